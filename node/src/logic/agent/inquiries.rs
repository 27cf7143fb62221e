//! Questions for every event so far, which are answered once every host has reported.
//!
//! Only the home of a deployment has its events. Events of another host may still be on their way, or wait there for a
//! home that was cut off or killed. So the home asks each host of its deployments. Messages of a host arrive in order,
//! so its answer arrives after all its reports. A host whose node was killed answers once its new
//! node has contact with the shims of its programs, which report the events in between.
//!
//! No host is waited for longer than [`WITHIN`]: a host that has not answered by then is named in the answer.

use crate::logic::effect::{Out, ProcessId, earliest};
use crate::logic::nameserver::NameServer;
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

    /// Returns when [`Inquiries::due`] wants to be called.
    pub(super) fn deadline(&self) -> Option<Time> {
        self.open.iter().map(|inquiry| inquiry.until).fold(None, |first, until| earliest(first, Some(until)))
    }

    /// Asks these hosts for a call.
    pub(super) fn ask(&mut self, call: u64, hosts: BTreeSet<String>, names: &NameServer, out: &mut Out<'_>) {
        let number = self.count;
        self.count += 1;
        let is_waited_for = self.open.len() < OPEN_MAX;
        if is_waited_for {
            for host in hosts.iter().filter(|host| names.reaches(host)) {
                out.send(host, Message::about_none(Body::Inquiry { number }));
            }
        }
        let until = if is_waited_for { out.now + WITHIN } else { out.now };
        self.open.push(Inquiry { number, call, hosts, until });
    }

    /// Asks a host that is there again: the first question may not have reached it.
    pub(super) fn ask_again(&self, host: &str, out: &mut Out<'_>) {
        for &Inquiry { number, .. } in self.open.iter().filter(|inquiry| inquiry.hosts.contains(host)) {
            out.send(host, Message::about_none(Body::Inquiry { number }));
        }
    }

    /// Takes the question of a home.
    pub(super) fn inquired(&mut self, number: u64, from: &str, out: &mut Out<'_>) {
        if self.unreached.is_empty() {
            out.send(from, Message::about_none(Body::Reported { number }));
        } else if self.asked_by.len() < OPEN_MAX {
            self.asked_by.insert((from.to_owned(), number));
        }
    }

    /// Takes the answer of a host: all events of the host before the question have arrived before this answer.
    pub(super) fn answered(&mut self, number: u64, from: &str) {
        if let Some(inquiry) = self.open.iter_mut().find(|inquiry| inquiry.number == number) {
            inquiry.hosts.remove(from);
        }
    }

    /// Answers the homes that have asked, once all programs here are reached.
    pub(super) fn answer_homes(&mut self, out: &mut Out<'_>) {
        if self.unreached.is_empty() {
            for (home, number) in std::mem::take(&mut self.asked_by) {
                out.send(&home, Message::about_none(Body::Reported { number }));
            }
        }
    }

    /// Takes the questions that can be answered, or whose time is over. `has_homes` tells whether a deployment has its home on
    /// this host: the shims of this host report no events of other deployments.
    pub(super) fn due(&mut self, own: &str, has_homes: bool, names: &NameServer, now: Time) -> Vec<Due> {
        let waits_for_shims = !self.unreached.is_empty() && has_homes;
        let is_due = |inquiry: &mut Inquiry| {
            let is_waiting = waits_for_shims || inquiry.hosts.iter().any(|host| names.reaches(host));
            inquiry.until <= now || !is_waiting
        };
        let own = waits_for_shims.then(|| own.to_owned());
        let due = |inquiry: Inquiry| Due {
            call: inquiry.call,
            behind: inquiry.hosts.into_iter().chain(own.clone()).collect(),
        };
        self.open.extract_if(.., is_due).map(due).collect()
    }
}

/// A question that is answered now.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Due {
    pub(super) call: u64,
    /// The hosts that have not answered.
    behind: Vec<String>,
}

impl Due {
    /// Completes the answer to the call, after the events.
    pub(super) fn end(self, out: &mut Out<'_>) {
        let Self { call, behind } = self;
        out.answer_last(call, if behind.is_empty() { Answer::Events(Vec::new()) } else { Answer::Behind(behind) });
    }
}
