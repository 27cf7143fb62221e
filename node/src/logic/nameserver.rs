//! The table of other nodes: which are there, which are missing, and which are lost.
//!
//! A node is there because it has answered: this one asks others, in numbered rounds, and each answers with the number of the
//! round. Those that matter now are asked about once a second, the others seldom: see `attention`. A token that appears or
//! vanishes, a second node of the same name, or a word of somebody who is not listed is only a reason to ask nodes of that name at
//! once, and nobody else: of 32 nodes one that comes would have all others ask all others. Tokens get lost, they come in any order,
//! and anybody can make one. What speaks against a node is cleared by its answer to a later round, never by one to an earlier.
//!
//! A node that does not answer is only missing; it is lost after [`LOST_AFTER`], because a short cut, or a node that was
//! suspended, must not end a mission. Two nodes with one name are both kept: the first one that answered holds the name for
//! as long as it is not lost, the second is refused until then. The next boot of a node that was killed has its name at once: it
//! comes from the same folder of the same machine, which two nodes never have at once. Never acts on a wall clock.

mod attention;
mod change;
mod detour;
mod duplicates;
mod sleep;

use super::effect::earliest;
use super::protocol::Pong;
pub(in crate::logic) use attention::{NEW_FOR, QUIET_EVERY};
pub use change::Change;
use comms::logic::time::Time;
use detour::Detour;
pub use detour::{RelayedPong, Round};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

/// How long a node may be missing before its part of a deployment counts as lost.
pub const LOST_AFTER: Duration = Duration::from_secs(5);
/// How often those are asked that matter now.
pub(super) const ASK_EVERY: Duration = Duration::from_secs(1);
/// How often at the most, whatever happens.
pub(super) const ASK_GAP: Duration = Duration::from_millis(100);
/// How many names are asked in a round; of more, all are asked.
const ASKED_MAX: usize = 64;
/// How many rounds an answer may be late: longer than the longest way, which is 3 s, at the shortest gap.
const ROUNDS_MAX: usize = 64;
/// How long a node whose token has vanished has to answer, besides its usual time.
pub(super) const DOUBT: Duration = Duration::from_millis(300);
/// How long a node has to answer when another one has taken its name: it may be a busy one.
const DOUBT_RIVAL: Duration = Duration::from_secs(2);
/// How long nothing may be heard of a node that is asked each second, besides its usual time.
pub(super) const SILENCE_MAX: Duration = Duration::from_millis(2500);
/// From the last answer of a silent node to when it is missing.
pub(super) const SILENCE_MISSING: Duration = Duration::from_secs(1);
/// How long nodes that are lost are remembered: no answer to a round from before the loss is accepted any more then.
pub(super) const REMEMBERED: Duration = Duration::from_secs(120);
/// How many names are kept.
const NAMES_MAX: usize = 1024;
/// How many nodes of one name are kept.
const LIVES_MAX: usize = 8;
/// How long a node that has come second to its name stays, so that the first one and others can hear of it and say so.
pub(super) const KNOWN_WITHIN: Duration = Duration::from_secs(3);

/// One boot of a node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Boot {
    place: String,
    /// [`Pong::origin`].
    origin: u32,
    /// When its last answer came.
    heard: Time,
    /// How long this node was away since then, which does not count.
    slept: Duration,
    /// From when its silence counts; none while nothing is expected of it.
    owes: Option<Time>,
    /// Since when it is there.
    there_since: Time,
    /// How long that took.
    took: Duration,
    /// The first round that it answered.
    first: u64,
    /// Answers to rounds before this one prove nothing.
    proof: u64,
    /// Until when it has to answer, where something speaks against it, and since when.
    doubted: Option<(Time, Time)>,
    missing_since: Option<Time>,
    lost_at: Option<Time>,
    /// Whether it and the holder of its name were there at the same time.
    is_rival: bool,
    /// Whether it has this node's own name, and was there first.
    is_elder: bool,
    /// How it is reached while it does not answer itself.
    detour: Option<Detour>,
}

/// Every boot of one name that is there, or was of late.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Peer {
    holder: Option<u64>,
    lives: BTreeMap<u64, Boot>,
}

/// The table of other nodes.
#[derive(Debug, Serialize, Deserialize)]
pub struct NameServer {
    host: String,
    boot: u64,
    started: Time,
    peers: BTreeMap<String, Peer>,
    rounds: VecDeque<(u64, Time)>,
    round: u64,
    /// When all others are asked, and how often they were.
    ask_at: Time,
    asked_all: u64,
    /// When those are asked that matter now.
    ask_close_at: Time,
    /// When some more are asked, and who.
    ask_some_at: Time,
    to_ask: BTreeSet<String>,
    /// The hosts that something here depends on.
    close: BTreeSet<String>,
    /// Until when a person looks.
    watched_until: Time,
    /// When it was looked at last, and when that is due again.
    seen: Time,
    due: Time,
    changes: Vec<Change>,
}

