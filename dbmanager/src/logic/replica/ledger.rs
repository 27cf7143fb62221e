//! The ledger: contents and identity of a replica. It applies, commits, takes over and drops transactions. The records of each
//! transaction are written in one batch.
//!
//! *Rule.* Log and state are changed only by [`Ledger::apply`] and [`Ledger::commit`]. Transactions are applied in the order in
//! which they come. A transaction that does not fit is buffered, or pulled again.

use super::authors::{Authors, NotTaken};
use super::commit::{Change, CommitPipeline};
use super::contents::Contents;
use super::download::Downloaded;
use super::identity::Identity;
use super::interface::{AckLevel, Alarm, Config, Effect};
use super::pending::PendingTxns;
use super::rebase::{self, Rest};
use crate::logic::delta::DeltaPush;
use crate::logic::gc::{Acks, Stable};
use crate::logic::log::{Head, Log, Verdict};
use crate::logic::member;
use crate::logic::message::{Chunk, Join, Message, PUSH_SIZE_MAX};
use crate::logic::notary::{Doubt, Notary};
use crate::logic::record::{Batch, OpenError, StoredRecords};
use crate::logic::txn::{CodecError, Draft, EncodedTxn, TxnError};
use crate::logic::version_vector::{Dot, ReplicaId, VersionVector};
use comms::logic::random::Random;
use comms::logic::time::Time;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The parts of a replica that change together.
#[derive(Debug)]
pub(super) struct Ledger {
    contents: Contents,
    pub(super) identity: Identity,
    pub(super) pipeline: CommitPipeline,
    pub(super) authors: Authors,
    pending: PendingTxns,
    /// The transactions that others are known to have.
    pub(super) acks: Acks,
    batch: Batch,
    log_size: usize,
    /// Whether this replica has changes that were not announced to others yet.
    changed: bool,
}

impl Ledger {
    pub(super) fn open(config: &Config, stored: StoredRecords, random: &mut Random) -> Result<Self, OpenError> {
        let (stored, log) = stored.finish()?;
        let identity = Identity::open(&config.robot, stored.identity, stored.count == 0, random)?;
        Ok(Self {
            pipeline: CommitPipeline::new(identity.origin(), log.last_stamp(), stored.local),
            contents: Contents::new(log, stored.state),
            identity,
            authors: Authors::default(),
            pending: PendingTxns::new(stored.pending),
            acks: Acks::default(),
            batch: Batch::default(),
            log_size: config.log_size,
            changed: false,
        })
    }

    /// Makes the replica sign its transactions, and accept only signed transactions of others.
    pub(super) fn sign_with(&mut self, notary: Arc<dyn Notary>) {
        self.pipeline.sign_with(Arc::clone(&notary));
        self.authors.check_with(notary);
    }

    /// Returns the request for admission; none if the replica does not ask for it.
    pub(super) fn join(&self) -> Option<Join> {
        let join = self.identity.join()?;
        let claim = self.authors.claim(join.origin, &join.replaces);
        Some(Join { claim, ..join })
    }

    pub(super) fn contents(&self) -> &Contents {
        &self.contents
    }

    pub(super) fn log(&self) -> &Log {
        self.contents.log()
    }

    pub(super) fn pending(&self) -> &PendingTxns {
        &self.pending
    }

    pub(super) fn is_member(&self) -> bool {
        self.identity.joining().is_none() && self.contents.members().is_active(self.identity.origin())
    }

    /// Returns the other members, with their robots.
    pub(super) fn others(&self) -> impl Iterator<Item = (ReplicaId, &str)> {
        self.contents.members().active().filter(|(origin, _)| *origin != self.identity.origin())
    }

    /// Returns the version vector of all transactions here, applied or buffered.
    pub(super) fn have(&self) -> VersionVector {
        self.pending.with(self.contents.log())
    }

    pub(super) fn stable(&self) -> Stable {
        self.acks.stable(self.identity.origin(), self.log().vector(), self.contents.members())
    }

