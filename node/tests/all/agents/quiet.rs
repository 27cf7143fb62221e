//! The nodes that a node asks each second and sends beats to: only those that a deployment involves.

use super::names::Asker;
use super::world::{Coming, World};
use node::logic::agent::Input;
use node::logic::nameserver::Change;
use std::time::Duration;

/// `c1` supervises all; `c2` supervises the group on `c3`. `c4` has a program that only the home supervises.
const NESTED: &str = r#"
process inner(there) {
    host { "c2" }
    instantiated_processes { far instof Sensor(there); }
    internal_event_actions { far }
}
process main() {
    host { "c1" }
    instantiated_processes { group instof inner("c3"); near instof Sensor("c4"); }
    internal_event_actions { group , near }
}
"#;

/// Returns the hosts that get beats from a host.
fn beaten(world: &World, host: &str) -> Vec<String> {
    world.agents[host].agent.beaten().iter().cloned().collect()
}

/// Returns how many rounds a host asks others in, within a minute.
fn rounds(world: &mut World, host: &str) -> u64 {
    let before = world.rounds[host];
    world.run_for(Duration::from_secs(60));
    world.rounds[host] - before
}

#[test]
fn who_has_a_part_hears_of_its_supervisors_and_of_whom_it_supervises() {
    let mut world = World::new(&["c1", "c2", "c3", "c4", "c5"]);
    world.run_for(Duration::from_secs(20));
    assert!(world.agents.keys().all(|host| beaten(&world, host).is_empty()));
    assert!(rounds(&mut world, "c1") <= 2, "nobody has anything to do");
    world.deploy("c1", NESTED);
    world.run_for(Duration::from_secs(20));
    let all = ["c1", "c2", "c3", "c4", "c5"].map(|host| beaten(&world, host));
    assert_eq!(all, [vec!["c2", "c3", "c4"], vec!["c1", "c3"], vec!["c1", "c2"], vec!["c1"], vec![]]);
    assert!((60..=64).contains(&rounds(&mut world, "c3")));
    assert!(rounds(&mut world, "c5") <= 2, "the mission is not its");
    world.stop("c1");
    world.run_for(Duration::from_secs(20));
    assert!(world.agents.keys().all(|host| beaten(&world, host).is_empty()));
    assert!(rounds(&mut world, "c1") <= 2);
}

/// A host is cut off the moment that a mission begins on it, in a network that was quiet for long.
#[test]
fn a_mission_in_a_quiet_network_misses_a_host_as_soon_as_ever() {
    for after in [0, 1, 7, 20, 100, 500] {
        let mut world = World::new(&["c1", "c2"]);
        world.run_for(Duration::from_secs(100));
        let text = "process main() { host { \"c1\" } instantiated_processes { a instof Sensor(\"c2\"); b instof Sensor(\"c1\"); } internal_event_actions { a , b } }";
        world.deploy("c1", text);
        world.run_for(Duration::from_millis(after));
        world.cut.insert("c2".to_owned());
        world.run_for(Duration::from_millis(2700));
        let told = |world: &World, wanted: fn(&Change) -> bool| {
            world.changes.iter().any(|(on, change)| on == "c1" && wanted(change))
        };
        assert!(told(&world, |change| matches!(change, Change::Missing { .. })), "{after} ms: {:?}", world.changes);
        world.run_for(Duration::from_millis(3500));
        assert!(told(&world, |change| matches!(change, Change::Lost { .. })), "{after} ms: {:?}", world.changes);
    }
}

/// A missed host is looked for, and found although its token is lost.
#[test]
fn a_host_that_comes_back_without_a_word_is_found_within_a_second() {
    let mut world = World::new(&["c1", "c2"]);
    world.run_for(Duration::from_secs(100));
    world.cut.insert("c2".to_owned());
    let boot = world.boots["c2"];
    world.at(0, "c1", Coming::Input(Input::Vanished { host: "c2".to_owned(), boot }));
    world.run_for(Duration::from_secs(600));
    world.changes.clear();
    world.cut.clear();
    world.run_for(Duration::from_millis(1100));
    assert!(world.changes.iter().any(|(on, change)| on == "c1" && matches!(change, Change::Appeared { .. })));
}

/// Nothing depends on any host: each is asked at most once a minute, and none is missed.
#[test]
fn an_idle_network_is_quiet() {
    let mut c1 = Asker::new();
    ["c2", "c3", "c4"].iter().for_each(|host| c1.lives(host, 7));
    c1.grow_quiet();
    c1.pass(600_000);
    assert_eq!((c1.rounds, &c1.asked["c2"], &c1.asked["c4"]), (10, &10, &10));
    // A host that matters is asked each second, and the others are not.
    c1.depends_on(&["c3"]);
    c1.pass(600_000);
    assert_eq!((c1.asked["c2"], c1.asked["c4"]), (20, 20));
    assert!((610..=612).contains(&c1.asked["c3"]), "{:?}", c1.asked);
    // It is left alone again, and its next answer is not missed.
    c1.depends_on(&[]);
    c1.pass(600_000);
    assert!(c1.asked["c3"] <= 633 && c1.took().is_empty(), "{:?}", c1.asked);
    // While a person looks, all are.
    c1.names.watch(c1.now);
    c1.pass(9_900);
    assert!(c1.asked["c2"] >= 30 + 9, "{:?}", c1.asked);
    assert!(c1.took().is_empty());
}

