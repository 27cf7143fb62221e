//! The goal of a sentence, which is checked while a system is explored.

use super::is_running;
use crate::explore::Observer;
use crate::system::MemberRef;
use crate::system::{Change, Changed, Frame, Phase, System};
use language::algebra::Activity;
use language::sites::{EventKind, Occurrence, ProcessRef};

/// The goal of a sentence. Each state carries one byte of notes for it.
#[derive(Clone, Debug)]
pub(super) enum Goal {
    /// Forbidden: two of these processes are active at the same time.
    Together(Vec<ProcessRef>),
    /// Forbidden: two of these processes really run at the same time, even if their supervisors do not know it.
    BesideEachOther(Vec<ProcessRef>),
    /// Forbidden: the first process runs while the second process does not run.
    Without(ProcessRef, ProcessRef),
    /// Forbidden: the process starts although the event has never happened.
    Before(ProcessRef, Occurrence),
    /// Forbidden: the process starts more often than this.
    Often(ProcessRef, u32),
    /// Forbidden: after the event (or the fault), the process runs and is not being stopped.
    StillRuns(Option<Occurrence>, ProcessRef),
    /// Forbidden: after the first event (or the fault), the second one happens.
    Then(Option<Occurrence>, Occurrence),
    /// Owed after the first event (or the fault): the second event.
    Owed(Option<Occurrence>, Occurrence),
    /// Owed once the fault has struck the first process while it is active: the second process no longer runs.
    Ending(ProcessRef, ProcessRef),
    /// Owed from the start on.
    Sometime(Occurrence),
}

impl Goal {
    /// Returns the processes for which the start matters, not only their activity.
    pub(super) fn begun(&self) -> Vec<ProcessRef> {
        let events: Vec<&Occurrence> = match self {
            Self::Before(who, event) if event.kind == EventKind::Started => return vec![*who, event.who],
            Self::Then(event, other) | Self::Owed(event, other) => event.iter().chain([other]).collect(),
            Self::StillRuns(event, _) => event.iter().collect(),
            Self::Without(a, b) => return vec![*a, *b],
            Self::Before(..)
            | Self::Together(_)
            | Self::BesideEachOther(_)
            | Self::Often(..)
            | Self::Ending(..)
            | Self::Sometime(_) => Vec::new(),
        };
        events.into_iter().filter(|event| event.kind == EventKind::Started).map(|event| event.who).collect()
    }

    /// Returns whether the goal is owed and has not been reached yet.
    pub(super) fn is_owed(&self, frame: &Frame) -> bool {
        let note = frame.notes.first().copied().unwrap_or(0);
        match self {
            Self::Sometime(_) => note == 0,
            Self::Owed(..) | Self::Ending(..) | Self::StillRuns(..) => note == 1,
            Self::Together(_)
            | Self::BesideEachOther(_)
            | Self::Without(..)
            | Self::Before(..)
            | Self::Often(..)
            | Self::Then(..) => false,
        }
    }
}

pub(super) struct Watch<'w> {
    goal: &'w Goal,
    seats: Seats,
}

/// The seat of each named process in a system.
pub(super) struct Seats(Vec<(ProcessRef, Option<Seat>)>);

/// The unit and slot, and the place of the notes about the absence of its program, if there are any.
#[derive(Clone, Copy, Debug)]
struct Seat {
    at: MemberRef,
    away: Option<usize>,
}

impl<'w> Watch<'w> {
    pub(super) fn new(system: &System<'_>, goal: &'w Goal) -> Self {
        let whom: Vec<ProcessRef> = match goal {
            Goal::Together(all) | Goal::BesideEachOther(all) => all.clone(),
            Goal::Without(a, b) => vec![*a, *b],
            Goal::Before(who, event) => vec![*who, event.who],
            Goal::Often(who, _) => vec![*who],
            Goal::Ending(hung, who) => vec![*hung, *who],
            Goal::StillRuns(event, who) => event.iter().map(|event| event.who).chain([*who]).collect(),
            Goal::Then(event, other) | Goal::Owed(event, other) => {
                event.iter().map(|event| event.who).chain([other.who]).collect()
            }
            Goal::Sometime(event) => vec![event.who],
        };
        Self { goal, seats: Seats::new(system, &whom) }
    }

    fn is_active(&self, system: &System<'_>, frame: &Frame, who: ProcessRef) -> bool {
        self.seats.is_active(system, frame, who)
    }

    /// Returns whether a process, or something in it, really runs.
    fn is_there(&self, system: &System<'_>, frame: &Frame, who: ProcessRef) -> bool {
        self.seats.seat(who).is_some_and(|seat| system.is_anything_there(frame, seat.at))
    }

    fn is(&self, change: &Change, event: &Occurrence) -> bool {
        self.seats.is(change, event)
    }

    /// Returns whether a process that has to start after a fault already runs, and continues because the fault has not
    /// struck it.
    fn goes_on(&self, system: &System<'_>, frame: &Frame, start: &Occurrence) -> bool {
        let Occurrence { who, kind: EventKind::Started } = *start else { return false };
        let at = self.seats.seat(who).map(|seat| seat.at);
        let is_struck =
            system.mode.fault.is_some_and(|fault| at == Some(MemberRef { unit: fault.unit, member: fault.member }));
        let runs = is_running(system, frame, who) && self.is_active(system, frame, who);
        !is_struck && runs && (who.member.is_none() || self.is_there(system, frame, who))
    }

    /// Returns whether the event (or the fault) happens in a transition.
    fn happens(&self, is_fault: bool, changes: &[Change], event: Option<&Occurrence>) -> bool {
        event.map_or(is_fault, |event| changes.iter().any(|change| self.is(change, event)))
    }
}

