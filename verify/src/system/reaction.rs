//! Applies an event to a system: the parts react one after the other, until the event has no further consequences.

use super::transit::Arrival;
use super::zone::TimedReaction;
use super::{Change, Changed, FaultKind, Frame, Injection, Label, Occupant, Phase, System};
use crate::system::MemberRef;
use language::algebra::{Activation, Activity, Cause, Command, Event, Outcome, Reason, Steps, Value};
use language::automaton::Failure;
use language::script::ScriptErrorKind;
use std::collections::VecDeque;

/// Every activation of an explored state has this number.
const ACTIVATION: Activation = Activation(1);

/// Applies events to a system, and can undo the last one.
#[derive(Debug)]
pub(crate) struct Stepper<'s> {
    system: &'s System<'s>,
    steps: Vec<Steps<'s>>,
    queue: VecDeque<(usize, Event)>,
    /// The changes of the last event: unit, item, and the previous word.
    journal: Vec<(usize, u32, u64)>,
    /// Everything except the states, as it was before the last event.
    before: Frame,
}

/// An effect of noting a loss on a unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Blow {
    /// The unit is stopped.
    Stop(usize),
    /// The unit is an activity, and learns that the host of this number is lost.
    News(usize, u32),
    /// A member that ran, or was already being stopped, has failed for this unit.
    End(usize, u32, Activity),
    /// A member has stopped, but no confirmation arrives.
    Tell(usize, u32),
}

impl<'s> Stepper<'s> {
    pub(super) fn new(system: &'s System<'s>, steps: Vec<Steps<'s>>) -> Self {
        let before = Frame { states: Vec::new(), ..system.initial() };
        Self { system, steps, queue: VecDeque::new(), journal: Vec::new(), before }
    }

    /// Applies a label. Writes the changes to `changes`, if given.
    pub(crate) fn apply(&mut self, frame: &mut Frame, label: Label, mut changes: Option<&mut Vec<Change>>) {
        if let Some(changes) = &mut changes {
            changes.clear();
        }
        self.journal.clear();
        self.before.take_rest_of(frame);
        let Self { system, steps, queue, journal, .. } = self;
        let mut reaction = Reaction { system, frame, changes, queue, journal, blows: VecDeque::new() };
        let mut next = reaction.begin(label);
        while let Some((unit, event)) = next.or_else(|| reaction.blow()) {
            reaction.react(&mut steps[unit], unit, event);
            next = reaction.queue.pop_front();
        }
    }

    /// Returns the nodes of a unit that end at once at an event, including nodes that a loop restarts.
    pub(crate) fn ended(&mut self, frame: &Frame, label: Label) -> Vec<usize> {
        let Self { system, steps, queue, journal, .. } = self;
        let mut frame = frame.clone();
        let mut reaction =
            Reaction { system, frame: &mut frame, changes: None, queue, journal, blows: VecDeque::new() };
        let Some((unit, event)) = reaction.begin(label) else { return Vec::new() };
        steps[unit].ended(&frame.states[unit], event)
    }

    /// Returns the items of units that the last event has changed.
    pub(crate) fn changed(&self) -> impl Iterator<Item = (usize, u32)> + '_ {
        self.journal.iter().map(|&(unit, item, _)| (unit, item))
    }

    /// Undoes the last event.
    pub(crate) fn undo(&mut self, frame: &mut Frame) {
        for (unit, item, word) in self.journal.drain(..).rev() {
            frame.states[unit].set(item, word);
        }
        frame.take_rest_of(&self.before);
    }
}

/// One event, with all its immediate consequences.
struct Reaction<'r, 'a> {
    system: &'r System<'a>,
    frame: &'r mut Frame,
    changes: Option<&'r mut Vec<Change>>,
    queue: &'r mut VecDeque<(usize, Event)>,
    journal: &'r mut Vec<(usize, u32, u64)>,
    /// The remaining effects of noticing a loss. Each waits until the previous ones have no further consequences.
    blows: VecDeque<Blow>,
}

