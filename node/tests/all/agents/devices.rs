//! The devices of hosts: their holders, the end of a hold, and refusals in between.

use super::world::World;
use node::logic::protocol::{Answer, Deployment, Ending, Report, Request, StopReply};
use std::time::Duration;

/// Two programs with a device each, on one host.
const TWO: &str = r#"
module A(host, way: Text = good) { exec "sh Script"; plain; done; claims arm; }
module B(host, way: Text = good) { exec "sh Script"; plain; done; claims leg; }
process main() {
    host { "c1" }
    instantiated_processes { a instof A("c2"); b instof B("c2"); }
    internal_event_actions { a ;; b }
}
"#;

/// Returns the held devices on a host, such as `arm: main/a of test`.
fn held(world: &mut World, host: &str) -> Vec<String> {
    let call = world.ask(host, Request::Names);
    world.run_for(Duration::from_millis(1));
    let [Answer::Names(names)] = &world.answers[&call][..] else { panic!("{:?}", world.answers[&call]) };
    names.devices.iter().map(|one| format!("{}: {} of {}", one.device, one.path, one.deployment.name)).collect()
}

/// Returns the reasons against a change; none if it was made.
#[track_caller]
fn reasons(world: &World, call: u64) -> Vec<String> {
    match world.last_report(call) {
        Report::Changed { .. } => Vec::new(),
        Report::Unchanged { reasons, .. } | Report::Refused { reasons } => reasons.clone(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn after_a_change_of_claims_the_holders_are_those_of_the_new_plan() {
    let swapped = TWO.replace("claims arm", "claims x").replace("claims leg", "claims arm");
    let other = TWO.replace("claims leg", "claims other");
    let replaced = other.replace("B(\"c2\")", "B(\"c2\", better)");
    let none = TWO.replace("claims arm;", "").replace("claims leg;", "");
    for (text, expected) in [
        (&swapped, &["arm: main/b of test", "x: main/a of test"][..]),
        (&other, &["arm: main/a of test", "other: main/b of test"]),
        (&replaced, &["arm: main/a of test", "other: main/b of test"]),
        (&none, &[]),
    ] {
        let mut world = World::new(&["c1", "c2"]);
        world.deploy("c1", TWO);
        world.run_for(Duration::from_secs(1));
        assert_eq!(held(&mut world, "c2"), ["arm: main/a of test", "leg: main/b of test"]);
        let change = world.change("c1", text, (1, 0), &[]);
        world.run_for(Duration::from_secs(30));
        assert_eq!(reasons(&world, change), Vec::<String>::new());
        assert_eq!(held(&mut world, "c2"), expected);
    }
}

/// A device of a new program is held from its hello on, not only once the change is made.
#[test]
fn what_a_new_program_owns_is_held_while_the_change_is_made() {
    let text = |module: &str| {
        format!(
            "process main() {{ host {{ \"c1\" }}
                instantiated_processes {{ a instof {module}(\"c1\"); long instof Long(\"c1\"); }}
                internal_event_actions {{ (a , long) ;; skip }} }}"
        )
    };
    let mut world = World::new(&["c1"]);
    world.deploy("c1", &text("Step"));
    world.run_for(Duration::from_secs(1));
    assert_eq!(held(&mut world, "c1"), Vec::<String>::new());
    let change = world.change("c1", &text("Owner"), (1, 0), &[]);
    world.run_for(Duration::from_secs(1));
    assert_eq!(world.answers.get(&change), None, "the new program is on probation");
    assert_eq!(held(&mut world, "c1"), ["arm: main/a of test"]);
    world.run_for(Duration::from_secs(30));
    assert_eq!((reasons(&world, change), held(&mut world, "c1")), (vec![], vec!["arm: main/a of test".to_owned()]));
}

#[test]
fn a_change_that_claims_what_another_deployment_holds_is_refused_and_one_taken_back_gives_it_free() {
    let mut world = World::new(&["c1", "c2"]);
    world.deploy("c1", TWO);
    world.deploy_as("door", "c1", &TWO.replace("claims arm", "claims eye").replace("claims leg", "claims ear"));
    world.run_for(Duration::from_secs(1));
    let before = held(&mut world, "c2");
    let change = world.change("c1", &TWO.replace("claims leg", "claims eye"), (1, 0), &[]);
    world.run_for(Duration::from_secs(1));
    let why = "`eye` is held by `main/a` of `door@2`; `dca stop door` ends that";
    assert_eq!(reasons(&world, change), [why]);
    let text = TWO.replace("claims leg", "claims tail").replace("A(\"c2\")", "A(\"c2\", dies)");
    let change = world.change("c1", &text, (1, 0), &[]);
    world.run_for(Duration::from_millis(100));
    assert!(held(&mut world, "c2").contains(&"tail: main/b of test".to_owned()), "while it is made");
    world.run_for(Duration::from_secs(40));
    assert!(reasons(&world, change)[0].contains("was not healthy"), "{:?}", reasons(&world, change));
    assert_eq!(held(&mut world, "c2"), before);
}

/// A program that could not be ended may still move the arm. It holds the arm until it has ended after all, or a person
/// releases it. No program of its name starts beside it.
#[test]
fn a_program_that_could_not_be_ended_holds_its_devices() {
    for is_forgotten in [true, false] {
        let mut world = World::new(&["c1", "c2"]);
        world.immortal = true;
        let door = TWO.replace("a ;; b", "a # (b ;; skip)").replace("sh Script", "sh Endless");
        world.deploy_as("door", "c1", &door);
        world.run_for(Duration::from_secs(1));
        world.ask("c1", Request::Stop { name: "door".into() });
        world.run_for(Duration::from_secs(60));
        assert_eq!(held(&mut world, "c2"), ["arm: main/a of door", "leg: main/b of door"]);
        let again = world.deploy("c1", TWO);
        world.run_for(Duration::from_secs(3));
        let why = "host `c2`: `arm` is held by `main/a` of `door@1`, which could not be ended and may still run; once you know \
                   better, `dca stop door --forget`";
        assert_eq!(reasons(&world, again), [why]);
        let same = world.deploy_as("door", "c1", &door);
        world.run_for(Duration::from_secs(3));
        let why = "host `c2`: programs of `door@1` could not be ended and may still run; once you know better, `dca stop door --forget`";
        assert_eq!(reasons(&world, same), [why]);
        if is_forgotten {
            let deployment = Deployment { name: "door".into(), epoch: 1 };
            for host in ["c1", "c2"] {
                let call = world.ask(host, Request::Forget { deployment: deployment.clone() });
                world.run_for(Duration::from_secs(1));
                assert_eq!(world.answers[&call], [Answer::Stop(StopReply::Stopped)], "{host}");
            }
        } else {
            for (host, process) in world.alive.clone() {
                assert_ne!(held(&mut world, "c2"), Vec::<String>::new());
                world.kill(&host, process.leaf);
                world.run_for(Duration::from_secs(1));
            }
        }
        assert_eq!(held(&mut world, "c2"), Vec::<String>::new());
        world.immortal = false;
        world.alive.clear();
        let last = world.deploy("c1", TWO);
        world.run_for(Duration::from_secs(3));
        assert!(!matches!(world.last_report(last), Report::Refused { .. }), "{:?}", world.last_report(last));
    }
}

#[test]
fn a_shim_that_is_suspended_is_killed_and_the_end_is_confirmed() {
    let mut world = World::new(&["c1", "c2"]);
    world.suspended = true;
    let call = world.deploy("c1", &TWO.replace("sh Script", "sh Endless"));
    world.run_for(Duration::from_secs(1));
    world.stop("c1");
    world.run_for(Duration::from_secs(60));
    assert_eq!(world.ending(call), &Ending::Stopped);
    assert_eq!((held(&mut world, "c2"), world.alive.len()), (vec![], 0));
}
