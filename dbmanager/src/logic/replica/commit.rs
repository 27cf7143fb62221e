//! The commit pipeline: turns a draft of a caller into a transaction with its position in history.
//!
//! [`CommitPipeline::plan`] checks a draft against the present state. [`CommitPipeline::seal`] gives it a timestamp, a number
//! and a context. The replica then adds it to its contents. Values that never leave the robot are written here at once.
//!
//! *Urgent and bulk.* Transactions have no priorities. A transaction is shown after all transactions that its writer had seen,
//! which is usually everything that its robot had. So an urgent transaction could overtake almost nothing without breaking that
//! promise or making two histories. Instead, transactions are short (256 KiB; a chunk of a slow link has at most four of them).
//! Large data is stored elsewhere, and a value names it by its hash. A robot that needs bulk data with a separate history runs
//! a second replica as a separate team, whose messages the driver sends with less priority.
//!
//! *State.* The hybrid clock, the last reading of the wall clock, and the values at `local/…`.

use super::contents::Contents;
use super::interface::AckLevel;
use crate::logic::clock::{Clock, Timestamp, Wall};
use crate::logic::key::{Key, Namespace};
use crate::logic::log::Log;
use crate::logic::notary::Notary;
use crate::logic::owner::{self, Owner};
use crate::logic::record::{Batch, LOCAL};
use crate::logic::state::{CausalContext, State};
use crate::logic::txn::{Condition, Draft, EncodedTxn, Grant, Rebase, Require, Txn, TxnError, Write};
use crate::logic::version_vector::{Dot, ReplicaId, VersionVector};
use comms::logic::time::Time;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

/// The content of a transaction, without its position in history.
#[derive(Debug, Default)]
pub(super) struct Change {
    pub(super) reason: String,
    pub(super) requires: Vec<Require>,
    pub(super) writes: Vec<Write>,
    pub(super) wants_ack: bool,
    pub(super) rebase: Option<Rebase>,
}

impl Change {
    /// Returns a change that the database itself writes.
    pub(super) fn system(reason: &str, writes: Vec<Write>) -> Self {
        Self { reason: reason.into(), writes, ..Self::default() }
    }
}

/// The pipeline that turns drafts into transactions.
#[derive(Debug)]
pub(super) struct CommitPipeline {
    clock: Clock,
    wall: Wall,
    local: State,
    /// Signs transactions, in a team with keys.
    notary: Option<Arc<dyn Notary>>,
}

impl CommitPipeline {
    /// Returns a pipeline that continues after `last`, the largest timestamp of the log, or after the largest one of the local
    /// keys.
    pub(super) fn new(origin: ReplicaId, last: Timestamp, local: State) -> Self {
        let stamps = local.scan("").flat_map(|(_, versions)| versions).map(|version| version.stamp);
        let last = stamps.chain([last]).max().unwrap_or_default();
        Self { clock: Clock::new(origin, last), wall: Wall::default(), local, notary: None }
    }

    pub(super) fn local(&self) -> &State {
        &self.local
    }

    pub(super) fn wall(&self) -> Wall {
        self.wall
    }

    /// Signs transactions from now on.
    pub(super) fn sign_with(&mut self, notary: Arc<dyn Notary>) {
        self.notary = Some(notary);
    }

    /// Notes a reading of the wall clock.
    pub(super) fn set_wall(&mut self, wall: Wall) {
        self.wall = wall;
    }

    /// Notes a transaction of another replica. Returns how far it is dated ahead of a trusted clock, if this is suspicious.
    pub(super) fn observe(&mut self, now: Time, txn: &Txn) -> Option<Duration> {
        let ahead_by = Clock::suspects(txn.stamp, self.wall);
        self.clock.observe(now, txn.stamp, txn.wall);
        ahead_by
    }

    /// Continues after the largest timestamp of a state that was taken over.
    pub(super) fn go_on_after(&mut self, now: Time, last: Timestamp) {
        self.clock.observe(now, last, Wall::default());
    }

    /// Writes under another origin.
    pub(super) fn move_to(&mut self, origin: ReplicaId) {
        self.clock.move_to(origin);
    }

    /// Begins a new epoch. Returns false if no epoch is left.
    pub(super) fn heal(&mut self) -> bool {
        self.clock.heal()
    }

