//! One replica as a state machine: its inputs, and the effects of each input.
//!
//! [`Replica::handle`] takes an [`Input`] and returns its effects, in order. The driver makes each [`Effect::Persist`] durable
//! before it executes any later effect (T4: everything acknowledged or sent is on the disk, and a replica cannot forget
//! transactions that others have received from it). If a write fails, the driver drops the later effects and the replica, and
//! reopens the store: a repeated sync may succeed without having written anything.
//!
//! After each input the driver also reads [`Replica::address`]. The address changes when a replica starts again, and while it
//! looks for a sponsor. The driver may pass on messages that still arrive at an old address, or drop them.
//!
//! A replica is a *member*, or it wants to become one. Until then it can be written to, but shows its transactions to no other
//! replica. Once admitted, it begins with its sponsor's state. It rebases its transactions under the admitted origin, with the
//! transactions that they had seen. The same applies in three other cases: a replica that was retired while away; a replica of
//! whose own transactions others know more than itself (a lost tail, a restored backup); and both of two clones.
//!
//! *Parts.* Each part owns its state and has its own transitions. `ledger` has the data and identity of the replica (`contents`:
//! log and state; `identity`; `commit`: how a draft becomes a transaction; `pending`: transactions that cannot be read yet).
//! `peers` chooses the peers to ask, and the time. `download` is a state in transit. `tickets` are the callers that wait for a
//! transaction. `hello`, `serve` and `branch` are the rules for messages of peers: they read the ledger and return actions.
//! `rebase` finds the transactions to bring along when the replica starts again. Only this file connects the parts.

mod action;
mod authors;
mod branch;
mod commit;
mod contents;
mod download;
mod hello;
mod identity;
mod interface;
mod ledger;
mod peers;
mod pending;
mod rebase;
mod serve;
mod tickets;

pub use interface::{AckLevel, Alarm, Answer, CommitRequest, Config, Effect, Input};

use crate::logic::gc::Stable;
use crate::logic::log::Log;
use crate::logic::member::Members;
use crate::logic::message::{Chunk, Message, Pull};
use crate::logic::owner::Owners;
use crate::logic::record::{OpenError, StoredRecords};
use crate::logic::state::State;
use crate::logic::txn::{EncodedTxn, FORMAT, FORMAT_FIRST};
use crate::logic::version_vector::{Dot, ReplicaId, VersionVector};
use action::Action;
use comms::logic::random::Random;
use comms::logic::time::Time;
use download::{Downloaded, Downloads, Offer};
use ledger::Ledger;
use peers::{Asking, PeerTable};
use tickets::{Tickets, Waiting};

/// How many pulls may be unanswered at a time.
const PULLS_MAX: usize = 2;
/// How many unusable states of one peer are accepted in a row.
const DROPPED_MAX: u32 = 2;

/// The machine.
#[derive(Debug)]
pub struct Replica {
    ledger: Ledger,
    peers: PeerTable,
    downloads: Downloads,
    offer: Offer,
    tickets: Tickets,
    random: Random,
}

impl Replica {
    /// Opens a replica with the content of its store: a [`StoredRecords`], or all its records.
    ///
    /// # Errors
    /// If the store is damaged, or belongs to another robot.
    pub fn open(config: Config, stored: impl Into<StoredRecords>) -> Result<Self, OpenError> {
        let mut random = Random::new(config.seed);
        Ok(Self {
            ledger: Ledger::open(&config, stored.into(), &mut random)?,
            peers: PeerTable::default(),
            downloads: Downloads::default(),
            offer: Offer::default(),
            tickets: Tickets::default(),
            random,
        })
    }

    /// Opens a replica whose store may be a copy of a store that is in use elsewhere, or may be
    /// older than transactions that other replicas have received from it. The replica gives up its
    /// origin before it writes anything.
    ///
    /// # Errors
    /// The errors of [`Replica::open`].
    pub fn open_copied(config: Config, stored: impl Into<StoredRecords>) -> Result<Self, OpenError> {
        let mut replica = Self::open(config, stored)?;
        // The caller requested this, so no alarm is raised.
        replica.rejoin(Time::ZERO, true, &mut Vec::new());
        Ok(replica)
    }