impl Reaction<'_, '_> {
    /// Returns the first consequence for the units: at most one event of one unit.
    fn begin(&mut self, label: Label) -> Option<(usize, Event)> {
        match label {
            Label::Start => Some(self.starts(Value::EMPTY)),
            Label::StartWith(value) => Some(self.starts(self.system.value(value))),
            Label::Stop => {
                self.frame.phase = Phase::Stopping;
                self.change(0, None, || Changed::Stopping);
                Some((0, Event::Stop))
            }
            Label::Done(unit, member, value) => self.ends(unit, member, Outcome::Done(self.system.value(value))),
            Label::Aborted(unit, member, why) => {
                let seat = MemberRef { unit: usize::from(unit), member: u32::from(member) };
                let is_asked = self.frame.states[seat.unit].activity(seat.member) == Activity::Stopping;
                let is_lost = self.system.is_refused(self.frame, seat) && !self.system.is_given_up(self.frame, seat);
                let is_unknown = is_asked && (is_lost || self.system.was_unconfirmed(self.frame, seat));
                let outcome = if is_unknown { unconfirmed() } else { failed(&self.system.reason(why)) };
                self.ends(unit, member, outcome)
            }
            Label::Arrived(unit, member) => {
                self.arrives(MemberRef { unit: usize::from(unit), member: u32::from(member) })
            }
            Label::Heard(unit, member) => self.hears(MemberRef { unit: usize::from(unit), member: u32::from(member) }),
            Label::Lost => {
                self.frame.is_faulty = true;
                self.lose_orders();
                self.system.lose_to_the_dead(self.frame);
                None
            }
            Label::Noted(host) => {
                self.lose_late_orders(u32::from(host));
                self.blows = self.system.note(self.frame, u32::from(host));
                None
            }
            Label::Stopped(unit, member) => self.ends(unit, member, Outcome::Stopped),
            Label::Died(unit, member) => self.dies(MemberRef { unit: usize::from(unit), member: u32::from(member) }),
            Label::Back(unit, member) => {
                let (unit, member) = (usize::from(unit), u32::from(member));
                self.system.is_here(self.frame, MemberRef { unit, member });
                self.change(unit, Some(member), || Changed::Started);
                None
            }
            Label::TooMany(unit) => self.too_many(usize::from(unit)),
            Label::Elapsed(unit, timer) => {
                let event = Event::Elapsed { timer: u32::from(timer), activation: ACTIVATION };
                Some((usize::from(unit), event))
            }
            Label::Script(unit, kind) => {
                self.fail_script(usize::from(unit), kind);
                None
            }
            Label::Told(unit, number) => {
                let message = self.system.told(usize::from(unit), number)?;
                Some((usize::from(unit), message))
            }
            Label::Reached(unit) => {
                self.forget_order(usize::from(unit));
                Some((usize::from(unit), Event::Stop))
            }
            Label::Fault(unit, member) => {
                self.frame.is_faulty = true;
                self.strikes(unit, member, self.system.mode.fault)
            }
            Label::Second(unit, member) => {
                self.frame.is_twice_faulty = true;
                self.strikes(unit, member, self.system.mode.second)
            }
        }
    }

    fn starts(&mut self, value: Value) -> (usize, Event) {
        self.frame.phase = Phase::Running;
        self.change(0, None, || Changed::Started);
        (0, Event::Start(value))
    }

    /// Lets the next script of a unit fail.
    fn fail_script(&mut self, unit: usize, kind: ScriptErrorKind) {
        let (program, words) = (self.system.program(unit), &mut self.frame.states[unit]);
        for (item, word) in self.system.units[unit].packing.fail_script(program, words, kind) {
            self.journal.push((unit, item, words.set(item, word)));
        }
    }

