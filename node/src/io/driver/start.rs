//! The beginning of a node: its folder, the state of the previous node, the types of its programs, and the options of its
//! database.

use super::{Config, adoption};
use crate::io::cgroup;
use crate::io::child::leftovers;
use crate::io::database::{self, DatabaseThread};
use crate::io::event::Event;
use crate::io::folder::FolderError;
use crate::io::input_log::InputLog;
use crate::io::journal::Journal;
use crate::io::kept::KeptFiles;
use crate::io::peers::Arrival;
use crate::io::policy::ExecutionPolicy;
use crate::io::program_database::ProgramDatabase;
use crate::io::programs;
use crate::io::run_dir::{self, PROGRAMS, RunDir, VISITORS};
use crate::io::secrets::Secrets;
use crate::io::starter::Starter;
use crate::io::state_dir;
use crate::logic::agent::{Agent, Identity};
use crate::logic::database::program::Access;
use crate::logic::node_state::NodeState;
use crate::logic::programs::Programs;
use crate::logic::protocol::{Earlier, Network};
use anyhow::Context;
use comms::io::session::{NodeOptions, Reach};
use comms::io::{clock, file};
use comms::logic::key::HostName;
use language::plan::{BRIDGE, BRIDGE_PROGRAM, PORTS, PORTS_PROGRAM};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tokio::sync::mpsc::{Receiver, Sender};

pub(super) fn database_options(config: &Config, dir: &RunDir) -> database::Options {
    database::Options {
        robot: config.name.clone(),
        team: config.database.team.clone(),
        folder: config.state.clone(),
        store: config.database.store,
        scratch: dir.path().to_owned(),
        proof: dir.proof().to_owned(),
        member: config.network.member.clone(),
        founds: config.database.founds,
    }
}

/// Returns the starter of programs, which opens their secrets with the keys of this node.
pub(super) fn starter(
    config: &Config,
    database: &DatabaseThread,
    policy: ExecutionPolicy,
    events: Sender<Event>,
) -> Starter {
    let secrets = Arc::new(Secrets::new(config.network.member.clone(), database.handle().clone(), &config.name));
    let access = Access { robot: config.name.clone(), is_team: config.network.member.is_some() };
    let database = ProgramDatabase::new(database.handle().clone(), access, Arc::clone(&secrets));
    Starter::new(programs::beside("dca-shim"), policy, secrets, database, events)
}

/// Opens the journal: in the state that survives the node, if it has one.
pub(super) fn journal(config: &Config, dir: &RunDir) -> anyhow::Result<Journal> {
    let (path, option) = match &config.state {
        Some(state) => (state.join("journal"), state_dir::OPTION),
        None => (dir.journal(), run_dir::OPTION),
    };
    Ok(Journal::open(&path).map_err(|cause| FolderError::kept(&path, cause, option))?)
}

/// The file in a node's folder that names its team.
const TEAM: &str = "team";
/// The longest such file that is read, in bytes.
const TEAM_MAX: usize = 4096;

/// Writes the files about this node: its team, which others on this machine check before they dial it, the place of its
/// state, and the credentials of its programs.
pub(super) fn show_team(config: &Config, dir: &RunDir) -> anyhow::Result<()> {
    let path = dir.path().join(TEAM);
    let written = file::write(&path, team(config).as_bytes());
    written.map_err(|cause| FolderError::kept(&path, cause, run_dir::OPTION))?;
    if let Some(state) = &config.state {
        state_dir::tell(dir.path(), state)?;
    }
    match &config.network.member {
        Some(member) => member.vouch(&dir.path().join(VISITORS), &programs_identity(dir)),
        None => {
            // The files of an earlier node.
            [VISITORS, PROGRAMS].iter().for_each(|file| drop(std::fs::remove_file(dir.path().join(file))));
            Ok(())
        }
    }
}

/// Returns the file with the credentials that programs of a node have for its team.
pub(super) fn programs_identity(dir: &RunDir) -> PathBuf {
    dir.path().join(PROGRAMS)
}

/// Returns the options of the session of the node.
pub(super) fn session_options(config: &Config, dir: &RunDir) -> anyhow::Result<NodeOptions> {
    Ok(NodeOptions {
        name: HostName::parse(&config.name)?,
        socket: dir.socket(),
        reach: config.network.reach.clone(),
        port: config.network.port,
        peers: siblings(config)?.into_iter().chain(config.network.peers.iter().cloned()).collect(),
    })
}

/// Returns the locators of the other nodes of this machine that are of the same team, or of none as this one.
fn siblings(config: &Config) -> anyhow::Result<Vec<String>> {
    let others = run_dir::running(&config.base)?.into_iter().filter(|(name, _)| *name != config.name);
    let others = others.filter(|(_, socket)| is_of_team(config, socket));
    Ok(others.map(|(_, socket)| format!("unixsock-stream/{}", socket.display())).collect())
}

/// Returns whether the node that listens on a socket of this machine is in the same team, or, like this node, in no team. A node
/// writes that down before it looks for others. So if two nodes start at once, one of them sees the other.
fn is_of_team(config: &Config, socket: &Path) -> bool {
    file::bytes(&socket.with_file_name(TEAM), TEAM_MAX).is_ok_and(|other| other == team(config).as_bytes())
}

