//! A deployment at its home node (the host of `main`): PREPARE on every host, CONNECT, GO, and the end.
//!
//! ```text
//! Starting: Preparing ─all prepared─▶ Connecting ─all connected─▶ Running ─main ended─▶ Ending ─all released─▶ Over
//!               └─────── refused, late, host failed, stopped ────────▶ Ending
//! ```
//! The epoch is written to the disk during the start, before GO.
//!
//! The answer to `deploy` is the outcome. Every caller gets each report when it is made. The last report comes when
//! nothing of the deployment is left on any host that can be reached.
//!
//! *Parts.* `start` leads to GO, and `aligned` compares the clocks for a start at one moment. `host` is a host of the
//! deployment, and `rejoin` its return. `change` is a change of the plan, and `switching` the calls for connection
//! sets. `stop` is the end that a user or the node asked for. `mission` has the plan, its hosts and its callers, which
//! all parts need. Only this file brings the parts together.

mod aligned;
mod change;
mod host;
mod mission;
mod rejoin;
mod start;
mod stop;
mod switching;
mod telling;

pub use mission::Requested;

use crate::logic::effect::{Effect, Out, earliest};
use crate::logic::history::{Audience, History};
use crate::logic::protocol::{
    Answer, ChangeRequest, Delivery, Deployment, DeploymentStatus, Ending, Failure, FailureCause, Kept, LeafFacts,
    Report, Revision, Signed, StartMode, SwitchRequest, Target, TellRequest, ToCoordinator, ToParticipant, Why,
    unreached,
};
use crate::logic::wiring::Registrations;
use change::Changes;
use comms::logic::time::Time;
use host::HostPart;
use mission::Mission;
use serde::{Deserialize, Serialize};
use start::{Next, Start};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;
use stop::{Stop, StopBy};
use switching::Switches;
use telling::Orders;

/// How long all hosts have to start their programs, if the plan gives no program more time than usual to be ready.
pub(super) const PREPARE_WITHIN: Duration = Duration::from_secs(40);
/// How long all hosts have to make their links.
pub(super) const CONNECT_WITHIN: Duration = Duration::from_secs(48);
/// How long all hosts have to remove everything, in addition to the time that their programs may take to stop.
pub(super) const RELEASE_WITHIN: Duration = Duration::from_secs(25);
/// How long the other hosts have to add their reasons after a host has refused.
pub(super) const REASONS_WITHIN: Duration = Duration::from_secs(2);

/// A deployment at its home.
#[derive(Debug, Serialize, Deserialize)]
pub struct Coordinator {
    mission: Mission,
    phase: Phase,
    changes: Changes,
    switches: Switches,
    orders: Orders,
}

#[derive(Debug, Serialize, Deserialize)]
enum Phase {
    Starting(Start),
    Running,
    Ending(End),
    /// The hosts that have not confirmed that nothing of the deployment is left there, each with the reason.
    Over(BTreeMap<String, Why>),
}

/// The end of a deployment, until all hosts have released everything.
#[derive(Debug, Serialize, Deserialize)]
struct End {
    /// How the deployment ended, or why it did not begin.
    outcome: Result<Ending, Vec<String>>,
    until: Time,
    /// The hosts that have not released everything.
    awaited: BTreeSet<String>,
}

impl Coordinator {
    /// Begins a deployment: asks every host of the plan to prepare.
    pub fn begin(
        deployment: Deployment,
        request: Requested,
        start: StartMode,
        audience: Audience,
        out: &mut Out<'_>,
    ) -> Self {
        let plan = Arc::clone(&request.wanted);
        let hosts = plan.hosts.clone();
        let mut mission = Mission {
            hosts: hosts.iter().map(|host| (host.clone(), HostPart::default())).collect(),
            rejoins: 0,
            registrations: Registrations { facts: BTreeMap::new(), machines: vec![String::new(); hosts.len()] },
            history: History::new(deployment.clone(), hosts.clone()),
            deployment: deployment.clone(),
            request,
            plan,
            go_at: None,
            audience,
            stop: Stop::default(),
        };
        out.effects.push(Effect::PersistEpoch { deployment: deployment.clone(), hosts });
        mission.report(Report::Accepted { deployment }, out);
        let phase = Phase::Starting(Start::new(&mission, start, out));
        Self { mission, phase, changes: Changes::default(), switches: Switches::default(), orders: Orders::default() }
    }

