//! The table of other nodes: which are present, which are missing, and which are lost.
//!
//! A node is present because it has answered. This node asks others in numbered rounds, and each answers with the
//! number of the round. Important nodes are asked once a second, the others seldom: see `attention`. Some events make
//! this node ask all nodes of one name at once: a token that appears or vanishes, a second node of the same name, or a
//! message of an unlisted node. Only nodes of that name are asked. Otherwise one arriving node would make all 32 nodes
//! query each other. Tokens get lost, arrive in any order, and can be made by anyone. If something suggests that a node
//! is gone, its answer to a later round refutes this. An answer to an earlier round does not.
//!
//! A node that does not answer is at first only missing. It is lost after [`LOST_AFTER`]: a short cut, or a node that
//! was suspended, must not end a mission. If two nodes have one name, both are kept. The node that answered first
//! holds the name until it is lost. Until then the second node is refused. If a node was killed, its next boot gets
//! the name at once: it has the same folder of the same machine, which two nodes never have at once. This module never
//! uses the calendar clock.

mod attention;
mod change;
mod detour;

use super::effect::earliest;
use super::protocol::{Duplicate, Pong};
pub(in crate::logic) use attention::{NEW_FOR, QUIET_EVERY};
pub use change::Change;
use comms::logic::time::Time;
use detour::Detour;
pub use detour::{RelayedPong, Round};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

/// How long a node may be missing before its parts of deployments count as lost.
pub const LOST_AFTER: Duration = Duration::from_secs(5);
/// How often the nodes that matter now are asked.
pub(super) const ASK_EVERY: Duration = Duration::from_secs(1);
/// The shortest time between two rounds in every case.
pub(super) const ASK_GAP: Duration = Duration::from_millis(100);
/// The most names that are asked in a round. If there are more names, all nodes are asked.
const ASKED_MAX: usize = 64;
/// The most rounds by which an answer may be late: longer than the longest way, which is 3 s, at the shortest gap.
const ROUNDS_MAX: usize = 64;
/// How long a node may take to answer after its token has vanished, in addition to its usual time.
pub(super) const DOUBT: Duration = Duration::from_millis(300);
/// How long a node may take to answer after another node has taken its name: the first node may be busy.
const DOUBT_RIVAL: Duration = Duration::from_secs(2);
/// The time after which a silent node counts as missing, from its last answer. The node is asked each second, and its
/// usual time to answer is added.
pub(super) const SILENCE_MAX: Duration = Duration::from_millis(2500);
/// The time from the last answer of a silent node to the start of its absence. A missing node has
/// been absent since then, and [`LOST_AFTER`] is measured from then.
pub(super) const SILENCE_MISSING: Duration = Duration::from_secs(1);
/// How long lost nodes are remembered. After that, no answer to a round from before the loss is accepted any more.
pub(super) const REMEMBERED: Duration = Duration::from_secs(120);
/// The most names that are kept.
const NAMES_MAX: usize = 1024;
/// The most nodes of one name that are kept.
const LIVES_MAX: usize = 8;
/// How long the second node of a name stays, so that the first node and other nodes can notice and report it.
pub(super) const KNOWN_WITHIN: Duration = Duration::from_secs(3);

/// One boot of a node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Boot {
    place: String,
    /// [`Pong::origin`].
    origin: u32,
    last: Answer,
    /// The time from which its silence is measured. Nothing while no answer is expected.
    owes: Option<Time>,
    /// Since when it is present.
    there_since: Time,
    /// The first round that it answered.
    first: u64,
    /// Answers to rounds before this one prove nothing.
    proof: u64,
    /// Since when something suggests that the boot is gone, and when its time to answer ends.
    doubted: Option<(Time, Time)>,
    reach: Reach,
    standing: Standing,
    /// How this boot is reached while it does not answer directly.
    detour: Option<Detour>,
}

