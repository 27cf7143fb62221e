//! `dca logs` without a name: lists the processes that have output.

use crate::absent;
use crate::client::Clients;
use crate::logic::process_name::ProcessName;
use node::console::{self, Failure};
use node::logic::protocol::{LeafStatus, NodeStatus, leaves};
use node::logic::table::table;

/// Lists the programs of all deployments, or of one deployment.
pub(super) async fn all(clients: &Clients, name: &ProcessName, is_json: bool) -> Result<(), Failure> {
    let all = clients.statuses().await?;
    let away = absent::ask(&all).await;
    let nodes: Vec<NodeStatus> = all.iter().flat_map(|(_, found)| found.nodes.clone()).collect();
    let rows = rows(&nodes, name);
    if let (Some(deployment), 1) = (name.deployment(), rows.len()) {
        return Err(absent::no_deployment(deployment, &all, &away));
    }
    away.warnings().iter().for_each(|warning| console::note(warning));
    if is_json {
        let object = |row: &Vec<String>| {
            let names = ["deployment", "process", "state", "host"].into_iter().map(str::to_owned);
            names.zip(row.iter().map(|cell| cell.as_str().into())).collect::<serde_json::Map<_, _>>()
        };
        console::answer(&rows[1..].iter().map(object).collect::<Vec<_>>());
        return Ok(());
    }
    if rows.len() > 1 {
        console::say(&table(&rows));
        console::note(
            "`dca logs PROCESS` prints the output of a process, named by its path or the end of its path; `-f` also prints new output",
        );
    } else {
        let where_known = if away.hosts.is_empty() && away.silent.is_empty() { "" } else { " on hosts that answer" };
        console::note(&format!(
            "nothing runs{where_known}; `dca logs PROCESS` prints the output of a process of an ended deployment"
        ));
    }
    Ok(())
}

fn rows(nodes: &[NodeStatus], name: &ProcessName) -> Vec<Vec<String>> {
    let mut rows = vec![["DEPLOYMENT", "PROCESS", "STATE", "HOST"].map(str::to_owned).to_vec()];
    let meant = leaves(nodes).into_iter().filter(|leaf| name.is_process(leaf.deployment, &leaf.process.path));
    rows.extend(meant.map(|LeafStatus { host, deployment, process }| {
        vec![deployment.name.clone(), process.path.clone(), process.state.clone(), host.to_owned()]
    }));
    rows[1..].sort();
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::tree::tests::door_node;

    #[test]
    fn programs_of_all_hosts_are_listed_without_groups() {
        let node = |host: &str, paths: &[&str]| {
            door_node(host, &paths.iter().map(|path| (*path, "idle", None)).collect::<Vec<_>>())
        };
        let nodes = [node("c1", &["main", "main/hit"]), node("c2", &["main/hit/force", "main/arm"])];
        let rows = rows(&nodes, &ProcessName::new(""));
        let found: Vec<&str> = rows[1..].iter().map(|row| row[1].as_str()).collect();
        assert_eq!(found, ["main/arm", "main/hit/force"]);
        assert_eq!(super::rows(&nodes, &ProcessName::new("window:")).len(), 1);
    }
}
