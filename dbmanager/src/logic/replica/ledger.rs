//! What a replica has and who it is: transactions are applied, committed, taken over and dropped here, all of it into one batch.
//!
//! *Rule.* [`Ledger::apply`] and [`Ledger::commit`] are the only ways into log and state. Frames are applied in the order in which
//! they come; what does not fit is buffered, or pulled again.

use super::commit::{Change, CommitPipeline};
use super::contents::Contents;
use super::download::Downloaded;
use super::identity::Identity;
use super::interface::{Alarm, Config, Effect, Level};
use super::pending::PendingTxns;
use super::rebase::{self, Rest};
use crate::logic::collect::{Acks, Stable};
use crate::logic::cut::{Cut, Dot, Origin};
use crate::logic::log::{Head, Log, Verdict};
use crate::logic::member;
use crate::logic::message::{Chunk, Message, PUSH_SIZE_MAX};
use crate::logic::news::News;
use crate::logic::random::Random;
use crate::logic::record::{Batch, OpenError, Reading};
use crate::logic::txn::{Draft, Frame, FrameError, TxnError};
use comms::logic::time::Time;
use std::collections::BTreeMap;

/// The parts that change together.
#[derive(Debug)]
pub(super) struct Ledger {
    contents: Contents,
    pub(super) identity: Identity,
    pub(super) pipeline: CommitPipeline,
    pending: PendingTxns,
    /// What others have.
    pub(super) acks: Acks,
    batch: Batch,
    log_size: usize,
    /// Whether others do not know yet of what is new here.
    news: bool,
}

