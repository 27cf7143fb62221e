//! The deployments that ran here before this node. Each is reported as over, and resumed if its spec says so and the
//! machine was rebooted.
//!
//! A deployment that is resumed waits for the other hosts, which may boot later, and for a possible message from them
//! that it was stopped in the meantime. It is deployed again under the next epoch, so everything left of the previous
//! epoch is fenced off. If a user stops a deployment whose home does not answer, the nodes that do answer keep
//! *tombstones*. Each tells the home as soon as the home returns; the home then does not resume the deployment, or ends
//! it, and reports that.

use super::promises::Promise;
use super::{Agent, AwaitingHosts};
use crate::logic::coordinator::Coordinator;
use crate::logic::database::chronicle;
use crate::logic::effect::{Effect, Out};
use crate::logic::history::{Audience, History};
use crate::logic::protocol::{
    Answer, Before, Body, Deployment, Ending, Failure, FailureCause, Kept, Message, Report, Signed, StartMode,
    StopReply, Tombstone, WaitingDeployment,
};
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::time::Duration;

/// How long a node waits after its start for messages of others, before it resumes anything.
const BOOT_WAIT: Duration = Duration::from_secs(10);
/// How long it waits for hosts that take part, which may boot later.
const BOOT_WITHIN: Duration = Duration::from_secs(120);
/// How many tombstones are kept; if there are more, those of the latest epochs.
const TOMBSTONES_MAX: usize = 1024;

/// Where a deployment that waits comes from, if no call has asked for it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Resumed {
    /// The deployment that ran before the reboot.
    from: Deployment,
    origin: u64,
    /// The earliest time at which it may begin; nothing once that time has passed.
    pub(super) earliest: Option<Time>,
    permission: Permission,
}

/// Whether the user who signed the deployment may still have it: the key may have been revoked since.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Permission {
    /// Not known yet. The question comes last, so that all hosts that know of a revocation have been heard before.
    Unknown,
    /// Asked.
    Asked,
    /// Given.
    Given,
}

impl Resumed {
    /// Returns the epoch under which a user has deployed it.
    pub(super) const fn origin(&self) -> u64 {
        self.origin
    }

    /// Asks whether the signer of the deployment may still have it.
    fn judge(&self, signed: &Option<Arc<Signed>>) -> Effect {
        Effect::JudgeResumed { deployment: self.from.clone(), signed: signed.clone() }
    }

    /// Returns the deployment that ran before the reboot.
    pub(super) const fn before(&self) -> &Deployment {
        &self.from
    }
}

impl AwaitingHosts {
    /// Returns when it is to be looked at again.
    pub(super) fn deadline(&self) -> Option<Time> {
        let Some(resumed) = &self.resumed else { return Some(self.until) };
        let is_asked = resumed.permission == Permission::Asked;
        resumed.earliest.or(Some(self.until)).filter(|_| !is_asked)
    }

    /// Returns the record on the disk of a deployment that is resumed, until it has begun.
    pub(super) fn kept(&self) -> Option<Kept> {
        let Resumed { from, origin, .. } = self.resumed.clone()?;
        let resume = Some((self.plan.clone(), self.signed.as_deref().cloned()));
        let (by, hosts, has_ended) = (self.by.clone(), self.plan.hosts.clone(), true);
        Some(Kept { deployment: from, origin, by, hosts, has_ended, waits: true, resume })
    }
}

impl Agent {
    /// Reports the end of the deployments that ran before this node, and waits with those that are resumed.
    pub(super) fn look_back(&mut self, out: &mut Out<'_>) {
        let mut earlier = std::mem::take(&mut self.pending.earlier);
        // If the power failed again while a deployment was being resumed, the last of its epochs counts.
        earlier.sort_by_key(|before| std::cmp::Reverse(before.kept.deployment.epoch));
        for Before { kept, was_rebooted } in earlier {
            let Kept { deployment, origin, by, hosts, has_ended, resume, .. } = kept;
            if !has_ended {
                let cause = if was_rebooted { FailureCause::Rebooted } else { FailureCause::Restarted };
                tracing::warn!(%deployment, %cause, "a deployment has not come to its end");
                self.tell_over(&deployment, hosts, cause, out);
            }
            let is_known = self.pending.awaiting.iter().any(|one| one.plan.name == deployment.name);
            let Some((plan, signed)) = resume.filter(|_| was_rebooted && !is_known) else {
                out.effects.push(Effect::Unkeep { deployment });
                continue;
            };
            let (earliest, until) = (out.now + BOOT_WAIT, out.now + BOOT_WITHIN);
            let permission = Permission::Unknown;
            let resumed = Some(Resumed { from: deployment, origin, earliest: Some(earliest), permission });
            let signed = signed.map(Arc::new);
            let start = StartMode::AtOnce;
            self.pending.awaiting.push(AwaitingHosts { until, call: None, plan, by, signed, resumed, start });
        }
    }

