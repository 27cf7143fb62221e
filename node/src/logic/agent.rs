//! The agent of a host: routes every input to the machine it belongs to, and nothing else.

mod calls;
mod crash_loop;
mod input;
mod over;
mod peers;

pub use input::Input;

use crate::logic::absence::Absence;
use crate::logic::claims::Claims;
use crate::logic::coordinator::Coordinator;
use crate::logic::effect::{Effect, Out, ProcessId, earliest};
use crate::logic::history::History;
use crate::logic::link::Link;
use crate::logic::nameserver::NameServer;
use crate::logic::participant::Participant;
use crate::logic::programs::Programs;
use crate::logic::protocol::{
    Absent, Body, ChangeOrder, ChangeReply, Containment, Deployment, Ending, Failure, FailureCause, Message,
    NodeStatus, ToCoordinator, ToParticipant,
};
use comms::logic::control::Notice;
use comms::logic::time::Time;
use language::plan::Plan;
use serde::{Deserialize, Serialize};
use shim::protocol::ShimReport;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;
use std::time::Duration;

/// How many deployments a node takes part in at once.
const DEPLOYMENTS_MAX: usize = 64;

/// How long a node that leaves waits for others to acknowledge its last messages.
const LINGER_MAX: Duration = Duration::from_secs(1);

/// How many deployments that are over are remembered, and keep their programs' output.
pub const OVER_MAX: usize = 8;

/// What an agent is told once, at its start.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Identity {
    /// Its host's name in specs.
    pub host: String,
    /// A number that no earlier run of it had.
    pub boot: u64,
    /// Its process id.
    pub pid: u32,
    /// Names the machine and its network.
    pub machine: String,
    /// The highest epoch that was given out here before.
    pub epoch: u64,
    /// The deployments with their home here that were not over when an earlier run ended, with their hosts.
    pub open: Vec<(Deployment, Vec<String>)>,
}

/// The agent of a host.
#[derive(Debug, Serialize, Deserialize)]
pub struct Agent {
    identity: Identity,
    started: Time,
    programs: Programs,
    names: NameServer,
    absence: Absence,
    /// Of each name, the links to its last boots; the one to the holder of the name is the last.
    links: BTreeMap<String, Vec<Link>>,
    /// What was told of who holds which name.
    holders: BTreeMap<String, u64>,
    coordinators: BTreeMap<Deployment, Coordinator>,
    participants: BTreeMap<Deployment, Participant>,
    requests: BTreeSet<u64>,
    awaiting_hosts: Vec<AwaitingHosts>,
    /// Reports of deployments that are over, for those who were cut off when it happened; the latest first.
    over: VecDeque<History>,
    /// The calls that listen to all that happens.
    listeners: Vec<u64>,
    /// The programs that parts of deployments had here which are over, by leaf and path; the latest first.
    past: VecDeque<(Deployment, Vec<(u32, String)>)>,
    leaving: bool,
    /// Programs of deployments that are over here, and that may still run.
    unended: BTreeMap<Deployment, UnendedPrograms>,
    /// When it was made again from its inputs, the last few times.
    adoptions: VecDeque<Time>,
    /// Until when a node of which nothing is left waits for others to acknowledge its last messages.
    lingers_until: Option<Time>,
}

/// Programs that could not be ended when their deployment was.
#[derive(Debug, Serialize, Deserialize)]
struct UnendedPrograms {
    /// The host of `main`.
    home: String,
    /// Indices into `Plan::leaves`.
    leaves: BTreeSet<u32>,
}

/// A deployment that waits for hosts which this node has not seen yet.
#[derive(Debug, Serialize, Deserialize)]
struct AwaitingHosts {
    until: Time,
    call: u64,
    plan: Plan,
    /// Who wants it.
    by: String,
}

