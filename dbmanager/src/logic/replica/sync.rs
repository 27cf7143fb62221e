//! Talking to peers: hello, pull, chunk, push, ack.
//!
//! *State.* For each peer whether it may have more than is here, and when it may be asked; the pulls that wait for an answer.
//!
//! *Rule.* Whoever says hello with another cut is pulled from; whoever pulls says what it has, and is pulled from if that is
//! more. A pull without an answer in time (`pace`) is over, and the peer is left alone for a while that doubles. A push
//! that cannot be applied is dropped, and pulled instead. How much is asked for at a time follows the speed of the link, so
//! that neither an answer nor what is urgent is late on a slow one.

use super::take::is_set_back;
use super::{Alarm, Effect, Replica};
use crate::logic::cut::Origin;
use crate::logic::message::{CHUNK_SIZE_MAX, Chunk, Hello, Join, Message, Pull};
use crate::logic::mutant::Mutant;
use crate::logic::record::Past;
use crate::logic::txn::FORMAT;
use comms::logic::pace::Pace;
use comms::logic::time::Time;
use std::collections::BTreeMap;
use std::time::Duration;

/// How many pulls may wait for an answer.
const PULLS_MAX: usize = 2;
/// How long after a push that did not fit its sender is pulled from: the one before it may be on its way.
const PULL_AFTER_PUSH: Duration = Duration::from_millis(50);
/// How late an answer may be that shows how long the way is.
const LATE_MAX: Duration = Duration::from_secs(10);
/// How often a sponsor does not answer before another one is asked.
const SILENT_MAX: u32 = 3;
/// The shortest and the longest time between two hellos.
const HELLO_PERIOD: [Duration; 2] = [Duration::from_secs(1), Duration::from_secs(10)];
/// How many peers are known at most, members or not.
const PEERS_MAX: usize = 1024;

/// What is known of the conversation with others.
#[derive(Debug, Default)]
pub(super) struct Sync {
    peers: BTreeMap<Origin, Peer>,
    hello_at: Time,
    /// Between the last two hellos; at the beginning none.
    hello_period: Duration,
}

#[derive(Debug, Default)]
struct Peer {
    /// It may have more than is here.
    ahead: bool,
    /// It may be asked from then on.
    ask_at: Time,
    /// An answer is waited for until then.
    pulling: Option<Time>,
    /// When it was asked what it has not answered yet, in time or not.
    asked_at: Option<Time>,
    /// How much it is asked for.
    pace: Pace,
    /// How often it has not answered since it last did.
    silent: u32,
    /// How many states of it in a row were of no use.
    dropped: u32,
    /// The newest format it reads, once it has said so.
    format: Option<u8>,
}

impl Sync {
    pub(super) fn deadline(&self, pulls_max: usize) -> Time {
        let pulling = self.peers.values().filter(|peer| peer.pulling.is_some()).count();
        let due = |peer: &Peer| match peer.pulling {
            Some(until) => Some(until),
            None if peer.ahead && pulling < pulls_max => Some(peer.ask_at),
            None => None,
        };
        self.peers.values().filter_map(due).chain([self.hello_at]).min().unwrap_or(self.hello_at)
    }

    /// Something is new here: others hear of it soon.
    pub(super) fn changed(&mut self, now: Time) {
        self.hello_period = HELLO_PERIOD[0];
        self.hello_at = self.hello_at.min(now + HELLO_PERIOD[0]);
    }

    /// Somebody has come: it hears of the state here at once, and whoever did not answer may be asked again. A question
    /// that was lost with the link is not waited for; one that was not is asked twice, which harms nobody.
    pub(super) fn met(&mut self, now: Time) {
        (self.hello_at, self.hello_period) = (now, HELLO_PERIOD[0]);
        for peer in self.peers.values_mut() {
            peer.ahead |= peer.pulling.take().is_some();
            (peer.ask_at, peer.silent) = (peer.ask_at.min(now), 0);
        }
    }

    /// Forgets all conversations.
    pub(super) fn reset(&mut self, now: Time) {
        *self = Self { hello_at: now, ..Self::default() };
    }

