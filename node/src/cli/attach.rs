//! `dca attach`: watches a deployment whose terminal was lost, as `dca deploy` would have gone on to.
//!
//! What has been seen of it so far is told again by its home. There is no record: that ended with the command that made it.

use crate::cli::client::{ANSWER_WITHIN, Client, Clients, block_on, missing, unasked};
use crate::cli::{Failure, Reaching, follow, stop};
use crate::logic::protocol::{Answer, Request};
use anyhow::anyhow;

/// What `dca attach` is told.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The deployment; the only one that runs if none is named
    name: Option<String>,
    #[command(flatten)]
    reaching: Reaching,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    block_on(async {
        let clients = Clients::open(&arguments.reaching).await?;
        let attached = attach(&clients, arguments.name.as_deref()).await;
        clients.close().await;
        attached
    })
}

async fn attach(clients: &Clients, name: Option<&str>) -> Result<(), Failure> {
    let name = match name {
        Some(name) => name.to_owned(),
        None => only_one(clients).await?,
    };
    let client = stop::whose(clients.statuses().await?, &name)?;
    let (deployment, home) = stop::find(client, &name).await?;
    let request = Request::Plan { deployment: deployment.clone() };
    let answer = client.ask(&home, &request, ANSWER_WITHIN).await?;
    let Answer::Plan(plan) = answer else { return Err(unasked(&home, &answer)) };
    follow::attach(client, *plan, deployment).await
}

/// Returns the name of the only deployment that runs.
async fn only_one(clients: &Clients) -> Result<String, Failure> {
    let (mut names, mut silent) = (Vec::new(), Vec::new());
    let all: Vec<(&Client, _)> = clients.statuses().await?;
    for (_, found) in all {
        names.extend(found.nodes.into_iter().flat_map(|node| node.deployments).map(|part| part.deployment.name));
        silent.extend(found.silent);
    }
    names.sort();
    names.dedup();
    match &names[..] {
        [] => Err(missing("deployment", &silent)),
        [one] => Ok(one.clone()),
        several => Err(anyhow!("several run: `{}`; name one", several.join("`, `")).into()),
    }
}
