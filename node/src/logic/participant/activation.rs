//! The orders of supervisors to run and to stop the processes of this host, and the activations that wait.
//!
//! An aligned start: nothing is activated after the first question for the clock, since a supervisor elsewhere may have heard of GO
//! before. From GO on supervisors go ahead, so that wires are open and other hosts have their orders when the moment comes; programs
//! wait for the moment. A process that is stopped before has never begun.
//!
//! A check-in: after its node was away for long, nothing begins until the home has answered, since the home may have given this host up.
//! Running programs go on, and can be stopped. Restarts and activations wait.

use super::{Participant, Phase};
use crate::logic::effect::Out;
use crate::logic::protocol::{Change, Ending, Failure, FailureCause, Target, ToCoordinator};
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// How late GO may come before users are told.
const LATE_MIN: Duration = Duration::from_millis(1);
/// How late this node may wake up for the moment before users are told: on a busy machine it waits for a core, as programs do.
pub(super) const WOKEN_LATE_MIN: Duration = Duration::from_millis(20);

/// The start of the processes of this host, and the activations that wait.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Together {
    /// When the home said GO.
    pub(super) go_at: Option<Time>,
    /// Whether its host was lost or has left, and its programs are not all up again.
    pub(super) rejoining: bool,
    /// The question to its home, after its node was away.
    pub(super) check_in: Option<CheckIn>,
    start: Start,
    /// Whether the moment was over when this host looked at its clock last.
    is_over: bool,
    /// Activations that wait: what, its number, and its value.
    waiting: Vec<(Target, u32, Vec<u8>)>,
}

/// When activated programs begin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
enum Start {
    /// At once.
    #[default]
    AtOnce,
    /// At a moment that is not known yet.
    Unknown,
    /// Not before a moment.
    At(Time),
}

impl Together {
    /// Returns the moment, if one is known.
    pub(super) fn start(&self) -> Time {
        if let Start::At(start) = self.start { start } else { Time::ZERO }
    }
}

/// How long a home that can be reached has to answer: longer than the time after which an absent home is lost.
const WITHIN: Duration = Duration::from_secs(30);

/// A question to the home.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct CheckIn {
    number: u64,
    until: Time,
}

/// Returns why nothing begins in a part that is at its end, or is not there any more.
pub(in crate::logic) fn gone() -> FailureCause {
    FailureCause::NotAvailable("its node has left the deployment".to_owned())
}

impl Participant {
    /// Reports the clock of this host, and from now on waits for the moment.
    pub(super) fn read_clock(&mut self, asked: Time, out: &mut Out<'_>) {
        if self.together.go_at.is_none() {
            self.together.start = Start::Unknown;
        }
        let read = ToCoordinator::ClockRead { asked, shown: out.now };
        self.site.tell_home(read, out);
    }

    /// Takes the moment; none if programs begin as soon as they can.
    pub(super) fn start_at(&mut self, start: Option<Time>, out: &mut Out<'_>) {
        self.together.start = start.map_or(Start::AtOnce, Start::At);
        self.begin_together(LATE_MIN, out);
        self.activate_waiting(out);
    }

    /// Returns when the programs of the first step begin, until then.
    pub fn starts_at(&self) -> Option<Time> {
        let Start::At(start) = self.together.start else { return None };
        (!self.together.is_over && self.together.check_in.is_none()).then_some(start)
    }

    /// Returns whether something is to begin later.
    pub(super) fn is_early(&self, target: Target, now: Time) -> bool {
        if self.together.check_in.is_some() {
            return true;
        }
        match self.together.start {
            Start::AtOnce => false,
            Start::Unknown => true,
            Start::At(start) => now < start && matches!(target, Target::Leaf(_)),
        }
    }

    pub(super) fn begin_later(&mut self, target: Target, activation: u32, value: Vec<u8>) {
        let is_known = self.together.waiting.iter().any(|(other, number, _)| (*other, *number) == (target, activation));
        if !is_known {
            self.together.waiting.push((target, activation, value));
        }
    }

    /// Removes a waiting activation that is stopped; returns whether it waited.
    pub(super) fn never_begins(&mut self, target: Target, activation: u32) -> bool {
        let count = self.together.waiting.len();
        self.together.waiting.retain(|(other, number, _)| (*other, *number) != (target, activation));
        self.together.waiting.len() < count
    }

    /// Activates what has waited, if the moment has come. This node may have been suspended, or killed and started
    /// again, at that moment: if it is too late, its home is told.
    pub(super) fn begin_together(&mut self, late_min: Duration, out: &mut Out<'_>) {
        let Some(start) = self.starts_at().filter(|start| *start <= out.now) else { return };
        self.together.is_over = true;
        let by = out.now.since(start);
        if by >= late_min {
            let late_ms = by.as_secs_f64() * 1000.0;
            tracing::warn!(deployment = %self.site.deployment, late_ms, "this host begins late at an aligned start");
            self.site.tell_home(ToCoordinator::BeganLate { by }, out);
        }
        self.activate_waiting(out);
    }

