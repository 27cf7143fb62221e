//! The fate of a group's programs when one of them dies, by its `supervision`.

use super::world::{Draw, World};
use node::logic::protocol::{Answer, Change, Ending, FailureCause, Report};
use std::collections::BTreeSet;
use std::ops::Range;
use std::time::Duration;

/// A group of four programs on two hosts, the last of them in a group of its own, and a plan B.
const GROUP: &str = r#"
process Inner(there) {
    host { there }
    instantiated_processes { deep instof Sensor(there) { restart transient; } }
    internal_event_actions { deep }
}
process Group(here, there) {
    host { here }
    supervision { RULES }
    instantiated_processes {
        first instof Sensor(here);
        second instof Sensor(there);
        once instof Sensor(here) { restart temporary; }
        inner instof Inner(there);
        long instof Long(here);
    }
    internal_event_actions { first , second , once , inner , long }
}
process main() {
    host { "c1" }
    instantiated_processes { group instof Group("c1", "c2"); rescue instof Step("c2"); }
    internal_event_actions { group else rescue }
}
"#;

/// The leaves, in the plan's order.
const LEAVES: [&str; 6] = ["first", "second", "once", "deep", "long", "rescue"];

fn deploy(world: &mut World, rules: &str) -> u64 {
    world.deploy("c1", &GROUP.replace("RULES", rules))
}

fn host_of(leaf: u32) -> &'static str {
    if [1, 3, 5].contains(&leaf) { "c2" } else { "c1" }
}

/// How often each program was started, in the order of [`LEAVES`].
fn lives(world: &World) -> Vec<u32> {
    let life = |leaf: u32| world.lives.iter().find(|(process, _)| process.leaf == leaf).map_or(0, |(_, lives)| *lives);
    (0..).take(LEAVES.len()).map(life).collect()
}

/// The program that dies, and how often each program has been started then, by strategy.
#[test]
fn each_strategy_starts_its_programs_again_and_the_mission_goes_on() {
    for (strategy, dies, expected) in [
        ("one_for_one", 1, [1, 2, 1, 1, 1, 1]),
        ("one_for_all", 1, [2, 2, 1, 2, 2, 1]),
        ("rest_for_one", 1, [1, 2, 1, 2, 2, 1]),
        ("rest_for_one", 0, [2, 2, 1, 2, 2, 1]),
        ("rest_for_one", 4, [1, 1, 1, 1, 2, 1]),
        // It belongs to the inner group, which has no strategy.
        ("one_for_all", 3, [1, 1, 1, 2, 1, 1]),
    ] {
        let mut world = World::new(&["c1", "c2"]);
        let call = deploy(&mut world, &format!("strategy {strategy};"));
        world.run_for(Duration::from_secs(1));
        world.kill(host_of(dies), dies);
        world.run_for(Duration::from_secs(1));
        assert_eq!(lives(&world), expected, "{strategy}, `{}` dies", LEAVES[dies as usize]);
        let running: Vec<u32> = world.running.keys().map(|(_, process)| process.leaf).collect();
        assert_eq!(running.into_iter().collect::<BTreeSet<_>>(), BTreeSet::from([0, 1, 2, 3, 4]), "{strategy}");
        let told = world.answers[&call].iter().filter(|answer| {
            matches!(answer, Answer::Report(Report::Process { change: Change::Renewing { with }, .. })
                if *with == format!("main/group/{}", LEAVES[dies as usize]))
        });
        let renewed: u32 = expected.iter().sum::<u32>() - 7;
        assert_eq!(u32::try_from(told.count()), Ok(renewed), "{strategy}");
        // `once` dies for good, and so the group aborts.
        world.kill("c1", 2);
        world.run_for(Duration::from_secs(3));
        assert_eq!((world.ending(call), &world.alive), (&Ending::Done(vec![]), &BTreeSet::new()), "{strategy}");
        assert!(world.log.iter().any(|line| line.starts_with("Step")), "plan B has run");
    }
}

/// The back-off of a group applies to each program without its own; programs that are restarted with it do not wait.
#[test]
fn programs_of_a_group_have_its_back_off_and_nobody_waits_with_them() {
    let mut world = World::new(&["c1", "c2"]);
    let own = "inner instof Inner(there);\n        long instof Long(here) { restart transient; backoff 2 s to 2 s; };";
    let text = GROUP.replace("inner instof Inner(there);\n        long instof Long(here);", own);
    world.deploy("c1", &text.replace("RULES", "strategy one_for_all; backoff 10 s to 30 s;"));
    world.run_for(Duration::from_secs(1));
    for (dies, seconds, expected) in [
        (1, 1, [2, 2, 1, 2, 2, 1]),
        (1, 7, [3, 2, 1, 3, 3, 1]),
        (1, 3, [3, 3, 1, 3, 3, 1]),
        (4, 1, [4, 4, 1, 4, 4, 1]),
        (4, 1, [5, 5, 1, 5, 4, 1]),
        (4, 2, [5, 5, 1, 5, 5, 1]),
        // Its own group has none.
        (3, 1, [5, 5, 1, 6, 5, 1]),
        (3, 1, [5, 5, 1, 7, 5, 1]),
    ] {
        world.kill_if_alive(host_of(dies), dies);
        world.run_for(Duration::from_secs(seconds));
        assert_eq!(lives(&world), expected, "`{}` dies", LEAVES[dies as usize]);
    }
}

