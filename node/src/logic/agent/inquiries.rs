//! Questions for every event so far, which are answered once every host has reported.
//!
//! Only the home of a deployment has its events. Events of another host may still be on their way, or wait there for a
//! home that was cut off or killed. So the home asks each host of its deployments. Messages of a host arrive in order,
//! so its answer arrives after all its reports. A host whose node was killed answers once it has heard the shims of its
//! programs again, which report the events of the time between.
//!
//! No host is waited for longer than [`WITHIN`]: a host that has not answered by then is named in the answer.

use super::Agent;
use crate::logic::coordinator::Coordinator;
use crate::logic::effect::{Out, ProcessId, earliest};
use crate::logic::protocol::{Answer, Body, Message};
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::time::Duration;

/// How long a question waits: less long than its caller waits.
pub(in crate::logic) const WITHIN: Duration = Duration::from_secs(3);
/// How many questions of callers may wait, and how many questions of other hosts. Further questions are answered without waiting.
const OPEN_MAX: usize = 64;

/// The questions that wait.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Inquiries {
    /// How many were asked.
    count: u64,
    open: Vec<Inquiry>,
    /// Programs that the previous node has left, and whose shims are not reached again yet.
    unreached: BTreeSet<ProcessId>,
    /// The homes that have asked in the meantime, each with the number of its question.
    asked_by: BTreeSet<(String, u64)>,
}

/// A question for all events of the deployments that have their home here.
#[derive(Debug, Serialize, Deserialize)]
struct Inquiry {
    number: u64,
    call: u64,
    /// The hosts that have not answered.
    hosts: BTreeSet<String>,
    until: Time,
}

impl Inquiries {
    /// Takes note that this node was made again, and that these programs are being reached.
    pub(super) fn adopted(&mut self, programs: BTreeSet<ProcessId>) {
        self.unreached = programs;
    }

    /// Takes note that a program was reached and has sent its reports.
    pub(super) fn reached(&mut self, process: &ProcessId) {
        self.unreached.remove(process);
    }

    /// Forgets a caller that has gone away.
    pub(super) fn forget(&mut self, call: u64) {
        self.open.retain(|inquiry| inquiry.call != call);
    }

    /// Returns when [`Agent::tick_inquiries`] wants to be called.
    pub(super) fn deadline(&self) -> Option<Time> {
        self.open.iter().map(|inquiry| inquiry.until).fold(None, |first, until| earliest(first, Some(until)))
    }

    fn answered(&mut self, number: u64, from: &str) {
        let inquiry = self.open.iter_mut().find(|inquiry| inquiry.number == number);
        if let Some(inquiry) = inquiry {
            inquiry.hosts.remove(from);
        }
    }
}

impl Agent {
    /// Asks every host of the deployments whose home is here, and answers the call once they have answered.
    pub(super) fn inquire(&mut self, call: u64, out: &mut Out<'_>) {
        let own = &self.identity.host;
        let all = self.coordinators.values().flat_map(Coordinator::taking_part);
        let hosts: BTreeSet<String> = all.filter(|host| *host != own).cloned().collect();
        let number = self.callers.inquiries.count;
        self.callers.inquiries.count += 1;
        let is_waited_for = self.callers.inquiries.open.len() < OPEN_MAX;
        if is_waited_for {
            for host in hosts.iter().filter(|host| self.peers.names.reaches(host)) {
                out.send(host, Message::about_none(Body::Inquiry { number }));
            }
        }
        let until = if is_waited_for { out.now + WITHIN } else { out.now };
        self.callers.inquiries.open.push(Inquiry { number, call, hosts, until });
    }

    /// Asks a host that is there again: the first question may not have reached it.
    pub(super) fn inquire_again(&self, host: &str, out: &mut Out<'_>) {
        for &Inquiry { number, .. } in self.callers.inquiries.open.iter().filter(|inquiry| inquiry.hosts.contains(host))
        {
            out.send(host, Message::about_none(Body::Inquiry { number }));
        }
    }

    /// Takes the question of a home.
    pub(super) fn inquired(&mut self, number: u64, from: &str, out: &mut Out<'_>) {
        if self.callers.inquiries.unreached.is_empty() {
            out.send(from, Message::about_none(Body::Reported { number }));
        } else if self.callers.inquiries.asked_by.len() < OPEN_MAX {
            self.callers.inquiries.asked_by.insert((from.to_owned(), number));
        }
    }

    /// Takes the answer of a host: all events of the host before the question have arrived before this answer.
    pub(super) fn reported(&mut self, number: u64, from: &str) {
        self.callers.inquiries.answered(number, from);
    }

    /// Answers the questions that can be answered, or whose time is over.
    pub(super) fn tick_inquiries(&mut self, out: &mut Out<'_>) {
        let is_reached = self.callers.inquiries.unreached.is_empty();
        if is_reached {
            for (home, number) in std::mem::take(&mut self.callers.inquiries.asked_by) {
                out.send(&home, Message::about_none(Body::Reported { number }));
            }
        }
        // The shims of this host report no events of deployments whose home is another host.
        let waits_for_shims = !is_reached && !self.coordinators.is_empty();
        let names = &self.peers.names;
        let is_due = |inquiry: &mut Inquiry| {
            let is_waiting = waits_for_shims || inquiry.hosts.iter().any(|host| names.reaches(host));
            inquiry.until <= out.now || !is_waiting
        };
        for Inquiry { call, hosts, .. } in self.callers.inquiries.open.extract_if(.., is_due).collect::<Vec<_>>() {
            self.tell_events(call, false, out);
            let own = waits_for_shims.then(|| self.identity.host.clone());
            let behind: Vec<String> = hosts.into_iter().chain(own).collect();
            let answer = if behind.is_empty() { Answer::Events(Vec::new()) } else { Answer::Behind(behind) };
            out.answer_last(call, answer);
        }
    }
}