    /// Takes a message of a host.
    pub fn receive(&mut self, message: ToCoordinator, from: &str, out: &mut Out<'_>) {
        let mission = &mut self.mission;
        let message = match &mut self.phase {
            Phase::Starting(start) => match start.receive(mission, message, from, out) {
                Ok(next) => return self.follow(next, out),
                Err(message) => message,
            },
            Phase::Running | Phase::Ending(_) | Phase::Over(_) => message,
        };
        match message {
            ToCoordinator::Prepared { facts, machine } => mission.rejoin_prepared(from, facts, &machine, out),
            ToCoordinator::Connected => mission.rejoined(from, out),
            ToCoordinator::Refused { reasons } => mission.rejoin_refused(from, &reasons.join("; "), out),
            ToCoordinator::ClockRead { .. } => {}
            ToCoordinator::Released => self.left(from, true, out),
            ToCoordinator::Unconfirmed => self.left(from, false, out),
            ToCoordinator::MainEnded { ending } => {
                // A user has asked for a stop, and a program may still run. So the user is not told that something
                // failed, nor that everything has stopped.
                let is_unconfirmed = matches!(&ending, Ending::Aborted(failure) if failure.cause.is_unconfirmed_stop());
                let is_unconfirmed = is_unconfirmed && mission.stop.by != StopBy::None;
                self.end(Some(if is_unconfirmed { Ending::Unconfirmed } else { ending }), out);
            }
            ToCoordinator::Happened { target, change } => mission.happened(target, change, out),
            ToCoordinator::Change(reply) => self.changes.reply(mission, reply, from, out),
            ToCoordinator::SetsSwitched { call, switched } => self.switches.switched(call, switched, out),
            ToCoordinator::Answered { call, taken } => self.orders.told(call, taken, out),
            ToCoordinator::BeganLate { by } => mission.report(Report::BeganLate { host: from.to_owned(), by }, out),
            ToCoordinator::Stepped { group, number, steps, changes } => {
                mission.stepped(group, number, steps, changes, out);
            }
        }
    }

    /// Takes the report of a host that has released everything, or could not end everything.
    fn left(&mut self, from: &str, is_all: bool, out: &mut Out<'_>) {
        // A host that was asked to rejoin refuses before it leaves again. So a report of leaving is older than the request.
        let Some(host) = self.mission.hosts.get_mut(from).filter(|host| !host.is_asked()) else { return };
        if !is_all {
            host.is_unable();
        } else if host.released() && matches!(self.phase, Phase::Running) {
            self.mission.cleared(from, out);
        }
        if matches!(self.phase, Phase::Running) {
            let why = format!("host `{from}`: its node has left the deployment");
            self.changes.without(&mut self.mission, from, why, out);
        }
        self.release_confirmed(from, out);
    }

    /// Notes that this host has released everything, or will not answer: the end no longer waits for the host.
    fn release_confirmed(&mut self, host: &str, out: &mut Out<'_>) {
        if let Phase::Ending(end) = &mut self.phase
            && end.awaited.remove(host)
            && end.awaited.is_empty()
        {
            self.finish(out);
        }
    }

    /// Takes the next step of the start.
    fn follow(&mut self, next: Next, out: &mut Out<'_>) {
        match next {
            Next::Wait => {}
            Next::Refuse => self.end(None, out),
            Next::Go => {
                if let Phase::Starting(start) = std::mem::replace(&mut self.phase, Phase::Running) {
                    start.go(&mut self.mission, out);
                }
            }
        }
    }

    /// Takes the answer of the disk about the epoch. If the disk has not written the epoch, nothing runs.
    pub fn committed(&mut self, written: Result<(), String>, out: &mut Out<'_>) {
        if let Err(why) = written {
            let home = self.mission.plan.home().unwrap_or_default();
            self.refuse(format!("host `{home}`: the deployment's epoch cannot be written down: {why}"), out);
        } else if let Phase::Starting(start) = &mut self.phase {
            let next = start.committed(&self.mission, out);
            self.follow(next, out);
        }
    }

    /// Refuses to begin the deployment, for this reason.
    fn refuse(&mut self, reason: String, out: &mut Out<'_>) {
        match &mut self.phase {
            Phase::Starting(start) => {
                start.reasons.push(reason);
                self.end(None, out);
            }
            Phase::Ending(End { outcome: Err(reasons), .. }) => reasons.push(reason),
            Phase::Running | Phase::Ending(_) | Phase::Over(_) => {}
        }
    }