    /// Appends the pending disk writes, then the effects `after` that depend on them.
    pub(super) fn persist(&mut self, after: Vec<Effect>, effects: &mut Vec<Effect>) {
        self.identity.write(&mut self.batch);
        if self.batch.is_empty() {
            effects.extend(after);
            return;
        }
        self.batch.digests(self.contents.log(), self.contents.state());
        let persist = Effect::Persist(std::mem::take(&mut self.batch));
        effects.push(persist);
        effects.extend(after);
    }

    /// Applies a transaction if it is the next one of its origin.
    fn apply(&mut self, now: Time, encoded: EncodedTxn, effects: &mut Vec<Effect>) -> Result<Verdict, NotTaken> {
        let txn = encoded.open()?;
        let verdict = self.log().judge(&txn, &encoded);
        if verdict != Verdict::Known {
            self.authors.check_signature(&txn, &encoded, &self.contents).map_err(NotTaken::Doubt)?;
        }
        if verdict != Verdict::Next {
            return Ok(verdict);
        }
        self.authors.check_rules(&txn, &self.contents).map_err(NotTaken::Doubt)?;
        let retired = txn.writes.iter().filter_map(|write| member::retired_by(&write.key));
        if retired.into_iter().any(|origin| self.pending.has(origin)) {
            return Ok(Verdict::Early);
        }
        let (me, origin) = (self.identity.origin(), txn.stamp.origin);
        if let Some(ahead_by) = (origin != me).then(|| self.pipeline.observe(now, &txn)).flatten() {
            effects.push(Effect::Alarm(Alarm::ClockSuspect { origin, ahead_by }));
        }
        let own = txn.context.get(me);
        if own > self.identity.proven()
            && encoded.seen().is_some_and(|said| self.log().seen(&txn.context) == Some(said))
        {
            self.identity.proves(own);
        }
        self.contents.enter(&txn, &encoded, &mut self.batch);
        effects.push(Effect::Visible(txn.dot(), encoded));
        Ok(verdict)
    }

    /// Applies transactions that a peer has sent; returns whether one could not be applied.
    pub(super) fn receive(
        &mut self,
        now: Time,
        from: ReplicaId,
        txns: Vec<EncodedTxn>,
        effects: &mut Vec<Effect>,
    ) -> bool {
        let mut missing = false;
        let mut waiting: Vec<ReplicaId> = Vec::new();
        for encoded in txns {
            let txn = encoded.open().ok();
            let origin = txn.as_ref().map_or(from, |txn| txn.stamp.origin);
            match self.apply(now, encoded.clone(), effects) {
                Ok(Verdict::Next) if txn.as_ref().is_some_and(|txn| txn.wants_ack) && !waiting.contains(&origin) => {
                    waiting.push(origin);
                }
                Ok(Verdict::Next | Verdict::Known) => {}
                Ok(Verdict::Early) => missing |= !self.buffer(&encoded),
                Ok(Verdict::Fork) => {
                    self.notice_fork(origin, effects);
                    if origin != from {
                        let known = self.contents.links_of([(origin, self.log().vector().get(origin))]);
                        effects.push(Effect::Send(from, known));
                    }
                    missing = true;
                }
                Ok(Verdict::Apart) => {
                    let seen = txn.map(|txn| txn.context).unwrap_or_default();
                    effects.push(Effect::Send(from, self.contents.links_of(seen.iter())));
                    missing = true;
                }
                Err(NotTaken::Doubt(Doubt::Unknown)) => missing = true,
                Err(NotTaken::Doubt(Doubt::Forged(why))) => {
                    effects.push(Effect::Alarm(Alarm::Forged { from, why }));
                    missing = true;
                }
                Err(NotTaken::Codec(CodecError::Format { format })) => {
                    effects.push(Effect::Alarm(Alarm::NeedsUpgrade(format)));
                    // This replica cannot find out the author of the transaction, so it accepts the transaction only from its origin.
                    let is_theirs = encoded.split().is_ok_and(|(header, _)| header.stamp.origin == from);
                    missing |= self.authors.notary().is_some() && !is_theirs || !self.buffer(&encoded);
                }
                Err(NotTaken::Codec(CodecError::Long { .. } | CodecError::Body { .. })) => {
                    effects.push(Effect::Alarm(Alarm::Malformed(from)));
                    missing = true;
                }
            }
        }
        self.changed |= !self.batch.is_empty();
        let ack = |origin| Effect::Send(origin, Message::Ack(self.log().vector().clone()));
        effects.extend(waiting.into_iter().map(ack));
        missing
    }

