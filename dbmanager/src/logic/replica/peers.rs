//! The peer table: which peers may have more data than this replica, when each peer may be asked,
//! and when this replica announces its state to other replicas.
//!
//! *Rule.* A pull without an answer in time ([`Pace::wait`]) is over. The peer is then not asked for a while, which is four times as long
//! after each silence, up to 12.8 s. The size of a request follows the speed of the link, so that on a slow link neither answers nor urgent
//! messages are late.
//!
//! A peer that has announced its answer ([`Message::Coming`](crate::logic::message::Message::Coming)) is asked for the next one at once, so
//! two answers may be in transit. The messages come in order, because the second message is useful only after the first.

use crate::logic::timing::{
    HELLO_PERIOD_MAX, HELLO_PERIOD_MIN, PULL_AFTER_PUSH, PULL_ANSWER_LATE_MAX, SILENCES_MAX, pull_pause,
};
use crate::logic::version_vector::ReplicaId;
use comms::logic::pace::Pace;
use comms::logic::random::Random;
use comms::logic::time::Time;
use std::collections::BTreeMap;
use std::time::Duration;

/// How often a sponsor may fail to answer before another one is asked.
const SPONSOR_SILENCES_MAX: u32 = 3;
/// How many peers the table has at most, members or not.
const PEERS_MAX: usize = 1024;

/// The state of the exchange with each peer.
#[derive(Debug, Default)]
pub(super) struct PeerTable {
    peers: BTreeMap<ReplicaId, Peer>,
    /// The number of the last pull.
    number: u32,
    hello_at: Time,
    /// The time between the last two hellos; zero at the beginning.
    hello_period: Duration,
}

#[derive(Debug, Default)]
struct Peer {
    /// Whether the peer may have more than this replica.
    ahead: bool,
    /// When the peer may be asked again.
    ask_at: Time,
    /// The time until which an answer is expected; none without an open pull.
    pulling: Option<Time>,
    /// The pull that the peer has not answered yet, in time or late.
    asked: Option<Asked>,
    /// When the peer announced the answer to that pull.
    announced: Option<Time>,
    /// The next pull, which was sent while that answer is in transit.
    next: Option<Asked>,
    /// The size of the requests to the peer.
    pace: Pace,
    /// How many pulls in a row the peer has not answered.
    silences: u32,
    /// How many states of the peer in a row were unusable.
    dropped: u32,
    /// The newest format that the peer reads, once it has reported it.
    format: Option<u8>,
}

/// A pull.
#[derive(Clone, Copy, Debug)]
struct Asked {
    number: u32,
    at: Time,
    /// Whether the answer to the previous pull was in transit when this pull was sent.
    follows: bool,
}

/// The number of a pull, and the approximate number of bytes that it asks for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Asking {
    pub(super) number: u32,
    pub(super) size: usize,
}

/// The answer to a pull.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Answered {
    /// Whether the answer came in time.
    pub(super) in_time: bool,
    /// Whether the answer to the previous pull was in transit when this one was requested.
    pub(super) follows: bool,
}

impl PeerTable {
    pub(super) fn deadline(&self, pulls_max: usize) -> Time {
        let pulling = self.pulling();
        let due = |peer: &Peer| match peer.pulling {
            Some(until) => Some(until),
            None if peer.ahead && pulling < pulls_max => Some(peer.ask_at),
            None => None,
        };
        self.peers.values().filter_map(due).chain([self.hello_at]).min().unwrap_or(self.hello_at)
    }

    /// Notes a change here, which is to be announced to others soon.
    pub(super) fn changed(&mut self, now: Time) {
        self.hello_period = HELLO_PERIOD_MIN;
        self.hello_at = self.hello_at.min(now + HELLO_PERIOD_MIN);
    }

    /// Notes that a peer has appeared. It is sent the state of this replica at once, and peers that did not answer may be asked again. A
    /// question that was lost with the link is not waited for. A question that was not lost is asked twice, which is harmless.
    pub(super) fn met(&mut self, now: Time) {
        (self.hello_at, self.hello_period) = (now, HELLO_PERIOD_MIN);
        for peer in self.peers.values_mut() {
            peer.ahead |= peer.pulling.take().is_some();
            (peer.announced, peer.next) = (None, None);
            (peer.ask_at, peer.silences) = (peer.ask_at.min(now), 0);
        }
    }

    /// Forgets all conversations.
    pub(super) fn reset(&mut self, now: Time) {
        *self = Self { hello_at: now, ..Self::default() };
    }

