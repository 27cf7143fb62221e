//! `dca logs`: prints the output of a process, wherever it runs.

mod form;
mod list;
mod recorded;

use crate::client::{Answers, Client, Clients, Statuses, unasked, words};
use crate::complete;
use crate::logic::process_name::ProcessName;
use crate::reader::Reader;
use crate::{ConnectArgs, absent};
use anyhow::anyhow;
use clap_complete::ArgValueCompleter;
use form::{Form, Writer};
use node::console::{self, Failure, block_on};
use node::io::run_dir;
use node::logic::protocol::{Answer, Deployment, NodeStatus, Request, SEVERAL, leaves};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The arguments of `dca logs`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The process: [DEPLOYMENT:]INSTANCE, the last part of its path is enough; without it or with `DEPLOYMENT:`, the processes are
    /// listed
    #[arg(value_parser = ProcessName::parse, add = ArgValueCompleter::new(complete::processes))]
    process: Option<ProcessName>,
    /// Also print new output
    #[arg(short, long)]
    follow: bool,
    /// Print each line of the output as an object of JSON; without a process, print the list as JSON
    #[arg(long, conflicts_with = "raw")]
    json: bool,
    /// Print the bytes of the output unchanged: control characters may do anything to a terminal
    #[arg(long)]
    raw: bool,
    /// The folder with records, for a process that no longer runs
    #[arg(long, value_name = "DIR", default_value = "runs")]
    runs: PathBuf,
    /// Read the latest record that has the process, and ask no node
    #[arg(long, requires = "process", conflicts_with_all = ["follow"])]
    recorded: bool,
    #[command(flatten)]
    connect: ConnectArgs,
}

impl Arguments {
    /// Returns the name of the process. It is empty for all processes, or for all processes of a deployment.
    fn name(&self) -> ProcessName {
        self.process.clone().unwrap_or_else(|| ProcessName::new(""))
    }

    /// Returns the form of the output. `writer` wrote it.
    fn form(&self, writer: Writer) -> Form {
        match (self.json, self.raw) {
            (true, _) => Form::json(writer),
            (false, true) => Form::Raw,
            (false, false) => Form::text(),
        }
    }

    fn is_meant(&self, deployment: &Deployment, path: &str) -> bool {
        self.name().is_process(deployment, path)
    }
}

/// The reason why no node has the output of a process.
enum NoOutput {
    /// Every node has answered, or no node runs. So the process is over.
    Over(Failure),
    /// The process may run on a host that does not answer.
    Unknown(Failure),
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let without = if arguments.recorded {
        let (runs, process) = (arguments.runs.display(), arguments.name());
        Some(NoOutput::Over(anyhow!("no record in `{runs}` has a process `{process}`").into()))
    } else {
        block_on(from_nodes(arguments))?
    };
    match without {
        None => Ok(()),
        // The run is over, and no node has the output any more. Its record still has it.
        Some(NoOutput::Over(failure)) => recorded::print(arguments).unwrap_or(Err(failure)),
        // The record of an earlier run would be a wrong answer.
        Some(NoOutput::Unknown(failure)) => Err(Failure::Unreachable(anyhow!(
            "{}; `--recorded` reads the latest record in `{}` instead",
            words(&failure),
            arguments.runs.display()
        ))),
    }
}

/// Prints the output that nodes have. If no node has it, returns the reason.
async fn from_nodes(arguments: &Arguments) -> Result<Option<NoOutput>, Failure> {
    let clients = match Clients::open(&arguments.connect).await {
        Ok(clients) => clients,
        Err(failure) if runs_any(&arguments.connect) => return Ok(Some(NoOutput::Unknown(failure))),
        Err(failure) => return Ok(Some(NoOutput::Over(failure))),
    };
    let name = arguments.name();
    if name.process().is_none() {
        let listed = list::all(&clients, &name, arguments.json).await;
        clients.close().await;
        return listed.map(|()| None);
    }
    let mut reader = Reader::new()?;
    let result = tokio::select! {
        result = print(&clients, arguments) => result,
        () = reader.left() => Ok(None),
    };
    clients.close().await;
    result
}

/// Returns whether a node runs on this machine.
fn runs_any(connect: &ConnectArgs) -> bool {
    let runs = |folder: &Path| run_dir::running(folder).is_ok_and(|nodes| !nodes.is_empty());
    std::iter::once(connect.base()).chain(connect.commands()).any(|folder| runs(&folder))
}

