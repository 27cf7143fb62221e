//! `dca status`: lists the processes of all hosts.
//!
//! The command shows only what nodes have answered. It names hosts that do not answer, and deployments that such hosts
//! may still run. A status is a valid answer in any case, so the exit code is 0.

mod watch;

use crate::ConnectArgs;
use crate::absent::{self, Absences};
use crate::client::{Client, Clients, Statuses, feed};
use crate::complete;
use crate::logic::process_name::DeploymentName;
use crate::logic::suggestion;
use crate::logic::tree::{Unknown, tree};
use anyhow::anyhow;
use clap_complete::ArgValueCompleter;
use node::console::{self, Failure, block_on};
use node::logic::printable::one_line;
use node::logic::protocol::{Absent, Deployment, DeploymentStatus, Network, NodeStatus};
use node::logic::table::table;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use view::{Fleet, RobotId};

/// The arguments of `dca status`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Only this deployment: NAME, or NAME@NUMBER for one run of it
    #[arg(value_parser = DeploymentName::parse, add = ArgValueCompleter::new(complete::deployments))]
    name: Option<DeploymentName>,
    /// Print everything as JSON; with `--watch` each state on one line
    #[arg(long)]
    json: bool,
    /// Show it again after each change, until Ctrl-C
    #[arg(short, long)]
    watch: bool,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// The status of a node in JSON.
#[derive(serde::Serialize)]
struct Node<'a> {
    #[serde(flatten)]
    status: NodeStatus,
    /// The hosts that do not answer this node.
    absent: Absent,
    /// The folder with the sockets of its group of nodes on this machine.
    run_dir: Option<&'a Path>,
}

/// The answers of the nodes that know of each other. The nodes inside a `dca run` do not know of other nodes, so both
/// may have a host `c1`, and a deployment `door@1`.
#[derive(Debug, Default)]
struct Group {
    /// The folder with the sockets of the nodes on this machine.
    folder: Option<PathBuf>,
    fleet: Fleet,
    statuses: Vec<NodeStatus>,
    away: Absences,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    if arguments.watch {
        return watch::run(arguments);
    }
    let mut groups = block_on(async {
        let clients = Clients::open(&arguments.connect).await?;
        let asked = asked(clients.statuses().await).await;
        clients.close().await;
        asked
    })?;
    if let Some(name) = &arguments.name {
        find(name, &groups, &arguments.connect)?;
        groups.iter_mut().for_each(|group| group.only(name));
    }
    if arguments.json {
        console::answer(&nodes(&groups));
    } else {
        console::say(&text(&groups, arguments.name.as_ref()));
    }
    groups.iter().flat_map(|group| group.away.warnings()).for_each(|warning| console::note(&warning));
    Ok(())
}

/// Checks that some node knows a deployment. It may run, wait for its start, or be over.
fn find(name: &DeploymentName, groups: &[Group], connect: &ConnectArgs) -> Result<(), Failure> {
    let statuses = groups.iter().flat_map(|group| &group.statuses);
    let parts = statuses.clone().flat_map(|status| &status.deployments).map(|part| &part.deployment);
    let open = groups.iter().flat_map(|group| &group.away.ends).map(|end| &end.deployment);
    let away = groups.iter().flat_map(|group| &group.away.processes).map(|one| &one.deployment);
    let running = parts.chain(open).chain(away);
    let is_waiting = statuses.flat_map(|status| &status.waiting).any(|one| name.is_called(&one.name));
    if is_waiting || running.clone().any(|deployment| name.is(deployment)) {
        return Ok(());
    }
    let over: BTreeSet<Deployment> = block_on(feed::deployments(connect))?;
    if over.iter().any(|deployment| name.is(deployment)) {
        console::note(&format!("`{name}` is over; `dca events {name}` says how it ended"));
        return Ok(());
    }
    let what = format!("deployment `{name}`");
    if let Some(failure) = groups.iter().find_map(|group| group.away.may_have(&what)) {
        return Err(failure);
    }
    let near = suggestion::deployment(name, running.chain(&over));
    let hint = suggestion::question(near, "`dca status` lists all running deployments");
    Err(Failure::Usage(anyhow!("no node knows a {what}; {hint}")))
}

