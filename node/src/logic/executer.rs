//! The supervisor of one process group: feeds events to the algebra and turns its commands into orders.
//!
//! Commands are carried out at once and in the algebra's order, with one exception: an activation waits until the wires
//! that were opened for its member are confirmed by their producers, so that a consumer never runs on closed wires.
//! Nothing else waits with it: a stop on contact must not be delayed by a slow host. Wires are counted, since two sets
//! may share one. An activation also waits for as long as a lost host may still use its resources (`fence`).

mod actions;
mod activity;
mod clock;
mod fence;
mod lost;
mod members;
mod places;
#[cfg(test)]
mod planted;
mod ports;
mod succession;
mod supervision;
mod switching;
mod wires;

use crate::logic::effect::{Out, earliest};
use crate::logic::protocol::{Change, Deployment, Ending, Failure, FailureCause, Target, ToCoordinator, ToParticipant};
use crate::logic::timed::Timed;
use activity::Outside;
pub use activity::Taking;
use clock::Clock;
use comms::logic::time::Time;
use fence::Fences;
use language::algebra::{Activation, Cause, Command, Event, Outcome, Program, Reason, State, StepRecord, Value, step};
use language::plan::{Plan, TIMER_LEAST};
pub use members::MemberRef;
use members::{Members, Waiting};
pub use places::{group_host, leaf_host, member_path};
use places::{member_host, member_target};
pub use ports::Sending;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::time::Duration;
use succession::acting;
pub use supervision::wants_restarts;
use supervision::{Supervised, Verdict};
pub use switching::Counted;
use switching::Switches;
use wires::Wires;

/// How long producers have to confirm that wires are open; then the consumer runs anyway and its own freshness checks
/// decide.
pub(super) const SWITCH_WITHIN: Duration = Duration::from_secs(1);
/// The shortest time between two activations of one member, and the shortest wait: a loop whose rounds end at once must
/// not keep a node from everything else.
pub(super) const PACE: Duration = TIMER_LEAST;
/// The most timers that run out in one turn of the node.
const ALARMS_MAX: usize = 256;
/// So many steps are recorded at once, or as many as there were when the group ends.
const STEPS_MAX: usize = 32;
/// The most bytes that a process may be initialised with.
const VALUE_MAX: usize = 8 << 20;

/// The fixed surroundings of an executer.
#[derive(Clone, Copy, Debug)]
pub struct ExecContext<'a> {
    /// The deployment.
    pub deployment: &'a Deployment,
    /// Its home, which informs the users who watch.
    pub home: &'a str,
    /// Its plan.
    pub plan: &'a Plan,
    /// Time since GO.
    pub since_go: Duration,
    /// When its programs begin, if that is a moment in the future: times are measured from it.
    pub start: Time,
}

/// The supervisor of one group.
#[derive(Debug, Serialize, Deserialize)]
pub struct Executer {
    group: u32,
    program: Program,
    state: State,
    run: Run,
    members: Members,
    wires: Wires,
    switches: Switches,
    clock: Clock,
    fences: Fences,
    supervised: Supervised,
    outside: Outside,
    /// The fault that a test plants.
    #[cfg(test)]
    #[serde(skip)]
    planted: Option<planted::Fault>,
}

/// Whether a group runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Run {
    /// Its last activation.
    activation: u32,
    is_on: bool,
    /// Whether its node leaves: nothing follows from anything any more.
    is_abandoned: bool,
}

impl Timed for Executer {
    fn deadline(&self) -> Option<Time> {
        Self::deadline(self)
    }

    fn is_over(&self) -> bool {
        !self.run.is_on
    }
}

impl Executer {
    /// Returns an idle supervisor for `plan.groups[group]`, or nothing if there is no such group. It `is_below` a `using` if it is
    /// in [`below_using`].
    pub fn new(plan: &Plan, group: u32, is_below: bool) -> Option<Self> {
        let declared = plan.groups.get(group as usize)?;
        let program = Program::compile(declared);
        let state = State::new(&program);
        Some(Self {
            group,
            program,
            state,
            run: Run::default(),
            members: Members::new(acting(declared)),
            wires: Wires::new(plan, declared),
            switches: Switches::default(),
            clock: Clock::default(),
            fences: Fences::new(declared, is_below),
            supervised: Supervised::default(),
            outside: Outside::default(),
            #[cfg(test)]
            planted: None,
        })
    }

