//! The wires of a group: which of its connection sets are open, and which wires their producers have not confirmed yet.

use super::{ExecContext, Executer, leaf_host};
use crate::logic::effect::Out;
use crate::logic::protocol::ToParticipant;
use language::plan::{Group, Plan};
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

impl Executer {
    /// Notes that the producers of a generation of wires are switched.
    pub fn switched(&mut self, generation: u64, context: ExecContext<'_>, out: &mut Out<'_>) {
        self.confirm(&BTreeSet::from([generation]));
        self.activate_ready(context, out);
    }

    /// Takes note that generations of wires need not be waited for any more.
    pub(super) fn confirm(&mut self, generations: &BTreeSet<u64>) {
        self.unconfirmed.retain(|generation, _| !generations.contains(generation));
        for waiting in self.waiting.values_mut() {
            waiting.wires.retain(|generation| !generations.contains(generation));
        }
    }

    /// Opens or closes the wires of a set that no other open set holds.
    pub(super) fn switch(&mut self, set: u32, open: bool, context: ExecContext<'_>, out: &mut Out<'_>) {
        let group = context.plan.groups.get(self.group as usize);
        let Some(wires) = group.and_then(|group| group.sets.get(set as usize)).map(|set| &set.wires) else { return };
        let count = self.open_sets.entry(set).or_default();
        *count = if open { *count + 1 } else { count.saturating_sub(1) };
        let mut flipped = Vec::new();
        for &wire in wires {
            let count = self.open.entry(wire).or_default();
            let flips = if open { *count == 0 } else { *count == 1 };
            *count = if open { *count + 1 } else { count.saturating_sub(1) };
            flipped.extend(Some(wire).filter(|_| flips));
        }
        self.flip(&flipped, open, context, out);
    }

    /// Uses the connection sets as the plan has them now: opens and closes the wires by which open sets have changed.
    pub fn rewire(&mut self, context: ExecContext<'_>, out: &mut Out<'_>) {
        let Some(group) = context.plan.groups.get(self.group as usize) else { return };
        self.consumers = consumers(context.plan, group);
        let mut counts: BTreeMap<u32, u32> = BTreeMap::new();
        for (set, count) in &self.open_sets {
            for wire in group.sets.get(*set as usize).map_or(&[][..], |set| &set.wires) {
                *counts.entry(*wire).or_default() += count;
            }
        }
        let before = std::mem::replace(&mut self.open, counts);
        let is_open = |counts: &BTreeMap<u32, u32>, wire: &u32| counts.get(wire).is_some_and(|count| *count > 0);
        let (opened, closed): (Vec<u32>, Vec<u32>) = (
            self.open.keys().copied().filter(|wire| is_open(&self.open, wire) && !is_open(&before, wire)).collect(),
            before.keys().copied().filter(|wire| is_open(&before, wire) && !is_open(&self.open, wire)).collect(),
        );
        self.flip(&opened, true, context, out);
        self.flip(&closed, false, context, out);
    }

    /// Opens or closes wires, one message to each host of producers.
    pub(super) fn flip(&mut self, flipped: &[u32], open: bool, context: ExecContext<'_>, out: &mut Out<'_>) {
        let mut by_host: BTreeMap<&str, (Vec<u32>, BTreeSet<u32>)> = BTreeMap::new();
        for &wire in flipped {
            let Some(ends) = context.plan.wires.get(wire as usize) else { continue };
            if let Some(host) = leaf_host(context.plan, ends.from.leaf) {
                let (wires, consumers) = by_host.entry(host).or_default();
                wires.push(wire);
                consumers.extend(self.consumers.get(&ends.to.leaf));
            }
        }
        for (host, (wires, consumers)) in by_host {
            self.generation += 1;
            let generation = self.generation;
            if open {
                self.unconfirmed.insert(generation, Unconfirmed { host: host.to_owned(), consumers });
            }
            let order = ToParticipant::Switch { wires, open, group: self.group, generation };
            out.send(host, context.deployment.to_participant(order));
        }
    }
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
