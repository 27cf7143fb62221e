//! `v |- E`: the start rules.

use super::{Cells, Phase, Reaction, Seats};
use crate::algebra::event::{Activation, Cause, Command, Outcome, Reason, Value};
use crate::algebra::program::{Kind, Start};
use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;

impl<C: Cells, S: Seats> Reaction<'_, C, S> {
    /// Starts the idle `node`; returns its outcome if it has one at once.
    pub(super) fn start(&mut self, node: usize, value: Value) -> Option<Outcome> {
        let program = self.program;
        match &program.nodes[node].kind {
            Kind::Run { member, sets } => self.s_leaf(node, *member, &program.sets[sets.clone()], value),
            Kind::Skip => Some(Outcome::Done(Value::EMPTY)),
            Kind::Never => self.s_never(node),
            Kind::Fail(why) => Some(s_fail(why)),
            Kind::Wait { timer, after } => self.s_wait(node, *timer, *after),
            Kind::Sequence => self.s_seq(node, value),
            Kind::Conditional => self.s_cond(node, value),
            Kind::Recurrent => self.s_rec(node, value),
            Kind::Otherwise => self.s_else(node, value),
            Kind::Concurrent { tasks } => self.s_par(node, *tasks, &value),
            Kind::FailFast { operands } => self.s_ff(node, *operands, &value),
            Kind::AnyOf { count, operands } => self.s_any(node, *count, *operands, &value),
            Kind::AtLeast { count, operands } => self.s_at_least(node, *count, *operands, &value),
            Kind::Disable => self.s_dis(node, &value),
            Kind::Match { tags } => self.s_match(node, tags.clone(), value),
            Kind::Shield { .. } => self.s_shield(node, value),
            Kind::Using { .. } => self.s_using(node, value),
            Kind::Asynchronous => self.s_arec(node, value),
            Kind::Finally => self.s_finally(node, value),
            Kind::Tagged(_) => self.s_tagged(node, value),
            Kind::Chart => self.s_chart(node, value),
            Kind::With(start) => self.s_with(node, start),
            Kind::Named(_) => self.s_named(node, value),
            Kind::Repeat { .. } => self.s_repeat(node, value),
            Kind::Catch { .. } => self.s_catch(node, value),
        }
    }

    /// [s-leaf] and [s-busy]: a member that is active or stopping elsewhere in the expression is not activated again.
    fn s_leaf(&mut self, node: usize, member: u32, sets: &[u32], value: Value) -> Option<Outcome> {
        let seat = &mut self.state.seats[member as usize];
        if seat.node.is_some() {
            return Some(Outcome::Aborted(Reason { member: Some(member), cause: Cause::Busy }));
        }
        seat.node = Some(node);
        seat.activation = next(seat.activation);
        let activation = seat.activation;
        self.enter(node, Phase::Running);
        self.commands.extend(sets.iter().map(|&set| Command::Connect { set }));
        self.commands.push(Command::Activate { member, activation, value });
        None
    }

    /// [s-const] of `never`.
    fn s_never(&mut self, node: usize) -> Option<Outcome> {
        self.enter(node, Phase::Running);
        None
    }

    /// [s-const] of `wait(d)`.
    fn s_wait(&mut self, node: usize, timer: u32, after: Duration) -> Option<Outcome> {
        self.enter(node, Phase::Running);
        self.arm(timer, after);
        None
    }

    pub(super) fn arm(&mut self, timer: u32, after: Duration) {
        let armed = &mut self.state.timers[timer as usize];
        *armed = next(*armed);
        let activation = *armed;
        self.commands.push(Command::Arm { timer, activation, after });
    }

    /// [s-seq]
    fn s_seq(&mut self, node: usize, value: Value) -> Option<Outcome> {
        let outcome = self.start_first(node, value)?;
        self.seq(node, outcome)
    }

    /// [s-cond]
    fn s_cond(&mut self, node: usize, value: Value) -> Option<Outcome> {
        let outcome = self.start_first(node, value)?;
        self.cond(node, outcome)
    }

    /// [s-rec]: the first phase is entered here, so one more is allowed in this reaction.
    fn s_rec(&mut self, node: usize, value: Value) -> Option<Outcome> {
        let outcome = self.start_first(node, value)?;
        self.rec(node, outcome, 1)
    }

    /// Start of `repeat P until t`: the first round begins here, so no other one may in this reaction.
    fn s_repeat(&mut self, node: usize, value: Value) -> Option<Outcome> {
        let outcome = self.start_first(node, value)?;
        self.repeat(node, outcome, 0)
    }

    /// Start of `P else Q`.
    fn s_else(&mut self, node: usize, value: Value) -> Option<Outcome> {
        let outcome = self.start_first(node, value)?;
        self.or_else(node, outcome)
    }

    /// Start of `P else match { ... }`.
    fn s_catch(&mut self, node: usize, value: Value) -> Option<Outcome> {
        let outcome = self.start_first(node, value)?;
        self.catch(node, outcome)
    }

    /// [s-with]
    fn s_with(&mut self, node: usize, start: &Start) -> Option<Outcome> {
        let given = match start {
            Start::Known(value) => value.clone(),
            Start::Kept { keeper, .. } => self.kept(*keeper),
        };
        let outcome = self.start_first(node, given)?;
        self.pass(node, outcome)
    }

    /// Returns the value that a node keeps under a name.
    fn kept(&mut self, keeper: usize) -> Value {
        match &self.cell(keeper).outcome {
            Some(Outcome::Done(value)) => value.clone(),
            Some(Outcome::Aborted(_) | Outcome::Stopped) | None => Value::EMPTY,
        }
    }

    /// [s-named]
    fn s_named(&mut self, node: usize, value: Value) -> Option<Outcome> {
        let cell = self.cell(node);
        (cell.phase, cell.outcome) = (Phase::Second, Some(Outcome::Done(value)));
        let outcome = self.start(self.program.first(node), Value::EMPTY)?;
        self.pass(node, outcome)
    }

    pub(super) fn start_first(&mut self, node: usize, value: Value) -> Option<Outcome> {
        self.enter(node, Phase::Running);
        self.start(self.program.first(node), value)
    }

    /// [s-par]
    fn s_par(&mut self, node: usize, tasks: u32, value: &Value) -> Option<Outcome> {
        self.enter(node, Phase::Running);
        self.cell(node).open = tasks;
        let mut lost = None;
        for operand in self.program.operands(node) {
            if let Some(outcome) = self.start(operand, value.clone()) {
                let lost_here = self.slot_service(node, operand, outcome);
                lost = lost.or(lost_here);
            }
        }
        self.par(node, lost)
    }

    /// [s-par] for `&`.
    fn s_ff(&mut self, node: usize, operands: u32, value: &Value) -> Option<Outcome> {
        self.start_all(node, operands, value);
        self.ff(node)
    }

    /// [s-par] for `any`.
    fn s_any(&mut self, node: usize, count: u32, operands: u32, value: &Value) -> Option<Outcome> {
        self.start_all(node, operands, value);
        self.any(node, count)
    }

    /// [s-par] for `at least`.
    fn s_at_least(&mut self, node: usize, count: u32, operands: u32, value: &Value) -> Option<Outcome> {
        self.start_all(node, operands, value);
        self.at_least(node, count)
    }

    fn start_all(&mut self, node: usize, operands: u32, value: &Value) {
        self.enter(node, Phase::Running);
        self.cell(node).open = operands;
        for operand in self.program.operands(node) {
            if let Some(outcome) = self.start(operand, value.clone()) {
                self.slot(node, operand, outcome);
            }
        }
    }

    /// [s-match]
    fn s_match(&mut self, node: usize, tags: Range<usize>, value: Value) -> Option<Outcome> {
        let tag = value.tag();
        let is_taken = |arm: &Option<Arc<str>>| arm.is_none() || arm.as_deref() == tag;
        let tags = &self.program.tags[tags];
        let Some(arm) = tags.iter().position(is_taken) else {
            return Some(Outcome::Aborted(Reason { member: None, cause: Cause::NoMatch }));
        };
        let value = if tags[arm].is_some() { value.without_tag() } else { value };
        let operand = self.program.operands(node).nth(arm).expect("a `match` has an operand for each tag");
        self.enter(node, Phase::Running);
        let outcome = self.start(operand, value)?;
        self.pass(node, outcome)
    }

    /// [s-dis]: an operand that ends at once decides, and those after it are not started.
    fn s_dis(&mut self, node: usize, value: &Value) -> Option<Outcome> {
        self.enter(node, Phase::Running);
        for operand in self.program.operands(node) {
            if let Some(outcome) = self.start(operand, value.clone()) {
                return self.dis(node, outcome);
            }
        }
        None
    }
}

/// [s-const] of `fail(r)`.
fn s_fail(why: &Arc<str>) -> Outcome {
    Outcome::Aborted(Reason { member: None, cause: Cause::Failed(Arc::clone(why)) })
}

/// Numbers wrap. They are only compared for equality, and 2^32 activations lie between two equal numbers.
fn next(Activation(number): Activation) -> Activation {
    Activation(number.wrapping_add(1))
}