    /// Returns the change that a draft of this `robot` makes.
    pub(super) fn plan(&self, draft: Draft, robot: &str, contents: &Contents) -> Result<Change, TxnError> {
        draft.check()?;
        draft.requires().iter().try_for_each(|require| self.check(require, contents))?;
        let fences = draft.writes().filter_map(|(key, _)| check_owner(key, robot, contents).transpose());
        let fences: BTreeMap<Key, Dot> = fences.collect::<Result<_, _>>()?;
        let mut granted = Vec::new();
        for (prefix, grant) in draft.grants() {
            let record = owner::record(prefix).map_err(|_long| TxnError::Reserved { key: prefix.clone() })?;
            let to = match grant {
                Grant::Give(to) => check_owner(prefix, robot, contents).map(|_fence| to.as_deref())?,
                Grant::TakeOver(to) => Some(to.as_str()),
            };
            let term = contents.owners().find(prefix).map_or(0, |(_, owner)| owner.term);
            granted.push(Write { key: record, value: Some(owner::grant(term.saturating_add(1), to)) });
        }
        let (reason, mut requires, mut writes) = draft.into_parts();
        // Conditions on local keys are checked here, and are not part of the transaction.
        requires.retain(|require| require.key.namespace() != Namespace::Local);
        requires.extend(fences.into_iter().map(|(key, dot)| Require { key, condition: Condition::Is(dot) }));
        writes.extend(granted);
        writes.sort_by(|a, b| a.key.cmp(&b.key));
        Ok(Change { reason, requires, writes, ..Change::default() })
    }

    /// Gives a change the next position in the history of `origin`, after the transactions in `log`.
    pub(super) fn seal(
        &mut self,
        now: Time,
        change: Change,
        on: (ReplicaId, &Log),
    ) -> Result<(Txn, EncodedTxn), TxnError> {
        let (origin, log) = on;
        let mut clock = self.clock.clone();
        let stamp = clock.tick(now, self.wall).ok_or(TxnError::Clock)?;
        let head = log.head(origin).cloned().unwrap_or_default();
        let seq = head.seq.checked_add(1).ok_or(TxnError::Clock)?;
        // The replica's own number already covers the transactions that its earlier transactions have seen.
        let context: VersionVector = log.vector().beyond(&head.context).without(origin);
        let txn = Txn {
            stamp,
            seq,
            prev: head.hash,
            wall: self.wall,
            context,
            reason: change.reason,
            requires: change.requires,
            writes: change.writes,
            wants_ack: change.wants_ack,
            rebase: change.rebase,
        };
        // The context contains only the last transactions of other origins, so all its hashes are known.
        let seen = log.seen(&txn.context);
        if let Some(notary) = &self.notary {
            let encoded = EncodedTxn::seal_signed(&txn, seen.unwrap_or_default(), &**notary)?;
            self.clock = clock;
            return Ok((txn, encoded));
        }
        let seen = seen.filter(|_| !txn.context.is_empty());
        let encoded = seen.map_or_else(|| EncodedTxn::seal(&txn), |seen| EncodedTxn::seal_on(&txn, seen))?;
        self.clock = clock;
        Ok((txn, encoded))
    }

    /// Writes values that never leave the robot. Their dot has no origin.
    pub(super) fn write_local(
        &mut self,
        now: Time,
        draft: &Draft,
        level: &AckLevel,
        contents: &Contents,
        batch: &mut Batch,
    ) -> Result<Dot, TxnError> {
        draft.check()?;
        if let Some((key, _)) = draft.writes().next().filter(|_| *level != AckLevel::Local) {
            return Err(TxnError::Stays { key: key.clone() });
        }
        draft.requires().iter().try_for_each(|require| self.check(require, contents))?;
        let stamp = self.clock.tick(now, self.wall).ok_or(TxnError::Clock)?;
        let dot = Dot { origin: ReplicaId::default(), seq: stamp.hlc };
        let all: VersionVector = [(dot.origin, u64::MAX)].into_iter().collect();
        for (key, value) in draft.writes() {
            let write = Write { key: key.clone(), value: value.cloned() };
            self.local.apply(dot, stamp, CausalContext { context: &all, only: None }, &[write]);
            self.local.drop_deleted(&all);
            batch.versions(LOCAL, key, self.local.versions(key));
        }
        Ok(dot)
    }

