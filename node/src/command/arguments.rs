//! The options of a node.

use crate::io::run_dir;
use crate::logic::database::TEAM;
use clap::builder::NonEmptyStringValueParser;
use comms::logic::key::HostName;
use dbmanager::io::store::Engine;
use language::plan::pattern_problem;
use std::net::Ipv6Addr;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The longest name of a network interface, in bytes. Source: `IFNAMSIZ` of Linux, without the zero at its end.
const INTERFACE_MAX: usize = 15;
/// The longest name for a boot of the machine, in bytes.
const BOOT_ID_MAX: usize = 128;
/// The longest time that may be given, in seconds.
const SECONDS_MAX: f64 = 86_400.0;

/// The arguments of `dca-node`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// The host's name in specs
    #[arg(long, value_parser = HostName::parse)]
    pub(super) name: HostName,
    /// Open this node, which is in no team, to everybody on the local network: anyone there can start programs
    #[arg(long, visible_alias = "lan")]
    pub(super) insecure_lan: bool,
    /// The TCP port to listen on, of a node in a team or with `--insecure-lan` [default: any free port]
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    pub(super) port: u16,
    /// A node known beforehand, for networks without multicast; may be given more than once
    #[arg(long = "peer", value_name = "tcp/ADDRESS:PORT", value_parser = peer)]
    pub(super) peers: Vec<String>,
    /// A program that offers controller types; may be given more than once [default: dca-controller beside this program]
    #[arg(long = "controllers", value_name = "PROGRAM")]
    pub(super) controllers: Vec<PathBuf>,
    /// A variable that programs inherit from this node, in addition to PATH, HOME, USER, LANG, TZ
    /// and RUST_LOG: a name, or the beginning of names, such as `ROS_*`; may be given more than
    /// once
    #[arg(long = "inherit", value_name = "NAME", value_delimiter = ',', value_parser = inherited)]
    pub(super) inherited: Vec<String>,
    /// How long programs may take to stop when this node is gone, in seconds [default: programs
    /// continue, and this node finds them when it is started again]
    #[arg(long, value_name = "S", value_parser = seconds, allow_negative_numbers = true)]
    pub(super) agent_loss_grace: Option<Duration>,
    /// Folder for sockets and output [env: DCA_RUN_DIR]; its path, a slash and the node's name have 45 bytes at the most
    #[arg(long, value_name = "DIR")]
    pub(super) run_dir: Option<PathBuf>,
    /// Folder for the database, which survives this node [default: /var/lib/dca, or dca in the user's state folder]
    #[arg(long, value_name = "DIR")]
    pub(super) state: Option<PathBuf>,
    /// The engine of a new database on the disk, `redb` or `sled`; a database keeps the engine that it was made on [default: redb]
    #[arg(long, value_name = "ENGINE")]
    pub(super) store: Option<Engine>,
    /// Identifies this boot of the machine, for a container that is restarted with the same kernel [default: the
    /// kernel's own identifier]
    #[arg(long, value_name = "TEXT", value_parser = boot_id)]
    pub(super) boot_id: Option<String>,
    /// The team whose database this robot has a copy of
    #[arg(long, value_name = "NAME", default_value = TEAM, value_parser = NonEmptyStringValueParser::new())]
    pub(super) team: String,
}

impl Arguments {
    /// Returns the folder for sockets and output.
    pub(super) fn base(&self) -> PathBuf {
        self.run_dir.clone().unwrap_or_else(run_dir::default_base)
    }

    /// Returns the paths that were given.
    pub(super) fn paths(&self) -> impl Iterator<Item = &Path> {
        self.controllers.iter().chain(&self.run_dir).chain(&self.state).map(PathBuf::as_path)
    }

    /// Returns words that mean the same options in every working folder. Paths have to be text.
    pub(super) fn words(&self) -> Vec<String> {
        let path = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned()).display().to_string();
        let mut words = vec!["--name".to_owned(), self.name.as_str().to_owned()];
        let mut option = |name: &str, value: String| words.extend([name.to_owned(), value]);
        if self.port != 0 {
            option("--port", self.port.to_string());
        }
        self.peers.iter().for_each(|peer| option("--peer", peer.clone()));
        self.controllers.iter().for_each(|program| option("--controllers", path(program)));
        self.inherited.iter().for_each(|name| option("--inherit", name.clone()));
        if let Some(grace) = self.agent_loss_grace {
            option("--agent-loss-grace", grace.as_secs_f64().to_string());
        }
        self.run_dir.iter().for_each(|folder| option("--run-dir", path(folder)));
        self.state.iter().for_each(|folder| option("--state", path(folder)));
        self.store.iter().for_each(|engine| option("--store", engine.to_string()));
        self.boot_id.iter().for_each(|boot| option("--boot-id", boot.clone()));
        if self.team != TEAM {
            option("--team", self.team.clone());
        }
        if self.insecure_lan {
            words.push("--insecure-lan".to_owned());
        }
        words
    }
}

