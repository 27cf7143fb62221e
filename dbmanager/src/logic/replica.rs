//! One replica: what it is told, what it does about it.
//!
//! [`Replica::handle`] takes an [`Input`] and says what is to be done, in order: the driver carries out [`Effect::Persist`],
//! durably, before anything that comes after it (T4: what is acknowledged or sent is on the disk, and what another has
//! from here cannot be forgotten here). If it fails, the driver drops the effects behind it and the replica, and opens the
//! store again: a sync that is tried once more may succeed without having written anything.
//!
//! The driver also asks for [`Replica::address`] after each input: it changes when a replica begins anew, and while it looks for
//! somebody to admit it. What still comes to an old address may be handed in, or not.
//!
//! A replica is a *member*, or it wants to become one. Until then it may be written to, but shows its transactions to
//! nobody; once admitted it begins with its sponsor's state and brings them in under the origin that was admitted, with
//! what they had seen. The same way back is taken by who was retired while away, by who finds that others know more of
//! its own transactions than itself (a lost tail, a restored backup), and by both of two clones.
//!
//! *Urgent and bulk.* There are no classes of transactions. One is shown after all that its writer had seen, and that is as a
//! rule all that its robot had; so there is hardly anything that an urgent one could overtake without breaking that promise
//! or making two histories. Instead transactions are short (256 KiB, a chunk of a slow link at most four of them), and what is
//! large goes beside them: a value names it by its hash. A robot that needs bulk with a history of its own runs a second
//! replica as a team of its own, whose messages the driver sends with less priority.
//!
//! `sync` talks to peers, `take` takes what they wrote, `commit` writes, `join` begins anew, `bring` says with what, `hold` keeps what cannot be read.

mod bring;
mod commit;
mod hold;
mod join;
mod sync;
mod take;

use crate::logic::clock::{Clock, Stamp, Wall};
use crate::logic::collect::{Acks, Stable};
use crate::logic::cut::{Cut, Dot, Origin};
use crate::logic::key::Key;
use crate::logic::log::{Log, Verdict};
use crate::logic::member::{self, Members};
use crate::logic::message::Message;
use crate::logic::mutant::Mutant;
use crate::logic::owner::Owners;
use crate::logic::random::Random;
use crate::logic::record::{Batch, Identity, OpenError, Reading, SHARED};
use crate::logic::snapshot::Name;
use crate::logic::state::{Seen, State};
use crate::logic::txn::{Draft, Frame, FrameError, Txn, TxnError};
use comms::logic::time::Time;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// What a replica is started with.
#[derive(Clone, Debug)]
pub struct Config {
    /// Name of the robot.
    pub robot: String,
    /// From real randomness: origins are made of it.
    pub seed: u64,
    /// How many bytes of transactions are kept although everybody has them.
    pub log_size: usize,
    /// A planted bug.
    pub mutant: Mutant,
}

/// How far a transaction has to have got.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Level {
    /// It is on the disk here.
    Local,
    /// It is on the disks of so many other robots.
    Replicated(usize),
    /// It is on the disks of these robots.
    On(BTreeSet<String>),
    /// It is on the disks of all members.
    Everywhere,
}

/// A wish to commit.
#[derive(Clone, Debug)]
pub struct Request {
    /// Named in the answers.
    pub ticket: u64,
    /// What.
    pub draft: Draft,
    /// What the caller waits for.
    pub level: Level,
    /// Until when.
    pub until: Time,
}

/// What a replica is told.
#[derive(Clone, Debug)]
pub enum Input {
    /// It begins; or it is time, as [`Replica::deadline`] asked for.
    Tick(Wall),
    /// Callers want to commit. Those that wait at the same time go to the disk together.
    Commit(Vec<Request>, Wall),
    /// A message has arrived.
    Received(Origin, Message, Wall),
    /// Somebody has come, or come back: it is told at once what is here.
    Appeared(Wall),
    /// An operator: this is the first member of a team.
    Found(Wall),
    /// An operator: this origin will never write again.
    Retire(Origin, Wall),
    /// An operator: dates have gone wrong, begin a new epoch.
    HealClock(Wall),
}

