//! The state of a participant, as shown to users.

use super::{Participant, Phase};
use crate::logic::executer::Executer;
use crate::logic::instance::Instance;
use crate::logic::parameters;
use crate::logic::programs::Programs;
use crate::logic::protocol::{AbsentProcess, DeploymentStatus, InstanceParameters, Names, PortName, ProcessStatus};
use crate::logic::wiring::observe;
use comms::logic::control::Dial;
use language::plan::{Leaf, LeafKind, Parameter};
use std::collections::BTreeSet;

impl Participant {
    /// Returns how many of its machines were looked at, all in all.
    pub fn visits(&self) -> u64 {
        self.instances.visits() + self.executers.visits()
    }

    /// Returns the running processes, in the plan's order.
    pub fn status(&self) -> DeploymentStatus {
        let live = self.site.plan.live_groups();
        let group = |(number, executer): (u32, &Executer)| {
            let group = self.site.plan.groups.get(number as usize).filter(|_| live.contains(&number))?;
            let (path, kind) = (group.path.clone(), group.process.clone());
            let words = std::iter::once(executer.state().to_owned())
                .chain(executer.states())
                .chain(executer.waits(&self.site.plan));
            let state = words.collect::<Vec<_>>().join("; ");
            Some(ProcessStatus { path, kind, state, pid: None, activity: executer.activity(&self.site.plan) })
        };
        let leaf = |(number, instance): (u32, &Instance)| {
            let leaf = self.site.plan.leaves.get(number as usize)?;
            let (path, kind) = (leaf.path.clone(), leaf.module.clone());
            let state = match self.is_succeeded(number) {
                true => format!("{}; the program before", instance.state()),
                false => instance.state(),
            };
            Some(ProcessStatus { path, kind, state, pid: instance.pid(), activity: None })
        };
        let mut processes: Vec<ProcessStatus> =
            self.executers.iter().filter_map(group).chain(self.instances.iter().filter_map(leaf)).collect();
        processes.extend(self.external_status());
        processes.sort_by(|a, b| a.path.cmp(&b.path));
        let phase = match self.phase {
            Phase::Preparing => "preparing",
            Phase::Connecting => "connecting",
            Phase::Running => "running",
            Phase::Leaving => "ending",
        };
        let (deployment, home) = (self.site.deployment.clone(), self.site.home.clone());
        DeploymentStatus { deployment, home, phase: phase.to_owned(), processes, lost: Vec::new(), refused: Vec::new() }
    }

    /// Returns the ends of a wire, for users.
    pub fn wire(&self, number: u32) -> Option<String> {
        self.site.plan.wires.get(number as usize).map(|wire| self.site.plan.ends(wire))
    }

    /// Returns the processes on hosts that are away.
    pub fn elsewhere(&self, is_away: impl Fn(&str) -> bool) -> Vec<AbsentProcess> {
        let away: Vec<bool> = self.site.plan.hosts.iter().map(|host| is_away(host)).collect();
        let process = |host: u32, path: &str, kind: &str| {
            let is_meant = away.get(host as usize).copied().unwrap_or_default();
            let host = self.site.plan.hosts.get(host as usize).filter(|_| is_meant)?.clone();
            let (deployment, path, kind) = (self.site.deployment.clone(), path.to_owned(), kind.to_owned());
            Some(AbsentProcess { deployment, host, path, kind })
        };
        let (leaves, groups) = (self.site.plan.live_leaves(), self.site.plan.live_groups());
        let groups = groups.iter().filter_map(|number| self.site.plan.groups.get(*number as usize));
        let groups = groups.filter_map(|group| process(group.host, &group.path, &group.process));
        let leaves = leaves.iter().filter_map(|number| self.site.plan.leaves.get(*number as usize));
        groups.chain(leaves.filter_map(|leaf| process(leaf.host, &leaf.path, &leaf.module))).collect()
    }

    /// Adds the names that it has given out on this host.
    pub fn names(&self, programs: &Programs, names: &mut Names) {
        let ends = self.site.plan.wires.iter().flat_map(|wire| [(&wire.from, true), (&wire.to, false)]);
        let ports = ends.filter_map(|(end, is_output)| {
            let leaf = self.site.plan.leaves.get(end.leaf as usize).filter(|_| self.instances.contains(end.leaf))?;
            let kind = programs.port_type(&leaf.module, &end.port).map(str::to_owned);
            let (deployment, path, port) = (self.site.deployment.clone(), leaf.path.clone(), end.port.clone());
            Some(PortName { deployment, path, port, is_output, kind })
        });
        // One port may have several wires.
        names.ports.extend(ports.collect::<BTreeSet<_>>());
        names.devices.extend(self.claims.names(&self.site.deployment));
    }

    /// Returns the programs of this host that have a data session, and where to dial each now.
    pub fn locations(&self) -> Vec<(String, Dial)> {
        let location = |(number, instance): (u32, &Instance)| {
            let leaf = self.site.plan.leaves.get(number as usize).filter(|_| !self.is_succeeded(number))?;
            // The address of a program that has ended, and may be started again, is out of date.
            let leaf = instance.has_program().then_some(leaf)?;
            Some((leaf.path.clone(), observe(&self.links.registrations, number)?))
        };
        self.instances.iter().filter_map(location).collect()
    }

    /// Returns the parameters that can be sent to the programs of this host while they run.
    pub fn parameters(&self, programs: &Programs) -> Vec<InstanceParameters> {
        let leaves = self.instances.iter().filter_map(|(number, _)| self.site.plan.leaves.get(number as usize));
        let of_leaf = |leaf: &Leaf| {
            // The parameters of a plain program cannot be changed while it runs.
            let secrets = parameters::of_plain(&leaf.arguments);
            let declared = match leaf.kind {
                LeafKind::Controller => declared(leaf, programs),
                LeafKind::Plain => Some(&secrets[..]),
            };
            InstanceParameters {
                deployment: self.site.deployment.clone(),
                path: leaf.path.clone(),
                module: leaf.module.clone(),
                parameters: declared.map(|declared| parameters::given(declared, &leaf.arguments)),
                ros_node: leaf.exec.as_deref().and_then(parameters::ros_node),
            }
        };
        leaves.map(of_leaf).collect()
    }

    /// Returns parameters that the database gives to the instance of a path, as its program gets them.
    pub fn in_si(&self, programs: &Programs, path: &str, stored: Vec<(String, String)>) -> Vec<(String, String)> {
        let live = self.site.plan.live_leaves();
        let leaves = live.iter().filter_map(|number| self.site.plan.leaves.get(*number as usize));
        let leaf = leaves.into_iter().find(|leaf| leaf.path == path);
        match leaf.and_then(|leaf| declared(leaf, programs)) {
            Some(declared) => parameters::in_si(declared, stored),
            None => stored,
        }
    }

    /// Returns the programs of this host: leaf and absolute path.
    pub fn programs(&self) -> Vec<(u32, String)> {
        let path = |(leaf, _): (u32, &Instance)| Some((leaf, self.site.plan.leaves.get(leaf as usize)?.path.clone()));
        self.instances.iter().filter(|(leaf, _)| !self.is_succeeded(*leaf)).filter_map(path).collect()
    }
}

/// Returns the parameters of a controller, as the plan says them or else its program.
fn declared<'a>(leaf: &'a Leaf, programs: &'a Programs) -> Option<&'a [Parameter]> {
    leaf.parameters.as_deref().or_else(|| programs.parameters(&leaf.module))
}
