//! The links of this host's programs: made before GO, opened and closed by supervisors, and made again for a program that
//! was started again.
//!
//! Such a program has a new address. It dials its sources as it did at first. Programs that dial it are told its new
//! address: on its own host by its node, elsewhere by a message from here to there. Its home has no part in that. The
//! reports of other hosts about their programs and the report of the home about all programs take different ways: the
//! report of a program's own host counts.

use super::{Participant, Phase};
use crate::logic::effect::Out;
use crate::logic::executer::leaf_host;
use crate::logic::instance::Instance;
use crate::logic::protocol::{LeafFacts, ToParticipant};
use crate::logic::wiring::{Registrations, calls, dialers, links, partnered, relink, shapes};
use comms::logic::control::{Order, Partner};
use comms::logic::switch::{Expect, Flip, Opening};
use language::plan::{LeafKind, Retention};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// The links of the programs of this host.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Links {
    pub(super) registrations: Registrations,
    /// The wires that are linked: those of the connection sets, and during a change also those of the previous plan.
    pub(super) live: BTreeSet<u32>,
    /// Open wires whose producers are here.
    pub(super) open: BTreeSet<u32>,
    /// Programs of other deployments that call programs of this one, by the called program, in a team.
    pub(super) clients: BTreeMap<u32, Vec<Partner>>,
    pub(super) switching: BTreeMap<u64, Switching>,
    /// Switches that programs of this host are to expect, by the number of the order.
    pub(super) expecting: BTreeMap<u64, Expecting>,
    /// The number of the last order.
    pub(super) ticket: u64,
}

/// A switch that a program of this host is to expect.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Expecting {
    group: u32,
    leaf: u32,
    host: String,
    generation: u64,
}

/// Wires that are being opened or closed for a supervisor.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Switching {
    asked: Asked,
    /// Producers that have not confirmed yet.
    waiting: BTreeSet<u32>,
}

/// The origin of an order to open or close wires.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Asked {
    pub(super) group: u32,
    /// The number of the order at its supervisor.
    pub(super) generation: u64,
    /// The host of the supervisor.
    pub(super) host: String,
}

impl Participant {
    pub(super) fn connect(&mut self, facts: Vec<LeafFacts>, machines: Vec<String>, out: &mut Out<'_>) {
        if self.phase != Phase::Preparing {
            return;
        }
        self.phase = Phase::Connecting;
        self.links.registrations.machines = machines;
        for facts in facts {
            self.links.registrations.facts.entry(facts.leaf).or_insert(facts);
        }
        if self.together.rejoining {
            self.links
                .registrations
                .facts
                .values()
                .filter(|facts| self.is_own(facts))
                .for_each(|facts| self.tell_where(facts, out));
        }
        for leaf in self.instances.numbers() {
            match self.orders(leaf) {
                Ok(orders) => {
                    // The programs of the other hosts run already, and some may be gone for good.
                    let rejoin = self.together.rejoining.then_some(Order::Rejoin);
                    let orders = rejoin.into_iter().chain(orders);
                    let plain =
                        self.site.plan.leaves.get(leaf as usize).is_some_and(|leaf| leaf.kind == LeafKind::Plain);
                    if !plain {
                        self.roll.waiting.insert(leaf);
                    }
                    self.with_instance(leaf, out, |instance, moment| {
                        if plain { instance.connect_plain() } else { instance.connect(orders, moment) }
                    });
                }
                Err(reasons) => self.roll.reasons.extend(reasons),
            }
        }
        self.report_connected(out);
    }

    /// Returns the orders that tell a program of this host every link it takes part in.
    ///
    /// # Errors
    /// Sentences for a person.
    pub(super) fn orders(&self, leaf: u32) -> Result<impl Iterator<Item = Order> + use<>, Vec<String>> {
        let links = links(&self.site.plan, &self.site.deployment, &self.links.registrations, leaf, &self.links.live)?;
        let calls = calls(&self.site.plan, &self.site.deployment, &self.links.registrations, leaf, &self.links.live)?;
        let partners = self.partners(leaf);
        Ok(partners.into_iter().chain(shapes(&self.site.plan, leaf)).chain(calls).chain([links]))
    }

    /// Links a program of this host that was started again, and tells the hosts of the programs that dial it.
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

