//! `dca names`: lists every name that a host has given out, and its holder.

use crate::ConnectArgs;
use crate::absent::{self, Absences};
use crate::client::{ANSWER_WITHIN, Clients};
use crate::logic::names::{HostNames, Partition, partitions, text};
use comms::io::clock;
use node::console::{self, Failure, block_on};
use node::logic::protocol::{Answer, Request};

/// The arguments of `dca names`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Print everything as JSON, one object for each partition
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let (partitions, away) = block_on(async {
        let clients = Clients::open(&arguments.connect).await?;
        let asked = asked(&clients).await;
        clients.close().await;
        asked
    })?;
    if arguments.json {
        console::answer(&partitions);
    } else {
        console::say(&text(&partitions));
    }
    away.warnings().iter().for_each(|warning| console::note(warning));
    Ok(())
}

/// Asks every node for its names. Each command has its own nodes, which are a separate partition.
async fn asked(clients: &Clients) -> Result<(Vec<Partition>, Absences), Failure> {
    let found = clients.statuses().await?;
    let away = absent::ask(&found).await;
    let mut all = Vec::new();
    for (client, statuses) in found {
        let deadline = clock::now() + ANSWER_WITHIN;
        // All nodes are asked at once: each may be far away.
        let ask = |host: &str| client.ask_on(host, &Request::Names).ok();
        let asked: Vec<_> = statuses.nodes.into_iter().map(|status| (ask(&status.host), status)).collect();
        let mut told = Vec::new();
        for (answers, status) in asked {
            let answer = match answers {
                Some(mut answers) => answers.next_by(deadline).await,
                None => None,
            };
            let names = if let Some(Ok(Answer::Names(names))) = answer { Some(names) } else { None };
            if names.is_none() {
                console::note(&format!("warning: `{}` does not say which ports and devices it has", status.host));
            }
            told.push(HostNames { status, names });
        }
        all.extend(partitions(&told));
    }
    Ok((all, away))
}
