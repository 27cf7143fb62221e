//! Finds limits that always pass: `P within 5 s`, where `P` always takes longer.

pub(crate) mod late;

use crate::explore::{Limits, Nobody, explore};
use crate::finding::{Finding, diagnostic, help};
use crate::model::{Model, count, walk};
use crate::story::{Story, seconds, tell};
use crate::system::{Label, System, small};
use crate::times::Times;
use language::Code;
use language::plan::{DEADLINE, Expression, Group, MemberKind};
use std::collections::BTreeSet;
use std::time::Duration;

/// Finds every limit that is too short. If there is none, reports the number of limits.
pub(crate) fn check(times: &Times<'_, '_>, limits: &Limits<'_>) -> Vec<Finding> {
    let (mut findings, mut count, mut seen) = (Vec::new(), 0, BTreeSet::new());
    for (group, source) in (0_u32..).zip(&times.model.plan.groups) {
        let mut node = 0;
        walk(&source.expression, &mut |expression| {
            let own = node;
            node += 1;
            let Some((body, limit)) = within(expression) else { return };
            count += 1;
            let Some(least) = times.of(group, source, body).done else { return };
            // A body with a program takes some time, even if it is short.
            if least <= limit && !(limit.is_zero() && takes_time(source, body)) {
                return;
            }
            let sites = &times.model.sites.groups[group as usize];
            let span = sites.nodes.get(own).copied().unwrap_or(sites.name);
            if !seen.insert(span) {
                return;
            }
            let limit = seconds(limit);
            let (takes, advice) = match least.is_zero() {
                true => ("some time, however short".to_owned(), "give it some time, as in `P within 5 s`".to_owned()),
                false => (format!("{} at the least", seconds(least)), format!("give it more than {}", seconds(least))),
            };
            let message = format!("this takes {takes}, so the limit of {limit} always passes");
            let found = help(diagnostic(Code::E0815, span, message), advice);
            findings.push(Finding::fails(found, passes(times.model, group, own, limits)));
        });
    }
    if findings.is_empty() && count > 0 {
        let limits = if count == 1 { "the limit is".to_owned() } else { format!("all {count} limits are") };
        findings.push(Finding::proved(format!("{limits} longer than the known times of their bodies")));
    }
    findings
}

/// Returns whether no part of an expression ends at the moment at which it starts: it contains only programs and
/// pauses.
fn takes_time(group: &Group, expression: &Expression) -> bool {
    if let Expression::Run { member, .. } = expression {
        return matches!(group.members[*member as usize].kind, MemberKind::Leaf(_));
    }
    let operands = expression.operands();
    match operands.is_empty() {
        true => matches!(expression, Expression::Wait(time) if !time.is_zero()),
        false => operands.into_iter().all(|operand| takes_time(group, operand)),
    }
}

/// Returns the story of a limit that passes: the limit of the `within` with this number in the expression of a group.
fn passes(model: &Model<'_>, group: u32, within: usize, limits: &Limits<'_>) -> Option<Story> {
    let is_piece = |part: usize| model.parts[part].is_piece && model.parts[part].group == group;
    let system = System::new(model, group as usize, &is_piece);
    let graph = explore(&system, limits, true, &Nobody).graph;
    let limit = Some(limit_node(model, group, within)?);
    let timer = system.units.iter().enumerate().find_map(|(unit, source)| {
        let part = &model.parts[source.part];
        let (mut node, mut timers, mut own) = (0, 0, None);
        walk(&part.expression, &mut |expression| {
            let is_wait = matches!(expression, Expression::Wait(_));
            if is_wait && part.nodes.get(node).copied() == limit {
                own = Some(timers);
            }
            timers += usize::from(is_wait || matches!(expression, Expression::Shield { bound: Some(_), .. }));
            node += 1;
        });
        own.map(|timer| Label::Elapsed(small(unit), small(timer)))
    })?;
    let states = 0..graph.store.count();
    let state = states.into_iter().find(|&state| graph.from(state).any(|(label, _)| label == timer))?;
    let mut way = graph.way(state);
    way.push(timer);
    Some(tell(&system, &way))
}

/// Returns the number of the `wait` in a `within`; `within` is the number of the operator.
fn limit_node(model: &Model<'_>, group: u32, within: usize) -> Option<u32> {
    let (mut node, mut found) = (0, None);
    walk(&model.plan.groups[group as usize].expression, &mut |expression| {
        if node == within
            && let Some((body, _)) = self::within(expression)
        {
            // The operator itself, its body, and the `;` of the limit come first.
            found = u32::try_from(within).ok().map(|within| within + 1 + count(body) + 1);
        }
        node += 1;
    });
    found
}

/// Returns the body and the limit of `P within d`.
pub(crate) fn within(expression: &Expression) -> Option<(&Expression, Duration)> {
    let Expression::Disable(of) = expression else { return None };
    let [body, Expression::Sequence(wait, fail)] = of.as_slice() else { return None };
    match (&**wait, &**fail) {
        (Expression::Wait(limit), Expression::Fail(why)) if why.starts_with(DEADLINE) => Some((body, *limit)),
        (_, _) => None,
    }
}

/// Returns for each timer of an expression whether it is a limit: when it passes, a failure follows.
pub(crate) fn is_limit(expression: &Expression) -> Vec<bool> {
    let (mut timers, mut limits) = (0, BTreeSet::new());
    walk(expression, &mut |expression| {
        if let Expression::Sequence(wait, fail) = expression
            && matches!((&**wait, &**fail), (Expression::Wait(_), Expression::Fail(_)))
        {
            // The `wait` of the limit is the next timer.
            limits.insert(timers);
        }
        let is_timer = matches!(expression, Expression::Wait(_) | Expression::Shield { bound: Some(_), .. });
        timers += usize::from(is_timer);
    });
    (0..timers).map(|timer| limits.contains(&timer)).collect()
}
