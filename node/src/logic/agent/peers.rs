//! The other nodes: their presence, the links to them, and the ways over a third node.
//!
//! Each name has the links to its last boots. The link to the holder of the name comes last, and is the only one in use.

use super::namesakes::Rivalry;
use crate::logic::absence::Absence;
use crate::logic::effect::{Effect, Out, earliest};
use crate::logic::link::{Frame, Link, Received};
use crate::logic::nameserver::{NameServer, RelayedPong, Round};
use crate::logic::protocol::{Deployment, Message, Relay, Relayed, ToCoordinator};
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// For how many boots of one name links are kept.
const LINKS_MAX: usize = 4;

/// The other nodes.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Peers {
    /// The name and the boot of this node.
    pub(super) host: String,
    pub(super) boot: u64,
    pub(super) names: NameServer,
    pub(super) absence: Absence,
    links: BTreeMap<String, Vec<Link>>,
    /// The holder of each name, as it was reported last.
    holders: BTreeMap<String, u64>,
    /// The hosts that get the beats of this node, as they were ordered last.
    beaten: BTreeSet<String>,
    pub(super) rivalry: Rivalry,
}

/// The way of a frame to another node.
#[derive(Debug)]
pub(super) enum Way {
    /// Directly.
    Direct(Effect),
    /// Inside a message to a third node.
    Over { via: String, message: Message },
}

/// The consequence of a relayed message.
#[derive(Debug)]
pub(super) enum FromRelay {
    /// A message to another node.
    Send { to: String, message: Message },
    /// A frame for this node.
    Frame(Frame),
}

impl Peers {
    /// Returns the peers of a node that knows no other yet; `open` are its open ends.
    pub(super) fn new(host: &str, boot: u64, open: Vec<(Deployment, Vec<String>)>, now: Time) -> Self {
        Self {
            host: host.to_owned(),
            boot,
            names: NameServer::new(host, boot, now),
            absence: Absence::new(host, open, now),
            links: BTreeMap::new(),
            holders: BTreeMap::new(),
            beaten: BTreeSet::new(),
            rivalry: Rivalry::default(),
        }
    }

    /// Returns whether a host is another one, and does not answer.
    pub(super) fn is_away(&self, host: &str) -> bool {
        !self.reaches(host)
    }

    /// Returns whether a host is this one, or answers.
    pub(super) fn reaches(&self, host: &str) -> bool {
        host == self.host || self.names.reaches(host)
    }

    /// Returns the boot that holds each name.
    pub(super) const fn holders(&self) -> &BTreeMap<String, u64> {
        &self.holders
    }

    /// Returns the hosts that get the beats of this node.
    pub(super) const fn beaten(&self) -> &BTreeSet<String> {
        &self.beaten
    }