impl Agent {
    /// Returns an agent that knows of nobody else yet.
    pub fn new(mut identity: Identity, programs: Programs, now: Time) -> Self {
        let open = std::mem::take(&mut identity.open);
        Self {
            absence: Absence::new(&identity.host, open, now),
            names: NameServer::new(&identity.host, identity.boot, now),
            identity,
            started: now,
            programs,
            links: BTreeMap::new(),
            holders: BTreeMap::new(),
            coordinators: BTreeMap::new(),
            participants: BTreeMap::new(),
            requests: BTreeSet::new(),
            awaiting_hosts: Vec::new(),
            over: VecDeque::new(),
            listeners: Vec::new(),
            past: VecDeque::new(),
            leaving: false,
            unended: BTreeMap::new(),
            adoptions: VecDeque::new(),
            lingers_until: None,
        }
    }

    /// Takes one input; appends what is to be done, in order.
    pub fn handle(&mut self, now: Time, input: Input, effects: &mut Vec<Effect>) {
        let mut more = Vec::new();
        let mut out = Out { now, effects, messages: &mut more };
        self.take(input, &mut out);
        self.tick(&mut out);
        // Messages to this node may cause more of them; each is handled after the one that caused it.
        let mut messages = VecDeque::from(std::mem::take(&mut more));
        while let Some((to, message)) = messages.pop_front() {
            let mut out = Out { now, effects, messages: &mut more };
            if to == self.identity.host {
                self.deliver(message, &to, &mut out);
            } else {
                self.transmit(&to, message, &mut out);
            }
            messages.extend(more.drain(..));
        }
        self.tidy_up(now, effects);
    }

    /// Returns whether a successor has anything to take over: a deployment, or programs of one.
    pub fn is_engaged(&self) -> bool {
        !(self.coordinators.is_empty()
            && self.participants.is_empty()
            && self.unended.is_empty()
            && self.awaiting_hosts.is_empty())
    }

    /// Returns its number among the runs of its node, which it keeps when it is made again.
    pub fn boot(&self) -> u64 {
        self.identity.boot
    }

    /// Returns since when it is there.
    pub fn started(&self) -> Time {
        self.started
    }

    /// Returns which boot of each name it deals with.
    pub fn holders(&self) -> &BTreeMap<String, u64> {
        &self.holders
    }

    /// Goes on in another process, with the programs that this one offers.
    pub fn move_to(&mut self, pid: u32, programs: Programs) {
        (self.identity.pid, self.programs) = (pid, programs);
    }

    /// Returns when [`Input::Tick`] is wanted.
    pub fn deadline(&self) -> Option<Time> {
        let coordinators = self.coordinators.values().map(Coordinator::deadline);
        let participants = self.participants.values().map(Participant::deadline);
        let links = self.links.values().flatten().map(Link::deadline);
        let gathering = self.awaiting_hosts.iter().map(|one| Some(one.until));
        coordinators
            .chain(participants)
            .chain(links)
            .chain(gathering)
            .chain([self.absence.deadline(), self.lingers_until])
            .fold(self.names.deadline(), earliest)
    }

