//! The soak: hosts on a network run one mission for hours. During this time, programs are killed, cables are pulled and
//! nodes are killed.

use anyhow::{Result, bail, ensure};
use clap::Parser;
use comms::io::clock::now;
use comms::logic::random::Random;
use comms::logic::time::Time;
use dca_tests::cluster::{
    Cluster, Host, Network, Process, Program, SOON, Stream, descriptors, memory, pass, wait_until,
};
use rustix::process::Signal;
use std::collections::BTreeMap;
use std::io::Write;
use std::process::ExitCode;
use std::time::Duration;

/// Short cuts, which must have no effect. Every fifth cut is long, so that a host is lost.
const CUT_SHORT: Duration = Duration::from_secs(2);
const CUT_LONG: Duration = Duration::from_secs(9);
/// The longest time for which the killed node is away.
const AWAY_MAX_MS: u64 = 1500;
/// The longest time until everything runs again after a disturbance. A lost host has to be found again, and its group
/// pauses for 5 s.
const RECOVERED_WITHIN: Duration = Duration::from_secs(45);
/// How often sizes are printed.
const SIZES_EVERY: Duration = Duration::from_secs(120);
/// The greatest growth of the largest size, from the second quarter to the last.
const GROWTH_MAX: f64 = 1.15;

/// Runs a mission on namespaces for a long time. Each second a program is killed, each minute a cable is pulled (for 2
/// s, each fifth time for 9 s, so that its host is lost), every five minutes a node is killed and started again.
///
/// It ends at once, with exit code 1, when a program runs twice, when not all run again after a disturbance, or when
/// something is left after the stop; and at the end when memory or descriptors of nodes have grown. Needs root.
#[derive(Debug, Parser)]
#[command(name = "soak")]
struct Options {
    /// How long
    #[arg(long, default_value_t = 120, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    minutes: u64,
    /// The seed that draws the victims
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Hosts; the groups of their programs are a tree, three below each
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u16).range(2..=64))]
    hosts: u16,
    /// Programs on each host
    #[arg(long, default_value_t = 16, value_parser = clap::value_parser!(u16).range(3..=200))]
    programs: u16,
    /// Seconds from one killed program to the next
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..))]
    crash_every: u64,
    /// Seconds from one pulled cable to the next
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u64).range(1..))]
    cut_every: u64,
    /// Seconds from one killed node to the next
    #[arg(long, default_value_t = 300, value_parser = clap::value_parser!(u64).range(1..))]
    kill_every: u64,
}

fn main() -> ExitCode {
    let options = Options::parse();
    let Some(network) = Network::new(usize::from(options.hosts)) else { return ExitCode::FAILURE };
    let mut soak = match Soak::begin(network, options) {
        Ok(soak) => soak,
        Err(error) => return failed(&error),
    };
    let outcome = soak.run().and_then(|()| soak.end());
    outcome.map_or_else(|error| failed(&error), |()| ExitCode::SUCCESS)
}

fn failed(error: &anyhow::Error) -> ExitCode {
    say(&format!("FAILED: {error:#}"));
    ExitCode::FAILURE
}

fn say(line: &str) {
    // The soak continues without its reader.
    writeln!(std::io::stdout(), "{line}").unwrap_or_default();
}

/// How often something was done.
#[derive(Debug, Default)]
struct Counts {
    crashes: u32,
    cuts: u32,
    losses: u32,
    kills: u32,
}

/// The resources that a process uses at one moment.
#[derive(Clone, Copy, Debug, Default)]
struct Sizes {
    memory: u64,
    descriptors: usize,
}

#[derive(Debug)]
struct Soak {
    // The fields are dropped in this order: the processes, their folder, the network.
    mission: Program,
    nodes: Vec<Option<Program>>,
    hosts: Vec<Host>,
    cluster: Cluster,
    network: Network,
    random: Random,
    options: Options,
    /// The instance path of the group on each host.
    parts: Vec<String>,
    /// The programs that this round still has to kill. Each program is killed once in a round, so that all are restarted equally often.
    victims: Vec<String>,
    paths: Vec<String>,
    counts: Counts,
    sizes: Vec<Sizes>,
    began: Time,
}

