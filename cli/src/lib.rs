//! The command line: each verb has its own file. Results go to standard output, everything else to standard error.
//!
//! Exit codes: 0 done, 1 refused or failed, 2 wrong usage, 3 unreachable, 4 not decided within the limits.

pub(crate) mod absent;
pub mod attach;
pub mod audit;
pub mod change;
pub mod check;
pub mod client;
pub mod clock;
mod complete;
pub mod completions;
pub mod component;
pub mod conform;
mod ctl;
pub mod db;
pub mod deploy;
pub mod display;
pub mod doctor;
pub mod echo;
pub mod estop;
pub mod events;
pub mod explain;
mod export;
pub mod fix;
pub mod fmea;
pub mod fmt;
pub mod follow;
pub mod graph;
mod help;
pub mod hz;
pub mod import;
pub mod io;
mod json;
pub mod list;
mod live;
mod lock;
pub mod logic;
pub mod logs;
pub mod lsp;
pub mod man;
pub mod names;
pub mod new;
pub mod nodes;
pub mod object;
mod orders;
pub mod output;
pub(crate) mod outputs;
pub mod param;
mod project;
mod queue;
pub(crate) mod reader;
pub mod replay;
pub mod report;
mod router;
pub mod run;
pub mod shown;
pub mod sim;
pub mod status;
pub mod stop;
pub(crate) mod stored;
mod switch;
pub(crate) mod tapped;
pub mod team;
pub mod test;
mod top;
pub mod types;
pub mod verify;
mod viewer;
mod work;

use clap::builder::{PathBufValueParser, TypedValueParser};
use clap::parser::ValueSource;
use clap::{Arg, Args, CommandFactory as _, Parser, Subcommand, ValueHint};
use client::signer::KeyPlace;
use comms::io::core_dump;
use comms::io::session::{self, Role};
use language::Assignment;
use node::console::{VERSION, finish, on_own_stack, parsed_by};
use node::io::{logging, run_dir};
use std::collections::BTreeSet;
use std::ffi::OsStr;
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::process::ExitCode;

/// A distributed control architecture for robots: one text file defines which programs run where, how they are wired,
/// and what happens next.
#[derive(Debug, Parser)]
#[command(name = "dca", version = VERSION.as_str())]
struct Command {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Run a spec on this machine alone: a node for each of its hosts is started inside this command
    Run(run::Arguments),
    /// Run a spec on this machine with a record in the place of some of its processes
    Replay(replay::Arguments),
    /// Run a spec on the hosts it names
    Deploy(deploy::Arguments),
    /// Watch a deployment that runs, as `deploy` does
    Attach(attach::Arguments),
    /// Show the changes that a spec would make to the running deployment of its name
    Plan(change::PlanArguments),
    /// Restart programs of a running deployment
    Replace(change::ReplaceArguments),
    /// Add a program to a deployment while it runs
    Add(component::AddArguments),
    /// Take a process away from a deployment while it runs
    Remove(component::RemoveArguments),
    /// Give a message to an activity that runs
    Ctl(ctl::Arguments),
    /// Switch a running process to other connection sets of its own
    Switch(switch::Arguments),
    /// Check a spec and print its diagnostics
    Check(check::Arguments),
    /// Prove the properties of a spec for every order of events, and show how a property fails
    Verify(verify::Arguments),
    /// Say whether mistakes that `dca verify --test` has kept are in their specs again
    Test(test::Arguments),
    /// Show the effects of each single fault of each program of a spec
    Fmea(fmea::Arguments),
    /// Compare a recorded run of supervisors with a spec
    Conform(conform::Arguments),
    /// Make a folder with a spec, and a controller program for it, to begin with
    New(new::Arguments),
    /// Make a spec of a state chart in SCXML, a behavior tree of BehaviorTree.CPP, or a launch file of ROS 2
    ///
    /// Each part that differs or is missing is a line on standard error, and a comment in the spec. The exit code is 0 if nothing is
    /// missing. It is 1 if a part is missing, or if the file is refused.
    Import(import::Arguments),
    /// Apply the fixes of a spec that need no decision
    Fix(fix::Arguments),
    /// Format specs
    Fmt(fmt::Arguments),
    /// Draw a spec: processes, ports and connections
    Graph(graph::Arguments),
    /// Print the record types of a spec as Python or Rust
    Types(types::Arguments),
    /// Run the event actions of a spec with fake processes
    Sim(sim::Arguments),
    /// Explain a diagnostic code
    Explain(explain::Arguments),
    /// Print the completions of verbs and options for a shell
    Completions(completions::Arguments),
    /// Write the pages for `man`
    Man(man::Arguments),
    /// Serve editors as a language server, over standard input and output
    Lsp(lsp::Arguments),
    /// Say whether this machine is as a robot needs it
    Doctor(doctor::Arguments),
    /// List the nodes that can be reached
    Nodes(nodes::Arguments),
    /// List every name that is given out: hosts, deployments, processes, ports, devices and their holders
    Names(names::Arguments),
    /// Say how far the clocks of all hosts are from the clock here
    Clock(clock::Arguments),
    /// Show the processes of all hosts
    Status(status::Arguments),
    /// Watch robots, processes, wires, events and questions on the whole terminal, as they change
    Top(top::Arguments),
    /// Show all robots as they change, on a page for a browser and in Foxglove
    View(viewer::Arguments),
    /// Print the events of all deployments on all hosts
    Events(events::Arguments),
    /// Print the output of a process
    Logs(logs::Arguments),
    /// Print the values that leave an output of a process
    #[command(visible_alias = "tap")]
    Echo(echo::Arguments),
    /// Say how often values leave an output, how regularly, and how many bytes they are
    #[command(visible_alias = "bw")]
    Hz(hz::Arguments),
    /// List the ports, procedures and states of running programs, and the wires inside in-process groups, with their types
    List(list::Arguments),
    /// Call a procedure that a running program exports
    Call(object::CallArguments),
    /// Read a state that a running program exports
    Get(object::GetArguments),
    /// Show the queues of running programs: waiting messages, and those dropped or rejected
    Queue(shown::Arguments),
    /// Show the routers of running programs: subscribers, filters and losses
    Router(shown::Arguments),
    /// Show the resource locks of running programs: holders, leases and waiting clients
    Lock(shown::Arguments),
    /// Stop a deployment everywhere
    Stop(stop::Arguments),
    /// Stop everything on every host at once, so that nothing begins before it is released; not a safety function
    Estop(estop::Arguments),
    /// List and change parameters of running programs
    Param(param::Arguments),
    /// Read and write the database that every robot of a team has a copy of
    Db(db::Arguments),
    /// Begin a team, and manage the rights of its members
    Team(team::Arguments),
    /// Verify the audit log of a node
    Audit(audit::Arguments),
    /// Make an HTML page from the record of a run
    Report(report::Arguments),
    /// Write a record in a form of other programs
    Export(export::Arguments),
}

