//! The processes of a participant, as shown to users.

use super::links::Links;
use super::processes::Processes;
use super::site::Site;
use crate::logic::executer::Executer;
use crate::logic::instance::Instance;
use crate::logic::parameters;
use crate::logic::programs::Programs;
use crate::logic::protocol::{AbsentProcess, InstanceParameters, PortName, ProcessStatus};
use comms::logic::control::Dial;
use language::plan::{Leaf, LeafKind, LeafPort, Parameter};
use std::collections::BTreeSet;

impl Processes {
    /// Returns the groups that are in the plan, and the programs, in the plan's order.
    pub(super) fn status(&self, site: &Site) -> impl Iterator<Item = ProcessStatus> {
        let live = site.plan.live_groups();
        let group = move |(number, executer): (u32, &Executer)| {
            let group = site.plan.groups.get(number as usize).filter(|_| live.contains(&number))?;
            let (path, kind) = (group.path.clone(), group.process.clone());
            let words =
                std::iter::once(executer.state().to_owned()).chain(executer.states()).chain(executer.waits(&site.plan));
            let state = words.collect::<Vec<_>>().join("; ");
            Some(ProcessStatus { path, kind, state, pid: None, activity: executer.activity(&site.plan) })
        };
        let leaf = |(number, instance): (u32, &Instance)| {
            let leaf = site.leaf(number)?;
            let (path, kind) = (leaf.path.clone(), leaf.module.clone());
            let state = match site.is_succeeded(number) {
                true => format!("{}; the program before", instance.state()),
                false => instance.state(),
            };
            Some(ProcessStatus { path, kind, state, pid: instance.pid(), activity: None })
        };
        self.executers.iter().filter_map(group).chain(self.instances.iter().filter_map(leaf))
    }

    /// Returns the names of the ports of the programs.
    pub(super) fn port_names(&self, site: &Site, programs: &Programs) -> BTreeSet<PortName> {
        let ends = site.plan.wires.iter().flat_map(|wire| [(&wire.from, true), (&wire.to, false)]);
        let port = |(end, is_output): (&LeafPort, bool)| {
            let leaf = site.leaf(end.leaf).filter(|_| self.instances.contains(end.leaf))?;
            let kind = programs.port_type(leaf, &end.port).map(str::to_owned);
            let (deployment, path, port) = (site.deployment.clone(), leaf.path.clone(), end.port.clone());
            Some(PortName { deployment, path, port, is_output, kind })
        };
        // One port may have several wires.
        ends.filter_map(port).collect()
    }

    /// Returns the programs that have a data session, and where to dial each now.
    pub(super) fn locations(&self, site: &Site, links: &Links) -> Vec<(String, Dial)> {
        let location = |(number, instance): (u32, &Instance)| {
            let leaf = site.leaf(number).filter(|_| !site.is_succeeded(number))?;
            // The address of a program that has ended, and may be started again, is out of date.
            let leaf = instance.has_program().then_some(leaf)?;
            Some((leaf.path.clone(), links.dial(number)?))
        };
        self.instances.iter().filter_map(location).collect()
    }

    /// Returns the parameters that can be sent to the programs while they run.
    pub(super) fn parameters(&self, site: &Site, programs: &Programs) -> Vec<InstanceParameters> {
        let leaves = self.instances.iter().filter_map(|(number, _)| site.leaf(number));
        let of_leaf = |leaf: &Leaf| {
            // The parameters of a plain program cannot be changed while it runs.
            let secrets = parameters::of_plain(&leaf.arguments);
            let declared = match leaf.kind {
                LeafKind::Controller => declared(leaf, programs),
                LeafKind::Plain => Some(&secrets[..]),
            };
            InstanceParameters {
                deployment: site.deployment.clone(),
                path: leaf.path.clone(),
                module: leaf.module.clone(),
                parameters: declared.map(|declared| parameters::given(declared, &leaf.arguments)),
                ros_node: leaf.exec.as_deref().and_then(parameters::ros_node),
            }
        };
        leaves.map(of_leaf).collect()
    }

    /// Returns the programs by leaf and absolute path, without those that are about to leave.
    pub(super) fn programs(&self, site: &Site) -> Vec<(u32, String)> {
        let path = |(leaf, _): (u32, &Instance)| Some((leaf, site.leaf(leaf)?.path.clone()));
        self.instances.iter().filter(|(leaf, _)| !site.is_succeeded(*leaf)).filter_map(path).collect()
    }
}

impl Site {
    /// Returns the processes on hosts that are away.
    pub(super) fn elsewhere(&self, is_away: impl Fn(&str) -> bool) -> Vec<AbsentProcess> {
        let away: Vec<bool> = self.plan.hosts.iter().map(|host| is_away(host)).collect();
        let process = |host: u32, path: &str, kind: &str| {
            let is_meant = away.get(host as usize).copied().unwrap_or_default();
            let host = self.plan.hosts.get(host as usize).filter(|_| is_meant)?.clone();
            let (deployment, path, kind) = (self.deployment.clone(), path.to_owned(), kind.to_owned());
            Some(AbsentProcess { deployment, host, path, kind })
        };
        let (leaves, groups) = (self.plan.live_leaves(), self.plan.live_groups());
        let groups = groups.iter().filter_map(|number| self.plan.groups.get(*number as usize));
        let groups = groups.filter_map(|group| process(group.host, &group.path, &group.process));
        let leaves = leaves.iter().filter_map(|number| self.leaf(*number));
        groups.chain(leaves.filter_map(|leaf| process(leaf.host, &leaf.path, &leaf.module))).collect()
    }

    /// Returns parameters that the database gives to the instance of a path, as its program gets them.
    pub(super) fn in_si(
        &self,
        programs: &Programs,
        path: &str,
        stored: Vec<(String, String)>,
    ) -> Vec<(String, String)> {
        let live = self.plan.live_leaves();
        let leaf = live.iter().filter_map(|number| self.leaf(*number)).find(|leaf| leaf.path == path);
        match leaf.and_then(|leaf| declared(leaf, programs)) {
            Some(declared) => parameters::in_si(declared, stored),
            None => stored,
        }
    }
}

/// Returns the parameters of a controller, as the plan says them or else its program.
fn declared<'a>(leaf: &'a Leaf, programs: &'a Programs) -> Option<&'a [Parameter]> {
    leaf.parameters.as_deref().or_else(|| programs.parameters(leaf))
}
