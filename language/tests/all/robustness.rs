//! Damaged texts: never a panic, and few remarks for one damaged token. `--show-output` shows the measured shares.

#![expect(clippy::print_stdout, reason = "the measured figures are for the reader of the test")]

use crate::good_files::good_files;
use language::syntax::lex;
use language::{
    Compiled, Fix, Options, RandomRun, Severity, Simulation, Source, Style, apply_fixes, compile, fix, format, gather,
    graph, render,
};
use proptest::prelude::*;
use std::ops::Range;
use std::sync::OnceLock;

/// The most errors that one damaged token should cost.
const ERRORS_MAX: usize = 2;

fn run(spec: &Source, interfaces: &[Source]) -> Compiled {
    compile(spec, interfaces, &Options::named("test"))
}

/// The places of the tokens that mean something.
fn tokens(text: &str) -> Vec<Range<usize>> {
    let tokens = lex(text).into_iter().filter(|token| !token.kind.is_trivia());
    tokens.map(|token| token.start as usize..token.end as usize).collect()
}

/// The text without one token; white space keeps its neighbours apart.
fn deleted(text: &str, token: &Range<usize>) -> String {
    format!("{} {}", &text[..token.start], &text[token.end..])
}

/// The text with two neighbours exchanged.
fn swapped(text: &str, first: &Range<usize>, second: &Range<usize>) -> String {
    let between = &text[first.end..second.start];
    let (before, after) = (&text[..first.start], &text[second.end..]);
    format!("{before} {} {between} {} {after}", &text[second.clone()], &text[first.clone()])
}

#[derive(Default)]
struct Tally {
    all: usize,
    few: usize,
    worst: (usize, String),
}

impl Tally {
    fn add(&mut self, what: &str, text: String, interfaces: &[Source]) {
        let source = Source::new("damaged", text);
        let compiled = run(&source, interfaces);
        let errors = compiled.diagnostics.iter().filter(|found| found.severity == Severity::Error).count();
        assert_eq!(compiled.plan.is_some(), errors == 0);
        self.all += 1;
        self.few += usize::from(errors <= ERRORS_MAX);
        if errors > self.worst.0 {
            self.worst = (errors, what.to_owned());
        }
    }

    fn check(&self, what: &str) {
        let share = 100.0 * self.few as f64 / self.all as f64;
        println!("{what}: {} of {} texts ({share:.2} %) have at most {ERRORS_MAX} errors", self.few, self.all);
        println!("    worst: {} errors for {}", self.worst.0, self.worst.1);
        assert!(share >= 95.0, "{what}: {share:.2} %");
    }
}

#[test]
fn one_damaged_token_costs_at_most_two_errors() {
    let (mut deletions, mut swaps) = (Tally::default(), Tally::default());
    for (spec, interfaces) in good_files() {
        let text = &spec.text;
        let places = tokens(text);
        let what = |token: &Range<usize>| {
            let place = language::Lines::new(&spec).position(u32::try_from(token.start).unwrap());
            format!("`{}` at {}:{}:{}", &text[token.clone()], spec.name, place.line, place.column)
        };
        for token in &places {
            deletions.add(&format!("deleted {}", what(token)), deleted(text, token), &interfaces);
        }
        for pair in places.windows(2) {
            swaps.add(&format!("swapped {}", what(&pair[0])), swapped(text, &pair[0], &pair[1]), &interfaces);
        }
    }
    deletions.check("deleted");
    swaps.check("swapped");
}

fn applied(text: &str, fix: &Fix) -> String {
    let mut edits: Vec<_> = fix.edits.iter().collect();
    edits.sort_by_key(|edit| std::cmp::Reverse(edit.span.start));
    edits.into_iter().fold(text.to_owned(), |mut text, edit| {
        text.replace_range(edit.span.start as usize..edit.span.end as usize, &edit.text);
        text
    })
}