    fn strikes(&mut self, unit: u16, member: u16, fault: Option<Injection>) -> Option<(usize, Event)> {
        let (kind, seat) = (fault?.kind, MemberRef { unit: usize::from(unit), member: u32::from(member) });
        match kind {
            FaultKind::Crash if self.system.is_restarted(seat) => self.dies(seat),
            FaultKind::Crash => self.ends(unit, member, failed(&Failure::Crash)),
            FaultKind::GivenUp => {
                self.system.give_up_member(self.frame, seat, kind);
                self.ends(unit, member, failed(&Failure::Crash))
            }
            FaultKind::TooMany => self.too_many(seat.unit),
            FaultKind::Unanswered => {
                self.system.give_up_member(self.frame, seat, kind);
                self.system.stays_taken(self.frame, seat);
                self.ends(unit, member, unconfirmed())
            }
            FaultKind::Hang | FaultKind::HostLost | FaultKind::CutOff | FaultKind::LinkLost => None,
        }
    }

    /// Handles the death of a program that is restarted. The supervisor does not learn of it.
    fn dies(&mut self, seat: MemberRef) -> Option<(usize, Event)> {
        for (unit, member, what) in self.system.dies(self.frame, seat) {
            self.change(unit, Some(member), || what);
        }
        None
    }

    fn too_many(&mut self, unit: usize) -> Option<(usize, Event)> {
        Some((self.system.too_many(self.frame, unit), Event::Stop))
    }

    /// Discards orders to stop in transit to a host that has died.
    fn lose_orders(&mut self) {
        for unit in 0..self.system.units.len() {
            if self.system.is_silent(self.frame, unit) {
                self.forget_order(unit);
            }
        }
    }

    /// Discards orders in transit over the loss to a host that has noticed it.
    fn lose_late_orders(&mut self, host: u32) {
        for unit in 0..self.system.units.len() {
            let parent = self.system.units[unit].parent.filter(|_| self.system.host_of(unit) == host);
            if parent.is_some_and(|seat| self.system.is_severed(self.frame, seat)) {
                self.forget_order(unit);
            }
        }
    }

    /// Notes that no order to stop is in transit to a unit any more.
    fn forget_order(&mut self, unit: usize) {
        self.frame.ordered[unit] = false;
        if let Some(seat) = self.system.units[unit].parent {
            self.system.receive_stop(self.frame, seat);
        }
    }

    /// The next effect of noting a loss.
    fn blow(&mut self) -> Option<(usize, Event)> {
        while let Some(blow) = self.blows.pop_front() {
            match blow {
                Blow::Tell(unit, member) => self.change(unit, Some(member), || Changed::Stopped),
                Blow::Stop(unit) if !self.system.is_silent(self.frame, unit) => return Some((unit, Event::Stop)),
                Blow::News(unit, host) if !self.system.is_silent(self.frame, unit) => {
                    let is_idle = !self.frame.states[unit].is_node_active(0);
                    if let Some(event) = self.system.loss_notice(unit, host).filter(|_| !is_idle) {
                        return Some((unit, event));
                    }
                }
                Blow::End(unit, member, was) if !self.system.is_silent(self.frame, unit) => {
                    let is_severed = self.system.is_severed(self.frame, MemberRef { unit, member });
                    match self.frame.states[unit].activity(member) {
                        // Learning of the loss may have led to the stop.
                        Activity::Stopping if is_severed && was == Activity::Active => {
                            return Some((unit, self.ended(unit, member, failed(&Failure::HostLost))));
                        }
                        Activity::Active => return Some((unit, self.ended(unit, member, failed(&Failure::HostLost)))),
                        Activity::Stopping if is_severed => {
                            return Some((unit, self.ended(unit, member, unconfirmed())));
                        }
                        Activity::Stopping | Activity::Idle => {}
                    }
                }
                Blow::Stop(_) | Blow::End(..) | Blow::News(..) => {}
            }
        }
        None
    }

    fn ends(&mut self, unit: u16, member: u16, outcome: Outcome) -> Option<(usize, Event)> {
        let seat = MemberRef { unit: usize::from(unit), member: u32::from(member) };
        // The supervisor's own node reports a refusal.
        let is_there = !self.system.is_refused(self.frame, seat) && self.system.is_distant_group(seat);
        if is_there && self.reports(seat, &outcome) {
            return None;
        }
        Some((seat.unit, self.ended(seat.unit, seat.member, outcome)))
    }

