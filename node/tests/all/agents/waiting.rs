//! Deployments that wait to be resumed after a reboot are listed, and a stop ends them for good, on virtual time.

use super::boot::{LONG, on_both, power_off, power_on, runs, told};
use super::world::World;
use node::logic::protocol::{Answer, Deployment, Report, Request, StopReply, Tombstone, WaitingDeployment};
use std::collections::BTreeSet;
use std::time::Duration;

/// Returns the deployments that have not begun, as their home lists them.
fn waiting(world: &mut World) -> Vec<WaitingDeployment> {
    let call = world.ask("c1", Request::Status);
    world.run_for(Duration::from_millis(1));
    let Some(Answer::Status(status)) = world.answers.remove(&call).unwrap_or_default().pop() else {
        panic!("it says how it is")
    };
    status.waiting
}

/// A mission that runs on both hosts, and whose home was rebooted 3 s ago; with or without the other host.
fn rebooted(is_other_there: bool) -> World {
    let mut world = World::new(&["c1", "c2"]);
    world.deploy("c1", LONG);
    world.run_for(Duration::from_secs(1));
    assert_eq!(runs(&world), on_both(1));
    power_off(&mut world, "c1");
    if !is_other_there {
        power_off(&mut world, "c2");
    }
    world.run_for(Duration::from_secs(3));
    power_on(&mut world, "c1", true);
    world.run_for(Duration::from_secs(3));
    world
}

/// Kills the node, which is started again in the same boot.
fn kill(world: &mut World) {
    world.crash("c1");
    world.run_for(Duration::from_millis(500));
    world.adopt("c1");
    world.run_for(Duration::from_millis(500));
}

/// Reboots the home once more, and gives it time to begin anything.
fn reboot(world: &mut World) {
    power_off(world, "c1");
    world.run_for(Duration::from_secs(1));
    power_on(world, "c1", true);
    world.run_for(Duration::from_secs(200));
}

#[test]
fn what_waits_is_listed_with_the_reason() {
    let mut world = rebooted(true);
    let listed = waiting(&mut world);
    let text: Vec<String> = listed.iter().map(|one| format!("{} {one}", one.name)).collect();
    assert_eq!(text, ["test waits to be resumed, in 7 s"]);
    let before = Some(Deployment { name: "test".into(), epoch: 1 });
    assert_eq!((&listed[0].resumes, listed[0].by.as_str()), (&before, "ann"));
    world.run_for(Duration::from_secs(10));
    assert_eq!((waiting(&mut world), runs(&world)), (Vec::new(), on_both(2)), "it has begun");

    let mut world = rebooted(false);
    let text = |world: &mut World| waiting(world).first().map(ToString::to_string);
    assert_eq!(text(&mut world).unwrap(), "waits to be resumed, in 7 s, for c2 (at most 117 s)");
    world.run_for(Duration::from_secs(10));
    assert_eq!(text(&mut world).unwrap(), "waits to be resumed, for c2 (at most 107 s)");
    world.run_for(Duration::from_secs(150));
    assert_eq!(text(&mut world), None, "it was given up");
}

/// A deployment that was just asked for may wait for a host as well.
#[test]
fn what_was_deployed_just_now_is_listed_and_stopped() {
    let mut world = World::new(&["c1"]);
    let deployed = world.deploy("c1", LONG);
    world.run_for(Duration::from_millis(500));
    assert_eq!(waiting(&mut world)[0].to_string(), "waits to begin, for c2 (at most 2 s)");
    let stop = world.stop("c1");
    world.run_for(Duration::from_secs(10));
    assert_eq!(world.answers[&stop], [Answer::Stop(StopReply::Stopped)]);
    let reasons = vec!["it was stopped before it ran".to_owned()];
    assert_eq!(world.last_report(deployed), &Report::Refused { reasons });
}

/// With all hosts or not, at once or after another kill of the node: a stopped mission does not begin, in this boot or
/// the next one.
#[test]
fn a_stop_ends_the_waiting_for_good() {
    for (is_other_there, kills_before, kills_after) in
        [(true, 0, 0), (true, 1, 1), (false, 0, 0), (false, 0, 2), (false, 2, 0)]
    {
        let case = (is_other_there, kills_before, kills_after);
        let mut world = rebooted(is_other_there);
        (0..kills_before).for_each(|_| kill(&mut world));
        assert_eq!(waiting(&mut world).len(), 1, "{case:?}");
        let stop = world.stop("c1");
        world.run_for(Duration::from_millis(10));
        assert_eq!(world.answers[&stop], [Answer::Stop(StopReply::Stopped)], "{case:?}");
        assert_eq!((waiting(&mut world), world.kept["c1"].len()), (Vec::new(), 0), "{case:?}");
        let Answer::Report(Report::Refused { reasons }) = told(&mut world, 1) else { panic!("{case:?}") };
        assert_eq!(reasons, ["the deployment is not resumed: it was stopped before it ran"], "{case:?}");
        (0..kills_after).for_each(|_| kill(&mut world));
        if !is_other_there {
            power_on(&mut world, "c2", true);
        }
        world.run_for(Duration::from_secs(200));
        assert_eq!(runs(&world), BTreeSet::new(), "{case:?}");
        reboot(&mut world);
        assert_eq!(runs(&world), BTreeSet::new(), "{case:?}: nor after one more reboot");
    }
}

