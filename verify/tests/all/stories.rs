//! Stories about activities name their causes. The simulator plays each story to the same end.

use crate::timers::Chance;
use language::{Options, Source, compile_with_sites};
use std::fmt::Write as _;
use verify::{Alone, Always, Finding, Limits, PlayResult, Script, verify};

const LIMITS: Limits<'static> = Limits { states: 60_000, memory: 256 << 20, threads: &Alone, goes_on: &Always };
const RUNS: [&str; 6] = ["p", "p ; q", "p # q", "p?", "retry(2) q", "p within 2 s"];

/// Returns an activity `x` with these states, in a mission with these event actions and sentences.
fn spec(states: &str, actions: &str, sentences: &str) -> String {
    format!(
        "module M(host) {{ done(found | missing); }}
module Ok(host) {{ done; }}
activity A(h: Host){{
    in m: Text queue 2;
    p instof M(h);
    q instof M(h);
    var n: 0..3 = 0;
{states}
}}
process main(){{
    host{{\"c1\"}}
    instantiated_processes{{ x instof A(\"c1\"); y instof Ok(\"c1\"); z instof Ok(\"c1\"); }}
    internal_event_actions{{ {actions} }}
    verify {{ {sentences} }}
}}"
    )
}

/// Returns the findings of a spec with their stories, or none if the check refuses the spec.
fn findings(text: &str) -> Option<(language::plan::Plan, Vec<Finding>)> {
    let source = Source::new("a.dca", text);
    let (compiled, sites) = compile_with_sites(&source, &[], &Options::named("a"));
    let (plan, sites) = compiled.plan.zip(sites)?;
    let findings = verify(&plan, &sites, &LIMITS).findings;
    Some((plan, findings))
}

/// Plays all stories of a spec. Returns the number of stories, and the mistakes.
fn played(text: &str) -> (usize, Vec<String>) {
    let Some((plan, findings)) = findings(text) else { return (0, Vec::new()) };
    let (mut count, mut wrong) = (0, Vec::new());
    for finding in findings {
        let Some(story) = finding.story else { continue };
        count += 1;
        let lines = story.lines().join("\n");
        let Some(script) = Script::of(&story) else {
            wrong.push(format!("{} has no script:\n{lines}\n{text}", finding.sentence));
            continue;
        };
        let played = script.play(&plan);
        if played.result != PlayResult::Same {
            let why = &played.result;
            wrong.push(format!("{}: {why:?}\n{lines}\n{}\n{text}", finding.sentence, played.lines.join("\n")));
        }
    }
    (count, wrong)
}

fn trigger(chance: &mut Chance, has_run: bool) -> String {
    match chance.below(9) {
        0 if has_run => "done".to_owned(),
        1 if has_run => "done(found)".to_owned(),
        2 => "aborted".to_owned(),
        3 => "always".to_owned(),
        4 => "message m where text == \"go\"".to_owned(),
        5 => "suspend".to_owned(),
        6 => format!("every {} s", 1 + chance.below(3)),
        _ => format!("after {} s", 1 + chance.below(4)),
    }
}

fn states(chance: &mut Chance) -> String {
    let count = 1 + chance.below(3);
    let mut text = String::new();
    for state in 0..count {
        let initial = if state == 0 { "initial " } else { "" };
        let _infallible = write!(text, "    {initial}state s{state} {{ ");
        let has_run = chance.below(2) == 0;
        if has_run {
            let run = RUNS[usize::try_from(chance.below(RUNS.len() as u64)).expect("it is small")];
            let _infallible = write!(text, "run ({run}); ");
        }
        for _ in 0..chance.below(4) {
            let trigger = trigger(chance, has_run);
            let guard = match chance.below(3) {
                0 => format!(" when n < {}", 1 + chance.below(3)),
                _ => String::new(),
            };
            let target = match chance.below(6) {
                0 => " -> done".to_owned(),
                1 => " -> abort(\"no\")".to_owned(),
                2 => String::new(),
                _ => format!(" -> s{}", chance.below(count)),
            };
            let actions = if chance.below(2) == 0 { " { n += 1; }" } else { " { log(\"so\"); }" };
            let _infallible = write!(text, "on {trigger}{guard}{target}{actions} ");
        }
        text.push_str("}\n");
    }
    text
}

fn all_are_played(seeds: std::ops::Range<u64>) -> usize {
    let (mut count, mut wrong) = (0, Vec::new());
    for seed in seeds {
        let chance = &mut Chance(seed);
        let states = states(chance);
        let actions = ["x ; y", "x, y", "(x ; y) # z", "x else y", "(z, x) ; y"];
        let actions = actions[usize::try_from(chance.below(5)).expect("it is small")];
        let sentences = "can finish; eventually y; y only after x.done; holds ltl \"G !done\"; holds ltl \"G !aborted\"; never x with y;";
        let (stories, mut mistakes) = played(&spec(&states, actions, sentences));
        count += stories;
        wrong.append(&mut mistakes);
    }
    assert!(wrong.is_empty(), "{} of {count}:\n{}", wrong.len(), wrong.join("\n\n"));
    count
}

#[test]
fn each_story_of_an_activity_is_played_to_the_same_end() {
    let count = all_are_played(0..60);
    assert!(count > 60, "only {count} stories");
}

#[test]
#[ignore = "long: 3,000 activities"]
fn each_story_of_many_activities_is_played_to_the_same_end() {
    all_are_played(1000..4000);
}

/// Returns the lines of the story of the finding with a code.
fn told(text: &str, code: &str) -> Vec<String> {
    let (_, findings) = findings(text).expect("it compiles");
    let is_it = |finding: &&Finding| finding.diagnostic.as_ref().is_some_and(|it| it.code.to_string() == code);
    let story = findings.iter().find(is_it).and_then(|finding| finding.story.as_ref()).expect("it has a story");
    story.lines().iter().map(|line| line.trim().to_owned()).collect()
}

#[test]
fn a_story_names_the_timer_and_the_state() {
    let states = "initial state one { on after 3 s -> two; }
        state two { on every 2 s { log(\"t\"); } on after 5 s -> abort(\"late\"); }";
    let expected = [
        "1  `main` starts: starts `x`",
        "2  `x` is in `one`, and `after 3 s` has run out: `x` is in `two`",
        "3  `x` is in `two`, and `after 5 s` has run out: `x` fails; `main` fails",
    ];
    assert_eq!(told(&spec(states, "x ; y", "can finish;"), "E0817"), expected);
}

/// An activity that ends in its first reaction has already ended at its start.
#[test]
fn an_activity_that_ends_at_once_has_no_event_of_its_end() {
    let text = spec("initial state one { on always -> two; } state two { on always -> one; }", "x ; y", "can finish;");
    assert_eq!(told(&text, "E0812"), ["1  `main` starts: `x` fails; `main` fails; starts `x`"]);
}

#[test]
fn a_claim_that_never_holds_has_the_story_of_a_run() {
    let text = spec("initial state one { }", "x ; y", "eventually y;");
    assert_eq!(told(&text, "E0817"), ["1  `main` starts: starts `x`", "now runs: x"]);
}