fn team(config: &Config) -> String {
    config.network.member.as_ref().map(|member| member.team().id().to_string()).unwrap_or_default()
}

/// Returns the peers that the node accepts over the network.
pub(super) fn network(config: &Config) -> Network {
    match (&config.network.member, &config.network.reach) {
        (Some(member), _) => Network::Team { name: member.team().name().to_string() },
        (None, Reach::Host) => Network::Host,
        (None, Reach::Lan | Reach::Team(_)) => Network::Insecure,
    }
}

/// Passes arrivals from the network on to the loop.
pub(super) async fn forward(mut arrivals: Receiver<Arrival>, events: Sender<Event>) {
    while let Some(arrival) = arrivals.recv().await {
        if events.send(Event::Arrival(arrival)).await.is_err() {
            return;
        }
    }
}

/// Asks the programs of controllers for their interfaces.
pub(super) async fn offered(config: &Config) -> anyhow::Result<Programs> {
    let mut offered = Programs::default();
    for program in programs::chosen(&config.programs.controllers) {
        let asked = program.clone();
        let interface = tokio::task::spawn_blocking(move || programs::interfaces(&asked)).await??;
        offered.declare(&program.display().to_string(), interface);
    }
    for (program, module) in [(BRIDGE_PROGRAM, BRIDGE), (PORTS_PROGRAM, PORTS)] {
        let program = programs::beside(program);
        if program.is_file() {
            offered.offer(&program.display().to_string(), [module.to_owned()]);
        }
    }
    Ok(offered)
}

/// Returns the initial state of a node: the previous node's, if it is adopted.
pub(super) fn state(
    before: Option<NodeState>,
    offered: Programs,
    is_guarded: bool,
    identity: impl FnOnce() -> Identity,
) -> NodeState {
    if let Some(mut state) = before {
        state.agent.move_to(std::process::id(), offered, is_guarded);
        return state;
    }
    let now = clock::now();
    NodeState::new(Agent::new(identity(), offered, now), now)
}

/// Takes the folder of the node, and adopts the remains of a killed node of its name, if possible. The others are
/// ended. Moves into a control group of its own.
pub(super) async fn take_folder(config: &Config, machine: &str) -> anyhow::Result<(RunDir, Option<NodeState>)> {
    let (base, name, adopts) = (config.base.clone(), config.name.clone(), config.adopts);
    let machine = life(config, machine);
    let taking = tokio::task::spawn_blocking(move || {
        let dir = RunDir::take(&base, &name)?;
        if let Some(pid) = leftovers::living_node(dir.path()) {
            anyhow::bail!(
                "a node named `{name}` is already running on this machine, as process {pid}, and its folder `{}` was taken away: end it with \
                 `kill {pid}`, which stops its programs, then start this one again",
                dir.path().display()
            );
        }
        dir.remove_socket()?;
        let mut inputs = InputLog::new(dir.path(), &machine, adopts);
        if let Some(state) = adopts.then(|| adoption::replay(&inputs)).flatten() {
            adoption::end_strangers(&dir, &state);
            cgroup::enter_recorded(dir.path());
            return anyhow::Ok((dir, Some(state)));
        }
        inputs.remove();
        leftovers::tell_left(&leftovers::end_all(dir.path()), dir.path());
        dir.clear();
        Ok((dir, None))
    });
    let (dir, state) = taking.await??;
    cgroup::enter(dir.path());
    // The orphans of a killed shim become children of this process, which ends them.
    rustix::process::set_child_subreaper(Some(rustix::process::getpid())).context("becoming the parent of orphans")?;
    Ok((dir, state))
}

/// Identifies the boot of the machine, by the configuration or by the kernel.
fn boot(config: &Config) -> String {
    let of_kernel = || std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default().trim().to_owned();
    config.boot.clone().unwrap_or_else(of_kernel)
}

/// Names the conditions under which a node can adopt programs: the same boot of the machine, and the same network.
pub(super) fn life(config: &Config, machine: &str) -> String {
    config.boot.as_ref().map_or_else(|| machine.to_owned(), |boot| format!("{machine} {boot}"))
}

/// Returns the files that survive a reboot, and their content.
pub(super) async fn kept(config: &Config) -> anyhow::Result<(KeptFiles, Earlier)> {
    // A node that adopts nothing belongs to one command, and so do its programs.
    let (state, boot) = (config.state.clone().filter(|_| config.adopts), boot(config));
    Ok(tokio::task::spawn_blocking(move || KeptFiles::open(state, &boot)).await?)
}

/// Stands for a machine, its network and a run folder: [`Pong::origin`](crate::logic::protocol::Pong::origin).
pub(super) fn origin(machine: &str, folder: &Path) -> u32 {
    crc32fast::hash([machine.as_bytes(), b" ", folder.as_os_str().as_bytes()].concat().as_slice())
}

/// Names the machine and its network: the kernel's boot and the network namespace.
pub(super) fn machine() -> String {
    let boot = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
    let network = std::fs::read_link("/proc/self/ns/net").unwrap_or_default();
    format!("{} {}", boot.trim(), network.display())
}