/// A host that becomes close is treated from then on like one that always was, whenever it was asked last.
#[test]
fn a_host_that_becomes_close_is_missed_as_soon_as_ever() {
    for rested in [0, 10, 500, 1000, 14_990, 59_500, 59_999] {
        for dies_first in [false, true] {
            let mut c1 = Asker::new();
            c1.lives("c2", 7);
            c1.lives("c3", 7);
            c1.grow_quiet();
            c1.pass(rested);
            if dies_first {
                c1.dies("c2", 7);
                c1.depends_on(&["c2", "c3"]);
            } else {
                c1.depends_on(&["c2", "c3"]);
                c1.pass(100);
                c1.dies("c2", 7);
            }
            let missed = c1.time_until(|c1| !c1.names.reaches("c2"));
            assert!(missed <= Duration::from_millis(2610), "{rested} ms, {dies_first}: {missed:?}");
            let lost = c1.time_until(|c1| !c1.names.knows("c2"));
            assert!(missed + lost <= Duration::from_millis(6110), "{rested} ms, {dies_first}: {lost:?}");
            assert!(c1.names.reaches("c3"), "the other one is there");
        }
    }
}

/// No message announces that it is gone, and nothing depends on it: the next question to all finds out.
#[test]
fn a_quiet_host_that_dies_without_a_word_is_missed_after_the_next_question() {
    for rested in [0, 1000, 15_000, 59_000] {
        let mut c1 = Asker::new();
        c1.lives("c2", 7);
        c1.grow_quiet();
        c1.pass(rested);
        c1.dies("c2", 7);
        let missed = c1.time_until(|c1| !c1.names.reaches("c2"));
        assert!(missed <= Duration::from_millis(62_510), "{missed:?}");
        let lost = c1.time_until(|c1| !c1.names.knows("c2"));
        assert!(lost <= Duration::from_millis(3510), "{lost:?}");
        // It is back without an announcement, and it is asked each second.
        c1.lives("c2", 7);
        let back = c1.time_until(|c1| c1.names.reaches("c2"));
        assert!(back <= Duration::from_millis(1010), "{back:?}");
    }
    // Its token goes: it is asked at once, like a host that matters.
    let mut c1 = Asker::new();
    c1.lives("c2", 7);
    c1.grow_quiet();
    c1.dies("c2", 7);
    c1.names.no_token(c1.now, "c2", 7);
    let missed = c1.time_until(|c1| !c1.names.reaches("c2"));
    assert!(missed <= Duration::from_millis(310), "{missed:?}");
}

/// A person looks: a host that was suspended in the meantime is missed after its usual time.
#[test]
fn what_a_person_sees_is_no_older_than_that_of_close_hosts() {
    let mut c1 = Asker::new();
    c1.lives("c2", 7);
    c1.grow_quiet();
    c1.pass(7000);
    c1.dies("c2", 7);
    c1.pass(1000);
    c1.names.watch(c1.now);
    let missed = c1.time_until(|c1| !c1.names.reaches("c2"));
    assert!(missed <= Duration::from_millis(2510), "{missed:?}");
}

/// A second node of a name joins a quiet network.
#[test]
fn a_second_node_of_a_quiet_one_is_refused_at_once() {
    let mut c1 = Asker::new();
    c1.lives("c2", 7);
    c1.grow_quiet();
    c1.lives("c2", 9);
    c1.names.token(c1.now, "c2", 9);
    let refused = c1.time_until(|c1| c1.changes.iter().any(|change| matches!(change, Change::Refused { .. })));
    assert!(refused <= Duration::from_millis(200), "{refused:?}");
    c1.lives("c1", 2);
    c1.names.token(c1.now, "c1", 2);
    let known = c1.time_until(|c1| c1.changes.iter().any(|change| matches!(change, Change::Namesake { .. })));
    assert!(known <= Duration::from_millis(200), "{known:?}");
    // Two of one name are asked each second.
    c1.asked.clear();
    c1.pass(60_000);
    assert!(c1.asked["c2"] >= 60 && c1.asked["c1"] >= 60, "{:?}", c1.asked);
}

/// A host at rest was heard until its link was lost, though it has answered up to a minute before.
#[test]
fn a_host_at_rest_was_heard_until_its_link_was_lost() {
    let mut c1 = Asker::new();
    c1.lives("c2", 7);
    c1.grow_quiet();
    c1.pass(40_000);
    c1.dies("c2", 7);
    let lost = c1.now;
    c1.names.no_token(lost, "c2", 7);
    c1.pass(1000);
    assert!(!c1.names.reaches("c2"));
    let heard = c1.names.heard("c2").expect("it is known");
    assert!(lost - heard <= Duration::from_secs(1) && heard <= lost, "{:?} before", lost - heard);
}