    /// Drops the waiting activations, because this part of the deployment ends.
    pub(super) fn begin_never(&mut self, out: &mut Out<'_>) {
        for (target, activation, _) in std::mem::take(&mut self.together.waiting) {
            self.tell_supervisor(target, activation, Ending::Stopped, out);
        }
    }

    /// Activates what waits, unless it has to wait on.
    pub(super) fn activate_waiting(&mut self, out: &mut Out<'_>) {
        for (target, activation, value) in std::mem::take(&mut self.together.waiting) {
            self.activate(target, activation, value, out);
        }
    }

    /// Waits for the answer of its home to this question; returns whether it waits. A part without its home does not wait.
    pub fn check_in(&mut self, number: u64, now: Time) -> bool {
        let is_alone = self.phase == Phase::Leaving || self.is_home_lost();
        if !is_alone {
            self.together.check_in = Some(CheckIn { number, until: now + WITHIN });
            self.instances.each(|_, instance| instance.check_in());
            self.executers.each(|_, executer| executer.check_in());
        }
        !is_alone
    }

    /// Returns the question that its home has not answered.
    pub fn checks_in(&self) -> Option<u64> {
        self.together.check_in.map(|check_in| check_in.number)
    }

    /// Goes on: its home has answered, or is lost.
    pub fn checked_in(&mut self, out: &mut Out<'_>) {
        if self.together.check_in.take().is_none() {
            return;
        }
        for leaf in self.instances.numbers() {
            self.with_instance(leaf, out, |instance, context| instance.checked_in(context));
        }
        self.activate_waiting(out);
        self.each_executer(out, |executer, at, out| executer.checked_in(at, out));
    }

    /// Limits the wait for the home.
    pub(super) fn tick_check_in(&mut self, out: &mut Out<'_>) {
        if self.together.check_in.is_some_and(|check_in| check_in.until <= out.now) {
            let (deployment, home) = (&self.site.deployment, &self.site.home);
            tracing::warn!(%deployment, home, "the home has not said whether it has given this host up: its part goes on");
            self.checked_in(out);
        }
    }

    /// Returns when [`Participant::tick_check_in`] wants to be called.
    pub(super) fn check_in_deadline(&self) -> Option<Time> {
        self.together.check_in.map(|check_in| check_in.until)
    }

    /// Runs a process of this host, for its supervisor.
    pub(super) fn activate(&mut self, target: Target, activation: u32, value: Vec<u8>, out: &mut Out<'_>) {
        match target {
            target if self.is_leaving() => {
                let (origin, at) = (String::new(), self.since_go(out.now));
                let failure = Failure { origin, cause: gone(), at };
                self.tell_supervisor(target, activation, Ending::Aborted(failure), out);
            }
            target if self.is_early(target, out.now) => self.begin_later(target, activation, value),
            Target::Leaf(leaf) if self.externals.contains_key(&leaf) => self.attach(leaf, activation, out),
            Target::Leaf(leaf) if self.refuse_held(leaf, activation, out) => {}
            Target::Leaf(leaf) => {
                self.with_instance(leaf, out, |instance, context| instance.activate(activation, value, context));
            }
            Target::Group(group) => {
                if let Some(executer) = self.executers.get(group).filter(|executer| executer.is_running()) {
                    if executer.activation() != activation {
                        let (origin, at) = (self.site.group_path(group), self.since_go(out.now));
                        let failure = Failure { origin, cause: FailureCause::Busy, at };
                        self.tell_supervisor(target, activation, Ending::Aborted(failure), out);
                    }
                    return;
                }
                self.happened(target, Change::Activated, out);
                self.with_executer(group, out, |executer, at, out| executer.activate(activation, &value, at, out));
            }
        }
    }

    /// Stops an activation of a process of this host.
    pub(super) fn stop(&mut self, target: Target, activation: u32, out: &mut Out<'_>) {
        match target {
            target if self.never_begins(target, activation) => {
                self.tell_supervisor(target, activation, Ending::Stopped, out);
            }
            Target::Leaf(leaf) if self.externals.contains_key(&leaf) => self.detach(leaf, activation, out),
            Target::Leaf(leaf) => self.with_instance(leaf, out, |instance, context| instance.stop(activation, context)),
            Target::Group(group) => {
                self.happened(target, Change::Stopping, out);
                self.with_executer(group, out, |executer, at, out| executer.stop(activation, at, out));
            }
        }
    }
}
