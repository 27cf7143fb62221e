//! The goal of a sentence, which is checked while a system is explored.

use super::is_running;
use crate::explore::Observer;
use crate::system::MemberRef;
use crate::system::{Change, Changed, Frame, Phase, System};
use language::algebra::Activity;
use language::sites::{EventKind, Moment, Occurrence, ProcessRef};

/// The goal of a sentence. Each state carries one byte of notes for it, and a second byte to count an event.
#[derive(Clone, Debug)]
pub(super) enum Goal {
    /// Forbidden: a state, from the first start of the process on, or always.
    Never(Option<ProcessRef>, Forbidden),
    /// Forbidden: the process starts although the event has never happened.
    Before(ProcessRef, Occurrence),
    /// Forbidden: the process starts more often than this.
    Often(ProcessRef, u32),
    /// Forbidden: after the event (or the fault), the process runs and is not being stopped.
    StillRuns(Option<Moment>, ProcessRef),
    /// Forbidden: after the first event (or the fault), the second one happens.
    Then(Option<Moment>, Occurrence),
    /// Owed after the first event (or the fault): the second event.
    Owed(Option<Moment>, Occurrence),
    /// Owed once the fault has struck the first process while it is active: the second process no longer runs.
    Ending(ProcessRef, ProcessRef),
    /// Owed from the start on.
    Sometime(Occurrence),
}

/// A forbidden state.
#[derive(Clone, Debug)]
pub(super) enum Forbidden {
    /// Two of these processes are active at the same time.
    Together(Vec<ProcessRef>),
    /// Two of these processes really run at the same time, even if their supervisors do not know it.
    BesideEachOther(Vec<ProcessRef>),
    /// The first process runs while the second process does not run.
    Without(ProcessRef, ProcessRef),
}

impl Forbidden {
    fn whom(&self) -> Vec<ProcessRef> {
        match self {
            Self::Together(all) | Self::BesideEachOther(all) => all.clone(),
            Self::Without(a, b) => vec![*a, *b],
        }
    }
}

impl Goal {
    /// Returns the processes for which the start matters, not only their activity.
    pub(super) fn begun(&self) -> Vec<ProcessRef> {
        let events: Vec<&Occurrence> = match self {
            Self::Before(who, event) if event.kind == EventKind::Started => return vec![*who, event.who],
            Self::Then(since, other) | Self::Owed(since, other) => event_of(since).chain([other]).collect(),
            Self::StillRuns(since, _) => event_of(since).collect(),
            Self::Never(first, Forbidden::Without(a, b)) => return first.iter().chain([a, b]).copied().collect(),
            Self::Never(first, Forbidden::Together(_) | Forbidden::BesideEachOther(_)) => {
                return first.iter().copied().collect();
            }
            Self::Before(..) | Self::Often(..) | Self::Ending(..) | Self::Sometime(_) => Vec::new(),
        };
        events.into_iter().filter(|event| event.kind == EventKind::Started).map(|event| event.who).collect()
    }

    /// Returns the processes whose failure is an event of the goal.
    pub(super) fn failing(&self) -> Vec<ProcessRef> {
        let events: Vec<&Occurrence> = match self {
            Self::Before(_, event) | Self::Sometime(event) => vec![event],
            Self::Then(since, other) | Self::Owed(since, other) => event_of(since).chain([other]).collect(),
            Self::StillRuns(since, _) => event_of(since).collect(),
            Self::Never(..) | Self::Often(..) | Self::Ending(..) => Vec::new(),
        };
        events.into_iter().filter(|event| event.kind == EventKind::Aborted).map(|event| event.who).collect()
    }

    /// Returns whether the goal is owed and has not been reached yet.
    pub(super) fn is_owed(&self, frame: &Frame) -> bool {
        let note = frame.notes.first().copied().unwrap_or(0);
        match self {
            Self::Sometime(_) => note == 0,
            Self::Owed(..) | Self::Ending(..) | Self::StillRuns(..) => note == 1,
            Self::Never(..) | Self::Before(..) | Self::Often(..) | Self::Then(..) => false,
        }
    }

