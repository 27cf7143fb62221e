//! The agent's view of other nodes: their presence, and the messages to them.

use super::Agent;
use crate::logic::effect::{Effect, Out};
use crate::logic::link::{Frame, Link, Received};
use crate::logic::nameserver::Change;
use crate::logic::protocol::{Body, Deployment, Message, ToCoordinator};

/// For how many boots of one name links are kept.
const LINKS_MAX: usize = 4;

impl Agent {
    /// Determines which nodes are there now, and reports the changes to everything that they concern.
    pub(super) fn look_around(&mut self, out: &mut Out<'_>) {
        self.attend(out.now);
        let (changes, round) = self.peers.names.tick(out.now);
        for change in changes {
            match &change {
                Change::Appeared { host, boot, replaces, .. } => self.appeared(host, *boot, *replaces, out),
                Change::Detour { host, boot, .. } => self.appeared(host, *boot, false, out),
                Change::Missing { host, since, .. } => {
                    self.peers.absence.missing(host, self.peers.names.heard(host).unwrap_or(*since));
                    let participants = self.participants.values_mut();
                    participants.for_each(|participant| participant.host_missing(host, *since, out));
                }
                Change::Lost { host } => self.host_lost(host, out),
                Change::Namesake { .. } => self.greet(out),
                Change::Refused { .. } | Change::Twice { .. } => {}
            }
            out.effects.push(Effect::Peer(change));
        }
        let holders = self.peers.names.holders();
        if holders != self.peers.holders {
            self.peers.holders.clone_from(&holders);
            out.effects.push(Effect::Holders(holders));
        }
        self.beat(out);
        if let Some(round) = round {
            self.ask(round, out);
            self.greet(out);
        }
    }

    fn appeared(&mut self, host: &str, boot: u64, replaces: bool, out: &mut Out<'_>) {
        if replaces {
            // Another boot has forgotten everything: for deployments that is the loss of the host.
            self.host_lost(host, out);
        }
        let links = self.peers.links.entry(host.to_owned()).or_default();
        // The link to a boot that is back continues: that boot has not forgotten the link either.
        let known = links.iter().position(|link| link.boot_peer() == boot).map(|at| links.remove(at));
        let mut link = known.unwrap_or_else(|| Link::new(out.now, &self.identity.host, self.identity.boot, boot));
        link.reached(out.now);
        links.push(link);
        links.drain(..links.len().saturating_sub(LINKS_MAX));
        self.peers.absence.appeared(out.now, host);
        self.tell_tombstones(host, out);
        self.parts_back(host, out);
        self.inquire_again(host, out);
    }

    /// Tells everything that runs that a host is lost.
    fn parts_lost(&mut self, host: &str, out: &mut Out<'_>) {
        self.coordinators.values_mut().for_each(|coordinator| coordinator.host_lost(host, out));
        self.participants.values_mut().for_each(|participant| participant.host_lost(host, out));
    }

    /// Tells everything that runs that a host is there again.
    fn parts_back(&mut self, host: &str, out: &mut Out<'_>) {
        self.coordinators.values_mut().for_each(|coordinator| coordinator.host_back(host, out));
        self.participants.values_mut().for_each(|participant| participant.host_back(host, out));
    }

    pub(super) fn host_lost(&mut self, host: &str, out: &mut Out<'_>) {
        self.peers.absence.lost(host, self.peers.names.heard(host).unwrap_or(out.now));
        self.forget_orders(host);
        self.peers.links.get_mut(host).into_iter().flatten().for_each(Link::abandon);
        self.parts_lost(host, out);
    }

    /// Takes a frame of the node that holds its name. A node that is not listed is asked first, and sends the frame
    /// again.
    pub(super) fn frame(&mut self, frame: Frame, out: &mut Out<'_>) {
        let (from, boot) = (frame.from.clone(), frame.boot);
        self.peers.names.heard_of(out.now, &from, boot);
        if !self.peers.names.knows(&from) || self.peers.names.holder(&from) != Some(boot) {
            return;
        }
        let Some(link) = self.peers.links.get_mut(&from).and_then(|links| links.last_mut()) else { return };
        let Received { message, answer, is_anew } = link.receive(out.now, frame);
        if let Some(frame) = answer {
            self.send_frame(&from, frame, out);
        }
        if is_anew {
            // The other node counts this node as lost, and its parts here as over.
            self.parts_lost(&from, out);
            self.parts_back(&from, out);
        }
        if let Some(message) = message {
            self.deliver(message, &from, out);
        }
    }

    /// Sends to another node. A message that cannot be sent is answered as a loss, so that its sender does not wait for
    /// ever. Final messages are kept for a lost node, which may not know that it is lost.
    pub(super) fn transmit(&mut self, to: &str, message: Message, out: &mut Out<'_>) {
        let is_known = self.peers.names.knows(to);
        let link = self.peers.links.get_mut(to).and_then(|links| links.last_mut());
        match link.filter(|_| is_known || message.is_final()).and_then(|link| link.send(out.now, message.clone())) {
            Some(frame) => {
                self.send_frame(to, frame, out);
                if is_known {
                    return;
                }
            }
            None if is_known => {
                // So many messages are unacknowledged that the node counts as lost.
                self.peers.names.lose(out.now, to);
                self.host_lost(to, out);
            }
            None => {}
        }
        if let Message { deployment, body: Body::Participant(message) } = message {
            self.answer_for_lost(to, &deployment, message, out);
        }
    }

    /// Takes the report of a host about a deployment that is over here.
    pub(super) fn confirm(&mut self, deployment: &Deployment, message: &ToCoordinator, from: &str) {
        if *message == ToCoordinator::Released {
            self.peers.absence.confirmed(deployment, from);
        } else if *message == ToCoordinator::Unconfirmed {
            self.peers.absence.unable(deployment, from);
        }
    }
}
