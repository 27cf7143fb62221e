//! A host takes part again: it failed, or its node had left, and nothing of the deployment is left there.
//!
//! ```text
//! Waiting ─Rejoin─▶ Preparing: its programs start, idle ─Connect─▶ Connecting: they make their links ─Go─▶ takes part
//!   ▲                  └────── refused, too late, failed ──┘
//!   └──── Failed: it is told `Release` until it has confirmed ◀┘
//! ```
//! Rejoining activates nothing. The processes that ran there have failed, and the expression decides. But the next activation finds
//! its program, so `retry` and `;;` continue after a host was away. The host itself tells the others where its programs are, and
//! they open their wires again.
//!
//! A host that refuses is asked again, less and less often. While a change is made, no host is asked.

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
/// How often hosts rejoin a deployment at most. After more rejoins, the numbers of their supervisors would repeat.
const REJOINS_MAX: u32 = 1000;

/// The progress of a host that rejoins.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Rejoin {
    step: Step,
    /// When the host is asked next, or when its step is too late.
    due: Time,
    /// How long it waits after the next refusal.
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
    /// Returns the wait for the next question, after `before` if there was one.
    fn next(before: Option<&Self>, now: Time) -> Self {
        let pause = before.map_or(FIRST, |before| before.pause);
        Self { step: Step::Waiting, due: now + pause, pause: (2 * pause).min(SELDOM) }
    }

    /// Its host is reached again: a host that waits is asked soon.
    pub(super) fn hurry(&mut self, now: Time) {
        if self.step == Step::Waiting {
            self.due = self.due.min(now + FIRST);
        }
    }

    /// The node of the home was gone and could not hear any answer.
    pub(super) fn adopted(&mut self, away: Duration) {
        self.due = self.due + away;
    }

    /// Returns whether its host was asked, and has not refused or taken part yet.
    pub(super) fn is_asked(&self) -> bool {
        matches!(self.step, Step::Preparing | Step::Connecting)
    }

    /// Returns when there is something to do.
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

    /// Nothing of the deployment is left on a host while it runs.
    pub(super) fn rejoin_later(&mut self, host: &str, now: Time) {
        if self.plan.home() == Some(host) || self.rejoins >= REJOINS_MAX {
            return;
        }
        if let Some(host) = self.hosts.get_mut(host) {
            host.rejoin = Some(Rejoin::next(host.rejoin.as_ref(), now));
        }
    }

    /// Asks the hosts whose time has come, unless a change is being made, and gives up those that take too long.
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

    /// Returns the progress of a host, if it is at this step.
    fn rejoining(&mut self, host: &str, step: Step) -> Option<&mut Rejoin> {
        self.hosts.get_mut(host)?.rejoin.as_mut().filter(|rejoin| rejoin.step == step)
    }

    /// A host that rejoins has started its programs.
    pub(super) fn rejoin_prepared(&mut self, from: &str, facts: Vec<LeafFacts>, machine: &str, out: &mut Out<'_>) {
        let Some(rejoin) = self.rejoining(from, Step::Preparing) else { return };
        (rejoin.step, rejoin.due) = (Step::Connecting, out.now + CONNECT_WITHIN);
        self.register(from, facts, machine, out);
        self.have_connected(from, out);
    }

    /// A host that rejoins has made its links: it takes part.
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

    /// A host could not rejoin. It gives back everything that it has begun, and is asked again later.
    pub(super) fn rejoin_refused(&mut self, from: &str, why: &str, out: &mut Out<'_>) {
        let rejoin = self.hosts.get(from).and_then(|host| host.rejoin.as_ref());
        if rejoin.is_some_and(|rejoin| rejoin.step != Step::Waiting) {
            tracing::warn!(deployment = %self.deployment, host = from, why, "a host cannot take part again yet");
            self.release_again(from, out);
        }
    }

    /// Has a host confirm that nothing is left there.
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
