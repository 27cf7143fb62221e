//! Makes names of the language from foreign names, and texts that fit into one line of a spec.

use std::collections::{BTreeMap, BTreeSet};

/// The most characters of a name that is made.
const NAME_MAX: usize = 60;
/// The most characters of a foreign text in a comment.
const COMMENT_MAX: usize = 300;

/// Words with a meaning at a place where a name of an instance, a state or a variable can stand.
const WORDS: [&str; 49] = [
    "abort",
    "all",
    "always",
    "and",
    "any",
    "as",
    "bool",
    "complete",
    "deep",
    "done",
    "each",
    "else",
    "every",
    "exit",
    "entry",
    "fail",
    "false",
    "final",
    "finally",
    "history",
    "host",
    "in",
    "initial",
    "link",
    "log",
    "main",
    "match",
    "message",
    "never",
    "not",
    "of",
    "on",
    "opaque",
    "or",
    "parallel",
    "race",
    "raise",
    "resume",
    "retry",
    "run",
    "shield",
    "signal",
    "skip",
    "state",
    "suspended",
    "true",
    "using",
    "wait",
    "within",
];

/// The names of one place, each given once.
#[derive(Clone, Debug, Default)]
pub(crate) struct Names {
    taken: BTreeSet<String>,
    /// The next number behind each name, so that a thousand equal names take a thousand steps.
    next: BTreeMap<String, usize>,
}

impl Names {
    /// Takes this name, or this name with the first free number behind it.
    pub(crate) fn take(&mut self, wanted: &str) -> String {
        let is_word = WORDS.contains(&wanted);
        let wanted = if is_word { format!("{wanted}_") } else { wanted.to_owned() };
        let mut name = wanted.clone();
        while !self.taken.insert(name.clone()) {
            let number = self.next.entry(wanted.clone()).or_insert(1);
            *number += 1;
            name = format!("{wanted}_{number}");
        }
        name
    }
}

/// Returns a name of letters, digits and `_`, in the same case: `error.no-way` becomes `error_no_way`.
pub(crate) fn identifier(text: &str) -> String {
    let characters = text.trim().chars().take(NAME_MAX);
    let name: String = characters.map(|found| if found.is_alphanumeric() { found } else { '_' }).collect();
    match name.chars().next() {
        Some(first) if first.is_alphabetic() || first == '_' => name,
        Some(_) => format!("n{name}"),
        None => "unnamed".into(),
    }
}

/// Returns the name of an instance: `ComputePath-Global` becomes `compute_path_global`.
pub(crate) fn snake(text: &str) -> String {
    let mut name = String::new();
    let mut was_small = false;
    for found in identifier(text).chars() {
        if found.is_uppercase() && was_small {
            name.push('_');
        }
        was_small = found.is_lowercase() || found.is_numeric();
        name.extend(found.to_lowercase());
    }
    // The small form of a letter can have characters that no name has.
    identifier(&name)
}

/// Returns the name of a type: `move_base` becomes `MoveBase`.
pub(crate) fn pascal(text: &str) -> String {
    let name = identifier(text);
    let mut parts = name.split('_').filter(|part| !part.is_empty()).peekable();
    if parts.peek().is_none() {
        return "Unnamed".into();
    }
    let name: String = parts
        .map(|part| {
            let mut characters = part.chars();
            let first = characters.next().into_iter().flat_map(char::to_uppercase);
            first.chain(characters).collect::<String>()
        })
        .collect();
    identifier(&name)
}

/// Whether a person cannot see a character, or sees the characters behind it in another order.
pub(crate) fn is_hidden(found: char) -> bool {
    found.is_control()
        || matches!(found, '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}')
}

/// Returns a text in one line without characters that a person cannot see, cut at a length.
pub(crate) fn plain(text: &str) -> String {
    let words: Vec<&str> = text.split_whitespace().collect();
    let line: String = words.join(" ").chars().filter(|found| !is_hidden(*found)).collect();
    match line.char_indices().nth(COMMENT_MAX) {
        Some((end, _)) => format!("{}…", &line[..end]),
        None => line,
    }
}

/// Returns a text in quotes.
pub(crate) fn quoted(text: &str) -> String {
    let line: String = text.chars().map(|found| if is_hidden(found) { ' ' } else { found }).collect();
    format!("\"{}\"", line.replace('\\', "\\\\").replace('"', "\\\""))
}

/// Returns a time as a spec writes it.
pub(crate) fn duration(milliseconds: u64) -> String {
    if milliseconds > 0 && milliseconds.is_multiple_of(60_000) {
        format!("{} min", milliseconds / 60_000)
    } else if milliseconds.is_multiple_of(1_000) {
        format!("{} s", milliseconds / 1_000)
    } else {
        format!("{milliseconds} ms")
    }
}