    /// Returns one word for a person.
    pub fn state(&self) -> &'static str {
        if self.run.is_on { "running" } else { "idle" }
    }

    /// Starts the group. Returns how it ended if it ended at once.
    pub fn activate(
        &mut self,
        activation: u32,
        value: &[u8],
        context: ExecContext<'_>,
        out: &mut Out<'_>,
    ) -> Option<Ending> {
        if self.run.is_on {
            return None;
        }
        (self.run.activation, self.run.is_on) = (activation, true);
        self.renew_actions(context.plan);
        self.clock.start(self.program.automaton().is_some());
        self.members.forget_failures();
        self.supervised = Supervised::default();
        self.react(Event::Start(Value::new(value)), context, out)
    }

    /// Asks the group to stop. Returns how it ended if it ended at once.
    pub fn stop(&mut self, activation: u32, context: ExecContext<'_>, out: &mut Out<'_>) -> Option<Ending> {
        if !self.run.is_on || activation != self.run.activation {
            return None;
        }
        self.react(Event::Stop, context, out)
    }

    /// Returns whether the group runs.
    pub fn is_running(&self) -> bool {
        self.run.is_on
    }

    /// Gives the group up without waiting, because its node leaves. Its activities have still to end.
    pub fn abandon(&mut self, context: ExecContext<'_>, out: &mut Out<'_>) {
        (self.run.is_on, self.run.is_abandoned) = (false, true);
        self.members.withdraw_all();
        let group = context.plan.groups.get(self.group as usize);
        let kinds = self.members.activations().filter_map(|run| Some(group?.members.get(run.slot as usize)?.kind));
        self.fences.abandon(kinds.flat_map(|kind| fence::hosts(context.plan, kind)).collect());
        self.pass_on_fences(context, out);
    }

    /// Returns the activation that [`Executer::activate`] was given last.
    pub fn activation(&self) -> u32 {
        self.run.activation
    }

    /// Takes the ending of a member. Returns how the group ended. None if it has not ended.
    pub fn ended(
        &mut self,
        run: MemberRef,
        ending: Ending,
        context: ExecContext<'_>,
        out: &mut Out<'_>,
    ) -> Option<Ending> {
        self.look_at_end(run, &ending, context);
        let current = self.members.is_current(run);
        if current {
            self.members.end(run.slot);
        } else {
            // It was given up before, so nothing else follows from it.
            self.open_fences(context, out);
        }
        let (member, activation) = (run.slot, Activation(run.activation));
        let event = match ending {
            Ending::Done(value) => Event::Done { member, activation, value: Value::new(&value) },
            Ending::Aborted(mut failure) => {
                // Users have already been told about activations that are no longer current.
                if current && failure.origin.is_empty() {
                    self.complete(member, &mut failure, context, out);
                }
                // An unconfirmed stop inside a group stays unconfirmed at its boundary.
                let unconfirmed = failure.cause.is_unconfirmed_stop();
                let report = failure.report(context.plan);
                if current {
                    self.members.fail(member, failure);
                }
                if unconfirmed {
                    Event::StopUnconfirmed { member, activation }
                } else {
                    Event::Aborted { member, activation, report }
                }
            }
            Ending::Stopped => Event::Stopped { member, activation },
            Ending::Unconfirmed => Event::StopUnconfirmed { member, activation },
        };
        self.react(event, context, out)
    }

    /// Takes note that the program of a member has died and is started again. Returns how the group ended. None if it has not ended.
    pub fn member_restarted(
        &mut self,
        slot: u32,
        cause: &FailureCause,
        context: ExecContext<'_>,
        out: &mut Out<'_>,
    ) -> Option<Ending> {
        let group = context.plan.groups.get(self.group as usize).filter(|_| self.run.is_on)?;
        if context.plan.ports_of(self.group).is_some_and(|(ports, _)| ports == slot) {
            return None;
        }
        let origin = member_path(context.plan, group, slot).unwrap_or_default();
        match self.supervised.restarted(group.supervision.intensity, cause, out.now) {
            Verdict::Bears => supervision::renew_others(self.group, slot, &origin, context, out),
            Verdict::Escalates(cause) => {
                self.supervised.give_up(Failure { origin, cause, at: context.since_go });
                return self.react(Event::Stop, context, out);
            }
            Verdict::IsStopping => {}
        }
        None
    }

    /// Lets time pass. Returns how the group ended. None if it has not ended.
    pub fn tick(&mut self, context: ExecContext<'_>, out: &mut Out<'_>) -> Option<Ending> {
        self.activate_ready(context, out);
        self.tick_switches(context, out);
        for _ in 0..ALARMS_MAX {
            let alarm = self.clock.ring(out.now)?;
            let (timer, activation) = (alarm.timer, Activation(alarm.number));
            let ending = self.react_now(Event::Elapsed { timer, activation }, context, out);
            if ending.is_some() {
                return ending;
            }
        }
        None
    }

    /// Returns when [`Executer::tick`] wants to be called.
    pub fn deadline(&self) -> Option<Time> {
        let timer = earliest(self.clock.deadline(), self.switches.deadline());
        earliest(timer, self.members.deadline(|slot| self.fences.against(slot).is_none()))
    }

    /// Adds path and time to a failure that was assumed for a member because its host is silent.
    /// Reports the failure to the users who watch, because no other part of the system reports it.
    fn complete(&self, slot: u32, failure: &mut Failure, context: ExecContext<'_>, out: &mut Out<'_>) {
        let Some(group) = context.plan.groups.get(self.group as usize) else { return };
        failure.origin = member_path(context.plan, group, slot).unwrap_or_default();
        failure.at = context.since_go;
        let Some((target, _)) = self.target(context.plan, group, slot) else { return };
        let change = Change::Ended(Ending::Aborted(failure.clone()));
        out.send(context.home, context.deployment.to_coordinator(ToCoordinator::Happened { target, change }));
    }

    fn react(&mut self, event: Event, context: ExecContext<'_>, out: &mut Out<'_>) -> Option<Ending> {
        self.clock.read(out.now);
        self.react_now(event, context, out)
    }

    /// Reacts at the time that the clock shows.
    fn react_now(&mut self, event: Event, context: ExecContext<'_>, out: &mut Out<'_>) -> Option<Ending> {
        if self.run.is_abandoned {
            return None;
        }
        let mut commands = Vec::new();
        let before = self.states_seen();
        let outcome = step(&self.program, &mut self.state, event.clone(), &mut commands);
        #[cfg(test)]
        let outcome = planted::spoil(self, &event, &mut commands, outcome);
        self.outside.news.steps.push(StepRecord::new(event.clone(), commands.clone(), outcome.clone()));
        if outcome.is_some() || self.outside.news.steps.len() >= STEPS_MAX {
            self.record(context, out);
        }
        self.connect(&commands, context, out);
        for command in commands {
            self.carry_out(command, context, out);
        }
        self.run.is_on &= outcome.is_none();
        self.tell_states(before, &event, context, out);
        Some(self.conclude(outcome?, context, out))
    }

    /// Says how the group has ended.
    fn conclude(&mut self, outcome: Outcome, context: ExecContext<'_>, out: &mut Out<'_>) -> Ending {
        self.run.is_on = false;
        self.succeed_now(context, out);
        self.end_switches(context, out);
        self.pass_on_fences(context, out);
        let ending = match outcome {
            Outcome::Done(value) => Ending::Done(value.bytes().to_vec()),
            Outcome::Aborted(reason) => Ending::Aborted(self.failure(&reason, context)),
            Outcome::Stopped => Ending::Stopped,
        };
        self.supervised.escalate(ending)
    }

    /// Has its steps recorded, for a later comparison with the spec: several at once, since nothing waits for them.
    fn record(&mut self, context: ExecContext<'_>, out: &mut Out<'_>) {
        let news = &mut self.outside.news;
        let (group, number, steps) = (self.group, news.recorded, std::mem::take(&mut news.steps));
        news.recorded += steps.len() as u64;
        let stepped = ToCoordinator::Stepped { group, number, steps, changes: news.changes };
        out.send(context.home, context.deployment.to_coordinator(stepped));
    }

    /// Activates nothing before [`Executer::checked_in`].
    pub fn check_in(&mut self) {
        self.members.hold(true);
    }

    /// Goes on.
    pub fn checked_in(&mut self, context: ExecContext<'_>, out: &mut Out<'_>) {
        self.members.hold(false);
        self.activate_ready(context, out);
    }

    /// Takes note that generations of wires need not be waited for any more.
    fn confirm(&mut self, generations: &BTreeSet<u64>) {
        self.wires.confirm(generations);
        self.members.confirm(generations);
    }

    /// Sends the activations that wait for nothing any more.
    fn activate_ready(&mut self, context: ExecContext<'_>, out: &mut Out<'_>) {
        let fences = &self.fences;
        for (member, waiting) in self.members.take_ready(out.now, |slot| fences.against(slot).is_none()) {
            // Once the time is over, no other member waits for a member that has not confirmed.
            self.confirm(&waiting.wires);
            self.activate_member(member, waiting, context, out);
        }
    }

    fn activate_member(&mut self, member: u32, waiting: Waiting, context: ExecContext<'_>, out: &mut Out<'_>) {
        let Waiting { activation, value, decided, .. } = waiting;
        let Some(group) = context.plan.groups.get(self.group as usize) else { return };
        self.renew_member(member, context, out);
        let Some((target, host)) = self.target(context.plan, group, member) else { return };
        self.members.told(member, out.now, &value);
        self.fences.began(member, host);
        let ago = out.now.since(decided);
        let order = ToParticipant::Activate { target, activation, value, ago };
        out.send(host, context.deployment.to_participant(order));
    }

    fn carry_out(&mut self, command: Command, context: ExecContext<'_>, out: &mut Out<'_>) {
        let Some(group) = context.plan.groups.get(self.group as usize) else { return };
        match command {
            // They were one switch, before all else.
            Command::Connect { .. } | Command::Disconnect { .. } => {}
            Command::Activate { member, activation: Activation(activation), value } => {
                let Some((target, _)) = self.target(context.plan, group, member) else { return };
                self.members.activate(MemberRef { slot: member, activation });
                let value = value.bytes().to_vec();
                if value.len() > VALUE_MAX {
                    return self.refuse_value((target, activation), value.len(), context, out);
                }
                let (wires, until) = (self.wires.unconfirmed_to(member), out.now + SWITCH_WITHIN);
                let not_before = self.members.next_at(member, PACE).unwrap_or(out.now);
                self.members.wait(member, Waiting { activation, value, decided: out.now, wires, until, not_before });
                self.activate_ready(context, out);
                if let Some(change) = self.held(member, context.plan)
                    && self.fences.is_news(member, activation)
                {
                    let message = ToCoordinator::Happened { target, change };
                    out.send(context.home, context.deployment.to_coordinator(message));
                }
            }
            Command::Stop { member, activation: Activation(activation) } => {
                self.succeed_member(member, context, out);
                let Some((target, host)) = self.target(context.plan, group, member) else { return };
                if self.members.withdraw(MemberRef { slot: member, activation }) {
                    // It has never begun.
                    return self.end_member((target, activation), Ending::Stopped, context, out);
                }
                out.send(host, context.deployment.to_participant(ToParticipant::Stop { target, activation }));
            }
            Command::Arm { timer, activation: Activation(number), after } => {
                self.clock.arm(timer, number, after, context.start);
            }
            Command::Cancel { timer, activation: Activation(number) } => {
                self.clock.cancel(timer, number);
            }
            Command::Send { output, ref value } => {
                self.send(output, value, context, out);
                self.say(&command, context, out);
            }
            Command::Log { .. } | Command::Lost { .. } => self.say(&command, context, out),
        }
    }

    fn refuse_value(&self, process: (Target, u32), size: usize, context: ExecContext<'_>, out: &mut Out<'_>) {
        let cause =
            FailureCause::Reported(format!("the value for its `Init` has {size} bytes; {VALUE_MAX} are allowed"));
        let ending = Ending::Aborted(Failure { origin: String::new(), cause, at: context.since_go });
        self.end_member(process, ending, context, out);
    }

    /// Reports the end of a member that was never told to run, after the commands that are being carried out.
    fn end_member(&self, process: (Target, u32), ending: Ending, context: ExecContext<'_>, out: &mut Out<'_>) {
        let (target, activation) = process;
        if let Some(here) = group_host(context.plan, self.group) {
            out.send(here, context.deployment.to_participant(ToParticipant::Ended { target, activation, ending }));
        }
    }

    fn failure(&self, reason: &Reason, context: ExecContext<'_>) -> Failure {
        let group = context.plan.groups.get(self.group as usize);
        let here = group.map_or_else(String::new, |group| group.path.clone());
        let member = reason.member;
        let origin = group.zip(member).and_then(|(group, slot)| member_path(context.plan, group, slot)).unwrap_or(here);
        let reported = || member.and_then(|slot| self.members.failure(slot)).cloned();
        let cause = match &reason.cause {
            Cause::Reported(_) => match reported() {
                Some(failure) => return failure,
                None => FailureCause::NotAvailable("it gave no reason".into()),
            },
            Cause::StopUnconfirmed => match reported() {
                Some(failure) if failure.cause.is_unconfirmed_stop() => return failure,
                _ => FailureCause::StopUnconfirmed,
            },
            Cause::Busy => FailureCause::Busy,
            Cause::ServiceEnded => FailureCause::ServiceEnded,
            Cause::Failed(why) => FailureCause::Failed(why.to_string()),
            Cause::NoMatch => FailureCause::NoMatch,
            Cause::Script(error) => FailureCause::Script(error.clone()),
        };
        Failure { origin, cause, at: context.since_go }
    }
}

/// Returns the groups for which something is taken in a `using` of a group above.
pub fn below_using(plan: &Plan) -> BTreeSet<u32> {
    fence::below(plan)
}
