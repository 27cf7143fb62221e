//! Chooses the nodes that a node asks each second, and those it asks seldom.
//!
//! An idle network is quiet: a node asks all others only each [`QUIET_EVERY`], and expects nothing of them in between.
//! Each second it asks the nodes that matter now: the *close* ones, which a deployment here depends on, the doubtful
//! ones, the newly arrived ones, and all nodes while a user looks. The silence of a host counts from when it was asked.
//! So a host that becomes close is missing as soon as if it had been close all the time, and a host at rest is missing
//! at the latest [`SILENCE_MAX`](super::SILENCE_MAX) after the next question to all. A lost link removes the token as
//! well, so its host is asked at once.

use super::{ASK_EVERY, ASKED_MAX, Boot, NameServer, ROUNDS_MAX, Round};
use comms::logic::time::Time;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// How often all others are asked. An idle link may carry 52 bytes a second each way, over IPv6: a message each 7.5 s
/// and the TCP acknowledgements are 23, questions and answers 10.
pub(in crate::logic) const QUIET_EVERY: Duration = Duration::from_secs(60);
/// For how long a new host is asked each second, and for how long a node that has just come asks all hosts each second.
pub(in crate::logic) const NEW_FOR: Duration = Duration::from_secs(5);
/// For how long all nodes are asked each second after a user has asked this node something.
const WATCHED_FOR: Duration = Duration::from_secs(10);
/// A node of a team proves its identity in one of this many questions to all.
const SHOWN_TO_ALL: u64 = 4;
/// A node of a team proves its identity in one of this many other rounds.
const SHOWN: u64 = 16;

impl NameServer {
    /// Takes note of the hosts that something here depends on. A host that is new among them is asked at once.
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

    /// Returns the hosts that are to hear of this node all the time, so that a cut is noticed soon: the close hosts, and the hosts that
    /// pass messages on to others.
    pub fn beaten(&self) -> BTreeSet<String> {
        self.close.iter().cloned().chain(self.helpers().into_iter().map(str::to_owned)).collect()
    }

    /// Takes note that a user looks: the view is kept up to date.
    pub fn watch(&mut self, now: Time) {
        self.watched_until = now + WATCHED_FOR;
    }

    /// Returns the round to ask others in, if it is time.
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

    /// Returns when the nodes that are asked each second are asked next, if there are any.
    pub(super) fn next_turn(&self) -> Option<Time> {
        let helpers = self.helpers();
        let is_any =
            !self.close.is_empty() || self.peers.keys().any(|host| self.is_attended(self.seen, host, &helpers));
        is_any.then_some(self.asked.close_at)
    }

    /// After an answer nothing is expected of a host that is asked seldom.
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
        // Includes close nodes that were never heard.
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
        // An earlier boot does not come back while a later one is there.
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