/// The names in event actions, each misspelt in a few ways: how many carry the fix that restores the text?
#[test]
fn most_misspelt_names_carry_the_right_fix() {
    let (mut all, mut right) = (0_usize, 0_usize);
    for (spec, interfaces) in good_files() {
        let whole = run(&spec, &interfaces);
        let exact = Source::new(&spec.name, apply_fixes(&spec.text, &whole.diagnostics));
        let (text, before) = (&exact.text, run(&exact, &interfaces));
        for token in names_in_actions(text) {
            for misspelt in misspellings(&text[token.clone()]) {
                let damaged = format!("{}{misspelt}{}", &text[..token.start], &text[token.end..]);
                let compiled = run(&Source::new("misspelt", damaged.clone()), &interfaces);
                // A name that may be another one is only offered, to choose from.
                let offered = compiled.diagnostics.iter().flat_map(|found| found.fix.iter().chain(&found.choices));
                let is_right = |fix: &Fix| {
                    let fixed = run(&Source::new("fixed", applied(&damaged, fix)), &interfaces);
                    fixed.plan.is_some() && fixed.plan == before.plan
                };
                all += 1;
                right += usize::from(offered.into_iter().any(is_right));
            }
        }
    }
    let share = 100.0 * right as f64 / all as f64;
    println!("{right} of {all} misspelt names ({share:.2} %) carry the right fix");
    assert!(share >= 80.0, "{share:.2} %");
}

/// The names and labels of at least four letters in the event actions.
fn names_in_actions(text: &str) -> Vec<Range<usize>> {
    let mut names = Vec::new();
    let mut is_inside = false;
    for token in tokens(text) {
        let word = &text[token.clone()];
        is_inside = (is_inside || word == "internal_event_actions") && word != "}";
        let is_name = word.is_ascii() && word.starts_with(|c: char| c.is_ascii_lowercase()) && word.len() >= 4;
        let words = ["internal_event_actions", "else", "within", "retry", "wait", "fail", "skip", "never"];
        if is_inside && is_name && !words.contains(&word) {
            names.push(token);
        }
    }
    names
}

/// A letter lost, doubled, exchanged with the next, or replaced by a look-alike.
fn misspellings(name: &str) -> Vec<String> {
    let middle = name.len() / 2;
    let (head, tail) = name.split_at(middle);
    let letter = &tail[..1];
    let mut misspelt = vec![
        format!("{head}{}", &tail[1..]),
        format!("{head}{letter}{tail}"),
        format!("{}{letter}{}{}", &head[..middle - 1], &head[middle - 1..], &tail[1..]),
        name.replace('l', "1").replace('o', "0"),
    ];
    misspelt.retain(|other| other != name && !other.starts_with(|c: char| c.is_ascii_digit()));
    misspelt
}

