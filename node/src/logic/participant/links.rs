//! The links of this host's programs: made before GO, opened and closed by supervisors, and made again for a program that
//! was started again.
//!
//! Such a program is elsewhere than before. It dials whom it needs as it did at first; who dials it is told where it is now,
//! on its own host by its node, elsewhere by a message from here to there. Its home has no part in that. What others say
//! about their programs and what the home says about all of them come on different ways: the word of a program's own host
//! counts.

use super::{Participant, Phase};
use crate::logic::effect::Out;
use crate::logic::executer::leaf_host;
use crate::logic::instance::Instance;
use crate::logic::protocol::{LeafFacts, ToParticipant};
use crate::logic::wiring::{calls, dialers, links, partnered, relink, shapes};
use comms::logic::control::Order;
use comms::logic::switch::{Flip, Opening};
use language::plan::LeafKind;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Wires that are being opened or closed for a supervisor.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Switching {
    /// Its group, and where that is supervised.
    group: u32,
    host: String,
    /// Its number for this.
    generation: u64,
    /// Producers that have not confirmed yet.
    waiting: BTreeSet<u32>,
}

/// The origin of an order to open or close wires: group, generation and host.
pub(super) type Asked<'a> = (u32, u64, &'a str);

impl Participant {
    pub(super) fn connect(&mut self, facts: Vec<LeafFacts>, machines: Vec<String>, out: &mut Out<'_>) {
        if self.phase != Phase::Preparing {
            return;
        }
        self.phase = Phase::Connecting;
        self.registrations.machines = machines;
        for facts in facts {
            self.registrations.facts.entry(facts.leaf).or_insert(facts);
        }
        if self.rejoining {
            self.registrations
                .facts
                .values()
                .filter(|facts| self.is_own(facts))
                .for_each(|facts| self.tell_where(facts, out));
        }
        for leaf in self.instances.numbers() {
            match self.orders(leaf) {
                Ok(orders) => {
                    let plain = self.plan.leaves.get(leaf as usize).is_some_and(|leaf| leaf.kind == LeafKind::Plain);
                    if !plain {
                        self.waiting.insert(leaf);
                    }
                    self.with_instance(leaf, out, |instance, moment| {
                        if plain { instance.connect_plain() } else { instance.connect(orders, moment) }
                    });
                }
                Err(reasons) => self.reasons.extend(reasons),
            }
        }
        self.report_connected(out);
    }

    /// Returns the orders that tell a program of this host every link it takes part in.
    ///
    /// # Errors
    /// Sentences for a person.
    pub(super) fn orders(&self, leaf: u32) -> Result<impl Iterator<Item = Order> + use<>, Vec<String>> {
        let links = links(&self.plan, &self.deployment, &self.registrations, (leaf, &self.live))?;
        let calls = calls(&self.plan, &self.deployment, &self.registrations, (leaf, &self.live))?;
        let partners = self.partners(leaf);
        Ok(partners.into_iter().chain(shapes(&self.plan, leaf)).chain(calls).chain([links]))
    }

    /// Links a program of this host that was started again, and tells the hosts of those who dial it.
    pub(super) fn rejoin(&mut self, facts: LeafFacts, out: &mut Out<'_>) {
        let leaf = facts.leaf;
        self.tell_where(&facts, out);
        self.moved(facts, out);
        let orders = self.orders(leaf);
        self.with_instance(leaf, out, |instance, moment| match orders {
            Ok(orders) => instance.connect(orders, moment),
            Err(reasons) => instance.turn_away(&reasons.join("; "), moment),
        });
    }

    /// Tells the hosts of those who dial a program, or have wires to it, where it is now, and the home, which tells a host that rejoins.
    pub(super) fn tell_where(&self, facts: &LeafFacts, out: &mut Out<'_>) {
        let here = leaf_host(&self.plan, facts.leaf);
        let mut concerned = dialers(&self.plan, &self.registrations, facts.leaf);
        if facts.location.as_ref().is_some_and(|location| !location.keys.is_empty()) {
            concerned.extend(partnered(&self.plan, &self.registrations, facts.leaf));
        }
        let others = concerned.into_iter().filter_map(|dialer| leaf_host(&self.plan, dialer));
        let hosts: BTreeSet<&str> = others.filter(|host| Some(*host) != here).chain([self.home.as_str()]).collect();
        for host in hosts {
            out.send(host, self.deployment.to_participant(ToParticipant::Moved { facts: facts.clone() }));
        }
    }

