//! Hosts that do not answer, and deployments that have ended although some hosts have not confirmed the end.
//!
//! A lost host may still run its programs. So a deployment that is over at its home stays here as an *open end* until
//! each host that has not reported its end has confirmed that nothing of the deployment is left. The home asks such a
//! host when the host returns, and at intervals after that. The journal records the open ends, so a home that is
//! restarted keeps asking.
//!
//! While the home itself cannot be reached, each participant of a deployment keeps its end open instead. That end is
//! closed when the home returns, since the home then answers for itself. A host that could not end every program
//! reports this each time it is asked, until the last program has ended. A restart of the host's node also closes the end,
//! because the new node ends what its predecessor has left.
//!
//! A node that ends on request announces this to the others. They do not list its host, and never say that something may run there.
//!
//! Hosts are kept for [`HOSTS_KEPT`], open ends until they are confirmed or a user has them forgotten. The number of both
//! is limited, and the oldest goes first.

use super::effect::{Effect, Out};
use super::protocol::{Absent, AbsentHost, Deployment, OpenEnd, OpenHost, ToParticipant, Why};
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// How long a host that does not answer is listed.
pub const HOSTS_KEPT: Duration = Duration::from_secs(3600);
/// How many such hosts are listed.
const HOSTS_MAX: usize = 256;
/// How many open ends are kept.
pub const ENDS_MAX: usize = 64;
/// How often hosts are asked for the ends that they have not confirmed.
pub(super) const ASK_EVERY: Duration = Duration::from_secs(10);

/// A host that does not answer.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct LostHost {
    heard: Time,
    lost: bool,
}

/// A deployment that is over, except on some hosts.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct End {
    home: String,
    /// The hosts that have not confirmed the end, and why.
    hosts: BTreeMap<String, Why>,
    since: Time,
}

/// Hosts that do not answer, and open ends.
#[derive(Debug, Serialize, Deserialize)]
pub struct Absence {
    host: String,
    gone: BTreeMap<String, LostHost>,
    /// Hosts whose nodes announced that they end, and that nothing is left there.
    left: BTreeSet<String>,
    ends: BTreeMap<Deployment, End>,
    ask_at: Time,
}

impl Absence {
    /// Returns the open ends that the node `host` knows at its start: the deployments of its journal that were not
    /// over, with their hosts.
    pub fn new(host: &str, open: Vec<(Deployment, Vec<String>)>, now: Time) -> Self {
        let end = |hosts: Vec<String>| {
            // This node ended everything its predecessor on this host had left before it began.
            let others = hosts.into_iter().filter(|other| other != host);
            End { home: host.to_owned(), hosts: others.map(|other| (other, Why::Restarted)).collect(), since: now }
        };
        let ends = open.into_iter().map(|(deployment, hosts)| (deployment, end(hosts))).collect();
        Self { host: host.to_owned(), gone: BTreeMap::new(), left: BTreeSet::new(), ends, ask_at: now }
    }

    /// Takes the message of a node that leaves after ending everything it started. The silence of that node then needs
    /// no attention.
    pub fn leaves(&mut self, host: &str) {
        self.gone.remove(host);
        self.left.insert(host.to_owned());
        if self.left.len() > HOSTS_MAX {
            self.left.pop_first();
        }
    }

    /// Takes note that a host does not answer, since its last answer.
    pub fn missing(&mut self, host: &str, heard: Time) {
        if self.left.contains(host) {
            return;
        }
        self.gone.entry(host.to_owned()).or_insert(LostHost { heard, lost: false });
        if self.gone.len() > HOSTS_MAX {
            let oldest = self.gone.iter().min_by_key(|(_, gone)| gone.heard).map(|(host, _)| host.clone());
            oldest.and_then(|oldest| self.gone.remove(&oldest));
        }
    }

    /// Takes note that a host is lost.
    pub fn lost(&mut self, host: &str, heard: Time) {
        self.missing(host, heard);
        self.gone.entry(host.to_owned()).and_modify(|gone| gone.lost = true);
    }

    /// Takes note that a node answers.
    pub fn appeared(&mut self, now: Time, host: &str) {
        self.gone.remove(host);
        self.left.remove(host);
        // From now on the node answers for the deployments whose home it is.
        self.ends.retain(|_, end| end.home != host);
        self.ask_at = self.ask_at.min(now);
    }

    /// Keeps the end of a deployment that these hosts have not confirmed. At its home, an end without such hosts is final.
    pub fn open(&mut self, now: Time, deployment: Deployment, home: &str, hosts: BTreeMap<String, Why>) {
        self.ends.insert(deployment, End { home: home.to_owned(), hosts, since: now });
        self.ask_at = now;
    }

