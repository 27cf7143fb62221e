//! The agent of a host: routes every input to the machine it belongs to, and nothing else.
//!
//! This file has the inputs of the driver, and the time. `delivery` has the messages between nodes, and `calls` the calls of
//! command lines. Each other file has a part of the agent, which owns its state.

mod boot;
mod calls;
mod check_in;
mod delivery;
mod estop;
mod external;
mod input;
mod inquiries;
mod namesakes;
mod orders;
mod past;
mod peers;
mod pending;
mod promises;
mod run;
mod tombstones;

use check_in::CheckIns;
use estop::Stopped;
pub use input::Input;
use inquiries::Inquiries;
use orders::Orders;
pub use past::OVER_MAX;
use past::Past;
use peers::Peers;
use pending::Pending;
use promises::Promises;
use run::Run;

use crate::logic::claims::Claims;
use crate::logic::coordinator::Coordinator;
use crate::logic::database::chronicle;
use crate::logic::effect::{Effect, Out, ProcessId, earliest};
use crate::logic::participant::Participant;
use crate::logic::programs::Programs;
use crate::logic::protocol::{
    Absent, Containment, Deployment, DeploymentStatus, Earlier, Estop, Message, Network, NodeStatus, ToCoordinator, Why,
};
use comms::logic::control::Notice;
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use shim::protocol::ShimReport;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

/// How many deployments a node takes part in at once.
const DEPLOYMENTS_MAX: usize = 64;

/// The facts that an agent is given once, at its start.
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
    /// Whether it is in a team: then the orders of other nodes are judged before they start anything.
    pub is_guarded: bool,
    /// The user who stopped everything, if the previous run ended in that state.
    pub estop: Option<Estop>,
    /// The deployments that ran before, and those that were stopped elsewhere.
    pub earlier: Earlier,
}

/// The agent of a host.
#[derive(Debug, Serialize, Deserialize)]
pub struct Agent {
    identity: Identity,
    run: Run,
    programs: Programs,
    peers: Peers,
    coordinators: BTreeMap<Deployment, Coordinator>,
    participants: BTreeMap<Deployment, Participant>,
    pending: Pending,
    past: Past,
    callers: Callers,
    orders: Orders,
    stopped: Stopped,
}

/// The calls and hosts that wait for an answer.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Callers {
    /// The calls that listen to every event.
    listeners: Vec<u64>,
    /// The calls that ask for every event so far.
    inquiries: Inquiries,
    check_ins: CheckIns,
    promises: Promises,
}

impl Agent {
    /// Returns an agent that knows no other node yet.
    pub fn new(mut identity: Identity, programs: Programs, now: Time) -> Self {
        let open = std::mem::take(&mut identity.open);
        let stopped = Stopped::before(identity.estop.take());
        let Earlier { running, tombstones } = std::mem::take(&mut identity.earlier);
        Self {
            run: Run::new(now),
            peers: Peers::new(&identity.host, identity.boot, open, now),
            pending: Pending::new(running, tombstones.into_iter().collect()),
            identity,
            programs,
            coordinators: BTreeMap::new(),
            participants: BTreeMap::new(),
            past: Past::default(),
            callers: Callers::default(),
            orders: Orders::default(),
            stopped,
        }
    }

    /// Takes one input; appends the effects in order.
    pub fn handle(&mut self, now: Time, input: Input, effects: &mut Vec<Effect>) {
        if let Input::Calendar { origin } = input {
            self.run.calendar = origin;
            return;
        }
        let (mut more, since_1970) = (Vec::new(), self.run.since_1970(now));
        let mut out = Out { now, since_1970, effects, messages: &mut more };
        self.callers.check_ins.check_in(&self.peers.names, self.participants.values_mut(), &mut out);
        // This comes first, so that even a caller whose question is the first input gets these deployments.
        self.look_back(&mut out);
        self.take(input, &mut out);
        self.tick(&mut out);
        // Messages to this node may cause further messages. Each message is handled after the message that caused it.
        let mut messages = VecDeque::from(std::mem::take(&mut more));
        loop {
            while let Some((to, message)) = messages.pop_front() {
                let mut out = Out { now, since_1970, effects, messages: &mut more };
                if to == self.identity.host {
                    self.deliver_own(message, &mut out);
                } else {
                    self.orders.note_outcome(&to, &message, out.effects);
                    self.transmit(&to, message, &mut out);
                }
                messages.extend(more.drain(..));
            }
            let mut out = Out { now, since_1970, effects, messages: &mut more };
            external::look_at(&mut self.participants, &self.programs, &mut out);
            messages.extend(more.drain(..));
            if messages.is_empty() {
                break;
            }
        }
        self.tidy_up(now, effects);
    }

