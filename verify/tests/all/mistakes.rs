//! Specs with a mistake, and specs that almost have one. Each spec in `mistakes/bad` is refused for the reason in its
//! first lines, with a story if the mistake has one. No spec in `mistakes/good` is refused. Their author did not
//! write the verifier.

use language::{Options, Severity, Source, compile_with_sites};
use std::collections::BTreeSet;
use std::path::Path;
use verify::{Alone, Always, Finding, Limits, Report, Verdict};

/// The mistakes of the catalogue by their names in the first lines, with their codes and whether they have a story.
const KINDS: [(&str, &str, bool); 7] = [
    ("deadlock", "E0811", true),
    ("lock order", "E0811", true),
    ("unreachable", "E0812", true),
    ("stop without end", "E0813", true),
    ("two owners", "E0814", true),
    ("short limit", "E0815", true),
    ("blind detector", "E0816", true),
];
/// The code of a sentence that does not hold.
const SENTENCE: &str = "E0817";

/// A spec, and the expectations in its first lines.
struct Entry {
    name: String,
    text: String,
    found_by: Option<String>,
    sentences: Vec<String>,
}

fn entries(folder: &str) -> Vec<Entry> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/mistakes").join(folder);
    let mut entries = Vec::new();
    for file in std::fs::read_dir(&folder).expect("the folder is there") {
        let path = file.expect("a file").path();
        let text = std::fs::read_to_string(&path).expect("a text");
        let after = |key: &str| {
            let lines = text.lines().filter_map(move |line| line.strip_prefix("// ")?.strip_prefix(key));
            lines.map(|rest| rest.trim().to_owned()).collect::<Vec<_>>()
        };
        let name = path.file_stem().expect("a name").to_string_lossy().into_owned();
        let (found_by, sentences) = (after("found by:").pop(), after("verify:"));
        entries.push(Entry { name, found_by, sentences, text });
    }
    entries.sort_by(|one, other| one.name.cmp(&other.name));
    entries
}

impl Entry {
    /// Returns the report on the spec with its sentences in a `verify` block.
    fn verified(&self) -> Report {
        let sentences: String = self.sentences.iter().map(|sentence| format!("    {sentence};\n")).collect();
        let text = format!("{}\nverify main {{\n{sentences}}}\n", self.text);
        let source = Source::new(format!("{}.dca", self.name), text);
        let (compiled, sites) = compile_with_sites(&source, &[], &Options::named(self.name.clone()));
        let errors = compiled.diagnostics.iter().filter(|found| found.severity == Severity::Error);
        let errors: Vec<&str> = errors.map(|found| found.message.as_str()).collect();
        let plan = compiled.plan.unwrap_or_else(|| panic!("{} does not pass the check: {errors:?}", self.name));
        let sites = sites.expect("the sites of a plan");
        verify::verify(&plan, &sites, &Limits { states: 100_000, memory: 64 << 20, threads: &Alone, goes_on: &Always })
    }

    /// Returns the difference between the report on the spec and the mistake that the report should contain.
    fn unfound(&self) -> Option<String> {
        let report = self.verified();
        let kind = self.found_by.as_ref().map(|found_by| {
            let kind = KINDS.iter().find(|(kind, ..)| kind == found_by);
            kind.unwrap_or_else(|| panic!("{}: there is no kind {found_by}", self.name))
        });
        let code = kind.map_or(SENTENCE, |(_, code, _)| *code);
        let fails: Vec<&Finding> = report.findings.iter().filter(|found| found.verdict == Verdict::Fails).collect();
        let of_code = |found: &&&Finding| found.diagnostic.as_ref().is_some_and(|it| format!("{:?}", it.code) == code);
        let Some(found) = fails.iter().find(of_code) else {
            return Some(format!("{}: no {code} among {:?}", self.name, sentences(&fails)));
        };
        // Limits of time are sums, and they have no story.
        let is_told = |sentence: &String| !sentence.contains("within");
        let wants_story = kind.map_or(self.sentences.iter().all(is_told), |(.., story)| *story);
        (wants_story && found.story.is_none()).then(|| format!("{}: {code} without a story", self.name))
    }
}

fn sentences<'f>(findings: &[&'f Finding]) -> Vec<&'f str> {
    findings.iter().map(|found| found.sentence.as_str()).collect()
}

#[test]
fn every_mistake_is_found_for_its_reason() {
    let bad = entries("bad");
    assert!(bad.len() >= 40, "only {} specs", bad.len());
    let unfound: Vec<String> = bad.iter().filter_map(Entry::unfound).collect();
    assert!(unfound.is_empty(), "{}", unfound.join("\n"));
}

#[test]
fn nothing_right_is_refused() {
    let good = entries("good");
    assert!(good.len() >= 40, "only {} specs", good.len());
    let mut refused = Vec::new();
    for entry in &good {
        let report = entry.verified();
        let not_proved: Vec<&Finding> = report.findings.iter().filter(|it| it.verdict != Verdict::Proved).collect();
        if !not_proved.is_empty() {
            refused.push(format!("{}: {:?}", entry.name, sentences(&not_proved)));
        }
    }
    assert!(refused.is_empty(), "{}", refused.join("\n"));
}

#[test]
fn each_mistake_says_one_reason() {
    let mut reasons = BTreeSet::new();
    for entry in entries("bad") {
        let count = usize::from(entry.found_by.is_some()) + entry.sentences.len();
        assert_eq!(count, 1, "{} names one property of the catalogue or one sentence", entry.name);
        reasons.extend(entry.found_by.into_iter().chain(entry.sentences));
    }
    assert!(reasons.len() >= 30, "only {} reasons", reasons.len());
}

#[test]
fn nobody_is_said_to_get_a_lock_that_is_kept() {
    for entry in entries("bad").iter().filter(|entry| entry.text.contains("using(")) {
        let report = entry.verified();
        let is_stuck =
            |found: &Finding| found.diagnostic.as_ref().is_some_and(|it| format!("{:?}", it.code) == "E0811");
        let proved: Vec<&Finding> = report.findings.iter().filter(|it| it.verdict == Verdict::Proved).collect();
        if report.findings.iter().any(is_stuck) {
            assert!(!sentences(&proved).iter().any(|it| it.contains("waits for a resource")), "{}", entry.name);
        }
    }
}