    /// Handles the end of a group on another host, which is reported to its supervisor. Returns false if the group is
    /// not on another host.
    fn reports(&mut self, seat: MemberRef, outcome: &Outcome) -> bool {
        let MemberRef { unit, member } = seat;
        let travels = self.system.send_end(self.frame, seat, outcome);
        if travels {
            self.change(unit, Some(member), || changed(outcome, false));
            self.system.is_here(self.frame, seat);
        }
        travels
    }

    /// Handles the arrival of the order to start a member at its host.
    fn arrives(&mut self, seat: MemberRef) -> Option<(usize, Event)> {
        let Some(Arrival::Start(value)) = self.system.receive(self.frame, seat) else { return None };
        if !self.system.is_taken(self.frame, seat) {
            return None;
        }
        self.change(seat.unit, Some(seat.member), || Changed::Started);
        match self.system.units[seat.unit].seats[seat.member as usize] {
            Occupant::Unit(inner) => Some((inner, Event::Start(value))),
            Occupant::Box(_) => None,
        }
    }

    /// Handles the report that a member on another host has ended.
    fn hears(&mut self, seat: MemberRef) -> Option<(usize, Event)> {
        let MemberRef { unit, member } = seat;
        let Some(Arrival::End(outcome)) = self.system.receive(self.frame, seat) else { return None };
        let is_awaited = self.frame.states[unit].activity(member) != Activity::Idle;
        (is_awaited && !self.system.is_silent(self.frame, unit)).then(|| (unit, self.event_of(member, outcome)))
    }

    /// Handles the end of a member. Returns the event for the unit.
    fn ended(&mut self, unit: usize, member: u32, outcome: Outcome) -> Event {
        let is_asked = self.frame.states[unit].activity(member) == Activity::Stopping;
        self.change(unit, Some(member), || changed(&outcome, is_asked));
        self.system.is_here(self.frame, MemberRef { unit, member });
        if !self.system.is_severed(self.frame, MemberRef { unit, member }) {
            self.system.receive(self.frame, MemberRef { unit, member });
        }
        self.event_of(member, outcome)
    }

    /// Returns the event of a unit for the end of a member.
    fn event_of(&self, member: u32, outcome: Outcome) -> Event {
        let activation = ACTIVATION;
        match outcome {
            Outcome::Done(value) => Event::Done { member, activation, value },
            Outcome::Stopped => Event::Stopped { member, activation },
            Outcome::Aborted(_) if is_unconfirmed(&outcome) => Event::StopUnconfirmed { member, activation },
            Outcome::Aborted(reason) => {
                let report = self.system.value(self.system.report(&Failure::of(&reason.cause)));
                Event::Aborted { member, activation, report }
            }
        }
    }

    fn change(&mut self, unit: usize, member: Option<u32>, what: impl FnOnce() -> Changed) {
        if let Some(changes) = &mut self.changes {
            changes.push(Change { unit, member, what: what() });
        }
    }

    fn react(&mut self, steps: &mut Steps<'_>, unit: usize, event: Event) {
        let elapsed = if let Event::Elapsed { timer, .. } = event { Some(timer) } else { None };
        let effect = steps.step(&self.frame.states[unit], event);
        for &(item, word) in &effect.writes {
            self.journal.push((unit, item, self.frame.states[unit].set(item, word)));
        }
        let timed = TimedReaction { elapsed, commands: &effect.commands };
        self.system.clocks.follow(self.frame, unit, self.system.program(unit), &timed);
        for command in &effect.commands {
            match command {
                Command::Activate { member, value, .. } => {
                    let seat = MemberRef { unit, member: *member };
                    self.system.is_here(self.frame, seat);
                    let begins = self.system.begins(self.frame, seat);
                    // A message sent over a loss never arrives.
                    let is_lost = !begins && self.system.is_severed(self.frame, seat) && self.system.is_followed(seat);
                    if is_lost || begins && self.system.send_start(self.frame, seat, value) {
                        self.change(unit, Some(*member), || Changed::Sent);
                        continue;
                    }
                    let is_given_up = self.system.is_given_up(self.frame, seat);
                    if !is_given_up && !self.system.waits_for_ever(self.frame, seat) {
                        self.change(unit, Some(*member), || Changed::Started);
                    }
                    if begins && let Occupant::Unit(inner) = self.system.units[unit].seats[*member as usize] {
                        self.queue.push_back((inner, Event::Start(value.clone())));
                    }
                }
                Command::Stop { member, .. } => self.stop(unit, *member),
                Command::Connect { .. }
                | Command::Disconnect { .. }
                | Command::Arm { .. }
                | Command::Cancel { .. }
                | Command::Send { .. }
                | Command::Log { .. }
                | Command::Lost { .. } => {}
            }
        }
        if let Some(outcome) = &effect.outcome {
            self.over(unit, outcome.clone());
        }
    }

