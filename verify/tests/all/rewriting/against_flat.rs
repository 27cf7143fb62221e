//! Nested groups. `verify` explores groups and pieces separately. This test compares its answers with the whole spec as
//! one system.

use super::random::{Dice, Taste, of_size};
use super::text::written;
use language::algebra::Program;
use language::plan::Group;
use language::{Options, Source, compile_with_sites};
use std::collections::BTreeSet;
use std::fmt::Write as _;
use verify::{
    Alone, Always, Detail, Limits, Report, Transitions, Verdict, flat, transitions_in_order, verify_in_pieces,
};

/// The result for a seed.
#[derive(Debug)]
pub(crate) enum Compared {
    /// The number of sentences that hold, and of those that do not.
    Same(usize, usize),
    /// The check refused the spec, or the spec has too many states.
    LeftOut,
    Differs(String),
}

/// Groups with more configurations than this are divided into pieces. The last number is the default.
const WHOLE: [u64; 3] = [1, 12, 20_000];
const LIMITS: Limits<'static> = Limits { states: 60_000, memory: 128 << 20, threads: &Alone, goes_on: &Always };

#[derive(Clone, Debug)]
enum Sentence {
    NeverWith(String, String),
    OnlyAfter(String, String),
    AfterNever(String, String),
}

impl Sentence {
    fn words(&self) -> String {
        match self {
            Self::NeverWith(a, b) => format!("never {a} with {b}"),
            Self::OnlyAfter(a, b) => format!("{a} only after {b}.done"),
            Self::AfterNever(a, b) => format!("after {a}.done: never {b}"),
        }
    }
}

pub(crate) fn compare(seed: u64) -> Compared {
    let mut dice = Dice::new(seed ^ 0xf1a7);
    let Made { text, programs } = spec(&mut dice);
    let sentences = sentences(&mut dice, &programs);
    let stated: String = sentences.iter().map(|sentence| format!("        {};\n", sentence.words())).collect();
    let text = text.replace("VERIFY", &stated);
    let (compiled, sites) =
        compile_with_sites(&Source::new("random.dca", text.clone()), &[], &Options::named("random"));
    let Some((plan, sites)) = compiled.plan.zip(sites) else { return Compared::LeftOut };
    let all = transitions_in_order(&plan, &sites, &LIMITS);
    if all.reached.is_some() {
        return Compared::LeftOut;
    }
    let (whole, flat) = (Whole::new(&all), flat(&plan, &sites, &LIMITS, Detail::All));
    let is_service = Program::compile(&plan.groups[0]).is_service();
    let mut differences = Vec::new();
    let (mut holds, mut fails) = (0, 0);
    for pieces in WHOLE {
        let report = verify_in_pieces(&plan, &sites, &LIMITS, pieces);
        if report.is_limited {
            return Compared::LeftOut;
        }
        for sentence in &sentences {
            let is_true = whole.holds(sentence);
            if is_true {
                holds += 1;
            } else {
                fails += 1;
            }
            match verdict(&report, &sentence.words()) {
                Some(said) if (said == Verdict::Proved) == is_true => {}
                said => differences.push(format!("{pieces}: {}: {is_true}, verify says {said:?}", sentence.words())),
            }
        }
        let mut same = |what: &str, is_so: bool, code: &str| {
            if is_so != has(&report, code) {
                differences.push(format!("{pieces}: {what}: {is_so}, {code} is said: {}", !is_so));
            }
        };
        same("a program is never started", programs.iter().any(|program| !whole.is_ever_there(program)), "E0812");
        // Even in a group that nothing starts, a stop may never end.
        if flat.stop_hangs || !has(&report, "E0812") {
            same("a stop has no end", flat.stop_hangs, "E0813");
        }
        // A group that waits for such a stop gets no report of its own.
        if !is_service && !has(&report, "E0813") {
            same("it gets stuck", flat.gets_stuck, "E0811");
        }
    }
    match differences.is_empty() {
        true => Compared::Same(holds, fails),
        false => Compared::Differs(format!("seed {seed}\n{}\n{text}", differences.join("\n"))),
    }
}

