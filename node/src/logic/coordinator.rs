//! A deployment at its home node (the host of `main`): PREPARE on every host, CONNECT, GO, and the end.
//!
//! ```text
//! Preparing ─all prepared─▶ Connecting ─all connected─▶ Running ─main ended─▶ Ending ─all released─▶ Over
//!      └─────── refused, late, host lost, stopped ────────────────▶ Ending
//! ```
//! Its epoch is written down meanwhile: there is no GO before that is on the disk, so that a node which is started again
//! never gives an epoch that has run to something else.
//!
//! The reply to `deploy` is the outcome: everyone who asked gets the reports as they come, and the last one when nothing
//! of the deployment is left on any host that can be reached.

mod aligned;
mod change;
mod processes;
mod rejoin;
mod start;
mod stop;
mod switching;

use crate::logic::effect::{Effect, Out, earliest};
use crate::logic::history::History;
use crate::logic::protocol::{Deployment, Ending, Report, Signed, ToCoordinator, ToParticipant, Why, unreached};
use crate::logic::wiring::Registrations;
use aligned::Aligning;
use change::Changing;
use comms::logic::time::Time;
use language::plan::Plan;
use rejoin::Rejoins;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

/// How long its node may be gone before what has not begun is refused: as long as until a host counts as lost.
const AWAY_MAX: Duration = Duration::from_secs(5);

/// How long all hosts have to start their programs, if none may take longer than usual to be ready.
pub(super) const PREPARE_WITHIN: Duration = Duration::from_secs(40);
/// How long all hosts have to make their links.
pub(super) const CONNECT_WITHIN: Duration = Duration::from_secs(48);
/// How long all hosts have to remove everything, beyond the time that their programs may take to stop.
pub(super) const RELEASE_WITHIN: Duration = Duration::from_secs(25);
/// How long the other hosts have to add their reasons once one has refused.
pub(super) const REASONS_WITHIN: Duration = Duration::from_secs(2);

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Phase {
    Preparing,
    Connecting,
    Running,
    Ending,
    Over,
}

/// A deployment at its home.
#[derive(Debug, Serialize, Deserialize)]
pub struct Coordinator {
    deployment: Deployment,
    /// The user who has deployed it.
    begun_by: String,
    /// The epoch under which a user has deployed it: not its own once it was resumed after a reboot.
    origin: u64,
    plan: Arc<Plan>,
    /// The same as it was asked for last, before it got the numbers of what runs.
    wanted: Arc<Plan>,
    /// The request by which the plan runs, if a user has signed it.
    signed: Option<Arc<Signed>>,
    hosts: Vec<String>,
    phase: Phase,
    /// Whether its epoch is on the disk.
    committed: bool,
    begun: Time,
    go_at: Option<Time>,
    deadline: Option<Time>,
    waiting: BTreeSet<String>,
    registrations: Registrations,
    reasons: Vec<String>,
    /// Hosts that may still hold something of it.
    lost: BTreeSet<String>,
    /// Hosts that were lost and have been reached again since.
    back: BTreeSet<String>,
    /// Hosts that have said that nothing of it is left there.
    left: BTreeSet<String>,
    /// Hosts that have said that they could not end everything.
    unable: BTreeSet<String>,
    /// Once it is over: who has not confirmed that nothing is left, and why.
    unconfirmed: BTreeMap<String, Why>,
    ending: Option<Ending>,
    watchers: Vec<u64>,
    /// The calls that listen to all deployments.
    listeners: Vec<u64>,
    stoppers: Vec<u64>,
    /// Whether somebody has asked for its end while it ran.
    is_asked: bool,
    /// Whether its node leaves, which may be for a reboot.
    is_leaving: bool,
    /// Whether a user has asked for its end.
    is_unwanted: bool,
    /// How many times the disk still has to say that it has forgotten it.
    unkeeping: u32,
    /// How often its plan was changed while it ran, and who did that last.
    revision: (u32, String),
    change: Option<Changing>,
    /// Numbers the changes.
    changes: u32,
    rejoins: Rejoins,
    /// Calls that wait for a switch of connection sets, and until when.
    switches: BTreeMap<u64, Time>,
    /// The clocks of the other hosts, if its first step is to begin at one moment.
    aligning: Option<Aligning>,
    history: History,
}