    /// Returns whether the next node has anything to take over: a deployment, a deployment that has just ended, or
    /// programs of a deployment.
    pub fn is_engaged(&self, now: Time) -> bool {
        let is_idle = self.coordinators.is_empty() && self.participants.is_empty() && self.pending.waiting().is_empty();
        self.past.is_engaged(now) || !is_idle
    }

    /// Returns its number among the runs of its node, which it keeps when it is made again.
    pub fn boot(&self) -> u64 {
        self.identity.boot
    }

    /// Returns the time of the calendar clock at [`Time::ZERO`], if it is known.
    pub fn calendar(&self) -> Duration {
        self.run.calendar
    }

    /// Returns the time at which this node began.
    pub fn started(&self) -> Time {
        self.run.started
    }

    /// Returns the boot that holds each name.
    pub fn holders(&self) -> &BTreeMap<String, u64> {
        self.peers.holders()
    }

    /// Returns the hosts that get the beats of this node.
    pub fn beaten(&self) -> &BTreeSet<String> {
        self.peers.beaten()
    }

    /// Continues in another process, with the programs that the new process offers, and with or without a team.
    pub fn move_to(&mut self, pid: u32, programs: Programs, is_guarded: bool) {
        (self.identity.pid, self.programs, self.identity.is_guarded) = (pid, programs, is_guarded);
    }

    /// Returns the epoch of a deployment that has its home here. Returns 0 if there is no such deployment.
    pub fn epoch(&self, name: &str) -> u64 {
        self.coordinators.keys().find(|deployment| deployment.name == name).map_or(0, |deployment| deployment.epoch)
    }

    /// Returns the total number of programs and groups that were looked at.
    pub fn visits(&self) -> u64 {
        self.participants.values().map(Participant::visits).sum()
    }

    /// Returns the time at which [`Input::Tick`] must come as exactly as possible, because programs begin at this time.
    pub fn starts_at(&self) -> Option<Time> {
        self.participants.values().filter_map(Participant::starts_at).min()
    }

    /// Returns when [`Input::Tick`] is wanted.
    pub fn deadline(&self) -> Option<Time> {
        let coordinators = self.coordinators.values().map(Coordinator::deadline);
        let participants = self.participants.values().map(Participant::deadline);
        let looking_back = self.pending.looks_back().then_some(self.run.started);
        coordinators
            .chain(participants)
            .chain([self.peers.names.deadline(), self.peers.absence.deadline(), self.peers.links_deadline()])
            .chain([self.pending.deadline(), self.callers.inquiries.deadline()])
            .chain([self.run.deadline(), self.past.deadline(), looking_back])
            .fold(None, earliest)
    }

