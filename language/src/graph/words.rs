//! Words for the transitions and runs of an activity of a plan. The text of its spec is not in the plan.

use crate::automaton::{Formula, Relation, Transition, Trigger};
use crate::plan::{Expression, Filter, FilterPart, Group, StateChart};
use std::time::Duration;

/// The longest text, in characters: it stands in a box.
const TEXT_MAX: usize = 60;
/// How deep conditions are written out.
const DEPTH_MAX: usize = 16;
/// Stands for the rest of a text.
const MORE: &str = "…";

/// Returns the trigger and the condition of a transition, as a spec writes them. The caller has validated the plan.
pub(super) fn transition(chart: &StateChart, transition: &Transition) -> String {
    let trigger = trigger(chart, &transition.trigger);
    let guard = transition.guard.as_ref().map(|guard| format!(" when {}", formula(chart, guard, 0)));
    short(&(trigger + &guard.unwrap_or_default()))
}

/// Returns the names of the members that an expression runs. The caller has validated the plan.
pub(super) fn members(expression: &Expression, group: &Group) -> String {
    let mut names: Vec<&str> = Vec::new();
    for slot in expression.members() {
        let name = group.members[slot as usize].name.as_str();
        if !names.contains(&name) {
            names.push(name);
        }
    }
    short(&names.join(", "))
}

fn trigger(chart: &StateChart, trigger: &Trigger) -> String {
    match trigger {
        Trigger::Always => "always".to_owned(),
        Trigger::Message { port, filter } => {
            let filter = filter.map(|filter| format!(" where {}", condition(&chart.filters[filter], 0)));
            format!("message {}{}", chart.inputs[*port], filter.unwrap_or_default())
        }
        Trigger::Any => "any".to_owned(),
        Trigger::Signal(signal) => format!("signal {}", chart.signals[*signal]),
        Trigger::Notice(notice) => chart.notices[*notice].to_string(),
        Trigger::Done(tag) => with("done", tag.as_deref()),
        Trigger::Aborted(failure) => with("aborted", failure.as_ref().map(ToString::to_string).as_deref()),
        Trigger::Complete => "complete".to_owned(),
        Trigger::After(time) => format!("after {}", seconds(*time)),
        Trigger::Every(time) => format!("every {}", seconds(*time)),
    }
}

fn with(word: &str, more: Option<&str>) -> String {
    more.map_or_else(|| word.to_owned(), |more| format!("{word}({more})"))
}

fn seconds(time: Duration) -> String {
    format!("{} s", time.as_secs_f64())
}

fn sign(relation: Relation, is_negated: bool) -> &'static str {
    match (relation, is_negated) {
        (Relation::Equal, false) => "==",
        (Relation::Equal, true) => "!=",
        (Relation::Less, false) => "<",
        (Relation::Less, true) => ">=",
        (Relation::AtMost, false) => "<=",
        (Relation::AtMost, true) => ">",
    }
}

fn condition(filter: &Filter, depth: usize) -> String {
    if depth > DEPTH_MAX {
        return MORE.to_owned();
    }
    let joined = |parts: &[FilterPart], word: &str| {
        let parts: Vec<String> = parts.iter().map(|part| condition(part, depth + 1)).collect();
        grouped(parts.join(word), depth)
    };
    match filter {
        Filter::Text { text, is_equal } => format!("text {} {text:?}", sign(Relation::Equal, !is_equal)),
        Filter::Priority { relation, number, is_negated } => {
            format!("priority {} {number}", sign(*relation, *is_negated))
        }
        Filter::All(parts) => joined(parts, " && "),
        Filter::Any(parts) => joined(parts, " || "),
    }
}

fn formula(chart: &StateChart, of: &Formula, depth: usize) -> String {
    if depth > DEPTH_MAX {
        return MORE.to_owned();
    }
    let inner = |of: &Formula| formula(chart, of, depth + 1);
    let joined = |a: &Formula, word: &str, b: &Formula| grouped(format!("{} {word} {}", inner(a), inner(b)), depth);
    match of {
        Formula::Number(number) => number.to_string(),
        Formula::Variable(variable) => chart.chart.variables[*variable].name.clone(),
        Formula::In(state) => format!("in {}", chart.chart.states[*state].name),
        Formula::Not(of) => match &**of {
            Formula::Compare(relation, a, b) => compared(chart, depth, sign(*relation, true), [a, b]),
            Formula::Number(_)
            | Formula::Variable(_)
            | Formula::In(_)
            | Formula::Not(_)
            | Formula::And(..)
            | Formula::Or(..)
            | Formula::Add(..)
            | Formula::Subtract(..)
            | Formula::Multiply(..) => format!("!{}", inner(of)),
        },
        Formula::And(a, b) => joined(a, "&&", b),
        Formula::Or(a, b) => joined(a, "||", b),
        Formula::Compare(relation, a, b) => compared(chart, depth, sign(*relation, false), [a, b]),
        Formula::Add(a, b) => joined(a, "+", b),
        Formula::Subtract(a, b) => joined(a, "-", b),
        Formula::Multiply(a, b) => joined(a, "*", b),
    }
}

/// Writes a comparison. A value of an enumeration has its name.
fn compared(chart: &StateChart, depth: usize, sign: &str, sides: [&Formula; 2]) -> String {
    let name = |of: &Formula, other: &Formula| {
        let (Formula::Number(number), Formula::Variable(variable)) = (of, other) else { return None };
        let variable = &chart.chart.variables[*variable];
        let place = usize::try_from(number.checked_sub(i64::from(variable.min))?).ok()?;
        variable.names.get(place).cloned()
    };
    let [a, b] = sides;
    let [left, right] =
        [(a, b), (b, a)].map(|(of, other)| name(of, other).unwrap_or_else(|| formula(chart, of, depth + 1)));
    grouped(format!("{left} {sign} {right}"), depth)
}

/// Puts a condition within another one into parentheses.
fn grouped(text: String, depth: usize) -> String {
    if depth == 0 { text } else { format!("({text})") }
}

/// Cuts a text that is too long for a box.
fn short(text: &str) -> String {
    if text.chars().count() <= TEXT_MAX {
        return text.to_owned();
    }
    text.chars().take(TEXT_MAX - 1).chain(MORE.chars()).collect()
}
