//! Hosts that do not answer, and deployments that have ended although some hosts have not confirmed the end.
//!
//! A lost host may still run its programs. So a deployment that is over at its home stays here as an *open end*. It
//! stays open until every host has confirmed that nothing of the deployment is left there. When a host that has not
//! confirmed returns, the home asks it, and asks again at intervals. The journal records the open ends, so a restarted
//! home keeps asking.
//!
//! While the home itself cannot be reached, each participant of a deployment keeps the end open instead. A participant
//! closes it when the home returns, since the home then answers for the deployment. A host that could not end every
//! program reports this each time it is asked, until the last program has ended. A restart of the host's node also
//! closes the end, because the new node ends everything that its predecessor has left.
//!
//! A node that ends on request announces this to the others. They do not list its host, and never say that something may still run there.
//!
//! A host is listed for [`HOSTS_KEPT`]. An open end is kept until it is confirmed, or until a user tells the node to forget it.
//! The number of both is limited, and the oldest is dropped first.

use super::effect::{Effect, Out};
use super::protocol::{Absent, AbsentHost, Deployment, OpenEnd, OpenHost, ToParticipant, Why};
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// How long a host that does not answer stays in the list.
pub const HOSTS_KEPT: Duration = Duration::from_secs(3600);
/// How many hosts that do not answer are listed.
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
    /// Hosts whose nodes announced that they leave, and that no program runs on after this.
    left: BTreeSet<String>,
    ends: BTreeMap<Deployment, End>,
    ask_at: Time,
}

impl Absence {
    /// Returns the absence that the node `host` knows at its start. The open ends are the deployments of its journal
    /// that were not over, with their hosts.
    pub fn new(host: &str, open: Vec<(Deployment, Vec<String>)>, now: Time) -> Self {
        let end = |hosts: Vec<String>| {
            // This node has already ended everything that its predecessor on this host had left.
            let others = hosts.into_iter().filter(|other| other != host);
            End { home: host.to_owned(), hosts: others.map(|other| (other, Why::Restarted)).collect(), since: now }
        };
        let ends = open.into_iter().map(|(deployment, hosts)| (deployment, end(hosts))).collect();
        Self { host: host.to_owned(), gone: BTreeMap::new(), left: BTreeSet::new(), ends, ask_at: now }
    }

    /// Takes the message of a node that leaves after it has ended everything it started. The later silence of that node
    /// needs no attention.
    pub fn leaves(&mut self, host: &str) {
        self.gone.remove(host);
        self.left.insert(host.to_owned());
        if self.left.len() > HOSTS_MAX {
            self.left.pop_first();
        }
    }

    /// Notes that a host does not answer any more; `heard` is the time of its last answer.
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

    /// Notes that a host is lost.
    pub fn lost(&mut self, host: &str, heard: Time) {
        self.missing(host, heard);
        self.gone.entry(host.to_owned()).and_modify(|gone| gone.lost = true);
    }

    /// Notes that a node answers.
    pub fn appeared(&mut self, now: Time, host: &str) {
        self.gone.remove(host);
        self.left.remove(host);
        // From now on the node answers for the deployments whose home it is.
        self.ends.retain(|_, end| end.home != host);
        self.ask_at = self.ask_at.min(now);
    }

    /// Keeps the end of a deployment open that these hosts have not confirmed. If a home has no such hosts, the end is final.
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

    /// Returns whether at least one host has not confirmed that nothing of a deployment is left there.
    pub fn is_open(&self, deployment: &Deployment) -> bool {
        self.ends.get(deployment).is_some_and(|end| !end.hosts.is_empty())
    }

    /// Returns the hosts that have not confirmed that nothing of a deployment is left there.
    pub fn unconfirmed(&self, deployment: &Deployment) -> BTreeSet<&String> {
        self.ends.get(deployment).into_iter().flat_map(|end| end.hosts.keys()).collect()
    }

    /// Forgets an open end at the request of a user; returns whether the end was known.
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

    /// Returns the hosts that are looked for: hosts that do not answer, and hosts that have not confirmed an end.
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
