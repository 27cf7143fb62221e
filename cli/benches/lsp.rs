//! How long an editor waits: `cargo bench -p cli --bench lsp`.
//!
//! Starts the real server, opens a spec of 5,000 lines, and types: a letter at a time, at places all over the text,
//! each sent when the diagnostics of the previous one have arrived. Prints the time from keystroke to diagnostics, and
//! the processor time of the server. The second spec has about 1,000 mistakes.

#![expect(clippy::print_stdout, reason = "the figures are the result")]

#[expect(dead_code, reason = "the tests need more of it")]
#[path = "../tests/all/lsp/editor.rs"]
mod editor;

use editor::Editor;
use serde_json::json;
use std::time::{Duration, Instant};

const LINES: usize = 5000;
const KEYSTROKES: usize = 1000;

/// A spec of many groups, each used once, with connections and event actions. `output` is the port that each connection
/// names.
fn spec(output: &str) -> String {
    let (mut text, mut main, mut actions) = (String::new(), String::new(), Vec::new());
    while text.lines().count() + 2 * actions.len() + 6 < LINES {
        let n = actions.len();
        text += &format!("// Group {n}\nprocess Group{n}(host1){{\n    host{{host1}}\n    instantiated_processes{{\n");
        for leaf in 0..8 {
            text += &format!("        leaf{leaf} instof Leaf(host1, {leaf} ms);\n");
        }
        text += "    }\n";
        for leaf in 0..7 {
            let next = leaf + 1;
            text += &format!(
                "    internal_connections(leaf{leaf}, set{leaf}){{\n        leaf{leaf}, {output} -> leaf{next}, In;\n    }}\n"
            );
        }
        text += "    internal_event_actions{\n        (leaf0[set0], leaf1[set1], leaf2[set2]) #\n            (leaf3[set3] ; leaf4[set4] ; leaf5[set5]) #\n            (leaf6[set6], leaf7)\n    }\n}\n\n";
        main += &format!("        g{n} instof Group{n}(c1);\n");
        actions.push(format!("g{n}"));
    }
    text += "module Leaf(host, wait: Time) { in In: Number optional; out Out: Number; done; }\n";
    let actions = actions.join(" ;\n        ");
    text + &format!(
        "process main(){{\n    instantiated_processes{{\n{main}    }}\n    internal_event_actions{{\n        {actions}\n    }}\n}}\n"
    )
}

fn percentile(sorted: &[Duration], of: usize) -> f64 {
    let place = (sorted.len() * of).div_ceil(1000).max(1) - 1;
    sorted[place].as_secs_f64() * 1e3
}

#[expect(clippy::disallowed_methods, reason = "a benchmark measures")]
fn now() -> Instant {
    Instant::now()
}

/// Returns the processor time of all threads of a process (Linux: the first number of `schedstat`, in nanoseconds).
fn processor_time(pid: u32) -> Duration {
    let threads = std::fs::read_dir(format!("/proc/{pid}/task")).expect("the server runs");
    let spent = threads.filter_map(|thread| std::fs::read_to_string(thread.ok()?.path().join("schedstat")).ok());
    spent.filter_map(|text| text.split(' ').next()?.parse().ok()).map(Duration::from_nanos).sum()
}

fn main() {
    measure("without a mistake", &spec("Out"));
    measure("with 1,000 mistakes", &spec("Outt"));
}

fn measure(what: &str, text: &str) {
    let lines = u32::try_from(text.lines().count()).expect("the spec is short");
    let uri = "untitled:bench";
    let mut editor = Editor::ready("true", &json!({}));
    editor.open(uri, text);
    editor.ask("textDocument/foldingRange", &json!({"textDocument": {"uri": uri}}));
    let (mut times, mut spent) = (Vec::new(), Vec::new());
    for (keystroke, version) in (0..KEYSTROKES).zip(2_i64..) {
        // The letters of a name that means nothing yet, at the end of a line somewhere; then they go again.
        let line = u32::try_from(keystroke / 8).unwrap_or(0).wrapping_mul(997) % lines;
        let (typed, column) = (keystroke % 8 < 4, u32::try_from(keystroke % 4).unwrap_or(0));
        let column = if typed { column } else { 3 - column };
        let end = if typed { column } else { column + 1 };
        let range = json!({"start": {"line": line, "character": column}, "end": {"line": line, "character": end}});
        let change = json!({"range": range, "text": if typed { "q" } else { "" }});
        let (start, before) = (now(), processor_time(editor.server.id()));
        editor.change(uri, version, &change);
        editor.diagnostics(uri, version);
        times.push(start.elapsed());
        spent.push(processor_time(editor.server.id()).saturating_sub(before));
    }
    let told = |times: &mut Vec<Duration>| {
        times.sort_unstable();
        let (p50, p99, worst) = (percentile(times, 500), percentile(times, 990), percentile(times, 1000));
        format!("p50 {p50:.1} ms, p99 {p99:.1} ms, worst {worst:.1} ms")
    };
    println!("{lines} lines {what}, {KEYSTROKES} keystrokes, one at a time: {}", told(&mut times));
    println!("    processor time: {} (reach: p99 20 ms)", told(&mut spent));
    assert!(editor.end().success(), "the server ends well");
}