    fn take(&mut self, input: Input, out: &mut Out<'_>) {
        match input {
            Input::Appeared { host, boot } => self.names.token(out.now, &host, boot),
            Input::Vanished { host, boot } => self.names.no_token(out.now, &host, boot),
            Input::Ping { host, boot } => self.names.heard_of(out.now, &host, boot),
            Input::Pong(pong) => self.names.answered(out.now, &pong),
            Input::Frame(frame) => self.frame(*frame, out),
            Input::Call { call, request } => self.call(call, *request, out),
            Input::CallGone { call } => {
                self.listeners.retain(|listener| *listener != call);
                self.coordinators.values_mut().for_each(|coordinator| coordinator.forget(call));
            }
            Input::Shim { process, report, output } => {
                if let Some(participant) = self.participants.get_mut(&process.deployment) {
                    participant.observe(process.leaf, report, output, out);
                } else if report == ShimReport::Gone {
                    self.loose_ended(&process, out);
                }
            }
            Input::Control { process, notice } => self.hear(&process, notice, out),
            Input::Configured { process, parameters } => {
                if let Some(participant) = self.participants.get(&process.deployment) {
                    participant.configured(process.leaf, parameters, out);
                }
            }
            Input::Found { deployment, number, problems } => {
                if let Some(participant) = self.participants.get(&deployment) {
                    participant.examined((number, &self.identity.host), problems, out);
                }
            }
            Input::Undelivered { process, why } => {
                if let Some(participant) = self.participants.get_mut(&process.deployment) {
                    participant.undelivered(process.leaf, why, out);
                }
            }
            Input::Committed { deployment, written } => {
                if let Some(coordinator) = self.coordinators.get_mut(&deployment) {
                    coordinator.committed(written, out);
                }
            }
            Input::Adopted { away } => self.adopted(out.now, away),
            Input::Leave => {
                self.leaving = true;
                self.stop_gathering(|_| true, out);
                self.coordinators.values_mut().for_each(|coordinator| coordinator.stop(None, out));
                let coordinators = &self.coordinators;
                let away =
                    self.participants.iter_mut().filter(|(deployment, _)| !coordinators.contains_key(deployment));
                away.for_each(|(_, participant)| participant.leave(out));
            }
            Input::Tick => {}
        }
    }

    /// Takes a word from a controller. One that owns what another deployment holds is refused at its hello.
    fn hear(&mut self, process: &ProcessId, notice: Notice, out: &mut Out<'_>) {
        let ProcessId { deployment, leaf } = process;
        let mut conflicts = Vec::new();
        if let Notice::Hello { owns, .. } = &notice
            && let Some(path) = self.participants.get(deployment).and_then(|participant| participant.path(*leaf))
        {
            conflicts = self.conflicts(deployment, &Claims::of_owner(path, owns));
        }
        let Some(participant) = self.participants.get_mut(deployment) else { return };
        match conflicts.first() {
            Some(why) => participant.refuse(*leaf, why, out),
            None => participant.hear(*leaf, notice, out),
        }
    }

    /// Returns why a deployment cannot hold something on this host: others do.
    fn conflicts(&self, deployment: &Deployment, claims: &Claims) -> Vec<String> {
        let others = self.participants.iter().filter(|(other, _)| *other != deployment);
        others.flat_map(|(other, participant)| claims.conflicts(other, participant.claims())).collect()
    }

    fn deliver(&mut self, message: Message, from: &str, out: &mut Out<'_>) {
        let Message { deployment, body } = message;
        match body {
            Body::Tombstone => {}
            Body::Leaves => self.absence.leaves(from),
            Body::Coordinator(message) => {
                if let Some(coordinator) = self.coordinators.get_mut(&deployment) {
                    return coordinator.receive(message, from, out);
                }
                self.confirm(&deployment, &message, from);
            }
            Body::Participant(message) => self.deliver_to_participant(&deployment, message, from, out),
        }
    }

    /// A participant obeys its own home alone; one that is not there any more says so.
    fn deliver_to_participant(
        &mut self,
        deployment: &Deployment,
        message: ToParticipant,
        from: &str,
        out: &mut Out<'_>,
    ) {
        let Some(participant) = self.participants.get_mut(deployment) else {
            return self.answer_without_participant(deployment, message, from, out);
        };
        let is_home = participant.home() == from;
        if matches!(message, ToParticipant::Prepare { .. }) {
            let reason = format!("host `{}`: `{deployment}` is already there", self.identity.host);
            out.send(from, deployment.to_coordinator(ToCoordinator::Refused { reasons: vec![reason] }));
        } else if message == ToParticipant::Release && !is_home {
            out.send(from, deployment.to_coordinator(ToCoordinator::Released));
        } else if let ToParticipant::Change(order) = message {
            if is_home {
                self.take_change(deployment, order, out);
            }
        } else if is_home || !matches!(message, ToParticipant::Connect { .. } | ToParticipant::Go) {
            participant.receive(message, from, out);
        }
    }

