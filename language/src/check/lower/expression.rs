//! Expressions: what is short for something else is written out.

use crate::check::spec::{Expr, ExprKind};
use crate::plan::Expression;

/// Writes an expression in the operators of the plan.
pub(super) fn lower(expr: &Expr) -> Expression {
    let all = |parts: &[Expr]| parts.iter().map(lower).collect::<Vec<_>>();
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
        ExprKind::Disable(parts) => Expression::Disable(all(parts)),
        ExprKind::Sequence(parts) => balance(all(parts), Expression::Sequence),
        ExprKind::Conditional(parts) => balance(all(parts), Expression::Conditional),
        ExprKind::Otherwise(parts) => balance(all(parts), Expression::Otherwise),
        ExprKind::Recurrent(first, second) => Expression::Recurrent(Box::new(lower(first)), Box::new(lower(second))),
        // `retry(2) P` is `P else P else P`.
        ExprKind::Retry(times, part) => {
            let tries = (0..=*times).map(|_| lower(part)).collect();
            balance(tries, Expression::Otherwise)
        }
        // `P within d` is `P # (wait(d) ; fail("timeout"))`.
        ExprKind::Within(limit, part) => {
            let wait = Box::new(Expression::Wait(*limit));
            let timeout = Expression::Sequence(wait, Box::new(Expression::Fail("timeout".to_owned())));
            Expression::Disable(vec![lower(part), timeout])
        }
    }
}

/// The most operands that are joined one by one, as they are read: `P ; (Q ; R)`.
const CHAIN_MAX: usize = 8;

/// Joins operands of an associative operator; more than a few of them to a tree of logarithmic depth, because a plan's
/// depth is limited and the length of a sequence is not.
fn balance(mut parts: Vec<Expression>, join: fn(Box<Expression>, Box<Expression>) -> Expression) -> Expression {
    if parts.len() < 2 {
        return parts.pop().unwrap_or(Expression::Skip);
    }
    let half = if parts.len() <= CHAIN_MAX { 1 } else { parts.len() / 2 };
    let right = parts.split_off(half);
    join(Box::new(balance(parts, join)), Box::new(balance(right, join)))
}

/// Returns how many operators and operands the written-out expression has.
pub(super) fn size(expr: &Expr) -> u64 {
    let parts: u64 = expr.parts().into_iter().map(size).fold(1, u64::saturating_add);
    if let ExprKind::Retry(times, _) = &expr.kind { parts.saturating_mul(u64::from(*times) + 1) } else { parts }
}

fn index(index: usize) -> u32 {
    u32::try_from(index).expect("a text of at most 16 MiB declares fewer than 2^32 names")
}
