//! Event actions of two plans: whether they have the same meaning, and the wanted event actions in the numbers of the running plan.

use super::{Arm, DEADLINE, Expression};
use crate::plan::{CatchArm, StateChart, StateRun};

/// The numbers of one running group, by the numbers of the wanted group.
pub(super) struct GroupNumbers {
    /// Slots of members.
    pub(super) slots: Vec<u32>,
    /// Indices of connection sets.
    pub(super) sets: Vec<u32>,
}

impl GroupNumbers {
    pub(super) fn slot(&self, wanted: u32) -> u32 {
        self.slots.get(wanted as usize).copied().unwrap_or(wanted)
    }

    pub(super) fn set(&self, wanted: u32) -> u32 {
        self.sets.get(wanted as usize).copied().unwrap_or(wanted)
    }

    /// Returns an expression with the numbers that run.
    pub(super) fn expression(&self, wanted: &Expression) -> Expression {
        let all = |of: &[Expression]| of.iter().map(|of| self.expression(of)).collect();
        let boxed = |of: &Expression| Box::new(self.expression(of));
        match wanted {
            Expression::Run { member, sets } => {
                Expression::Run { member: self.slot(*member), sets: sets.iter().map(|set| self.set(*set)).collect() }
            }
            Expression::Skip | Expression::Never | Expression::Fail(_) | Expression::Wait(_) => wanted.clone(),
            Expression::Concurrent(of) => Expression::Concurrent(all(of)),
            Expression::FailFast(of) => Expression::FailFast(all(of)),
            Expression::AnyOf { count, of } => Expression::AnyOf { count: *count, of: all(of) },
            Expression::AtLeast { count, of } => Expression::AtLeast { count: *count, of: all(of) },
            Expression::Disable(of) => Expression::Disable(all(of)),
            Expression::Sequence(p, q) => Expression::Sequence(boxed(p), boxed(q)),
            Expression::Conditional(p, q) => Expression::Conditional(boxed(p), boxed(q)),
            Expression::Recurrent(p, q) => Expression::Recurrent(boxed(p), boxed(q)),
            Expression::Otherwise(p, q) => Expression::Otherwise(boxed(p), boxed(q)),
            Expression::Match(arms) => {
                let arm = |arm: &Arm| Arm { tag: arm.tag.clone(), body: self.expression(&arm.body) };
                Expression::Match(arms.iter().map(arm).collect())
            }
            Expression::Shield { bound, of } => Expression::Shield { bound: *bound, of: boxed(of) },
            Expression::Using { resources, of } => Expression::Using { resources: resources.clone(), of: boxed(of) },
            Expression::Asynchronous { source, pool } => {
                Expression::Asynchronous { source: boxed(source), pool: all(pool) }
            }
            Expression::Finally(p, q) => Expression::Finally(boxed(p), boxed(q)),
            Expression::Tagged { tag, of } => Expression::Tagged { tag: tag.clone(), of: boxed(of) },
            Expression::With { given, of } => Expression::With { given: given.clone(), of: boxed(of) },
            Expression::Named { name, of } => Expression::Named { name: name.clone(), of: boxed(of) },
            Expression::Repeat { until, of } => Expression::Repeat { until: until.clone(), of: boxed(of) },
            Expression::Catch { of, arms } => {
                let arm = |arm: &CatchArm| CatchArm { failure: arm.failure.clone(), body: self.expression(&arm.body) };
                Expression::Catch { of: boxed(of), arms: arms.iter().map(arm).collect() }
            }
            Expression::Chart(chart) => {
                let run = |run: &StateRun| StateRun { state: run.state, expression: self.expression(&run.expression) };
                let runs = chart.runs.iter().map(run).collect();
                Expression::Chart(Box::new(StateChart { runs, ..(**chart).clone() }))
            }
        }
    }
}

/// Whether two expressions have the same meaning. The position of a deadline, and the spelling of its text, are ignored.
pub(super) fn same(before: &Expression, after: &Expression) -> bool {
    let without_places = |expression: &Expression| {
        let mut expression = expression.clone();
        forget_places(&mut expression);
        expression
    };
    before == after || without_places(before) == without_places(after)
}

fn forget_places(expression: &mut Expression) {
    if let Expression::Fail(why) = expression
        && why.starts_with(DEADLINE)
    {
        why.truncate(DEADLINE.len());
    }
    expression.operands_mut().into_iter().for_each(forget_places);
}
