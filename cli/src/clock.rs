//! `dca clock`: the offset of each host's clock from the clock of this machine, and the error of this offset.

use crate::ConnectArgs;
use crate::absent;
use crate::client::{ANSWER_WITHIN, Client, Clients};
use crate::logic::clock::{Exchange, HostClock, text};
use anyhow::anyhow;
use comms::io::clock::{now, unix_time};
use node::console::{self, Failure, block_on};
use node::logic::protocol::{Answer, Request};
use std::collections::BTreeSet;

/// How many times a host is asked.
const EXCHANGES: usize = 8;

/// The arguments of `dca clock`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Print everything as JSON, times in seconds
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let (clocks, unreachable) = block_on(async {
        let clients = Clients::open(&arguments.connect).await?;
        let asked = asked(&clients).await;
        clients.close().await;
        asked
    })?;
    if arguments.json {
        console::answer(&serde_json::json!({ "clocks": clocks, "unreachable": unreachable }));
    } else {
        console::say(&text(&clocks, &unreachable));
    }
    clocks.iter().flat_map(HostClock::warnings).for_each(|warning| console::note(&warning));
    if unreachable.is_empty() {
        return Ok(());
    }
    let hosts = unreachable.join("`, `");
    Err(Failure::Unreachable(anyhow!("`{hosts}` did not answer; `dca nodes` says since when")))
}

/// Asks the hosts one after the other. If questions waited for each other, the links would look too long.
/// Also returns the hosts that do not answer.
async fn asked(clients: &Clients) -> Result<(Vec<HostClock>, Vec<String>), Failure> {
    let found = clients.look().await?;
    let away = absent::ask(&found).await;
    let mut unreachable: BTreeSet<String> = away.hosts.into_iter().map(|one| one.host).chain(away.silent).collect();
    let mut clocks = Vec::new();
    for (client, statuses) in found {
        for host in statuses.nodes.iter().map(|node| &node.host) {
            match HostClock::of(host, &exchanges(client, host).await) {
                Some(clock) => clocks.push(clock),
                None => drop(unreachable.insert(host.clone())),
            }
        }
    }
    Ok((clocks, unreachable.into_iter().collect()))
}

/// Asks a host several times, or fewer times if the time is short.
async fn exchanges(client: &Client, host: &str) -> Vec<Exchange> {
    let (mut exchanges, until) = (Vec::new(), now() + ANSWER_WITHIN);
    while exchanges.len() < EXCHANGES && now() < until {
        let (asked, shown_here) = (now(), unix_time());
        let answer = client.ask(host, &Request::Clock, ANSWER_WITHIN).await;
        let answered = now();
        let Ok(Answer::Clock(there)) = answer else { break };
        exchanges.push(Exchange { asked, shown_here, answered, there });
    }
    exchanges
}
