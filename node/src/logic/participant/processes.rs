//! The processes of a deployment on this host: its programs, and the supervisors of its groups.
//!
//! If a program or a supervisor gets an input, it may make reports that the participant has to handle at once. So the
//! participant itself passes such inputs on. This module answers questions about programs and supervisors, and passes on
//! the orders that a program answers later.

use super::site::Site;
use crate::logic::effect::{Out, earliest};
use crate::logic::executer::{Executer, below_using, group_host};
use crate::logic::instance::Instance;
use crate::logic::protocol::{Ending, Failure, FailureCause, Target, ToParticipant};
use crate::logic::timed::TimedMap;
use comms::logic::control::Order;
use comms::logic::time::Time;
use language::plan::{LinkLoss, Plan};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::time::Duration;

/// The processes of a deployment on this host.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Processes {
    /// The programs, by leaf.
    pub(super) instances: TimedMap<Instance>,
    /// The supervisors, by group.
    pub(super) executers: TimedMap<Executer>,
}

impl Processes {
    /// Gives the groups of the plan that have no supervisor on this host one.
    pub(super) fn add_supervisors(&mut self, site: &Site) {
        let Site { plan, host, .. } = site;
        let below = below_using(plan);
        for number in plan.live_groups().into_iter().filter(|number| group_host(plan, *number) == Some(host)) {
            if !self.executers.contains(number)
                && let Some(executer) = Executer::new(plan, number, below.contains(&number))
            {
                self.executers.insert(number, executer);
            }
        }
    }

    /// Returns how many of the participant's machines were looked at in total.
    pub(super) fn visits(&self) -> u64 {
        self.instances.visits() + self.executers.visits()
    }

    /// Returns the first deadline of a process.
    pub(super) fn deadline(&self) -> Option<Time> {
        earliest(self.instances.deadline(), self.executers.deadline())
    }

    /// Returns whether a process is on this host.
    pub(super) fn contains(&self, target: Target) -> bool {
        match target {
            Target::Leaf(leaf) => self.instances.contains(leaf),
            Target::Group(group) => self.executers.contains(group),
        }
    }

    /// Returns whether a program can be told to switch wires, and will answer.
    pub(super) fn is_linked(&self, leaf: u32) -> bool {
        self.instances.get(leaf).is_some_and(Instance::is_linked)
    }

    /// Gives a program an order that it answers. Returns whether it will answer.
    pub(super) fn ask(&self, leaf: u32, order: Order, out: &mut Out<'_>) -> bool {
        self.instances.get(leaf).is_some_and(|instance| instance.ask(order, out.effects))
    }

    /// Passes the new place of another program on to a program.
    pub(super) fn relink(&self, leaf: u32, order: Order, out: &mut Out<'_>) {
        if let Some(instance) = self.instances.get(leaf) {
            instance.relink(order, out.effects);
        }
    }

    /// Returns whether a group hands connections over.
    pub(super) fn hand_over(&self) -> bool {
        self.executers.iter().any(|(_, executer)| executer.hands_over())
    }

    /// Returns why groups cannot continue with the event actions of a plan.
    pub(super) fn against_actions(&self, plan: &Plan) -> Vec<String> {
        self.executers.iter().filter_map(|(_, executer)| executer.against_actions(plan)).collect()
    }

    /// Whether something continues without the home.
    pub(super) fn go_on_alone(&self, site: &Site) -> bool {
        let keeps = |instance: &Instance| instance.is_active() && instance.link_loss() != LinkLoss::Leave;
        let mut groups = self.executers.iter().filter(|(_, executer)| executer.is_running()).map(|(group, _)| group);
        self.instances.iter().any(|(_, instance)| keeps(instance)) || groups.any(|group| site.endures(group))
    }

    /// Returns the programs that may still be there although everything was done to end them.
    pub(super) fn unconfirmed(&self) -> BTreeSet<u32> {
        self.instances.iter().filter(|(_, instance)| instance.is_unconfirmed()).map(|(leaf, _)| leaf).collect()
    }

    /// Returns the programs that have stopped while work outside of them may continue, each with a description of the work.
    pub(super) fn open_work(&self, site: &Site) -> Vec<String> {
        let causes = self.instances.iter().filter_map(|(leaf, instance)| Some((leaf, instance.open_work()?)));
        causes.map(|(leaf, cause)| format!("{}: {cause}", site.path(leaf).unwrap_or_default())).collect()
    }

    /// Returns why a plan cannot be taken on if it lacks a program that could not be ended: the resources of that program would
    /// be free with this plan.
    pub(super) fn unended_without(&self, plan: &Plan, site: &Site) -> Vec<String> {
        let live = plan.live_leaves();
        let gone = self.unconfirmed().into_iter().filter(|leaf| !live.contains(leaf));
        let paths = gone.filter_map(|leaf| site.path(leaf));
        paths
            .map(|path| format!("`{path}` could not be ended, and may still use its resources; end its program, and then remove the \
                                 process"))
            .collect()
    }

    /// Returns whether another program has the path of this one.
    pub(super) fn overlap(&self, leaf: u32, site: &Site) -> bool {
        self.instances.iter().any(|(other, _)| other != leaf && site.path(other) == site.path(leaf))
    }

    /// Returns whether another program with the path of this one is there and has its links.
    pub(super) fn has_linked_predecessor(&self, leaf: u32, site: &Site) -> bool {
        let is_other = |other: u32| other != leaf && site.path(other) == site.path(leaf);
        self.instances.iter().any(|(other, instance)| is_other(other) && instance.is_linked())
    }

    /// Abandons each running group, and tells its supervisor, since this part of the deployment ends.
    pub(super) fn abandon_groups(&mut self, site: &Site, since_go: Duration, start: Time, out: &mut Out<'_>) {
        let context = site.context(since_go, start);
        self.executers.each(|group, executer| {
            if !executer.is_running() {
                return;
            }
            // Its resources are not free before its programs have ended.
            executer.abandon(context, out);
            let origin = site.group_path(group);
            let cause = FailureCause::NotAvailable("its host has ended its part".into());
            let (target, activation) = (Target::Group(group), executer.activation());
            let ending = site.as_stopped(Ending::Aborted(Failure { origin, cause, at: since_go }));
            if let Some(host) = site.supervisor_host(target) {
                site.tell(host, ToParticipant::Ended { target, activation, ending }, out);
            }
        });
    }
}
