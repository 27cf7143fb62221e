//! `dca nodes`: lists the nodes that can be reached, and the nodes that no longer can be reached.

use crate::ConnectArgs;
use crate::absent::{self, Absences, ago, duplicate, outlawed};
use crate::client::{ANSWER_WITHIN, Client, Clients};
use comms::io::clock;
use node::console::{self, Failure, block_on};
use node::logic::protocol::{AbsentHost, Answer, Duplicate, NodeStatus, Request};
use node::logic::table::table;
use std::collections::BTreeSet;

/// The arguments of `dca nodes`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Print everything as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let (statuses, unlinked, away) = block_on(async {
        let clients = Clients::open(&arguments.connect).await?;
        let asked = asked(&clients).await;
        clients.close().await;
        asked
    })?;
    if arguments.json {
        let json = serde_json::json!({ "nodes": statuses, "missing": missing(&away)?, "duplicates": away.duplicates });
        console::answer(&json);
        away.duplicates.iter().map(duplicate).chain(unlinked).for_each(|sentence| console::note(&sentence));
        return Ok(());
    }
    let mut rows = vec![["HOST", "PID", "UP", "VERSION", "DEPLOYMENTS", "SEES"].map(str::to_owned).to_vec()];
    for node in statuses {
        let deployments: Vec<String> = node.deployments.iter().map(|one| one.deployment.name.clone()).collect();
        let up = format!("{} s", node.up.as_secs());
        rows.push(vec![node.host, node.pid.to_string(), up, node.version, dash(&deployments), dash(&node.peers)]);
    }
    let there: BTreeSet<String> = rows[1..].iter().map(|row| row[0].clone()).collect();
    rows.extend(away_rows(&away, &there));
    let dashes = || ["-", "-", "-"].map(str::to_owned);
    let twice = |one: &Duplicate| {
        let second = format!("second of its name: {}", one.second);
        [one.host.clone(), "-".to_owned(), second].into_iter().chain(dashes()).collect()
    };
    rows.extend(away.duplicates.iter().map(twice));
    away.duplicates.iter().for_each(|one| console::note(&duplicate(one)));
    away.outlawed.iter().for_each(|host| console::note(&outlawed(host)));
    console::say(&table(&rows));
    unlinked.iter().for_each(|sentence| console::note(sentence));
    Ok(())
}

/// Returns a row for each host that does not answer. The rows have the form of those for hosts that are `there`.
fn away_rows(away: &Absences, there: &BTreeSet<String>) -> Vec<Vec<String>> {
    let row = |host: &str, state: String| {
        let open = away.ends.iter().filter(|end| end.hosts.iter().any(|one| one.host == host));
        let open: Vec<String> = open.map(|end| format!("{}?", end.deployment.name)).collect();
        let none = || "-".to_owned();
        vec![host.to_owned(), none(), state, none(), dash(&open), none()]
    };
    let gone = |one: &AbsentHost| {
        let how = if one.lost { "lost" } else { "missing" };
        row(&one.host, format!("{how}, heard {}", ago(one.heard)))
    };
    let mut rows: Vec<Vec<String>> = away.hosts.iter().map(gone).collect();
    rows.extend(away.silent.iter().map(|host| row(host, "does not answer".to_owned())));
    rows.extend(away.revoked.iter().map(|host| row(host, "revoked".to_owned())));
    // The home may know such a host only from its journal.
    let named: BTreeSet<&str> = away.ends.iter().flat_map(|end| &end.hosts).map(|one| one.host.as_str()).collect();
    let listed: BTreeSet<String> = rows.iter().map(|row| row[0].clone()).collect();
    let unheard = named.into_iter().filter(|host| !listed.contains(*host) && !there.contains(*host));
    rows.extend(unheard.map(|host| row(host, "not heard yet".to_owned())));
    rows
}

/// Returns the hosts that do not answer. The time of the last message of a host is null if no node reports it.
fn missing(away: &Absences) -> serde_json::Result<Vec<serde_json::Value>> {
    let silent = away.silent.iter().map(|host| Ok(serde_json::json!({ "host": host, "heard": null, "lost": false })));
    away.hosts.iter().map(serde_json::to_value).chain(silent).collect()
}

/// Asks every node for its status, for the nodes that it misses, and for its missing links.
async fn asked(clients: &Clients) -> Result<(Vec<NodeStatus>, Vec<String>, Absences), Failure> {
    let (mut statuses, mut missing) = (Vec::new(), Vec::new());
    let all = clients.statuses().await?;
    let away = absent::ask(&all).await;
    for (client, found) in all {
        missing.extend(unlinked(client, &found.nodes).await);
        statuses.extend(found.nodes);
    }
    Ok((statuses, missing, away))
}

/// Returns a sentence for each link that a node tries to make but does not have yet.
async fn unlinked(client: &Client, nodes: &[NodeStatus]) -> Vec<String> {
    let (mut sentences, deadline) = (Vec::new(), clock::now() + ANSWER_WITHIN);
    // All nodes are asked at once: each may be far away.
    let asked: Vec<_> = nodes.iter().map(|node| (node, client.ask_on(&node.host, &Request::Unlinked))).collect();
    for (node, answers) in asked {
        let Ok(mut answers) = answers else { continue };
        // A node of an older version does not understand the question.
        let Some(Ok(Answer::Unlinked(missing))) = answers.next_by(deadline).await else { continue };
        sentences.extend(missing_links(node, missing));
    }
    sentences
}

/// Describes the missing links of a node. Leaves out links to other nodes that had the same name as this node.
fn missing_links(node: &NodeStatus, missing: Vec<(String, String)>) -> impl Iterator<Item = String> {
    let unseen = missing.into_iter().filter(|(who, _)| *who != node.host && !node.peers.contains(who));
    unseen.map(|(who, why)| format!("`{}` is not linked to {who}: {why}", node.host))
}

fn dash(words: &[String]) -> String {
    if words.is_empty() { "-".to_owned() } else { words.join(", ") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_node_is_not_missed_by_itself() {
        let node = crate::logic::tree::tests::door_node("c3", &[]);
        let missing = ["c3", "c4"].map(|who| (who.to_owned(), "it is being dialled".to_owned())).to_vec();
        let said: Vec<String> = missing_links(&node, missing).collect();
        assert_eq!(said, ["`c3` is not linked to c4: it is being dialled"], "a namesake of it has left");
    }

    #[test]
    fn a_host_that_no_node_misses_yet_is_listed() {
        let lost = AbsentHost { host: "c2".into(), heard: Duration::from_secs(40), lost: true };
        let away = Absences { hosts: vec![lost], silent: ["c3".to_owned()].into(), ..Absences::default() };
        let rows = away_rows(&away, &["c1".to_owned()].into());
        let told: Vec<_> = rows.iter().map(|row| (row[0].as_str(), row[2].as_str())).collect();
        assert_eq!(told, [("c2", "lost, heard 40 s ago"), ("c3", "does not answer")]);
        let json = serde_json::Value::Array(missing(&away).unwrap());
        let expected = serde_json::json!([
            { "host": "c2", "heard": 40.0, "lost": true },
            { "host": "c3", "heard": null, "lost": false },
        ]);
        assert_eq!(json, expected);
    }
}