fn verdict(report: &Report, words: &str) -> Option<Verdict> {
    let is_it = |sentence: &str| sentence.ends_with(&format!(": {words}"));
    report.findings.iter().find(|finding| is_it(&finding.sentence)).map(|finding| finding.verdict)
}

fn has(report: &Report, code: &str) -> bool {
    let diagnostics = report.findings.iter().filter_map(|found| found.diagnostic.as_ref());
    diagnostics.into_iter().any(|diagnostic| format!("{:?}", diagnostic.code) == code)
}

// ---- the spec ----

struct Made {
    /// The text, with `VERIFY` in the place of the sentences.
    text: String,
    /// The names of the programs that an expression uses, as in a sentence.
    programs: Vec<String>,
}

/// Makes a `main` of which some members are groups. Some of their members are groups as well.
fn spec(dice: &mut Dice) -> Made {
    let mut made = Made { text: String::new(), programs: Vec::new() };
    let size = 2 + dice.below(4);
    let main = process(dice, &mut made, (size, 2), ("main", ""));
    let resources = "    resource arm, gripper;\n";
    made.text += &format!("process main(){{\n    host{{c1}}\n{resources}{main}    verify{{\nVERIFY    }}\n}}\n");
    made
}

/// Returns the body of a process of about this size, with this many levels of groups below it. The text gets the
/// processes that the body needs before it.
fn process(dice: &mut Dice, made: &mut Made, (size, levels): (u32, u32), (name, path): (&str, &str)) -> String {
    let (group, expression, matched) = with_programs(dice, size, !path.is_empty());
    let mut instances = String::new();
    for (slot, member) in (0_u32..).zip(&group.members) {
        let (kind, below) = (format!("{name}M{slot}"), format!("{path}m{slot}"));
        let is_run = expression.contains(&format!("m{slot}"));
        let is_group = levels > 0 && is_run && !matched.contains(&slot) && !member.service && dice.one_in(3);
        if is_group {
            let inner = 1 + dice.below(3);
            let body = process(dice, made, (inner, levels - 1), (&kind, &format!("{below}.")));
            made.text += &format!("process {kind}(){{\n    host{{c1}}\n{body}}}\n");
            writeln!(instances, "        m{slot} instof {kind}();").expect("a text");
            continue;
        }
        let ends = match (matched.contains(&slot), member.service) {
            (true, _) => "done(found | missing)",
            (false, true) => "service",
            (false, false) => "done",
        };
        made.text += &format!("module {kind}(host: Host) {{ {ends}; }}\n");
        writeln!(instances, "        m{slot} instof {kind}(c1);").expect("a text");
        if is_run {
            made.programs.push(below);
        }
    }
    format!(
        "    instantiated_processes{{\n{instances}    }}\n    internal_event_actions{{\n        {expression}\n    }}\n"
    )
}

/// Makes a group that runs a program, so that its start is visible. Returns the group, its text, and the members whose
/// outcomes matter. An inner group takes some time, since a closed group counts as one that takes any time.
fn with_programs(dice: &mut Dice, size: u32, is_inside: bool) -> (Group, String, Vec<u32>) {
    loop {
        let group = of_size(dice, Taste::Text, size);
        let mut matched = Vec::new();
        let expression = written(&group.expression, &mut matched);
        let is_instant = ["skip", "fail"].iter().any(|instant| expression.contains(instant));
        if is_inside && is_instant {
            continue;
        }
        if (0..group.members.len()).any(|slot| expression.contains(&format!("m{slot}"))) {
            return (group, expression, matched);
        }
    }
}

