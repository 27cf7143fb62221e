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
use node::logic::protocol::{Absent, Deployment, LostValues, Network, NodeStatus, RefusedValues};
use node::logic::table::table;
use std::collections::BTreeSet;

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
struct Node {
    #[serde(flatten)]
    status: NodeStatus,
    /// The hosts that do not answer this node.
    absent: Absent,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    if arguments.watch {
        return watch::run(arguments);
    }
    let (mut statuses, mut away) = block_on(async {
        let clients = Clients::open(&arguments.connect).await?;
        let asked = asked(clients.statuses().await).await;
        clients.close().await;
        asked
    })?;
    if let Some(name) = &arguments.name {
        find(name, &statuses, &away, &arguments.connect)?;
    }
    only(&mut statuses, &mut away, arguments.name.as_ref());
    if arguments.json {
        console::answer(&nodes(&statuses, &away));
    } else {
        console::say(&text(&statuses, &away, arguments.name.as_ref()));
    }
    away.warnings().iter().for_each(|warning| console::note(warning));
    Ok(())
}

/// Checks that some node knows a deployment. It may run, wait for its start, or be over.
fn find(name: &DeploymentName, statuses: &[NodeStatus], away: &Absences, connect: &ConnectArgs) -> Result<(), Failure> {
    let parts = statuses.iter().flat_map(|status| &status.deployments).map(|part| &part.deployment);
    let open = away.ends.iter().map(|end| &end.deployment);
    let running = parts.chain(open).chain(away.processes.iter().map(|one| &one.deployment));
    let is_waiting = statuses.iter().flat_map(|status| &status.waiting).any(|one| name.is_called(&one.name));
    if is_waiting || running.clone().any(|deployment| name.is(deployment)) {
        return Ok(());
    }
    let over: BTreeSet<Deployment> = block_on(feed::deployments(connect))?;
    if over.iter().any(|deployment| name.is(deployment)) {
        console::note(&format!("`{name}` is over; `dca events {name}` says how it ended"));
        return Ok(());
    }
    let what = format!("deployment `{name}`");
    if let Some(failure) = away.may_have(&what) {
        return Err(failure);
    }
    let near = suggestion::deployment(name, running.chain(&over));
    let hint = suggestion::question(near, "`dca status` lists all running deployments");
    Err(Failure::Usage(anyhow!("no node knows a {what}; {hint}")))
}

/// If a deployment is named, removes all other deployments.
fn only(statuses: &mut [NodeStatus], away: &mut Absences, name: Option<&DeploymentName>) {
    let Some(name) = name else { return };
    for status in statuses {
        status.deployments.retain(|one| name.is(&one.deployment));
        status.waiting.retain(|one| name.is_called(&one.name));
    }
    away.ends.retain(|end| name.is(&end.deployment));
    away.processes.retain(|one| name.is(&one.deployment));
    for absent in away.told.values_mut() {
        absent.ends.retain(|end| name.is(&end.deployment));
        absent.processes.retain(|one| name.is(&one.deployment));
    }
}

/// Also asks the nodes that have given their status which hosts they miss.
async fn asked(found: Result<Vec<(&Client, Statuses)>, Failure>) -> Result<(Vec<NodeStatus>, Absences), Failure> {
    let found = found?;
    let away = absent::ask(&found).await;
    Ok((found.into_iter().flat_map(|(_, statuses)| statuses.nodes).collect(), away))
}

fn nodes(statuses: &[NodeStatus], away: &Absences) -> Vec<Node> {
    let absent = |status: &NodeStatus| away.told.get(&status.host).cloned().unwrap_or_default();
    statuses.iter().map(|status| Node { absent: absent(status), status: status.clone() }).collect()
}

fn text(statuses: &[NodeStatus], away: &Absences, name: Option<&DeploymentName>) -> String {
    let unknown: Vec<Unknown<'_>> = away
        .processes
        .iter()
        .map(|process| Unknown { process, state: format!("unknown ({})", away.word(&process.host)) })
        .collect();
    let stopped = statuses.iter().filter_map(|status| Some(format!("{}: {}", status.host, status.estop.as_ref()?)));
    let stopped: Vec<String> =
        stopped.map(|by| format!("{by}; `dca estop --release` lets programs begin again")).collect();
    let mut blocks = vec![stopped.join("\n"), tree(statuses, &unknown)];
    let lost = statuses.iter().flat_map(|status| &status.deployments).flat_map(|part| {
        let row = |lost: &LostValues| {
            vec![format!("{}: {}", part.deployment.name, lost.wire), format!("{} lost", lost.count)]
        };
        part.lost.iter().map(row).collect::<Vec<_>>()
    });
    let undelivered = statuses.iter().flat_map(|status| &status.deployments).flat_map(|part| {
        let row = |lost: &LostValues| {
            let what = format!("{} not delivered: the consumer is not connected", lost.count);
            vec![format!("{}: {}", part.deployment.name, lost.wire), what]
        };
        part.undelivered.iter().map(row).collect::<Vec<_>>()
    });
    let refused = statuses.iter().flat_map(|status| &status.deployments).flat_map(|part| {
        let row = |refused: &RefusedValues| {
            let what = format!("{} refused: a number was not finite", refused.count);
            vec![format!("{}: {}", part.deployment.name, refused.input), what]
        };
        part.refused.iter().map(row).collect::<Vec<_>>()
    });
    blocks.push(table(&lost.chain(undelivered).chain(refused).collect::<Vec<_>>()));
    let waiting = statuses.iter().flat_map(|status| status.waiting.iter().map(move |one| (&status.host, one)));
    let waiting = waiting.map(|(host, one)| vec![one_line(&one.name).to_string(), one.to_string(), host.clone()]);
    blocks.push(table(&waiting.collect::<Vec<_>>()));
    let row = |end| [format!("{end}"), "unconfirmed on".to_owned()];
    let rows: Vec<Vec<String>> =
        away.ends.iter().map(|end| row(&end.deployment).into_iter().chain([away.open_hosts(end)]).collect()).collect();
    blocks.push(table(&rows));
    blocks.retain(|block| !block.is_empty());
    if blocks.len() == usize::from(!stopped.is_empty()) {
        let hosts: Vec<&str> = statuses.iter().map(|status| status.host.as_str()).collect();
        let what = name.map_or_else(|| "nothing".to_owned(), |name| format!("nothing of `{}`", one_line(name.text())));
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

/// Describes from which peers a node accepts links over the network, and the policy for its programs.
fn guard(status: &NodeStatus) -> String {
    let policy = status.policy.as_ref().map(ToString::to_string);
    let words = [status.network.to_string(), policy.unwrap_or_default()];
    words.into_iter().filter(|word| !word.is_empty()).collect::<Vec<_>>().join(", ")
}
