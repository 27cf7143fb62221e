//! All names that hosts have given out, for each partition. A partition consists of hosts that report that they reach each other.

use node::logic::protocol::{Deployment, DeviceName, Names, NodeStatus, PortName};
use node::logic::table::table;
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// The names of one host.
#[derive(Clone, Debug)]
pub struct HostNames {
    /// The node of the host, and the processes that run there.
    pub status: NodeStatus,
    /// The ports and devices of the host; nothing if its version does not report them.
    pub names: Option<Names>,
}

/// The names that hosts which reach each other have given out.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Partition {
    /// The hosts, with their process ids.
    hosts: Vec<Host>,
    deployments: Vec<DeploymentName>,
    processes: Vec<ProcessName>,
    ports: Vec<Held<PortName>>,
    devices: Vec<Held<DeviceName>>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
struct Host {
    host: String,
    pid: u32,
    /// The other hosts that it reaches.
    sees: Vec<String>,
    /// The other hosts that it reached recently, and that do not answer now.
    missing: Vec<String>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
struct DeploymentName {
    deployment: Deployment,
    /// The host of `main`.
    home: String,
    /// The hosts that have a part of the deployment.
    hosts: Vec<String>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
struct ProcessName {
    deployment: Deployment,
    path: String,
    kind: String,
    host: String,
    state: String,
}

/// A name with the host that has given it out.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
struct Held<T> {
    host: String,
    #[serde(flatten)]
    name: T,
}

/// Returns the names of each partition, in the order of the first host of each. Two hosts are in the same partition if
/// one of them reaches the other.
pub fn partitions(told: &[HostNames]) -> Vec<Partition> {
    let mut left: BTreeMap<&str, &HostNames> = told.iter().map(|one| (one.status.host.as_str(), one)).collect();
    let mut partitions = Vec::new();
    while let Some((_, first)) = left.pop_first() {
        let (mut together, mut next) = (Vec::new(), vec![first]);
        while let Some(one) = next.pop() {
            let status = &one.status;
            let is_linked = |host: &str, other: &mut &HostNames| {
                status.peers.iter().any(|peer| peer == host) || other.status.peers.contains(&status.host)
            };
            next.extend(left.extract_if(.., |host, other| is_linked(host, other)).map(|(_, other)| other));
            together.push(one);
        }
        together.sort_by(|a, b| a.status.host.cmp(&b.status.host));
        partitions.push(Partition::of(&together));
    }
    partitions
}

impl Partition {
    fn of(told: &[&HostNames]) -> Self {
        let mut all = Self::default();
        let mut deployments: BTreeMap<&Deployment, (&str, BTreeSet<&str>)> = BTreeMap::new();
        for HostNames { status, names } in told {
            let host = || status.host.clone();
            all.hosts.push(Host {
                host: host(),
                pid: status.pid,
                sees: status.peers.clone(),
                missing: status.missing.clone(),
            });
            for part in &status.deployments {
                let known = deployments.entry(&part.deployment).or_insert((&part.home, BTreeSet::new()));
                known.1.insert(&status.host);
                let processes = part.processes.iter().cloned();
                all.processes.extend(processes.map(|process| {
                    let deployment = part.deployment.clone();
                    ProcessName {
                        deployment,
                        path: process.path,
                        kind: process.kind,
                        host: host(),
                        state: process.state,
                    }
                }));
            }
            let names = names.clone().unwrap_or_default();
            all.ports.extend(names.ports.into_iter().map(|name| Held { host: host(), name }));
            all.devices.extend(names.devices.into_iter().map(|name| Held { host: host(), name }));
        }
        all.processes.sort_by(|a, b| (&a.deployment, &a.path).cmp(&(&b.deployment, &b.path)));
        all.ports.sort_by(|a, b| a.name.cmp(&b.name));
        all.devices.sort_by(|a, b| (&a.host, &a.name).cmp(&(&b.host, &b.name)));
        all.deployments = deployments
            .into_iter()
            .map(|(deployment, (home, hosts))| DeploymentName {
                deployment: deployment.clone(),
                home: home.to_owned(),
                hosts: hosts.into_iter().map(str::to_owned).collect(),
            })
            .collect();
        all
    }

