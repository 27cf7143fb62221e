//! A few replicas that receive each other's messages at once, in virtual time.

mod branches;

use super::*;
use crate::logic::clock::{Quality, Timestamp, Wall};
use crate::logic::key::Key;
use crate::logic::log::Head;
use crate::logic::record::{Batch, Records};
use crate::logic::state::Version;
use crate::logic::txn::{
    Condition, Draft, EncodedTxn, Grant, TXN_SIZE_MAX, Txn, TxnError, VALUE_SIZE_MAX, Value, Write,
};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

pub(super) const WALL: Wall = Wall { millis: 1_790_000_000_000, quality: Quality::Network };

/// Robots `r0`, `r1` and so on.
#[derive(Default)]
pub(super) struct Team {
    pub(super) replicas: Vec<Replica>,
    pub(super) disks: Vec<Records>,
    mail: VecDeque<(usize, ReplicaId, Message)>,
    pub(super) answers: Vec<Answer>,
    pub(super) alarms: Vec<(usize, Alarm)>,
    /// The isolated replicas.
    pub(super) away: BTreeSet<usize>,
    /// This replica receives and sends only hellos.
    deaf: Option<usize>,
    pub(super) now: Time,
}

impl Team {
    pub(super) fn of(count: usize) -> Self {
        let mut team = Self::default();
        for node in 0..count {
            team.disks.push(Records::new());
            let config = team.config(node);
            team.replicas.push(Replica::open(config, &Records::new()).unwrap());
        }
        team.input(0, Input::Found(WALL));
        team.run(60);
        assert!(team.replicas.iter().all(Replica::is_member));
        team
    }

    pub(super) fn config(&self, node: usize) -> Config {
        let seed = 1 + node as u64 + 1000 * self.now.nanos();
        Config { robot: format!("r{node}"), seed, log_size: 1 << 20 }
    }

    pub(super) fn input(&mut self, node: usize, input: Input) {
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
            let hears = |other: &usize| *other != node && !self.away.contains(other) && !self.away.contains(&node);
            let deaf = self.deaf.filter(|_| !matches!(message, Message::Hello(_)));
            let hears = |other: &usize| hears(other) && deaf != Some(*other);
            let meant = |other: &usize| to.is_none_or(|to| self.replicas[*other].address() == to);
            for other in (0..self.replicas.len()).filter(hears).filter(meant) {
                self.mail.push_back((other, address, message.clone()));
            }
        }
    }

    /// Lets this many seconds pass.
    pub(super) fn run(&mut self, seconds: u64) {
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

    pub(super) fn commit(&mut self, node: usize, draft: Draft) -> Answer {
        let request = CommitRequest { ticket: 0, draft, level: AckLevel::Local, until: self.now };
        self.answers.clear();
        self.input(node, Input::Commit(vec![request], WALL));
        self.answers.remove(0)
    }

    pub(super) fn versions(&self, node: usize, name: &str) -> &[Version] {
        self.replicas[node].state().versions(&key(name))
    }

    fn txns(&self, node: usize) -> Vec<Txn> {
        self.replicas[node].log().in_order().iter().map(|(_, encoded)| encoded.open().unwrap()).collect()
    }
}

pub(super) fn key(name: &str) -> Key {
    Key::new(name).unwrap()
}

pub(super) fn put(name: &str, value: &[u8; 1]) -> Draft {
    Draft::new("put").put(key(name), value)
}

fn refused_for(answer: &Answer) -> Option<(&str, u64)> {
    let Answer::Refused(TxnError::NotOwner { owner, term, .. }) = answer else { return None };
    Some((owner, *term))
}

#[test]
fn conditions_hold_for_the_team_where_the_owner_decides() {
    let mut team = Team::of(3);
    let give = |to: Option<&str>| Draft::new("give").grant(key("team/arm"), Grant::Give(to.map(str::to_owned)));
    assert!(matches!(team.commit(0, give(Some("r1"))), Answer::Committed(_)));
    team.run(20);
    let create = || Draft::new("create").require(key("team/arm/x"), Condition::Absent).put(key("team/arm/x"), b"1");
    assert_eq!(refused_for(&team.commit(0, create())), Some(("r1", 1)), "the request can be sent on to the owner");
    assert!(matches!(team.commit(1, create()), Answer::Committed(_)));
    assert!(matches!(team.commit(1, create()), Answer::Refused(TxnError::Precondition { .. })));
    assert_eq!(refused_for(&team.commit(0, give(Some("r0")))), Some(("r1", 1)), "only the owner gives");
    assert!(matches!(team.commit(1, give(Some("r2"))), Answer::Committed(_)));
    assert_eq!(refused_for(&team.commit(1, put("team/arm/x", b"2"))), Some(("r2", 2)));
    team.run(20);
    assert!(matches!(team.commit(2, give(None)), Answer::Committed(_)));
    team.run(20);
    assert!(matches!(team.commit(0, put("team/arm/x", b"3")), Answer::Committed(_)), "released, it is anybody's");
    assert_eq!(refused_for(&team.commit(0, put("robot/r1/x", b"1"))), Some(("r1", 0)));
    for system in ["sys/own/team", "sys/schema/team/arm"] {
        assert!(matches!(team.commit(0, put(system, b"1")), Answer::Refused(TxnError::Reserved { .. })));
    }
}

