//! A node in a team, and an attacker on the same machine who wants more than is signed. The targets are the
//! node's sockets, disk and audit log. Each attack starts nothing and writes nothing, and is one line of the audit log.

use comms::io::session::{Session, Subscription};
use comms::logic::port::Policy;
use comms::logic::{codec, key};
use dbmanager::logic::key::Key;
use dbmanager::logic::txn::Write;
use dbmanager::logic::view::value::Datum;
use dca_tests::cluster::{Cluster, Host, Network, Program, SOON, wait_until};
use dca_tests::made_team::{MadeTeam, keys};
use language::plan::Plan;
use language::{Options, Source, compile};
use node::logic::database::question::{AckLevel, Commit, Question, Reply};
use node::logic::gate;
use node::logic::link::{Ends, Frame};
use node::logic::protocol::{
    Answer, Body, Deployment, Message, Ping, Pong, Request, Signed, StopReply, ToCoordinator, ToParticipant,
};
use std::collections::BTreeMap;
use std::fs;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::runtime::Runtime;
use trust::identity::{KeyId, SecretKeys};
use trust::name::UnixTime;
use trust::request;
use trust::revocation::RevokedSet;
use trust::role::{Action, Role};
use trust::team::Credential;

const SPEC: &str = r#"
module Idle(host) { exec "sleep 3600"; plain; }
process main() {
    host { "c1" }
    instantiated_processes { here instof Idle("c1"); there instof Idle("c2"); }
    internal_event_actions { here , there }
}
"#;

fn plan() -> Plan {
    let compiled = compile(&Source::new("test.dca", SPEC), &[], &Options::named("test"));
    compiled.plan.unwrap_or_else(|| panic!("{:#?}", compiled.diagnostics))
}

fn deploy() -> Request {
    Request::Deploy { request: 7, plan: plan(), by: "somebody".into(), start: Default::default() }
}

fn write() -> Request {
    let value = Some(Datum::from("stolen").encode().expect("it is short"));
    let writes = vec![Write { key: Key::new("team/gain").expect("a key"), value }];
    let (reason, requires, within) = (String::new(), Vec::new(), SOON);
    Request::Database(Question::Commit(Commit { reason, requires, writes, level: AckLevel::Local, within }))
}

fn stop() -> Request {
    Request::Stop { name: "test".into() }
}

/// A user. Each request has the next number.
struct User {
    keys: SecretKeys,
    credential: Credential,
    team: KeyId,
    number: AtomicU64,
}

impl User {
    fn sign(&self, asked: &Request, host: &str) -> Signed {
        self.sign_with(asked, host, |_| {})
    }

    fn sign_with(&self, asked: &Request, host: &str, change: impl FnOnce(&mut request::Request)) -> Signed {
        let now = team::now();
        let mut request = request::Request {
            team: self.team,
            audience: gate::audience(asked, host).expect("a name"),
            action: gate::action(asked).expect("it is signed"),
            id: [1; 16],
            sequence: self.number.fetch_add(1, Ordering::Relaxed),
            epoch: 0,
            not_before: now,
            not_after: now.plus(60),
        };
        change(&mut request);
        let body = codec::encode(asked).expect("it is short");
        Signed { head: request.sign(&body, &self.keys, &self.credential), body }
    }
}

/// A node `c2` of a team, in a namespace, and the keys of the team.
struct Attacked {
    runtime: Runtime,
    node: Option<Program>,
    host: Host,
    cluster: Cluster,
    _network: Network,
    team: MadeTeam,
}

impl Attacked {
    fn new() -> Option<Self> {
        let (cluster, network) = (Cluster::new(), Network::new(1)?);
        let host = cluster.host(&network, 1);
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build();
        let runtime = runtime.expect("threads");
        let team = MadeTeam::default();
        team.admit(&host, "c2");
        let mut attacked = Self { runtime, node: None, host, cluster, _network: network, team };
        attacked.restart();
        Some(attacked)
    }

    fn user(&self, name: &str, role: Role) -> User {
        let keys = keys();
        let credential = self.team.certify(name, role, &keys);
        User { keys, credential, team: self.team.team.id(), number: AtomicU64::new(1) }
    }

