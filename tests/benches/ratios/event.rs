//! From the last calculation of one process to the run of the next: two programs, a node, and the algebra between them.

use crate::figures::{Round, Subject, Table, cell};
use crate::node::{HOST, Node};
use crate::programs::{REST, times_of};
use crate::raw::{Pair, Way};
use anyhow::Context;
use node::logic::protocol::{Change, Report};
use std::path::Path;
use std::time::Duration;

/// How often everything is measured, in turn.
const ROUNDS: u32 = 7;
/// How many turns of a round: of processes that take a while, as processes do, and of those that end at once. In the
/// second case both cores are busy with the reports of the turns before.
const TURNS: [(&str, bool, u32); 2] = [("a ;; b, 2 ms each", true, 200), ("a ;; b, at once", false, 1500)];
/// The most that it may cost of a round trip through a Unix socket.
const TARGET: f64 = 3.0;

/// Measures, and adds its lines.
pub(crate) async fn measure(dir: &Path, table: &mut Table) -> anyhow::Result<()> {
    let dir = dir.join("event");
    std::fs::create_dir(&dir)?;
    let mut node = Node::start(&dir).await?;
    let mut socket = Pair::start(Way::Socket, &dir)?;
    table.heading("end of a process to run of the next, one host", "", "of socket");
    for (name, rests, turns) in TURNS {
        let (mut ours, mut raw) = (Subject::default(), Subject::default());
        let rest = if rests { REST } else { Duration::ZERO };
        for _ in 0..ROUNDS {
            raw.push(socket.measure_paced(64, turns, turns / 10, rest)?);
            ours.push(take_turns(&mut node, &dir, rests, turns).await?);
        }
        table.line(name, &ours, [String::new(), cell(ours.ratio(&raw), Some(TARGET))]);
        let name = if rests { "Unix socket, there and back, every 2 ms" } else { "Unix socket, there and back" };
        table.line(name, &raw, [String::new(), "1".into()]);
    }
    socket.end()?;
    node.end().await
}

/// Deploys two processes that take turns; returns how long it took from each end of the first to a run of the second.
async fn take_turns(node: &mut Node, dir: &Path, rests: bool, turns: u32) -> anyhow::Result<Round> {
    let (first, second) = (dir.join("first"), dir.join("second"));
    let spec = format!(
        "process main() {{
            host {{ \"{HOST}\" }}
            instantiated_processes {{
                a instof Turn(\"{HOST}\", {first:?}, {rests});
                b instof Turn(\"{HOST}\", {second:?}, {rests});
            }}
            internal_event_actions {{ a ;; b }}
        }}"
    );
    let mut deployment = node.deploy(&spec)?;
    deployment.go().await?;
    let mut taken = 0;
    while taken < turns {
        let report = deployment.next().await?.context("it ended by itself")?;
        if matches!(report, Report::Process { path, change: Change::Activated, .. } if path == "main/b") {
            taken += 1;
        }
    }
    node.stop(deployment).await?;
    Round::of(times_of(&std::fs::read(&second)?)).context("no samples")
}