    /// Processes one input, and appends its effects.
    pub fn handle(&mut self, now: Time, input: Input, effects: &mut Vec<Effect>) {
        use Input::{Appeared, Commit, Found, HealClock, Join, Received, Retire, Tick};
        let mut after = Vec::new();
        let (Tick(w)
        | Appeared(w)
        | Found(w)
        | HealClock(w)
        | Commit(_, w)
        | Join(_, w)
        | Retire(_, w)
        | Received(_, _, w)) = &input;
        self.ledger.pipeline.set_wall(*w);
        match input {
            Tick(_) => self.tick(now, &mut after),
            Commit(requests, _) => self.commit_all(now, requests, &mut after),
            Received(from, message, _) => self.receive(now, from, message, &mut after),
            Appeared(_) => {
                self.peers.met(now);
                self.tick(now, &mut after);
            }
            Found(_) => {
                if let Some(change) = serve::founding(&self.ledger) {
                    self.ledger.commit_system(now, change, &mut after);
                    self.ledger.identity.founds();
                }
            }
            Join(peer, _) => self.act(now, peer, hello::join(&self.ledger, peer), &mut after),
            Retire(origin, _) => self.ledger.retire(now, origin, &mut after),
            HealClock(_) => self.ledger.heal_clock(now, &mut after),
        }
        if self.ledger.take_changed() {
            self.peers.changed(now);
        }
        self.ledger.persist(after, effects);
    }

    /// Returns the time at which the replica has to be called with an [`Input::Tick`]; it may be called earlier with any input.
    pub fn deadline(&self) -> Option<Time> {
        let peers = Some(self.peers.deadline(self.pulls_max()));
        [peers, self.tickets.deadline(), self.downloads.deadline()].into_iter().flatten().min()
    }

    /// Returns the readable state.
    pub fn state(&self) -> &State {
        self.ledger.contents().state()
    }

    /// Returns the keys at `local/…`, which no other robot sees. They are not in the log, the history or the notifications of
    /// watchers.
    pub fn local(&self) -> &State {
        self.ledger.pipeline.local()
    }

    /// Returns the transactions that are still kept.
    pub fn log(&self) -> &Log {
        self.ledger.log()
    }

    /// Returns the team.
    pub fn members(&self) -> &Members {
        self.ledger.contents().members()
    }

    /// Returns the owners of prefixes.
    pub fn owners(&self) -> &Owners {
        self.ledger.contents().owners()
    }

    /// Returns the origin under which the replica writes.
    pub fn origin(&self) -> ReplicaId {
        self.ledger.identity.origin()
    }

    /// Returns the id under which others reach the replica: its origin, or the origin that it wants to be admitted as. Any input
    /// may change it, so callers must not store it.
    pub fn address(&self) -> ReplicaId {
        self.ledger.identity.joining().unwrap_or(self.origin())
    }

    /// Returns whether the replica belongs to the team, as far as it knows.
    pub fn is_member(&self) -> bool {
        self.ledger.is_member()
    }

    /// Returns the version vector that a member has reported.
    pub fn acked(&self, origin: ReplicaId) -> Option<&VersionVector> {
        self.ledger.acks.acked(origin)
    }

    /// Returns the version vector that every member has, as far as this replica knows, and the members that have less.
    pub fn stable(&self) -> Stable {
        self.ledger.stable()
    }

    /// Returns whether a transaction has reached this level, as far as this replica knows. After a restart, a pending ticket can
    /// also be checked in this way.
    pub fn has_reached(&self, dot: Dot, level: &AckLevel) -> bool {
        tickets::has_reached(&self.ledger, dot, level)
    }

