//! Members whose next program replaces the present program while both programs run.
//!
//! ```text
//! rewire ─the next ones get the activations─▶ pending ─all of them run─▶ a switch ─taken─▶ the ones before are stopped
//!                                                └─ an event moves wires or members: at once
//! ```
//! The switch has one in-band boundary. A producer of the old program sends to the next program from the boundary on.
//! The old program closes its outputs once it has processed the values before the boundary. The
//! next program opens its outputs before it processes the values after the boundary. Consumers take
//! the old values first. So nothing is lost, doubled or reordered.

use super::members::MemberRef;
use super::switching::{Handover, pushes_to};
use super::wires::{Difference, ends_before};
use super::{ExecContext, Executer, leaf_host, member_target};
use crate::logic::effect::Out;
use crate::logic::protocol::{Target, ToParticipant};
use comms::logic::switch::{Flip, Opening};
use language::algebra::Activity;
use language::plan::{Group, MemberKind, Plan};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Members whose place others are about to take.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Succession {
    /// The running members, by slot, with their activations: the next programs take these over.
    begun: BTreeMap<u32, u32>,
    /// The next programs that do not run yet.
    starting: BTreeSet<u32>,
    /// Programs that are not there to hand over their state.
    gone: BTreeSet<u32>,
}

/// A program whose place another one has taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Succeeded {
    /// The program, and the program that replaces it.
    old: u32,
    new: u32,
    /// Its activation.
    activation: u32,
    /// Whether it is there to hand its connections over.
    is_there: bool,
}

impl Executer {
    /// Uses the connection sets as the plan has them now, and the programs.
    pub fn rewire(&mut self, context: ExecContext<'_>, out: &mut Out<'_>) {
        let Some(group) = context.plan.groups.get(self.group as usize) else { return };
        // A succession that was not made is taken back: the programs it has begun leave with the change.
        self.switches.succession = None;
        let mut succession = Succession::default();
        for (slot, (_, leaf)) in self.pairs(group) {
            let Some((_, host)) = member_target(context.plan, group, slot) else { continue };
            let is_meant = !self.members.is_waiting(slot) && !self.is_stopping(slot);
            let Some(activation) = self.members.activation(slot).filter(|_| is_meant) else { continue };
            succession.starting.insert(leaf);
            succession.begun.insert(slot, activation);
            let value = self.members.value(slot);
            let order = ToParticipant::Succeed { group: self.group, leaf, activation, value };
            out.send(host, context.deployment.to_participant(order));
        }
        self.switches.succession = Some(succession);
        self.succeed_if_ready(context, out);
    }

    /// Takes note that a program now runs beside the program that it is to replace.
    pub fn succeeding(&mut self, leaf: u32, is_handed_over: bool, context: ExecContext<'_>, out: &mut Out<'_>) {
        let Some(group) = context.plan.groups.get(self.group as usize) else { return };
        let Some(succession) = &mut self.switches.succession else { return };
        succession.starting.remove(&leaf);
        if !is_handed_over {
            let old = self.members.all_acting().find(|(slot, _)| leaf_of(group, *slot) == Some(leaf));
            succession.gone.extend(old.map(|(_, old)| old));
        }
        self.succeed_if_ready(context, out);
    }

    /// Returns whether programs are about to hand their connections over.
    pub fn hands_over(&self) -> bool {
        self.switches.hand_over()
    }

    fn succeed_if_ready(&mut self, context: ExecContext<'_>, out: &mut Out<'_>) {
        if self.switches.succession.as_ref().is_some_and(|succession| succession.starting.is_empty()) {
            self.succeed_now(context, out);
        }
    }

    /// Puts the next programs in the place of those before, also where they do not run yet.
    pub(super) fn succeed_now(&mut self, context: ExecContext<'_>, out: &mut Out<'_>) {
        let Some(Succession { begun, gone, .. }) = self.switches.succession.take() else { return };
        let Some(group) = context.plan.groups.get(self.group as usize) else { return };
        let mut succeeded = Vec::new();
        self.members.forget_next();
        for (slot, (old, new)) in self.pairs(group) {
            let activation = begun.get(&slot).copied();
            let activation = activation.filter(|it| self.members.is_current(MemberRef { slot, activation: *it }));
            let is_there = !gone.contains(&old);
            succeeded.extend(activation.map(|activation| Succeeded { old, new, activation, is_there }));
            // A member that is being stopped reports its end itself.
            if activation.is_some() || !self.is_stopping(slot) {
                self.members.act_as(slot, new);
            } else {
                self.members.act_next_as(slot, new);
            }
        }
        for (slot, leaf) in acting(group) {
            if self.members.acting(slot).is_none() {
                self.members.act_as(slot, leaf);
            }
        }
        let difference = self.wires.recount(context.plan, group);
        if succeeded.is_empty() {
            self.begin_switch(difference, context, out);
        } else {
            self.hand_over(difference, succeeded, context, out);
        }
    }

    /// Returns whether a member was told to stop, and has not ended.
    fn is_stopping(&self, slot: u32) -> bool {
        self.members.is_active(slot) && self.state.activity(slot) == Activity::Stopping
    }