/// Also asks the nodes that have given their status which hosts they miss.
async fn asked(found: Result<Vec<(&Client, Statuses)>, Failure>) -> Result<Vec<Group>, Failure> {
    let mut groups = Vec::new();
    for (client, statuses) in found? {
        let found = [(client, statuses)];
        let away = absent::ask(&found).await;
        let [(_, Statuses { nodes: statuses, .. })] = found;
        groups.push(Group { folder: client.folder().map(Path::to_owned), fleet: client.fleet(), statuses, away });
    }
    Ok(groups)
}

fn nodes(groups: &[Group]) -> Vec<Node<'_>> {
    groups.iter().flat_map(Group::nodes).collect()
}

/// Returns what runs on the nodes. If there are several groups of nodes, each has a heading. If a deployment is named,
/// only the groups that have it are shown.
fn text(groups: &[Group], name: Option<&DeploymentName>) -> String {
    let is_in_none = !groups.iter().any(Group::has_any);
    let shown: Vec<&Group> = groups.iter().filter(|group| name.is_none() || is_in_none || group.has_any()).collect();
    match &shown[..] {
        [one] => one.text(name),
        several => {
            let block = |group: &&Group| format!("{}:\n{}", group.heading(), group.text(name));
            several.iter().map(block).collect::<Vec<_>>().join("\n\n")
        }
    }
}

impl Group {
    /// Removes all other deployments.
    fn only(&mut self, name: &DeploymentName) {
        for status in &mut self.statuses {
            status.deployments.retain(|one| name.is(&one.deployment));
            status.waiting.retain(|one| name.is_called(&one.name));
        }
        let away = &mut self.away;
        away.ends.retain(|end| name.is(&end.deployment));
        away.processes.retain(|one| name.is(&one.deployment));
        for absent in away.told.values_mut() {
            absent.ends.retain(|end| name.is(&end.deployment));
            absent.processes.retain(|one| name.is(&one.deployment));
        }
    }

    /// Returns whether a deployment runs, waits for its start, or may not have ended.
    fn has_any(&self) -> bool {
        let is_there = |status: &NodeStatus| !(status.deployments.is_empty() && status.waiting.is_empty());
        self.statuses.iter().any(is_there) || !self.away.ends.is_empty() || !self.away.processes.is_empty()
    }

    /// Returns the name of the group: the folder that `--run-dir` takes to choose it.
    fn heading(&self) -> String {
        let Some(folder) = &self.folder else { return "nodes on the network".to_owned() };
        let of = self.fleet.command().map_or(String::new(), |pid| format!(", of command {pid}"));
        format!("nodes in `{}`{of}", folder.display())
    }

    /// Returns the name of a host. A host inside a command is named with the command.
    fn robot(&self, host: &str) -> String {
        RobotId { host: host.to_owned(), fleet: self.fleet }.to_string()
    }

