//! Writing: conditions, a place in history, and how far it has got.

use super::{Alarm, Answer, Effect, Level, Replica, Request};
use crate::logic::clock::Stamp;
use crate::logic::cut::{Cut, Dot, Origin};
use crate::logic::key::{Key, Namespace};
use crate::logic::log::Head;
use crate::logic::member;
use crate::logic::message::{Message, PUSH_SIZE_MAX};
use crate::logic::mutant::Mutant;
use crate::logic::news::News;
use crate::logic::owner::{self, Owner};
use crate::logic::record::LOCAL;
use crate::logic::state::Seen;
use crate::logic::txn::{Condition, Draft, Frame, Grant, Rebase, Require, Txn, TxnError, Write};
use comms::logic::time::Time;
use std::collections::{BTreeMap, BTreeSet};

/// The most tickets that wait; whoever comes later hears at once that it is pending.
const WAITING_MAX: usize = 1024;
/// How often the name of a transaction may have changed.
const LIVES_MAX: u32 = 32;

/// Who waits for a transaction to get further.
#[derive(Debug, Default)]
pub(super) struct Waiting(BTreeMap<u64, (Dot, Level, Time)>);

impl Waiting {
    pub(super) fn deadline(&self) -> Option<Time> {
        self.0.values().map(|(_, _, until)| *until).min()
    }
}

/// What a transaction does, without its place in history.
#[derive(Debug, Default)]
pub(super) struct Change {
    pub(super) reason: String,
    pub(super) requires: Vec<Require>,
    pub(super) writes: Vec<Write>,
    pub(super) wants_ack: bool,
    pub(super) rebase: Option<Rebase>,
}

impl Replica {
    /// Returns whether a transaction has got this far, as far as is known here. A ticket that is pending can be asked
    /// for in this way after a restart too.
    pub fn has_reached(&self, dot: Dot, level: &Level) -> bool {
        let (me, dot) = (self.identity.origin, self.name_of(dot));
        let here = self.log.cut().contains(dot);
        let has = |origin: Origin| origin == me || self.acks.said(origin).is_some_and(|cut| cut.contains(dot));
        let others = || self.members.active().filter(|(origin, _)| *origin != me);
        let robots = || others().filter(|(origin, _)| has(*origin)).map(|(_, robot)| robot).collect::<BTreeSet<_>>();
        here && match level {
            Level::Local => true,
            Level::Replicated(count) => {
                let own = usize::from(self.config.mutant.is(Mutant::SelfCounted));
                robots().iter().filter(|robot| **robot != self.identity.robot).count() + own >= *count
            }
            Level::On(names) => {
                let reached = robots();
                names.iter().all(|name| *name == self.identity.robot || reached.contains(name.as_str()))
            }
            Level::Everywhere => self.is_member() && others().all(|(origin, _)| has(origin)),
        }
    }

    /// Returns under which name a transaction has to be asked for. If its origin was given up, that is the transaction with
    /// which everything that is left of it has arrived.
    pub fn name_of(&self, mut dot: Dot) -> Dot {
        for _ in 0..LIVES_MAX {
            let brought = self.members.brought(dot.origin).filter(|brought| dot.seq <= brought.last.seq);
            let Some(brought) = brought.filter(|_| !self.log.cut().contains(dot)) else { break };
            dot = brought.by;
        }
        dot
    }

    /// Commits what callers want.
    pub(super) fn commit_all(&mut self, now: Time, requests: Vec<Request>, effects: &mut Vec<Effect>) {
        let (before, mut frames) = (self.own_head(), Vec::new());
        for Request { ticket, draft, level, until } in requests {
            if draft.is_local() {
                let answer = self.commit_local(now, (&draft, &level)).map_or_else(Answer::Refused, Answer::Committed);
                effects.push(Effect::Answer(ticket, answer));
                continue;
            }
            let wants_ack = level != Level::Local;
            let frame = self.plan(draft).and_then(|change| self.commit(now, Change { wants_ack, ..change }));
            let (dot, frame) = match frame {
                Ok(committed) => committed,
                Err(error) => {
                    effects.push(Effect::Answer(ticket, Answer::Refused(error)));
                    continue;
                }
            };
            effects.push(Effect::Visible(dot, frame.clone()));
            effects.push(Effect::Answer(ticket, Answer::Committed(dot)));
            frames.push(frame);
            if !wants_ack {
                continue;
            }
            if self.has_reached(dot, &level) {
                effects.push(Effect::Answer(ticket, Answer::Reached(dot)));
            } else if self.waiting.0.len() >= WAITING_MAX || until <= now {
                effects.push(Effect::Answer(ticket, Answer::Pending(dot)));
            } else {
                self.waiting.0.insert(ticket, (dot, level, until));
            }
        }
        self.push(now, (before, frames), effects);
    }

