//! The beginning of a node: its folder, the state of the node before, the types of its programs, and the options of its
//! database.

use super::{Config, adoption};
use crate::io::cgroup;
use crate::io::child::leftovers;
use crate::io::database;
use crate::io::input_log::InputLog;
use crate::io::programs;
use crate::io::run_dir::RunDir;
use crate::logic::agent::{Agent, Identity};
use crate::logic::node_state::NodeState;
use crate::logic::programs::Programs;
use anyhow::Context;
use comms::io::clock;

pub(super) fn database_options(config: &Config, dir: &RunDir) -> database::Options {
    database::Options {
        robot: config.name.clone(),
        team: config.team.clone(),
        folder: config.state.clone(),
        store: config.store,
        scratch: dir.path().to_owned(),
        proof: dir.proof().to_owned(),
        founds: config.founds,
    }
}

/// Asks the programs of controllers what they offer.
pub(super) async fn offered(config: &Config) -> anyhow::Result<Programs> {
    let mut offered = Programs::default();
    for program in programs::chosen(&config.controllers) {
        let asked = program.clone();
        let interface = tokio::task::spawn_blocking(move || programs::interfaces(&asked)).await??;
        offered.declare(&program.display().to_string(), interface);
    }
    Ok(offered)
}

/// Returns the state that a node begins with: that of the one before, if it is taken over.
pub(super) fn state(before: Option<NodeState>, offered: Programs, identity: impl FnOnce() -> Identity) -> NodeState {
    if let Some(mut state) = before {
        state.agent.move_to(std::process::id(), offered);
        return state;
    }
    let now = clock::now();
    NodeState::new(Agent::new(identity(), offered, now), now)
}

/// Takes the folder of the node, and what a node of its name that was killed has left in it, if that can be taken over. What
/// cannot is ended. Moves into a control group of its own.
pub(super) async fn take_folder(config: &Config, machine: &str) -> anyhow::Result<(RunDir, Option<NodeState>)> {
    let (base, name, adopts) = (config.base.clone(), config.name.clone(), config.adopts);
    let machine = machine.to_owned();
    let taking = tokio::task::spawn_blocking(move || {
        let dir = RunDir::take(&base, &name)?;
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
    // What a killed shim leaves behind comes to this process, which ends it.
    rustix::process::set_child_subreaper(Some(rustix::process::getpid())).context("becoming the parent of orphans")?;
    Ok((dir, state))
}

/// Names the machine and its network: the kernel's boot and the network namespace.
pub(super) fn machine() -> String {
    let boot = std::fs::read_to_string("/proc/sys/kernel/random/boot_id").unwrap_or_default();
    let network = std::fs::read_link("/proc/self/ns/net").unwrap_or_default();
    format!("{} {}", boot.trim(), network.display())
}
