//! The laws of the formatter, over the corpus, over every file of `specs/`, over both written in other ways, and over random
//! specs: formatting twice is formatting once, tokens and comments stay, and the plan stays. More random specs by hand:
//! `DCA_FORMAT_CASES=100000 cargo test -p language --test all format::random`

use crate::random;

use crate::shown::shown;
use language::syntax::{SyntaxKind, lex};
use language::{Options, Source, compile, format};
use proptest::prelude::*;
use std::path::{Path, PathBuf};

fn files(folder: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let entries = std::fs::read_dir(folder).expect("a folder of specs");
    let mut files: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    files.retain(|path| path.extension().is_some_and(|extension| extension == "dca" || extension == "interface"));
    files.sort();
    files
}

fn texts() -> Vec<(PathBuf, String)> {
    let files = files("tests/corpus").into_iter().chain(files("../specs"));
    files.map(|path| (path.clone(), std::fs::read_to_string(path).expect("a spec is text"))).collect()
}

/// The tokens that mean something, and the comments.
fn content(text: &str) -> (Vec<String>, Vec<String>) {
    let (mut tokens, mut comments) = (Vec::new(), Vec::new());
    for token in lex(text) {
        let text = &text[token.start as usize..token.end as usize];
        if token.kind == SyntaxKind::Whitespace {
            continue;
        }
        match token.kind.is_trivia() {
            true => comments.push(text.trim_end().to_owned()),
            false => tokens.push(if text == ":;" { ";;".to_owned() } else { text.to_owned() }),
        }
    }
    (tokens, comments)
}

fn plan(text: &str) -> Option<String> {
    compile(&Source::new("a.dca", text), &[], &Options::named("a")).plan.as_ref().map(shown)
}

/// Checks all laws on one text; returns whether it could be read.
fn check(name: &str, text: &str) -> bool {
    let Ok(once) = format(&Source::new(name, text)) else { return false };
    let twice = format(&Source::new(name, &*once)).unwrap_or_else(|found| panic!("{name}: {found:?}\n{once}"));
    assert_eq!(once, twice, "{name} is not formatted at once:\n{text}");
    assert_eq!(content(text), content(&once), "{name} has lost something:\n{text}\n{once}");
    assert_eq!(plan(text), plan(&once), "{name} means something else now");
    for line in once.lines() {
        assert_eq!(line.trim_end(), line, "{name} ends a line with white space");
    }
    true
}

#[test]
fn the_laws_hold_for_every_file() {
    let texts = texts();
    let read = texts.iter().filter(|(path, text)| check(&path.to_string_lossy(), text)).count();
    assert!(read * 2 > texts.len(), "{read} of {} files could be read", texts.len());
}

/// Found by fuzzing: the second `;` is an empty statement, and both together would be the operator `;;`.
#[test]
fn an_empty_statement_stays_apart() {
    let text =
        "process main(){ instantiated_processes{ a instof A(c1); ;b instof B(c1);;; } internal_event_actions{ a } }";
    assert!(check("empty statements", text));
}

#[test]
fn an_ordinal_stays_one_word() {
    let text = "process main() { verify { after the 2nd start of a: never b; assume a takes 2  s .. 3s; } }";
    let formatted = format(&Source::new("a.dca", text)).expect("it can be formatted");
    assert!(formatted.contains("after the 2nd start of a: never b;"), "{formatted}");
    assert!(formatted.contains("takes 2 s..3 s") || formatted.contains("takes 2 s .. 3 s"), "{formatted}");
}

#[test]
fn the_specs_are_formatted() {
    for path in files("../specs") {
        let text = std::fs::read_to_string(&path).unwrap();
        let name = path.to_string_lossy();
        expect_test::expect_file![&path].assert_eq(&format(&Source::new(name, text)).unwrap());
    }
}

/// The texts that are allowed between two tokens without a change of meaning.
const BETWEEN: &[&str] = &[
    " ",
    "  ",
    "\n",
    "\n\n",
    "\n\n\n",
    "\t",
    " // why\n",
    "\n// own\n",
    " /* in */ ",
    "\n/* two\n lines */\n",
    "// a\n// b\n",
];

/// The text with other white space and more comments; `choices` are used in turn.
fn respaced(text: &str, choices: &[usize]) -> String {
    let mut choices = choices.iter().cycle();
    let mut other = String::new();
    for token in lex(text) {
        let word = &text[token.start as usize..token.end as usize];
        if token.kind != SyntaxKind::Whitespace {
            other.push_str(word);
        }
        let choice = choices.next().copied().unwrap_or(0);
        other.push_str(if token.kind.is_trivia() { "\n" } else { BETWEEN.get(choice).unwrap_or(&" ") });
    }
    other
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn the_laws_hold_however_it_is_written(choices in proptest::collection::vec(0_usize..30, 1..60)) {
        for (path, text) in texts() {
            check(&path.to_string_lossy(), &respaced(&text, &choices));
        }
    }
}

/// As many random specs in the suite.
const CASES: u64 = 500;

#[test]
fn the_laws_hold_for_random_specs_with_comments() {
    let cases = std::env::var("DCA_FORMAT_CASES").ok().and_then(|cases| cases.parse().ok()).unwrap_or(CASES);
    let read = (0..cases).filter(|&seed| check(&format!("seed {seed}"), &random::spec(seed))).count() as u64;
    assert!(read * 10 > cases * 9, "{read} of {cases} specs could be read");
}

/// Found by users and by fuzzing: comments are measured where they go.
#[test]
fn comments_that_move_are_measured_where_they_go() {
    let actions = ["(m)/**/:wait/**/(8s);any 4of(/*4 */(m6/* c5 */),m// l6 ß😀\n,//ß😀\nm8,/* c8 */m9)"];
    for actions in actions {
        let text = format!("process main(){{ internal_event_actions{{ {actions} }} }}");
        assert!(check(actions, &text), "{text}");
    }
}
