//! The cost of idle nodes: on their own network, and with programs that sleep.

use anyhow::{Context as _, Result, ensure};
use clap::Parser;
use comms::io::clock::now;
use dca_tests::cluster::{Cluster, Network, Program, SOON, memory, pass, wait_until};
use std::fmt::Write as _;
use std::fs;
use std::io::Write as _;
use std::process::ExitCode;
use std::time::Duration;

/// How long nodes need to find each other and to become quiet.
const SETTLED_AFTER: Duration = Duration::from_secs(15);
/// The number of clock ticks of `/proc/PID/stat` in a second. Source: proc_pid_stat(5); `sysconf(_SC_CLK_TCK)` is 100
/// on every current Linux.
const TICKS: f64 = 100.0;

/// Starts nodes in network namespaces, without a mission, and prints what each sends and how much processor time it
/// takes; then one node with programs that sleep. Needs root.
#[derive(Debug, Parser)]
#[command(name = "idle")]
struct Options {
    /// Nodes on one network
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u16).range(2..=64))]
    nodes: u16,
    /// Programs on the one node
    #[arg(long, default_value_t = 50, value_parser = clap::value_parser!(u16).range(1..=500))]
    programs: u16,
    /// For how long, in seconds
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..=3600))]
    seconds: u64,
}

fn main() -> ExitCode {
    let options = Options::parse();
    match network(&options).and_then(|()| programs(&options)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            say(&format!("FAILED: {error:#}"));
            ExitCode::FAILURE
        }
    }
}

fn say(line: &str) {
    writeln!(std::io::stdout(), "{line}").unwrap_or_default();
}

/// Measures nodes that know each other and do nothing else.
fn network(options: &Options) -> Result<()> {
    let network = Network::new(usize::from(options.nodes)).context("there is no network of namespaces")?;
    let cluster = Cluster::new();
    let hosts: Vec<_> = network.hosts().map(|number| cluster.host(&network, number)).collect();
    let start =
        |(number, host): (usize, &dca_tests::cluster::Host)| host.node(&format!("c{number}"), &["--insecure-lan"]);
    let nodes: Vec<Program> = (1..).zip(&hosts).map(start).collect();
    let found = wait_until(2 * SOON, || hosts[0].statuses(&[]).len() == nodes.len());
    ensure!(found.is_some(), "the nodes do not find each other");
    pass(SETTLED_AFTER);
    let sent =
        || -> Result<Vec<f64>> { network.hosts().map(|number| sent_bytes(&network.namespace(number))).collect() };
    let used = || -> Result<Vec<f64>> { nodes.iter().map(|node| processor_time(node.pid())).collect() };
    let (begun, sent_before, used_before) = (now(), sent()?, used()?);
    pass(Duration::from_secs(options.seconds));
    let (took, sent, used) = (now().since(begun).as_secs_f64(), sent()?, used()?);
    let per_second = |after: &[f64], before: &[f64]| -> Vec<f64> {
        let mut rates: Vec<f64> = after.iter().zip(before).map(|(after, before)| (after - before) / took).collect();
        rates.sort_by(f64::total_cmp);
        rates
    };
    let (sent, used) = (per_second(&sent, &sent_before), per_second(&used, &used_before));
    let megabytes = nodes.iter().map(|node| memory(node.pid())).max().unwrap_or_default() >> 20;
    let count = nodes.len();
    say(&format!(
        "{count} idle nodes, for {took:.0} s: a node sends {:.2} kB/s in the middle, {:.2} at most (asked: 1); it takes {:.2} % of a core \
         in the middle, {:.2} at most (asked: 2); {megabytes} MiB at most",
        sent[count / 2] / 1e3,
        sent[count - 1] / 1e3,
        used[count / 2] * 100.0,
        used[count - 1] * 100.0,
    ));
    Ok(())
}

