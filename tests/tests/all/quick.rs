//! Times for which a person waits: until one machine answers, and until a command reports that its mission is lost.

use comms::io::clock::now;
use comms::io::session::Session;
use comms::logic::{codec, key};
use dca_tests::cluster::{Cluster, Host, Network, Program, SOON, Stream};
use node::logic::protocol::Request;
use rustix::process::Signal;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// The longest time of a command on an otherwise idle machine.
const QUIET: Duration = Duration::from_millis(200);
/// The longest time of a command as a multiple of a program's start and a question, if these two take long.
const RATIO: u32 = 3;
/// The number of measurements of each command. The fastest one counts, since this machine also has other users.
const TIMES: usize = 7;
/// The longest time until a command reports that its mission is lost.
const LOST_WITHIN: Duration = Duration::from_secs(6);

/// Gives the machine to one measuring test at a time.
fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

fn took(act: impl FnOnce()) -> Duration {
    let began = now();
    act();
    now() - began
}

/// Does the least that asking a node can need: a program starts, and a question goes to the node and back.
fn bare(host: &Host) {
    assert_eq!(host.ask(&["--version"]).code, Some(0));
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
    runtime.expect("a machine has threads").block_on(async {
        let socket = host.run_dir().join("c1/node.sock");
        let session = Session::open_client(&socket).await.expect("the node is there");
        let question = codec::encode(&Request::Status).expect("it is short");
        session.call(&key::rpc("c1", "request"), question, SOON).await.expect("the node answers");
        session.close().await;
    });
}

/// `dca nodes` and `dca status` answer within a fifth of a second, or within the least time that this machine needs.
#[test]
fn nodes_and_status_answer_at_once() {
    let _alone = alone();
    let cluster = Cluster::new();
    let here = cluster.here();
    let _nodes = ["c1", "c2"].map(|name| here.node(name, &[]));
    let mut quickest = [Duration::MAX; 3];
    for _ in 0..TIMES {
        let ask = |verb| {
            let ended = here.ask(&[verb]);
            assert_eq!(ended.code, Some(0), "{ended}");
        };
        let all = [took(|| bare(&here)), took(|| ask("nodes")), took(|| ask("status"))];
        for (best, one) in quickest.iter_mut().zip(all) {
            *best = one.min(*best);
        }
    }
    let [bare, nodes, status] = quickest;
    println!("bare {bare:.1?}, dca nodes {nodes:.1?}, dca status {status:.1?}");
    for time in [nodes, status] {
        assert!(time <= QUIET.max(bare * RATIO), "{quickest:?}");
    }
}

/// Deploys an endless mission on `c1` from `host`, and waits until the mission runs.
fn deployed(cluster: &Cluster, host: &Host) -> Program {
    let text = "
process main() {
    host { c1 }
    instantiated_processes { source instof RateSource(c1, 1 kB); }
    internal_event_actions { source }
}
";
    let mission = host.dca(&["deploy", &cluster.file("forever.dca", text)]);
    mission.wait_for(Stream::Err, "▸", SOON);
    mission
}

/// Returns the time until the command reports that its mission is lost. It checks the output.
#[track_caller]
fn says_that_it_is_lost(mission: Program, since: comms::logic::time::Time) -> Duration {
    let ended = mission.ended(SOON);
    let took = now() - since;
    assert_eq!(ended.code, Some(3), "{ended}");
    assert!(ended.err.contains("the mission on `c1` is lost"), "{ended}");
    assert!(ended.out.starts_with("forever: "), "there is a summary: {ended}");
    took
}

/// The home of a mission is killed, or its cable is pulled. The command on another host reports this.
#[test]
fn a_mission_whose_home_died_is_told_as_lost() {
    let _alone = alone();
    let Some(network) = Network::new(2) else { return };
    let cluster = Cluster::new();
    let (first, second) = (cluster.host(&network, 1), cluster.host(&network, 2));
    let _c2 = second.node("c2", &["--lan"]);
    let c1 = first.node("c1", &["--lan"]);
    let mission = deployed(&cluster, &second);
    let began = now();
    c1.signal(Signal::KILL);
    let killed = says_that_it_is_lost(mission, began);
    drop(c1);
    let _c1 = first.node("c1", &["--lan"]);
    // The restarted node has taken over the mission.
    let stopped = first.ask(&["stop", "forever"]);
    assert_eq!(stopped.code, Some(0), "{stopped}");
    let mission = deployed(&cluster, &second);
    let began = now();
    network.cut(1);
    let cut = says_that_it_is_lost(mission, began);
    println!("told that it is lost {killed:.1?} after its home was killed, {cut:.1?} after its cable was pulled");
    // A cut cable sends no signal. It is noticed because messages are missing, and later on links with long delays.
    assert!(killed <= LOST_WITHIN && cut <= LOST_WITHIN + Duration::from_secs(2), "{killed:?}, {cut:?}");
}
