//! The links of this host's programs: made before GO, opened and closed by supervisors, and made again for a program that
//! was started again.
//!
//! Such a program has a new address. It dials its sources again. Programs that dial it
//! get its new address: on its own host from the node, on other hosts by a message from here. Its
//! home has no part in that. Other hosts report their own programs, and the home reports all
//! programs. These reports may arrive in any order: the report of a program's own host is used.
//!
//! An order of a supervisor has a ticket until it is confirmed. The ticket is in `switching` until
//! each producer has opened or closed its wires, and in `expecting` until the consumer has taken
//! its values. A program that is gone confirms nothing and is not waited for.

use super::processes::Processes;
use super::site::Site;
use crate::logic::claims::Claims;
use crate::logic::effect::Out;
use crate::logic::executer::leaf_host;
use crate::logic::protocol::{LeafFacts, ToParticipant};
use crate::logic::wiring::{self, Registrations, calls, dialers, links, partnered, relink, shapes};
use comms::logic::control::{Dial, Order, Partner};
use comms::logic::switch::{Expect, Flip, Opening};
use language::plan::{Plan, Retention};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// The links of the programs of this host.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Links {
    pub(super) registrations: Registrations,
    /// The linked wires: the wires of the connection sets, and during a change also the wires of the previous plan.
    live: BTreeSet<u32>,
    /// Open wires whose producers are here.
    open: BTreeSet<u32>,
    /// Programs of other deployments that call programs of this one, by the called program, in a team.
    clients: BTreeMap<u32, Vec<Partner>>,
    switching: BTreeMap<u64, Switching>,
    /// Switches that programs of this host are to expect, by the number of the order.
    expecting: BTreeMap<u64, Expecting>,
    /// The number of the last order.
    ticket: u64,
}

/// A switch that a program of this host is to expect.
#[derive(Debug, Serialize, Deserialize)]
struct Expecting {
    asked: Asked,
    leaf: u32,
}

/// Wires that are being opened or closed for a supervisor.
#[derive(Debug, Serialize, Deserialize)]
struct Switching {
    asked: Asked,
    /// Producers that have not confirmed yet.
    waiting: BTreeSet<u32>,
}

/// The origin of an order to open or close wires, or to expect that.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Asked {
    pub(super) group: u32,
    /// The number of the order at its supervisor.
    pub(super) generation: u64,
    /// The host of the supervisor.
    pub(super) host: String,
}

/// The report of a consumer about its values after a switch.
#[derive(Debug, Default)]
pub(super) struct TakenValues {
    pub(super) lost: u64,
    pub(super) late: u64,
    /// The wires whose last values have not come.
    pub(super) missing: Vec<u32>,
}

impl Links {
    /// Returns the links of a plan, before anything is known about its programs.
    pub(super) fn new(plan: &Plan) -> Self {
        Self { live: plan.live_wires(), ..Self::default() }
    }

    /// Takes note of the programs of all hosts. A host's own report about a program is newer.
    pub(super) fn register(&mut self, facts: Vec<LeafFacts>, machines: Vec<String>) {
        self.registrations.machines = machines;
        for facts in facts {
            self.registrations.facts.entry(facts.leaf).or_insert(facts);
        }
    }

    /// Takes note of the programs that a change adds.
    pub(super) fn register_also(&mut self, facts: Vec<LeafFacts>) {
        self.registrations.facts.extend(facts.into_iter().map(|facts| (facts.leaf, facts)));
    }

    /// Returns what is known about a program.
    pub(super) fn facts(&self, leaf: u32) -> Option<&LeafFacts> {
        self.registrations.facts.get(&leaf)
    }

    /// Links the wires of the next plan, while the wires of the previous plan stay linked. Returns the wires that come or go.
    pub(super) fn change(&mut self, plan: &Plan) -> BTreeSet<u32> {
        let mut live = plan.live_wires();
        let rewired = self.live.symmetric_difference(&live).copied().collect();
        // The programs that are put back cannot link to a program that never arrived.
        let has_come = |leaf: u32| self.registrations.facts.contains_key(&leaf);
        let both = |wire: &&u32| {
            plan.wires.get(**wire as usize).is_some_and(|wire| has_come(wire.from.leaf) && has_come(wire.to.leaf))
        };
        live.extend(self.live.iter().filter(both));
        self.live = live;
        rewired
    }