    /// Sends a caller the reports after the first `seen`, and then each new report.
    pub fn watch(&mut self, call: u64, seen: u64, out: &mut Out<'_>) {
        self.mission.history.tell_missed(call, seen, out);
        self.mission.audience.watchers.push(call);
    }

    /// Sends all reports so far. If the caller stays, it gets each new report as well.
    pub fn listen(&mut self, call: u64, stays: bool, out: &mut Out<'_>) {
        self.mission.history.tell(call, out);
        self.mission.audience.listeners.extend(stays.then_some(call));
    }

    /// Forgets a caller that has gone away.
    pub fn forget(&mut self, call: u64) {
        self.mission.audience.forget(call);
        self.mission.stop.calls.retain(|other| *other != call);
    }

    /// Returns the hosts of the plan.
    pub fn hosts(&self) -> impl Iterator<Item = &String> {
        self.mission.hosts.keys()
    }

    /// Returns the hosts that take part and can be reached.
    pub fn taking_part(&self) -> impl Iterator<Item = &String> {
        self.mission.hosts.iter().filter(|(_, part)| part.is_active()).map(|(host, _)| host)
    }

    /// Returns its state on the home after the processes there have ended.
    pub fn status(&self, home: &str) -> DeploymentStatus {
        let phase = match self.phase {
            Phase::Starting(_) => "preparing",
            Phase::Running => "running",
            Phase::Ending(_) | Phase::Over(_) => "ending",
        };
        DeploymentStatus {
            deployment: self.mission.deployment.clone(),
            home: home.to_owned(),
            phase: phase.to_owned(),
            processes: Vec::new(),
            lost: Vec::new(),
            refused: Vec::new(),
            undelivered: Vec::new(),
        }
    }

    /// Returns the name of the user who deployed it.
    pub fn begun_by(&self) -> &str {
        &self.mission.request.by
    }

    /// Returns the epoch under which the user deployed it.
    pub fn origin(&self) -> u64 {
        self.mission.request.origin
    }

    /// Returns whether the deployment is over.
    pub fn is_over(&self) -> bool {
        matches!(self.phase, Phase::Over(_))
    }

    /// Returns whether the deployment is over or is about to be.
    pub fn is_ending(&self) -> bool {
        matches!(self.phase, Phase::Ending(_) | Phase::Over(_))
    }

    /// Returns the reports of a deployment that is over, and the hosts that have not confirmed that nothing is left there.
    pub fn into_history(self) -> (History, BTreeMap<String, Why>) {
        let unconfirmed = match self.phase {
            Phase::Over(unconfirmed) => unconfirmed,
            Phase::Starting(_) | Phase::Running | Phase::Ending(_) => BTreeMap::new(),
        };
        (self.mission.history, unconfirmed)
    }

    /// Returns the record of the deployment for the disk; nothing if the deployment is ending, or a user has asked for its end.
    pub fn kept(&self) -> Option<Kept> {
        (!self.is_ending() && self.mission.stop.by != StopBy::User).then(|| self.mission.kept(false))
    }

    /// Handles the failure of a host.
    pub fn host_lost(&mut self, name: &str, out: &mut Out<'_>) {
        let Some(host) = self.mission.hosts.get_mut(name).filter(|host| host.is_active()) else { return };
        match &mut self.phase {
            Phase::Starting(_) => self.refuse(unreached(name), out),
            Phase::Running => {
                host.fail();
                self.changes.without(&mut self.mission, name, unreached(name), out);
            }
            Phase::Ending(_) => {
                host.fail();
                self.release_confirmed(name, out);
            }
            Phase::Over(_) => {}
        }
    }

    /// Handles the return of a host. The host is told to release everything that it still has of this deployment: its part has failed.
    pub fn host_back(&mut self, name: &str, out: &mut Out<'_>) {
        let Some(host) = self.mission.hosts.get_mut(name) else { return };
        let rejoin = &mut host.rejoin;
        rejoin.iter_mut().for_each(|rejoin| rejoin.hurry(out.now));
        match &mut self.phase {
            Phase::Running if host.is_back() => {}
            Phase::Ending(end) if host.is_back() => {
                end.awaited.insert(name.to_owned());
            }
            Phase::Starting(_) | Phase::Running | Phase::Ending(_) | Phase::Over(_) => return,
        }
        self.mission.tell(name, ToParticipant::Release, out);
    }

