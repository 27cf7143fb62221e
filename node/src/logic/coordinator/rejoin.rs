//! A host takes part again: it was lost, or its node had left, and nothing of the deployment is left there.
//!
//! ```text
//! waits ─Rejoin─▶ its programs start, idle ─Connect─▶ they make their links ─Go─▶ takes part
//!   ▲                  └────── refused, too late, lost ──┘
//!   └──────── Release, until it has confirmed ◀┘
//! ```
//! Nothing runs by that: what ran there has failed, and the expression decides. But the next activation finds its program, so `retry`
//! and `;;` go on after a host was away. The others hear where its programs are from the host itself, and open their wires again.
//!
//! A host that refuses is asked again, less and less often. While a change is made nobody is asked.

use super::start::prepare_within;
use super::{CONNECT_WITHIN, Coordinator, PREPARE_WITHIN, Phase};
use crate::logic::effect::{Out, earliest};
use crate::logic::protocol::{LeafFacts, Report, ToParticipant};
use crate::logic::wiring::observe;
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;

/// When a host is asked for the first time; from then on half as often each time.
const FIRST: Duration = Duration::from_millis(200);
/// How seldom it is asked in the end.
const SELDOM: Duration = Duration::from_secs(30);
/// How often hosts rejoin a deployment at the most: their supervisors' numbers would repeat.
const REJOINS_MAX: u32 = 1000;

/// The hosts that are to take part again.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Rejoins {
    /// Of all times that hosts were asked.
    number: u32,
    hosts: BTreeMap<String, Rejoining>,
}

#[derive(Debug, Serialize, Deserialize)]
struct Rejoining {
    step: Step,
    /// When it is asked, or too late.
    due: Time,
    /// How long it waits after the next refusal.
    pause: Duration,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Step {
    Waiting,
    Preparing,
    Connecting,
    /// It was told to release what it has.
    Failed,
}

impl Rejoins {
    /// Drops what was begun with a host: it is lost once more.
    pub(super) fn forget(&mut self, host: &str) {
        self.hosts.remove(host);
    }

    /// A host that waits is there again: it is asked at once.
    pub(super) fn hurry(&mut self, host: &str, now: Time) {
        let waiting = self.hosts.get_mut(host).filter(|one| one.step == Step::Waiting);
        waiting.into_iter().for_each(|one| one.due = one.due.min(now + FIRST));
    }

    /// Takes note that its node was gone: nobody could answer it meanwhile.
    pub(super) fn adopted(&mut self, away: Duration) {
        self.hosts.values_mut().for_each(|one| one.due = one.due + away);
    }

    /// Returns whether a host was asked to take part again, and has not done so yet.
    pub(super) fn is_asked(&self, host: &str) -> bool {
        self.hosts.get(host).is_some_and(|one| matches!(one.step, Step::Preparing | Step::Connecting))
    }

    fn at(&mut self, host: &str, step: Step) -> Option<&mut Rejoining> {
        self.hosts.get_mut(host).filter(|one| one.step == step)
    }
}

impl Coordinator {
    /// Returns when [`Coordinator::tick_rejoins`] wants to be called.
    pub(super) fn rejoin_deadline(&self) -> Option<Time> {
        let is_asking = self.change.is_none();
        let due = |one: &Rejoining| (is_asking || one.step != Step::Waiting).then_some(one.due);
        self.rejoins.hosts.values().map(due).fold(None, earliest)
    }

    /// Nothing of the deployment is left on a host while it runs.
    pub(super) fn rejoin_later(&mut self, host: &str, now: Time) {
        if self.phase != Phase::Running || self.plan.home() == Some(host) || self.rejoins.number >= REJOINS_MAX {
            return;
        }
        let pause = self.rejoins.hosts.get(host).map_or(FIRST, |one| one.pause);
        let next = Rejoining { step: Step::Waiting, due: now + pause, pause: (2 * pause).min(SELDOM) };
        self.rejoins.hosts.insert(host.to_owned(), next);
    }

    /// Takes note of where a program is that was started again: a host that rejoins has to know, and so do the people who watch.
    pub fn moved(&mut self, facts: &LeafFacts, from: &str, out: &mut Out<'_>) {
        let leaf = self.plan.leaves.get(facts.leaf as usize);
        let host = leaf.and_then(|leaf| self.plan.hosts.get(leaf.host as usize));
        if host.is_none_or(|host| host != from) {
            return;
        }
        let before = self.registrations.facts.insert(facts.leaf, facts.clone());
        if before.as_ref() != Some(facts) {
            self.tell_where([facts.leaf], out);
        }
    }

