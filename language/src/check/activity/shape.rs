//! Explains errors of a whole chart in the words of the text.

use crate::automaton::{Chart, ChartError, ChartPlace};
use crate::source::Span;
use std::collections::BTreeMap;

/// Returns the message of an error of a chart, and its place if the text has this place.
pub(super) fn explained(
    error: &ChartError,
    chart: &Chart,
    states: &BTreeMap<usize, Span>,
    transitions: &[Span],
) -> (Option<Span>, String) {
    let name = |state: usize| chart.states.get(state).map_or("", |state| state.name.as_str());
    match error {
        ChartError::Kind { state, why } => (states.get(state).copied(), format!("`{}` {why}", name(*state))),
        ChartError::Targets { place: ChartPlace::State(state), why } => {
            (states.get(state).copied(), format!("the states in which `{}` begins {why}", name(*state)))
        }
        ChartError::Targets { place: ChartPlace::Transition(number), why } => {
            (transitions.get(*number).copied(), format!("the targets of this transition {why}"))
        }
        ChartError::Trigger { transition, why } => {
            (transitions.get(*transition).copied(), format!("this transition {why}"))
        }
        ChartError::Depth(state) => (states.get(state).copied(), format!("`{}` is nested too deep", name(*state))),
        ChartError::Order(_) | ChartError::Size | ChartError::Missing(_) | ChartError::Range(_) => {
            (None, error.to_string())
        }
    }
}
