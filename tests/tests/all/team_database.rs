//! A stolen member, and the database of its team. If it forges transactions under another name, or beyond its rights,
//! they are written nowhere. Each attempt is in the audit log.

use comms::io::session::{NodeOptions, Reach, Session};
use comms::logic::key::HostName;
use comms::logic::port::Policy;
use comms::logic::{codec, key};
use dbmanager::logic::clock::{DATE_MAX_MS, Quality, Timestamp, Wall};
use dbmanager::logic::key::Key;
use dbmanager::logic::member;
use dbmanager::logic::message::{Hello, Join, Message, Pull};
use dbmanager::logic::notary::{Claim, Holder, Notary};
use dbmanager::logic::txn::{ChainHash, EncodedTxn, Txn, Value, Write};
use dbmanager::logic::version_vector::{ReplicaId, VersionVector};
use dca_tests::cluster::{Cluster, Host, Network, Program, SOON, alone, wait_until};
use dca_tests::made_team::{MadeTeam, keys};
use node::logic::database::question::{Envelope, Question};
use node::logic::gate;
use node::logic::protocol::{Request, Signed};
use std::collections::BTreeMap;
use std::fs;
use std::sync::Arc;
use std::time::Duration;
use team::member::Member;
use tokio::sync::Notify;
use trust::identity::SecretKeys;
use trust::request;
use trust::role::Role;
use trust::team::Credential;

/// The default name of a robots' database.
const TEAM: &str = "dca";
/// The hash of nothing, for a transaction that has seen no other one. Source: BLAKE3, the empty input.
const NOTHING_SEEN: ChainHash = ChainHash([0xaf, 0x13, 0x49, 0xb9, 0xf5, 0xf9, 0xa1, 0xa6]);

/// The thief's keys, used by hand.
#[derive(Debug)]
struct ByHand(Arc<Member>);

impl Notary for ByHand {
    fn sign(&self, digest: &[u8; 32]) -> Vec<u8> {
        self.0.state(digest).to_vec()
    }

    fn credential(&self) -> Vec<u8> {
        self.0.shown()
    }

    fn holder(&self, _: &[u8]) -> Result<Holder, String> {
        Err("it checks nothing".to_owned())
    }

    fn is_signed(&self, _: &Holder, _: &[u8; 32], _: &[u8]) -> bool {
        true
    }

    fn is_revoked(&self, _: &Holder) -> bool {
        false
    }
}

struct Thief {
    session: Session,
    hand: ByHand,
    admin: (SecretKeys, Credential),
    team: trust::identity::KeyId,
    own: ReplicaId,
}

impl Thief {
    /// Lets the admin found the database on `c1`. Returns whether the node has confirmed this.
    async fn found(&self, number: u64) -> bool {
        let asked = Request::Database(Question::Found);
        let now = team::now();
        let request = request::Request {
            team: self.team,
            audience: gate::audience(&asked, "c1").expect("a name"),
            action: gate::action(&asked).expect("it is signed"),
            id: [1; 16],
            sequence: number,
            epoch: 0,
            not_before: now,
            not_after: now.plus(60),
        };
        let body = codec::encode(&asked).expect("it is short");
        let signed = Signed { head: request.sign(&body, &self.admin.0, &self.admin.1), body };
        let bytes = codec::encode(&Request::Signed(Box::new(signed))).expect("it is short");
        self.session.call(&key::rpc("c1", "request"), bytes, Duration::from_secs(2)).await.is_ok()
    }

    /// Returns the replicas of `c1` and `c2` once both report that they are members.
    async fn members(&self) -> BTreeMap<String, ReplicaId> {
        let mut news = self.session.subscribe(&key::db_news_any(TEAM), Policy::reject(256)).expect("it is open");
        let mut members = BTreeMap::new();
        while members.len() < 2 {
            let (_, bytes) = news.next().await.expect("it is open");
            let Ok(Envelope { from, message: Message::Hello(hello) }) = codec::decode(&bytes) else { continue };
            if hello.member {
                members.insert(hello.robot, from);
            }
        }
        members
    }

    fn put(&self, from: ReplicaId, message: Message) {
        let bytes = codec::encode(&Envelope { from, message }).expect("it is short");
        self.session.put_shown(&key::db_news(TEAM, from.number()), bytes).expect("it is open");
    }

    /// Becomes a member in the same way as every robot of the team.
    async fn join(&self, sponsor: ReplicaId, robot: &str) {
        let claim = Some(Claim::make(&self.hand, self.own, &[]).to_bytes());
        let join = Some(Join { origin: self.own, robot: robot.to_owned(), replaces: Vec::new(), claim });
        let (vector, pending) = (VersionVector::default(), VersionVector::default());
        let message = Message::Pull(Pull { number: 1, vector, pending, size_max: 1 << 16, join });
        let bytes = codec::encode(&Envelope { from: self.own, message }).expect("it is short");
        let asked = self.session.call(&key::db_ask(TEAM, sponsor.number()), bytes, Duration::from_secs(2)).await;
        drop(asked);
    }

