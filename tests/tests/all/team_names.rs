//! A stolen member has links to the others, like every member, and speaks under another name. It is not believed. The
//! attempt is one line of the audit log, and the others are told.

use comms::io::session::{NodeOptions, Reach, Request, Session};
use comms::logic::key::HostName;
use comms::logic::port::Policy;
use comms::logic::{codec, key};
use dca_tests::cluster::{Cluster, Host, Network, Program, SOON, alone, wait_until};
use dca_tests::made_team::MadeTeam;
use node::logic::link::{Ends, Frame};
use node::logic::protocol::{Answer, Ping, Pong, Refusal, StopReply};
use std::fs;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;
use tokio::sync::Notify;

/// The boot that the thief claims for itself.
const BOOT: u64 = 77;

/// Two nodes of a team, `c1` and `c2`, on separate hosts. The third host is the thief's.
struct Robbed {
    nodes: Vec<Program>,
    thief: Option<std::thread::JoinHandle<()>>,
    end: Arc<Notify>,
    told: Receiver<Refusal>,
    cluster: Cluster,
    network: Network,
}

impl Robbed {
    fn new() -> Option<Self> {
        let (cluster, network, team) = (Cluster::new(), Network::new(3)?, MadeTeam::default());
        for (number, name) in [(1, "c1"), (2, "c2")] {
            team.admit(&cluster.host(&network, number), name);
        }
        let member = team.member(&cluster.folder().join("thief"), "c3");
        let (end, (tell, told)) = (Arc::new(Notify::new()), sync_channel(64));
        let (socket, until) = (cluster.folder().join("thief.sock"), Arc::clone(&end));
        let options = NodeOptions {
            name: HostName::parse("c3").expect("a name"),
            socket,
            reach: Reach::Team(Arc::clone(&member) as _),
            port: 0,
            peers: Vec::new(),
        };
        // Zenoh begins its threads in the network of its first use.
        let thief = network.inside(3, move || {
            let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
            runtime.expect("threads").block_on(async {
                let session = Session::open_node(options).await.expect("it opens").authenticated_by(member as _);
                tokio::select! {
                    () = steal(&session, tell) => {}
                    () = until.notified() => {}
                }
                session.close().await;
            });
        });
        let nodes = [(1, "c1"), (2, "c2")].map(|(number, name)| cluster.host(&network, number).node(name, &[]));
        Some(Self { nodes: nodes.into(), thief: Some(thief), end, told, cluster, network })
    }

    fn host(&self, number: usize) -> Host {
        self.cluster.host(&self.network, number)
    }

    /// Returns the subject and the reason of each refused message in the audit log of `c1`.
    fn refusals(&self) -> Vec<String> {
        let log = fs::read_to_string(self.host(1).state().join("c1/team/audit")).unwrap_or_default();
        let fields = |line: &str| {
            let fields: Vec<&str> = line.split('\t').collect();
            (fields.get(2) == Some(&"refused") && fields[4].starts_with("speak as"))
                .then(|| format!("{}|{}", fields[4], fields[6]))
        };
        log.lines().filter_map(fields).collect()
    }
}

impl Drop for Robbed {
    fn drop(&mut self) {
        self.end.notify_one();
        self.thief.take().into_iter().for_each(|thief| drop(thief.join()));
        self.nodes.clear();
    }
}