impl Coordinator {
    /// Begins a deployment: asks every host of the plan to prepare. `watcher` is the call that asked for it, `listeners` want to
    /// hear of all deployments.
    pub fn begin(
        deployment: Deployment,
        (plan, signed): (Arc<Plan>, Option<Arc<Signed>>),
        watcher: Option<u64>,
        listeners: Vec<u64>,
        out: &mut Out<'_>,
    ) -> Self {
        let hosts: Vec<String> = plan.hosts.clone();
        let until = out.now + start::prepare_within(&plan);
        let mut coordinator = Self {
            registrations: Registrations { facts: Default::default(), machines: vec![String::new(); hosts.len()] },
            waiting: hosts.iter().cloned().collect(),
            history: History::new(deployment.clone(), hosts.clone()),
            hosts,
            deployment,
            begun_by: String::new(),
            origin: 0,
            wanted: Arc::clone(&plan),
            plan,
            signed,
            phase: Phase::Preparing,
            committed: false,
            begun: out.now,
            go_at: None,
            deadline: Some(until),
            reasons: Vec::new(),
            lost: BTreeSet::new(),
            back: BTreeSet::new(),
            left: BTreeSet::new(),
            unable: BTreeSet::new(),
            unconfirmed: BTreeMap::new(),
            ending: None,
            watchers: watcher.into_iter().collect(),
            listeners,
            stoppers: Vec::new(),
            is_asked: false,
            is_leaving: false,
            is_unwanted: false,
            unkeeping: 0,
            revision: (0, String::new()),
            change: None,
            changes: 0,
            rejoins: Rejoins::default(),
            switches: BTreeMap::new(),
            aligning: None,
        };
        let (deployment, hosts) = (coordinator.deployment.clone(), coordinator.hosts.clone());
        out.effects.push(Effect::PersistEpoch { deployment, hosts });
        coordinator.report(Report::Accepted { deployment: coordinator.deployment.clone() }, out);
        for host in coordinator.hosts.clone() {
            let order = ToParticipant::Prepare { plan: (*coordinator.plan).clone() };
            out.send(&host, coordinator.deployment.to_participant(order.signed(coordinator.signed.as_deref())));
        }
        coordinator
    }

    /// Takes a message of a host.
    pub fn receive(&mut self, message: ToCoordinator, from: &str, out: &mut Out<'_>) {
        let starting = matches!(self.phase, Phase::Preparing | Phase::Connecting);
        match message {
            ToCoordinator::Prepared { facts, machine } => {
                if self.phase == Phase::Preparing {
                    self.prepared(from, facts, &machine, out);
                } else {
                    self.rejoin_prepared(from, facts, &machine, out);
                }
            }
            ToCoordinator::Connected => {
                if self.phase == Phase::Connecting {
                    self.connected(from, out);
                } else {
                    self.rejoined(from, out);
                }
            }
            ToCoordinator::Refused { reasons } => {
                if starting {
                    self.refused(from, reasons, out);
                } else {
                    self.rejoin_refused(from, &reasons.join("; "), out);
                }
            }
            ToCoordinator::Released | ToCoordinator::Unconfirmed => {
                if starting {
                    return self.refused(from, vec![format!("host `{from}`: its node left")], out);
                }
                // It was said before the host was asked to take part again, since its answer to that comes after it. Or the host has left
                // again, and is asked once more when its answer is due.
                if self.rejoins.is_asked(from) {
                    return;
                }
                if message == ToCoordinator::Unconfirmed {
                    self.lost.insert(from.to_owned());
                    self.unable.insert(from.to_owned());
                }
                // A node may leave before the end.
                self.left.insert(from.to_owned());
                // Who was lost has not said so itself unless it is back.
                let is_known = !self.lost.contains(from) || self.back.contains(from);
                if message == ToCoordinator::Released && is_known {
                    self.lost.remove(from);
                    let others = self.hosts.iter().filter(|host| self.phase == Phase::Running && *host != from);
                    for host in others {
                        let cleared = ToParticipant::Cleared { host: from.to_owned() };
                        out.send(host, self.deployment.to_participant(cleared));
                    }
                    self.rejoin_later(from, out.now);
                }
                if self.phase == Phase::Ending && self.waiting.remove(from) && self.waiting.is_empty() {
                    self.finish(out);
                }
            }
            ToCoordinator::MainEnded { ending } => {
                // Who has asked for a stop is not told that something has failed, nor that it has stopped.
                let is_unconfirmed =
                    matches!(&ending, Ending::Aborted(failure) if self.is_asked && failure.cause.is_unconfirmed_stop());
                self.end(Some(if is_unconfirmed { Ending::Unconfirmed } else { ending }), out);
            }
            ToCoordinator::Happened { target, change } => self.happened(target, change, out),
            ToCoordinator::Change(reply) => self.change_reply(reply, from, out),
            ToCoordinator::SetsSwitched { call, switched } => self.sets_switched(call, switched, out),
            ToCoordinator::ClockRead { asked, shown } => self.clock_read(from, (asked, shown), out),
            ToCoordinator::BeganLate { by } => self.report(Report::BeganLate { host: from.to_owned(), by }, out),
            ToCoordinator::Stepped { group, number, steps } => self.stepped(group, (number, steps), out),
        }
    }

