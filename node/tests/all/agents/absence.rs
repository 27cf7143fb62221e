//! The reports of nodes on hosts that do not answer, and on deployments whose end such a host has not confirmed, on
//! virtual time.

use super::losses::{FOUR, active, cut, heal};
use super::world::{Coming, World};
use node::logic::agent::{Agent, Identity, Input};
use node::logic::node_state::NodeState;
use node::logic::programs::Programs;
use node::logic::protocol::{
    Absent, Answer, Change, Deployment, Ending, FailureCause, OpenEnd, Report, Request, StopReply, Why,
};
use std::time::Duration;

fn absent(world: &mut World, host: &str) -> Absent {
    let call = world.ask(host, Request::Absent);
    world.run_for(Duration::from_millis(1));
    match &world.answers[&call][..] {
        [Answer::Absent(absent)] => absent.clone(),
        other => panic!("{other:?}"),
    }
}

/// Returns the deployments that may still run somewhere, with the hosts that have not confirmed their end, and the
/// reasons.
fn ends(world: &mut World, host: &str) -> Vec<(u64, String, Why)> {
    let of = |end: OpenEnd| end.hosts.into_iter().map(move |host| (end.deployment.epoch, host.host, host.why));
    absent(world, host).ends.into_iter().flat_map(of).collect()
}

/// A lost host may still run its programs: both sides report this, for as long as it takes, and ask when it is back.
#[test]
fn an_end_that_nobody_has_confirmed_stays_open() {
    let mut world = World::new(&["c1", "c2"]);
    world.deploy("c1", FOUR);
    world.run_for(Duration::from_secs(1));
    cut(&mut world, "c2");
    world.run_for(Duration::from_secs(1));
    let away = absent(&mut world, "c1");
    assert_eq!(away.hosts.iter().map(|gone| (gone.host.as_str(), gone.lost)).collect::<Vec<_>>(), [("c2", false)]);
    let paths: Vec<&str> = away.processes.iter().map(|one| one.path.as_str()).collect();
    assert_eq!(paths, ["main/stays", "main/soon", "main/late", "main/other"], "they are on c2");
    world.run_for(Duration::from_secs(7));
    assert_eq!(ends(&mut world, "c1"), [(1, "c2".to_owned(), Why::Lost)]);
    world.run_for(Duration::from_secs(1800));
    let away = absent(&mut world, "c1");
    let heard = away.hosts.iter().map(|gone| (gone.host.as_str(), gone.lost, gone.heard.as_secs())).collect::<Vec<_>>();
    assert_eq!(heard, [("c2", true, 1808)]);
    world.run_for(Duration::from_secs(3600));
    assert_eq!((active(&world, "c2"), absent(&mut world, "c1").hosts), (vec![0], vec![]), "the list has an end");
    assert_eq!(ends(&mut world, "c1"), [(1, "c2".to_owned(), Why::Lost)], "what may still run is never forgotten");
    assert_eq!(world.settled, []);
    heal(&mut world, "c2");
    world.run_for(Duration::from_secs(5));
    assert_eq!((ends(&mut world, "c1"), world.alive.len()), (vec![], 0));
    let named = Deployment { name: "test".into(), epoch: 1 };
    assert_eq!(world.settled, [("c1".to_owned(), named)]);
}

/// While the home cannot be reached, the participants of a deployment report that it may go on there.
#[test]
fn who_took_part_speaks_for_a_home_that_is_lost() {
    let mut world = World::new(&["c1", "c2"]);
    let (deploy, far) = (world.deploy("c1", &FOUR.replace(" { on_link_loss keep; }", ";")), Duration::from_secs(20));
    world.run_for(Duration::from_secs(1));
    cut(&mut world, "c2");
    world.run_for(far);
    assert_eq!((active(&world, "c2"), ends(&mut world, "c2")), (vec![], vec![(1, "c1".to_owned(), Why::Lost)]));
    heal(&mut world, "c2");
    world.run_for(Duration::from_secs(3));
    assert_eq!((ends(&mut world, "c2"), ends(&mut world, "c1")), (vec![], vec![]));
    assert!(matches!(world.last_report(deploy), Report::Finished { .. }));
}

/// A person knows better: the robot was switched off.
#[test]
fn an_open_end_can_be_forgotten() {
    let mut world = World::new(&["c1", "c2"]);
    world.deploy("c1", FOUR);
    world.run_for(Duration::from_secs(1));
    cut(&mut world, "c2");
    world.run_for(Duration::from_secs(20));
    let deployment = Deployment { name: "test".into(), epoch: 1 };
    let mut replies = vec![];
    for _ in 0..2 {
        let call = world.ask("c1", Request::Forget { deployment: deployment.clone() });
        world.run_for(Duration::from_millis(1));
        replies.extend(world.answers[&call].clone());
    }
    assert_eq!(replies, [Answer::Stop(StopReply::Stopped), Answer::Stop(StopReply::Unknown)]);
    assert_eq!((ends(&mut world, "c1"), world.settled.len()), (vec![], 1));
}

