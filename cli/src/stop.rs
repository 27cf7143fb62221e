//! `dca stop`: ends a deployment on every host.
//!
//! The result is taken from the deployment's last report. It names the hosts that could not confirm that nothing of the
//! deployment is left. Its home keeps such an end in a list, so a second stop reports it as well. If the link is lost
//! in the meantime, the node is asked again.

mod away;

use crate::ConnectArgs;
use crate::absent;
use crate::client::{ANSWER_WITHIN, Answers, Client, Clients, Statuses, unasked, words};
use crate::complete;
use crate::logic::process_name::DeploymentName;
use anyhow::anyhow;
use clap_complete::ArgValueCompleter;
use comms::io::clock;
use comms::logic::human::span;
use node::console::{self, Failure, block_on};
use node::logic::protocol::{Answer, Change, Deployment, Ending, FailureCause, NodeStatus, Report, Request};
use std::collections::BTreeSet;
use std::time::Duration;

/// If the node is out of reach for longer than this, a note is printed.
const TOLD_AFTER: Duration = Duration::from_secs(2);
/// How long the deployment's home may be out of reach. A node that starts or ends hundreds of programs answers late.
const SILENT_MAX: Duration = Duration::from_secs(30);
/// How long hosts that answer may take to confirm that nothing is left of the earlier run.
const CONFIRMED_WITHIN: Duration = Duration::from_secs(5);
/// How often the node is asked again.
const ASK_EVERY: Duration = Duration::from_millis(200);

/// The arguments of `dca stop`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The deployment: NAME, or NAME@NUMBER for one run of it
    #[arg(value_parser = DeploymentName::parse, add = ArgValueCompleter::new(complete::deployments))]
    name: DeploymentName,
    /// Remove the deployment from the list of unconfirmed ends; the hosts are no longer asked
    #[arg(long)]
    forget: bool,
    /// Stop the deployment although its home HOST does not answer; other nodes inform the home when it is back
    #[arg(long, value_name = "HOST", conflicts_with_all = ["forget", "json"], add = ArgValueCompleter::new(complete::hosts))]
    away: Option<String>,
    /// Print the result as JSON
    #[arg(long, conflicts_with = "forget")]
    json: bool,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// The result of a stop.
pub(crate) struct Ended {
    /// Whether the deployment has ended, as far as its home and the hosts that answer know.
    pub(crate) is_stopped: bool,
    /// The hosts that have not confirmed that nothing of it is left.
    pub(crate) unconfirmed: Vec<String>,
    /// Work outside of the programs that may continue.
    pub(crate) may_go_on: Vec<String>,
    /// Why the stop was not successful. Nothing after a successful stop.
    pub(crate) failure: Option<Failure>,
}

/// The end of a deployment, according to its home.
#[derive(Default)]
struct Reported {
    /// The hosts that have not confirmed that nothing of it is left.
    hosts: Vec<String>,
    /// Work outside of the programs that may continue.
    may_go_on: Vec<String>,
    /// Whether a stop could not be confirmed.
    is_unconfirmed: bool,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let outcome = block_on(async {
        let clients = Clients::open(&arguments.connect).await?;
        let result = if let Some(home) = &arguments.away {
            away::keep_tombstones(&clients, &arguments.name, home).await.map(|()| None)
        } else if arguments.forget {
            forget(&clients, &arguments.name).await.map(|()| None)
        } else {
            stop(&clients, &arguments.name).await.map(Some)
        };
        clients.close().await;
        result
    });
    let name = arguments.name.text();
    let outcome = match outcome {
        Ok(Some(outcome)) => outcome,
        Ok(None) => return Ok(()),
        Err(failure) => {
            Ended { is_stopped: false, unconfirmed: Vec::new(), may_go_on: Vec::new(), failure: Some(failure) }
        }
    };
    if arguments.json {
        let Ended { is_stopped, unconfirmed, may_go_on, .. } = &outcome;
        console::answer(&serde_json::json!({
            "deployment": name, "stopped": is_stopped, "unconfirmed": unconfirmed, "may_go_on": may_go_on,
        }));
    }
    match outcome.failure {
        Some(failure) => Err(failure),
        None if arguments.json => Ok(()),
        None => {
            console::say(&format!("`{name}` is stopped; nothing of it is left"));
            Ok(())
        }
    }
}