/// Measures a node with programs that sleep.
fn programs(options: &Options) -> Result<()> {
    let (cluster, mut instances) = (Cluster::new(), String::new());
    let here = cluster.here();
    for number in 0..options.programs {
        write!(instances, "p{number} instof Sleep(c1); ")?;
    }
    let all: Vec<String> = (0..options.programs).map(|number| format!("p{number}")).collect();
    let spec = format!(
        "module Sleep {{ exec \"sleep 100000\"; plain; }}\nprocess main() {{ host {{ c1 }}\ninstantiated_processes {{ {instances} }}\n\
         internal_event_actions {{ {} }} }}\n",
        all.join(" , ")
    );
    let node = here.node("c1", &[]);
    let mission = here.dca(&["deploy", "--no-record", &cluster.file("asleep.dca", &spec)]);
    let are_up = || here.pids().len() == usize::from(options.programs);
    ensure!(wait_until(2 * SOON, are_up).is_some(), "they do not all start");
    pass(SETTLED_AFTER);
    let shims: Vec<u32> =
        cluster.left().iter().filter(|process| process.command[0].ends_with("dca-shim")).map(pid).collect();
    let used = |pids: &[u32]| -> Result<f64> { pids.iter().map(|pid| processor_time(*pid)).sum() };
    let (begun, node_before, shims_before) = (now(), used(&[node.pid()])?, used(&shims)?);
    pass(Duration::from_secs(options.seconds));
    let took = now().since(begun).as_secs_f64();
    let share = |after: f64, before: f64| (after - before) / took * 100.0;
    let shims_size: u64 = shims.iter().map(|pid| own_memory(*pid)).sum::<Result<u64>>()?;
    say(&format!(
        "a node with {} programs that sleep, for {took:.0} s: {:.2} % of a core, {:.1} MiB; their {} shims {:.2} % of a core, {:.0} KiB of \
         their own each",
        options.programs,
        share(used(&[node.pid()])?, node_before),
        memory(node.pid()) as f64 / f64::from(1 << 20),
        shims.len(),
        share(used(&shims)?, shims_before),
        shims_size as f64 / 1024.0 / shims.len().max(1) as f64,
    ));
    let stopped = here.ask(&["stop", "asleep"]);
    ensure!(stopped.code == Some(0), "it does not stop: {stopped}");
    mission.ended(SOON);
    Ok(())
}

fn pid(process: &dca_tests::cluster::Process) -> u32 {
    process.pid.unsigned_abs()
}

/// Returns the number of bytes that a namespace has sent over its cable.
fn sent_bytes(namespace: &str) -> Result<f64> {
    let asked = std::process::Command::new("ip")
        .args(["netns", "exec", namespace, "cat", "/sys/class/net/eth0/statistics/tx_bytes"])
        .output()?;
    let text = String::from_utf8(asked.stdout)?;
    text.trim().parse().with_context(|| format!("`{text}` is not a number of bytes"))
}

/// Returns the processor time that a process has used, in seconds. Source: proc_pid_stat(5), `utime` and `stime`.
fn processor_time(pid: u32) -> Result<f64> {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat"))?;
    let (_, fields) = stat.rsplit_once(')').context("a line of `stat` has a name in brackets")?;
    let fields: Vec<&str> = fields.split_whitespace().collect();
    let ticks = |field: usize| -> Result<f64> { Ok(fields.get(field).context("`stat` is short")?.parse()?) };
    Ok((ticks(11)? + ticks(12)?) / TICKS)
}

/// Returns the memory that a process shares with no other process, in bytes. Source: proc_pid_smaps(5).
fn own_memory(pid: u32) -> Result<u64> {
    let text = fs::read_to_string(format!("/proc/{pid}/smaps_rollup"))?;
    let own = text.lines().filter(|line| line.starts_with("Private_"));
    let sizes = own.filter_map(|line| line.split_whitespace().nth(1)?.parse::<u64>().ok());
    Ok(sizes.sum::<u64>() * 1024)
}
