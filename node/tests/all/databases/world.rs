//! Databases of several robots on virtual time: the machines, their disks as maps, and a network that can be cut.

use comms::logic::codec;
use comms::logic::time::Time;
use dbmanager::logic::clock::{Quality, Wall};
use dbmanager::logic::key::Key;
use dbmanager::logic::record::Records;
use dbmanager::logic::replica::{Config, Replica};
use dbmanager::logic::txn::Write;
use dbmanager::logic::version_vector::{Dot, ReplicaId};
use dbmanager::logic::view::value::Datum;
use dbmanager::logic::view::watch::Notification;
use node::logic::database::question::{AckLevel, Commit, Envelope, Question, Reply, Status};
use node::logic::database::settings::Settings;
use node::logic::database::{Database, Effect, Input};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

pub(super) struct Robot {
    pub(super) name: String,
    pub(super) machine: Database,
    pub(super) disk: Records,
    pub(super) inbox: Vec<Input>,
    pub(super) replies: BTreeMap<u64, Vec<Reply>>,
    pub(super) ended: BTreeSet<u64>,
    pub(super) settings: Settings,
    pub(super) away: bool,
    /// Whether its disk takes nothing.
    pub(super) broken: bool,
    /// Where it can be asked.
    pub(super) address: ReplicaId,
}

pub(super) struct World {
    pub(super) now: Time,
    pub(super) robots: Vec<Robot>,
    /// The caller of each question, by its number, and until when an answer is taken.
    asked: BTreeMap<u64, (usize, Time)>,
    /// How many bytes of answers the network carries in a second, one after another; nothing if they take no time.
    pub(super) rate: Option<u32>,
    /// The messages on their way, by the time of arrival.
    coming: BTreeMap<(Time, u64), (usize, Envelope)>,
    next: u64,
}

pub(super) fn open(name: &str, disk: &Records, seed: u64) -> Replica {
    let config = Config { robot: name.to_owned(), seed, log_size: 1 << 20 };
    Replica::open(config, disk).expect("a disk that was written by a replica")
}

pub(super) fn key_of(text: &str) -> Key {
    Key::new(text).expect("the tests have plain keys")
}

pub(super) fn put(key: &str, datum: &Datum) -> Write {
    Write { key: key_of(key), value: Some(datum.encode().expect("it is short")) }
}

pub(super) fn commit(writes: Vec<Write>, level: AckLevel) -> Question {
    let (reason, requires, within) = ("a test".to_owned(), Vec::new(), Duration::from_secs(1));
    Question::Commit(Commit { reason, requires, writes, level, within })
}

impl World {
    pub(super) fn new(names: &[&str]) -> Self {
        let robot = |(number, name): (u64, &&str)| {
            let disk = Records::new();
            let machine = Database::new(open(name, &disk, number), name, "dca", None);
            let address = machine.address();
            let (inbox, replies, ended) = (Vec::new(), BTreeMap::new(), BTreeSet::new());
            let name = (*name).to_owned();
            Robot {
                name,
                machine,
                disk,
                inbox,
                replies,
                ended,
                settings: Settings::default(),
                away: false,
                broken: false,
                address,
            }
        };
        Self {
            now: Time::ZERO,
            robots: (1..).zip(names).map(robot).collect(),
            asked: BTreeMap::new(),
            rate: None,
            coming: BTreeMap::new(),
            next: 0,
        }
    }

    /// Returns a team of these.
    pub(super) fn team(names: &[&str]) -> Self {
        let mut world = Self::new(names);
        world.call(0, Question::Found);
        world.run(Duration::from_secs(5));
        for robot in 0..names.len() {
            assert_eq!(world.status(robot).members.len(), names.len());
        }
        world
    }

    pub(super) fn wall(&self) -> Wall {
        Wall { millis: 1_700_000_000_000 + self.now.nanos() / 1_000_000, quality: Quality::Network }
    }

    /// Asks; returns the number of the call.
    pub(super) fn call(&mut self, robot: usize, question: Question) -> u64 {
        self.next += 1;
        let call = self.next;
        self.robots[robot].inbox.push(Input::Call(call, question));
        self.turns();
        call
    }

    pub(super) fn replies(&self, robot: usize, call: u64) -> &[Reply] {
        self.robots[robot].replies.get(&call).map_or(&[], Vec::as_slice)
    }

    /// Asks a question that is answered at once, by one reply.
    pub(super) fn ask(&mut self, robot: usize, question: Question) -> Reply {
        let call = self.call(robot, question);
        assert!(self.robots[robot].ended.contains(&call), "{:?}", self.replies(robot, call));
        self.replies(robot, call).last().expect("what has ended was answered").clone()
    }

    pub(super) fn status(&mut self, robot: usize) -> Status {
        match self.ask(robot, Question::Status) {
            Reply::Status(status) => *status,
            other => panic!("{other:?}"),
        }
    }

    pub(super) fn write(&mut self, robot: usize, key: &str, number: i64) -> Dot {
        match self.ask(robot, commit(vec![put(key, &Datum::from(number))], AckLevel::Local)) {
            Reply::Committed(dot) => dot,
            other => panic!("{other:?}"),
        }
    }

    pub(super) fn read(&mut self, robot: usize, key: &str) -> Vec<Datum> {
        match self.ask(robot, Question::Get { key: key_of(key) }) {
            Reply::Entries(entries) => {
                let versions = entries.into_iter().flat_map(|(_, versions)| versions);
                versions.filter_map(|version| version.value.map(|value| Datum::of(&value))).collect()
            }
            other => panic!("{other:?}"),
        }
    }

