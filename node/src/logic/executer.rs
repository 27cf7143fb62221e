//! The supervisor of one process group: feeds events to the algebra and turns its commands into orders.
//!
//! Commands go out strictly in the algebra's order. One rule is added: an activation waits until every connection set
//! opened before it is confirmed by its producers, so that a consumer never runs on closed wires. Wires are counted, since
//! two sets may share one.

use crate::logic::effect::{Out, earliest};
use crate::logic::protocol::{Deployment, Ending, Failure, FailureCause, Target, ToTenant};
use comms::logic::time::Time;
use language::algebra::{Activation, Activity, Cause, Command, Event, Outcome, Program, Reason, State, Value, step};
use language::plan::{Group, MemberKind, Plan};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::time::Duration;

/// How long producers have to confirm that wires are open; then the consumer runs anyway and its own freshness checks
/// decide.
const SWITCH_WITHIN: Duration = Duration::from_secs(1);
/// The shortest time between two activations of one member, and the shortest wait: a loop whose rounds end at once must
/// not keep a node from everything else.
const PACE: Duration = Duration::from_millis(10);
/// The most bytes that a process may be initialised with.
const VALUE_MAX: usize = 8 << 20;

/// The fixed surroundings of an executer.
#[derive(Clone, Copy, Debug)]
pub struct Surroundings<'a> {
    /// Which deployment.
    pub deployment: &'a Deployment,
    /// Its plan.
    pub plan: &'a Plan,
    /// Time since GO.
    pub since_go: Duration,
}

/// The supervisor of one group.
#[derive(Debug)]
pub struct Executer {
    group: u32,
    program: Program,
    state: State,
    activation: u32,
    running: bool,
    queue: VecDeque<Command>,
    open: BTreeMap<u32, u32>,
    generation: u64,
    unconfirmed: BTreeMap<u64, String>,
    switch_until: Option<Time>,
    pace_until: Option<Time>,
    activated: BTreeMap<u32, Time>,
    timers: BTreeSet<(Time, u32, u32)>,
    active: BTreeMap<u32, u32>,
    failures: BTreeMap<u32, Failure>,
}

impl Executer {
    /// Returns an idle supervisor for `plan.groups[group]`.
    pub fn new(plan: &Plan, group: u32) -> Option<Self> {
        let program = Program::compile(plan.groups.get(group as usize)?);
        let state = State::new(&program);
        Some(Self {
            group,
            program,
            state,
            activation: 0,
            running: false,
            queue: VecDeque::new(),
            open: BTreeMap::new(),
            generation: 0,
            unconfirmed: BTreeMap::new(),
            switch_until: None,
            pace_until: None,
            activated: BTreeMap::new(),
            timers: BTreeSet::new(),
            active: BTreeMap::new(),
            failures: BTreeMap::new(),
        })
    }