    /// Applies the transactions that a peer has written after the head known here; returns whether some are missing.
    pub(super) fn receive_delta(
        &mut self,
        now: Time,
        from: ReplicaId,
        push: &DeltaPush,
        effects: &mut Vec<Effect>,
    ) -> bool {
        let head = self.log().head(from).cloned().unwrap_or_default();
        if let Some(txns) = push.txns(from, head, |vector| self.log().seen(vector)) {
            return self.receive(now, from, txns, effects);
        }
        let known = |seq| self.log().encoded(Dot { origin: from, seq }).map(EncodedTxn::hash);
        let forks = push.hashes().any(|(seq, hash)| known(seq).is_some_and(|known| known != hash));
        if forks {
            self.notice_fork(from, effects);
        }
        forks || push.hashes().any(|(seq, _)| seq > self.log().vector().get(from))
    }

    /// Notes that a transaction has come whose number its origin has used twice. This is remembered until this replica is admitted
    /// again: a state does not show which of the two transactions it has.
    fn notice_fork(&mut self, origin: ReplicaId, effects: &mut Vec<Effect>) {
        if origin != self.identity.origin() {
            self.identity.knows_forked(origin);
        }
        self.tell_fork(origin, effects);
    }

    /// Reports that an origin has used a number twice.
    pub(super) fn tell_fork(&self, origin: ReplicaId, effects: &mut Vec<Effect>) {
        effects.push(Effect::Alarm(Alarm::Fork(origin)));
        effects.push(Effect::Send(origin, self.contents.tip_of(origin)));
    }

    /// Buffers a transaction that cannot be applied. Returns whether it is buffered now, possibly from before.
    pub(super) fn buffer(&mut self, encoded: &EncodedTxn) -> bool {
        self.pending.buffer(encoded, self.contents.log(), &mut self.batch)
    }

    /// Applies the buffered transactions that this program can read, and drops those that have been applied in another way.
    pub(super) fn release(&mut self, now: Time, effects: &mut Vec<Effect>) {
        if !self.is_member() {
            return;
        }
        let mut left = BTreeMap::new();
        for (index, (dot, encoded)) in self.pending.take() {
            let done = matches!(self.apply(now, encoded.clone(), effects), Ok(Verdict::Next | Verdict::Known));
            if done || self.log().vector().contains(dot) {
                self.batch.pending(index, None);
            } else {
                left.insert(index, (dot, encoded));
            }
        }
        self.pending.keep(left);
    }

    /// Returns whether an origin may be retired: it belongs to another replica, none of its transactions is buffered, and it is
    /// not retired yet.
    pub(super) fn may_retire(&self, origin: ReplicaId) -> bool {
        let retired = self.contents.members().retired(origin).is_some();
        origin != self.identity.origin() && !retired && !self.pending.has(origin)
    }

    /// Commits the draft of a caller.
    pub(super) fn commit_draft(
        &mut self,
        now: Time,
        draft: Draft,
        wants_ack: bool,
    ) -> Result<(Dot, EncodedTxn), TxnError> {
        let change = self.pipeline.plan(draft, self.identity.robot(), &self.contents)?;
        self.commit(now, Change { wants_ack, ..change })
    }

