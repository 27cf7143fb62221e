//! A change of the deployment while it runs, as this host carries it out.
//!
//! ```text
//! Apply ──▶ the programs of the next plan are started     Link ──▶ its links are made, beside those that are still used
//! Adopt ──▶ supervisors use the next connection sets      Settle ──▶ links, programs and claims that have gone are dropped
//! ```
//! Between `Link` and `Settle` the wires of both plans are linked. So no value is lost on a wire that stays, a new wire
//! is open only when both its ends are up, and a change that is taken back finds its links.
//!
//! An added program is idle until the event actions of its group activate it. A program that is taken away is stopped by its supervisor
//! at `Adopt` and leaves at `Settle`, so it is there again at once if the change is taken back.

use super::succession::Succeeding;
use super::{Participant, Phase};
use crate::logic::claims::Claims;
use crate::logic::effect::{Effect, Out, ProcessId};
use crate::logic::executer::{Executer, below_using, group_host, leaf_host};
use crate::logic::instance::{Instance, InstanceContext, Start};
use crate::logic::programs::{self, Programs};
use crate::logic::protocol::{ChangeOrder, ChangeReply, LeafFacts, Target, ToCoordinator};
use language::plan::{LeafKind, Plan};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

/// The change of the deployment.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Changes {
    pub(super) current: Option<Changing>,
    /// Programs that are to take the place of others and are not running yet.
    pub(super) succeeding: BTreeMap<u32, Succeeding>,
}

/// A change that is being carried out.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Changing {
    pub(super) number: u32,
    /// New programs that are not up yet.
    pub(super) starting: BTreeSet<u32>,
    /// Programs whose links are not made yet.
    pub(super) linking: BTreeSet<u32>,
    /// New programs that are on probation.
    pub(super) probing: BTreeSet<u32>,
    /// The wires that come or go.
    rewired: BTreeSet<u32>,
    /// The next reply that the home waits for, if any.
    next: Next,
    /// Programs that are added, and are not linked yet.
    pub(super) adding: BTreeSet<u32>,
    /// The locations of the added programs.
    pub(super) facts: Vec<LeafFacts>,
    /// How long a new program has to stay healthy.
    pub(super) probation: Duration,
    /// Whether it takes another change back.
    is_undoing: bool,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
enum Next {
    #[default]
    Applied,
    Linked,
    Healthy,
    Nothing,
}

impl Participant {
    /// Takes a step of a change.
    pub fn take_change(&mut self, order: ChangeOrder, host: &str, programs: &Programs, out: &mut Out<'_>) {
        match order {
            ChangeOrder::Examine { number, plan } => {
                self.examine(number, &plan, programs, out);
            }
            ChangeOrder::Apply { number, plan, again, probation } => match self.starts(&plan, host, programs) {
                Ok(starts) => self.apply(number, plan, &again, probation, starts, out),
                Err(reasons) => {
                    let reason = format!("host `{host}`: {}", reasons.join("; "));
                    self.answer_change(ChangeReply::Failed { number, reason }, out);
                }
            },
            ChangeOrder::Link { number } => self.link_change(number, Vec::new(), out),
            ChangeOrder::LinkAlso { number, facts } => self.link_change(number, facts, out),
            ChangeOrder::Settle { .. } => self.settle_change(out),
            ChangeOrder::Adopt { number } => {
                if self.changes.current.as_ref().is_some_and(|change| change.number == number) {
                    self.adopt_sets(out);
                    self.changes.current.iter_mut().for_each(|change| change.next = Next::Healthy);
                    self.report_change(out);
                }
            }
        }
    }

    /// Holds the devices that a controller says are its own.
    pub(super) fn hold_own(&mut self, facts: &LeafFacts) {
        let path = self.path(facts.leaf).unwrap_or_default();
        self.claims.extend(Claims::of_owner(path, &facts.owns));
    }

    /// Returns the devices that the programs of this host hold by the current plan, and by their own reports.
    pub(super) fn claims_now(&self) -> Claims {
        let mut claims = Claims::of(&self.site.plan, &self.site.host);
        let own = self.links.registrations.facts.values();
        let own = own.filter(|facts| leaf_host(&self.site.plan, facts.leaf) == Some(&self.site.host));
        // A program of another deployment holds its devices itself.
        for facts in own.filter(|facts| self.site.plan.external(facts.leaf).is_none()) {
            let path = self.path(facts.leaf).unwrap_or_default();
            claims.extend(Claims::of_owner(path, &facts.owns));
        }
        claims
    }

