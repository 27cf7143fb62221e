//! Processes of another deployment: found while a mission is prepared, watched while it runs, and there after it.

use super::world::World;
use node::logic::effect::ProcessId;
use node::logic::protocol::{Deployment, Ending, Report, Request};
use std::time::Duration;

const HARDWARE: &str = r#"
process main() {
    host { "c1" }
    instantiated_processes { base instof Server("c2"){ restart temporary; } }
    internal_event_actions { base }
}
"#;

const MISSION: &str = r#"
process main() {
    host { "c1" }
    instantiated_processes {
        base instof Server("c2"){ runs_in hardware; }
        client instof Client("c1");
        work instof Long("c1");
    }
    internal_connections { client, Go -> base, Drive; }
    internal_event_actions { base, client, work }
}
"#;

fn process(name: &str, epoch: u64, leaf: u32) -> ProcessId {
    ProcessId { deployment: Deployment { name: name.to_owned(), epoch }, leaf }
}

/// The server of the hardware, which is deployed first.
fn server() -> ProcessId {
    process("hardware", 1, 0)
}

fn with_hardware(hardware: &str) -> (World, u64) {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy_as("hardware", "c1", hardware);
    world.run_for(Duration::from_secs(1));
    (world, call)
}

#[track_caller]
fn refused(world: &World, call: u64, expected: &str) {
    let Report::Refused { reasons } = world.last_report(call) else { panic!("{:?}", world.last_report(call)) };
    assert_eq!(reasons, &[format!("host `c2`: `main/base` runs in another deployment: {expected}")]);
}

#[track_caller]
fn aborted(world: &World, call: u64, why: &str) {
    let Ending::Aborted(failure) = world.ending(call) else { panic!("{:?}", world.ending(call)) };
    assert_eq!(failure.origin, "main/base", "{failure}");
    assert!(failure.to_string().starts_with(&format!("main ← base: was not there any more: {why} at ")), "{failure}");
}

#[test]
fn a_mission_uses_what_runs_and_leaves_it_running() {
    let (mut world, _) = with_hardware(HARDWARE);
    for _ in 0..2 {
        let call = world.deploy("c1", MISSION);
        world.run_for(Duration::from_secs(1));
        let leaves = world.alive.iter().filter(|(_, process)| process.deployment.name == "test").count();
        assert_eq!(leaves, 2, "no program is started for what another deployment runs");
        world.run_for(Duration::from_secs(20));
        assert_eq!(world.ending(call), &Ending::Done(vec![]));
        assert_eq!((world.alive.len(), world.lives[&server()]), (1, 1), "the hardware goes on in the same program");
    }
}

#[test]
fn what_is_not_there_is_refused_with_one_sentence() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", MISSION);
    world.run_for(Duration::from_secs(5));
    refused(&world, call, "no deployment `hardware` runs there; deploy it first");
    assert_eq!(world.alive.len(), 0);
    let (mut world, _) = with_hardware(HARDWARE);
    for (from, to, why) in [
        ("runs_in hardware", "runs_in hardware \"main/legs\"", "`hardware` runs no `main/legs` there"),
        ("Server(\"c2\")", "Sensor(\"c2\")", "`main/base` of `hardware` is a `Server`, not a `Sensor`"),
    ] {
        let mut text = MISSION.replace(from, to);
        if to.starts_with("Sensor") {
            text = text.replace("client, Go -> base, Drive;", "");
        }
        let call = world.deploy("c1", &text);
        world.run_for(Duration::from_secs(5));
        refused(&world, call, why);
    }
    // On another host of the hardware it is not there either.
    let call = world.deploy("c1", &MISSION.replace("Server(\"c2\")", "Server(\"c1\")"));
    world.run_for(Duration::from_secs(5));
    let Report::Refused { reasons } = world.last_report(call) else { panic!("not refused") };
    assert_eq!(reasons, &["host `c1`: `main/base` runs in another deployment: `hardware` runs no `main/base` there"]);
}

