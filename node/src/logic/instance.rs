//! One program on this host, from PREPARE to the moment when nothing of it is left.
//!
//! ```text
//! Starting ─hello─▶ Prepared ─connect─▶ Connecting ─connected─▶ Idle ⇄ Running ─▶ Stopping ─▶ Idle
//!     any ─program ended, nothing left─▶ Dead          any ─leave─▶ Leaving ─▶ Dead
//!     after the first Idle: any ─program ended─▶ Waiting ─▶ Starting …, as `restarts` allows, else Dead
//! ```
//! Invariants: each activation has exactly one ending (`finish` removes the activation that it ends). The ending
//! comes only when the controller has finished its `Stop()`, or when nothing of the program is left. A stop is
//! bounded by `stop_within`, then by the grace after SIGTERM, then by the time the kernel has to remove the
//! killed processes. A controller reports a stop that it has begun by itself, so that this stop has the same limit.
//! An activation outlives its program: while the program is started again, its supervisor gets no report.

mod note;
mod program;
mod replace;
mod restarts;
pub mod watchdog;

use crate::logic::effect::{Effect, earliest};
use crate::logic::protocol::{Change, Ending, Failure, FailureCause};
use crate::logic::timed::Timed;
use comms::logic::control::Order;
use comms::logic::time::Time;
use language::plan::{LeafKind, LinkLoss};
pub use note::Note;
pub use replace::Start;
use replace::{Probation, Saved};
use restarts::Restarts;
pub use restarts::{RESTARTS_MAX, WINDOW};
use serde::{Deserialize, Serialize};
use shim::protocol::ShimOrder;
use std::collections::BTreeSet;
use std::time::Duration;

/// How long a program has to make its links: it waits 18 s for its sources, and 18 s for its receivers.
pub(super) const CONNECT_WITHIN: Duration = Duration::from_secs(38);
/// How long a program has between SIGTERM and SIGKILL.
pub(super) const GRACE: Duration = Duration::from_secs(1);
/// How long a killed program may take to be gone: the kernel removes it, and on a starved machine its shim waits its turn.
pub(super) const KILL_WITHIN: Duration = Duration::from_secs(15);
/// How long the removal may take after its shim was killed: the shim may be suspended.
pub(super) const SHIM_KILL_WITHIN: Duration = Duration::from_secs(5);

/// Whether an activation has failed because of the death of a program. Each death is reported once.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum DeathTold {
    No,
    Yes,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Stage {
    Starting {
        until: Time,
    },
    Prepared,
    Connecting {
        until: Time,
    },
    Idle,
    Running,
    Stopping {
        until: Time,
        forced: bool,
    },
    /// The program cannot take part, and its deployment knows why.
    Refused,
    Leaving {
        until: Time,
        forced: bool,
    },
    Dead,
    /// The program has died, and is started again at this time. A program that was ended by force at a stop is started
    /// with its next activation.
    Waiting {
        until: Option<Time>,
    },
    /// The program hangs at its start, or was started again and did not return correctly. It is
    /// ended before any other step.
    Removing {
        until: Time,
    },
    /// Another program takes its place once this program is gone.
    Replacing {
        until: Time,
        forced: bool,
        /// Whether its activation was being stopped.
        is_stopping: bool,
    },
}

/// One program.
#[derive(Debug, Serialize, Deserialize)]
pub struct Instance {
    start: Start,
    stage: Stage,
    current: Option<Current>,
    /// Whether its links have been up once: from then on it is started again rather than refused.
    joined: bool,
    restarts: Restarts,
    /// The restarts of the previous program.
    saved: Option<Saved>,
    obstacles: Obstacles,
    program: Program,
    /// The activation whose end could not be confirmed.
    unconfirmed: Option<u32>,
    /// Why the last activation failed. None if it did not fail.
    failed: Option<FailureCause>,
    /// The replacement that is started when this program is gone.
    next: Option<Start>,
    /// The probation of a program that has replaced another.
    probation: Option<Probation>,
}

/// An activation that has not ended.
#[derive(Debug, Serialize, Deserialize)]
struct Current {
    number: u32,
    /// When its supervisor decided it.
    decided: Time,
    /// The argument of `Init`, in case another program takes the place of this one.
    value: Vec<u8>,
    /// The host whose loss stops it.
    lost: Option<String>,
    /// The work that may continue outside of the program, which was told to leave.
    may_go_on: Option<String>,
    /// When the stop that the controller has begun by itself must have finished.
    stops_by: Option<Time>,
}

