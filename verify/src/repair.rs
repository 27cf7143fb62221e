//! Repairs: edits of a spec after which a mistake is proved to be gone.
//!
//! For the usual mistakes there are usual repairs. Each that might do is made in a copy of the text, and the copy is verified: what is
//! offered is what was proved, and what brings no other mistake with it. Whether it is what was meant only a person knows.

mod candidates;
mod text;

use crate::explore::Limits;
use crate::finding::{Finding, Verdict};
use crate::{Report, verify};
use language::plan::Plan;
use language::sites::Sites;
use language::{Code, Fix, Options, Source, Span, apply_fix, compile_with_sites};

/// So many mistakes of a spec are looked at.
const FINDINGS_MAX: usize = 20;
/// So many repairs of one mistake are tried, and so many are offered.
const TRIED_MAX: usize = 16;
const OFFERED_MAX: usize = 1;

/// Edits that are proved to repair a mistake.
#[derive(Clone, Debug, PartialEq)]
pub struct Repair {
    /// What does not hold without it.
    pub sentence: String,
    /// The mistake.
    pub code: Code,
    /// Where the mistake is.
    pub span: Span,
    /// What is changed, in words and as edits of the spec.
    pub fix: Fix,
}

/// Returns the repairs of what does not hold of a spec: those after which it was verified to hold, and nothing else fails that
/// did not fail before.
pub fn repairs(spec: &Source, interfaces: &[Source], options: &Options, limits: &Limits<'_>) -> Vec<Repair> {
    let Some((plan, sites, report)) = verified(spec, interfaces, options, limits) else { return Vec::new() };
    let fails = report.findings.iter().filter(|finding| finding.verdict == Verdict::Fails);
    let mut repairs = Vec::new();
    for finding in fails.take(FINDINGS_MAX) {
        let Some(diagnostic) = &finding.diagnostic else { continue };
        let candidates = candidates::of(spec, (&plan, &sites), diagnostic).into_iter().take(TRIED_MAX);
        let holds = |fix: &Fix| {
            limits.goes_on.goes_on()
                && verified(&applied(spec, fix), interfaces, options, limits)
                    .is_some_and(|(_, _, after)| is_repaired((&report, &after), finding))
        };
        repairs.extend(candidates.filter(holds).take(OFFERED_MAX).map(|fix| Repair {
            sentence: finding.sentence.clone(),
            code: diagnostic.code,
            span: diagnostic.primary.span,
            fix,
        }));
    }
    repairs
}

fn verified(
    spec: &Source,
    interfaces: &[Source],
    options: &Options,
    limits: &Limits<'_>,
) -> Option<(Plan, Sites, Report)> {
    let (compiled, sites) = compile_with_sites(spec, interfaces, options);
    let (plan, sites) = compiled.plan.zip(sites)?;
    let report = verify(&plan, &sites, limits);
    Some((plan, sites, report))
}

/// Whether a mistake is gone from the second of two reports, nothing new is in it, and all of it is decided that was.
fn is_repaired((before, after): (&Report, &Report), finding: &Finding) -> bool {
    let code = |finding: &Finding| finding.diagnostic.as_ref().map(|diagnostic| diagnostic.code);
    let is_same = |one: &Finding, other: &Finding| code(one) == code(other) && one.sentence == other.sentence;
    let was_there = |other: &Finding| before.findings.iter().any(|old| is_same(old, other));
    after.findings.iter().all(|other| match other.verdict {
        Verdict::Proved => true,
        Verdict::Fails => was_there(other) && !is_same(finding, other),
        Verdict::Open => was_there(other),
    })
}

/// The spec with a fix applied.
pub fn applied(spec: &Source, fix: &Fix) -> Source {
    Source::new(spec.name.clone(), apply_fix(&spec.text, fix))
}
