//! The start of a deployment at its home: every host prepares, every host connects, then GO.

use super::{CONNECT_WITHIN, Coordinator, PREPARE_WITHIN, Phase, REASONS_WITHIN};
use crate::logic::effect::Out;
use crate::logic::instance::watchdog::{READY_WITHIN, ready_within};
use crate::logic::protocol::{LeafFacts, Report, Target, ToParticipant};
use crate::logic::wiring::observe;
use language::plan::Plan;
use std::time::Duration;

/// Returns how long hosts have to start their programs: the plan may let one take longer than usual.
pub(super) fn prepare_within(plan: &Plan) -> Duration {
    let slowest = plan.leaves.iter().map(|leaf| ready_within(&leaf.policy)).max().unwrap_or_default();
    PREPARE_WITHIN + slowest.saturating_sub(READY_WITHIN)
}

impl Coordinator {
    /// Takes note of the user who has deployed it.
    pub fn begun_for(&mut self, by: &str) {
        by.clone_into(&mut self.begun_by);
    }

    /// Returns the user who has deployed it.
    pub fn begun_by(&self) -> &str {
        &self.begun_by
    }

    /// Takes note that it is resumed after a reboot: a user has deployed it under this epoch.
    pub fn resumes(&mut self, origin: u64) {
        self.origin = origin;
    }

    /// Returns the epoch under which a user has deployed it.
    pub fn origin(&self) -> u64 {
        if self.origin == 0 { self.deployment.epoch } else { self.origin }
    }

    /// Returns whether nothing is left to be done.
    pub fn is_over(&self) -> bool {
        self.phase == Phase::Over
    }

    pub(super) fn prepared(&mut self, from: &str, facts: Vec<LeafFacts>, machine: &str, out: &mut Out<'_>) {
        self.waiting.remove(from);
        self.register(from, facts, machine, out);
        if !self.waiting.is_empty() {
            return;
        }
        if !self.reasons.is_empty() {
            return self.end(None, out);
        }
        self.phase = Phase::Connecting;
        self.deadline = Some(out.now + CONNECT_WITHIN);
        self.waiting = self.hosts.iter().cloned().collect();
        self.hosts.iter().for_each(|host| self.have_connected(host, out));
    }

    /// Notes where the programs of a host are.
    pub(super) fn register(&mut self, host: &str, facts: Vec<LeafFacts>, machine: &str, out: &mut Out<'_>) {
        let leaves = u32::try_from(facts.len()).unwrap_or(u32::MAX);
        self.registrations.facts.extend(facts.into_iter().map(|facts| (facts.leaf, facts)));
        let theirs = self.hosts.iter().zip(&mut self.registrations.machines).filter(|(other, _)| *other == host);
        theirs.for_each(|(_, known)| machine.clone_into(known));
        self.report(Report::Prepared { host: host.to_owned(), leaves }, out);
    }

    /// Has a host make its links, with all that is known of where programs are.
    pub(super) fn have_connected(&self, host: &str, out: &mut Out<'_>) {
        let facts = self.registrations.facts.values().cloned().collect();
        let machines = self.registrations.machines.clone();
        out.send(host, self.deployment.to_participant(ToParticipant::Connect { facts, machines }));
    }

    pub(super) fn connected(&mut self, from: &str, out: &mut Out<'_>) {
        self.waiting.remove(from);
        self.report(Report::Connected { host: from.to_owned() }, out);
        self.go_if_ready(out);
    }

    pub(super) fn go_if_ready(&mut self, out: &mut Out<'_>) {
        if self.phase == Phase::Connecting && self.waiting.is_empty() && self.committed && self.clocks_are_read(out) {
            self.go(out);
        }
    }

    /// The other hosts get a moment to say what is wrong with them, too.
    pub(super) fn refused(&mut self, from: &str, reasons: Vec<String>, out: &mut Out<'_>) {
        self.reasons.extend(reasons);
        self.waiting.remove(from);
        if self.waiting.is_empty() {
            self.end(None, out);
        } else {
            let soon = out.now + REASONS_WITHIN;
            self.deadline = Some(self.deadline.map_or(soon, |at| at.min(soon)));
        }
    }

    pub(super) fn go(&mut self, out: &mut Out<'_>) {
        self.phase = Phase::Running;
        self.deadline = None;
        self.go_at = Some(out.now);
        let signals = self.registrations.facts.values().filter(|facts| facts.signals).filter_map(|facts| {
            let leaf = self.plan.leaves.get(facts.leaf as usize)?;
            let dial = observe(&self.registrations, facts.leaf)?;
            Some((leaf.path.clone(), dial))
        });
        let signals = signals.collect();
        let start = self.start_on_hosts(out);
        self.report(Report::Go { took: out.now - self.begun, signals }, out);
        // What other deployments run is looked at there.
        let own = self.registrations.facts.keys().filter(|leaf| self.plan.external(**leaf).is_none());
        let programs = own.filter_map(|leaf| {
            let path = self.plan.leaves.get(*leaf as usize)?.path.clone();
            Some((path, observe(&self.registrations, *leaf)?))
        });
        let at = programs.collect();
        self.report(Report::Programs { at }, out);
        for host in &self.hosts {
            let at = start.get(host).map(|start| ToParticipant::GoAt { start: *start });
            out.send(host, self.deployment.to_participant(at.unwrap_or(ToParticipant::Go)));
        }
        let Some(home) = self.plan.home().map(str::to_owned) else { return };
        let order = ToParticipant::Activate { target: Target::Group(0), activation: 1, value: Vec::new() };
        out.send(&home, self.deployment.to_participant(order));
    }
}
