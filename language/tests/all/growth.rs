//! The cost of a text grows at most linearly with its length, for any text.
//!
//! One long text is compared with four of a quarter of it: these cost as much if the work is linear, and a quarter of
//! it if the work is quadratic. Time is the processor time of this thread, so that a loaded machine changes nothing.

use language::{Options, Source, Style, compile, format, render};

/// How much more than four quarters a whole may cost: caches and logarithms, no squares.
const RATIO_MAX: f64 = 2.2;
/// How often both are tried.
const TRIES_MAX: usize = 10;

/// Returns the processor time of this thread so far, in seconds.
fn spent() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").expect("Linux counts it");
    let nanoseconds: f64 = text.split(' ').next().and_then(|first| first.parse().ok()).expect("it is a number");
    nanoseconds * 1e-9
}

/// Reads a text like `dca check`, `dca fmt` and an editor, and renders all diagnostics.
fn work(text: &str) {
    let source = Source::new("long.dca", text);
    let compiled = compile(&source, &[], &Options::named("long"));
    let told = render(&compiled.diagnostics, &source, &[], Style::Plain);
    assert!(told.lines().all(|line| line.len() < 1000), "lines are clipped");
    assert!(told.lines().count() < 10_000, "remarks are limited");
    assert!(format(&source).is_ok() || !compiled.diagnostics.is_empty());
}

fn cost(text: &str, times: usize) -> f64 {
    let began = spent();
    (0..times).for_each(|_| work(text));
    spent() - began
}

#[track_caller]
fn check(what: &str, size: usize, text: &dyn Fn(usize) -> String) {
    let (small, large) = (text(size / 4), text(size));
    // Other work of the machine may make one try slower, and none faster. So each side counts with its quickest try.
    let (mut whole, mut quarters, mut tries) = (f64::MAX, f64::MAX, 0);
    while whole / quarters >= RATIO_MAX || tries == 0 {
        assert!(tries < TRIES_MAX, "{what}: {:.2} after {tries} tries", whole / quarters);
        whole = whole.min(cost(&large, 1));
        quarters = quarters.min(cost(&small, 4).max(0.004));
        tries += 1;
    }
}

/// `count` pieces of text, each with its number.
fn many(count: usize, piece: &dyn Fn(usize) -> String) -> String {
    (0..count).map(piece).collect()
}

