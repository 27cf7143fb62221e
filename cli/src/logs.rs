//! `dca logs`: prints the output of a process, wherever it runs.

mod list;

use crate::client::{Answers, Clients, Statuses, unasked, words};
use crate::complete;
use crate::follow::RUNS;
use crate::io::recorder;
use crate::logic::process_name::ProcessName;
use crate::reader::Reader;
use crate::{ConnectArgs, absent};
use anyhow::anyhow;
use clap_complete::ArgValueCompleter;
use node::console::{self, Failure, block_on};
use node::io::{folder, run_dir};
use node::logic::printable::Printable;
use node::logic::protocol::{Answer, Deployment, NodeStatus, Request, SEVERAL, leaves};
use std::collections::BTreeSet;
use std::path::PathBuf;

/// The most records that are searched for the output of a process that does not run any more.
const RECORDS_MAX: usize = 20;

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
    /// List the processes as JSON
    #[arg(long, conflicts_with_all = ["follow", "raw"])]
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
        Some(NoOutput::Over(failure)) => recorded(arguments).unwrap_or(Err(failure)),
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
    let runs = |folder: &PathBuf| run_dir::running(folder).is_ok_and(|nodes| !nodes.is_empty());
    run_dir::groups(&connect.base()).iter().any(runs)
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
            pass(host, answers, None, arguments.raw).await.map(|()| None)
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
            let all = many.iter().map(of).collect::<Vec<_>>().join(", ");
            let how = "give more of the path, or the deployment before it: `DEPLOYMENT:INSTANCE`";
            Err(anyhow!("`{}` may be any of {all}; {how}", arguments.name()).into())
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
                return pass(&host, answers, Some(first), arguments.raw).await.map(|()| true);
            }
            if matches!(&answer, Answer::Refused(why) if why.starts_with(SEVERAL)) {
                return Err(unasked(&host, &answer));
            }
        }
    }
    Ok(false)
}

async fn pass(host: &str, mut answers: Answers, first: Option<Vec<u8>>, raw: bool) -> Result<(), Failure> {
    let (mut printable, mut is_empty) = (Printable::default(), true);
    let mut print = |bytes: &[u8]| {
        is_empty &= bytes.is_empty();
        if raw { console::pass(bytes) } else { console::pass(printable.push(bytes).as_bytes()) }
    };
    let mut is_read = print(&first.unwrap_or_default())?;
    while is_read && let Some(answer) = answers.next().await {
        let answer = answer?;
        let Answer::Output(bytes) = answer else { return Err(unasked(host, &answer)) };
        is_read = print(&bytes)?;
    }
    if is_empty {
        console::note("note: this process has written nothing");
    }
    console::pass(printable.finish().as_bytes())?;
    Ok(())
}

/// Prints the output of a process from the latest record that has it. Returns nothing if no record has it.
fn recorded(arguments: &Arguments) -> Option<Result<(), Failure>> {
    if let Err(why) = folder::check(&arguments.runs, RUNS) {
        return Some(Err(anyhow!(why).into()));
    }
    let mut records: Vec<PathBuf> =
        std::fs::read_dir(&arguments.runs).ok()?.flatten().map(|entry| entry.path()).collect();
    let begun =
        |folder: &PathBuf| std::fs::metadata(folder.join(recorder::FILE)).and_then(|record| record.modified()).ok();
    records.retain(|folder| begun(folder).is_some());
    records.sort_by_key(|folder| std::cmp::Reverse(begun(folder)));
    for folder in records.iter().take(RECORDS_MAX) {
        let run = match recorder::read(&folder.join(recorder::FILE)) {
            Ok(run) => run,
            Err(error) => {
                console::note(&format!("warning: a record is left out: {error}"));
                continue;
            }
        };
        // A record does not say which run of its deployment it belongs to.
        let (name, deployment) =
            (arguments.name().of_any_run(), Deployment { name: run.header.plan.name.clone(), epoch: 0 });
        let meant: Vec<&str> = run
            .header
            .plan
            .leaves
            .iter()
            .map(|leaf| leaf.path.as_str())
            .filter(|path| name.is_process(&deployment, path))
            .collect();
        let path = match meant[..] {
            [] => continue,
            [path] => path,
            _ => {
                let paths = meant.join("`, `");
                return Some(Err(anyhow!("`{}` may be any of `{paths}`", arguments.name()).into()));
            }
        };
        let why = if arguments.recorded { "" } else { "no node runs it; " };
        console::note(&format!("note: {why}this is the output of `{path}` by the record in `{}`", folder.display()));
        let wrote = run.outputs().remove(path).unwrap_or_default();
        let text: String = wrote.into_iter().map(|lines| format!("{lines}\n")).collect();
        let mut printable = Printable::default();
        let shown = if arguments.raw { text } else { printable.push(text.as_bytes()) + &printable.finish() };
        let whole = || match run.lacks() {
            Some(damage) => Err(anyhow!(
                "the record in `{}` is not whole: {damage}; it may have written more than this",
                folder.display()
            )),
            None => Ok(()),
        };
        return Some(console::pass(shown.as_bytes()).and_then(|_| whole()).map_err(Failure::from));
    }
    None
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