    /// Gives a change its position in history, and applies it.
    fn commit(&mut self, now: Time, change: Change) -> Result<(Dot, EncodedTxn), TxnError> {
        let (txn, encoded) = self.pipeline.seal(now, change, (self.identity.origin(), self.contents.log()))?;
        self.authors.check_own(&txn, &self.contents).map_err(|why| TxnError::Unproven { why })?;
        self.contents.enter(&txn, &encoded, &mut self.batch);
        Ok((txn.dot(), encoded))
    }

    /// Writes local keys, which never leave the robot.
    pub(super) fn commit_local(&mut self, now: Time, draft: &Draft, level: &AckLevel) -> Result<Dot, TxnError> {
        self.pipeline.write_local(now, draft, level, &self.contents, &mut self.batch)
    }

    /// Gives up the origin. `twice`: the origin may have used numbers twice.
    pub(super) fn begin_anew(&mut self, twice: bool, random: &mut Random, effects: &mut Vec<Effect>) {
        let from = self.identity.begin_anew(twice, random);
        self.pipeline.move_to(self.identity.origin());
        effects.push(Effect::Alarm(Alarm::Rejoining { from }));
    }

    /// Commits the rest of a transaction again, as several transactions if it is too long now. Returns the name of the last one.
    fn commit_again(&mut self, now: Time, rest: Rest, effects: &mut Vec<Effect>) -> Option<Dot> {
        let (mut waiting, mut name) = (vec![rest], None);
        while let Some(rest) = waiting.pop() {
            match self.commit(now, rest.change()) {
                Ok((dot, encoded)) => {
                    effects.push(Effect::Visible(dot, encoded));
                    name = Some(dot);
                }
                Err(TxnError::Codec(CodecError::Long { .. })) => waiting.extend(rest.shorter()),
                Err(_exhausted) => effects.push(Effect::Alarm(Alarm::Malformed(self.identity.origin()))),
            }
        }
        name
    }

    /// Commits a change of the database itself, and pushes it to others.
    pub(super) fn commit_system(&mut self, now: Time, change: Change, effects: &mut Vec<Effect>) {
        let before = self.own_head();
        match self.commit(now, change) {
            Ok((dot, encoded)) => {
                effects.push(Effect::Visible(dot, encoded.clone()));
                self.push(before, vec![encoded], effects);
            }
            Err(TxnError::Unproven { why }) => {
                effects.push(Effect::Alarm(Alarm::Forged { from: self.identity.origin(), why }));
            }
            Err(_exhausted) => effects.push(Effect::Alarm(Alarm::Malformed(self.identity.origin()))),
        }
    }

    pub(super) fn retire(&mut self, now: Time, origin: ReplicaId, effects: &mut Vec<Effect>) {
        let may = self.may_retire(origin) && self.authors.may_retire(origin, &self.contents);
        if may && self.is_member() && self.contents.members().is_active(origin) {
            let writes = member::retirement(origin).into_iter().collect();
            self.commit_system(now, Change::system("retire", writes), effects);
        }
    }

    /// Begins a new epoch. Every replica that sees a transaction of the new epoch continues in it, even after a restart.
    pub(super) fn heal_clock(&mut self, now: Time, effects: &mut Vec<Effect>) {
        if self.pipeline.heal() {
            self.commit_system(now, Change::system("heal the clocks", Vec::new()), effects);
        } else {
            effects.push(Effect::Alarm(Alarm::Malformed(self.identity.origin())));
        }
    }

    /// Returns the last of the own transactions.
    pub(super) fn own_head(&self) -> Head {
        self.log().head(self.identity.origin()).cloned().unwrap_or_default()
    }

    /// Pushes new transactions, and the head before them, to others. Long transactions are not pushed: others pull them.
    pub(super) fn push(&mut self, before: Head, txns: Vec<EncodedTxn>, effects: &mut Vec<Effect>) {
        if txns.is_empty() || !self.is_member() {
            return;
        }
        self.changed = true;
        let size: usize = txns.iter().map(EncodedTxn::size).sum();
        if size <= PUSH_SIZE_MAX {
            let push = DeltaPush::of(before, &txns);
            effects.push(Effect::Broadcast(push.map_or(Message::Push(txns), Message::DeltaPush)));
        }
    }