/// Where to find nodes.
#[derive(Clone, Debug, Default, Args)]
pub struct ConnectArgs {
    /// Look for nodes on the local network too (unauthenticated)
    #[arg(long)]
    pub lan: bool,
    /// Folder with the sockets of this machine's nodes [env: DCA_RUN_DIR]
    #[arg(long, value_name = "DIR", value_parser = RunDirParser, value_hint = ValueHint::DirPath)]
    pub run_dir: Option<RunDir>,
    /// The folder with your key, for nodes in a team [default: $XDG_CONFIG_HOME/dca or ~/.config/dca]
    #[arg(long = "keys", value_name = "DIR")]
    pub key_folder: Option<PathBuf>,
    /// A file of mode 0600 whose first line is the passphrase of your key [env: DCA_PASSPHRASE_FILE] [default: asked for at the terminal]
    #[arg(long = "passphrase", value_name = "FILE")]
    pub key_passphrase: Option<PathBuf>,
    /// Nodes of this machine that have not answered: others are tried first.
    #[arg(skip)]
    silent: BTreeSet<String>,
}

impl ConnectArgs {
    /// Returns these options. Options that are missing are taken from `other`.
    fn or(&self, other: &Self) -> Self {
        let Self { lan, run_dir, key_folder, key_passphrase, silent } = self.clone();
        Self {
            lan: lan || other.lan,
            run_dir: run_dir.or_else(|| other.run_dir.clone()),
            key_folder: key_folder.or_else(|| other.key_folder.clone()),
            key_passphrase: key_passphrase.or_else(|| other.key_passphrase.clone()),
            silent: &silent | &other.silent,
        }
    }

    /// Returns the options for the user's key.
    fn key_place(&self) -> KeyPlace {
        KeyPlace { folder: self.key_folder.clone(), passphrase: self.key_passphrase.clone() }
    }

    /// Returns the folder with the sockets of this machine's nodes, as an absolute path.
    fn base(&self) -> PathBuf {
        let base = self.run_dir.as_ref().map_or_else(run_dir::default_base, |named| named.folder.clone());
        std::path::absolute(&base).unwrap_or(base)
    }

