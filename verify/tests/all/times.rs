//! The longest time of a mission: `finishes within` holds for that time, and for no shorter one.

use language::{Options, Source, compile_with_sites};
use verify::{Alone, Always, Limits, Verdict};

const LIMITS: Limits<'static> = Limits { states: 100_000, memory: 64 << 20, threads: &Alone, goes_on: &Always };

/// `a` and `b` have unknown durations and take 2 s to stop. `quick` and `slow` have known durations. `watch` is a
/// service that takes 3 s to stop.
fn holds(expression: &str, limit: &str) -> bool {
    let text = format!(
        "module Step {{ done; stop within 2 s; }}
        module Quick {{ done; duration 1 s .. 3 s; stop within 2 s; }}
        module Slow {{ done; duration 8 s .. 9 s; stop within 1 s; }}
        module Watch {{ service; stop within 3 s; }}
        process main(){{
            host{{c1}}
            instantiated_processes{{
                a instof Step(c1); b instof Step(c1); quick instof Quick(c1); slow instof Slow(c1); watch instof Watch(c1);
            }}
            internal_event_actions{{ {expression} }}
            verify{{ finishes within {limit}; }}
        }}"
    );
    let source = Source::new("test.dca", text);
    let (compiled, sites) = compile_with_sites(&source, &[], &Options::named("test"));
    let (plan, sites) = compiled.plan.zip(sites).unwrap_or_else(|| panic!("{:?}", compiled.diagnostics));
    let found = verify::sentences(&plan, &sites, &LIMITS);
    found.iter().all(|finding| finding.verdict == Verdict::Proved)
}

#[test]
fn it_finishes_within_what_it_takes_and_not_sooner() {
    let cases = [
        ("quick", 3),
        // The process is done before the limit passes, so nothing is stopped.
        ("quick within 5 s", 3),
        // The limit passes, and then the step takes its time to stop.
        ("a within 5 s", 7),
        ("quick within 2 s", 4),
        // A process that exceeds its limit fails, so nothing follows it.
        ("a within 5 s ; b within 5 s", 12),
        ("a within 5 s ; quick", 8),
        ("a within 5 s ; skip", 7),
        // The first one fails at once, or at the limit, and then the other begins.
        ("a within 5 s else quick", 10),
        ("(a within 5 s else quick) ; quick", 13),
        ("(a within 5 s) finally quick", 10),
        // The slow process may fail before the other is done, and then the other is stopped.
        ("quick # slow", 5),
        // The race is never done before that.
        ("(quick # slow) ; quick", 7),
        ("a # wait(5 s)", 7),
        ("(quick # wait(5 s)) ; quick", 6),
        // At the end, the service is stopped. If the service fails, the step is also stopped.
        ("watch, quick", 6),
        ("(watch, quick) ; quick", 9),
        ("quick, slow", 9),
        ("quick & slow", 11),
        ("any 1 of (quick, slow)", 11),
        ("shield(4 s) (a within 5 s) ; quick", 8),
    ];
    for (expression, most) in cases {
        assert!(holds(expression, &format!("{most} s")), "`{expression}` takes at most {most} s");
        assert!(!holds(expression, &format!("{} ms", 1000 * most - 1)), "`{expression}` may take {most} s");
    }
}

#[test]
fn nothing_bounds_what_has_no_limit() {
    for expression in
        ["a", "a ; quick", "a, quick", "never # never", "a # b", "quick ;; quick", "watch", "a else quick"]
    {
        assert!(!holds(expression, "9000 s"), "{expression}");
    }
}

/// Returns whether `verify` proves that `p` stops within this many seconds on the lost host. The supervisor of `p` is
/// on another host.
fn stops_after_loss(policy: &str, limit: u32) -> bool {
    let text = format!(
        "module Watch {{ service; stop within 3 s; }}
        module Step {{ done; }}
        process main(){{
            host{{c1}}
            instantiated_processes{{ p instof Watch(c2){policy} a instof Step(c1); }}
            internal_event_actions{{ p # a }}
            verify{{ on loss of host(c2): p stopped within {limit} s; }}
        }}"
    );
    let source = Source::new("test.dca", text);
    let (compiled, sites) = compile_with_sites(&source, &[], &Options::named("test"));
    let (plan, sites) = compiled.plan.zip(sites).unwrap_or_else(|| panic!("{:?}", compiled.diagnostics));
    verify::sentences(&plan, &sites, &LIMITS).iter().all(|finding| finding.verdict == Verdict::Proved)
}

/// The node notes the loss after 7 s, and the stop takes 3 s. A process with rules of its own stops up to 2 s after
/// its stated time, and not before its node misses the host after 3.5 s.
#[test]
fn what_is_cut_off_stops_by_its_own_rules() {
    let policies = [
        (";", 10),
        (" { on_link_loss safe_stop_after 10 s; }", 15),
        (" { on_link_loss safe_stop_after 2 s; }", 7),
        (" { on_link_loss safe_stop_after 10 ms; }", 7),
    ];
    for (policy, least) in policies {
        assert!(stops_after_loss(policy, least), "`{policy}`: {least} s");
        assert!(!stops_after_loss(policy, least - 1), "`{policy}`: {} s", least - 1);
    }
}

#[test]
fn the_step_without_a_limit_is_named() {
    let text = "module Step { done; }
        module Quick { done; duration 1 s .. 3 s; }
        process Part(){
            instantiated_processes{ quick instof Quick(c1); drill instof Step(c1); }
            internal_event_actions{ quick ; drill }
        }
        process main(){
            host{c1}
            instantiated_processes{ quick instof Quick(c1); part instof Part(); weld instof Quick(c1) { restart transient; } }
            internal_event_actions{ EXPRESSION }
            verify{ finishes within 1 min; }
        }";
    let told = |expression: &str| {
        let source = Source::new("test.dca", text.replace("EXPRESSION", expression));
        let (compiled, sites) = compile_with_sites(&source, &[], &Options::named("test"));
        let (plan, sites) = compiled.plan.zip(sites).unwrap_or_else(|| panic!("{:?}", compiled.diagnostics));
        let found = verify::sentences(&plan, &sites, &LIMITS);
        let help = found.iter().filter_map(|finding| finding.diagnostic.as_ref()).flat_map(|found| found.help.clone());
        help.collect::<Vec<_>>().join("; ")
    };
    let cases = [
        ("quick ; part", "nothing limits how long `part/drill` takes: write `drill within 30 s`, declare"),
        ("weld ; quick", "nothing limits how long `weld` takes, which is started again as often as it dies"),
        ("quick ;; skip", "nothing limits how long `main` takes: a part of it repeats"),
    ];
    for (expression, expected) in cases {
        assert!(told(expression).contains(expected), "{expression}: {}", told(expression));
    }
}