/// The program that is there, or was there last.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Program {
    pid: Option<u32>,
    /// Whether its shim was killed, because the shim did not end the program in time.
    shim_was_killed: bool,
    /// The time by which all processes of a program that has ended by itself must be gone.
    clearing: Option<Time>,
    /// Whether the program has died by itself, and whether an activation has failed because of that.
    death: Option<DeathTold>,
    cause: Option<FailureCause>,
    /// The last lines that it has written, once it has ended.
    output: Vec<String>,
}

/// The reasons for which nothing begins.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Obstacles {
    /// Whether the home has to answer first, because this node was away.
    checks_in: bool,
    /// The failed hosts that it waits for.
    hosts: BTreeSet<String>,
}

/// The moment of an input, and the lists for effects and notes.
#[derive(Debug)]
pub struct InstanceContext<'a> {
    /// The time of the input.
    pub now: Time,
    /// Time since GO.
    pub since_go: Duration,
    /// For the driver.
    pub effects: &'a mut Vec<Effect>,
    /// For the deployment.
    pub notes: &'a mut Vec<Note>,
}

impl Timed for Instance {
    fn deadline(&self) -> Option<Time> {
        Self::deadline(self)
    }

    fn is_over(&self) -> bool {
        self.is_gone()
    }
}

impl Instance {
    /// Starts a program; a plain one is held by its shim.
    pub fn spawn(start: Start, context: &mut InstanceContext<'_>) -> Self {
        let mut instance = Self {
            restarts: start.restarts(),
            start,
            stage: Stage::Dead,
            current: None,
            joined: false,
            saved: None,
            obstacles: Obstacles::default(),
            program: Program::default(),
            unconfirmed: None,
            failed: None,
            next: None,
            probation: None,
        };
        instance.start(context);
        instance
    }

    /// Returns one word for a person, with the reason when it is dead, or when its last activation has failed.
    pub fn state(&self) -> String {
        let word = match self.stage {
            Stage::Removing { .. } if !self.joined => "starting",
            Stage::Waiting { until: None } => "ended",
            Stage::Waiting { .. } | Stage::Removing { .. } => "restarting",
            Stage::Replacing { .. } => "being replaced",
            Stage::Starting { .. } | Stage::Prepared | Stage::Connecting { .. } if self.joined => "restarting",
            Stage::Starting { .. } => "starting",
            // The shim has the order to let the program run, and has not reported that it runs.
            Stage::Running if self.program.pid.is_none() => "starting",
            Stage::Prepared | Stage::Connecting { .. } => "connecting",
            Stage::Refused => "refused",
            Stage::Idle if self.is_active() => "restarting",
            Stage::Idle => {
                let failed = self.failed.as_ref().map(|cause| format!("idle, aborted: {cause}"));
                return failed.unwrap_or_else(|| "idle".to_owned());
            }
            Stage::Running => "running",
            Stage::Stopping { .. } => "stopping",
            Stage::Leaving { .. } => "leaving",
            Stage::Dead if self.is_unconfirmed() => {
                let end = self
                    .program
                    .pid
                    .map_or_else(|| "end it there".to_owned(), |pid| format!("end process {pid} there"));
                return format!(
                    "unconfirmed; its stop could not be confirmed: {end}, and then the resources of the process are free"
                );
            }
            Stage::Dead => {
                return match (&self.failed, &self.program.cause) {
                    // The reason for the stop says more than how the program ended then.
                    (Some(failed @ FailureCause::HostLost(_)), _) => format!("ended, aborted: {failed}"),
                    (_, Some(cause)) => format!("dead: {cause}"),
                    (_, None) => "ended".to_owned(),
                };
            }
        };
        word.to_owned()
    }

    /// Returns the program's process id, once it has one.
    pub fn pid(&self) -> Option<u32> {
        self.program.pid.filter(|_| self.stage != Stage::Dead || self.is_unconfirmed())
    }

    /// Returns its reaction to the loss of hosts.
    pub fn link_loss(&self) -> LinkLoss {
        self.start.order.policy.link_loss
    }

    /// Returns whether an activation of it has not ended.
    pub fn is_active(&self) -> bool {
        self.current.is_some()
    }