    /// Returns whether the user has named a folder in which nodes run. Then the user means only these nodes.
    fn is_group(&self) -> bool {
        let is_named = self.run_dir.as_ref().is_some_and(|named| named.is_named);
        is_named && run_dir::running(&self.base()).is_ok_and(|nodes| !nodes.is_empty())
    }

    /// Returns the folders of the commands on this machine that have nodes of their own and that the user may mean.
    fn commands(&self) -> Vec<PathBuf> {
        if self.is_group() { Vec::new() } else { self.all_commands() }
    }

    /// Returns the folders of all commands on this machine that have nodes of their own.
    fn all_commands(&self) -> Vec<PathBuf> {
        let base = self.base();
        run_dir::groups(&base).into_iter().filter(|folder| *folder != base).collect()
    }
}

/// The folder with the sockets of this machine's nodes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunDir {
    folder: PathBuf,
    /// Whether the user has written the folder in this command. A folder from the environment or from the project file
    /// chooses no group of nodes.
    is_named: bool,
}

/// Reads a [`RunDir`].
#[derive(Clone, Debug)]
struct RunDirParser;

impl TypedValueParser for RunDirParser {
    type Value = RunDir;

    fn parse_ref(&self, command: &clap::Command, arg: Option<&Arg>, value: &OsStr) -> Result<RunDir, clap::Error> {
        self.parse_ref_(command, arg, value, ValueSource::CommandLine)
    }

    fn parse_ref_(
        &self,
        command: &clap::Command,
        arg: Option<&Arg>,
        value: &OsStr,
        source: ValueSource,
    ) -> Result<RunDir, clap::Error> {
        let folder = PathBufValueParser::new().parse_ref(command, arg, value)?;
        Ok(RunDir { folder, is_named: source == ValueSource::CommandLine })
    }
}

/// Reads a number of seconds within a range.
fn seconds(text: &str, range: &RangeInclusive<f64>) -> Result<f64, String> {
    let seconds: f64 = text.parse().map_err(|_not_a_number| "expected a number of seconds".to_owned())?;
    let within = || format!("expected a number from {} to {} seconds", range.start(), range.end());
    range.contains(&seconds).then_some(seconds).ok_or_else(within)
}

/// Where the controllers' programs are.
#[derive(Clone, Debug, Args)]
pub struct Controllers {
    /// A program that offers controller types; may be given more than once [env: DCA_CONTROLLERS, with `:` between several]
    /// [default: dca-controller beside this program]
    #[arg(long = "controllers", value_name = "PROGRAM")]
    pub programs: Vec<PathBuf>,
}

/// The values that a user gives to the parameters of the root.
#[derive(Clone, Debug, Default, Args)]
pub struct Values {
    /// Give this parameter of `main` a value, such as `--set robot=r7`; may be given more than once [default: as in the spec]
    #[arg(id = "set", long = "set", value_name = "NAME=VALUE", value_parser = assignment)]
    assignments: Vec<Assignment>,
    /// The values that the project file gives.
    #[arg(id = "defaults", long = "project-set", hide = true, value_parser = assignment)]
    defaults: Vec<Assignment>,
    /// The hosts that the project file lists.
    #[arg(id = "hosts", long = "project-host", hide = true)]
    hosts: Vec<String>,
}

impl Values {
    /// Returns the values that the user gives, and the values of the project file for all other parameters.
    fn assignments(&self) -> Vec<Assignment> {
        let is_given = |one: &&Assignment| self.assignments.iter().any(|other| other.name == one.name);
        let defaults = self.defaults.iter().filter(|one| !is_given(one));
        defaults.chain(&self.assignments).cloned().collect()
    }

    /// Returns the values without the values of the project file, for a verb that writes into the spec.
    fn without_defaults(&self) -> Self {
        Self { defaults: Vec::new(), ..self.clone() }
    }

    /// If the project file lists hosts, returns a warning for each host that is not in the list.
    fn strange_hosts(&self, hosts: &[String]) -> Vec<String> {
        let is_strange = |host: &&String| !self.hosts.is_empty() && !self.hosts.contains(host);
        let sentence = |host: &String| {
            let near = language::nearest(host, self.hosts.iter().map(String::as_str));
            let hint = near.map_or(String::new(), |near| format!("; did you mean `{near}`?"));
            format!("warning: `{host}` is not one of the hosts in `{}`{hint}", project::FILE)
        };
        hosts.iter().filter(is_strange).map(sentence).collect()
    }
}

