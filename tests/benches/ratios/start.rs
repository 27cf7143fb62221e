//! Compares the time from the request to a running deployment with the time for starting only the same programs.

use crate::figures::{Round, Subject, Table, cell};
use crate::node::{HOST, Node};
use crate::sdk::Place;
use anyhow::{Context, ensure};
use comms::io::clock::now;
use node::logic::protocol::{Change, Report};
use std::fmt::Write as _;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// The number of programs, and the number of measurements with them.
const SIZES: [(u32, u32); 3] = [(10, 9), (50, 5), (200, 3)];
/// The greatest allowed time for a deployment of 50 programs, as a multiple of bare starts.
const TARGET: f64 = 3.0;

/// Measures, and adds lines to the table.
pub(crate) async fn measure(dir: &Path, table: &mut Table) -> anyhow::Result<()> {
    let dir = dir.join("start");
    std::fs::create_dir(&dir)?;
    let mut node = Node::start(&dir).await?;
    table.heading("PREPARE to GO, one host", "of bare starts", "");
    for (size, rounds) in SIZES {
        let [mut controllers, mut up, mut plain, mut spawned] = <[Subject; 4]>::default();
        for _ in 0..rounds {
            up.push(Round::single(start_bare(&dir, size).await?));
            controllers.push(Round::single(deploy_controllers(&mut node, size).await?));
            spawned.push(Round::single(spawn_bare(size)?));
            plain.push(Round::single(deploy_plain(&mut node, size).await?));
        }
        let target = (size == 50).then_some(TARGET);
        let ratio = cell(controllers.ratio(&up), target);
        table.line(&format!("{size} controllers, wired in a row, to GO"), &controllers, [ratio, String::new()]);
        table.line(&format!("{size} started bare, to their hello"), &up, ["1".into(), String::new()]);
        let ratio = cell(plain.ratio(&spawned), target);
        table.line(&format!("{size} plain programs, to the last one running"), &plain, [ratio, String::new()]);
        table.line(&format!("{size} spawned bare"), &spawned, ["1".into(), String::new()]);
    }
    node.end().await
}

/// Starts controllers at the same time. Returns the time until the last one has sent its hello.
async fn start_bare(dir: &Path, size: u32) -> anyhow::Result<Duration> {
    let dir = dir.join("bare");
    std::fs::create_dir_all(&dir)?;
    let place = Place::new(&dir)?;
    let begun = now();
    let children: anyhow::Result<Vec<Child>> =
        (0..size).map(|number| place.start("Link", &number.to_string())).collect();
    let mut programs = Vec::new();
    for _ in 0..size {
        programs.push(place.hello().await?);
    }
    let took = now().since(begun);
    for program in programs {
        program.leave().await?;
    }
    for mut child in children? {
        child.wait()?;
    }
    std::fs::remove_dir_all(&dir)?;
    Ok(took)
}

fn spawn_bare(size: u32) -> anyhow::Result<Duration> {
    let spawn = |_| Command::new("sleep").arg("1000").stdin(Stdio::null()).stdout(Stdio::null()).spawn();
    let begun = now();
    let children: std::io::Result<Vec<Child>> = (0..size).map(spawn).collect();
    let took = now().since(begun);
    for mut child in children? {
        child.kill()?;
        child.wait()?;
    }
    Ok(took)
}

async fn deploy_controllers(node: &mut Node, size: u32) -> anyhow::Result<Duration> {
    let (mut instances, mut connections, mut running) = (String::new(), String::new(), String::new());
    for number in 0..size {
        write!(instances, "p{number} instof Link(\"{HOST}\"); ")?;
        let labels = if number + 1 < size {
            writeln!(connections, "internal_connections(p{number}, on) {{ p{number}, Out -> p{}, In; }}", number + 1)?;
            "[on]"
        } else {
            ""
        };
        write!(running, "{}p{number}{labels}", if number == 0 { "" } else { " , " })?;
    }
    let spec = format!(
        "process main() {{ host {{ \"{HOST}\" }} instantiated_processes {{ {instances} }}
        {connections} internal_event_actions {{ {running} }} }}"
    );
    let mut deployment = node.deploy(&spec)?;
    let took = deployment.go().await?;
    node.stop(deployment).await?;
    Ok(took)
}

/// Plain programs are executed only at their activation. So this measures the time until the last one is activated.
async fn deploy_plain(node: &mut Node, size: u32) -> anyhow::Result<Duration> {
    let instances: String =
        (0..size).fold(String::new(), |text, number| text + &format!("p{number} instof Sleep(\"{HOST}\"); "));
    let running: Vec<String> = (0..size).map(|number| format!("p{number}")).collect();
    let spec = format!(
        "module Sleep {{ exec \"sleep 1000\"; plain; }}
        process main() {{ host {{ \"{HOST}\" }} instantiated_processes {{ {instances} }}
        internal_event_actions {{ {} }} }}",
        running.join(" , ")
    );
    let mut deployment = node.deploy(&spec)?;
    let mut started = 0;
    while started < size {
        let report = deployment.next().await?.context("it ended by itself")?;
        ensure!(!matches!(report, Report::Process { change: Change::Ended(_), .. }), "it ended: {report:?}");
        started += u32::from(matches!(report, Report::Process { change: Change::Started { .. }, .. }));
    }
    let took = now().since(deployment.asked);
    node.stop(deployment).await?;
    Ok(took)
}
