//! The colours of editors know every word and every unit of the language.

use std::path::Path;

const WORDS: &[&str] = &[
    "process",
    "module",
    "const",
    "type",
    "use",
    "host",
    "instantiated_processes",
    "external_io",
    "internal_connections",
    "internal_event_actions",
    "instof",
    "in",
    "out",
    "optional",
    "service",
    "done",
    "plain",
    "remembers",
    "claims",
    "read",
    "write",
    "exec",
    "stop",
    "push",
    "pull",
    "latch",
    "drop",
    "queue",
    "rate",
    "else",
    "within",
    "retry",
    "pause",
    "match",
    "shield",
    "using",
    "resource",
    "restart",
    "temporary",
    "transient",
    "permanent",
    "watchdog",
    "none",
    "ready",
    "on_agent_loss",
    "on_link_loss",
    "keep",
    "hold",
    "safe_stop_after",
    "memory",
    "cpu",
    "files",
    "nice",
    "realtime",
    "wait",
    "fail",
    "any",
    "of",
    "all",
    "race",
    "skip",
    "never",
    "true",
    "false",
    "ms",
    "min",
    "deg",
    "kHz",
    "Nm",
    "kg",
    "mA",
    "MB",
];

#[test]
fn the_grammar_knows_every_word() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../editors/vscode/syntaxes/dca.tmLanguage.json");
    let grammar = std::fs::read_to_string(path).expect("the grammar is text");
    // `\\b` is a word boundary of the patterns, no letter.
    let grammar = grammar.replace("\\\\b", " ");
    let known: Vec<&str> = grammar.split(|c: char| !c.is_alphanumeric() && c != '_').collect();
    let missing: Vec<&&str> = WORDS.iter().filter(|word| !known.contains(word)).collect();
    assert!(missing.is_empty(), "{missing:?}");
}