    /// Returns whether there is a program that has reported its address.
    pub fn has_program(&self) -> bool {
        !matches!(self.stage, Stage::Starting { .. } | Stage::Waiting { .. } | Stage::Dead)
    }

    /// Returns whether nothing of the program is left, for good.
    pub fn is_gone(&self) -> bool {
        self.stage == Stage::Dead
    }

    /// Returns the cause of its last end, if work outside of the program may continue.
    pub fn open_work(&self) -> Option<&FailureCause> {
        self.failed.as_ref().filter(|cause| matches!(cause, FailureCause::MayGoOn(_)))
    }

    /// Returns whether its links have stood once.
    pub fn has_joined(&self) -> bool {
        self.joined
    }

    /// Returns whether the program can be told to switch wires, and will answer.
    pub fn is_linked(&self) -> bool {
        self.is_controller() && matches!(self.stage, Stage::Idle | Stage::Running | Stage::Stopping { .. })
    }

    /// Returns whether the program may still be there although everything was done to end it.
    pub fn is_unconfirmed(&self) -> bool {
        self.stage == Stage::Dead && self.program.cause == Some(FailureCause::StopUnconfirmed)
    }

    /// Returns when [`Instance::tick`] wants to be called.
    pub fn deadline(&self) -> Option<Time> {
        let of_stage = match self.stage {
            Stage::Starting { until }
            | Stage::Connecting { until }
            | Stage::Stopping { until, .. }
            | Stage::Leaving { until, .. }
            | Stage::Replacing { until, .. }
            | Stage::Removing { until } => Some(until),
            Stage::Waiting { until } => until.filter(|_| !self.obstacles.checks_in),
            Stage::Running => self.stops_by(),
            Stage::Prepared | Stage::Idle | Stage::Refused | Stage::Dead => None,
        };
        earliest(earliest(of_stage, self.probation_until()), self.program.clearing)
    }

    /// Returns when the stop that the controller has begun by itself must have finished.
    fn stops_by(&self) -> Option<Time> {
        self.current.as_ref()?.stops_by
    }

    /// Kills a shim that has not ended its program in time. Returns whether the shim had not been killed before.
    fn kill_shim(&mut self, context: &mut InstanceContext<'_>) -> bool {
        let (Stage::Stopping { until, forced: true }
        | Stage::Leaving { until, forced: true }
        | Stage::Replacing { until, forced: true, .. }
        | Stage::Removing { until }) = &mut self.stage
        else {
            return false;
        };
        if self.program.shim_was_killed {
            return false;
        }
        (*until, self.program.shim_was_killed) = (context.now + SHIM_KILL_WITHIN, true);
        context.effects.push(Effect::KillShim { process: self.start.order.process.clone() });
        true
    }

    /// Takes note that its node was gone: its program could not answer in the meantime.
    pub fn adopted(&mut self, away: Duration) {
        self.program.clearing = self.program.clearing.map(|at| at + away);
        if let Some(by) = self.current.as_mut().and_then(|current| current.stops_by.as_mut()) {
            *by = *by + away;
        }
        match &mut self.stage {
            Stage::Starting { until }
            | Stage::Connecting { until }
            | Stage::Stopping { until, .. }
            | Stage::Leaving { until, .. }
            | Stage::Replacing { until, .. }
            | Stage::Removing { until } => *until = *until + away,
            Stage::Prepared | Stage::Idle | Stage::Running | Stage::Refused | Stage::Dead | Stage::Waiting { .. } => {}
        }
    }

    /// Continues where the previous program died: `open` opens the wires that were open. Nothing waits for these wires, since
    /// a program takes its orders one after the other.
    pub fn resume(&mut self, open: Option<Order>, context: &mut InstanceContext<'_>) {
        if self.stage != Stage::Idle {
            return;
        }
        if let Some(open) = open {
            self.tell(open, context);
        }
        if let Some(current) = &self.current {
            if self.obstacles.checks_in {
                return;
            }
            let value = current.value.clone();
            self.run(value, context);
            context.notes.push(Note::Changed(Change::Resumed));
            if self.is_controller() {
                // Its `Init` has not succeeded yet. The program reports when it has.
                return;
            }
        }
        self.is_up(context);
    }

