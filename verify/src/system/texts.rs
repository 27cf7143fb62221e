//! Texts of failures that activities wait for: `on aborted("no way")`.
//!
//! A box fails without a text. So a part that may fail with a text for which an activity around it waits is never a box.

use crate::model::{Model, Seat};
use language::automaton::{Failure, Target, Trigger};
use language::plan::Expression;
use std::collections::BTreeSet;

/// The texts that the transitions of an activity wait for.
pub(super) fn awaited(expression: &Expression) -> impl Iterator<Item = &str> {
    let chart = if let Expression::Chart(chart) = expression { Some(chart) } else { None };
    let transitions = chart.into_iter().flat_map(|chart| &chart.chart.transitions);
    transitions.filter_map(|transition| {
        if let Trigger::Aborted(Some(Failure::Failed(text))) = &transition.trigger { Some(text.as_str()) } else { None }
    })
}

/// Whether a part may fail with one of some texts.
pub(super) fn may_fail_with(model: &Model<'_>, part: usize, texts: &BTreeSet<&str>) -> bool {
    if texts.is_empty() {
        return false;
    }
    let mut is_there = false;
    crate::model::walk(&model.parts[part].expression, &mut |expression| {
        if let Expression::Fail(text) = expression {
            is_there |= texts.contains(text.as_str());
        } else if let Expression::Chart(chart) = expression {
            let is_it = |target: &Target| matches!(target, Target::Abort(text) if texts.contains(text.as_str()));
            is_there |= chart.chart.transitions.iter().any(|transition| is_it(&transition.target));
        }
    });
    let runs = crate::model::runs(&model.parts[part].expression);
    let mut inner = (0..).zip(&model.parts[part].members).filter(|(slot, _)| runs.contains(slot));
    is_there || inner.any(|(_, seat)| matches!(seat, Seat::Part(inner) if may_fail_with(model, *inner, texts)))
}
