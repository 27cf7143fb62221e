//! `dca attach`: watches a deployment whose terminal was lost, as `dca deploy` would have done.
//!
//! What has been seen of it so far is told again by its home. There is no record: that ended with the command that made it.

use crate::client::{ANSWER_WITHIN, Client, Clients, Statuses, unasked};
use crate::stop::{Located, locate};
use crate::{ConnectArgs, absent, follow};
use anyhow::anyhow;
use node::console::{Failure, block_on};
use node::logic::protocol::{Answer, Request};
use std::collections::BTreeSet;

/// The arguments of `dca attach`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The deployment; the only one that runs if none is named
    name: Option<String>,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    block_on(async {
        let clients = Clients::open(&arguments.connect).await?;
        let attached = attach(&clients, arguments.name.as_deref()).await;
        clients.close().await;
        attached
    })
}

async fn attach(clients: &Clients, name: Option<&str>) -> Result<(), Failure> {
    let all = clients.statuses().await?;
    let name = match name {
        Some(name) => name.to_owned(),
        None => only_one(&all).await?,
    };
    let Located { client, deployment, home } = locate(all, &name).await?;
    let request = Request::Plan { deployment: deployment.clone() };
    let answer = client.ask(&home, &request, ANSWER_WITHIN).await?;
    let Answer::Plan(plan) = answer else { return Err(unasked(&home, &answer)) };
    follow::attach(client, *plan, deployment).await
}

/// Returns the name of the only deployment that runs.
async fn only_one(all: &[(&Client, Statuses)]) -> Result<String, Failure> {
    let parts = all.iter().flat_map(|(_, found)| &found.nodes).flat_map(|node| &node.deployments);
    let names: BTreeSet<&str> = parts.map(|part| part.deployment.name.as_str()).collect();
    match &Vec::from_iter(names)[..] {
        [] => Err(absent::missing("deployment", all).await),
        [one] => Ok((*one).to_owned()),
        several => Err(anyhow!("several run: `{}`; name one", several.join("`, `")).into()),
    }
}
