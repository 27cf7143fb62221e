//! The network of a [`World`]: frames that are lost, hosts that are cut off, and questions about presence.

use super::world::{Coming, World};
use comms::logic::time::Time;
use node::logic::agent::Input;
use node::logic::link::Frame;
use node::logic::protocol::Pong;
use std::collections::{BTreeMap, BTreeSet};

impl World {
    /// Passes a frame on, unless it is lost on the way.
    pub(super) fn transmit(&mut self, host: &str, to: &str, frame: Box<Frame>) {
        self.transmitted += 1;
        let is_unlucky = self.loses_by_chance.as_mut().is_some_and(|(draw, frames)| draw.below(*frames) == 0);
        let is_lost = is_unlucky || self.loses_one_in.is_some_and(|frames| self.transmitted.is_multiple_of(frames));
        if !is_lost && self.passes(host, to) {
            self.at(1, to, Coming::Input(Input::Frame(frame)));
        }
    }

    /// Whether the network takes anything from one host to another.
    fn passes(&self, from: &str, to: &str) -> bool {
        let is_cut = self.cut.contains(from) || self.cut.contains(to);
        !is_cut && !self.one_way.contains(&(from.to_owned(), to.to_owned()))
    }

    /// Asks every other host, which answers at once where the network lets it.
    pub(super) fn ping(&mut self, host: &str, round: u64, only: Option<&BTreeSet<String>>) {
        self.rounds.insert(host.to_owned(), round);
        let boots: BTreeMap<String, u64> = self.boots.clone();
        let to_boot = boots[host];
        for (from, &boot) in boots.iter().filter(|(from, _)| *from != host) {
            let is_asked = only.is_none_or(|only| only.contains(from));
            if !is_asked || self.down.contains_key(from) || !self.passes(host, from) {
                continue;
            }
            self.at(1, from, Coming::Input(Input::Ping { host: host.into(), boot: to_boot }));
            if !self.passes(from, host) {
                continue;
            }
            let holder = self.holders.get(from).and_then(|holders| holders.get(host)).copied();
            let (up, place, session) = (self.now.since(Time::ZERO), from.clone(), from.clone());
            let pong = Pong { from: from.clone(), boot, to_boot, round, up, place, holder, session, origin: 0 };
            self.at(2, host, Coming::Input(Input::Pong(Box::new(pong))));
        }
    }
}
