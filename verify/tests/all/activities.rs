//! Activities: guards and finite variables are exact, messages may come at any time, and mistakes in activities are found.

use language::sites::Sites;
use language::{Options, Source, compile_with_sites};
use verify::{Alone, Always, Limits, Report, Verdict, verify};

const LIMITS: Limits<'static> = Limits { states: 100_000, memory: 64 << 20, threads: &Alone, goes_on: &Always };

const MODULES: &str = "
module Work(host) { done(found | missing); }
module Go(host) { done; }
module Arm(host) { done; claims arm; }
";

/// Returns a spec whose activity has this body.
fn spec(body: &str) -> String {
    format!(
        "{MODULES}
activity A(h: Host){{
    in orders: Text;
    look instof Work(h);
    walk instof Go(h);
    one instof Arm(h);
    two instof Arm(h);
    var tries: 0..3 = 0;
    {body}
}}
process main(){{
    host{{\"c1\"}}
    instantiated_processes{{ a instof A(\"c1\"); }}
    internal_event_actions{{ a }}
}}"
    )
}

/// Returns the codes of all messages about a spec, from `dca check` and from `dca verify`.
fn codes(text: &str) -> Vec<String> {
    let source = Source::new("a.dca", text);
    let (compiled, sites) = compile_with_sites(&source, &[], &Options::named("a"));
    let mut codes: Vec<String> = compiled.diagnostics.iter().map(|found| found.code.to_string()).collect();
    if let (Some(plan), Some(sites)) = (&compiled.plan, &sites) {
        let report = explored(plan, sites);
        assert!(!report.is_limited);
        let found = report.findings.iter().filter(|finding| finding.verdict == Verdict::Fails);
        codes.extend(found.filter_map(|finding| Some(finding.diagnostic.as_ref()?.code.to_string())));
    }
    codes.retain(|code| code != "W0120");
    codes.sort();
    codes.dedup();
    codes
}

fn explored(plan: &language::plan::Plan, sites: &Sites) -> Report {
    verify(plan, sites, &LIMITS)
}

/// The mistake, its code, an activity with the mistake, and one without it.
const MISTAKES: [(&str, &str, &str, &str); 18] = [
    (
        "nothing leads out of the pause",
        "E0811",
        "initial state s { run look; on done -> done; on message orders -> paused; } suspended state paused { }",
        "initial state s { run look; on done -> done; on message orders -> paused; }
         suspended state paused { on message orders -> resume; }",
    ),
    (
        "the counter never gets so high",
        "E0812",
        "initial state s { run look; on done when tries < 3 -> s { tries += 1; } on done when tries > 3 -> t; on done -> done; }
         state t { run walk; on done -> done; }",
        "initial state s { run look; on done when tries < 3 -> s { tries += 1; } on done when tries >= 3 -> t; }
         state t { run walk; on done -> done; }",
    ),
    (
        "the counter leaves its range",
        "E0817",
        "initial state s { run look; on done(missing) -> s { tries += 1; } on done -> t; } state t { run walk; on done -> done; }
         verify { eventually done; }",
        "initial state s { run look; on done(missing) when tries < 3 -> s { tries += 1; } on done -> t; } state t { run walk; on done -> done; }",
    ),
    (
        "a region never reaches its end",
        "E0811",
        "initial state s { on always -> both; }
         parallel state both {
             state l { initial state a { run walk; on done -> b; } final state b; }
             state r { initial state c { run look; on done -> d; } state d { } final state e; }
             on complete -> done;
         }",
        "initial state s { on always -> both; }
         parallel state both {
             state l { initial state a { run walk; on done -> b; } final state b; }
             state r { initial state c { run look; on done -> e; } final state e; }
             on complete -> done;
         }",
    ),
    (
        "two states want the arm at once",
        "E0501",
        "initial parallel state both {
             state l { initial state a { run one; on done -> b; } final state b; }
             state r { initial state c { run two; on done -> d; } final state d; }
             on complete -> done;
         }",
        "initial state l { run one; on done -> r; } state r { run two; on done -> done; }",
    ),
    (
        "one process runs twice at once",
        "E0401",
        "initial parallel state both {
             state l { initial state a { run walk; on done -> b; } final state b; }
             state r { initial state c { run walk; on done -> d; } final state d; }
             on complete -> done;
         }",
        "initial state l { run walk; on done -> r; } state r { run walk; on done -> done; }",
    ),
    (
        "both run together, which a sentence forbids",
        "E0817",
        "initial state s { run look, walk; on done -> done; } verify { never look with walk; }",
        "initial state s { run (look ; walk); on done -> done; } verify { never look with walk; }",
    ),
    (
        "the way past the check is open to a message",
        "E0817",
        "initial state s { run look; on done -> t; on message orders -> t; } state t { run walk; on done -> done; }
         verify { walk only after look.done; }",
        "initial state s { run look; on done -> t; } state t { run walk; on done -> done; }
         verify { walk only after look.done; }",
    ),
    (
        "failures are tried again for ever",
        "W0907",
        "initial state s { run look; on done -> t; on aborted -> abort(\"no\"); } state t { run walk; on done -> done; on aborted -> s; }",
        "initial state s { run look; on done -> t; on aborted -> abort(\"no\"); }
         state t { run walk; on done -> done; on aborted when tries < 3 -> s { tries += 1; } }",
    ),
    (
        "a transition hides another",
        "W0905",
        "initial state s { run look; on done -> done; on done(missing) -> t; } state t { run walk; on done -> done; }",
        "initial state s { run look; on done(missing) -> t; on done -> done; } state t { run walk; on done -> done; }",
    ),
    (
        "a tick is taken twice",
        "W0908",
        "initial state s { run look; on done -> done; on every 1 s { tries = 1; } on every 1 s { tries = 2; } }",
        "initial state s { run look; on done -> done; on every 1 s { tries = 1; } on every 2 s { tries = 2; } }",
    ),
    (
        "nothing leads to a state",
        "W0906",
        "initial state s { run look; on done -> done; } state t { run walk; on done -> done; }",
        "initial state s { run look; on done -> t; } state t { run walk; on done -> done; }",
    ),
    (
        "the pause is left to the wrong state",
        "E0902",
        "initial state s { run look; on done -> done; on message orders -> paused; } state paused { on message orders -> resume; }",
        "initial state s { run look; on done -> done; on message orders -> paused; }
         suspended state paused { on message orders -> resume; }",
    ),
    (
        "nothing lets it go on after it was suspended",
        "E0811",
        "initial state s { run look; on done -> done; } suspended state paused { } on suspend -> paused;",
        "initial state s { run look; on done -> done; } suspended state paused { on resume -> resume; } on suspend -> paused;",
    ),
    (
        "the end of the wrong instance opens the way",
        "E0817",
        "initial state s { run look, one; on one.done -> t; } state t { run walk; on done -> done; }
         verify { walk only after look.done; }",
        "initial state s { run look, one; on look.done -> t; } state t { run walk; on done -> done; }
         verify { walk only after look.done; }",
    ),
    (
        "a lost host leads past the check",
        "E0817",
        "initial state s { run look; on done -> t; on host \"c2\" lost -> t; } state t { run walk; on done -> done; }
         verify { walk only after look.done; }",
        "initial state s { run look; on done -> t; on host \"c2\" lost { log(\"alone\"); } } state t { run walk; on done -> done; }
         verify { walk only after look.done; }",
    ),
    (
        "the default of a question leads past the check",
        "E0817",
        "initial state s { run one; on done confirm operator \"Look?\" options(yes -> t, no -> u) default no after 5 s; }
         state t { run look; on done -> u; } state u { run walk; on done -> done; }
         verify { walk only after look.done; }",
        "initial state s { run one; on done confirm operator \"Look?\" options(yes -> t, no -> done) default no after 5 s; }
         state t { run look; on done -> u; } state u { run walk; on done -> done; }
         verify { walk only after look.done; }",
    ),
    (
        "it waits for a priority that no message has",
        "E0904",
        "initial state s { run look; on done -> done; on message orders where priority > 256 -> done; }",
        "initial state s { run look; on done -> done; on message orders where priority > 250 -> done; }",
    ),
];

#[test]
fn mistakes_of_activities_are_found_and_nothing_is_said_of_their_repairs() {
    let mut wrong = Vec::new();
    for (mistake, code, bad, good) in MISTAKES {
        let (of_bad, of_good) = (codes(&spec(bad)), codes(&spec(good)));
        if !of_bad.iter().any(|found| found == code) || !of_good.is_empty() {
            wrong.push(format!("{mistake}: {of_bad:?}, repaired {of_good:?}"));
        }
    }
    assert_eq!(wrong, Vec::<String>::new());
}

/// Returns a spec with an activity on `c1` that runs `walk` on `c2`. The state in which it walks has these transitions.
fn guard(transitions: &str, sentence: &str) -> String {
    format!(
        "{MODULES}
activity A(h: Host, far: Host){{
    host{{h}}
    walk instof Go(far);
    back instof Go(h);
    initial state out {{ run walk; on done -> home; {transitions} }}
    state home {{ run back; on done -> done; }}
    verify {{ {sentence} }}
}}
process main(){{
    host{{\"c1\"}}
    instantiated_processes{{ a instof A(\"c1\", \"c2\"); }}
    internal_event_actions{{ a }}
}}"
    )
}

/// A host may be lost at any time, so the state that its loss leads to can be entered.
#[test]
fn the_loss_of_a_host_is_a_free_event() {
    assert_eq!(codes(&guard("on host far lost -> home;", "can finish;")), Vec::<String>::new());
    assert_eq!(codes(&guard("on link far lost -> home;", "can finish;")), Vec::<String>::new());
}

/// If the loss is the fault of a sentence, its notice comes when the node notices the loss, before the members there fail. A
/// run that leaves the activity because of the notice counts as failed, not as a run whose stop is not confirmed.
#[test]
fn a_sentence_about_a_lost_host_knows_its_news() {
    let sentence = "on loss of host(c2): eventually back;";
    let both = guard("on host far lost -> home; on aborted -> home;", sentence);
    assert_eq!(codes(&both), Vec::<String>::new());
    // If the host restarts, only its programs have died, and no host is lost.
    assert_eq!(codes(&guard("on host far lost -> home;", sentence)), ["E0817"]);
    assert_eq!(codes(&guard("on host far lost -> done; on aborted -> home;", sentence)), ["E0817"]);
}

/// `dca fmea` has rows for the programs that the states of an activity run.
#[test]
fn faults_of_the_runs_of_an_activity_have_rows() {
    let text = guard("on aborted -> home;", "can finish;");
    let source = Source::new("a.dca", &text);
    let (compiled, sites) = compile_with_sites(&source, &[], &Options::named("a"));
    let (plan, sites) = compiled.plan.zip(sites).unwrap_or_else(|| panic!("{:#?}", compiled.diagnostics));
    let table = verify::fmea(&plan, &sites, &LIMITS, verify::Faults::One);
    expect_test::expect![[r#"
        | program | fault | while | at once | still runs | safe within | mission | verdict |
        |---|---|---|---|---|---|---|---|
        | a/back | crash | alone | a fails; main fails | nothing | 0 s | fails | safe |
        | a/back | hang | alone | unnoticed | a/back |  | never ends | STUCK |
        | a/walk | crash | alone | starts a/back | a/back |  | can be done | handled |
        | a/walk | hang | alone | unnoticed | a/walk |  | never ends | STUCK |
        | host c1 | loss of host | a/back | nothing follows at once | nothing | 7 s | is lost | safe |
        | host c1 | loss of host | a/walk | a/walk has stopped | nothing | 9 s | is lost | safe |
        | host c2 | loss of host | a/back | nothing follows at once | a/back |  | can be done | goes on without |
        | host c2 | loss of host | a/walk | a/walk fails; starts a/back | a/back |  | can be done | handled |
        | c1 - c2 | loss of link | a/back | nothing follows at once | a/back |  | can be done | goes on without |
        | c1 - c2 | loss of link | a/walk | a/walk fails; starts a/back; a/walk has stopped | a/back |  | can be done | handled |
    "#]].assert_eq(&table.markdown());
}

/// The failure of an inner group has a text, also if the group first has to stop something, or fails on another host.
#[test]
fn the_text_of_a_failure_inside_is_known() {
    let text = |host: &str, wanted: &str| {
        format!(
            "{MODULES}
process deep(h){{
    host{{h}}
    instantiated_processes{{ w instof Go(h); v instof Go(h); }}
    internal_event_actions{{ v & (w ; fail(\"no way\")) }}
}}
process group(h){{
    host{{h}}
    instantiated_processes{{ d instof deep(h); }}
    internal_event_actions{{ d }}
}}
activity A(h: Host){{
    g instof group(\"{host}\");
    walk instof Go(h);
    back instof Go(h);
    initial state s {{ run g; on done -> done; on aborted({wanted}) -> t; on aborted -> u; }}
    state t {{ run walk; on done -> done; }}
    state u {{ run back; on done -> done; }}
}}
process main(){{
    host{{\"c1\"}}
    instantiated_processes{{ a instof A(\"c1\"); }}
    internal_event_actions{{ a }}
}}"
        )
    };
    for host in ["c1", "c2"] {
        assert_eq!(codes(&text(host, "\"no way\"")), Vec::<String>::new(), "on {host}");
        // No program is running here yet.
        assert_eq!(codes(&text(host, "busy")), ["E0812"], "on {host}");
    }
    // A text that no failure has is never matched.
    assert_eq!(codes(&text("c1", "\"no wayy\"")), ["E0812", "W0905"]);
}

/// A `match` around an activity knows its outcomes: each arm is used, and an arm without an outcome is dead.
#[test]
fn a_match_knows_the_outcomes_of_an_activity() {
    let text = |ends: &str| {
        format!(
            "{MODULES}
activity A(h: Host){{
    done(held: Text | gave_up);
    look instof Work(h);
    initial state s {{ run look; {ends} }}
}}
process main(){{
    host{{\"c1\"}}
    instantiated_processes{{ a instof A(\"c1\"); one instof Go(\"c1\"); two instof Go(\"c1\"); }}
    internal_event_actions{{ a : match {{ held => one, gave_up => two }} }}
    verify{{ can finish; }}
}}"
        )
    };
    let both = "on done(found p) -> done(held p); on done(missing) -> done(gave_up);";
    assert_eq!(codes(&text(both)), Vec::<String>::new());
    let one = "on done(found p) -> done(held p); on done(missing) -> done(held \"none\");";
    assert_eq!(codes(&text(one)), ["E0812"], "`two` never begins");
}

/// The value of a script is unknown, and each script may fail for both reasons. Without a script, no arm for these
/// reasons begins. The script never runs: this one would use up its budget.
#[test]
fn a_script_may_fail_for_both_reasons() {
    let text = |action: &str| {
        format!(
            "{MODULES}
activity A(h: Host){{
    look instof Work(h);
    var tries: 0..3 = 0;
    var word: opaque Text = ();
    initial state s {{ run look; on done -> t {{ {action} tries = 2; }} }}
    state t {{ on always when tries == 2 -> done; }}
}}
process main(){{
    host{{\"c1\"}}
    instantiated_processes{{ a instof A(\"c1\"); one instof Go(\"c1\"); two instof Go(\"c1\"); }}
    internal_event_actions{{ a else match {{ script_budget => one, script_failed => two }} }}
    verify{{ can finish; }}
}}"
        )
    };
    assert_eq!(codes(&text("word = script { loop {} };")), Vec::<String>::new());
    assert_eq!(codes(&text("")), ["E0812"]);
}

/// The ports of an activity are a program that no event action runs: `verify` and `fmea` do not mention it.
#[test]
fn connections_change_nothing_of_a_proof() {
    let text = |connections: &str| {
        format!(
            "module Mic(host) {{ out Heard: Text; service; }}
module Speaker(host) {{ in Words: Text optional; service; }}
activity A(h: Host){{
    in orders: Text;
    out say: Text;
    initial state s {{ on message orders -> done {{ say.send(\"bye\"); }} }}
}}
process main(){{
    host{{\"c1\"}}
    instantiated_processes{{ a instof A(\"c1\"); mic instof Mic(\"c1\"); other instof Mic(\"c1\"); speaker instof Speaker(\"c1\"); }}
    internal_connections{{ {connections} }}
    internal_event_actions{{ a # mic # other # speaker }}
    verify{{ can finish; }}
}}"
        )
    };
    let connected = text("mic.Heard -> a.orders; other.Heard -> a.orders; a.say -> speaker.Words;");
    assert_eq!(codes(&connected), codes(&text("")));
    let tables = [text(""), connected].map(|text| {
        let (compiled, sites) = compile_with_sites(&Source::new("a.dca", text), &[], &Options::named("a"));
        let (plan, sites) = compiled.plan.zip(sites).unwrap_or_else(|| panic!("{:#?}", compiled.diagnostics));
        verify::fmea(&plan, &sites, &LIMITS, verify::Faults::One).markdown()
    });
    assert_eq!(tables[0], tables[1]);
}
