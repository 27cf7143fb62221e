//! The values of outcomes, as far as an expression distinguishes them: tags, tags inside tags, and reasons of failures.

use crate::model::{Model, Part, Seat, walk};
use language::algebra::Value;
use language::automaton::Failure;
use language::plan::{Expression, Given};
use std::collections::BTreeSet;

/// The most values in a packed state, besides the empty value.
const VALUES_MAX: usize = 255;

/// The values besides the empty value.
#[derive(Debug, Default)]
pub(crate) struct Values {
    pub(crate) all: Vec<Value>,
    /// Whether values are missing because the spec has too many.
    pub(crate) is_limited: bool,
}

impl Values {
    /// Returns the values of a spec. There are none if no expression and no sentence distinguishes values.
    pub(crate) fn of(model: &Model<'_>) -> Self {
        if !model.has_tags() {
            return Self::default();
        }
        let mut tags: Vec<&str> =
            model.plan.leaves.iter().flat_map(|leaf| &leaf.outcomes).map(String::as_str).collect();
        tags.extend(model.plan.groups.iter().flat_map(|group| group.expression.tags()));
        tags.sort_unstable();
        tags.dedup();
        let mut all: Vec<Value> = tags.iter().filter_map(|tag| Value::tagged(tag, &[])).collect();
        // A `match` may look at the tag inside a tag: `(look as seen) : match { seen v => (match { found => a }) with v }`.
        let mut inner = all.clone();
        for _ in 1..depth(model) {
            let pairs = tags.iter().flat_map(|tag| inner.iter().map(move |value| Value::tagged(tag, value.bytes())));
            inner = pairs.flatten().take(VALUES_MAX + 1).collect();
            all.extend(inner.iter().take(VALUES_MAX + 1).cloned());
        }
        let asked = model.plan.groups.iter().flat_map(|group| group.expression.failures());
        let asked: BTreeSet<&Failure> = asked.collect();
        // The report of this reason is empty, so all other reasons need a number.
        let others = asked.contains(&Failure::Reported).then(|| Failure::other().report());
        for value in asked.into_iter().map(Failure::report).chain(others) {
            // The bytes of a short text are equal to the bytes of a tag.
            if value != Value::EMPTY && !all.contains(&value) {
                all.push(value);
            }
        }
        let is_limited = all.len() > VALUES_MAX;
        all.truncate(VALUES_MAX);
        Self { all, is_limited }
    }
}

/// Returns how many tags, one inside the other, some expression may look at.
fn depth(model: &Model<'_>) -> usize {
    let mut most = 0;
    for part in &model.parts {
        walk(&part.expression, &mut |expression| most = most.max(read_of(&model.parts, part, expression)));
    }
    most
}

/// Returns for each part whether it looks at the tag of the value with which it is started.
pub(crate) fn readers(parts: &[Part]) -> Vec<bool> {
    parts.iter().map(|part| read_of(parts, part, &part.expression) > 0).collect()
}

/// Returns at how many tags of its start value an expression of a part may look, one inside the other.
fn read_of(parts: &[Part], part: &Part, expression: &Expression) -> usize {
    let read = |expression: &Expression| read_of(parts, part, expression);
    match expression {
        Expression::Run { member, .. } => match part.members.get(*member as usize) {
            Some(Seat::Part(inner)) => read_of(parts, &parts[*inner], &parts[*inner].expression),
            Some(Seat::Leaf(_)) | None => 0,
        },
        Expression::Match(arms) => 1 + arms.iter().map(|arm| read(&arm.body)).max().unwrap_or(0),
        Expression::Named { name, of } => read_as(parts, part, name, of),
        Expression::With { .. } | Expression::Skip | Expression::Never | Expression::Fail(_) | Expression::Wait(_) => 0,
        Expression::Sequence(first, _)
        | Expression::Conditional(first, _)
        | Expression::Recurrent(first, _)
        | Expression::Otherwise(first, _)
        | Expression::Finally(first, _) => read(first),
        Expression::Catch { of, .. }
        | Expression::Shield { of, .. }
        | Expression::Using { of, .. }
        | Expression::Tagged { of, .. }
        | Expression::Repeat { of, .. } => read(of),
        Expression::Asynchronous { source, .. } => read(source),
        Expression::Concurrent(_)
        | Expression::FailFast(_)
        | Expression::Disable(_)
        | Expression::AnyOf { .. }
        | Expression::AtLeast { .. }
        | Expression::Chart(_) => expression.operands().into_iter().map(read).max().unwrap_or(0),
    }
}

/// Returns the same for the value that has a name in an expression.
fn read_as(parts: &[Part], part: &Part, name: &str, expression: &Expression) -> usize {
    if let Expression::With { given: Given::Result(other), of } = expression
        && other == name
    {
        return read_of(parts, part, of).max(read_as(parts, part, name, of));
    }
    expression.operands().into_iter().map(|operand| read_as(parts, part, name, operand)).max().unwrap_or(0)
}
