//! `dca call` and `dca get`: what running programs export, from any host.
//!
//! The nodes say where a program is; the call goes straight to it.

use crate::client::{Client, Clients};
use crate::io::taps::Taps;
use crate::logic::object::{ObjectName, argument, result};
use crate::reader::Reader;
use crate::tapped::locations;
use crate::{ConnectArgs, absent};
use anyhow::anyhow;
use comms::io::clock;
use comms::logic::control::Dial;
use comms::logic::object::{ExportKind, Exported, Exports, ObjectError};
use node::console::{self, Failure, block_on};
use node::logic::printable::printable;
use node::logic::protocol::{Deployment, ProcessStatus, leaves};
use serde_json::{Value, json};
use std::time::Duration;

/// The options that calls and reads have in common.
#[derive(Debug, clap::Args)]
struct ObjectArgs {
    /// What is meant: [DEPLOYMENT:]INSTANCE.NAME, such as `hand.Grip`; of the path of the instance its end is enough
    name: String,
    /// How many seconds the program has to answer
    #[arg(long, value_name = "SECONDS", default_value = "5", value_parser = |text: &str| crate::seconds(text, &(0.001..=86_400.0)), allow_negative_numbers = true)]
    within: f64,
    /// Print the result as JSON, in one object with the name and the time that it took
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// The arguments of `dca call`.
#[derive(Debug, clap::Args)]
pub struct CallArguments {
    #[command(flatten)]
    object: ObjectArgs,
    /// The argument, as a spec has it: `'{ force = 20 N }'`, or each field by itself: `force='20 N'`
    #[arg(allow_negative_numbers = true)]
    argument: Vec<String>,
}

/// The arguments of `dca get`.
#[derive(Debug, clap::Args)]
pub struct GetArguments {
    #[command(flatten)]
    object: ObjectArgs,
    /// Go on, and print the state whenever it has changed; looks ten times in a second
    #[arg(long)]
    watch: bool,
}

/// How often a state is looked at.
const WATCH_EVERY: Duration = Duration::from_millis(100);

/// How often the node of a program that does not answer is asked whether it still runs.
const LOOK_EVERY: Duration = Duration::from_millis(500);

/// A program that is meant, with what it exports.
struct Found {
    deployment: String,
    path: String,
    exports: Exports,
}

/// Runs `dca call`.
pub(crate) fn call(arguments: &CallArguments) -> Result<(), Failure> {
    let name = ObjectName::parse(&arguments.object.name).map_err(|why| anyhow!(why))?;
    block_on(with_taps(&arguments.object, async |clients, taps| {
        let found = find(clients, taps, &name).await?;
        let exported = exported(&found, &name)?;
        if exported.kind == ExportKind::State {
            return Err(
                anyhow!("`{}` is a state, which is read: `dca get {}`", name.name, arguments.object.name).into()
            );
        }
        let bytes = argument(&found.exports, &exported.signature, &arguments.argument);
        let bytes = bytes.map_err(|why| anyhow!("`{}` cannot be called so: {why}", name.name))?;
        let (value, took) = ask(taps, &arguments.object, (&found, exported), bytes).await?;
        show(&arguments.object, &found, exported, (&value, took));
        Ok(())
    }))
}

/// Runs `dca get`.
pub(crate) fn get(arguments: &GetArguments) -> Result<(), Failure> {
    let name = ObjectName::parse(&arguments.object.name).map_err(|why| anyhow!(why))?;
    block_on(with_taps(&arguments.object, async |clients, taps| {
        let found = find(clients, taps, &name).await?;
        let exported = exported(&found, &name)?;
        if exported.kind == ExportKind::Procedure {
            return Err(anyhow!("`{}` is a procedure: `dca call {}`", name.name, arguments.object.name).into());
        }
        let mut shown = None;
        loop {
            let (value, took) = ask(taps, &arguments.object, (&found, exported), Vec::new()).await?;
            if shown.as_ref() != Some(&value) {
                show(&arguments.object, &found, exported, (&value, took));
                shown = Some(value);
            }
            if !arguments.watch {
                return Ok(());
            }
            clock::sleep_until(clock::now() + WATCH_EVERY).await;
        }
    }))
}

async fn with_taps(
    arguments: &ObjectArgs,
    work: impl AsyncFnOnce(&Clients, &Taps) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let clients = Clients::open(&arguments.connect).await?;
    let taps = Taps::open(clients.iter().find_map(Client::team)).await?;
    let taps = taps.within(Duration::from_secs_f64(arguments.within));
    let mut reader = Reader::new()?;
    let done = tokio::select! {
        done = work(&clients, &taps) => done,
        () = reader.left() => Ok(()),
    };
    taps.close().await;
    clients.close().await;
    done
}

/// Finds the one program that is meant, and asks it what it exports.
async fn find(clients: &Clients, taps: &Taps, name: &ObjectName) -> Result<Found, Failure> {
    let all = clients.statuses().await?;
    let mut meant: Vec<(&Client, Deployment, String, ProcessStatus)> = Vec::new();
    for (client, statuses) in &all {
        let all = leaves(&statuses.nodes).into_iter();
        let leaves = all.filter(|leaf| name.is_process(&leaf.deployment.name, &leaf.process.path));
        meant.extend(leaves.map(|leaf| (*client, leaf.deployment.clone(), leaf.host.to_owned(), leaf.process.clone())));
    }
    // The whole of a path goes before the end of another.
    if meant.iter().any(|(.., process)| process.path == name.process) {
        meant.retain(|(.., process)| process.path == name.process);
    }
    let what = format!("process `{}`", name.process);
    let (client, deployment, host, process) = match meant.as_slice() {
        [] => return Err(absent::missing(&what, &all).await),
        [one] => one,
        several => {
            let names =
                several.iter().map(|(_, deployment, _, process)| format!("`{}:{}`", deployment.name, process.path));
            let names = names.collect::<Vec<_>>().join(", ");
            return Err(
                anyhow!("several processes are called `{}`: {names}; name one of them whole", name.process).into()
            );
        }
    };
    let path = &process.path;
    let found = Found { deployment: deployment.name.clone(), path: path.clone(), exports: Exports::default() };
    let Some(mut dial) = located(client, host, deployment, (process, taps.patience())).await? else { return Ok(found) };
    let exports = loop {
        let moved = tokio::select! {
            exports = exports_of(taps, deployment, path, dial.clone()) => break exports?,
            moved = moved(client, host, deployment, (path, &dial.session)) => moved,
        };
        taps.forget(&dial.session);
        let ended = || anyhow!("`{path}` ended before it could be asked; `dca events {}` says why", deployment.name);
        dial = moved.ok_or_else(ended)?;
    };
    Ok(Found { exports, ..found })
}

/// Returns where a program is; nowhere, if it runs and has no data session. One that begins is waited for.
async fn located(
    client: &Client,
    host: &str,
    deployment: &Deployment,
    (process, within): (&ProcessStatus, Duration),
) -> Result<Option<Dial>, Failure> {
    let (path, state, until) = (&process.path, process.state.as_str(), clock::now() + within);
    let is_coming = matches!(state, "starting" | "restarting" | "connecting" | "being replaced");
    loop {
        let located = locations(client, host, deployment).await?;
        let dial = located.into_iter().find(|(located, _)| located == path).map(|(_, dial)| dial);
        if dial.is_none() && ["ended", "dead", "refused"].iter().any(|word| state.starts_with(word)) {
            return Err(anyhow!("`{path}` does not run: {state}").into());
        }
        if dial.is_some() || !is_coming {
            return Ok(dial);
        }
        if clock::now() >= until {
            return Err(Failure::Unreachable(anyhow!("`{path}` cannot be asked yet: it was {state}")));
        }
        clock::sleep_until(clock::now() + WATCH_EVERY).await;
    }
}

/// Waits until a program is elsewhere than in this session: where it was started again, or nowhere since it has ended. A node that does
/// not answer says neither.
///
/// # Cancellation
/// Safe.
async fn moved(client: &Client, host: &str, deployment: &Deployment, (path, session): (&str, &str)) -> Option<Dial> {
    loop {
        clock::sleep_until(clock::now() + LOOK_EVERY).await;
        let located = match locations(client, host, deployment).await {
            Ok(located) => located,
            Err(Failure::Unreachable(_)) => continue,
            // It knows nothing of the deployment any more.
            Err(_) => return None,
        };
        let dial = located.into_iter().find(|(located, _)| located == path).map(|(_, dial)| dial);
        if dial.as_ref().is_none_or(|dial| dial.session != session) {
            return dial;
        }
    }
}

pub(crate) async fn exports_of(
    taps: &Taps,
    deployment: &Deployment,
    path: &str,
    dial: Dial,
) -> Result<Exports, Failure> {
    taps.dial(dial).await?;
    let silent = || anyhow!("`{path}` does not say what it exports: it has no links yet, or is of an older DCA");
    taps.exports(&deployment.name, path).await?.ok_or_else(|| Failure::Unreachable(silent()))
}

fn exported<'a>(found: &'a Found, name: &ObjectName) -> Result<&'a Exported, Failure> {
    let exported = found.exports.exports.iter().find(|exported| exported.name == name.name);
    let known = || found.exports.exports.iter().map(|exported| exported.name.clone()).collect();
    exported.ok_or_else(|| {
        let error = ObjectError::NoSuchProcedure { name: name.name.clone(), known: known() };
        failure(found, &name.name, &error)
    })
}

