//! Checks that the manual is true: its timings are constants of the code, its steps name functions, and its commands
//! name verbs.

use super::sources::{files, root, sources};
use super::{Source, check};
use std::collections::BTreeSet;
use std::fs;
use std::time::Duration;

/// The pages that follow one thing through the code. Each step has a function.
const WAYS: [&str; 2] = ["crash.md", "value.md"];

fn page(name: &str) -> String {
    fs::read_to_string(root().join("docs/src/inside").join(name)).expect("the page is there")
}

/// Returns the texts between backquotes.
fn quoted(text: &str) -> Vec<&str> {
    text.split('`').skip(1).step_by(2).collect()
}

fn source<'a>(path: &str, sources: &'a [Source]) -> Option<&'a str> {
    sources.iter().find(|source| source.path == path).map(|source| source.text.as_str())
}

/// Parses a time in the form of a page: `1.25 s`, `300 ms`, `2 min`.
fn time(text: &str) -> Option<Duration> {
    let (number, unit) = text.trim().split_once(' ')?;
    let seconds = match unit {
        "ms" => 0.001,
        "s" => 1.0,
        "min" => 60.0,
        "h" => 3600.0,
        _ => return None,
    };
    Some(Duration::from_secs_f64(number.parse::<f64>().ok()? * seconds))
}

/// Returns the value of a constant. It is a duration, or a number of milliseconds if its name says so.
fn constant(name: &str, text: &str) -> Option<Duration> {
    let declared = text.lines().find(|line| line.contains(&format!("const {name}: ")))?;
    let value = declared.split_once(" = ")?.1.trim_end_matches(';');
    let number = |digits: &str| digits.replace('_', "").parse::<u64>().ok();
    let within = |begin: &str| number(value.strip_prefix(begin)?.strip_suffix(')')?);
    let is_millis = name.ends_with("_MS");
    let millis = within("Duration::from_millis(").or_else(|| number(value).filter(|_| is_millis));
    within("Duration::from_secs(").map(Duration::from_secs).or_else(|| millis.map(Duration::from_millis))
}

/// Returns the sum of the constants in a row: `A` + `B` / 4.
fn sum(cell: &str, known: &[(&str, Duration)]) -> Option<Duration> {
    let term = |term: &str| {
        let (name, part) = term.split_once(" / ").unwrap_or((term, "1"));
        let name = name.trim().trim_matches('`');
        let (_, value) = known.iter().find(|(known, _)| *known == name)?;
        Some(*value / part.trim().parse::<u32>().ok()?)
    };
    cell.split(" + ").map(term).sum()
}

#[test]
fn the_timings_of_the_manual_are_those_of_the_code() {
    let (page, sources) = (page("timings.md"), sources());
    let rows = page.lines().filter_map(|line| line.strip_prefix("| ")?.strip_suffix(" |"));
    let rows: Vec<Vec<&str>> = rows.map(|row| row.split(" | ").collect()).collect();
    let (mut known, mut wrong) = (Vec::new(), Vec::new());
    for row in rows.iter().filter(|row| row.len() == 4 && row[0] != "time") {
        let [name, path] = quoted(row[3])[..] else {
            wrong.push(format!("{} does not name a constant and its file", row[3]));
            continue;
        };
        let told = time(row[0]);
        match source(path, &sources).and_then(|text| constant(name, text)) {
            Some(value) if Some(value) == told => known.push((name, value)),
            value => wrong.push(format!("`{name}` in `{path}` is {value:?}, and the page says {}", row[0])),
        }
    }
    for row in rows.iter().filter(|row| row.len() == 3 && row[1] != "time") {
        let value = sum(row[2], &known);
        if value.is_none() || value != time(row[1]) {
            wrong.push(format!("{} is {value:?}, and the page says {}", row[2], row[1]));
        }
    }
    assert!(known.len() > 40, "only {} timings are compared", known.len());
    check("docs/src/inside/timings.md has the times of the constants that it names", &wrong);
}

#[test]
fn the_ways_of_the_manual_name_functions() {
    let (sources, mut wrong, mut steps) = (sources(), Vec::new(), 0);
    for name in WAYS {
        let page = page(name).replace("\n    ", " ");
        let is_step = |line: &&str| line.starts_with(|first: char| first.is_ascii_digit());
        for step in page.lines().filter(is_step) {
            steps += 1;
            let quotes = quoted(step);
            let [path, function, others @ ..] = &quotes[..] else {
                wrong.push(format!("{name}: no function in `{step}`"));
                continue;
            };
            let Some(text) = source(path, &sources) else {
                wrong.push(format!("{name}: there is no `{path}`"));
                continue;
            };
            let others = others.iter().filter_map(|quote| quote.strip_suffix("()"));
            let is_there = |function: &&str| {
                text.contains(&format!("fn {function}(")) || text.contains(&format!("fn {function}<"))
            };
            let missing = std::iter::once(*function).chain(others).filter(|function| !is_there(function));
            wrong.extend(missing.map(|function| format!("{name}: `{path}` has no `{function}`")));
        }
    }
    assert!(steps > 40, "only {steps} steps");
    check("each step of a way through the code names a function that is there", &wrong);
}

/// Returns the verbs of `dca`: the variants of `Verb`, and the other names of these.
fn verbs(sources: &[Source]) -> BTreeSet<String> {
    let declared = |text: &str| {
        let body = text.split("enum Verb {\n").nth(1)?.split("\n}\n").next()?;
        let variants = body.lines().filter_map(|line| line.strip_prefix("    ")?.split_once('('));
        let variants = variants.map(|(name, _)| name.to_lowercase());
        let aliases = body.split("alias = \"").skip(1).filter_map(|rest| rest.split('"').next()).map(str::to_owned);
        Some(variants.chain(aliases).collect::<Vec<_>>())
    };
    let own = sources.iter().filter(|source| source.path.starts_with("cli/src/"));
    own.filter_map(|source| declared(&source.text)).flatten().chain(["help".to_owned()]).collect()
}

#[test]
fn pages_name_verbs_that_are_there() {
    let (verbs, mut wrong) = (verbs(&sources()), Vec::new());
    assert!(verbs.len() > 40, "only {} verbs", verbs.len());
    for (path, file) in files().into_iter().filter(|(path, _)| path.ends_with(".md")) {
        let text = fs::read_to_string(file).expect("a page can be read");
        for (index, line) in text.lines().enumerate() {
            let in_text = quoted(line).into_iter().filter_map(|quote| quote.strip_prefix("dca "));
            let command = line.strip_prefix("$ dca ").or_else(|| line.strip_prefix("dca "));
            for words in in_text.chain(command) {
                let verb = words.split(|c: char| !c.is_ascii_lowercase()).next().unwrap_or_default();
                if !verb.is_empty() && !verbs.contains(verb) {
                    wrong.push(format!("{path}:{}: `dca {verb}`", index + 1));
                }
            }
        }
    }
    check("each verb of `dca` that a page names is there", &wrong);
}
