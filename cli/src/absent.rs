//! Combines the reports of all nodes about hosts that do not answer.

use crate::client::{ANSWER_WITHIN, Client, Statuses};
use crate::logic::process_name::{DeploymentName, ProcessName};
use crate::logic::suggestion;
use crate::logic::tap::Wanted;
use anyhow::anyhow;
use comms::io::clock;
use comms::logic::human::span;
use node::console::Failure;
use node::logic::protocol::{
    Absent, AbsentHost, AbsentProcess, Answer, Deployment, Duplicate, OpenEnd, OpenHost, Request, WaitingDeployment,
    Why,
};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// Hosts that do not answer, and the processes that may run there.
#[derive(Debug, Default)]
pub(crate) struct Absences {
    pub(crate) hosts: Vec<AbsentHost>,
    pub(crate) ends: Vec<OpenEnd>,
    pub(crate) processes: Vec<AbsentProcess>,
    /// The report of each node, by the name of the node.
    pub(crate) told: BTreeMap<String, Absent>,
    /// The names that two nodes share.
    pub(crate) duplicates: Vec<Duplicate>,
    /// Hosts that did not answer, although no node reports them as absent.
    pub(crate) silent: BTreeSet<String>,
    /// The hosts that some node missed a moment ago, and that no node misses now.
    pub(crate) back: BTreeSet<String>,
    /// Hosts whose keys are revoked; no command waits for them.
    pub(crate) revoked: BTreeSet<String>,
    /// The hosts that answer although their keys are revoked. This can only be the host of this machine.
    pub(crate) outlawed: BTreeSet<String>,
}

/// Asks every node that has given its status. A node of an older version reports no absent host.
pub(crate) async fn ask(found: &[(&Client, Statuses)]) -> Absences {
    let mut asked = Vec::new();
    for (client, statuses) in found {
        // All nodes are asked at once: each may be far away.
        asked.extend(statuses.nodes.iter().map(|node| {
            let ask = |request| client.ask_on(&node.host, &request);
            (node.host.clone(), ask(Request::Absent), ask(Request::Duplicates))
        }));
    }
    let mut duplicates: BTreeMap<String, (bool, Duplicate)> = BTreeMap::new();
    let (mut told, deadline) = (BTreeMap::new(), clock::now() + ANSWER_WITHIN);
    for (host, absent, twice) in asked {
        if let Ok(mut answers) = twice
            && let Some(Ok(Answer::Duplicates(all))) = answers.next_by(deadline).await
        {
            for one in all {
                // The report of another node is preferred: it knows where both nodes are.
                let is_own = one.host == host;
                if duplicates.get(&one.host).is_none_or(|(was_own, _)| *was_own && !is_own) {
                    duplicates.insert(one.host.clone(), (is_own, one));
                }
            }
        }
        let Ok(mut answers) = absent else { continue };
        if let Some(Ok(Answer::Absent(absent))) = answers.next_by(deadline).await {
            told.insert(host, absent);
        }
    }
    let there: BTreeSet<String> =
        found.iter().flat_map(|(_, statuses)| &statuses.nodes).map(|node| node.host.clone()).collect();
    let mut away = Absences::new(told, &there);
    away.duplicates = duplicates.into_values().map(|(_, one)| one).collect();
    let is_told = |host: &&String| away.hosts.iter().any(|one| one.host == **host);
    // Some nodes missed these hosts when they gave their status, and miss them no longer. Such a host has returned
    // since then, and has not been asked.
    let back = found.iter().flat_map(|(_, statuses)| &statuses.missed).filter(|host| !is_told(host));
    away.back = back.filter(|host| !there.contains(*host)).cloned().collect();
    let silent = found.iter().flat_map(|(_, statuses)| &statuses.silent).filter(|host| !is_told(host));
    away.silent = silent.chain(&away.back).cloned().collect();
    let revoked = revoked(found, &away).await;
    away.leave_out(&revoked);
    away.outlawed = &there & &revoked;
    away
}

