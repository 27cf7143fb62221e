//! The timers of an activity run out in the order of their times, in the verifier and in the simulator.

use language::{Options, Simulation, Source, Transition, compile_with_sites};
use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::time::Duration;
use verify::{Alone, Always, Detail, Limits, Verdict, flat, verify};

const LIMITS: Limits<'static> = Limits { states: 200_000, memory: 256 << 20, threads: &Alone, goes_on: &Always };
/// The number of states in which an activity can end. Each has a program that shows that the state was entered.
const GOALS: u64 = 4;

/// Numbers by chance.
pub(super) struct Chance(pub(super) u64);

impl Chance {
    pub(super) fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % limit
    }
}

/// Returns a spec whose activity `a` has this body, as well as the states `g0` to `g3` that run `w0` to `w3`.
fn spec(body: &str, sentences: &str) -> String {
    let mut text =
        "module Go(host) { done; }\nactivity A(h: Host){\n    var n: 0..9 = 0;\n    in m: Text;\n".to_owned();
    for goal in 0..GOALS {
        let _infallible = writeln!(text, "    w{goal} instof Go(h);");
        let _infallible = writeln!(text, "    state g{goal} {{ run w{goal}; on done -> done; }}");
    }
    format!(
        "{text}{body}
}}
process main(){{
    host{{\"c1\"}}
    instantiated_processes{{ a instof A(\"c1\"); }}
    internal_event_actions{{ a }}
    {sentences}
}}"
    )
}

/// Returns the goals that are possible for the verifier, and whether it proves all sentences.
fn verified(text: &str) -> (BTreeSet<u64>, bool) {
    let source = Source::new("a.dca", text);
    let (compiled, sites) = compile_with_sites(&source, &[], &Options::named("a"));
    let (plan, sites) = compiled.plan.zip(sites).unwrap_or_else(|| panic!("{text}\n{:#?}", compiled.diagnostics));
    let report = verify(&plan, &sites, &LIMITS);
    assert!(!report.is_limited, "{text}");
    let said: Vec<String> = report
        .findings
        .iter()
        .filter(|finding| finding.verdict == Verdict::Fails)
        .filter_map(|finding| finding.diagnostic.as_ref())
        .map(|diagnostic| format!("{}: {}", diagnostic.code, diagnostic.message))
        .collect();
    let is_never = |goal: &u64| said.contains(&format!("E0812: `a/w{goal}` is never started here"));
    let goals = (0..GOALS).filter(|goal| !is_never(goal)).collect();
    (goals, !said.iter().any(|said| said.starts_with("E0817")))
}

/// Returns the goals that a simulation reaches in which messages arrive at these times.
fn simulated(text: &str, messages: &[Duration]) -> BTreeSet<u64> {
    let source = Source::new("a.dca", text);
    let plan = compile_with_sites(&source, &[], &Options::named("a")).0.plan.expect("it was compiled before");
    let mut simulation = Simulation::start(&plan);
    for &at in messages {
        simulation.pass(at.saturating_sub(simulation.now()));
        // A message may arrive when nothing waits for it any more.
        let _is_heard = simulation.send("m", "go").is_ok();
    }
    simulation.pass(Duration::from_secs(300));
    let happenings = simulation.take_happenings();
    let started = happenings.iter().filter(|happening| happening.transition == Transition::Started);
    started.filter_map(|happening| happening.path.strip_prefix("main/a/w")?.parse().ok()).collect()
}

/// Returns states with only timers, and also with messages if `hears`.
fn states(chance: &mut Chance, prefix: &str, hears: bool) -> String {
    let count = 1 + chance.below(3);
    let mut text = String::new();
    for state in 0..count {
        let initial = if state == 0 { "initial " } else { "" };
        let _infallible = write!(text, "    {initial}state {prefix}{state} {{ ");
        for _ in 0..1 + chance.below(3) {
            let guard = match chance.below(5) {
                0 => format!(" when n < {}", 1 + chance.below(4)),
                1 => format!(" when n >= {}", 1 + chance.below(4)),
                _ => String::new(),
            };
            let target = match chance.below(3) {
                0 => format!("g{}", chance.below(GOALS)),
                _ => format!("{prefix}{}", chance.below(count)),
            };
            let trigger = match chance.below(6) {
                0 if hears => "message m".to_owned(),
                _ => format!("after {} s", 1 + chance.below(6)),
            };
            let _infallible = write!(text, "on {trigger}{guard} -> {target}; ");
        }
        if chance.below(3) == 0 {
            let _infallible = write!(text, "on every {} s when n < 9 {{ n += 1; }} ", 1 + chance.below(4));
        }
        text.push_str("}\n");
    }
    text
}

fn body(seed: u64, hears: bool) -> String {
    let chance = &mut Chance(seed);
    let outer = match chance.below(3) {
        0 => format!("    on after {} s -> g{};\n", 1 + chance.below(12), chance.below(GOALS)),
        _ => String::new(),
    };
    let inner = match chance.below(2) {
        0 => states(chance, "s", hears),
        _ => format!(
            "initial parallel state both {{\nstate l {{\n{}}}\nstate r {{\n{}}}\n}}\n",
            states(chance, "l", hears),
            states(chance, "r", hears)
        ),
    };
    outer + &inner
}

/// Without messages there is only one run, and the verifier knows it.
fn is_exact(seeds: std::ops::Range<u64>) {
    let mut wrong = Vec::new();
    for seed in seeds {
        let text = spec(&body(seed, false), "");
        let (possible, reached) = (verified(&text).0, simulated(&text, &[]));
        if possible != reached {
            wrong.push(format!("seed {seed}: verify {possible:?}, sim {reached:?}\n{text}"));
        }
    }
    assert!(wrong.is_empty(), "{} wrong:\n{}", wrong.len(), wrong.join("\n"));
}

/// The verifier considers every run of the simulator with messages possible. Some messages lead to each possible
/// goal.
fn is_safe(seeds: std::ops::Range<u64>) {
    let (mut wrong, mut more, mut all) = (Vec::new(), 0, 0);
    for seed in seeds {
        let text = spec(&body(seed, true), "");
        let possible = verified(&text).0;
        let mut reached = simulated(&text, &[]);
        for first in 0..20 {
            for second in (first..20).step_by(3) {
                let messages = [first, second].map(|half| Duration::from_millis(500 * half + 250));
                reached.extend(simulated(&text, &messages));
            }
        }
        if !reached.is_subset(&possible) {
            wrong.push(format!("seed {seed}: verify {possible:?}, sim {reached:?}\n{text}"));
        }
        (more, all) = (more + possible.difference(&reached).count(), all + possible.len());
    }
    assert!(wrong.is_empty(), "{} wrong:\n{}", wrong.len(), wrong.join("\n"));
    assert!(more * 5 <= all, "{more} of {all} possible goals came of no messages that were tried");
}

#[test]
fn verify_and_sim_agree_about_timers() {
    is_exact(0..150);
}

#[test]
fn what_sim_reaches_with_messages_verify_calls_possible() {
    is_safe(1000..1040);
}

#[test]
#[ignore = "long: 3,400 activities"]
fn verify_and_sim_agree_about_timers_of_many_activities() {
    is_exact(2000..5000);
    is_safe(20_000..20_400);
}

/// A claim that something can happen must not depend on an order of timers that is impossible on a robot.
#[test]
fn a_longer_timer_of_one_state_does_not_run_out_first() {
    let text = spec("initial state one { on after 3 s -> g0; on after 5 s -> done; }", "verify { can finish; }");
    assert_eq!(verified(&text), ([0].into(), true));
    let text =
        spec("initial state one { on after 3 s -> abort(\"3\"); on after 5 s -> done; }", "verify { can finish; }");
    assert_eq!(verified(&text), ([].into(), false));
}

/// Three steps of 2 s end later than 5 s, and two steps end earlier.
#[test]
fn times_of_states_in_sequence_add_up() {
    let steps = |last: &str| {
        format!(
            "on after 5 s -> g0;
             initial state a {{ on after 2 s -> b; }} state b {{ on after 2 s -> {last}; }} state c {{ on after 2 s -> g1; }}"
        )
    };
    assert_eq!(verified(&spec(&steps("c"), "")).0, [0].into());
    assert_eq!(verified(&spec(&steps("g1"), "")).0, [0, 1].into());
}

/// A message may arrive at any time, and so may the confirmation of a stop.
#[test]
fn a_wait_between_two_timers_leaves_their_order_open() {
    let text = spec("on after 5 s -> g0; initial state a { on message m -> b; } state b { on after 3 s -> g1; }", "");
    assert_eq!(verified(&text).0, [0, 1].into());
    let text =
        spec("on after 5 s -> g0; initial state a { run w2; on after 2 s -> b; } state b { on after 2 s -> g1; }", "");
    assert_eq!(verified(&text).0, [0, 1].into());
}

/// The number of ticks before another timer is known.
#[test]
fn ticks_are_counted_exactly() {
    let text = |limit: u32| {
        let body = format!(
            "initial state a {{ on every 10 ms when n < 9 {{ n += 1; }}
             on after 75 ms when n < {limit} -> g0; on after 75 ms -> g1; }}"
        );
        spec(&body, "")
    };
    assert_eq!(verified(&text(7)).0, [1].into());
    assert_eq!(verified(&text(8)).0, [0].into());
    assert_eq!(simulated(&text(7), &[]), [1].into());
}

/// The specs of the repository that have a plan without interfaces.
fn specs() -> Vec<(String, language::plan::Plan, language::sites::Sites)> {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let folders = ["specs", "verify/tests/corpus/good", "verify/tests/corpus/bad", "verify/tests/mistakes/good"];
    let mut all = Vec::new();
    for entry in folders.iter().flat_map(|folder| std::fs::read_dir(root.join(folder)).expect("it is there")) {
        let path = entry.expect("it can be read").path();
        if path.extension().is_some_and(|kind| kind == "dca") {
            let text = std::fs::read_to_string(&path).expect("it can be read");
            let (compiled, sites) = compile_with_sites(&Source::new("a.dca", text), &[], &Options::named("a"));
            all.extend(compiled.plan.zip(sites).map(|(plan, sites)| (path.display().to_string(), plan, sites)));
        }
    }
    all
}

#[test]
fn the_order_of_timers_only_takes_states_away() {
    let limits = Limits { states: 20_000, ..LIMITS };
    let (mut fewer, mut compared) = (0, 0);
    for (name, plan, sites) in specs() {
        let ordered = flat(&plan, &sites, &limits, Detail::All);
        let free = flat(&plan, &sites, &limits, Detail::AnyOrder);
        if ordered.reached.is_some() || free.reached.is_some() {
            continue;
        }
        assert!(ordered.states <= free.states && ordered.transitions <= free.transitions, "{name}");
        assert!(ordered.situations.is_subset(&free.situations), "{name}");
        compared += 1;
        fewer += u32::from(ordered.transitions < free.transitions);
    }
    assert!(compared > 50 && fewer > 2, "{fewer} of {compared} specs have fewer transitions");
}
