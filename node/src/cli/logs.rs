//! `dca logs`: what a process has written, wherever it runs.

use crate::cli::client::{Client, block_on, unasked};
use crate::cli::{Failure, Reaching, output};
use crate::logic::protocol::{Answer, NodeStatus, Request};
use anyhow::anyhow;

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
    let found = find(&client.statuses().await?, arguments);
    let (host, deployment, process) = match &found[..] {
        [one] => one.clone(),
        [] => return Err(anyhow!("no process `{}`; `dca status` lists them", arguments.process).into()),
        many => {
            let paths: Vec<String> = many.iter().map(|(_, _, path)| format!("`{path}`")).collect();
            return Err(anyhow!("`{}` may be any of {}", arguments.process, paths.join(", ")).into());
        }
    };
    let request = Request::Logs { deployment: Some(deployment), process, follow: arguments.follow };
    let mut answers = client.ask_on(&host, &request)?;
    while let Some(answer) = answers.next().await {
        let answer = answer?;
        let Answer::Output(bytes) = answer else { return Err(unasked(&host, &answer)) };
        output::pass(&bytes)?;
    }
    Ok(())
}

/// Returns host, deployment and path of every leaf that is meant.
fn find(statuses: &[NodeStatus], arguments: &Arguments) -> Vec<(String, String, String)> {
    let named = |name: &str| arguments.deployment.as_ref().is_none_or(|wanted| wanted == name);
    let meant = |path: &str| path == arguments.process || path.ends_with(&format!("/{}", arguments.process));
    let mut found = Vec::new();
    for node in statuses {
        for part in node.deployments.iter().filter(|part| named(&part.deployment.name)) {
            let leaves = part.processes.iter().filter(|one| one.pid.is_some() && meant(&one.path));
            found.extend(leaves.map(|one| (node.host.clone(), part.deployment.name.clone(), one.path.clone())));
        }
    }
    found
}
