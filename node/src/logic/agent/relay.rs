//! Messages through a third node, for two nodes that do not reach each other.

use super::Agent;
use crate::logic::effect::{Effect, Out};
use crate::logic::link::Frame;
use crate::logic::nameserver::{RelayedPong, Round};
use crate::logic::protocol::{Message, Relay, Relayed};

impl Agent {
    /// Asks other nodes whether they are there. Silent nodes are also asked through others.
    pub(super) fn ask(&mut self, Round { number, only, shows, through }: Round, out: &mut Out<'_>) {
        out.effects.push(Effect::Ping { round: number, only, shows });
        for (via, host) in through {
            let what = Relayed::Ping { boot: self.identity.boot, round: number };
            let relay = Relay { from: self.identity.host.clone(), to: host, what, proof: Vec::new() };
            self.transmit(&via, Message::relay(relay), out);
        }
    }

    /// Sends a frame to another node, through a third node if necessary.
    pub(super) fn send_frame(&mut self, to: &str, frame: Frame, out: &mut Out<'_>) {
        let Some(via) = self.peers.names.detour(to).map(str::to_owned) else {
            return out.effects.push(Effect::Transmit { to: to.to_owned(), frame: Box::new(frame) });
        };
        let Frame { from, boot, boot_peer, ends, acknowledged, message } = frame;
        let message = message.map(|(number, message)| (number, Box::new(message)));
        let what = Relayed::Frame { boot, boot_peer, ends, acknowledged, message };
        self.transmit(&via, Message::relay(Relay { from, to: to.to_owned(), what, proof: Vec::new() }), out);
    }

    /// Takes a message that `via` has sent for another node, or has passed on.
    pub(super) fn relay(&mut self, relay: Relay, via: &str, out: &mut Out<'_>) {
        if relay.to != self.identity.host {
            // A message passes over one node, not over several: otherwise it could circulate for ever.
            if relay.from == via && self.peers.names.reaches_directly(&relay.to) {
                let to = relay.to.clone();
                self.transmit(&to, Message::relay(relay), out);
            }
            return;
        }
        let Relay { from, what, .. } = relay;
        match what {
            Relayed::Ping { boot, round } => {
                self.peers.names.heard_of(out.now, &from, boot);
                let holder = self.peers.names.holder(&from).filter(|_| self.peers.names.knows(&from));
                let what = Relayed::Pong { boot: self.identity.boot, to_boot: boot, round, holder };
                let answer = Relay { from: self.identity.host.clone(), to: from, what, proof: Vec::new() };
                self.transmit(via, Message::relay(answer), out);
            }
            Relayed::Pong { boot, to_boot, round, holder } => {
                let pong = RelayedPong { from: &from, boot, to_boot, round, holder, via };
                self.peers.names.answered_through(out.now, pong);
            }
            Relayed::Frame { boot, boot_peer, ends, acknowledged, message } => {
                let message = message.map(|(number, message)| (number, *message));
                self.frame(Frame { from, boot, boot_peer, ends, acknowledged, message }, out);
            }
        }
    }
}
