//! A host takes part again after it failed or its node left. By then, nothing of the deployment is left on the host.
//!
//! ```text
//! Waiting ─Rejoin─▶ Preparing: its programs start, idle ─Connect─▶ Connecting: they make their links ─Go─▶ takes part
//!   ▲                  └────── refused, too late, failed ──┘
//!   └──── Failed: it is told `Release` until it has confirmed ◀┘
//! ```
//! Rejoining activates nothing. The processes that ran on the host have failed, and the process expression decides how
//! to continue. But the next activation of such a process finds its program, so `retry` and `;;` continue after the
//! absence of a host. The host itself tells the others where its programs are, and the others open their wires again.
//!
//! A host that refuses is asked again after longer and longer pauses. No host is asked while a change is made.

use super::host::HostPart;
use super::mission::Mission;
use super::start::prepare_within;
use super::{CONNECT_WITHIN, PREPARE_WITHIN};
use crate::logic::effect::{Out, earliest};
use crate::logic::protocol::{LeafFacts, Report, ToParticipant};
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// The delay before a host is asked for the first time; each further delay is twice as long.
const FIRST: Duration = Duration::from_millis(200);
/// The longest pause between two questions to a host.
const SELDOM: Duration = Duration::from_secs(30);
/// How often hosts rejoin a deployment at most. With more rejoins, numbers of their supervisors would be used twice.
const REJOINS_MAX: u32 = 1000;

/// The progress of a host that rejoins.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Rejoin {
    step: Step,
    /// When the host is asked next, or when the time limit of its step ends.
    due: Time,
    /// How long the home waits after the next refusal.
    pause: Duration,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Step {
    Waiting,
    Preparing,
    Connecting,
    Failed,
}

impl Rejoin {
    /// Returns the wait for the next question. The wait depends on the progress `before`, if the host was asked already.
    fn next(before: Option<&Self>, now: Time) -> Self {
        let pause = before.map_or(FIRST, |before| before.pause);
        Self { step: Step::Waiting, due: now + pause, pause: (2 * pause).min(SELDOM) }
    }

    /// Notes that the host is reached again: if it waits, it is asked soon.
    pub(super) fn hurry(&mut self, now: Time) {
        if self.step == Step::Waiting {
            self.due = self.due.min(now + FIRST);
        }
    }

    /// Notes that the home's node was gone and could not receive any answer.
    pub(super) fn adopted(&mut self, away: Duration) {
        self.due = self.due + away;
    }

    /// Returns whether the host was asked, and has neither refused nor taken part yet.
    pub(super) fn is_asked(&self) -> bool {
        matches!(self.step, Step::Preparing | Step::Connecting)
    }

    /// Returns when something is to be done about the host.
    fn due(&self, is_asking: bool) -> Option<Time> {
        (is_asking || self.step != Step::Waiting).then_some(self.due)
    }
}

impl Mission {
    /// Returns when [`Mission::tick_rejoins`] wants to be called.
    pub(super) fn rejoin_deadline(&self, is_asking: bool) -> Option<Time> {
        let rejoins = self.hosts.values().filter_map(|host| host.rejoin.as_ref());
        rejoins.map(|rejoin| rejoin.due(is_asking)).fold(None, earliest)
    }

    /// Plans to ask a host to rejoin, on which nothing of the running deployment is left.
    pub(super) fn rejoin_later(&mut self, host: &str, now: Time) {
        if self.plan.home() == Some(host) || self.rejoins >= REJOINS_MAX {
            return;
        }
        if let Some(host) = self.hosts.get_mut(host) {
            host.rejoin = Some(Rejoin::next(host.rejoin.as_ref(), now));
        }
    }

    /// Asks the hosts whose time has come, unless a change is being made. Gives up the rejoining of hosts that take too long.
    pub(super) fn tick_rejoins(&mut self, is_asking: bool, out: &mut Out<'_>) {
        let due = self.hosts.iter().filter_map(|(host, part)| {
            let rejoin = part.rejoin.as_ref()?;
            rejoin.due(is_asking).filter(|due| *due <= out.now)?;
            Some((host.clone(), rejoin.step))
        });
        for (host, step) in due.collect::<Vec<_>>() {
            match step {
                Step::Waiting => self.rejoin(&host, out),
                Step::Preparing | Step::Connecting => self.rejoin_refused(&host, "it did not answer in time", out),
                Step::Failed => self.release_again(&host, out),
            }
        }
    }

