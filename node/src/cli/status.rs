//! `dca status`: what runs where.

use crate::cli::client::{Clients, block_on};
use crate::cli::{Failure, Reaching, output};
use crate::logic::table;

/// What `dca status` is told.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Only this deployment
    name: Option<String>,
    /// Print everything as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    reaching: Reaching,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let mut statuses = block_on(async {
        let clients = Clients::open(&arguments.reaching).await?;
        let statuses = clients.statuses().await.map(|all| all.into_iter().flat_map(|(_, statuses)| statuses.nodes));
        let statuses = statuses.map(Iterator::collect::<Vec<_>>);
        clients.close().await;
        statuses
    })?;
    if let Some(name) = &arguments.name {
        for status in &mut statuses {
            status.deployments.retain(|one| one.deployment.name == *name);
        }
    }
    if arguments.json {
        output::say(&serde_json::to_string_pretty(&statuses)?);
        return Ok(());
    }
    let text = table::tree(&statuses);
    output::say(if text.is_empty() { "nothing is deployed" } else { &text });
    Ok(())
}
