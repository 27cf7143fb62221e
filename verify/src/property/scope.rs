//! The groups in which a sentence is checked, the smallest first.
//!
//! The group of a sentence may be much larger than the groups that it names. A group alone does everything that it does in its
//! surroundings: it may be started with every outcome, its programs may fail, and an order to stop may come at any time. So if
//! a sentence about its members holds in the group alone, it also holds in the surroundings. Otherwise the surroundings
//! may exclude the violation, so the next larger group is explored.

use super::watch::{Forbidden, Goal};
use crate::model::Model;
use language::plan::Expression;
use language::sites::ProcessRef;

/// Returns the groups inside `root` that contain all named processes, the smallest first. There are none if the goal may hold
/// in such a group and not around it.
pub(super) fn inner_groups(model: &Model<'_>, root: u32, whom: &[ProcessRef], goal: &Goal) -> Vec<u32> {
    let outwards = |group: u32| std::iter::successors(Some(group), |group| Some(model.around[*group as usize]?.0));
    let Some(first) = whom.first().filter(|_| whom.iter().all(|who| who.member.is_some())) else { return Vec::new() };
    let holds_all = |group: &u32| whom.iter().all(|who| outwards(who.group).any(|around| around == *group));
    let inside = outwards(first.group).take_while(|group| *group != root);
    let groups = inside.filter(holds_all);
    match reach(goal) {
        Reach::Activation => groups.collect(),
        Reach::Run => groups.filter(|group| begins_once(model, *group, root)).collect(),
        Reach::Surroundings => Vec::new(),
    }
}

/// The part of a run that a goal is about.
enum Reach {
    /// Each activation of a group by itself.
    Activation,
    /// All activations of a group together.
    Run,
    /// The stops and ends around a group as well.
    Surroundings,
}

fn reach(goal: &Goal) -> Reach {
    match goal {
        Goal::Never(None, Forbidden::Together(_) | Forbidden::Without(..)) | Goal::Before(..) => Reach::Activation,
        Goal::Never(Some(_), Forbidden::Together(_) | Forbidden::Without(..))
        | Goal::Often(..)
        | Goal::Then(Some(_), _)
        | Goal::Owed(Some(_), _) => Reach::Run,
        Goal::Never(_, Forbidden::BesideEachOther(_))
        | Goal::StillRuns(..)
        | Goal::Then(None, _)
        | Goal::Owed(None, _)
        | Goal::Ending(..)
        | Goal::Sometime(_) => Reach::Surroundings,
    }
}

/// Returns whether a group is activated at most once in each activation of the group `root` around it.
fn begins_once(model: &Model<'_>, mut group: u32, root: u32) -> bool {
    while let Some((around, slot)) = model.around[group as usize].filter(|_| group != root) {
        if starts(&model.plan.groups[around as usize].expression, slot) > 1 {
            return false;
        }
        group = around;
    }
    true
}

/// Returns how often an expression starts a member: at most 2, which stands for any larger number.
fn starts(expression: &Expression, member: u32) -> u32 {
    let of = |operand: &Expression| starts(operand, member);
    let all: u32 = match expression {
        Expression::Run { member: other, .. } => u32::from(*other == member),
        Expression::Recurrent(..)
        | Expression::Repeat { .. }
        | Expression::Asynchronous { .. }
        | Expression::Chart(_) => 2 * expression.operands().into_iter().map(of).sum::<u32>(),
        Expression::Concurrent(_)
        | Expression::FailFast(_)
        | Expression::Disable(_)
        | Expression::AnyOf { .. }
        | Expression::AtLeast { .. }
        | Expression::Sequence(..)
        | Expression::Conditional(..)
        | Expression::Otherwise(..)
        | Expression::Finally(..)
        | Expression::Match(_)
        | Expression::Catch { .. }
        | Expression::Shield { .. }
        | Expression::Using { .. }
        | Expression::Tagged { .. }
        | Expression::With { .. }
        | Expression::Named { .. }
        | Expression::Skip
        | Expression::Never
        | Expression::Fail(_)
        | Expression::Wait(_) => expression.operands().into_iter().map(of).sum(),
    };
    all.min(2)
}
