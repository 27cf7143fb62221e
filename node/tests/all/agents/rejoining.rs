//! Hosts that were lost, or whose nodes were restarted, rejoin: on virtual time.

use super::changes::outcome;
use super::losses::{active, cut, heal};
use super::world::{Draw, World};
use node::logic::protocol::{Answer, Ending, Report};
use std::collections::BTreeSet;
use std::ops::Range;
use std::time::Duration;

/// A group on c2 is restarted whenever it has failed. It hears a sensor on c1, and a program on c3 hears it.
const AGAIN: &str = r#"
process Far(there) {
    host { there }
    external_io { In = long, In; Out = long, Out; }
    instantiated_processes { long instof Tuned(there); step instof Long(there); }
    internal_event_actions { long, step }
}
process main() {
    host { "c1" }
    instantiated_processes {
        sensor instof Sensor("c1");
        near instof Tuned("c3");
        far instof Far("c2");
    }
    internal_connections(sensor, lbl1) { sensor, Out -> far, In; far, Out -> near, In; }
    internal_event_actions { sensor[lbl1], near, ((far else skip) ;; wait(1 s)) }
}
"#;

fn begun() -> (World, u64) {
    let mut world = World::new(&["c1", "c2", "c3"]);
    let call = world.deploy("c1", AGAIN);
    world.run_for(Duration::from_secs(1));
    assert_eq!(active(&world, "c2").len(), 2, "{:?}", world.answers[&call]);
    (world, call)
}

/// Returns how often hosts have made their links.
fn linked(world: &World, call: u64) -> usize {
    let is_linked = |answer: &&Answer| matches!(answer, Answer::Report(Report::Connected { .. }));
    world.answers[&call].iter().filter(is_linked).count()
}

/// A home that was away does not know which hosts lost it. A host that left in the meantime reports this, and rejoins.
#[test]
fn who_left_while_the_home_was_away_takes_part_again() {
    let alone =
        AGAIN.replace("near instof Tuned(\"c3\");", "").replace("; far, Out -> near, In;", ";").replace("near, ", "");
    for seconds in 6..=30 {
        let mut world = World::new(&["c1", "c2"]);
        world.deploy("c1", &alone);
        world.run_for(Duration::from_secs(1));
        world.crash("c1");
        world.run_for(Duration::from_secs(seconds));
        assert_eq!(active(&world, "c2"), Vec::<u32>::new(), "they stop by their own rules");
        world.adopt("c1");
        world.run_for(Duration::from_secs(20));
        assert_eq!(active(&world, "c2").len(), 2, "the home was away for {seconds} s");
    }
}

/// After a long cut nothing runs on the host by itself, but the expression finds its programs again; its wires are open as before,
/// in both directions.
#[test]
fn a_lost_host_takes_part_again() {
    let (mut world, call) = begun();
    let wires = world.wires_open.clone();
    assert_eq!(wires.len(), 2);
    let dialled = |world: &World| world.dialled.values().filter(|sessions| !sessions.is_empty()).count();
    let dialling = dialled(&world);
    for round in 1..=3 {
        cut(&mut world, "c2");
        world.run_for(Duration::from_secs(12));
        assert_eq!(active(&world, "c2"), Vec::<u32>::new(), "it stops by its own rules");
        world.wires_open.clear();
        heal(&mut world, "c2");
        world.run_for(Duration::from_secs(10));
        assert_eq!(active(&world, "c2").len(), 2, "round {round}: {:?}", world.answers[&call]);
        assert_eq!(linked(&world, call), 3 + round);
        assert!(wires.iter().any(|wire| world.wires_open.contains(wire)), "{:?}", world.wires_open);
        assert_eq!(dialled(&world), dialling);
    }
    world.stop("c1");
    world.run_for(Duration::from_secs(30));
    assert_eq!(world.ending(call), &Ending::Stopped);
    assert_eq!(world.alive, BTreeSet::new());
}

/// A host that cannot take part again at first is asked again, until it can.
#[test]
fn who_cannot_is_asked_again() {
    let (mut world, call) = begun();
    cut(&mut world, "c2");
    world.run_for(Duration::from_secs(12));
    world.fails_at_start = true;
    heal(&mut world, "c2");
    world.run_for(Duration::from_secs(20));
    assert_eq!(active(&world, "c2"), Vec::<u32>::new());
    world.fails_at_start = false;
    world.run_for(Duration::from_secs(60));
    assert_eq!(active(&world, "c2").len(), 2, "{:?}", world.answers[&call]);
}

/// Hosts are cut off at any time and return while frames are lost. No report of a process is about an earlier one,
/// nothing runs twice, and in the end all run again, or nothing is left after a stop.
#[test]
fn whatever_is_cut_whenever_all_run_again() {
    whatever_is_cut_whenever_all_run_again_for(0..100);
}

