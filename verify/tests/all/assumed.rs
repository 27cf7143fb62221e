//! A proof is printed with its assumption: after the loss of a host, it may no longer hold that two processes never run
//! at the same time.

use language::{Options, Source, compile_with_sites};
use verify::{Alone, Always, Limits, Report, Verdict};

const LIMITS: Limits<'static> = Limits { states: 100_000, memory: 64 << 20, threads: &Alone, goes_on: &Always };

fn spec(hosts: [&str; 2], policy: &str, expression: &str) -> String {
    let [one, other] = hosts;
    format!(
        "module Step {{ done; }}
        process main(){{
            host{{c1}}
            instantiated_processes{{ a instof Step({one}){policy} b instof Step({other}); }}
            internal_event_actions{{ {expression} }}
            verify{{ never a with b; }}
        }}"
    )
}

fn verified(text: &str) -> (Report, String) {
    let source = Source::new("test.dca", text.to_owned());
    let (compiled, sites) = compile_with_sites(&source, &[], &Options::named("test"));
    let (plan, sites) = compiled.plan.zip(sites).unwrap_or_else(|| panic!("{:?}", compiled.diagnostics));
    let report = verify::verify(&plan, &sites, &LIMITS);
    let told = report.text(&source, &[], language::Style::Plain);
    (report, told)
}

#[test]
fn what_runs_on_a_lost_host_may_run_beside_what_comes_after_it() {
    let keep = " { on_link_loss keep; }";
    let cases = [
        // The step that failed was on the lost host, where it may still run.
        (spec(["c2", "c1"], ";", "a else b"), Some("no host is lost: once `c2` is cut off, both processes may run")),
        (spec(["c2", "c1"], keep, "a else b"), Some("no host is lost: once `c2` is cut off, both processes may run")),
        (spec(["c1", "c2"], ";", "a else b"), None),
        // No process comes after the process on the lost host.
        (spec(["c2", "c1"], ";", "a ; b"), None),
        (spec(["c1", "c1"], ";", "a else b"), None),
        (spec(["c2", "c1"], ";", "using(arm) a else using(arm) b").replace("host{c1}", "host{c1} resource arm;"), None),
    ];
    for (text, expected) in cases {
        let (report, told) = verified(&text);
        let found = report.findings.iter().find(|found| found.sentence.ends_with("never a with b")).expect("an answer");
        assert_eq!(found.verdict, Verdict::Proved, "{told}");
        assert_eq!(found.assumes.as_ref().map(|assumes| assumes.text.as_str()), expected, "{text}\n{told}");
        let is_told = told.contains("proved: main: never a with b\n  as long as no host is lost");
        assert_eq!(is_told, expected.is_some(), "{told}");
        let story = found.assumes.as_ref().and_then(|assumes| assumes.story.as_ref());
        assert_eq!(story.is_some_and(|story| story.running == ["a", "b"]), expected.is_some(), "{story:?}");
    }
}

#[test]
fn a_spec_of_several_hosts_says_that_none_is_lost() {
    let says =
        |hosts| verified(&spec(hosts, ";", "a ; b")).0.assumptions.iter().any(|it| it.contains("no host is lost"));
    assert!(says(["c1", "c2"]));
    assert!(!says(["c1", "c1"]));
}

#[test]
fn the_order_of_timers_is_one_sentence() {
    let plain = spec(["c1", "c1"], ";", "a ; b");
    let ordered = spec(["c1", "c1"], ";", "(a within 5 s) # (b within 3 s)");
    let activity = |text: &str| {
        format!(
            "{text} activity Act(){{ host{{c1}} k instof Step(c1); initial state one {{ run k; on done -> done; }} }}"
        )
        .replace("a instof Step(c1);", "a instof Act();")
    };
    let order = "a timer runs out before a longer one that begins together with it or later";
    let states = "timers of one activity run out in the order of their times";
    let any = "timers may run out in any order";
    let cases = [
        (activity(&plain), format!("{any}, but {states}")),
        (activity(&ordered), format!("{any}, but {order}, and {states}")),
        (ordered, format!("{any}, but {order}")),
        (plain, any.to_owned()),
    ];
    for (text, expected) in cases {
        assert!(verified(&text).0.assumptions.contains(&expected), "{expected}\n{text}");
    }
}

/// A claim about time counts no time for messages. Its proof says so if any messages are in transit.
#[test]
fn times_across_hosts_rest_on_messages_that_take_none() {
    let spec = |[one, other]: [&str; 2], sentence: &str| {
        format!(
            "module Step {{ done; duration 1 s .. 2 s; stop within 1 s; }}
            process Far(){{
                host{{c2}}
                instantiated_processes{{ arm instof Step(c2); }}
                internal_event_actions{{ arm }}
            }}
            process main(){{
                host{{c1}}
                instantiated_processes{{ a instof Step({one}); b instof Step({other}); c instof Step(c1); far instof Far(); }}
                internal_event_actions{{ (a # b) ; c ; far }}
                verify{{ {sentence}; }}
            }}"
        )
    };
    let (here, there) = (["c1", "c1"], ["c1", "c2"]);
    let cases = [
        (spec(here, "finishes within 9 s"), true),
        (spec(there, "stops within 1 s"), true),
        (spec(here, "after a.done: b stopped within 1 s"), false),
        (spec(there, "after a.done: b stopped within 1 s"), true),
        (spec(there, "after b.done: a stopped within 1 s"), true),
        (spec(there, "after a.done: b stopped"), false),
        (spec(there, "after far.arm.done: c stopped within 2 s"), true),
        (spec(here, "on crash of a: c stopped within 3 s"), false),
        (spec(there, "on crash of b: a stopped within 3 s"), true),
        (spec(here, "never a with c"), false),
    ];
    for (text, is_across) in cases {
        let (report, told) = verified(&text);
        let found = report.findings.last().expect("an answer");
        assert_eq!(found.verdict, Verdict::Proved, "{told}");
        let is_said = told.contains("  as long as messages between hosts take no time");
        assert_eq!(is_said, is_across, "{text}\n{told}");
    }
}