#[test]
fn owner_takeover_old_owner_isolated_keeps_writing() {
    let mut team = Team::of(3);
    let take = |to: &str| Draft::new("lost").grant(key("team/arm"), Grant::TakeOver(to.to_owned()));
    assert!(matches!(team.commit(0, take("r1")), Answer::Committed(_)));
    team.run(20);
    team.away.insert(1);
    assert!(matches!(team.commit(1, put("team/arm/late", b"1")), Answer::Committed(_)), "it cannot know");
    let Answer::Committed(grant) = team.commit(0, take("r2")) else { panic!("an operator takes it over") };
    team.run(20);
    assert!(matches!(team.commit(2, put("team/arm/x", b"2")), Answer::Committed(_)));
    team.away.clear();
    team.run(60);
    for node in 0..3 {
        assert_eq!(team.versions(node, "team/arm/late").len(), 1, "kept");
        assert_eq!(team.replicas[node].owners().find(&key("team/arm/x")).unwrap().1.grant, Some(grant));
        let txns = team.txns(node);
        let late = txns.iter().find(|txn| txn.writes.iter().any(|write| write.key == key("team/arm/late"))).unwrap();
        let [fence] = &late.requires[..] else { panic!("it relied on one grant: {late:?}") };
        assert_eq!(fence.key, key("sys/own/team/arm"));
        assert!(fence.condition != Condition::Is(grant) && !late.context.contains(grant), "which the races list");
    }
    assert_eq!(refused_for(&team.commit(1, put("team/arm/x", b"3"))), Some(("r2", 2)));
}

#[test]
fn unknown_format_relay() {
    let mut team = Team::of(3);
    let commit = |team: &mut Team, name: &str| {
        let Answer::Committed(dot) = team.commit(1, put(name, b"1")) else { panic!("nothing forbids it") };
        team.replicas[1].log().encoded(dot).unwrap().clone()
    };
    team.away.extend([0, 1, 2]);
    let (newer, after) = (commit(&mut team, "team/a"), commit(&mut team, "team/b"));
    let newer = EncodedTxn { format: 9, body: [newer.body, vec![1, 2]].concat() };
    let mut after = after.open().unwrap();
    after.prev = newer.hash();
    let after = EncodedTxn::seal(&after).unwrap();
    let from = team.replicas[1].origin();
    let vector = team.replicas[0].log().vector().clone();
    for encoded in [&newer, &newer, &after] {
        team.input(0, Input::Received(from, Message::Push(vec![encoded.clone()]), WALL));
    }
    assert!(team.alarms.contains(&(0, Alarm::NeedsUpgrade(9))), "{:?}", team.alarms);
    // The replica continues after a restart, and passes both on; the third replica buffers them too.
    team.replicas[0] = Replica::open(team.config(0), &team.disks[0].clone()).unwrap();
    team.away = BTreeSet::from([1]);
    team.run(60);
    for node in [0, 2] {
        let replica = &team.replicas[node];
        assert_eq!(
            (replica.log().vector(), replica.ledger.pending().beyond(&VersionVector::default(), 1 << 20).0.len()),
            (&vector, 2),
            "{node}"
        );
        assert!(team.versions(node, "team/b").is_empty(), "it comes after what nobody here can read");
    }
    assert!(matches!(team.commit(0, put("team/c", b"2")), Answer::Committed(_)), "it still writes");
    team.run(20);
    assert_eq!(team.versions(2, "team/c").len(), 1);
}

#[test]
fn what_was_held_is_applied_once_it_can_be_read() {
    let mut team = Team::of(2);
    assert_eq!(team.replicas[0].team_format(), FORMAT);
    team.away.insert(1);
    let Answer::Committed(dot) = team.commit(1, put("team/a", b"1")) else { panic!() };
    let encoded = team.replicas[1].log().encoded(dot).unwrap().clone();
    assert!(team.replicas[0].ledger.buffer(&encoded) && team.replicas[0].ledger.buffer(&encoded));
    team.run(20);
    assert_eq!(team.versions(0, "team/a").len(), 1);
    assert!(!team.disks[0].keys().any(|name| name[0] == b'o'));
}