impl Ledger {
    pub(super) fn open(config: &Config, stored: Reading, random: &mut Random) -> Result<Self, OpenError> {
        let (stored, log) = stored.finish()?;
        let identity = Identity::open(&config.robot, (stored.identity, stored.count == 0), random)?;
        Ok(Self {
            pipeline: CommitPipeline::new(identity.origin(), log.last_stamp(), stored.local),
            contents: Contents::new(log, stored.state),
            identity,
            pending: PendingTxns::new(stored.held),
            acks: Acks::default(),
            batch: Batch::default(),
            log_size: config.log_size,
            news: false,
        })
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
    pub(super) fn others(&self) -> impl Iterator<Item = (Origin, &str)> {
        self.contents.members().active().filter(|(origin, _)| *origin != self.identity.origin())
    }

    /// Returns what is here, applied or buffered.
    pub(super) fn have(&self) -> Cut {
        self.pending.with(self.contents.log())
    }

    pub(super) fn stable(&self) -> Stable {
        self.acks.stable(self.identity.origin(), self.log().cut(), self.contents.members())
    }

    /// Puts what is to be written before what was decided because of it.
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

    /// Applies a transaction that may be next.
    fn apply(&mut self, now: Time, frame: Frame, effects: &mut Vec<Effect>) -> Result<Verdict, FrameError> {
        let txn = frame.open()?;
        let verdict = self.log().judge(&txn, &frame);
        if verdict != Verdict::Next {
            return Ok(verdict);
        }
        let retired = txn.writes.iter().filter_map(|write| member::retired_by(&write.key));
        if retired.into_iter().any(|origin| self.pending.has(origin)) {
            return Ok(Verdict::Early);
        }
        let (me, origin) = (self.identity.origin(), txn.stamp.origin);
        if let Some(ahead_by) = (origin != me).then(|| self.pipeline.observe(now, &txn)).flatten() {
            effects.push(Effect::Alarm(Alarm::ClockSuspect { origin, ahead_by }));
        }
        let own = txn.context.get(me);
        if own > self.identity.proven() && frame.seen().is_some_and(|said| self.log().seen(&txn.context) == Some(said))
        {
            self.identity.proves(own);
        }
        self.contents.enter(&txn, &frame, &mut self.batch);
        effects.push(Effect::Visible(txn.dot(), frame));
        Ok(verdict)
    }

    /// Applies frames that a peer has sent; returns whether one could not be.
    pub(super) fn receive(
        &mut self,
        now: Time,
        (from, frames): (Origin, Vec<Frame>),
        effects: &mut Vec<Effect>,
    ) -> bool {
        let mut missing = false;
        let mut waiting: Vec<Origin> = Vec::new();
        for frame in frames {
            let txn = frame.open().ok();
            let origin = txn.as_ref().map_or(from, |txn| txn.stamp.origin);
            match self.apply(now, frame.clone(), effects) {
                Ok(Verdict::Next) if txn.as_ref().is_some_and(|txn| txn.wants_ack) && !waiting.contains(&origin) => {
                    waiting.push(origin);
                }
                Ok(Verdict::Next | Verdict::Known) => {}
                Ok(Verdict::Early) => missing |= !self.buffer(&frame),
                Ok(Verdict::Fork) => {
                    self.tell_fork(origin, effects);
                    if origin != from {
                        let known = self.contents.links_of([(origin, self.log().cut().get(origin))]);
                        effects.push(Effect::Send(from, known));
                    }
                    missing = true;
                }
                Ok(Verdict::Apart) => {
                    let seen = txn.map(|txn| txn.context).unwrap_or_default();
                    effects.push(Effect::Send(from, self.contents.links_of(seen.iter())));
                    missing = true;
                }
                Err(FrameError::Format { format }) => {
                    effects.push(Effect::Alarm(Alarm::NeedsUpgrade(format)));
                    missing |= !self.buffer(&frame);
                }
                Err(FrameError::Long { .. } | FrameError::Body { .. }) => {
                    effects.push(Effect::Alarm(Alarm::Malformed(from)));
                    missing = true;
                }
            }
        }
        self.news |= !self.batch.is_empty();
        let ack = |origin| Effect::Send(origin, Message::Ack(self.log().cut().clone()));
        effects.extend(waiting.into_iter().map(ack));
        missing
    }

    /// Applies what a peer has written after the head that is known here; returns whether something is missing.
    pub(super) fn receive_news(&mut self, now: Time, (from, news): (Origin, &News), effects: &mut Vec<Effect>) -> bool {
        let head = self.log().head(from).cloned().unwrap_or_default();
        if let Some(frames) = news.frames(from, head, |cut| self.log().seen(cut)) {
            return self.receive(now, (from, frames), effects);
        }
        let known = |seq| self.log().frame(Dot { origin: from, seq }).map(Frame::link);
        let forks = news.links().any(|(seq, link)| known(seq).is_some_and(|known| known != link));
        if forks {
            self.tell_fork(from, effects);
        }
        forks || news.links().any(|(seq, _)| seq > self.log().cut().get(from))
    }

    /// An origin has used a number twice.
    pub(super) fn tell_fork(&self, origin: Origin, effects: &mut Vec<Effect>) {
        effects.push(Effect::Alarm(Alarm::Fork(origin)));
        effects.push(Effect::Send(origin, self.contents.tip_of(origin)));
    }

    /// Buffers a frame that cannot be applied; returns whether that was possible, or it is buffered already.
    pub(super) fn buffer(&mut self, frame: &Frame) -> bool {
        self.pending.buffer(frame, self.contents.log(), &mut self.batch)
    }

    /// Applies what can be read by now, and forgets what has come in another way.
    pub(super) fn release(&mut self, now: Time, effects: &mut Vec<Effect>) {
        if !self.is_member() {
            return;
        }
        let mut left = BTreeMap::new();
        for (index, (dot, frame)) in self.pending.take() {
            let done = matches!(self.apply(now, frame.clone(), effects), Ok(Verdict::Next | Verdict::Known));
            if done || self.log().cut().contains(dot) {
                self.batch.held(index, None);
            } else {
                left.insert(index, (dot, frame));
            }
        }
        self.pending.keep(left);
    }

    /// Returns whether an origin may be retired: it is another's, none of its transactions is buffered, and it is not retired yet.
    pub(super) fn may_retire(&self, origin: Origin) -> bool {
        let retired = self.contents.members().retired(origin).is_some();
        origin != self.identity.origin() && !retired && !self.pending.has(origin)
    }

    /// Commits what a caller wants.
    pub(super) fn commit_draft(&mut self, now: Time, draft: Draft, wants_ack: bool) -> Result<(Dot, Frame), TxnError> {
        let change = self.pipeline.plan(draft, self.identity.robot(), &self.contents)?;
        self.commit(now, Change { wants_ack, ..change })
    }

    /// Gives a change its place in history, and applies it.
    fn commit(&mut self, now: Time, change: Change) -> Result<(Dot, Frame), TxnError> {
        let (txn, frame) = self.pipeline.seal(now, change, (self.identity.origin(), self.contents.log()))?;
        self.contents.enter(&txn, &frame, &mut self.batch);
        Ok((txn.dot(), frame))
    }

    /// Writes what never leaves the robot.
    pub(super) fn commit_local(&mut self, now: Time, what: (&Draft, &Level)) -> Result<Dot, TxnError> {
        self.pipeline.write_local(now, what, &self.contents, &mut self.batch)
    }

    /// Gives up the origin, which may have used numbers `twice`.
    pub(super) fn begin_anew(&mut self, twice: bool, random: &mut Random, effects: &mut Vec<Effect>) {
        let from = self.identity.begin_anew(twice, random);
        self.pipeline.move_to(self.identity.origin());
        effects.push(Effect::Alarm(Alarm::Rejoining { from }));
    }

    /// Commits a transaction once more, in several if it does not fit any more. Returns the name of the last.
    fn commit_again(&mut self, now: Time, rest: Rest, effects: &mut Vec<Effect>) -> Option<Dot> {
        let (mut waiting, mut name) = (vec![rest], None);
        while let Some(rest) = waiting.pop() {
            match self.commit(now, rest.change()) {
                Ok((dot, frame)) => {
                    effects.push(Effect::Visible(dot, frame));
                    name = Some(dot);
                }
                Err(TxnError::Frame(FrameError::Long { .. })) => waiting.extend(rest.shorter()),
                Err(_exhausted) => effects.push(Effect::Alarm(Alarm::Malformed(self.identity.origin()))),
            }
        }
        name
    }

    /// Commits what the database itself writes, and tells others.
    pub(super) fn commit_system(&mut self, now: Time, change: Change, effects: &mut Vec<Effect>) {
        let before = self.own_head();
        match self.commit(now, change) {
            Ok((dot, frame)) => {
                effects.push(Effect::Visible(dot, frame.clone()));
                self.push((before, vec![frame]), effects);
            }
            Err(_exhausted) => effects.push(Effect::Alarm(Alarm::Malformed(self.identity.origin()))),
        }
    }

    /// Returns the last of the own transactions.
    pub(super) fn own_head(&self) -> Head {
        self.log().head(self.identity.origin()).cloned().unwrap_or_default()
    }

    /// Tells others of new transactions and the head before them, unless they are long: those are pulled.
    pub(super) fn push(&mut self, (before, frames): (Head, Vec<Frame>), effects: &mut Vec<Effect>) {
        if frames.is_empty() || !self.is_member() {
            return;
        }
        self.news = true;
        let size: usize = frames.iter().map(Frame::size).sum();
        if size <= PUSH_SIZE_MAX {
            let news = News::of(before, &frames);
            effects.push(Effect::Broadcast(news.map_or(Message::Push(frames), Message::News)));
        }
    }

    /// Returns whether others do not know yet of what is new here; from now on they do.
    pub(super) fn take_news(&mut self) -> bool {
        std::mem::take(&mut self.news)
    }

    /// Takes over the state of a peer, and applies what is here and beyond it once more; who is admitted by that commits what else
    /// it had. Returns the new names of transactions.
    pub(super) fn install(&mut self, now: Time, whole: Downloaded, effects: &mut Vec<Effect>) -> BTreeMap<Dot, Dot> {
        let (from, cut, joining) = (whole.from, whole.manifest.cut(), self.identity.joining());
        let log = Log::new(whole.manifest.heads.into_iter().collect());
        let old = self.contents.replace(log, whole.state, &mut self.batch);
        self.pipeline.go_on_after(now, self.log().last_stamp());
        effects.push(Effect::Replaced);
        let joins = joining.is_some();
        for (dot, frame) in old.log().in_order() {
            if self.log().cut().contains(dot) || joins && !self.contents.members().is_active(dot.origin) {
                continue;
            }
            if !matches!(self.apply(now, frame.clone(), effects), Ok(Verdict::Next)) && !joins {
                effects.push(Effect::Alarm(Alarm::Fork(dot.origin)));
            }
        }
        let names = joining.map(|joining| self.rebase(now, (joining, &old), effects)).unwrap_or_default();
        self.acks.begin_anew();
        self.acks.note(from, &cut);
        names
    }

    /// Goes on as `joining`, with all of `old` that nobody else brings in; returns its new names.
    fn rebase(
        &mut self,
        now: Time,
        (joining, old): (Origin, &Contents),
        effects: &mut Vec<Effect>,
    ) -> BTreeMap<Dot, Dot> {
        let arrivals = rebase::arrivals(old, &self.contents, (joining, &self.identity));
        self.identity.admitted(joining);
        self.pipeline.move_to(joining);
        let mut names = BTreeMap::new();
        let Some(arrivals) = arrivals else { return names };
        // The first has the sponsor's cut as its context, so that none of the others is longer for that.
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

    /// Drops what nobody needs any more.
    pub(super) fn collect(&mut self) {
        self.acks.settle(self.contents.log().cut());
        if !self.is_member() {
            return;
        }
        let mut stable = self.stable().cut;
        if self.acks.drops(&stable) {
            self.contents.drop_deleted(&stable, &mut self.batch);
        }
        // By the own numbers others may mean what they know from before a set-back; that shows as long as the frames are here.
        let (me, proven) = (self.identity.origin(), self.identity.proven());
        if stable.get(me) > proven && self.contents.members().active().nth(1).is_some() {
            stable = stable.without(me);
            stable.include(Dot { origin: me, seq: proven });
        }
        self.contents.truncate(&stable, self.log_size, &mut self.batch);
    }

    /// Returns what to answer a member who has less than it has said to have. Others may have dropped deletions because of
    /// that, so it must not go on under its name.
    pub(super) fn behind(&self, from: Origin, cut: &Cut) -> Option<Message> {
        let said = self.acks.said(from).filter(|said| !cut.dominates(said));
        said.map(|said| Message::Chunk(Chunk::Behind(said.clone())))
    }
}