    /// Kills the node if it runs, and then starts it.
    fn restart(&mut self) {
        if let Some(node) = self.node.take() {
            node.kill();
            drop(node);
        }
        self.node = Some(self.host.node("c2", &[]));
    }

    /// Kills the node, and starts it as after a boot with this name.
    fn reboot(&mut self, boot: &str) {
        if let Some(node) = self.node.take() {
            node.kill();
            drop(node);
        }
        self.node = Some(self.host.node("c2", &["--boot-id", boot]));
    }

    fn session(&self) -> Session {
        let socket = self.host.run_dir().join("c2/node.sock");
        self.runtime.block_on(Session::open_client(&socket)).expect("the node is there")
    }

    fn ask(&self, request: &Request) -> Answer {
        let session = self.session();
        let bytes = codec::encode(request).expect("it is short");
        let answer = self.runtime.block_on(async {
            let answer = session.call(&key::rpc("c2", "request"), bytes, SOON).await;
            session.close().await;
            answer
        });
        codec::decode(&answer.expect("it answers")).expect("an answer")
    }

    fn ask_signed(&self, signed: &Signed) -> Answer {
        self.ask(&Request::Signed(Box::new(signed.clone())))
    }

    /// Returns for each record in the audit log the result, the subject, the user and the reason.
    fn records(&self) -> Vec<String> {
        let log = fs::read_to_string(self.host.state().join("c2/team/audit")).unwrap_or_default();
        let fields = |line: &str| {
            let fields: Vec<&str> = line.split('\t').collect();
            (fields.len() > 6).then(|| [fields[2], fields[3], fields[4], fields[6]].join("|"))
        };
        log.lines().filter_map(fields).collect()
    }

    /// Returns the user, the subject and the reason of each refusal in the audit log.
    fn refusals(&self) -> Vec<String> {
        self.records().iter().filter_map(|line| Some(line.strip_prefix("refused|")?.to_owned())).collect()
    }

    /// Attacks. The attack is refused for this reason with one line in the audit log, and nothing is started.
    #[track_caller]
    fn refused(&self, attack: impl FnOnce() -> String, reason: &str) {
        let before = self.refusals();
        let said = attack();
        assert!(said.contains(reason), "{said:?} instead of {reason:?}");
        let is_told = wait_until(SOON, || self.refusals().len() > before.len());
        let told = self.refusals();
        assert!(is_told.is_some() && told.len() == before.len() + 1, "{reason}: {told:#?}");
        assert!(told.last().is_some_and(|line| line.contains(reason)), "{reason}: {told:#?}");
        assert!(self.cluster.leaf("main/there").is_none(), "{reason}: a program was started");
    }

    #[track_caller]
    fn call_refused(&self, request: &Request, reason: &str) {
        let attack = || {
            let answer = self.ask(request);
            let Answer::Refused(why) = answer else { panic!("{reason}: {answer:?}") };
            why
        };
        self.refused(attack, reason);
    }

    #[track_caller]
    fn signed_refused(&self, signed: Signed, reason: &str) {
        self.call_refused(&Request::Signed(Box::new(signed)), reason);
    }
}

