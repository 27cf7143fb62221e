//! Computes how long a `using` waits for its turn.
//!
//! A waiting `using` is in a queue, after every earlier `using` that wants the same resources. So each other `using` that may
//! be active at the same time gets its resources at most once before this one's turn comes. The
//! same limit applies to a `using` that shares no resource with this `using`, but shares a resource
//! with another `using` in the queue, because that other `using` may have to wait for it.

use super::{Times, add};
use language::plan::{Expression, Group};
use std::time::Duration;

/// The way to a `using`: the expressions around it, the outermost first, and then the `using` itself.
type Way<'e> = Vec<&'e Expression>;

impl Times<'_, '_> {
    /// Returns the longest time that a `using` of a group waits. None if it is not limited, or if two may wait for each
    /// other.
    pub(super) fn turn(&self, group: u32, source: &Group, own: &Expression) -> Option<Duration> {
        // Without this, two locks in opposite orders would recurse without end.
        let mark = std::ptr::from_ref(own) as usize;
        if self.turns.borrow().contains(&mark) {
            return None;
        }
        self.turns.borrow_mut().push(mark);
        let mut all = Vec::new();
        collect(&source.expression, &mut Vec::new(), &mut all);
        let own = all.iter().position(|way| way.last().is_some_and(|last| std::ptr::eq(*last, own)));
        let before = own.and_then(|own| {
            let holds = rivals(&all, own).into_iter().map(|other| self.hold(group, source, &all[other], &all[own]));
            holds.into_iter().try_fold(Duration::ZERO, |sum, hold| Some(sum.saturating_add(hold?)))
        });
        self.turns.borrow_mut().pop();
        before
    }

    /// Returns the longest time for which a `using` holds its resources while another one waits.
    fn hold(&self, group: u32, source: &Group, way: &Way<'_>, own: &Way<'_>) -> Option<Duration> {
        let (last, around) = way.split_last()?;
        let body = self.of(group, source, last.operands().into_iter().next()?);
        let stopping = around.iter().filter(|operator| is_stopping(operator));
        // A stopped body releases its resources only once it has stopped.
        let by_itself = if stopping.clone().count() == 0 { body.end } else { add(body.end, body.stop) };
        let beside = stopping.filter(|operator| !own.iter().any(|other| std::ptr::eq(*other, **operator)));
        let by_others = beside.filter_map(|operator| self.of(group, source, operator).end);
        by_itself.into_iter().chain(by_others).min()
    }
}

/// Returns the other `using`s for which one may have to wait.
fn rivals(all: &[Way<'_>], own: usize) -> Vec<usize> {
    let (mut rivals, mut open) = (Vec::new(), vec![own]);
    while let Some(at) = open.pop() {
        for other in 0..all.len() {
            let is_new = other != own && !rivals.contains(&other);
            if is_new && share(&all[at], &all[other]) && are_beside(&all[own], &all[other]) {
                rivals.push(other);
                open.push(other);
            }
        }
    }
    rivals
}

/// Returns whether two `using`s share a resource.
fn share(one: &Way<'_>, other: &Way<'_>) -> bool {
    let taken = |way: &Way<'_>| match way.last() {
        Some(Expression::Using { resources, .. }) => resources.clone(),
        Some(_) | None => Vec::new(),
    };
    let others = taken(other);
    taken(one).iter().any(|name| others.contains(name))
}

/// Returns whether two `using`s may be active at the same time: the innermost operator around both runs its operands in
/// parallel.
fn are_beside(one: &Way<'_>, other: &Way<'_>) -> bool {
    let both = one.iter().zip(other).take_while(|(one, other)| std::ptr::eq(**one, **other)).last();
    both.is_some_and(|(operator, _)| {
        is_stopping(operator)
            || matches!(
                operator,
                Expression::Concurrent(_) | Expression::AtLeast { .. } | Expression::Asynchronous { .. }
            )
    })
}

/// Returns whether an operator stops some of its operands when another one has ended.
fn is_stopping(operator: &Expression) -> bool {
    matches!(operator, Expression::Disable(_) | Expression::FailFast(_) | Expression::AnyOf { .. })
}

fn collect<'e>(expression: &'e Expression, around: &mut Way<'e>, all: &mut Vec<Way<'e>>) {
    around.push(expression);
    if matches!(expression, Expression::Using { .. }) {
        all.push(around.clone());
    }
    for operand in expression.operands() {
        collect(operand, around, all);
    }
    around.pop();
}