    fn take(&mut self, input: Input, out: &mut Out<'_>) {
        match input {
            Input::Appeared { host, boot } => self.peers.names.token(out.now, &host, boot),
            Input::Vanished { host, boot } => self.peers.names.no_token(out.now, &host, boot),
            Input::Ping { host, boot } => self.peers.names.heard_of(out.now, &host, boot),
            Input::Pong(pong) => self.peers.names.answered(out.now, &pong),
            Input::Namesake(namesake) => self.greeted(&namesake, out),
            Input::Frame(frame) => self.frame(*frame, out),
            Input::Call { call, request } => {
                self.peers.names.watch(out.now);
                self.take_call(call, *request, out);
            }
            Input::Judged { number, verdict } => self.judged(number, verdict, out),
            Input::Resumable { deployment, verdict } => self.resumable(&deployment, verdict, out),
            Input::CallGone { call } => self.forget_call(call),
            Input::Shim { process, report, output } => {
                if let Some(participant) = self.participants.get_mut(&process.deployment) {
                    participant.observe(process.leaf, report, output, out);
                } else if report == ShimReport::Gone {
                    self.program_ended(&process, out);
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
                    participant.examined(number, problems, out);
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
            Input::EstopKept { number, written } => self.stopped.kept(number, written, out),
            Input::Unkept { deployment, written } => {
                if let Some(home) = self.coordinators.get_mut(&deployment) {
                    home.unkept(out);
                }
                self.callers.promises.unkept(&deployment, &self.identity.host, &written, out);
            }
            Input::Adopted { away, programs } => {
                self.callers.inquiries.adopted(programs);
                self.adopted(away, out);
            }
            Input::Reached { process } => self.callers.inquiries.reached(&process),
            Input::Leave => {
                self.run.leaving = true;
                self.stop_gathering(|_| true, calls::STOPPED, out);
                self.coordinators.values_mut().for_each(|coordinator| coordinator.stop(None, out));
                let coordinators = &self.coordinators;
                let away =
                    self.participants.iter_mut().filter(|(deployment, _)| !coordinators.contains_key(deployment));
                away.for_each(|(_, participant)| participant.give_up("its node is leaving", out));
            }
            Input::Calendar { .. } | Input::Tick => {}
        }
    }

    /// Forgets a call whose caller is gone.
    fn forget_call(&mut self, call: u64) {
        self.callers.listeners.retain(|listener| *listener != call);
        self.callers.inquiries.forget(call);
        self.stopped.forget(call);
        self.callers.promises.forget(call);
        self.coordinators.values_mut().for_each(|coordinator| coordinator.forget(call));
    }

    /// Continues after the agent was made again from its inputs. The killed node may have left some
    /// questions and writes undone, and has not received the answers.
    fn adopted(&mut self, away: Duration, out: &mut Out<'_>) {
        self.run.adopted(out.now);
        self.coordinators.values_mut().for_each(|coordinator| coordinator.adopted(away));
        self.participants.values_mut().for_each(|participant| participant.adopted(away));
        self.stopped.keep(out);
        let running = self.coordinators.values().filter_map(Coordinator::kept);
        out.effects.push(Effect::KeepAll(running.chain(self.pending.kept()).collect()));
        self.pending.tombstones.keep(out);
        self.callers.promises.unkeep_again(out);
        self.coordinators.values_mut().for_each(|home| home.unkeep_again(out));
        self.orders.judge_again(out);
        self.pending.ask_again(out);
    }

    /// Takes a message from a controller. A controller that owns a device which another deployment holds is refused at
    /// its hello.
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

    /// Returns why a deployment cannot hold some devices on this host: other deployments hold them.
    fn conflicts(&self, deployment: &Deployment, claims: &Claims) -> Vec<String> {
        let others = self.participants.iter().filter(|(other, _)| *other != deployment);
        let running = others.flat_map(|(other, participant)| claims.conflicts(other, participant.claims()));
        running.chain(self.past.conflicts(deployment, claims)).collect()
    }

    /// Returns why this node begins no deployment. None if it may begin a deployment.
    fn obstacle(&self, now: Time) -> Option<String> {
        self.peers.namesake().or_else(|| self.stopped.obstacle()).or_else(|| self.run.crash_loop(now))
    }

    /// Takes note that nothing is left of a program which could not be ended with its deployment.
    fn program_ended(&mut self, process: &ProcessId, out: &mut Out<'_>) {
        if let Some(home) = self.past.program_ended(process) {
            out.send(&home, process.deployment.to_coordinator(ToCoordinator::Released));
        }
    }

    fn status(&self, now: Time) -> NodeStatus {
        NodeStatus {
            host: self.identity.host.clone(),
            pid: self.identity.pid,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            up: now - self.run.started,
            peers: self.peers.names.present().map(str::to_owned).collect(),
            waiting: self.pending.waiting().iter().map(|one| one.status(&self.peers, now)).collect(),
            missing: self
                .peers
                .absence
                .hosts()
                .filter(|host| !self.peers.names.reaches(host))
                .map(str::to_owned)
                .collect(),
            deployments: self.deployments().collect(),
            // The driver knows.
            containment: Containment::default(),
            network: Network::default(),
            estop: self.stopped.by().cloned(),
            policy: None,
        }
    }

    /// Returns the deployments that run here, and those whose home is here and whose end other hosts still have to confirm.
    fn deployments(&self) -> impl Iterator<Item = DeploymentStatus> {
        let homes = self.coordinators.iter().filter(|(deployment, _)| !self.participants.contains_key(*deployment));
        let homes = homes.map(|(_, home)| home.status(&self.identity.host));
        self.participants.values().map(Participant::status).chain(homes)
    }

    /// Returns the state of hosts that do not answer.
    fn absent(&self, now: Time) -> Absent {
        let mut absent = self.peers.absence.report(now);
        self.past.add_ends(&self.identity.host, &mut absent.ends);
        let is_away = |host: &str| self.peers.is_away(host);
        absent.processes = self.participants.values().flat_map(|participant| participant.elsewhere(is_away)).collect();
        absent
    }

    fn tick(&mut self, out: &mut Out<'_>) {
        self.look_around(out);
        self.callers.check_ins.answer(&self.peers.names, out);
        self.begin_gathered(out);
        let names = &self.peers.names;
        self.peers.absence.tick(|host| names.reaches(host), out);
        for (host, frame) in self.peers.resend(out.now) {
            self.send_frame(&host, frame, out);
        }
        self.coordinators.values_mut().for_each(|coordinator| coordinator.tick(out));
        self.participants.values_mut().for_each(|participant| participant.tick(out));
        self.callers.inquiries.answer_homes(out);
        let has_homes = !self.coordinators.is_empty();
        for due in self.callers.inquiries.due(&self.identity.host, has_homes, &self.peers.names, out.now) {
            self.tell_events(due.call, false, out);
            due.end(out);
        }
    }

    /// Tells the table of hosts which of them matter now: those that a deployment here depends on, and all of them while a user
    /// looks.
    fn attend(&mut self, now: Time) {
        if !self.callers.listeners.is_empty() {
            self.peers.names.watch(now);
        }
        let homes = self.coordinators.values().flat_map(|coordinator| coordinator.hosts());
        let parts = self.participants.values().flat_map(|participant| participant.relevant_hosts());
        let awaited = self.pending.waiting().iter().flat_map(|awaiting| &awaiting.plan.hosts);
        self.peers.attend(now, homes.chain(parts).chain(awaited).map(String::as_str));
    }

    /// Drops the deployments that are over. A node with nothing left then leaves, if it is to leave.
    fn tidy_up(&mut self, now: Time, effects: &mut Vec<Effect>) {
        for (deployment, coordinator) in self.coordinators.extract_if(.., |_, coordinator| coordinator.is_over()) {
            let (history, unconfirmed) = coordinator.into_history();
            if unconfirmed.is_empty() {
                effects.push(Effect::Settled { deployment });
            } else {
                self.peers.absence.open(now, deployment, &self.identity.host, unconfirmed);
            }
            let record = chronicle::ended(&self.identity.host, &history);
            effects.extend(record.map(|record| Effect::WriteDatabase(Box::new(record))));
            self.past.ended_at_home(history, now);
        }
        self.past.tick(now);
        for (deployment, participant) in self.participants.extract_if(.., |_, participant| participant.is_over()) {
            if self.peers.is_away(participant.home()) {
                let away = participant.hosts().iter().filter(|host| self.peers.is_away(host));
                let open = away.map(|host| (host.clone(), Why::Lost)).collect();
                self.peers.absence.open(now, deployment.clone(), participant.home(), open);
            }
            self.stopped.note_open(&deployment, participant.may_go_on());
            effects.push(Effect::CloseDeployment { deployment: deployment.clone() });
            self.past.ended_here(deployment, &participant);
        }
        if self.participants.is_empty() {
            self.stopped.tell(self.past.unended_programs(), effects);
        }
        if !self.coordinators.is_empty() || !self.participants.is_empty() {
            return;
        }
        if self.run.leaving {
            self.take_leave(now, effects);
        } else if let Some(why) = self.peers.namesake().filter(|_| {
            let names = &self.peers.names;
            names.elder().is_some() && self.pending.waiting().is_empty() && names.is_known(now)
        }) {
            effects.push(Effect::Yield { why });
        }
    }

    /// Announces to the others that this node leaves, unless something may run on after it, and ends when they have acknowledged.
    fn take_leave(&mut self, now: Time, effects: &mut Vec<Effect>) {
        // A node that is gone cannot send its last messages again; without them the others would wait for it.
        if self.run.is_at_work() {
            if self.past.is_clean() {
                let since_1970 = self.run.since_1970(now);
                let mut out = Out { now, since_1970, effects, messages: &mut Vec::new() };
                self.peers.linked().iter().for_each(|host| self.transmit(host, Message::leaves(), &mut out));
            }
            // The listeners are told that nothing follows.
            effects.extend(self.callers.listeners.iter().map(|call| Effect::EndAnswers { call: *call }));
        }
        if self.run.linger(now) || self.peers.is_heard() && self.callers.promises.is_empty() {
            effects.push(Effect::Leave);
        }
    }
}
