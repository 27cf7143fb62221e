//! The time from the last calculation of one process to the run of the next. It includes the programs, a node, and
//! the algebra between them.

use crate::figures::{Round, Subject, Table, cell};
use crate::node::{HOST, Node};
use crate::programs::{REST, times_of};
use crate::raw::{Pair, Transport};
use anyhow::Context;
use node::logic::protocol::{Change, Report};
use std::path::Path;
use std::time::Duration;

/// The number of measurements of each subject, in turn.
const ROUNDS: u32 = 7;
/// The number of turns of the two processes in a loop.
const TURNS: u32 = 80;
/// The number of processes in a row. Each runs only once, since a node slows down loops with faster turns.
const ROW: u32 = 40;
/// The greatest allowed cost, as a multiple of a round trip through a Unix socket.
const TARGET: f64 = 3.0;

/// Measures, and adds lines to the table.
pub(crate) async fn measure(dir: &Path, table: &mut Table) -> anyhow::Result<()> {
    let dir = dir.join("event");
    std::fs::create_dir(&dir)?;
    let mut node = Node::start(&dir).await?;
    let mut socket = Pair::start(Transport::Socket, &dir)?;
    let [mut row, mut busy, mut pair, mut idle] = <[Subject; 4]>::default();
    for _ in 0..ROUNDS {
        busy.push(socket.measure(64, 2000, 200)?);
        row.push(run_row(&mut node, &dir).await?);
        idle.push(socket.measure_paced(64, TURNS, TURNS / 10, REST)?);
        pair.push(take_turns(&mut node, &dir).await?);
    }
    table.heading("end of a process to run of the next, one host", "", "of socket");
    let ratio = |subject: &Subject, base: &Subject| [String::new(), cell(subject.ratio(base), Some(TARGET))];
    table.line("a : b : c ..., each done at once", &row, ratio(&row, &busy));
    table.line("Unix socket, there and back", &busy, [String::new(), "1".into()]);
    table.line("a ;; b, each done after 8 ms", &pair, ratio(&pair, &idle));
    table.line("Unix socket, there and back every 8 ms", &idle, [String::new(), "1".into()]);
    socket.end()?;
    node.end().await
}

/// Deploys a row of processes. Each is done at once.
async fn run_row(node: &mut Node, dir: &Path) -> anyhow::Result<Round> {
    let files: Vec<_> = (0..ROW).map(|number| dir.join(number.to_string())).collect();
    let names: Vec<String> = (0..ROW).map(|number| format!("p{number}")).collect();
    let instances: Vec<String> = names
        .iter()
        .zip(&files)
        .map(|(name, file)| format!("{name} instof Turn(\"{HOST}\", {file:?}, false);"))
        .collect();
    let mut deployment = node.deploy(&main(&instances.concat(), &names.join(" : ")))?;
    while deployment.next().await?.is_some() {}
    let times: std::io::Result<Vec<_>> = files.iter().map(|file| Ok(times_of(&std::fs::read(file)?))).collect();
    Round::of(times?.concat()).context("no samples")
}

/// Deploys two processes that take turns. Returns the times from each end of the first to a run of the second.
async fn take_turns(node: &mut Node, dir: &Path) -> anyhow::Result<Round> {
    let (first, second) = (dir.join("first"), dir.join("second"));
    let instances = format!("a instof Turn(\"{HOST}\", {first:?}, true); b instof Turn(\"{HOST}\", {second:?}, true);");
    let mut deployment = node.deploy(&main(&instances, "a ;; b"))?;
    deployment.go().await?;
    let mut taken = 0;
    while taken < TURNS {
        let report = deployment.next().await?.context("it ended by itself")?;
        if matches!(report, Report::Process { path, change: Change::Activated, .. } if path == "main/b") {
            taken += 1;
        }
    }
    node.stop(deployment).await?;
    let times: Vec<Duration> = times_of(&std::fs::read(&second)?);
    Round::of(times).context("no samples")
}

fn main(instances: &str, actions: &str) -> String {
    format!(
        "process main() {{
            host {{ \"{HOST}\" }}
            instantiated_processes {{ {instances} }}
            internal_event_actions {{ {actions} }}
        }}"
    )
}
