//! The agent of a host: routes every input to the machine it belongs to, and nothing else.

mod attention;
mod boot;
mod calls;
mod check_in;
mod crash_loop;
mod delivery;
mod estop;
mod external;
mod input;
mod inquiries;
mod namesakes;
mod orders;
mod over;
mod peers;
mod promises;
mod relay;

use boot::Resumed;
use check_in::CheckIns;
use estop::Stopped;
pub use input::Input;
use inquiries::Inquiries;
use namesakes::Rivalry;
use orders::Orders;
use promises::Promises;

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
    Absent, Before, Containment, Deployment, Earlier, Estop, Network, NodeStatus, Signed, StartMode, Tombstone,
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

/// How long a successor still takes over the end of a deployment: a caller that waits for the end may not have heard
/// it, and asks again.
const END_KEPT: Duration = Duration::from_secs(10);

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

/// The life of this node.
#[derive(Debug, Serialize, Deserialize)]
struct Run {
    started: Time,
    /// The calendar clock at [`Time::ZERO`], as time since 1970.
    calendar: Duration,
    /// The last few times at which this agent was made again from its inputs.
    adoptions: VecDeque<Time>,
    leaving: bool,
    /// The time until which a node without any work left waits for others to acknowledge its last messages.
    lingers_until: Option<Time>,
}

/// The other nodes.
#[derive(Debug, Serialize, Deserialize)]
struct Peers {
    names: NameServer,
    absence: Absence,
    /// For each name, the links to its last boots; the link to the holder of the name comes last.
    links: BTreeMap<String, Vec<Link>>,
    /// The holder of each name, as it was reported last.
    holders: BTreeMap<String, u64>,
    /// The hosts that get the beats of this node, as they were ordered last.
    beaten: BTreeSet<String>,
    rivalry: Rivalry,
}

/// The deployments that have not begun, and those that must not begin.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Pending {
    /// The requests that were made, by number.
    requests: BTreeSet<u64>,
    awaiting: Vec<AwaitingHosts>,
    /// The deployments that ran before this node, until they are told.
    earlier: Vec<Before>,
    /// The deployments of other homes that were stopped while those were away.
    tombstones: BTreeSet<Tombstone>,
}

/// The deployments that are over here.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Past {
    /// Their reports, for callers that were cut off when it happened; the latest first.
    over: VecDeque<History>,
    /// The time until which a successor takes over the end of the last deployment.
    over_until: Option<Time>,
    /// The programs of these deployments on this host, by leaf and path; the latest first.
    programs: VecDeque<(Deployment, Vec<(u32, String)>)>,
    /// The programs of these deployments that may still run.
    unended: BTreeMap<Deployment, UnendedPrograms>,
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

/// Programs that could not be ended when their deployment was.
#[derive(Debug, Serialize, Deserialize)]
struct UnendedPrograms {
    /// The host of `main`.
    home: String,
    /// Indices into `Plan::leaves`.
    leaves: BTreeSet<u32>,
    /// The devices that the deployment held here. They stay reserved until its programs have ended.
    claims: Claims,
}

/// A deployment that waits for hosts which this node has not seen yet.
#[derive(Debug, Serialize, Deserialize)]
struct AwaitingHosts {
    until: Time,
    /// The call that asked for it; none for a deployment that is resumed.
    call: Option<u64>,
    plan: Plan,
    /// The user who wants it, such as `ann@c1`.
    by: String,
    /// The request, if a user has signed it.
    signed: Option<Arc<Signed>>,
    resumed: Option<Resumed>,
    start: StartMode,
}

