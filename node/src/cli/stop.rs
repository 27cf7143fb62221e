//! `dca stop`: ends a deployment on every host.
//!
//! What it says rests on the deployment's last report, which names the hosts that could not confirm that nothing is left.
//! A link that is lost meanwhile is not an answer: the node is asked again.

use crate::cli::client::{Answers, Client, Clients, Statuses, block_on, missing, unasked, words};
use crate::cli::{Failure, Reaching, output};
use crate::logic::protocol::{Answer, Deployment, Report, Request};
use anyhow::anyhow;
use comms::io::clock;
use std::time::Duration;

/// How long the deployment's node may be out of reach. A node that starts or ends hundreds of programs answers late.
const SILENT_MAX: Duration = Duration::from_secs(30);
/// How often the node is asked again.
const ASK_EVERY: Duration = Duration::from_millis(200);

/// What `dca stop` is told.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The deployment
    name: String,
    #[command(flatten)]
    reaching: Reaching,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let unconfirmed = block_on(async {
        let clients = Clients::open(&arguments.reaching).await?;
        let result = match whose(&clients, &arguments.name).await {
            Ok(client) => stop(client, &arguments.name).await,
            Err(failure) => Err(failure),
        };
        clients.close().await;
        result
    })?;
    let name = &arguments.name;
    if unconfirmed.is_empty() {
        output::say(&format!("`{name}` is stopped; nothing of it is left"));
        return Ok(());
    }
    let hosts = unconfirmed.join("`, `");
    Err(Failure::Unreachable(anyhow!(
        "`{name}` is stopped, but `{hosts}` has not confirmed that nothing of it is left"
    )))
}

/// Returns the connection to the nodes that run a deployment of that name.
async fn whose<'a>(clients: &'a Clients, name: &str) -> Result<&'a Client, Failure> {
    let (mut found, mut unanswered) = (Vec::new(), Vec::new());
    for (client, Statuses { nodes, silent }) in clients.statuses().await? {
        if nodes.iter().flat_map(|node| &node.deployments).any(|part| part.deployment.name == name) {
            found.push(client);
        } else {
            unanswered.extend(silent);
        }
    }
    match &found[..] {
        [one] => Ok(one),
        [] => Err(missing(&format!("deployment `{name}`"), &unanswered)),
        several => {
            let why =
                "each has nodes of its own; choose one with `--run-dir`, or end it with Ctrl-C where it was started";
            Err(anyhow!("`{name}` runs {} times on this machine: {why}", several.len()).into())
        }
    }
}

/// Stops a deployment; returns the hosts that could not confirm that nothing of it is left.
async fn stop(client: &Client, name: &str) -> Result<Vec<String>, Failure> {
    let (deployment, home) = find(client, name).await?;
    let mut heard = clock::now();
    loop {
        let why = match stop_once(client, &home, &deployment).await {
            Err(Failure::Unreachable(why)) => why,
            over => return over,
        };
        // Stopping goes by the name, which may be another deployment's by now.
        while !matches!(find(client, name).await, Ok((there, _)) if there == deployment) {
            if let Ok(unconfirmed) = last_report(client.ask_on(&home, &watch(&deployment))?, &home).await {
                return Ok(unconfirmed);
            }
            if clock::now() - heard > SILENT_MAX {
                return Err(Failure::Unreachable(why.context(format!(
                    "`{name}` was asked to stop, but its node cannot be asked whether it has; see `dca status`"
                ))));
            }
            clock::sleep_until(clock::now() + ASK_EVERY).await;
        }
        tracing::debug!(deployment = %deployment, why = %words(&Failure::Unreachable(why)), "asking for the end again");
        heard = clock::now();
    }
}

/// Returns the deployment of that name, and the node where its `main` runs.
async fn find(client: &Client, name: &str) -> Result<(Deployment, String), Failure> {
    let Statuses { nodes, silent } = client.statuses().await?;
    let mut parts = nodes.into_iter().flat_map(|node| node.deployments);
    let Some(part) = parts.find(|part| part.deployment.name == name) else {
        return Err(missing(&format!("deployment `{name}`"), &silent));
    };
    if silent.contains(&part.home) {
        let home = part.home;
        return Err(Failure::Unreachable(anyhow!("the node `{home}`, where `{name}` has its home, does not answer")));
    }
    Ok((part.deployment, part.home))
}

async fn stop_once(client: &Client, home: &str, deployment: &Deployment) -> Result<Vec<String>, Failure> {
    // Watched first, so that the last report is not missed.
    let reports = client.ask_on(home, &watch(deployment))?;
    let mut stopping = client.ask_on(home, &Request::Stop { name: deployment.name.clone() })?;
    let refused = async {
        match stopping.next().await {
            Some(Ok(Answer::Refused(why))) => Failure::Refused(anyhow!("host `{home}`: {why}")),
            // The last report says the rest.
            _ => std::future::pending().await,
        }
    };
    tokio::select! {
        unconfirmed = last_report(reports, home) => unconfirmed,
        refused = refused => Err(refused),
    }
}

fn watch(deployment: &Deployment) -> Request {
    // Only the reports to come, and the last one if it is there.
    Request::Watch { deployment: deployment.clone(), seen: u64::MAX }
}

/// Waits for the last report; returns the hosts that could not confirm.
async fn last_report(mut reports: Answers, home: &str) -> Result<Vec<String>, Failure> {
    loop {
        match reports.next().await {
            Some(Ok(Answer::Report(Report::Finished { unconfirmed, .. }))) => return Ok(unconfirmed),
            Some(Ok(Answer::Report(Report::Refused { .. }))) => return Ok(Vec::new()),
            Some(Ok(Answer::Report(_))) => {}
            Some(Ok(other)) => return Err(unasked(home, &other)),
            Some(Err(why)) => return Err(why),
            None => return Err(Failure::Unreachable(anyhow!("the node `{home}` went away"))),
        }
    }
}
