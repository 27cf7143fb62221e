//! `dca stop`: ends a deployment on every host.
//!
//! What it says rests on the deployment's last report, which names the hosts that could not confirm that nothing is left.
//! What a host has not confirmed stays on the list of the deployment's home: a second stop says so, too.
//! A link that is lost meanwhile is not an answer: the node is asked again.

use crate::cli::absent::{self, confirmers};
use crate::cli::client::{ANSWER_WITHIN, Answers, Client, Clients, Statuses, block_on, missing, unasked, words};
use crate::cli::{Failure, Reaching, output};
use crate::logic::protocol::{AbsentHost, Answer, Deployment, Report, Request};
use anyhow::anyhow;
use comms::io::clock;
use comms::logic::human::span;
use std::time::Duration;

/// How long it may be out of reach before a person is told.
const TOLD_AFTER: Duration = Duration::from_secs(2);
/// How long the deployment's node may be out of reach. A node that starts or ends hundreds of programs answers late.
const SILENT_MAX: Duration = Duration::from_secs(30);
/// How often the node is asked again.
const ASK_EVERY: Duration = Duration::from_millis(200);

/// What `dca stop` is told.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The deployment
    name: String,
    /// Take it off the list of what hosts have not confirmed: what may run there is nobody's business any more
    #[arg(long)]
    forget: bool,
    #[command(flatten)]
    reaching: Reaching,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let unconfirmed = block_on(async {
        let clients = Clients::open(&arguments.reaching).await?;
        let result = if arguments.forget {
            forget(&clients, &arguments.name).await.map(|()| None)
        } else {
            stop_any(&clients, &arguments.name).await.map(Some)
        };
        clients.close().await;
        result
    })?;
    let name = &arguments.name;
    let Some(unconfirmed) = unconfirmed else { return Ok(()) };
    if unconfirmed.is_empty() {
        output::say(&format!("`{name}` is stopped; nothing of it is left"));
        return Ok(());
    }
    let hosts = unconfirmed.join("`, `");
    let have = if unconfirmed.len() == 1 { "has" } else { "have" };
    Err(Failure::Unreachable(anyhow!(
        "`{name}` is stopped, but `{hosts}` {have} not confirmed that nothing of it is left: its programs may still run \
         there; `dca status` says when they have ended"
    )))
}

/// Stops the deployment of that name, which may be over but for some hosts.
async fn stop_any(clients: &Clients, name: &str) -> Result<Vec<String>, Failure> {
    let all = clients.statuses().await?;
    let away = absent::ask(&all).await;
    match whose(all, name) {
        Ok(client) => stop(client, name).await,
        Err(failure) => match away.ends.iter().rfind(|end| end.deployment.name == name) {
            Some(end) => Err(Failure::Unreachable(anyhow!(
                "`{}` has ended, but {} not confirmed that nothing of it is left: its programs may still run there; \
                 `dca stop {name} --forget` takes it off the list",
                end.deployment,
                confirmers(end)
            ))),
            None => Err(unless_away(failure, name, &away.hosts)),
        },
    }
}

/// Says that a deployment may run on hosts that do not answer; if all answer, why it does not run.
fn unless_away(failure: Failure, name: &str, hosts: &[AbsentHost]) -> Failure {
    if hosts.is_empty() {
        return failure;
    }
    let hosts: Vec<&str> = hosts.iter().map(|one| one.host.as_str()).collect();
    Failure::Unreachable(anyhow!(
        "no node that answers has the deployment `{name}`, and `{}` cannot be reached, where it may run",
        hosts.join("`, `")
    ))
}

/// Takes every end of that name off the lists of all nodes.
async fn forget(clients: &Clients, name: &str) -> Result<(), Failure> {
    let all = clients.statuses().await?;
    let away = absent::ask(&all).await;
    let mut ends = Vec::new();
    for (client, node) in all.iter().flat_map(|(client, found)| found.nodes.iter().map(move |node| (client, node))) {
        let told = away.told.get(&node.host).map_or(&[][..], |absent| &absent.ends);
        for end in told.iter().filter(|end| end.deployment.name == name) {
            let request = Request::Forget { deployment: end.deployment.clone() };
            let answer = client.ask(&node.host, &request, ANSWER_WITHIN).await?;
            let Answer::Stop(_) = answer else { return Err(unasked(&node.host, &answer)) };
            ends.push(end);
        }
    }
    if ends.is_empty() {
        return Err(anyhow!(
            "every host has confirmed that nothing of `{name}` is left, as far as nodes that answer know"
        )
        .into());
    }
    ends.sort_by_key(|end| &end.deployment);
    ends.dedup_by_key(|end| &end.deployment);
    for end in ends {
        output::say(&format!("`{}` is forgotten: {} not confirmed its end", end.deployment, confirmers(end)));
    }
    Ok(())
}