#[test]
#[ignore = "long: 200 seeds"]
fn whatever_is_cut_whenever_all_run_again_for_more_seeds() {
    whatever_is_cut_whenever_all_run_again_for(100..300);
}

fn whatever_is_cut_whenever_all_run_again_for(seeds: Range<u64>) {
    for seed in seeds {
        let mut draw = Draw::new(seed);
        let (mut world, call) = begun();
        world.loses_by_chance = Some((Draw::new(seed), 5));
        let mut away: BTreeSet<&str> = BTreeSet::new();
        for _ in 0..10 {
            let host = ["c2", "c3"][draw.index(2)];
            if away.remove(host) {
                heal(&mut world, host);
            } else {
                away.insert(host);
                cut(&mut world, host);
            }
            world.run_for(Duration::from_millis(draw.below(9000)));
        }
        for host in away {
            heal(&mut world, host);
        }
        world.loses_by_chance = None;
        let stops = draw.below(3) == 0;
        if stops {
            world.run_for(Duration::from_millis(draw.below(3000)));
            world.stop("c1");
        }
        world.run_for(Duration::from_secs(120));
        let has_ended = matches!(world.answers[&call].last(), Some(Answer::Report(Report::Finished { .. })));
        if has_ended {
            // `near` on c3 is never restarted.
            assert_eq!(world.alive, BTreeSet::new(), "seed {seed}");
        } else {
            assert!(!stops, "seed {seed}: it was stopped: {:?}", world.answers[&call].last());
            // It may pause at this moment.
            let runs = |world: &mut World| {
                world.run_for(Duration::from_millis(100));
                active(world, "c2").len() == 2
            };
            assert!((0..30).any(|_| runs(&mut world)), "seed {seed}: {:?}", world.answers[&call]);
        }
    }
}

/// A host that is back ends its programs, which takes a while. The next try of its home comes during this time: it
/// fails and is reported.
#[test]
fn who_ends_its_part_begins_nothing_in_it() {
    let text = r#"
process Far(there, other) {
    host { there }
    instantiated_processes {
        slow instof Stubborn(there) { on_link_loss keep; }
        next instof Sensor(other) { on_link_loss keep; }
    }
    internal_event_actions { slow? ; next }
}
process main() {
    host { "c1" }
    instantiated_processes { sensor instof Sensor("c1"); far instof Far("c2", "c3"); }
    internal_event_actions { sensor, ((far else skip) ;; wait(300 ms)) }
}
"#;
    for millis in (0..600).step_by(10) {
        let mut world = World::new(&["c1", "c2", "c3"]);
        let call = world.deploy("c1", text);
        world.run_for(Duration::from_secs(1));
        cut(&mut world, "c2");
        world.run_for(Duration::from_secs(12) + Duration::from_millis(millis));
        assert_eq!(active(&world, "c2").len(), 1, "it goes on");
        heal(&mut world, "c2");
        for _ in 0..100 {
            world.run_for(Duration::from_millis(200));
            assert_eq!(active(&world, "c3"), Vec::<u32>::new(), "nothing follows from what was given up");
        }
        assert_eq!(active(&world, "c2").len(), 1, "after {millis} ms: {:?}", world.answers[&call]);
    }
}

/// A program is replaced on a host at any time of its return: that is refused with the reason, or it is done, and either way the host takes
/// part again.
#[test]
fn a_program_is_replaced_on_a_host_that_comes_back() {
    let mut outcomes = BTreeSet::new();
    for millis in (0..3000).step_by(60).chain((190..400).step_by(3)) {
        let (mut world, call) = begun();
        cut(&mut world, "c2");
        world.run_for(Duration::from_secs(12));
        heal(&mut world, "c2");
        world.run_for(Duration::from_millis(millis));
        let replaced = world.change("c1", AGAIN, (1, 0), &["main/far/long"]);
        world.run_for(Duration::from_secs(60));
        outcomes.insert(match outcome(&world, replaced) {
            Ok(_) => "done",
            Err(reasons) if reasons[0] == "host `c2` is lost, so nothing can be changed on it" => "lost",
            Err(reasons) if reasons[0].starts_with("host `c2` is about to take part again") => "coming",
            // The home has not heard of that yet.
            Err(reasons) if reasons[0] == "host `c2`: its node has left the deployment" => "left",
            Err(reasons) => panic!("after {millis} ms: {reasons:?}"),
        });
        let runs = |world: &mut World| {
            world.run_for(Duration::from_millis(100));
            active(world, "c2").len() == 2
        };
        assert!((0..30).any(|_| runs(&mut world)), "after {millis} ms: {:?}", world.answers[&call]);
    }
    println!("{outcomes:?}");
    assert!(["done", "lost"].iter().all(|outcome| outcomes.contains(outcome)), "{outcomes:?}");
}