    /// Returns whether to use the report of a process about the end of a slot's activation, because there may be two
    /// programs of one process.
    pub fn speaks(&mut self, slot: u32, target: Target, context: ExecContext<'_>, out: &mut Out<'_>) -> bool {
        let Target::Leaf(leaf) = target else { return true };
        let next = context.plan.groups.get(self.group as usize).and_then(|group| leaf_of(group, slot));
        let is_acting = self.members.acting(slot) == Some(leaf);
        let is_pending =
            self.switches.succession.as_ref().is_some_and(|succession| succession.begun.contains_key(&slot));
        if is_pending && self.members.is_active(slot) && (is_acting || next == Some(leaf)) {
            // Either has ended before the other one has taken over, or could.
            self.succeed_now(context, out);
            return next == Some(leaf);
        }
        is_acting
    }

    /// Returns a member and its host: of two programs, the running one.
    pub(super) fn target<'a>(&self, plan: &'a Plan, group: &Group, slot: u32) -> Option<(Target, &'a str)> {
        match (member_target(plan, group, slot)?, self.members.acting(slot)) {
            ((Target::Leaf(_), _), Some(leaf)) => Some((Target::Leaf(leaf), leaf_host(plan, leaf)?)),
            (found, _) => Some(found),
        }
    }

    /// Returns, by slot, the running leaves and the leaves of the plan, if they differ.
    fn pairs(&self, group: &Group) -> BTreeMap<u32, (u32, u32)> {
        let pair = |(slot, old)| Some((slot, (old, leaf_of(group, slot)?)));
        self.members.all_acting().filter_map(pair).filter(|(_, (old, new))| old != new).collect()
    }

    /// Hands the connections of programs over to those in their places.
    fn hand_over(
        &mut self,
        difference: Difference,
        succeeded: Vec<Succeeded>,
        context: ExecContext<'_>,
        out: &mut Out<'_>,
    ) {
        self.hurry_handovers(context, out);
        let (plan, generation) = (context.plan, self.wires.next_generation());
        let from = |wire: u32| plan.wires.get(wire as usize).map(|wire| wire.from.leaf);
        let is_gone = |leaf: u32| succeeded.iter().any(|one| one.old == leaf && !one.is_there);
        // A missing program is not expected to take something, or to report that it sends nothing more.
        let ends = |wire: u32| plan.wires.get(wire as usize).map(|wire| [wire.from.leaf, wire.to.leaf]);
        let is_unheard = |wire: &u32| ends(*wire).is_none_or(|ends| ends.into_iter().any(is_gone));
        let unheard: BTreeSet<u32> = difference.close.iter().copied().filter(is_unheard).collect();
        let close: Vec<u32> = difference.close.iter().copied().filter(|wire| !unheard.contains(wire)).collect();
        let is_fed = |wires: &[u32], leaf: u32| wires.iter().any(|wire| pushes_to(plan, *wire, leaf));
        let (mut then, new) = (BTreeMap::<u32, Flip>::new(), || Flip { generation, ..Flip::default() });
        for (wire, leaf) in close.iter().filter_map(|wire| Some((*wire, from(*wire)?))) {
            if succeeded.iter().any(|one| one.old == leaf) && is_fed(&close, leaf) {
                then.entry(leaf).or_insert_with(new).close.push(wire);
            }
        }
        for (wire, leaf) in difference.open.iter().filter_map(|wire| Some((*wire, from(*wire)?))) {
            if succeeded.iter().any(|one| one.new == leaf) && is_fed(&difference.open, leaf) {
                let after = ends_before(plan, &close, wire);
                then.entry(leaf).or_insert_with(new).open.push(Opening { wire, after });
            }
        }
        self.begin_handover(Handover { generation, difference, unheard, succeeded, then }, context, out);
    }

    /// Puts the next program of a member in its place, if that waits for it: it is to be stopped together with the
    /// previous one.
    pub(super) fn succeed_member(&mut self, slot: u32, context: ExecContext<'_>, out: &mut Out<'_>) {
        if self.switches.succession.as_ref().is_some_and(|succession| succession.begun.contains_key(&slot)) {
            self.succeed_now(context, out);
        }
    }

    /// Makes a member that is activated use the leaf of the plan.
    pub(super) fn renew_member(&mut self, slot: u32, context: ExecContext<'_>, out: &mut Out<'_>) {
        let Some(group) = context.plan.groups.get(self.group as usize) else { return };
        if self.switches.succession.is_some() && self.pairs(group).contains_key(&slot) {
            self.succeed_now(context, out);
        }
        self.members.renew(slot);
    }

    /// Stops the programs whose places were taken.
    pub(super) fn stop_succeeded(&self, succeeded: &[Succeeded], context: ExecContext<'_>, out: &mut Out<'_>) {
        let Some(group) = context.plan.groups.get(self.group as usize) else { return };
        // A program is kept if a change that is taken back needs it again.
        let is_back = |leaf: u32| group.members.iter().any(|member| member.kind == MemberKind::Leaf(leaf));
        for Succeeded { old, activation, .. } in succeeded.iter().filter(|one| !is_back(one.old)) {
            let Some(host) = leaf_host(context.plan, *old) else { continue };
            let order = ToParticipant::Stop { target: Target::Leaf(*old), activation: *activation };
            out.send(host, context.deployment.to_participant(order));
        }
    }
}

/// Returns the leaf of each slot that is one.
pub(super) fn acting(group: &Group) -> BTreeMap<u32, u32> {
    let slots = 0..u32::try_from(group.members.len()).unwrap_or(u32::MAX);
    slots.filter_map(|slot| Some((slot, leaf_of(group, slot)?))).collect()
}

fn leaf_of(group: &Group, slot: u32) -> Option<u32> {
    match group.members.get(slot as usize)?.kind {
        MemberKind::Leaf(leaf) => Some(leaf),
        MemberKind::Group(_) => None,
    }
}
