//! Decides whether a step watches other processes, which would continue unwatched while the step hangs.

use super::case::is_step;
use crate::system::MemberRef;
use crate::system::{Frame, System};
use language::algebra::Activity;
use language::plan::Expression;

/// Returns whether other processes run in parallel with a step and continue without it. They may be in another operand
/// of a `#` or an `any`. Or the step is beside an operand that is never done, such as `button ; fail("...")`. A limit
/// further inside is for the step itself. A limit further outside also ends the watched processes.
pub(super) fn is_watcher(system: &System<'_>, frame: &Frame, seat: MemberRef) -> bool {
    let seats = std::iter::successors(Some(seat), |MemberRef { unit, .. }| system.units[*unit].parent);
    let mut looks = seats.filter_map(|MemberRef { unit, member }| {
        let mut look = Look { system, frame, unit, member, node: 0, is_watcher: None };
        look.at(&system.model.parts[system.units[unit].part].expression);
        look.is_watcher
    });
    looks.next().unwrap_or(false)
}

/// A look at the expression of a unit.
struct Look<'l, 'a> {
    system: &'l System<'a>,
    frame: &'l Frame,
    unit: usize,
    member: u32,
    /// The number of the next node.
    node: usize,
    /// The answer of the innermost operator that decides the question.
    is_watcher: Option<bool>,
}

/// The contents of an expression.
#[derive(Clone, Copy, Debug, Default)]
struct Sight {
    /// The step.
    own: bool,
    /// Whether another process runs.
    other: bool,
    /// Whether a timer runs.
    timer: bool,
    /// Whether the expression can be done.
    can_be_done: bool,
}

impl Look<'_, '_> {
    fn at(&mut self, expression: &Expression) -> Sight {
        let node = self.node;
        self.node += 1;
        let of: Vec<Sight> = expression.operands().into_iter().map(|operand| self.at(operand)).collect();
        let state = &self.frame.states[self.unit];
        let is_active = state.is_node_active(node);
        if let Expression::Run { member, .. } = expression {
            let runs = is_active && state.activity(*member) == Activity::Active;
            let (own, can_be_done) =
                (runs && *member == self.member, is_step(self.system, MemberRef { unit: self.unit, member: *member }));
            return Sight { own, other: runs && !own, timer: false, can_be_done };
        }
        if let Some(own) = of.iter().position(|sight| sight.own).filter(|_| self.is_watcher.is_none()) {
            self.is_watcher = decides(expression, &of, own);
        }
        Sight {
            own: of.iter().any(|sight| sight.own),
            other: of.iter().any(|sight| sight.other),
            timer: is_active && matches!(expression, Expression::Wait(_)) || of.iter().any(|sight| sight.timer),
            can_be_done: can_be_done(expression, &of),
        }
    }
}

/// Returns whether an operator makes one of its operands a watcher; `None` if the operator does not decide this.
fn decides(expression: &Expression, of: &[Sight], own: usize) -> Option<bool> {
    let besides = || of.iter().enumerate().filter(|(index, _)| *index != own).map(|(_, sight)| sight);
    let is_enough = matches!(expression, Expression::AnyOf { count, .. } if of.len() > *count as usize);
    let is_raced = is_enough || matches!(expression, Expression::Disable(_));
    let is_beside = matches!(expression, Expression::Concurrent(_) | Expression::FailFast(_)) && !of[own].can_be_done;
    if (is_raced || is_beside) && besides().any(|sight| sight.other) {
        return Some(true);
    }
    (is_raced && besides().any(|sight| sight.timer)).then_some(false)
}

fn can_be_done(expression: &Expression, of: &[Sight]) -> bool {
    let all = || of.iter().all(|sight| sight.can_be_done);
    let any = || of.is_empty() || of.iter().any(|sight| sight.can_be_done);
    match expression {
        Expression::Never | Expression::Fail(_) | Expression::Recurrent(..) | Expression::Asynchronous { .. } => false,
        Expression::Sequence(..) | Expression::Conditional(..) | Expression::Finally(..) => all(),
        Expression::Chart(chart) => !chart.is_service(),
        Expression::Run { .. }
        | Expression::Skip
        | Expression::Wait(_)
        | Expression::Concurrent(_)
        | Expression::FailFast(_)
        | Expression::AnyOf { .. }
        | Expression::AtLeast { .. }
        | Expression::Disable(_)
        | Expression::Otherwise(..)
        | Expression::Match(_)
        | Expression::Shield { .. }
        | Expression::Using { .. }
        | Expression::Tagged { .. }
        | Expression::With { .. }
        | Expression::Named { .. }
        | Expression::Repeat { .. }
        | Expression::Catch { .. } => any(),
    }
}