    /// Returns the present name of a transaction. If its origin was given up, this is the name of the transaction in which the
    /// last remaining part of it has arrived.
    pub fn name_of(&self, dot: Dot) -> Dot {
        self.ledger.contents().name_of(dot)
    }

    /// Returns the newest format that every member is known to read.
    pub fn team_format(&self) -> u8 {
        let formats = self.ledger.others().map(|(origin, _)| self.peers.format(origin).unwrap_or(FORMAT_FIRST));
        formats.chain([FORMAT]).min().unwrap_or(FORMAT)
    }

    fn tick(&mut self, now: Time, effects: &mut Vec<Effect>) {
        self.peers.expire(now);
        self.downloads.tick(now, effects);
        if self.ledger.identity.joining().is_none() && self.members().retired(self.origin()).is_some() {
            self.rejoin(now, false, effects);
        }
        if self.peers.hello_at() <= now {
            effects.push(Effect::Broadcast(Message::Hello(hello::of(&self.ledger))));
            self.peers.said_hello(now, &mut self.random);
            self.ledger.release(now, effects);
            self.ledger.retire_revoked(now, effects);
            self.ledger.gc();
            if self.is_member() {
                let members = self.ledger.contents().members();
                self.peers.retain(|origin| members.is_active(origin));
            }
        }
        self.go_on(now, effects);
    }

    /// Answers the callers whose transactions have reached their level, and pulls from peers that may have more, up to the limit
    /// of open pulls.
    fn go_on(&mut self, now: Time, effects: &mut Vec<Effect>) {
        self.tickets.settle(now, |dot, level| tickets::has_reached(&self.ledger, dot, level), effects);
        loop {
            let (pulls_max, sponsor) = (self.pulls_max(), self.ledger.identity.asked());
            let Some(peer) = self.peers.choose(now, pulls_max, sponsor, &mut self.random) else { return };
            self.ledger.identity.asks(peer, &mut self.random);
            let asked = self.peers.asked(now, peer);
            effects.push(self.pull(peer, asked, self.ledger.pending().vector()));
        }
    }

    /// Returns the pull, with its number and size, for transactions that are neither here nor in `pending`.
    fn pull(&self, peer: ReplicaId, asked: Asking, pending: VersionVector) -> Effect {
        let (number, size_max) = (asked.number, u32::try_from(asked.size).unwrap_or(u32::MAX));
        let vector = self.log().vector().clone();
        Effect::Send(peer, Message::Pull(Pull { number, vector, pending, size_max, join: self.ledger.join() }))
    }

    /// Asks a peer for the transactions after an answer that the peer has announced and that is in transit.
    fn ask_ahead(&mut self, now: Time, from: ReplicaId, number: u32, last: &VersionVector, effects: &mut Vec<Effect>) {
        if let Some(asked) = self.peers.announced(now, from, number) {
            let mut pending = self.ledger.pending().vector();
            pending.join(last);
            effects.push(self.pull(from, asked, pending));
        }
    }

    /// Returns how many pulls may be unanswered at a time.
    fn pulls_max(&self) -> usize {
        match (self.downloads.is_on(), self.is_member()) {
            (true, _) => 0,
            (false, false) => 1,
            (false, true) => PULLS_MAX,
        }
    }

