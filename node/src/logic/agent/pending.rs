//! The deployments that have not begun. Each waits for its hosts, and a resumed deployment also waits for permission.

use super::boot::Resumed;
use super::peers::Peers;
use super::tombstones::Tombstones;
use crate::logic::effect::{Out, earliest};
use crate::logic::protocol::{Before, Deployment, Kept, Signed, StartMode, WaitingDeployment};
use comms::logic::time::Time;
use language::plan::Plan;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

/// How many requests are remembered, so that repeating one is harmless.
const REQUESTS_MAX: usize = 10_000;

/// The deployments that have not begun, and those that must not begin.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Pending {
    /// The requests that were made, by number.
    requests: BTreeSet<u64>,
    awaiting: Vec<AwaitingHosts>,
    /// The deployments that ran before this node, until they are reported.
    earlier: Vec<Before>,
    /// The deployments of other homes that were stopped while those were away.
    pub(super) tombstones: Tombstones,
}

/// A deployment that waits for hosts which this node has not seen yet.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct AwaitingHosts {
    pub(super) until: Time,
    /// The call that asked for it; none for a deployment that is resumed.
    pub(super) call: Option<u64>,
    pub(super) plan: Plan,
    /// The user who wants it, such as `ann@c1`.
    pub(super) by: String,
    /// The request, if a user has signed it.
    pub(super) signed: Option<Arc<Signed>>,
    pub(super) resumed: Option<Resumed>,
    pub(super) start: StartMode,
}

impl Pending {
    /// Returns the deployments that a node finds at its start.
    pub(super) fn new(earlier: Vec<Before>, tombstones: Tombstones) -> Self {
        Self { requests: BTreeSet::new(), awaiting: Vec::new(), earlier, tombstones }
    }

    /// Returns the deployments that ran before this node, the latest epoch first, and forgets them.
    /// If the power failed again while a deployment was being resumed, its last epoch is used.
    pub(super) fn take_earlier(&mut self) -> Vec<Before> {
        let mut earlier = std::mem::take(&mut self.earlier);
        earlier.sort_by_key(|before| std::cmp::Reverse(before.kept.deployment.epoch));
        earlier
    }

    /// Returns whether deployments that ran before this node are not reported yet.
    pub(super) const fn looks_back(&self) -> bool {
        !self.earlier.is_empty()
    }

    /// Returns whether a request was made before.
    pub(super) fn is_known(&self, request: u64) -> bool {
        self.requests.contains(&request)
    }

    /// Remembers a request.
    pub(super) fn note(&mut self, request: u64) {
        self.requests.insert(request);
        if self.requests.len() > REQUESTS_MAX {
            self.requests.pop_first();
        }
    }

    /// Has a deployment wait.
    pub(super) fn wait(&mut self, one: AwaitingHosts) {
        self.awaiting.push(one);
    }

    /// Returns the deployments that wait.
    pub(super) fn waiting(&self) -> &[AwaitingHosts] {
        &self.awaiting
    }

    /// Returns the waiting deployment of a name.
    pub(super) fn find(&self, name: &str) -> Option<&AwaitingHosts> {
        self.awaiting.iter().find(|one| one.plan.name == name)
    }

    /// Takes the matching waiting deployments out.
    pub(super) fn take(&mut self, is_meant: impl Fn(&AwaitingHosts) -> bool) -> Vec<AwaitingHosts> {
        self.awaiting.extract_if(.., |one| is_meant(one)).collect()
    }

    /// Takes the deployments out whose hosts are all there, or whose time of waiting is over.
    pub(super) fn take_ready(&mut self, peers: &Peers, now: Time) -> Vec<AwaitingHosts> {
        for resumed in self.awaiting.iter_mut().filter_map(|one| one.resumed.as_mut()) {
            resumed.earliest.take_if(|earliest| *earliest <= now);
        }
        self.take(|one| one.may_begin(peers, now))
    }

    /// Takes the deployment out that resumes another one.
    pub(super) fn take_resumed(&mut self, before: &Deployment) -> Option<AwaitingHosts> {
        let is_meant = |one: &AwaitingHosts| one.resumed.as_ref().is_some_and(|resumed| resumed.from == *before);
        let place = self.awaiting.iter().position(is_meant)?;
        Some(self.awaiting.remove(place))
    }

    /// Asks again for the verdicts that a node which was killed has not given.
    pub(super) fn ask_again(&self, out: &mut Out<'_>) {
        for AwaitingHosts { signed, resumed, .. } in &self.awaiting {
            let asked = resumed.as_ref().filter(|resumed| resumed.is_asked());
            out.effects.extend(asked.map(|resumed| resumed.judge(signed)));
        }
    }

    /// Returns the records on the disk of deployments that are resumed.
    pub(super) fn kept(&self) -> impl Iterator<Item = Kept> {
        self.awaiting.iter().filter_map(|one| Some(one.resumed.as_ref()?.kept(one)))
    }

    /// Returns when a waiting deployment is to be looked at again.
    pub(super) fn deadline(&self) -> Option<Time> {
        self.awaiting.iter().map(AwaitingHosts::deadline).fold(None, earliest)
    }
}

impl AwaitingHosts {
    /// Returns when it is to be looked at again.
    fn deadline(&self) -> Option<Time> {
        let Some(resumed) = &self.resumed else { return Some(self.until) };
        resumed.earliest.or(Some(self.until)).filter(|_| !resumed.is_asked())
    }

    /// Returns whether it may begin.
    fn may_begin(&self, peers: &Peers, now: Time) -> bool {
        let are_there = self.plan.hosts.iter().all(|host| peers.reaches(host));
        let is_free = self
            .resumed
            .as_ref()
            .is_none_or(|resumed| resumed.earliest.is_none() && !peers.absence.is_open(&resumed.from));
        self.until <= now || are_there && is_free
    }

    /// Returns its state, for users.
    pub(super) fn status(&self, peers: &Peers, now: Time) -> WaitingDeployment {
        let (resumes, earliest) = self.resumed.as_ref().map(|resumed| (&resumed.from, resumed.earliest)).unzip();
        let open = resumes.map(|before| peers.absence.unconfirmed(before)).unwrap_or_default();
        let is_awaited = |host: &&String| **host != peers.host && (peers.is_away(host) || open.contains(host));
        WaitingDeployment {
            name: self.plan.name.clone(),
            by: self.by.clone(),
            resumes: resumes.cloned(),
            begins_in: earliest.flatten().map_or(Duration::ZERO, |at| at.since(now)),
            hosts: self.plan.hosts.iter().filter(is_awaited).cloned().collect(),
            at_most: self.until.since(now),
        }
    }
}
