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

/// How long a successor still takes over the end of a deployment: whoever waits for it may not have heard it, and asks again.
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
    /// Whether it is in a team: then what others order is judged before it starts anything.
    pub is_guarded: bool,
    /// Who had stopped everything when an earlier run ended.
    pub estop: Option<Estop>,
    /// What ran before, and what was stopped elsewhere.
    pub earlier: Earlier,
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
    /// The holder of each name, as it was reported last.
    holders: BTreeMap<String, u64>,
    /// Who hears of this node all the time, as it was ordered last.
    beaten: BTreeSet<String>,
    coordinators: BTreeMap<Deployment, Coordinator>,
    participants: BTreeMap<Deployment, Participant>,
    requests: BTreeSet<u64>,
    awaiting_hosts: Vec<AwaitingHosts>,
    /// Reports of deployments that are over, for those who were cut off when it happened; the latest first.
    over: VecDeque<History>,
    /// Until when the end of the last of them is taken over by a successor.
    over_until: Option<Time>,
    /// The calls that listen to all that happens.
    listeners: Vec<u64>,
    /// The calls that want all that has happened.
    inquiries: Inquiries,
    check_ins: CheckIns,
    /// The programs that parts of deployments had here which are over, by leaf and path; the latest first.
    past: VecDeque<(Deployment, Vec<(u32, String)>)>,
    leaving: bool,
    /// Programs of deployments that are over here, and that may still run.
    unended: BTreeMap<Deployment, UnendedPrograms>,
    /// When it was made again from its inputs, the last few times.
    adoptions: VecDeque<Time>,
    /// Until when a node of which nothing is left waits for others to acknowledge its last messages.
    lingers_until: Option<Time>,
    orders: Orders,
    promises: Promises,
    rivalry: Rivalry,
    stopped: Stopped,
    /// The deployments that ran before this node, until they are told.
    earlier: Vec<Before>,
    /// The deployments of other homes that were stopped while those were away.
    tombstones: BTreeSet<Tombstone>,
    /// What the calendar clock showed at [`Time::ZERO`], as time since 1970.
    calendar: Duration,
}

/// Programs that could not be ended when their deployment was.
#[derive(Debug, Serialize, Deserialize)]
struct UnendedPrograms {
    /// The host of `main`.
    home: String,
    /// Indices into `Plan::leaves`.
    leaves: BTreeSet<u32>,
    /// What the deployment held here, which nobody else has before they have ended.
    claims: Claims,
}

/// A deployment that waits for hosts which this node has not seen yet.
#[derive(Debug, Serialize, Deserialize)]
struct AwaitingHosts {
    until: Time,
    /// Who has asked for it; nobody for one that is resumed.
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
    /// Returns an agent that knows of nobody else yet.
    pub fn new(mut identity: Identity, programs: Programs, now: Time) -> Self {
        let open = std::mem::take(&mut identity.open);
        let stopped = Self::stopped_before(identity.estop.take());
        let Earlier { running, tombstones } = std::mem::take(&mut identity.earlier);
        Self {
            absence: Absence::new(&identity.host, open, now),
            names: NameServer::new(&identity.host, identity.boot, now),
            identity,
            started: now,
            programs,
            links: BTreeMap::new(),
            holders: BTreeMap::new(),
            beaten: BTreeSet::new(),
            coordinators: BTreeMap::new(),
            participants: BTreeMap::new(),
            requests: BTreeSet::new(),
            awaiting_hosts: Vec::new(),
            over: VecDeque::new(),
            over_until: None,
            listeners: Vec::new(),
            inquiries: Inquiries::default(),
            check_ins: CheckIns::default(),
            past: VecDeque::new(),
            leaving: false,
            unended: BTreeMap::new(),
            adoptions: VecDeque::new(),
            lingers_until: None,
            orders: Orders::default(),
            promises: Promises::default(),
            rivalry: Rivalry::default(),
            stopped,
            earlier: running,
            tombstones: tombstones.into_iter().collect(),
            calendar: Duration::ZERO,
        }
    }

    /// Takes one input; appends what is to be done, in order.
    pub fn handle(&mut self, now: Time, input: Input, effects: &mut Vec<Effect>) {
        if let Input::Calendar { origin } = input {
            self.calendar = origin;
            return;
        }
        let (mut more, since_1970) = (Vec::new(), self.since_1970(now));
        let mut out = Out { now, since_1970, effects, messages: &mut more };
        self.check_in(&mut out);
        // Who asks at once hears of it, too.
        self.look_back(&mut out);
        self.take(input, &mut out);
        self.tick(&mut out);
        // Messages to this node may cause more of them; each is handled after the one that caused it.
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
        let has_just_ended = self.over_until.is_some_and(|until| now < until);
        has_just_ended
            || !(self.coordinators.is_empty()
                && self.participants.is_empty()
                && self.unended.is_empty()
                && self.awaiting_hosts.is_empty())
    }