/// What the caller of a commit learns.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// Nothing was written.
    Refused(TxnError),
    /// It is durable here, and will be everywhere.
    Committed(Dot),
    /// It has got as far as was asked for.
    Reached(Dot),
    /// It has not in time, but still may. It stays committed.
    Pending(Dot),
}

/// What an operator has to know.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Alarm {
    /// A transaction is dated far ahead of our trusted clock.
    ClockSuspect {
        /// Whose.
        origin: Origin,
        /// By how much.
        ahead_by: Duration,
    },
    /// An origin has used a number twice.
    Fork(Origin),
    /// A peer has the same transactions and another state.
    Diverged(Origin),
    /// A peer writes a format that this program cannot read.
    NeedsUpgrade(u8),
    /// A peer sent what no peer sends.
    Malformed(Origin),
    /// We have to begin under a new origin.
    Rejoining {
        /// The one given up.
        from: Origin,
    },
}

/// What is to be done, in order.
#[derive(Clone, Debug)]
pub enum Effect {
    /// Write this, and return only when it is on the disk.
    Persist(Batch),
    /// Send this to everybody.
    Broadcast(Message),
    /// Send this to one.
    Send(Origin, Message),
    /// Tell the caller of a ticket.
    Answer(u64, Answer),
    /// Tell watchers: this transaction is visible now.
    Visible(Dot, Frame),
    /// A transaction has a new name, since its origin had to be given up.
    Renamed(Dot, Dot),
    /// Watchers begin anew: the state was replaced by a snapshot.
    Replaced,
    /// Tell an operator.
    Alarm(Alarm),
}

/// The machine.
#[derive(Debug)]
pub struct Replica {
    config: Config,
    identity: Identity,
    boot: u64,
    log: Log,
    state: State,
    local: State,
    clock: Clock,
    wall: Wall,
    members: Members,
    owners: Owners,
    acks: Acks,
    collected: Cut,
    /// Up to where others are known to mean the same by the own numbers, as this start has seen.
    proven: u64,
    random: Random,
    sync: sync::Sync,
    waiting: commit::Waiting,
    download: Option<join::Download>,
    /// Chunks of a download that was broken off.
    spare: BTreeMap<Name, Vec<u8>>,
    offer: join::Offer,
    held: hold::Held,
    batch: Batch,
}

impl Replica {
    /// Opens a replica on what its store says: a [`Reading`] of it, or all its records.
    ///
    /// # Errors
    /// If the store is damaged, or another robot's.
    pub fn open(config: Config, stored: impl Into<Reading>) -> Result<Self, OpenError> {
        let mut random = Random::new(config.seed);
        let boot = random.next();
        let (stored, log) = stored.into().finish(config.mutant)?;
        let mut batch = Batch::default();
        let identity = match stored.identity {
            Some(identity) if identity.robot == config.robot => identity,
            Some(identity) => return Err(OpenError::Robot { found: identity.robot, expected: config.robot }),
            None if stored.count == 0 => {
                let (origin, joining) = (Origin::new(random.next()), Origin::new(random.next()));
                let robot = config.robot.clone();
                let identity = Identity { origin, robot, joining: Some(joining), ..Identity::default() };
                batch.identity(&identity);
                identity
            }
            None => return Err(OpenError::Damaged { what: "there is no identity" }),
        };
        let local = stored.local.scan("").flat_map(|(_, versions)| versions).map(|version| version.stamp);
        let last = local.chain([log.last_stamp()]).max().unwrap_or_default();
        let last = if config.mutant.is(Mutant::ClockForgotten) { Stamp::default() } else { last };
        Ok(Self {
            clock: Clock::new(identity.origin, last),
            members: Members::of(&stored.state),
            owners: Owners::of(&stored.state),
            sync: sync::Sync::default(),
            waiting: commit::Waiting::default(),
            log,
            state: stored.state,
            local: stored.local,
            wall: Wall::default(),
            acks: Acks::default(),
            collected: Cut::default(),
            proven: 0,
            download: None,
            spare: BTreeMap::new(),
            offer: join::Offer::default(),
            held: hold::Held::new(stored.held),
            config,
            identity,
            boot,
            random,
            batch,
        })
    }

