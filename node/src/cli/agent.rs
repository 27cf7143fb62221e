//! `dca-node`: the agent of a host, until it is asked to leave (SIGTERM, SIGINT).

use crate::cli::client::{block_on, ended};
use crate::cli::{Failure, finish, output};
use crate::io::driver::{self, Config};
use crate::io::logging::{self, Log};
use crate::io::{cgroup, programs, run_dir, state_dir};
use crate::logic::database::TEAM;
use anyhow::Context;
use clap::{CommandFactory as _, Parser};
use comms::io::session::{self, Reach, Role};
use comms::logic::key::HostName;
use dbmanager::io::store::Engine;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::watch;

/// The agent of a host: starts programs, supervises them, and finds the other agents.
#[derive(Debug, Parser)]
#[command(name = "dca-node", version)]
struct Arguments {
    /// The host's name in specs
    #[arg(long, value_parser = HostName::parse)]
    name: HostName,
    /// Open this node to the local network, unauthenticated
    #[arg(long)]
    lan: bool,
    /// The TCP port to listen on with `--lan` [default: any that is free]
    #[arg(long, requires = "lan", default_value_t = 0, hide_default_value = true)]
    port: u16,
    /// A node known beforehand, for networks without multicast; may be given more than once
    #[arg(long = "peer", value_name = "tcp/ADDRESS:PORT")]
    peers: Vec<String>,
    /// A program that offers controller types; may be given more than once [default: dca-controller beside this program]
    #[arg(long = "controllers", value_name = "PROGRAM")]
    controllers: Vec<PathBuf>,
    /// How long programs have to stop when this node is gone, in seconds
    #[arg(long, default_value_t = 5.0, value_name = "S")]
    agent_loss_grace: f64,
    /// Folder for sockets and output
    #[arg(long, value_name = "DIR")]
    run_dir: Option<PathBuf>,
    /// Folder for the database, which survives this node [default: /var/lib/dca, or dca in the user's state folder]
    #[arg(long, value_name = "DIR")]
    state: Option<PathBuf>,
    /// What keeps a new database on the disk, `redb` or `sled`; one that is there stays with what it was made on [default: redb]
    #[arg(long, value_name = "ENGINE")]
    store: Option<Engine>,
    /// The team whose database this robot has a copy of
    #[arg(long, value_name = "NAME", default_value = TEAM)]
    team: String,
}

/// The command line of `dca-node`, for its page of the manual.
pub(crate) fn command() -> clap::Command {
    Arguments::command()
}

/// Runs the agent of this process.
pub fn main() -> ExitCode {
    session::prepare_process(Role::Relay);
    let arguments = Arguments::parse();
    finish(run(arguments, logging::start(logging::NODE)))
}

fn run(arguments: Arguments, log: Log) -> Result<(), Failure> {
    if arguments.lan {
        output::note("this node is open to the local network without authentication: anyone there can start programs");
    }
    let seconds = arguments.agent_loss_grace;
    let agent_loss_grace = Duration::try_from_secs_f64(seconds).context("`--agent-loss-grace` must not be negative")?;
    let state = state_dir::take(arguments.state.as_deref(), arguments.name.as_str())?;
    let config = Config {
        state: Some(state),
        store: arguments.store,
        team: arguments.team,
        founds: false,
        name: arguments.name.as_str().to_owned(),
        base: arguments.run_dir.unwrap_or_else(run_dir::default_base),
        reach: if arguments.lan { Reach::Lan } else { Reach::Host },
        controllers: programs::chosen(&arguments.controllers),
        port: arguments.port,
        peers: arguments.peers,
        agent_loss_grace,
        log: Some(log),
    };
    let result = block_on(async {
        let (leave, ready) = (watch::Sender::new(false), watch::Sender::new(false));
        let (mut is_ready, name) = (ready.subscribe(), config.name.clone());
        let announcing = async move {
            if is_ready.wait_for(|ready| *ready).await.is_ok() {
                output::say(&format!("node `{name}` is ready"));
            }
        };
        tokio::pin!(announcing);
        let mut announced = false;
        let mut node = tokio::task::JoinSet::new();
        node.spawn(driver::run(config, leave.subscribe(), ready));
        let (mut terminate, mut interrupt) = (signal(SignalKind::terminate())?, signal(SignalKind::interrupt())?);
        loop {
            tokio::select! {
                ended = ended(&mut node) => return Ok(ended?),
                () = &mut announcing, if !announced => announced = true,
                _ = terminate.recv() => { leave.send_replace(true); }
                _ = interrupt.recv() => { leave.send_replace(true); }
            }
        }
    });
    cgroup::leave();
    result
}
