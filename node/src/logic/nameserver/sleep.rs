//! A node that was away: killed and started again, or suspended. Nothing was looked at meanwhile, which is no silence of others.

use super::{ASK_EVERY, NameServer, SILENCE_MAX};
use comms::logic::time::Time;
use std::time::Duration;

impl NameServer {
    /// Returns whether this node was away just now, killed or suspended, and for so long since a host has answered it that the host may
    /// have missed it. True until [`NameServer::tick`].
    pub fn has_slept(&self, now: Time, host: &str) -> bool {
        let slept = self.slept(now);
        slept > ASK_EVERY && self.held(host).is_some_and(|life| life.slept + slept > SILENCE_MAX)
    }

    fn slept(&self, now: Time) -> Duration {
        now.since(self.due.max(self.seen + ASK_EVERY))
    }

    /// Shifts all times by the span that this node has slept: that is no silence of others. Who has slept for long asks all.
    pub(super) fn make_up(&mut self, now: Time) {
        let slept = self.slept(now);
        self.seen = now;
        if slept > SILENCE_MAX {
            self.ask_at = now;
        }
        if slept > Duration::ZERO {
            let lives = self.peers.values_mut().flat_map(|peer| peer.lives.values_mut());
            for life in lives {
                (life.heard, life.slept) = (life.heard + slept, life.slept + slept);
                life.owes = life.owes.map(|since| since + slept);
                life.detour.iter_mut().for_each(|detour| detour.heard = detour.heard + slept);
                life.doubted = life.doubted.map(|(since, until)| (since + slept, until + slept));
            }
        }
    }
}