/// Claims to be `c2` on every occasion: in presence, pongs, pings and frames, and in answers to requests for `c2`.
async fn steal(session: &Session, told: SyncSender<Refusal>) {
    let _token = session.announce(&key::live("c2", BOOT)).expect("it is open");
    let mut pings = session.subscribe(&key::ping_any(), Policy::reject(64)).expect("it is open");
    let mut refused = session.subscribe(&key::refused("c3"), Policy::reject(64)).expect("it is open");
    let mut calls = session.serve(&key::rpc_any("c2")).expect("it is open");
    let mut again = tokio::time::interval(Duration::from_millis(200));
    loop {
        tokio::select! {
            Some((_, bytes)) = pings.next() => {
                let Ok(ping) = codec::decode::<Ping>(&bytes) else { continue };
                if ping.boot == BOOT {
                    continue; // Its own ping: it would answer itself for ever.
                }
                let (boot, to_boot, round) = (BOOT, ping.boot, ping.round);
                let (up, place) = (Duration::from_secs(600), "the thief's".to_owned());
                let holder = Some(ping.boot);
                let (session_id, origin) = (session.id(), 1);
                let pong =
                    Pong { from: "c2".into(), boot, to_boot, round, up, place, holder, session: session_id, origin };
                put(session, &key::pong(&ping.from), codec::encode(&pong));
                let ping = Ping { from: "c2".into(), boot, round };
                put(session, &key::ping("c2"), codec::encode(&ping));
                let ends = Ends { own: comms::logic::time::Time::ZERO, peer: None };
                let frame = Frame { from: "c2".into(), boot, boot_peer: to_boot, ends, acknowledged: 0, message: None };
                put(session, &key::inbox("c1"), codec::encode(&frame));
            }
            Some(request) = calls.next() => lie(request).await,
            Some((_, bytes)) = refused.next() => {
                if let Ok(refusal) = codec::decode(&bytes) {
                    told.try_send(refusal).unwrap_or_default();
                }
            }
            _ = again.tick() => {}
        }
    }
}

fn put(session: &Session, key: &str, bytes: Result<Vec<u8>, codec::CodecError>) {
    session.put_shown(key, bytes.expect("it is short")).expect("it is open");
}

/// Answers every request with the claim that nothing with that name runs.
async fn lie(mut request: Request) {
    request.reply(codec::encode(&Answer::Stop(StopReply::Unknown)).expect("it is short")).await;
    request.finish();
}

const SPEC: &str = r#"
module Idle(host) { exec "sleep 3600"; plain; }
process main() {
    host { "c2" }
    instantiated_processes { there instof Idle("c2"); }
    internal_event_actions { there }
}
"#;

#[test]
fn who_speaks_as_another_member_is_refused_and_told() {
    if !alone("team_names::who_speaks_as_another_member_is_refused_and_told") {
        return;
    }
    let Some(mut robbed) = Robbed::new() else { return };
    // `c2` is there and answers on its own, although the thief also answers.
    let sees_c2 = |robbed: &Robbed| robbed.host(1).statuses(&[]).iter().any(|status| status.host == "c2");
    assert!(wait_until(SOON, || sees_c2(&robbed)).is_some(), "{}", robbed.host(1).ask(&["status"]));
    for _ in 0..10 {
        let status = robbed.host(1).ask(&["status"]);
        assert!(status.code == Some(0) && !status.err.contains("c2"), "{status}");
    }
    let refused =
        wait_until(SOON, || robbed.refusals().iter().any(|line| line == "speak as `c2`|`c3` uses the name of `c2`"));
    assert!(refused.is_some(), "{:?}", robbed.refusals());
    let Refusal { by, why } = robbed.told.recv_timeout(SOON).expect("the thief is told");
    assert!(why == "`c3` uses the name of `c2`" && (by == "c1" || by == "c2"), "{by}: {why}");

    // Once `c2` has gone, no other node takes its place.
    let node = robbed.nodes.remove(1);
    node.kill();
    drop(node);
    let is_up = |line: &str| line.starts_with("c2") && !line.contains("lost");
    let gone = wait_until(SOON, || !robbed.host(1).ask(&["nodes"]).out.lines().any(is_up));
    assert!(gone.is_some(), "{}", robbed.host(1).ask(&["nodes"]));
    let asked = robbed.host(1).ask(&["db", "status", "--robot", "c2"]);
    assert!(asked.code != Some(0) && asked.err.contains("`c3` uses the name of `c2`"), "{asked}");
    let spec = robbed.cluster.file("idle.dca", SPEC);
    let deployed = robbed.host(1).ask(&["deploy", &spec]);
    assert_ne!(deployed.code, Some(0), "{deployed}");
    let lines = robbed.refusals();
    let same = lines.iter().filter(|line| line.as_str() == "speak as `c2`|`c3` uses the name of `c2`").count();
    assert!((1..=3).contains(&same), "one line a minute: {lines:?}");
}
