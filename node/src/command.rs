//! `dca-node`: runs the agent of a host until SIGTERM or SIGINT.

use crate::console::{self, Failure, block_on, ended, finish, parsed};
use crate::io::driver::{self, Config};
use crate::io::logging::{self, Log};
use crate::io::{cgroup, programs, run_dir, state_dir};
use crate::logic::database::TEAM;
use clap::{CommandFactory as _, Parser};
use comms::io::session::{self, Reach, Role};
use comms::logic::key::HostName;
use dbmanager::io::store::Engine;
use std::net::Ipv6Addr;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::watch;

/// The longest time that may be given, in seconds.
const SECONDS_MAX: f64 = 86_400.0;

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
    #[arg(long = "peer", value_name = "tcp/ADDRESS:PORT", value_parser = peer)]
    peers: Vec<String>,
    /// A program that offers controller types; may be given more than once [default: dca-controller beside this program]
    #[arg(long = "controllers", value_name = "PROGRAM")]
    controllers: Vec<PathBuf>,
    /// How long programs have to stop when this node is gone, in seconds [default: they go on, and this node finds them again
    /// when it is started again]
    #[arg(long, value_name = "S", value_parser = seconds)]
    agent_loss_grace: Option<Duration>,
    /// Folder for sockets and output; its path, a slash and the node's name have 45 bytes at the most
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

/// Reads where another node can be dialled.
fn peer(text: &str) -> Result<String, &'static str> {
    let place = text.strip_prefix("tcp/").ok_or("it begins with `tcp/`")?;
    let (host, port) = place.rsplit_once(':').ok_or("it ends in `:` and a port")?;
    if !port.parse::<u16>().is_ok_and(|port| port > 0) {
        return Err("the port is a number from 1 to 65535");
    }
    let is_v6 = host.strip_prefix('[').and_then(|host| host.strip_suffix(']'));
    let is_address = match is_v6 {
        Some(address) => address.split('%').next().is_some_and(|address| address.parse::<Ipv6Addr>().is_ok()),
        None => !host.is_empty() && host.chars().all(|c| c.is_ascii_alphanumeric() || "-._".contains(c)),
    };
    if is_address { Ok(text.to_owned()) } else { Err("the address is a name, `10.0.0.7` or `[fd00::7]`") }
}

/// Reads a time in seconds.
fn seconds(text: &str) -> Result<Duration, &'static str> {
    let seconds = text.parse().ok().filter(|seconds| (0.0..=SECONDS_MAX).contains(seconds));
    seconds.map(Duration::from_secs_f64).ok_or("it is a number of seconds from 0 to 86400")
}

/// The command line of `dca-node`, for its page of the manual.
pub fn command() -> clap::Command {
    Arguments::command()
}

/// Runs the agent of this process.
pub fn main() -> ExitCode {
    session::prepare_process(Role::Relay);
    match parsed() {
        Ok(arguments) => finish(run(arguments, logging::start(logging::NODE))),
        Err(code) => code,
    }
}

fn run(arguments: Arguments, log: Log) -> Result<(), Failure> {
    if arguments.lan {
        console::note("this node is open to the local network without authentication: anyone there can start programs");
    }
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
        agent_loss_grace: arguments.agent_loss_grace,
        adopts: true,
        log: Some(log),
    };
    let result = block_on(async {
        let (leave, ready) = (watch::Sender::new(false), watch::Sender::new(false));
        let (mut is_ready, name) = (ready.subscribe(), config.name.clone());
        let announcing = async move {
            if is_ready.wait_for(|ready| *ready).await.is_ok() {
                // A node runs just as well where nobody reads that.
                drop(console::pass(format!("node `{name}` is ready\n").as_bytes()));
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_peer_is_an_address_with_a_port() {
        for good in ["tcp/10.0.0.7:7000", "tcp/robot-1.local:1", "tcp/[fd00::7]:65535", "tcp/[fe80::1%eth0]:7000"] {
            assert_eq!(peer(good).as_deref(), Ok(good));
        }
        let bad =
            ["x", "tcp/1.2.3.4", "tcp/[::1]:70000", "tcp/:1", "tcp/a b:1", "udp/1.1.1.1:1", "tcp/[x]:1", "tcp/a:0"];
        for bad in bad {
            assert!(peer(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_grace_is_a_time() {
        assert_eq!(seconds("2.5"), Ok(Duration::from_millis(2500)));
        for bad in ["nan", "inf", "-1", "1e300", "86401", "soon"] {
            assert!(seconds(bad).is_err(), "{bad}");
        }
    }
}
