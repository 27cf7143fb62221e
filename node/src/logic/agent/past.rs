//! The deployments that are over here, and their programs that could not be ended.

use crate::logic::claims::Claims;
use crate::logic::effect::{Out, ProcessId};
use crate::logic::history::History;
use crate::logic::participant::Participant;
use crate::logic::protocol::{Answer, Deployment, Names, OpenEnd, OpenHost, Why};
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

/// How many deployments that are over are remembered, and keep their programs' output.
pub const OVER_MAX: usize = 8;
/// How long the next node still takes over the end of a deployment. A caller that waits for the end
/// may not have received it, and asks again.
const END_KEPT: Duration = Duration::from_secs(10);

/// The deployments that are over here.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Past {
    /// Their reports, for callers that were cut off when it happened; the latest first.
    over: VecDeque<History>,
    /// The time until which a successor takes over the end of the last deployment.
    over_until: Option<Time>,
    /// The programs of these deployments on this host, by leaf and path; the latest first.
    programs: VecDeque<(Deployment, Vec<(u32, String)>)>,
    /// The programs of these deployments that may still run.
    unended: BTreeMap<Deployment, UnendedPrograms>,
}

/// Programs that could not be ended when their deployment ended.
#[derive(Debug, Serialize, Deserialize)]
struct UnendedPrograms {
    /// The host of `main`.
    home: String,
    /// Indices into `Plan::leaves`.
    leaves: BTreeSet<u32>,
    /// The devices that the deployment held here. They stay reserved until its programs have ended.
    claims: Claims,
}

impl Past {
    /// Keeps the reports of a deployment that has ended at its home, which is here.
    pub(super) fn ended_at_home(&mut self, history: History, now: Time) {
        self.remember(history);
        self.over_until = Some(now + END_KEPT);
    }

    /// Keeps the reports of a deployment that no node has seen end.
    pub(super) fn remember(&mut self, history: History) {
        self.over.push_front(history);
        self.over.truncate(OVER_MAX);
    }

    /// Keeps the programs of a deployment that is over on this host, and reserves the devices of those that could not be
    /// ended.
    pub(super) fn ended_here(&mut self, deployment: Deployment, participant: &Participant) {
        let leaves = participant.unconfirmed();
        if !leaves.is_empty() {
            let (home, claims) = (participant.home().to_owned(), participant.claims().clone());
            self.unended.insert(deployment.clone(), UnendedPrograms { home, leaves, claims });
        }
        self.programs.push_front((deployment, participant.programs()));
        self.programs.truncate(OVER_MAX);
    }

    /// Lets time pass.
    pub(super) fn tick(&mut self, now: Time) {
        self.over_until.take_if(|until| *until <= now);
    }

    /// Returns when [`Past::tick`] wants to be called.
    pub(super) const fn deadline(&self) -> Option<Time> {
        self.over_until
    }

    /// Returns whether a successor takes something of this over.
    pub(super) fn is_engaged(&self, now: Time) -> bool {
        self.over_until.is_some_and(|until| now < until) || !self.unended.is_empty()
    }

    /// Returns the reports of a deployment.
    pub(super) fn history(&self, deployment: &Deployment) -> Option<&History> {
        self.over.iter().find(|history| history.deployment() == deployment)
    }

    /// Returns the reports of a deployment, to add another report. The list is empty if the deployment is not known.
    pub(super) fn history_or_new(&mut self, deployment: &Deployment, host: &str) -> Option<&mut History> {
        if self.history(deployment).is_none() {
            self.remember(History::new(deployment.clone(), vec![host.to_owned()]));
        }
        self.over.iter_mut().find(|history| history.deployment() == deployment)
    }

    /// Sends all reports to a call, the oldest first.
    pub(super) fn tell(&self, call: u64, out: &mut Out<'_>) {
        self.over.iter().rev().for_each(|history| history.tell(call, out));
    }

    /// Sends the reports of a deployment to a call, after the first `seen` reports.
    pub(super) fn watch(&self, call: u64, deployment: &Deployment, seen: u64, out: &mut Out<'_>) {
        match self.history(deployment) {
            Some(history) => history.tell_missed(call, seen, out),
            None => out.answer(call, Answer::Refused(format!("`{deployment}` is not known here"))),
        }
    }

    /// Returns the deployments with their programs here, the latest first.
    pub(super) fn programs(&self) -> impl Iterator<Item = (&Deployment, &Vec<(u32, String)>)> {
        self.programs.iter().map(|(deployment, programs)| (deployment, programs))
    }

    /// Returns the programs that a deployment had here.
    pub(super) fn programs_of(&self, deployment: &Deployment) -> Option<&Vec<(u32, String)>> {
        self.programs().find(|(other, _)| *other == deployment).map(|(_, programs)| programs)
    }

    /// Returns the deployment of a name that has programs which could not be ended.
    pub(super) fn unended_of(&self, name: &str) -> Option<&Deployment> {
        self.unended.keys().find(|other| other.name == name)
    }

    /// Returns whether a deployment has programs that could not be ended.
    pub(super) fn is_unended(&self, deployment: &Deployment) -> bool {
        self.unended.contains_key(deployment)
    }

    /// Returns whether no program is left that could not be ended.
    pub(super) fn is_clean(&self) -> bool {
        self.unended.is_empty()
    }

    /// Returns the path of each program that could not be ended, with its deployment.
    pub(super) fn unended_programs(&self) -> impl Iterator<Item = String> {
        self.unended.iter().flat_map(|(deployment, left)| {
            let programs = self.programs_of(deployment).into_iter().flatten();
            let left = programs.filter(|(leaf, _)| left.leaves.contains(leaf));
            left.map(move |(_, path)| format!("{deployment} {path}"))
        })
    }

    /// Returns why a deployment cannot hold some devices: programs that could not be ended hold them.
    pub(super) fn conflicts(&self, deployment: &Deployment, claims: &Claims) -> impl Iterator<Item = String> {
        let others = self.unended.iter().filter(move |(other, _)| *other != deployment);
        others.flat_map(move |(other, left)| claims.conflicts_with_unended(other, &left.claims))
    }

    /// Adds the names of devices that programs hold which could not be ended.
    pub(super) fn names(&self, names: &mut Names) {
        self.unended.iter().for_each(|(other, left)| names.devices.extend(left.claims.names(other)));
    }

    /// Takes note that nothing is left of a program which could not be ended with its deployment.
    /// After the last such program, returns the home, which must be informed.
    pub(super) fn program_ended(&mut self, process: &ProcessId) -> Option<String> {
        let left = self.unended.get_mut(&process.deployment)?;
        left.leaves.remove(&process.leaf);
        if !left.leaves.is_empty() {
            return None;
        }
        self.unended.remove(&process.deployment).map(|left| left.home)
    }

    /// Takes a user's statement that nothing is left of a deployment; returns whether anything was listed as left.
    pub(super) fn forget(&mut self, deployment: &Deployment) -> bool {
        self.unended.remove(deployment).is_some()
    }

    /// Adds deployments that could not be ended on this host and are not listed: their homes may have forgotten them.
    pub(super) fn add_ends(&self, host: &str, ends: &mut Vec<OpenEnd>) {
        for (deployment, unended) in &self.unended {
            if ends.iter().all(|end| end.deployment != *deployment) {
                let hosts = vec![OpenHost { host: host.to_owned(), why: Why::Unable, heard: None }];
                ends.push(OpenEnd { deployment: deployment.clone(), home: unended.home.clone(), hosts });
            }
        }
    }
}