    fn check(&self, require: &Require, contents: &Contents) -> Result<(), TxnError> {
        let state = if require.key.namespace() == Namespace::Local { &self.local } else { contents.state() };
        state.check(require)
    }
}

/// Returns the grant that permits a robot to write a key, if it needs one, with the key of the grant's record.
fn check_owner(key: &Key, robot: &str, contents: &Contents) -> Result<Option<(Key, Dot)>, TxnError> {
    if matches!(key.namespace(), Namespace::System | Namespace::Local) {
        return Err(TxnError::Reserved { key: key.clone() });
    }
    let Some((prefix, Owner { term, robot: owner, grant })) = contents.owners().find(key) else { return Ok(None) };
    if let Some(owner) = owner.filter(|owner| owner != robot) {
        return Err(TxnError::NotOwner { key: key.clone(), owner, term });
    }
    let record = Key::new(prefix).and_then(|prefix| owner::record(&prefix));
    Ok(record.ok().zip(grant))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::clock::Quality;

    const ME: ReplicaId = ReplicaId::new(1);
    const WALL: Wall = Wall { millis: 1_790_000_000_000, quality: Quality::Network };

    fn pipeline() -> (CommitPipeline, Contents) {
        let mut pipeline = CommitPipeline::new(ME, Timestamp::default(), State::default());
        pipeline.set_wall(WALL);
        (pipeline, Contents::new(Log::default(), State::default()))
    }

    fn key(text: &str) -> Key {
        Key::new(text).unwrap()
    }

    #[test]
    fn a_draft_becomes_the_next_transaction_of_its_origin() {
        let (mut pipeline, mut contents) = pipeline();
        let mut batch = Batch::default();
        for seq in 1..=3 {
            let change = pipeline.plan(Draft::new("r").put(key("team/a"), b"1"), "r", &contents).unwrap();
            let (txn, encoded) = pipeline.seal(Time::ZERO, change, (ME, contents.log())).unwrap();
            assert_eq!((txn.dot(), txn.prev), (Dot { origin: ME, seq }, contents.log().tip(ME).1));
            assert!(txn.stamp > contents.log().last_stamp() && txn.context.is_empty());
            contents.enter(&txn, &encoded, &mut batch);
        }
        assert_eq!(contents.state().versions(&key("team/a")).len(), 1);
    }

    #[test]
    fn what_does_not_hold_or_is_another_robots_is_refused_and_changes_nothing() {
        let (pipeline, contents) = pipeline();
        let plan = |draft| pipeline.plan(draft, "r", &contents).err();
        let missing = Draft::new("").require(key("team/a"), Condition::Exists).put(key("team/b"), b"1");
        assert!(matches!(plan(missing), Some(TxnError::Precondition { .. })));
        assert!(matches!(plan(Draft::new("").put(key("robot/x/a"), b"1")), Some(TxnError::NotOwner { .. })));
        assert!(matches!(plan(Draft::new("").put(key("sys/a"), b"1")), Some(TxnError::Reserved { .. })));
        assert_eq!(plan(Draft::new("").put(key("robot/r/a"), b"1")), None);
    }

    #[test]
    fn what_is_too_long_uses_up_no_stamp() {
        let (mut pipeline, contents) = pipeline();
        let before = pipeline.clock.clone().tick(Time::ZERO, WALL);
        let change = Change { reason: "r".repeat(1 << 20), ..Change::default() };
        assert!(pipeline.seal(Time::ZERO, change, (ME, contents.log())).is_err());
        assert_eq!(pipeline.clock.clone().tick(Time::ZERO, WALL), before);
    }

    #[test]
    fn what_is_local_waits_for_nobody_and_leaves_no_deletion() {
        let (mut pipeline, contents) = pipeline();
        let mut write = |draft: &Draft, level: &AckLevel| {
            let mut batch = Batch::default();
            pipeline.write_local(Time::ZERO, draft, level, &contents, &mut batch).map(|_dot| pipeline.local.len())
        };
        let put = Draft::new("").put(key("local/a"), b"1");
        assert!(matches!(write(&put, &AckLevel::Everywhere), Err(TxnError::Stays { .. })));
        assert_eq!(write(&put, &AckLevel::Local), Ok(1));
        assert_eq!(write(&Draft::new("").delete(key("local/a")), &AckLevel::Local), Ok(0));
    }
}
