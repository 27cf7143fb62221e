//! `dca estop` on virtual time: everything ends at once, whatever the plan still wants, and nothing begins before the
//! release.

use super::TWO_HOSTS;
use super::losses::{FOUR, cut, heal};
use super::world::World;
use node::logic::protocol::{Answer, Ending, Estop, Estopped, FailureCause, Report, Request};
use std::collections::BTreeSet;
use std::time::Duration;

fn estop() -> Estop {
    Estop { by: "ann@c1".into(), reason: "a person in the cell".into() }
}

fn stop_all(world: &mut World, host: &str) -> u64 {
    world.ask(host, Request::Estop(estop()))
}

fn nothing_left() -> Answer {
    Answer::Estopped(Estopped::default())
}

/// The hosts of the living programs.
fn hosts_alive(world: &World) -> BTreeSet<String> {
    world.alive.iter().map(|(host, _)| host.clone()).collect()
}

#[test]
fn everything_ends_without_what_the_plan_does_at_its_end_and_stays_so() {
    let mut world = World::new(&["c1", "c2"]);
    let text = TWO_HOSTS.replace("first instof Step", "first instof Long").replace("pair ; last", "pair finally last");
    let call = world.deploy("c1", &text);
    world.run_for(Duration::from_millis(500));
    let asked = ["c1", "c2"].map(|host| stop_all(&mut world, host));
    world.run_for(Duration::from_secs(3));
    for asked in asked {
        assert_eq!(world.answers[&asked], [nothing_left()]);
    }
    assert_eq!(world.alive, BTreeSet::new());
    assert!(!world.log.iter().any(|line| line == "Step with wires {}"), "`last` has not run: {:?}", world.log);
    let Ending::Aborted(failure) = world.ending(call) else { panic!("{:?}", world.ending(call)) };
    assert_eq!(failure.cause, FailureCause::Estop(estop()));
    assert!(failure.to_string().starts_with("main: was ended: everything was stopped by ann@c1: a person in the cell"));
    assert_eq!((&world.estops["c1"], &world.estops["c2"]), (&Some(estop()), &Some(estop())));

    let refused = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_secs(3));
    let Report::Refused { reasons } = world.last_report(refused) else { panic!("not refused") };
    let why = "everything was stopped by ann@c1: a person in the cell; `dca estop --release` lets programs begin again";
    assert_eq!(reasons, &[why]);
    let released = world.ask("c1", Request::ReleaseEstop);
    world.run_for(Duration::from_millis(10));
    assert_eq!(world.answers[&released], [Answer::Released { was_stopped: true, unwritten: None }]);
    let refused = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_secs(3));
    let Report::Refused { reasons } = world.last_report(refused) else { panic!("not refused") };
    assert_eq!(reasons, &[format!("host `c2`: {why}")], "the other one is not released");
    let released = world.ask("c2", Request::ReleaseEstop);
    let again = world.deploy("c1", TWO_HOSTS);
    world.run_for(Duration::from_secs(5));
    assert_eq!(world.answers[&released], [Answer::Released { was_stopped: true, unwritten: None }]);
    assert_eq!(world.ending(again), &Ending::Done(vec![]));
    assert_eq!(world.estops["c2"], None);
}

/// At any moment of a start, and for any host that hears of it first: people read the user who stopped everything as
/// the cause.
#[test]
fn at_each_moment_of_a_start_the_cause_is_who_has_stopped_everything() {
    for (millis, order) in (0..40).flat_map(|millis| [(millis, ["c1", "c2"]), (millis, ["c2", "c1"])]) {
        let mut world = World::new(&["c1", "c2"]);
        let call = world.deploy("c1", &TWO_HOSTS.replace("first instof Step", "first instof Long"));
        world.run_for(Duration::from_millis(millis));
        for host in order {
            stop_all(&mut world, host);
            world.run_for(Duration::from_millis(15));
        }
        world.run_for(Duration::from_secs(10));
        let told = match world.last_report(call) {
            Report::Refused { reasons } => reasons.join("; "),
            Report::Finished { ending: Ending::Aborted(failure), .. } => failure.to_string(),
            other => panic!("{millis} ms, {order:?}: {other:?}"),
        };
        assert!(told.contains("everything was stopped by ann@c1"), "{millis} ms, {order:?}: {told}");
        assert!(!told.contains("has ended its part"), "{millis} ms, {order:?}: {told}");
    }
}

/// A part with an unreachable home also ends, and stays ended when the home is back, which would want it again.
#[test]
fn a_host_that_has_lost_its_home_ends_its_part() {
    let mut world = World::new(&["c1", "c2", "c3", "c4"]);
    world.deploy("c1", FOUR);
    world.run_for(Duration::from_millis(500));
    assert!(hosts_alive(&world).contains("c2"), "{:?}", world.alive);
    cut(&mut world, "c1");
    let asked = stop_all(&mut world, "c2");
    world.run_for(Duration::from_secs(3));
    assert_eq!(world.answers[&asked], [nothing_left()]);
    assert!(!hosts_alive(&world).contains("c2"), "{:?}", world.alive);
    heal(&mut world, "c1");
    world.run_for(Duration::from_secs(60));
    assert!(!hosts_alive(&world).contains("c2"), "{:?}", world.alive);
}

