//! Orders from a live view: stop everything, release the stop, answer a question.

use crate::client::{Client, Clients, words};
use crate::estop::{self, Outcome};
use crate::io::user;
use crate::logic::top::{Action, GivenAnswer};
use crate::{ConnectArgs, ctl};
use node::console::Failure;
use node::logic::protocol::{ActivityInput, Delivery, Estop, Request, TellRequest};
use std::collections::BTreeMap;
use std::sync::Arc;
use view::MissionId;

/// Stops everything on every node, or releases the stop. Returns the results in one line. If no node answers over the
/// present connections, new ones are made.
pub(crate) async fn everywhere(clients: &Clients, connect: &ConnectArgs, action: &Action) -> String {
    let request = if *action == Action::Release {
        Request::ReleaseEstop
    } else {
        Request::Estop(Estop { by: user::name_and_host(), reason: String::new() })
    };
    match outcomes(clients, connect, &request).await {
        Ok(outcomes) => in_one_line(&outcomes),
        Err(failure) => words(&failure),
    }
}

/// Makes every node stop everything or release the stop. Returns the result of each host. If no node answers over the
/// present connections, new ones are made.
pub(crate) async fn outcomes(
    clients: &Clients,
    connect: &ConnectArgs,
    request: &Request,
) -> Result<BTreeMap<String, Outcome>, Failure> {
    match estop::everywhere(clients, request).await {
        Ok(outcomes) => Ok(outcomes),
        Err(failure) => anew(clients, connect, request).await.ok_or(failure),
    }
}

/// Returns the results of all hosts in one line.
pub(crate) fn in_one_line(outcomes: &BTreeMap<String, Outcome>) -> String {
    let mut by_words: BTreeMap<String, Vec<&str>> = BTreeMap::new();
    for (host, outcome) in outcomes {
        by_words.entry(estop::in_words(outcome)).or_default().push(host);
    }
    let lines = by_words.into_iter().map(|(words, hosts)| format!("{}: {words}", hosts.join(", ")));
    lines.collect::<Vec<_>>().join(" | ")
}

/// Asks every node over new connections: the node behind the present ones may be gone, and another one may run now.
/// Gives up if this would need a passphrase.
async fn anew(clients: &Clients, connect: &ConnectArgs, request: &Request) -> Option<BTreeMap<String, Outcome>> {
    let fresh = Clients::open(connect).await.ok()?;
    let mut is_locked = false;
    for new in fresh.iter() {
        clients.iter().for_each(|old| new.take_keys(old));
        if let Some(host) = new.local() {
            is_locked |= new.asks_for_passphrase(host).await.unwrap_or(true);
        }
    }
    let outcomes = if is_locked { None } else { estop::everywhere(&fresh, request).await.ok() };
    fresh.close().await;
    outcomes
}

/// Answers a question, and returns the result in one line.
pub(crate) async fn tell(client: Arc<Client>, given: GivenAnswer) -> String {
    let GivenAnswer { mission: MissionId { deployment, home, .. }, path, question, option } = given;
    let order = ActivityInput::Answer { question, option: option.clone() };
    let request = TellRequest { name: deployment.name.clone(), process: path, order, by: user::name_and_host() };
    match ctl::deliver(&client, &home, request, deployment.epoch).await {
        Ok(Delivery::Taken { path, taken }) => ctl::confirmed(&format!("the answer `{option}`"), &path, taken),
        Ok(Delivery::Refused(why)) => format!("cannot give the answer: {why}"),
        Ok(Delivery::Unconfirmed(why)) => format!("the answer is not confirmed: {why}"),
        Err(failure) => words(&failure),
    }
}
