//! A team whose robots have keys, and a member that forges transactions beyond its rights: every other member rejects
//! them and reports them. The runs of honest robots with keys are in `simulation.rs`.

use crate::simulation::world::keys::{Keys, Revoked};
use comms::logic::time::Time;
use dbmanager::logic::clock::{DATE_MAX_MS, Quality, Timestamp, Wall};
use dbmanager::logic::key::Key;
use dbmanager::logic::member;
use dbmanager::logic::message::Message;
use dbmanager::logic::notary::{self, Claim, Notary};
use dbmanager::logic::record::Records;
use dbmanager::logic::replica::{AckLevel, Alarm, Answer, CommitRequest, Config, Effect, Input, Replica};
use dbmanager::logic::txn::{ChainHash, Draft, EncodedTxn, Txn, Value, Write};
use dbmanager::logic::version_vector::{ReplicaId, VersionVector};
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

const WALL: Wall = Wall { millis: 1_790_000_000_000, quality: Quality::Network };
/// The hash of no bytes, for a transaction that has seen no others. Source: BLAKE3, the empty input.
const NOTHING_SEEN: ChainHash = ChainHash([0xaf, 0x13, 0x49, 0xb9, 0xf5, 0xf9, 0xa1, 0xa6]);

/// Robots `r0`, `r1` and so on, which receive each other's messages at once.
struct Team {
    replicas: Vec<Replica>,
    disks: Vec<Records>,
    mail: VecDeque<(usize, ReplicaId, Message)>,
    answers: Vec<Answer>,
    alarms: Vec<(usize, Alarm)>,
    /// A robot that receives no messages.
    away: Option<usize>,
    revoked: Revoked,
    now: Time,
}

impl Team {
    fn without_keys(count: usize) -> Self {
        let mut team = Self {
            replicas: Vec::new(),
            disks: vec![Records::new(); count],
            mail: VecDeque::new(),
            answers: Vec::new(),
            alarms: Vec::new(),
            away: None,
            revoked: Revoked::default(),
            now: Time::ZERO,
        };
        team.replicas = (0..count).map(|node| team.opened(node)).collect();
        team
    }

    fn of(count: usize) -> Self {
        let mut team = Self::without_keys(count);
        team.replicas = (0..count).map(|node| team.opened(node).signed_by(team.keys(node, 0))).collect();
        team.gather();
        team
    }

    fn gather(&mut self) {
        self.input(0, Input::Found(WALL));
        self.run(120);
        assert!(self.replicas.iter().all(Replica::is_member));
    }

    fn keys(&self, node: usize, invited: u32) -> Arc<Keys> {
        Arc::new(Keys::new(&format!("r{node}"), invited, &self.revoked))
    }

    fn opened(&self, node: usize) -> Replica {
        let seed = 1 + node as u64 + 1000 * self.now.nanos();
        let config = Config { robot: format!("r{node}"), seed, log_size: 1 << 20 };
        Replica::open(config, &self.disks[node]).expect("it is sound")
    }

    fn input(&mut self, node: usize, input: Input) {
        let mut effects = Vec::new();
        self.replicas[node].handle(self.now, input, &mut effects);
        let address = self.replicas[node].address();
        for effect in effects {
            let (to, message) = match effect {
                Effect::Persist(batch) => {
                    batch.apply(&mut self.disks[node]);
                    continue;
                }
                Effect::Answer(_, answer) => {
                    self.answers.push(answer);
                    continue;
                }
                Effect::Alarm(alarm) => {
                    self.alarms.push((node, alarm));
                    continue;
                }
                Effect::Visible(..) | Effect::Renamed(..) | Effect::Replaced => continue,
                Effect::Broadcast(message) => (None, message),
                Effect::Send(to, message) => (Some(to), message),
            };
            let is_meant = |other: &usize| to.is_none_or(|to| self.replicas[*other].address() == to);
            let hears = |other: &usize| *other != node && ![Some(*other), Some(node)].contains(&self.away);
            for other in (0..self.replicas.len()).filter(hears).filter(is_meant) {
                self.mail.push_back((other, address, message.clone()));
            }
        }
    }

    fn run(&mut self, seconds: u64) {
        let end = self.now + Duration::from_secs(seconds);
        loop {
            if let Some((to, from, message)) = self.mail.pop_front() {
                self.input(to, Input::Received(from, message, WALL));
                continue;
            }
            let due = self.replicas.iter().enumerate().filter_map(|(node, replica)| Some((replica.deadline()?, node)));
            let Some((at, node)) = due.min().filter(|(at, _)| *at <= end) else { break };
            self.now = self.now.max(at);
            self.input(node, Input::Tick(WALL));
        }
        self.now = end;
    }

    fn put(&mut self, node: usize, name: &str) {
        let draft = Draft::new("put").put(Key::new(name).expect("a key"), b"1");
        let request = CommitRequest { ticket: 0, draft, level: AckLevel::Local, until: self.now };
        self.answers.clear();
        self.input(node, Input::Commit(vec![request], WALL));
        assert!(matches!(self.answers[..], [Answer::Committed(_)]), "{:?}", self.answers);
    }