    /// Carries out a step of a change; what others hold is not taken.
    fn take_change(&mut self, deployment: &Deployment, order: ChangeOrder, out: &mut Out<'_>) {
        let host = &self.identity.host;
        if let ChangeOrder::Examine { number, plan } = &order {
            let mut reasons = self.conflicts(deployment, &Claims::of(plan, host));
            if self.leaving {
                reasons.push(format!("host `{host}`: its node is leaving"));
            }
            if !reasons.is_empty() {
                let reply = ChangeReply::Examined { number: *number, reasons };
                let home = self.participants.get(deployment).map(Participant::home);
                home.into_iter()
                    .for_each(|home| out.send(home, deployment.to_coordinator(ToCoordinator::Change(reply.clone()))));
                return;
            }
        }
        if let Some(participant) = self.participants.get_mut(deployment) {
            participant.take_change(order, host, &self.programs, out);
        }
    }

    fn answer_without_participant(
        &mut self,
        deployment: &Deployment,
        message: ToParticipant,
        from: &str,
        out: &mut Out<'_>,
    ) {
        if let ToParticipant::Prepare { plan } = message {
            self.prepare(deployment.clone(), plan, from, out);
        } else if message == ToParticipant::Release {
            let is_loose = self.unended.contains_key(deployment);
            out.send(
                from,
                deployment.to_coordinator(if is_loose { ToCoordinator::Unconfirmed } else { ToCoordinator::Released }),
            );
        } else if let ToParticipant::Change(order) = message {
            let reason = format!("host `{}`: its node has left the deployment", self.identity.host);
            out.send(from, deployment.to_coordinator(ToCoordinator::Change(order.failed(reason))));
        } else {
            let gone = FailureCause::NotAvailable("its node has left the deployment".to_owned());
            let answer = answer_of_absent(message, gone);
            answer.into_iter().for_each(|answer| out.send(from, deployment.to_participant(answer)));
        }
    }