    /// Attends to the hosts that a deployment here depends on, and to the wanted ones.
    pub(super) fn attend<'a>(&mut self, now: Time, needed: impl Iterator<Item = &'a str>) {
        let wanted = self.absence.wanted().filter(|host| !self.names.reaches(host)).map(str::to_owned);
        let close: BTreeSet<String> =
            needed.map(str::to_owned).chain(wanted).filter(|host| *host != self.host).collect();
        if *self.names.close() != close {
            self.names.keep_close(now, close);
        }
    }

    /// Has the driver know which boot holds each name, if that has changed.
    pub(super) fn tell_holders(&mut self, out: &mut Out<'_>) {
        let holders = self.names.holders();
        if holders != self.holders {
            self.holders.clone_from(&holders);
            out.effects.push(Effect::Holders(holders));
        }
    }

    /// Has the driver send the beats of this node to the hosts that matter now.
    pub(super) fn beat(&mut self, out: &mut Out<'_>) {
        let beaten = self.names.beaten();
        if beaten != self.beaten {
            self.beaten.clone_from(&beaten);
            out.effects.push(Effect::Beat(beaten));
        }
    }

    /// Takes note that a node has come, or is back.
    pub(super) fn appeared(&mut self, host: &str, boot: u64, now: Time) {
        let links = self.links.entry(host.to_owned()).or_default();
        // The link to a boot that is back continues: that boot has not forgotten the link either.
        let known = links.iter().position(|link| link.boot_peer() == boot).map(|at| links.remove(at));
        let mut link = known.unwrap_or_else(|| Link::new(now, &self.host, self.boot, boot));
        link.reached(now);
        links.push(link);
        links.drain(..links.len().saturating_sub(LINKS_MAX));
        self.absence.appeared(now, host);
    }

    /// Takes note that a node is missing since then.
    pub(super) fn missing(&mut self, host: &str, since: Time) {
        self.absence.missing(host, self.names.heard(host).unwrap_or(since));
    }

    /// Takes note that a node is lost.
    pub(super) fn lost(&mut self, host: &str, now: Time) {
        self.absence.lost(host, self.names.heard(host).unwrap_or(now));
        self.links.get_mut(host).into_iter().flatten().for_each(Link::abandon);
    }

    /// Takes a frame of the node that holds its name. A node that is not listed is asked first, and sends the frame
    /// again.
    pub(super) fn receive(&mut self, now: Time, frame: Frame) -> Option<Received> {
        let (from, boot) = (frame.from.clone(), frame.boot);
        self.names.heard_of(now, &from, boot);
        if !self.names.knows(&from) || self.names.holder(&from) != Some(boot) {
            return None;
        }
        let link = self.links.get_mut(&from).and_then(|links| links.last_mut())?;
        Some(link.receive(now, frame))
    }

    /// Gives a message to the link to another node; nothing if the node is not known and the message is not final, or too
    /// many messages are unacknowledged.
    pub(super) fn send(&mut self, now: Time, to: &str, message: Message) -> Option<Frame> {
        let is_sent = self.names.knows(to) || message.is_final();
        let link = self.links.get_mut(to).and_then(|links| links.last_mut());
        link.filter(|_| is_sent).and_then(|link| link.send(now, message))
    }

    /// Returns the frames that are to be sent again now, each with the node that it is for.
    pub(super) fn resend(&mut self, now: Time) -> Vec<(String, Frame)> {
        let resent = self.links.iter_mut().flat_map(|(host, links)| {
            links.iter_mut().flat_map(|link| link.resend(now)).map(|frame| (host.clone(), frame))
        });
        resent.collect()
    }

    /// Returns when a link wants to send again.
    pub(super) fn links_deadline(&self) -> Option<Time> {
        self.links.values().flatten().map(Link::deadline).fold(None, earliest)
    }

    /// Returns the nodes with links that can be reached.
    pub(super) fn linked(&self) -> Vec<String> {
        self.links.keys().filter(|host| self.names.reaches(host)).cloned().collect()
    }

    /// Whether every node that can be reached has acknowledged everything.
    pub(super) fn is_heard(&self) -> bool {
        let is_idle = |links: &Vec<Link>| links.last().is_none_or(|link| link.deadline().is_none());
        self.links.iter().all(|(host, links)| is_idle(links) || !self.names.reaches(host))
    }

    /// Takes the report of a host about a deployment that is over here.
    pub(super) fn confirm(&mut self, deployment: &Deployment, message: &ToCoordinator, from: &str) {
        if *message == ToCoordinator::Released {
            self.absence.confirmed(deployment, from);
        } else if *message == ToCoordinator::Unconfirmed {
            self.absence.unable(deployment, from);
        }
    }

    /// Asks other nodes whether they are present. Returns the questions for silent nodes, each with the node that passes it on.
    pub(super) fn ask(
        &self,
        Round { number, only, shows, through }: Round,
        out: &mut Out<'_>,
    ) -> Vec<(String, Message)> {
        out.effects.push(Effect::Ping { round: number, only, shows });
        let what = Relayed::Ping { boot: self.boot, round: number };
        through.into_iter().map(|(via, host)| (via, self.relayed(host, what.clone()))).collect()
    }

    /// Returns the way of a frame to another node.
    pub(super) fn way(&self, to: &str, frame: Frame) -> Way {
        let Some(via) = self.names.detour(to).map(str::to_owned) else {
            return Way::Direct(Effect::Transmit { to: to.to_owned(), frame: Box::new(frame) });
        };
        let Frame { from, boot, boot_peer, ends, acknowledged, message } = frame;
        let message = message.map(|(number, message)| (number, Box::new(message)));
        let what = Relayed::Frame { boot, boot_peer, ends, acknowledged, message };
        let relay = Relay { from, to: to.to_owned(), what, proof: Vec::new() };
        Way::Over { via, message: Message::relay(relay) }
    }

    fn relayed(&self, to: String, what: Relayed) -> Message {
        Message::relay(Relay { from: self.host.clone(), to, what, proof: Vec::new() })
    }

    /// Takes a message that `via` has sent for another node, or has passed on.
    pub(super) fn relay(&mut self, now: Time, relay: Relay, via: &str) -> Option<FromRelay> {
        if relay.to != self.host {
            // A message passes over one node, not over several: otherwise it could circulate for ever.
            let passes = relay.from == via && self.names.reaches_directly(&relay.to);
            return passes.then(|| FromRelay::Send { to: relay.to.clone(), message: Message::relay(relay) });
        }
        let Relay { from, what, .. } = relay;
        match what {
            Relayed::Ping { boot, round } => {
                self.names.heard_of(now, &from, boot);
                let holder = self.names.holder(&from).filter(|_| self.names.knows(&from));
                let what = Relayed::Pong { boot: self.boot, to_boot: boot, round, holder };
                Some(FromRelay::Send { to: via.to_owned(), message: self.relayed(from, what) })
            }
            Relayed::Pong { boot, to_boot, round, holder } => {
                self.names.answered_through(now, RelayedPong { from: &from, boot, to_boot, round, holder, via });
                None
            }
            Relayed::Frame { boot, boot_peer, ends, acknowledged, message } => {
                let message = message.map(|(number, message)| (number, *message));
                Some(FromRelay::Frame(Frame { from, boot, boot_peer, ends, acknowledged, message }))
            }
        }
    }
}