    /// Keeps the last report of a deployment that no node has seen end.
    fn tell_over(&mut self, deployment: &Deployment, hosts: Vec<String>, cause: FailureCause, out: &mut Out<'_>) {
        let unconfirmed = hosts.iter().filter(|host| **host != self.identity.host).cloned().collect();
        let mut history = History::new(deployment.clone(), hosts);
        let failure = Failure { origin: "main".to_owned(), cause, at: Duration::ZERO };
        let (ending, at) = (Ending::Aborted(failure), Duration::ZERO);
        history.report(Report::Finished { ending, at, unconfirmed }, 0, &Audience::default(), out);
        let record = chronicle::ended(&self.identity.host, &history);
        out.effects.extend(record.map(|record| Effect::WriteDatabase(Box::new(record))));
        self.past.over.push_front(history);
        self.past.over.truncate(super::OVER_MAX);
    }

    /// Returns whether a deployment that waits may begin.
    pub(super) fn may_begin(&self, one: &AwaitingHosts, now: Time) -> bool {
        let (here, names) = (&self.identity.host, &self.peers.names);
        let are_there = one.plan.hosts.iter().all(|host| host == here || names.reaches(host));
        let is_free = one
            .resumed
            .as_ref()
            .is_none_or(|resumed| resumed.earliest.is_none() && !self.peers.absence.is_open(&resumed.from));
        one.until <= now || are_there && is_free
    }

    /// Returns the state of a waiting deployment, for users.
    pub(super) fn waiting(&self, one: &AwaitingHosts, now: Time) -> WaitingDeployment {
        let (here, names) = (&self.identity.host, &self.peers.names);
        let (resumes, earliest) = one.resumed.as_ref().map(|resumed| (&resumed.from, resumed.earliest)).unzip();
        let open = resumes.map(|before| self.peers.absence.unconfirmed(before)).unwrap_or_default();
        let is_awaited = |host: &&String| *host != here && (!names.reaches(host) || open.contains(host));
        WaitingDeployment {
            name: one.plan.name.clone(),
            by: one.by.clone(),
            resumes: resumes.cloned(),
            begins_in: earliest.flatten().map_or(Duration::ZERO, |at| at.since(now)),
            hosts: one.plan.hosts.iter().filter(is_awaited).cloned().collect(),
            at_most: one.until.since(now),
        }
    }

    /// Resumes a deployment, if nothing is against it and, in a team, its signer still has permission.
    pub(super) fn resume(&mut self, mut one: AwaitingHosts, out: &mut Out<'_>) {
        let obstacle = self.obstacle(out.now);
        let Some(resumed) = &mut one.resumed else { return };
        if let Some(why) = obstacle {
            let resumed = resumed.clone();
            return self.not_resumed(&resumed, &why, out);
        }
        if !self.identity.is_guarded || resumed.permission == Permission::Given {
            return self.begin(one, out);
        }
        if resumed.permission == Permission::Unknown {
            resumed.permission = Permission::Asked;
            out.effects.push(resumed.judge(&one.signed));
        }
        self.pending.awaiting.push(one);
    }

    /// Takes the verdict about a deployment that is to be resumed.
    pub(super) fn resumable(&mut self, deployment: &Deployment, verdict: Result<(), String>, out: &mut Out<'_>) {
        let is_meant = |one: &AwaitingHosts| one.resumed.as_ref().is_some_and(|resumed| resumed.from == *deployment);
        let Some(place) = self.pending.awaiting.iter().position(is_meant) else { return };
        let mut one = self.pending.awaiting.remove(place);
        let Some(resumed) = &mut one.resumed else { return };
        match verdict {
            Ok(()) => {
                resumed.permission = Permission::Given;
                self.resume(one, out);
            }
            Err(why) => {
                let resumed = resumed.clone();
                self.not_resumed(&resumed, &why, out);
            }
        }
    }

    /// Asks again for the verdicts that a node which was killed has not given.
    pub(super) fn ask_again(&self, out: &mut Out<'_>) {
        for AwaitingHosts { signed, resumed, .. } in &self.pending.awaiting {
            if let Some(resumed) = resumed.as_ref().filter(|resumed| resumed.permission == Permission::Asked) {
                out.effects.push(resumed.judge(signed));
            }
        }
    }

    /// Reports why a deployment is not resumed after all.
    pub(super) fn not_resumed(&mut self, resumed: &Resumed, why: &str, out: &mut Out<'_>) {
        let deployment = resumed.from.clone();
        tracing::warn!(%deployment, why, "it is not resumed");
        if self.past.over.iter().all(|history| *history.deployment() != deployment) {
            self.past.over.push_front(History::new(deployment.clone(), vec![self.identity.host.clone()]));
            self.past.over.truncate(super::OVER_MAX);
        }
        if let Some(history) = self.past.over.iter_mut().find(|history| *history.deployment() == deployment) {
            let reasons = vec![format!("it is not resumed: {why}")];
            let audience = Audience { listeners: self.callers.listeners.clone(), ..Audience::default() };
            history.report(Report::Refused { reasons }, 0, &audience, out);
        }
        out.effects.push(Effect::Unkeep { deployment });
    }