/// Prints the output of the process. If no node has it, returns the reason.
async fn print(clients: &Clients, arguments: &Arguments) -> Result<Option<NoOutput>, Failure> {
    let all = clients.statuses().await?;
    let meant = |(client, statuses): &(_, Statuses)| {
        find(&statuses.nodes, arguments).into_iter().map(|one| (*client, one)).collect::<Vec<_>>()
    };
    let found: Vec<_> = all.iter().flat_map(meant).collect();
    match &found[..] {
        [(client, (host, deployment, process))] => {
            let request = request(arguments, Some(deployment.clone()), process.clone());
            let answers = client.ask_on(host, &request)?;
            let writer = Writer { host: Some(host.clone()), process: process.clone() };
            pass(host, answers, None, arguments.form(writer)).await.map(|()| None)
        }
        [] => {
            let away = absent::ask(&all).await;
            let runs_there = away.processes.iter().any(|one| arguments.is_meant(&one.deployment, &one.path));
            if !runs_there && ended(clients, arguments).await? {
                return Ok(None);
            }
            let failure = absent::no_process_of(&arguments.name(), &all, &away);
            Ok(Some(match (&failure, clients.hanging()) {
                (Failure::Unreachable(_), _) => NoOutput::Unknown(failure),
                (_, Some(why)) => NoOutput::Unknown(Failure::Unreachable(anyhow!("{why}"))),
                _ => NoOutput::Over(failure),
            }))
        }
        many => {
            let of = |(_, (_, deployment, path)): &(_, (_, String, String))| format!("`{deployment}:{path}`");
            let names: Vec<String> = many.iter().map(of).collect();
            let path = "give more of the path, or the deployment before it: `DEPLOYMENT:INSTANCE`";
            let how = Client::choice(many.iter().map(|(client, _)| *client), &names).unwrap_or_else(|| path.to_owned());
            Err(anyhow!("`{}` may be any of {}; {how}", arguments.name(), names.join(", ")).into())
        }
    }
}

fn request(arguments: &Arguments, deployment: Option<String>, process: String) -> Request {
    Request::Logs { deployment, process, follow: arguments.follow }
}

/// Prints the output of a process that has ended together with its deployment. The first node that still has the output
/// sends it. Returns whether there is such a node.
async fn ended(clients: &Clients, arguments: &Arguments) -> Result<bool, Failure> {
    for client in clients.iter() {
        for host in client.hosts(&[]).await? {
            let name = arguments.name();
            let deployment = name.deployment().map(|named| named.text().to_owned());
            let request = request(arguments, deployment, name.process().unwrap_or_default().to_owned());
            let mut answers = client.ask_on(&host, &request)?;
            let Some(Ok(answer)) = answers.next().await else { continue };
            if let Answer::Output(first) = answer {
                let writer =
                    Writer { host: Some(host.clone()), process: name.process().unwrap_or_default().to_owned() };
                return pass(&host, answers, Some(first), arguments.form(writer)).await.map(|()| true);
            }
            if matches!(&answer, Answer::Refused(why) if why.starts_with(SEVERAL)) {
                return Err(unasked(&host, &answer));
            }
        }
    }
    Ok(false)
}

async fn pass(host: &str, mut answers: Answers, first: Option<Vec<u8>>, mut form: Form) -> Result<(), Failure> {
    let first = first.unwrap_or_default();
    let (mut is_empty, mut is_read) = (first.is_empty(), form.print(&first)?);
    while is_read && let Some(answer) = answers.next().await {
        let answer = answer?;
        let Answer::Output(bytes) = answer else { return Err(unasked(host, &answer)) };
        is_empty &= bytes.is_empty();
        is_read = form.print(&bytes)?;
    }
    if is_empty {
        console::note("note: this process has written nothing");
    }
    form.finish()?;
    Ok(())
}

/// Returns host, deployment and path of each matching leaf, even if its program does not run.
fn find(statuses: &[NodeStatus], arguments: &Arguments) -> BTreeSet<(String, String, String)> {
    let leaves = leaves(statuses).into_iter();
    let found = leaves.filter(|leaf| arguments.is_meant(leaf.deployment, &leaf.process.path));
    found.map(|leaf| (leaf.host.to_owned(), leaf.deployment.name.clone(), leaf.process.path.clone())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::tree::tests::door_node;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        arguments: Arguments,
    }

    #[test]
    fn a_leaf_is_found_dead_or_alive_and_a_group_is_not() {
        let statuses = [
            door_node(
                "c1",
                &[("main", "running", None), ("main/hit", "running", None), ("main/arm", "running", Some(7))],
            ),
            door_node("c2", &[("main/hit/force", "dead: SIGSEGV", None)]),
        ];
        let check = |line: &[&str], expected: &[(&str, &str)]| {
            let line = Line::parse_from(["logs"].iter().chain(line));
            let found = find(&statuses, &line.arguments);
            let found: Vec<_> = found.iter().map(|(host, _, path)| (host.as_str(), path.as_str())).collect();
            assert_eq!(found, expected);
        };
        check(&["force"], &[("c2", "main/hit/force")]);
        check(&["door:main/arm"], &[("c1", "main/arm")]);
        check(&["door@1:arm"], &[("c1", "main/arm")]);
        check(&["main/arm.Out"], &[("c1", "main/arm")]);
        check(&["window:main/arm"], &[]);
        check(&["hit"], &[]);
        check(&["main"], &[]);
    }
}
