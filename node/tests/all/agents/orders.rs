//! Hosts in a team: an order of the home starts nothing before a user's signature is verified.

use super::TWO_HOSTS;
use super::world::World;
use node::logic::protocol::{Ending, Report};
use std::collections::BTreeSet;
use std::time::Duration;

#[test]
fn what_is_signed_runs_and_is_judged_where_it_starts() {
    let mut world = World::guarded(&["c1", "c2"]);
    let call = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_secs(5));
    assert_eq!(world.ending(call), &Ending::Done(vec![]));
    let judged: Vec<(&str, u64)> = world.judged.iter().map(|(host, of)| (host.as_str(), of.epoch)).collect();
    assert_eq!(judged, [("c2", 1)], "the home has judged the call");
    assert_eq!(world.ended, [("c2".to_owned(), Ok(()))]);
}

/// An order that is accepted and not carried out is reported with its subject.
#[test]
fn what_was_accepted_and_failed_is_told_with_the_reason() {
    let mut world = World::guarded(&["c1", "c2"]);
    world.fails_at_start = true;
    let call = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_secs(20));
    assert!(matches!(world.last_report(call), Report::Refused { .. }));
    let [(host, Err(why))] = world.ended.as_slice() else { panic!("{:?}", world.ended) };
    assert!(host == "c2" && why.contains("cannot take part on `c2`"), "{why}");
}

#[test]
fn what_is_not_signed_runs_nowhere_and_the_user_is_told_why() {
    let mut world = World::guarded(&["c1", "c2"]);
    world.verdict = Some("it is not signed".to_owned());
    let call = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_secs(20));
    let Report::Refused { reasons } = world.last_report(call) else { panic!("not refused") };
    assert_eq!(reasons, &["host `c2`: it is not signed"]);
    assert_eq!((&world.alive, world.log.len()), (&BTreeSet::new(), 0));
}

/// The verdict waits for the disk. An order that has been cancelled in the meantime does not begin.
#[test]
fn what_is_called_off_before_its_verdict_does_not_begin() {
    let mut world = World::guarded(&["c1", "c2"]);
    world.disk_ms = 3000;
    let call = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_millis(1000));
    assert_eq!((world.judged.len(), &world.ended), (1, &Vec::new()));
    world.stop("c1");
    world.run_for(Duration::from_secs(20));
    let Report::Refused { reasons } = world.last_report(call) else { panic!("not refused") };
    assert_eq!(reasons, &["it was stopped before it ran"]);
    assert_eq!((&world.alive, world.log.len()), (&BTreeSet::new(), 0));
}

/// A host whose node was away rejoins only by signed orders.
#[test]
fn a_change_is_judged_before_anything_is_applied() {
    let mut world = World::guarded(&["c1", "c2"]);
    let long = TWO_HOSTS.replace("first instof Step", "first instof Long");
    let call = world.deploy_as("test", "c1", &long);
    world.run_for(Duration::from_millis(500));
    world.verdict = Some("it is not signed".to_owned());
    let change = world.change("c1", &long.replace("second instof Step", "second instof Long"), (1, 0), &[]);
    world.run_for(Duration::from_secs(8));
    let Report::Unchanged { reasons, .. } = world.last_report(change) else { panic!("not refused") };
    assert_eq!(reasons, &["host `c2`: it is not signed"]);
    world.stop("c1");
    world.run_for(Duration::from_secs(8));
    assert_eq!((world.ending(call), &world.alive), (&Ending::Stopped, &BTreeSet::new()));
}
