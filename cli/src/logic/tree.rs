//! Shows the processes of all hosts as a tree.

use node::logic::protocol::{AbsentProcess, Deployment, NodeStatus, ProcessStatus};
use node::logic::table::table;
use std::collections::{BTreeMap, BTreeSet};

/// One deployment, as all nodes report it: its phases, and its processes with their hosts.
#[derive(Default)]
struct Parts<'a> {
    phases: BTreeSet<&'a str>,
    processes: BTreeMap<&'a str, Row<'a>>,
}

/// A process as the tree shows it.
struct Row<'a> {
    kind: &'a str,
    state: &'a str,
    host: &'a str,
    pid: Option<u32>,
}

impl<'a> Row<'a> {
    fn new(host: &'a str, process: &'a ProcessStatus) -> Self {
        Self { kind: &process.kind, state: &process.state, host, pid: process.pid }
    }
}

/// A process on a host that does not answer.
#[derive(Clone, Debug)]
pub struct Unknown<'a> {
    /// The process.
    pub process: &'a AbsentProcess,
    /// Its state, in a few words.
    pub state: String,
}

/// Returns every deployment as one tree. Each node reports its own part; the processes on hosts that do not answer are added.
pub fn tree(statuses: &[NodeStatus], unknown: &[Unknown<'_>]) -> String {
    let mut deployments: BTreeMap<&Deployment, Parts<'_>> = BTreeMap::new();
    for Unknown { process, state } in unknown {
        let row = Row { kind: &process.kind, state, host: &process.host, pid: None };
        deployments.entry(&process.deployment).or_default().processes.insert(&process.path, row);
    }
    for status in statuses {
        for part in &status.deployments {
            let parts = deployments.entry(&part.deployment).or_default();
            parts.phases.insert(&part.phase);
            parts.processes.extend(part.processes.iter().map(|one| (one.path.as_str(), Row::new(&status.host, one))));
        }
    }
    let mut blocks = Vec::new();
    for (deployment, Parts { phases, processes }) in deployments {
        let phases = phases.into_iter().collect::<Vec<_>>().join("/");
        let mut rows = vec![vec![format!("{deployment}"), phases, String::new(), String::new()]];
        let mut sentences = Vec::new();
        for (path, process) in processes {
            let depth = path.matches('/').count();
            let name = path.rsplit('/').next().unwrap_or(path);
            let pid = process.pid.map(|pid| format!("pid {pid}")).unwrap_or_default();
            let name = format!("{}{name}: {}", "  ".repeat(depth + 1), process.kind);
            // If a state needs a sentence, the sentence follows its word.
            let (state, said) = process.state.split_once("; ").unwrap_or((process.state, ""));
            sentences.extend(Some(format!("{path}: {said}")).filter(|_| !said.is_empty()));
            rows.push(vec![name, state.to_owned(), process.host.to_owned(), pid]);
        }
        blocks.push(table(&rows));
        blocks.extend(Some(sentences.join("\n")).filter(|said| !said.is_empty()));
    }
    blocks.join("\n\n")
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use node::logic::protocol::{Containment, DeploymentStatus, Network};
    use std::time::Duration;

    /// Returns the status of a node for tests. It has a part of `door@1`, whose home is `c1`: processes with path, state and process id.
    pub(crate) fn door_node(host: &str, processes: &[(&str, &str, Option<u32>)]) -> NodeStatus {
        let process = |(path, state, pid): &(&str, &str, Option<u32>)| ProcessStatus {
            path: (*path).to_owned(),
            kind: "Any".into(),
            state: (*state).to_owned(),
            pid: *pid,
            activity: None,
        };
        let part = DeploymentStatus {
            deployment: Deployment { name: "door".into(), epoch: 1 },
            home: "c1".into(),
            phase: "running".into(),
            processes: processes.iter().map(process).collect(),
            lost: Vec::new(),
            refused: Vec::new(),
            undelivered: Vec::new(),
        };
        let (version, up) = ("0".into(), Duration::ZERO);
        NodeStatus {
            host: host.into(),
            pid: 1,
            version,
            up,
            peers: vec![],
            deployments: vec![part],
            containment: Containment::default(),
            network: Network::default(),
            estop: None,
            policy: None,
            missing: vec![],
            waiting: vec![],
        }
    }

    #[test]
    fn the_tree_is_put_together_from_all_hosts() {
        let statuses = [
            door_node("c1", &[("main", "running", None)]),
            door_node("c2", &[("main/hit", "dead: SIGSEGV", Some(12))]),
        ];
        let expected = "\
door@1        running
  main: Any   running        c1
    hit: Any  dead: SIGSEGV  c2  pid 12";
        assert_eq!(tree(&statuses, &[]), expected);
        // If a state needs a sentence, the tree shows the sentence below.
        let held = [door_node("c1", &[("main", "running; `main/b` waits", None), ("main/b", "idle", None)])];
        let expected = "\
door@1       running
  main: Any  running  c1
    b: Any   idle     c1

main: `main/b` waits";
        assert_eq!(tree(&held, &[]), expected);
        // The processes on a lost host are shown as well.
        let absent = |path: &str| AbsentProcess {
            deployment: Deployment { name: "door".into(), epoch: 1 },
            host: "c3".into(),
            path: path.into(),
            kind: "Arm".into(),
        };
        let (arm, hit) = (absent("main/arm"), absent("main/hit"));
        let unknown = [&arm, &hit].map(|process| Unknown { process, state: "unknown (c3 is lost)".into() });
        let expected = "\
door@1        running
  main: Any   running               c1
    arm: Arm  unknown (c3 is lost)  c3
    hit: Any  dead: SIGSEGV         c2  pid 12";
        assert_eq!(tree(&statuses, &unknown), expected);
    }
}
