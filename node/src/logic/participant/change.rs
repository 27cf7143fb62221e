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

use super::progress::Progress;
use super::succession::{NextActivation, Supervisor};
use super::{Participant, Phase};
use crate::logic::claims::Claims;
use crate::logic::effect::{Effect, Out};
use crate::logic::instance::{Instance, Start};
use crate::logic::programs::Programs;
use crate::logic::protocol::{Change, ChangeOrder, ChangeReply, LeafFacts, Target, ToParticipant};
use language::plan::Plan;
use std::collections::BTreeSet;
use std::time::Duration;

impl Participant {
    /// Takes a step of a change.
    pub fn take_change(&mut self, order: ChangeOrder, programs: &Programs, out: &mut Out<'_>) {
        match order {
            ChangeOrder::Examine { number, plan } => {
                self.examine(number, &plan, programs, out);
            }
            ChangeOrder::Apply { number, plan, again, probation } => match self.site.starts(&plan, programs) {
                Ok(starts) => self.apply(number, plan, &again, probation, starts, out),
                Err(reasons) => {
                    let reason = format!("host `{}`: {}", self.site.host, reasons.join("; "));
                    self.site.answer_change(ChangeReply::Failed { number, reason }, out);
                }
            },
            ChangeOrder::Link { number } => self.link_change(number, Vec::new(), out),
            ChangeOrder::LinkAlso { number, facts } => self.link_change(number, facts, out),
            ChangeOrder::Settle { .. } => self.settle_change(out),
            ChangeOrder::Adopt { number } => {
                if self.change.as_ref().is_some_and(|change| change.number() == number) {
                    self.adopt_sets(out);
                    self.change.iter_mut().for_each(Progress::adopt);
                    self.report_change(out);
                }
            }
        }
    }

    /// Reports why the next plan cannot be taken on here, once it is known whether the differing programs can be started.
    fn examine(&self, number: u32, plan: &Plan, programs: &Programs, out: &mut Out<'_>) {
        let mut against = self.processes.against_actions(plan);
        against.extend(self.processes.unended_without(plan, &self.site));
        let starts = if self.phase == Phase::Running {
            self.site
                .starts(plan, programs)
                .and_then(|starts| if against.is_empty() { Ok(starts) } else { Err(against) })
        } else {
            Err(vec!["the deployment does not run there".to_owned()])
        };
        match starts {
            Ok(starts) => {
                let differs = |(leaf, start): &(u32, Start)| {
                    let instance = self.processes.instances.get(*leaf);
                    instance.is_none_or(|instance| !instance.is_same_program(start))
                };
                let differing = starts.into_iter().filter(differs);
                let programs = differing.map(|(_, start)| start.order).collect();
                out.effects.push(Effect::FindPrograms { deployment: self.site.deployment.clone(), number, programs });
            }
            Err(problems) => self.site.examined(number, problems, out),
        }
    }

    /// Tells the home the reasons against the next plan here.
    pub fn examined(&self, number: u32, problems: Vec<String>, out: &mut Out<'_>) {
        self.site.examined(number, problems, out);
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
        let is_undoing = self.change.is_some();
        let before = self.site.change(plan);
        self.processes.add_supervisors(&self.site);
        let rewired = self.links.change(&self.site.plan);
        self.claims.extend(Claims::of(&self.site.plan, &self.site.host));
        self.change = Some(Progress::new(number, rewired, probation, is_undoing));
        for (leaf, start) in starts {
            let Some(instance) = self.processes.instances.get(leaf) else {
                self.add(leaf, start, out);
                continue;
            };
            let is_same = instance.is_same_program(&start);
            let is_returning = instance.is_returning();
            let is_retyped = before.leaves.get(leaf as usize).map(|leaf| &leaf.module)
                != self.site.leaf(leaf).map(|leaf| &leaf.module);
            let is_reclaimed = before.claims_of(leaf) != self.site.plan.claims_of(leaf);
            let is_kept = is_same && !is_retyped && !is_reclaimed && !again.contains(&leaf);
            if let Some(change) = self.change.as_mut().filter(|_| !is_kept || is_returning) {
                change.replaces(leaf);
            }
            if is_kept {
                self.processes.instances.with(leaf, |instance| instance.settle(start));
                continue;
            }
            self.with_instance(leaf, out, |instance, context| match is_undoing {
                true => instance.take_back(start, probation, context),
                false => instance.replace(start, probation, context),
            });
        }
        self.report_change(out);
    }

    /// Starts a program that is added.
    fn add(&mut self, leaf: u32, start: Start, out: &mut Out<'_>) {
        let Some(change) = &mut self.change else { return };
        change.adds(leaf);
        let probation = change.probation();
        self.insert_instance(leaf, out, |context| Instance::add(start, probation, context));
    }

