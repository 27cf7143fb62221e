//! Specs with a gap that a fault reveals, and specs that almost have one. The expectations in their first lines match
//! `dca fmea`.
//!
//! `// row: program | fault | verdict` is a row in some phase, with a story. A fourth part stands in another cell of
//! this row. `// pair:` is one of two faults. `// all: safe, handled` lists all verdicts in the table.

use crate::timers::Chance;
use language::{Options, Source, compile_with_sites};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use verify::{Alone, Always, Faults, Limits, Mission, Report, Row, Severity, Table, Verdict};

const LIMITS: Limits<'static> = Limits { states: 100_000, memory: 64 << 20, threads: &Alone, goes_on: &Always };

fn specs() -> Vec<(String, String)> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/faults");
    let files = std::fs::read_dir(&folder).expect("the folder is there");
    let mut files: Vec<PathBuf> = files.map(|file| file.expect("a file").path()).collect();
    files.sort();
    let read = |file: PathBuf| {
        let name = file.file_stem().expect("a name").to_string_lossy().into_owned();
        (name, std::fs::read_to_string(&file).expect("a text"))
    };
    files.into_iter().map(read).collect()
}

fn looked_at(name: &str, text: &str, limits: &Limits<'_>, faults: Faults) -> Table {
    let source = Source::new(format!("{name}.dca"), text.to_owned());
    let (compiled, sites) = compile_with_sites(&source, &[], &Options::named(name));
    let found = compiled.plan.zip(sites);
    let (plan, sites) = found.unwrap_or_else(|| panic!("{name} does not pass: {:?}", compiled.diagnostics));
    verify::fmea(&plan, &sites, limits, faults)
}

/// Returns the values after `// key:` in the first lines.
fn after<'t>(text: &'t str, key: &str) -> Vec<&'t str> {
    let lines = text.lines().filter_map(|line| line.strip_prefix("// ")?.strip_prefix(key)?.strip_prefix(':'));
    lines.map(str::trim).collect()
}

/// Returns whether a table has a row with these parts.
fn has(table: &Table, row: &str) -> bool {
    let parts: Vec<&str> = row.split('|').map(str::trim).collect();
    let [program, fault, verdict, rest @ ..] = parts.as_slice() else { return false };
    let is_it = |row: &&Row| {
        let cells = row.cells();
        let is_named = [&cells[0], &cells[1], &cells[7]] == [*program, *fault, *verdict];
        is_named && rest.iter().all(|part| cells.iter().any(|cell| cell == part)) && !row.story.steps.is_empty()
    };
    table.rows.iter().any(|row| is_it(&row))
}

#[test]
fn every_row_is_there() {
    let mut verdicts = BTreeSet::new();
    for (name, text) in specs() {
        let table = looked_at(&name, &text, &LIMITS, Faults::One);
        assert!(table.unfinished.is_empty(), "{name}: {:?}", table.unfinished);
        let rows: Vec<String> = table.rows.iter().map(|row| row.cells().join(" | ")).collect();
        for row in after(&text, "row") {
            assert!(has(&table, row), "{name}: no row {row} among\n{}", rows.join("\n"));
        }
        for all in after(&text, "all") {
            let others = table.rows.iter().filter(|row| !all.split(", ").any(|word| word == row.severity.word()));
            assert_eq!(others.count(), 0, "{name}: other verdicts than {all} in\n{}", rows.join("\n"));
        }
        verdicts.extend(table.rows.iter().map(|row| row.severity));
    }
    assert_eq!(verdicts.len(), 8, "every verdict is in some spec: {verdicts:?}");
}

/// No row in which something runs, or may run, is called safe.
#[test]
fn safe_is_where_nothing_runs() {
    for (name, text) in specs() {
        for row in looked_at(&name, &text, &LIMITS, Faults::One).rows {
            let is_safe = row.severity == Severity::Safe;
            assert!(!is_safe || row.running.is_empty(), "{name}: {}", row.cells().join(" | "));
            assert!(is_safe || row.safe_within.is_none(), "{name}: {}", row.cells().join(" | "));
        }
    }
}

#[test]
fn pairs_are_told_where_they_are_worse() {
    let mut count = 0;
    for (name, text) in specs() {
        let wanted = after(&text, "pair");
        if wanted.is_empty() {
            continue;
        }
        let table = looked_at(&name, &text, &LIMITS, Faults::Two);
        let rows: Vec<String> = table.rows.iter().map(|row| row.cells().join(" | ")).collect();
        for row in wanted {
            assert!(has(&table, row), "{name}: no row {row} among\n{}", rows.join("\n"));
            count += 1;
        }
        assert!(table.harmless > 0, "{name}: pairs that are no worse are counted");
    }
    assert!(count > 0);
}

