//! `dca nodes`: who can be reached, and who cannot any more.

use crate::Reaching;
use crate::absent::{self, Away, ago};
use crate::client::{ANSWER_WITHIN, Client, Clients};
use comms::io::clock;
use node::console::{self, Failure, block_on};
use node::logic::protocol::{Answer, NodeStatus, Request};
use node::logic::table::table;
use std::collections::BTreeSet;

/// What `dca nodes` is told.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Print everything as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    reaching: Reaching,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let (statuses, unlinked, away) = block_on(async {
        let clients = Clients::open(&arguments.reaching).await?;
        let asked = asked(&clients).await;
        clients.close().await;
        asked
    })?;
    if arguments.json {
        let (nodes, missing) = (statuses, away.hosts);
        console::say(&serde_json::to_string_pretty(&serde_json::json!({ "nodes": nodes, "missing": missing }))?);
        unlinked.iter().for_each(|sentence| console::note(sentence));
        return Ok(());
    }
    let mut rows = vec![["HOST", "PID", "UP", "VERSION", "DEPLOYMENTS", "SEES"].map(str::to_owned).to_vec()];
    for node in statuses {
        let deployments: Vec<String> = node.deployments.iter().map(|one| one.deployment.name.clone()).collect();
        let up = format!("{} s", node.up.as_secs());
        rows.push(vec![node.host, node.pid.to_string(), up, node.version, dash(&deployments), dash(&node.peers)]);
    }
    let open = |host: &str| {
        let ends = away.ends.iter().filter(|end| end.hosts.iter().any(|one| one.host == host));
        ends.map(|end| format!("{}?", end.deployment.name)).collect::<Vec<_>>()
    };
    for gone in &away.hosts {
        let how = if gone.lost { "lost" } else { "missing" };
        let [none, version, sees] = ["-", "-", "-"].map(str::to_owned);
        let up = format!("{how}, heard {}", ago(gone.heard));
        rows.push(vec![gone.host.clone(), none, up, version, dash(&open(&gone.host)), sees]);
    }
    // One of which this home has only read in its journal.
    let named: BTreeSet<&str> = away.ends.iter().flat_map(|end| &end.hosts).map(|one| one.host.as_str()).collect();
    for host in named.into_iter().filter(|host| rows.iter().all(|row| row[0] != **host)).collect::<Vec<_>>() {
        let [none, version, sees] = ["-", "-", "-"].map(str::to_owned);
        rows.push(vec![host.to_owned(), none, "not heard yet".to_owned(), version, dash(&open(host)), sees]);
    }
    console::say(&table(&rows));
    unlinked.iter().for_each(|sentence| console::note(sentence));
    Ok(())
}

/// Asks every node how it is, whom it is not linked to, and whom it misses.
async fn asked(clients: &Clients) -> Result<(Vec<NodeStatus>, Vec<String>, Away), Failure> {
    let (mut statuses, mut missing) = (Vec::new(), Vec::new());
    let all = clients.statuses().await?;
    let away = absent::ask(&all).await;
    for (client, found) in all {
        missing.extend(unlinked(client, &found.nodes).await);
        statuses.extend(found.nodes);
    }
    Ok((statuses, missing, away))
}

/// Returns a sentence for each link that a node tries to make, and has not.
async fn unlinked(client: &Client, nodes: &[NodeStatus]) -> Vec<String> {
    let (mut sentences, deadline) = (Vec::new(), clock::now() + ANSWER_WITHIN);
    // All at once: each may be far away.
    let asked: Vec<_> = nodes.iter().map(|node| (node, client.ask_on(&node.host, &Request::Unlinked))).collect();
    for (node, answers) in asked {
        let Ok(mut answers) = answers else { continue };
        // One of an older version does not know the question.
        let Some(Ok(Answer::Unlinked(missing))) = answers.next_by(deadline).await else { continue };
        let unseen = missing.into_iter().filter(|(who, _)| !node.peers.contains(who));
        sentences.extend(unseen.map(|(who, why)| format!("`{}` is not linked to {who}: {why}", node.host)));
    }
    sentences
}

fn dash(words: &[String]) -> String {
    if words.is_empty() { "-".to_owned() } else { words.join(", ") }
}
