//! The reports of a deployment so far: for callers that watch it, were cut off and come back, and for those that listen
//! to everything.

use crate::logic::effect::{Effect, Out};
use crate::logic::protocol::{Answer, Deployment, Event, Report};
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};

/// How many reports are kept; past that, changes of processes are left out.
const REPORTS_MAX: usize = 20_000;
/// How many events are told in one answer: a caller has room for so many answers only.
const EVENTS_IN_ONE: usize = 512;

/// The reports of one deployment, in order.
#[derive(Debug, Default, Serialize, Deserialize)]
pub struct History {
    deployment: Deployment,
    /// The hosts of its plan.
    hosts: Vec<String>,
    entries: Vec<Entry>,
    /// How many reports there were.
    count: u64,
}

/// A report, and what people want to know of it.
#[derive(Debug, Serialize, Deserialize)]
struct Entry {
    number: u64,
    at: Time,
    /// Index into the hosts of the plan.
    host: u32,
    report: Report,
}

impl History {
    /// Returns the history of a deployment that has reported nothing.
    pub fn new(deployment: Deployment, hosts: Vec<String>) -> Self {
        Self { deployment, hosts, entries: Vec::new(), count: 0 }
    }

    /// Returns whose it is.
    pub fn deployment(&self) -> &Deployment {
        &self.deployment
    }

    /// Returns the reports that are kept, the last first.
    pub fn latest(&self) -> impl Iterator<Item = &Report> {
        self.entries.iter().rev().map(|entry| &entry.report)
    }

    /// Keeps a report about a host of the plan, and tells it to `watchers` and `listeners`.
    pub fn report(&mut self, report: Report, host: u32, (watchers, listeners): (&[u64], &[u64]), out: &mut Out<'_>) {
        for &call in watchers {
            out.effects.push(Effect::Answer { call, answer: Box::new(Answer::Report(report.clone())) });
        }
        let entry = Entry { number: self.count, at: out.now, host, report };
        for &call in listeners {
            tell(call, self.event(&entry, out.now).into_iter().collect(), out);
        }
        self.count += 1;
        // Of a very long mission only the beginning and the end are repeated to those who were cut off.
        if self.entries.len() < REPORTS_MAX || is_last(&entry.report) {
            self.entries.push(entry);
        }
    }

    /// Repeats the reports that somebody who has the first `seen` of them has missed.
    pub fn tell_missed(&self, call: u64, seen: u64, out: &mut Out<'_>) {
        let seen = usize::try_from(seen).unwrap_or(usize::MAX);
        let last = self.entries.len() - usize::from(self.entries.last().is_some_and(|last| is_last(&last.report)));
        for entry in self.entries.get(seen.min(last)..).unwrap_or_default() {
            let answer = Answer::Report(entry.report.clone());
            out.effects.push(Effect::Answer { call, answer: Box::new(answer) });
        }
    }

    /// Tells somebody who listens to everything what has happened so far.
    pub fn tell(&self, call: u64, out: &mut Out<'_>) {
        for some in self.entries.chunks(EVENTS_IN_ONE) {
            tell(call, some.iter().filter_map(|entry| self.event(entry, out.now)).collect(), out);
        }
    }

    /// Returns a report as it is told to those who listen to everything; nothing if it is none of their business.
    fn event(&self, entry: &Entry, now: Time) -> Option<Event> {
        // Where programs can be dialled, and each step of a supervisor, is for those who record one mission.
        let report = match &entry.report {
            Report::Programs { .. } | Report::Stepped { .. } => return None,
            Report::Go { took, .. } => Report::Go { took: *took, signals: Vec::new() },
            Report::Accepted { .. }
            | Report::Prepared { .. }
            | Report::Connected { .. }
            | Report::Process { .. }
            | Report::Changed { .. }
            | Report::Unchanged { .. }
            | Report::Refused { .. }
            | Report::Finished { .. } => entry.report.clone(),
        };
        let host = self.hosts.get(entry.host as usize).cloned().unwrap_or_default();
        let (deployment, number, ago) = (self.deployment.clone(), entry.number, now - entry.at);
        Some(Event { deployment, number, host, ago, report })
    }
}

/// Tells some events; none at all would mean that these were all up to now.
fn tell(call: u64, events: Vec<Event>, out: &mut Out<'_>) {
    if !events.is_empty() {
        out.effects.push(Effect::Answer { call, answer: Box::new(Answer::Events(events)) });
    }
}

fn is_last(report: &Report) -> bool {
    matches!(report, Report::Finished { .. } | Report::Refused { .. })
}