    /// Ends the pulls that were not answered in time.
    pub(super) fn expire(&mut self, now: Time) {
        for peer in self.peers.values_mut() {
            if peer.pulling.is_some_and(|until| until <= now) {
                (peer.pulling, peer.announced, peer.next) = (None, None, None);
                peer.silences = (peer.silences + 1).min(SILENCES_MAX);
                peer.pace.lost();
                peer.ask_at = now + pull_pause(peer.silences);
            }
        }
    }

    /// Returns when to say hello.
    pub(super) fn hello_at(&self) -> Time {
        self.hello_at
    }

    /// Notes that a hello was sent: the next one is sent after up to twice the time.
    pub(super) fn said_hello(&mut self, now: Time, random: &mut Random) {
        let period = self.hello_period.max(HELLO_PERIOD_MIN);
        let jitter = random.below(u64::try_from(period.as_nanos() / 5).unwrap_or(1));
        self.hello_at = now + period * 9 / 10 + Duration::from_nanos(jitter);
        self.hello_period = (period * 2).min(HELLO_PERIOD_MAX);
    }

    /// Removes replicas that are not members, unless they may have more than this replica.
    pub(super) fn retain(&mut self, is_member: impl Fn(ReplicaId) -> bool) {
        self.peers.retain(|origin, peer| is_member(*origin) || peer.ahead || peer.pulling.is_some());
    }

    fn peer(&mut self, origin: ReplicaId) -> Option<&mut Peer> {
        if self.peers.len() >= PEERS_MAX && !self.peers.contains_key(&origin) {
            return None;
        }
        Some(self.peers.entry(origin).or_default())
    }

    /// Returns the newest format that a peer reads, if it has reported it.
    pub(super) fn format(&self, origin: ReplicaId) -> Option<u8> {
        self.peers.get(&origin)?.format
    }

    /// Notes the newest format that a peer reads.
    pub(super) fn reads(&mut self, origin: ReplicaId, format: u8) {
        if let Some(peer) = self.peer(origin) {
            peer.format = Some(format);
        }
    }

    /// Notes that a state of a peer was unusable; returns how many were so in a row.
    pub(super) fn dropped(&mut self, origin: ReplicaId) -> u32 {
        let Some(peer) = self.peers.get_mut(&origin) else { return 0 };
        peer.dropped = peer.dropped.saturating_add(1);
        peer.dropped
    }

    /// Notes that a peer has answered with transactions.
    pub(super) fn served(&mut self, origin: ReplicaId) {
        self.peers.entry(origin).and_modify(|peer| peer.dropped = 0);
    }

    /// Notes that a peer may have more than this replica, and may be asked from `ask_at` on.
    pub(super) fn ahead(&mut self, origin: ReplicaId, ask_at: Time) {
        if let Some(peer) = self.peer(origin) {
            peer.ask_at = if peer.ahead { peer.ask_at.min(ask_at) } else { peer.ask_at.max(ask_at) };
            peer.ahead = true;
        }
    }

    /// Notes that a peer has pushed a transaction that does not fit yet: the previous one may be in transit.
    pub(super) fn pushed_early(&mut self, now: Time, origin: ReplicaId) {
        self.ahead(origin, now + PULL_AFTER_PUSH);
    }

    /// Notes an answer. `full` is the size of the answer in bytes if the answer was full. This shows how fast the link
    /// is. An answer of transactions has the `number` of its pull; a repeated answer is ignored.
    pub(super) fn answered(
        &mut self,
        now: Time,
        origin: ReplicaId,
        number: Option<u32>,
        full: Option<usize>,
    ) -> Answered {
        let repeated = Answered { in_time: false, follows: false };
        let Some(peer) = self.peers.get_mut(&origin) else { return repeated };
        let is_to = |asked: &Asked| number.is_none_or(|number| number == asked.number);
        if peer.next.as_ref().is_some_and(is_to) {
            // The previous answer is lost, or this answer ends the exchange.
            (peer.asked, peer.announced) = (peer.next.take(), None);
        } else if peer.pulling.is_some() && !peer.asked.as_ref().is_some_and(is_to) {
            return repeated;
        }
        (peer.ahead, peer.silences) = (false, 0);
        let (in_time, asked, announced) = (peer.pulling.take().is_some(), peer.asked.take(), peer.announced.take());
        // A late answer also shows the delay of the link.
        match (asked, announced, full) {
            (Some(asked), Some(at), Some(bytes)) => peer.pace.timed(bytes, at.since(asked.at), now.since(at)),
            (Some(asked), None, Some(bytes)) => peer.pace.arrived(bytes, now.since(asked.at)),
            (Some(asked), _, None) => peer.pace.heard(now.since(asked.at)),
            (None, ..) => {}
        }
        if let Some(next) = peer.next.take() {
            (peer.asked, peer.pulling) = (Some(next), Some(now + peer.pace.wait()));
        }
        Answered { in_time, follows: asked.is_some_and(|asked| asked.follows) }
    }