impl Soak {
    fn begin(network: Network, options: Options) -> Result<Self> {
        let cluster = Cluster::new();
        let hosts: Vec<Host> = network.hosts().map(|number| cluster.host(&network, number)).collect();
        let nodes = (1..).zip(&hosts).map(|(number, host)| Some(host.node(&name(number), &["--lan"]))).collect();
        let mission = hosts[0].dca(&["deploy", &cluster.file("soak.dca", &spec(&options))]);
        mission.wait_for(Stream::Err, "started in", 2 * SOON);
        let mut parts = vec!["main".to_owned()];
        for number in 2..=hosts.len() {
            parts.push(format!("{}/p{number}", parts[parent(number) - 1]));
        }
        let members = members(&options);
        let paths =
            parts.iter().flat_map(|part| members.iter().map(move |member| format!("{part}/{member}"))).collect();
        let random = Random::new(options.seed);
        let (counts, sizes, victims, began) = (Counts::default(), Vec::new(), Vec::new(), now());
        let soak = Self {
            mission,
            nodes,
            hosts,
            cluster,
            network,
            random,
            options,
            parts,
            victims,
            paths,
            counts,
            sizes,
            began,
        };
        soak.expect_all("the start")?;
        Ok(soak)
    }

    fn run(&mut self) -> Result<()> {
        let [time, cut_every, kill_every, crash_every] =
            [60 * self.options.minutes, self.options.cut_every, self.options.kill_every, self.options.crash_every]
                .map(Duration::from_secs);
        let (mut cut, mut kill, mut size) = (cut_every, kill_every, Duration::ZERO);
        while now() - self.began < time {
            ensure!(self.mission.is_running(), "the mission has ended: {}", self.mission.text(Stream::Err));
            let age = now() - self.began;
            if age >= cut {
                cut += cut_every;
                self.cut()?;
            } else if age >= kill {
                kill += kill_every;
                self.kill_node()?;
            } else if age >= size {
                size += SIZES_EVERY;
                self.expect_all("a while without cuts")?;
                self.note_sizes();
            } else {
                self.crash()?;
                pass(crash_every);
            }
        }
        self.expect_all("the last disturbance")
    }

    /// Kills a program. All programs are killed equally often.
    fn crash(&mut self) -> Result<()> {
        if self.victims.is_empty() {
            self.victims.clone_from(&self.paths);
        }
        let index = self.random.below(self.victims.len() as u64);
        let victim = self.victims.swap_remove(usize::try_from(index)?);
        // The program may still be restarting after the last loss of its host.
        if let Some(pid) = self.programs()?.get(&victim).and_then(|pid| rustix::process::Pid::from_raw(*pid)) {
            self.counts.crashes += u32::from(rustix::process::kill_process(pid, Signal::KILL).is_ok());
        }
        Ok(())
    }

    /// Pulls the cable of a host. Long cuts leave out the home, since without it the mission would end.
    fn cut(&mut self) -> Result<()> {
        self.counts.cuts += 1;
        let is_long = self.counts.cuts.is_multiple_of(5);
        let number = self.draw(if is_long { 2 } else { 1 })?;
        self.expect_all("the last crash")?;
        let before = self.programs()?;
        self.network.cut(number);
        pass(if is_long { CUT_LONG } else { CUT_SHORT });
        self.network.heal(number);
        self.counts.losses += u32::from(is_long);
        self.expect_all(&format!("the cut of {}", name(number)))?;
        // The programs below a group on the lost host have been restarted.
        let lost = format!("{}/", self.parts[number - 1]);
        let after = self.programs()?;
        let again =
            before.iter().find(|(path, pid)| !(is_long && path.starts_with(&lost)) && after.get(*path) != Some(pid));
        ensure!(again.is_none(), "the cut of {} started a program again: {again:?}", name(number));
        Ok(())
    }