#[test]
fn what_is_local_stays_here_and_survives() {
    let mut team = Team::of(2);
    let create = || Draft::new("id").require(key("local/id"), Condition::Absent).put(key("local/id"), b"7");
    assert!(matches!(team.commit(0, create()), Answer::Committed(_)));
    assert!(matches!(team.commit(0, create()), Answer::Refused(TxnError::Precondition { .. })));
    assert!(matches!(team.commit(0, put("local/gone", b"1")), Answer::Committed(_)));
    assert!(matches!(team.commit(0, Draft::new("").delete(key("local/gone"))), Answer::Committed(_)));
    let mixed = put("local/a", b"1").put(key("team/a"), b"1");
    assert!(matches!(team.commit(0, mixed), Answer::Refused(TxnError::Reserved { .. })));
    team.run(30);
    team.replicas[0] = Replica::open(team.config(0), &team.disks[0].clone()).unwrap();
    let local = |node: usize| team.replicas[node].local().scan("").map(|(key, _)| key.as_str()).collect::<Vec<_>>();
    assert_eq!((local(0), local(1)), (vec!["local/id"], vec![]));
    assert_eq!(team.replicas[0].state(), team.replicas[1].state());
}

#[test]
fn a_transaction_as_long_as_may_be_comes_along_whole() {
    let mut team = Team::of(3);
    team.away.insert(2);
    let value = |size| Value { encoding: Default::default(), bytes: vec![7; size].into() };
    let sizes = [VALUE_SIZE_MAX, VALUE_SIZE_MAX, VALUE_SIZE_MAX, TXN_SIZE_MAX - 3 * VALUE_SIZE_MAX - 150];
    let names = ["team/a", "team/b", "team/c", "team/d"];
    let draft =
        names.iter().zip(sizes).fold(Draft::new("long"), |draft, (name, size)| draft.put(key(name), value(size)));
    let Answer::Committed(dot) = team.commit(2, draft) else { panic!("it just fits") };
    let origin = team.replicas[2].origin();
    team.input(0, Input::Retire(origin, WALL));
    team.run(30);
    team.away.clear();
    team.run(120);
    let name = team.replicas[2].name_of(dot);
    for replica in &team.replicas {
        let pending = names.map(|name| replica.state().get(&key(name)).map(|version| version.stamp));
        assert!(pending[0].is_some() && pending.iter().all(|stamp| *stamp == pending[0]), "{pending:?}");
        assert!(name != dot && replica.log().vector().contains(name) && replica.name_of(dot) == name);
        assert!(replica.has_reached(dot, &AckLevel::Everywhere) || replica.origin() != team.replicas[0].origin());
    }
}

#[test]
fn who_was_alone_can_begin_a_team_again_with_what_it_had() {
    let mut team = Team::of(1);
    assert!(matches!(team.commit(0, put("team/a", b"1")), Answer::Committed(_)));
    let before = team.replicas[0].origin();
    team.replicas[0] = Replica::open_copied(team.config(0), &team.disks[0].clone()).unwrap();
    team.run(5);
    assert!(!team.replicas[0].is_member(), "it may be a copy, and waits for somebody to admit it");
    team.input(0, Input::Found(WALL));
    assert!(team.replicas[0].is_member() && team.replicas[0].members().retired(before).is_some());
    assert_eq!(team.versions(0, "team/a").len(), 1);
    let mut other = Team::of(2);
    other.replicas[0] = Replica::open_copied(other.config(0), &other.disks[0].clone()).unwrap();
    other.input(0, Input::Found(WALL));
    assert!(!other.replicas[0].is_member(), "there is another who can admit it");
}

#[test]
fn a_robot_that_cannot_be_answered_does_not_fill_the_team() {
    let mut team = Team::of(2);
    team.disks.push(Records::new());
    let config = team.config(2);
    team.replicas.push(Replica::open(config, &Records::new()).unwrap());
    let before = team.replicas[0].state().len();
    team.deaf = Some(2);
    team.run(300);
    let more = team.replicas[0].state().len() - before;
    assert!(more < 8, "{more} records more in five minutes, for ever");
    team.deaf = None;
    team.run(60);
    assert!(team.replicas[2].is_member(), "it is admitted as soon as it hears the answer");
}

#[test]
fn strangers_do_not_use_up_the_places_of_members() {
    let mut team = Team::of(2);
    team.away.insert(1);
    team.replicas[0] = Replica::open(team.config(0), &team.disks[0].clone()).unwrap();
    let mut hello = hello::of(&team.replicas[0].ledger);
    for (number, member) in (0..4096).zip([false, true].into_iter().cycle()) {
        hello.member = member;
        team.input(0, Input::Received(ReplicaId::new(1 << 40 | number), Message::Hello(hello.clone()), WALL));
    }
    team.commit(1, put("team/a", b"1"));
    team.away.clear();
    team.run(60);
    assert_eq!(team.versions(0, "team/a").len(), 1);
}