fn sentences(dice: &mut Dice, programs: &[String]) -> Vec<Sentence> {
    let mut sentences = Vec::new();
    if programs.len() < 2 {
        return sentences;
    }
    for _ in 0..4 {
        let (a, b) = (dice.pick(programs).clone(), dice.pick(programs).clone());
        if a != b {
            sentences.push(Sentence::NeverWith(a.clone(), b.clone()));
            sentences.push(Sentence::OnlyAfter(a.clone(), b.clone()));
            sentences.push(Sentence::AfterNever(a, b));
        }
    }
    sentences
}

// ---- the whole ----

/// All behaviour of a spec, and for each state the programs that are there. A program is there if an end of it is
/// possible, since any program may fail.
struct Whole<'t> {
    from: Vec<Vec<(&'t str, usize)>>,
    there: Vec<BTreeSet<&'t str>>,
}

impl<'t> Whole<'t> {
    fn new(flat: &'t Transitions) -> Self {
        let states = flat.states as usize;
        let (mut from, mut there) = (vec![Vec::new(); states], vec![BTreeSet::new(); states]);
        for (state, word, target) in &flat.all {
            from[*state as usize].push((word.as_str(), *target as usize));
            let ended = ["done(", "aborted(", "stopped("].iter().find_map(|kind| word.strip_prefix(kind));
            if let Some(rest) = ended {
                there[*state as usize].insert(rest.split([',', ')']).next().unwrap_or_default());
            }
        }
        Self { from, there }
    }

    fn is_ever_there(&self, program: &str) -> bool {
        self.there.iter().any(|there| there.contains(path(program).as_str()))
    }

    fn holds(&self, sentence: &Sentence) -> bool {
        match sentence {
            Sentence::NeverWith(a, b) => {
                let (a, b) = (path(a), path(b));
                !self.there.iter().any(|there| there.contains(a.as_str()) && there.contains(b.as_str()))
            }
            Sentence::OnlyAfter(a, b) => {
                let a = path(a);
                !self.walks(|was, edge| match was {
                    true => Some(true),
                    false if is_done(edge.1, b) => Some(true),
                    false if self.starts(&a, edge) => None,
                    false => Some(false),
                })
            }
            Sentence::AfterNever(a, b) => {
                let b = path(b);
                !self.walks(|was, edge| {
                    let is_after = was || is_done(edge.1, a);
                    if is_after && self.starts(&b, edge) { None } else { Some(is_after) }
                })
            }
        }
    }

    /// Returns whether a transition starts a program: the program runs after the transition. It did not run before, or
    /// it has ended in the same transition.
    fn starts(&self, program: &str, (from, word, to): (usize, &str, usize)) -> bool {
        let ends = || ["done", "aborted", "stopped"].iter().any(|kind| is_word(word, kind, program));
        self.there[to].contains(program) && (!self.there[from].contains(program) || ends())
    }

    /// Returns whether `next` returns `None` somewhere along some way. Otherwise `next` returns the memory for the next
    /// step.
    fn walks(&self, next: impl Fn(bool, (usize, &str, usize)) -> Option<bool>) -> bool {
        let mut seen = vec![[false; 2]; self.from.len()];
        let mut open = vec![(0, false)];
        while let Some((state, was)) = open.pop() {
            if std::mem::replace(&mut seen[state][usize::from(was)], true) {
                continue;
            }
            for &(word, target) in &self.from[state] {
                match next(was, (state, word, target)) {
                    Some(is) => open.push((target, is)),
                    None => return true,
                }
            }
        }
        false
    }
}

/// Returns the path that a program of a sentence has in an export.
fn path(name: &str) -> String {
    name.replace('.', "/")
}

fn is_done(word: &str, program: &str) -> bool {
    is_word(word, "done", &path(program))
}

fn is_word(word: &str, kind: &str, program: &str) -> bool {
    let rest = word.strip_prefix(kind).and_then(|rest| rest.strip_prefix('(')?.strip_prefix(program));
    rest.is_some_and(|rest| rest.starts_with([',', ')']))
}