    /// Opens a replica on a store that may be a copy of one that goes on elsewhere, or older than what others have from it:
    /// it gives up its origin before it writes anything.
    ///
    /// # Errors
    /// As [`Replica::open`].
    pub fn open_copied(config: Config, stored: impl Into<Reading>) -> Result<Self, OpenError> {
        let mut replica = Self::open(config, stored)?;
        // The alarm is for who did not know; the caller does.
        replica.rejoin(Time::ZERO, true, &mut Vec::new());
        Ok(replica)
    }

    /// Takes one input.
    pub fn handle(&mut self, now: Time, input: Input, effects: &mut Vec<Effect>) {
        use Input::{Appeared, Commit, Found, HealClock, Received, Retire, Tick};
        let mut after = Vec::new();
        let (Tick(w) | Appeared(w) | Found(w) | HealClock(w) | Commit(_, w) | Retire(_, w) | Received(_, _, w)) =
            &input;
        self.wall = *w;
        match input {
            Tick(_) => self.tick(now, &mut after),
            Commit(requests, _) => self.commit_all(now, requests, &mut after),
            Received(from, message, _) => self.receive(now, (from, message), &mut after),
            Appeared(_) => {
                self.sync.met(now);
                self.tick(now, &mut after);
            }
            Found(_) => self.found(now, &mut after),
            Retire(origin, _) => self.retire(now, origin, &mut after),
            HealClock(_) => self.heal_clock(now, &mut after),
        }
        self.persist(after, effects);
    }

    /// Returns when it wants to be told the time.
    pub fn deadline(&self) -> Option<Time> {
        [Some(self.sync.deadline(self.pulls_max())), self.waiting.deadline(), self.download_deadline()]
            .into_iter()
            .flatten()
            .min()
    }

    /// Returns what can be read.
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Returns what is at `local/…`, which no other robot sees: neither log, watchers nor history have it.
    pub fn local(&self) -> &State {
        &self.local
    }

    /// Returns the transactions that are still here.
    pub fn log(&self) -> &Log {
        &self.log
    }

    /// Returns the team.
    pub fn members(&self) -> &Members {
        &self.members
    }

    /// Returns who owns which prefixes.
    pub fn owners(&self) -> &Owners {
        &self.owners
    }

    /// Returns under which origin it writes.
    pub fn origin(&self) -> Origin {
        self.identity.origin
    }

    /// Returns the name under which others know it: its origin, or the one it wants to be admitted as. Any input may change
    /// it, so it is never to be kept.
    pub fn address(&self) -> Origin {
        self.identity.joining.unwrap_or(self.identity.origin)
    }

    /// Returns whether it belongs to the team, as far as it knows.
    pub fn is_member(&self) -> bool {
        self.identity.joining.is_none() && self.members.is_active(self.identity.origin)
    }

    /// Returns what a member has said to have.
    pub fn said(&self, origin: Origin) -> Option<&Cut> {
        self.acks.said(origin)
    }

    /// Returns what everybody has, as far as it knows, and who has less.
    pub fn stable(&self) -> Stable {
        self.acks.stable(self.identity.origin, self.log.cut(), &self.members, self.config.mutant)
    }

    /// Puts what is to be written before what was decided because of it.
    fn persist(&mut self, after: Vec<Effect>, effects: &mut Vec<Effect>) {
        if self.batch.is_empty() {
            effects.extend(after);
            return;
        }
        self.batch.digests(&self.log, &self.state);
        let persist = Effect::Persist(std::mem::take(&mut self.batch));
        if self.config.mutant.is(Mutant::AckBeforeDisk) {
            effects.extend(after);
            effects.push(persist);
        } else {
            effects.push(persist);
            effects.extend(after);
        }
    }