impl Ended {
    /// Returns the result of a stop that the home has reported as done. It is a failure if hosts could not confirm the
    /// end, or if work outside of the programs may continue.
    fn reported(name: &DeploymentName, Reported { hosts, may_go_on, is_unconfirmed }: Reported) -> Self {
        let have = if hosts.len() == 1 { "has" } else { "have" };
        let failure = if !hosts.is_empty() {
            let listed = hosts.join("`, `");
            Some(Failure::Unreachable(anyhow!(
                "`{name}` is stopped, but `{listed}` {have} not confirmed that nothing of it is left: its programs may still run \
                 there; `dca status` says when they have ended"
            )))
        } else if !may_go_on.is_empty() {
            Some(anyhow!("the programs of `{name}` have ended, but {}", may_go_on.join("; ")).into())
        } else if is_unconfirmed {
            Some(
                anyhow!(
                    "`{name}` has ended, but the stop of one of its processes was not confirmed; `dca events` names it"
                )
                .into(),
            )
        } else {
            None
        };
        Self { is_stopped: true, unconfirmed: hosts, may_go_on, failure }
    }
}

/// Removes every end with that name from the lists of all nodes.
async fn forget(clients: &Clients, name: &DeploymentName) -> Result<(), Failure> {
    let all = clients.statuses().await?;
    let away = absent::ask(&all).await;
    let mut ends = Vec::new();
    for (client, node) in all.iter().flat_map(|(client, found)| found.nodes.iter().map(move |node| (client, node))) {
        let told = away.told.get(&node.host).map_or(&[][..], |absent| &absent.ends);
        for end in told.iter().filter(|end| name.is(&end.deployment)) {
            let request = Request::Forget { deployment: end.deployment.clone() };
            let request = client.signed(&node.host, request, end.deployment.epoch).await?;
            let answer = client.ask(&node.host, &request, ANSWER_WITHIN).await?;
            let Answer::Stop(_) = answer else { return Err(unasked(&node.host, &answer)) };
            ends.push(end);
        }
    }
    let mut parts = all.iter().flat_map(|(_, found)| &found.nodes).flat_map(|node| &node.deployments);
    let waiting = absent::waiting(name, &all)
        .map(|(_, home, one)| format!("`{name}` {one} on `{home}`; `dca stop {name}` ends that"));
    if ends.is_empty()
        && let Some(waiting) = waiting
    {
        return Err(anyhow!(waiting).into());
    }
    waiting.iter().for_each(|waiting| console::note(&format!("note: {waiting}")));
    if ends.is_empty()
        && let Some(part) = parts.find(|part| name.is(&part.deployment))
    {
        return Err(anyhow!("`{}` is {}; `dca stop {name}` ends it", part.deployment, part.phase).into());
    }
    if ends.is_empty() {
        return Err(anyhow!(
            "according to the nodes that answer, every host has confirmed that nothing of `{name}` is left"
        )
        .into());
    }
    ends.sort_by_key(|end| &end.deployment);
    ends.dedup_by_key(|end| &end.deployment);
    for end in ends {
        console::say(&format!("`{}` is forgotten: {} not confirmed its end", end.deployment, away.confirmers(end)));
    }
    Ok(())
}

/// The place of a deployment.
pub(crate) struct Located<'a> {
    /// The connection to its nodes.
    pub(crate) client: &'a Client,
    pub(crate) deployment: Deployment,
    /// The node that takes orders: where its `main` runs.
    pub(crate) home: String,
}