    /// Drops the wires that a plan does not have, and returns them. By then the values under way over them have arrived.
    pub(super) fn settle(&mut self, plan: &Plan) -> BTreeSet<u32> {
        let live = plan.live_wires();
        let gone = self.live.difference(&live).copied().collect();
        self.live = live;
        gone
    }

    /// Forgets the programs that a plan does not have.
    pub(super) fn retain(&mut self, leaves: &BTreeSet<u32>) {
        self.registrations.facts.retain(|leaf, _| leaves.contains(leaf));
    }

    /// Returns the orders that tell a program of this host every link it takes part in.
    ///
    /// # Errors
    /// Sentences for a person.
    pub(super) fn orders(&self, site: &Site, leaf: u32) -> Result<impl Iterator<Item = Order> + use<>, Vec<String>> {
        let Site { plan, deployment, .. } = site;
        let links = links(plan, deployment, &self.registrations, leaf, &self.live)?;
        let calls = calls(plan, deployment, &self.registrations, leaf, &self.live)?;
        let partners = self.partners(site, leaf);
        Ok(partners.into_iter().chain(shapes(plan, leaf)).chain(calls).chain([links]))
    }

    /// Returns the order that tells a program the other ends of its wires, and its callers from other deployments.
    fn partners(&self, site: &Site, leaf: u32) -> Option<Order> {
        let mut partners = wiring::partners(&site.plan, &site.deployment, &self.registrations, leaf)?;
        partners.extend(self.clients.get(&leaf).into_iter().flatten().cloned());
        Some(Order::Partners { partners })
    }

    /// Returns which programs call a process of another deployment, by their keys; none outside of a team.
    pub(super) fn callers(&self, site: &Site, leaf: u32) -> Option<Vec<Partner>> {
        wiring::partners(&site.plan, &site.deployment, &self.registrations, leaf)
    }

    /// Returns where to dial a program that has a data session.
    pub(super) fn dial(&self, leaf: u32) -> Option<Dial> {
        wiring::observe(&self.registrations, leaf)
    }

    /// Returns the devices that the programs of this host hold by the current plan, and by their own reports.
    pub(super) fn claims(&self, site: &Site) -> Claims {
        let mut claims = Claims::of(&site.plan, &site.host);
        let own = self.registrations.facts.values().filter(|facts| site.is_here(facts.leaf));
        // A program of another deployment holds its devices itself.
        for facts in own.filter(|facts| site.plan.external(facts.leaf).is_none()) {
            let path = site.path(facts.leaf).unwrap_or_default();
            claims.extend(Claims::of_owner(path, &facts.owns));
        }
        claims
    }

    /// Returns the devices of a program: its claims in the spec, and the devices that the program named itself.
    pub(super) fn claims_of(&self, site: &Site, leaf: u32) -> Claims {
        let mut claims = Claims::of_leaf(&site.plan, leaf);
        let path = site.path(leaf).unwrap_or_default();
        self.facts(leaf).into_iter().for_each(|facts| claims.extend(Claims::of_owner(path, &facts.owns)));
        claims
    }

    /// Sends the new address of a program to the hosts of programs that dial it or have wires to
    /// it. Also sends the address to the home, which passes it on to a host that rejoins.
    pub(super) fn tell_where(&self, site: &Site, facts: &LeafFacts, out: &mut Out<'_>) {
        let here = leaf_host(&site.plan, facts.leaf);
        let mut concerned = dialers(&site.plan, &self.registrations, facts.leaf);
        if facts.location.as_ref().is_some_and(|location| !location.keys.is_empty()) {
            concerned.extend(partnered(&site.plan, &self.registrations, facts.leaf));
        }
        let others = concerned.into_iter().filter_map(|dialer| leaf_host(&site.plan, dialer));
        let hosts: BTreeSet<&str> = others.filter(|host| Some(*host) != here).chain([site.home.as_str()]).collect();
        for host in hosts {
            site.tell(host, ToParticipant::Moved { facts: facts.clone() }, out);
        }
    }