#[test]
fn deep_nesting_is_an_error_and_no_overflow() {
    for (open, close) in
        [("(", ")"), ("retry(3) ", ""), ("(a, ", ")"), ("any 1 of (", ")"), ("{", "}"), ("a : (b ;; ", ")")]
    {
        for depth in [10, 70, 100_000] {
            let actions = format!("{}a{}", open.repeat(depth), close.repeat(depth));
            let text = format!(
                "process main() {{ instantiated_processes {{ a instof A(c1); }} internal_event_actions {{ {actions} }} }}"
            );
            let compiled = run(&Source::new("deep", text), &[]);
            assert!(depth < 20 || compiled.plan.is_none(), "{open}");
        }
    }
    for chain in [" ; a", " , a", " # a", " : a", " ;; a", " else a", "?", " within 1 s", " & a"] {
        let text = format!(
            "process main() {{ instantiated_processes {{ a instof A(c1); }} internal_event_actions {{ a{} }} }}",
            chain.repeat(20_000)
        );
        run(&Source::new("long", text), &[]);
    }
    let groups = (0..2000).map(|n| {
        format!(
            "process P{n}() {{ instantiated_processes {{ a instof P{}(); }} internal_event_actions {{ a }} }}\n",
            n + 1
        )
    });
    assert!(run(&Source::new("groups", groups.collect::<String>()), &[]).plan.is_none());
    let doubled = (0..60).map(|n| format!("process P{n}() {{ instantiated_processes {{ a instof P{0}(); b instof P{0}(); }} internal_event_actions {{ a, b }} }}\n", n + 1));
    assert!(run(&Source::new("doubled", doubled.collect::<String>()), &[]).plan.is_none());
    let retries = format!(
        "process main() {{ instantiated_processes {{ a instof A(c1); }} internal_event_actions {{ {}a }} }}",
        "retry(100) ".repeat(40)
    );
    assert!(run(&Source::new("retries", retries), &[]).plan.is_none());
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(400) })]

    /// Any text at all.
    #[test]
    fn no_text_makes_it_panic(text in "\\PC{0,120}") {
        use_everything(&Source::new("any", text));
    }

    /// A good file in which a few tokens are lost, doubled or exchanged for words of the language.
    #[test]
    fn no_damaged_file_makes_it_panic(file in 0_usize..200, changes in proptest::collection::vec((0_usize..500, 0..WORDS.len(), 0..3), 0..4)) {
        static FILES: OnceLock<Vec<(Source, Vec<Source>)>> = OnceLock::new();
        let files = FILES.get_or_init(good_files);
        let (spec, _) = &files[file % files.len()];
        let mut words: Vec<&str> = tokens(&spec.text).into_iter().map(|token| &spec.text[token]).collect();
        for (place, word, change) in changes {
            let place = place % words.len().max(1);
            match change {
                0 if place < words.len() => drop(words.remove(place)),
                1 => words.insert(place, WORDS[word]),
                _ if place < words.len() => words[place] = WORDS[word],
                _ => {}
            }
        }
        use_everything(&Source::new("any", words.join(" ")));
    }

    /// Tokens of the language in any order.
    #[test]
    fn no_tokens_make_it_panic(words in proptest::collection::vec(proptest::sample::select(WORDS), 0..80)) {
        let source = Source::new("any", words.join(" "));
        use_everything(&source);
        let compiled = run(&source, &[]);
        run(&Source::new("fixed", apply_fixes(&source.text, &compiled.diagnostics)), std::slice::from_ref(&source));
    }
}

/// Does with a text all that the command line does.
fn use_everything(source: &Source) {
    let parts = gather(source, &|path| Err(format!("no file `{path}`")));
    let compiled = run(source, &parts);
    render(&compiled.diagnostics, source, &parts, Style::Plain);
    fix(source, &parts, &Options::named("test"));
    if let Ok(once) = format(source) {
        assert_eq!(format(&Source::new("again", &*once)), Ok(once));
    }
    if let (Some(graph), _) = graph(source, &parts, &Options::named("test")) {
        assert!(graph.svg().len() > graph.dot().len() / 10);
    }
    if let Some(plan) = compiled.plan {
        let (mut simulation, mut chance) = (Simulation::start(&plan), RandomRun::new(&plan, 1, 20));
        for _ in 0..50 {
            if simulation.outcome().is_some() || !chance.step(&mut simulation) {
                break;
            }
        }
    }
}

const WORDS: &[&str] = &[
    "const",
    "use",
    "all i in 0..2 (",
    "race",
    "each",
    "[i]",
    "[2]",
    "[l]",
    "claims",
    "latch",
    "queue 3",
    "rate 5 Hz",
    "5 Hz",
    "i",
    "process",
    "module",
    "main",
    "host",
    "instantiated_processes",
    "external_io",
    "internal_connections",
    "internal_event_actions",
    "a",
    "b",
    "instof",
    "(",
    ")",
    "{",
    "}",
    "[",
    "]",
    "<",
    ">",
    ",",
    ";",
    ":",
    ".",
    "#",
    "&",
    "?",
    "=",
    "/",
    "-",
    "->",
    "<-",
    ";;",
    "::",
    "5",
    "0.5e3",
    "s",
    "\"text\"",
    "else",
    "within",
    "retry",
    "wait",
    "fail",
    "any",
    "at",
    "least",
    "of",
    "skip",
    "never",
    "in",
    "out",
    "service",
    "done",
    "exec",
    "stop",
    "push",
    "pull",
    "// x\n",
    "$",
    "\"",
    "process main() {",
    "internal_event_actions {",
    "instantiated_processes {",
    "a instof A(c1);",
    "a, Out -> b, In;",
];