impl NameServer {
    /// Returns a table without others for the node `host`, booted as `boot`.
    pub fn new(host: &str, boot: u64, now: Time) -> Self {
        Self {
            host: host.to_owned(),
            boot,
            started: now,
            peers: BTreeMap::new(),
            rounds: VecDeque::new(),
            round: 0,
            ask_at: now,
            asked_all: 0,
            ask_close_at: now,
            ask_some_at: now,
            to_ask: BTreeSet::new(),
            close: BTreeSet::new(),
            watched_until: now,
            seen: now,
            due: now,
            changes: Vec::new(),
        }
    }

    /// Takes note that a token of a node is there.
    pub fn token(&mut self, now: Time, host: &str, boot: u64) {
        self.heard_of(now, host, boot);
    }

    /// Takes note that a token of a node is gone. A token of another boot says nothing about this one.
    pub fn no_token(&mut self, now: Time, host: &str, boot: u64) {
        let proof = self.round + 1;
        let Some(life) = self.life_mut(host, boot).filter(|life| life.is_there()) else { return };
        life.proof = proof;
        let until = now + DOUBT + 2 * life.took;
        life.doubted = Some(life.doubted.map_or((now, until), |(since, before)| (since, before.min(until))));
        self.ask_soon(now, host);
    }

    /// Returns whether all others, whom it asks every second when it is new, have had time to hear of this node.
    pub fn is_known(&self, now: Time) -> bool {
        now.since(self.started) > KNOWN_WITHIN
    }

    /// Takes note of a word of a node that is no answer: one that is not listed is asked at once.
    pub fn heard_of(&mut self, now: Time, host: &str, boot: u64) {
        let is_own = host == self.host && boot == self.boot;
        let is_there = self.peers.get(host).and_then(|peer| peer.lives.get(&boot)).is_some_and(Boot::is_there);
        if !is_own && !is_there {
            tracing::debug!("the node `{host}` is heard, and not there: it is asked");
            self.ask_soon(now, host);
        }
    }

    /// Takes an answer.
    pub fn answered(&mut self, now: Time, pong: &Pong) {
        let (host, boot) = (&pong.from, pong.boot);
        let asked = self.rounds.iter().find(|(round, _)| *round == pong.round).map(|(_, at)| *at);
        let Some(asked) = asked.filter(|_| pong.to_boot == self.boot && (host, boot) != (&self.host, self.boot)) else {
            return;
        };
        if !self.has_room(host, boot) {
            return;
        }
        let peer = self.peers.entry(host.clone()).or_default();
        let is_new = !peer.lives.contains_key(&boot);
        let life = peer.lives.entry(boot).or_insert_with(|| Boot::new(pong, now));
        if pong.round < life.proof {
            return;
        }
        (life.heard, life.slept) = (now, Duration::ZERO);
        (life.took, life.place) = (now.since(asked), pong.place.clone());
        let (was_there, is_holder) = (life.is_there(), peer.holder == Some(boot));
        let had_detour = life.detour.take().is_some();
        if !was_there {
            life.there_since = now;
        }
        if pong.holder.is_some_and(|holder| holder != self.boot) && *host != self.host {
            // Who deals with another node of this one's name is not there for this one.
            life.missing_since.get_or_insert(now);
            if was_there && is_holder {
                let why = format!("it deals with another node called `{}`", self.host);
                self.changes.push(Change::Missing { host: host.clone(), since: now, why });
            }
            return;
        }
        (life.doubted, life.missing_since, life.lost_at) = (None, None, None);
        if *host == self.host {
            life.is_elder = (pong.up, boot) > (now.since(self.started), self.boot);
            if is_new || !was_there {
                self.changes.push(Change::Namesake { place: pong.place.clone(), elder: life.is_elder });
            }
        } else {
            if (!was_there || had_detour) && is_holder {
                let place = life.place.clone();
                self.changes.push(Change::Appeared { host: host.clone(), boot, place, replaces: false });
            }
            self.settle(now, &pong.from);
        }
        self.rest(now, &pong.from, boot);
    }

