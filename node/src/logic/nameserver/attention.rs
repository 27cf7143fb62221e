//! Chooses which nodes are asked each second, and which are asked seldom.
//!
//! An idle network is quiet: a node asks all others only every [`QUIET_EVERY`], and expects no answer from them in
//! between. It asks the nodes that matter now each second. These are the *close* nodes, on which a deployment here
//! depends; doubtful nodes; nodes that have just come; and all nodes while a user looks. The silence of a host is
//! measured from the question to it. So a host that becomes close is missing as soon as if it had always been close.
//! A host that is seldom asked is missing at the latest [`SILENCE_MAX`](super::SILENCE_MAX) after the next question
//! to all. If a link is lost, its token vanishes as well, so its host is asked at once.

use super::{ASK_EVERY, ASKED_MAX, Boot, NameServer, ROUNDS_MAX, Round};
use comms::logic::time::Time;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// How often all other nodes are asked. An idle link may carry 52 bytes a second in each direction, over IPv6. A
/// message every 7.5 s and the TCP acknowledgements take 23 of them, questions and answers 10.
pub(in crate::logic) const QUIET_EVERY: Duration = Duration::from_secs(60);
/// How long a new host is asked each second, and how long a new node asks all hosts each second.
pub(in crate::logic) const NEW_FOR: Duration = Duration::from_secs(5);
/// How long all nodes are asked each second after a user has asked this node a question.
const WATCHED_FOR: Duration = Duration::from_secs(10);
/// In one of this many questions to all, a node of a team proves its identity.
const SHOWN_TO_ALL: u64 = 4;
/// In one of this many other rounds, a node of a team proves its identity.
const SHOWN: u64 = 16;

impl NameServer {
    /// Notes the hosts that something here depends on. A host that is new among them is asked soon.
    pub fn keep_close(&mut self, now: Time, hosts: BTreeSet<String>) {
        let before = std::mem::replace(&mut self.close, hosts);
        for host in self.close.difference(&before).cloned().collect::<Vec<_>>() {
            self.ask_soon(now, &host);
        }
    }

    /// Returns the hosts that something here depends on.
    pub fn close(&self) -> &BTreeSet<String> {
        &self.close
    }

    /// Returns the hosts that get beats of this node, so that they notice a cut soon: the close hosts, and the hosts
    /// that pass messages on to others.
    pub fn beaten(&self) -> BTreeSet<String> {
        self.close.iter().cloned().chain(self.helpers().into_iter().map(str::to_owned)).collect()
    }

    /// Notes that a user looks. From now on, the state of all nodes is kept up to date.
    pub fn watch(&mut self, now: Time) {
        self.watched_until = now + WATCHED_FOR;
    }

    /// Returns the next round of questions, if it is due.
    pub(super) fn next_round(&mut self, now: Time) -> Option<Round> {
        let attended = if self.asked.close_at <= now { self.attended(now) } else { BTreeSet::new() };
        let is_turn = !attended.is_empty();
        let is_some_due = !self.asked.some.is_empty() && self.asked.some_at <= now;
        let is_for_all = self.asked.all_at <= now || attended.len() > ASKED_MAX;
        if !is_for_all && !is_turn && !is_some_due {
            return None;
        }
        self.asked.round += 1;
        self.asked.rounds.push_back((self.asked.round, now));
        self.asked.rounds.drain(..self.asked.rounds.len().saturating_sub(ROUNDS_MAX));
        let some = std::mem::take(&mut self.asked.some);
        let (mut shows, mut through) = (!some.is_empty(), self.asked_through(now));
        if is_for_all || is_turn {
            self.asked.close_at = now + ASK_EVERY;
        }
        let only = if is_for_all {
            let is_new = now.since(self.started) < NEW_FOR;
            self.asked.all_at = now + if is_new { ASK_EVERY } else { QUIET_EVERY };
            self.asked.all_count += 1;
            shows |= self.asked.all_count.is_multiple_of(SHOWN_TO_ALL);
            None
        } else {
            let only = &some | &attended;
            shows |= self.asked.round.is_multiple_of(SHOWN);
            through.retain(|(_, host)| only.contains(host));
            Some(only)
        };
        let asked = self.peers.iter_mut().filter(|(host, _)| only.as_ref().is_none_or(|only| only.contains(*host)));
        for life in asked.flat_map(|(_, peer)| peer.lives.values_mut()) {
            life.owes.get_or_insert(now);
        }
        Some(Round { number: self.asked.round, only, shows, through })
    }

    /// Returns when the nodes that are asked each second are asked next; nothing if there are no such nodes.
    pub(super) fn next_turn(&self) -> Option<Time> {
        let helpers = self.helpers();
        let is_any =
            !self.close.is_empty() || self.peers.keys().any(|host| self.is_attended(self.seen, host, &helpers));
        is_any.then_some(self.asked.close_at)
    }

    /// Notes an answer. If the host is seldom asked, no further answer is expected from it.
    pub(super) fn rest(&mut self, now: Time, host: &str, boot: u64) {
        let is_of_concern = self.is_of_concern(now, host, &self.helpers());
        if let Some(life) = self.life_mut(host, boot) {
            life.owes = is_of_concern.then_some(now);
        }
    }

    /// Returns the nodes that are asked each second.
    fn attended(&self, now: Time) -> BTreeSet<String> {
        let helpers = self.helpers();
        let known = self.peers.keys().filter(|host| self.is_attended(now, host, &helpers));
        // This includes close nodes that have never sent a message.
        known.chain(&self.close).cloned().collect()
    }

    fn is_attended(&self, now: Time, host: &str, helpers: &BTreeSet<&str>) -> bool {
        let owes = |life: &Boot| life.is_there() && life.owes.is_some();
        self.peers.get(host).is_some_and(|peer| peer.lives.values().any(owes)) || self.is_of_concern(now, host, helpers)
    }

    /// Returns whether a host matters now.
    fn is_of_concern(&self, now: Time, host: &str, helpers: &BTreeSet<&str>) -> bool {
        let of_life = |life: &Boot| {
            let is_new = life.there_since + NEW_FOR > now;
            is_new || life.doubted.is_some() || life.detour.is_some() || life.is_rival()
        };
        // If a later boot is present, an earlier one does not return.
        let of_lives = |lives: &BTreeMap<u64, Boot>| {
            let mut there = lives.values().filter(|life| life.is_there()).peekable();
            there.peek().is_none() || there.any(of_life)
        };
        let is_doubtful = || self.peers.get(host).is_some_and(|peer| of_lives(&peer.lives));
        self.watched_until > now
            || host == self.host
            || self.close.contains(host)
            || helpers.contains(host)
            || is_doubtful()
    }

    /// Returns the nodes that pass messages on to others.
    fn helpers(&self) -> BTreeSet<&str> {
        let lives = self.peers.values().flat_map(|peer| peer.lives.values());
        lives.filter_map(|life| life.detour.as_ref()).map(|detour| detour.via()).collect()
    }
}
