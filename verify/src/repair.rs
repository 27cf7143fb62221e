//! Repairs: edits of a spec that are proved to remove a mistake.
//!
//! Common mistakes have common repairs. Each candidate is applied to a copy of the text, and the copy is verified.
//! Only repairs that were proved and cause no new mistake are offered. Only the author can decide which repair has the
//! intended meaning.

mod candidates;
mod text;

use crate::explore::Limits;
use crate::finding::{Finding, Verdict};
use crate::{Report, verify};
use language::plan::{Member, Plan};
use language::sites::Sites;
use language::{Code, Fix, Options, Source, Span, apply_fix, compile_with_sites};
use std::collections::BTreeMap;

/// The most mistakes in a spec for which repairs are searched.
const FINDINGS_MAX: usize = 20;
/// The most candidates that are tried for one mistake, and the most repairs that are offered.
const TRIED_MAX: usize = 16;
const OFFERED_MAX: usize = 1;

/// Edits that are proved to repair a mistake.
#[derive(Clone, Debug, PartialEq)]
pub struct Repair {
    /// The sentence that does not hold without the repair.
    pub sentence: String,
    /// The mistake.
    pub code: Code,
    /// The place of the mistake.
    pub span: Span,
    /// The change, in words and as edits of the spec.
    pub fix: Fix,
}

/// A spec, and the result of verifying it.
#[derive(Clone, Copy, Debug)]
pub struct Verified<'v> {
    /// The text of the spec.
    pub spec: &'v Source,
    /// The plan of this text.
    pub plan: &'v Plan,
    /// The places in the text.
    pub sites: &'v Sites,
    /// The report of `verify` on this plan.
    pub report: &'v Report,
}

/// Returns the repairs of a spec. Each was verified: the sentence holds afterwards, and everything that held before
/// still holds.
pub fn repairs(before: &Verified<'_>, interfaces: &[Source], options: &Options, limits: &Limits<'_>) -> Vec<Repair> {
    let fails = before.report.findings.iter().filter(|finding| finding.verdict == Verdict::Fails);
    let mut repairs = Vec::new();
    for finding in fails.take(FINDINGS_MAX) {
        let Some(diagnostic) = &finding.diagnostic else { continue };
        // A step for which a limit leaves no time has no story. Its author does not want another order of the steps.
        if diagnostic.code == Code::E0812 && finding.story.is_none() {
            continue;
        }
        let candidates = candidates::of(before.spec, before.plan, before.sites, diagnostic).into_iter().take(TRIED_MAX);
        let holds = |fix: &Fix| {
            if !limits.goes_on.goes_on() {
                return false;
            }
            let spec = applied(before.spec, fix);
            let (compiled, sites) = compile_with_sites(&spec, interfaces, options);
            let Some((plan, sites)) = compiled.plan.zip(sites) else { return false };
            // A question that the changed text does not have would not be proved.
            if questions(before.plan, before.sites) != questions(&plan, &sites) {
                return false;
            }
            is_repaired(before.report, &verify(&plan, &sites, limits), finding)
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

/// Returns the subjects of a spec's proofs: its sentences, each with its group; its processes; and its wires.
fn questions(plan: &Plan, sites: &Sites) -> BTreeMap<String, usize> {
    let group = |index: u32| plan.groups.get(index as usize).map_or("", |group| &group.path);
    let sentences = sites.properties.iter().map(|property| format!("{}: {}", group(property.group), property.text));
    let members = plan.groups.iter().flat_map(|group| {
        let name = |member: &Member| format!("{}/{}", group.path, member.name);
        group.members.iter().map(name)
    });
    let wires = plan.wires.iter().map(|wire| plan.ends(wire));
    let mut questions = BTreeMap::new();
    for question in sentences.chain(members).chain(wires) {
        *questions.entry(question).or_default() += 1;
    }
    questions
}

/// Returns whether the second of two reports about the same questions shows a repair: the mistake
/// is gone, no new mistake has appeared, and each decided question is still decided.
fn is_repaired(before: &Report, after: &Report, finding: &Finding) -> bool {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Alone, Always};

    const LIMITS: Limits<'static> = Limits { states: 10_000, memory: 16 << 20, threads: &Alone, goes_on: &Always };

    fn of(spec: &Source) -> (Plan, Sites) {
        let (compiled, sites) = compile_with_sites(spec, &[], &Options::named("spec"));
        compiled.plan.zip(sites).expect("a plan")
    }

    fn questions_of(text: &str) -> BTreeMap<String, usize> {
        let (plan, sites) = of(&Source::new("spec.dca", text));
        questions(&plan, &sites)
    }

    const SPEC: &str = "module Step(host: Host) { done; }
        process main(){
            host{c1}
            instantiated_processes{ a instof Step(c1); b instof Step(c1); }
            internal_event_actions{ a, b }
            verify{ b only after a.done; can finish; can finish; }
        }";

    #[test]
    fn a_sentence_that_has_gone_is_not_repaired() {
        let known = questions_of(SPEC);
        assert_eq!(known, questions_of(&SPEC.replace("a, b }", "a ; b }")), "the same is asked of other event actions");
        assert_ne!(known, questions_of(&SPEC.replace("b only after a.done; ", "")));
        assert_ne!(known, questions_of(&SPEC.replace("b only after", "a only after")));
        assert_ne!(known, questions_of(&SPEC.replacen("can finish; ", "", 1)), "it was asked twice");
        let without = SPEC.replace(" b instof Step(c1);", "").replace("a, b", "a").replace("b only after a.done; ", "");
        assert_ne!(known, questions_of(&without), "nothing is proved of a process that is not there");
    }

    #[test]
    fn repairs_are_of_the_report_that_they_are_given() {
        let spec = Source::new("spec.dca", SPEC.replace("b only after a.done", "eventually b"));
        let (plan, sites) = of(&spec);
        let report = Report { findings: Vec::new(), ..verify(&plan, &sites, &LIMITS) };
        let before = Verified { spec: &spec, plan: &plan, sites: &sites, report: &report };
        assert_eq!(repairs(&before, &[], &Options::named("spec"), &LIMITS), Vec::new());
    }
}