    /// Returns its number among the runs of its node, which it keeps when it is made again.
    pub fn boot(&self) -> u64 {
        self.identity.boot
    }

    /// Returns what the calendar clock showed at [`Time::ZERO`], as far as it was told.
    pub fn calendar(&self) -> Duration {
        self.calendar
    }

    /// Returns a moment on the calendar clock.
    fn since_1970(&self, now: Time) -> Duration {
        self.calendar + now.since(Time::ZERO)
    }

    /// Returns since when it is there.
    pub fn started(&self) -> Time {
        self.started
    }

    /// Returns which boot of each name it deals with.
    pub fn holders(&self) -> &BTreeMap<String, u64> {
        &self.holders
    }

    /// Returns who hears of it all the time.
    pub fn beaten(&self) -> &BTreeSet<String> {
        &self.beaten
    }

    /// Goes on in another process, with the programs that this one offers, in a team or not.
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
        let links = self.links.values().flatten().map(Link::deadline);
        let gathering = self.awaiting_hosts.iter().map(AwaitingHosts::deadline);
        let looking_back = (!self.earlier.is_empty()).then_some(self.started);
        coordinators
            .chain(participants)
            .chain(links)
            .chain(gathering)
            .chain([self.absence.deadline(), self.inquiries.deadline()])
            .chain([self.lingers_until, self.over_until, looking_back])
            .fold(self.names.deadline(), earliest)
    }

    fn take(&mut self, input: Input, out: &mut Out<'_>) {
        match input {
            Input::Appeared { host, boot } => self.names.token(out.now, &host, boot),
            Input::Vanished { host, boot } => self.names.no_token(out.now, &host, boot),
            Input::Ping { host, boot } => self.names.heard_of(out.now, &host, boot),
            Input::Pong(pong) => self.names.answered(out.now, &pong),
            Input::Namesake(namesake) => self.greeted(&namesake, out),
            Input::Frame(frame) => self.frame(*frame, out),
            Input::Call { call, request } => {
                self.names.watch(out.now);
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
            Input::EstopKept { number, written } => self.estop_kept(number, written, out),
            Input::Unkept { deployment, written } => self.unkept(&deployment, &written, out),
            Input::Adopted { away, programs } => {
                self.inquiries.adopted(programs);
                self.adopted(out.now, away);
                self.keep_estop(out);
                self.keep_all(out);
                self.unkeep_again(out);
                self.judge_again(out);
                self.ask_again(out);
            }
            Input::Reached { process } => self.inquiries.reached(&process),
            Input::Leave => {
                self.leaving = true;
                self.stop_gathering(|_| true, calls::STOPPED, out);
                self.coordinators.values_mut().for_each(|coordinator| coordinator.stop(None, out));
                let coordinators = &self.coordinators;
                let away =
                    self.participants.iter_mut().filter(|(deployment, _)| !coordinators.contains_key(deployment));
                away.for_each(|(_, participant)| participant.leave(out));
            }
            Input::Calendar { .. } | Input::Tick => {}
        }
    }

    /// Forgets a call whose caller is gone.
    fn forget_call(&mut self, call: u64) {
        self.listeners.retain(|listener| *listener != call);
        self.inquiries.forget(call);
        self.forget_stopped(call);
        self.promises.forget(call);
        self.coordinators.values_mut().for_each(|coordinator| coordinator.forget(call));
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
        let running = others.flat_map(|(other, participant)| claims.conflicts(other, participant.claims()));
        let unended = self.unended.iter().filter(|(other, _)| *other != deployment);
        running.chain(unended.flat_map(|(other, left)| claims.conflicts_with_unended(other, &left.claims))).collect()
    }

    fn status(&self, now: Time) -> NodeStatus {
        NodeStatus {
            host: self.identity.host.clone(),
            pid: self.identity.pid,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            up: now - self.started,
            peers: self.names.present().map(str::to_owned).collect(),
            waiting: self.awaiting_hosts.iter().map(|one| self.waiting(one, now)).collect(),
            missing: self.absence.hosts().filter(|host| !self.names.reaches(host)).map(str::to_owned).collect(),
            deployments: self.participants.values().map(Participant::status).collect(),
            // The driver knows.
            containment: Containment::default(),
            network: Network::default(),
            estop: self.stopped_by().cloned(),
            policy: None,
        }
    }

    /// Returns what is known of hosts that do not answer.
    fn absent(&self, now: Time) -> Absent {
        let mut absent = self.absence.report(now);
        self.tell_unended(&mut absent.ends);
        let is_away = |host: &str| *host != *self.identity.host && !self.names.reaches(host);
        absent.processes = self.participants.values().flat_map(|participant| participant.elsewhere(is_away)).collect();
        absent
    }

    fn tick(&mut self, out: &mut Out<'_>) {
        self.look_around(out);
        self.answer_check_ins(out);
        self.begin_gathered(out);
        let names = &self.names;
        self.absence.tick(|host| names.reaches(host), out);
        let resent = self.links.iter_mut().flat_map(|(host, links)| {
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