#[test]
fn a_mission_hears_at_once_that_the_hardware_has_ended() {
    // It is stopped, it dies, or the node that runs it is gone for good.
    for way in 0..2 {
        let (mut world, _) = with_hardware(HARDWARE);
        let call = world.deploy("c1", MISSION);
        world.run_for(Duration::from_secs(1));
        if way == 0 {
            world.ask("c1", Request::Stop { name: "hardware".into() });
        } else {
            world.die("c2", &server(), shim::protocol::ShimReport::Signalled { signal: 9 });
        }
        world.run_for(Duration::from_secs(5));
        match way {
            // The expression of the hardware ends first, and then its part on this host.
            0 => {
                let Ending::Aborted(failure) = world.ending(call) else { panic!("{:?}", world.ending(call)) };
                let why = failure.to_string();
                assert!(why.contains("`main/base` of `hardware` is not active") || why.contains("has ended"), "{why}");
            }
            _ => aborted(&world, call, "`main/base` of `hardware` has died"),
        }
        assert_eq!(world.alive.len(), 0);
    }
}

#[test]
fn who_does_not_watch_it_goes_on_without_it() {
    let (mut world, _) = with_hardware(HARDWARE);
    let call = world.deploy("c1", &MISSION.replace("base, client, work", "client, work"));
    world.run_for(Duration::from_secs(1));
    world.ask("c1", Request::Stop { name: "hardware".into() });
    world.run_for(Duration::from_secs(20));
    assert_eq!(world.ending(call), &Ending::Done(vec![]));
}

/// A program that its own deployment restarts has another address then: its callers are told, and no expression sees
/// anything.
#[test]
fn a_restart_of_the_hardware_is_no_fault_of_the_mission() {
    let (mut world, _) = with_hardware(&HARDWARE.replace("temporary", "transient"));
    let call = world.deploy("c1", MISSION);
    world.run_for(Duration::from_secs(1));
    let client =
        world.alive.iter().map(|(_, process)| process.clone()).find(|one| world.modules[one] == "Client").unwrap();
    world.die("c2", &server(), shim::protocol::ShimReport::Signalled { signal: 9 });
    world.run_for(Duration::from_secs(2));
    assert_eq!(world.lives[&server()], 2);
    assert!(world.dialled[&client].contains("leaf 0 life 2"), "{:?}", world.dialled[&client]);
    world.run_for(Duration::from_secs(20));
    assert_eq!(world.ending(call), &Ending::Done(vec![]));
}

/// A node that is killed and rebuilt from its inputs keeps its watches.
#[test]
fn a_node_that_was_killed_watches_on() {
    for ends in [false, true] {
        let (mut world, _) = with_hardware(HARDWARE);
        let call = world.deploy("c1", MISSION);
        world.run_for(Duration::from_secs(1));
        world.crash("c2");
        world.run_for(Duration::from_millis(500));
        world.adopt("c2");
        world.run_for(Duration::from_millis(500));
        if ends {
            world.die("c2", &server(), shim::protocol::ShimReport::Signalled { signal: 9 });
            world.run_for(Duration::from_secs(5));
            aborted(&world, call, "`main/base` of `hardware` has died");
        } else {
            world.run_for(Duration::from_secs(20));
            assert_eq!(world.ending(call), &Ending::Done(vec![]));
            assert_eq!(world.alive.len(), 1);
        }
    }
}

/// Its claims belong to its own deployment: a mission that only uses it claims nothing.
#[test]
fn the_hardware_alone_holds_its_devices() {
    let (mut world, _) = with_hardware(HARDWARE);
    let own = MISSION.replace("{ runs_in hardware; }", ";");
    let call = world.deploy("c1", &own);
    world.run_for(Duration::from_secs(5));
    let Report::Refused { reasons } = world.last_report(call) else { panic!("not refused") };
    assert_eq!(reasons, &["host `c2`: `wheels` is held by `main/base` of `hardware@1`; `dca stop hardware` ends that"]);
}
