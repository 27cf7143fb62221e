//! The same work with DCA, supervisord and dora: programs start, one is killed, the supervisor is killed, and all are
//! stopped.

use anyhow::{Context as _, Result, bail, ensure};
use clap::Parser;
use comms::io::clock::now;
use comms::logic::time::Time;
use dca_tests::cluster::{Network, executable, pass, wait_until};
use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitCode, Stdio};
use std::time::Duration;

/// How long anything may take.
const WITHIN: Duration = Duration::from_secs(60);
/// How long programs are watched after the end of their supervisor, and after the start of the next one.
const WATCHED: Duration = Duration::from_secs(5);
/// The compared systems. A program counts once it runs, even if its supervisor still waits for something.
const KINDS: [Kind; 3] = [Kind::Dca, Kind::Supervisord, Kind::Dora];

/// Has DCA, supervisord and dora run the same programs in turn, in a network namespace, and prints the resources that
/// each takes. A system that is not installed is skipped with a message. Needs root.
///
/// A line: from nothing to all programs running; from a `kill -9` of one to its successor; how many still run 5 s after
/// a `kill -9` of all processes of the supervisor; how many of these are the same 5 s after it was started again, and
/// how many run then; from the order to stop to none left.
#[derive(Debug, Parser)]
#[command(name = "peers")]
struct Options {
    /// Programs
    #[arg(long, default_value_t = 50, value_parser = clap::value_parser!(u16).range(2..=500))]
    programs: u16,
    /// How often each is measured, in turn
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..=100))]
    rounds: u16,
}

fn main() -> ExitCode {
    let options = Options::parse();
    let Some(network) = Network::new(1) else { return ExitCode::FAILURE };
    match compare(&network, &options) {
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

fn compare(network: &Network, options: &Options) -> Result<()> {
    let installed = |kind: &Kind| {
        let is_there = kind.is_installed();
        if !is_there {
            say(&format!("{} is not installed", kind.name()));
        }
        is_there
    };
    let kinds: Vec<Kind> = KINDS.into_iter().filter(installed).collect();
    let load = fs::read_to_string("/proc/loadavg")?;
    say(&format!("{} programs, median of {}; load average before: {}", options.programs, options.rounds, load.trim()));
    let mut rounds: Vec<Vec<Round>> = vec![Vec::new(); kinds.len()];
    for round in 0..options.rounds {
        for (kind, rounds) in kinds.iter().zip(&mut rounds) {
            let place = Place::new(network, *kind, options.programs, round)?;
            rounds.push(place.measure().with_context(|| format!("{}, round {round}", kind.name()))?);
        }
    }
    say("                   start  replaced  left alone  the same then, of  stopped");
    for (kind, rounds) in kinds.iter().zip(&rounds) {
        let time = |of: fn(&Round) -> Duration| format!("{:.0} ms", median(rounds, of).as_secs_f64() * 1e3);
        let count = |of: fn(&Round) -> usize| median(rounds, of);
        let stopped: Vec<Duration> = rounds.iter().filter_map(|round| round.stopped).collect();
        let stopped = match stopped.len() {
            few if few < rounds.len() => format!("never in {} of {}", rounds.len() - few, rounds.len()),
            _ => format!("{:.0} ms", median(&stopped, |time| *time).as_secs_f64() * 1e3),
        };
        say(&format!(
            "  {:<12} {:>10} {:>9} {:>11} {:>18} {:>8}",
            kind.name(),
            time(|round| round.started),
            time(|round| round.replaced),
            count(|round| round.alone),
            format!("{}, {}", count(|round| round.same), count(|round| round.after)),
            stopped
        ));
    }
    Ok(())
}

fn median<T, V: Copy + Default + Ord>(of: &[T], value: fn(&T) -> V) -> V {
    let mut values: Vec<V> = of.iter().map(value).collect();
    values.sort_unstable();
    values.get(values.len() / 2).copied().unwrap_or_default()
}

/// The result of one round.
#[derive(Clone, Debug)]
struct Round {
    started: Duration,
    replaced: Duration,
    /// The number of programs that run without their supervisor.
    alone: usize,
    /// The number of them that continue under the next supervisor, and the number of all programs that then run.
    same: usize,
    after: usize,
    /// None if some programs are left.
    stopped: Option<Duration>,
}

/// A supervisor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Dca,
    Supervisord,
    Dora,
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Self::Dca => "DCA",
            Self::Supervisord => "supervisord",
            Self::Dora => "dora",
        }
    }

    fn is_installed(self) -> bool {
        let version = |name: &str| Command::new(name).arg("--version").stdout(Stdio::null()).status();
        match self {
            Self::Dca => true,
            Self::Supervisord => version("supervisord").is_ok(),
            Self::Dora => version("dora").is_ok(),
        }
    }
}