    /// Tells the people who watch where these programs are now.
    pub(super) fn tell_where(&mut self, leaves: impl IntoIterator<Item = u32>, out: &mut Out<'_>) {
        let at = leaves.into_iter().filter_map(|leaf| {
            let path = self.plan.leaves.get(leaf as usize)?.path.clone();
            Some((path, observe(&self.registrations, leaf)?))
        });
        let at: Vec<_> = at.collect();
        if self.phase == Phase::Running && !at.is_empty() {
            self.report(Report::Programs { at }, out);
        }
    }

    /// Asks who is to be asked, and gives up whom it takes too long.
    pub(super) fn tick_rejoins(&mut self, out: &mut Out<'_>) {
        let is_asking = self.change.is_none();
        let is_due = |one: &Rejoining| one.due <= out.now && (is_asking || one.step != Step::Waiting);
        let due = self.rejoins.hosts.iter().filter(|(_, one)| is_due(one));
        for (host, step) in due.map(|(host, one)| (host.clone(), one.step)).collect::<Vec<_>>() {
            match step {
                Step::Waiting => self.rejoin(&host, out),
                Step::Preparing | Step::Connecting => self.rejoin_refused(&host, "it did not answer in time", out),
                Step::Failed => self.rejoin_again(&host, out),
            }
        }
    }

    fn rejoin(&mut self, host: &str, out: &mut Out<'_>) {
        let Some(one) = self.rejoins.hosts.get_mut(host) else { return };
        self.rejoins.number += 1;
        (one.step, one.due) = (Step::Preparing, out.now + prepare_within(&self.plan));
        // From now on it may hold something again.
        self.left.remove(host);
        self.lost.insert(host.to_owned());
        self.back.insert(host.to_owned());
        let since_go = self.go_at.map_or(Duration::ZERO, |go| out.now - go);
        let (plan, number) = ((*self.plan).clone(), self.rejoins.number);
        let order = ToParticipant::Rejoin { plan, number, since_go }.signed(self.signed.as_deref());
        out.send(host, self.deployment.to_participant(order));
    }

    pub(super) fn rejoin_prepared(&mut self, from: &str, facts: Vec<LeafFacts>, machine: &str, out: &mut Out<'_>) {
        let Some(one) = self.rejoins.at(from, Step::Preparing) else { return };
        (one.step, one.due) = (Step::Connecting, out.now + CONNECT_WITHIN);
        self.register(from, facts, machine, out);
        self.have_connected(from, out);
    }

    pub(super) fn rejoined(&mut self, from: &str, out: &mut Out<'_>) {
        if self.rejoins.at(from, Step::Connecting).is_none() {
            return;
        }
        self.rejoins.forget(from);
        self.lost.remove(from);
        self.back.remove(from);
        self.unable.remove(from);
        self.report(Report::Connected { host: from.to_owned() }, out);
        let host = |leaf: &u32| self.plan.hosts.get(self.plan.leaves.get(*leaf as usize)?.host as usize);
        let of_host = |leaf: &u32| host(leaf).is_some_and(|host| host == from);
        let leaves: Vec<u32> = self.registrations.facts.keys().copied().filter(of_host).collect();
        self.tell_where(leaves, out);
        out.send(from, self.deployment.to_participant(ToParticipant::Go));
        for host in self.hosts.iter().filter(|host| !self.lost.contains(*host)) {
            let reopen = ToParticipant::Reopen { host: from.to_owned() };
            out.send(host, self.deployment.to_participant(reopen));
        }
    }

    /// A host could not; it gives back what it has begun, and is asked again later.
    pub(super) fn rejoin_refused(&mut self, from: &str, why: &str, out: &mut Out<'_>) {
        if self.rejoins.hosts.get(from).is_none_or(|one| one.step == Step::Waiting) {
            return;
        }
        tracing::warn!(deployment = %self.deployment, host = from, why, "a host cannot take part again yet");
        self.rejoin_again(from, out);
    }

    /// Has a host confirm that nothing is left there.
    fn rejoin_again(&mut self, host: &str, out: &mut Out<'_>) {
        let Some(one) = self.rejoins.hosts.get_mut(host) else { return };
        (one.step, one.due) = (Step::Failed, out.now + PREPARE_WITHIN);
        out.send(host, self.deployment.to_participant(ToParticipant::Release));
    }
}