    /// Returns how many bytes of notes each state needs.
    pub(super) fn notes(&self) -> usize {
        match self {
            Self::StillRuns(Some(moment), _) | Self::Then(Some(moment), _) | Self::Owed(Some(moment), _) => {
                1 + usize::from(moment.nth.is_some())
            }
            Self::StillRuns(None, _)
            | Self::Then(None, _)
            | Self::Owed(None, _)
            | Self::Never(..)
            | Self::Before(..)
            | Self::Often(..)
            | Self::Ending(..)
            | Self::Sometime(_) => 1,
        }
    }
}

fn event_of(since: &Option<Moment>) -> impl Iterator<Item = &Occurrence> {
    since.iter().map(|moment| &moment.event)
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
            Goal::Never(first, forbidden) => first.iter().copied().chain(forbidden.whom()).collect(),
            Goal::Before(who, event) => vec![*who, event.who],
            Goal::Often(who, _) => vec![*who],
            Goal::Ending(hung, who) => vec![*hung, *who],
            Goal::StillRuns(since, who) => event_of(since).map(|event| event.who).chain([*who]).collect(),
            Goal::Then(since, other) | Goal::Owed(since, other) => {
                event_of(since).map(|event| event.who).chain([other.who]).collect()
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

    /// Returns whether a change is the event after which the goal counts. Counts the event if only one occurrence matters.
    fn begins(&self, change: &Change, moment: &Moment, after: &mut Frame) -> bool {
        let Moment { event, nth } = moment;
        match *nth {
            _ if !self.is(change, event) => false,
            None => true,
            Some(nth) if after.notes[1] < nth => {
                after.notes[1] += 1;
                after.notes[1] == nth
            }
            Some(_) => false,
        }
    }

    /// Returns whether no state is forbidden.
    fn is_allowed(&self, system: &System<'_>, frame: &Frame, forbidden: &Forbidden) -> bool {
        match forbidden {
            Forbidden::Together(all) => all.iter().filter(|who| self.is_active(system, frame, **who)).count() < 2,
            Forbidden::BesideEachOther(all) => all.iter().filter(|who| self.is_there(system, frame, **who)).count() < 2,
            Forbidden::Without(a, b) => {
                let has_begun = |who| self.seats.has_begun(system, frame, who);
                let runs = is_running(system, frame, *a) && has_begun(*a);
                !runs || self.is_active(system, frame, *b) && has_begun(*b)
            }
        }
    }

    /// Returns whether the other event does not happen after the first event (or the fault), which may have happened before.
    fn is_still_allowed(
        &self,
        is_fault: bool,
        changes: &[Change],
        since: Option<&Moment>,
        other: &Occurrence,
        after: &mut Frame,
    ) -> bool {
        let mut is_over = after.notes[0] == 1 || since.is_none() && is_fault;
        for change in changes {
            if is_over && self.is(change, other) {
                return false;
            }
            is_over |= since.is_some_and(|moment| self.begins(change, moment, after));
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
            Goal::Never(None, forbidden) => self.is_allowed(system, after, forbidden),
            Goal::Never(Some(first), forbidden) => {
                let start = Occurrence { who: *first, kind: EventKind::Started };
                after.notes[0] |= u8::from(changes.iter().any(|change| self.is(change, &start)));
                after.notes[0] == 0 || self.is_allowed(system, after, forbidden)
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
            Goal::StillRuns(since, who) => {
                let mut happens = since.is_none() && is_fault;
                for change in changes {
                    happens |= since.as_ref().is_some_and(|moment| self.begins(change, moment, after));
                }
                after.notes[0] |= u8::from(happens);
                // Members inside a group may have to stop before the group's end is visible outside.
                if after.notes[0] == 0 || system.has_stops(after) || system.is_held_up(after) {
                    return true;
                }
                after.notes[0] = 0;
                !is_running(system, after, *who)
            }
            Goal::Then(since, other) => self.is_still_allowed(is_fault, changes, since.as_ref(), other, after),
            Goal::Owed(since, other) => {
                if since.is_none() && is_fault {
                    after.notes[0] = u8::from(!self.goes_on(system, after, other));
                }
                for change in changes {
                    if since.as_ref().is_some_and(|moment| self.begins(change, moment, after)) {
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