/// A folder and a namespace for one supervisor. Dropping it kills the remaining processes.
struct Place {
    kind: Kind,
    folder: PathBuf,
    namespace: String,
    programs: u16,
    /// The argument of `sleep` that marks the programs of this place.
    mark: String,
}

impl Place {
    fn new(network: &Network, kind: Kind, programs: u16, round: u16) -> Result<Self> {
        let id = std::process::id();
        let folder = std::env::temp_dir().join(format!("peers{id}-{round}-{}", kind.name()));
        fs::create_dir_all(&folder)?;
        let mark = format!("10000{id}.{round}{}", kind as u8 + 1);
        Ok(Self { kind, folder, namespace: network.namespace(1), programs, mark })
    }

    fn measure(&self) -> Result<Round> {
        let wanted = usize::from(self.programs);
        self.write_files()?;
        let begun = now();
        let mut commands = self.start()?;
        let started = self.wait_for(begun, |pids| pids.len() == wanted).context("they do not all start")?;

        let victim = self.running().into_iter().next().context("there is none")?;
        let begun = now();
        kill(victim)?;
        let is_replaced = |pids: &BTreeSet<u32>| pids.len() == wanted && !pids.contains(&victim);
        let replaced = self.wait_for(begun, is_replaced).context("the one that was killed is not replaced")?;

        let before = self.running();
        for process in self.supervisors()? {
            kill(process)?;
        }
        // No event shows whether programs continue without a supervisor, so the test waits.
        pass(WATCHED);
        let alone = self.running().intersection(&before).count();
        commands.extend(self.start()?);
        pass(WATCHED);
        let now_running = self.running();
        let (same, after) = (now_running.intersection(&before).count(), now_running.len());

        let begun = now();
        self.stop()?;
        let stopped = self.wait_for(begun, BTreeSet::is_empty).ok();
        for mut command in commands {
            command.kill().unwrap_or_default();
            command.wait()?;
        }
        Ok(Round { started, replaced, alone, same, after, stopped })
    }

    fn wait_for(&self, begun: Time, is_so: impl Fn(&BTreeSet<u32>) -> bool) -> Result<Duration> {
        let found = wait_until(WITHIN, || is_so(&self.running()));
        ensure!(found.is_some(), "{} run after {WITHIN:?}", self.running().len());
        Ok(now().since(begun))
    }

    /// Returns the running programs.
    fn running(&self) -> BTreeSet<u32> {
        let is_program = |arguments: &[&str]| arguments.len() == 2 && arguments[1] == self.mark;
        pids(|_, command| is_program(&command.split_terminator('\0').collect::<Vec<_>>()))
    }

    /// Returns the processes of the supervisor. These do not include its programs. They also do not include the parents
    /// that DCA gives to the programs, so that the programs outlive the supervisor.
    fn supervisors(&self) -> Result<BTreeSet<u32>> {
        let (folder, programs) = (self.folder.display().to_string(), self.running());
        let name = match self.kind {
            Kind::Dca => "dca-node",
            Kind::Supervisord => "supervisord",
            Kind::Dora => "dora",
        };
        let found = pids(|pid, command| {
            let is_here = command.contains(&folder) || is_in(pid, &self.folder);
            is_here && !programs.contains(&pid) && command.split('\0').any(|word| word.ends_with(name))
        });
        ensure!(!found.is_empty(), "there is no process of {}", self.kind.name());
        Ok(found)
    }

    fn write_files(&self) -> Result<()> {
        let numbers = 0..self.programs;
        let (name, text) = match self.kind {
            Kind::Dca => {
                let instances = numbers.clone().fold(String::new(), |mut text, number| {
                    write!(text, "p{number} instof Sleep(c1) {{ restart permanent; }} ").unwrap_or_default();
                    text
                });
                let all: Vec<String> = numbers.map(|number| format!("p{number}")).collect();
                let spec = format!(
                    "module Sleep {{ exec \"sleep {}\"; plain; }}\nprocess main() {{ host {{ c1 }}\n\
                     instantiated_processes {{ {instances} }}\ninternal_event_actions {{ {} }} }}\n",
                    self.mark,
                    all.join(" , ")
                );
                ("peers.dca", spec)
            }
            Kind::Supervisord => {
                let folder = self.folder.display();
                let mut text = format!(
                    "[supervisord]\nlogfile={folder}/log\npidfile={folder}/pid\nchildlogdir={folder}\n\
                     [unix_http_server]\nfile={folder}/socket\n[supervisorctl]\nserverurl=unix://{folder}/socket\n\
                     [rpcinterface:supervisor]\n\
                     supervisor.rpcinterface_factory = supervisor.rpcinterface:make_main_rpcinterface\n"
                );
                for number in numbers {
                    write!(text, "[program:p{number}]\ncommand=sleep {}\nstartsecs=0\nautorestart=true\n", self.mark)?;
                }
                ("supervisord.conf", text)
            }
            Kind::Dora => {
                let node = |number| {
                    format!(
                        "  - id: p{number}\n    path: sleep\n    args: \"{}\"\n    restart_policy: always\n",
                        self.mark
                    )
                };
                ("flow.yml", format!("nodes:\n{}", numbers.map(node).collect::<String>()))
            }
        };
        Ok(fs::write(self.folder.join(name), text)?)
    }

