//! Finds code that hides a missing concept: structs with many fields, tuples as parameters, and types whose code is in many
//! files.
//!
//! Each rule has a list of exceptions, which may only become shorter. An entry that is no longer needed is also an error.
//! A struct that is wide for a reason states it in the code, in a comment `// Wide: …` above its attributes.

use super::sources::{Source, room};
use super::{Strings, check, sources, without_comments};
use std::collections::{BTreeMap, BTreeSet};

/// The beginning of the comment with the reason why a struct is wide.
const REASON: &str = "// Wide: ";
/// The most fields of a struct.
const FIELDS_MAX: usize = 12;
/// The largest number of files with an `impl` of one type.
const FILES_MAX: usize = 3;
/// The number of functions in each room that have a tuple as a parameter.
const TUPLES: [(&str, usize); 1] = [("python", 2)];
/// Types with an `impl` in more files, and in how many.
const SPREAD: [(&str, usize); 12] = [
    ("language: ActivityReader", 9),
    ("language: Analysis", 11),
    ("language: Parser", 11),
    ("language: Plan", 6),
    ("language: Reaction", 11),
    ("language: Simulation", 5),
    ("language: Walk", 7),
    ("node: Driver", 10),
    ("node: Executer", 6),
    ("verify: System", 7),
    ("verify: Times", 4),
    ("verify: Writer", 4),
];

/// Compares the findings with the exceptions.
#[track_caller]
fn compare(rule: &str, found: &BTreeMap<String, usize>, exceptions: &[(&str, usize)]) {
    let allowed: BTreeMap<&str, usize> = exceptions.iter().copied().collect();
    let mut wrong = Vec::new();
    for (name, count) in found {
        match allowed.get(name.as_str()) {
            Some(allowed) if count < allowed => wrong.push(format!("(\"{name}\", {count}) is the exception now")),
            Some(allowed) if count == allowed => {}
            Some(allowed) => wrong.push(format!("{name}: {count}, where {allowed} are allowed")),
            None => wrong.push(format!("{name}: {count}")),
        }
    }
    let gone = allowed.keys().filter(|name| !found.contains_key(**name));
    wrong.extend(gone.map(|name| format!("{name} needs no exception any more")));
    check(rule, &wrong);
}

fn shipped() -> Vec<Source> {
    // Until `dca new` has filled it in, a template is only text.
    sources().into_iter().filter(|source| source.is_shipped() && !source.path.contains("/templates/")).collect()
}

/// Returns the code without the tests in it. Unlike `Source::code`, it continues after a line that names a file of tests.
fn code(source: &Source) -> String {
    let code = without_comments(&source.text, Strings::Emptied);
    let lines: Vec<&str> = code.lines().collect();
    let is_tests = |pair: &[&str]| pair[0] == "#[cfg(test)]" && pair[1].starts_with("mod ") && pair[1].ends_with('{');
    let end = lines.windows(2).position(is_tests).unwrap_or(lines.len());
    lines[..end].join("\n")
}

/// Returns whether the code states a reason why a struct is wide.
fn is_reasoned(text: &str, name: &str) -> bool {
    let lines: Vec<&str> = text.lines().collect();
    let Some((number, _)) = items(text, "struct").find(|(_, rest)| self::name(rest) == name) else { return false };
    let above = lines[..number].iter().rev().take_while(|line| line.trim_start().starts_with(['#', '/']));
    above.into_iter().any(|line| line.trim_start().starts_with(REASON))
}

/// Returns the name at the beginning of a text.
fn name(text: &str) -> &str {
    text.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or_default()
}

/// Returns the text after a word in each line where the word begins an item.
fn items<'a>(code: &'a str, word: &str) -> impl Iterator<Item = (usize, &'a str)> {
    let word = format!("{word} ");
    code.lines().enumerate().filter_map(move |(number, line)| {
        let line = line.trim_start().trim_start_matches("pub ");
        let line = line.strip_prefix("pub(").and_then(|rest| rest.split_once(") ")).map_or(line, |(_, rest)| rest);
        Some((number, line.strip_prefix(&word)?))
    })
}

/// Returns each struct with its number of fields. The formatter writes each field on its own line.
fn structs(code: &str) -> Vec<(&str, usize)> {
    let lines: Vec<&str> = code.lines().collect();
    let count = |number: usize| {
        let indent = lines[number].len() - lines[number].trim_start().len();
        let inside = lines[number + 1..].iter().take_while(|line| line.trim() != "}" || line.len() > indent + 1);
        let is_field = |line: &&&str| {
            let own = line.len() - line.trim_start().len() == indent + 4;
            own && line.contains(": ") && !line.trim_start().starts_with('#')
        };
        inside.filter(is_field).count()
    };
    let all = items(code, "struct").filter(|(_, rest)| rest.ends_with('{'));
    all.map(|(number, rest)| (name(rest), count(number))).collect()
}