/// Requests of command lines: unsigned, for another host or team, expired, of a lower role, altered, from a revoked
/// signer, and repeated.
#[test]
fn what_is_not_signed_as_it_has_to_be_is_refused() {
    let Some(mut at) = Attacked::new() else { return };
    let [ann, dan, vic] =
        [("ann", Role::Admin), ("dan", Role::Deployer), ("vic", Role::Viewer)].map(|(name, role)| at.user(name, role));
    let Answer::Team(Some(team)) = at.ask(&Request::Team) else { panic!("it is in a team") };
    assert_eq!((team.id, team.name.as_str(), team.node.as_str()), (at.team.team.id().0, "acme", "c2"));
    let found = Request::Database(Question::Found);
    at.call_refused(&found, "it is not signed");
    at.signed_refused(dan.sign(&found, "c2"), "`dan` has the role deployer, which may not decide who has the database");
    let Answer::Database(Reply::Done(_)) = at.ask_signed(&ann.sign(&found, "c2")) else { panic!("an admin may") };
    // The log contains an accepted request with its result.
    let unknown = at.ask_signed(&dan.sign(&stop(), "c2"));
    assert!(matches!(unknown, Answer::Stop(StopReply::Unknown)), "{unknown:?}");
    let of_dan = || at.records().into_iter().filter(|line| line.contains("|dan|stop `test`|")).collect::<Vec<_>>();
    assert!(wait_until(SOON, || of_dan().len() >= 2).is_some(), "{:#?}", at.records());
    let failed = "failed|dan|stop `test`|no such deployment has its home here";
    assert_eq!(of_dan(), ["accepted|dan|stop `test`|", failed]);
    for request in [deploy(), stop(), write()] {
        at.call_refused(&request, "it is not signed");
        at.signed_refused(vic.sign(&request, "c2"), "`vic` has the role viewer, which may not");
    }
    at.signed_refused(dan.sign(&stop(), "c1"), "the request is for another host");
    at.signed_refused(dan.sign_with(&stop(), "c2", |it| it.team = KeyId([7; 32])), "the request is for another team");
    let past = |it: &mut request::Request| {
        (it.not_before, it.not_after) = (UnixTime(it.not_before.0 - 2000), UnixTime(it.not_before.0 - 1940));
    };
    at.signed_refused(dan.sign_with(&write(), "c2", past), "s too late; compare the clocks");
    let as_look = |it: &mut request::Request| it.action = Action::Watch;
    at.signed_refused(dan.sign_with(&stop(), "c2", as_look), "the request is signed to look, but asks to stop");
    let mut altered = dan.sign(&stop(), "c2");
    altered.body = codec::encode(&Request::Stop { name: "tent".into() }).expect("it is short");
    at.signed_refused(altered, "the body differs from the signed body");
    at.signed_refused(Signed { head: vec![3; 200], body: vec![5; 9] }, "the signed payload is not a request");
    let stranger = User { keys: keys(), ..at.user("dan", Role::Admin) };
    at.signed_refused(stranger.sign(&stop(), "c2"), "not signed by the key that it names");

    let good = dan.sign(&stop(), "c2");
    assert_eq!(at.ask_signed(&good), Answer::Stop(StopReply::Unknown), "it is accepted once");
    at.signed_refused(good.clone(), "was used before");
    at.restart();
    at.signed_refused(good.clone(), "was used before");
    // Without the list of accepted requests, a node would carry out a request again. So it does not run.
    let accepted = at.host.state().join("c2/team/accepted");
    let kept = at.cluster.folder().join("accepted");
    at.node.take().expect("it runs").kill();
    fs::rename(&accepted, &kept).expect("it is there");
    let refused = at.host.start_node("c2", &[]).ended(SOON);
    assert!(
        refused.code == Some(1) && refused.err.contains("it is not known which requests were used before"),
        "{refused}"
    );
    fs::rename(&kept, &accepted).expect("it was there");
    at.restart();
    at.signed_refused(good, "was used before");

    let gone = BTreeMap::from([(dan.keys.public().id(), team::now())]);
    let set = RevokedSet::sign(&at.team.team, 1, gone, &at.team.root, None).expect("a good set");
    assert_eq!(at.ask(&Request::Revoke { set: set.to_bytes() }), Answer::Revoked { is_new: true });
    at.signed_refused(dan.sign(&write(), "c2"), "the key of `dan` is revoked");
    let get = Request::Database(Question::Get { key: Key::new("team/gain").expect("a key") });
    let Answer::Database(Reply::Entries(entries)) = at.ask(&get) else { panic!("looking needs no signature") };
    assert!(entries.iter().all(|(_, versions)| versions.is_empty()), "nothing was written: {entries:?}");
    let Answer::Database(reply) = at.ask_signed(&ann.sign(&write(), "c2")) else { panic!("an admin may write") };
    assert!(matches!(reply, Reply::Committed(_)), "{reply:?}");
}

const RESUMED: &str = r#"
module Idle(host) { exec "sleep 3600"; plain; done; }
process main() {
    host { "c2" }
    on_boot { resume }
    instantiated_processes { there instof Idle("c2"); }
    internal_event_actions { there }
}
"#;

