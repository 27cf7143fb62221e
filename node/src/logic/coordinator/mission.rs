//! A deployment as all parts of its home see it: the plan, the hosts, and the callers that get its reports.

use super::host::HostPart;
use super::stop::Stop;
use crate::logic::effect::Out;
use crate::logic::history::{Audience, History};
use crate::logic::protocol::{Change, Deployment, Kept, LeafFacts, Report, Signed, Target, ToParticipant};
use crate::logic::wiring::{Registrations, observe};
use comms::logic::control::Dial;
use comms::logic::time::Time;
use language::algebra::StepRecord;
use language::plan::{OnBoot, Plan};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

/// A deployment without its phase.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Mission {
    pub(super) deployment: Deployment,
    pub(super) request: Requested,
    pub(super) plan: Arc<Plan>,
    /// When the home said GO.
    pub(super) go_at: Option<Time>,
    pub(super) hosts: BTreeMap<String, HostPart>,
    /// How often hosts were asked to rejoin, all in all.
    pub(super) rejoins: u32,
    pub(super) registrations: Registrations,
    pub(super) audience: Audience,
    pub(super) stop: Stop,
    pub(super) history: History,
}

/// The request of a user by which a deployment runs.
#[derive(Debug, Serialize, Deserialize)]
pub struct Requested {
    /// The user who deployed it.
    pub by: String,
    /// The epoch under which the user deployed it. After a resume, the deployment has a later epoch.
    pub origin: u64,
    /// The last plan that a user asked for, without the numbers that running processes have received since.
    pub wanted: Arc<Plan>,
    /// The request itself, if the user signed it.
    pub signed: Option<Arc<Signed>>,
}

impl Mission {
    /// Sends an order to a host, together with the signed request if the order needs a signature.
    pub(super) fn tell(&self, host: &str, order: ToParticipant, out: &mut Out<'_>) {
        out.send(host, self.deployment.to_participant(order.signed(self.request.signed.as_deref())));
    }

    /// Returns how much time has passed since the home said GO.
    pub(super) fn since_go(&self, now: Time) -> Duration {
        self.go_at.map_or(Duration::ZERO, |go| now - go)
    }

    /// Reports an event of one host, or of all.
    pub(super) fn report(&mut self, report: Report, out: &mut Out<'_>) {
        let named = if let Report::Prepared { host, .. } | Report::Connected { host } | Report::BeganLate { host, .. } =
            &report
        {
            Some(host.as_str())
        } else {
            self.plan.home()
        };
        let host =
            (0..).zip(&self.plan.hosts).find(|(_, host)| Some(host.as_str()) == named).map_or(0, |(host, _)| host);
        self.history.report(report, host, &self.audience, out);
    }

    /// Reports a change of a process.
    pub(super) fn happened(&mut self, target: Target, change: Change, out: &mut Out<'_>) {
        let process = match target {
            Target::Leaf(leaf) => self.plan.leaves.get(leaf as usize).map(|leaf| (leaf.path.clone(), leaf.host)),
            Target::Group(group) => self.plan.groups.get(group as usize).map(|group| (group.path.clone(), group.host)),
        };
        if let Some((path, host)) = process {
            let report = Report::Process { path, change, at: self.since_go(out.now) };
            self.history.report(report, host, &self.audience, out);
        }
    }

    /// Reports steps of a supervisor.
    pub(super) fn stepped(&mut self, group: u32, number: u64, steps: Vec<StepRecord>, changes: u32, out: &mut Out<'_>) {
        if let Some(group) = self.plan.groups.get(group as usize) {
            let (path, host) = (group.path.clone(), group.host);
            let report = Report::Stepped { path, number, steps, changes, at: self.since_go(out.now) };
            self.history.report(report, host, &self.audience, out);
        }
    }

    /// Records the locations of the programs of a host.
    pub(super) fn register(&mut self, host: &str, facts: Vec<LeafFacts>, machine: &str, out: &mut Out<'_>) {
        let leaves = u32::try_from(facts.len()).unwrap_or(u32::MAX);
        self.registrations.facts.extend(facts.into_iter().map(|facts| (facts.leaf, facts)));
        let theirs = self.plan.hosts.iter().zip(&mut self.registrations.machines).filter(|(other, _)| *other == host);
        theirs.for_each(|(_, known)| machine.clone_into(known));
        self.report(Report::Prepared { host: host.to_owned(), leaves }, out);
    }