    /// Reports why the next plan cannot be taken on here, once it is known whether the differing programs can be started.
    fn examine(&self, number: u32, plan: &Plan, programs: &Programs, out: &mut Out<'_>) {
        let host = &self.site.host;
        let mut against = self.against_actions(plan);
        against.extend(self.unended_without(plan));
        let starts = if self.phase == Phase::Running {
            self.starts(plan, host, programs)
                .and_then(|starts| if against.is_empty() { Ok(starts) } else { Err(against) })
        } else {
            Err(vec!["the deployment does not run there".to_owned()])
        };
        match starts {
            Ok(starts) => {
                let differs = |(leaf, start): &(u32, Start)| {
                    self.instances.get(*leaf).is_none_or(|instance| !instance.is_same_program(start))
                };
                let differing = starts.into_iter().filter(differs);
                let programs = differing.map(|(_, start)| start.order).collect();
                out.effects.push(Effect::FindPrograms { deployment: self.site.deployment.clone(), number, programs });
            }
            Err(problems) => self.examined(number, problems, out),
        }
    }

    /// Tells the home the reasons against the next plan here.
    pub fn examined(&self, number: u32, problems: Vec<String>, out: &mut Out<'_>) {
        let host = &self.site.host;
        let reasons = problems.into_iter().map(|why| format!("host `{host}`: {why}")).collect();
        self.answer_change(ChangeReply::Examined { number, reasons }, out);
    }

    /// Returns how each program of this host is started by a plan.
    pub(super) fn starts(&self, plan: &Plan, host: &str, offered: &Programs) -> Result<Vec<(u32, Start)>, Vec<String>> {
        let (mut starts, mut problems, live) = (Vec::new(), Vec::new(), plan.live_leaves());
        let is_mine = |number: &u32| live.contains(number) && leaf_host(plan, *number) == Some(host);
        let started = (0_u32..).zip(&plan.leaves).filter(|(_, leaf)| leaf.external.is_none());
        for (number, leaf) in started.filter(|(number, _)| is_mine(number)) {
            let process = ProcessId { deployment: self.site.deployment.clone(), leaf: number };
            match offered.command(leaf) {
                Ok(command) => {
                    let order = programs::order(process, command, plan, leaf);
                    starts.push((number, Start { order, stop_within: leaf.stop_within }));
                }
                Err(why) => problems.push(why),
            }
        }
        problems.dedup();
        if problems.is_empty() { Ok(starts) } else { Err(problems) }
    }

    fn apply(
        &mut self,
        number: u32,
        plan: Plan,
        again: &[u32],
        probation: Duration,
        starts: Vec<(u32, Start)>,
        out: &mut Out<'_>,
    ) {
        let is_undoing = self.changes.current.is_some();
        let before = std::mem::replace(&mut self.site.plan, Arc::new(plan));
        self.extend_relevant();
        self.add_groups();
        let mut live = self.site.plan.live_wires();
        let rewired: BTreeSet<u32> = self.links.live.symmetric_difference(&live).copied().collect();
        // The programs that are put back cannot link to a program that never arrived.
        let has_come = |leaf: u32| self.links.registrations.facts.contains_key(&leaf);
        let both = |wire: &&u32| {
            self.site
                .plan
                .wires
                .get(**wire as usize)
                .is_some_and(|wire| has_come(wire.from.leaf) && has_come(wire.to.leaf))
        };
        live.extend(self.links.live.iter().filter(both));
        self.links.live = live;
        self.claims.extend(Claims::of(&self.site.plan, &self.site.host));
        self.changes.current = Some(Changing { number, rewired, probation, is_undoing, ..Changing::default() });
        for (leaf, start) in starts {
            if !self.instances.contains(leaf) {
                self.add(leaf, start, out);
                continue;
            }
            let instance = self.instances.get(leaf);
            let is_same = instance.is_some_and(|instance| instance.is_same_program(&start));
            let is_returning = instance.is_some_and(Instance::is_returning);
            let is_retyped = before.leaves.get(leaf as usize).map(|leaf| &leaf.module)
                != self.site.plan.leaves.get(leaf as usize).map(|leaf| &leaf.module);
            let is_reclaimed = before.claims_of(leaf) != self.site.plan.claims_of(leaf);
            let is_kept = is_same && !is_retyped && !is_reclaimed && !again.contains(&leaf);
            if let Some(change) = self.changes.current.as_mut().filter(|_| !is_kept || is_returning) {
                change.starting.insert(leaf);
                change.probing.insert(leaf);
            }
            if is_kept {
                self.instances.with(leaf, |instance| instance.settle(start));
                continue;
            }
            self.with_instance(leaf, out, |instance, context| match is_undoing {
                true => instance.take_back(start, probation, context),
                false => instance.replace(start, probation, context),
            });
        }
        self.report_change(out);
    }

