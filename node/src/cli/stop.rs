//! `dca stop`: ends a deployment on every host.

use crate::cli::client::{Client, Statuses, block_on, missing, unasked};
use crate::cli::{Failure, Reaching, output};
use crate::logic::protocol::{Answer, Request, StopReply};
use anyhow::anyhow;
use std::time::Duration;

/// How long a deployment has to end: its programs' own limits, and some.
const STOP_WITHIN: Duration = Duration::from_secs(60);

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
    block_on(async {
        let client = Client::open(&arguments.reaching).await?;
        let result = stop(&client, &arguments.name).await;
        client.close().await;
        result
    })?;
    output::say(&format!("`{}` is stopped; nothing of it is left", arguments.name));
    Ok(())
}

async fn stop(client: &Client, name: &str) -> Result<(), Failure> {
    let Statuses { nodes, silent } = client.statuses().await?;
    let mut parts = nodes.into_iter().flat_map(|node| node.deployments);
    let Some(part) = parts.find(|part| part.deployment.name == name) else {
        return Err(missing(&format!("deployment `{name}`"), &silent));
    };
    if silent.contains(&part.home) {
        let home = part.home;
        return Err(Failure::Unreachable(anyhow!("the node `{home}`, where `{name}` has its home, does not answer")));
    }
    let request = Request::Stop { name: name.to_owned() };
    let answer = client.ask(&part.home, &request, STOP_WITHIN).await?;
    let Answer::Stop(reply) = answer else { return Err(unasked(&part.home, &answer)) };
    match reply {
        StopReply::Stopped => Ok(()),
        StopReply::Unknown => Err(anyhow!("`{name}` has just ended by itself").into()),
    }
}
