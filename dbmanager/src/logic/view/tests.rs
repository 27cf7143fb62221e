//! A few robots that write and take over transactions from each other by the replica's own rules, but without its
//! protocol.

use crate::logic::clock::{Quality, Timestamp, Wall};
use crate::logic::key::Key;
use crate::logic::log::{Head, Log, Verdict};
use crate::logic::member;
use crate::logic::state::{CausalContext, State};
use crate::logic::txn::{Draft, EncodedTxn, Txn};
use crate::logic::version_vector::{Dot, ReplicaId, VersionVector};
use crate::logic::view::past::Past;
use crate::logic::view::value::Datum;
use proptest::prelude::*;

/// 2026-11-21 10:00:00 UTC.
pub(super) const MORNING: u64 = 1_795_255_200_000;

pub(super) fn key(text: &str) -> Key {
    Key::new(text).unwrap()
}

pub(super) fn toml(text: &str) -> Datum {
    Datum::from_toml(text).unwrap()
}

/// A robot.
#[derive(Clone, Debug)]
pub(super) struct Robot {
    pub(super) origin: ReplicaId,
    pub(super) log: Log,
    pub(super) state: State,
    pub(super) wall: Wall,
}

impl Robot {
    /// Returns robots `r1`, `r2`, … that know each other as members, and have no other data.
    pub(super) fn team(count: u64) -> Vec<Self> {
        let robot = |number| Self {
            origin: ReplicaId::new(number),
            log: Log::default(),
            state: State::default(),
            wall: Wall { millis: MORNING, quality: Quality::Network },
        };
        let mut team: Vec<Self> = (1..=count).map(robot).collect();
        let mut found = Draft::new("found the team");
        for number in 1..=count {
            let write = member::admission(ReplicaId::new(number), &format!("r{number}")).unwrap();
            found = found.put(write.key, write.value.unwrap());
        }
        team[0].commit(found);
        let first = team[0].clone();
        team.iter_mut().skip(1).for_each(|robot| robot.pull(&first));
        team
    }

    pub(super) fn past(&self) -> Past<'_> {
        Past { log: &self.log, state: &self.state }
    }

    pub(super) fn vector(&self) -> VersionVector {
        self.log.vector().clone()
    }

    pub(super) fn put(&mut self, reason: &str, at: &str, value: &str) -> Dot {
        self.commit(Draft::new(reason).put(key(at), toml(value).encode().unwrap()))
    }

    /// Commits a second after the last time.
    pub(super) fn commit(&mut self, draft: Draft) -> Dot {
        draft.requires().iter().for_each(|require| self.state.check(require).unwrap());
        self.wall.millis += 1000;
        let none = Head::default();
        let head = self.log.head(self.origin).unwrap_or(&none);
        let kept = self.wall.quality >= Quality::Network;
        let lift = if kept { self.wall.millis << 16 } else { 0 };
        let (reason, requires, writes) = draft.into_parts();
        let txn = Txn {
            stamp: Timestamp { epoch: 0, hlc: lift.max(self.log.last_stamp().hlc + 1), origin: self.origin },
            seq: head.seq + 1,
            prev: head.hash,
            wall: self.wall,
            context: self.log.vector().beyond(&head.context).without(self.origin),
            reason,
            requires,
            writes,
            wants_ack: false,
            rebase: None,
        };
        self.take(&EncodedTxn::seal(&txn).unwrap());
        txn.dot()
    }

    /// Takes over all transactions of another robot.
    pub(super) fn pull(&mut self, from: &Self) {
        let (txns, _) = from.log.beyond(self.log.vector(), usize::MAX).unwrap();
        txns.iter().for_each(|encoded| self.take(encoded));
        self.wall.millis = self.wall.millis.max(from.wall.millis);
    }

    fn take(&mut self, encoded: &EncodedTxn) {
        let txn = encoded.open().unwrap();
        assert_eq!(self.log.judge(&txn, encoded), Verdict::Next);
        let context = self.log.context(&txn);
        self.state.apply(txn.dot(), txn.stamp, CausalContext { context: &context, only: None }, &txn.writes);
        self.log.append(&txn, encoded.clone());
    }

    /// Drops the oldest transactions that every robot has, as if only `size_max` bytes were to be kept.
    pub(super) fn forget(&mut self, size_max: usize) {
        self.forget_within(&self.vector(), size_max);
    }

    /// Drops the oldest transactions within a version vector.
    pub(super) fn forget_within(&mut self, stable: &VersionVector, size_max: usize) {
        self.log.truncate(stable, size_max);
    }
}

/// An event in a team of three.
#[derive(Clone, Debug)]
pub(super) enum Step {
    /// A robot writes these values, or deletions, at these keys.
    Write(usize, Vec<(u8, Option<i64>)>),
    /// A robot takes over all transactions of another one.
    Pull(usize, usize),
}

pub(super) fn steps() -> impl Strategy<Value = Vec<Step>> {
    let change = (0_u8..4, proptest::option::weighted(0.8, 0_i64..9));
    let step = prop_oneof![
        (0_usize..3, proptest::collection::vec(change, 1..3)).prop_map(|(robot, changes)| Step::Write(robot, changes)),
        (0_usize..3, 0_usize..3).prop_map(|(to, from)| Step::Pull(to, from)),
    ];
    proptest::collection::vec(step, 0..40)
}

/// Runs the steps; calls `after` with the acting robot after each step.
pub(super) fn play(team: &mut [Robot], steps: &[Step], mut after: impl FnMut(&Robot)) {
    for step in steps {
        let robot = match step {
            Step::Write(robot, changes) => {
                let draft = changes.iter().fold(Draft::new("step"), |draft, (at, value)| match value {
                    Some(number) => draft.put(key(&format!("team/k{at}")), Datum::Integer(*number).encode().unwrap()),
                    None => draft.delete(key(&format!("team/k{at}"))),
                });
                team[*robot].commit(draft);
                *robot
            }
            Step::Pull(to, from) => {
                let from = team[*from].clone();
                team[*to].pull(&from);
                *to
            }
        };
        after(&team[robot]);
    }
}

/// Gives all transactions to all robots.
pub(super) fn heal(team: &mut [Robot]) {
    for _ in 0..2 {
        for to in 0..team.len() {
            for from in 0..team.len() {
                let from = team[from].clone();
                team[to].pull(&from);
            }
        }
    }
}