    fn peer(&mut self, origin: Origin) -> Option<&mut Peer> {
        if self.peers.len() >= PEERS_MAX && !self.peers.contains_key(&origin) {
            return None;
        }
        Some(self.peers.entry(origin).or_default())
    }

    /// Returns the newest format that a peer reads, if it has said so.
    pub(super) fn format(&self, origin: Origin) -> Option<u8> {
        self.peers.get(&origin)?.format
    }

    /// A state of a peer was of no use; returns how many were in a row.
    pub(super) fn dropped(&mut self, origin: Origin) -> u32 {
        let Some(peer) = self.peers.get_mut(&origin) else { return 0 };
        peer.dropped = peer.dropped.saturating_add(1);
        peer.dropped
    }

    fn ahead(&mut self, origin: Origin, ask_at: Time) {
        if let Some(peer) = self.peer(origin) {
            peer.ask_at = if peer.ahead { peer.ask_at.min(ask_at) } else { peer.ask_at.max(ask_at) };
            peer.ahead = true;
        }
    }

    /// Notes an answer; returns whether one was waited for. One that was `full` shows how fast the link is.
    fn answered(&mut self, now: Time, origin: Origin, full: bool) -> bool {
        let Some(peer) = self.peers.get_mut(&origin) else { return false };
        (peer.ahead, peer.silent) = (false, 0);
        let asked = peer.pulling.take().is_some();
        // One that comes late shows how long the way is, too.
        match peer.asked_at.take().map(|at| now.since(at)) {
            Some(took) if full => peer.pace.arrived(took),
            Some(took) => peer.pace.heard(took),
            None => {}
        }
        asked
    }
}

impl Replica {
    /// Does what is due.
    pub(super) fn tick(&mut self, now: Time, effects: &mut Vec<Effect>) {
        for peer in self.sync.peers.values_mut() {
            let over = peer.pulling.is_some_and(|until| until <= now);
            if over && !self.config.mutant.is(Mutant::PullForEver) {
                peer.pulling = None;
                peer.silent = (peer.silent + 1).min(4);
                peer.pace.lost();
                peer.ask_at = now + PULL_AFTER_PUSH * (1 << (2 * peer.silent));
            }
        }
        self.tick_download(now, effects);
        if self.identity.joining.is_none() && self.members.retired(self.identity.origin).is_some() {
            self.rejoin(now, false, effects);
        }
        if self.sync.hello_at <= now {
            effects.push(Effect::Broadcast(Message::Hello(self.hello())));
            let period = self.sync.hello_period.max(HELLO_PERIOD[0]);
            let jitter = self.random.below(u64::try_from(period.as_nanos() / 5).unwrap_or(1));
            self.sync.hello_at = now + period * 9 / 10 + Duration::from_nanos(jitter);
            self.sync.hello_period = (period * 2).min(HELLO_PERIOD[1]);
            self.release(now, effects);
            self.collect();
            if self.is_member() {
                let is_wanted = |peer: &Peer| peer.ahead || peer.pulling.is_some();
                self.sync.peers.retain(|origin, peer| self.members.is_active(*origin) || is_wanted(peer));
            }
        }
        self.settle_tickets(now, effects);
        self.pull(now, effects);
    }