/// Returns the hosts whose keys are revoked and that an answering node has met. If all hosts answer, only the node of
/// this machine is asked: its own keys may be revoked.
async fn revoked(found: &[(&Client, Statuses)], away: &Absences) -> BTreeSet<String> {
    let (mut revoked, is_whole) = (BTreeSet::new(), away.hosts.is_empty() && away.silent.is_empty());
    for (client, statuses) in found {
        let nodes = statuses.nodes.iter().map(|node| node.host.as_str());
        revoked.extend(client.revoked(nodes.filter(|host| !is_whole || client.local() == Some(*host))).await);
    }
    revoked
}

/// Says that no answering node has a process. Hosts that do not answer may have the process.
pub(crate) async fn no_process(name: &ProcessName, found: &[(&Client, Statuses)]) -> Failure {
    no_process_of(name, found, &ask(found).await)
}

/// Says that no node that answers has a process with an output.
pub(crate) async fn no_output(wanted: &Wanted, found: &[(&Client, Statuses)]) -> Failure {
    let near = suggestion::process(wanted.process(), paths(found));
    nowhere(&format!("process with an output `{wanted}`"), near, &ask(found).await)
}

/// Does the same as [`no_process`], without asking the nodes again.
pub(crate) fn no_process_of(name: &ProcessName, found: &[(&Client, Statuses)], away: &Absences) -> Failure {
    let near = suggestion::process(name, paths(found));
    nowhere(&format!("process `{name}`"), near, away)
}

/// Says that no answering node has a deployment. Hosts that do not answer may have the deployment.
pub(crate) fn no_deployment(name: &DeploymentName, found: &[(&Client, Statuses)], away: &Absences) -> Failure {
    let near = suggestion::deployment(name, paths(found).map(|(deployment, _)| deployment));
    nowhere(&format!("deployment `{name}`"), near, away)
}

/// Says that no answering node has `what`. Hosts that do not answer may have it.
pub(crate) fn nowhere(what: &str, near: Option<String>, away: &Absences) -> Failure {
    let hint = suggestion::question(near, "`dca status` lists what is running");
    away.may_have(what).unwrap_or_else(|| Failure::Refused(anyhow!("no {what} is running; {hint}")))
}

/// Returns every process that a node runs, with its deployment.
fn paths<'a>(found: &'a [(&Client, Statuses)]) -> impl Iterator<Item = (&'a Deployment, &'a str)> + Clone {
    let parts = found.iter().flat_map(|(_, statuses)| &statuses.nodes).flat_map(|node| &node.deployments);
    parts.flat_map(|part| part.processes.iter().map(|process| (&part.deployment, process.path.as_str())))
}

/// Returns the deployment of this name that has not begun, with its home and the connection to the home.
pub(crate) fn waiting<'a, 'b>(
    name: &DeploymentName,
    found: &'b [(&'a Client, Statuses)],
) -> Option<(&'a Client, &'b str, &'b WaitingDeployment)> {
    let nodes = found.iter().flat_map(|(client, statuses)| statuses.nodes.iter().map(move |node| (*client, node)));
    let mut all =
        nodes.flat_map(|(client, node)| node.waiting.iter().map(move |one| (client, node.host.as_str(), one)));
    all.find(|(_, _, one)| name.is_called(&one.name))
}

/// Says why no answering node runs a deployment. It waits for its start, some hosts have not confirmed its end, or it is missing.
pub(crate) async fn not_running(name: &DeploymentName, found: &[(&Client, Statuses)]) -> Failure {
    if let Some((_, home, one)) = waiting(name, found) {
        return Failure::Refused(anyhow!("`{name}` {one} on `{home}`; `dca stop {name}` ends that"));
    }
    let away = ask(found).await;
    match away.end(name) {
        Some(end) => away.not_confirmed(name, end),
        None => no_deployment(name, found, &away),
    }
}

