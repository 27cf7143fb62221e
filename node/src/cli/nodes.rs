//! `dca nodes`: who can be reached.

use crate::cli::client::{Clients, block_on};
use crate::cli::{Failure, Reaching, output};
use crate::logic::table::table;

/// What `dca nodes` is told.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    reaching: Reaching,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let statuses = block_on(async {
        let clients = Clients::open(&arguments.reaching).await?;
        let statuses = clients.statuses().await.map(|all| all.into_iter().flat_map(|(_, statuses)| statuses.nodes));
        let statuses = statuses.map(Iterator::collect::<Vec<_>>);
        clients.close().await;
        statuses
    })?;
    let mut rows = vec![["HOST", "PID", "UP", "VERSION", "DEPLOYMENTS", "SEES"].map(str::to_owned).to_vec()];
    for node in statuses {
        let deployments: Vec<String> = node.deployments.iter().map(|one| one.deployment.name.clone()).collect();
        let up = format!("{} s", node.up.as_secs());
        rows.push(vec![node.host, node.pid.to_string(), up, node.version, dash(&deployments), dash(&node.peers)]);
    }
    output::say(&table(&rows));
    Ok(())
}

fn dash(words: &[String]) -> String {
    if words.is_empty() { "-".to_owned() } else { words.join(", ") }
}