/// The last answer of a boot.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Answer {
    heard: Time,
    /// How long this node was away after the answer. This time does not count as silence.
    slept: Duration,
    /// The time from the question to the answer.
    took: Duration,
}

/// Whether a boot is present.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Reach {
    There,
    Missing { since: Time },
    Lost { since: Time, at: Time },
}

/// The claim of a boot to its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Standing {
    Alone,
    /// This boot and the holder of its name were present at the same time.
    Rival,
    /// It has the name of this node, and was present first.
    Elder,
}

/// All boots of one name that are present, or were present recently.
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
    asked: Asked,
    /// The hosts that something here depends on.
    close: BTreeSet<String>,
    /// Until then, all nodes are asked each second, because a user looks.
    watched_until: Time,
    /// When the table was last updated, and when the next update is due.
    seen: Time,
    due: Time,
    changes: Vec<Change>,
}

/// The questions to other nodes.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Asked {
    /// The last rounds, with the time of each.
    rounds: VecDeque<(u64, Time)>,
    round: u64,
    /// When all other nodes are asked next, and how many times they were asked.
    all_at: Time,
    all_count: u64,
    /// When the nodes that matter now are asked next.
    close_at: Time,
    /// When further nodes are asked, and the names of these nodes.
    some_at: Time,
    some: BTreeSet<String>,
}

impl NameServer {
    /// Returns an empty table for the node `host`, booted as `boot`.
    pub fn new(host: &str, boot: u64, now: Time) -> Self {
        Self {
            host: host.to_owned(),
            boot,
            started: now,
            peers: BTreeMap::new(),
            asked: Asked { all_at: now, close_at: now, some_at: now, ..Asked::default() },
            close: BTreeSet::new(),
            watched_until: now,
            seen: now,
            due: now,
            changes: Vec::new(),
        }
    }

    /// Notes that the token of a node has appeared.
    pub fn token(&mut self, now: Time, host: &str, boot: u64) {
        self.heard_of(now, host, boot);
    }

    /// Notes that the token of a node has vanished. The token of another boot says nothing about this boot.
    pub fn no_token(&mut self, now: Time, host: &str, boot: u64) {
        let proof = self.asked.round + 1;
        let Some(life) = self.life_mut(host, boot).filter(|life| life.is_there()) else { return };
        life.proof = proof;
        let until = now + DOUBT + 2 * life.last.took;
        life.doubted = Some(life.doubted.map_or((now, until), |(since, before)| (since, before.min(until))));
        self.ask_soon(now, host);
    }

    /// Returns whether all other nodes have had time to notice this node. A new node asks them every second.
    pub fn is_known(&self, now: Time) -> bool {
        now.since(self.started) > KNOWN_WITHIN
    }

    /// Notes a message of a node that is not an answer. If the node is not listed as present, it is asked at once.
    pub fn heard_of(&mut self, now: Time, host: &str, boot: u64) {
        let is_own = host == self.host && boot == self.boot;
        let is_there = self.peers.get(host).and_then(|peer| peer.lives.get(&boot)).is_some_and(Boot::is_there);
        if !is_own && !is_there {
            tracing::debug!("the node `{host}` was heard, but is not listed as present: asking it");
            self.ask_soon(now, host);
        }
    }