    /// Tells the new address of a program to the hosts of programs that dial it or have wires to it, and to the home,
    /// which tells a host that rejoins.
    pub(super) fn tell_where(&self, facts: &LeafFacts, out: &mut Out<'_>) {
        let here = leaf_host(&self.site.plan, facts.leaf);
        let mut concerned = dialers(&self.site.plan, &self.links.registrations, facts.leaf);
        if facts.location.as_ref().is_some_and(|location| !location.keys.is_empty()) {
            concerned.extend(partnered(&self.site.plan, &self.links.registrations, facts.leaf));
        }
        let others = concerned.into_iter().filter_map(|dialer| leaf_host(&self.site.plan, dialer));
        let hosts: BTreeSet<&str> =
            others.filter(|host| Some(*host) != here).chain([self.site.home.as_str()]).collect();
        for host in hosts {
            self.site.tell(host, ToParticipant::Moved { facts: facts.clone() }, out);
        }
    }

    /// Takes note of the new address of a program, and tells the programs of this host that dial it or have wires to
    /// it.
    pub(super) fn moved(&mut self, facts: LeafFacts, out: &mut Out<'_>) {
        let moved = facts.leaf;
        if self.links.registrations.facts.get(&moved) == Some(&facts) {
            return;
        }
        let before = self.links.registrations.facts.insert(moved, facts);
        for other in partnered(&self.site.plan, &self.links.registrations, moved) {
            if let Some(order) = self.partners(other) {
                self.with_instance(other, out, |instance, moment| instance.relink(order, moment));
            }
        }
        let Some(lost) = before.and_then(|before| before.location).map(|location| location.session) else { return };
        for dialer in dialers(&self.site.plan, &self.links.registrations, moved) {
            if let Some(order) = relink(&self.site.plan, &self.links.registrations, dialer, moved, &lost) {
                self.with_instance(dialer, out, |instance, moment| instance.relink(order, moment));
            }
        }
    }

    /// Opens the wires again that were open when the program died, and has the producers of its latched inputs send
    /// their last values again.
    pub(super) fn resume(&mut self, leaf: u32, out: &mut Out<'_>) {
        let is_own = |wire: &u32| self.site.plan.wires.get(*wire as usize).is_some_and(|wire| wire.from.leaf == leaf);
        let wires: Vec<u32> = self.links.open.iter().copied().filter(is_own).collect();
        self.links.ticket += 1;
        let open = (!wires.is_empty()).then_some(Order::Open { wires, generation: self.links.ticket });
        self.with_instance(leaf, out, |instance, moment| instance.resume(open, moment));
        let mut latched: BTreeMap<&str, Vec<u32>> = BTreeMap::new();
        for (number, wire) in (0..).zip(&self.site.plan.wires) {
            let is_latched = wire.to.leaf == leaf && wire.quality.retention == Retention::Latch;
            if let Some(host) = leaf_host(&self.site.plan, wire.from.leaf).filter(|_| is_latched) {
                latched.entry(host).or_default().push(number);
            }
        }
        for (host, wires) in latched {
            self.site.tell(host, ToParticipant::Repeat { wires }, out);
        }
    }

    /// Has producers of this host send the last values of open wires again, to consumers of the host that asks. A wire
    /// that is closed and opened between two values does that.
    pub(super) fn repeat(&mut self, wires: &[u32], from: &str, out: &mut Out<'_>) {
        let goes_there = |number: &u32| {
            let wire = self.site.plan.wires.get(*number as usize);
            wire.is_some_and(|wire| leaf_host(&self.site.plan, wire.to.leaf) == Some(from))
        };
        let open = wires.iter().copied().filter(|number| self.links.open.contains(number));
        let close: Vec<u32> = open.filter(goes_there).collect();
        let open = close.iter().map(|wire| Opening { wire: *wire, after: Vec::new() }).collect();
        for (producer, flip) in self.by_producer(Flip { close, open, ..Flip::default() }) {
            self.links.ticket += 1;
            let order = Order::Flip { ticket: self.links.ticket, flip };
            // Nothing waits for the answer.
            self.with_instance(producer, out, |instance, moment| {
                instance.ask(order, moment);
            });
        }
    }

    /// Opens or closes wires whose producers are here, outside of a switch.
    pub(super) fn switch(&mut self, wires: &[u32], open: bool, asked: Asked, out: &mut Out<'_>) {
        let flip = if open {
            let open = wires.iter().map(|wire| Opening { wire: *wire, after: Vec::new() }).collect();
            Flip { open, ..Flip::default() }
        } else {
            Flip { close: wires.to_vec(), ..Flip::default() }
        };
        self.flip(flip, asked, out);
    }

