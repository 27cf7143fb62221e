//! `dca deploy`: runs a spec on the hosts that it names, and stays until the mission has ended. If a deployment of this
//! name runs already, changes it to the spec instead, and reports the result.

use crate::change::{Rollout, change_running};
use crate::client::Client;
use crate::follow::Spec;
use crate::verify::Proof;
use crate::{ConnectArgs, Controllers, Values, check, follow, stored};
use anyhow::anyhow;
use node::console::{Failure, block_on};
use node::logic::protocol::StartMode;
use std::path::PathBuf;

/// The arguments of `dca deploy`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The spec
    file: PathBuf,
    #[command(flatten)]
    following: follow::FollowArgs,
    #[command(flatten)]
    connect: ConnectArgs,
    #[command(flatten)]
    controllers: Controllers,
    #[command(flatten)]
    values: Values,
    #[command(flatten)]
    rollout: Rollout,
    #[command(flatten)]
    proof: Proof,
    /// Begin the first step on all hosts at one moment: a tenth of a second after GO, or a little more where links are slow
    #[arg(long)]
    aligned: bool,
}

/// Runs the verb.
pub(crate) fn run(arguments: Arguments) -> Result<(), Failure> {
    let spec = check::load(&arguments.file, &arguments.controllers, &arguments.values, false)?;
    arguments.proof.require(&spec)?;
    block_on(async {
        let client = Client::open(&arguments.connect).await?;
        let start = if arguments.aligned { StartMode::Aligned } else { StartMode::AtOnce };
        let result = deploy(&client, spec, &arguments.following, start, Some(&arguments.rollout)).await;
        client.close().await;
        result
    })
}

/// Deploys a spec once all of its hosts answer, and stays until the mission has ended. With a rollout, if a
/// deployment of the same name runs already, changes it to this spec instead.
pub(crate) async fn deploy(
    client: &Client,
    spec: Spec,
    following: &follow::FollowArgs,
    start: StartMode,
    rollout: Option<&Rollout>,
) -> Result<(), Failure> {
    client.refuse_revoked(&spec.plan.hosts).await?;
    let hosts = client.hosts(&spec.plan.hosts).await?;
    let missing: Vec<&str> = spec.plan.hosts.iter().filter(|host| !hosts.contains(*host)).map(String::as_str).collect();
    if let Some(first) = missing.first() {
        let unlinked = client.unlinked(&missing);
        if !unlinked.is_empty() {
            return Err(Failure::Unreachable(anyhow!("{}; try again", unlinked.join("; "))));
        }
        let seen = if hosts.is_empty() { "none".to_owned() } else { hosts.into_iter().collect::<Vec<_>>().join(", ") };
        return Err(Failure::Unreachable(anyhow!(
            "no node answers for the host `{}` (nodes seen: {seen}); start `dca-node --name {first}` on it, in the same \
             team or with `--insecure-lan`",
            missing.join("`, `")
        )));
    }
    if let Some(rollout) = rollout
        && change_running(client, &spec, rollout).await?
    {
        return Ok(());
    }
    stored::check(client, &spec).await?;
    follow::follow(client, spec, following, start).await
}
