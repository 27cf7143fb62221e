//! Compares brute force with `verify`: both give the same verdicts on random small specs with random sentences.

use super::explore::{Graph, Trouble, explore};
use super::random::{Dice, Taste, group};
use super::term::Outcome;
use super::text::text;
use language::algebra::Activity;
use language::plan::{Expression, Plan};
use language::{Options, Source, compile_with_sites};
use std::collections::BTreeSet;
use std::rc::Rc;
use verify::{Alone, Always, Detail, Ending, Limits, Report, Verdict};

/// The result for a seed.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Compared {
    Same,
    /// The check refused the spec, or the spec has too many states for brute force.
    LeftOut,
    Differs(String),
}

/// A sentence about members, each with its name.
#[derive(Clone, Copy, Debug)]
enum Sentence {
    NeverWith(u32, u32),
    Implies(u32, u32),
    OnlyAfter(u32, u32),
    AfterNever(u32, u32),
    AtMostOnce(u32),
    CanFinish,
}

pub(crate) fn compare(seed: u64) -> Compared {
    let mut dice = Dice::new(seed);
    let made = group(&mut dice, Taste::Text);
    let members = u32::try_from(made.members.len()).expect("few members");
    let (a, b) = (dice.below(members), dice.below(members));
    let (a, b) = if a == b { (a, (b + 1) % members) } else { (a, b) };
    let mut sentences = vec![Sentence::AtMostOnce(a), Sentence::CanFinish];
    if a != b {
        sentences.extend([Sentence::NeverWith(a, b), Sentence::Implies(a, b)]);
        sentences.extend([Sentence::OnlyAfter(a, b), Sentence::AfterNever(a, b)]);
    }
    let stated: String = sentences.iter().map(|sentence| format!("        {};\n", words(*sentence))).collect();
    let (text, tags) = text(&made, &stated);
    let source = Source::new("random.dca", text.clone());
    let (compiled, sites) = compile_with_sites(&source, &[], &Options::named("random"));
    let Some((plan, sites)) = compiled.plan.zip(sites) else { return Compared::LeftOut };
    let lowered = Rc::new(plan.groups[0].clone());
    let (Some(rough), Some(calm)) = (explore(&lowered, &tags, Trouble::Any), explore(&lowered, &tags, Trouble::None))
    else {
        return Compared::LeftOut;
    };
    let limits = Limits { states: 200_000, memory: 64 << 20, threads: &Alone, goes_on: &Always };
    let report = verify::verify(&plan, &sites, &limits);
    let mut differences = of_catalogue(&plan, &rough, &report);
    let situations = situations(&rough, plan.groups[0].members.len());
    let flat = verify::flat(&plan, &sites, &limits, Detail::All);
    if situations != flat.situations {
        let (ours, theirs) = (situations.len(), flat.situations.len());
        differences.push(format!("{ours} situations by brute force, {theirs} by verify"));
    }
    for sentence in sentences {
        let words = words(sentence);
        let holds = holds(sentence, &rough, &calm);
        let found = report.findings.iter().find(|found| found.sentence.ends_with(&words));
        let proved = found.map(|found| found.verdict == Verdict::Proved);
        if proved != Some(holds) {
            differences.push(format!("`{words}`: {holds} by brute force, verify says {proved:?}"));
        }
    }
    match differences.is_empty() {
        true => Compared::Same,
        false => Compared::Differs(format!("seed {seed}: {}\n{text}", differences.join("\n"))),
    }
}

/// Returns for each state the activity of every member and the ending of the whole, without duplicates.
fn situations(rough: &Graph, members: usize) -> BTreeSet<(Vec<Activity>, Ending)> {
    let mut situations = BTreeSet::from([(vec![Activity::Idle; members], Ending::Idle)]);
    for seen in rough.seen.iter().skip(1) {
        let mut doing = vec![Activity::Idle; members];
        seen.active.iter().for_each(|&member| doing[member as usize] = Activity::Active);
        seen.stopping.iter().for_each(|&member| doing[member as usize] = Activity::Stopping);
        let ending = match &seen.ended {
            None if seen.is_stopping => Ending::Stopping,
            None => Ending::Running,
            Some(Outcome::Done(_)) => Ending::Done,
            Some(Outcome::Aborted(_)) => Ending::Aborted,
            Some(Outcome::Killed) => Ending::Stopped,
        };
        situations.insert((doing, ending));
    }
    situations
}