    fn link_change(&mut self, number: u32, facts: Vec<LeafFacts>, out: &mut Out<'_>) {
        let Some(change) = self.changes.current.as_mut().filter(|change| change.number == number) else { return };
        change.next = Next::Linked;
        let rewired = change.rewired.clone();
        self.links.registrations.facts.extend(facts.into_iter().map(|facts| (facts.leaf, facts)));
        self.link_added(out);
        self.link_again(&rewired, out);
        self.report_change(out);
    }

    /// Has the programs that stay make the links of these wires that are live, and drop the others.
    fn link_again(&mut self, rewired: &BTreeSet<u32>, out: &mut Out<'_>) {
        let ends = rewired.iter().filter_map(|wire| self.site.plan.wires.get(*wire as usize));
        let touched: BTreeSet<u32> = ends.flat_map(|wire| [wire.from.leaf, wire.to.leaf]).collect();
        for leaf in touched.into_iter().filter(|leaf| self.instances.contains(*leaf)).collect::<Vec<_>>() {
            let is_plain = self.site.plan.leaves.get(leaf as usize).is_none_or(|leaf| leaf.kind == LeafKind::Plain);
            if is_plain {
                continue;
            }
            match self.orders(leaf) {
                Ok(orders) => {
                    let mut answers = false;
                    self.with_instance(leaf, out, |instance, context| answers = instance.link_again(orders, context));
                    if let Some(change) = &mut self.changes.current
                        && answers
                        && change.next == Next::Linked
                    {
                        change.linking.insert(leaf);
                    }
                }
                Err(reasons) => self.fail_change(&reasons.join("; "), out),
            }
        }
    }

    pub(super) fn linked(&mut self, leaf: u32, made: Result<(), String>, out: &mut Out<'_>) {
        if !self.changes.current.as_mut().is_some_and(|change| change.linking.remove(&leaf)) {
            return;
        }
        match made {
            Ok(()) => self.report_change(out),
            Err(why) => {
                let path = self.path(leaf).unwrap_or_default().to_owned();
                self.fail_change(&format!("`{path}`: {why}"), out);
            }
        }
    }

    pub(super) fn replaced(&mut self, leaf: u32, out: &mut Out<'_>) {
        if let Some(change) = &mut self.changes.current {
            change.starting.remove(&leaf);
        }
        self.report_change(out);
    }

    pub(super) fn healthy(&mut self, leaf: u32, out: &mut Out<'_>) {
        if let Some(change) = &mut self.changes.current {
            change.probing.remove(&leaf);
        }
        self.report_change(out);
    }

    pub(super) fn unhealthy(&mut self, leaf: u32, why: &str, out: &mut Out<'_>) {
        let is_meant = self.changes.current.as_mut().is_some_and(|change| change.probing.remove(&leaf));
        if is_meant {
            let path = self.path(leaf).unwrap_or_default().to_owned();
            self.fail_change(&format!("the new program of `{path}` was not healthy: {why}"), out);
        }
    }

    /// A program that was to make links is gone. Its successor makes its own links.
    pub(super) fn forget_linking(&mut self, leaf: u32, out: &mut Out<'_>) {
        let is_there = self.instances.get(leaf).is_some_and(Instance::is_linked);
        if !is_there && self.changes.current.as_mut().is_some_and(|change| change.linking.remove(&leaf)) {
            self.report_change(out);
        }
    }

    pub(super) fn fail_change(&mut self, reason: &str, out: &mut Out<'_>) {
        if let Some(number) = self.changes.current.as_ref().map(|change| change.number) {
            self.answer_change(ChangeReply::Failed { number, reason: reason.to_owned() }, out);
        }
    }

    fn adopt_sets(&mut self, out: &mut Out<'_>) {
        let against = self.against_actions(&Arc::clone(&self.site.plan));
        if !against.is_empty() && self.changes.current.as_ref().is_some_and(|change| !change.is_undoing) {
            return self.fail_change(&against.join("; "), out);
        }
        for group in self.executers.numbers() {
            self.with_executer(group, out, |executer, context, out| {
                executer.rewire(context, out);
                executer.adopt_actions(context, out)
            });
        }
    }