#[test]
fn what_belongs_to_one_robot_stays_there_whatever_others_send() {
    let mut team = Team::of(2);
    let from = team.replicas[1].origin();
    let stamp = Timestamp { epoch: 0, hlc: WALL.millis << 17, origin: from };
    let (seq, prev) = team.replicas[1].log().tip(from);
    let txn = Txn {
        stamp,
        seq: seq + 1,
        prev,
        wall: WALL,
        context: team.replicas[1].log().vector().clone().without(from),
        reason: String::new(),
        requires: Vec::new(),
        writes: vec![Write { key: key("local/x"), value: Some(b"1".into()) }],
        wants_ack: false,
        rebase: None,
    };
    team.input(0, Input::Received(from, Message::Push(vec![EncodedTxn::seal(&txn).unwrap()]), WALL));
    assert_eq!((team.versions(0, "local/x").len(), team.replicas[0].local().len()), (1, 0));
    assert_eq!(Replica::open(team.config(0), &team.disks[0]).err(), None, "its store opens");
}

#[test]
fn a_condition_on_a_key_of_this_robot_is_checked_there_and_not_told() {
    let mut team = Team::of(2);
    team.commit(0, put("local/armed", b"1"));
    let draft = |condition| Draft::new("").require(key("local/armed"), condition).put(key("team/a"), b"1");
    assert!(matches!(team.commit(0, draft(Condition::Absent)), Answer::Refused(_)));
    assert!(matches!(team.commit(0, draft(Condition::Exists)), Answer::Committed(_)));
    assert_eq!(team.txns(0).last().map(|txn| txn.requires.len()), Some(0));
}

#[test]
fn nobody_else_can_have_what_stays_here() {
    let mut team = Team::of(2);
    let request =
        CommitRequest { ticket: 7, draft: put("local/x", b"1"), level: AckLevel::Everywhere, until: team.now };
    team.input(0, Input::Commit(vec![request], WALL));
    assert!(matches!(team.answers[..], [Answer::Refused(TxnError::Stays { .. })]), "{:?}", team.answers);
}

#[test]
fn healed_clocks_are_healed_everywhere_and_stay_so() {
    let mut team = Team::of(2);
    let ahead = Wall { millis: 4_070_908_800_000, quality: Quality::Network };
    let request = CommitRequest { ticket: 0, draft: put("team/a", b"1"), level: AckLevel::Local, until: team.now };
    team.input(1, Input::Commit(vec![request], ahead));
    team.run(30);
    team.input(0, Input::HealClock(WALL));
    team.run(60);
    team.replicas[0] = Replica::open(team.config(0), &team.disks[0].clone()).unwrap();
    let epoch = |team: &mut Team, node: usize| {
        team.commit(node, put("team/b", b"1"));
        team.txns(node).last().map(|txn| txn.stamp.epoch)
    };
    assert_eq!((epoch(&mut team, 0), epoch(&mut team, 1)), (Some(1), Some(1)));
}

#[test]
fn who_is_retired_is_not_as_long_as_something_of_it_cannot_be_read() {
    let mut team = Team::of(3);
    team.commit(0, put("team/a", b"0"));
    team.run(60);
    team.away.insert(2);
    let Answer::Committed(dot) = team.commit(2, put("team/a", b"1")) else { panic!("it is not committed") };
    let readable = team.replicas[2].log().encoded(dot).unwrap().clone();
    let newer = EncodedTxn { format: 9, body: readable.body.clone() };
    team.input(1, Input::Received(dot.origin, Message::Push(vec![newer]), WALL));
    team.input(1, Input::Retire(dot.origin, WALL));
    team.input(0, Input::Retire(dot.origin, WALL));
    team.run(120);
    let retired = |team: &Team, node: usize| team.replicas[node].members().retired(dot.origin).is_some();
    // By now, the other replica has passed on the transactions that it cannot read.
    assert_eq!((retired(&team, 0), retired(&team, 1)), (true, false));
    assert!(!team.replicas[1].ledger.pending().vector().is_empty());
}

#[test]
fn a_store_of_a_newer_program_is_not_damaged() {
    let mut team = Team::of(1);
    let Answer::Committed(last) = team.commit(0, put("team/a", b"1")) else { panic!("it is not committed") };
    // The traces that it would have left: its transaction in the log, and its head with the hash.
    let log = team.replicas[0].log();
    let newer = EncodedTxn { format: 9, body: log.encoded(last).unwrap().body.clone() };
    let mut batch = Batch::default();
    batch.txn(last, Some((1 << 20, &newer)));
    let head = Head { hash: newer.hash(), ..log.head(last.origin).unwrap().clone() };
    batch.head(last.origin, Some(&head));
    batch.apply(&mut team.disks[0]);
    assert_eq!(Replica::open(team.config(0), &team.disks[0]).err(), Some(OpenError::Newer));
}