    /// Orders a host to make its links, and sends it the known locations of all programs.
    pub(super) fn have_connected(&self, host: &str, out: &mut Out<'_>) {
        let facts = self.registrations.facts.values().cloned().collect();
        let machines = self.registrations.machines.clone();
        self.tell(host, ToParticipant::Connect { facts, machines }, out);
    }

    /// Says GO to all hosts, and activates `main`. For an aligned start, `start` has the moment on the clock of each host.
    pub(super) fn go(&mut self, begun: Time, start: &BTreeMap<String, Time>, out: &mut Out<'_>) {
        self.go_at = Some(out.now);
        let signals = self.registrations.facts.values().filter(|facts| facts.signals).map(|facts| facts.leaf);
        let signals = self.locations(signals);
        self.report(Report::Go { took: out.now - begun, signals }, out);
        // A program of another deployment is shown with its own deployment.
        let own = self.registrations.facts.keys().copied().filter(|leaf| self.plan.external(*leaf).is_none());
        let at = self.locations(own);
        self.report(Report::Programs { at }, out);
        for host in &self.plan.hosts {
            let at = start.get(host).map(|start| ToParticipant::GoAt { start: *start });
            self.tell(host, at.unwrap_or(ToParticipant::Go), out);
        }
        let Some(home) = self.plan.home() else { return };
        let order =
            ToParticipant::Activate { target: Target::Group(0), activation: 1, value: Vec::new(), ago: Duration::ZERO };
        self.tell(home, order, out);
    }

    /// Returns the paths of programs, and where each can be dialled.
    fn locations(&self, leaves: impl Iterator<Item = u32>) -> Vec<(String, Dial)> {
        let location = |leaf: u32| {
            let path = self.plan.leaves.get(leaf as usize)?.path.clone();
            Some((path, observe(&self.registrations, leaf)?))
        };
        leaves.filter_map(location).collect()
    }

    /// Reports the present locations of these programs.
    pub(super) fn tell_where(&mut self, leaves: impl IntoIterator<Item = u32>, out: &mut Out<'_>) {
        let at = self.locations(leaves.into_iter());
        if !at.is_empty() {
            self.report(Report::Programs { at }, out);
        }
    }

    /// Records the new location of a restarted program, which a host that rejoins needs. Returns whether the location changed.
    pub(super) fn moved(&mut self, facts: &LeafFacts, from: &str) -> bool {
        let leaf = self.plan.leaves.get(facts.leaf as usize);
        let host = leaf.and_then(|leaf| self.plan.hosts.get(leaf.host as usize));
        let is_its = host.is_some_and(|host| host == from);
        is_its && self.registrations.facts.insert(facts.leaf, facts.clone()).as_ref() != Some(facts)
    }

    /// Returns the record of the deployment for the disk.
    pub(super) fn kept(&self, has_ended: bool) -> Kept {
        let Requested { by, origin, wanted, signed } = &self.request;
        let resume = (wanted.on_boot == OnBoot::Resume).then(|| ((**wanted).clone(), signed.as_deref().cloned()));
        Kept {
            deployment: self.deployment.clone(),
            origin: *origin,
            by: by.clone(),
            hosts: self.plan.hosts.clone(),
            has_ended,
            waits: false,
            resume,
        }
    }

    /// Handles the confirmation of a host that nothing of the deployment is left there, while the deployment runs on.
    /// The other hosts are told, and may continue without this host.
    pub(super) fn cleared(&mut self, host: &str, out: &mut Out<'_>) {
        for other in self.hosts.keys().filter(|other| *other != host) {
            self.tell(other, ToParticipant::Cleared { host: host.to_owned() }, out);
        }
        self.rejoin_later(host, out.now);
    }

    /// Returns whether this host of the deployment has failed.
    pub(super) fn is_lost(&self, host: &str) -> bool {
        self.hosts.get(host).is_some_and(HostPart::has_failed)
    }

    /// Returns the names of the hosts that take part and can be reached.
    pub(super) fn reachable(&self) -> impl Iterator<Item = &String> {
        self.hosts.iter().filter(|(_, part)| part.takes_part()).map(|(host, _)| host)
    }
}
