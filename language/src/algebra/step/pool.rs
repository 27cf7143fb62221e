//! The rules of `P ::[n] Q`: a source, and the pool that its values start.

use super::completion::{INSTANT, aborted};
use super::drain::prefer_unconfirmed;
use super::{Cell, Cells, Phase, Reaction, Seats};
use crate::algebra::event::{Cause, Outcome, Value};

impl<C: Cells, S: Seats> Reaction<'_, C, S> {
    /// Start of `P ::[n] Q`: P alone.
    pub(super) fn s_arec(&mut self, node: usize, value: Value) -> Option<Outcome> {
        match self.start_first(node, value)? {
            Outcome::Done(value) => self.spawn(node, value),
            outcome @ (Outcome::Aborted(_) | Outcome::Stopped) => self.wind_down(node, outcome),
        }
    }

    /// AREC: an operand has ended.
    pub(super) fn asynchronous(&mut self, node: usize, operand: usize, outcome: Outcome) -> Option<Outcome> {
        let source = self.program.first(node);
        match outcome {
            Outcome::Done(value) if operand == source => self.spawn(node, value),
            Outcome::Done(_) if self.cell(source).phase == Phase::Done => {
                let Some(Outcome::Done(value)) = std::mem::take(self.cell(source)).outcome else {
                    unreachable!("a source that is done has left a value")
                };
                self.spawn(node, value)
            }
            Outcome::Done(_) => None,
            Outcome::Aborted(_) | Outcome::Stopped => self.wind_down(node, outcome),
        }
    }

    /// The source has left a value: a place of the pool gets it and the source is restarted, or both wait for a place.
    /// [rec-instant]: a pool that is not full after as many rounds as it has places will never be.
    fn spawn(&mut self, node: usize, mut value: Value) -> Option<Outcome> {
        let source = self.program.first(node);
        for _ in self.program.operands(node) {
            let is_free = |place: &usize| !self.state.cells[*place].phase.is_active();
            let Some(place) = self.program.operands(node).skip(1).find(is_free) else {
                *self.cell(source) =
                    Cell { phase: Phase::Done, outcome: Some(Outcome::Done(value)), ..Cell::default() };
                return None;
            };
            if let Some(outcome @ Outcome::Aborted(_)) = self.start(place, value) {
                return self.wind_down(node, outcome);
            }
            match self.start(source, Value::EMPTY)? {
                Outcome::Done(next) => value = next,
                outcome @ (Outcome::Aborted(_) | Outcome::Stopped) => return self.wind_down(node, outcome),
            }
        }
        self.wind_down(node, aborted(Cause::Failed(INSTANT.into())))
    }

    /// Something has failed: the source is stopped, and the members that it has started come to their end.
    fn wind_down(&mut self, node: usize, mut outcome: Outcome) -> Option<Outcome> {
        if let Some(ended) = self.stop(self.program.first(node)) {
            prefer_unconfirmed(&mut outcome, ended);
        }
        let active = self.program.operands(node).filter(|&operand| self.state.cells[operand].phase.is_active());
        let open = u32::try_from(active.count()).expect("a plan has fewer than 2^32 operands");
        self.drain_open(node, open, outcome)
    }
}