    fn link_change(&mut self, number: u32, facts: Vec<LeafFacts>, out: &mut Out<'_>) {
        let Some(change) = self.change.as_mut().filter(|change| change.number() == number) else { return };
        change.link();
        let rewired = change.rewired().clone();
        self.links.register_also(facts);
        self.link_added(out);
        self.link_again(&rewired, out);
        self.report_change(out);
    }

    /// Makes the links of the programs that are added.
    fn link_added(&mut self, out: &mut Out<'_>) {
        let Some(change) = &self.change else { return };
        for leaf in change.adding().clone() {
            match self.links.orders(&self.site, leaf) {
                Ok(_) if self.site.is_plain(leaf) => self.with_instance(leaf, out, |instance, context| {
                    instance.connect_plain();
                    instance.is_added(context);
                }),
                Ok(orders) => {
                    self.change.iter_mut().for_each(|change| change.links(leaf));
                    self.with_instance(leaf, out, |instance, context| instance.connect(orders, context));
                }
                Err(reasons) => self.fail_change(&reasons.join("; "), out),
            }
        }
    }

    /// Has the programs that stay make the links of these wires that are live, and drop the others.
    fn link_again(&mut self, rewired: &BTreeSet<u32>, out: &mut Out<'_>) {
        let ends = rewired.iter().filter_map(|wire| self.site.plan.wires.get(*wire as usize));
        let touched: BTreeSet<u32> = ends.flat_map(|wire| [wire.from.leaf, wire.to.leaf]).collect();
        let is_meant = |leaf: &u32| self.processes.instances.contains(*leaf) && !self.site.is_plain(*leaf);
        for leaf in touched.into_iter().filter(is_meant).collect::<Vec<_>>() {
            match self.links.orders(&self.site, leaf) {
                Ok(orders) => {
                    let mut answers = false;
                    self.with_instance(leaf, out, |instance, context| answers = instance.link_again(orders, context));
                    self.change.iter_mut().filter(|_| answers).for_each(|change| change.links_again(leaf));
                }
                Err(reasons) => self.fail_change(&reasons.join("; "), out),
            }
        }
    }

    /// Takes note that a program has made its links, or why it cannot.
    pub(super) fn linked(&mut self, leaf: u32, made: Result<(), String>, out: &mut Out<'_>) {
        if !self.change.as_mut().is_some_and(|change| change.linked(leaf)) {
            return;
        }
        match made {
            Ok(()) => self.report_change(out),
            Err(why) => {
                let path = self.site.path(leaf).unwrap_or_default();
                self.fail_change(&format!("`{path}`: {why}"), out);
            }
        }
    }

    /// Takes note that a program is up that replaces another one.
    pub(super) fn replaced(&mut self, leaf: u32, out: &mut Out<'_>) {
        self.change.iter_mut().for_each(|change| change.replaced(leaf));
        self.report_change(out);
    }

    /// Takes note that a program has passed its probation.
    pub(super) fn healthy(&mut self, leaf: u32, out: &mut Out<'_>) {
        self.change.iter_mut().for_each(|change| change.healthy(leaf));
        self.report_change(out);
    }

    /// Takes note that a program has not passed its probation.
    pub(super) fn unhealthy(&mut self, leaf: u32, why: &str, out: &mut Out<'_>) {
        if self.change.as_mut().is_some_and(|change| change.unhealthy(leaf)) {
            let path = self.site.path(leaf).unwrap_or_default();
            self.fail_change(&format!("the new program of `{path}` was not healthy: {why}"), out);
        }
    }

    /// A program that was to make links is gone. Its successor makes its own links.
    pub(super) fn forget_linking(&mut self, leaf: u32, out: &mut Out<'_>) {
        let is_there = self.processes.is_linked(leaf);
        if !is_there && self.change.as_mut().is_some_and(|change| change.linked(leaf)) {
            self.report_change(out);
        }
    }

    /// Returns whether a program is being added.
    pub(super) fn is_adding(&self, leaf: u32) -> bool {
        self.change.as_ref().is_some_and(|change| change.adding().contains(&leaf))
    }

    /// Takes note that a program that is added is up.
    pub(super) fn added(&mut self, facts: LeafFacts, out: &mut Out<'_>) {
        if let Some(device) = facts.owns.iter().chain(&facts.needs).next()
            && self.processes.overlap(facts.leaf, &self.site)
        {
            let path = self.site.path(facts.leaf).unwrap_or_default();
            let why = format!("two programs of `{path}` cannot overlap: it uses the device `{device}`, and both would");
            return self.fail_change(&why, out);
        }
        self.hold_own(&facts);
        self.change.iter_mut().for_each(|change| change.added(facts.clone()));
        self.report_change(out);
    }