    /// Returns whether one more node can be remembered; forgets one of the same name that is lost if that helps.
    fn has_room(&mut self, host: &str, boot: u64) -> bool {
        let Some(peer) = self.peers.get_mut(host) else { return self.peers.len() < NAMES_MAX };
        if peer.lives.contains_key(&boot) || peer.lives.len() < LIVES_MAX {
            return true;
        }
        let gone = peer.lives.iter().filter(|(other, life)| !life.is_there() && Some(**other) != peer.holder);
        let oldest = gone.min_by_key(|(_, life)| life.missing_since).map(|(other, _)| *other);
        oldest.is_some_and(|oldest| peer.lives.remove(&oldest).is_some())
    }

    /// Works out who holds a name.
    fn settle(&mut self, now: Time, host: &str) {
        let next = self.round + 1;
        let Some(peer) = self.peers.get_mut(host).filter(|_| *host != *self.host) else { return };
        let held = peer.holder.and_then(|boot| peer.lives.get(&boot));
        let is_free = held.is_none_or(|life| life.lost_at.is_some());
        let is_there = held.is_some_and(Boot::is_there);
        // The next boot of a node that was killed: a second node waits until the first is lost.
        let is_next = |life: &Boot| held.is_some_and(|held| held.origin == life.origin);
        let may_take = |life: &Boot| is_free || !life.is_rival && (is_there || is_next(life));
        let others = peer.lives.iter().filter(|(boot, life)| Some(**boot) != peer.holder && life.is_there());
        let other = others.filter(|(_, life)| may_take(life)).min_by_key(|(_, life)| (!is_next(life), life.first));
        let Some((&boot, taker)) = other else { return };
        if !is_there {
            let (place, replaces) = (taker.place.clone(), !is_free);
            peer.holder = Some(boot);
            peer.lives.values_mut().for_each(|life| life.is_rival = false);
            self.changes.push(Change::Appeared { host: host.to_owned(), boot, place, replaces });
            return;
        }
        let (place, first) = (taker.place.clone(), taker.first);
        let Some(holder) = peer.holder.and_then(|boot| peer.lives.get_mut(&boot)) else { return };
        if holder.doubted.is_some() {
            return;
        }
        if holder.proof > first {
            // It has answered a round that began when the other was there.
            let first = holder.place.clone();
            peer.lives.entry(boot).and_modify(|life| life.is_rival = true);
            self.changes.push(Change::Refused { host: host.to_owned(), place, first });
        } else {
            (holder.proof, holder.doubted) = (next, Some((now, now + DOUBT_RIVAL + 2 * holder.took)));
            self.ask_soon(now, host);
        }
    }

    /// Returns where another node with this one's name runs that was there first, if there is one.
    pub fn elder(&self) -> Option<&str> {
        let mut own = self.peers.get(&self.host).into_iter().flat_map(|peer| peer.lives.values());
        own.find(|life| life.is_elder && life.is_there()).map(|life| life.place.as_str())
    }

    /// Returns whether a node was seen and is not lost.
    pub fn knows(&self, host: &str) -> bool {
        self.held(host).is_some_and(|life| life.lost_at.is_none())
    }

    /// Counts a node as lost that takes nothing any more; it is there again when it answers.
    pub fn lose(&mut self, now: Time, host: &str) {
        let proof = self.round + 1;
        let holder = self.peers.get(host).and_then(|peer| peer.holder);
        if let Some(life) = holder.and_then(|boot| self.life_mut(host, boot)) {
            (life.proof, life.missing_since, life.lost_at, life.detour) = (proof, Some(now), Some(now), None);
        }
    }

    /// Returns when a node has answered last, or its link stood: one that is seldom asked has answered long before it was cut off.
    pub fn heard(&self, host: &str) -> Option<Time> {
        let life = self.held(host)?;
        let before = |since: Time| Time::ZERO + since.since(Time::ZERO).saturating_sub(SILENCE_MISSING);
        Some(life.missing_since.map_or(life.last_heard(), |since| life.last_heard().max(before(since))))
    }

    /// Returns the boot that a name belongs to.
    pub fn holder(&self, host: &str) -> Option<u64> {
        self.peers.get(host)?.holder
    }

    /// Returns every name that is held, and the boot that holds it.
    pub fn holders(&self) -> BTreeMap<String, u64> {
        let known = self.peers.iter().filter(|(host, _)| self.knows(host));
        known.filter_map(|(host, peer)| Some((host.clone(), peer.holder?))).collect()
    }

    /// Returns whether a node can be reached right now.
    pub fn reaches(&self, host: &str) -> bool {
        self.held(host).is_some_and(Boot::is_there)
    }