/// One restart more than the group may have: it stops its members, and has aborted for that reason; the group above
/// decides.
#[test]
fn a_restart_too_many_aborts_the_group_with_its_cause() {
    for (pause, aborts) in [(1000, true), (4100, false)] {
        let mut world = World::new(&["c1", "c2"]);
        let text = GROUP.replace("group else rescue", "group").replace("rescue instof Step(\"c2\");", "");
        let call = world.deploy("c1", &text.replace("RULES", "restarts 2 within 8 s;"));
        world.run_for(Duration::from_millis(500));
        for _ in 0..3 {
            world.kill_if_alive("c2", 1);
            world.run_for(Duration::from_millis(pause));
        }
        if !aborts {
            assert_eq!((world.ending(call), lives(&world)[1]), (&Ending::Done(vec![]), 4));
            continue;
        }
        let Ending::Aborted(failure) = world.ending(call) else { panic!("{:?}", world.ending(call)) };
        let (last, within) = ("SIGKILL (external)".to_owned(), Duration::from_secs(8));
        assert_eq!(failure.cause, FailureCause::Intensity { last, restarts: 2, within });
        let told = "main ← group ← second: SIGKILL (external), and its group bears 2 restarts within 8 s at 2.5 s";
        assert_eq!(failure.to_string(), told);
        assert_eq!(world.alive, BTreeSet::new());
    }
}

/// The next run of a group has all of its restarts before it.
#[test]
fn a_group_that_is_tried_again_begins_to_count_anew() {
    let mut world = World::new(&["c1", "c2"]);
    let text = GROUP.replace("group else rescue", "retry(1) group").replace("rescue instof Step(\"c2\");", "");
    let call = world.deploy("c1", &text.replace("RULES", "restarts 1 within 60 s; strategy one_for_all;"));
    world.run_for(Duration::from_millis(500));
    for kills in 1..=4 {
        world.kill_if_alive("c1", 0);
        world.run_for(Duration::from_secs(1));
        let is_over = matches!(world.answers[&call].last(), Some(Answer::Report(Report::Finished { .. })));
        assert_eq!(is_over, kills == 4, "after {kills} kills");
    }
    let Ending::Aborted(failure) = world.ending(call) else { panic!("{:?}", world.ending(call)) };
    assert!(matches!(failure.cause, FailureCause::Intensity { restarts: 1, .. }), "{failure}");
}

/// For any deaths, any losses on the way, and any killed node: nothing runs twice, which the world asserts, the group
/// ends, and nothing is left.
#[test]
fn whoever_dies_whenever_the_group_goes_on_or_ends() {
    whoever_dies_whenever_the_group_goes_on_or_ends_for(0..100);
}

#[test]
#[ignore = "long: 400 seeds"]
fn whoever_dies_whenever_the_group_goes_on_or_ends_for_more_seeds() {
    whoever_dies_whenever_the_group_goes_on_or_ends_for(100..500);
}

fn whoever_dies_whenever_the_group_goes_on_or_ends_for(seeds: Range<u64>) {
    for seed in seeds {
        let (mut draw, mut world) = (Draw::new(seed), World::new(&["c1", "c2", "c3"]));
        let strategy = ["one_for_one", "one_for_all", "rest_for_one"][draw.index(3)];
        let intensity = ["", "restarts 3 within 10 s;"][draw.index(2)];
        world.loses_by_chance = Some((Draw::new(seed), 12));
        let call = deploy(&mut world, &format!("strategy {strategy}; {intensity}"));
        world.run_for(Duration::from_millis(300 + draw.below(500)));
        for _ in 0..1 + draw.below(6) {
            let leaf = u32::try_from(draw.below(6)).expect("it is small");
            world.kill_if_alive(host_of(leaf), leaf);
            world.run_for(Duration::from_millis(draw.below(900)));
            if draw.below(4) == 0 {
                let host = ["c1", "c2"][draw.index(2)];
                world.crash(host);
                world.run_for(Duration::from_millis(draw.below(400)));
                world.adopt(host);
            }
            if draw.below(6) == 0 {
                world.stop("c1");
            }
        }
        world.run_for(Duration::from_secs(60));
        // Two services keep the group running for ever, unless something ends it.
        world.stop("c1");
        world.run_for(Duration::from_secs(30));
        assert_eq!(world.alive, BTreeSet::new(), "seed {seed}");
        let finished = |call: u64| matches!(world.answers[&call].last(), Some(Answer::Report(_)));
        assert!(finished(call), "seed {seed}");
    }
}
