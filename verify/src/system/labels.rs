//! The events that may happen next in a system.

use super::{Ends, FaultKind, Frame, Injection, Label, Occupant, Phase, System, small};
use crate::system::MemberRef;
use language::algebra::Activity;
use language::automaton::Failure;
use language::script::ScriptErrorKind;

impl System<'_> {
    /// Appends all events that may happen next.
    pub(crate) fn labels(&self, frame: &Frame, labels: &mut Vec<Label>) {
        labels.clear();
        match frame.phase {
            Phase::Idle => return self.start_labels(labels),
            // Beyond a loss, members may continue.
            Phase::Done | Phase::Aborted | Phase::Stopped if !self.is_split(frame) => return,
            Phase::Done | Phase::Aborted | Phase::Stopped | Phase::Stopping => {}
            Phase::Running if self.mode.stops => labels.push(Label::Stop),
            Phase::Running => {}
        }
        if self.mode.lost.is_some() {
            self.loss_labels(frame, labels);
        }
        self.restart_labels(frame, labels);
        self.transit_labels(frame, labels);
        for unit in 0..self.units.len() {
            if self.is_silent(frame, unit) {
                continue;
            }
            if frame.ordered[unit] && self.units[unit].parent.is_none_or(|seat| self.is_stop_next(frame, seat)) {
                labels.push(Label::Reached(small(unit)));
            }
            for member in frame.states[unit].members_active() {
                match &self.units[unit].seats[member as usize] {
                    Occupant::Box(ends) => self.member_labels(frame, MemberRef { unit, member }, ends, labels),
                    Occupant::Unit(_) if self.is_refused(frame, MemberRef { unit, member }) => {
                        let why = self.refusal(frame, MemberRef { unit, member });
                        labels.push(Label::Aborted(small(unit), small(member as usize), why));
                    }
                    Occupant::Unit(_) => {}
                }
            }
            if frame.states[unit].hears() {
                labels.extend(self.messages(unit).map(|number| Label::Told(small(unit), number)));
            }
            let program = self.program(unit);
            if self.mode.aborts && self.units[unit].packing.may_fail_script(program, &frame.states[unit]) {
                labels.extend(ScriptErrorKind::ALL.map(|kind| Label::Script(small(unit), kind)));
            }
            for timer in 0..program.timers() {
                if frame.states[unit].is_armed(program, timer) && self.clocks.may_elapse(frame, unit, program, timer) {
                    labels.push(Label::Elapsed(small(unit), small(timer as usize)));
                }
            }
        }
    }

    /// Appends the starts of the whole. The group around it may start it with any outcome.
    fn start_labels(&self, labels: &mut Vec<Label>) {
        labels.push(Label::Start);
        let part = self.units[0].part;
        if part != 0 && self.model.parts[part].reads_start {
            let outcomes = (1..=u8::MAX).take_while(|number| self.tag(*number).is_some());
            labels.extend(outcomes.map(Label::StartWith));
        }
    }

    /// Returns whether an active member runs, so that it may end by itself.
    pub(crate) fn ends_by_itself(&self, frame: &Frame, unit: usize, member: u32) -> bool {
        let seat = MemberRef { unit, member };
        !self.is_refused(frame, seat) && !self.is_unheard(frame, seat) && !self.is_under_way(frame, seat)
    }

    /// Returns the number of the report for a member that is refused: it cannot be started any more, or its host is
    /// lost.
    fn refusal(&self, frame: &Frame, seat: MemberRef) -> u8 {
        self.report(if self.is_given_up(frame, seat) { &Failure::Crash } else { &Failure::HostLost })
    }

    fn member_labels(&self, frame: &Frame, seat: MemberRef, ends: &[Ends; 2], labels: &mut Vec<Label>) {
        let MemberRef { unit, member } = seat;
        let (at, slot) = (small(unit), small(member as usize));
        if self.is_refused(frame, seat) {
            labels.push(Label::Aborted(at, slot, self.refusal(frame, seat)));
            return;
        }
        let is_stopping = frame.states[unit].activity(member) == Activity::Stopping;
        if self.is_unheard(frame, seat) || self.is_under_way(frame, seat) {
            if self.may_have_ended(frame, seat) {
                match is_stopping {
                    true => labels.push(Label::Stopped(at, slot)),
                    false => labels.extend(ends[1].done.iter().map(|value| Label::Done(at, slot, self.number(value)))),
                }
            }
            return;
        }
        let mut hangs = self.waits_for_ever(frame, seat);
        let ends = &ends[usize::from(!self.mode.aborts)];
        let is_struck = |fault: Injection| (fault.unit, fault.member) == (unit, member);
        let faults = [
            (self.mode.fault, frame.is_faulty, Label::Fault(at, slot)),
            (self.mode.second, frame.is_twice_faulty, Label::Second(at, slot)),
        ];
        for (fault, has_happened, _) in faults {
            hangs |= has_happened && fault.is_some_and(|fault| is_struck(fault) && fault.kind == FaultKind::Hang);
        }
        let ends_by_itself = match is_stopping {
            // The member may still end before the order to stop reaches it.
            true => self.is_distant_group(seat),
            false => !self.death_labels(frame, seat, labels),
        };
        if is_stopping {
            labels.push(Label::Stopped(at, slot));
            if !ends_by_itself && self.failing.contains(&seat) {
                // The supervisor treats all failures of a member that it has told to stop in the same way.
                labels.extend(ends.aborted.first().map(|report| Label::Aborted(at, slot, self.number(report))));
            }
        }
        if ends_by_itself && !hangs {
            labels.extend(ends.done.iter().map(|value| Label::Done(at, slot, self.number(value))));
            labels.extend(ends.aborted.iter().map(|report| Label::Aborted(at, slot, self.number(report))));
        }
        for (fault, has_happened, label) in faults {
            let may = |fault: Injection| {
                let is_due = is_stopping == (fault.kind == FaultKind::Unanswered);
                is_struck(fault) && is_due && !self.is_away(frame, seat)
            };
            if !has_happened && fault.is_some_and(may) {
                labels.push(label);
            }
        }
    }

    /// Returns whether a label happens without a failure and without a request to stop: a program ends, a stop is
    /// answered, or a timer elapses. A black box may fail although no program fails: `estop ; fail("stopped")`. It
    /// may also be done only because a program has failed: `service else home`.
    pub(crate) fn is_natural(&self, label: Label) -> bool {
        match label {
            Label::Done(unit, member, value) => match self.calm(unit, member) {
                Some(calm) => calm.done.iter().any(|other| self.number(other) == value),
                None => true,
            },
            Label::Start
            | Label::StartWith(_)
            | Label::Stopped(..)
            | Label::Elapsed(..)
            | Label::Told(..)
            | Label::Reached(_)
            | Label::Arrived(..)
            | Label::Heard(..)
            | Label::Back(..)
            | Label::Noted(_) => true,
            Label::Aborted(unit, member, why) => {
                let calm = self.calm(unit, member).map_or(&[][..], |calm| &calm.aborted);
                calm.iter().any(|report| self.number(report) == why)
            }
            Label::Stop
            | Label::Script(..)
            | Label::Died(..)
            | Label::TooMany(_)
            | Label::Fault(..)
            | Label::Second(..)
            | Label::Lost => false,
        }
    }

    /// Returns the possible ends of a black box if no program fails.
    fn calm(&self, unit: u16, member: u16) -> Option<&Ends> {
        match self.units[usize::from(unit)].seats.get(usize::from(member)) {
            Some(Occupant::Box([_, calm])) => Some(calm),
            Some(Occupant::Unit(_)) | None => None,
        }
    }
}