    /// Records the new location of a restarted program.
    pub fn moved(&mut self, facts: &LeafFacts, from: &str, out: &mut Out<'_>) {
        if self.mission.moved(facts, from) && matches!(self.phase, Phase::Running) {
            self.mission.tell_where([facts.leaf], out);
        }
    }

    /// Notes that the node was gone and could not receive any answer: the hosts get that much more time to answer.
    pub fn adopted(&mut self, away: Duration) {
        match &mut self.phase {
            Phase::Starting(start) => start.adopted(away),
            Phase::Ending(end) => end.until = end.until + away,
            Phase::Running | Phase::Over(_) => {}
        }
        self.changes.adopted(away);
        let rejoins = self.mission.hosts.values_mut().filter_map(|host| host.rejoin.as_mut());
        rejoins.for_each(|rejoin| rejoin.adopted(away));
    }

    /// Does everything that is due.
    pub fn tick(&mut self, out: &mut Out<'_>) {
        self.changes.tick(&mut self.mission, out);
        self.switches.tick(out);
        self.orders.tick(&self.mission, out);
        self.mission.tick_rejoins(!self.changes.is_busy(), out);
        match &mut self.phase {
            Phase::Starting(start) if start.until <= out.now => {
                start.late();
                self.end(None, out);
            }
            Phase::Ending(end) if end.until <= out.now => self.finish(out),
            Phase::Starting(_) | Phase::Running | Phase::Ending(_) | Phase::Over(_) => {}
        }
    }

    /// Returns when [`Coordinator::tick`] wants to be called.
    pub fn deadline(&self) -> Option<Time> {
        let phase = match &self.phase {
            Phase::Starting(start) => Some(start.until),
            Phase::Ending(end) => Some(end.until),
            Phase::Running | Phase::Over(_) => None,
        };
        let rejoins = self.mission.rejoin_deadline(!self.changes.is_busy());
        let calls = [self.switches.deadline(), self.orders.deadline()];
        [self.changes.deadline(), rejoins].into_iter().chain(calls).fold(phase, earliest)
    }

    /// Returns the plan that runs, for a user who wants to change it.
    pub fn revision(&self) -> Revision {
        self.changes.revision(&self.mission)
    }

    /// Begins a change; `call` gets its outcome.
    pub fn change(&mut self, call: u64, request: ChangeRequest, signed: Option<Arc<Signed>>, out: &mut Out<'_>) {
        let deployment = &self.mission.deployment;
        if !matches!(self.phase, Phase::Running) || deployment.epoch != request.epoch {
            let reasons = vec![format!("`{}@{}` does not run", deployment.name, request.epoch)];
            return out.answer_last(call, Answer::Report(Report::Unchanged { by: request.by, reasons }));
        }
        self.changes.ask(&self.mission, call, request, signed, out);
    }

    /// Tells a supervisor to switch a process; `call` is answered when the supervisor has confirmed the switch.
    pub fn switch(&mut self, call: u64, request: &SwitchRequest, out: &mut Out<'_>) {
        let asked = if matches!(self.phase, Phase::Running) {
            self.switches.ask(&self.mission, call, request, out)
        } else {
            Err(format!("`{}` does not run", self.mission.deployment.name))
        };
        if let Err(why) = asked {
            out.answer_last(call, Answer::Switched(Err(why)));
        }
    }

    /// Gives an order to an activity; `call` is answered when the activity has confirmed it.
    pub fn tell(&mut self, call: u64, request: &TellRequest, out: &mut Out<'_>) {
        let asked = if matches!(self.phase, Phase::Running) {
            self.orders.give(&self.mission, call, request, out)
        } else {
            Err(Delivery::Refused(format!("`{}` does not run", self.mission.deployment.name)))
        };
        if let Err(answer) = asked {
            out.answer_last(call, Answer::Delivered(answer));
        }
    }

    /// Stops the deployment because a user asked, or because its node leaves. `call` is answered when nothing is left.
    pub fn stop(&mut self, call: Option<u64>, out: &mut Out<'_>) {
        self.mission.stop.ask(call);
        if call.is_some() {
            self.mission.stop.unkeep(&self.mission.deployment, out);
        }
        match self.phase {
            Phase::Starting(_) => self.refuse("it was stopped before it ran".to_owned(), out),
            Phase::Running => {
                let Some(home) = self.mission.plan.home() else { return };
                self.mission.tell(home, ToParticipant::Stop { target: Target::Group(0), activation: 1 }, out);
            }
            Phase::Ending(_) | Phase::Over(_) => {}
        }
    }