/// A kill of the node during the wait changes neither the programs that begin nor their time.
#[test]
fn what_waits_outlives_its_node() {
    let mut world = rebooted(true);
    kill(&mut world);
    assert!(world.kept["c1"][&1].waits, "also if that node is one that takes nothing over");
    assert_eq!(waiting(&mut world)[0].to_string(), "waits to be resumed, in 6 s");
    world.run_for(Duration::from_secs(10));
    assert_eq!(runs(&world), on_both(2));
}

/// The answer to a stop promises that it is for good, so it comes after the disk. A node that is killed before asks the disk again.
#[test]
fn a_stop_is_answered_when_the_disk_has_it() {
    for is_killed in [false, true] {
        let mut world = rebooted(true);
        world.disk_ms = 900;
        let before = world.kept["c1"].clone();
        let stop = world.stop("c1");
        world.run_for(Duration::from_millis(800));
        assert_eq!(world.answers.get(&stop), None, "the disk does not have it");
        if is_killed {
            // It had not got that far.
            world.crash("c1");
            world.kept.insert("c1".to_owned(), before);
            world.adopt("c1");
            world.run_for(Duration::from_secs(1));
            assert_eq!(world.answers.get(&stop), None, "who asked is gone with the node that was asked");
        } else {
            world.run_for(Duration::from_millis(200));
            assert_eq!(world.answers[&stop], [Answer::Stop(StopReply::Stopped)]);
        }
        assert_eq!(world.kept["c1"].len(), 0);
        reboot(&mut world);
        assert_eq!(runs(&world), BTreeSet::new());
    }
}

#[test]
fn a_disk_that_refuses_to_forget_is_told() {
    let mut world = rebooted(true);
    world.disk_refuses = Some("read-only file system".to_owned());
    let stop = world.stop("c1");
    world.run_for(Duration::from_secs(20));
    let why = "`test` does not begin while this node runs, but may begin after a reboot: host `c1` cannot store that `test` was stopped: \
               read-only file system";
    assert_eq!(world.answers[&stop], [Answer::Refused(why.to_owned())]);
    assert_eq!(runs(&world), BTreeSet::new());
}

/// The stop of a running mission is answered when the disk has it.
#[test]
fn a_running_mission_is_reported_as_stopped_when_the_disk_has_it() {
    let mut world = World::new(&["c1", "c2"]);
    let deployed = world.deploy("c1", LONG);
    world.run_for(Duration::from_secs(1));
    world.disk_ms = 5_000;
    let stop = world.stop("c1");
    world.run_for(Duration::from_millis(4_900));
    assert_eq!((runs(&world), world.answers.get(&stop)), (BTreeSet::new(), None));
    assert!(!matches!(world.last_report(deployed), Report::Finished { .. }), "{:?}", world.last_report(deployed));
    world.run_for(Duration::from_millis(200));
    assert_eq!(world.answers[&stop], [Answer::Stop(StopReply::Stopped)]);
    assert!(matches!(world.last_report(deployed), Report::Finished { .. }), "{:?}", world.last_report(deployed));
    // A disk that does not answer holds it up for as long as a host that does not.
    world.deploy("c1", LONG);
    world.run_for(Duration::from_secs(20));
    world.disk_ms = 1_000_000;
    let stop = world.stop("c1");
    world.run_for(Duration::from_secs(40));
    assert_eq!(world.answers[&stop], [Answer::Stop(StopReply::Stopped)]);
}

/// A tombstone is kept until the home has written down that the deployment is stopped.
#[test]
fn a_tombstone_stays_until_the_home_has_it_on_its_disk() {
    let mut world = World::new(&["c1", "c2"]);
    world.deploy("c1", LONG);
    world.run_for(Duration::from_secs(1));
    power_off(&mut world, "c1");
    world.run_for(Duration::from_secs(20));
    let tombstone = Tombstone { home: "c1".into(), deployment: Deployment { name: "test".into(), epoch: 1 } };
    world.ask("c2", Request::StopAway(Box::new(tombstone)));
    world.run_for(Duration::from_millis(10));
    world.disk_ms = 3_000;
    power_on(&mut world, "c1", true);
    world.run_for(Duration::from_millis(2_900));
    assert_eq!(world.tombstones["c2"].len(), 1, "the disk of the home does not have it");
    world.run_for(Duration::from_secs(2));
    assert_eq!((world.tombstones["c2"].len(), world.kept["c1"].len()), (0, 0));
    reboot(&mut world);
    assert_eq!(runs(&world), BTreeSet::new());
}