    /// Keeps a tombstone for a home that does not answer.
    pub(super) fn stop_away(&mut self, call: u64, tombstone: Tombstone, out: &mut Out<'_>) {
        let Tombstone { home, deployment } = &tombstone;
        let refusal = if *home == self.identity.host {
            Some(format!("`{}` has its home here: `dca stop {}` ends it", deployment.name, deployment.name))
        } else if self.peers.names.reaches(home) {
            Some(format!("`{home}` answers: `dca stop {}` ends it there", deployment.name))
        } else {
            None
        };
        if let Some(why) = refusal {
            return out.answer(call, Answer::Refused(why));
        }
        // A tombstone of a later epoch covers the earlier epochs.
        let is_new = !self.pending.tombstones.iter().any(|other| tombstone.is_covered_by(other));
        if is_new {
            self.pending.tombstones.retain(|other| !other.is_covered_by(&tombstone));
            self.pending.tombstones.insert(tombstone);
            while self.pending.tombstones.len() > TOMBSTONES_MAX {
                let first = self.pending.tombstones.iter().min_by_key(|one| one.deployment.epoch).cloned();
                self.pending.tombstones.retain(|one| Some(one) != first.as_ref());
            }
        }
        self.keep_tombstones(out);
        out.answer(call, Answer::Stop(StopReply::Stopped));
    }

    fn keep_tombstones(&self, out: &mut Out<'_>) {
        out.effects.push(Effect::KeepTombstones(self.pending.tombstones.iter().cloned().collect()));
    }

    /// Tells a reachable home which of its deployments were stopped while it was away.
    pub(super) fn tell_tombstones(&self, home: &str, out: &mut Out<'_>) {
        for tombstone in self.pending.tombstones.iter().filter(|tombstone| tombstone.home == home) {
            out.send(home, Message { deployment: tombstone.deployment.clone(), body: Body::Stopped });
        }
    }

    /// Takes the message of another node that a deployment of this home was stopped while the home was away.
    pub(super) fn was_stopped(&mut self, deployment: &Deployment, from: &str, out: &mut Out<'_>) {
        let is_meant = |name: &str, origin: u64| name == deployment.name && origin <= deployment.epoch;
        let waiting = |one: &mut AwaitingHosts| {
            one.resumed.as_ref().is_some_and(|resumed| is_meant(&one.plan.name, resumed.origin))
        };
        let dropped: Vec<AwaitingHosts> = self.pending.awaiting.extract_if(.., waiting).collect();
        // The disk forgets them in this order.
        let mut last = None;
        for resumed in dropped.into_iter().filter_map(|one| one.resumed) {
            let why = format!("it was stopped while `{}` was away, as `{from}` says", self.identity.host);
            self.not_resumed(&resumed, &why, out);
            last = Some(resumed.from);
        }
        for (own, home) in &mut self.coordinators {
            if is_meant(&own.name, home.origin()) && !home.is_ending() {
                home.abort(FailureCause::StoppedAway(from.to_owned()), out);
                last = Some(own.clone());
            }
        }
        match last {
            Some(last) => self.promise(last, Promise::Mourned(from.to_owned(), deployment.clone())),
            None => out.send(from, Message { deployment: deployment.clone(), body: Body::Mourned }),
        }
    }

    /// Forgets a tombstone that its home has heard of.
    pub(super) fn mourned(&mut self, deployment: &Deployment, from: &str, out: &mut Out<'_>) {
        let count = self.pending.tombstones.len();
        self.pending.tombstones.retain(|tombstone| tombstone.home != from || tombstone.deployment != *deployment);
        if self.pending.tombstones.len() != count {
            self.keep_tombstones(out);
        }
    }

    /// Has the right records kept on the disk, and no others: a node that was killed may not have written or removed some.
    pub(super) fn keep_all(&self, out: &mut Out<'_>) {
        let running = self.coordinators.values().filter_map(Coordinator::kept);
        let waiting = self.pending.awaiting.iter().filter_map(AwaitingHosts::kept);
        out.effects.push(Effect::KeepAll(running.chain(waiting).collect()));
        self.keep_tombstones(out);
    }
}

impl Tombstone {
    /// Returns whether another tombstone covers everything that this one covers.
    fn is_covered_by(&self, other: &Self) -> bool {
        let (own, its) = (&self.deployment, &other.deployment);
        self.home == other.home && own.name == its.name && own.epoch <= its.epoch
    }
}