    /// Takes note of where a program is now, and tells those of this host who dial it or have wires to it.
    pub(super) fn moved(&mut self, facts: LeafFacts, out: &mut Out<'_>) {
        let moved = facts.leaf;
        if self.registrations.facts.get(&moved) == Some(&facts) {
            return;
        }
        let before = self.registrations.facts.insert(moved, facts);
        for other in partnered(&self.plan, &self.registrations, moved) {
            if let Some(order) = self.partners(other) {
                self.with_instance(other, out, |instance, moment| instance.relink(order, moment));
            }
        }
        let Some(lost) = before.and_then(|before| before.location).map(|location| location.session) else { return };
        for dialer in dialers(&self.plan, &self.registrations, moved) {
            if let Some(order) = relink(&self.plan, &self.registrations, (dialer, moved), &lost) {
                self.with_instance(dialer, out, |instance, moment| instance.relink(order, moment));
            }
        }
    }

    /// Opens the wires again that were open when the program died.
    pub(super) fn resume(&mut self, leaf: u32, out: &mut Out<'_>) {
        let is_own = |wire: &u32| self.plan.wires.get(*wire as usize).is_some_and(|wire| wire.from.leaf == leaf);
        let wires: Vec<u32> = self.open.iter().copied().filter(is_own).collect();
        self.ticket += 1;
        let open = (!wires.is_empty()).then_some(Order::Open { wires, generation: self.ticket });
        self.with_instance(leaf, out, |instance, moment| instance.resume(open, moment));
    }

    /// Opens or closes wires whose producers are here, outside of a switch.
    pub(super) fn switch(&mut self, wires: &[u32], open: bool, asked: Asked<'_>, out: &mut Out<'_>) {
        let flip = if open {
            let open = wires.iter().map(|wire| Opening { wire: *wire, after: Vec::new() }).collect();
            Flip { open, ..Flip::default() }
        } else {
            Flip { close: wires.to_vec(), ..Flip::default() }
        };
        self.flip(flip, asked, out);
    }

    /// Flips wires whose producers are here; confirms when every producer that is alive has.
    pub(super) fn flip(&mut self, flip: Flip, asked: Asked<'_>, out: &mut Out<'_>) {
        let mut by_leaf: BTreeMap<u32, Flip> = BTreeMap::new();
        let Flip { generation: of_switch, close, open } = flip;
        let new = || Flip { generation: of_switch, ..Flip::default() };
        let producer = |wire: u32| self.plan.wires.get(wire as usize).map(|wire| wire.from.leaf);
        for wire in close {
            let Some(leaf) = producer(wire) else { continue };
            self.open.remove(&wire);
            by_leaf.entry(leaf).or_insert_with(new).close.push(wire);
        }
        for opening in open {
            let Some(leaf) = producer(opening.wire) else { continue };
            self.open.insert(opening.wire);
            by_leaf.entry(leaf).or_insert_with(new).open.push(opening);
        }
        self.ticket += 1;
        let ticket = self.ticket;
        let mut waiting = BTreeSet::new();
        for (leaf, flip) in by_leaf {
            let order = Order::Flip { ticket, flip };
            self.with_instance(leaf, out, |instance, moment| {
                if instance.switch(order, moment) {
                    waiting.insert(leaf);
                }
            });
        }
        let (group, generation, host) = asked;
        self.switching.insert(ticket, Switching { group, host: host.to_owned(), generation, waiting });
        self.confirm_switches(out);
    }

    pub(super) fn confirm_switch(&mut self, leaf: u32, ticket: u64, out: &mut Out<'_>) {
        if let Some(switching) = self.switching.get_mut(&ticket) {
            switching.waiting.remove(&leaf);
        }
        self.confirm_switches(out);
    }

    /// A program that is gone confirms nothing any more; one that is started again gets its open wires anew.
    pub(super) fn forget_switches(&mut self, leaf: u32, out: &mut Out<'_>) {
        if !self.instances.get(leaf).is_some_and(Instance::is_linked) {
            for switching in self.switching.values_mut() {
                switching.waiting.remove(&leaf);
            }
            self.confirm_switches(out);
            self.forget_expecting(leaf, out);
        }
    }

    fn confirm_switches(&mut self, out: &mut Out<'_>) {
        for (_, Switching { group, host, generation, .. }) in
            self.switching.extract_if(.., |_, switching| switching.waiting.is_empty())
        {
            out.send(&host, self.deployment.to_participant(ToParticipant::Switched { group, generation }));
        }
    }
}
