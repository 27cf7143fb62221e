//! `dca logs`: what a process has written, wherever it runs.

use crate::cli::client::{self, Client, block_on, unasked};
use crate::cli::{Failure, Reaching, output};
use crate::logic::printable::Printable;
use crate::logic::protocol::{Answer, Deployment, NodeStatus, ProcessStatus, Request};
use anyhow::anyhow;
use std::collections::BTreeSet;

/// What `dca logs` is told.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The process: a path such as `main/dooropensyst/hit`, or the end of one
    process: String,
    /// Go on as it writes
    #[arg(short, long)]
    follow: bool,
    /// In this deployment
    #[arg(long)]
    deployment: Option<String>,
    /// Pass its bytes on as they are: control characters may do anything to a terminal
    #[arg(long)]
    raw: bool,
    #[command(flatten)]
    reaching: Reaching,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    block_on(async {
        let client = Client::open(&arguments.reaching).await?;
        let result = tokio::select! {
            result = print(&client, arguments) => result,
            _ = tokio::signal::ctrl_c() => Ok(()),
        };
        client.close().await;
        result
    })
}

async fn print(client: &Client, arguments: &Arguments) -> Result<(), Failure> {
    let statuses = client.statuses().await?;
    let found = find(&statuses.nodes, arguments);
    let (host, deployment, process) = match &Vec::from_iter(found)[..] {
        [one] => one.clone(),
        [] => return Err(client::missing(&format!("process `{}`", arguments.process), &statuses.silent)),
        many => {
            let paths: Vec<String> = many.iter().map(|(_, _, path)| format!("`{path}`")).collect();
            return Err(anyhow!("`{}` may be any of {}", arguments.process, paths.join(", ")).into());
        }
    };
    let request = Request::Logs { deployment: Some(deployment), process, follow: arguments.follow };
    let mut answers = client.ask_on(&host, &request)?;
    let mut printable = Printable::default();
    while let Some(answer) = answers.next().await {
        let answer = answer?;
        let Answer::Output(bytes) = answer else { return Err(unasked(&host, &answer)) };
        if arguments.raw {
            output::pass(&bytes)?;
        } else {
            output::pass(printable.push(&bytes).as_bytes())?;
        }
    }
    Ok(output::pass(printable.finish().as_bytes())?)
}

/// Returns host, deployment and path of every leaf that is meant, whether its program is alive or not.
fn find(statuses: &[NodeStatus], arguments: &Arguments) -> BTreeSet<(String, String, String)> {
    let named = |name: &str| arguments.deployment.as_ref().is_none_or(|wanted| wanted == name);
    let meant = |path: &str| path == arguments.process || path.ends_with(&format!("/{}", arguments.process));
    let parts = || statuses.iter().flat_map(|node| node.deployments.iter().map(move |part| (node, part)));
    // A leaf has nothing below it, on any host.
    let groups: BTreeSet<(&Deployment, &str)> = parts()
        .flat_map(|(_, part)| part.processes.iter().map(move |one| (&part.deployment, one.path.as_str())))
        .filter_map(|(deployment, path)| Some((deployment, path.rsplit_once('/')?.0)))
        .collect();
    let mut found = BTreeSet::new();
    for (node, part) in parts().filter(|(_, part)| named(&part.deployment.name)) {
        let leaf = |one: &&ProcessStatus| !groups.contains(&(&part.deployment, one.path.as_str())) && meant(&one.path);
        let leaves = part.processes.iter().filter(leaf);
        found.extend(leaves.map(|one| (node.host.clone(), part.deployment.name.clone(), one.path.clone())));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::protocol::DeploymentStatus;
    use clap::Parser;
    use std::time::Duration;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        arguments: Arguments,
    }

    #[test]
    fn a_leaf_is_found_dead_or_alive_and_a_group_is_not() {
        let node = |host: &str, processes: &[(&str, &str, Option<u32>)]| NodeStatus {
            host: host.into(),
            pid: 1,
            version: "0".into(),
            up: Duration::ZERO,
            peers: vec![],
            deployments: vec![DeploymentStatus {
                deployment: Deployment { name: "door".into(), epoch: 1 },
                home: "c1".into(),
                phase: "running".into(),
                processes: processes
                    .iter()
                    .map(|(path, state, pid)| ProcessStatus {
                        path: (*path).into(),
                        kind: "Any".into(),
                        state: (*state).into(),
                        pid: *pid,
                    })
                    .collect(),
            }],
        };
        let statuses = [
            node("c1", &[("main", "running", None), ("main/hit", "running", None), ("main/arm", "running", Some(7))]),
            node("c2", &[("main/hit/force", "dead: SIGSEGV", None)]),
        ];
        let check = |line: &[&str], expected: &[(&str, &str)]| {
            let line = Line::parse_from(["logs"].iter().chain(line));
            let found = find(&statuses, &line.arguments);
            let found: Vec<_> = found.iter().map(|(host, _, path)| (host.as_str(), path.as_str())).collect();
            assert_eq!(found, expected);
        };
        check(&["force"], &[("c2", "main/hit/force")]);
        check(&["main/arm", "--deployment", "door"], &[("c1", "main/arm")]);
        check(&["main/arm", "--deployment", "window"], &[]);
        check(&["hit"], &[]);
        check(&["main"], &[]);
    }
}