/// Makes the call; returns its result, and how long it took.
async fn ask(
    taps: &Taps,
    arguments: &ObjectArgs,
    (found, exported): (&Found, &Exported),
    bytes: Vec<u8>,
) -> Result<(Value, Duration), Failure> {
    let (begun, within) = (clock::now(), Duration::from_secs_f64(arguments.within));
    let called = taps.call((&found.deployment, &found.path), exported, bytes, within).await?;
    let bytes = called.map_err(|error| failure(found, &exported.name, &error))?;
    Ok((result(&found.exports, &exported.signature, &bytes), clock::now() - begun))
}

fn show(arguments: &ObjectArgs, found: &Found, exported: &Exported, (value, took): (&Value, Duration)) {
    if arguments.json {
        let name = format!("{}:{}.{}", found.deployment, found.path, exported.name);
        let kind = exported.signature.result.name.as_str();
        console::say(&json!({ "name": name, "type": kind, "value": value, "took": took.as_secs_f64() }).to_string());
    } else if !value.is_null() {
        console::say(&printable(&value.to_string()));
    }
}

/// Says in one sentence why there is no result. Where nobody can know whether it was carried out, nobody was reached.
fn failure(found: &Found, name: &str, error: &ObjectError) -> Failure {
    let hint = if error.hint().is_empty() { String::new() } else { format!("; {}", error.hint()) };
    let why = anyhow!("`{name}` of `{}`: {error}{hint}", found.path);
    if error.may_have_happened() { Failure::Unreachable(why) } else { Failure::Refused(why) }
}