    /// Applies a transaction that may be next; the one place where log and state change.
    fn apply(&mut self, now: Time, frame: Frame, effects: &mut Vec<Effect>) -> Result<Verdict, FrameError> {
        let txn = frame.open()?;
        let verdict = self.log.judge(&txn, &frame);
        if verdict != Verdict::Next {
            return Ok(verdict);
        }
        if txn.writes.iter().filter_map(|write| member::retired_by(&write.key)).any(|origin| self.held.has(origin)) {
            return Ok(Verdict::Early);
        }
        if txn.stamp.origin != self.identity.origin {
            if let Some(ahead_by) = Clock::suspects(txn.stamp, self.wall) {
                effects.push(Effect::Alarm(Alarm::ClockSuspect { origin: txn.stamp.origin, ahead_by }));
            }
            if !self.config.mutant.is(Mutant::StampsUnseen) {
                let epoch = if self.config.mutant.is(Mutant::EpochUnseen) { 0 } else { txn.stamp.epoch };
                self.clock.observe(now, Stamp { epoch, ..txn.stamp }, txn.wall);
            }
        }
        let own = txn.context.get(self.identity.origin);
        if own > self.proven && frame.seen().is_some_and(|said| self.log.seen(&txn.context) == Some(said)) {
            self.proven = own;
        }
        self.enter(&txn, &frame);
        if self.config.mutant.is(Mutant::ShownTwice) {
            effects.push(Effect::Visible(txn.dot(), frame.clone()));
        }
        effects.push(Effect::Visible(txn.dot(), frame));
        Ok(verdict)
    }

    /// Enters a transaction into state, log and batch.
    fn enter(&mut self, txn: &Txn, frame: &Frame) {
        let (dot, context) = (txn.dot(), self.log.context(txn));
        let only = txn.rebase.as_ref().map(|rebase| rebase.takes.as_slice());
        // What is brought in stands beside what is brought in with it.
        let seen = if only.is_some() { context.without(dot.origin) } else { context };
        self.state.apply(dot, txn.written(), Seen { context: &seen, only }, &txn.writes);
        let index = self.log.append(txn, frame.clone());
        self.batch.frame(dot, index, frame);
        if let Some(head) = self.log.head(dot.origin).filter(|_| !self.config.mutant.is(Mutant::HeadNotStored)) {
            self.batch.head(dot.origin, head);
        }
        for write in txn.writes.iter().filter(|_| !self.config.mutant.is(Mutant::VersionsNotStored)) {
            self.batch.versions((SHARED, &write.key), self.state.versions(&write.key));
        }
        if txn.writes.iter().any(|write| is_system(&write.key)) {
            (self.members, self.owners) = (Members::of(&self.state), Owners::of(&self.state));
        }
    }

    /// Drops what nobody needs any more.
    fn collect(&mut self) {
        self.acks.settle(self.log.cut(), self.config.mutant);
        if !self.is_member() {
            return;
        }
        let stable = self.stable().cut;
        if stable != self.collected {
            for key in self.state.drop_deleted(&stable) {
                self.batch.versions((SHARED, &key), &[]);
            }
            self.collected = stable;
        }
        let mut stable = self.collected.clone();
        // By the own numbers others may mean what they know from before a set-back; that shows as long as the frames are here.
        let (me, proven) = (self.identity.origin, self.proven.max(self.identity.told));
        if stable.get(me) > proven && self.members.active().nth(1).is_some() {
            stable = stable.without(me);
            stable.include(Dot { origin: me, seq: proven });
        }
        let own = self.config.mutant.is(Mutant::LogCutAtOwn).then(|| self.log.cut().clone());
        for dot in self.log.truncate(own.as_ref().unwrap_or(&stable), self.config.log_size) {
            self.batch.no_frame(dot);
        }
    }
}

fn is_system(key: &Key) -> bool {
    key.as_str().starts_with("sys/")
}

#[cfg(test)]
mod tests;