    /// Takes a message.
    pub(super) fn receive(&mut self, now: Time, (from, message): (Origin, Message), effects: &mut Vec<Effect>) {
        let stranger = self.is_member() && !self.members.is_active(from);
        if stranger && self.members.retired(from).is_some() && !self.config.mutant.is(Mutant::RetiredServed) {
            return self.answer_retired(now, (from, &message), effects);
        }
        match message {
            Message::Hello(hello) => self.take_hello(now, (from, &hello), effects),
            Message::Pull(pull) => self.take_pull(now, (from, &pull), effects),
            Message::Chunk(chunk) => self.take_chunk(now, (from, chunk), effects),
            Message::Snap(name) => {
                let bytes = self.offer.chunk(name);
                effects.push(Effect::Send(from, Message::SnapChunk { name, bytes }));
            }
            Message::SnapChunk { name, bytes } => self.take_snap_chunk(now, (from, name, bytes), effects),
            Message::Push(frames) if self.is_member() && !stranger => {
                if self.take_frames(now, (from, frames), effects) {
                    self.sync.ahead(from, now + PULL_AFTER_PUSH);
                }
            }
            Message::News(news) if self.is_member() && !stranger => {
                if self.take_news(now, (from, &news), effects) {
                    self.sync.ahead(from, now + PULL_AFTER_PUSH);
                }
            }
            Message::Ack(cut) if self.members.is_active(from) => {
                self.acks.note(from, &cut);
            }
            Message::Push(_) | Message::News(_) | Message::Ack(_) => {}
        }
        self.settle_tickets(now, effects);
        self.pull(now, effects);
    }

    pub(super) fn hello(&self) -> Hello {
        Hello {
            robot: self.identity.robot.clone(),
            boot: self.boot,
            format: FORMAT,
            member: self.is_member(),
            sponsors: self.members.sponsors(self.identity.origin),
            cut: self.log.cut().digest(),
            chains: self.log.chains(),
            held: self.held.cut().digest(),
            state: self.state.digest(),
            head: self.log.tip(self.identity.origin),
            wall: self.wall,
        }
    }

    fn take_hello(&mut self, now: Time, (from, hello): (Origin, &Hello), effects: &mut Vec<Effect>) {
        if from == self.identity.origin {
            // Two boots of one origin: somebody has copied the disk.
            if hello.boot != self.boot {
                self.rejoin(now, true, effects);
            }
            return;
        }
        if !self.is_member() {
            if hello.member {
                self.sync.ahead(from, now);
            }
            return;
        }
        if !hello.member {
            return;
        }
        if !self.members.is_active(from) {
            let known = |origin: &&Origin| self.members.is_active(**origin) || self.members.retired(**origin).is_some();
            let Some(sponsor) = hello.sponsors.iter().find(known) else { return };
            if let Some(stamp) = self.members.retired(*sponsor) {
                effects.push(Effect::Send(from, Message::Chunk(Chunk::Retired(stamp))));
            } else {
                // A member has admitted it, from whom we have not heard of late: it can tell us itself.
                self.sync.ahead(from, now);
            }
            return;
        }
        if let Some(peer) = self.sync.peer(from) {
            peer.format = Some(hello.format);
        }
        let (seq, link) = self.log.tip(from);
        if is_set_back(hello.head, (seq, link)) {
            // An old hello may have been overtaken by what it announces: who gets this knows better.
            effects.push(Effect::Send(from, Message::Chunk(Chunk::Fork { seq, link })));
        } else if hello.cut == self.log.cut().digest() {
            let cut = self.log.cut().clone();
            effects.extend(self.behind(from, &cut));
            self.acks.note(from, &cut);
            if hello.held != self.held.cut().digest() {
                self.sync.ahead(from, now);
            }
            if hello.chains == self.log.chains() && hello.state == self.state.digest() {
                self.learn_told();
            } else {
                effects.push(Effect::Alarm(Alarm::Diverged(from)));
                if hello.chains != self.log.chains() {
                    self.tell_known(from, self.log.cut().iter(), effects);
                }
            }
        } else if !self.config.mutant.is(Mutant::PushOnly) {
            self.sync.ahead(from, now);
        }
    }