    fn has(&self, node: usize, name: &str) -> bool {
        self.replicas[node].state().get(&Key::new(name).expect("a key")).is_some()
    }

    fn origin(&self, node: usize) -> ReplicaId {
        self.replicas[node].origin()
    }

    /// Writes the next transaction of `of` by hand, signed by robot `by`, and makes r0 get it from r2.
    fn forge(&mut self, (of, by): (usize, usize), stamp: impl FnOnce(Timestamp) -> Timestamp, writes: Vec<Write>) {
        let origin = self.origin(of);
        let log = self.replicas[0].log();
        let head = log.head(origin).cloned().unwrap_or_default();
        let context: VersionVector = log.vector().iter().filter(|(other, _)| *other != origin).collect();
        let seen = log.seen(&context).unwrap_or(NOTHING_SEEN);
        let last = Timestamp { origin, ..log.last_stamp().next() };
        let txn = Txn {
            stamp: stamp(last),
            seq: head.seq + 1,
            prev: head.hash,
            wall: WALL,
            context,
            reason: "by hand".to_owned(),
            requires: Vec::new(),
            writes,
            wants_ack: false,
            rebase: None,
        };
        let encoded = EncodedTxn::seal_signed(&txn, seen, &*self.keys(by, 0)).expect("it is short");
        let from = self.replicas[2].address();
        self.input(0, Input::Received(from, Message::Push(vec![encoded]), WALL));
    }

    /// Returns why r0 has refused something since the last call.
    fn refusal(&mut self) -> String {
        let alarms = std::mem::take(&mut self.alarms);
        let why = |(node, alarm)| if let (0, Alarm::Forged { why, .. }) = (node, alarm) { Some(why) } else { None };
        alarms.into_iter().find_map(why).unwrap_or_default()
    }
}

fn stolen() -> Vec<Write> {
    vec![Write { key: Key::new("team/stolen").expect("a key"), value: Some(Value::from(b"1")) }]
}