/// A mission is resumed after a reboot. It is not resumed if the user who signed it was revoked in the meantime,
/// although its home had accepted it.
#[test]
fn a_mission_of_a_revoked_user_does_not_come_back_after_a_reboot() {
    let Some(mut at) = Attacked::new() else { return };
    at.reboot("first");
    let dan = at.user("dan", Role::Deployer);
    let compiled = compile(&Source::new("test.dca", RESUMED), &[], &Options::named("test"));
    let plan = compiled.plan.unwrap_or_else(|| panic!("{:#?}", compiled.diagnostics));
    let answer = at.ask_signed(
        &dan.sign(&Request::Deploy { request: 7, plan, by: "dan".into(), start: Default::default() }, "c2"),
    );
    assert!(matches!(answer, Answer::Report(_)), "{answer:?}");
    let runs = |at: &Attacked| at.cluster.leaf("main/there").map(|process| process.pid);
    let begins = wait_until(SOON, || runs(&at).is_some());
    assert!(begins.is_some(), "{:?}", at.records());
    // The caller has gone after the first answer, but the result is still in the log.
    let done = "done|dan|deploy `test`|".to_owned();
    assert!(wait_until(SOON, || at.records().contains(&done)).is_some(), "{:?}", at.records());
    let first = runs(&at);
    at.reboot("second");
    assert!(wait_until(SOON, || runs(&at).is_some_and(|pid| Some(pid) != first)).is_some(), "{:?}", at.records());
    assert!(at.records().contains(&"done|dan|begin `test@1` again after a reboot|".to_owned()), "{:?}", at.records());
    let gone = BTreeMap::from([(dan.keys.public().id(), team::now())]);
    let set = RevokedSet::sign(&at.team.team, 1, gone, &at.team.root, None).expect("a good set");
    assert_eq!(at.ask(&Request::Revoke { set: set.to_bytes() }), Answer::Revoked { is_new: true });
    at.reboot("third");
    let refused = "refused|dan|begin `test@2` again after a reboot|the key of `dan` is revoked; ";
    let is_refused = || at.records().iter().any(|line| line.starts_with(refused));
    assert!(wait_until(SOON, is_refused).is_some(), "{:?}", at.records());
    assert_eq!(runs(&at), None);
}

/// An attacker that claims to be the node `c1`.
struct Liar<'a> {
    at: &'a Attacked,
    session: Session,
    pings: Subscription,
    inbox: Subscription,
    sent: u64,
    heard: u64,
    boot_peer: u64,
}

const BOOT: u64 = 77;

impl<'a> Liar<'a> {
    fn new(at: &'a Attacked) -> Self {
        let member = at.team.member(&at.cluster.folder().join("liar"), "c1");
        let session = at.session().authenticated_by(member as _);
        let pings = session.subscribe(&key::ping_any(), Policy::reject(64)).expect("it is open");
        let inbox = session.subscribe(&key::inbox("c1"), Policy::reject(64)).expect("it is open");
        Self { at, session, pings, inbox, sent: 0, heard: 0, boot_peer: 0 }
    }

    fn put(&self, key: &str, bytes: Vec<u8>) {
        self.session.put_shown(key, bytes).expect("it is open");
    }

    fn pong(&mut self, bytes: &[u8]) {
        let Ok(ping) = codec::decode::<Ping>(bytes) else { return };
        self.boot_peer = ping.boot;
        let pong = Pong {
            from: "c1".into(),
            boot: BOOT,
            to_boot: ping.boot,
            round: ping.round,
            up: Duration::from_secs(60),
            place: "nowhere".into(),
            holder: Some(ping.boot),
            session: self.session.id(),
            origin: 1,
        };
        self.put(&key::pong(&ping.from), codec::encode(&pong).expect("it is short"));
    }

