//! The programs that prepare or make their links, and their reports so far. The home gets one report of this host once no
//! program is waited for: what each program has said, or every reason against this deployment.

use super::site::Site;
use crate::logic::protocol::{LeafFacts, ToCoordinator};
use crate::logic::table::counted;
use language::plan::Plan;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// The programs that prepare or make their links, and their reports so far.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Roll {
    waiting: BTreeSet<u32>,
    facts: Vec<LeafFacts>,
    reasons: Vec<String>,
    /// Why programs cannot take part, and which.
    refusals: BTreeMap<String, Vec<u32>>,
}

impl Roll {
    /// Waits for the report of a program.
    pub(super) fn wait_for(&mut self, leaf: u32) {
        self.waiting.insert(leaf);
    }

    /// Takes the facts of a process that is there.
    pub(super) fn prepared(&mut self, facts: LeafFacts) {
        self.waiting.remove(&facts.leaf);
        self.facts.push(facts);
    }

    /// Takes note that the links of a program are made.
    pub(super) fn connected(&mut self, leaf: u32) {
        self.waiting.remove(&leaf);
    }

    /// Takes the reason for which a program cannot take part.
    pub(super) fn refused(&mut self, leaf: u32, why: String) {
        self.refusals.entry(why).or_default().push(leaf);
        self.waiting.remove(&leaf);
    }

    /// Takes reasons of this host against the deployment.
    pub(super) fn object(&mut self, reasons: impl IntoIterator<Item = String>) {
        self.reasons.extend(reasons);
    }

    /// Returns whether there is a reason of this host against the deployment.
    pub(super) fn has_reasons(&self) -> bool {
        !self.reasons.is_empty()
    }

    /// Returns the report of this host that its programs are prepared; none while it waits for one.
    pub(super) fn prepared_all(&mut self, site: &Site) -> Option<ToCoordinator> {
        let reasons = self.take_reasons(&site.plan)?;
        if !reasons.is_empty() {
            return Some(ToCoordinator::Refused { reasons });
        }
        Some(ToCoordinator::Prepared { facts: std::mem::take(&mut self.facts), machine: site.machine.clone() })
    }

    /// Returns the report of this host that its programs have their links; none while it waits for one.
    pub(super) fn connected_all(&mut self, site: &Site) -> Option<ToCoordinator> {
        let reasons = self.take_reasons(&site.plan)?;
        Some(if reasons.is_empty() { ToCoordinator::Connected } else { ToCoordinator::Refused { reasons } })
    }

    /// Returns the reasons against this deployment, and clears them; none while it waits for a program. A reason that several
    /// programs share is given once: most often they are of one executable.
    fn take_reasons(&mut self, plan: &Plan) -> Option<Vec<String>> {
        if !self.waiting.is_empty() {
            return None;
        }
        let mut reasons = std::mem::take(&mut self.reasons);
        for (why, leaves) in std::mem::take(&mut self.refusals) {
            let leaf = leaves.first().and_then(|leaf| plan.leaves.get(*leaf as usize));
            let others = match leaves.len() {
                0 | 1 => String::new(),
                count => format!(" (and {})", counted(count - 1, "other")),
            };
            reasons.extend(leaf.map(|leaf| {
                let host = plan.hosts.get(leaf.host as usize).map_or("", String::as_str);
                format!("`{}`{others} cannot take part on `{host}`: {why}", leaf.path)
            }));
        }
        Some(reasons)
    }
}
