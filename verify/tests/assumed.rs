//! What a proof rests on stands beside it: that two never run at the same time may not hold any more once a host is lost.

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
        (spec(["c2", "c1"], ";", "a else b"), Some("no host is lost: once `c2` is cut off, both may run")),
        (spec(["c2", "c1"], keep, "a else b"), Some("no host is lost: once `c2` is cut off, both may run")),
        (spec(["c1", "c2"], ";", "a else b"), None),
        // Nothing comes after it.
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
