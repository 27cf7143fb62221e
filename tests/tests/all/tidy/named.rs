//! Checks that tests and sources named as proof in pages exist.

use super::sources::{files, sources};
use std::fs;

/// Returns the texts between backquotes in a page with their line numbers.
fn quoted(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let of_line = |line| str::split(line, '`').skip(1).step_by(2);
    text.lines().enumerate().flat_map(move |(index, line)| of_line(line).map(move |quote| (index + 1, quote)))
}

fn is_name(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'_')
}

/// Returns the error in a quote that names a source, or a test in one: `path.rs`, `path.rs::test`, or only `test` in
/// a table of tests.
fn problem(quote: &str, in_table: bool, sources: &[super::Source]) -> Option<String> {
    let has = |test: &str, source: &super::Source| source.text.contains(&format!("fn {test}("));
    let (path, test) = match quote.split_once(".rs::") {
        Some((path, test)) => (format!("{path}.rs"), Some(test)),
        None if quote.ends_with(".rs") && (in_table || quote.contains('/')) => (quote.to_owned(), None),
        None => {
            let is_test = in_table && is_name(quote) && quote.matches('_').count() > 2;
            let is_there = || sources.iter().any(|source| has(quote, source));
            return (is_test && !is_there()).then(|| format!("there is no test `{quote}`"));
        }
    };
    if !path.trim_end_matches(".rs").split('/').all(|part| is_name(&part.replace('-', "_"))) {
        return None;
    }
    let named = |source: &&super::Source| source.path == path || source.path.ends_with(&format!("/{path}"));
    let mut there = sources.iter().filter(named).peekable();
    if there.peek().is_none() {
        return Some(format!("there is no source `{path}`"));
    }
    let test = test.filter(|test| is_name(test))?;
    (!there.any(|source| has(test, source))).then(|| format!("`{path}` has no test `{test}`"))
}

#[test]
fn sources_and_tests_that_pages_name_are_there() {
    let sources = sources();
    let mut wrong = Vec::new();
    let is_page = |path: &str| path.ends_with(".md") && path != "CHANGELOG.md";
    for (path, file) in files().into_iter().filter(|(path, _)| is_page(path)) {
        let text = fs::read_to_string(file).expect("a page can be read");
        for (line, quote) in quoted(&text) {
            wrong.extend(
                problem(quote, path == "docs/src/faults.md", &sources).map(|why| format!("{path}:{line}: {why}")),
            );
        }
    }
    super::check("a page names tests and sources that are there", &wrong);
}
