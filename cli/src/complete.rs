//! Completes words in a shell, including the present names of hosts, deployments, processes and ports.
//!
//! The shell asks this program which words can follow, and waits for the answer. So nodes have a short time to answer,
//! and a node that does not answer is not mentioned.

use crate::client::{Client, Clients, Statuses};
use crate::json::with_json;
use crate::logic::completion::{Process, processes as process_words};
use crate::{Command, ConnectArgs, RunDir, project};
use clap::{ArgMatches, CommandFactory as _};
use clap_complete::CompleteEnv;
use clap_complete::engine::CompletionCandidate;
use comms::io::clock;
use node::console::block_on;
use node::logic::protocol::{Answer, Request, leaves};
use std::collections::BTreeSet;
use std::ffi::{OsStr, OsString};
use std::path::PathBuf;
use std::time::Duration;

/// The environment variable with which a shell asks for words.
pub(crate) const VARIABLE: &str = "DCA_COMPLETE";

/// How long a person waits at most after pressing a key.
const PATIENCE: Duration = Duration::from_secs(2);

/// The answers of the nodes.
type Found<'a> = Vec<(&'a Client, Statuses)>;

/// If a shell has asked, answers it and ends the process.
pub(crate) fn answer() {
    CompleteEnv::with_factory(Command::command).var(VARIABLE).complete();
}

/// Returns the deployments that run or wait for their start.
pub(crate) fn deployments(current: &OsStr) -> Vec<CompletionCandidate> {
    let names = live(async |found| {
        let nodes = found.iter().flat_map(|(_, statuses)| &statuses.nodes);
        let names = nodes.flat_map(|node| {
            let running = node.deployments.iter().map(|part| &part.deployment.name);
            running.chain(node.waiting.iter().map(|one| &one.name)).cloned()
        });
        names.collect()
    });
    candidates(names, current)
}

/// Returns the hosts whose nodes answer.
pub(crate) fn hosts(current: &OsStr) -> Vec<CompletionCandidate> {
    let names = live(async |found| {
        found.iter().flat_map(|(_, statuses)| &statuses.nodes).map(|node| node.host.clone()).collect()
    });
    candidates(names, current)
}

/// Returns the processes that run.
pub(crate) fn processes(current: &OsStr) -> Vec<CompletionCandidate> {
    let all = live(async |found| {
        let all = found.iter().flat_map(|(_, statuses)| leaves(&statuses.nodes));
        all.map(|leaf| Process::new(leaf.deployment, &leaf.process.path)).collect()
    });
    let words = process_words(&all, &current.to_string_lossy());
    candidates(words, current)
}

/// Returns the activities that run.
pub(crate) fn activities(current: &OsStr) -> Vec<CompletionCandidate> {
    let all = live(async |found| {
        let nodes = found.iter().flat_map(|(_, statuses)| &statuses.nodes);
        let all = nodes.flat_map(|node| &node.deployments).flat_map(|part| {
            let activities = part.processes.iter().filter(|process| process.activity.is_some());
            activities.map(|process| Process::new(&part.deployment, &process.path))
        });
        all.collect()
    });
    let words = process_words(&all, &current.to_string_lossy());
    candidates(words, current)
}

/// Returns the outputs of running programs: `hit/force.Out`.
pub(crate) fn outputs(current: &OsStr) -> Vec<CompletionCandidate> {
    let all = live(async |found| {
        let mut all = BTreeSet::new();
        for (client, statuses) in found {
            for node in &statuses.nodes {
                let names = client.ask(&node.host, &Request::Names, PATIENCE).await;
                let Ok(Answer::Names(names)) = names else { continue };
                let outputs = names.ports.into_iter().filter(|port| port.is_output);
                all.extend(outputs.map(|port| Process::with_port(&port.deployment, &port.path, &port.port)));
            }
        }
        all
    });
    let words = process_words(&all, &current.to_string_lossy());
    candidates(words, current)
}

fn candidates(names: BTreeSet<String>, current: &OsStr) -> Vec<CompletionCandidate> {
    let current = current.to_string_lossy();
    names.into_iter().filter(|name| name.starts_with(&*current)).map(CompletionCandidate::new).collect()
}

/// Asks every node that can be reached; returns nothing if the answers take too long.
fn live<T: Default>(look: impl AsyncFnOnce(&Found<'_>) -> T) -> T {
    let connect = connect(std::env::args_os().skip_while(|word| word != "--").skip(1));
    let asked = block_on(async {
        let work = async {
            let clients = Clients::open(&connect).await?;
            let found = clients.look().await?;
            let looked = look(&found).await;
            drop(found);
            clients.close().await;
            Ok(looked)
        };
        tokio::select! {
            done = work => done,
            () = clock::sleep_until(clock::now() + PATIENCE) => Ok(T::default()),
        }
    });
    asked.unwrap_or_default()
}

/// Reads the options for reaching nodes from an unfinished command line.
fn connect(words: impl Iterator<Item = OsString>) -> ConnectArgs {
    let command = || with_json(Command::command());
    let command = project::with_defaults(command()).unwrap_or_else(|_| command());
    let matches = command.ignore_errors(true).try_get_matches_from(words).ok();
    let mut connect = ConnectArgs::default();
    let mut next: Option<&ArgMatches> = matches.as_ref();
    while let Some(matches) = next {
        let path = |id| matches.try_get_one::<PathBuf>(id).ok().flatten().cloned();
        connect.run_dir = matches.try_get_one::<RunDir>("run_dir").ok().flatten().cloned().or(connect.run_dir);
        connect.key_folder = path("key_folder").or(connect.key_folder);
        connect.lan |= matches.try_get_one::<bool>("lan").ok().flatten().copied().unwrap_or_default();
        next = matches.subcommand().map(|(_, matches)| matches);
    }
    connect
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap_complete::engine::complete;

    #[test]
    fn verbs_options_and_values_are_completed() {
        let check = |words: &[&str], expected: &[&str]| {
            let words: Vec<OsString> =
                std::iter::once("dca").chain(words.iter().copied()).map(OsString::from).collect();
            let place = words.len() - 1;
            let found = complete(&mut Command::command(), words, place, None).unwrap();
            let found: Vec<String> = found.iter().map(|one| one.get_value().to_string_lossy().into_owned()).collect();
            assert_eq!(found, expected);
        };
        check(&["gra"], &["graph"]);
        check(&["check", "--form"], &["--format"]);
        check(&["check", "--format", "s"], &["sarif"]);
    }

    #[test]
    fn the_folder_of_a_command_that_is_being_written_counts() {
        let connect = |words: &[&str]| connect(words.iter().map(OsString::from));
        let named = |folder: &str| RunDir { folder: folder.into(), is_named: true };
        let of = connect(&["dca", "stop", "--run-dir", "/tmp/x", "--lan", "do"]);
        assert_eq!((of.run_dir, of.lan), (Some(named("/tmp/x")), true));
        assert_eq!(connect(&["dca", "param", "get", "--run-dir=/tmp/y", "f"]).run_dir, Some(named("/tmp/y")));
        assert_eq!(connect(&["dca", "st"]).run_dir, None);
    }
}
