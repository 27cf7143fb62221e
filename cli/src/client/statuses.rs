//! Asks the nodes that can be reached for their status.

use super::{ANSWER_WITHIN, Answers, Client, unasked, words};
use anyhow::anyhow;
use comms::io::clock;
use comms::logic::time::Time;
use node::console::Failure;
use node::logic::protocol::{Answer, NodeStatus, Request};
use std::collections::BTreeSet;

/// The answers of the nodes about themselves.
#[derive(Debug, Default)]
pub(crate) struct Statuses {
    /// The state of every node that answers, in order of name.
    pub(crate) nodes: Vec<NodeStatus>,
    /// The known nodes that do not answer.
    pub(crate) silent: Vec<String>,
    /// The hosts that do not answer, and that some answering nodes miss.
    pub(crate) missed: BTreeSet<String>,
}

impl Statuses {
    /// Asks every node at once for its status, and then the nodes that only other nodes have named. `note` receives a
    /// warning for each node that does not answer.
    pub(super) async fn ask(client: &Client, note: fn(&str)) -> Result<Self, Failure> {
        let hosts = client.all().await?;
        let mut found = Self::of(client, &hosts, note).await;
        // If a node has just vanished from the network, the other nodes miss it only a little later.
        let named: BTreeSet<String> = found.nodes.iter().flat_map(|node| node.peers.iter().cloned()).collect();
        let Self { nodes, silent, .. } = Self::of(client, &(&named - &hosts), note).await;
        found.nodes.extend(nodes);
        found.silent.extend(silent);
        // A missed node may be back by now. If not, the nodes that miss it report this.
        let asked = &named | &hosts;
        let missed: BTreeSet<String> = found.nodes.iter().flat_map(|node| node.missing.iter().cloned()).collect();
        let Self { nodes, silent, .. } = Self::of(client, &(&missed - &asked), |_| {}).await;
        found.nodes.extend(nodes);
        found.missed.extend(silent);
        found.nodes.sort_by(|a, b| a.host.cmp(&b.host));
        if found.nodes.is_empty() {
            let none = match &found.silent[..] {
                [] => "no node answers; start one with `dca-node --name NAME`, in your team or with `--insecure-lan`"
                    .to_owned(),
                silent => format!(
                    "`{}` can be reached and does not answer: it may be suspended, or short of processor time; try again",
                    silent.join("`, `")
                ),
            };
            return Err(Failure::Unreachable(anyhow!(none)));
        }
        Ok(found)
    }

    async fn of(client: &Client, hosts: &BTreeSet<String>, note: fn(&str)) -> Self {
        let asked: Vec<_> = hosts.iter().map(|host| (client.ask_on(host, &Request::Status), host)).collect();
        let deadline = clock::now() + ANSWER_WITHIN;
        let mut found = Self::default();
        for (answers, host) in asked {
            let status = match answers {
                Ok(answers) => status(answers, deadline).await,
                Err(failure) => Err(failure),
            };
            match status {
                Ok(status) => found.nodes.push(status),
                Err(failure) => {
                    note(&format!("warning: {}: the programs that run there are not known", words(&failure)));
                    found.silent.push(host.clone());
                }
            }
        }
        found
    }
}

/// Waits for the status of a node.
async fn status(mut answers: Answers, deadline: Time) -> Result<NodeStatus, Failure> {
    let answer = answers.next_by(deadline).await;
    let host = &answers.host;
    match answer {
        Some(Ok(Answer::Status(status))) => Ok(status),
        Some(Ok(other)) => Err(unasked(host, &other)),
        Some(Err(failure)) => Err(failure),
        None => Err(Failure::Unreachable(anyhow!("the node `{host}` does not answer"))),
    }
}