    fn prepare(&mut self, deployment: Deployment, plan: Plan, from: &str, out: &mut Out<'_>) {
        let host = &self.identity.host;
        let refuse = |why: String, out: &mut Out<'_>| {
            out.send(
                from,
                deployment.to_coordinator(ToCoordinator::Refused { reasons: vec![format!("host `{host}`: {why}")] }),
            );
        };
        if self.leaving {
            return refuse("its node is leaving".into(), out);
        }
        if let Some(why) = self.namesake().or_else(|| self.crash_loop(out.now)) {
            return refuse(why, out);
        }
        if let Err(why) = plan.validate() {
            return refuse(format!("the plan is not sound: {why}"), out);
        }
        if let Some(other) = self.participants.keys().find(|other| other.name == deployment.name) {
            return refuse(format!("`{}` is already there (epoch {})", other.name, other.epoch), out);
        }
        if self.participants.len() >= DEPLOYMENTS_MAX {
            return refuse(format!("it already takes part in {DEPLOYMENTS_MAX} deployments"), out);
        }
        if let Some(why) = self.conflicts(&deployment, &Claims::of(&plan, host)).first() {
            return refuse(why.clone(), out);
        }
        let machine = self.identity.machine.clone();
        let participant =
            Participant::prepare(deployment.clone(), Arc::new(plan), (host, &machine), &self.programs, out);
        self.participants.insert(deployment, participant);
    }

    /// Says what a host that cannot be reached would have to say.
    fn answer_for_lost(&mut self, lost: &str, deployment: &Deployment, message: ToParticipant, out: &mut Out<'_>) {
        if matches!(message, ToParticipant::Prepare { .. }) {
            let reason = format!("host `{lost}` cannot be reached; start `dca-node --name {lost} --lan` on it");
            self.tell_coordinator(deployment, ToCoordinator::Refused { reasons: vec![reason] }, lost, out);
        } else if message == ToParticipant::Release {
            // A host that never took part has nothing to release; one that was lost is told about as unconfirmed.
            self.tell_coordinator(deployment, ToCoordinator::Released, lost, out);
        } else if let ToParticipant::Change(order) = message {
            let reply = order.failed(format!("host `{lost}` cannot be reached"));
            self.tell_coordinator(deployment, ToCoordinator::Change(reply), lost, out);
        } else {
            let answer = answer_of_absent(message, FailureCause::HostLost(lost.to_owned()));
            let here = self.identity.host.clone();
            answer.into_iter().for_each(|answer| out.send(&here, deployment.to_participant(answer)));
        }
    }

    fn tell_coordinator(&mut self, deployment: &Deployment, message: ToCoordinator, from: &str, out: &mut Out<'_>) {
        if let Some(coordinator) = self.coordinators.get_mut(deployment) {
            coordinator.receive(message, from, out);
        }
    }

    fn status(&self, now: Time) -> NodeStatus {
        NodeStatus {
            host: self.identity.host.clone(),
            pid: self.identity.pid,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            up: now - self.started,
            peers: self.names.present().map(str::to_owned).collect(),
            deployments: self.participants.values().map(Participant::status).collect(),
            // The driver knows.
            containment: Containment::default(),
        }
    }

    /// Returns what is known of hosts that do not answer.
    fn absent(&self, now: Time) -> Absent {
        let mut absent = self.absence.told(now);
        let is_away = |host: &str| *host != *self.identity.host && !self.names.reaches(host);
        absent.processes = self.participants.values().flat_map(|participant| participant.elsewhere(is_away)).collect();
        absent
    }

    fn tick(&mut self, out: &mut Out<'_>) {
        self.look_around(out);
        self.begin_gathered(out);
        let names = &self.names;
        self.absence.tick(|host| names.reaches(host), out);
        for (host, links) in &mut self.links {
            for frame in links.iter_mut().flat_map(|link| link.resend(out.now)) {
                out.effects.push(Effect::Transmit { to: host.clone(), frame: Box::new(frame) });
            }
        }
        self.coordinators.values_mut().for_each(|coordinator| coordinator.tick(out));
        self.participants.values_mut().for_each(|participant| participant.tick(out));
    }
}

/// Returns what a part of a deployment that is not there would have to say to its supervisor, so that nobody waits for
/// ever.
fn answer_of_absent(message: ToParticipant, cause: FailureCause) -> Option<ToParticipant> {
    match message {
        ToParticipant::Activate { target, activation, .. } => {
            // The supervisor knows the path and the time.
            let failure = Failure { origin: String::new(), cause, at: Duration::ZERO };
            Some(ToParticipant::Ended { target, activation, ending: Ending::Aborted(failure) })
        }
        ToParticipant::Stop { target, activation } => {
            let ending = if let FailureCause::HostLost(host) = cause {
                let cause = FailureCause::HostLostStopping(host);
                Ending::Aborted(Failure { origin: String::new(), cause, at: Duration::ZERO })
            } else {
                Ending::Unconfirmed
            };
            Some(ToParticipant::Ended { target, activation, ending })
        }
        ToParticipant::Switch { group, generation, .. } => Some(ToParticipant::Switched { group, generation }),
        ToParticipant::Prepare { .. }
        | ToParticipant::Connect { .. }
        | ToParticipant::Go
        | ToParticipant::Release
        | ToParticipant::Ended { .. }
        | ToParticipant::Switched { .. }
        | ToParticipant::Moved { .. }
        | ToParticipant::Loose { .. }
        | ToParticipant::Cleared { .. }
        | ToParticipant::Change(_) => None,
    }
}