/// The home knows the deployment until each host has confirmed the end or is lost, so a person can see and stop it.
#[test]
fn the_home_tells_of_an_end_that_a_host_has_not_confirmed() {
    let mut world = World::new(&["c1", "c2", "c3", "c4"]);
    let call = world.deploy("c1", FOUR);
    world.run_for(Duration::from_millis(500));
    cut(&mut world, "c2");
    stop_all(&mut world, "c1");
    let mut ending = 0;
    for _ in 0..100 {
        let is_over = matches!(world.answers[&call].last(), Some(Answer::Report(Report::Finished { .. })));
        let asked = world.ask("c1", Request::Status);
        world.run_for(Duration::from_millis(1));
        let [Answer::Status(status)] = &world.answers[&asked][..] else { panic!("{:?}", world.answers[&asked]) };
        assert_eq!(status.deployments.is_empty(), is_over, "{status:?}");
        ending += usize::from(!is_over && status.deployments[0].processes.is_empty());
        world.run_for(Duration::from_millis(100));
    }
    assert!(ending > 10, "the home has waited {ending} times for the host that is cut off");
}

/// A program that cannot be ended is named; a second command finds it still there.
#[test]
fn what_could_not_be_ended_is_named() {
    let mut world = World::new(&["c1", "c2"]);
    (world.immortal, world.lingers) = (true, true);
    let text = r#"process main() { host { "c1" } instantiated_processes { rock instof Stubborn("c2"); } internal_event_actions { rock } }"#;
    world.deploy("c1", text);
    world.run_for(Duration::from_millis(500));
    assert_eq!(hosts_alive(&world), ["c2".to_owned()].into());
    for _ in 0..2 {
        let asked = stop_all(&mut world, "c2");
        world.run_for(Duration::from_secs(30));
        let unended = vec!["test@1 main/rock".to_owned()];
        assert_eq!(world.answers[&asked], [Answer::Estopped(Estopped { unended, unwritten: None })]);
    }
}

/// Nothing runs, but the disk does not have the stop: the caller is told, and so is the user who releases it. Once the
/// disk has it, nothing is reported.
#[test]
fn what_the_disk_does_not_have_is_told() {
    let mut world = World::new(&["c1", "c2"]);
    world.disk_ms = 700;
    world.disk_refuses = Some("no space is left".to_owned());
    let asked = stop_all(&mut world, "c2");
    world.run_for(Duration::from_millis(600));
    assert!(!world.answers.contains_key(&asked), "the disk has not answered");
    world.run_for(Duration::from_millis(200));
    let unwritten = Some("no space is left".to_owned());
    let estopped = Answer::Estopped(Estopped { unended: Vec::new(), unwritten: unwritten.clone() });
    assert_eq!(world.answers[&asked], [estopped]);
    let released = world.ask("c2", Request::ReleaseEstop);
    world.run_for(Duration::from_secs(1));
    assert_eq!(world.answers[&released], [Answer::Released { was_stopped: true, unwritten }]);
    world.disk_refuses = None;
    // A later wish overtakes an earlier one: both are answered with the result of the last write.
    let (asked, released) = (stop_all(&mut world, "c2"), world.ask("c2", Request::ReleaseEstop));
    world.run_for(Duration::from_secs(1));
    assert_eq!(world.answers[&asked], [nothing_left()]);
    assert_eq!(world.answers[&released], [Answer::Released { was_stopped: true, unwritten: None }]);
    assert_eq!(world.estops["c2"], None);
}

/// The node is killed between the command and the end of its programs: the next node goes on with the stop, and has no
/// caller to answer.
#[test]
fn a_node_that_is_killed_meanwhile_goes_on_with_it() {
    let mut world = World::new(&["c1", "c2"]);
    world.deploy("c1", &TWO_HOSTS.replace("first instof Step", "first instof Long"));
    world.run_for(Duration::from_millis(500));
    world.crash_after("c2", 0);
    stop_all(&mut world, "c2");
    world.run_for(Duration::from_millis(100));
    world.adopt("c2");
    world.run_for(Duration::from_secs(10));
    assert!(!hosts_alive(&world).contains("c2"), "{:?}", world.alive);
    let status = world.ask("c2", Request::Status);
    world.run_for(Duration::from_millis(10));
    let [Answer::Status(status)] = &world.answers[&status][..] else { panic!("{:?}", world.answers[&status]) };
    assert_eq!((&status.estop, &world.estops["c2"]), (&Some(estop()), &Some(estop())));
}