    /// Notes an answer.
    pub fn answered(&mut self, now: Time, pong: &Pong) {
        let (host, boot) = (&pong.from, pong.boot);
        let asked = self.asked.rounds.iter().find(|(round, _)| *round == pong.round).map(|(_, at)| *at);
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
        (life.last.heard, life.last.slept) = (now, Duration::ZERO);
        (life.last.took, life.place) = (now.since(asked), pong.place.clone());
        let (was_there, is_holder) = (life.is_there(), peer.holder == Some(boot));
        let had_detour = life.detour.take().is_some();
        if !was_there {
            life.there_since = now;
        }
        if pong.holder.is_some_and(|holder| holder != self.boot) && *host != self.host {
            // If a node communicates with another node of this node's name, it does not count as present.
            if life.is_there() {
                life.reach = Reach::Missing { since: now };
            }
            if was_there && is_holder {
                let why = format!("it deals with another node called `{}`", self.host);
                self.changes.push(Change::Missing { host: host.clone(), since: now, why });
            }
            return;
        }
        (life.doubted, life.reach) = (None, Reach::There);
        if *host == self.host {
            let is_elder = (pong.up, boot) > (now.since(self.started), self.boot);
            life.standing = if is_elder { Standing::Elder } else { Standing::Alone };
            if is_new || !was_there {
                self.changes.push(Change::Namesake { place: pong.place.clone(), elder: life.is_elder() });
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

    /// Returns whether one more boot can be stored. If necessary, removes an absent boot of the same name.
    fn has_room(&mut self, host: &str, boot: u64) -> bool {
        let Some(peer) = self.peers.get_mut(host) else { return self.peers.len() < NAMES_MAX };
        if peer.lives.contains_key(&boot) || peer.lives.len() < LIVES_MAX {
            return true;
        }
        let gone = peer.lives.iter().filter(|(other, life)| !life.is_there() && Some(**other) != peer.holder);
        let oldest = gone.min_by_key(|(_, life)| life.missing_since()).map(|(other, _)| *other);
        oldest.is_some_and(|oldest| peer.lives.remove(&oldest).is_some())
    }

    /// Determines which boot holds a name.
    fn settle(&mut self, now: Time, host: &str) {
        let next = self.asked.round + 1;
        let Some(peer) = self.peers.get_mut(host).filter(|_| *host != *self.host) else { return };
        let held = peer.holder.and_then(|boot| peer.lives.get(&boot));
        let is_free = held.is_none_or(|life| life.is_lost());
        let is_there = held.is_some_and(Boot::is_there);
        // This is the next boot of a killed node. A second node of the name waits until the first is lost.
        let is_next = |life: &Boot| held.is_some_and(|held| held.origin == life.origin);
        let may_take = |life: &Boot| is_free || !life.is_rival() && (is_there || is_next(life));
        let others = peer.lives.iter().filter(|(boot, life)| Some(**boot) != peer.holder && life.is_there());
        let other = others.filter(|(_, life)| may_take(life)).min_by_key(|(_, life)| (!is_next(life), life.first));
        let Some((&boot, taker)) = other else { return };
        if !is_there {
            let (place, replaces) = (taker.place.clone(), !is_free);
            peer.holder = Some(boot);
            peer.lives.values_mut().for_each(|life| life.standing = Standing::Alone);
            self.changes.push(Change::Appeared { host: host.to_owned(), boot, place, replaces });
            return;
        }
        let (place, first) = (taker.place.clone(), taker.first);
        let Some(holder) = peer.holder.and_then(|boot| peer.lives.get_mut(&boot)) else { return };
        if holder.doubted.is_some() {
            return;
        }
        if holder.proof > first {
            // The holder has answered a round that began when the other boot was present.
            let first = holder.place.clone();
            peer.lives.entry(boot).and_modify(|life| life.standing = Standing::Rival);
            self.changes.push(Change::Refused { host: host.to_owned(), place, first });
        } else {
            (holder.proof, holder.doubted) = (next, Some((now, now + DOUBT_RIVAL + 2 * holder.last.took)));
            self.ask_soon(now, host);
        }
    }

    /// If another node has this node's name and was present first, returns where it runs.
    pub fn elder(&self) -> Option<&str> {
        let mut own = self.peers.get(&self.host).into_iter().flat_map(|peer| peer.lives.values());
        own.find(|life| life.is_elder() && life.is_there()).map(|life| life.place.as_str())
    }

    /// Returns whether a node is known and not lost.
    pub fn knows(&self, host: &str) -> bool {
        self.held(host).is_some_and(|life| !life.is_lost())
    }

    /// Marks a node as lost, because it takes no messages any more. Its next answer makes it present again.
    pub fn lose(&mut self, now: Time, host: &str) {
        let proof = self.asked.round + 1;
        let holder = self.peers.get(host).and_then(|peer| peer.holder);
        if let Some(life) = holder.and_then(|boot| self.life_mut(host, boot)) {
            (life.proof, life.reach, life.detour) = (proof, Reach::Lost { since: now, at: now }, None);
        }
    }

    /// Returns when a node last answered, or when its link was last up. If a node is seldom asked, its last answer may
    /// be much older than the cut of its link.
    pub fn heard(&self, host: &str) -> Option<Time> {
        let life = self.held(host)?;
        let heard = life.last_heard();
        Some(life.missing_since().map_or(heard, |since| heard.max(since.before(SILENCE_MISSING))))
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

    /// Returns whether a node can be reached now.
    pub fn reaches(&self, host: &str) -> bool {
        self.held(host).is_some_and(Boot::is_there)
    }

    /// Returns the nodes that can be reached now, sorted by name.
    pub fn present(&self) -> impl Iterator<Item = &str> {
        self.peers.keys().map(String::as_str).filter(|host| self.reaches(host))
    }

    /// Returns the present boots of other nodes with this node's name, and whether each was present before this node.
    pub fn namesakes(&self) -> impl Iterator<Item = (u64, bool)> {
        let own = self.peers.get(&self.host).into_iter().flat_map(|peer| &peer.lives);
        own.filter(|(_, life)| life.is_there()).map(|(boot, life)| (*boot, life.is_elder()))
    }

    /// Returns where another node with this node's name runs.
    pub fn place(&self, boot: u64) -> Option<&str> {
        self.peers.get(&self.host)?.lives.get(&boot).map(|life| life.place.as_str())
    }

    /// Returns the names that two nodes share. `place` is where this node runs.
    pub fn duplicates(&self, place: &str) -> Vec<Duplicate> {
        let of_name = |(host, peer): (&String, &Peer)| {
            let is_own = *host == self.host;
            let held = peer.holder.and_then(|boot| peer.lives.get(&boot)).filter(|life| life.is_there());
            let first = if is_own { Some(place) } else { held.map(|life| life.place.as_str()) };
            let others = peer
                .lives
                .iter()
                .filter(|(boot, life)| life.is_there() && (is_own || life.is_rival() && Some(**boot) != peer.holder));
            let pair = |life: &Boot| {
                let (first, second) = (first?.to_owned(), life.place.clone());
                let is_second = is_own && life.is_elder();
                let (first, second) = if is_second { (second, first) } else { (first, second) };
                Some(Duplicate { host: host.clone(), first, second })
            };
            others.filter_map(|(_, life)| pair(life)).collect::<Vec<_>>()
        };
        self.peers.iter().flat_map(of_name).collect()
    }

    /// Returns whether a host may treat this node as missing: this node was just away, killed or
    /// suspended, and the last answer of the host is old. Stays true until [`NameServer::tick`].
    pub fn has_slept(&self, now: Time, host: &str) -> bool {
        let slept = self.slept(now);
        slept > ASK_EVERY && self.held(host).is_some_and(|life| life.last.slept + slept > SILENCE_MAX)
    }

    fn slept(&self, now: Time) -> Duration {
        now.since(self.due.max(self.seen + ASK_EVERY))
    }

    /// Shifts all times by the time for which this node was away, because other nodes were not silent during this time. If it was away
    /// for long, asks all nodes.
    fn make_up(&mut self, now: Time) {
        let slept = self.slept(now);
        self.seen = now;
        if slept > SILENCE_MAX {
            self.asked.all_at = now;
        }
        if slept > Duration::ZERO {
            let lives = self.peers.values_mut().flat_map(|peer| peer.lives.values_mut());
            for life in lives {
                (life.last.heard, life.last.slept) = (life.last.heard + slept, life.last.slept + slept);
                life.owes = life.owes.map(|since| since + slept);
                life.detour.iter_mut().for_each(|detour| detour.heard = detour.heard + slept);
                life.doubted = life.doubted.map(|(since, until)| (since + slept, until + slept));
            }
        }
    }

    /// Notes that time has passed. Returns the changes since the last call, and the next round of questions if it is due.
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
        let proof = self.asked.round + 1;
        let Some(peer) = self.peers.get_mut(host) else { return };
        for (boot, life) in &mut peer.lives {
            let is_holder = peer.holder == Some(*boot);
            if life.is_there()
                && let Some(since) = life.missed(now)
            {
                (life.reach, life.doubted, life.proof, life.detour) = (Reach::Missing { since }, None, proof, None);
                if is_holder {
                    let why = "it does not answer".to_owned();
                    self.changes.push(Change::Missing { host: host.to_owned(), since, why });
                }
            }
            if let Reach::Missing { since } = life.reach
                && since + LOST_AFTER <= now
            {
                life.reach = Reach::Lost { since, at: now };
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

    /// Returns when [`NameServer::tick`] has to be called.
    pub fn deadline(&self) -> Option<Time> {
        let lives = self.peers.values().flat_map(|peer| peer.lives.values());
        let some = (!self.asked.some.is_empty()).then_some(self.asked.some_at);
        let asked = some.into_iter().chain(self.next_turn());
        Some(lives.filter_map(Boot::deadline).chain(asked).fold(self.asked.all_at, Time::min))
    }

    /// Schedules questions to the nodes of a name, as soon as the gap after the last round allows it.
    fn ask_soon(&mut self, now: Time, host: &str) {
        let soon = self.asked.rounds.back().map_or(Time::ZERO, |(_, at)| *at + ASK_GAP).max(now);
        if self.asked.some.contains(host) || self.asked.some.len() < ASKED_MAX {
            if self.asked.some.is_empty() {
                self.asked.some_at = soon;
            }
            self.asked.some.insert(host.to_owned());
        } else {
            self.asked.all_at = self.asked.all_at.min(soon);
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
            last: Answer { heard: now, slept: Duration::ZERO, took: Duration::ZERO },
            owes: Some(now),
            there_since: now,
            first: pong.round,
            proof: 0,
            doubted: None,
            reach: Reach::There,
            standing: Standing::Alone,
            detour: None,
        }
    }

    fn is_there(&self) -> bool {
        self.reach == Reach::There
    }

    fn is_lost(&self) -> bool {
        matches!(self.reach, Reach::Lost { .. })
    }

    fn missing_since(&self) -> Option<Time> {
        match self.reach {
            Reach::There => None,
            Reach::Missing { since } | Reach::Lost { since, .. } => Some(since),
        }
    }

    fn is_rival(&self) -> bool {
        self.standing == Standing::Rival
    }

    fn is_elder(&self) -> bool {
        self.standing == Standing::Elder
    }

    /// Returns since when the boot is missing; nothing if it is not missing.
    fn missed(&self, now: Time) -> Option<Time> {
        let doubted = self.doubted.filter(|(_, until)| *until <= now).map(|(since, _)| since);
        doubted.or_else(|| {
            let (since, _) = self.silent_at().filter(|(_, at)| *at <= now)?;
            Some(since + SILENCE_MISSING)
        })
    }

    fn is_over(&self, now: Time) -> bool {
        matches!(self.reach, Reach::Lost { at, .. } if at + REMEMBERED <= now)
    }

    fn deadline(&self) -> Option<Time> {
        match self.reach {
            Reach::Lost { at, .. } => Some(at + REMEMBERED),
            Reach::Missing { since } => Some(since + LOST_AFTER),
            Reach::There => earliest(self.doubted.map(|(_, until)| until), self.silent_at().map(|(_, at)| at)),
        }
    }
}