    /// Kills a node and starts it again.
    fn kill_node(&mut self) -> Result<()> {
        let number = self.draw(1)?;
        self.expect_all("the last crash")?;
        let before = self.programs()?;
        if let Some(node) = self.nodes[number - 1].take() {
            node.signal(Signal::KILL);
            drop(node.ended(SOON));
        }
        pass(Duration::from_millis(self.random.below(AWAY_MAX_MS)));
        self.nodes[number - 1] = Some(self.hosts[number - 1].node(&name(number), &["--lan"]));
        self.counts.kills += 1;
        self.expect_all(&format!("the end of the node {}", name(number)))?;
        ensure!(self.programs()? == before, "the end of the node {} started a program again", name(number));
        Ok(())
    }

    /// Draws the number of a host.
    fn draw(&mut self, first: usize) -> Result<usize> {
        let count = self.hosts.len() + 1 - first;
        Ok(first + usize::try_from(self.random.below(count as u64))?)
    }

    /// Returns the process of each program. No program may run twice.
    fn programs(&self) -> Result<BTreeMap<String, i32>> {
        let mut programs = BTreeMap::new();
        for process in self.cluster.left() {
            let Some(path) = path(&process) else { continue };
            if let Some(other) = programs.insert(path.clone(), process.pid) {
                // Either process may have ended since it was read.
                let both =
                    [other, process.pid].iter().all(|pid| std::path::Path::new(&format!("/proc/{pid}/exe")).exists());
                ensure!(!both, "{path} runs twice: {other} and {}", process.pid);
            }
        }
        Ok(programs)
    }

    /// Waits until every program runs, once.
    fn expect_all(&self, after: &str) -> Result<()> {
        let mut wrong = None;
        let all = || match self.programs() {
            Ok(programs) => self.paths.iter().all(|path| programs.contains_key(path)),
            Err(error) => wrong.replace(error).is_none(),
        };
        let found = wait_until(RECOVERED_WITHIN, all);
        if let Some(error) = wrong {
            return Err(error);
        }
        if found.is_none() {
            let programs = self.programs()?;
            let missing: Vec<&String> = self.paths.iter().filter(|path| !programs.contains_key(*path)).collect();
            bail!(
                "{RECOVERED_WITHIN:?} after {after} these do not run: {missing:?}\n{}",
                self.hosts[0].ask(&["status"])
            );
        }
        Ok(())
    }

    fn note_sizes(&mut self) {
        let sizes = |pid| Sizes { memory: memory(pid), descriptors: descriptors(pid).len() };
        let nodes: Vec<Sizes> = self.nodes.iter().flatten().map(|node| sizes(node.pid())).collect();
        let client = sizes(self.mission.pid());
        let largest = nodes.iter().chain([&client]).fold(Sizes::default(), |largest, one| Sizes {
            memory: largest.memory.max(one.memory),
            descriptors: largest.descriptors.max(one.descriptors),
        });
        let mean = nodes.iter().map(|one| mebibytes(one.memory)).sum::<f64>() / nodes.len().max(1) as f64;
        let Counts { crashes, cuts, losses, kills } = self.counts;
        say(&format!(
            "{:>4} min: {crashes} crashes, {cuts} cuts, {losses} of them lost a host, {kills} nodes killed; a node takes {mean:.1} MiB, \
             `dca` {:.1} MiB; {} descriptors at most",
            (now() - self.began).as_secs() / 60,
            mebibytes(client.memory),
            largest.descriptors
        ));
        self.sizes.push(largest);
    }