    /// Takes note that an order did not reach the program: the program is of no more use.
    pub fn undelivered(&mut self, why: String, context: &mut InstanceContext<'_>) {
        let is_there = !matches!(
            self.stage,
            Stage::Dead
                | Stage::Leaving { .. }
                | Stage::Waiting { .. }
                | Stage::Removing { .. }
                | Stage::Replacing { .. }
        );
        if is_there {
            self.program.cause.get_or_insert(FailureCause::NotAvailable(why));
            self.tell_shim(ShimOrder::Stop { grace: GRACE }, context);
        }
    }

    /// Ends the program.
    pub fn leave(&mut self, context: &mut InstanceContext<'_>) {
        match self.stage {
            Stage::Dead => context.notes.push(Note::Gone),
            Stage::Leaving { .. } => {}
            Stage::Waiting { .. } => {
                self.stage = Stage::Dead;
                self.left(context);
            }
            // A program that has not said hello has no channel for an order yet.
            Stage::Starting { .. } | Stage::Removing { .. } | Stage::Replacing { .. } | Stage::Refused => {
                (self.next, self.probation) = (None, None);
                self.force_out(context);
            }
            Stage::Prepared | Stage::Connecting { .. } | Stage::Idle | Stage::Running | Stage::Stopping { .. } => {
                if self.is_controller() {
                    let until = context.now + self.start.stop_within + GRACE;
                    self.stage = Stage::Leaving { until, forced: false };
                    self.tell(Order::Exit, context);
                } else {
                    self.force_out(context);
                }
            }
        }
    }

    /// Initialises and runs the program, or notes that this is to be done once it is there again. The supervisor decided it at `decided`.
    pub fn activate(&mut self, activation: u32, value: Vec<u8>, decided: Time, context: &mut InstanceContext<'_>) {
        if self.current.as_ref().is_some_and(|current| current.number == activation) {
            return;
        }
        if let Some(cause) = self.obstacle() {
            self.program.death = self.program.death.map(|_| DeathTold::Yes);
            let failure = self.failure(cause, context);
            return context.notes.push(Note::Ended(activation, Ending::Aborted(failure)));
        }
        let (number, value_of) = (activation, value.clone());
        self.current = Some(Current { number, decided, value: value_of, lost: None, may_go_on: None, stops_by: None });
        context.notes.push(Note::Changed(Change::Activated));
        match self.stage {
            Stage::Idle if self.obstacles.checks_in => {}
            Stage::Idle => self.run(value, context),
            Stage::Waiting { until: None } => self.start(context),
            // The program has died: a new activation is meant for another program of its kind.
            Stage::Dead => {
                self.forget_program();
                self.start(context);
            }
            Stage::Starting { .. }
            | Stage::Prepared
            | Stage::Connecting { .. }
            | Stage::Running
            | Stage::Stopping { .. }
            | Stage::Refused
            | Stage::Leaving { .. }
            | Stage::Waiting { until: Some(_) }
            | Stage::Removing { .. }
            | Stage::Replacing { .. } => {}
        }
    }

    /// Returns whether it is being stopped.
    pub fn is_stopping(&self) -> bool {
        matches!(self.stage, Stage::Stopping { .. } | Stage::Replacing { is_stopping: true, .. })
    }

    /// Returns whether a program that has died is started again with its next activation. The
    /// conditions: it took part, nothing of it is left, its death was reported, and its policy is
    /// `restart temporary`. With another policy, a dead program was given up after too many
    /// restarts.
    fn is_renewable(&self) -> bool {
        let is_told = self.program.death == Some(DeathTold::Yes) && !self.is_unconfirmed();
        is_told && self.joined && self.is_controller() && !self.restarts.are_allowed()
    }

    /// Returns why the process cannot be activated. None if it can be activated.
    fn obstacle(&self) -> Option<FailureCause> {
        let takes_part = match self.stage {
            Stage::Dead if self.is_renewable() => true,
            Stage::Leaving { .. } | Stage::Dead => {
                let gone = || FailureCause::NotAvailable("its program is not running".into());
                return Some(self.program.cause.clone().unwrap_or_else(gone));
            }
            Stage::Starting { .. } | Stage::Prepared | Stage::Connecting { .. } | Stage::Refused => self.joined,
            Stage::Idle
            | Stage::Running
            | Stage::Stopping { .. }
            | Stage::Waiting { .. }
            | Stage::Removing { .. }
            | Stage::Replacing { .. } => true,
        };
        if !takes_part {
            Some(FailureCause::NotAvailable("it is not connected".into()))
        } else if self.current.is_some() {
            Some(FailureCause::Busy)
        } else {
            self.obstacles.hosts.first().cloned().map(FailureCause::HostLost)
        }
    }