    /// Aborts the deployment at once, for this cause.
    pub fn abort(&mut self, cause: FailureCause, out: &mut Out<'_>) {
        if !matches!(self.phase, Phase::Running) {
            return self.refuse(format!("it {cause}"), out);
        }
        let origin = self.mission.plan.groups.first().map(|main| main.path.clone()).unwrap_or_default();
        let at = self.mission.since_go(out.now);
        self.end(Some(Ending::Aborted(Failure { origin, cause, at })), out);
    }

    /// Takes the answer of the disk, which has forgotten the deployment or has failed to forget it.
    pub fn unkept(&mut self, out: &mut Out<'_>) {
        self.mission.stop.unkeeping = self.mission.stop.unkeeping.saturating_sub(1);
        if matches!(&self.phase, Phase::Ending(end) if end.awaited.is_empty()) {
            self.finish(out);
        }
    }

    /// Asks the disk again to forget the deployment: a node that was killed did not receive the answer.
    pub fn unkeep_again(&mut self, out: &mut Out<'_>) {
        let Mission { stop, deployment, .. } = &mut self.mission;
        if stop.unkeeping > 0 {
            stop.unkeeping = 0;
            stop.unkeep(deployment, out);
        }
    }

    /// Begins the end: tells all hosts to release everything.
    fn end(&mut self, ending: Option<Ending>, out: &mut Out<'_>) {
        let reasons = match &mut self.phase {
            Phase::Starting(start) => std::mem::take(&mut start.reasons),
            Phase::Running => Vec::new(),
            Phase::Ending(_) | Phase::Over(_) => return,
        };
        let mission = &mut self.mission;
        // The node leaves, perhaps for a reboot. So the deployment may be started again.
        if mission.stop.by == StopBy::Node && !matches!(ending, Some(Ending::Done(_))) {
            out.effects.push(Effect::Keep(Box::new(mission.kept(true))));
        } else {
            mission.stop.unkeep(&mission.deployment, out);
        }
        mission.hosts.values_mut().for_each(|host| host.rejoin = None);
        self.changes.abandon(out);
        self.switches.abandon(&mission.deployment.name, out);
        self.orders.abandon(&mission.deployment.name, out);
        let slowest = mission.plan.leaves.iter().map(|leaf| leaf.stop_within).max().unwrap_or_default();
        // A host whose node has left has already reported that, and no longer receives this order.
        let awaited: BTreeSet<String> = self.taking_part().cloned().collect();
        let mission = &mut self.mission;
        awaited.iter().for_each(|host| mission.tell(host, ToParticipant::Release, out));
        let is_released = awaited.is_empty();
        let outcome = ending.ok_or(reasons);
        self.phase = Phase::Ending(End { outcome, until: out.now + slowest + RELEASE_WITHIN, awaited });
        if is_released {
            self.finish(out);
        }
    }

    /// Completes the end. If a user asked for the end, this waits until the disk has forgotten the deployment, or the
    /// time limit of the end is over.
    fn finish(&mut self, out: &mut Out<'_>) {
        let mission = &mut self.mission;
        let End { outcome, awaited, .. } = match &mut self.phase {
            Phase::Ending(end) if mission.stop.unkeeping == 0 || end.until <= out.now => end,
            Phase::Starting(_) | Phase::Running | Phase::Ending(_) | Phase::Over(_) => return,
        };
        let why = |(host, part): (&String, &HostPart)| Some((host.clone(), part.unconfirmed(awaited.contains(host))?));
        let unconfirmed: BTreeMap<String, Why> = mission.hosts.iter().filter_map(why).collect();
        let last = match std::mem::replace(outcome, Err(Vec::new())) {
            Ok(ending) => Report::Finished {
                ending,
                at: mission.since_go(out.now),
                unconfirmed: unconfirmed.keys().cloned().collect(),
            },
            Err(reasons) => Report::Refused { reasons },
        };
        self.phase = Phase::Over(unconfirmed);
        mission.report(last, out);
        for call in std::mem::take(&mut mission.audience.watchers) {
            out.effects.push(Effect::EndAnswers { call });
        }
        mission.stop.answer(out);
    }
}