    /// Takes note that its epoch is on the disk, or why it is not: then nothing of it runs.
    pub fn committed(&mut self, written: Result<(), String>, out: &mut Out<'_>) {
        if let Err(why) = written {
            let home = self.plan.home().unwrap_or_default();
            self.reasons.push(format!("host `{home}`: the deployment's epoch cannot be written down: {why}"));
            return self.end(None, out);
        }
        self.committed = true;
        self.go_if_ready(out);
    }

    /// Goes on reporting to somebody who has the first `seen` reports.
    pub fn watch(&mut self, call: u64, seen: u64, out: &mut Out<'_>) {
        self.history.tell_missed(call, seen, out);
        self.watchers.push(call);
    }

    /// Tells what has happened so far, and goes on telling if the caller stays.
    pub fn listen(&mut self, call: u64, stays: bool, out: &mut Out<'_>) {
        self.history.tell(call, out);
        self.listeners.extend(stays.then_some(call));
    }

    /// Returns the hosts whose reports it takes.
    pub fn taking_part(&self) -> impl Iterator<Item = &String> {
        self.hosts.iter().filter(|host| !self.left.contains(*host))
    }

    /// Returns who has not confirmed that nothing of it is left, and why, once it is over.
    pub fn unconfirmed(&self) -> &BTreeMap<String, Why> {
        &self.unconfirmed
    }

    /// Returns what was reported, once it is over.
    pub fn into_history(self) -> History {
        self.history
    }

    /// Forgets a caller that has gone away.
    pub fn forget(&mut self, call: u64) {
        self.watchers.retain(|watcher| *watcher != call);
        self.listeners.retain(|listener| *listener != call);
        self.stoppers.retain(|stopper| *stopper != call);
    }

    /// Takes the loss of a host.
    pub fn host_lost(&mut self, host: &str, out: &mut Out<'_>) {
        if self.left.contains(host) || !self.hosts.iter().any(|other| other == host) {
            return;
        }
        match self.phase {
            Phase::Preparing | Phase::Connecting => {
                self.reasons.push(unreached(host));
                self.end(None, out);
            }
            Phase::Running => {
                self.back.remove(host);
                self.lost.insert(host.to_owned());
                self.rejoins.forget(host);
                self.change_without(host, out);
            }
            Phase::Ending => {
                self.back.remove(host);
                self.lost.insert(host.to_owned());
                if self.waiting.remove(host) && self.waiting.is_empty() {
                    self.finish(out);
                }
            }
            Phase::Over => {}
        }
    }