/// Finds the deployment with that name in the reports of all nodes.
pub(crate) async fn locate<'a>(
    all: Vec<(&'a Client, Statuses)>,
    name: &DeploymentName,
) -> Result<Located<'a>, Failure> {
    let mut found = Vec::new();
    for (client, Statuses { nodes, .. }) in &all {
        let mut parts = nodes.iter().flat_map(|node| &node.deployments);
        if let Some(part) = parts.find(|part| name.is(&part.deployment)) {
            found.push((*client, part, nodes));
        }
    }
    match found[..] {
        [(_, part, nodes)] if !answers(nodes, &part.home) => {
            let home = &part.home;
            Err(Failure::Unreachable(anyhow!(
                "the node `{home}`, where `{name}` has its home, does not answer; `dca stop {name} --away {home}` makes the \
                 other nodes pass the stop on when it answers again"
            )))
        }
        [(client, part, _)] => Ok(Located { client, deployment: part.deployment.clone(), home: part.home.clone() }),
        [] => Err(absent::not_running(name, &all).await),
        _ => {
            let names: Vec<String> = found.iter().map(|(_, part, _)| part.deployment.name.clone()).collect();
            let how = Client::choice(found.iter().map(|(client, _, _)| *client), &names);
            let how = how.unwrap_or_else(|| "give its whole name".to_owned());
            Err(anyhow!("`{name}` runs {} times on this machine; {how}", found.len()).into())
        }
    }
}

/// Stops a deployment that runs or that waits for its start.
pub(crate) async fn stop(clients: &Clients, name: &DeploymentName) -> Result<Ended, Failure> {
    let all = clients.statuses().await?;
    match absent::waiting(name, &all) {
        Some((client, home, waiting)) => stop_waiting(client, home, &waiting.name).await?,
        None if is_over(name, &all) => {
            let away = absent::ask(&all).await;
            let Some(end) = away.end(name) else { return Err(absent::no_deployment(name, &all, &away)) };
            let unconfirmed: Vec<String> = end.hosts.iter().map(|one| one.host.clone()).collect();
            let failure = away.not_confirmed(name, end);
            let is_stopped = !absent::is_unknown_at_home(end);
            return Ok(Ended { is_stopped, unconfirmed, may_go_on: Vec::new(), failure: Some(failure) });
        }
        None => return Ok(Ended::reported(name, stop_running(locate(all, name).await?).await?)),
    }
    let deadline = clock::now() + CONFIRMED_WITHIN;
    loop {
        let all = clients.statuses().await?;
        let away = absent::ask(&all).await;
        let ends = away.ends.iter().filter(|end| name.is(&end.deployment));
        let open: BTreeSet<String> = ends.flat_map(|end| end.hosts.iter().map(|open| open.host.clone())).collect();
        let answers = |host: &String| all.iter().flat_map(|(_, found)| &found.nodes).any(|node| node.host == *host);
        if !open.iter().any(answers) || clock::now() >= deadline {
            let hosts = open.into_iter().collect();
            return Ok(Ended::reported(name, Reported { hosts, ..Reported::default() }));
        }
        clock::sleep_until(clock::now() + ASK_EVERY).await;
    }
}

/// Returns whether no answering node runs a deployment of that name.
fn is_over(name: &DeploymentName, all: &[(&Client, Statuses)]) -> bool {
    let mut parts = all.iter().flat_map(|(_, found)| &found.nodes).flat_map(|node| &node.deployments);
    !parts.any(|part| name.is(&part.deployment))
}

/// Makes a home give up a deployment that waits for its start. If it has begun in the meantime, it is stopped.
async fn stop_waiting(client: &Client, home: &str, name: &str) -> Result<(), Failure> {
    let mut answers = client.order_on(home, Request::Stop { name: name.to_owned() }, 0).await?;
    match answers.next().await {
        Some(Ok(Answer::Stop(_))) => Ok(()),
        Some(Ok(Answer::Refused(why))) => Err(anyhow!("host `{home}`: {why}").into()),
        Some(Ok(other)) => Err(unasked(home, &other)),
        Some(Err(failure)) => Err(failure),
        None => Err(Failure::Unreachable(anyhow!("the node `{home}` went away"))),
    }
}

