//! Deployments that are refused: by a host, by a disk, because of the version of a program or of a device that is held.

use super::TWO_HOSTS;
use super::world::{Coming, World};
use comms::logic::codec::WIRE_VERSION;
use comms::logic::time::Time;
use node::logic::agent::{Agent, Identity, Input};
use node::logic::node_state::NodeState;
use node::logic::programs::Programs;
use node::logic::protocol::{Ending, Report, is_unreached};
use std::collections::BTreeSet;
use std::time::Duration;

#[test]
fn every_reason_of_every_host_is_told_and_nothing_stays() {
    let mut world = World::new(&["c1", "c2"]);
    for host in ["c1", "c2"] {
        let (own, machine, open) = (host.to_owned(), host.to_owned(), Vec::new());
        let identity = Identity {
            host: own,
            boot: 9,
            pid: 1,
            machine,
            epoch: 0,
            open,
            is_guarded: false,
            estop: None,
            earlier: Default::default(),
        };
        world
            .agents
            .insert(host.into(), NodeState::new(Agent::new(identity, Programs::default(), Time::ZERO), Time::ZERO));
        world.boots.insert(host.into(), 9);
    }
    world.at(0, "c1", Coming::Input(Input::Appeared { host: "c2".into(), boot: 9 }));
    world.at(0, "c2", Coming::Input(Input::Appeared { host: "c1".into(), boot: 9 }));
    let call = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_secs(20));
    let Report::Refused { reasons } = world.last_report(call) else { panic!("not refused") };
    assert!(reasons.iter().any(|reason| reason.contains("host `c1`") && reason.contains("`Sensor`")), "{reasons:?}");
    assert!(reasons.iter().any(|reason| reason.contains("host `c2`") && reason.contains("`Step`")), "{reasons:?}");
}

/// A node that is started again must not give an epoch that has run to something else.
#[test]
fn nothing_runs_before_its_epoch_is_on_the_disk() {
    let mut world = World::new(&["c1", "c2"]);
    world.disk_ms = 4000;
    let call = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_millis(3990));
    assert_eq!((world.alive.len(), world.log.len()), (4, 0), "they are started, and idle");
    world.run_for(Duration::from_secs(5));
    assert_eq!((world.ending(call), world.log.len()), (&Ending::Done(vec![]), 4));

    world.disk_ms = 3_600_000;
    let call = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_secs(60));
    let Report::Refused { reasons } = world.last_report(call) else { panic!("not refused") };
    assert_eq!(reasons, &["the disk of its home did not take its epoch in time"]);
    assert_eq!((world.alive.len(), world.log.len()), (0, 4));
}

/// An epoch that is not on the disk could be given out again after a restart.
#[test]
fn nothing_runs_whose_epoch_the_disk_refuses_and_the_deployer_is_told() {
    let mut world = World::new(&["c1", "c2"]);
    world.disk_refuses = Some("no space left on device".to_owned());
    let call = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_secs(20));
    let Report::Refused { reasons } = world.last_report(call) else { panic!("{:?}", world.last_report(call)) };
    assert_eq!(reasons, &["host `c1`: the deployment's epoch cannot be written down: no space left on device"]);
    assert_eq!((world.alive.len(), world.log.len()), (0, 0));
    world.disk_refuses = None;
    let call = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_secs(5));
    assert_eq!(world.ending(call), &Ending::Done(vec![]));
}

#[test]
fn a_program_of_another_version_is_refused_with_both_versions() {
    let mut world = World::new(&["c1", "c2"]);
    world.version = Some(WIRE_VERSION + 1);
    let call = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_secs(20));
    let Report::Refused { reasons } = world.last_report(call) else { panic!("not refused") };
    let expected = format!(
        "`main/pair/sensor` (and 1 other) cannot take part on `c1`: it speaks version {} of the control protocol, this node version \
         {WIRE_VERSION}; ",
        WIRE_VERSION + 1
    );
    assert!(reasons.len() == 2 && reasons.iter().any(|reason| reason.starts_with(&expected)), "{reasons:?}");
    assert_eq!(world.alive, BTreeSet::new());
}