    /// Returns a row for each name: its kind, the name itself, and its meaning.
    fn rows(&self) -> Vec<Vec<String>> {
        let row = |kind: &str, name: String, of: String| vec![kind.to_owned(), name, of];
        let hosts = self.hosts.iter().map(|one| {
            let sees = if one.sees.is_empty() { String::new() } else { format!(", sees {}", one.sees.join(", ")) };
            row("host", one.host.clone(), format!("pid {}{sees}", one.pid))
        });
        let deployments = self.deployments.iter().map(|one| {
            row("deployment", one.deployment.to_string(), format!("home {}, on {}", one.home, one.hosts.join(", ")))
        });
        let processes = self.processes.iter().map(|one| {
            let of = format!("{} on {}, {}", one.deployment, one.host, one.state);
            row("process", format!("{}: {}", one.path, one.kind), of)
        });
        let ports = self.ports.iter().map(|Held { host, name }| {
            let kind = name.kind.as_ref().map_or(String::new(), |kind| format!(": {kind}"));
            let way = if name.is_output { "output" } else { "input" };
            row("port", format!("{}.{}{kind}", name.path, name.port), format!("{way}, {} on {host}", name.deployment))
        });
        let devices = self.devices.iter().map(|Held { host, name }| {
            let how = if name.is_exclusive { "held" } else { "read" };
            row("device", name.device.clone(), format!("{how} by {} of {} on {host}", name.path, name.deployment))
        });
        hosts.chain(deployments).chain(processes).chain(ports).chain(devices).collect()
    }
}

/// Returns a table of all names. If there are several partitions, each has a heading.
pub fn text(partitions: &[Partition]) -> String {
    if let [one] = partitions {
        return table(&one.rows());
    }
    let block = |partition: &Partition| {
        let hosts: Vec<&str> = partition.hosts.iter().map(|host| host.host.as_str()).collect();
        format!("{} alone:\n{}", hosts.join(", "), table(&partition.rows()))
    };
    partitions.iter().map(block).collect::<Vec<_>>().join("\n\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::tree::tests::door_node;

    fn told(host: &str, peers: &[&str], names: Names) -> HostNames {
        let mut status = door_node(host, &[(&format!("main/{host}"), "running", Some(7))]);
        status.peers = peers.iter().map(|peer| (*peer).to_owned()).collect();
        HostNames { status, names: Some(names) }
    }

    #[test]
    fn hosts_that_reach_each_other_are_one_partition() {
        let check = |links: &[(&str, &[&str])], expected: &[&[&str]]| {
            let told: Vec<HostNames> = links.iter().map(|(host, peers)| told(host, peers, Names::default())).collect();
            let partitions = partitions(&told);
            let hosts = |one: &Partition| one.hosts.iter().map(|host| host.host.clone()).collect::<Vec<_>>();
            assert_eq!(partitions.iter().map(hosts).collect::<Vec<_>>(), expected);
        };
        check(&[("c1", &["c2"]), ("c2", &["c1"]), ("c3", &[])], &[&["c1", "c2"], &["c3"]]);
        // The hosts form a chain, and only one end of a link knows of it yet.
        check(&[("c1", &[]), ("c2", &["c1", "c3"]), ("c3", &["c2"]), ("c4", &["c9"])], &[&["c1", "c2", "c3"], &["c4"]]);
    }

    #[test]
    fn every_name_has_its_holder() {
        let deployment = Deployment { name: "door".into(), epoch: 1 };
        let port = |port: &str, kind: Option<&str>, is_output| PortName {
            deployment: deployment.clone(),
            path: "main/c1".into(),
            port: port.into(),
            is_output,
            kind: kind.map(str::to_owned),
        };
        let device = DeviceName {
            device: "arm".into(),
            deployment: deployment.clone(),
            path: "main/c1".into(),
            is_exclusive: true,
        };
        let names =
            Names { ports: vec![port("In", None, false), port("Out", Some("Force"), true)], devices: vec![device] };
        let expected = "\
host        c1                  pid 1
deployment  door@1              home c1, on c1
process     main/c1: Any        door@1 on c1, running
port        main/c1.In          input, door@1 on c1
port        main/c1.Out: Force  output, door@1 on c1
device      arm                 held by main/c1 of door@1 on c1";
        let partitions = partitions(&[told("c1", &[], names)]);
        assert_eq!(text(&partitions), expected);
        let json = serde_json::to_value(&partitions).unwrap();
        assert_eq!(json[0]["devices"][0]["host"], "c1");
        assert_eq!(json[0]["devices"][0]["device"], "arm");
    }
}