fn around(instances: &str, rest: &str, actions: &str) -> String {
    format!("process main() {{ host{{c1}} instantiated_processes {{ {instances} }} {rest} internal_event_actions {{ {actions} }} }}
             module Arm(host) {{ in In: Force; out Out: Force; done; }}")
}

#[test]
fn a_good_spec() {
    check("good", 4000, &|size| {
        let instances = many(size, &|n| format!("arm{n} instof Arm(c1);\n"));
        let wires = many(size - 1, &|n| format!("arm{n}, Out -> arm{}, In;\n", n + 1));
        let actions = many(size, &|n| format!("{}arm{n}", if n > 0 { ", " } else { "" }));
        around(&instances, &format!("internal_connections {{ {wires} }}"), &actions)
    });
}

#[test]
fn garbage() {
    check("braces", 80_000, &|size| "}".repeat(size));
    check("words on one line", 20_000, &|size| many(size, &|n| format!("w{n} ")));
    check("words on many lines", 20_000, &|size| many(size, &|n| format!("w{n}\n")));
    check("signs", 20_000, &|size| "$ ".repeat(size));
    check("strings without end", 20_000, &|size| "\"\n".repeat(size));
    check("open brackets", 20_000, &|size| "process a( { [".repeat(size));
    check("letters", 100_000, &|size| "ö€𝄞".repeat(size));
}

#[test]
fn many_mistakes() {
    let actions = |size: usize, between: &str| many(size, &|n| format!("{}x{n}", if n > 0 { between } else { "" }));
    check("unknown names on one line", 10_000, &|size| around("", "", &actions(size, ",")));
    check("unknown names on many lines", 10_000, &|size| around("", "", &actions(size, ",\n")));
    check("unknown names beside known ones", 6000, &|size| {
        let instances = many(size, &|n| format!("robot{n} instof Arm(c1);\n"));
        around(&instances, "", &many(size, &|n| format!("{}gripper{n}", if n > 0 { ", " } else { "" })))
    });
    check("names in another case", 6000, &|size| {
        let instances = many(size, &|n| format!("robot{n} instof Arm(c1);\n"));
        around(&instances, "", &many(size, &|n| format!("{}Robot{n}", if n > 0 { ", " } else { "" })))
    });
    check("instances twice", 10_000, &|size| around(&"arm instof Arm(c1);\n".repeat(size), "", "arm"));
    check("unknown ports", 6000, &|size| {
        let wires = many(size, &|n| format!("arm, Ouu{n} -> arm, Inn{n};\n"));
        around("arm instof Arm(c1);", &format!("internal_connections {{ {wires} }}"), "arm")
    });
    check("unknown types", 6000, &|size| around(&many(size, &|n| format!("a{n} instof T{n}(c1);")), "", "skip"));
    check("wrong arguments", 6000, &|size| {
        around(&many(size, &|n| format!("a{n} instof Arm(c1, 4, x = {n});")), "", "skip")
    });
    check("constants", 6000, &|size| many(size, &|n| format!("const c{n} = d{n};\n")) + "process main() {}");
    check("processes twice", 6000, &|size| "process main() {}\n".repeat(size));
    check("empty groups", 6000, &|size| {
        many(size, &|n| format!("process g{n}(h) {{ internal_event_actions {{ x }} }}\n"))
    });
}

/// A suggestion compares a name with known names: only a limited number is compared.
#[test]
fn similar_names() {
    check("unknown resources", 6000, &|size| {
        let known = many(size, &|n| format!("{}arm{n}", if n > 0 { ", " } else { "" }));
        let actions = many(size, &|n| format!("{}using(gripper{n}) a", if n > 0 { " ; " } else { "" }));
        around("a instof Arm(c1);", &format!("resource {known};"), &actions)
    });
    check("resources inside of others", 2000, &|size| {
        let names = |from: &str| many(size, &|n| format!("{}{from}{n}", if n > 0 { ", " } else { "" }));
        let (one, other) = (names("arm"), names("hand"));
        around("a instof Arm(c1);", &format!("resource {one}, {other};"), &format!("using({one}) using({other}) a"))
    });
    check("unknown labels", 6000, &|size| {
        let sets = many(size, &|n| format!("internal_connections(arm, set{n}) {{ }}\n"));
        let actions = many(size, &|n| format!("{}arm[label{n}]", if n > 0 { " ; " } else { "" }));
        around("arm instof Arm(c1);", &sets, &actions)
    });
    check("labels that are not written", 6000, &|size| {
        let sets = many(size, &|n| format!("internal_connections(arm, set{n}) {{ }}\n"));
        around("arm instof Arm(c1);", &sets, &many(size, &|n| format!("{}arm", if n > 0 { " ; " } else { "" })))
    });
    check("unknown arrays", 6000, &|size| {
        let arrays = many(size, &|n| format!("robot{n}[1] instof Arm(c1);\n"));
        around(&arrays, "", &many(size, &|n| format!("{}gripper{n}[0]", if n > 0 { ", " } else { "" })))
    });
    check("unknown types beside known ones", 6000, &|size| {
        let groups = many(size, &|n| format!("process Robot{n}() {{ internal_event_actions {{ skip }} }}\n"));
        around(&many(size, &|n| format!("a{n} instof Gripper{n}(c1);\n")), "", "skip") + &groups
    });
    check("unknown types of parameters", 6000, &|size| {
        let types = many(size, &|n| format!("type Robot{n} = Number;\n"));
        types + &many(size, &|n| format!("module M{n}(host, a: Gripper{n}) {{ done; }}\n")) + "process main() {}"
    });
    check("unknown values", 6000, &|size| {
        let consts = many(size, &|n| format!("const robot{n} = 1;\n"));
        consts + &around(&many(size, &|n| format!("a{n} instof Arm(gripper{n});\n")), "", "skip")
    });
    check("unknown outcomes", 3000, &|size| {
        let outcomes = many(size, &|n| format!("{}found{n}", if n > 0 { " | " } else { "" }));
        let arms = many(size, &|n| format!("lost{n} => skip, "));
        around("find instof Find(c1);", "", &format!("find : match {{ {arms} }}"))
            + &format!("module Find(host) {{ done({outcomes}); }}")
    });
}

#[test]
fn many_declarations() {
    check("a value that is handed on and on", 4000, &|size| {
        let groups = many(size, &|n| {
            format!(
                "process G{n}(n) {{ instantiated_processes {{ g instof G{}(n); }} internal_event_actions {{ g }} }}\n",
                n + 1
            )
        });
        let last = format!("process G{size}(n) {{ internal_event_actions {{ wait(n) }} }}\n");
        groups + &last + &around("g instof G0(2 s);", "", "g")
    });
    check("choices of a shape", 4000, &|size| {
        let consts = many(size, &|n| format!("const c{n} = 1;\n"));
        let group = "process G(n) { internal_event_actions { wait(n) ; x } }\n";
        consts + group + &around(&many(size, &|n| format!("g{n} instof G({n} s);\n")), "", "skip")
    });
    check("wires in groups", 3000, &|size| {
        let instances = many(size, &|n| format!("arm{n} instof Arm(c1);\n"));
        let wires =
            many(size - 1, &|n| format!("internal_connections(arm{n}, on) {{ arm{n}, Out -> arm{}, In; }}\n", n + 1));
        around(&instances, &wires, &many(size, &|n| format!("{}arm{n}[on]", if n > 0 { ", " } else { "" })))
    });
}