    /// Drops the links that the plan does not have any more. By then the values under way over them have arrived.
    pub(super) fn unlink(&mut self, out: &mut Out<'_>) {
        let live = self.site.plan.live_wires();
        let gone: BTreeSet<u32> = self.links.live.difference(&live).copied().collect();
        self.links.live = live;
        self.link_again(&gone, out);
    }

    /// Tells the home that its condition is met, once that is the case.
    pub(super) fn report_change(&mut self, out: &mut Out<'_>) {
        let hands_over = self.changes.current.is_some() && self.hands_over();
        let Some(change) = &mut self.changes.current else { return };
        let number = change.number;
        let (is_so, reply) = match change.next {
            Next::Applied if change.facts.is_empty() => (change.starting.is_empty(), ChangeReply::Applied { number }),
            Next::Applied => {
                let facts = change.facts.clone();
                (change.starting.is_empty(), ChangeReply::Joined { number, facts })
            }
            Next::Linked => (change.linking.is_empty(), ChangeReply::Linked { number }),
            Next::Healthy => (change.probing.is_empty() && !hands_over, ChangeReply::Healthy { number }),
            Next::Nothing => return,
        };
        if is_so {
            change.next = Next::Nothing;
            self.answer_change(reply, out);
        }
    }

    fn answer_change(&self, reply: ChangeReply, out: &mut Out<'_>) {
        self.site.tell_home(ToCoordinator::Change(reply), out);
    }

    /// Returns why groups of this host cannot go on with the event actions of a plan.
    pub(super) fn against_actions(&self, plan: &Plan) -> Vec<String> {
        self.executers.iter().filter_map(|(_, executer)| executer.against_actions(plan)).collect()
    }

    /// Gives the groups of the plan that are new on this host their supervisors.
    pub(super) fn add_groups(&mut self) {
        let host = self.site.host.as_str();
        let plan = Arc::clone(&self.site.plan);
        // A program that is being replaced is supervised until it has left.
        self.site.supervisors.extend(supervisors(&plan));
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
        let Some(change) = &mut self.changes.current else { return };
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
        self.changes.current.as_ref().is_some_and(|change| change.adding.contains(&leaf))
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
        if let Some(change) = &mut self.changes.current {
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
        let Some(change) = &mut self.changes.current else { return };
        change.adding.remove(&leaf);
        change.probing.remove(&leaf);
        let path = self.path(leaf).unwrap_or_default().to_owned();
        self.fail_change(&format!("`{path}` cannot be added: {why}"), out);
    }

    /// Makes the links of the programs that are added.
    pub(super) fn link_added(&mut self, out: &mut Out<'_>) {
        let Some(change) = &self.changes.current else { return };
        for leaf in change.adding.clone() {
            let is_plain = self.site.plan.leaves.get(leaf as usize).is_none_or(|leaf| leaf.kind == LeafKind::Plain);
            match self.orders(leaf) {
                Ok(_) if is_plain => self.with_instance(leaf, out, |instance, context| {
                    instance.connect_plain();
                    instance.is_added(context);
                }),
                Ok(orders) => {
                    if let Some(change) = &mut self.changes.current {
                        change.linking.insert(leaf);
                    }
                    self.with_instance(leaf, out, |instance, context| instance.connect(orders, context));
                }
                Err(reasons) => self.fail_change(&reasons.join("; "), out),
            }
        }
    }

    /// A change has held, or was taken back, everywhere: programs that are not in the plan any more leave.
    pub(super) fn settle_change(&mut self, out: &mut Out<'_>) {
        self.changes.current = None;
        self.changes.succeeding.clear();
        self.unlink(out);
        self.site.supervisors = supervisors(&self.site.plan);
        let live = self.site.plan.live_leaves();
        self.links.registrations.facts.retain(|leaf, _| live.contains(leaf));
        self.externals.retain(|leaf, _| live.contains(leaf));
        for leaf in self.instances.numbers().into_iter().filter(|leaf| !live.contains(leaf)) {
            self.with_instance(leaf, out, Instance::leave);
        }
        self.free_claims();
    }

    /// Nothing of a program is left. A program that was taken away is forgotten, and its claims are free.
    pub(super) fn removed(&mut self, leaf: u32) {
        let is_gone = self.instances.get(leaf).is_some_and(|instance| !instance.is_unconfirmed());
        if is_gone && self.changes.current.is_none() && !self.site.plan.live_leaves().contains(&leaf) {
            self.instances.remove(leaf);
            self.free_claims();
        }
    }

    /// Frees the devices that were held only by programs that are gone.
    fn free_claims(&mut self) {
        let live = self.site.plan.live_leaves();
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