    /// Returns the nodes that can be reached right now, in order of name.
    pub fn present(&self) -> impl Iterator<Item = &str> {
        self.peers.keys().map(String::as_str).filter(|host| self.reaches(host))
    }

    /// Lets time pass. Returns what has changed since the last call, and the round to ask others in, if it is time.
    pub fn tick(&mut self, now: Time) -> (Vec<Change>, Option<Round>) {
        self.make_up(now);
        for host in self.peers.keys().cloned().collect::<Vec<_>>() {
            self.grow_old(now, &host);
        }
        let round = self.next_round(now);
        self.due = self.deadline().unwrap_or(now);
        (std::mem::take(&mut self.changes), round)
    }

    fn grow_old(&mut self, now: Time, host: &str) {
        let proof = self.round + 1;
        let Some(peer) = self.peers.get_mut(host) else { return };
        for (boot, life) in &mut peer.lives {
            let is_holder = peer.holder == Some(*boot);
            if life.is_there()
                && let Some(since) = life.missed(now)
            {
                (life.missing_since, life.doubted, life.proof, life.detour) = (Some(since), None, proof, None);
                if is_holder {
                    let why = "it does not answer".to_owned();
                    self.changes.push(Change::Missing { host: host.to_owned(), since, why });
                }
            }
            if life.lost_at.is_none() && life.missing_since.is_some_and(|since| since + LOST_AFTER <= now) {
                life.lost_at = Some(now);
                if is_holder {
                    self.changes.push(Change::Lost { host: host.to_owned() });
                }
            }
        }
        peer.lives.retain(|_, life| !life.is_over(now));
        peer.holder.take_if(|holder| !peer.lives.contains_key(holder));
        if peer.lives.is_empty() {
            self.peers.remove(host);
        } else {
            self.settle(now, host);
        }
    }

    /// Returns when [`NameServer::tick`] wants to be called.
    pub fn deadline(&self) -> Option<Time> {
        let lives = self.peers.values().flat_map(|peer| peer.lives.values());
        let some = (!self.to_ask.is_empty()).then_some(self.ask_some_at);
        let asked = some.into_iter().chain(self.next_turn());
        Some(lives.filter_map(Boot::deadline).chain(asked).fold(self.ask_at, Time::min))
    }

    /// Has the nodes of a name asked as soon as the last round is not too close.
    fn ask_soon(&mut self, now: Time, host: &str) {
        let soon = self.rounds.back().map_or(Time::ZERO, |(_, at)| *at + ASK_GAP).max(now);
        if self.to_ask.contains(host) || self.to_ask.len() < ASKED_MAX {
            if self.to_ask.is_empty() {
                self.ask_some_at = soon;
            }
            self.to_ask.insert(host.to_owned());
        } else {
            self.ask_at = self.ask_at.min(soon);
        }
    }

    fn held(&self, host: &str) -> Option<&Boot> {
        let peer = self.peers.get(host)?;
        peer.lives.get(&peer.holder?)
    }

    fn life_mut(&mut self, host: &str, boot: u64) -> Option<&mut Boot> {
        self.peers.get_mut(host)?.lives.get_mut(&boot)
    }
}

impl Boot {
    fn new(pong: &Pong, now: Time) -> Self {
        Self {
            place: pong.place.clone(),
            origin: pong.origin,
            heard: now,
            slept: Duration::ZERO,
            owes: Some(now),
            there_since: now,
            took: Duration::ZERO,
            first: pong.round,
            proof: 0,
            doubted: None,
            missing_since: None,
            lost_at: None,
            is_rival: false,
            is_elder: false,
            detour: None,
        }
    }

    fn is_there(&self) -> bool {
        self.missing_since.is_none()
    }

    /// Returns since when it is missing, if it is.
    fn missed(&self, now: Time) -> Option<Time> {
        let doubted = self.doubted.filter(|(_, until)| *until <= now).map(|(since, _)| since);
        doubted.or_else(|| {
            let (since, _) = self.silent_at().filter(|(_, at)| *at <= now)?;
            Some(since + SILENCE_MISSING)
        })
    }

    fn is_over(&self, now: Time) -> bool {
        self.lost_at.is_some_and(|at| at + REMEMBERED <= now)
    }

    fn deadline(&self) -> Option<Time> {
        match (self.missing_since, self.lost_at) {
            (_, Some(lost)) => Some(lost + REMEMBERED),
            (Some(since), None) => Some(since + LOST_AFTER),
            (None, None) => earliest(self.doubted.map(|(_, until)| until), self.silent_at().map(|(_, at)| at)),
        }
    }
}