impl Watch<'_> {
    /// Returns whether the other event does not happen after the first event. If `is_over`, the first event has happened
    /// before.
    fn is_still_allowed(
        &self,
        mut is_over: bool,
        changes: &[Change],
        event: Option<&Occurrence>,
        other: &Occurrence,
        after: &mut Frame,
    ) -> bool {
        for change in changes {
            if is_over && self.is(change, other) {
                return false;
            }
            is_over |= event.is_some_and(|event| self.is(change, event));
        }
        after.notes[0] = u8::from(is_over);
        true
    }
}

impl Seats {
    pub(super) fn new(system: &System<'_>, whom: &[ProcessRef]) -> Self {
        let seat = |who: &ProcessRef| {
            let at = system.find(who.group, who.member?)?;
            Some(Seat { at, away: system.place_of(at) })
        };
        Self(whom.iter().map(|who| (*who, seat(who))).collect())
    }

    fn seat(&self, who: ProcessRef) -> Option<Seat> {
        self.0.iter().find(|(other, _)| *other == who).and_then(|(_, seat)| *seat)
    }

    /// Returns whether a process is active, or is being stopped, and its program exists.
    pub(super) fn is_active(&self, system: &System<'_>, frame: &Frame, who: ProcessRef) -> bool {
        match self.seat(who) {
            Some(Seat { at: MemberRef { unit, member }, away }) => {
                let is_away = away.is_some_and(|place| System::notes_away(frame, place));
                let is_under_way = system.is_group_under_way(frame, MemberRef { unit, member });
                frame.states[unit].activity(member) != Activity::Idle && !is_away && !is_under_way
            }
            None => who.member.is_none() && [Phase::Running, Phase::Stopping].contains(&frame.phase),
        }
    }

    /// Returns whether no order to start a process is in transit any more, as far as its messages are tracked.
    pub(super) fn has_begun(&self, system: &System<'_>, frame: &Frame, who: ProcessRef) -> bool {
        self.seat(who).is_none_or(|seat| !system.is_under_way(frame, seat.at))
    }

    /// Returns whether a change is this event.
    pub(super) fn is(&self, change: &Change, event: &Occurrence) -> bool {
        let is_there = match (event.who.member, change.member) {
            (None, None) => true,
            (Some(_), Some(member)) => {
                self.seat(event.who).is_some_and(|seat| seat.at == MemberRef { unit: change.unit, member })
            }
            (_, _) => false,
        };
        is_there
            && match (&event.kind, &change.what) {
                (EventKind::Started, Changed::Started) | (EventKind::Aborted, Changed::Aborted(_)) => true,
                (EventKind::Done(None), Changed::Done(_)) => true,
                (EventKind::Done(Some(tag)), Changed::Done(value)) => value.tag() == Some(tag),
                (EventKind::Ended, Changed::Done(_) | Changed::Aborted(_) | Changed::Stopped) => true,
                (_, _) => false,
            }
    }
}

impl Observer for Watch<'_> {
    fn sees(&self, system: &System<'_>, is_fault: bool, changes: &[Change], after: &mut Frame) -> bool {
        let note = after.notes[0];
        match self.goal {
            Goal::Together(all) => all.iter().filter(|who| self.is_active(system, after, **who)).count() < 2,
            Goal::BesideEachOther(all) => all.iter().filter(|who| self.is_there(system, after, **who)).count() < 2,
            Goal::Without(a, b) => {
                let has_begun = |who| self.seats.has_begun(system, after, who);
                let runs = is_running(system, after, *a) && has_begun(*a);
                !runs || self.is_active(system, after, *b) && has_begun(*b)
            }
            Goal::Before(who, event) => {
                let start = Occurrence { who: *who, kind: EventKind::Started };
                for change in changes {
                    if self.is(change, event) {
                        after.notes[0] = 1;
                    }
                    if after.notes[0] == 0 && self.is(change, &start) {
                        return false;
                    }
                }
                true
            }
            Goal::Often(who, times) => {
                let start = Occurrence { who: *who, kind: EventKind::Started };
                let starts = changes.iter().filter(|change| self.is(change, &start)).count();
                let starts = usize::from(note) + starts;
                after.notes[0] = u8::try_from(starts).unwrap_or(u8::MAX);
                starts <= *times as usize
            }
            Goal::StillRuns(event, who) => {
                if self.happens(is_fault, changes, event.as_ref()) {
                    after.notes[0] = 1;
                }
                // Members inside a group may have to stop before the group's end is visible outside.
                if after.notes[0] == 0 || system.has_stops(after) || system.is_held_up(after) {
                    return true;
                }
                after.notes[0] = 0;
                !is_running(system, after, *who)
            }
            Goal::Then(event, other) => {
                let is_over = note == 1 || event.is_none() && self.happens(is_fault, changes, None);
                self.is_still_allowed(is_over, changes, event.as_ref(), other, after)
            }
            Goal::Owed(event, other) => {
                if event.is_none() && self.happens(is_fault, changes, None) {
                    after.notes[0] = u8::from(!self.goes_on(system, after, other));
                }
                for change in changes {
                    if event.as_ref().is_some_and(|event| self.is(change, event)) {
                        after.notes[0] = 1;
                    }
                    if self.is(change, other) {
                        after.notes[0] = 0;
                    }
                }
                true
            }
            Goal::Ending(hung, who) => {
                let is_asked = note == 1 || after.is_faulty && self.is_active(system, after, *hung);
                after.notes[0] = u8::from(is_asked && is_running(system, after, *who));
                true
            }
            Goal::Sometime(event) => {
                if changes.iter().any(|change| self.is(change, event)) {
                    after.notes[0] = 1;
                }
                true
            }
        }
    }
}