    /// Takes note that a program that is added cannot take part.
    pub(super) fn not_added(&mut self, leaf: u32, why: &str, out: &mut Out<'_>) {
        let Some(change) = &mut self.change else { return };
        change.not_added(leaf);
        let path = self.site.path(leaf).unwrap_or_default();
        self.fail_change(&format!("`{path}` cannot be added: {why}"), out);
    }

    fn adopt_sets(&mut self, out: &mut Out<'_>) {
        let against = self.processes.against_actions(&self.site.plan);
        if !against.is_empty() && self.change.as_ref().is_some_and(|change| !change.is_undoing()) {
            return self.fail_change(&against.join("; "), out);
        }
        for group in self.processes.executers.numbers() {
            self.with_executer(group, out, |executer, context, out| {
                executer.rewire(context, out);
                executer.adopt_actions(context, out)
            });
        }
    }

    /// Activates a program beside another one, for a supervisor.
    pub(super) fn succeed(&mut self, by: Supervisor, leaf: u32, activation: u32, value: Vec<u8>, out: &mut Out<'_>) {
        let Some(instance) = self.processes.instances.get(leaf) else { return };
        // A program that was not healthy is taken away again: its home knows.
        if self.is_adding(leaf) && !instance.is_linked() {
            return;
        }
        let (is_active, is_stopping) = (instance.is_active(), instance.is_stopping());
        let then = is_stopping.then(|| NextActivation { activation, value: value.clone() });
        self.successions.begin(leaf, by, then);
        if !is_active {
            self.with_instance(leaf, out, |instance, context| {
                instance.activate(activation, value, context.now, context);
            });
        } else if !is_stopping {
            // The program was never stopped.
            self.has_begun(leaf, out);
        }
    }

    /// Tells a supervisor that a program runs that is to take the place of another one.
    pub(super) fn has_begun(&mut self, leaf: u32, out: &mut Out<'_>) {
        let Some(Supervisor { group, host }) = self.successions.begun(leaf) else { return };
        let is_handed_over = self.processes.has_linked_predecessor(leaf, &self.site);
        self.site.tell(&host, ToParticipant::Succeeding { group, leaf, is_handed_over }, out);
        if self.processes.instances.get(leaf).is_some_and(Instance::is_active) {
            self.site.happened(Target::Leaf(leaf), Change::Resumed, out);
        }
    }

    /// Tells the home that its condition is met, once that is the case.
    fn report_change(&mut self, out: &mut Out<'_>) {
        let hands_over = self.change.is_some() && self.processes.hand_over();
        let reply = self.change.as_mut().and_then(|change| change.reply(hands_over));
        reply.into_iter().for_each(|reply| self.site.answer_change(reply, out));
    }

    /// A change is not over before programs have handed their connections over.
    pub(super) fn report_handover(&mut self, out: &mut Out<'_>) {
        if self.change.is_some() && !self.processes.hand_over() {
            self.report_change(out);
        }
    }

    fn fail_change(&self, reason: &str, out: &mut Out<'_>) {
        if let Some(number) = self.change.as_ref().map(Progress::number) {
            self.site.answer_change(ChangeReply::Failed { number, reason: reason.to_owned() }, out);
        }
    }

    /// A change has held, or was taken back, everywhere: programs that are not in the plan any more leave.
    fn settle_change(&mut self, out: &mut Out<'_>) {
        self.change = None;
        self.successions.clear();
        let gone = self.links.settle(&self.site.plan);
        self.link_again(&gone, out);
        self.site.settle();
        let live = self.site.plan.live_leaves();
        self.links.retain(&live);
        self.externals.retain(&live);
        for leaf in self.processes.instances.numbers().into_iter().filter(|leaf| !live.contains(leaf)) {
            self.with_instance(leaf, out, Instance::leave);
        }
        self.free_claims();
    }

    /// Nothing of a program is left. A program that was taken away is forgotten, and its claims are free.
    pub(super) fn removed(&mut self, leaf: u32) {
        let is_gone = self.processes.instances.get(leaf).is_some_and(|instance| !instance.is_unconfirmed());
        if is_gone && self.change.is_none() && !self.site.plan.live_leaves().contains(&leaf) {
            self.processes.instances.remove(leaf);
            self.free_claims();
        }
    }

    /// Frees the devices that were held only by programs that are gone.
    fn free_claims(&mut self) {
        let live = self.site.plan.live_leaves();
        if self.processes.instances.iter().all(|(leaf, _)| live.contains(&leaf)) {
            self.claims = self.links.claims(&self.site);
        }
    }
}