    /// Stops everything. Afterwards nothing is left, and nothing has grown.
    fn end(&mut self) -> Result<()> {
        self.note_sizes();
        let stop = self.hosts[0].ask(&["stop", "soak"]);
        ensure!(stop.code == Some(0), "{stop}");
        wait_until(SOON, || !self.mission.is_running());
        for node in self.nodes.drain(..).flatten() {
            node.signal(Signal::TERM);
            let ended = node.ended(SOON);
            ensure!(ended.code == Some(0), "{ended}");
        }
        wait_until(SOON, || self.cluster.left().is_empty())
            .ok_or_else(|| anyhow::anyhow!("left after the stop: {:?}", self.cluster.left()))?;
        let quarter = self.sizes.len() / 4;
        if quarter > 0 {
            let (second, last) = (&self.sizes[quarter..2 * quarter], &self.sizes[self.sizes.len() - quarter..]);
            let memory = |sizes: &[Sizes]| sizes.iter().map(|one| mebibytes(one.memory)).fold(0.0, f64::max);
            let files = |sizes: &[Sizes]| sizes.iter().map(|one| one.descriptors).max().unwrap_or_default();
            say(&format!(
                "largest of the second quarter and of the last: {:.1} and {:.1} MiB, {} and {} descriptors",
                memory(second),
                memory(last),
                files(second),
                files(last)
            ));
            ensure!(memory(last) <= GROWTH_MAX * memory(second), "memory has grown");
            ensure!(files(last) <= files(second) + 16, "descriptors have grown");
        }
        say("nothing ran twice, everything ran again, nothing is left");
        Ok(())
    }
}

/// Returns the name of a host. The host numbers begin with 1.
fn name(number: usize) -> String {
    format!("c{number}")
}

/// Returns the host of the parent group of a host's group.
fn parent(number: usize) -> usize {
    (number + 1) / 3
}

/// Returns the programs of each group.
fn members(options: &Options) -> Vec<String> {
    (3..=options.programs)
        .map(|number| format!("idle{number}"))
        .chain(["source", "monitor"].map(str::to_owned))
        .collect()
}

/// Returns the instance path of a program, or none for shims, nodes and commands.
fn path(process: &Process) -> Option<String> {
    let is_program = process.command.first().is_some_and(|name| !name.ends_with("dca-shim"));
    let mark = process.environment.iter().find_map(|entry| entry.strip_prefix("DCA_INSTANCE="));
    mark.filter(|_| is_program).map(str::to_owned)
}

#[expect(clippy::cast_precision_loss, reason = "memory is far below 2^52 bytes")]
fn mebibytes(bytes: u64) -> f64 {
    bytes as f64 / f64::from(1 << 20)
}

/// Returns a mission with a group on each host. Its programs are restarted when they die, and a group is restarted when
/// its host is lost.
fn spec(options: &Options) -> String {
    let mut text = "module Idle(host) { exec \"sleep 1000000\"; plain; done; }\n".to_owned();
    let hosts = usize::from(options.hosts);
    for number in 1..=hosts {
        let below: Vec<usize> = (2..=hosts).filter(|other| parent(*other) == number).collect();
        let kind = |name: &str| match name {
            "source" => "RateSource",
            "monitor" => "RateMonitor",
            _ => "Idle",
        };
        let programs = members(options)
            .into_iter()
            .map(|member| format!("{member} instof {}(\"{}\") {{ restart transient; }}", kind(&member), name(number)));
        let groups = below.iter().map(|other| format!("p{other} instof Part{other}();"));
        let declared: Vec<String> = programs.chain(groups).collect();
        let own = members(options)
            .into_iter()
            .map(|member| if member == "source" { "source[lbl1]".to_owned() } else { member });
        let begun = below.iter().map(|other| format!("((p{other} else skip) ;; wait(5 s))"));
        let running: Vec<String> = own.chain(begun).collect();
        text += &format!(
            "process {}(){{
    host{{\"{}\"}}
    instantiated_processes{{
        {}
    }}
    internal_connections(source, lbl1){{ source, Out -> monitor, In; }}
    internal_event_actions{{
        {}
    }}
}}
",
            if number == 1 { "main".to_owned() } else { format!("Part{number}") },
            name(number),
            declared.join("\n        "),
            running.join(", ")
        );
    }
    text
}