/// Asks the questions of the catalogue that one group alone answers.
fn of_catalogue(plan: &Plan, rough: &Graph, report: &Report) -> Vec<String> {
    let has = |code: &str| {
        let diagnostics = report.findings.iter().filter_map(|found| found.diagnostic.as_ref());
        diagnostics.into_iter().any(|diagnostic| format!("{:?}", diagnostic.code) == code)
    };
    let started: Vec<u32> = rough.edges.iter().flatten().flat_map(|edge| edge.starts.clone()).collect();
    let mut named = Vec::new();
    named_in(&plan.groups[0].expression, &mut named);
    let mut differences = Vec::new();
    let mut same = |what: &str, ours: bool, theirs: bool| {
        if ours != theirs {
            differences.push(format!("{what}: {ours} by brute force, {theirs} by verify"));
        }
    };
    same("a member is never started", named.iter().any(|member| !started.contains(member)), has("E0812"));
    let ends = rough.can_reach(|seen| seen.ended.is_some());
    let stuck =
        |is_stopping: bool| (1..ends.len()).any(|state| rough.seen[state].is_stopping == is_stopping && !ends[state]);
    same("a stop has no end", stuck(true), has("E0813"));
    if !super::term::expression(&plan.groups[0]).is_service {
        same("it gets stuck", stuck(false), has("E0811"));
    }
    differences
}

/// Collects the members that an expression names.
fn named_in(expression: &Expression, named: &mut Vec<u32>) {
    if let Expression::Run { member, .. } = expression {
        named.push(*member);
    }
    expression.operands().into_iter().for_each(|operand| named_in(operand, named));
}

fn holds(sentence: Sentence, rough: &Graph, calm: &Graph) -> bool {
    match sentence {
        Sentence::NeverWith(a, b) => !rough.objects(|_, _, seen| {
            let runs = |who: u32| seen.active.contains(&who) || seen.stopping.contains(&who);
            if runs(a) && runs(b) { Err(()) } else { Ok(0) }
        }),
        Sentence::Implies(a, b) => !rough.objects(|_, _, seen| {
            let is_there = seen.active.contains(&b) || seen.stopping.contains(&b);
            if seen.active.contains(&a) && !seen.is_stopping && !is_there { Err(()) } else { Ok(0) }
        }),
        Sentence::OnlyAfter(a, b) => !rough.objects(|note, edge, _| {
            let was = note == 1 || edge.is_done(b);
            if edge.starts.contains(&a) && !was { Err(()) } else { Ok(u8::from(was)) }
        }),
        Sentence::AfterNever(a, b) => !rough.objects(|note, edge, _| {
            let was = note == 1 || edge.is_done(a);
            if edge.starts.contains(&b) && was { Err(()) } else { Ok(u8::from(was)) }
        }),
        Sentence::AtMostOnce(a) => !rough.objects(|note, edge, _| {
            let starts = edge.starts.iter().filter(|&&start| start == a).count();
            match usize::from(note) + starts {
                0 => Ok(0),
                1 => Ok(1),
                _ => Err(()),
            }
        }),
        // A run can be done, and an end is possible from every reachable state.
        Sentence::CanFinish => {
            let is_done = |outcome: &Option<Outcome>| matches!(outcome, Some(Outcome::Done(_)));
            calm.seen.iter().any(|seen| is_done(&seen.ended))
                && calm.can_reach(|seen| seen.ended.is_some()).into_iter().all(|can| can)
        }
    }
}

fn words(sentence: Sentence) -> String {
    match sentence {
        Sentence::NeverWith(a, b) => format!("never m{a} with m{b}"),
        Sentence::Implies(a, b) => format!("always m{a} implies m{b}"),
        Sentence::OnlyAfter(a, b) => format!("m{a} only after m{b}.done"),
        Sentence::AfterNever(a, b) => format!("after m{a}.done: never m{b}"),
        Sentence::AtMostOnce(a) => format!("m{a} at most once"),
        Sentence::CanFinish => "can finish".to_owned(),
    }
}
