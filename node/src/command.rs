//! `dca-node`: runs the agent of a host until SIGTERM, SIGINT or SIGHUP.

mod arguments;
mod install;

use crate::console::{self, Failure, block_on, ended, finish, on_own_stack, parsed};
use crate::io::driver::{self, Config, DatabaseConfig, Inherited, NetworkConfig, ProgramsConfig};
use crate::io::leave::Leave;
use crate::io::logging::{self, Log};
use crate::io::service_manager::ServiceManager;
use crate::io::{cgroup, programs, state_dir};
use anyhow::{Context as _, anyhow, ensure};
use arguments::Arguments;
use clap::{CommandFactory as _, Parser, Subcommand};
use comms::io::core_dump;
use comms::io::session::{self, Reach, Role};
use install::Install;
use rustix::process::{Resource, getrlimit};
use std::process::ExitCode;
use std::sync::Arc;
use team::member::Member;
use tokio::sync::watch;

/// The agent of a host: starts programs, supervises them, and finds the other agents.
#[derive(Debug, Parser)]
#[command(name = "dca-node", version = console::VERSION.as_str(), args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
struct Command {
    #[command(subcommand)]
    verb: Option<Verb>,
    #[command(flatten)]
    node: Option<Arguments>,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Have systemd keep a node with these options running
    Install(Install),
}

/// Returns the command line of `dca-node`, for its page of the manual.
pub fn command() -> clap::Command {
    Command::command()
}

/// Runs the agent of this process.
pub fn main() -> ExitCode {
    session::prepare_process(Role::Relay);
    core_dump::forbid();
    on_own_stack(run_verb)
}

fn run_verb() -> ExitCode {
    match parsed() {
        Ok(Command { verb: Some(Verb::Install(install)), .. }) => finish(install::run(&install)),
        Ok(Command { verb: None, node: Some(node) }) => finish(run(node, logging::start(logging::NODE))),
        Ok(Command { verb: None, node: None }) => {
            finish(Err(anyhow!("give the name of this host with `--name`").into()))
        }
        Err(code) => code,
    }
}

/// Returns the peers that a node accepts: its team, every host, or no other host. A node in a team never accepts every host.
fn reach(arguments: &Arguments, member: Option<&Arc<Member>>) -> anyhow::Result<Reach> {
    let Some(member) = member else {
        ensure!(arguments.insecure_lan || arguments.port == 0, "`--port` needs a node in a team, or `--insecure-lan`");
        if !arguments.insecure_lan {
            return Ok(Reach::Host);
        }
        console::note("this node is open to the local network without authentication: anyone there can start programs");
        return Ok(Reach::Lan);
    };
    let team = member.team().name();
    let (name, certified) = (arguments.name.as_str(), member.name().as_str());
    ensure!(
        name == certified,
        "this node is `{certified}` in the team `{team}`, and cannot use the name `{name}`: start it with `--name {certified}`, or take \
         `{name}` into the team as another node"
    );
    ensure!(
        !arguments.insecure_lan,
        "this node is in the team `{team}`, and accepts connections from its team only: leave out `--insecure-lan`"
    );
    if let Err(error) = member.check() {
        console::note(&format!("the other nodes of the team `{team}` will refuse this node: {error:#}"));
    }
    Ok(Reach::Team(Arc::clone(member) as _))
}

/// How many files a node needs to have open at once. The node itself needs 20. The rest is for 8 other nodes, 8
/// commands, 2 programs with 6 files each, and files that are open only briefly.
const FILES_MIN: u64 = 64;
/// How many bytes of address space a node needs. Its threads and allocators reserve far more than they use.
const ADDRESSES_MIN: u64 = 1 << 30;

/// Checks that the limits of this process are high enough for a node. If they are not, a library of the node ends the process,
/// or receives nothing any more.
fn check_limits() -> anyhow::Result<()> {
    let files = getrlimit(Resource::Nofile).current.unwrap_or(u64::MAX);
    ensure!(
        files >= FILES_MIN,
        "a node needs {FILES_MIN} open files at once, but its limit is {files}: raise the limit, with `ulimit -n` or \
         `LimitNOFILE=` of its service"
    );
    let addresses = getrlimit(Resource::As).current.unwrap_or(u64::MAX);
    ensure!(
        addresses >= ADDRESSES_MIN,
        "a node reserves {} MB of addresses, but its limit is {} MB: raise the limit, with `ulimit -v` or `LimitAS=` of its \
         service; `memory` in a spec limits programs",
        ADDRESSES_MIN >> 20,
        addresses >> 20
    );
    Ok(())
}

fn run(arguments: Arguments, log: Log) -> Result<(), Failure> {
    check_limits()?;
    programs::check_shim()?;
    let service =
        ServiceManager::of_environment().context("reaching the service manager that `NOTIFY_SOCKET` names")?;
    let state = state_dir::take(arguments.state.as_deref(), arguments.name.as_str())?;
    let member = Member::open(&state)?.map(Arc::new);
    let reach = reach(&arguments, member.as_ref())?;
    let team = member.as_ref().map_or_else(String::new, |member| format!(", in the team `{}`", member.team().name()));
    let base = arguments.base();
    let config = Config {
        name: arguments.name.as_str().to_owned(),
        base,
        network: NetworkConfig { reach, member, port: arguments.port, peers: arguments.peers },
        programs: ProgramsConfig {
            controllers: programs::chosen(&arguments.controllers),
            inherited: Inherited::Listed(arguments.inherited),
            agent_loss_grace: arguments.agent_loss_grace,
        },
        database: DatabaseConfig { store: arguments.store, team: arguments.team, founds: false },
        state: Some(state),
        adopts: true,
        boot: arguments.boot_id,
        log: Some(log),
        service: service.clone(),
    };
    let result = block_on(async {
        let (leave, ready) = (watch::Sender::new(false), watch::Sender::new(false));
        let (mut is_ready, name) = (ready.subscribe(), config.name.clone());
        let told = service.clone();
        let announcing = async move {
            if is_ready.wait_for(|ready| *ready).await.is_ok() {
                told.ready(&name);
                // A node runs just as well if no program reads this line.
                drop(console::pass(format!("node `{name}` is ready{team}\n").as_bytes()));
            }
        };
        tokio::pin!(announcing);
        let mut announced = false;
        let mut node = tokio::task::JoinSet::new();
        let mut leave_asked = Leave::new()?;
        node.spawn(driver::run(config, leave.subscribe(), ready));
        loop {
            tokio::select! {
                ended = ended(&mut node) => return Ok(ended?),
                () = &mut announcing, if !announced => {
                    announced = true;
                    continue;
                }
                signal = leave_asked.asked() => tracing::info!(signal, "the node was asked to leave"),
            }
            service.leaving();
            leave.send_replace(true);
        }
    });
    cgroup::leave();
    result
}