    /// Starts the supervisor and lets it start the programs. A person would type the same command after a `kill -9` of
    /// the supervisor.
    fn start(&self) -> Result<Vec<Child>> {
        let run = self.folder.join("n").display().to_string();
        match self.kind {
            Kind::Dca => {
                let node = executable("dca-node").display().to_string();
                let state = self.folder.join("state").display().to_string();
                let arguments = ["--name", "c1", "--run-dir", &run, "--state", &state];
                let mut node = self.command(&node).args(arguments).stdout(Stdio::piped()).spawn()?;
                let mut said = String::new();
                let out = node.stdout.take().context("no pipe")?;
                std::io::BufRead::read_line(&mut std::io::BufReader::new(out), &mut said)?;
                ensure!(said.contains("ready"), "the node said `{said}`");
                if self.running().is_empty() {
                    let dca = executable("dca").display().to_string();
                    let deploy = ["deploy", "--no-record", "peers.dca", "--run-dir", &run];
                    return Ok(vec![node, self.command(&dca).args(deploy).spawn()?]);
                }
                Ok(vec![node])
            }
            Kind::Supervisord => Ok(vec![self.command("supervisord").args(["-n", "-c", "supervisord.conf"]).spawn()?]),
            Kind::Dora => {
                self.run("dora", &["up"])?;
                self.run("dora", &["start", "flow.yml", "--detach"])?;
                Ok(Vec::new())
            }
        }
    }

    fn stop(&self) -> Result<()> {
        match self.kind {
            Kind::Dca => {
                let run = self.folder.join("n").display().to_string();
                self.run(&executable("dca").display().to_string(), &["stop", "peers", "--run-dir", &run])
            }
            Kind::Supervisord => self.run("supervisorctl", &["-c", "supervisord.conf", "shutdown"]),
            Kind::Dora => {
                self.run("dora", &["stop", "--all"])?;
                self.run("dora", &["destroy", "--force"])
            }
        }
    }

    fn command(&self, program: &str) -> Command {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", &self.namespace, program]).current_dir(&self.folder);
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        command
    }

    /// Runs a command to its end. The programs that run afterwards show its result.
    fn run(&self, program: &str, arguments: &[&str]) -> Result<()> {
        let mut child = self.command(program).args(arguments).spawn()?;
        if wait_until(WITHIN, || !matches!(child.try_wait(), Ok(None))).is_none() {
            child.kill()?;
            child.wait()?;
            bail!("`{program} {}` takes longer than {WITHIN:?}", arguments.join(" "));
        }
        Ok(())
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let own = std::process::id();
        let all = pids(|pid, command| pid != own && (command.contains(&self.mark) || is_in(pid, &self.folder)));
        for process in all {
            kill(process).unwrap_or_default();
        }
        fs::remove_dir_all(&self.folder).unwrap_or_default();
    }
}

fn is_in(pid: u32, folder: &Path) -> bool {
    fs::read_link(format!("/proc/{pid}/cwd")).is_ok_and(|cwd| cwd.starts_with(folder))
}

/// Returns the processes for which `is_wanted` holds. It receives the id and the command line, in which every word ends
/// with a zero.
fn pids(is_wanted: impl Fn(u32, &str) -> bool) -> BTreeSet<u32> {
    let entries = fs::read_dir("/proc").into_iter().flatten().flatten();
    let pids = entries.filter_map(|entry| entry.file_name().to_str()?.parse::<u32>().ok());
    pids.filter(|pid| {
        let command = fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        is_wanted(*pid, &String::from_utf8_lossy(&command))
    })
    .collect()
}

fn kill(pid: u32) -> Result<()> {
    let pid = rustix::process::Pid::from_raw(i32::try_from(pid)?).context("no process has the id 0")?;
    Ok(rustix::process::kill_process(pid, rustix::process::Signal::KILL)?)
}