/// Reads `NAME=VALUE`.
fn assignment(text: &str) -> Result<Assignment, String> {
    let (name, value) = text.split_once('=').ok_or("write a name, `=` and a value: `--set speed=0.3`")?;
    Ok(Assignment { name: name.trim().into(), value: value.into() })
}

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    session::prepare_process(Role::Relay);
    core_dump::forbid();
    on_own_stack(run_verb)
}

fn run_verb() -> ExitCode {
    complete::answer();
    let command = match project::with_defaults(json::with_json(help::with_help(Command::command()))) {
        Ok(command) => command,
        Err(failure) => return finish(Err(failure)),
    };
    let command: Command = match parsed_by(command) {
        Ok(command) => command,
        Err(code) => return code,
    };
    logging::start(logging::COMMAND);
    finish(match command.verb {
        Verb::Run(arguments) => run::run(arguments),
        Verb::Replay(arguments) => replay::run(arguments),
        Verb::Deploy(arguments) => deploy::run(arguments),
        Verb::Attach(arguments) => attach::run(&arguments),
        Verb::Plan(arguments) => change::plan(&arguments),
        Verb::Replace(arguments) => change::replace(&arguments),
        Verb::Add(arguments) => component::add(&arguments),
        Verb::Remove(arguments) => component::remove(&arguments),
        Verb::Ctl(arguments) => ctl::run(&arguments),
        Verb::Switch(arguments) => switch::run(&arguments),
        Verb::Check(arguments) => check::run(&arguments),
        Verb::Verify(arguments) => verify::run(&arguments),
        Verb::Test(arguments) => test::run(&arguments),
        Verb::Fmea(arguments) => fmea::run(&arguments),
        Verb::Conform(arguments) => conform::run(&arguments),
        Verb::New(arguments) => new::run(&arguments),
        Verb::Import(arguments) => import::run(&arguments),
        Verb::Fix(arguments) => fix::run(&arguments),
        Verb::Fmt(arguments) => fmt::run(&arguments),
        Verb::Graph(arguments) => graph::run(&arguments),
        Verb::Types(arguments) => types::run(&arguments),
        Verb::Sim(arguments) => sim::run(&arguments),
        Verb::Explain(arguments) => explain::run(&arguments),
        Verb::Completions(arguments) => completions::run(&arguments),
        Verb::Man(arguments) => man::run(&arguments),
        Verb::Lsp(arguments) => lsp::run(&arguments),
        Verb::Doctor(arguments) => doctor::run(&arguments),
        Verb::Nodes(arguments) => nodes::run(&arguments),
        Verb::Names(arguments) => names::run(&arguments),
        Verb::Clock(arguments) => clock::run(&arguments),
        Verb::Status(arguments) => status::run(&arguments),
        Verb::Top(arguments) => top::run(&arguments),
        Verb::View(arguments) => viewer::run(&arguments),
        Verb::Events(arguments) => events::run(&arguments),
        Verb::Logs(arguments) => logs::run(&arguments),
        Verb::Echo(arguments) => echo::run(&arguments),
        Verb::Hz(arguments) => hz::run(&arguments),
        Verb::List(arguments) => list::run(&arguments),
        Verb::Call(arguments) => object::call(&arguments),
        Verb::Get(arguments) => object::get(&arguments),
        Verb::Queue(arguments) => queue::run(&arguments),
        Verb::Router(arguments) => router::run(&arguments),
        Verb::Lock(arguments) => lock::run(&arguments),
        Verb::Stop(arguments) => stop::run(&arguments),
        Verb::Estop(arguments) => estop::run(&arguments),
        Verb::Param(arguments) => param::run(arguments),
        Verb::Db(arguments) => db::run(arguments),
        Verb::Team(arguments) => team::run(&arguments),
        Verb::Audit(arguments) => audit::run(&arguments),
        Verb::Report(arguments) => report::run(&arguments),
        Verb::Export(arguments) => export::run(&arguments),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::FromArgMatches as _;

    #[test]
    fn every_verb_can_be_parsed() {
        Command::command().debug_assert();
    }

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        connect: ConnectArgs,
    }

    #[test]
    fn only_a_written_folder_chooses_a_group_of_nodes() {
        let usual = || Line::command().mut_arg("run_dir", |run_dir| run_dir.default_value("/usual"));
        let check = |words: &[&str], folder: &str, is_named| {
            let matches = usual().get_matches_from(std::iter::once(&"dca").chain(words));
            let connect = Line::from_arg_matches(&matches).unwrap().connect;
            assert_eq!(connect.run_dir, Some(RunDir { folder: folder.into(), is_named }));
        };
        check(&[], "/usual", false);
        check(&["--run-dir", "/usual"], "/usual", true);
    }
}