impl Absences {
    /// Combines the nodes' reports about others. A host that answers is not absent, and a home that answers reports
    /// about its own deployments.
    fn new(told: BTreeMap<String, Absent>, there: &BTreeSet<String>) -> Self {
        let mut hosts: BTreeMap<&str, &AbsentHost> = BTreeMap::new();
        let mut ends: BTreeMap<&Deployment, (bool, &OpenEnd)> = BTreeMap::new();
        let mut processes: BTreeMap<(&Deployment, &str), &AbsentProcess> = BTreeMap::new();
        for (from, absent) in &told {
            for one in absent.hosts.iter().filter(|one| !there.contains(&one.host)) {
                let latest = hosts.entry(&one.host).or_insert(one);
                if one.heard < latest.heard {
                    *latest = one;
                }
            }
            for end in &absent.ends {
                let is_home = end.home == *from;
                let known = ends.get(&end.deployment).is_some_and(|(home, _)| *home);
                if is_home || !(known || there.contains(&end.home)) {
                    ends.insert(&end.deployment, (is_home, end));
                }
            }
            let away = absent.processes.iter().filter(|one| !there.contains(&one.host));
            processes.extend(away.map(|one| ((&one.deployment, one.path.as_str()), one)));
        }
        let hosts = hosts.into_values().cloned().collect();
        let ends = ends.into_values().map(|(_, end)| end.clone()).collect();
        let processes = processes.into_values().cloned().collect();
        Self { hosts, ends, processes, told, ..Self::default() }
    }

    /// Moves the absent hosts whose keys are revoked to `revoked`.
    fn leave_out(&mut self, revoked: &BTreeSet<String>) {
        let absent = self.hosts.iter().map(|one| &one.host).chain(&self.silent);
        self.revoked = absent.filter(|host| revoked.contains(*host)).cloned().collect();
        self.hosts.retain(|one| !revoked.contains(&one.host));
        self.silent.retain(|host| !revoked.contains(host));
        self.back.retain(|host| !revoked.contains(host));
    }

    /// Returns the latest deployment of that name whose end some hosts have not confirmed.
    pub(crate) fn end(&self, name: &DeploymentName) -> Option<&OpenEnd> {
        self.ends.iter().rfind(|end| name.is(&end.deployment))
    }

    /// Says that some hosts have not confirmed the end of a deployment, or that it may still run at its home.
    pub(crate) fn not_confirmed(&self, name: &DeploymentName, end: &OpenEnd) -> Failure {
        let (deployment, home) = (&end.deployment, &end.home);
        Failure::Unreachable(if is_unknown_at_home(end) {
            anyhow!(
                "the home of `{deployment}`, `{home}`, does not answer: the deployment may still run there. `dca stop {name} --away {home}` makes \
                 the other nodes pass the stop on when the home answers again"
            )
        } else {
            anyhow!(
                "`{deployment}` has ended, but {} not confirmed that nothing of it is left: its programs may still run there; \
                 `dca stop {name} --forget` takes it off the list",
                self.confirmers(end)
            )
        })
    }

    /// Returns the hosts that have not confirmed an end: `` `c2` (lost, heard 40 s ago) and `c3` (not in time) have ``.
    pub(crate) fn confirmers(&self, end: &OpenEnd) -> String {
        let hosts: Vec<String> =
            end.hosts.iter().map(|one| format!("`{}` ({})", one.host, self.why(one, end))).collect();
        format!("{} {}", hosts.join(" and "), if hosts.len() == 1 { "has" } else { "have" })
    }

    /// Returns the hosts that have not confirmed an end, for a table: `c2 (lost, heard 40 s ago)`.
    pub(crate) fn open_hosts(&self, end: &OpenEnd) -> String {
        let hosts: Vec<String> = end.hosts.iter().map(|one| format!("{} ({})", one.host, self.why(one, end))).collect();
        hosts.join(", ")
    }

    /// Returns why a host has not confirmed an end.
    fn why(&self, host: &OpenHost, end: &OpenEnd) -> String {
        let why = match (host.why, host.heard) {
            _ if self.revoked.contains(&host.host) => "revoked".to_owned(),
            (Why::Lost, Some(_)) => "lost".to_owned(),
            (Why::Lost, None) => "it was lost".to_owned(),
            (Why::Late, _) => "not in time".to_owned(),
            (Why::Unable, _) => "it could not end all its programs".to_owned(),
            (Why::Restarted, _) => format!("not heard since `{}` was started again", end.home),
        };
        host.heard.map_or(why.clone(), |heard| format!("{why}, heard {}", ago(heard)))
    }