/// A limit leaves out some rows, and the table reports this.
#[test]
fn a_limit_is_told() {
    for (name, text) in specs() {
        for faults in [Faults::One, Faults::Two] {
            let table = looked_at(&name, &text, &Limits { states: 1, ..LIMITS }, faults);
            assert!(!table.unfinished.is_empty(), "{name}");
            assert!(table.rows.is_empty(), "{name}: {:?}", table.rows);
        }
    }
}

/// Returns a mission with an activity of three states. Limits, failures, messages and timers lead from state to state.
fn activity(chance: &mut Chance) -> String {
    let (mut states, mut sentences) = (String::new(), String::new());
    for state in 0..3 {
        let mut target = || {
            ["s0", "s1", "s2", "done", "done", "abort(\"z\")"]
                [usize::try_from(chance.below(6)).expect("a small number")]
        };
        let all = [
            format!("on done -> {};", target()),
            format!("on aborted(timeout) -> {};", target()),
            format!("on aborted -> {};", target()),
            format!("on message cmd -> {};", target()),
            format!("on after 9 s -> {};", target()),
        ];
        let chosen: Vec<&str> = (0..)
            .zip(&all)
            .filter(|(index, _)| *index == 0 || chance.below(2) == 0)
            .map(|(_, it)| it.as_str())
            .collect();
        let limit = if chance.below(3) == 0 { "" } else { " within 5 s" };
        let initial = if state == 0 { "initial " } else { "" };
        states += &format!("    {initial}state s{state} {{ run w{state}{limit}; {} }}\n", chosen.join(" "));
        for (fault, what) in FAULTS.into_iter().flat_map(|fault| MISSION.map(|what| (fault, what))) {
            sentences += &format!("        on {fault} of a.w{state}: {what};\n");
        }
    }
    let around = ["a", "a within 30 s", "(a within 30 s)?", "a else home"]
        [usize::try_from(chance.below(4)).expect("a small number")];
    format!(
        "module Go(host: Host) {{ done; }}
activity A(h: Host){{
    in cmd: Text;
    w0 instof Go(h); w1 instof Go(h); w2 instof Go(h);
{states}}}
process main(){{
    host{{\"c1\"}}
    instantiated_processes{{ a instof A(\"c1\"); home instof Go(\"c1\"); }}
    internal_event_actions{{ {around} ; home }}
    verify{{
{sentences}    }}
}}
"
    )
}

const FAULTS: [&str; 2] = ["crash", "hang"];
/// The sentences about the mission after a fault.
pub(crate) const MISSION: [&str; 3] = ["eventually done", "not done", "not aborted"];

/// Returns which sentences about the mission after a fault are proved. `on` is `on hang of a`.
pub(crate) fn proved(report: &Report, on: &str) -> [bool; 3] {
    MISSION.map(|what| {
        let words = format!("{on}: {what}");
        let found = report.findings.iter().find(|found| found.sentence.ends_with(&words));
        found.unwrap_or_else(|| panic!("no answer to `{words}`")).verdict == Verdict::Proved
    })
}

/// Returns whether a row says something else than the proved sentences about its fault.
pub(crate) fn contradicts(row: &Row, [always_done, never_done, never_fails]: [bool; 3]) -> bool {
    let can_be_done = [Mission::Done, Mission::CanBeDone, Mission::MayFail].contains(&row.mission);
    let fails = [Mission::Fails, Mission::EndsByLimit, Mission::MayFail].contains(&row.mission);
    let is_possible = can_be_done && row.severity != Severity::Stuck;
    always_done && !is_possible || never_done && can_be_done || never_fails && fails
}

/// The rows of `fmea` never contradict the sentences of `verify` about the same fault.
#[test]
fn no_row_of_an_activity_contradicts_a_sentence() {
    let (mut compared, mut proofs) = (0, [0; 3]);
    for seed in 0..150 {
        let text = activity(&mut Chance(seed));
        let (compiled, sites) = compile_with_sites(&Source::new("a.dca", &text), &[], &Options::named("a"));
        let Some((plan, sites)) = compiled.plan.zip(sites) else { continue };
        let report = verify::verify(&plan, &sites, &LIMITS);
        let table = verify::fmea(&plan, &sites, &LIMITS, Faults::One);
        assert!(table.unfinished.is_empty() && !report.is_limited, "{text}");
        compared += 1;
        for (fault, state) in FAULTS.into_iter().flat_map(|fault| (0..3).map(move |state| (fault, state))) {
            let proved = proved(&report, &format!("on {fault} of a.w{state}"));
            let program = format!("a/w{state}");
            for row in table.rows.iter().filter(|row| row.program == program && row.fault == fault) {
                let cells = row.cells().join(" | ");
                assert!(!contradicts(row, proved), "seed {seed}: {cells} but {proved:?} of {MISSION:?}\n{text}");
                (0..3).for_each(|index| proofs[index] += usize::from(proved[index]));
            }
        }
    }
    assert!(compared > 100 && proofs.iter().all(|count| *count > 20), "{compared} specs, proved {proofs:?}");
}