impl Agent {
    /// Returns an agent that knows no other node yet.
    pub fn new(mut identity: Identity, programs: Programs, now: Time) -> Self {
        let open = std::mem::take(&mut identity.open);
        let stopped = Self::stopped_before(identity.estop.take());
        let Earlier { running, tombstones } = std::mem::take(&mut identity.earlier);
        Self {
            run: Run {
                started: now,
                calendar: Duration::ZERO,
                adoptions: VecDeque::new(),
                leaving: false,
                lingers_until: None,
            },
            peers: Peers {
                names: NameServer::new(&identity.host, identity.boot, now),
                absence: Absence::new(&identity.host, open, now),
                links: BTreeMap::new(),
                holders: BTreeMap::new(),
                beaten: BTreeSet::new(),
                rivalry: Rivalry::default(),
            },
            pending: Pending { earlier: running, tombstones: tombstones.into_iter().collect(), ..Pending::default() },
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
        let (mut more, since_1970) = (Vec::new(), self.since_1970(now));
        let mut out = Out { now, since_1970, effects, messages: &mut more };
        self.check_in(&mut out);
        // This comes first, so that a caller whose question is the first input hears of these deployments.
        self.look_back(&mut out);
        self.take(input, &mut out);
        self.tick(&mut out);
        // Messages to this node may cause further ones; each is handled after the message that caused it.
        let mut messages = VecDeque::from(std::mem::take(&mut more));
        loop {
            while let Some((to, message)) = messages.pop_front() {
                let mut out = Out { now, since_1970, effects, messages: &mut more };
                if to == self.identity.host {
                    self.deliver_own(message, &mut out);
                } else {
                    self.note_outcome(&to, &message, out.effects);
                    self.transmit(&to, message, &mut out);
                }
                messages.extend(more.drain(..));
            }
            self.look_at_externals(&mut Out { now, since_1970, effects, messages: &mut more });
            messages.extend(more.drain(..));
            if messages.is_empty() {
                break;
            }
        }
        self.tidy_up(now, effects);
    }

    /// Returns whether a successor has anything to take over: a deployment, one that has just ended, or programs of one.
    pub fn is_engaged(&self, now: Time) -> bool {
        let has_just_ended = self.past.over_until.is_some_and(|until| now < until);
        has_just_ended
            || !(self.coordinators.is_empty()
                && self.participants.is_empty()
                && self.past.unended.is_empty()
                && self.pending.awaiting.is_empty())
    }

    /// Returns its number among the runs of its node, which it keeps when it is made again.
    pub fn boot(&self) -> u64 {
        self.identity.boot
    }

    /// Returns the time of the calendar clock at [`Time::ZERO`], if it is known.
    pub fn calendar(&self) -> Duration {
        self.run.calendar
    }

    /// Returns a moment on the calendar clock.
    fn since_1970(&self, now: Time) -> Duration {
        self.run.calendar + now.since(Time::ZERO)
    }

    /// Returns the time at which this node began.
    pub fn started(&self) -> Time {
        self.run.started
    }

    /// Returns the boot that holds each name.
    pub fn holders(&self) -> &BTreeMap<String, u64> {
        &self.peers.holders
    }

    /// Returns the hosts that get the beats of this node.
    pub fn beaten(&self) -> &BTreeSet<String> {
        &self.peers.beaten
    }

    /// Continues in another process, with the programs that the new process offers, in a team or not.
    pub fn move_to(&mut self, pid: u32, programs: Programs, is_guarded: bool) {
        (self.identity.pid, self.programs, self.identity.is_guarded) = (pid, programs, is_guarded);
    }

    /// Returns which epoch of a deployment has its home here; 0 if none has.
    pub fn epoch(&self, name: &str) -> u64 {
        self.coordinators.keys().find(|deployment| deployment.name == name).map_or(0, |deployment| deployment.epoch)
    }

    /// Returns how many programs and groups were looked at, all in all.
    pub fn visits(&self) -> u64 {
        self.participants.values().map(Participant::visits).sum()
    }

    /// Returns when [`Input::Tick`] is wanted as exactly as can be: programs begin then.
    pub fn starts_at(&self) -> Option<Time> {
        self.participants.values().filter_map(Participant::starts_at).min()
    }

    /// Returns when [`Input::Tick`] is wanted.
    pub fn deadline(&self) -> Option<Time> {
        let coordinators = self.coordinators.values().map(Coordinator::deadline);
        let participants = self.participants.values().map(Participant::deadline);
        let links = self.peers.links.values().flatten().map(Link::deadline);
        let gathering = self.pending.awaiting.iter().map(AwaitingHosts::deadline);
        let looking_back = (!self.pending.earlier.is_empty()).then_some(self.run.started);
        coordinators
            .chain(participants)
            .chain(links)
            .chain(gathering)
            .chain([self.peers.absence.deadline(), self.callers.inquiries.deadline()])
            .chain([self.run.lingers_until, self.past.over_until, looking_back])
            .fold(self.peers.names.deadline(), earliest)
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
            Input::EstopKept { number, written } => self.estop_kept(number, written, out),
            Input::Unkept { deployment, written } => self.unkept(&deployment, &written, out),
            Input::Adopted { away, programs } => {
                self.callers.inquiries.adopted(programs);
                self.adopted(out.now, away);
                self.keep_estop(out);
                self.keep_all(out);
                self.unkeep_again(out);
                self.judge_again(out);
                self.ask_again(out);
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
        self.forget_stopped(call);
        self.callers.promises.forget(call);
        self.coordinators.values_mut().for_each(|coordinator| coordinator.forget(call));
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
        let unended = self.past.unended.iter().filter(|(other, _)| *other != deployment);
        running.chain(unended.flat_map(|(other, left)| claims.conflicts_with_unended(other, &left.claims))).collect()
    }

    fn status(&self, now: Time) -> NodeStatus {
        NodeStatus {
            host: self.identity.host.clone(),
            pid: self.identity.pid,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            up: now - self.run.started,
            peers: self.peers.names.present().map(str::to_owned).collect(),
            waiting: self.pending.awaiting.iter().map(|one| self.waiting(one, now)).collect(),
            missing: self
                .peers
                .absence
                .hosts()
                .filter(|host| !self.peers.names.reaches(host))
                .map(str::to_owned)
                .collect(),
            deployments: self.participants.values().map(Participant::status).collect(),
            // The driver knows.
            containment: Containment::default(),
            network: Network::default(),
            estop: self.stopped_by().cloned(),
            policy: None,
        }
    }

    /// Returns the state of hosts that do not answer.
    fn absent(&self, now: Time) -> Absent {
        let mut absent = self.peers.absence.report(now);
        self.tell_unended(&mut absent.ends);
        let is_away = |host: &str| *host != *self.identity.host && !self.peers.names.reaches(host);
        absent.processes = self.participants.values().flat_map(|participant| participant.elsewhere(is_away)).collect();
        absent
    }

    fn tick(&mut self, out: &mut Out<'_>) {
        self.look_around(out);
        self.answer_check_ins(out);
        self.begin_gathered(out);
        let names = &self.peers.names;
        self.peers.absence.tick(|host| names.reaches(host), out);
        let resent = self.peers.links.iter_mut().flat_map(|(host, links)| {
            links.iter_mut().flat_map(|link| link.resend(out.now)).map(|frame| (host.clone(), frame))
        });
        for (host, frame) in resent.collect::<Vec<_>>() {
            self.send_frame(&host, frame, out);
        }
        self.coordinators.values_mut().for_each(|coordinator| coordinator.tick(out));
        self.participants.values_mut().for_each(|participant| participant.tick(out));
        self.tick_inquiries(out);
    }
}
