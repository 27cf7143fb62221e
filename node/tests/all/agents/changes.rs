//! Deployments whose plan changes while they run, on virtual time.

use super::world::{Draw, World};
use node::logic::protocol::{Answer, Change, ChangeStage, ChangeUnderway, Ending, Report, Request, Revision};
use shim::protocol::{EndReason, ProgramEnd, ShimReport};
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::time::Duration;

/// A sensor on one host feeds a program on another, and that one a third; a task ends it all.
pub(super) const FEED: &str = r#"
process main() {
    host { "c1" }
    instantiated_processes {
        sensor instof Sensor("c1");
        filter instof Tuned("c2") { watchdog 200 ms; }
        sink instof Tuned("c1") { watchdog 200 ms; }
        task instof Long("c2");
    }
    internal_connections(sensor, feed) { sensor, Out -> filter, In; }
    internal_connections(filter, on) { filter, Out -> sink, In; }
    internal_event_actions { sensor[feed] # filter[on] # sink # task }
}
"#;

pub(super) fn start(world: &mut World) -> u64 {
    let call = world.deploy("c1", FEED);
    world.run_for(Duration::from_secs(1));
    call
}

pub(super) fn revision(world: &mut World) -> Revision {
    let call = world.ask("c1", Request::Revision { name: "test".to_owned() });
    world.run_for(Duration::from_millis(1));
    match &world.answers[&call][..] {
        [Answer::Revision(revision)] => (**revision).clone(),
        other => panic!("{other:?}"),
    }
}

/// Returns the result of the change: its lines, or the reasons against it.
#[track_caller]
pub(super) fn outcome(world: &World, call: u64) -> Result<Vec<String>, Vec<String>> {
    match world.last_report(call) {
        Report::Changed { changes, .. } => Ok(changes.clone()),
        Report::Unchanged { reasons, .. } => Err(reasons.clone()),
        other => panic!("{other:?}"),
    }
}

pub(super) fn lives(world: &World) -> Vec<u32> {
    let by_leaf: BTreeMap<u32, u32> = world.lives.iter().map(|(process, lives)| (process.leaf, *lives)).collect();
    by_leaf.into_values().collect()
}

/// Checks that every program runs as planned, and looks for its producers at their addresses.
#[track_caller]
pub(super) fn check(world: &mut World) {
    let plan = revision(world).plan;
    let alive: BTreeMap<u32, _> = world.alive.iter().map(|(_, process)| (process.leaf, process)).collect();
    let live = plan.live_wires();
    let mut expected: BTreeMap<u32, BTreeSet<String>> = alive.keys().map(|leaf| (*leaf, BTreeSet::new())).collect();
    for wire in live.iter().map(|wire| &plan.wires[*wire as usize]) {
        let (from, to) = (alive[&wire.from.leaf], wire.to.leaf);
        expected.get_mut(&to).expect("it runs").insert(world.session(from));
    }
    for (leaf, process) in alive {
        assert_eq!(world.dialled[process], expected[&leaf], "leaf {leaf}");
        let arguments: Vec<String> =
            plan.leaves[leaf as usize].arguments.iter().map(|one| format!("{:?}", one.value)).collect();
        assert_eq!(world.commands[process].len(), 2 + arguments.len(), "leaf {leaf}");
    }
    assert_eq!(world.wires_open, live, "the wires that are open");
}

#[test]
fn a_changed_program_takes_the_place_of_the_one_before_and_all_others_stay() {
    let mut world = World::new(&["c1", "c2"]);
    let call = start(&mut world);
    let again = world.change("c1", FEED, (1, 0), &[]);
    world.run_for(Duration::from_secs(1));
    assert_eq!(outcome(&world, again), Ok(vec![]), "the same spec changes nothing");
    let text = FEED.replace("Tuned(\"c2\")", "Tuned(\"c2\", better)");
    let change = world.change("c1", &text, (1, 0), &[]);
    world.run_for(Duration::from_secs(5));
    let line = "replace    main/filter: `way` is \"better\", was \"good\"";
    assert!(
        matches!(&outcome(&world, change).unwrap()[..], [one] if one.starts_with("replace    main/filter")),
        "{line}"
    );
    assert_eq!(lives(&world), [1, 2, 1, 1]);
    check(&mut world);
    assert_eq!(revision(&mut world).revision, 1);
    world.run_for(Duration::from_secs(20));
    assert_eq!(world.ending(call), &Ending::Done(vec![]));
    let changes: Vec<&Change> = world.answers[&call]
        .iter()
        .filter_map(|answer| match answer {
            Answer::Report(Report::Process { path, change, .. }) if path == "main/filter" => Some(change),
            _ => None,
        })
        .collect();
    let count = |wanted: &Change| changes.iter().filter(|change| **change == wanted).count();
    assert_eq!([&Change::Activated, &Change::Replacing, &Change::Resumed].map(count), [1, 1, 1], "{changes:?}");
}

/// Followers of the mission hear of the current plan before anything happens by it, also when it is taken back; and
/// callers are told when a change is in its probation.
#[test]
fn followers_are_told_which_plan_counts() {
    let mut world = World::new(&["c1", "c2"]);
    let call = start(&mut world);
    let before = revision(&mut world);
    assert_eq!(before.change, None);
    let text = FEED.replace("# task", "# task # wait(1 h)");
    let change = world.change("c1", &text.replace("Tuned(\"c2\")", "Tuned(\"c2\", better)"), (1, 0), &[]);
    world.run_for(Duration::from_millis(1500));
    let probed = revision(&mut world);
    let underway = |stage| Some(ChangeUnderway { revision: 1, by: "ann".to_owned(), stage });
    assert_eq!((probed.revision, &probed.change), (0, &underway(ChangeStage::Probation)));
    assert_ne!(probed.plan, before.plan);
    world.run_for(Duration::from_millis(3500));
    assert_eq!(outcome(&world, change).map(|lines| lines.len()), Ok(2));
    let after = revision(&mut world);
    assert_eq!((after.revision, &after.change, &after.plan), (1, &None, &probed.plan));

    let bad = world.change("c1", &FEED.replace("Tuned(\"c2\")", "Tuned(\"c2\", worse)"), (1, 1), &[]);
    world.run_for(Duration::from_millis(1500));
    assert_eq!(revision(&mut world).change.map(|change| change.stage), Some(ChangeStage::Probation));
    world.end("c2", 1, ShimReport::Exited { code: 3 });
    world.run_for(Duration::from_millis(5));
    assert_eq!(revision(&mut world).change.map(|change| change.stage), Some(ChangeStage::TakenBack));
    world.run_for(Duration::from_secs(5));
    assert!(outcome(&world, bad).is_err());
    let reports = world.answers[&call].iter().map(|answer| match answer {
        Answer::Report(report) => report,
        other => panic!("{other:?}"),
    });
    let kinds = reports.clone().filter_map(|report| match report {
        Report::Replanned { .. } => Some("plan"),
        Report::Changed { .. } => Some("changed"),
        Report::Unchanged { .. } => Some("unchanged"),
        _ => None,
    });
    assert_eq!(kinds.collect::<Vec<_>>(), ["plan", "changed", "plan", "plan", "unchanged"]);
    let plans = reports.filter_map(|report| if let Report::Replanned { plan } = report { Some(plan) } else { None });
    let expressions: Vec<_> = plans.map(|plan| plan.groups[0].expression.clone()).collect();
    let expected = [&after.plan, &before.plan, &after.plan].map(|plan| plan.groups[0].expression.clone());
    assert_eq!(expressions, expected);
}

#[test]
fn a_program_that_is_not_healthy_is_put_back_and_the_mission_goes_on() {
    for way in ["dies", "aborts", "hangs", "ends"] {
        let mut world = World::new(&["c1", "c2"]);
        let call = start(&mut world);
        let text = FEED
            .replace("Tuned(\"c2\")", &format!("Tuned(\"c2\", {way})"))
            .replace("Tuned(\"c1\")", "Tuned(\"c1\", better)");
        let change = world.change("c1", &text, (1, 0), &[]);
        if way == "hangs" {
            // Its `Init` does not end, and until it has succeeded the change is not done.
            world.run_for(Duration::from_secs(4));
            assert!(!world.answers.contains_key(&change), "its probation has not begun");
            let why = EndReason::StartTimeout(Duration::from_secs(4));
            world.end("c2", 1, ShimReport::Ended { end: ProgramEnd::Signal(6), why });
        }
        world.run_for(Duration::from_secs(4));
        let reasons = outcome(&world, change).unwrap_err();
        assert!(reasons[0].starts_with("the new program of `main/filter` was not healthy"), "{reasons:?}");
        assert_eq!(lives(&world), [1, 3, 3, 1], "{way}: the other one is put back, too");
        check(&mut world);
        assert_eq!(revision(&mut world).revision, 0);
        world.run_for(Duration::from_secs(20));
        assert_eq!(world.ending(call), &Ending::Done(vec![]), "{way}");
    }
}

#[test]
fn a_plain_service_that_ends_on_probation_is_put_back() {
    let module = |way| format!("module Watcher(host) {{ exec \"sh Watcher {way}\"; plain; service; }}\n");
    let feed = FEED.replace("task instof Long(\"c2\");", "task instof Long(\"c2\"); watcher instof Watcher(\"c2\");");
    let feed = feed.replace("# task", "# watcher # task");
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", &(module("good") + &feed));
    world.run_for(Duration::from_secs(1));
    let change = world.change("c1", &(module("bad") + &feed), (1, 0), &[]);
    world.run_for(Duration::from_secs(1));
    let watcher = world.alive.iter().find(|(_, process)| world.modules[process] == "Watcher").unwrap().1.leaf;
    world.end("c2", watcher, ShimReport::Exited { code: 0 });
    world.run_for(Duration::from_secs(4));
    let reasons = outcome(&world, change).unwrap_err();
    assert!(reasons[0].contains("`main/watcher` was not healthy: a service ended by itself"), "{reasons:?}");
    assert!(!is_over(&world, call), "the mission goes on");
    assert_eq!(revision(&mut world).revision, 0);
}

/// The watchdog finds that later than the probation would end that was asked for.
#[test]
fn a_program_that_hangs_from_its_first_calculation_on_is_put_back() {
    let mut world = World::new(&["c1", "c2"]);
    let before = FEED.replace("# task", "# (task ;; skip)").replace(" { watchdog 200 ms; }", ";");
    let call = world.deploy("c1", &before);
    world.run_for(Duration::from_secs(1));
    let text = before.replace("Tuned(\"c2\")", "Tuned(\"c2\", better)");
    let change = world.change("c1", &text, (1, 0), &[]);
    world.run_for(Duration::from_secs(7));
    assert_eq!(world.answers.get(&change), None, "nobody knows yet");
    let why = EndReason::Watchdog(Duration::from_secs(5));
    world.end("c2", 1, ShimReport::Ended { end: ProgramEnd::Signal(6), why });
    world.run_for(Duration::from_secs(6));
    let reasons = outcome(&world, change).unwrap_err();
    assert!(reasons[0].starts_with("the new program of `main/filter` was not healthy"), "{reasons:?}");
    check(&mut world);
    assert_eq!((lives(&world), revision(&mut world).revision), (vec![1, 3, 1, 1], 0));
    assert!(!is_over(&world, call), "the mission goes on");
}

#[test]
fn wires_change_without_a_restart() {
    let mut world = World::new(&["c1", "c2"]);
    let call = start(&mut world);
    let text =
        FEED.replace("{ sensor, Out -> filter, In; }", "{ sensor, Out -> filter, Other; sensor, Out -> sink, Other; }");
    let change = world.change("c1", &text, (1, 0), &[]);
    world.run_for(Duration::from_secs(1));
    assert_eq!(outcome(&world, change).map(|lines| lines.len()), Ok(3));
    assert_eq!(lives(&world), [1, 1, 1, 1]);
    assert_eq!(world.wires_open, BTreeSet::from([1, 2, 3]));
    check(&mut world);
    // A program that is started again has the new wires.
    let change = world.change("c1", &text, (1, 1), &["main/filter", "main/filter"]);
    world.run_for(Duration::from_secs(4));
    assert_eq!(outcome(&world, change), Ok(vec!["replace    main/filter: started again".to_owned()]));
    assert_eq!(lives(&world), [1, 2, 1, 1]);
    check(&mut world);
    let change = world.change("c1", FEED, (1, 2), &[]);
    world.run_for(Duration::from_secs(1));
    assert_eq!(outcome(&world, change).map(|lines| lines.len()), Ok(3));
    check(&mut world);
    world.run_for(Duration::from_secs(20));
    assert_eq!(world.ending(call), &Ending::Done(vec![]));
    assert_eq!((&world.alive, &world.wires_open), (&BTreeSet::new(), &BTreeSet::new()));
}

#[test]
fn of_two_people_the_first_one_wins_and_the_other_is_told() {
    let mut world = World::new(&["c1", "c2"]);
    start(&mut world);
    let text = |way: &str| FEED.replace("Tuned(\"c2\")", &format!("Tuned(\"c2\", {way})"));
    let first = world.change("c1", &text("better"), (1, 0), &[]);
    let second = world.change("c1", &text("best"), (1, 0), &[]);
    world.run_for(Duration::from_secs(6));
    let third = world.change("c1", &text("best"), (1, 0), &[]);
    let other = world.change("c1", &text("best"), (2, 0), &[]);
    world.run_for(Duration::from_secs(1));
    assert!(outcome(&world, first).is_ok());
    assert_eq!(outcome(&world, second), Err(vec!["ann is changing `test` at this moment".to_owned()]));
    let why = "in the meantime, ann has changed `test`; `dca plan` shows its present state";
    assert_eq!(outcome(&world, third), Err(vec![why.to_owned()]));
    assert_eq!(outcome(&world, other), Err(vec!["`test@2` does not run here".to_owned()]));
}

#[test]
fn what_a_host_cannot_do_changes_nothing_anywhere() {
    let mut world = World::new(&["c1", "c2"]);
    start(&mut world);
    let text = format!("module Unknown(host) {{ in In: Number; in Other: Number; out Out: Number; service; }}\n{FEED}")
        .replace("Tuned(\"c2\")", "Unknown(\"c2\")")
        .replace("Tuned(\"c1\")", "Tuned(\"c1\", better)");
    let change = world.change("c1", &text, (1, 0), &[]);
    world.run_for(Duration::from_secs(1));
    let reasons = outcome(&world, change).unwrap_err();
    assert!(reasons[0].starts_with("host `c2`: no program here offers the controller type `Unknown`"), "{reasons:?}");
    let text =
        FEED.replace("Tuned(\"c2\")", "Tuned(\"c2\", missing)").replace("Tuned(\"c1\")", "Tuned(\"c1\", better)");
    let change = world.change("c1", &text, (1, 0), &[]);
    world.run_for(Duration::from_secs(1));
    let why = "host `c2`: `main/filter` cannot be started: there is no such program";
    assert_eq!(outcome(&world, change), Err(vec![why.to_owned()]));
    assert_eq!(lives(&world), [1, 1, 1, 1]);
    check(&mut world);
}

pub(super) fn is_over(world: &World, call: u64) -> bool {
    matches!(world.last_report(call), Report::Finished { .. } | Report::Refused { .. })
}

/// A change is made as a whole or not at all, with any losses, delays and kills.
#[test]
fn a_change_is_made_everywhere_or_nowhere() {
    a_change_is_made_everywhere_or_nowhere_for(0..100);
}

#[test]
#[ignore = "long: 900 seeds"]
fn a_change_is_made_everywhere_or_nowhere_for_more_seeds() {
    a_change_is_made_everywhere_or_nowhere_for(100..1000);
}

fn a_change_is_made_everywhere_or_nowhere_for(seeds: Range<u64>) {
    let count = seeds.end - seeds.start;
    let (mut made, mut undone, mut refused) = (0, 0, 0);
    for seed in seeds.clone() {
        let mut draw = Draw::new(seed);
        let mut world = World::new(&["c1", "c2"]);
        world.loses_by_chance = (seed % 3 > 0).then(|| (Draw::new(!seed), 4 + seed % 20));
        let call = start(&mut world);
        let mut ways = ["good", "better", "dies", "aborts"].into_iter().cycle().skip(draw.index(4));
        let mut text =
            FEED.replace("Tuned(\"c2\")", &format!("Tuned(\"c2\", {})", ways.next().expect("there are enough ways")));
        if draw.below(2) == 0 {
            text = text.replace("Tuned(\"c1\")", "Tuned(\"c1\", better)");
        }
        if draw.below(2) == 0 {
            text = text.replace("filter, In; }", "filter, Other; sensor, Out -> sink, Other; }");
        }
        let change = world.change("c1", &text, (1, 0), &[]);
        world.run_for(Duration::from_millis(draw.below(40)));
        match draw.below(4) {
            0 => world.kill_if_alive("c2", 1),
            1 => world.kill_if_alive("c1", 2),
            2 => drop(world.stop("c1")),
            _ => {}
        }
        world.run_for(Duration::from_secs(7));
        if world.answers.contains_key(&change) && !is_over(&world, call) {
            check(&mut world);
        }
        world.run_for(Duration::from_secs(60));
        assert!(is_over(&world, call), "seed {seed}: {:?}", world.answers[&call]);
        match outcome(&world, change) {
            Ok(_) => made += 1,
            Err(reasons) if reasons.iter().any(|reason| reason.contains("not healthy")) => undone += 1,
            Err(_) => refused += 1,
        }
        assert_eq!((&world.alive, &world.wires_open), (&BTreeSet::new(), &BTreeSet::new()), "seed {seed}");
    }
    assert!(
        made * 10 > count && undone * 10 > count && refused * 10 > count,
        "{made} made, {undone} taken back, {refused} refused"
    );
}

/// Four restarts in a minute, then a change that is taken back, by its own program or since another one was not healthy: one is left.
#[test]
fn a_program_that_is_put_back_has_the_restarts_that_it_had_left() {
    for (filter, sink) in [("aborts", "good"), ("better", "aborts")] {
        let mut world = World::new(&["c1", "c2"]);
        let before =
            FEED.replace("{ watchdog 200 ms; }", "{ restart transient; }").replace("# task", "# (task ;; skip)");
        world.deploy("c1", &before);
        world.run_for(Duration::from_secs(1));
        let kill = |world: &mut World| {
            world.kill("c2", 1);
            world.run_for(Duration::from_secs(2));
        };
        (0..4).for_each(|_| kill(&mut world));
        let text = before
            .replace("Tuned(\"c2\")", &format!("Tuned(\"c2\", {filter})"))
            .replace("Tuned(\"c1\")", &format!("Tuned(\"c1\", {sink})"));
        let change = world.change("c1", &text, (1, 0), &[]);
        world.run_for(Duration::from_secs(25));
        assert!(outcome(&world, change).is_err());
        let is_there = |world: &World| world.alive.iter().any(|(_, process)| process.leaf == 1);
        kill(&mut world);
        assert!(is_there(&world), "{filter}: the fifth restart");
        kill(&mut world);
        assert!(!is_there(&world), "{filter}: it is given up");
    }
}