    fn rejoin(&mut self, name: &str, out: &mut Out<'_>) {
        let until = out.now + prepare_within(&self.plan);
        let Some(host) = self.hosts.get_mut(name) else { return };
        host.rejoins();
        host.rejoin.iter_mut().for_each(|rejoin| (rejoin.step, rejoin.due) = (Step::Preparing, until));
        self.rejoins += 1;
        let (plan, number) = ((*self.plan).clone(), self.rejoins);
        self.tell(name, ToParticipant::Rejoin { plan, number, since_go: self.since_go(out.now) }, out);
    }

    /// Returns the progress of a host that is at this step.
    fn rejoining(&mut self, host: &str, step: Step) -> Option<&mut Rejoin> {
        self.hosts.get_mut(host)?.rejoin.as_mut().filter(|rejoin| rejoin.step == step)
    }

    /// Notes that a rejoining host has started its programs.
    pub(super) fn rejoin_prepared(&mut self, from: &str, facts: Vec<LeafFacts>, machine: &str, out: &mut Out<'_>) {
        let Some(rejoin) = self.rejoining(from, Step::Preparing) else { return };
        (rejoin.step, rejoin.due) = (Step::Connecting, out.now + CONNECT_WITHIN);
        self.register(from, facts, machine, out);
        self.have_connected(from, out);
    }

    /// Notes that a rejoining host has made its links: the host takes part again.
    pub(super) fn rejoined(&mut self, from: &str, out: &mut Out<'_>) {
        if self.rejoining(from, Step::Connecting).is_none() {
            return;
        }
        self.hosts.insert(from.to_owned(), HostPart::default());
        self.report(Report::Connected { host: from.to_owned() }, out);
        let host = |leaf: &u32| self.plan.hosts.get(self.plan.leaves.get(*leaf as usize)?.host as usize);
        let of_host = |leaf: &u32| host(leaf).is_some_and(|host| host == from);
        let leaves: Vec<u32> = self.registrations.facts.keys().copied().filter(of_host).collect();
        self.tell_where(leaves, out);
        self.tell(from, ToParticipant::Go, out);
        for host in self.reachable() {
            self.tell(host, ToParticipant::Reopen { host: from.to_owned() }, out);
        }
    }

    /// Handles the refusal of a host. The host releases everything that it has begun, and is asked again later.
    pub(super) fn rejoin_refused(&mut self, from: &str, why: &str, out: &mut Out<'_>) {
        let rejoin = self.hosts.get(from).and_then(|host| host.rejoin.as_ref());
        if rejoin.is_some_and(|rejoin| rejoin.step != Step::Waiting) {
            tracing::warn!(deployment = %self.deployment, host = from, why, "a host cannot take part again yet");
            self.release_again(from, out);
        }
    }

    /// Orders a host to release everything, and to confirm that nothing is left there.
    fn release_again(&mut self, host: &str, out: &mut Out<'_>) {
        if let Some(rejoin) = self.hosts.get_mut(host).and_then(|host| host.rejoin.as_mut()) {
            (rejoin.step, rejoin.due) = (Step::Failed, out.now + PREPARE_WITHIN);
            self.tell(host, ToParticipant::Release, out);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_host_that_refuses_is_asked_less_and_less_often() {
        let (mut rejoin, mut pauses) = (Rejoin::next(None, Time::ZERO), vec![FIRST]);
        for _ in 0..9 {
            let now = rejoin.due;
            rejoin = Rejoin::next(Some(&rejoin), now);
            pauses.push(rejoin.due - now);
        }
        assert!(pauses.windows(2).all(|pair| pair[1] == (2 * pair[0]).min(SELDOM)), "{pauses:?}");
        assert_eq!(pauses.last(), Some(&SELDOM));
    }

    #[test]
    fn a_host_is_not_asked_while_a_change_is_made() {
        let mut rejoin = Rejoin::next(None, Time::ZERO);
        assert_eq!((rejoin.due(false), rejoin.due(true)), (None, Some(Time::ZERO + FIRST)));
        rejoin.step = Step::Preparing;
        assert!(rejoin.is_asked() && rejoin.due(false).is_some(), "a host that was asked is waited for");
    }
}