    /// Returns the state of a host that is absent: `c2 is lost`.
    pub(crate) fn word(&self, host: &str) -> String {
        if self.revoked.contains(host) {
            return format!("{host} is revoked");
        }
        match self.hosts.iter().find(|one| one.host == host) {
            Some(AbsentHost { lost: true, .. }) => format!("{host} is lost"),
            _ => format!("{host} does not answer"),
        }
    }

    /// Returns the failure that unreachable hosts may have `what`; nothing if no host is unreachable.
    pub(crate) fn may_have(&self, what: &str) -> Option<Failure> {
        let hosts: BTreeSet<&str> =
            self.silent.iter().chain(self.hosts.iter().map(|one| &one.host)).map(String::as_str).collect();
        let do_not = if hosts.len() == 1 { "does not" } else { "do not" };
        let names = Vec::from_iter(hosts.iter().copied()).join("`, `");
        (!hosts.is_empty()).then(|| {
            Failure::Unreachable(anyhow!(
                "no node that answers has the {what}; `{names}` {do_not} answer, and it may run there"
            ))
        })
    }

    /// Returns warnings for people: hosts with unknown state, and ends that may not be complete.
    pub(crate) fn warnings(&self) -> Vec<String> {
        let host = |one: &AbsentHost| {
            let how = if one.lost { "is lost" } else { "does not answer" };
            format!(
                "warning: `{}` {how} and was last heard {}: the programs that run there are not known",
                one.host,
                ago(one.heard)
            )
        };
        let end = |end: &OpenEnd| {
            let (name, hosts) = (&end.deployment.name, self.confirmers(end));
            let then = if end.hosts.iter().all(|one| self.revoked.contains(&one.host)) {
                "No node of the team can end the programs"
            } else {
                "The hosts are asked when they answer again"
            };
            format!(
                "warning: {hosts} not confirmed that nothing of `{}` is left: its programs may still run there. {then}; \
                 `dca stop {name} --forget` takes it off this list",
                end.deployment
            )
        };
        let revoked = |host: &String| {
            format!(
                "warning: `{host}` is revoked: the programs that run there are not known, and no node of the team can end them"
            )
        };
        let back = |host: &String| {
            format!(
                "warning: `{host}` has just come back, and has not answered yet: the programs that run there are not known"
            )
        };
        let twice = self
            .outlawed
            .iter()
            .map(|host| outlawed(host))
            .chain(self.duplicates.iter().map(duplicate))
            .chain(self.revoked.iter().map(revoked));
        twice
            .chain(self.back.iter().map(back))
            .chain(self.hosts.iter().map(host))
            .chain(self.ends.iter().map(end))
            .collect()
    }
}

/// Says that a host answers although its keys are revoked.
pub(crate) fn outlawed(host: &str) -> String {
    format!(
        "warning: the keys of `{host}` are revoked: no other node of the team works with it; `dca team invite {host}`, on the operator's \
         machine, takes it into the team again, with new keys"
    )
}

/// Says that two nodes have the same name.
pub(crate) fn duplicate(Duplicate { host, first, second }: &Duplicate) -> String {
    format!(
        "warning: two nodes are called `{host}`: {first}; and {second}. Until one of the nodes has another name (`dca-node --name`), no \
         deployment begins under this name, and this output shows only one of the two nodes"
    )
}

/// Returns whether only other hosts have ended a deployment: its home was lost, and may still run it.
pub(crate) fn is_unknown_at_home(end: &OpenEnd) -> bool {
    end.hosts.iter().any(|one| one.host == end.home && one.why == Why::Lost)
}