/// Returns the connection to the nodes that run a deployment of that name.
pub(crate) fn whose<'a>(all: Vec<(&'a Client, Statuses)>, name: &str) -> Result<&'a Client, Failure> {
    let (mut found, mut unanswered) = (Vec::new(), Vec::new());
    for (client, Statuses { nodes, silent }) in all {
        if nodes.iter().flat_map(|node| &node.deployments).any(|part| part.deployment.name == name) {
            found.push(client);
        } else {
            unanswered.extend(silent);
        }
    }
    match &found[..] {
        [one] => Ok(one),
        [] => Err(missing(&format!("deployment `{name}`"), &unanswered)),
        several => {
            let why =
                "each has nodes of its own; choose one with `--run-dir`, or end it with Ctrl-C where it was started";
            Err(anyhow!("`{name}` runs {} times on this machine: {why}", several.len()).into())
        }
    }
}

/// Stops a deployment; returns the hosts that could not confirm that nothing of it is left.
async fn stop(client: &Client, name: &str) -> Result<Vec<String>, Failure> {
    let (deployment, home) = find(client, name).await?;
    let (mut heard, mut is_told) = (clock::now(), false);
    loop {
        let why = match stop_once(client, &home, &deployment).await {
            Err(Failure::Unreachable(why)) => why,
            over => return over,
        };
        // Stopping goes by the name, which may be another deployment's by now.
        while !matches!(find(client, name).await, Ok((there, _)) if there == deployment) {
            if let Ok(unconfirmed) = last_report(client.ask_on(&home, &watch(&deployment))?, &home).await {
                return Ok(unconfirmed);
            }
            if clock::now() - heard > SILENT_MAX {
                return Err(Failure::Unreachable(why.context(format!(
                    "`{name}` was asked to stop, but its node cannot be asked whether it has; see `dca status`"
                ))));
            }
            if !is_told && clock::now() - heard > TOLD_AFTER {
                output::note(&format!("note: {why:#}; it is asked again for {} (Ctrl-C to leave)", span(SILENT_MAX)));
                is_told = true;
            }
            clock::sleep_until(clock::now() + ASK_EVERY).await;
        }
        tracing::debug!(deployment = %deployment, why = %words(&Failure::Unreachable(why)), "asking for the end again");
        heard = clock::now();
    }
}

/// Returns the deployment of that name, and the node where its `main` runs.
pub(crate) async fn find(client: &Client, name: &str) -> Result<(Deployment, String), Failure> {
    let Statuses { nodes, silent } = client.statuses().await?;
    let mut parts = nodes.into_iter().flat_map(|node| node.deployments);
    let Some(part) = parts.find(|part| part.deployment.name == name) else {
        return Err(missing(&format!("deployment `{name}`"), &silent));
    };
    if silent.contains(&part.home) {
        let home = part.home;
        return Err(Failure::Unreachable(anyhow!("the node `{home}`, where `{name}` has its home, does not answer")));
    }
    Ok((part.deployment, part.home))
}

async fn stop_once(client: &Client, home: &str, deployment: &Deployment) -> Result<Vec<String>, Failure> {
    // Watched first, so that the last report is not missed.
    let reports = client.ask_on(home, &watch(deployment))?;
    let mut stopping = client.ask_on(home, &Request::Stop { name: deployment.name.clone() })?;
    let refused = async {
        match stopping.next().await {
            Some(Ok(Answer::Refused(why))) => Failure::Refused(anyhow!("host `{home}`: {why}")),
            // The last report says the rest.
            _ => std::future::pending().await,
        }
    };
    tokio::select! {
        unconfirmed = last_report(reports, home) => unconfirmed,
        refused = refused => Err(refused),
    }
}

fn watch(deployment: &Deployment) -> Request {
    // Only the reports to come, and the last one if it is there.
    Request::Watch { deployment: deployment.clone(), seen: u64::MAX }
}

/// Waits for the last report; returns the hosts that could not confirm.
async fn last_report(mut reports: Answers, home: &str) -> Result<Vec<String>, Failure> {
    loop {
        match reports.next().await {
            Some(Ok(Answer::Report(Report::Finished { unconfirmed, .. }))) => return Ok(unconfirmed),
            Some(Ok(Answer::Report(Report::Refused { .. }))) => return Ok(Vec::new()),
            Some(Ok(Answer::Report(_))) => {}
            Some(Ok(other)) => return Err(unasked(home, &other)),
            Some(Err(why)) => return Err(why),
            None => return Err(Failure::Unreachable(anyhow!("the node `{home}` went away"))),
        }
    }
}
