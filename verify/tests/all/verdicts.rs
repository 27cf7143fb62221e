//! Sentences that were proved although a run breaks them, or that are proved only in a small part of a large spec.

use language::{Options, Source, compile_with_sites};
use std::fmt::Write as _;
use verify::{Alone, Always, Limits, Verdict};

const LIMITS: Limits<'static> = Limits { states: 100_000, memory: 64 << 20, threads: &Alone, goes_on: &Always };

/// Checks the verdict of each sentence, which is added to the process `verified`.
fn check(spec: &str, verified: &str, sentences: &[(&str, Verdict)]) {
    let mut text = format!("{spec}\nverify {verified} {{\n");
    sentences.iter().for_each(|(sentence, _)| writeln!(text, "    {sentence};").expect("a text"));
    text += "}\n";
    let source = Source::new("test.dca", text.clone());
    let (compiled, sites) = compile_with_sites(&source, &[], &Options::named("test"));
    let (plan, sites) = compiled.plan.zip(sites).unwrap_or_else(|| panic!("{text}\n{:#?}", compiled.diagnostics));
    let found = verify::sentences(&plan, &sites, &LIMITS);
    assert_eq!(found.len(), sentences.len(), "{text}");
    for ((sentence, expected), found) in sentences.iter().zip(&found) {
        assert_eq!(found.verdict, *expected, "{sentence}: {}\n{text}", found.sentence);
    }
}

use Verdict::{Fails, Open, Proved};

const LOOK: &str = "module Look { done(found | missing); } module Step { done; }";

#[test]
fn an_outcome_behind_an_outcome_is_kept() {
    let spec = format!(
        "{LOOK}
        process main(){{
            host{{c1}}
            instantiated_processes{{ look instof Look(c1); STEPS }}
            internal_event_actions{{
                (look as seen) : p => (ask ; (match {{
                    seen q => ((match {{ found => x, missing => y, else => z }}) with q)
                }}) with p)
            }}
        }}"
    )
    .replace("STEPS", &["ask", "x", "y", "z"].map(|name| format!("{name} instof Step(c1);")).join(" "));
    let sentences = [
        ("holds ltl \"G !x\"", Fails),
        ("holds ltl \"G !y\"", Fails),
        ("holds ltl \"G !z\"", Proved),
        ("x only after look.done.found", Proved),
        ("after look.done.missing: never x", Proved),
    ];
    check(&spec, "main", &sentences);
}

#[test]
fn a_group_may_choose_by_the_outcome_that_starts_it() {
    let spec = format!(
        "{LOOK}
        process Choose(){{
            host{{c1}}
            instantiated_processes{{ a instof Step(c1); b instof Step(c1); }}
            internal_event_actions{{ p => ((match {{ found => a, missing => b }}) with p) }}
        }}
        process main(){{
            host{{c1}}
            instantiated_processes{{ look instof Look(c1); g instof Choose(); c instof Step(c1); d instof Step(c1); }}
            internal_event_actions{{ ((look : g) ; c) else d }}
        }}"
    );
    let outside = [
        ("holds ltl \"G !c\"", Fails),
        ("after look.done: never c", Fails),
        ("g.a only after look.done.found", Proved),
        ("after look.done.found: never g.b", Proved),
        ("never g.a with g.b", Proved),
        ("after g.a.done: never d", Fails),
    ];
    check(&spec, "main", &outside);
    check(
        &spec,
        "Choose",
        &[("holds ltl \"G !a\"", Fails), ("never a with b", Proved), ("after a.done: never b", Proved)],
    );
}

#[test]
fn a_spec_with_more_outcomes_than_a_state_can_hold_is_not_decided() {
    let spec = |count: usize| {
        let tags: Vec<String> = (0..count).map(|number| format!("t{number:03}")).collect();
        let last = format!("t{:03} => b", count - 1);
        let arms: String = tags[..count - 1].iter().map(|tag| format!("{tag} => skip, ")).collect();
        format!(
            "module Look {{ done({}); }} module Step {{ done; }}
            process main(){{
                host{{c1}}
                instantiated_processes{{ look instof Look(c1); b instof Step(c1); }}
                internal_event_actions{{ look : match {{ {arms}{last} }} }}
            }}",
            tags.join(" | ")
        )
    };
    check(&spec(255), "main", &[("after look.done: never b", Fails)]);
    check(&spec(256), "main", &[("after look.done: never b", Open)]);
}

#[test]
fn a_service_may_end_against_its_declaration() {
    let spec = "module Watch { service; } module Step { done; }
        process main(){
            host{c1}
            instantiated_processes{ s instof Watch(c1); b instof Step(c1); c instof Step(c1); }
            internal_event_actions{ s else match { service_ended => b, else => c } }
        }";
    check(spec, "main", &[("holds ltl \"G !b\"", Fails), ("b only after s.aborted", Proved)]);
}

