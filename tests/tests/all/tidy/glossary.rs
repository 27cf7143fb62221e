//! Checks that the glossary is true: its names are in the code, and the words that it retires are not.

use super::{Strings, check, root, sources, without_comments};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;

/// The chapters of the glossary, each with the room whose code contains its words.
const GLOSSARY: [(&str, &str); 5] = [
    ("## The language", "language"),
    ("## The database", "dbmanager"),
    ("## Messages", "comms"),
    ("## The node", "node"),
    ("## Trust", "trust"),
];

/// Returns the cells of the table below a heading of the glossary, row by row.
fn glossary(heading: &str) -> Vec<Vec<String>> {
    let text = fs::read_to_string(root().join("docs/src/glossary.md")).expect("there is a glossary");
    let chapter = text.lines().skip_while(|line| *line != heading).skip(1).take_while(|line| !line.starts_with("## "));
    let rows = chapter.filter(|line| line.starts_with("| ") && !line.starts_with("|-")).skip(1);
    rows.map(|row| row.trim_matches('|').split('|').map(|cell| cell.trim().to_owned()).collect()).collect()
}

/// Returns the texts in backquotes.
fn quoted(cell: &str) -> Vec<String> {
    cell.split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

/// Returns each identifier in the code of a room, including tests, with the files that contain it.
fn identifiers(room: &str) -> BTreeMap<String, BTreeSet<String>> {
    let mut found: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for source in sources().into_iter().filter(|source| source.path.starts_with(&format!("{room}/"))) {
        let code = without_comments(&source.text, Strings::Emptied);
        for word in code.split(|c: char| !c.is_alphanumeric() && c != '_') {
            found.entry(word.to_owned()).or_default().insert(source.path.clone());
        }
    }
    found
}

#[test]
fn the_glossary_names_what_is_in_the_code() {
    let mut missing = Vec::new();
    for (chapter, room) in GLOSSARY {
        let (rows, known) = (glossary(chapter), identifiers(room));
        assert!(rows.len() >= 20, "{chapter} has {} rows", rows.len());
        let names = rows.iter().flat_map(|row| quoted(row.last().expect("a row has cells")));
        missing.extend(names.filter(|name| !known.contains_key(name)).map(|name| format!("{room}: {name}")));
        let terms: Vec<&String> = rows.iter().map(|row| &row[0]).collect();
        missing.extend(terms.windows(2).filter(|pair| pair[0] >= pair[1]).map(|pair| format!("order: {}", pair[1])));
    }
    check("docs/src/glossary.md names types and functions that there are, its terms in order", &missing);
}

#[test]
fn retired_words_are_gone() {
    let rows = glossary("## Retired words");
    assert!(!rows.is_empty());
    let rooms: BTreeSet<&String> = rows.iter().map(|row| &row[0]).collect();
    let mut left = Vec::new();
    for room in rooms {
        let known = identifiers(room);
        for word in rows.iter().filter(|row| row[0] == *room).flat_map(|row| quoted(&row[1])) {
            left.extend(known.get(&word).into_iter().flatten().map(|path| format!("{path}: {word}")));
        }
    }
    check("the words that docs/src/glossary.md lists as retired are no identifiers of their rooms", &left);
}