/// A restarted home asks for the deployments in its journal, and reports this until it has been told.
#[test]
fn a_home_that_was_started_again_asks() {
    let mut world = World::new(&["c1", "c2"]);
    world.deploy("c1", FOUR);
    world.run_for(Duration::from_secs(1));
    let deployment = Deployment { name: "test".into(), epoch: 1 };
    let open = vec![(deployment.clone(), vec!["c1".to_owned(), "c2".to_owned()])];
    world.cut.insert("c2".to_owned());
    let identity = Identity {
        host: "c1".into(),
        boot: 9,
        pid: 1,
        machine: "c1".into(),
        epoch: 1,
        open,
        is_guarded: false,
        estop: None,
        earlier: Default::default(),
    };
    world.agents.insert("c1".into(), NodeState::new(Agent::new(identity, Programs::default(), world.now), world.now));
    world.boots.insert("c1".into(), 9);
    world.run_for(Duration::from_secs(60));
    assert_eq!(ends(&mut world, "c1"), [(1, "c2".to_owned(), Why::Restarted)]);
    world.cut.remove("c2");
    world.run_for(Duration::from_secs(10));
    assert_eq!((ends(&mut world, "c1"), active(&world, "c2")), (vec![], vec![]));
    assert_eq!(world.settled, [("c1".to_owned(), deployment)]);
}

/// A node that could not end everything says so until the last program has ended after all, as when its shim was suspended.
#[test]
fn a_host_that_could_not_end_everything_confirms_when_the_last_program_has_ended() {
    let mut world = World::new(&["c1", "c2"]);
    world.immortal = true;
    world.deploy("c1", &FOUR.replace("instof Sensor", "instof Stubborn"));
    world.run_for(Duration::from_millis(100));
    world.stop("c1");
    world.run_for(Duration::from_secs(60));
    let left = ends(&mut world, "c1");
    assert!(left.iter().any(|(_, host, why)| host == "c2" && *why == Why::Unable), "{left:?}");
    cut(&mut world, "c2");
    world.run_for(Duration::from_secs(10));
    heal(&mut world, "c2");
    world.run_for(Duration::from_secs(30));
    assert_eq!(ends(&mut world, "c1"), left);
    for (host, process) in world.alive.clone() {
        assert_ne!(ends(&mut world, "c1"), []);
        world.kill(&host, process.leaf);
        world.run_for(Duration::from_secs(1));
    }
    assert_eq!(ends(&mut world, "c1"), []);
}

/// A host that comes back while the deployment ends has time to confirm, as long as others have not.
#[test]
fn a_host_that_is_back_before_the_end_confirms_it() {
    let text = r#"
process main() {
    host { "c1" }
    instantiated_processes { far instof Sensor("c2") { on_link_loss keep; } other instof Sensor("c3"); }
    internal_event_actions { far ; other }
}
"#;
    let mut world = World::new(&["c1", "c2", "c3"]);
    let call = world.deploy("c1", text);
    world.run_for(Duration::from_secs(1));
    cut(&mut world, "c2");
    world.run_for(Duration::from_millis(4500));
    cut(&mut world, "c3");
    world.run_for(Duration::from_millis(1500));
    heal(&mut world, "c2");
    world.run_for(Duration::from_secs(60));
    let Report::Finished { at, unconfirmed, .. } = world.last_report(call) else { panic!("it has not ended") };
    assert_eq!((unconfirmed, at.as_secs()), (&vec!["c3".to_owned()], 10));
    assert_eq!(ends(&mut world, "c1"), [(1, "c3".to_owned(), Why::Lost)]);
}

/// A node that leaves says goodbye first: its host is listed as missing neither at once nor when it counts as lost.
#[test]
fn a_node_that_has_left_is_not_listed() {
    let mut world = World::new(&["c1", "c2"]);
    world.run_for(Duration::from_secs(2));
    world.at(0, "c2", Coming::Input(Input::Leave));
    for second in 0..10 {
        world.run_for(Duration::from_secs(1));
        assert_eq!(absent(&mut world, "c1").hosts, vec![], "after {second} s");
    }
    assert_eq!(world.agents.len(), 1, "it has left");
}

/// A mission that is given up for a host names the loss, which is the first thing that has failed, and each process has one end.
#[test]
fn a_host_that_is_lost_is_the_cause_and_each_end_is_told_once() {
    let text = r#"
process main() {
    host { "c1" }
    instantiated_processes {
        n instof Sensor("c2");
        o instof Long("c2");
        p instof Sensor("c2") { on_link_loss keep; }
        q instof Sensor("c1");
    }
    internal_event_actions { q, o, n, p }
}
"#;
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", text);
    world.run_for(Duration::from_secs(1));
    cut(&mut world, "c2");
    world.run_for(Duration::from_secs(30));
    let ends = world.answers[&call].iter().filter_map(|answer| match answer {
        Answer::Report(Report::Process { path, change: Change::Ended(ending), .. }) => Some((path.as_str(), ending)),
        _ => None,
    });
    let lost = FailureCause::HostLost("c2".into());
    let mut far: Vec<&str> = Vec::new();
    for (path, ending) in ends.filter(|(path, _)| ["main/n", "main/o", "main/p"].contains(path)) {
        assert!(matches!(ending, Ending::Aborted(failure) if failure.cause == lost), "{path}: {ending:?}");
        far.push(path);
    }
    far.sort_unstable();
    assert_eq!(far, ["main/n", "main/o", "main/p"]);
    let Report::Finished { ending: Ending::Aborted(failure), .. } = world.last_report(call) else {
        panic!("{:?}", world.last_report(call))
    };
    assert_eq!((failure.origin.as_str(), &failure.cause), (far[0], &lost));
}
