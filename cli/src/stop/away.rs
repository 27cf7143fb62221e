//! `dca stop NAME --away HOST`: stops a deployment whose home does not answer, as far as this is possible without the home.
//! The nodes that answer inform the home when it is back. The home then ends the deployment, or does not begin it.

use crate::absent::{self, Absences};
use crate::client::{ANSWER_WITHIN, Client, Clients, Statuses, unasked};
use crate::db::databases::Databases;
use crate::logic::process_name::DeploymentName;
use anyhow::anyhow;
use comms::io::clock;
use node::console::{self, Failure};
use node::logic::database::chronicle;
use node::logic::database::question::{AsOf, Question, Reply};
use node::logic::protocol::{Answer, Deployment, Request, StopReply, Tombstone};

/// Makes every answering node keep a tombstone for the deployment.
pub(super) async fn keep_tombstones(clients: &Clients, name: &DeploymentName, home: &str) -> Result<(), Failure> {
    let all = clients.statuses().await?;
    if all.iter().flat_map(|(_, found)| &found.nodes).any(|node| node.host == home) {
        return Err(anyhow!("`{home}` answers: `dca stop {name}` ends it there").into());
    }
    let away = absent::ask(&all).await;
    let of = |epoch| Deployment { name: name.plain().to_owned(), epoch };
    let Some(epoch) = epoch(&all, &away, name.plain(), home).await.filter(|epoch| name.is(&of(*epoch))) else {
        return Err(anyhow!(
            "no node that answers knows of a deployment `{name}` with its home on `{home}`: {}",
            "check the names, or stop the deployment when that host answers again"
        )
        .into());
    };
    let deployment = of(epoch);
    let (mut keepers, mut why) = (Vec::new(), None);
    for (client, node) in all.iter().flat_map(|(client, found)| found.nodes.iter().map(move |node| (client, node))) {
        let tombstone = Tombstone { home: home.to_owned(), deployment: deployment.clone() };
        let request = client.signed(&node.host, Request::StopAway(Box::new(tombstone)), epoch).await?;
        match client.ask(&node.host, &request, ANSWER_WITHIN).await {
            Ok(Answer::Stop(StopReply::Stopped)) => keepers.push(node.host.as_str()),
            Ok(other) => why = Some(unasked(&node.host, &other)),
            Err(failure) => why = Some(failure),
        }
    }
    match (keepers.as_slice(), why) {
        ([], Some(why)) => Err(why),
        ([], None) => Err(Failure::Unreachable(anyhow!("no node answers that could inform `{home}`"))),
        (keepers, _) => {
            console::say(&format!(
                "`{deployment}` will be stopped as soon as `{home}` answers again: `{}` will inform it",
                keepers.join("`, `")
            ));
            Ok(())
        }
    }
}

/// Returns the latest known epoch of a deployment.
async fn epoch(all: &[(&Client, Statuses)], away: &Absences, name: &str, home: &str) -> Option<u64> {
    let parts = all.iter().flat_map(|(_, found)| &found.nodes).flat_map(|node| &node.deployments);
    let parts = parts.filter(|part| part.home == home).map(|part| &part.deployment);
    let told = away.told.values().flat_map(|absent| &absent.ends).filter(|end| end.home == home);
    let known = parts.chain(told.map(|end| &end.deployment)).filter(|deployment| deployment.name == name);
    let mut latest = known.map(|deployment| deployment.epoch).max();
    for (client, node) in all.iter().flat_map(|(client, found)| found.nodes.iter().map(move |node| (client, node))) {
        latest = latest.max(recorded(client, &node.host, &chronicle::below(home, name)).await);
    }
    latest
}

/// Returns the latest epoch below a prefix in the database of a robot; nothing if there is none. The database contains
/// the records of all homes.
async fn recorded(client: &Client, robot: &str, below: &str) -> Option<u64> {
    let databases = Databases::through(client, robot.to_owned());
    let question = Question::List { prefix: below.to_owned(), at: AsOf::Now };
    let mut replies = databases.ask(robot, question).await.ok()?;
    let mut latest = None;
    while let Ok(Some(Reply::Entries(entries))) = replies.next(clock::now() + ANSWER_WITHIN).await {
        let epochs =
            entries.iter().filter_map(|(key, _)| key.as_str().strip_prefix(below)?.split('/').next()?.parse().ok());
        latest = latest.max(epochs.max());
    }
    latest
}