    /// Stops an activation. For an activation that is over, the ending already sent is enough.
    pub fn stop(&mut self, activation: u32, context: &mut InstanceContext<'_>) {
        if self.current.as_ref().is_none_or(|current| current.number != activation) {
            return;
        }
        match self.stage {
            Stage::Running => {
                context.notes.push(Note::Changed(Change::Stopping));
                if self.is_controller() {
                    let until = self.stops_by().unwrap_or(context.now + self.start.stop_within);
                    self.stage = Stage::Stopping { until, forced: false };
                    self.tell(Order::Stop { activation }, context);
                } else {
                    let until = context.now + self.start.stop_within + KILL_WITHIN;
                    self.stage = Stage::Stopping { until, forced: true };
                    self.tell_shim(ShimOrder::Stop { grace: self.start.stop_within }, context);
                }
            }
            // The program died and has not been activated since, or it waits for its home: nothing runs that could be stopped.
            Stage::Idle
            | Stage::Waiting { .. }
            | Stage::Removing { .. }
            | Stage::Starting { .. }
            | Stage::Prepared
            | Stage::Connecting { .. } => self.finish(Ending::Stopped, context),
            // The program is about to leave: its activation ends with it.
            Stage::Replacing { until, forced, .. } => {
                self.stage = Stage::Replacing { until, forced, is_stopping: true };
            }
            Stage::Stopping { .. } | Stage::Leaving { .. } | Stage::Refused | Stage::Dead => {}
        }
    }

    /// Stops the running activation because `host` is lost, which then counts as its failure; nothing new begins until
    /// [`Self::reach`].
    pub fn cut(&mut self, host: &str, context: &mut InstanceContext<'_>) {
        self.hold(host);
        if matches!(self.stage, Stage::Stopping { .. } | Stage::Leaving { .. }) {
            return;
        }
        if let Some(current) = &mut self.current {
            current.lost = Some(host.to_owned());
            let number = current.number;
            self.stop(number, context);
        }
    }

    /// Begins nothing, and starts no program again, before [`Self::checked_in`].
    pub fn check_in(&mut self) {
        self.obstacles.checks_in = true;
    }

    /// Goes on.
    pub fn checked_in(&mut self, context: &mut InstanceContext<'_>) {
        self.obstacles.checks_in = false;
        if self.stage == Stage::Idle && self.current.is_some() {
            self.resume(None, context);
        }
    }

    /// Begins nothing new while `host` is lost.
    pub fn hold(&mut self, host: &str) {
        self.obstacles.hosts.insert(host.to_owned());
    }

    /// Takes note that `host` is back.
    pub fn reach(&mut self, host: &str) {
        self.obstacles.hosts.remove(host);
    }

    /// The current activation ends, if there is one. A stop because of a lost host counts as a failure.
    fn finish(&mut self, ending: Ending, context: &mut InstanceContext<'_>) {
        let Some(Current { number, lost, .. }) = self.current.take() else { return };
        let ending = match (ending, lost) {
            (Ending::Stopped, Some(host)) => Ending::Aborted(self.failure(FailureCause::HostLost(host), context)),
            (ending, _) => ending,
        };
        if ending == Ending::Unconfirmed {
            self.unconfirmed = Some(number);
        }
        self.failed = match &ending {
            Ending::Aborted(failure) => Some(failure.cause.clone()),
            Ending::Done(_) | Ending::Stopped | Ending::Unconfirmed => None,
        };
        context.notes.push(Note::Ended(number, ending));
    }

    fn failure(&self, cause: FailureCause, context: &InstanceContext<'_>) -> Failure {
        Failure { origin: self.start.order.path.clone(), cause, at: context.since_go }
    }

    fn is_controller(&self) -> bool {
        self.start.order.kind == LeafKind::Controller
    }

    fn tell(&self, order: Order, context: &mut InstanceContext<'_>) {
        context.effects.push(self.control(order));
    }

    fn control(&self, order: Order) -> Effect {
        Effect::Control { process: self.start.order.process.clone(), order }
    }

    fn tell_shim(&self, order: ShimOrder, context: &mut InstanceContext<'_>) {
        context.effects.push(Effect::Shim { process: self.start.order.process.clone(), order });
    }
}