    fn take_pull(&mut self, now: Time, (from, pull): (Origin, &Pull), effects: &mut Vec<Effect>) {
        if !self.is_member() {
            return;
        }
        if let Some(join) = &pull.join {
            return self.sponsor(now, (from, join), effects);
        }
        if pull.cut.get(from) < self.log.cut().get(from) {
            let (seq, link) = self.log.tip(from);
            effects.push(Effect::Send(from, Message::Chunk(Chunk::Fork { seq, link })));
            return;
        }
        if let Some(behind) = self.behind(from, &pull.cut) {
            effects.push(behind);
            return;
        }
        // Of two that were admitted by others that are gone neither knows the other: it is answered, but does not count.
        if self.members.is_active(from) {
            self.acks.note(from, &pull.cut);
        }
        if !self.have().dominates(&pull.cut) && !self.config.mutant.is(Mutant::PushOnly) {
            self.sync.ahead(from, now);
        }
        let size_max = usize::try_from(pull.size_max).unwrap_or(CHUNK_SIZE_MAX).min(CHUNK_SIZE_MAX);
        let mut theirs = pull.cut.clone();
        theirs.join(&pull.held);
        let chunk = match self.log.beyond(&theirs, size_max) {
            Some((mut frames, mut more)) => {
                if !more {
                    let (held, rest) = self.held.beyond(&theirs, size_max);
                    frames.extend(held);
                    more = rest;
                }
                if self.config.mutant.is(Mutant::NoRelay) {
                    let own = self.identity.origin;
                    frames.retain(|frame| frame.open().is_ok_and(|txn| txn.stamp.origin == own));
                }
                Chunk::Frames { cut: self.log.cut().clone(), frames, more }
            }
            None => Chunk::Snapshot(self.offer.take(&self.state, &self.log)),
        };
        if self.config.mutant.is(Mutant::SentIsHad) {
            self.acks.note(from, self.log.cut());
        }
        effects.push(Effect::Send(from, Message::Chunk(chunk)));
    }

    fn take_chunk(&mut self, now: Time, (from, chunk): (Origin, Chunk), effects: &mut Vec<Effect>) {
        let full = matches!(chunk, Chunk::Frames { more: true, .. });
        let asked = self.sync.answered(now, from, full);
        match chunk {
            Chunk::Frames { cut, frames, more } if self.is_member() && (asked || self.members.is_active(from)) => {
                let missing = self.take_frames(now, (from, frames), effects);
                self.sync.peers.entry(from).and_modify(|peer| peer.dropped = 0);
                if self.members.is_active(from) {
                    self.acks.note(from, &cut);
                }
                if (more || !self.have().dominates(&cut)) && !missing {
                    self.sync.ahead(from, now);
                }
            }
            Chunk::Snapshot(manifest) if asked || self.members.is_active(from) || self.identity.asked == Some(from) => {
                self.begin_download(now, (from, manifest), effects);
            }
            Chunk::Frames { .. } | Chunk::Snapshot(_) => {}
            Chunk::Retired(_) if asked && self.identity.joining.is_some() => self.want_another(now, from),
            Chunk::Retired(stamp) => {
                // If each has retired the other, the earlier retirement stands.
                let mine = self.members.retired(from);
                if self.identity.joining.is_none() && mine.is_none_or(|mine| stamp < mine) {
                    self.rejoin(now, false, effects);
                }
            }
            Chunk::Fork { seq, link } => self.take_fork(now, (seq, link), effects),
            Chunk::Known(known) => {
                if self.is_member() && self.members.is_active(from) {
                    self.take_known(now, (from, &known), effects);
                }
            }
            Chunk::Behind(cut) if self.identity.joining.is_none() && !self.log.cut().dominates(&cut) => {
                self.rejoin(now, false, effects);
            }
            // What was said first was heard last.
            Chunk::Behind(_) => self.sync.ahead(from, now),
        }
    }

    fn answer_retired(&mut self, now: Time, (from, message): (Origin, &Message), effects: &mut Vec<Effect>) {
        if let (Message::Hello(_) | Message::Pull(_), Some(stamp)) = (message, self.members.retired(from)) {
            effects.push(Effect::Send(from, Message::Chunk(Chunk::Retired(stamp))));
        }
        if let Message::Chunk(Chunk::Retired(stamp)) = message {
            self.take_chunk(now, (from, Chunk::Retired(*stamp)), effects);
        }
    }

    /// Returns how many pulls may wait for an answer at a time.
    pub(super) fn pulls_max(&self) -> usize {
        match (self.is_downloading(), self.is_member()) {
            (true, _) => 0,
            (false, false) => 1,
            (false, true) => PULLS_MAX,
        }
    }