/// Stops a deployment, and returns its end.
async fn stop_running(Located { client, deployment, home }: Located<'_>) -> Result<Reported, Failure> {
    let name = &deployment.name;
    let (mut heard, mut is_told) = (clock::now(), false);
    loop {
        let why = match stop_once(client, &home, &deployment).await {
            Err(Failure::Unreachable(why)) => why,
            over => return over,
        };
        // A stop is sent by name. By now, this may be the name of another deployment.
        while !runs(client, &deployment).await {
            if let Ok(end) = last_report(client.ask_on(&home, &watch(&deployment))?, &home).await {
                return Ok(end);
            }
            if clock::now() - heard > SILENT_MAX {
                return Err(Failure::Unreachable(why.context(format!(
                    "`{home}`, the home of `{name}`, does not answer, and may not have received the stop; `dca stop {name} \
                     --away {home}` makes the other nodes pass the stop on when the home answers again"
                ))));
            }
            if !is_told && clock::now() - heard > TOLD_AFTER {
                console::note(&format!("note: {why:#}; asking again for {} (Ctrl-C to leave)", span(SILENT_MAX)));
                is_told = true;
            }
            clock::sleep_until(clock::now() + ASK_EVERY).await;
        }
        tracing::debug!(%deployment, why = %words(&Failure::Unreachable(why)), "asking for the end again");
        heard = clock::now();
    }
}

/// Returns whether the deployment runs and its home answers. Prints no warning about hosts that do not answer: the caller prints one.
async fn runs(client: &Client, deployment: &Deployment) -> bool {
    let Ok(Statuses { nodes, .. }) = client.statuses_noted(|_| {}).await else { return false };
    let mut parts = nodes.iter().flat_map(|node| &node.deployments);
    let part = parts.find(|part| part.deployment.name == deployment.name);
    part.is_some_and(|part| part.deployment == *deployment && answers(&nodes, &part.home))
}

/// Returns whether a host has answered. A host that is lost is not asked, so it is not listed as silent either.
fn answers(nodes: &[NodeStatus], host: &str) -> bool {
    nodes.iter().any(|node| node.host == host)
}

async fn stop_once(client: &Client, home: &str, deployment: &Deployment) -> Result<Reported, Failure> {
    // The reports are requested before the stop, so that the last one is not missed.
    let reports = client.ask_on(home, &watch(deployment))?;
    let stop = Request::Stop { name: deployment.name.clone() };
    let mut stopping = client.order_on(home, stop, deployment.epoch).await?;
    let refused = async {
        match stopping.next().await {
            Some(Ok(Answer::Refused(why))) => Failure::Refused(anyhow!("host `{home}`: {why}")),
            // The last report says how the stop went.
            _ => std::future::pending().await,
        }
    };
    tokio::select! {
        end = last_report(reports, home) => end,
        refused = refused => Err(refused),
    }
}

fn watch(deployment: &Deployment) -> Request {
    // This requests only future reports, and also the last report if it exists already.
    Request::Watch { deployment: deployment.clone(), seen: u64::MAX }
}

/// Waits for the last report, and returns the end that it reports.
async fn last_report(mut reports: Answers, home: &str) -> Result<Reported, Failure> {
    let mut end = Reported::default();
    loop {
        match reports.next().await {
            Some(Ok(Answer::Report(Report::Finished { unconfirmed, ending, .. }))) => {
                (end.hosts, end.is_unconfirmed) = (unconfirmed, ending == Ending::Unconfirmed);
                return Ok(end);
            }
            Some(Ok(Answer::Report(Report::Refused { .. }))) => return Ok(Reported::default()),
            Some(Ok(Answer::Report(report))) => end.may_go_on.extend(open_end(&report)),
            Some(Ok(other)) => return Err(unasked(home, &other)),
            Some(Err(why)) => return Err(why),
            None => return Err(Failure::Unreachable(anyhow!("the node `{home}` went away"))),
        }
    }
}

/// If the report is the end of a process, returns the work outside of it that may continue.
fn open_end(report: &Report) -> Option<String> {
    let Report::Process { path, change: Change::Ended(Ending::Aborted(failure)), .. } = report else { return None };
    let FailureCause::MayGoOn(what) = &failure.cause else { return None };
    (failure.origin == *path).then(|| format!("`{path}`: {what}"))
}
