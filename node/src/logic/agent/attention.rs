//! The hosts that this node attends to: those that a deployment here depends on, the wanted ones, and all of them while
//! a user looks.

use super::Agent;
use crate::logic::effect::{Effect, Out};
use comms::logic::time::Time;
use std::collections::BTreeSet;

impl Agent {
    /// Tells the table of hosts which of them matter now.
    pub(super) fn attend(&mut self, now: Time) {
        if !self.callers.listeners.is_empty() {
            self.peers.names.watch(now);
        }
        let own = self.identity.host.as_str();
        let homes = self.coordinators.values().flat_map(|coordinator| coordinator.hosts());
        let parts = self.participants.values().flat_map(|participant| participant.relevant_hosts());
        let awaited = self.pending.awaiting.iter().flat_map(|awaiting| &awaiting.plan.hosts);
        let wanted = self.peers.absence.wanted().filter(|host| !self.peers.names.reaches(host));
        let close = homes.chain(parts).chain(awaited).map(String::as_str).chain(wanted);
        let close: BTreeSet<&str> = close.filter(|host| *host != own).collect();
        if !self.peers.names.close().iter().map(String::as_str).eq(close.iter().copied()) {
            let close = close.into_iter().map(str::to_owned).collect();
            self.peers.names.keep_close(now, close);
        }
    }

    /// Has the driver send the beats of this node to the hosts that matter now.
    pub(super) fn beat(&mut self, out: &mut Out<'_>) {
        let beaten = self.peers.names.beaten();
        if beaten != self.peers.beaten {
            self.peers.beaten.clone_from(&beaten);
            out.effects.push(Effect::Beat(beaten));
        }
    }
}