    fn receive(&mut self, now: Time, from: ReplicaId, message: Message, effects: &mut Vec<Effect>) {
        let stranger = self.is_member() && !self.members().is_active(from);
        if let (true, Some(stamp)) = (stranger, self.members().retired(from)) {
            if let Message::Hello(_) | Message::Pull(_) = message {
                effects.push(Effect::Send(from, Message::Chunk(Chunk::Retired(stamp))));
            } else if let Message::Chunk(chunk @ Chunk::Retired(_)) = message {
                self.receive_chunk(now, from, chunk, effects);
            }
            return;
        }
        match message {
            Message::Hello(hello) => self.act(now, from, hello::react(&self.ledger, from, &hello), effects),
            Message::Pull(pull) => self.act(now, from, serve::pull(&self.ledger, from, &pull), effects),
            Message::Chunk(chunk) => self.receive_chunk(now, from, chunk, effects),
            Message::ChunkRequest(name) => {
                let bytes = self.offer.chunk(name);
                effects.push(Effect::Send(from, Message::SnapshotChunk { name, bytes }));
            }
            Message::SnapshotChunk { name, bytes } => {
                self.downloads.receive(now, from, name, bytes, effects);
                self.install(now, effects);
            }
            Message::Push(txns) if self.is_member() && !stranger => {
                if self.ledger.receive(now, from, txns, effects) {
                    self.peers.pushed_early(now, from);
                }
            }
            Message::DeltaPush(push) if self.is_member() && !stranger => {
                if self.ledger.receive_delta(now, from, &push, effects) {
                    self.peers.pushed_early(now, from);
                }
            }
            Message::Ack(vector) if self.members().is_active(from) => {
                self.ledger.acks.note(from, &vector);
            }
            Message::Coming { number, last } if self.is_member() && !stranger => {
                self.ask_ahead(now, from, number, &last, effects);
            }
            Message::Push(_) | Message::DeltaPush(_) | Message::Ack(_) | Message::Coming { .. } => {}
        }
        self.go_on(now, effects);
    }

    /// Executes the actions that the rules return for a message of a peer.
    fn act(&mut self, now: Time, from: ReplicaId, actions: Vec<Action>, effects: &mut Vec<Effect>) {
        for action in actions {
            match action {
                Action::Emit(effect) => effects.push(effect),
                Action::Ahead => self.peers.ahead(from, now),
                Action::Reads(format) => self.peers.reads(from, format),
                Action::Has(vector) => self.ledger.acks.note(from, &vector),
                Action::KnowsOwn => self.ledger.identity.set_known_by_peers(self.log().vector().get(self.origin())),
                Action::KnowForked(origin) => self.ledger.identity.knows_forked(origin),
                Action::Rejoin { twice } => self.rejoin(now, twice, effects),
                Action::Commit(change) => self.ledger.commit_system(now, change, effects),
                Action::Offer => {
                    let manifest = self.offer.take(self.ledger.contents());
                    effects.push(Effect::Send(from, Message::Chunk(Chunk::Snapshot(manifest))));
                }
            }
        }
    }

    fn receive_chunk(&mut self, now: Time, from: ReplicaId, chunk: Chunk, effects: &mut Vec<Effect>) {
        let (number, full) = match &chunk {
            Chunk::Txns { number, txns, more, .. } => {
                (Some(*number), more.then(|| txns.iter().map(EncodedTxn::size).sum()))
            }
            Chunk::Snapshot(_) | Chunk::Retired(_) | Chunk::Fork { .. } | Chunk::Known(_) | Chunk::Behind(_) => {
                (None, None)
            }
        };
        let answered = self.peers.answered(now, from, number, full);
        let (asked, known) = (answered.in_time, answered.in_time || self.members().is_active(from));
        let mut rules = Vec::new();
        match chunk {
            Chunk::Txns { vector, txns, more, .. } if self.is_member() && known => {
                let missing = self.ledger.receive(now, from, txns, effects);
                self.peers.served(from);
                if self.members().is_active(from) {
                    self.ledger.acks.note(from, &vector);
                }
                // If two answers were in transit, the first one may be lost.
                if (more || !self.ledger.have().dominates(&vector)) && (answered.follows || !missing) {
                    self.peers.ahead(from, now);
                }
            }
            Chunk::Snapshot(manifest) if known || self.ledger.identity.asked() == Some(from) => {
                if !(self.is_member() && self.log().vector().dominates(&manifest.vector())) {
                    self.downloads.begin(now, from, manifest, effects);
                    self.install(now, effects);
                }
            }
            Chunk::Txns { .. } | Chunk::Snapshot(_) => {}
            Chunk::Retired(_) if asked && self.ledger.identity.joining().is_some() => {
                if self.ledger.identity.wants_another(from, &mut self.random) {
                    self.peers.ahead(from, now);
                }
            }
            Chunk::Retired(stamp) => rules.extend(branch::retired(&self.ledger, from, stamp)),
            Chunk::Fork { seq, hash } => rules.extend(branch::fork(&self.ledger, seq, hash)),
            Chunk::Known(known) if self.is_member() && self.members().is_active(from) => {
                rules.extend(branch::known(&self.ledger, from, &known));
            }
            Chunk::Known(_) => {}
            Chunk::Behind(vector) => rules.push(branch::behind(&self.ledger, &vector)),
        }
        self.act(now, from, rules, effects);
    }