#[test]
fn what_a_member_may_not_write_is_taken_over_by_nobody() {
    let mut team = Team::of(3);
    let at_the_end = |stamp: Timestamp| Timestamp { hlc: (DATE_MAX_MS + 1) << 16, ..stamp };
    let (r1, r0) = (team.origin(1), team.origin(0));
    let new = ReplicaId::new(77);
    let claim = |team: &Team, by| Claim::make(&*team.keys(by, 0), new, &[]).to_bytes();
    type Lie = (&'static str, (usize, usize), fn(Timestamp) -> Timestamp, Vec<Write>);
    let admission = |robot: &str| member::admission(new, robot).unwrap();
    let lies: Vec<Lie> = vec![
        ("`r1` has not signed a transaction in its name", (1, 2), |stamp| stamp, stolen()),
        ("`r2` retires `r1`, whose key is not revoked", (2, 2), |stamp| stamp, vec![member::retirement(r1).unwrap()]),
        ("is admitted without a claim of its own", (2, 2), |stamp| stamp, vec![admission("r1")]),
        (
            "is admitted under the name of another robot",
            (2, 2),
            |stamp| stamp,
            vec![notary::record(new, &claim(&team, 2)).unwrap(), admission("r1")],
        ),
        (
            "is claimed without being admitted",
            (2, 2),
            |stamp| stamp,
            vec![notary::record(new, &claim(&team, 2)).unwrap()],
        ),
        (
            "is another robot's already",
            (2, 2),
            |stamp| stamp,
            vec![
                notary::record(r0, &Claim::make(&*team.keys(2, 0), r0, &[]).to_bytes()).unwrap(),
                member::admission(r0, "r2").unwrap(),
            ],
        ),
        ("`r2` leaves out epochs of dates", (2, 2), |stamp| Timestamp { epoch: 101, ..stamp }, stolen()),
        ("`r2` leaves out epochs of dates", (2, 2), |stamp| Timestamp { epoch: u16::MAX, ..stamp }, stolen()),
        ("`r2` dates what it writes at the end of time", (2, 2), at_the_end, stolen()),
    ];
    let before = team.replicas[0].state().digest();
    for (why, of_by, stamp, mut writes) in lies {
        writes.sort_by(|a, b| a.key.cmp(&b.key));
        team.forge(of_by, stamp, writes);
        let refused = team.refusal();
        assert!(refused.contains(why), "{refused:?} instead of {why:?}");
        assert_eq!(team.replicas[0].state().digest(), before, "{why}");
    }
    // Made by hand in the same way, but within the robot's rights.
    team.forge((2, 2), |stamp| stamp, stolen());
    assert_eq!(team.refusal(), "");
    assert!(team.has(0, "team/stolen"));
}

/// A wrong date alone is not a reason to refuse: every robot can continue after it, and all robots must have the same
/// transactions.
#[test]
fn a_date_in_the_year_2099_is_taken_over_and_epochs_rise() {
    let mut team = Team::of(3);
    team.forge((2, 2), |stamp| Timestamp { hlc: 4_070_908_800_000 << 16, ..stamp }, stolen());
    assert_eq!(team.refusal(), "");
    assert!(team.has(0, "team/stolen"));
    for _ in 0..3 {
        team.input(0, Input::HealClock(WALL));
        team.run(30);
    }
    team.put(1, "team/a");
    team.run(30);
    assert!((0..2).all(|node| team.has(node, "team/a")), "{:?}", team.alarms);
    assert_eq!(team.refusal(), "");
}

/// The transactions of a robot arrive through another robot while the robot itself is away.
#[test]
fn who_passes_on_need_not_be_who_has_signed() {
    let mut team = Team::of(3);
    team.away = Some(0);
    team.put(1, "team/a");
    team.run(30);
    assert!(team.has(2, "team/a"));
    team.away = Some(1);
    team.run(60);
    assert!(team.has(0, "team/a"), "{:?}", team.alarms);
    assert_eq!(team.refusal(), "");
}

#[test]
fn an_order_to_retire_who_has_a_key_does_nothing() {
    let mut team = Team::of(3);
    let other = team.origin(2);
    assert!(!team.replicas[0].may_retire(other) && team.replicas[2].may_retire(other));
    team.input(0, Input::Retire(other, WALL));
    team.run(30);
    assert!((0..3).all(|node| team.replicas[node].members().is_active(other)));
    assert_eq!(team.refusal(), "");
}

#[test]
fn whose_key_is_revoked_is_retired_by_itself() {
    let mut team = Team::of(3);
    let gone = team.origin(2);
    team.away = Some(2);
    team.keys(2, 0).revoke();
    team.run(120);
    assert!((0..2).all(|node| team.replicas[node].members().retired(gone).is_some()), "{:?}", team.alarms);
    assert_eq!(team.refusal(), "");
}

/// A robot gets new keys: it continues under another origin, with its transactions, and its previous origin is
/// retired.
#[test]
fn other_keys_are_another_origin_and_lose_nothing() {
    let mut team = Team::of(3);
    let before = team.origin(1);
    team.away = Some(1);
    team.put(1, "team/late");
    team.replicas[1] = team.opened(1).signed_by(team.keys(1, 1));
    assert!(!team.replicas[1].is_member(), "it asks to be admitted");
    team.away = None;
    team.run(120);
    assert!(team.replicas[1].is_member() && team.origin(1) != before);
    assert!((0..3).all(|node| team.has(node, "team/late")), "{:?}", team.alarms);
    assert_eq!(team.refusal(), "");
}

/// A database from before its robots had keys: the first robot founds the team again, and the others join with their
/// data.
#[test]
fn a_database_without_keys_goes_along_into_a_team_with_keys() {
    let mut team = Team::without_keys(3);
    team.gather();
    team.put(1, "team/all");
    team.run(30);
    team.away = Some(2);
    team.put(2, "team/late");
    for node in 0..3 {
        team.replicas[node] = team.opened(node).signed_by(team.keys(node, 0));
        assert!(!team.replicas[node].is_member());
        assert!(team.has(node, "team/all"), "what is there can be read");
    }
    team.away = None;
    team.run(30);
    team.input(1, Input::Found(WALL));
    team.run(120);
    for node in 0..3 {
        assert!(team.replicas[node].is_member(), "{node}");
        assert!(team.has(node, "team/all") && team.has(node, "team/late"), "{node}: {:?}", team.alarms);
    }
    assert_eq!(team.refusal(), "");
}

/// The exact bytes of format 3, which other versions have to read.
#[test]
fn golden_bytes_of_signed_transactions() {
    let keys = Keys::new("r1", 0, &Revoked::default());
    let origin = ReplicaId::new(0x1234);
    let txn = Txn {
        stamp: Timestamp { epoch: 0, hlc: 1 << 16, origin },
        seq: 1,
        prev: ChainHash::default(),
        wall: Wall { millis: 2, quality: Quality::Network },
        context: VersionVector::default(),
        reason: "r".to_owned(),
        requires: Vec::new(),
        writes: vec![Write { key: Key::new("team/a").unwrap(), value: Some(Value::from(b"1")) }],
        wants_ack: false,
        rebase: None,
    };
    let plain = EncodedTxn::seal_on(&txn, NOTHING_SEEN).unwrap();
    let signed = EncodedTxn::seal_signed(&txn, NOTHING_SEEN, &keys).unwrap();
    assert_eq!((plain.format, signed.format), (2, 3));
    assert_eq!(signed.body[..plain.body.len()], plain.body[..], "the bytes of format 2, then the signature");
    assert_eq!(signed.body[plain.body.len()..], keys.sign(&blake3::derive_key("dca txn 1", &plain.body)));
    assert_eq!((signed.open().unwrap(), signed.seen()), (txn, Some(NOTHING_SEEN)));
    let claim = Claim::make(&keys, origin, &[]).to_bytes();
    assert_eq!(claim[..2], [66, keys.credential()[0]], "a credential of 66 bytes, then the origins and the signature");
    assert!(Claim::from_bytes(&claim).unwrap().check(&keys, origin).is_ok());
    assert!(Claim::from_bytes(&claim).unwrap().check(&keys, ReplicaId::new(1)).is_err());
}
