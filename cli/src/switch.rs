//! `dca switch`: switches a running process to other connection sets.

use crate::ConnectArgs;
use crate::change::revision;
use crate::client::{Clients, unasked};
use crate::complete;
use crate::logic::process_name::{DeploymentName, ProcessName};
use crate::stop::{Located, locate};
use anyhow::anyhow;
use clap_complete::ArgValueCompleter;
use language::plan::Plan;
use node::console::{self, Failure, block_on};
use node::logic::protocol::{Answer, Deployment, Request, SetsSwitched, SwitchRequest};
use std::str::FromStr;
use std::time::Duration;

/// How long the home of the deployment may take to answer. It waits for 8 s itself.
const ANSWER_WITHIN: Duration = Duration::from_secs(12);

/// The arguments of `dca switch`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// The deployment: NAME, or NAME@NUMBER for one run of it
    #[arg(value_parser = DeploymentName::parse, add = ArgValueCompleter::new(complete::deployments))]
    name: DeploymentName,
    /// The process, as a path or the end of one, and all labels of it that are to be open: `hit/force[lbl2]`
    #[arg(value_name = "PROCESS[LABEL,...]", add = ArgValueCompleter::new(complete::processes))]
    process: Labelled,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// A process, and labels of its connection sets.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Labelled {
    process: ProcessName,
    labels: Vec<String>,
}

impl FromStr for Labelled {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.strip_suffix(']').and_then(|text| text.rsplit_once('['));
        let Some((process, labels)) = parts.filter(|(process, _)| !process.is_empty()) else {
            return Err("give a process and its labels, such as `hit/force[lbl2]`; `hit/force[]` closes all".to_owned());
        };
        let labels = labels.split(',').map(|label| label.trim().to_owned()).filter(|label| !label.is_empty());
        Ok(Self { process: ProcessName::parse_one(process)?, labels: labels.collect() })
    }
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    block_on(async {
        let clients = Clients::open(&arguments.connect).await?;
        let switched = switch(&clients, arguments).await;
        clients.close().await;
        switched
    })
}

async fn switch(clients: &Clients, arguments: &Arguments) -> Result<(), Failure> {
    let Located { client, deployment, home } = locate(clients.statuses().await?, &arguments.name).await?;
    let plan = revision(client, &home, &deployment.name).await?.map(|revision| revision.plan);
    let Labelled { process, labels } = arguments.process.clone();
    let process = path(plan.as_ref(), &deployment, &process)?;
    let request = Request::Switch(SwitchRequest { name: deployment.name.clone(), process, labels });
    let request = client.signed(&home, request, deployment.epoch).await?;
    let answer = client.ask(&home, &request, ANSWER_WITHIN).await?;
    let Answer::Switched(switched) = answer else { return Err(unasked(&home, &answer)) };
    let switched = switched.map_err(|why| anyhow!("`{}` is not switched: {why}", arguments.name))?;
    if arguments.json {
        console::answer(&switched);
    } else {
        console::say(&text(plan.as_ref(), &switched));
    }
    if switched.unconfirmed.is_empty() {
        return Ok(());
    }
    let silent = switched.unconfirmed.join("`, `");
    let why = anyhow!("`{silent}` did not confirm the switch in time; their connections change when they continue");
    Err(Failure::Unreachable(why))
}

/// Returns the path of the only matching process. Otherwise returns the text of the user, so that the home says why it fits no process.
fn path(plan: Option<&Plan>, deployment: &Deployment, process: &ProcessName) -> Result<String, Failure> {
    if process.deployment().is_some_and(|named| !named.is(deployment)) {
        return Err(Failure::Usage(anyhow!("`{process}` is not a process of `{deployment}`")));
    }
    let leaves = plan.iter().flat_map(|plan| &plan.leaves).map(|leaf| &leaf.path);
    let groups = plan.iter().flat_map(|plan| &plan.groups).map(|group| &group.path);
    let all: Vec<&String> = leaves.chain(groups).filter(|path| process.is_process(deployment, path)).collect();
    let end = || process.process().unwrap_or_default().to_owned();
    Ok(if let [one] = all[..] { one.clone() } else { end() })
}

/// Returns a line for each switched wire, and a line with the time that the switch took.
fn text(plan: Option<&Plan>, switched: &SetsSwitched) -> String {
    let SetsSwitched { closed, opened, .. } = switched;
    if closed.is_empty() && opened.is_empty() {
        return "these sets are open: nothing changes".to_owned();
    }
    let mut lines = Vec::new();
    for (word, sets, others) in [("disconnect", closed, opened), ("connect   ", opened, closed)] {
        let kept = wires(plan, others);
        let changed = wires(plan, sets).into_iter().filter(|wire| !kept.contains(wire));
        lines.extend(changed.map(|wire| format!("  {word} {wire}")));
    }
    lines.push(switched.text());
    lines.join("\n")
}

/// Returns the wires of sets that have names of the form `path[label]`.
fn wires(plan: Option<&Plan>, sets: &[String]) -> Vec<String> {
    let Some(plan) = plan else { return Vec::new() };
    let mut wires = Vec::new();
    for group in &plan.groups {
        for set in &group.sets {
            let owner = set.owner.and_then(|slot| group.members.get(slot as usize));
            let name =
                owner.zip(set.label.as_ref()).map(|(owner, label)| format!("{}/{}[{label}]", group.path, owner.name));
            if name.is_some_and(|name| sets.contains(&name)) {
                let of_set = set.wires.iter().filter_map(|wire| plan.wires.get(*wire as usize));
                wires.extend(of_set.map(|wire| plan.ends(wire)));
            }
        }
    }
    wires
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_is_followed_by_its_labels() {
        let check = |text: &str, process: &str, labels: &[&str]| {
            let labels = labels.iter().map(|label| (*label).to_owned()).collect();
            assert_eq!(text.parse(), Ok(Labelled { process: ProcessName::new(process), labels }));
        };
        check("hit/force[lbl2]", "hit/force", &["lbl2"]);
        check("force[a, b]", "force", &["a", "b"]);
        check("force[]", "force", &[]);
        check("door@3:main/force[a]", "door@3:main/force", &["a"]);
        for wrong in ["force", "[a]", "force[a", "force]", "force.Out[a]"] {
            assert!(wrong.parse::<Labelled>().is_err(), "{wrong}");
        }
    }
}