    /// Takes note of the new address of a program, and tells the programs of this host that dial it or have wires to
    /// it.
    pub(super) fn moved(&mut self, site: &Site, processes: &Processes, facts: LeafFacts, out: &mut Out<'_>) {
        let moved = facts.leaf;
        if self.facts(moved) == Some(&facts) {
            return;
        }
        let before = self.registrations.facts.insert(moved, facts);
        for other in partnered(&site.plan, &self.registrations, moved) {
            if let Some(order) = self.partners(site, other) {
                processes.relink(other, order, out);
            }
        }
        let Some(lost) = before.and_then(|before| before.location).map(|location| location.session) else { return };
        for dialer in dialers(&site.plan, &self.registrations, moved) {
            if let Some(order) = relink(&site.plan, &self.registrations, dialer, moved, &lost) {
                processes.relink(dialer, order, out);
            }
        }
    }

    /// Takes note of the programs of other deployments that call programs here, and informs the called programs.
    pub(super) fn serve(
        &mut self,
        site: &Site,
        processes: &Processes,
        clients: BTreeMap<u32, Vec<Partner>>,
        out: &mut Out<'_>,
    ) {
        if self.clients == clients {
            return;
        }
        let before = std::mem::replace(&mut self.clients, clients);
        for leaf in before.keys().chain(self.clients.keys()) {
            if before.get(leaf) != self.clients.get(leaf)
                && let Some(order) = self.partners(site, *leaf)
            {
                processes.relink(*leaf, order, out);
            }
        }
    }

    /// Returns the order to open the wires again that were open when a program died.
    pub(super) fn reopen(&mut self, site: &Site, leaf: u32) -> Option<Order> {
        let is_own = |wire: &u32| site.plan.wires.get(*wire as usize).is_some_and(|wire| wire.from.leaf == leaf);
        let wires: Vec<u32> = self.open.iter().copied().filter(is_own).collect();
        let generation = self.next_ticket();
        (!wires.is_empty()).then_some(Order::Open { wires, generation })
    }

    /// Has producers of this host send the last values of open wires again, to consumers of the host that asks. A wire
    /// that is closed and opened between two values does that.
    pub(super) fn repeat(&mut self, site: &Site, processes: &Processes, wires: &[u32], from: &str, out: &mut Out<'_>) {
        let goes_there = |number: &u32| {
            let wire = site.plan.wires.get(*number as usize);
            wire.is_some_and(|wire| leaf_host(&site.plan, wire.to.leaf) == Some(from))
        };
        let open = wires.iter().copied().filter(|number| self.open.contains(number));
        let close: Vec<u32> = open.filter(goes_there).collect();
        let open = close.iter().map(|wire| Opening { wire: *wire, after: Vec::new() }).collect();
        for (producer, flip) in by_producer(&site.plan, Flip { close, open, ..Flip::default() }) {
            let ticket = self.next_ticket();
            // Nothing waits for the answer.
            processes.ask(producer, Order::Flip { ticket, flip }, out);
        }
    }

    /// Switches wires whose producers are here. Confirms when every living producer has switched.
    pub(super) fn flip(&mut self, site: &Site, processes: &Processes, flip: Flip, asked: Asked, out: &mut Out<'_>) {
        let by_producer = by_producer(&site.plan, flip);
        by_producer.values().for_each(|flip| self.note_open(flip));
        let ticket = self.next_ticket();
        let is_asked = |(leaf, flip)| processes.ask(leaf, Order::Flip { ticket, flip }, out).then_some(leaf);
        let waiting = by_producer.into_iter().filter_map(is_asked).collect();
        self.switching.insert(ticket, Switching { asked, waiting });
        self.confirm_switches(site, out);
    }

    /// Takes the confirmation of a producer.
    pub(super) fn switched(&mut self, site: &Site, leaf: u32, ticket: u64, out: &mut Out<'_>) {
        if let Some(switching) = self.switching.get_mut(&ticket) {
            switching.waiting.remove(&leaf);
        }
        self.confirm_switches(site, out);
    }

    /// A program that is gone no longer confirms switches; a program that is started again gets its open wires again.
    pub(super) fn forget_program(&mut self, site: &Site, leaf: u32, out: &mut Out<'_>) {
        for switching in self.switching.values_mut() {
            switching.waiting.remove(&leaf);
        }
        self.confirm_switches(site, out);
        let theirs = self.expecting.iter().filter(|(_, expecting)| expecting.leaf == leaf).map(|(ticket, _)| *ticket);
        for ticket in theirs.collect::<Vec<_>>() {
            self.taken(site, ticket, TakenValues::default(), out);
        }
    }