    /// Asks peers that may have more, as many as may be asked at a time.
    fn pull(&mut self, now: Time, effects: &mut Vec<Effect>) {
        loop {
            let pulling = self.sync.peers.values().filter(|peer| peer.pulling.is_some()).count();
            let may = |peer: &Peer| peer.ahead && peer.pulling.is_none() && peer.ask_at <= now;
            let ready: Vec<Origin> = self.sync.peers.iter().filter(|(_, p)| may(p)).map(|(o, _)| *o).collect();
            let ready = self.one_sponsor(ready);
            let choice = self.random.below(u64::try_from(ready.len()).unwrap_or(0));
            let Some(peer) = usize::try_from(choice).ok().and_then(|choice| ready.get(choice)) else { return };
            if pulling >= self.pulls_max() {
                return;
            }
            let peer = &peer.to_owned();
            self.note_asked(*peer);
            let chunk = self.sync.peers.get(peer).map_or(0, |peer| peer.pace.chunk());
            let (cut, size_max) = (self.log.cut().clone(), u32::try_from(chunk).unwrap_or(u32::MAX));
            let replaces = || self.identity.past.iter().map(|past| past.origin).collect();
            let robot = || self.identity.robot.clone();
            let join = self.identity.joining.map(|origin| Join { origin, robot: robot(), replaces: replaces() });
            effects.push(Effect::Send(*peer, Message::Pull(Pull { cut, held: self.held.cut(), size_max, join })));
            if let Some(peer) = self.sync.peers.get_mut(peer) {
                peer.pulling = Some(now + peer.pace.wait());
                peer.asked_at = peer.asked_at.filter(|at| now.since(*at) < LATE_MAX).or(Some(now));
            }
        }
    }

    /// Narrows down whom to ask for admission: to whoever was asked for it, as long as that one may answer.
    fn one_sponsor(&mut self, mut ready: Vec<Origin>) -> Vec<Origin> {
        let Some(asked) = self.identity.asked else { return ready };
        let asked_peer = self.sync.peers.get(&asked);
        let Some(peer) = asked_peer.filter(|peer| peer.ahead && peer.silent < SILENT_MAX) else { return ready };
        let until = peer.ask_at;
        if !ready.contains(&asked) {
            self.sync.peers.values_mut().for_each(|peer| peer.ask_at = peer.ask_at.max(until));
        }
        ready.retain(|origin| *origin == asked);
        ready
    }

    /// Whoever is no member asks one sponsor for one origin, and another one for another.
    fn note_asked(&mut self, peer: Origin) {
        let Some(joining) = self.identity.joining.filter(|_| self.identity.asked != Some(peer)) else { return };
        if let Some(before) = self.identity.asked.replace(peer) {
            let known = self.identity.past.iter().position(|past| past.asked == Some(peer));
            let known = known.map(|index| self.identity.past.remove(index).origin);
            self.identity.joining = Some(known.unwrap_or_else(|| Origin::new(self.random.next())));
            self.identity.past.push(Past { origin: joining, asked: Some(before), ..Past::default() });
        }
        self.batch.identity(&self.identity);
    }

    /// The origin that it asked for was retired meanwhile: it asks for another one.
    fn want_another(&mut self, now: Time, from: Origin) {
        let Some(joining) = self.identity.joining.filter(|_| self.identity.asked == Some(from)) else { return };
        self.identity.past.push(Past { origin: joining, ..Past::default() });
        self.identity.joining = Some(Origin::new(self.random.next()));
        self.batch.identity(&self.identity);
        self.sync.ahead(from, now);
    }

    /// Remembers that others have all own transactions. That one says so of a number is not enough: it may know another
    /// transaction by it, if the store was set back.
    fn learn_told(&mut self) {
        let head = self.log.cut().get(self.identity.origin);
        if head > self.identity.told && self.identity.joining.is_none() {
            self.identity.told = head;
            self.batch.identity(&self.identity);
        }
    }
}
