//! Follows outputs of running programs, for `dca echo` and `dca hz`.
//!
//! The nodes say which programs match and where they are. Each value then comes directly from its program. The home of
//! the deployment reports when a program was restarted, and when the deployment has ended.

use crate::client::{ANSWER_WITHIN, Answers, Client, Clients, unasked, words};
use crate::complete;
use crate::io::taps::Taps;
use crate::io::value_queue::SharedQueue;
use crate::logic::tap::{Wanted, message};
use crate::logic::value_queue::Queued;
use crate::reader::Reader;
use crate::{ConnectArgs, absent};
use anyhow::anyhow;
use clap_complete::ArgValueCompleter;
use comms::io::clock;
use comms::logic::control::Dial;
use comms::logic::layout::Message;
use comms::logic::tap::{Outputs, Tapped};
use node::console::{self, Failure};
use node::logic::protocol::{Answer, Change, Deployment, Report, Request, leaves};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

/// The most outputs that are followed at once.
const OUTPUTS_MAX: usize = 256;
/// The period of [`TapEvent::Second`].
const SECOND: Duration = Duration::from_secs(1);

/// Which outputs are followed.
#[derive(Debug, clap::Args)]
pub(crate) struct TapArgs {
    /// The output, and the end of its process's path: `force.Out`, `door:hit/force.Out`; of a device: `plant.arm/state`; inside
    /// an in-process group: `filter.smooth.Out`; without a process all that have it
    #[arg(value_parser = Wanted::parse, add = ArgValueCompleter::new(complete::outputs))]
    output: Wanted,
    /// Print objects of JSON, one on a line; the last has `end`
    #[arg(long)]
    pub(crate) json: bool,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// An output that is followed.
#[derive(Debug)]
pub(crate) struct FollowedOutput {
    /// Path of the process and its output: `main/hit/force.Out`.
    pub(crate) name: String,
    /// The type of its values, as its program names it.
    pub(crate) type_name: String,
    /// The fields of the values, if the program lists them.
    pub(crate) message: Option<Message>,
}

/// An event of the outputs.
pub(crate) enum TapEvent {
    /// From now on, values of the outputs arrive.
    Begun(Vec<FollowedOutput>),
    /// A value of an output. The number is the position of the output in the list.
    Value(usize, Tapped),
    /// A second is over.
    Second,
}

/// How the command has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum End {
    /// The deployment is over.
    Finished,
    /// The requested number of values has arrived, or the requested time is over.
    Enough,
    /// The user has ended the command, or no longer reads its output.
    Interrupted,
}

impl End {
    /// Returns the end in one word.
    pub(crate) fn word(self) -> &'static str {
        match self {
            Self::Finished => "finished",
            Self::Enough => "enough",
            Self::Interrupted => "interrupted",
        }
    }
}

/// A matching program.
pub(crate) struct Program {
    pub(crate) path: String,
    pub(crate) host: String,
    /// The address of its data session.
    pub(crate) dial: Dial,
}

/// Follows the requested outputs until `take` returns an end, the user presses Ctrl-C, or the deployment is over.
pub(crate) async fn follow(
    arguments: &TapArgs,
    mut take: impl FnMut(TapEvent) -> anyhow::Result<Option<End>>,
) -> Result<End, Failure> {
    let mut reader = Reader::new()?;
    let clients = Clients::open(&arguments.connect).await?;
    let mut taps = Taps::open(clients.iter().find_map(|client| client.team())).await?;
    let ended = tokio::select! {
        ended = follow_with(&clients, &mut taps, arguments, &mut take) => ended,
        () = reader.left() => Ok(End::Interrupted),
    };
    taps.close().await;
    clients.close().await;
    ended
}