    /// Gives up the origin. `twice`: the origin may have used numbers twice.
    fn rejoin(&mut self, now: Time, twice: bool, effects: &mut Vec<Effect>) {
        self.ledger.begin_anew(twice, &mut self.random, effects);
        self.peers.reset(now);
        self.downloads.cancel();
    }

    /// Takes over a state as soon as it is complete.
    fn install(&mut self, now: Time, effects: &mut Vec<Effect>) {
        let Some(whole) = self.downloads.whole(effects) else { return };
        match self.ledger.identity.joining() {
            Some(joining) if !Members::of(&whole.state).is_active(joining) => return,
            // The replica was admitted with keys that it does not have any more.
            Some(joining) if !self.ledger.authors.is_own(joining, &whole.state) => {
                return self.rejoin(now, false, effects);
            }
            None if !self.is_of_use(now, &whole, effects) => return,
            _ => {}
        }
        let names = self.ledger.install(now, whole, effects);
        self.tickets.rename(&names);
        self.peers.reset(now);
    }

    /// Returns whether a member can continue with a state. If it cannot, it may have to start again.
    fn is_of_use(&mut self, now: Time, whole: &Downloaded, effects: &mut Vec<Effect>) -> bool {
        let from = whole.from;
        if !whole.manifest.vector().dominates(&self.log().low()) {
            // Some transactions that would have to be applied again to this state are no longer kept here.
            let dropped = self.peers.dropped(from);
            if dropped >= DROPPED_MAX && from < self.origin() {
                self.rejoin(now, false, effects);
            }
            return false;
        }
        let actions = branch::hidden(&self.ledger, from, &whole.manifest);
        let useful = actions.is_empty();
        self.act(now, from, actions, effects);
        useful
    }

    fn commit_all(&mut self, now: Time, requests: Vec<CommitRequest>, effects: &mut Vec<Effect>) {
        let (before, mut txns) = (self.ledger.own_head(), Vec::new());
        for CommitRequest { ticket, draft, level, until } in requests {
            if draft.is_local() {
                let answer = self.ledger.commit_local(now, &draft, &level);
                effects.push(Effect::Answer(ticket, answer.map_or_else(Answer::Refused, Answer::Committed)));
                continue;
            }
            let wants_ack = level != AckLevel::Local;
            let (dot, encoded) = match self.ledger.commit_draft(now, draft, wants_ack) {
                Ok(committed) => committed,
                Err(error) => {
                    effects.push(Effect::Answer(ticket, Answer::Refused(error)));
                    continue;
                }
            };
            effects.push(Effect::Visible(dot, encoded.clone()));
            effects.push(Effect::Answer(ticket, Answer::Committed(dot)));
            txns.push(encoded);
            if wants_ack && self.has_reached(dot, &level) {
                effects.push(Effect::Answer(ticket, Answer::Reached(dot)));
            } else if wants_ack && !self.tickets.wait(now, ticket, Waiting { dot, level, until }) {
                effects.push(Effect::Answer(ticket, Answer::Pending(dot)));
            }
        }
        self.ledger.push(before, txns, effects);
    }
}

#[cfg(test)]
mod tests;
