//! Lets something happen in a system: the parts react one after the other, until nothing follows any more.

use super::{Change, Changed, FaultKind, Frame, Label, Occupant, Phase, System};
use language::algebra::{Activity, Cause, Command, Event, Outcome, Reason, Value, step};
use std::collections::VecDeque;

/// One thing that happens, with all that follows at once.
pub(super) struct Reaction<'r, 'a> {
    pub(super) system: &'r System<'a>,
    pub(super) frame: &'r mut Frame,
    pub(super) changes: &'r mut Vec<Change>,
    pub(super) queue: VecDeque<(usize, Event)>,
    pub(super) commands: Vec<Command>,
}

impl Reaction<'_, '_> {
    pub(super) fn begin(&mut self, label: Label) {
        match label {
            Label::Start => {
                self.frame.phase = Phase::Running;
                self.change(0, None, Changed::Started);
                self.queue.push_back((0, Event::Start(Value::EMPTY)));
            }
            Label::Stop => {
                self.frame.phase = Phase::Stopping;
                self.change(0, None, Changed::Stopping);
                self.queue.push_back((0, Event::Stop));
            }
            Label::Done(unit, member, value) => self.ends(unit, member, Outcome::Done(self.system.value(value))),
            Label::Aborted(unit, member) => {
                let (at, slot) = (usize::from(unit), u32::from(member));
                let is_asked = self.frame.states[at].activity(slot) == Activity::Stopping;
                let is_lost = self.frame.is_faulty && self.system.is_lost(at, slot);
                self.ends(unit, member, if is_asked && is_lost { unconfirmed() } else { failed() });
            }
            Label::Lost => self.frame.is_faulty = true,
            Label::Stopped(unit, member) => self.ends(unit, member, Outcome::Stopped),
            Label::Elapsed(unit, timer) => {
                let (unit, timer) = (usize::from(unit), u32::from(timer));
                let activation = self.frame.states[unit].timer(self.system.program(unit), timer).0;
                self.queue.push_back((unit, Event::Elapsed { timer, activation }));
            }
            Label::Reached(unit) => {
                self.frame.ordered[usize::from(unit)] = false;
                self.queue.push_back((usize::from(unit), Event::Stop));
            }
            Label::Fault(unit, member) => {
                self.frame.is_faulty = true;
                let kind = self.system.mode.fault.map(|fault| fault.kind);
                match kind {
                    Some(FaultKind::Crash) => self.ends(unit, member, failed()),
                    Some(FaultKind::Unanswered) => self.ends(unit, member, unconfirmed()),
                    Some(FaultKind::Hang | FaultKind::HostLost) | None => {}
                }
            }
        }
    }

    fn ends(&mut self, unit: u16, member: u16, outcome: Outcome) {
        self.ended(usize::from(unit), u32::from(member), outcome);
    }

    /// A member of a unit has ended.
    fn ended(&mut self, unit: usize, member: u32, outcome: Outcome) {
        let activation = self.frame.states[unit].activation(member);
        let is_asked = self.frame.states[unit].activity(member) == Activity::Stopping;
        let (changed, event) = match outcome {
            Outcome::Done(value) => (Changed::Done(value.clone()), Event::Done { member, activation, value }),
            Outcome::Stopped => (Changed::Stopped, Event::Stopped { member, activation }),
            Outcome::Aborted(reason) if reason.cause == Cause::StopUnconfirmed => {
                (Changed::Aborted, Event::StopUnconfirmed { member, activation })
            }
            Outcome::Aborted(_) => (Changed::Aborted, Event::Aborted { member, activation, report: Value::EMPTY }),
        };
        let changed = if is_asked && changed != Changed::Aborted { Changed::Stopped } else { changed };
        self.change(unit, Some(member), changed);
        self.queue.push_back((unit, event));
    }

    fn change(&mut self, unit: usize, member: Option<u32>, what: Changed) {
        self.changes.push(Change { unit, member, what });
    }

    pub(super) fn react(&mut self, unit: usize, event: Event) {
        let program = self.system.program(unit);
        self.commands.clear();
        let outcome = step(program, &mut self.frame.states[unit], event, &mut self.commands);
        for command in std::mem::take(&mut self.commands) {
            match command {
                Command::Activate { member, value, .. } => {
                    self.change(unit, Some(member), Changed::Started);
                    if let Occupant::Unit(inner) = self.system.units[unit].seats[member as usize] {
                        self.queue.push_back((inner, Event::Start(value)));
                    }
                }
                Command::Stop { member, .. } => self.stop(unit, member),
                Command::Connect { .. } | Command::Disconnect { .. } | Command::Arm { .. } | Command::Cancel { .. } => {
                }
            }
        }
        if let Some(outcome) = outcome {
            self.over(unit, outcome);
        }
    }

    /// A unit stops a member: what is a piece of the same group at once, another group when the order reaches it.
    fn stop(&mut self, unit: usize, member: u32) {
        self.change(unit, Some(member), Changed::Stopping);
        let Occupant::Unit(inner) = self.system.units[unit].seats[member as usize] else { return };
        if self.system.model.parts[self.system.units[inner].part].is_piece {
            self.queue.push_back((inner, Event::Stop));
        } else {
            self.frame.ordered[inner] = true;
        }
    }

    /// A unit has an outcome: it is that of the member around it, or of the whole.
    fn over(&mut self, unit: usize, outcome: Outcome) {
        self.frame.ordered[unit] = false;
        if let Some((around, member)) = self.system.units[unit].parent {
            // A stop that comes too late finds nothing: its answer is the outcome that was under way.
            if self.frame.states[around].activity(member) != Activity::Idle {
                self.ended(around, member, outcome);
            }
            return;
        }
        let (phase, what) = match outcome {
            Outcome::Done(value) => (Phase::Done, Changed::Done(value)),
            Outcome::Aborted(_) => (Phase::Aborted, Changed::Aborted),
            Outcome::Stopped => (Phase::Stopped, Changed::Stopped),
        };
        self.frame.phase = phase;
        self.change(unit, None, what);
    }
}

fn unconfirmed() -> Outcome {
    Outcome::Aborted(Reason { member: None, cause: Cause::StopUnconfirmed })
}

fn failed() -> Outcome {
    Outcome::Aborted(Reason { member: None, cause: Cause::Reported(Value::EMPTY) })
}