    /// Notes that a peer has announced its answer to a pull. Returns the number and size of the next pull, if it is to be sent now. If
    /// another peer is asked as well, both may send the same transactions, so no further pull is sent.
    pub(super) fn announced(&mut self, now: Time, origin: ReplicaId, number: u32) -> Option<Asking> {
        let is_alone = self.pulling() == 1;
        let peer = self.peers.get_mut(&origin).filter(|peer| peer.pulling.is_some() && peer.announced.is_none())?;
        peer.asked.filter(|asked| asked.number == number)?;
        peer.announced = Some(now);
        if !is_alone {
            return None;
        }
        self.number = self.number.wrapping_add(1);
        peer.next = Some(Asked { number: self.number, at: now, follows: true });
        Some(Asking { number: self.number, size: peer.pace.chunk() })
    }

    /// Chooses a peer to ask now; none if the limit of open pulls is reached. A replica that has asked one `sponsor` asks no other sponsor
    /// as long as the first may answer.
    pub(super) fn choose(
        &mut self,
        now: Time,
        pulls_max: usize,
        sponsor: Option<ReplicaId>,
        random: &mut Random,
    ) -> Option<ReplicaId> {
        let may = |peer: &Peer| peer.ahead && peer.pulling.is_none() && peer.ask_at <= now;
        let ready: Vec<ReplicaId> =
            self.peers.iter().filter(|(_, peer)| may(peer)).map(|(origin, _)| *origin).collect();
        let ready = self.one_sponsor(ready, sponsor);
        let choice = random.below(u64::try_from(ready.len()).unwrap_or(0));
        let chosen = usize::try_from(choice).ok().and_then(|choice| ready.get(choice)).copied();
        chosen.filter(|_| self.pulling() < pulls_max)
    }

    /// Notes that a peer is asked; returns the number of the pull, and the number of bytes to ask for.
    pub(super) fn asked(&mut self, now: Time, origin: ReplicaId) -> Asking {
        let Some(peer) = self.peers.get_mut(&origin) else { return Asking::default() };
        self.number = self.number.wrapping_add(1);
        peer.pulling = Some(now + peer.pace.wait());
        let late = peer.asked.filter(|asked| now.since(asked.at) < PULL_ANSWER_LATE_MAX);
        let asked = late.unwrap_or(Asked { number: self.number, at: now, follows: false });
        peer.asked = Some(asked);
        Asking { number: asked.number, size: peer.pace.chunk() }
    }

    fn pulling(&self) -> usize {
        self.peers.values().filter(|peer| peer.pulling.is_some()).count()
    }

