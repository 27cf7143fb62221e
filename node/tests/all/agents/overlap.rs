//! Programs that replace others while both run: a thousand values a second go through them at the same time.

use super::changes::{is_over, lives, outcome, revision};
use super::world::{Draw, World};
use node::logic::protocol::{Answer, Change, Report};
use shim::protocol::{EndReason, ProgramEnd, ShimReport};
use std::collections::BTreeSet;
use std::ops::Range;
use std::time::Duration;

/// A sensor on one host feeds a program on another, and that one a third. All of them may overlap.
const FEED: &str = r#"
process main() {
    host { "c1" }
    instantiated_processes {
        sensor instof Sensor("c1") { watchdog 200 ms; replace overlap; }
        filter instof Tuned("c2") { watchdog 200 ms; replace overlap; }
        sink instof Tuned("c1") { watchdog 200 ms; }
        task instof Long("c2");
    }
    internal_connections(sensor, feed) { sensor, Out -> filter, In; }
    internal_connections(filter, on) { filter, Out -> sink, In; }
    internal_event_actions { sensor[feed] # filter[on] # sink # (task ;; skip) }
}
"#;
const SINK: u32 = 2;
/// The next program is the first leaf that is added.
const NEXT: u32 = 4;

fn start(seed: u64) -> (World, u64) {
    let mut world = World::new(&["c1", "c2"]);
    world.loses_by_chance = (!seed.is_multiple_of(3)).then(|| (Draw::new(!seed), 8 + seed % 20));
    world.flow_on(seed);
    let call = world.deploy("c1", FEED);
    world.run_for(Duration::from_secs(2));
    (world, call)
}

fn filter(way: &str) -> String {
    FEED.replace("Tuned(\"c2\")", &format!("Tuned(\"c2\", {way})"))
}

/// Checks that a consumer has every number of a producer, once and in order, from its first number on.
#[track_caller]
fn check_numbers(world: &World, producer: u32, seed: u64) {
    let got = world.all_got(SINK).iter().filter(|(from, _)| *from == producer).map(|(_, number)| *number);
    let got: Vec<u64> = got.collect();
    let wrong = got.windows(2).find(|pair| pair[1] != pair[0] + 1);
    assert!(got.len() > 1000 && wrong.is_none(), "seed {seed}: {} values, {wrong:?}", got.len());
}

/// Returns the living programs, by leaf.
fn alive(world: &World) -> BTreeSet<u32> {
    world.alive.iter().map(|(_, process)| process.leaf).collect()
}

#[test]
fn a_program_overlaps_with_the_one_before_and_no_value_is_lost() {
    a_program_overlaps_with_the_one_before_and_no_value_is_lost_for(0..15);
}

#[test]
#[ignore = "long: 45 seeds"]
fn a_program_overlaps_with_the_one_before_and_no_value_is_lost_for_more_seeds() {
    a_program_overlaps_with_the_one_before_and_no_value_is_lost_for(15..60);
}

fn a_program_overlaps_with_the_one_before_and_no_value_is_lost_for(seeds: Range<u64>) {
    for seed in seeds {
        let (mut world, call) = start(seed);
        let change = world.change("c1", &filter("better"), (1, 0), &[]);
        world.run_for(Duration::from_secs(6));
        let lines = outcome(&world, change).unwrap_or_else(|why| panic!("seed {seed}: {why:?}"));
        assert!(lines.len() == 1 && lines[0].starts_with("replace    main/filter: "), "{lines:?}");
        assert!(lines[0].ends_with("; the two overlap"), "{lines:?}");
        check_numbers(&world, 0, seed);
        assert_eq!((alive(&world), lives(&world)), (BTreeSet::from([0, 2, 3, NEXT]), vec![1, 1, 1, 1, 1]));
        let got = world.all_got(NEXT).len();
        world.run_for(Duration::from_secs(1));
        assert!(world.all_got(NEXT).len() > got + 900, "seed {seed}: the next one gets them all");

        // Restarted, the first program returns under its number, and so on.
        for (revision, there) in [(1, 1), (2, NEXT), (3, 1)] {
            let again = world.change("c1", &filter("better"), (1, revision), &["main/filter"]);
            world.run_for(Duration::from_secs(6));
            let line = "replace    main/filter: started again; the two overlap";
            assert_eq!(outcome(&world, again), Ok(vec![line.to_owned()]), "seed {seed}");
            let next = if revision == 1 { 5 } else { there };
            assert!(alive(&world).len() == 4 && (revision > 1 || alive(&world).contains(&next)), "{:?}", alive(&world));
        }
        check_numbers(&world, 0, seed);
        assert!(!is_over(&world, call));
        world.stop("c1");
        world.run_for(Duration::from_secs(20));
        assert_eq!((&world.alive, &world.wires_open), (&BTreeSet::new(), &BTreeSet::new()), "seed {seed}");
    }
}

/// Clients that watch see one process, which is replaced.
#[test]
fn people_see_one_process() {
    let (mut world, call) = start(0);
    world.change("c1", &filter("better"), (1, 0), &[]);
    world.run_for(Duration::from_secs(6));
    let changes: Vec<&Change> = world.answers[&call]
        .iter()
        .filter_map(|answer| match answer {
            Answer::Report(Report::Process { path, change, .. }) if path == "main/filter" => Some(change),
            _ => None,
        })
        .filter(|change| !matches!(change, Change::Started { .. }))
        .collect();
    assert_eq!(changes, [&Change::Activated, &Change::Replacing, &Change::Resumed]);
}

/// A source hands over as well: the consumer takes all of the old one, then all of the next.
#[test]
fn sources_overlap_and_so_do_several_at_once() {
    sources_overlap_and_so_do_several_at_once_for(0..20);
}

#[test]
#[ignore = "long: 40 seeds"]
fn sources_overlap_and_so_do_several_at_once_for_more_seeds() {
    sources_overlap_and_so_do_several_at_once_for(20..60);
}

fn sources_overlap_and_so_do_several_at_once_for(seeds: Range<u64>) {
    for seed in seeds {
        let (mut world, _) = start(seed);
        let again: &[&str] = if seed % 2 == 0 { &["main/sensor"] } else { &["main/sensor", "main/filter"] };
        let change = world.change("c1", FEED, (1, 0), again);
        world.run_for(Duration::from_secs(6));
        assert_eq!(outcome(&world, change).map(|lines| lines.len()), Ok(again.len()), "seed {seed}");
        world.run_for(Duration::from_secs(2));
        let next = if seed % 2 == 0 {
            NEXT
        } else {
            *alive(&world).iter().find(|leaf| **leaf >= NEXT).expect("the next one runs")
        };
        check_numbers(&world, 0, seed);
        check_numbers(&world, next, seed);
        let from: Vec<u32> = world.all_got(SINK).iter().map(|(from, _)| *from).collect();
        assert!(from.is_sorted(), "seed {seed}: the old values come first");
    }
}

/// The previous program was never ended, so it continues at once.
#[test]
fn a_program_that_is_not_healthy_gives_back_what_it_has_taken() {
    for (way, seed) in ["dies", "aborts", "hangs"].into_iter().cycle().zip(0..60) {
        let (mut world, call) = start(seed);
        let change = world.change("c1", &filter(way), (1, 0), &[]);
        if way == "hangs" {
            world.run_for(Duration::from_secs(4));
            assert!(!world.answers.contains_key(&change), "its probation has not begun");
            let why = EndReason::StartTimeout(Duration::from_secs(4));
            world.end("c2", NEXT, ShimReport::Ended { end: ProgramEnd::Signal(6), why });
        }
        world.run_for(Duration::from_secs(6));
        let reasons = outcome(&world, change).unwrap_err();
        assert!(
            reasons[0].starts_with("the new program of `main/filter` was not healthy"),
            "{way} {seed}: {reasons:?}"
        );
        assert_eq!((alive(&world), lives(&world)[1]), (BTreeSet::from([0, 1, 2, 3]), 1), "{way} {seed}");
        let got = world.all_got(SINK).len();
        world.run_for(Duration::from_secs(1));
        assert!(world.all_got(SINK).len() > got + 900, "{way} {seed}: the mission goes on");
        let is_in_order = world.all_got(SINK).windows(2).all(|pair| pair[0].1 < pair[1].1);
        assert!(is_in_order, "{way} {seed}");
        if way == "hangs" {
            // It has never run, so it has taken nothing.
            check_numbers(&world, 0, seed);
        }
        assert_eq!(revision(&mut world).revision, 0);
        assert!(!is_over(&world, call));
    }
}

/// With any kill, stop or loss in between: the change ends as a whole, and nothing is left.
#[test]
fn an_overlap_is_made_or_taken_back_whatever_happens_meanwhile() {
    an_overlap_is_made_or_taken_back_whatever_happens_meanwhile_for(0..100);
}

#[test]
#[ignore = "long: 300 seeds"]
fn an_overlap_is_made_or_taken_back_whatever_happens_meanwhile_for_more_seeds() {
    an_overlap_is_made_or_taken_back_whatever_happens_meanwhile_for(100..400);
}

fn an_overlap_is_made_or_taken_back_whatever_happens_meanwhile_for(seeds: Range<u64>) {
    let count = seeds.end - seeds.start;
    let (mut made, mut undone) = (0, 0);
    for seed in seeds.clone() {
        let mut draw = Draw::new(seed);
        let (mut world, call) = start(seed);
        let ways = ["better", "best", "dies", "aborts"];
        let again: &[&str] = if draw.below(2) == 0 { &["main/sensor"] } else { &[] };
        let change = world.change("c1", &filter(ways[draw.index(4)]), (1, 0), again);
        world.run_for(Duration::from_millis(draw.below(60)));
        match draw.below(6) {
            0 => world.kill_if_alive("c2", 1),
            1 => world.kill_if_alive("c2", NEXT),
            2 => world.kill_if_alive("c1", SINK),
            3 => drop(world.stop("c1")),
            _ => {}
        }
        world.run_for(Duration::from_secs(20));
        match outcome(&world, change) {
            Ok(_) => made += 1,
            Err(_) => undone += 1,
        }
        if !is_over(&world, call) {
            let (got, plan) = (world.all_got(SINK).len(), revision(&mut world).plan);
            assert_eq!(alive(&world), plan.live_leaves(), "seed {seed}: {:?}", world.answers[&call]);
            assert_eq!(world.wires_open, plan.live_wires(), "seed {seed}");
            world.run_for(Duration::from_secs(1));
            assert!(world.all_got(SINK).len() > got + 900, "seed {seed}: it flows");
            world.stop("c1");
            world.run_for(Duration::from_secs(20));
        }
        assert!(is_over(&world, call), "seed {seed}: {:?}", world.answers[&call]);
        assert_eq!((&world.alive, &world.wires_open), (&BTreeSet::new(), &BTreeSet::new()), "seed {seed}");
    }
    assert!(made * 4 > count && undone * 4 > count, "{made} made, {undone} taken back");
}
