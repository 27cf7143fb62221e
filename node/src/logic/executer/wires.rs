//! The wires of a group: which of its connection sets are open, and which wires their producers have not confirmed yet.
//!
//! All wires that one event closes and opens form one switch: each producer flips its wires between two values, and a
//! wire that stays in use stays open.

use super::{ExecContext, leaf_host};
use crate::logic::effect::Out;
use crate::logic::protocol::ToParticipant;
use comms::logic::switch::{Flip, Opening};
use language::plan::{Group, Plan, Transfer};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Wires that were opened, and that their producers have not confirmed yet.
#[derive(Debug, Serialize, Deserialize)]
struct Unconfirmed {
    /// The host of the producers.
    host: String,
    /// Slots of the members that they lead to.
    consumers: BTreeSet<u32>,
}

/// Sets and wires that one switch closes and opens.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Difference {
    pub(super) sets_closed: Vec<u32>,
    pub(super) sets_opened: Vec<u32>,
    pub(super) close: Vec<u32>,
    pub(super) open: Vec<u32>,
}

impl Difference {
    pub(super) fn is_empty(&self) -> bool {
        self.close.is_empty() && self.open.is_empty()
    }
}

/// Wires that the producers are to flip, for one switch.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Flips<'a> {
    pub(super) generation: u64,
    pub(super) close: &'a [u32],
    pub(super) open: &'a [u32],
    /// Closed wires, for whose end the values on new wires wait.
    pub(super) ends: &'a [u32],
}

/// The wires of one group.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Wires {
    /// Slot of the member that a leaf is, or is below of, for each leaf that a wire of this group leads to.
    consumers: BTreeMap<u32, u32>,
    /// How many open sets have each wire.
    open: BTreeMap<u32, u32>,
    /// The wires of each set in current use.
    sets: Vec<Vec<u32>>,
    /// How often each set is open.
    open_sets: BTreeMap<u32, u32>,
    /// The number of the last switch or order.
    generation: u64,
    unconfirmed: BTreeMap<u64, Unconfirmed>,
}

impl Wires {
    pub(super) fn new(plan: &Plan, group: &Group) -> Self {
        Self { consumers: consumers(plan, group), sets: wires_of_sets(group), ..Self::default() }
    }

    /// Returns a number that no switch or order has had.
    pub(super) fn next_generation(&mut self) -> u64 {
        self.generation += 1;
        self.generation
    }

    /// Goes on with numbers behind this one.
    pub(super) fn number_from(&mut self, generation: u64) {
        self.generation = generation;
    }

    /// Counts sets as closed and open. Returns which of these wires switch: a wire switches if no other open set holds it.
    pub(super) fn difference(&mut self, close: Vec<u32>, open: Vec<u32>) -> Difference {
        let before = self.open_wires();
        for set in &close {
            let count = self.open_sets.entry(*set).or_default();
            *count = count.saturating_sub(1);
            for wire in self.sets.get(*set as usize).map_or(&[][..], Vec::as_slice) {
                let count = self.open.entry(*wire).or_default();
                *count = count.saturating_sub(1);
            }
        }
        for set in &open {
            *self.open_sets.entry(*set).or_default() += 1;
            let wires = self.sets.get(*set as usize).map_or(&[][..], Vec::as_slice);
            wires.iter().for_each(|wire| *self.open.entry(*wire).or_default() += 1);
        }
        let after = self.open_wires();
        let (sets_closed, sets_opened) = (close, open);
        let (close, open) = (&before - &after, &after - &before);
        Difference { sets_closed, sets_opened, close: close.into_iter().collect(), open: open.into_iter().collect() }
    }

    /// Returns the wires of a set in current use: during a change the plan may already have others.
    pub(super) fn of_set(&self, set: u32) -> &[u32] {
        self.sets.get(set as usize).map_or(&[], Vec::as_slice)
    }

    /// Returns which sets are open.
    pub(super) fn open_sets(&self) -> impl Iterator<Item = u32> {
        self.open_sets.iter().filter(|(_, count)| **count > 0).map(|(set, _)| *set)
    }

    /// Returns which wires are open.
    pub(super) fn open_wires(&self) -> BTreeSet<u32> {
        self.open.iter().filter(|(_, count)| **count > 0).map(|(wire, _)| *wire).collect()
    }

    /// Returns how many open sets have a wire.
    pub(super) fn times_open(&self, wire: u32) -> usize {
        self.open.get(&wire).map_or(0, |count| *count as usize)
    }

    /// Counts the wires of the open sets as the plan has them now. Returns what of that flips.
    pub(super) fn recount(&mut self, plan: &Plan, group: &Group) -> Difference {
        (self.consumers, self.sets) = (consumers(plan, group), wires_of_sets(group));
        let before = self.open_wires();
        let mut counts: BTreeMap<u32, u32> = BTreeMap::new();
        for (set, count) in &self.open_sets {
            for wire in self.of_set(*set) {
                *counts.entry(*wire).or_default() += count;
            }
        }
        self.open = counts;
        let after = self.open_wires();
        let (close, open) = (&before - &after, &after - &before);
        Difference { close: close.into_iter().collect(), open: open.into_iter().collect(), ..Difference::default() }
    }

