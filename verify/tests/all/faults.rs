//! Specs with a gap that a fault reveals, and specs that almost have one. The expectations in their first lines match
//! `dca fmea`.
//!
//! `// row: program | fault | verdict` is a row in some phase, with a story. A fourth part stands in another cell of
//! this row. `// pair:` is one of two faults. `// all: safe, handled` lists all verdicts in the table.

use language::{Options, Source, compile_with_sites};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use verify::{Alone, Always, Faults, Limits, Row, Severity, Table};

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
