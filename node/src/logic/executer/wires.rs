//! The wires of a group: which of its connection sets are open, and which wires their producers have not confirmed yet.
//!
//! All wires that one event closes and opens form one switch: each producer flips its wires between two values, and a
//! wire that stays in use stays open.

use super::{ExecContext, Executer, leaf_host};
use crate::logic::effect::Out;
use crate::logic::protocol::ToParticipant;
use comms::logic::switch::{Flip, Opening};
use language::algebra::Command;
use language::plan::{Group, Plan, Transfer};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Wires that were opened, and that their producers have not confirmed yet.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Unconfirmed {
    /// The host of the producers.
    pub(super) host: String,
    /// Slots of the members that they lead to.
    pub(super) consumers: BTreeSet<u32>,
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

impl Executer {
    /// Notes that the producers of a generation of wires are switched.
    pub fn switched(&mut self, generation: u64, context: ExecContext<'_>, out: &mut Out<'_>) {
        self.confirm(&BTreeSet::from([generation]));
        self.activate_ready(context, out);
        self.flipped(generation, context, out);
    }

    /// Takes note that generations of wires need not be waited for any more.
    pub(super) fn confirm(&mut self, generations: &BTreeSet<u64>) {
        self.unconfirmed.retain(|generation, _| !generations.contains(generation));
        for waiting in self.waiting.values_mut() {
            waiting.wires.retain(|generation| !generations.contains(generation));
        }
    }

    /// Switches to the sets that the commands of one event leave open.
    pub(super) fn connect(&mut self, commands: &[Command], context: ExecContext<'_>, out: &mut Out<'_>) {
        let Some(group) = context.plan.groups.get(self.group as usize) else { return };
        let (mut close, mut open) = (Vec::new(), Vec::new());
        for command in commands {
            if let Command::Disconnect { set } = command {
                close.push(*set);
            } else if let Command::Connect { set } = command {
                open.push(*set);
            }
        }
        if close.is_empty() && open.is_empty() {
            return;
        }
        let owners = close.iter().filter_map(|set| group.sets.get(*set as usize)?.owner).collect::<BTreeSet<_>>();
        owners.into_iter().for_each(|slot| self.forget_switch(slot, context, out));
        let close = self.instead_of(close, group);
        let difference = self.difference(close, open);
        self.begin_switch(difference, context, out);
    }

    /// Counts sets as closed and open. Returns what of that flips: a wire flips if no other open set holds it.
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
    pub(super) fn wires_of(&self, set: u32) -> &[u32] {
        self.sets.get(set as usize).map_or(&[], Vec::as_slice)
    }

    /// Returns which wires are open.
    pub(super) fn open_wires(&self) -> BTreeSet<u32> {
        self.open.iter().filter(|(_, count)| **count > 0).map(|(wire, _)| *wire).collect()
    }

    /// Counts the wires of the open sets as the plan has them now. Returns what of that flips.
    pub(super) fn recount(&mut self, plan: &Plan) -> Difference {
        let Some(group) = plan.groups.get(self.group as usize) else { return Difference::default() };
        (self.consumers, self.sets) = (consumers(plan, group), wires_of_sets(group));
        let before = self.open_wires();
        let mut counts: BTreeMap<u32, u32> = BTreeMap::new();
        for (set, count) in &self.open_sets {
            for wire in self.wires_of(*set) {
                *counts.entry(*wire).or_default() += count;
            }
        }
        self.open = counts;
        let after = self.open_wires();
        let (close, open) = (&before - &after, &after - &before);
        Difference { close: close.into_iter().collect(), open: open.into_iter().collect(), ..Difference::default() }
    }

    /// Orders the producers to flip wires of the switch `generation`. Values on new wires wait for the end of those
    /// that the switch `ends`. Returns the numbers by which their hosts confirm.
    pub(super) fn order_flips(
        &mut self,
        (close, open, ends): (&[u32], &[u32], &[u32]),
        generation: u64,
        context: ExecContext<'_>,
        out: &mut Out<'_>,
    ) -> BTreeSet<u64> {
        let plan = context.plan;
        let mut by_host: BTreeMap<&str, Flip> = BTreeMap::new();
        let host = |wire: u32| leaf_host(plan, plan.wires.get(wire as usize)?.from.leaf);
        for &wire in close {
            let Some(host) = host(wire) else { continue };
            by_host.entry(host).or_default().close.push(wire);
        }
        for &wire in open {
            let Some(host) = host(wire) else { continue };
            let opening = Opening { wire, after: ends_before(plan, ends, wire) };
            by_host.entry(host).or_default().open.push(opening);
        }
        let mut numbers = BTreeSet::new();
        for (host, flip) in by_host {
            let flip = Flip { generation, ..flip };
            self.generation += 1;
            let number = self.generation;
            numbers.insert(number);
            if !flip.open.is_empty() {
                let ends = flip.open.iter().filter_map(|opening| plan.wires.get(opening.wire as usize));
                let consumers = ends.filter_map(|ends| self.consumers.get(&ends.to.leaf)).copied().collect();
                self.unconfirmed.insert(number, Unconfirmed { host: host.to_owned(), consumers });
            }
            let order = ToParticipant::Flip { group: self.group, generation: number, flip };
            out.send(host, context.deployment.to_participant(order));
        }
        numbers
    }
}

/// Returns the wires of each set of a group.
pub(super) fn wires_of_sets(group: &Group) -> Vec<Vec<u32>> {
    group.sets.iter().map(|set| set.wires.clone()).collect()
}

/// Returns those of the closed wires that push to the consumer of an opened one.
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
pub(super) fn consumers(plan: &Plan, group: &Group) -> BTreeMap<u32, u32> {
    let slots: BTreeMap<&str, u32> =
        (0..).zip(&group.members).map(|(slot, member)| (member.name.as_str(), slot)).collect();
    let wires = group.sets.iter().flat_map(|set| &set.wires).filter_map(|wire| plan.wires.get(*wire as usize));
    let consumer = |leaf: u32| {
        let path = plan.leaves.get(leaf as usize)?.path.strip_prefix(&group.path)?.strip_prefix('/')?;
        slots.get(path.split('/').next()?).copied()
    };
    wires.filter_map(|wire| Some((wire.to.leaf, consumer(wire.to.leaf)?))).collect()
}