fn with_arm(main: &str, module: &str) -> String {
    format!(
        r#"process main() {{
    host {{ "{main}" }}
    instantiated_processes {{ a instof {module}("c3"); }}
    internal_event_actions {{ a ; wait(1 s) }}
}}"#
    )
}

/// A device is held by one deployment at a time, whether its spec claims it or its program declares it.
#[test]
fn one_arm_is_held_by_one_deployment() {
    for (first, second) in [("Arm", "Arm"), ("Owner", "Owner"), ("Arm", "Owner"), ("Eye", "Arm")] {
        let mut world = World::new(&["c1", "c2", "c3"]);
        let calls = [
            world.deploy_as("door", "c1", &with_arm("c1", first)),
            world.deploy_as("copy", "c2", &with_arm("c2", second)),
        ];
        world.run_for(Duration::from_secs(5));
        let reports: Vec<_> = calls.iter().map(|call| world.last_report(*call)).collect();
        let is_done = |report: &&&Report| matches!(report, Report::Finished { ending: Ending::Done(_), .. });
        assert_eq!(reports.iter().filter(is_done).count(), 1, "{first} beside {second}: {reports:?}");
        let holder = if is_done(&&reports[0]) { "door" } else { "copy" };
        let held = format!("`arm` is held by `main/a` of `{holder}@1`; `dca stop {holder}` ends that");
        let expected = [format!("host `c3`: {held}"), format!("`main/a` cannot take part on `c3`: {held}")];
        let refused = reports.iter().find_map(|report| match report {
            Report::Refused { reasons } => Some(reasons),
            _ => None,
        });
        assert!(matches!(&refused.unwrap()[..], [why] if expected.contains(why)), "{refused:?}");
        assert_eq!((world.log.len(), world.alive.len()), (1, 0), "it has run once");
        // A deployment that is over holds nothing.
        let again = world.deploy_as("copy", "c2", &with_arm("c2", second));
        world.run_for(Duration::from_secs(5));
        assert_eq!(world.ending(again), &Ending::Done(vec![]));
    }
}

#[test]
fn any_number_may_look_at_one_arm() {
    let mut world = World::new(&["c1", "c2", "c3"]);
    let calls =
        [world.deploy_as("door", "c1", &with_arm("c1", "Eye")), world.deploy_as("copy", "c2", &with_arm("c2", "Eye"))];
    world.run_for(Duration::from_secs(5));
    calls.iter().for_each(|call| assert_eq!(world.ending(*call), &Ending::Done(vec![])));
}

#[test]
fn a_host_that_nobody_has_seen_refuses_at_once() {
    let mut world = World::new(&["c1"]);
    let call = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_secs(5));
    let Report::Refused { reasons } = world.last_report(call) else { panic!("not refused") };
    assert!(reasons.iter().any(|reason| reason.contains("host `c2` cannot be reached")), "{reasons:?}");
    assert!(is_unreached(reasons), "{reasons:?}");
    assert_eq!(world.alive, BTreeSet::new());
}

/// The exit code tells the user that this was not a refusal: the host could not be reached.
#[test]
fn a_host_that_is_lost_while_it_prepares_is_told_as_such() {
    for after in 0..12 {
        let mut world = World::new(&["c1", "c2"]);
        let call = world.deploy("c1", TWO_HOSTS);
        world.run_for(Duration::from_millis(after));
        super::losses::cut(&mut world, "c2");
        world.run_for(Duration::from_secs(30));
        match world.last_report(call) {
            Report::Refused { reasons } => assert!(is_unreached(reasons), "{after} ms: {reasons:?}"),
            other => assert!(matches!(other, Report::Finished { .. }) && after > 8, "{after} ms: {other:?}"),
        }
    }
}