    /// Writes what never leaves the robot. Its dot has no origin.
    fn commit_local(&mut self, now: Time, (draft, level): (&Draft, &Level)) -> Result<Dot, TxnError> {
        draft.check()?;
        if let Some((key, _)) = draft.writes().next().filter(|_| *level != Level::Local) {
            return Err(TxnError::Stays { key: key.clone() });
        }
        draft.requires().iter().try_for_each(|require| self.check(require))?;
        let stamp = self.clock.tick(now, self.wall).ok_or(TxnError::Clock)?;
        let dot = Dot { origin: Origin::default(), seq: stamp.hlc };
        let all: Cut = [(dot.origin, u64::MAX)].into_iter().collect();
        for (key, value) in draft.writes() {
            let write = Write { key: key.clone(), value: value.cloned() };
            self.local.apply(dot, stamp, Seen { context: &all, only: None }, &[write]);
            self.local.drop_deleted(&all);
            self.batch.versions((LOCAL, key), self.local.versions(key));
        }
        Ok(dot)
    }

    /// Makes this the first member of a team, alone or with what is left of one that had no members but itself.
    pub(super) fn found(&mut self, now: Time, effects: &mut Vec<Effect>) {
        let given_up = |origin: &Origin| self.identity.past.iter().any(|past| past.origin == *origin);
        let before: Vec<Origin> = self.members.active().map(|(origin, _)| origin).collect();
        if self.identity.joining.is_none() || !before.iter().all(given_up) {
            return;
        }
        let admission = member::admission(self.identity.origin, &self.identity.robot);
        let retired = before.into_iter().filter_map(member::retirement);
        let writes = admission.into_iter().chain(retired).collect();
        let change = Change { reason: "found the team".into(), writes, ..Change::default() };
        self.system(now, change, effects);
        (self.identity.joining, self.identity.asked) = (None, None);
        self.identity.past.clear();
        self.batch.identity(&self.identity);
    }

    /// Retires an origin.
    pub(super) fn retire(&mut self, now: Time, origin: Origin, effects: &mut Vec<Effect>) {
        let may = self.is_member() && origin != self.identity.origin && !self.held.has(origin);
        if !may || !self.members.is_active(origin) {
            return;
        }
        let writes = member::retirement(origin).into_iter().collect();
        self.system(now, Change { reason: "retire".into(), writes, ..Change::default() }, effects);
    }

    /// Begins a new epoch: whoever sees a transaction of it goes on in it, and after a restart too.
    pub(super) fn heal_clock(&mut self, now: Time, effects: &mut Vec<Effect>) {
        if self.clock.heal() {
            self.system(now, Change { reason: "heal the clocks".into(), ..Change::default() }, effects);
        } else {
            effects.push(Effect::Alarm(Alarm::Malformed(self.identity.origin)));
        }
    }

    /// Commits what the database itself writes.
    pub(super) fn system(&mut self, now: Time, change: Change, effects: &mut Vec<Effect>) {
        let before = self.own_head();
        match self.commit(now, change) {
            Ok((dot, frame)) => {
                effects.push(Effect::Visible(dot, frame.clone()));
                self.push(now, (before, vec![frame]), effects);
            }
            Err(_exhausted) => effects.push(Effect::Alarm(Alarm::Malformed(self.identity.origin))),
        }
    }

    /// Tells callers what others have by now, and whose time is over.
    pub(super) fn settle_tickets(&mut self, now: Time, effects: &mut Vec<Effect>) {
        let mut waiting = std::mem::take(&mut self.waiting.0);
        waiting.retain(|ticket, (dot, level, until)| {
            let answer = if self.has_reached(*dot, level) {
                Answer::Reached(*dot)
            } else if *until <= now && !self.config.mutant.is(Mutant::TicketForgotten) {
                Answer::Pending(*dot)
            } else {
                return true;
            };
            effects.push(Effect::Answer(*ticket, answer));
            false
        });
        self.waiting.0 = waiting;
    }

    /// Gives waiting tickets the new names of their transactions.
    pub(super) fn rename_tickets(&mut self, names: &BTreeMap<Dot, Dot>) {
        for (dot, ..) in self.waiting.0.values_mut() {
            *dot = names.get(dot).copied().unwrap_or(*dot);
        }
    }

