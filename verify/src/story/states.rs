//! The names of the states of activities in stories.

use crate::system::{Frame, System};
use language::automaton::Trigger;
use language::plan::Expression;

/// Returns the words for the end of a transition's timer; none for other timers.
pub(super) fn timer(expression: &Expression, timer: usize, activity: &str, time: &str) -> Option<String> {
    let Expression::Chart(chart) = expression else { return None };
    let mut timed = chart.chart.transitions.iter().filter(|transition| transition.trigger.time().is_some());
    let transition = timed.nth(timer)?;
    let state = match transition.source {
        0 => format!("`{activity}` runs"),
        source => format!("`{activity}` is in `{}`", chart.chart.states[source].name),
    };
    let is_tick = matches!(transition.trigger, Trigger::Every(_));
    Some(match is_tick {
        true => format!("{state}, and `every {time}` ticks"),
        false => format!("{state}, and `after {time}` has run out"),
    })
}

/// Returns for each unit the names of the present states of its activity. Empty while the unit runs no activity, or
/// waits for a stop.
pub(super) fn names(system: &System<'_>, frame: &Frame) -> Vec<String> {
    (0..system.units.len()).map(|unit| name(system, frame, unit).unwrap_or_default()).collect()
}

fn name(system: &System<'_>, frame: &Frame, unit: usize) -> Option<String> {
    let automaton = system.program(unit).automaton()?;
    let place = system.place(frame, unit)?;
    let name = |state: usize| format!("`{}`", automaton.chart().states[state].name);
    let names: Vec<String> = place.leaves(automaton).map(name).collect();
    (!place.is_waiting()).then(|| names.join(", "))
}

/// Returns the activities whose states differ from those before.
pub(super) fn entered(system: &System<'_>, before: &[String], frame: &Frame) -> Vec<String> {
    let after = names(system, frame);
    let changed = before.iter().zip(&after).enumerate().filter(|(_, (before, after))| before != after);
    let entered = changed.filter(|(_, (_, after))| !after.is_empty());
    let told = entered.map(|(unit, (_, after))| {
        let group = system.model.parts[system.units[unit].part].group;
        format!("`{}` is in {after}", system.model.group_name(group))
    });
    told.collect()
}