    /// Writes with an origin, with a date of `millis` milliseconds after 1970, and with the thief's signature.
    fn write(&self, origin: ReplicaId, (epoch, millis): (u16, u64), write: Write) {
        let stamp = Timestamp { epoch, hlc: millis << 16, origin };
        let txn = Txn {
            stamp,
            seq: 1,
            prev: ChainHash::default(),
            wall: Wall { millis, quality: Quality::Network },
            context: VersionVector::default(),
            reason: "by hand".to_owned(),
            requires: Vec::new(),
            writes: vec![write],
            wants_ack: false,
            rebase: None,
        };
        let encoded = EncodedTxn::seal_signed(&txn, NOTHING_SEEN, &self.hand).expect("it is short");
        self.put(self.own, Message::Push(vec![encoded]));
    }

    async fn steal(&self) {
        let mut number = 1;
        while !self.found(number).await {
            number += 1;
            tokio::time::sleep(Duration::from_millis(200)).await;
        }
        let members = self.members().await;
        let (c1, c2) = (members["c1"], members["c2"]);
        let now = team::now().0 * 1000;
        let value = || Some(Value::from(b"stolen"));
        let stolen = || Write { key: Key::new("team/stolen").expect("a key"), value: value() };
        let mut again = tokio::time::interval(Duration::from_millis(500));
        loop {
            again.tick().await;
            // It acts as the replica of another node, and under the name of another node.
            self.put(c2, Message::Ack(VersionVector::default()));
            self.join(c1, "c2").await;
            let hello = Hello {
                robot: "c2".to_owned(),
                boot: 1,
                format: 2,
                member: true,
                sponsors: Vec::new(),
                vector: 0,
                chains: 0,
                pending: 0,
                state: 0,
                head: (0, ChainHash::default()),
                wall: Wall::default(),
            };
            self.put(self.own, Message::Hello(hello));
            // Under its own name, it writes a key that it may not write.
            self.join(c1, "c3").await;
            self.write(c2, (0, now), stolen());
            self.write(self.own, (0, now), member::retirement(c2).expect("a key"));
            self.write(self.own, (0, now), member::admission(ReplicaId::new(99), "c2").expect("a key"));
            self.write(self.own, (0, DATE_MAX_MS + 1), stolen());
            self.write(self.own, (u16::MAX, now), stolen());
        }
    }
}

/// Two nodes of a team and a thief on a third host.
struct Robbed {
    nodes: Vec<Program>,
    thief: Option<std::thread::JoinHandle<()>>,
    end: Arc<Notify>,
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
        let admin = keys();
        let credential = team.certify("ann", Role::Admin, &admin);
        let (end, id) = (Arc::new(Notify::new()), team.team.id());
        let until = Arc::clone(&end);
        let options = NodeOptions {
            name: HostName::parse("c3").expect("a name"),
            socket: cluster.folder().join("thief.sock"),
            reach: Reach::Team(Arc::clone(&member) as _),
            port: 0,
            peers: Vec::new(),
        };
        // Zenoh begins its threads in the network of its first use.
        let thief = network.inside(3, move || {
            let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build();
            runtime.expect("threads").block_on(async {
                let session = Session::open_node(options).await.expect("it opens");
                let session = session.authenticated_by(Arc::clone(&member) as _);
                let (hand, admin, own) = (ByHand(member), (admin, credential), ReplicaId::new(0x77));
                let thief = Thief { session, hand, admin, team: id, own };
                tokio::select! {
                    () = thief.steal() => {}
                    () = until.notified() => {}
                }
                thief.session.close().await;
            });
        });
        let nodes = [(1, "c1"), (2, "c2")].map(|(number, name)| cluster.host(&network, number).node(name, &[]));
        Some(Self { nodes: nodes.into(), thief: Some(thief), end, cluster, network })
    }

    fn host(&self, number: usize) -> Host {
        self.cluster.host(&self.network, number)
    }

    /// Returns the refusals on a host with their reasons.
    fn refusals(&self, number: usize) -> Vec<String> {
        let file = format!("c{number}/team/audit");
        let log = fs::read_to_string(self.host(number).state().join(file)).unwrap_or_default();
        let fields = |line: &str| {
            let fields: Vec<&str> = line.split('\t').collect();
            (fields.get(2) == Some(&"refused")).then(|| format!("{}|{}", fields[4], fields[6]))
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

#[test]
fn a_member_writes_for_itself_and_only_what_it_may() {
    if !alone("team_database::a_member_writes_for_itself_and_only_what_it_may") {
        return;
    }
    let Some(robbed) = Robbed::new() else { return };
    let refused = |why: &str| {
        let told = wait_until(2 * SOON, || robbed.refusals(1).iter().any(|line| line.contains(why)));
        assert!(told.is_some(), "{why}: {:#?} {}", robbed.refusals(1), robbed.host(1).ask(&["db", "status"]));
    };
    refused("speak as `c2`|`c3` uses the name of `c2` in messages to the database");
    refused("`c2` has not signed a transaction in its name");
    refused("`c3` retires `c2`, whose key is not revoked");
    refused("is admitted without a claim of its own");
    refused("`c3` dates what it writes at the end of time");
    refused("`c3` leaves out epochs of dates");
    // The team continues.
    for number in [1, 2] {
        let stolen = robbed.host(number).ask(&["db", "get", "team/stolen"]);
        assert!(!stolen.out.contains("stolen"), "{stolen}");
        let status = robbed.host(number).ask(&["db", "status"]);
        assert!(status.out.contains("c1") && status.out.contains("c2"), "{status}");
    }
}
