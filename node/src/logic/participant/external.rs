//! Processes of other deployments that this one uses. They are looked up while everything is prepared, called while it
//! runs, and never started or stopped. An activation of such a process watches it: it aborts when the other deployment
//! ends the process, and is stopped at once.
//!
//! After each input the agent checks whether such a process is unchanged (`agent/external.rs`). If
//! its own deployment restarts a process, the process stays active during the restart, as for its
//! own supervisor. Then its callers get its new address.

use super::site::Site;
use crate::logic::programs::Programs;
use crate::logic::protocol::{LeafFacts, ProcessStatus};
use comms::logic::control::Location;
use language::plan::{External, Leaf, Plan, Transfer};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// A process that another deployment runs on this host.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Seen {
    location: Location,
    /// The devices whose keys are its own.
    owns: Vec<String>,
    is_active: bool,
}

/// The processes of other deployments that this one uses on this host, by the leaves that stand for them.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Externals {
    all: BTreeMap<u32, ExternalProcess>,
}

/// A process of another deployment that this one uses.
#[derive(Debug, Serialize, Deserialize)]
struct ExternalProcess {
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

impl Seen {
    /// Returns a process whose program has said these facts; none if it cannot be reached.
    pub(super) fn new(facts: &LeafFacts, is_active: bool) -> Option<Self> {
        Some(Self { location: facts.location.clone()?, owns: facts.owns.clone(), is_active })
    }

    /// Returns the process as a leaf of the deployment that uses it.
    fn facts(&self, leaf: u32) -> LeafFacts {
        LeafFacts { location: Some(self.location.clone()), owns: self.owns.clone(), ..LeafFacts::plain(leaf) }
    }
}

impl<'a> Wanted<'a> {
    /// Returns the use that a plan makes of a process of another deployment at a leaf; nothing if the leaf is not such
    /// a process.
    pub fn of(plan: &'a Plan, leaf: u32) -> Option<Self> {
        let calls = plan.wires.iter().filter(|wire| wire.to.leaf == leaf && wire.transfer == Transfer::Call);
        let exports = calls.map(|wire| wire.to.port.as_str()).collect();
        Some(Self { external: plan.external(leaf)?, module: &plan.leaves.get(leaf as usize)?.module, exports })
    }

    /// Checks that a process is the wanted one.
    ///
    /// # Errors
    /// Why it is not, for a person.
    pub(super) fn check(&self, found: &Leaf, programs: &Programs) -> Result<(), String> {
        let Wanted { external, module, exports } = self;
        if found.module != *module {
            return Err(format!("{external} is a `{}`, not a `{module}`", found.module));
        }
        if let Some(known) = programs.exports(found)
            && let Some(missing) = exports.iter().find(|export| !known.contains_key(**export))
        {
            return Err(format!("{external} has no `{missing}`: it runs another version of `{module}`"));
        }
        Ok(())
    }
}

impl Externals {
    /// Takes note of a process that the plan uses here. Returns its facts.
    ///
    /// # Errors
    /// Why the process is not there.
    pub(super) fn find(&mut self, leaf: u32, seen: Result<Seen, String>) -> Result<LeafFacts, String> {
        let facts = seen.as_ref().map(|seen| seen.facts(leaf)).map_err(Clone::clone);
        self.all.insert(leaf, ExternalProcess { seen, current: None });
        facts
    }

    /// Returns the leaves that stand for processes of other deployments.
    pub(super) fn leaves(&self) -> Vec<u32> {
        self.all.keys().copied().collect()
    }

    /// Returns whether a leaf stands for a process of another deployment.
    pub(super) fn contains(&self, leaf: u32) -> bool {
        self.all.contains_key(&leaf)
    }

    /// Begins to watch a process; returns whether this activation is new.
    pub(super) fn attach(&mut self, leaf: u32, activation: u32) -> bool {
        self.all.get_mut(&leaf).is_some_and(|process| process.current.replace(activation) != Some(activation))
    }

    /// Stops watching a process; returns whether this activation was watched.
    pub(super) fn detach(&mut self, leaf: u32, activation: u32) -> bool {
        self.all.get_mut(&leaf).is_some_and(|process| process.current.take_if(|own| *own == activation).is_some())
    }

    /// Takes note of the present state of a process; returns whether it is another one.
    pub(super) fn sees(&mut self, leaf: u32, seen: Result<Seen, String>) -> bool {
        let Some(process) = self.all.get_mut(&leaf).filter(|process| process.seen != seen) else { return false };
        process.seen = seen;
        true
    }

    /// Returns the facts of a process that is there.
    pub(super) fn facts(&self, leaf: u32) -> Option<LeafFacts> {
        Some(self.all.get(&leaf)?.seen.as_ref().ok()?.facts(leaf))
    }

    /// Stops watching a process that is not active any more. Returns the activation, and why it aborts.
    pub(super) fn end_if_over(&mut self, site: &Site, leaf: u32) -> Option<(u32, String)> {
        let process = self.all.get_mut(&leaf)?;
        let why = match &process.seen {
            Ok(seen) if seen.is_active => return None,
            Ok(_) => {
                let external = site.plan.external(leaf).map(ToString::to_string).unwrap_or_default();
                format!("{external} is not active")
            }
            Err(why) => why.clone(),
        };
        Some((process.current.take()?, why))
    }

    /// Forgets the processes that the plan does not use any more.
    pub(super) fn retain(&mut self, leaves: &BTreeSet<u32>) {
        self.all.retain(|leaf, _| leaves.contains(leaf));
    }

    /// Returns the processes, as shown to users.
    pub(super) fn status(&self, site: &Site) -> impl Iterator<Item = ProcessStatus> {
        self.all.iter().filter_map(|(leaf, process)| {
            let found = site.leaf(*leaf)?;
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
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(is_active: bool) -> Result<Seen, String> {
        let location = Location { session: "b".into(), ..Location::default() };
        Ok(Seen { location, owns: Vec::new(), is_active })
    }

    /// Each activation of a process that is watched ends once: by its stop, or by the end of the process.
    #[test]
    fn an_activation_is_watched_once() {
        let mut externals = Externals::default();
        assert!(externals.find(3, seen(true)).is_ok() && externals.find(4, Err("it is not there".into())).is_err());
        assert!(externals.attach(3, 1) && !externals.attach(3, 1) && !externals.attach(5, 1));
        assert!(!externals.detach(3, 2) && externals.detach(3, 1) && !externals.detach(3, 1));
        assert!(!externals.sees(3, seen(true)) && externals.sees(3, seen(false)));
        assert!(externals.facts(3).is_some());
        assert!(externals.sees(3, Err("it has died".into())) && externals.facts(3).is_none());
        externals.retain(&BTreeSet::from([4]));
        assert_eq!(externals.leaves(), [4]);
    }
}
