//! Limits that always pass: `P within 5 s` where P takes longer than that at the least.

use crate::finding::{Finding, diagnostic, help};
use crate::story::seconds;
use crate::times::Times;
use language::Code;
use language::plan::{DEADLINE, Expression};
use std::collections::BTreeSet;
use std::time::Duration;

/// Finds every limit that is too short; says how many there are if none is.
pub(crate) fn check(times: &Times<'_, '_>) -> Vec<Finding> {
    let (mut findings, mut count, mut seen) = (Vec::new(), 0, BTreeSet::new());
    for (group, source) in (0_u32..).zip(&times.model.plan.groups) {
        let mut node = 0;
        crate::model::walk(&source.expression, &mut |expression| {
            let own = node;
            node += 1;
            let Some((body, limit)) = within(expression) else { return };
            count += 1;
            let Some(least) = times.of(group, source, body).done.filter(|least| *least > limit) else { return };
            let sites = &times.model.sites.groups[group as usize];
            let span = sites.nodes.get(own).copied().unwrap_or(sites.name);
            if !seen.insert(span) {
                return;
            }
            let (least, limit) = (seconds(least), seconds(limit));
            let message = format!("this takes {least} at the least, so the limit of {limit} always passes");
            let found = help(diagnostic(Code::E0815, span, message), format!("give it more than {least}"));
            findings.push(Finding::fails(found, None));
        });
    }
    if findings.is_empty() && count > 0 {
        let limits = if count == 1 { "the limit is".to_owned() } else { format!("all {count} limits are") };
        findings.push(Finding::proved(format!("{limits} longer than what is known of their bodies")));
    }
    findings
}

/// The body and the limit of `P within d`.
pub(crate) fn within(expression: &Expression) -> Option<(&Expression, Duration)> {
    let Expression::Disable(of) = expression else { return None };
    let [body, Expression::Sequence(wait, fail)] = of.as_slice() else { return None };
    match (&**wait, &**fail) {
        (Expression::Wait(limit), Expression::Fail(why)) if why.starts_with(DEADLINE) => Some((body, *limit)),
        (_, _) => None,
    }
}
