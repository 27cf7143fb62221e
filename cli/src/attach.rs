//! `dca attach`: watches a deployment whose terminal was lost, with the output of `dca deploy`.
//!
//! The home repeats the events so far. The mission is no longer recorded: the record ended with the command that began it.

use crate::client::{ANSWER_WITHIN, Client, Clients, Statuses, unasked};
use crate::complete;
use crate::logic::process_name::DeploymentName;
use crate::stop::{Located, locate};
use crate::{ConnectArgs, absent, follow};
use anyhow::anyhow;
use clap_complete::ArgValueCompleter;
use node::console::{Failure, block_on};
use node::logic::protocol::{Answer, Request};
use std::collections::BTreeSet;

/// The arguments of `dca attach`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The deployment; may be left out if only one runs
    #[arg(value_parser = DeploymentName::parse, add = ArgValueCompleter::new(complete::deployments))]
    name: Option<DeploymentName>,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    block_on(async {
        let clients = Clients::open(&arguments.connect).await?;
        let attached = attach(&clients, arguments.name.as_ref()).await;
        clients.close().await;
        attached
    })
}

async fn attach(clients: &Clients, name: Option<&DeploymentName>) -> Result<(), Failure> {
    let all = clients.statuses().await?;
    let name = match name {
        Some(name) => name.clone(),
        None => only_one(&all).await?,
    };
    let Located { client, deployment, home } = locate(all, &name).await?;
    let request = Request::Plan { deployment: deployment.clone() };
    let answer = client.ask(&home, &request, ANSWER_WITHIN).await?;
    let Answer::Plan(plan) = answer else { return Err(unasked(&home, &answer)) };
    follow::attach(client, *plan, deployment).await
}

/// Returns the name of the only deployment that runs.
async fn only_one(all: &[(&Client, Statuses)]) -> Result<DeploymentName, Failure> {
    let parts = all.iter().flat_map(|(_, found)| &found.nodes).flat_map(|node| &node.deployments);
    let names: BTreeSet<&str> = parts.map(|part| part.deployment.name.as_str()).collect();
    match &Vec::from_iter(names)[..] {
        [] => Err(absent::nowhere("deployment", None, &absent::ask(all).await)),
        [one] => DeploymentName::parse(one).map_err(|why| anyhow!(why).into()),
        several => Err(anyhow!("several deployments run: `{}`; name one of them", several.join("`, `")).into()),
    }
}
