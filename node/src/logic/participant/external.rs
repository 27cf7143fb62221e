//! Processes of other deployments that this one uses. They are looked up while everything is prepared, called while it
//! runs, and never started or stopped. An activation of such a process watches it: it aborts when the other deployment
//! ends the process, and is stopped at once.
//!
//! After each input the agent checks whether such a process is unchanged (`agent/external.rs`). A process that its own
//! deployment starts again stays active during the restart, as for its own supervisor, and its callers are then told
//! its new address.

use super::{Participant, Phase};
use crate::logic::effect::Out;
use crate::logic::executer::leaf_host;
use crate::logic::programs::Programs;
use crate::logic::protocol::{Change, Ending, Failure, FailureCause, LeafFacts, ProcessStatus, Target};
use crate::logic::wiring::partners;
use comms::logic::control::{Location, Order, Partner};
use language::plan::{External, Plan, Transfer};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A process that another deployment runs on this host.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Seen {
    location: Location,
    /// The devices whose keys are its own.
    owns: Vec<String>,
    is_active: bool,
}

/// A process of another deployment that this one uses.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct ExternalProcess {
    /// The last state seen, or why the process is not there.
    seen: Result<Seen, String>,
    /// The activation that has not ended.
    current: Option<u32>,
}

/// The use that a plan makes of a process of another deployment.
#[derive(Clone, Debug)]
pub struct Wanted<'a> {
    /// The process.
    pub external: &'a External,
    /// Its type.
    pub module: &'a str,
    /// The procedures and states that are called.
    pub exports: Vec<&'a str>,
}

impl<'a> Wanted<'a> {
    /// Returns the use that a plan makes of a process of another deployment at a leaf; nothing if the leaf is not such
    /// a process.
    pub fn of(plan: &'a Plan, leaf: u32) -> Option<Self> {
        let calls = plan.wires.iter().filter(|wire| wire.to.leaf == leaf && wire.transfer == Transfer::Call);
        let exports = calls.map(|wire| wire.to.port.as_str()).collect();
        Some(Self { external: plan.external(leaf)?, module: &plan.leaves.get(leaf as usize)?.module, exports })
    }
}

impl Participant {
    /// Returns the leaves of this host that stand for processes of other deployments.
    pub fn externals(&self) -> Vec<u32> {
        self.externals.keys().copied().collect()
    }

    /// Returns the program that another deployment means by a path.
    pub fn served(&self, path: &str) -> Option<u32> {
        let is_meant = |leaf: &u32| self.path(*leaf) == Some(path) && !self.is_succeeded(*leaf);
        self.instances.iter().map(|(leaf, _)| leaf).find(is_meant)
    }

    /// Returns what another deployment sees of a process here.
    ///
    /// # Errors
    /// Why it cannot be used, for a person.
    pub fn show(&self, wanted: &Wanted<'_>, programs: &Programs) -> Result<Seen, String> {
        let Wanted { external, module, exports } = wanted;
        let name = &external.deployment;
        match self.phase {
            Phase::Preparing | Phase::Connecting => return Err(format!("`{name}` does not run yet")),
            Phase::Leaving => return Err(format!("`{name}` has ended")),
            Phase::Running => {}
        }
        let here = self.served(&external.path);
        let found = here.and_then(|leaf| Some((leaf, self.site.plan.leaves.get(leaf as usize)?)));
        let Some((leaf, found)) = found else {
            return Err(format!("`{name}` runs no `{}` there", external.path));
        };
        if found.module != *module {
            return Err(format!("{external} is a `{}`, not a `{module}`", found.module));
        }
        if let Some(known) = programs.exports(module)
            && let Some(missing) = exports.iter().find(|export| !known.contains_key(**export))
        {
            return Err(format!("{external} has no `{missing}`: its `{module}` is another one"));
        }
        let instance = self.instances.get(leaf).filter(|instance| instance.has_joined());
        let facts = self.links.registrations.facts.get(&leaf);
        let found = facts.and_then(|facts| Some((facts.location.clone()?, facts.owns.clone())));
        match instance.zip(found) {
            Some((instance, _)) if instance.is_gone() => Err(format!("{external} has died")),
            Some((instance, (location, owns))) => Ok(Seen { location, owns, is_active: instance.is_active() }),
            None => Err(format!("{external} is not there")),
        }
    }

    /// Takes note of the processes of other deployments that it uses here. A missing process is a reason against it.
    pub(super) fn find_externals(&mut self, all: BTreeMap<u32, Result<Seen, String>>) {
        for (leaf, seen) in all {
            match &seen {
                Ok(seen) => self.roll.facts.push(facts(leaf, seen)),
                Err(why) => {
                    let path = self.path(leaf).unwrap_or_default();
                    self.roll
                        .reasons
                        .push(format!("host `{}`: `{path}` runs in another deployment: {why}", self.site.host));
                }
            }
            self.externals.insert(leaf, ExternalProcess { seen, current: None });
        }
    }