    /// Flips wires whose producers are here; confirms when every producer that is alive has.
    pub(super) fn flip(&mut self, flip: Flip, asked: Asked, out: &mut Out<'_>) {
        let by_producer = self.by_producer(flip);
        for Flip { close, open, .. } in by_producer.values() {
            for wire in close {
                self.links.open.remove(wire);
            }
            self.links.open.extend(open.iter().map(|opening| opening.wire));
        }
        self.links.ticket += 1;
        let ticket = self.links.ticket;
        let mut waiting = BTreeSet::new();
        for (leaf, flip) in by_producer {
            let order = Order::Flip { ticket, flip };
            self.with_instance(leaf, out, |instance, moment| {
                if instance.ask(order, moment) {
                    waiting.insert(leaf);
                }
            });
        }
        self.links.switching.insert(ticket, Switching { asked, waiting });
        self.confirm_switches(out);
    }

    /// Splits a flip into one for each producer. A wire that the plan does not have is left out.
    fn by_producer(&self, flip: Flip) -> BTreeMap<u32, Flip> {
        let mut by_producer: BTreeMap<u32, Flip> = BTreeMap::new();
        let Flip { generation, close, open } = flip;
        let new = || Flip { generation, ..Flip::default() };
        let producer = |wire: u32| self.site.plan.wires.get(wire as usize).map(|wire| wire.from.leaf);
        for wire in close {
            let Some(leaf) = producer(wire) else { continue };
            by_producer.entry(leaf).or_insert_with(new).close.push(wire);
        }
        for opening in open {
            let Some(leaf) = producer(opening.wire) else { continue };
            by_producer.entry(leaf).or_insert_with(new).open.push(opening);
        }
        by_producer
    }

    pub(super) fn confirm_switch(&mut self, leaf: u32, ticket: u64, out: &mut Out<'_>) {
        if let Some(switching) = self.links.switching.get_mut(&ticket) {
            switching.waiting.remove(&leaf);
        }
        self.confirm_switches(out);
    }

    /// A program that is gone no longer confirms switches; a program that is started again gets its open wires again.
    pub(super) fn forget_switches(&mut self, leaf: u32, out: &mut Out<'_>) {
        if !self.instances.get(leaf).is_some_and(Instance::is_linked) {
            for switching in self.links.switching.values_mut() {
                switching.waiting.remove(&leaf);
            }
            self.confirm_switches(out);
            self.forget_expecting(leaf, out);
        }
    }

    fn confirm_switches(&mut self, out: &mut Out<'_>) {
        let is_done = |_: &u64, switching: &mut Switching| switching.waiting.is_empty();
        for (_, Switching { asked: Asked { group, generation, host }, .. }) in
            self.links.switching.extract_if(.., is_done)
        {
            self.site.tell(&host, ToParticipant::Switched { group, generation }, out);
        }
    }

    /// Has a program expect a switch. A program that is not there is not waited for: its values are lost anyway.
    pub(super) fn expect(
        &mut self,
        leaf: u32,
        expect: Expect,
        then: Option<Flip>,
        group: u32,
        from: &str,
        out: &mut Out<'_>,
    ) {
        self.links.ticket += 1;
        let (ticket, generation) = (self.links.ticket, expect.generation);
        self.links.expecting.insert(ticket, Expecting { group, leaf, host: from.to_owned(), generation });
        if let Some(then) = &then {
            self.links.open.retain(|wire| !then.close.contains(wire));
            self.links.open.extend(then.open.iter().map(|opening| opening.wire));
        }
        let order = Order::Expect { ticket, expect, then };
        let mut is_there = false;
        self.with_instance(leaf, out, |instance, context| is_there = instance.ask(order, context));
        if !is_there {
            self.confirm_taken(ticket, 0, 0, Vec::new(), out);
        }
    }

    pub(super) fn confirm_expecting(&mut self, ticket: u64, out: &mut Out<'_>) {
        if let Some(Expecting { group, leaf, host, generation }) = self.links.expecting.get(&ticket) {
            let (group, leaf, generation) = (*group, *leaf, *generation);
            let word = ToParticipant::Expecting { group, leaf, generation };
            self.site.tell(host, word, out);
        }
    }

    pub(super) fn confirm_taken(&mut self, ticket: u64, lost: u64, late: u64, missing: Vec<u32>, out: &mut Out<'_>) {
        if let Some(Expecting { group, leaf, host, generation }) = self.links.expecting.remove(&ticket) {
            let word = ToParticipant::Taken { group, leaf, generation, lost, late, missing };
            self.site.tell(&host, word, out);
        }
    }

    /// A program that is gone no longer takes a switch.
    pub(super) fn forget_expecting(&mut self, leaf: u32, out: &mut Out<'_>) {
        let theirs =
            self.links.expecting.iter().filter(|(_, expecting)| expecting.leaf == leaf).map(|(ticket, _)| *ticket);
        for ticket in theirs.collect::<Vec<_>>() {
            self.confirm_taken(ticket, 0, 0, Vec::new(), out);
        }
    }
}