async fn follow_with(
    clients: &Clients,
    taps: &mut Taps,
    arguments: &TapArgs,
    take: &mut impl FnMut(TapEvent) -> anyhow::Result<Option<End>>,
) -> Result<End, Failure> {
    let (client, deployment, home, mut programs) = find(clients, arguments).await?;
    // The reports are requested first, so that no restart is missed.
    let watch = Request::Watch { deployment: deployment.clone(), seen: u64::MAX };
    let mut reports = Some(client.ask_on(&home, &watch)?);
    let (outputs, values) = hear(taps, arguments, &deployment, &programs).await?;
    take(TapEvent::Begun(outputs))?;
    let (mut second, mut is_away) = (clock::now() + SECOND, false);
    loop {
        let end = tokio::select! {
            Queued { source, value, .. } = values.next() => take(TapEvent::Value(source, value))?,
            () = clock::sleep_until(second) => {
                second = second + SECOND;
                if reports.is_none() {
                    reports = client.ask_on(&home, &watch).ok();
                    // While the home was out of reach, it did not report restarts of programs.
                    for program in &mut programs {
                        if found_again(client, taps, &deployment, program).await.is_err() {
                            break;
                        }
                    }
                }
                take(TapEvent::Second)?
            }
            report = next(&mut reports) => match report {
                Some(Ok(Answer::Report(Report::Finished { .. } | Report::Refused { .. }))) => Some(End::Finished),
                Some(Ok(Answer::Report(Report::Process { path, change: Change::Started { .. } | Change::Activated | Change::Resumed, .. }))) => {
                    if let Some(program) = programs.iter_mut().find(|program| program.path == path) {
                        let found = found_again(client, taps, &deployment, program).await;
                        found.unwrap_or_else(|failure| {
                            console::note(&format!("warning: `{path}` was started again: {}", words(&failure)));
                        });
                    }
                    None
                }
                Some(Ok(Answer::Report(_))) => {
                    is_away = false;
                    None
                }
                Some(Ok(other)) => return Err(unasked(&home, &other)),
                Some(Err(failure)) => {
                    if !std::mem::replace(&mut is_away, true) {
                        let why = words(&failure);
                        console::note(&format!("warning: {why}. Still receiving values; the end of the mission will be reported when the node is back"));
                    }
                    reports = None;
                    None
                }
                None => Some(End::Finished),
            },
        };
        if let Some(end) = end {
            return Ok(end);
        }
    }
}

/// Returns the next report. Waits for ever if `reports` is empty.
async fn next(reports: &mut Option<Answers>) -> Option<Result<Answer, Failure>> {
    match reports {
        Some(reports) => reports.next().await,
        None => std::future::pending().await,
    }
}

/// Finds the matching programs. They have to belong to one deployment.
async fn find<'a>(
    clients: &'a Clients,
    arguments: &TapArgs,
) -> Result<(&'a Client, Deployment, String, Vec<Program>), Failure> {
    let (wanted, all) = (&arguments.output, clients.statuses().await?);
    let mut found = Vec::new();
    for (client, statuses) in &all {
        let mut meant: BTreeMap<&Deployment, BTreeMap<&str, BTreeSet<&str>>> = BTreeMap::new();
        for leaf in leaves(&statuses.nodes) {
            if wanted.process().is_process(leaf.deployment, &leaf.process.path) {
                let hosts = meant.entry(leaf.deployment).or_default();
                hosts.entry(leaf.host).or_default().insert(&leaf.process.path);
            }
        }
        for (deployment, hosts) in meant {
            let mut programs = Vec::new();
            for (host, paths) in hosts {
                let located = locations(client, host, deployment).await?;
                let here = located.into_iter().filter(|(path, _)| paths.contains(path.as_str()));
                programs.extend(here.map(|(path, dial)| Program { path, host: host.to_owned(), dial }));
            }
            if !programs.is_empty() {
                found.push((*client, deployment.clone(), programs));
            }
        }
    }
    let what = format!("process with an output `{wanted}`");
    if found.len() > 1 {
        let names: Vec<String> = found.iter().map(|(_, deployment, _)| format!("`{}`", deployment.name)).collect();
        let how = Client::choice(found.iter().map(|(client, ..)| *client), &names).unwrap_or_else(|| {
            format!("write the name of a deployment before it, as in `{}:{}`", found[0].1.name, wanted.bare())
        });
        return Err(anyhow!("several deployments have a {what}: {}; {how}", names.join(", ")).into());
    }
    let Some((client, deployment, programs)) = found.pop() else {
        return Err(absent::no_output(wanted, &all).await);
    };
    let nodes = all.iter().filter(|(other, _)| std::ptr::eq(*other, client)).flat_map(|(_, statuses)| &statuses.nodes);
    let home = nodes
        .flat_map(|node| &node.deployments)
        .find(|part| part.deployment == deployment)
        .map(|part| part.home.clone());
    let home = home.ok_or_else(|| anyhow!("`{deployment}` has no home"))?;
    Ok((client, deployment, home, programs))
}

