//! The reaction times of a supervisor: how soon it notices the end of a program and starts a successor, and how regular
//! the ticks of a controller are.

use crate::figures::{Round, Subject, Table, cell};
use crate::node::{Deployment, HOST, Node};
use crate::programs::{TICK, times_of};
use anyhow::{Context, ensure};
use comms::io::clock::now;
use node::logic::protocol::{Change, Report};
use rustix::process::{Pid, Signal, kill_process};
use rustix::thread::{ClockId, Timespec, clock_nanosleep_absolute};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

/// The number of measurements of each subject, in turn.
const ROUNDS: u32 = 5;
/// The number of programs that are killed in a round. Each is killed only once, since a program that dies repeatedly
/// has to wait.
const PROGRAMS: usize = 20;
/// The greatest allowed time for a successor, as a multiple of a bare spawn.
const TARGET: f64 = 2.0;
/// How long a loop of 1 kHz is measured.
const LOOKED: Duration = Duration::from_secs(5);

/// Measures, and adds lines to the table.
pub(crate) async fn measure(dir: &Path, table: &mut Table) -> anyhow::Result<()> {
    let dir = dir.join("faults");
    std::fs::create_dir(&dir)?;
    let mut node = Node::start(&dir).await?;
    let [mut noticed, mut replaced, mut waited, mut spawned] = <[Subject; 4]>::default();
    let [mut beats, mut bare] = <[Subject; 2]>::default();
    for _ in 0..ROUNDS {
        let [ends, starts] = kill_bare()?;
        waited.push(ends);
        spawned.push(starts);
        let [ends, starts] = kill_supervised(&mut node).await?;
        noticed.push(ends);
        replaced.push(starts);
        bare.push(tick_bare()?);
        beats.push(tick_controller(&mut node, &dir).await?);
    }
    table.heading("a program is killed, one host", "of bare", "");
    table.line("to the report of its end", &noticed, [cell(noticed.ratio(&waited), None), String::new()]);
    table.line("a child is killed, to the return of its parent's wait", &waited, ["1".into(), String::new()]);
    table.line(
        "to the report that its successor runs",
        &replaced,
        [cell(replaced.ratio(&spawned), Some(TARGET)), String::new()],
    );
    table.line("a child is killed, waited for, and spawned again", &spawned, ["1".into(), String::new()]);
    table.heading("a loop of 1 kHz: by how much an interval differs from 1 ms", "of bare", "");
    table.line("calculations of a controller", &beats, [cell(beats.ratio(&bare), None), String::new()]);
    table.line("clock_nanosleep", &bare, ["1".into(), String::new()]);
    node.end().await
}

/// Kills children of this process. Returns the times until each was known to be gone, and until another one ran.
fn kill_bare() -> anyhow::Result<[Round; 2]> {
    let spawn = || Command::new("sleep").arg("1000").stdin(Stdio::null()).stdout(Stdio::null()).spawn();
    let (mut ends, mut starts, mut child) = (Vec::new(), Vec::new(), spawn()?);
    for _ in 0..PROGRAMS {
        let at = now();
        child.kill()?;
        child.wait()?;
        ends.push(now().since(at));
        child = spawn()?;
        starts.push(now().since(at));
    }
    child.kill()?;
    child.wait()?;
    rounds(ends, starts)
}

/// Kills programs of a deployment. Returns the times until each report of an end, and until each report of a start.
async fn kill_supervised(node: &mut Node) -> anyhow::Result<[Round; 2]> {
    let (mut instances, mut names) = (String::new(), Vec::new());
    for number in 0..PROGRAMS {
        write!(instances, "p{number} instof Sleep(\"{HOST}\") {{ restart permanent; }} ")?;
        names.push(format!("p{number}"));
    }
    let mut deployment = node.deploy(&format!(
        "module Sleep {{ exec \"sleep 1000\"; plain; }}
        process main() {{ host {{ \"{HOST}\" }} instantiated_processes {{ {instances} }}
        internal_event_actions {{ {} }} }}",
        names.join(" , ")
    ))?;
    let mut pids = BTreeMap::new();
    while pids.len() < PROGRAMS {
        if let (path, Change::Started { pid }) = change(&mut deployment).await? {
            pids.insert(path, pid);
        }
    }
    let (mut ends, mut starts) = (Vec::new(), Vec::new());
    for (victim, pid) in pids {
        let at = now();
        kill_process(Pid::from_raw(i32::try_from(pid)?).context("no process has the id 0")?, Signal::KILL)?;
        loop {
            match change(&mut deployment).await? {
                (path, Change::Restarting { .. }) if path == victim => ends.push(now().since(at)),
                (path, Change::Started { .. }) if path == victim => break starts.push(now().since(at)),
                (path, other) => ensure!(path == victim, "`{path}` changes, too: {other:?}"),
            }
        }
    }
    node.stop(deployment).await?;
    rounds(ends, starts)
}

async fn change(deployment: &mut Deployment) -> anyhow::Result<(String, Change)> {
    loop {
        if let Report::Process { path, change, .. } = deployment.next().await?.context("it ended by itself")? {
            return Ok((path, change));
        }
    }
}

fn rounds(ends: Vec<Duration>, starts: Vec<Duration>) -> anyhow::Result<[Round; 2]> {
    Ok([Round::of(ends).context("nothing was killed")?, Round::of(starts).context("nothing was killed")?])
}

/// Sleeps until each millisecond, like a loop without any surroundings.
fn tick_bare() -> anyhow::Result<Round> {
    let steps = LOOKED.as_nanos() / TICK.as_nanos();
    let (mut next, mut times) = (now(), Vec::new());
    for _ in 0..steps {
        next = next + TICK;
        let until = Timespec::try_from(next.since(comms::logic::time::Time::ZERO))?;
        clock_nanosleep_absolute(ClockId::Boottime, &until)?;
        times.push(now());
    }
    let steps = times.windows(2).map(|pair| (pair[1] - pair[0]).abs_diff(TICK)).collect();
    Round::of(steps).context("no samples")
}

/// Deploys a controller of 1 kHz.
async fn tick_controller(node: &mut Node, dir: &Path) -> anyhow::Result<Round> {
    let file = dir.join("beats");
    let mut deployment = node.deploy(&format!(
        "process main() {{ host {{ \"{HOST}\" }} instantiated_processes {{ beat instof Beat(\"{HOST}\", {file:?}); }}
        internal_event_actions {{ beat # wait({} s) }} }}",
        LOOKED.as_secs()
    ))?;
    while deployment.next().await?.is_some() {}
    Round::of(times_of(&std::fs::read(&file)?)).context("no samples")
}