    fn one_sponsor(&mut self, mut ready: Vec<ReplicaId>, sponsor: Option<ReplicaId>) -> Vec<ReplicaId> {
        let asked = sponsor.and_then(|sponsor| Some((sponsor, self.peers.get(&sponsor)?)));
        let asked = asked.filter(|(_, peer)| peer.ahead && peer.silences < SPONSOR_SILENCES_MAX);
        let Some((sponsor, until)) = asked.map(|(sponsor, peer)| (sponsor, peer.ask_at)) else { return ready };
        if !ready.contains(&sponsor) {
            self.peers.values_mut().for_each(|peer| peer.ask_at = peer.ask_at.max(until));
        }
        ready.retain(|origin| *origin == sponsor);
        ready
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const A: ReplicaId = ReplicaId::new(1);
    const B: ReplicaId = ReplicaId::new(2);

    fn at(millis: u64) -> Time {
        Time::ZERO + Duration::from_millis(millis)
    }

    #[test]
    fn who_does_not_answer_is_left_alone_for_longer_and_longer() {
        let (mut table, mut random) = (PeerTable::default(), Random::new(1));
        table.ahead(A, Time::ZERO);
        let (mut now, mut pauses) = (Time::ZERO, Vec::new());
        for _ in 0..6 {
            assert_eq!(table.choose(now, 1, None, &mut random), Some(A));
            table.asked(now, A);
            assert_eq!(table.choose(now, 1, None, &mut random), None, "it is asked already");
            let over = table.peers[&A].pulling.unwrap();
            table.expire(over);
            now = table.peers[&A].ask_at;
            pauses.push(now.since(over).as_millis());
        }
        assert_eq!(pauses, [200, 800, 3_200, 12_800, 12_800, 12_800]);
        table.met(at(0));
        assert_eq!(table.choose(at(0), 1, None, &mut random), Some(A), "it has come back");
    }

    #[test]
    fn while_an_answer_is_on_its_way_the_next_one_is_asked_for() {
        let (mut table, answered) = (PeerTable::default(), |follows| Answered { in_time: true, follows });
        table.ahead(A, at(0));
        assert_eq!(table.announced(at(0), A, 1), None, "it was not asked");
        let Asking { number: first, size } = table.asked(at(0), A);
        let Asking { number: second, size: as_much } = table.announced(at(1000), A, first).unwrap();
        assert_eq!((as_much, table.announced(at(1001), A, first)), (size, None), "once");
        // 50 kbit/s.
        assert_eq!(table.answered(at(1655), A, Some(first), Some(4096)), answered(false));
        assert!(!table.answered(at(1656), A, Some(first), Some(4096)).in_time, "it is repeated");
        let Asking { number: third, size } = table.announced(at(2000), A, second).unwrap();
        assert!((7500..=8000).contains(&size), "{size} bytes are on their way for a round trip and a quarter");
        assert_eq!(table.answered(at(2655), A, Some(second), Some(4096)), answered(true));
        assert_eq!(table.answered(at(4000), A, Some(third), None), answered(true), "it is the last one");
        // The first of the two answers is lost.
        table.ahead(A, at(5000));
        let first = table.asked(at(5000), A).number;
        let second = table.announced(at(6000), A, first).unwrap().number;
        assert_eq!(table.answered(at(7000), A, Some(second), None), answered(true));
        assert_eq!(table.pulling(), 0);
        // With a new link, everything in transit is lost.
        table.ahead(A, at(8000));
        let first = table.asked(at(8000), A).number;
        table.announced(at(8100), A, first);
        table.met(at(8200));
        assert_eq!(table.choose(at(8200), 1, None, &mut Random::new(1)), Some(A));
    }

    #[test]
    fn no_more_peers_are_asked_at_a_time_than_may_be() {
        let (mut table, mut random) = (PeerTable::default(), Random::new(1));
        (1..=3).for_each(|peer| table.ahead(ReplicaId::new(peer), Time::ZERO));
        for _ in 0..2 {
            let peer = table.choose(at(1), 2, None, &mut random).unwrap();
            table.asked(at(1), peer);
        }
        assert_eq!(table.choose(at(1), 2, None, &mut random), None);
        assert!(table.deadline(2) > at(1) || table.hello_at == table.deadline(2));
    }

    #[test]
    fn one_sponsor_is_asked_until_it_is_silent() {
        let (mut table, mut random) = (PeerTable::default(), Random::new(1));
        table.ahead(A, Time::ZERO);
        table.ahead(B, Time::ZERO);
        let mut now = Time::ZERO;
        for _ in 0..SPONSOR_SILENCES_MAX {
            assert_eq!(table.choose(now, 1, Some(A), &mut random), Some(A));
            table.asked(now, A);
            now = table.peers[&A].pulling.unwrap();
            table.expire(now);
            assert_eq!(
                table.choose(now, 1, Some(A), &mut random),
                None.or(table.peers[&A].silences.eq(&3).then_some(B))
            );
            now = table.peers[&A].ask_at;
        }
    }

    #[test]
    fn hellos_become_rare_while_nothing_changes() {
        let (mut table, mut random) = (PeerTable::default(), Random::new(1));
        let mut gaps = Vec::new();
        let mut now = Time::ZERO;
        for _ in 0..6 {
            table.said_hello(now, &mut random);
            gaps.push(table.hello_at.since(now));
            now = table.hello_at;
        }
        assert!(gaps[0] <= HELLO_PERIOD_MIN * 11 / 10 && gaps[5] >= HELLO_PERIOD_MAX * 9 / 10, "{gaps:?}");
        table.changed(now);
        assert!(table.deadline(2) <= now + HELLO_PERIOD_MIN);
    }

    #[test]
    fn strangers_are_forgotten_and_do_not_use_up_all_places() {
        let mut table = PeerTable::default();
        for number in 0..2 * PEERS_MAX {
            table.reads(ReplicaId::new(10 + number as u64), 1);
        }
        assert_eq!(table.peers.len(), PEERS_MAX);
        table.retain(|_| false);
        table.ahead(A, Time::ZERO);
        assert_eq!(table.peers.keys().copied().collect::<Vec<_>>(), [A]);
    }
}
