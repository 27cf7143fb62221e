//! Nodes that leave while deployments run.

use super::TWO_HOSTS;
use super::world::{Coming, World};
use node::logic::agent::Input;
use node::logic::protocol::{Answer, Ending, FailureCause, Report, StopReply};
use std::collections::BTreeSet;
use std::time::Duration;

#[test]
fn a_node_that_leaves_is_not_waited_for() {
    // While it prepares: nothing runs without it.
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_millis(4));
    world.at(0, "c2", Coming::Input(Input::Leave));
    world.run_for(Duration::from_secs(7));
    let Report::Refused { reasons } = world.last_report(call) else { panic!("{:?}", world.last_report(call)) };
    assert!(reasons.iter().any(|reason| reason.contains("host `c2`")), "{reasons:?}");
    assert_eq!(world.alive, BTreeSet::new());

    // While something runs there: that has failed.
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", &TWO_HOSTS.replace("first instof Step", "first instof Long"));
    world.run_for(Duration::from_millis(500));
    world.at(0, "c2", Coming::Input(Input::Leave));
    world.run_for(Duration::from_secs(10));
    let Report::Finished { ending: Ending::Aborted(failure), .. } = world.last_report(call) else {
        panic!("{:?}", world.last_report(call))
    };
    assert_eq!(failure.cause, FailureCause::NotAvailable("its host has ended its part".into()));
    assert_eq!(world.alive, BTreeSet::new());
}

/// A resource that was taken for a group is free when its programs have ended, not when its node announces that it
/// leaves.
#[test]
fn a_node_that_leaves_keeps_what_its_programs_use() {
    let text = r#"
process Group(there) {
    host { there }
    instantiated_processes { slow instof Stubborn(there); }
    internal_event_actions { slow }
}
process main() {
    host { "c1" }
    resource arm;
    instantiated_processes { far instof Group("c2"); near instof Step("c1"); other instof Step("c3"); }
    internal_event_actions { (using(arm) far)? , (wait(100 ms) ; using(arm) near) , other }
}
"#;
    let mut world = World::new(&["c1", "c2", "c3"]);
    let call = world.deploy("c1", text);
    world.run_for(Duration::from_millis(500));
    world.lingers = true;
    world.at(0, "c2", Coming::Input(Input::Leave));
    let begun = |world: &World| world.log.iter().filter(|line| line.starts_with("Step")).count();
    let is_alive = |world: &World| world.alive.iter().any(|(host, _)| host == "c2");
    world.run_for(Duration::from_millis(50));
    assert_eq!((is_alive(&world), begun(&world)), (true, 1), "its program takes its time");
    while is_alive(&world) {
        assert_eq!(begun(&world), 1);
        world.run_for(Duration::from_millis(1));
    }
    world.lingers = false;
    world.run_for(Duration::from_secs(1));
    assert_eq!(begun(&world), 2, "then it is free");
    assert!(matches!(world.ending(call), Ending::Done(_)), "{:?}", world.last_report(call));
}

#[test]
fn nodes_that_leave_together_do_not_wait_for_each_other() {
    // As `dca run` does when it is interrupted twice: a stop is under way when all of its nodes are to leave. A message that
    // is lost is sent again before its sender is gone.
    for late in 0..20 {
        let mut world = World::new(&["c1", "c2", "c3"]);
        let call = world.deploy("c1", &TWO_HOSTS.replace("first instof Step", "first instof Long"));
        world.run_for(Duration::from_millis(500));
        world.loses_one_in = Some(3);
        let stop = world.stop("c1");
        for host in ["c1", "c2", "c3"] {
            world.at(late, host, Coming::Input(Input::Leave));
        }
        world.run_for(Duration::from_secs(3));
        assert_eq!(world.ending(call), &Ending::Stopped, "after {late} ms");
        assert_eq!(world.answers[&stop], [Answer::Stop(StopReply::Stopped)]);
        assert_eq!((world.alive.len(), world.agents.len()), (0, 0), "after {late} ms");
    }
}

#[test]
fn a_node_that_has_left_is_not_waited_for_at_the_end() {
    // The programs at home take longer to stop than the node of the other host takes to leave.
    let text = r#"process main() {
    host { "c1" }
    instantiated_processes { slow instof Stubborn("c1"); long instof Long("c2"); }
    internal_event_actions { slow , long }
}"#;
    for late in 0..20 {
        let mut world = World::new(&["c1", "c2"]);
        let call = world.deploy("c1", text);
        world.run_for(Duration::from_millis(500));
        let stop = world.stop("c1");
        for host in ["c1", "c2"] {
            world.at(late, host, Coming::Input(Input::Leave));
        }
        world.run_for(Duration::from_secs(2));
        assert_eq!(world.answers[&stop], [Answer::Stop(StopReply::Stopped)], "after {late} ms");
        let Report::Finished { unconfirmed, .. } = world.last_report(call) else {
            panic!("{:?}", world.last_report(call))
        };
        assert_eq!((unconfirmed.len(), world.alive.len(), world.agents.len()), (0, 0, 0), "after {late} ms");
    }
}