    fn nodes(&self) -> impl Iterator<Item = Node<'_>> {
        self.statuses.iter().map(|status| {
            let absent = self.away.told.get(&status.host).cloned().unwrap_or_default();
            Node { absent, status: status.clone(), run_dir: self.folder.as_deref() }
        })
    }

    fn text(&self, name: Option<&DeploymentName>) -> String {
        let Self { statuses, away, .. } = self;
        let unknown: Vec<Unknown<'_>> = away
            .processes
            .iter()
            .map(|process| Unknown { process, state: format!("unknown ({})", away.word(&process.host)) })
            .collect();
        let stopped = statuses.iter().filter_map(|status| Some(format!("{}: {}", status.host, status.estop.as_ref()?)));
        let stopped: Vec<String> =
            stopped.map(|by| format!("{by}; `dca estop --release` lets programs begin again")).collect();
        let mut blocks = vec![stopped.join("\n"), tree(statuses, &unknown)];
        let parts = || statuses.iter().flat_map(|status| &status.deployments);
        let row = |part: &DeploymentStatus, end: &str, count: u64, what: &str| {
            vec![format!("{}: {end}", part.deployment.name), format!("{count} {what}")]
        };
        let lost = parts().flat_map(|part| part.lost.iter().map(move |one| row(part, &one.wire, one.count, "lost")));
        let missed = "not delivered: the consumer is not connected";
        let missed =
            parts().flat_map(|part| part.undelivered.iter().map(move |one| row(part, &one.wire, one.count, missed)));
        let refused = "refused: a number was not finite";
        let refused =
            parts().flat_map(|part| part.refused.iter().map(move |one| row(part, &one.input, one.count, refused)));
        blocks.push(table(&lost.chain(missed).chain(refused).collect::<Vec<_>>()));
        let waiting = statuses.iter().flat_map(|status| status.waiting.iter().map(move |one| (&status.host, one)));
        let waiting = waiting.map(|(host, one)| vec![one_line(&one.name).to_string(), one.to_string(), host.clone()]);
        blocks.push(table(&waiting.collect::<Vec<_>>()));
        let row = |end| [format!("{end}"), "unconfirmed on".to_owned()];
        let rows: Vec<Vec<String>> = away
            .ends
            .iter()
            .map(|end| row(&end.deployment).into_iter().chain([away.open_hosts(end)]).collect())
            .collect();
        blocks.push(table(&rows));
        blocks.retain(|block| !block.is_empty());
        if blocks.len() == usize::from(!stopped.is_empty()) {
            let hosts: Vec<&str> = statuses.iter().map(|status| status.host.as_str()).collect();
            let what =
                name.map_or_else(|| "nothing".to_owned(), |name| format!("nothing of `{}`", one_line(name.text())));
            let open = |status: &&NodeStatus| status.network != Network::Host || status.policy.is_some();
            let networks = statuses.iter().filter(open).map(|status| vec![status.host.clone(), guard(status)]);
            let blocks = [
                stopped.join("\n"),
                format!("{what} is deployed on {}", hosts.join(", ")),
                table(&networks.collect::<Vec<_>>()),
            ];
            return blocks.into_iter().filter(|block| !block.is_empty()).collect::<Vec<_>>().join("\n\n");
        }
        let held =
            |status: &NodeStatus| vec![status.host.clone(), format!("held by {}", status.containment), guard(status)];
        blocks.push(table(&statuses.iter().map(held).collect::<Vec<_>>()));
        blocks.join("\n\n")
    }
}

/// Describes from which peers a node accepts links over the network, and the policy for its programs.
fn guard(status: &NodeStatus) -> String {
    let policy = status.policy.as_ref().map(ToString::to_string);
    let words = [status.network.to_string(), policy.unwrap_or_default()];
    words.into_iter().filter(|word| !word.is_empty()).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::tree::tests::door_node;

    fn group(folder: &str, fleet: Fleet) -> Group {
        let statuses = vec![door_node("c1", &[("main/arm", "running", Some(7))])];
        Group { folder: Some(folder.into()), fleet, statuses, away: Absences::default() }
    }

    #[test]
    fn each_group_of_nodes_is_shown_with_its_folder() {
        let one = [group("/run/dca", Fleet::Standing)];
        assert!(text(&one, None).starts_with("door@1"), "{}", text(&one, None));
        let [standing] = one;
        let mut both = [standing, group("/run/dca/run+9", Fleet::Command(9))];
        let shown = text(&both, None);
        assert_eq!(shown.matches("door@1").count(), 2, "{shown}");
        let headings: Vec<&str> = shown.lines().filter(|line| line.starts_with("nodes in")).collect();
        assert_eq!(headings, ["nodes in `/run/dca`:", "nodes in `/run/dca/run+9`, of command 9:"]);
        assert_eq!(nodes(&both).len(), 2);
        // A named deployment that only one group has needs no heading.
        both[0].only(&DeploymentName::parse("window").unwrap());
        let named = text(&both, Some(&DeploymentName::parse("door").unwrap()));
        assert!(named.starts_with("door@1") && named.matches("door@1").count() == 1, "{named}");
    }
}