    fn confirm_switches(&mut self, site: &Site, out: &mut Out<'_>) {
        let is_done = |_: &u64, switching: &mut Switching| switching.waiting.is_empty();
        for (_, Switching { asked: Asked { group, generation, host }, .. }) in self.switching.extract_if(.., is_done) {
            site.tell(&host, ToParticipant::Switched { group, generation }, out);
        }
    }

    /// Has a program expect a switch. This does not wait for a missing program, because its values are lost anyway.
    pub(super) fn expect(
        &mut self,
        site: &Site,
        processes: &Processes,
        expected: ExpectedSwitch,
        from: &str,
        out: &mut Out<'_>,
    ) {
        let ExpectedSwitch { group, leaf, expect, then } = expected;
        let ticket = self.next_ticket();
        let asked = Asked { group, generation: expect.generation, host: from.to_owned() };
        self.expecting.insert(ticket, Expecting { asked, leaf });
        then.iter().for_each(|then| self.note_open(then));
        if !processes.ask(leaf, Order::Expect { ticket, expect, then }, out) {
            self.taken(site, ticket, TakenValues::default(), out);
        }
    }

    /// Takes the message of a consumer that it expects a switch.
    pub(super) fn expects(&self, site: &Site, ticket: u64, out: &mut Out<'_>) {
        if let Some(Expecting { asked: Asked { group, generation, host }, leaf }) = self.expecting.get(&ticket) {
            let (group, leaf, generation) = (*group, *leaf, *generation);
            site.tell(host, ToParticipant::Expecting { group, leaf, generation }, out);
        }
    }

    /// Takes the message of a consumer that it has taken its values after a switch.
    pub(super) fn taken(&mut self, site: &Site, ticket: u64, values: TakenValues, out: &mut Out<'_>) {
        if let Some(Expecting { asked: Asked { group, generation, host }, leaf }) = self.expecting.remove(&ticket) {
            let TakenValues { lost, late, missing } = values;
            site.tell(&host, ToParticipant::Taken { group, leaf, generation, lost, late, missing }, out);
        }
    }

    /// Takes note of the wires that a flip closes and opens.
    fn note_open(&mut self, Flip { close, open, .. }: &Flip) {
        for wire in close {
            self.open.remove(wire);
        }
        self.open.extend(open.iter().map(|opening| opening.wire));
    }

    const fn next_ticket(&mut self) -> u64 {
        self.ticket += 1;
        self.ticket
    }
}

/// The order of a supervisor to expect a switch.
#[derive(Debug)]
pub(super) struct ExpectedSwitch {
    pub(super) group: u32,
    pub(super) leaf: u32,
    pub(super) expect: Expect,
    /// The wires of the consumer itself that are flipped once it has taken its values.
    pub(super) then: Option<Flip>,
}

/// Returns the flip that opens or closes wires outside of a switch.
pub(super) fn outside_of_switch(wires: &[u32], open: bool) -> Flip {
    if open {
        let open = wires.iter().map(|wire| Opening { wire: *wire, after: Vec::new() }).collect();
        Flip { open, ..Flip::default() }
    } else {
        Flip { close: wires.to_vec(), ..Flip::default() }
    }
}

/// Asks the producers of the latched inputs of a program that was started again for their last values.
pub(super) fn ask_for_latched(site: &Site, leaf: u32, out: &mut Out<'_>) {
    let mut latched: BTreeMap<&str, Vec<u32>> = BTreeMap::new();
    for (number, wire) in (0..).zip(&site.plan.wires) {
        let is_latched = wire.to.leaf == leaf && wire.quality.retention == Retention::Latch;
        if let Some(host) = leaf_host(&site.plan, wire.from.leaf).filter(|_| is_latched) {
            latched.entry(host).or_default().push(number);
        }
    }
    for (host, wires) in latched {
        site.tell(host, ToParticipant::Repeat { wires }, out);
    }
}

/// Splits a flip into one for each producer. A wire that the plan does not have is left out.
fn by_producer(plan: &Plan, flip: Flip) -> BTreeMap<u32, Flip> {
    let mut by_producer: BTreeMap<u32, Flip> = BTreeMap::new();
    let Flip { generation, close, open } = flip;
    let new = || Flip { generation, ..Flip::default() };
    let producer = |wire: u32| plan.wires.get(wire as usize).map(|wire| wire.from.leaf);
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