#[test]
fn the_end_of_a_run_waits_until_other_runs_have_stopped() {
    let spec = |regions: &str| {
        format!(
            "module Quick {{ done; stop within 1 s; }} module Slow {{ done; stop within 30 s; }}
            activity Act(h: Host){{
                host{{h}}
                a instof Quick(h);
                b instof Quick(h);
                c instof Slow(h);
                {regions}
            }}
            process main(){{
                host{{c1}}
                instantiated_processes{{ act instof Act(c1); }}
                internal_event_actions{{ act }}
            }}"
        )
    };
    // The timer ends `c`. The activity takes the end of `a` only once `c` has stopped.
    let beside = spec(
        "initial parallel state both {
            on a.done -> done;
            state first { initial state x { run c; on after 1 s -> y; } state y { } }
            state second { run a; }
            state third { run b; }
        }",
    );
    let limit = |time| format!("after a.done: b stopped within {time}");
    let (short, long) = (limit("2 s"), limit("10 min"));
    check(&beside, "Act", &[(&short, Fails), (&long, Proved), ("after a.done: b stopped", Proved)]);
    // Nothing runs beside `a`.
    let alone = spec(
        "initial state one { run (a # b); on done -> two; }
        state two { run c; on done -> done; }",
    );
    check(&alone, "Act", &[(&short, Proved)]);
}

#[test]
fn a_pause_takes_as_long_as_the_shortest_timer() {
    let spec = "module Step { done; duration 0 s .. 0 s; }
        process main(){
            host{c1}
            instantiated_processes{ a instof Step(c1); }
            internal_event_actions{ wait(1 ms) ; a }
        }";
    check(spec, "main", &[("finishes within 9 ms", Fails), ("finishes within 10 ms", Proved)]);
}

#[test]
fn a_failure_beside_an_order_to_stop_counts() {
    let spec = |host: &str, first: &str| {
        format!(
            "module Step {{ done; }}
            process Group(){{
                host{{{host}}}
                instantiated_processes{{ p instof Step({host}); }}
                internal_event_actions{{ p }}
            }}
            process main(){{
                host{{c1}}
                instantiated_processes{{
                    g instof Group(); f instof Step({host}); t instof Step(c1); u instof Step(c1); k instof Step(c1);
                }}
                internal_event_actions{{ ({first} # t) ; u }}
            }}"
        )
    };
    let never =
        ["after f.aborted: never u", "after the 1st abort of f: never u", "holds ltl \"G (f.aborted -> G !u)\""];
    // On one host, a program has the order at once.
    check(&spec("c1", "f"), "main", &never.map(|sentence| (sentence, Proved)));
    check(&spec("c2", "f"), "main", &never.map(|sentence| (sentence, Fails)));
    let never = ["after g.aborted: never u", "after the 1st abort of g.p: never u"];
    check(&spec("c1", "g"), "main", &never.map(|sentence| (sentence, Fails)));
    check(&spec("c2", "g"), "main", &never.map(|sentence| (sentence, Fails)));
}

/// A sentence about the members of one group is first checked in this group alone.
#[test]
fn what_holds_in_a_group_alone_has_to_hold_around_it() {
    let spec = |expression: &str| {
        format!(
            "module Step {{ done; }}
            process Group(){{
                host{{c1}}
                instantiated_processes{{ a instof Step(c1); b instof Step(c1); }}
                internal_event_actions{{ b ; a }}
            }}
            process main(){{
                host{{c1}}
                instantiated_processes{{ g instof Group(); t instof Step(c1); }}
                internal_event_actions{{ {expression} }}
            }}"
        )
    };
    let once = [
        ("after g.a.done: never g.b", Proved),
        ("g.a at most once", Proved),
        ("g.a only after g.b.done", Proved),
        ("once g.a runs: never g.b with g.a", Proved),
        ("after the 1st start of g.a: never g.b", Proved),
        ("g.b only after g.a.done", Fails),
    ];
    check(&spec("t ; g"), "main", &once);
    // If the group runs again, one run of it decides nothing about the runs together.
    let again = [
        ("after g.a.done: never g.b", Fails),
        ("g.a at most once", Fails),
        ("g.a only after g.b.done", Proved),
        ("once g.a runs: never g.b with g.a", Proved),
        ("after the 1st start of g.a: never g.b", Fails),
        ("never g.a with g.b", Proved),
    ];
    check(&spec("g ;; t"), "main", &again);
    check(&spec("retry(1) g"), "main", &again[2..4]);
    check(&spec("retry(1) (g ; t)"), "main", &again[..1]);
}
