//! Lowers expressions: short forms are expanded to operators of the plan.

use super::quote::Quotes;
use super::start::Starts;
use crate::check::spec::{Arm, CatchArm, Expr, ExprKind};
use crate::plan::{self, Expression, StateChart, StateRun};
use crate::syntax::ast::Name;
use std::time::Duration;

/// The resources, places and start values that the expressions of one group refer to.
#[derive(Clone, Copy)]
pub(super) struct Lowering<'a> {
    pub(super) resources: &'a [Name],
    pub(super) quotes: &'a Quotes<'a>,
    pub(super) starts: &'a Starts<'a>,
}

impl Lowering<'_> {
    /// Returns an expression in the operators of the plan.
    pub(super) fn lower(self, expr: &Expr) -> Expression {
        lower(expr, self)
    }
}

fn lower(expr: &Expr, lowering: Lowering<'_>) -> Expression {
    let Lowering { resources, quotes, starts } = lowering;
    let rest = |part: &Expr| lower(part, lowering);
    let all = |parts: &[Expr]| parts.iter().map(rest).collect::<Vec<_>>();
    match &expr.kind {
        ExprKind::Run(slot, sets) => {
            Expression::Run { member: index(*slot), sets: sets.iter().copied().map(index).collect() }
        }
        ExprKind::Skip | ExprKind::Broken => Expression::Skip,
        ExprKind::Never => Expression::Never,
        ExprKind::Fail(reason) => Expression::Fail(reason.clone()),
        ExprKind::Wait(limit) => Expression::Wait(*limit),
        ExprKind::Concurrent(parts) => Expression::Concurrent(all(parts)),
        ExprKind::FailFast(parts) => Expression::FailFast(all(parts)),
        ExprKind::AnyOf(count, parts) => Expression::AnyOf { count: *count, of: all(parts) },
        ExprKind::AtLeast(count, parts) => Expression::AtLeast { count: *count, of: all(parts) },
        ExprKind::Disable(parts) => Expression::Disable(all(parts)),
        ExprKind::Sequence(parts) => balance(all(parts), Expression::Sequence),
        ExprKind::Conditional(parts) => balance(all(parts), Expression::Conditional),
        ExprKind::Otherwise(parts) => balance(all(parts), Expression::Otherwise),
        ExprKind::Recurrent(first, second) => Expression::Recurrent(Box::new(rest(first)), Box::new(rest(second))),
        // `retry(2) P` is `P else P else P`. With a pause of d, it is `P else (wait(d) ; P) else (wait(d) ; P)`.
        ExprKind::Retry(times, pause, part) => {
            let tries = (0..=*times).map(|number| match wait_first(*pause, number) {
                Some(pause) => Expression::Sequence(Box::new(Expression::Wait(pause)), Box::new(rest(part))),
                None => rest(part),
            });
            balance(tries.collect(), Expression::Otherwise)
        }
        // `P within d` is `P # (wait(d) ; fail("the deadline ... has passed"))`.
        ExprKind::Within(limit, part) => {
            let wait = Box::new(Expression::Wait(*limit));
            let timeout = Expression::Sequence(wait, Box::new(Expression::Fail(quotes.deadline(expr.span))));
            Expression::Disable(vec![rest(part), timeout])
        }
        ExprKind::Match(arms) => {
            let arm =
                |arm: &Arm| plan::Arm { tag: arm.tag.as_ref().map(|tag| tag.text.clone()), body: rest(&arm.body) };
            Expression::Match(arms.iter().map(arm).collect())
        }
        ExprKind::Catch(first, arms) => {
            let arm = |arm: &CatchArm| plan::CatchArm { failure: arm.failure.clone(), body: rest(&arm.body) };
            Expression::Catch { of: Box::new(rest(first)), arms: arms.iter().map(arm).collect() }
        }
        ExprKind::Shield(bound, part) => Expression::Shield { bound: *bound, of: Box::new(rest(part)) },
        ExprKind::Using(taken, part) => {
            let resources = taken.iter().map(|&index| resources[index].text.clone()).collect();
            Expression::Using { resources, of: Box::new(rest(part)) }
        }
        ExprKind::Repeat(until, part) => {
            let until = until.iter().map(|name| name.text.clone()).collect();
            Expression::Repeat { until, of: Box::new(rest(part)) }
        }
        ExprKind::Finally(first, second) => Expression::Finally(Box::new(rest(first)), Box::new(rest(second))),
        ExprKind::Tagged(tag, part) => Expression::Tagged { tag: tag.text.clone(), of: Box::new(rest(part)) },
        ExprKind::With(start, part) => match starts.given(start, part) {
            Some(given) => Expression::With { given, of: Box::new(rest(part)) },
            None => rest(part),
        },
        ExprKind::Named(name, part) => Expression::Named { name: name.text.clone(), of: Box::new(rest(part)) },
        ExprKind::Chart(model) => {
            let run = |(state, run): &(usize, Expr)| StateRun { state: index(*state), expression: rest(run) };
            let runs = model.runs.iter().map(run).collect();
            Expression::Chart(Box::new(StateChart { runs, ..model.chart.clone() }))
        }
        ExprKind::Asynchronous(source, pool) => {
            Expression::Asynchronous { source: Box::new(rest(source)), pool: all(pool) }
        }
    }
}

/// The largest number of operands that are joined one by one, in their order: `P ; (Q ; R)`.
pub(super) const CHAIN_MAX: usize = 8;

/// Returns the pause before an attempt of `retry`. The first attempt has none.
pub(super) fn wait_first(pause: Option<Duration>, number: u32) -> Option<Duration> {
    pause.filter(|_| number > 0)
}

/// Joins the operands of an associative operator. Many operands are joined to a tree of logarithmic depth, because the
/// depth of a plan is limited and the length of a sequence is not.
fn balance(mut parts: Vec<Expression>, join: fn(Box<Expression>, Box<Expression>) -> Expression) -> Expression {
    if parts.len() < 2 {
        return parts.pop().unwrap_or(Expression::Skip);
    }
    let half = if parts.len() <= CHAIN_MAX { 1 } else { parts.len() / 2 };
    let right = parts.split_off(half);
    join(Box::new(balance(parts, join)), Box::new(balance(right, join)))
}

/// Returns how many operators and operands the expanded expression has.
pub(super) fn size(expr: &Expr) -> u64 {
    let parts: u64 = expr.parts().into_iter().map(size).fold(1, u64::saturating_add);
    if let ExprKind::Retry(times, ..) = &expr.kind { parts.saturating_mul(u64::from(*times) + 1) } else { parts }
}

fn index(index: usize) -> u32 {
    u32::try_from(index).expect("a text of at most 16 MiB declares fewer than 2^32 names")
}