    /// Returns what a draft comes to, if it may be committed.
    fn plan(&self, draft: Draft) -> Result<Change, TxnError> {
        draft.check()?;
        let conditions = draft.requires().iter().filter(|_| !self.config.mutant.is(Mutant::ConditionsIgnored));
        conditions.into_iter().try_for_each(|require| self.check(require))?;
        let fences = draft.writes().filter_map(|(key, _)| self.check_owner(key).transpose());
        let fences: BTreeMap<Key, Dot> = fences.collect::<Result<_, _>>()?;
        let mut granted = Vec::new();
        for (prefix, grant) in draft.grants() {
            let record = owner::record(prefix).map_err(|_long| TxnError::Reserved { key: prefix.clone() })?;
            let robot = match grant {
                Grant::Give(robot) => self.check_owner(prefix).map(|_fence| robot.as_deref())?,
                Grant::TakeOver(robot) => Some(robot.as_str()),
            };
            let term = self.owners.find(prefix).map_or(0, |(_, owner)| owner.term);
            granted.push(Write { key: record, value: Some(owner::grant(term.saturating_add(1), robot)) });
        }
        let (reason, mut requires, mut writes) = draft.into_parts();
        // What is nobody else's business is checked, and not told.
        requires.retain(|require| require.key.namespace() != Namespace::Local);
        requires.extend(fences.into_iter().map(|(key, dot)| Require { key, condition: Condition::Is(dot) }));
        writes.extend(granted);
        writes.sort_by(|a, b| a.key.cmp(&b.key));
        Ok(Change { reason, requires, writes, ..Change::default() })
    }

    fn check(&self, require: &Require) -> Result<(), TxnError> {
        let state = if require.key.namespace() == Namespace::Local { &self.local } else { &self.state };
        state.check(require)
    }

    /// Returns the grant on which writing a key here relies, if any, with the key of its record.
    fn check_owner(&self, key: &Key) -> Result<Option<(Key, Dot)>, TxnError> {
        if matches!(key.namespace(), Namespace::System | Namespace::Local) {
            return Err(TxnError::Reserved { key: key.clone() });
        }
        let Some((prefix, Owner { term, robot, grant })) = self.owners.find(key) else { return Ok(None) };
        let other = robot.filter(|robot| *robot != self.identity.robot);
        if let Some(owner) = other.filter(|_| !self.config.mutant.is(Mutant::OwnersIgnored)) {
            return Err(TxnError::NotOwner { key: key.clone(), owner, term });
        }
        let record = Key::new(prefix).and_then(|prefix| owner::record(&prefix));
        Ok(record.ok().zip(grant))
    }

    /// Gives a change its place in history, and applies it.
    pub(super) fn commit(&mut self, now: Time, change: Change) -> Result<(Dot, Frame), TxnError> {
        let origin = self.identity.origin;
        let mut clock = self.clock.clone();
        let mut stamp = clock.tick(now, self.wall).ok_or(TxnError::Clock)?;
        let head = self.own_head();
        let seq = head.seq.checked_add(1).ok_or(TxnError::Clock)?;
        if self.config.mutant.is(Mutant::WallClock) {
            stamp = Stamp { epoch: 0, hlc: (self.wall.millis << 16).max(head.stamp.hlc + 1), origin };
        }
        // What one's own transactions have seen is in one's own number.
        let mut context: Cut = self.log.cut().beyond(&head.context);
        context = context.without(origin);
        let txn = Txn {
            stamp,
            seq,
            prev: head.link,
            wall: self.wall,
            context,
            reason: change.reason,
            requires: change.requires,
            writes: change.writes,
            wants_ack: change.wants_ack,
            rebase: change.rebase,
        };
        // All of it is what others wrote last, so it is known.
        let seen = self.log.seen(&txn.context).filter(|_| !txn.context.is_empty());
        let frame = seen.map_or_else(|| Frame::seal(&txn), |seen| Frame::seal_on(&txn, seen))?;
        self.clock = clock;
        self.enter(&txn, &frame);
        Ok((txn.dot(), frame))
    }

    fn own_head(&self) -> Head {
        self.log.head(self.identity.origin).cloned().unwrap_or_default()
    }

    /// Tells others of new transactions and the head before them, unless they are long: those are pulled.
    fn push(&mut self, now: Time, (before, frames): (Head, Vec<Frame>), effects: &mut Vec<Effect>) {
        if frames.is_empty() || !self.is_member() {
            return;
        }
        self.sync.changed(now);
        let size: usize = frames.iter().map(Frame::size).sum();
        if size <= PUSH_SIZE_MAX {
            if self.config.mutant.is(Mutant::PushedIsHad) {
                self.members.active().for_each(|(origin, _)| self.acks.note(origin, self.log.cut()));
            }
            let news = News::of(before, &frames);
            effects.push(Effect::Broadcast(news.map_or(Message::Push(frames), Message::News)));
        }
    }
}