    /// Takes the report of a host that nothing of a deployment is left there.
    pub fn confirmed(&mut self, deployment: &Deployment, host: &str) {
        if let Some(end) = self.ends.get_mut(deployment) {
            end.hosts.remove(host);
        }
    }

    /// Takes the report of a host that something of a deployment may be left there.
    pub fn unable(&mut self, deployment: &Deployment, host: &str) {
        let why = self.ends.get_mut(deployment).and_then(|end| end.hosts.get_mut(host));
        why.into_iter().for_each(|why| *why = Why::Unable);
    }

    /// Returns whether some host has not confirmed that nothing of a deployment is left there.
    pub fn is_open(&self, deployment: &Deployment) -> bool {
        self.ends.get(deployment).is_some_and(|end| !end.hosts.is_empty())
    }

    /// Returns the hosts that have not confirmed that nothing of a deployment is left.
    pub fn unconfirmed(&self, deployment: &Deployment) -> BTreeSet<&String> {
        self.ends.get(deployment).into_iter().flat_map(|end| end.hosts.keys()).collect()
    }

    /// Forgets an open end at the request of a user; returns whether there was one.
    pub fn forget(&mut self, deployment: &Deployment) -> bool {
        self.ends.get_mut(deployment).map(|end| end.hosts.clear()).is_some()
    }

    /// Asks reachable hosts when it is time, and drops the ends that are closed.
    pub fn tick(&mut self, reaches: impl Fn(&str) -> bool, out: &mut Out<'_>) {
        self.gone.retain(|_, gone| gone.heard + HOSTS_KEPT > out.now);
        while self.ends.len() > ENDS_MAX {
            let oldest = self.ends.iter().min_by_key(|(_, end)| end.since).map(|(deployment, _)| deployment.clone());
            let Some(oldest) = oldest else { break };
            tracing::warn!(deployment = %oldest, "too many deployments are unconfirmed: the oldest is forgotten");
            self.settle(&oldest, out);
        }
        let over: Vec<Deployment> = self
            .ends
            .iter()
            .filter(|(_, end)| end.hosts.is_empty())
            .map(|(deployment, _)| deployment.clone())
            .collect();
        over.iter().for_each(|deployment| self.settle(deployment, out));
        if self.ask_at > out.now {
            return;
        }
        self.ask_at = out.now + ASK_EVERY;
        for (deployment, end) in self.ends.iter().filter(|(_, end)| end.home == self.host) {
            let asked = end.hosts.keys().filter(|host| reaches(host));
            asked.for_each(|host| out.send(host, deployment.to_participant(ToParticipant::Release)));
        }
    }

    /// Returns when [`Absence::tick`] wants to be called.
    pub fn deadline(&self) -> Option<Time> {
        let gone = self.gone.values().map(|gone| gone.heard + HOSTS_KEPT).min();
        let ends = self.ends.values().map(|end| if end.hosts.is_empty() { Time::ZERO } else { self.ask_at }).min();
        gone.into_iter().chain(ends).min()
    }

    /// Returns the hosts that do not answer, in order of name.
    pub fn hosts(&self) -> impl Iterator<Item = &str> {
        self.gone.keys().map(String::as_str)
    }

    /// Returns the wanted hosts: those that do not answer, and those that have not confirmed an end.
    pub fn wanted(&self) -> impl Iterator<Item = &str> {
        self.hosts().chain(self.ends.values().flat_map(|end| end.hosts.keys().map(String::as_str)))
    }

    /// Returns the report for users, without the processes.
    pub fn report(&self, now: Time) -> Absent {
        let ago = |host: &str| self.gone.get(host).map(|gone| now.since(gone.heard));
        let host = |(host, gone): (&String, &LostHost)| AbsentHost {
            host: host.clone(),
            heard: now.since(gone.heard),
            lost: gone.lost,
        };
        let end = |(deployment, end): (&Deployment, &End)| {
            let hosts =
                end.hosts.iter().map(|(host, why)| OpenHost { host: host.clone(), why: *why, heard: ago(host) });
            OpenEnd { deployment: deployment.clone(), home: end.home.clone(), hosts: hosts.collect() }
        };
        let open = self.ends.iter().filter(|(_, end)| !end.hosts.is_empty());
        Absent { hosts: self.gone.iter().map(host).collect(), ends: open.map(end).collect(), processes: Vec::new() }
    }

    fn settle(&mut self, deployment: &Deployment, out: &mut Out<'_>) {
        if self.ends.remove(deployment).is_some_and(|end| end.home == self.host) {
            out.effects.push(Effect::Settled { deployment: deployment.clone() });
        }
    }
}
