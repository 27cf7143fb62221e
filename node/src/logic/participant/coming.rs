//! Programs and groups that are added to the deployment while it runs, and those that are taken away.
//!
//! An added program is started with the others that a change starts, makes its links with them, and is idle until the event actions
//! of its group activate it. One that is taken away has been stopped by its supervisor when it adopted the change; it leaves
//! once the change has held everywhere, and so it is there again at once if the change is taken back.

use super::Participant;
use crate::logic::effect::Out;
use crate::logic::executer::{Executer, below_using, group_host};
use crate::logic::instance::{Instance, InstanceContext, Start};
use crate::logic::protocol::{LeafFacts, Target};
use language::plan::{LeafKind, Plan};
use std::collections::BTreeMap;
use std::sync::Arc;

impl Participant {
    /// Returns why groups of this host cannot go on with the event actions of a plan.
    pub(super) fn against_actions(&self, plan: &Plan) -> Vec<String> {
        self.executers.iter().filter_map(|(_, executer)| executer.against_actions(plan)).collect()
    }

    /// Gives the groups of the plan that are new on this host their supervisors.
    pub(super) fn add_groups(&mut self, host: &str) {
        let plan = Arc::clone(&self.plan);
        // A program whose place another one takes is supervised until it has left.
        self.supervisors.extend(supervisors(&plan));
        let below = below_using(&plan);
        for number in plan.live_groups().into_iter().filter(|number| group_host(&plan, *number) == Some(host)) {
            if !self.executers.contains(number)
                && let Some(executer) = Executer::new(&plan, number, below.contains(&number))
            {
                self.executers.insert(number, executer);
            }
        }
    }

    /// Starts a program that is added.
    pub(super) fn add(&mut self, leaf: u32, start: Start, out: &mut Out<'_>) {
        let Some(change) = &mut self.change else { return };
        change.starting.insert(leaf);
        change.probing.insert(leaf);
        change.adding.insert(leaf);
        let (probation, since_go, mut notes) = (change.probation, self.since_go(out.now), Vec::new());
        let mut context = InstanceContext { now: out.now, since_go, effects: out.effects, notes: &mut notes };
        let instance = Instance::add(start, probation, &mut context);
        self.instances.insert(leaf, instance);
    }

    /// Returns whether a program is being added.
    pub(super) fn is_adding(&self, leaf: u32) -> bool {
        self.change.as_ref().is_some_and(|change| change.adding.contains(&leaf))
    }

    /// Takes note that a program that is added is up.
    pub(super) fn added(&mut self, facts: LeafFacts, out: &mut Out<'_>) {
        if let Some(device) = facts.owns.iter().chain(&facts.needs).next()
            && self.overlaps(facts.leaf)
        {
            let path = self.path(facts.leaf).unwrap_or_default();
            let why = format!("two programs of `{path}` cannot overlap: it uses the device `{device}`, and both would");
            return self.fail_change(&why, out);
        }
        self.hold_own(&facts);
        if let Some(change) = &mut self.change {
            change.starting.remove(&facts.leaf);
            change.facts.push(facts);
        }
        self.report_change(out);
    }

    /// Returns whether another program has the path of this one.
    fn overlaps(&self, leaf: u32) -> bool {
        self.instances.iter().any(|(other, _)| other != leaf && self.path(other) == self.path(leaf))
    }

    /// Takes note that a program that is added cannot take part.
    pub(super) fn not_added(&mut self, leaf: u32, why: &str, out: &mut Out<'_>) {
        let Some(change) = &mut self.change else { return };
        change.adding.remove(&leaf);
        change.probing.remove(&leaf);
        let path = self.path(leaf).unwrap_or_default().to_owned();
        self.fail_change(&format!("`{path}` cannot be added: {why}"), out);
    }

    /// Makes the links of the programs that are added.
    pub(super) fn link_added(&mut self, out: &mut Out<'_>) {
        let Some(change) = &self.change else { return };
        for leaf in change.adding.clone() {
            let is_plain = self.plan.leaves.get(leaf as usize).is_none_or(|leaf| leaf.kind == LeafKind::Plain);
            match self.orders(leaf) {
                Ok(_) if is_plain => self.with_instance(leaf, out, |instance, context| {
                    instance.connect_plain();
                    instance.is_added(context);
                }),
                Ok(orders) => {
                    if let Some(change) = &mut self.change {
                        change.linking.insert(leaf);
                    }
                    self.with_instance(leaf, out, |instance, context| instance.connect(orders, context));
                }
                Err(reasons) => self.fail_change(&reasons.join("; "), out),
            }
        }
    }

    /// A change has held, or was taken back, everywhere: what is not in the plan any more leaves.
    pub(super) fn settle_change(&mut self, out: &mut Out<'_>) {
        self.change = None;
        self.succeeding.clear();
        self.unlink(out);
        self.supervisors = supervisors(&self.plan);
        let live = self.plan.live_leaves();
        self.registrations.facts.retain(|leaf, _| live.contains(leaf));
        self.externals.retain(|leaf, _| live.contains(leaf));
        for leaf in self.instances.numbers().into_iter().filter(|leaf| !live.contains(leaf)) {
            self.with_instance(leaf, out, Instance::leave);
        }
        self.free_claims();
    }

    /// Takes note that nothing of a program is left. One that was taken away is forgotten; what it held is free.
    pub(super) fn removed(&mut self, leaf: u32) {
        let is_gone = self.instances.get(leaf).is_some_and(|instance| !instance.is_unconfirmed());
        if is_gone && self.change.is_none() && !self.plan.live_leaves().contains(&leaf) {
            self.instances.remove(leaf);
            self.free_claims();
        }
    }

    /// Frees what only programs have held that are not there any more.
    fn free_claims(&mut self) {
        let live = self.plan.live_leaves();
        if self.instances.iter().all(|(leaf, _)| live.contains(&leaf)) {
            self.claims = self.claims_now();
        }
    }
}

/// For each process, the group and slot that supervise it.
pub(super) fn supervisors(plan: &Plan) -> BTreeMap<Target, (u32, u32)> {
    let mut supervisors = BTreeMap::new();
    for (group, members) in (0_u32..).zip(plan.groups.iter().map(|group| &group.members)) {
        for (slot, member) in (0_u32..).zip(members) {
            supervisors.insert(member.kind.into(), (group, slot));
        }
    }
    supervisors
}