    /// Makes a unit stop a member: a piece of the same group at once, another group when the order reaches it.
    fn stop(&mut self, unit: usize, member: u32) {
        self.change(unit, Some(member), || Changed::Stopping);
        let Occupant::Unit(inner) = self.system.units[unit].seats[member as usize] else { return };
        if self.system.model.parts[self.system.units[inner].part].is_piece {
            self.queue.push_back((inner, Event::Stop));
        } else if self.system.waits_for_ever(self.frame, MemberRef { unit, member }) {
            // The member has never begun.
            self.queue.push_back((unit, Event::Stopped { member, activation: ACTIVATION }));
        } else if !self.system.is_severed(self.frame, MemberRef { unit, member }) {
            // A member that has already ended does not have to be stopped.
            if !self.system.has_ended_unheard(self.frame, MemberRef { unit, member }) {
                self.frame.ordered[inner] = true;
                self.system.send_stop(self.frame, MemberRef { unit, member });
            }
        }
    }

    /// Handles the outcome of a unit, which is the outcome of the member around it, or of the whole.
    fn over(&mut self, unit: usize, outcome: Outcome) {
        self.forget_order(unit);
        let is_escalated = self.system.take_escalation(self.frame, unit);
        let outcome = if is_escalated && !is_unconfirmed(&outcome) { failed(&Failure::Crash) } else { outcome };
        if let Some(MemberRef { unit: around, member }) = self.system.units[unit].parent {
            // A stop that comes too late has no effect: its answer is the outcome that was in transit.
            let is_heard = !self.system.is_severed(self.frame, MemberRef { unit: around, member })
                && !self.system.is_silent(self.frame, around);
            let is_awaited = is_heard && self.frame.states[around].activity(member) != Activity::Idle;
            if is_awaited && !self.reports(MemberRef { unit: around, member }, &outcome) {
                let event = self.ended(around, member, outcome);
                self.queue.push_back((around, event));
            }
            return;
        }
        let (phase, what) = match outcome {
            Outcome::Done(value) => (Phase::Done, Changed::Done(value)),
            Outcome::Aborted(reason) => (Phase::Aborted, Changed::Aborted(Failure::of(&reason.cause).report())),
            Outcome::Stopped => (Phase::Stopped, Changed::Stopped),
        };
        self.frame.phase = phase;
        self.change(unit, None, || what);
    }
}

/// Returns the change that observers see at an end. A member with an order to stop is treated as
/// stopped, regardless of its outcome.
fn changed(outcome: &Outcome, is_asked: bool) -> Changed {
    match outcome {
        Outcome::Aborted(reason) => Changed::Aborted(Failure::of(&reason.cause).report()),
        Outcome::Done(value) if !is_asked => Changed::Done(value.clone()),
        Outcome::Done(_) | Outcome::Stopped => Changed::Stopped,
    }
}

/// Whether a stop was not confirmed.
pub(super) fn is_unconfirmed(outcome: &Outcome) -> bool {
    matches!(outcome, Outcome::Aborted(reason) if reason.cause == Cause::StopUnconfirmed)
}

pub(super) fn unconfirmed() -> Outcome {
    Outcome::Aborted(Reason { member: None, cause: Cause::StopUnconfirmed })
}

/// Returns a failure with this reason.
pub(super) fn failed(reason: &Failure) -> Outcome {
    Outcome::Aborted(Reason { member: None, cause: Cause::Reported(reason.report()) })
}