/// Reads the name of a variable, or the beginning of such names.
fn inherited(text: &str) -> Result<String, String> {
    pattern_problem(text).map_or_else(|| Ok(text.to_owned()), Err)
}

/// Reads the address at which another node can be dialled.
fn peer(text: &str) -> Result<String, &'static str> {
    let place = text.strip_prefix("tcp/").ok_or("it must begin with `tcp/`")?;
    let (host, port) = place.rsplit_once(':').ok_or("it must end in `:` and a port")?;
    if !port.parse::<u16>().is_ok_and(|port| port > 0) {
        return Err("the port must be a number from 1 to 65535");
    }
    let is_v6 = host.strip_prefix('[').and_then(|host| host.strip_suffix(']'));
    let is_address = match is_v6 {
        Some(address) => {
            let (address, zone) =
                address.split_once('%').map_or((address, None), |(address, zone)| (address, Some(zone)));
            address.parse::<Ipv6Addr>().is_ok() && zone.is_none_or(is_interface)
        }
        None => !host.is_empty() && host.chars().all(|c| c.is_ascii_alphanumeric() || "-._".contains(c)),
    };
    if is_address { Ok(text.to_owned()) } else { Err("the address must be a name, `10.0.0.7` or `[fd00::7]`") }
}

/// Returns whether a network interface can have this name. Characters that have a meaning in zenoh's locators are not
/// permitted. Source: `dev_valid_name` of Linux.
fn is_interface(name: &str) -> bool {
    let is_plain = |c: char| c.is_ascii_graphic() && !"/:?#%[]".contains(c);
    (1..=INTERFACE_MAX).contains(&name.len()) && name.chars().all(is_plain)
}

/// Reads a name for a boot of the machine.
fn boot_id(text: &str) -> Result<String, &'static str> {
    let is_one = (1..=BOOT_ID_MAX).contains(&text.len()) && text.chars().all(|c| c.is_ascii_graphic());
    is_one.then(|| text.to_owned()).ok_or("it must have 1 to 128 visible ASCII characters")
}

/// Reads a time in seconds.
fn seconds(text: &str) -> Result<Duration, &'static str> {
    let seconds = text.parse().ok().filter(|seconds| (0.0..=SECONDS_MAX).contains(seconds));
    seconds.map(Duration::from_secs_f64).ok_or("it must be a number of seconds from 0 to 86400")
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
        let zones = ["tcp/[fe80::1%]:1", "tcp/[fe80::1%a b]:1", "tcp/[fe80::1%a#iface=b]:1", "tcp/[fe80::1%a/../b]:1"];
        for bad in bad.into_iter().chain(zones) {
            assert!(peer(bad).is_err(), "{bad}");
        }
    }

    /// Reads options as `dca-node` does.
    fn read(words: &[String]) -> clap::error::Result<Arguments> {
        #[derive(clap::Parser)]
        struct Alone {
            #[command(flatten)]
            arguments: Arguments,
        }
        let words = std::iter::once("dca-node").chain(words.iter().map(String::as_str));
        <Alone as clap::Parser>::try_parse_from(words).map(|read| read.arguments)
    }

    #[test]
    fn the_words_of_all_options_are_read_as_the_same_options() {
        let all = "--name c1 --port 7000 --peer tcp/1.2.3.4:1 --peer tcp/[::1]:2 --controllers /bin/x --agent-loss-grace 2.5 \
                   --run-dir /run/x --state /var/x --store sled --boot-id b7 --team ours --insecure-lan";
        let all: Vec<String> = all.split_whitespace().map(str::to_owned).collect();
        assert_eq!(read(&all).unwrap().words(), all);
        assert_eq!(read(&all[..2]).unwrap().words(), all[..2]);
        let relative = [&all[..2], &["--state".to_owned(), "x".to_owned()]].concat();
        assert!(Path::new(read(&relative).unwrap().words().last().unwrap()).is_absolute());
    }

    #[test]
    fn a_team_has_a_name() {
        assert!(read(&["--name", "c1", "--team", ""].map(str::to_owned)).is_err());
    }

    #[test]
    fn a_boot_has_a_name() {
        assert_eq!(boot_id("4f1c-7"), Ok("4f1c-7".to_owned()));
        for bad in ["", "a b", "a\nb", "ä", &"x".repeat(129)] {
            assert!(boot_id(bad).is_err(), "{bad:?}");
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