    /// Returns one word for a person.
    pub fn state(&self) -> &'static str {
        if self.running { "running" } else { "idle" }
    }

    /// Starts the group. Returns how it ended if it ended at once.
    pub fn activate(
        &mut self,
        activation: u32,
        value: &[u8],
        at: Surroundings<'_>,
        out: &mut Out<'_>,
    ) -> Option<Ending> {
        if self.running {
            return None;
        }
        (self.activation, self.running) = (activation, true);
        self.failures.clear();
        self.react(Event::Start(Value::new(value)), at, out)
    }

    /// Asks the group to stop. Returns how it ended if it ended at once.
    pub fn stop(&mut self, activation: u32, at: Surroundings<'_>, out: &mut Out<'_>) -> Option<Ending> {
        if !self.running || activation != self.activation {
            return None;
        }
        self.react(Event::Stop, at, out)
    }

    /// Returns whether the group runs.
    pub fn is_running(&self) -> bool {
        self.running
    }

    /// Ends the group without waiting for anything: its node leaves.
    pub fn abandon(&mut self) {
        self.running = false;
    }

    /// Returns the activation that [`Executer::activate`] was given last.
    pub fn activation(&self) -> u32 {
        self.activation
    }

    /// Takes the ending of a member. Returns how the group ended, if it did.
    pub fn ended(
        &mut self,
        (slot, activation): (u32, u32),
        ending: Ending,
        at: Surroundings<'_>,
        out: &mut Out<'_>,
    ) -> Option<Ending> {
        let current = self.active.get(&slot) == Some(&activation);
        if current {
            self.active.remove(&slot);
        }
        let (member, activation) = (slot, Activation(activation));
        let event = match ending {
            Ending::Done(value) => Event::Done { member, activation, value: Value::new(&value) },
            Ending::Aborted(mut failure) => {
                if failure.origin.is_empty() {
                    let group = at.plan.groups.get(self.group as usize);
                    failure.origin = group.and_then(|group| member_path(at.plan, group, slot)).unwrap_or_default();
                    failure.at = at.since_go;
                }
                // What nobody could confirm inside a group stays unconfirmed at its boundary.
                let unconfirmed = failure.cause == FailureCause::StopUnconfirmed;
                if current {
                    self.failures.insert(slot, failure);
                }
                if unconfirmed {
                    Event::StopUnconfirmed { member, activation }
                } else {
                    Event::Aborted { member, activation, report: Value::EMPTY }
                }
            }
            Ending::Stopped => Event::Stopped { member, activation },
            Ending::Unconfirmed => Event::StopUnconfirmed { member, activation },
        };
        self.react(event, at, out)
    }

    /// Notes that the producers of a generation of wires are switched.
    pub fn switched(&mut self, generation: u64, at: Surroundings<'_>, out: &mut Out<'_>) {
        self.unconfirmed.remove(&generation);
        self.flush(at, out);
    }

    /// Takes the loss of a host: its members fail, and nobody waits for it any more.
    pub fn host_lost(&mut self, host: &str, at: Surroundings<'_>, out: &mut Out<'_>) -> Option<Ending> {
        self.unconfirmed.retain(|_, waited| waited != host);
        self.flush(at, out);
        let group = at.plan.groups.get(self.group as usize)?;
        let lost: Vec<(u32, u32)> = self.active.iter().map(|(slot, number)| (*slot, *number)).collect();
        for (slot, number) in lost {
            if member_host(at.plan, group, slot) != Some(host) {
                continue;
            }
            let origin = member_path(at.plan, group, slot).unwrap_or_default();
            let failure = Failure { origin, cause: FailureCause::HostLost(host.to_owned()), at: at.since_go };
            let stopping = self.state.activity(slot) == Activity::Stopping;
            let ending = if stopping { Ending::Unconfirmed } else { Ending::Aborted(failure) };
            if let Some(ending) = self.ended((slot, number), ending, at, out) {
                return Some(ending);
            }
        }
        None
    }

    /// Does what is due. Returns how the group ended, if it did.
    pub fn tick(&mut self, at: Surroundings<'_>, out: &mut Out<'_>) -> Option<Ending> {
        if self.switch_until.is_some_and(|until| until <= out.now) {
            self.unconfirmed.clear();
            self.flush(at, out);
        }
        if self.pace_until.is_some_and(|until| until <= out.now) {
            self.flush(at, out);
        }
        let due: Vec<_> = self.timers.iter().copied().take_while(|(due, ..)| *due <= out.now).collect();
        for (due, timer, number) in due {
            // An earlier one of them may have cancelled it.
            if !self.timers.remove(&(due, timer, number)) {
                continue;
            }
            let ending = self.react(Event::Elapsed { timer, activation: Activation(number) }, at, out);
            if ending.is_some() {
                return ending;
            }
        }
        None
    }

    /// Returns when [`Executer::tick`] wants to be called.
    pub fn deadline(&self) -> Option<Time> {
        let timer = self.timers.first().map(|(due, ..)| *due);
        earliest(earliest(self.switch_until, self.pace_until), timer)
    }

    fn react(&mut self, event: Event, at: Surroundings<'_>, out: &mut Out<'_>) -> Option<Ending> {
        let mut commands = Vec::new();
        let outcome = step(&self.program, &mut self.state, event, &mut commands);
        self.queue.extend(commands);
        self.flush(at, out);
        let outcome = outcome?;
        self.running = false;
        Some(match outcome {
            Outcome::Done(value) => Ending::Done(value.bytes().to_vec()),
            Outcome::Aborted(reason) => Ending::Aborted(self.failure(&reason, at)),
            Outcome::Stopped => Ending::Stopped,
        })
    }

    fn flush(&mut self, at: Surroundings<'_>, out: &mut Out<'_>) {
        self.pace_until = None;
        while let Some(command) = self.queue.front() {
            if let Command::Activate { member, .. } = command {
                if !self.unconfirmed.is_empty() {
                    self.switch_until.get_or_insert(out.now + SWITCH_WITHIN);
                    return;
                }
                if let Some(last) = self.activated.get(member).filter(|last| **last + PACE > out.now) {
                    self.pace_until = Some(*last + PACE);
                    return;
                }
                self.switch_until = None;
            }
            if let Some(command) = self.queue.pop_front() {
                self.carry_out(command, at, out);
            }
        }
        self.switch_until = None;
    }

    fn carry_out(&mut self, command: Command, at: Surroundings<'_>, out: &mut Out<'_>) {
        let Some(group) = at.plan.groups.get(self.group as usize) else { return };
        match command {
            Command::Connect { set } => self.switch(set, true, at, out),
            Command::Disconnect { set } => self.switch(set, false, at, out),
            Command::Activate { member, activation: Activation(activation), value } => {
                let Some((target, host)) = member_target(at.plan, group, member) else { return };
                self.active.insert(member, activation);
                self.activated.insert(member, out.now);
                let value = value.bytes().to_vec();
                if value.len() > VALUE_MAX {
                    return self.refuse_value((target, activation), value.len(), at, out);
                }
                let order = ToTenant::Activate { target, activation, value };
                out.send(host, at.deployment.to_tenant(order));
            }
            Command::Stop { member, activation: Activation(activation) } => {
                let Some((target, host)) = member_target(at.plan, group, member) else { return };
                out.send(host, at.deployment.to_tenant(ToTenant::Stop { target, activation }));
            }
            Command::Arm { timer, activation: Activation(number), after } => {
                self.timers.insert((out.now + after.max(PACE), timer, number));
            }
            Command::Cancel { timer, activation: Activation(number) } => {
                self.timers.retain(|(_, other, armed)| (*other, *armed) != (timer, number));
            }
        }
    }

    fn refuse_value(&self, process: (Target, u32), size: usize, at: Surroundings<'_>, out: &mut Out<'_>) {
        let (target, activation) = process;
        let cause =
            FailureCause::Reported(format!("the value for its `Init` has {size} bytes; {VALUE_MAX} are allowed"));
        let ending = Ending::Aborted(Failure { origin: String::new(), cause, at: at.since_go });
        if let Some(here) = group_host(at.plan, self.group) {
            out.send(here, at.deployment.to_tenant(ToTenant::Ended { target, activation, ending }));
        }
    }

    /// Opens or closes the wires of a set that no other open set holds, one message to each host of producers.
    fn switch(&mut self, set: u32, open: bool, at: Surroundings<'_>, out: &mut Out<'_>) {
        let group = at.plan.groups.get(self.group as usize);
        let Some(set) = group.and_then(|group| group.sets.get(set as usize)) else { return };
        let mut by_host: BTreeMap<&str, Vec<u32>> = BTreeMap::new();
        for &wire in &set.wires {
            let count = self.open.entry(wire).or_default();
            let flips = if open { *count == 0 } else { *count == 1 };
            *count = if open { *count + 1 } else { count.saturating_sub(1) };
            let host = at.plan.wires.get(wire as usize).and_then(|wire| leaf_host(at.plan, wire.from.leaf));
            if let Some(host) = host.filter(|_| flips) {
                by_host.entry(host).or_default().push(wire);
            }
        }
        for (host, wires) in by_host {
            self.generation += 1;
            let generation = self.generation;
            if open {
                self.unconfirmed.insert(generation, host.to_owned());
            }
            let order = ToTenant::Switch { wires, open, group: self.group, generation };
            out.send(host, at.deployment.to_tenant(order));
        }
    }

    fn failure(&self, reason: &Reason, at: Surroundings<'_>) -> Failure {
        let group = at.plan.groups.get(self.group as usize);
        let here = group.map_or_else(String::new, |group| group.path.clone());
        let member = reason.member;
        let origin = group.zip(member).and_then(|(group, slot)| member_path(at.plan, group, slot)).unwrap_or(here);
        let reported = || member.and_then(|slot| self.failures.get(&slot)).cloned();
        let cause = match &reason.cause {
            Cause::Reported(_) => match reported() {
                Some(failure) => return failure,
                None => FailureCause::NotAvailable("it gave no reason".into()),
            },
            Cause::StopUnconfirmed => match reported() {
                Some(failure) if failure.cause == FailureCause::StopUnconfirmed => return failure,
                _ => FailureCause::StopUnconfirmed,
            },
            Cause::Busy => FailureCause::Busy,
            Cause::ServiceEnded => FailureCause::ServiceEnded,
            Cause::Failed(why) => FailureCause::Failed(why.to_string()),
            Cause::NoMatch => FailureCause::Failed("no arm of `match` has this outcome".to_owned()),
        };
        Failure { origin, cause, at: at.since_go }
    }
}

