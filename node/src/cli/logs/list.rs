//! `dca logs` without a name: the processes whose output can be asked for.

use crate::cli::client::Clients;
use crate::cli::{Failure, output};
use crate::logic::protocol::{DeploymentStatus, NodeStatus};
use crate::logic::table::table;
use std::collections::BTreeSet;

/// Lists the programs of all deployments, or of one.
pub(super) async fn all(clients: &Clients, deployment: Option<&str>) -> Result<(), Failure> {
    let nodes: Vec<NodeStatus> = clients.statuses().await?.into_iter().flat_map(|(_, found)| found.nodes).collect();
    let rows = rows(&nodes, deployment);
    if rows.len() > 1 {
        output::say(&table(&rows));
        output::note(
            "`dca logs PROCESS` prints what one has written, the end of its path will do; `-f` goes on as it writes",
        );
    } else {
        output::note("nothing runs; `dca logs PROCESS` prints what one of a deployment that is over has written");
    }
    Ok(())
}

fn rows(nodes: &[NodeStatus], deployment: Option<&str>) -> Vec<Vec<String>> {
    let parts = || nodes.iter().flat_map(|node| node.deployments.iter().map(move |part| (node, part)));
    let parts = || parts().filter(|(_, part)| deployment.is_none_or(|name| name == part.deployment.name));
    // A leaf has nothing below it, on any host.
    let paths = |part: &DeploymentStatus| -> Vec<_> {
        part.processes.iter().map(|one| (part.deployment.clone(), one.path.clone())).collect()
    };
    let above: BTreeSet<_> = parts()
        .flat_map(|(_, part)| paths(part))
        .filter_map(|(of, path)| Some((of, path.rsplit_once('/')?.0.to_owned())))
        .collect();
    let mut rows = vec![["DEPLOYMENT", "PROCESS", "STATE", "HOST"].map(str::to_owned).to_vec()];
    for (node, part) in parts() {
        let is_leaf = |path: &str| path.contains('/') && !above.contains(&(part.deployment.clone(), path.to_owned()));
        for one in part.processes.iter().filter(|one| is_leaf(&one.path)) {
            rows.push(vec![part.deployment.name.clone(), one.path.clone(), one.state.clone(), node.host.clone()]);
        }
    }
    rows[1..].sort();
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::protocol::{Deployment, ProcessStatus};
    use std::time::Duration;

    #[test]
    fn programs_of_all_hosts_are_listed_without_groups() {
        let process =
            |path: &str| ProcessStatus { path: path.into(), kind: "A".into(), state: "idle".into(), pid: None };
        let node = |host: &str, paths: &[&str]| NodeStatus {
            host: host.into(),
            pid: 1,
            version: "0".into(),
            up: Duration::ZERO,
            peers: vec![],
            deployments: vec![DeploymentStatus {
                deployment: Deployment { name: "door".into(), epoch: 1 },
                home: "c1".into(),
                phase: "running".into(),
                processes: paths.iter().map(|path| process(path)).collect(),
            }],
        };
        let nodes = [node("c1", &["main", "main/hit"]), node("c2", &["main/hit/force", "main/arm"])];
        let rows = rows(&nodes, None);
        let found: Vec<&str> = rows[1..].iter().map(|row| row[1].as_str()).collect();
        assert_eq!(found, ["main/arm", "main/hit/force"]);
        assert_eq!(super::rows(&nodes, Some("window")).len(), 1);
    }
}
