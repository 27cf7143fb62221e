//! Finds the states of one type in running programs, and reads them. For `dca queue`, `dca router` and `dca lock`.
//!
//! The nodes give the places of the programs. Each program itself is asked for its states.

use crate::client::{ANSWER_WITHIN, Client, Clients, words};
use crate::complete;
use crate::io::taps::Taps;
use crate::logic::queues::{Shown, ShownName};
use crate::object::exports_of;
use crate::reader::Reader;
use crate::tapped::locations;
use crate::{ConnectArgs, absent};
use anyhow::anyhow;
use clap_complete::ArgValueCompleter;
use comms::io::clock;
use comms::logic::control::Dial;
use comms::logic::object::{ExportKind, Exported};
use node::console::{self, Failure, block_on};
use node::logic::protocol::{Deployment, leaves};
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinSet;

/// How often states are read.
const WATCH_EVERY: Duration = Duration::from_millis(100);

/// The arguments of `dca queue`, `dca router` and `dca lock`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// One name, or all names of a process: [DEPLOYMENT:]INSTANCE[.NAME]; the end of the path is enough [default: all]
    #[arg(value_parser = ShownName::parse, add = ArgValueCompleter::new(complete::processes))]
    name: Option<ShownName>,
    /// Continue, and print everything after each change; asks ten times per second
    #[arg(long)]
    watch: bool,
    /// How many seconds each program has to answer
    #[arg(long, value_name = "SECONDS", default_value = "5", value_parser = |text: &str| crate::seconds(text, &(0.001..=86_400.0)), allow_negative_numbers = true)]
    within: f64,
    /// Print an array of JSON on a line, one object for each
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// The states to look for.
pub(crate) struct Wanted {
    /// The type of the states.
    pub(crate) type_name: &'static str,
    /// `queue`, `router`, `lock`
    pub(crate) word: &'static str,
}

/// A state that was found: its process, its name, and its value or the reason why it cannot be read.
type Read<T> = (String, String, Result<T, String>);

/// A program with states of this type.
#[derive(Clone, Debug)]
struct Place {
    deployment: Deployment,
    path: String,
    states: Vec<Exported>,
}

/// The programs that were found, and the hosts that did not answer.
#[derive(Default)]
struct Found {
    places: Vec<Place>,
    known: BTreeSet<String>,
    silent: BTreeSet<String>,
}

/// Shows all states of one type.
pub(crate) fn run<T: Shown + DeserializeOwned + Send + 'static>(
    arguments: &Arguments,
    wanted: &Wanted,
) -> Result<(), Failure> {
    block_on(async {
        let clients = Clients::open(&arguments.connect).await?;
        let taps = Taps::open(clients.iter().find_map(Client::team)).await?;
        let taps = Arc::new(taps.within(Duration::from_secs_f64(arguments.within)));
        let mut reader = Reader::new()?;
        let done = tokio::select! {
            done = show_all::<T>(&clients, &taps, arguments, wanted) => done,
            () = reader.left() => Ok(()),
        };
        if let Some(taps) = Arc::into_inner(taps) {
            taps.close().await;
        }
        clients.close().await;
        done
    })
}

async fn show_all<T: Shown + DeserializeOwned + Send + 'static>(
    clients: &Clients,
    taps: &Arc<Taps>,
    arguments: &Arguments,
    wanted: &Wanted,
) -> Result<(), Failure> {
    let name = arguments.name.as_ref();
    let mut found = find(clients, taps, wanted, name).await?;
    if let (true, true, Some(named)) = (found.places.is_empty(), found.silent.is_empty(), name) {
        let known: Vec<String> = found.known.iter().map(|known| format!("`{known}`")).collect();
        let hint = if known.is_empty() { "it shows none".to_owned() } else { format!("it shows {}", known.join(", ")) };
        return Err(anyhow!("no {} `{named}`: {hint}", wanted.word).into());
    }
    let mut shown = None;
    loop {
        let mut rows = Vec::new();
        for (process, state, read) in read::<T>(&found.places, taps, arguments.within).await? {
            match read {
                Ok(value) => rows.push((process, state, value)),
                Err(why) => {
                    console::note(&format!("warning: `{process}.{state}`: {why}"));
                    found.silent.insert(format!("`{process}`"));
                }
            }
        }
        rows.sort_by(|one, other| (&one.0, &one.1).cmp(&(&other.0, &other.1)));
        if arguments.json || !rows.is_empty() {
            let now = if arguments.json { T::json(&rows) } else { Value::String(T::table(&rows)) };
            if shown.as_ref() != Some(&now) {
                if let Value::String(table) = &now {
                    console::say(table);
                } else {
                    console::answer(&now);
                }
                shown = Some(now);
            }
        } else if found.silent.is_empty() {
            let (word, type_name) = (wanted.word, wanted.type_name);
            console::note(&format!(
                "no running program shows a {word}; to show one, a program exports a state of the type `{type_name}`"
            ));
        }
        if !found.silent.is_empty() {
            let silent = Vec::from_iter(found.silent.iter().map(String::as_str)).join(", ");
            return Err(Failure::Unreachable(anyhow!("the list is not complete: {silent} did not answer")));
        }
        if !arguments.watch {
            return Ok(());
        }
        if found.places.is_empty() {
            found = find(clients, taps, wanted, name).await?;
        }
        clock::sleep_until(clock::now() + WATCH_EVERY).await;
    }
}