    /// Returns the transactions that a watcher was told of.
    pub(super) fn told(&self, robot: usize, call: u64) -> Vec<Dot> {
        let told = self.replies(robot, call).iter().filter_map(|reply| match reply {
            Reply::Notification(Notification::Event(event)) => Some(event.entry.dot),
            _ => None,
        });
        told.collect()
    }

    /// The disk of a robot is back, and its store is reopened.
    pub(super) fn reopen(&mut self, robot: usize) {
        let robot = &mut self.robots[robot];
        robot.broken = false;
        robot.machine.reopen(open(&robot.name, &robot.disk, 77));
    }

    /// Takes robots off the network, or puts them back.
    pub(super) fn away(&mut self, robots: &[usize], away: bool) {
        for robot in robots {
            self.robots[*robot].away = away;
        }
        if !away {
            self.robots.iter_mut().for_each(|robot| robot.inbox.push(Input::Appeared));
            self.turns();
        }
    }

    /// Works off everything that waits.
    pub(super) fn turns(&mut self) {
        while self.robots.iter().any(|robot| !robot.inbox.is_empty()) {
            for robot in 0..self.robots.len() {
                self.turn(robot);
            }
        }
    }

    /// Lets time pass, from deadline to deadline.
    pub(super) fn run(&mut self, span: Duration) {
        let until = self.now + span;
        while self.now < until {
            let deadline = self.robots.iter().filter_map(|robot| robot.machine.deadline());
            let deadline = deadline.chain(self.coming.keys().map(|(at, _)| *at)).min().unwrap_or(until);
            self.now = self.now.max(deadline.min(until));
            while let Some(arrival) = self.coming.first_entry().filter(|arrival| arrival.key().0 <= self.now) {
                let (asker, envelope) = arrival.remove();
                self.robots[asker].inbox.push(Input::Envelope(envelope));
            }
            for robot in 0..self.robots.len() {
                if self.robots[robot].machine.deadline().is_some_and(|deadline| deadline <= self.now) {
                    self.turn(robot);
                }
            }
            self.turns();
        }
    }

    pub(super) fn turn(&mut self, number: usize) {
        let (now, wall, mut effects) = (self.now, self.wall(), Vec::new());
        let robot = &mut self.robots[number];
        let inbox = std::mem::take(&mut robot.inbox);
        let before = robot.machine.durable();
        robot.machine.handle(now, wall, inbox, &mut effects);
        if robot.broken && effects.iter().any(|effect| matches!(effect, Effect::Persist(_))) {
            effects = robot.machine.fail("no space left on device", before, effects);
        }
        for effect in effects {
            self.carry_out(number, effect);
        }
    }

    pub(super) fn carry_out(&mut self, number: usize, effect: Effect) {
        let here = &mut self.robots[number];
        match effect {
            Effect::Persist(batch) => {
                batch.apply(&mut here.disk);
                here.machine.written();
            }
            Effect::Address(address) => here.address = address,
            Effect::AnswerCaller(call, reply) => here.replies.entry(call).or_default().push(reply),
            Effect::End(call) => drop(here.ended.insert(call)),
            Effect::Settings(settings) => here.settings = settings,
            Effect::Alarm(_) => {}
            Effect::Refused { from, why } => panic!("{from} is refused without keys: {why}"),
            Effect::Broadcast(envelope) => {
                let away = here.away;
                for (_, other) in self.robots.iter_mut().enumerate().filter(|(other, _)| *other != number) {
                    if !away && !other.away {
                        other.inbox.push(Input::Envelope(envelope.clone()));
                    }
                }
            }
            Effect::Tell(to, envelope) => self.send(number, to, Input::Envelope(envelope)),
            Effect::Ask(to, envelope, within) => {
                self.next += 1;
                let asked = self.next;
                self.asked.insert(asked, (number, self.now + within));
                self.send(number, to, Input::Asked(asked, envelope));
            }
            Effect::ReplyToPeer(asked, envelope) => {
                let (asker, until) = self.asked.remove(&asked).expect("a question is ended once");
                if let Some(envelope) = envelope.filter(|_| !self.robots[number].away && !self.robots[asker].away) {
                    self.answer(asker, until, envelope);
                }
            }
        }
    }

    /// Carries an answer, behind those already in transit; a late one is discarded.
    fn answer(&mut self, asker: usize, until: Time, envelope: Envelope) {
        let Some(rate) = self.rate else { return self.robots[asker].inbox.push(Input::Envelope(envelope)) };
        let bytes = u32::try_from(codec::encode(&envelope).expect("it can be written").len()).expect("it is short");
        let from = self.coming.last_key_value().map_or(self.now, |((at, _), _)| *at);
        let at = from + Duration::from_secs_f64(f64::from(bytes) / f64::from(rate));
        if at <= until {
            self.next += 1;
            self.coming.insert((at, self.next), (asker, envelope));
        }
    }

    pub(super) fn send(&mut self, from: usize, to: ReplicaId, input: Input) {
        let away = self.robots[from].away;
        if let Some(robot) = self.robots.iter_mut().find(|robot| robot.address == to && !robot.away && !away) {
            robot.inbox.push(input);
        }
    }
}