    /// Takes note that generations of wires need not be waited for any more.
    pub(super) fn confirm(&mut self, generations: &BTreeSet<u64>) {
        self.unconfirmed.retain(|generation, _| !generations.contains(generation));
    }

    /// Returns the generations of wires to a member that are not confirmed.
    pub(super) fn unconfirmed_to(&self, slot: u32) -> BTreeSet<u64> {
        let leads_here = |wires: &Unconfirmed| wires.consumers.contains(&slot);
        self.unconfirmed.iter().filter(|(_, wires)| leads_here(wires)).map(|(number, _)| *number).collect()
    }

    /// Returns the generations of wires that the producers of a host have not confirmed.
    pub(super) fn unconfirmed_by(&self, host: &str) -> BTreeSet<u64> {
        self.unconfirmed.iter().filter(|(_, wires)| wires.host == host).map(|(number, _)| *number).collect()
    }

    /// Returns the hosts whose producers have not confirmed these generations.
    pub(super) fn silent_hosts(&self, generations: &BTreeSet<u64>) -> BTreeSet<&str> {
        let silent = generations.iter().filter_map(|number| self.unconfirmed.get(number));
        silent.map(|wires| wires.host.as_str()).collect()
    }

    /// Orders the producers of a group to flip wires. Returns the numbers by which their hosts confirm.
    pub(super) fn order(
        &mut self,
        flips: Flips<'_>,
        group: u32,
        context: ExecContext<'_>,
        out: &mut Out<'_>,
    ) -> BTreeSet<u64> {
        let plan = context.plan;
        let mut by_host: BTreeMap<&str, Flip> = BTreeMap::new();
        let host = |wire: u32| leaf_host(plan, plan.wires.get(wire as usize)?.from.leaf);
        for &wire in flips.close {
            let Some(host) = host(wire) else { continue };
            by_host.entry(host).or_default().close.push(wire);
        }
        for &wire in flips.open {
            let Some(host) = host(wire) else { continue };
            let opening = Opening { wire, after: ends_before(plan, flips.ends, wire) };
            by_host.entry(host).or_default().open.push(opening);
        }
        let mut numbers = BTreeSet::new();
        for (host, flip) in by_host {
            let flip = Flip { generation: flips.generation, ..flip };
            let number = self.next_generation();
            numbers.insert(number);
            if !flip.open.is_empty() {
                let ends = flip.open.iter().filter_map(|opening| plan.wires.get(opening.wire as usize));
                let consumers = ends.filter_map(|ends| self.consumers.get(&ends.to.leaf)).copied().collect();
                self.unconfirmed.insert(number, Unconfirmed { host: host.to_owned(), consumers });
            }
            let order = ToParticipant::Flip { group, generation: number, flip };
            out.send(host, context.deployment.to_participant(order));
        }
        numbers
    }
}

/// Returns the wires of each set of a group.
fn wires_of_sets(group: &Group) -> Vec<Vec<u32>> {
    group.sets.iter().map(|set| set.wires.clone()).collect()
}

/// Returns the closed wires that push to the consumer of an opened wire.
pub(super) fn ends_before(plan: &Plan, closed: &[u32], opened: u32) -> Vec<u32> {
    closed.iter().copied().filter(|wire| *wire != opened && are_of_one_input(plan, *wire, opened)).collect()
}

/// Returns whether two wires push values to one program.
pub(super) fn are_of_one_input(plan: &Plan, one: u32, other: u32) -> bool {
    let consumer = |wire: u32| {
        let wire = plan.wires.get(wire as usize)?;
        (wire.transfer == Transfer::Push).then_some(wire.to.leaf)
    };
    consumer(one).is_some_and(|leaf| consumer(other) == Some(leaf))
}

/// Returns the member that each leaf at the end of a wire of this group is, or is below of.
fn consumers(plan: &Plan, group: &Group) -> BTreeMap<u32, u32> {
    let slots: BTreeMap<&str, u32> =
        (0..).zip(&group.members).map(|(slot, member)| (member.name.as_str(), slot)).collect();
    let wires = group.sets.iter().flat_map(|set| &set.wires).filter_map(|wire| plan.wires.get(*wire as usize));
    let consumer = |leaf: u32| {
        let path = plan.leaves.get(leaf as usize)?.path.strip_prefix(&group.path)?.strip_prefix('/')?;
        slots.get(path.split('/').next()?).copied()
    };
    wires.filter_map(|wire| Some((wire.to.leaf, consumer(wire.to.leaf)?))).collect()
}