    /// Begins to watch a process of another deployment, for its supervisor here.
    pub(super) fn attach(&mut self, leaf: u32, activation: u32, out: &mut Out<'_>) {
        let Some(process) = self.externals.get_mut(&leaf) else { return };
        if process.current.replace(activation) == Some(activation) {
            return;
        }
        self.happened(Target::Leaf(leaf), Change::Activated, out);
        self.end_if_over(leaf, out);
    }

    /// Stops watching a process of another deployment.
    pub(super) fn detach(&mut self, leaf: u32, activation: u32, out: &mut Out<'_>) {
        if let Some(process) = self.externals.get_mut(&leaf)
            && process.current == Some(activation)
        {
            self.end_watch(leaf, Ending::Stopped, out);
        }
    }

    /// Takes note of the present state of a process of another deployment.
    pub fn sees(&mut self, leaf: u32, seen: Result<Seen, String>, out: &mut Out<'_>) {
        let Some(process) = self.externals.get_mut(&leaf).filter(|process| process.seen != seen) else { return };
        process.seen = seen;
        if let Ok(seen) = &process.seen {
            let facts = facts(leaf, seen);
            if self.links.registrations.facts.get(&leaf) != Some(&facts) {
                self.tell_where(&facts, out);
                self.moved(facts, out);
            }
        }
        self.end_if_over(leaf, out);
    }

    fn end_if_over(&mut self, leaf: u32, out: &mut Out<'_>) {
        let Some(ExternalProcess { seen, current: Some(_) }) = self.externals.get(&leaf) else { return };
        let why = match seen {
            Ok(seen) if seen.is_active => return,
            Ok(_) => {
                let external = self.site.plan.external(leaf).map(ToString::to_string).unwrap_or_default();
                format!("{external} is not active")
            }
            Err(why) => why.clone(),
        };
        let origin = self.path(leaf).unwrap_or_default().to_owned();
        let failure = Failure { origin, cause: FailureCause::NotAvailable(why), at: self.since_go(out.now) };
        self.end_watch(leaf, Ending::Aborted(failure), out);
    }

    fn end_watch(&mut self, leaf: u32, ending: Ending, out: &mut Out<'_>) {
        let watched = self.externals.get_mut(&leaf).and_then(|process| process.current.take());
        let Some(activation) = watched else { return };
        let target = Target::Leaf(leaf);
        self.happened(target, Change::Ended(ending.clone()), out);
        self.tell_supervisor(target, activation, ending, out);
    }

    /// Returns which programs call a process of another deployment, by their keys; none outside of a team.
    pub fn callers(&self, leaf: u32) -> Vec<Partner> {
        let is_linked = matches!(self.phase, Phase::Connecting | Phase::Running);
        let partners = || partners(&self.site.plan, &self.site.deployment, &self.links.registrations, leaf);
        is_linked.then(partners).flatten().unwrap_or_default()
    }

    /// Takes note of which programs of other deployments call programs here, and tells those.
    pub fn serve(&mut self, clients: BTreeMap<u32, Vec<Partner>>, out: &mut Out<'_>) {
        if self.links.clients == clients {
            return;
        }
        let before = std::mem::replace(&mut self.links.clients, clients);
        let all: Vec<u32> = before.keys().chain(self.links.clients.keys()).copied().collect();
        for leaf in all.into_iter().filter(|leaf| before.get(leaf) != self.links.clients.get(leaf)).collect::<Vec<_>>()
        {
            if let Some(order) = self.partners(leaf) {
                self.with_instance(leaf, out, |instance, context| instance.relink(order, context));
            }
        }
    }

    /// Returns the order that tells a program the other ends of its wires, and its callers from other deployments.
    pub(super) fn partners(&self, leaf: u32) -> Option<Order> {
        let mut partners = partners(&self.site.plan, &self.site.deployment, &self.links.registrations, leaf)?;
        partners.extend(self.links.clients.get(&leaf).into_iter().flatten().cloned());
        Some(Order::Partners { partners })
    }

    /// Returns the processes of other deployments, as shown to users.
    pub(super) fn external_status(&self) -> impl Iterator<Item = ProcessStatus> + '_ {
        self.externals.iter().filter_map(|(leaf, process)| {
            let found = self.site.plan.leaves.get(*leaf as usize)?;
            let external = found.external.as_ref()?;
            let state = match (&process.seen, process.current) {
                (Ok(_), Some(_)) => format!("running: {external}"),
                (Ok(_), None) => format!("idle: {external}"),
                (Err(why), _) => format!("not there: {why}"),
            };
            Some(ProcessStatus {
                path: found.path.clone(),
                kind: found.module.clone(),
                state,
                pid: None,
                activity: None,
            })
        })
    }

    /// Returns whether this host has to report the facts of a leaf.
    pub(super) fn is_own(&self, facts: &LeafFacts) -> bool {
        let is_here = leaf_host(&self.site.plan, facts.leaf) == Some(self.site.host.as_str());
        is_here && (self.instances.contains(facts.leaf) || self.externals.contains_key(&facts.leaf))
    }
}

fn facts(leaf: u32, seen: &Seen) -> LeafFacts {
    LeafFacts { location: Some(seen.location.clone()), owns: seen.owns.clone(), ..LeafFacts::plain(leaf) }
}
