//! `dca list`: the ports, procedures, states and inner wires of running programs, with their types.
//!
//! The nodes give the places of the programs. Each program itself is asked for its names.

use crate::ConnectArgs;
use crate::absent;
use crate::client::{Client, Clients, words};
use crate::complete;
use crate::io::taps::Taps;
use crate::logic::object::{Listed, ListedKind};
use crate::logic::queues::ShownName;
use crate::object::exports_of;
use crate::tapped::{locations, outputs_of};
use anyhow::anyhow;
use clap_complete::ArgValueCompleter;
use comms::logic::control::Dial;
use node::console::{self, Failure, block_on};
use node::logic::printable::printable;
use node::logic::protocol::{Answer, Deployment, PortName, Request, leaves};
use node::logic::table::table;
use std::collections::BTreeSet;
use std::sync::Arc;
use tokio::task::JoinSet;

/// The arguments of `dca list`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// A process, or one name of it: [DEPLOYMENT:]INSTANCE[.NAME], the last part of its path is enough [default: all]
    #[arg(value_parser = ShownName::parse, add = ArgValueCompleter::new(complete::processes))]
    instance: Option<ShownName>,
    /// Print an array of JSON, one object for each name
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let (mut rows, silent) = block_on(async {
        let clients = Clients::open(&arguments.connect).await?;
        let taps = Arc::new(Taps::open(clients.iter().find_map(Client::team)).await?);
        let listed = listed(&clients, &taps, arguments.instance.as_ref()).await;
        if let Some(taps) = Arc::into_inner(taps) {
            taps.close().await;
        }
        clients.close().await;
        listed
    })?;
    rows.sort();
    rows.dedup();
    if arguments.json {
        console::answer(&serde_json::Value::Array(rows.iter().map(Listed::json).collect()));
        return whole(&silent);
    }
    let mut lines = vec![["PROCESS", "NAME", "KIND", "TYPE"].map(str::to_owned).to_vec()];
    lines.extend(rows.iter().map(|row| row.cells().map(|cell| printable(&cell).to_string()).to_vec()));
    if rows.is_empty() && silent.is_empty() {
        console::note("no program that runs has ports, procedures or states");
    } else if !rows.is_empty() {
        console::say(&table(&lines));
    }
    whole(&silent)
}

/// Returns an error if hosts have not answered: then the list is not complete.
fn whole(silent: &BTreeSet<String>) -> Result<(), Failure> {
    if silent.is_empty() {
        return Ok(());
    }
    let silent = Vec::from_iter(silent.iter().map(String::as_str)).join(", ");
    Err(Failure::Unreachable(anyhow!("the list is not complete: {silent} did not answer")))
}

/// Returns the entries of all matching programs, and the hosts that have not answered.
async fn listed(
    clients: &Clients,
    taps: &Arc<Taps>,
    instance: Option<&ShownName>,
) -> Result<(Vec<Listed>, BTreeSet<String>), Failure> {
    let all = clients.statuses().await?;
    let away = absent::ask(&all).await;
    let hosts = away.hosts.iter().map(|one| &one.host).chain(&away.silent);
    let mut silent: BTreeSet<String> = hosts.map(|host| format!("the node `{host}`")).collect();
    let is_meant =
        |deployment: &Deployment, path: &str| instance.is_none_or(|name| name.process.is_process(deployment, path));
    let (mut places, mut is_any, mut rows) = (BTreeSet::new(), false, Vec::new());
    let (mut requests, mut reached, mut names) = (JoinSet::new(), Vec::new(), Vec::new());
    for (client, statuses) in &all {
        for leaf in leaves(&statuses.nodes) {
            if is_meant(leaf.deployment, &leaf.process.path) {
                is_any = true;
                reached.push(*client);
                names.push(format!("{}:{}", leaf.deployment.name, leaf.process.path));
                places.insert((leaf.deployment.clone(), leaf.host.to_owned()));
            }
        }
        for (deployment, host) in std::mem::take(&mut places) {
            for (path, dial) in locations(client, &host, &deployment).await? {
                if is_meant(&deployment, &path) {
                    requests.spawn(program(Arc::clone(taps), deployment.clone(), path, dial));
                }
            }
            let names = client.ask(&host, &Request::Names, crate::client::ANSWER_WITHIN).await;
            let Ok(Answer::Names(names)) = names else {
                silent.insert(format!("the node `{host}`"));
                continue;
            };
            let meant = names.ports.into_iter().filter(|port| !port.is_output && port.deployment == deployment);
            let meant = meant.filter(|port| is_meant(&deployment, &port.path));
            rows.extend(meant.map(input));
        }
    }
    if let (false, Some(instance)) = (is_any, instance) {
        return Err(absent::no_process_of(&instance.process, &all, &away));
    }
    if let Some(how) = Client::choice(reached.into_iter(), &names) {
        console::note(&format!("note: some of these programs run more than once: {how}"));
    }
    let mut exported = BTreeSet::new();
    while let Some(joined) = requests.join_next().await {
        let (process, found, failures) = joined.map_err(anyhow::Error::from)?;
        failures.iter().for_each(|failure| console::note(failure));
        silent.extend((!failures.is_empty()).then(|| format!("`{process}`")));
        exported.extend(found.iter().map(|row| (row.process.clone(), row.name.clone())));
        rows.extend(found);
    }
    // A procedure may also be at the end of a connection, so it counts as an input.
    let is_input = |row: &Listed| row.kind == ListedKind::Input;
    rows.retain(|row| instance.is_none_or(|name| name.is_state(&row.name)));
    rows.retain(|row| !is_input(row) || !exported.contains(&(row.process.clone(), row.name.clone())));
    Ok((rows, silent))
}

fn input(port: PortName) -> Listed {
    let process = format!("{}:{}", port.deployment.name, port.path);
    Listed {
        process,
        name: port.port,
        to: None,
        kind: ListedKind::Input,
        types: port.kind.unwrap_or_default(),
        doc: String::new(),
        access: None,
    }
}

/// Asks one program. Returns its name, its entries, and notes for a person.
async fn program(
    taps: Arc<Taps>,
    deployment: Deployment,
    path: String,
    dial: Dial,
) -> (String, Vec<Listed>, Vec<String>) {
    let (mut rows, mut failures) = (Vec::new(), Vec::new());
    let process = format!("{}:{path}", deployment.name);
    match exports_of(&taps, &deployment, &path, dial.clone()).await {
        Ok(exports) => rows.extend(exports.exports.into_iter().map(|exported| Listed::exported(&process, exported))),
        Err(failure) => {
            failures.push(format!("warning: `{process}`: {}", words(&failure)));
            return (process, rows, failures);
        }
    }
    match outputs_of(&taps, &deployment, &path, dial).await {
        Ok(outputs) => {
            rows.extend(outputs.outputs.into_iter().map(|output| Listed::output(&process, output)));
            rows.extend(outputs.inner.into_iter().flat_map(|inner| Listed::inner(&process, inner)));
        }
        Err(failure) => failures.push(format!("warning: `{process}`: {}", words(&failure))),
    }
    (process, rows, failures)
}
