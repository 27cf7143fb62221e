//! The completion functions, used after a start and after an event alike.

use super::{Cell, Cells, Phase, Reaction, Seats};
use crate::algebra::event::{Cause, Outcome, Reason, Value};
use crate::algebra::program::Kind;
use crate::automaton::Failure;

/// The reason why a loop whose round takes no time is aborted.
pub(super) const INSTANT: &str = "a round of a loop took no time";

impl<C: Cells, S: Seats> Reaction<'_, C, S> {
    /// SEQ: `;` starts its second operand with the empty value.
    pub(super) fn seq(&mut self, node: usize, outcome: Outcome) -> Option<Outcome> {
        match (self.cell(node).phase, outcome) {
            (Phase::Running, Outcome::Done(_)) => self.start_second(node, Value::EMPTY),
            (_, outcome) => self.pass(node, outcome),
        }
    }

    /// COND: `:` starts its second operand with the first one's value.
    pub(super) fn cond(&mut self, node: usize, outcome: Outcome) -> Option<Outcome> {
        match (self.cell(node).phase, outcome) {
            (Phase::Running, Outcome::Done(value)) => self.start_second(node, value),
            (_, outcome) => self.pass(node, outcome),
        }
    }

    /// ELSE: the second operand is started with the reason of the first one's abort.
    pub(super) fn or_else(&mut self, node: usize, outcome: Outcome) -> Option<Outcome> {
        match (self.cell(node).phase, outcome) {
            (Phase::Running, Outcome::Aborted(reason)) => self.start_second(node, report(reason.cause)),
            (_, outcome) => self.pass(node, outcome),
        }
    }

    /// CATCH: the first arm that the reason fits is started with it; without one, the failure stays.
    pub(super) fn catch(&mut self, node: usize, outcome: Outcome) -> Option<Outcome> {
        let Outcome::Aborted(reason) = outcome else { return self.pass(node, outcome) };
        let Some(arm) = self.arm_for(node, &reason.cause).filter(|_| self.cell(node).phase == Phase::Running) else {
            return self.pass(node, Outcome::Aborted(reason));
        };
        self.enter(node, Phase::Second);
        let outcome = self.start(arm, report(reason.cause))?;
        self.pass(node, outcome)
    }

    /// The arm of an `else match` that takes a failure.
    fn arm_for(&self, node: usize, cause: &Cause) -> Option<usize> {
        let program = self.program;
        let Kind::Catch { failures } = &program.nodes[node].kind else { return None };
        let takes = |failure: &Option<Failure>| failure.as_ref().is_none_or(|failure| failure.is_of(cause));
        let arm = program.failures[failures.clone()].iter().position(takes)?;
        program.operands(node).nth(arm + 1)
    }

    fn start_second(&mut self, node: usize, value: Value) -> Option<Outcome> {
        self.enter(node, Phase::Second);
        let outcome = self.start(self.program.second(node), value)?;
        self.pass(node, outcome)
    }

    /// The operator ends with the outcome of this operand.
    pub(super) fn pass(&mut self, node: usize, outcome: Outcome) -> Option<Outcome> {
        self.clear(node);
        Some(outcome)
    }

    /// REC1, REC2: the phase flips in place. [rec-instant]: `flips` is how many phases may be entered in this reaction;
    /// beyond them a phase would be entered a second time in a configuration that it has been in before.
    pub(super) fn rec(&mut self, node: usize, mut outcome: Outcome, flips: u32) -> Option<Outcome> {
        for _ in 0..flips {
            outcome = match (self.cell(node).phase, outcome) {
                (Phase::Running, Outcome::Done(value)) => {
                    self.enter(node, Phase::Second);
                    self.start(self.program.second(node), value)?
                }
                (Phase::Second, Outcome::Done(_)) => {
                    self.enter(node, Phase::Running);
                    self.start(self.program.first(node), Value::EMPTY)?
                }
                (_, outcome) => return self.pass(node, outcome),
            };
        }
        match outcome {
            Outcome::Done(_) => self.pass(node, aborted(Cause::Failed(INSTANT.into()))),
            Outcome::Aborted(_) | Outcome::Stopped => self.pass(node, outcome),
        }
    }

    /// REPEAT: any other outcome than those that end it starts the operand again. [rec-instant]: `rounds` is how many may begin
    /// in this reaction.
    pub(super) fn repeat(&mut self, node: usize, mut outcome: Outcome, rounds: u32) -> Option<Outcome> {
        for left in (0..=rounds).rev() {
            if self.cell(node).phase != Phase::Running || !self.goes_on(node, &outcome) {
                return self.pass(node, outcome);
            }
            if left > 0 {
                outcome = self.start(self.program.first(node), Value::EMPTY)?;
            }
        }
        self.pass(node, aborted(Cause::Failed(INSTANT.into())))
    }

    /// Whether a `repeat` begins another round after an outcome of its operand.
    fn goes_on(&self, node: usize, outcome: &Outcome) -> bool {
        let (Outcome::Done(value), Kind::Repeat { tags }) = (outcome, &self.program.nodes[node].kind) else {
            return false;
        };
        let tag = value.tag();
        tag.is_none() || self.program.tags[tags.clone()].iter().all(|end| end.as_deref() != tag)
    }

    /// DIS: the first outcome decides.
    pub(super) fn dis(&mut self, node: usize, outcome: Outcome) -> Option<Outcome> {
        self.drain(node, outcome)
    }

    /// Notes the outcome of an operand of `,` in its slot. The abort of a service is not noted but returned, for the rule p-lost.
    pub(super) fn slot_service(&mut self, node: usize, operand: usize, outcome: Outcome) -> Option<Reason> {
        match outcome {
            Outcome::Aborted(reason) if self.program.nodes[operand].service => Some(reason),
            Outcome::Done(_) | Outcome::Aborted(_) | Outcome::Stopped => {
                if self.program.is_task(node, operand) {
                    self.slot(node, operand, outcome);
                }
                None
            }
        }
    }

    /// Notes the outcome of an operand that is waited for, in its slot.
    pub(super) fn slot(&mut self, node: usize, operand: usize, outcome: Outcome) {
        let cell = self.cell(node);
        cell.open -= 1;
        if matches!(outcome, Outcome::Aborted(_)) {
            cell.outcome.get_or_insert(outcome);
        } else {
            cell.done += 1;
            *self.cell(operand) = Cell { phase: Phase::Done, outcome: Some(outcome), ..Cell::default() };
        }
    }

    /// PAR: p-lost, p-join, p-wait.
    pub(super) fn par(&mut self, node: usize, lost: Option<Reason>) -> Option<Outcome> {
        if let Some(reason) = lost {
            return self.drain(node, Outcome::Aborted(reason));
        }
        if self.cell(node).open > 0 {
            return None;
        }
        let outcome = self.cell(node).outcome.take();
        let outcome = outcome.unwrap_or_else(|| self.done(node, u32::MAX));
        self.drain(node, outcome)
    }

    /// FF: `&` ends with its first abort or when all are done.
    pub(super) fn ff(&mut self, node: usize) -> Option<Outcome> {
        if let Some(abort) = self.cell(node).outcome.take() {
            return self.drain(node, abort);
        }
        if self.cell(node).open > 0 {
            return None;
        }
        let outcome = self.done(node, u32::MAX);
        self.drain(node, outcome)
    }

    /// ANY: `any k of` ends when `k` are done or cannot be done any more.
    pub(super) fn any(&mut self, node: usize, count: u32) -> Option<Outcome> {
        let cell = self.cell(node);
        if cell.done >= count {
            let outcome = self.done(node, count);
            return self.drain(node, outcome);
        }
        if cell.done + cell.open < count {
            let abort = cell.outcome.take().expect("`count` is at most the number of operands, so one has aborted");
            return self.drain(node, abort);
        }
        None
    }

    /// AT LEAST: all have ended. The next process could not know which values it gets, so it gets none.
    pub(super) fn at_least(&mut self, node: usize, count: u32) -> Option<Outcome> {
        let cell = self.cell(node);
        if cell.open > 0 {
            return None;
        }
        if cell.done >= count {
            return self.drain(node, Outcome::Done(Value::EMPTY));
        }
        let abort = cell.outcome.take().expect("`count` is at most the number of operands, so one has aborted");
        self.drain(node, abort)
    }

    /// Returns `done(<u1..uk>)` of the first slots that are done, so many at most: of `any k of` more than `k` are done when
    /// they were so at the start.
    fn done(&self, node: usize, count: u32) -> Outcome {
        let cells = self.program.operands(node).map(|operand| &self.state.cells[operand]);
        let values = cells.filter_map(|cell| match (cell.phase, &cell.outcome) {
            (Phase::Done, Some(Outcome::Done(value))) => Some(value),
            (_, _) => None,
        });
        Outcome::Done(Value::tuple(values.take(count as usize)))
    }
}

/// Returns the input of the second operand of `else`: the member's own report, or a text for the cause.
fn report(cause: Cause) -> Value {
    let words = Failure::of(&cause).words();
    match cause {
        Cause::Failed(why) => Value::new(why.as_bytes()),
        Cause::Reported(report) => words.map_or(report, |words| Value::new(words.as_bytes())),
        Cause::Script(error) => Value::new(error.to_string().as_bytes()),
        Cause::Busy | Cause::StopUnconfirmed | Cause::ServiceEnded | Cause::NoMatch => {
            Value::new(words.unwrap_or_default().as_bytes())
        }
    }
}

pub(super) fn aborted(cause: Cause) -> Outcome {
    Outcome::Aborted(Reason { member: None, cause })
}