/// Returns the name of the host of a leaf.
pub fn leaf_host(plan: &Plan, leaf: u32) -> Option<&str> {
    let host = plan.leaves.get(leaf as usize)?.host;
    plan.hosts.get(host as usize).map(String::as_str)
}

/// Returns the name of the host of a group's supervisor.
pub fn group_host(plan: &Plan, group: u32) -> Option<&str> {
    let host = plan.groups.get(group as usize)?.host;
    plan.hosts.get(host as usize).map(String::as_str)
}

fn member_target<'a>(plan: &'a Plan, group: &Group, slot: u32) -> Option<(Target, &'a str)> {
    match group.members.get(slot as usize)?.kind {
        MemberKind::Leaf(leaf) => Some((Target::Leaf(leaf), leaf_host(plan, leaf)?)),
        MemberKind::Group(group) => Some((Target::Group(group), group_host(plan, group)?)),
    }
}

fn member_host<'a>(plan: &'a Plan, group: &Group, slot: u32) -> Option<&'a str> {
    member_target(plan, group, slot).map(|(_, host)| host)
}

fn member_path(plan: &Plan, group: &Group, slot: u32) -> Option<String> {
    match group.members.get(slot as usize)?.kind {
        MemberKind::Leaf(leaf) => plan.leaves.get(leaf as usize).map(|leaf| leaf.path.clone()),
        MemberKind::Group(group) => plan.groups.get(group as usize).map(|group| group.path.clone()),
    }
}