/// Asks a host for the places of a deployment's programs. Only programs with a data session have one.
pub(crate) async fn locations(
    client: &Client,
    host: &str,
    deployment: &Deployment,
) -> Result<Vec<(String, Dial)>, Failure> {
    let request = Request::Locations { deployment: deployment.clone() };
    let answer = client.ask(host, &request, ANSWER_WITHIN).await?;
    if let Answer::Locations(locations) = answer { Ok(locations) } else { Err(unasked(host, &answer)) }
}

/// If a program was restarted elsewhere, dials it there.
pub(crate) async fn found_again(
    client: &Client,
    taps: &Taps,
    deployment: &Deployment,
    program: &mut Program,
) -> Result<(), Failure> {
    let located = locations(client, &program.host, deployment).await?;
    let found = located.into_iter().find(|(path, _)| *path == program.path);
    if let Some((_, dial)) = found.filter(|(_, dial)| dial.session != program.dial.session) {
        taps.dial(dial.clone()).await?;
        program.dial = dial;
    }
    Ok(())
}

/// Asks the programs for their outputs, and begins to receive the matching ones.
async fn hear(
    taps: &mut Taps,
    arguments: &TapArgs,
    deployment: &Deployment,
    programs: &[Program],
) -> Result<(Vec<FollowedOutput>, Arc<SharedQueue<usize, Tapped>>), Failure> {
    let wanted = &arguments.output;
    let values = Arc::new(SharedQueue::default());
    let (mut followed, mut known, mut failure) = (Vec::new(), BTreeSet::new(), None);
    for Program { path, dial, .. } in programs {
        let outputs = match outputs_of(taps, deployment, path, dial.clone()).await {
            Ok(outputs) => outputs,
            Err(why) => {
                console::note(&format!("warning: `{path}`: {}", words(&why)));
                failure = Some(why);
                continue;
            }
        };
        for output in outputs.all() {
            let name = format!("{path}.{}", output.name);
            if !wanted.is_output(&output.name) {
                known.insert(name);
                continue;
            }
            if followed.len() == OUTPUTS_MAX {
                return Err(anyhow!("more than {OUTPUTS_MAX} outputs have this name; also name the process").into());
            }
            taps.hear(&deployment.name, path, &output.name, followed.len(), Arc::clone(&values)).await?;
            let message = message(output, &outputs);
            followed.push(FollowedOutput { name, type_name: output.type_name.clone(), message });
        }
    }
    if !followed.is_empty() {
        return Ok((followed, values));
    }
    if let Some(failure) = failure {
        return Err(failure);
    }
    let known: Vec<String> = known.into_iter().map(|name| format!("`{name}`")).collect();
    let hint = if known.is_empty() {
        "the matching processes have no outputs".to_owned()
    } else {
        format!("the outputs are {}", known.join(", "))
    };
    Err(anyhow!("no matching process has an output `{}`; {hint}", arguments.output).into())
}

pub(crate) async fn outputs_of(
    taps: &Taps,
    deployment: &Deployment,
    path: &str,
    dial: Dial,
) -> Result<Outputs, Failure> {
    taps.dial(dial).await?;
    let silent =
        || anyhow!("it has not reported its outputs: it has no links yet, or was built with an older version of DCA");
    taps.outputs(&deployment.name, path).await?.ok_or_else(|| Failure::Unreachable(silent()))
}