/// Formats how long ago something happened, in whole units: `40 s ago`, `5 min ago`, `2 h ago`.
pub(crate) fn ago(time: Duration) -> String {
    let seconds = time.as_secs();
    match seconds {
        0..120 => format!("{} ago", span(Duration::from_secs(seconds))),
        120..7200 => format!("{} min ago", seconds / 60),
        _ => format!("{} h ago", seconds / 3600),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lost(host: &str, seconds: u64) -> AbsentHost {
        AbsentHost { host: host.into(), heard: Duration::from_secs(seconds), lost: true }
    }

    fn end(home: &str, host: &str) -> OpenEnd {
        let open = OpenHost { host: host.into(), why: Why::Lost, heard: Some(Duration::from_secs(40)) };
        let deployment = Deployment { name: "door".into(), epoch: 1 };
        OpenEnd { deployment, home: home.into(), hosts: vec![open] }
    }

    #[test]
    fn who_answers_is_not_away_and_a_home_speaks_for_itself() {
        let absent = |hosts: Vec<AbsentHost>, ends: Vec<OpenEnd>| Absent { hosts, ends, processes: vec![] };
        let there = |hosts: &[&str]| hosts.iter().map(|host| (*host).to_owned()).collect::<BTreeSet<_>>();
        // c3 does not see c1, which still answers; the end in c1's report counts.
        let c1 = absent(vec![lost("c2", 50)], vec![end("c1", "c2")]);
        let c3 = absent(vec![lost("c1", 9), lost("c2", 40)], vec![end("c1", "c1")]);
        let told = BTreeMap::from([("c1".to_owned(), c1), ("c3".to_owned(), c3.clone())]);
        let away = Absences::new(told, &there(&["c1", "c3"]));
        assert_eq!((away.hosts.clone(), away.ends.clone()), (vec![lost("c2", 40)], vec![end("c1", "c2")]));
        let warnings = away.warnings();
        assert_eq!(
            warnings[0],
            "warning: `c2` is lost and was last heard 40 s ago: the programs that run there are not known"
        );
        assert!(warnings[1].starts_with("warning: `c2` (lost, heard 40 s ago) has not confirmed"), "{warnings:?}");
        // The home does not answer, so the report of a participant counts.
        let away = Absences::new(BTreeMap::from([("c3".to_owned(), c3)]), &there(&["c3"]));
        assert_eq!((away.hosts.len(), away.ends), (2, vec![end("c1", "c1")]));
    }

    #[test]
    fn a_lost_home_may_run_on() {
        assert!(is_unknown_at_home(&end("c1", "c1")) && !is_unknown_at_home(&end("c1", "c2")));
    }

    #[test]
    fn who_is_revoked_is_not_absent() {
        let hosts = [lost("c2", 50), lost("c3", 40)];
        let mut away = Absences { hosts: hosts.into(), silent: ["c4".to_owned()].into(), ..Absences::default() };
        away.leave_out(&["c3", "c4", "c5"].map(str::to_owned).into());
        assert_eq!((away.hosts.len(), away.silent.len()), (1, 0));
        assert_eq!(away.revoked, ["c3", "c4"].map(str::to_owned).into());
        assert_eq!(away.word("c3"), "c3 is revoked");
        away.outlawed = ["c1".to_owned()].into();
        away.ends = vec![end("c1", "c3")];
        let warnings = away.warnings();
        assert!(warnings[0].starts_with("warning: the keys of `c1` are revoked"), "{warnings:?}");
        let last = warnings.last().map_or("", String::as_str);
        assert!(last.starts_with("warning: `c3` (revoked, heard 40 s ago) has not confirmed"), "{warnings:?}");
        assert!(last.contains("No node of the team can end the programs"), "{warnings:?}");
        let Some(Failure::Unreachable(why)) = away.may_have("deployment `door`") else { panic!("c2 may have it") };
        assert_eq!(
            why.to_string(),
            "no node that answers has the deployment `door`; `c2` does not answer, and it may run there"
        );
    }

    #[test]
    fn spans_that_have_passed_are_whole() {
        let check =
            |seconds: u64, expected: &str| assert_eq!(ago(Duration::from_millis(seconds * 1000 + 400)), expected);
        [(0, "0 s ago"), (119, "119 s ago"), (120, "2 min ago"), (7199, "119 min ago"), (7200, "2 h ago")]
            .into_iter()
            .for_each(|(seconds, expected)| check(seconds, expected));
    }
}