    /// Sends an order as the home, and returns the answer.
    fn order(&mut self, epoch: u64, order: ToParticipant) -> ToCoordinator {
        let runtime = &self.at.runtime;
        let deployment = Deployment { name: "test".into(), epoch };
        self.sent += 1;
        let message = Message { deployment: deployment.clone(), body: Body::Participant(order) };
        runtime.block_on(async {
            let mut again = tokio::time::interval(Duration::from_millis(500));
            let deadline = tokio::time::sleep(SOON);
            tokio::pin!(deadline);
            loop {
                tokio::select! {
                    Some((_, bytes)) = self.pings.next() => self.pong(&bytes),
                    Some((_, bytes)) = self.inbox.next() => {
                        let Ok(frame) = codec::decode::<Frame>(&bytes) else { continue };
                        let Some((number, message)) = frame.message.filter(|(number, _)| *number == self.heard + 1) else {
                            continue;
                        };
                        self.heard = number;
                        if let Body::Coordinator(answer) = message.body
                            && message.deployment == deployment
                        {
                            return answer;
                        }
                    }
                    _ = again.tick() => {
                        let (boot_peer, acknowledged) = (self.boot_peer, self.heard);
                        let ends = Ends { own: comms::logic::time::Time::ZERO, peer: None };
                        let message = Some((self.sent, message.clone()));
                        let frame = Frame { from: "c1".into(), boot: BOOT, boot_peer, ends, acknowledged, message };
                        self.put(&key::inbox("c2"), codec::encode(&frame).expect("it is short"));
                    }
                    () = &mut deadline => panic!("the node does not answer"),
                }
            }
        })
    }

    #[track_caller]
    fn refused(&mut self, epoch: u64, order: ToParticipant, reason: &str) {
        let at = self.at;
        let attack = || {
            let answer = self.order(epoch, order);
            let ToCoordinator::Refused { reasons } = answer else { panic!("{reason}: {answer:?}") };
            reasons.join("; ")
        };
        at.refused(attack, reason);
    }
}

/// A lying home, or a relay between the home and its hosts. It has a request that a user has signed, and wants more.
#[test]
fn a_home_that_lies_starts_nothing() {
    let Some(at) = Attacked::new() else { return };
    let (dan, vic) = (at.user("dan", Role::Deployer), at.user("vic", Role::Viewer));
    let mut liar = Liar::new(&at);
    let announced = liar.session.announce(&key::live("c1", BOOT)).expect("it is open");
    let prepare = |by: Option<&Signed>| ToParticipant::Prepare { plan: plan() }.signed(by);
    let rejoin =
        |plan: Plan, by: &Signed| ToParticipant::Rejoin { plan, number: 1, since_go: Duration::ZERO }.signed(Some(by));
    liar.refused(1, prepare(None), "it is not signed");
    let good = dan.sign(&deploy(), "c1");
    let mut altered = plan();
    altered.leaves.iter_mut().for_each(|leaf| leaf.exec = Some("touch /stolen".into()));
    liar.refused(1, rejoin(altered.clone(), &good), "the order of `c1` differs from the signed request");
    let mut body = good.clone();
    body.body =
        codec::encode(&Request::Deploy { request: 7, plan: altered, by: String::new(), start: Default::default() })
            .expect("it is short");
    liar.refused(1, prepare(Some(&body)), "the body differs from the signed body");
    liar.refused(1, prepare(Some(&vic.sign(&deploy(), "c1"))), "`vic` has the role viewer, which may not deploy");
    let past = |it: &mut request::Request| {
        (it.not_before, it.not_after) = (UnixTime(it.not_before.0 - 2000), UnixTime(it.not_before.0 - 1940));
    };
    liar.refused(1, prepare(Some(&dan.sign_with(&deploy(), "c1", past))), "s too late");

    // A signed request starts its programs once. The same request does not start them again.
    let started = liar.order(5, prepare(Some(&good)));
    assert!(matches!(started, ToCoordinator::Prepared { .. }), "{started:?}");
    assert_eq!(liar.order(5, ToParticipant::Release), ToCoordinator::Released);
    assert!(wait_until(SOON, || at.cluster.leaf("main/there").is_none()).is_some());
    liar.refused(6, prepare(Some(&good)), "was used before");
    liar.refused(4, prepare(Some(&dan.sign(&deploy(), "c1"))), "it is of epoch 4, but epoch 5 is known");
    drop(announced);
}