/// Returns the parts of `text` between commas outside of brackets, up to the bracket that closes the text.
fn parameters(text: &str) -> Vec<String> {
    let (mut depth, mut pieces, mut before) = (0_usize, vec![String::new()], ' ');
    for character in text.chars() {
        match character {
            '(' | '[' | '{' | '<' => depth += 1,
            ')' if depth == 0 => break,
            ')' | ']' | '}' => depth -= 1,
            '>' if before != '-' && before != '=' => depth -= 1,
            _ => {}
        }
        if character == ',' && depth == 0 {
            pieces.push(String::new());
        } else {
            pieces.last_mut().expect("there is one").push(character);
        }
        before = character;
    }
    pieces
}

/// Returns the functions that have a tuple as a parameter.
fn functions_with_tuples(code: &str) -> Vec<&str> {
    let mut found = Vec::new();
    for (start, _) in code.match_indices("fn ") {
        let is_word = code[..start].chars().next_back().is_none_or(|c| !c.is_alphanumeric() && c != '_');
        let rest = &code[start + 3..];
        let after = &rest[name(rest).len()..];
        if !is_word || name(rest).is_empty() {
            continue;
        }
        let Some(open) = begin_of_parameters(after) else { continue };
        let is_tuple = |one: &String| {
            let pattern = one.trim_start().trim_start_matches("mut ");
            // `()` contains nothing that could have a name.
            pattern.starts_with('(') && !pattern.starts_with("()")
        };
        if parameters(&after[open + 1..]).iter().any(is_tuple) {
            found.push(name(rest));
        }
    }
    found
}

/// Returns where the parameters begin. If there are generics, this is after them.
fn begin_of_parameters(text: &str) -> Option<usize> {
    let (mut depth, mut before) = (0_usize, ' ');
    for (at, character) in text.char_indices() {
        match character {
            '<' => depth += 1,
            '>' if before != '-' && before != '=' => depth -= 1,
            '(' if depth == 0 => return Some(at),
            _ => {}
        }
        before = character;
    }
    None
}

/// Returns the types that have their own `impl` in this code.
fn implemented(code: &str) -> BTreeSet<&str> {
    let of = |line: &&str| line.starts_with("impl") && line.ends_with('{') && !line.contains(" for ");
    let lines = code.lines().filter(of);
    let types = lines.map(|line| {
        let rest = &line["impl".len()..];
        let rest = if rest.starts_with('<') { rest.split_once("> ").map_or("", |(_, rest)| rest) } else { rest };
        name(rest.trim_start())
    });
    types.collect()
}

#[test]
fn a_struct_has_few_fields() {
    let mut found = BTreeMap::new();
    for source in shipped() {
        let code = code(&source);
        for (name, fields) in structs(&code) {
            // A reason that is not needed any more is also an error.
            if (fields > FIELDS_MAX) != is_reasoned(&source.text, name) {
                found.insert(format!("{}: {name}", source.path), fields);
            }
        }
    }
    compare(
        "a struct above twelve fields lacks a noun: group the fields that change together, or state the reason after `// Wide: `",
        &found,
        &[],
    );
}

#[test]
fn no_parameter_is_a_tuple() {
    let mut found: BTreeMap<String, usize> = BTreeMap::new();
    for source in shipped() {
        let count = functions_with_tuples(&code(&source)).len();
        if let Some((room, _)) = room(&source.path).filter(|_| count > 0) {
            *found.entry(room.to_owned()).or_default() += count;
        }
    }
    compare("a tuple as a parameter has no names at the call: pass values, or a struct", &found, &TUPLES);
}

#[test]
fn a_type_is_in_few_files() {
    let mut files: BTreeMap<String, usize> = BTreeMap::new();
    for source in shipped() {
        let code = code(&source);
        for name in implemented(&code) {
            let room = room(&source.path).map_or("", |(room, _)| room);
            *files.entry(format!("{room}: {name}")).or_default() += 1;
        }
    }
    files.retain(|_, count| *count > FILES_MAX);
    compare("a type with an `impl` in many files lacks a part that owns its state", &files, &SPREAD);
}

#[test]
fn the_reader_of_shapes_is_right() {
    let code = "pub(super) struct A<T> {\n    a: u8,\n    pub b: Vec<(u8, T)>,\n}\nfn f<T: Fn(u8) -> u8>(a: (u8, u8), (b, c): (u8, T)) {}\n\
                fn g(&self, (): (), a: impl Fn((u8, u8)) -> u8) {\n    let f = |(a, b)| a;\n}\nimpl<T> A<T> {\n}\nimpl B for A<u8> {\n}\n";
    assert_eq!(structs(code), [("A", 2)]);
    assert!(!is_reasoned(code, "A"));
    let reasoned = "struct B {\n}\n// Wide: its fields are the keys of a file.\n#[derive(Debug)]\npub struct A {\n}\n";
    assert_eq!(["A", "B"].map(|name| is_reasoned(reasoned, name)), [true, false]);
    assert_eq!(functions_with_tuples(code), ["f"]);
    assert_eq!(implemented(code), BTreeSet::from(["A"]));
}
