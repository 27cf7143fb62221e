//! A change of the deployment while it runs, as this host carries it out.
//!
//! `Apply` brings the programs of the next plan, `Link` its links, beside the links that are still used; `Adopt` has the supervisors
//! use the next connection sets; `Settle` drops the links that those do not have any more, and frees the devices that no program
//! claims any more. In between both kinds of wires are linked, so no value is lost on a wire that stays, a new one is open only when
//! both its ends stand, and what is taken back is there.

use super::{Participant, Phase};
use crate::logic::claims::Claims;
use crate::logic::effect::{Effect, Out, ProcessId};
use crate::logic::executer::leaf_host;
use crate::logic::instance::{Instance, Start};
use crate::logic::programs::{self, Programs};
use crate::logic::protocol::{ChangeOrder, ChangeReply, LeafFacts, ToCoordinator};
use language::plan::{LeafKind, Plan};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

/// A change that is being carried out.
#[derive(Debug, Serialize, Deserialize)]
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
    /// The next word that the home waits for, if any.
    next: Next,
    /// Programs that are added, and are not linked yet.
    pub(super) adding: BTreeSet<u32>,
    /// Where they are.
    pub(super) facts: Vec<LeafFacts>,
    /// How long a new program has to stay healthy.
    pub(super) probation: Duration,
    /// Whether it takes another change back.
    is_undoing: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Next {
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
                self.examine((number, &plan), host, programs, out);
            }
            ChangeOrder::Apply { number, plan, again, probation } => match self.starts(&plan, host, programs) {
                Ok(starts) => self.apply((number, plan, again, probation), (host, starts), out),
                Err(reasons) => {
                    let reason = format!("host `{host}`: {}", reasons.join("; "));
                    self.answer_change(ChangeReply::Failed { number, reason }, out);
                }
            },
            ChangeOrder::Link { number } => self.link_change(number, Vec::new(), out),
            ChangeOrder::LinkAlso { number, facts } => self.link_change(number, facts, out),
            ChangeOrder::Settle { .. } => self.settle_change(out),
            ChangeOrder::Adopt { number } => {
                if self.change.as_ref().is_some_and(|change| change.number == number) {
                    self.adopt_sets(out);
                    self.change.iter_mut().for_each(|change| change.next = Next::Healthy);
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

    /// Returns what the programs of this host hold by the plan as it is, and by their own word.
    pub(super) fn claims_now(&self) -> Claims {
        let mut claims = Claims::of(&self.plan, &self.host);
        let own = self.registrations.facts.values();
        let own = own.filter(|facts| leaf_host(&self.plan, facts.leaf) == Some(&self.host));
        // What another deployment runs has its devices itself.
        for facts in own.filter(|facts| self.plan.external(facts.leaf).is_none()) {
            let path = self.path(facts.leaf).unwrap_or_default();
            claims.extend(Claims::of_owner(path, &facts.owns));
        }
        claims
    }

    /// Says why the next plan cannot be taken on here, once it is known whether the programs that differ can be started.
    fn examine(&self, (number, plan): (u32, &Plan), host: &str, programs: &Programs, out: &mut Out<'_>) {
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
                let programs = differing.map(|(_, (order, _))| order).collect();
                out.effects.push(Effect::FindPrograms { deployment: self.deployment.clone(), number, programs });
            }
            Err(problems) => self.examined((number, host), problems, out),
        }
    }

    /// Tells the home what is against the next plan here.
    pub fn examined(&self, (number, host): (u32, &str), problems: Vec<String>, out: &mut Out<'_>) {
        let reasons = problems.into_iter().map(|why| format!("host `{host}`: {why}")).collect();
        self.answer_change(ChangeReply::Examined { number, reasons }, out);
    }

    /// Returns how each program of this host is started by a plan.
    fn starts(&self, plan: &Plan, host: &str, offered: &Programs) -> Result<Vec<(u32, Start)>, Vec<String>> {
        let (mut starts, mut problems, live) = (Vec::new(), Vec::new(), plan.live_leaves());
        let is_mine = |number: &u32| live.contains(number) && leaf_host(plan, *number) == Some(host);
        let started = (0_u32..).zip(&plan.leaves).filter(|(_, leaf)| leaf.external.is_none());
        for (number, leaf) in started.filter(|(number, _)| is_mine(number)) {
            let process = ProcessId { deployment: self.deployment.clone(), leaf: number };
            match offered.command(leaf) {
                Ok(command) => {
                    starts.push((number, (programs::order(process, command, (plan, leaf)), leaf.stop_within)));
                }
                Err(why) => problems.push(why),
            }
        }
        problems.dedup();
        if problems.is_empty() { Ok(starts) } else { Err(problems) }
    }

    fn apply(
        &mut self,
        (number, plan, again, probation): (u32, Plan, Vec<u32>, Duration),
        (host, starts): (&str, Vec<(u32, Start)>),
        out: &mut Out<'_>,
    ) {
        let is_undoing = self.change.is_some();
        let before = std::mem::replace(&mut self.plan, Arc::new(plan));
        self.extend_relevant();
        self.add_groups(host);
        let mut live = self.plan.live_wires();
        let rewired: BTreeSet<u32> = self.live.symmetric_difference(&live).copied().collect();
        // What never came cannot be linked by those that are put back.
        let has_come = |leaf: u32| self.registrations.facts.contains_key(&leaf);
        let both = |wire: &&u32| {
            self.plan.wires.get(**wire as usize).is_some_and(|wire| has_come(wire.from.leaf) && has_come(wire.to.leaf))
        };
        live.extend(self.live.iter().filter(both));
        self.live = live;
        self.claims.extend(Claims::of(&self.plan, host));
        let (starting, linking, probing) = (BTreeSet::new(), BTreeSet::new(), BTreeSet::new());
        let (next, adding, facts) = (Next::Applied, BTreeSet::new(), Vec::new());
        self.change =
            Some(Changing { number, starting, linking, probing, rewired, next, adding, facts, probation, is_undoing });
        for (leaf, start) in starts {
            if !self.instances.contains(leaf) {
                self.add(leaf, start, out);
                continue;
            }
            let instance = self.instances.get(leaf);
            let is_same = instance.is_some_and(|instance| instance.is_same_program(&start));
            let is_returning = instance.is_some_and(Instance::is_returning);
            let is_retyped = before.leaves.get(leaf as usize).map(|leaf| &leaf.module)
                != self.plan.leaves.get(leaf as usize).map(|leaf| &leaf.module);
            let is_reclaimed = before.claims_of(leaf) != self.plan.claims_of(leaf);
            let is_kept = is_same && !is_retyped && !is_reclaimed && !again.contains(&leaf);
            if let Some(change) = self.change.as_mut().filter(|_| !is_kept || is_returning) {
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
        let Some(change) = self.change.as_mut().filter(|change| change.number == number) else { return };
        change.next = Next::Linked;
        let rewired = change.rewired.clone();
        self.registrations.facts.extend(facts.into_iter().map(|facts| (facts.leaf, facts)));
        self.link_added(out);
        self.link_again(&rewired, out);
        self.report_change(out);
    }

    /// Has the programs that stay make the links of these wires that are live, and drop the others.
    fn link_again(&mut self, rewired: &BTreeSet<u32>, out: &mut Out<'_>) {
        let ends = rewired.iter().filter_map(|wire| self.plan.wires.get(*wire as usize));
        let touched: BTreeSet<u32> = ends.flat_map(|wire| [wire.from.leaf, wire.to.leaf]).collect();
        for leaf in touched.into_iter().filter(|leaf| self.instances.contains(*leaf)).collect::<Vec<_>>() {
            let is_plain = self.plan.leaves.get(leaf as usize).is_none_or(|leaf| leaf.kind == LeafKind::Plain);
            if is_plain {
                continue;
            }
            match self.orders(leaf) {
                Ok(orders) => {
                    let mut answers = false;
                    self.with_instance(leaf, out, |instance, context| answers = instance.link_again(orders, context));
                    if let Some(change) = &mut self.change
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
        if !self.change.as_mut().is_some_and(|change| change.linking.remove(&leaf)) {
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
        if let Some(change) = &mut self.change {
            change.starting.remove(&leaf);
        }
        self.report_change(out);
    }

    pub(super) fn healthy(&mut self, leaf: u32, out: &mut Out<'_>) {
        if let Some(change) = &mut self.change {
            change.probing.remove(&leaf);
        }
        self.report_change(out);
    }

    pub(super) fn unhealthy(&mut self, leaf: u32, why: &str, out: &mut Out<'_>) {
        let is_meant = self.change.as_mut().is_some_and(|change| change.probing.remove(&leaf));
        if is_meant {
            let path = self.path(leaf).unwrap_or_default().to_owned();
            self.fail_change(&format!("the new program of `{path}` was not healthy: {why}"), out);
        }
    }

    /// A program that was to make links is gone: another one makes its own.
    pub(super) fn forget_linking(&mut self, leaf: u32, out: &mut Out<'_>) {
        let is_there = self.instances.get(leaf).is_some_and(Instance::is_linked);
        if !is_there && self.change.as_mut().is_some_and(|change| change.linking.remove(&leaf)) {
            self.report_change(out);
        }
    }

    pub(super) fn fail_change(&mut self, reason: &str, out: &mut Out<'_>) {
        if let Some(number) = self.change.as_ref().map(|change| change.number) {
            self.answer_change(ChangeReply::Failed { number, reason: reason.to_owned() }, out);
        }
    }

    fn adopt_sets(&mut self, out: &mut Out<'_>) {
        let against = self.against_actions(&Arc::clone(&self.plan));
        if !against.is_empty() && self.change.as_ref().is_some_and(|change| !change.is_undoing) {
            return self.fail_change(&against.join("; "), out);
        }
        for group in self.executers.numbers() {
            self.with_executer(group, out, |executer, context, out| {
                executer.rewire(context, out);
                executer.adopt_actions(context, out)
            });
        }
    }

    /// Drops the links that the plan does not have any more. Until then what was under way over them has come.
    pub(super) fn unlink(&mut self, out: &mut Out<'_>) {
        let live = self.plan.live_wires();
        let gone: BTreeSet<u32> = self.live.difference(&live).copied().collect();
        self.live = live;
        self.link_again(&gone, out);
    }

    /// Tells the home what it waits for, once that is so.
    pub(super) fn report_change(&mut self, out: &mut Out<'_>) {
        let hands_over = self.change.is_some() && self.hands_over();
        let Some(change) = &mut self.change else { return };
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
        out.send(&self.home, self.deployment.to_coordinator(ToCoordinator::Change(reply)));
    }
}