    /// Takes note that a host is back. What it still has of this deployment is fenced off: its part counts as failed.
    pub fn host_back(&mut self, host: &str, out: &mut Out<'_>) {
        if self.lost.contains(host) && matches!(self.phase, Phase::Running | Phase::Ending) {
            self.back.insert(host.to_owned());
            if self.phase == Phase::Ending {
                self.waiting.insert(host.to_owned());
            }
            out.send(host, self.deployment.to_participant(ToParticipant::Release));
        }
        self.rejoins.hurry(host, out.now);
    }

    /// Takes note that its node was gone: nobody could answer it meanwhile. What has not begun, and whose user was told that it is lost, does
    /// not begin any more.
    pub fn adopted(&mut self, away: Duration) {
        let has_begun = !matches!(self.phase, Phase::Preparing | Phase::Connecting);
        if !has_begun && away > AWAY_MAX {
            self.reasons.push(format!("its home was gone for {} s before it had begun", away.as_secs()));
            self.deadline = Some(Time::ZERO);
        } else {
            self.deadline = self.deadline.map(|at| at + away);
        }
        self.change.iter_mut().for_each(|change| change.adopted(away));
        self.rejoins.adopted(away);
    }

    /// Does what is due.
    pub fn tick(&mut self, out: &mut Out<'_>) {
        self.tick_change(out);
        self.tick_calls_to_switch(out);
        self.tick_rejoins(out);
        if self.deadline.is_none_or(|at| at > out.now) {
            return;
        }
        self.deadline = None;
        match self.phase {
            Phase::Preparing | Phase::Connecting => {
                if self.reasons.is_empty() {
                    let late = self.waiting.iter().map(|host| format!("host `{host}` did not answer in time"));
                    self.reasons.extend(late);
                    if self.waiting.is_empty() {
                        self.reasons.push("the disk of its home did not take its epoch in time".to_owned());
                    }
                }
                self.end(None, out);
            }
            Phase::Ending => self.finish(out),
            Phase::Running | Phase::Over => {}
        }
    }

    /// Returns when [`Coordinator::tick`] wants to be called.
    pub fn deadline(&self) -> Option<Time> {
        let change = self.change.as_ref().map(Changing::deadline);
        [change, self.rejoin_deadline(), self.switches.values().min().copied()]
            .into_iter()
            .fold(self.deadline, earliest)
    }

    fn end(&mut self, ending: Option<Ending>, out: &mut Out<'_>) {
        if matches!(self.phase, Phase::Ending | Phase::Over) {
            return;
        }
        self.phase = Phase::Ending;
        self.ending = ending;
        self.keep_end(out);
        self.rejoins = Rejoins::default();
        self.abandon_change(out);
        self.abandon_switches(out);
        let slowest = self.plan.leaves.iter().map(|leaf| leaf.stop_within).max().unwrap_or_default();
        self.deadline = Some(out.now + slowest + RELEASE_WITHIN);
        // A node that left has said so before, and does not hear this any more.
        self.waiting = self.hosts.iter().filter(|host| !self.left.contains(*host)).cloned().collect();
        for host in self.waiting.clone() {
            out.send(&host, self.deployment.to_participant(ToParticipant::Release));
        }
        if self.waiting.is_empty() {
            self.finish(out);
        }
    }

    /// Reports what is about a host, or about all.
    fn report(&mut self, report: Report, out: &mut Out<'_>) {
        let named = match &report {
            Report::Prepared { host, .. } | Report::Connected { host } | Report::BeganLate { host, .. } => {
                Some(host.as_str())
            }
            Report::Accepted { .. }
            | Report::Go { .. }
            | Report::Process { .. }
            | Report::Refused { .. }
            | Report::Finished { .. }
            | Report::Programs { .. }
            | Report::Changed { .. }
            | Report::Stepped { .. }
            | Report::Unchanged { .. }
            | Report::Replanned { .. }
            | Report::Aligned { .. }
            | Report::Omitted { .. } => self.plan.home(),
        };
        let host = (0..).zip(&self.hosts).find(|(_, host)| Some(host.as_str()) == named).map_or(0, |(host, _)| host);
        self.report_of(host, report, out);
    }

    fn report_of(&mut self, host: u32, report: Report, out: &mut Out<'_>) {
        self.history.report(report, host, (&self.watchers, &self.listeners), out);
    }
}
