//! The similarities between nodes of two programs, and the number of operands that a node waits for.

use crate::algebra::phase::Phase;
use crate::algebra::program::{Kind, Program, Start};
use crate::algebra::state::Cell;
use crate::automaton::Failure;
use std::collections::BTreeSet;
use std::mem::discriminant;
use std::sync::Arc;

/// Counts the operands that an operator waits for, and those that are done.
pub(super) fn count(program: &Program, cells: &mut [Cell], node: usize, starting: &BTreeSet<usize>) {
    let is_open = |operand: &usize| starting.contains(operand) || cells[*operand].phase.is_active();
    let is_draining = cells[node].phase == Phase::Draining;
    let kind = &program.nodes[node].kind;
    let is_waited_for = |operand: &usize| {
        let is_task = matches!(kind, Kind::Concurrent { .. }) && program.is_task(node, *operand);
        is_draining || is_task || matches!(kind, Kind::FailFast { .. })
    };
    let open = program.operands(node).filter(is_open).filter(is_waited_for).count();
    let done = program.operands(node).filter(|operand| cells[*operand].phase == Phase::Done).count();
    let small = |count: usize| u32::try_from(count).expect("a plan has fewer than 2^32 operands");
    (cells[node].open, cells[node].done) = (small(open), small(done));
}

pub(super) fn sets(program: &Program, node: usize) -> &[u32] {
    if let Kind::Run { sets, .. } = &program.nodes[node].kind { &program.sets[sets.clone()] } else { &[] }
}

pub(super) fn tags(program: &Program, node: usize) -> &[Option<Arc<str>>] {
    if let Kind::Match { tags } | Kind::Repeat { tags } = &program.nodes[node].kind {
        &program.tags[tags.clone()]
    } else {
        &[]
    }
}

pub(super) fn failures(program: &Program, node: usize) -> &[Option<Failure>] {
    if let Kind::Catch { failures } = &program.nodes[node].kind { &program.failures[failures.clone()] } else { &[] }
}

pub(super) fn taken(program: &Program, node: usize) -> BTreeSet<&str> {
    program.taken(node).iter().map(|&index| program.resources()[index].as_str()).collect()
}

/// A node that is compared with one of another program.
#[derive(Clone, Copy)]
pub(super) struct Compared<'a> {
    pub(super) program: &'a Program,
    pub(super) node: usize,
    /// The first node of those that are compared.
    pub(super) first: usize,
}

/// Whether two nodes have the same meaning.
pub(super) fn is_alike(old: Compared<'_>, new: Compared<'_>) -> bool {
    let (a, b, old_first, new_first) = (old.node, new.node, old.first, new.first);
    let (old, new) = (old.program, new.program);
    if old.nodes[a].end - old_first != new.nodes[b].end - new_first {
        return false;
    }
    match (&old.nodes[a].kind, &new.nodes[b].kind) {
        (Kind::Run { member, .. }, Kind::Run { member: other, .. }) => member == other && sets(old, a) == sets(new, b),
        (Kind::Fail(why), Kind::Fail(other)) | (Kind::Tagged(why), Kind::Tagged(other)) => why == other,
        (Kind::With(Start::Known(value)), Kind::With(Start::Known(other))) => value == other,
        (Kind::With(Start::Kept { between, .. }), Kind::With(Start::Kept { between: other, .. })) => between == other,
        (Kind::With(_), Kind::With(_)) => false,
        (Kind::Wait { after, .. }, Kind::Wait { after: other, .. }) => after == other,
        (Kind::AnyOf { count, .. }, Kind::AnyOf { count: other, .. })
        | (Kind::AtLeast { count, .. }, Kind::AtLeast { count: other, .. }) => count == other,
        (Kind::Match { .. }, Kind::Match { .. }) | (Kind::Repeat { .. }, Kind::Repeat { .. }) => {
            tags(old, a) == tags(new, b)
        }
        (Kind::Catch { .. }, Kind::Catch { .. }) => failures(old, a) == failures(new, b),
        (Kind::Shield { bound }, Kind::Shield { bound: other }) => {
            bound.map(|bound| bound.after) == other.map(|bound| bound.after)
        }
        (Kind::Using { .. }, Kind::Using { .. }) => taken(old, a) == taken(new, b),
        (Kind::Chart, Kind::Chart) => old.chart == new.chart,
        (one, other) => discriminant(one) == discriminant(other),
    }
}