/// Asks all matching programs for their exports.
async fn find(
    clients: &Clients,
    taps: &Arc<Taps>,
    wanted: &Wanted,
    name: Option<&ShownName>,
) -> Result<Found, Failure> {
    let all = clients.statuses().await?;
    let away = absent::ask(&all).await;
    let hosts = away.hosts.iter().map(|one| &one.host).chain(&away.silent);
    let silent: BTreeSet<String> = hosts.map(|host| format!("the node `{host}`")).collect();
    let (mut found, mut is_any, mut requests) = (Found { silent, ..Found::default() }, false, JoinSet::new());
    for (client, statuses) in &all {
        let mut places = BTreeSet::new();
        for leaf in leaves(&statuses.nodes) {
            if name.is_none_or(|name| name.process.is_process(leaf.deployment, &leaf.process.path)) {
                is_any = true;
                places.insert((leaf.deployment.clone(), leaf.host.to_owned()));
            }
        }
        for (deployment, host) in places {
            let Ok(located) = locations(client, &host, &deployment).await else {
                found.silent.insert(format!("the node `{host}`"));
                continue;
            };
            for (path, dial) in located {
                if name.is_none_or(|name| name.process.is_process(&deployment, &path)) {
                    requests.spawn(states(Arc::clone(taps), deployment.clone(), path, dial));
                }
            }
        }
    }
    if let (false, Some(name)) = (is_any, name) {
        return Err(absent::no_process_of(&name.process, &all, &away));
    }
    while let Some(joined) = requests.join_next().await {
        let (mut place, read) = joined.map_err(anyhow::Error::from)?;
        if let Err(failure) = read {
            let process = format!("{}:{}", place.deployment.name, place.path);
            console::note(&format!("warning: `{process}`: {}", words(&failure)));
            found.silent.insert(format!("`{process}`"));
        }
        place.states.retain(|state| state.signature.result.name == wanted.type_name);
        found.known.extend(place.states.iter().map(|state| state.name.clone()));
        place.states.retain(|state| name.is_none_or(|name| name.is_state(&state.name)));
        found.places.extend((!place.states.is_empty()).then_some(place));
    }
    Ok(found)
}

/// Returns the states of a program that have this type.
async fn states(taps: Arc<Taps>, deployment: Deployment, path: String, dial: Dial) -> (Place, Result<(), Failure>) {
    let (states, read) = match exports_of(&taps, &deployment, &path, dial).await {
        Ok(exports) => {
            let states = exports.exports.into_iter().filter(|exported| exported.kind == ExportKind::State);
            (states.collect(), Ok(()))
        }
        Err(failure) => (Vec::new(), Err(failure)),
    };
    (Place { deployment, path, states }, read)
}

/// Reads all states at the same time.
async fn read<T: DeserializeOwned + Send + 'static>(
    places: &[Place],
    taps: &Arc<Taps>,
    within: f64,
) -> Result<Vec<Read<T>>, Failure> {
    let (mut requests, within) = (JoinSet::new(), Duration::from_secs_f64(within).max(ANSWER_WITHIN.min(WATCH_EVERY)));
    for place in places {
        for state in &place.states {
            let (taps, place, state) = (Arc::clone(taps), place.clone(), state.clone());
            requests.spawn(async move {
                let called =
                    taps.call(&place.deployment.name, &place.path, taps.prepare(&state, Vec::new(), within)).await;
                let value = match called {
                    Ok(Ok(bytes)) => postcard::from_bytes(&bytes)
                        .map_err(|cause| format!("its program was built with another version of DCA: {cause}")),
                    Ok(Err(error)) => Err(error.to_string()),
                    Err(failure) => Err(words(&failure)),
                };
                (format!("{}:{}", place.deployment.name, place.path), state.name, value)
            });
        }
    }
    let mut all = Vec::new();
    while let Some(joined) = requests.join_next().await {
        all.push(joined.map_err(anyhow::Error::from)?);
    }
    Ok(all)
}