    /// Returns whether there are changes that were not announced to others, and marks them as announced.
    pub(super) fn take_changed(&mut self) -> bool {
        std::mem::take(&mut self.changed)
    }

    /// Takes over the state of a peer, and applies again the transactions that only this replica has. If this state admits the
    /// replica, it then commits its remaining changes. Returns the new names of transactions.
    pub(super) fn install(&mut self, now: Time, whole: Downloaded, effects: &mut Vec<Effect>) -> BTreeMap<Dot, Dot> {
        let (from, vector, joining) = (whole.from, whole.manifest.vector(), self.identity.joining());
        let log = Log::new(whole.manifest.heads.into_iter().collect());
        let old = self.contents.replace(log, whole.state, &mut self.batch);
        self.authors.forget();
        self.pipeline.go_on_after(now, self.log().last_stamp());
        effects.push(Effect::Replaced);
        let joins = joining.is_some();
        for (dot, encoded) in old.log().in_order() {
            if self.log().vector().contains(dot) || joins && !self.contents.members().is_active(dot.origin) {
                continue;
            }
            if !matches!(self.apply(now, encoded.clone(), effects), Ok(Verdict::Next)) && !joins {
                effects.push(Effect::Alarm(Alarm::Fork(dot.origin)));
            }
        }
        let names = joining.map(|joining| self.rebase(now, joining, &old, effects)).unwrap_or_default();
        self.acks.begin_anew();
        self.acks.note(from, &vector);
        names
    }

    /// Continues as `joining`, with all of `old` that no other replica rebases; returns the new names of transactions.
    fn rebase(
        &mut self,
        now: Time,
        joining: ReplicaId,
        old: &Contents,
        effects: &mut Vec<Effect>,
    ) -> BTreeMap<Dot, Dot> {
        let arrivals = rebase::arrivals(old, &self.contents, joining, &self.identity);
        self.identity.admitted(joining);
        self.pipeline.move_to(joining);
        let mut names = BTreeMap::new();
        let Some(arrivals) = arrivals else { return names };
        // The first transaction has the sponsor's version vector as its context, so the later transactions do not have to repeat it.
        self.commit_system(now, Change::system("come back", Vec::new()), effects);
        for (from, rest) in arrivals.rests {
            let name = self.commit_again(now, rest, effects);
            names.extend(from.zip(name));
        }
        effects.extend(names.iter().map(|(from, to)| Effect::Renamed(*from, *to)));
        for write in arrivals.records {
            self.commit_system(now, Change::system("come back", vec![write]), effects);
        }
        names
    }

    /// Drops data that is no longer needed.
    pub(super) fn gc(&mut self) {
        self.acks.settle(self.contents.log().vector());
        if !self.is_member() {
            return;
        }
        let mut stable = self.stable().vector;
        if self.acks.drops(&stable) {
            self.contents.drop_deleted(&stable, &mut self.batch);
        }
        // After a set-back, others may have different transactions under the own numbers. This can be noticed only while the own
        // transactions are kept.
        let (me, proven) = (self.identity.origin(), self.identity.proven());
        if stable.get(me) > proven && self.contents.members().active().nth(1).is_some() {
            stable = stable.without(me);
            stable.include(Dot { origin: me, seq: proven });
        }
        self.contents.truncate(&stable, self.log_size, &mut self.batch);
    }

    /// Returns the answer to a member that has lost transactions that it had reported. Others may have dropped deletions because
    /// of that report, so the member must not continue under its id.
    pub(super) fn behind(&self, from: ReplicaId, vector: &VersionVector) -> Option<Message> {
        let said = self.acks.acked(from).filter(|said| !vector.dominates(said));
        said.map(|said| Message::Chunk(Chunk::Behind(said.clone())))
    }
}
