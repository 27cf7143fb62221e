//! The sources of the workspace as text. If a rule requires it, this is without comments or the contents of strings.

use super::{FLOORS, IMPURE, PURE, dependencies, names};
use std::fs;
use std::path::{Path, PathBuf};

/// A source file.
pub(super) struct Source {
    /// From the root of the workspace.
    pub(super) path: String,
    /// The unchanged text.
    pub(super) text: String,
}

impl Source {
    /// Returns whether the file belongs to the room's own code, and not to tests, examples or benchmarks.
    pub(super) fn is_shipped(&self) -> bool {
        let Some((room, rest)) = room(&self.path) else { return false };
        rest.starts_with("src/") && room != "tests" && !rest.split('/').any(|part| part.starts_with("tests"))
    }

    /// Returns the code line by line, starting with line 1, without comments and without the tests at the end. Strings are
    /// kept or emptied.
    pub(super) fn code(&self, strings: Strings) -> Vec<(usize, String)> {
        let code = without_comments(&self.text, strings);
        code.lines().map(str::to_owned).enumerate().map(|(index, line)| (index + 1, line)).take(self.length()).collect()
    }

    /// Returns the number of lines before the tests.
    pub(super) fn length(&self) -> usize {
        let lines: Vec<&str> = self.text.lines().collect();
        let is_test = |line: &str| line == "#[cfg(test)]" || line.starts_with("#[cfg(all(test, ");
        let is_tail = |pair: &[&str]| is_test(pair[0]) && pair[1].contains("mod ");
        lines.windows(2).position(is_tail).unwrap_or(lines.len())
    }

    pub(super) fn is_pure(&self) -> bool {
        let logic = self.path.split('/').any(|part| part == "logic" || part == "logic.rs");
        let listed = |paths: &[&str]| paths.iter().any(|path| self.path.starts_with(path));
        self.is_shipped() && (logic || listed(&PURE)) && !listed(&IMPURE)
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Strings {
    Kept,
    Emptied,
}

pub(super) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the crate is a folder of the workspace").to_owned()
}

/// Returns the folder of a file's room, and the rest of its path.
pub(super) fn room(path: &str) -> Option<(&'static str, &str)> {
    let within = |room: &'static str| Some((room, path.strip_prefix(room)?.strip_prefix('/')?));
    FLOORS.iter().filter_map(|(room, _)| within(room)).max_by_key(|(room, _)| room.len())
}

/// Returns every file of the workspace with its path from the root.
pub(super) fn files() -> Vec<(String, PathBuf)> {
    let root = root();
    let (mut found, mut folders) = (Vec::new(), vec![root.clone()]);
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("the workspace can be listed") {
            let path = entry.expect("the workspace can be listed").path();
            let name = path.strip_prefix(&root).ok().and_then(Path::to_str).expect("every name is text").to_owned();
            if path.is_dir() {
                if !["target", "runs", ".git", "fuzz/target", "fuzz/corpus", "docs/book"].contains(&name.as_str()) {
                    folders.push(path);
                }
            } else {
                found.push((name, path));
            }
        }
    }
    found.sort();
    found
}

pub(super) fn sources() -> Vec<Source> {
    let is_source = |path: &String| path.ends_with(".rs");
    let read = |(path, file): (String, PathBuf)| Source {
        path,
        text: fs::read_to_string(file).expect("a source can be read"),
    };
    files().into_iter().filter(|(path, _)| is_source(path)).map(read).collect()
}

/// Returns `text` with spaces instead of comments. If requested, strings are emptied. All lines stay in their places.
pub(super) fn without_comments(text: &str, strings: Strings) -> String {
    let mut code = String::with_capacity(text.len());
    let mut rest = text;
    while let Some(first) = rest.chars().next() {
        let length = if rest.starts_with("//") {
            rest.find('\n').unwrap_or(rest.len())
        } else if rest.starts_with("/*") {
            rest.find("*/").map_or(rest.len(), |end| end + 2)
        } else if let Some(length) = string_length(rest) {
            if strings == Strings::Kept {
                code.push_str(&rest[..length]);
                rest = &rest[length..];
                continue;
            }
            length
        } else {
            // A quote in a character literal does not begin a string.
            let length = ["'\"'", "'\\''", "'\\\"'"]
                .iter()
                .find(|literal| rest.starts_with(**literal))
                .map(|literal| literal.len());
            let length = length.unwrap_or(first.len_utf8());
            code.push_str(&rest[..length]);
            rest = &rest[length..];
            continue;
        };
        code.extend(rest[..length].chars().filter(|character| *character == '\n'));
        code.push(' ');
        rest = &rest[length..];
    }
    code
}

/// Returns the length of the string literal at the beginning of `text`.
pub(super) fn string_length(text: &str) -> Option<usize> {
    if let Some(raw) = text.strip_prefix('r') {
        let hashes = raw.bytes().take_while(|byte| *byte == b'#').count();
        if raw[hashes..].starts_with('"') {
            let close = format!("\"{}", "#".repeat(hashes));
            let body = &raw[hashes + 1..];
            return Some(1 + hashes + 1 + body.find(&close).map_or(body.len(), |end| end + close.len()));
        }
    }
    let body = text.strip_prefix('"')?;
    let mut escaped = false;
    for (index, byte) in body.bytes().enumerate() {
        match byte {
            _ if escaped => escaped = false,
            b'\\' => escaped = true,
            b'"' => return Some(index + 2),
            _ => {}
        }
    }
    Some(text.len())
}

#[test]
fn the_reader_of_sources_is_right() {
    let code = "let a = \"// no\"; // yes \"\nlet b = '\"'; /* x\ny */ let c = r#\"a\"b\"#;\nd(\"\\\"//\");";
    assert_eq!(
        without_comments(code, Strings::Kept),
        "let a = \"// no\";  \nlet b = '\"'; \n  let c = r#\"a\"b\"#;\nd(\"\\\"//\");"
    );
    assert_eq!(without_comments(code, Strings::Emptied), "let a =  ;  \nlet b = '\"'; \n  let c =  ;\nd( );");
    assert!(names("use tokio::x", "tokio") && names("a tokio", "tokio") && names("std::fs::read", "fs::"));
    assert!(!names("use tokios::x", "tokio") && !names("offs::x", "fs::") && !names("eprintln!()", "println!"));
    let source = Source { path: "a/src/b.rs".to_owned(), text: "one\n#[cfg(test)]\nmod tests {\n".to_owned() };
    assert_eq!(source.length(), 1);
    assert_eq!(
        dependencies("[package]\na = 1\n[dependencies]\nb.workspace = true\n\n[dev-dependencies]\nc = \"1\"\n"),
        ["b", "c"]
    );
}
