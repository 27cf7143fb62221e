//! One program on this host, from PREPARE to the moment when nothing of it is left.
//!
//! ```text
//! Starting ─hello─▶ Prepared ─connect─▶ Connecting ─connected─▶ Idle ⇄ Running ─▶ Stopping ─▶ Idle
//!     any ─program ended, nothing left─▶ Dead          any ─leave─▶ Leaving ─▶ Dead
//!     after the first Idle: any ─program ended─▶ Waiting ─▶ Starting …, as `restarts` allows, else Dead
//! ```
//! Invariants: exactly one ending for each activation (`finish` takes away what it ends), and only when the controller has
//! finished its `Stop()` or when nothing of the program is left; a stop is bounded by `stop_within`, then by the grace
//! after SIGTERM, then by the time the kernel has to remove what was killed. An activation outlives its program: while that
//! is started again, its supervisor hears nothing.

mod activation;
mod clearing;
mod note;
mod program;
mod replace;
mod restarts;
pub mod watchdog;

use crate::logic::effect::{Effect, SpawnOrder, earliest};
use crate::logic::protocol::{Change, FailureCause};
use crate::logic::timed::Timed;
use activation::Current;
use comms::logic::control::Order;
use comms::logic::time::Time;
use language::plan::{LeafKind, LinkLoss};
pub use note::Note;
use replace::Probation;
pub use replace::Start;
use restarts::Restarts;
pub use restarts::{RESTARTS_MAX, WINDOW};
use serde::{Deserialize, Serialize};
use shim::protocol::ShimOrder;
use std::collections::BTreeSet;
use std::time::Duration;

/// How long a program has to make its links: it waits 18 s for who it hears, and 18 s for who hears it.
pub(super) const CONNECT_WITHIN: Duration = Duration::from_secs(38);
/// How long a program has between SIGTERM and SIGKILL.
pub(super) const GRACE: Duration = Duration::from_secs(1);
/// The most bytes that a process may leave for the next.
const VALUE_MAX: usize = 1 << 20;
/// How long a killed program may take to be gone: the kernel removes it, and on a starved machine its shim waits its turn.
pub(super) const KILL_WITHIN: Duration = Duration::from_secs(15);
/// How long it may take then, once its shim was killed, too: that may be suspended.
pub(super) const SHIM_KILL_WITHIN: Duration = Duration::from_secs(5);

/// Whether an activation has failed of the death of a program: each death is told once.
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
    /// The program has died, and is started again then; one that was ended by force at a stop, with its next activation.
    Waiting {
        until: Option<Time>,
    },
    /// The program hangs at its start, or was started again and did not come back as it should; it is ended before
    /// anything else.
    Removing {
        until: Time,
    },
    /// Another one takes its place once it is gone.
    Replacing {
        until: Time,
        forced: bool,
        /// Whether its activation was to stop.
        is_stopping: bool,
    },
}

/// One program.
#[derive(Debug, Serialize, Deserialize)]
pub struct Instance {
    order: SpawnOrder,
    stop_within: Duration,
    stage: Stage,
    current: Option<Current>,
    /// Whether its links have stood once: from then on it is started again rather than refused.
    joined: bool,
    restarts: Restarts,
    /// Those of the program before, and whether it is to have them back.
    saved: Option<Restarts>,
    gives_back: bool,
    /// Whether nothing begins before its home has answered: its node was away.
    checks_in: bool,
    /// Lost hosts for whose sake nothing new begins.
    cut_off: BTreeSet<String>,
    pid: Option<u32>,
    /// Whether its shim was killed, since that did not end the program in time.
    shim_was_killed: bool,
    /// By when nothing may be left any more of a program that has ended by itself.
    clearing: Option<Time>,
    /// Whether its program has died by itself, and whether an activation has failed of that.
    death: Option<DeathTold>,
    cause: Option<FailureCause>,
    /// The activation whose end nobody could confirm.
    unconfirmed: Option<u32>,
    /// Why the last activation failed, if it did.
    failed: Option<FailureCause>,
    /// The last lines that its program has written, once it has ended.
    output: Vec<String>,
    /// The replacement that is started when this program is gone.
    next: Option<Start>,
    /// The probation of a program that has replaced another.
    probation: Option<Probation>,
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
    pub fn spawn(order: SpawnOrder, stop_within: Duration, context: &mut InstanceContext<'_>) -> Self {
        let restarts = Restarts::new(order.process.leaf, &order.policy);
        let mut instance = Self {
            order,
            stop_within,
            stage: Stage::Dead,
            current: None,
            joined: false,
            restarts,
            saved: None,
            gives_back: false,
            checks_in: false,
            cut_off: BTreeSet::new(),
            pid: None,
            death: None,
            shim_was_killed: false,
            clearing: None,
            cause: None,
            unconfirmed: None,
            failed: None,
            output: Vec::new(),
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
            // Its shim has the word to let it run, and has not said that it runs.
            Stage::Running if self.pid.is_none() => "starting",
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
                let end = self.pid.map_or_else(|| "end it there".to_owned(), |pid| format!("end process {pid} there"));
                return format!(
                    "unconfirmed; nobody could confirm that it has stopped: {end}, then what it held is free"
                );
            }
            Stage::Dead => {
                return match (&self.failed, &self.cause) {
                    // Why it was stopped says more than how its program left then.
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
        self.pid.filter(|_| self.stage != Stage::Dead || self.is_unconfirmed())
    }

    /// Returns what it does when hosts are lost.
    pub fn link_loss(&self) -> LinkLoss {
        self.order.policy.link_loss
    }

    /// Returns whether an activation of it has not ended.
    pub fn is_active(&self) -> bool {
        self.current.is_some()
    }

    /// Returns whether a program is there that has said where it is.
    pub fn has_program(&self) -> bool {
        !matches!(self.stage, Stage::Starting { .. } | Stage::Waiting { .. } | Stage::Dead)
    }

    /// Returns whether nothing of the program is left, for good.
    pub fn is_gone(&self) -> bool {
        self.stage == Stage::Dead
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
        self.stage == Stage::Dead && self.cause == Some(FailureCause::StopUnconfirmed)
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
            Stage::Waiting { until } => until.filter(|_| !self.checks_in),
            Stage::Prepared | Stage::Idle | Stage::Running | Stage::Refused | Stage::Dead => None,
        };
        earliest(earliest(of_stage, self.probation_until()), self.clearing)
    }

    /// Kills a shim that has not ended its program in time; says whether it had not been killed before.
    fn kill_shim(&mut self, context: &mut InstanceContext<'_>) -> bool {
        let (Stage::Stopping { until, forced: true }
        | Stage::Leaving { until, forced: true }
        | Stage::Replacing { until, forced: true, .. }
        | Stage::Removing { until }) = &mut self.stage
        else {
            return false;
        };
        if self.shim_was_killed {
            return false;
        }
        (*until, self.shim_was_killed) = (context.now + SHIM_KILL_WITHIN, true);
        context.effects.push(Effect::KillShim { process: self.order.process.clone() });
        true
    }

    /// Takes note that its node was gone: its program could not answer meanwhile.
    pub fn adopted(&mut self, away: Duration) {
        self.clearing = self.clearing.map(|at| at + away);
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

    /// Makes the program's links.
    pub fn connect(&mut self, orders: impl IntoIterator<Item = Order>, context: &mut InstanceContext<'_>) {
        if self.stage != Stage::Prepared {
            return;
        }
        self.stage = Stage::Connecting { until: context.now + CONNECT_WITHIN };
        if self.joined {
            self.tell(Order::Rejoin, context);
        }
        for order in orders {
            self.tell(order, context);
        }
    }

    /// Adds and removes links of a program that has its own already. Returns whether it will answer by [`Note::Linked`].
    pub fn link_again(&mut self, orders: impl IntoIterator<Item = Order>, context: &mut InstanceContext<'_>) -> bool {
        let answers = self.is_linked();
        if answers {
            orders.into_iter().for_each(|order| self.tell(order, context));
        }
        answers
    }

    /// Confirms the links of a plain program, which has none.
    pub fn connect_plain(&mut self) {
        if self.stage == Stage::Prepared && !self.is_controller() {
            (self.stage, self.joined) = (Stage::Idle, true);
        }
    }

    /// Passes an order to open or close wires on. Returns whether the program will answer.
    pub fn switch(&mut self, order: Order, context: &mut InstanceContext<'_>) -> bool {
        let answers = self.is_linked();
        if answers {
            self.tell(order, context);
        }
        answers
    }

    /// Passes on where a program is now that was started again. One that makes its links was told where that was before.
    pub fn relink(&mut self, order: Order, context: &mut InstanceContext<'_>) {
        if self.is_linked() || matches!(self.stage, Stage::Connecting { .. }) {
            self.tell(order, context);
        }
    }

    /// Goes on where the program that died was: `open` opens the wires that were open. They are not waited for, since a
    /// program takes its orders one after the other.
    pub fn resume(&mut self, open: Option<Order>, context: &mut InstanceContext<'_>) {
        if self.stage != Stage::Idle {
            return;
        }
        if let Some(open) = open {
            self.tell(open, context);
        }
        if let Some(current) = &self.current {
            if self.checks_in {
                return;
            }
            let value = current.value.clone();
            self.run(value, context);
            context.notes.push(Note::Changed(Change::Resumed));
            if self.is_controller() {
                // Its `Init` is still to succeed; it says so.
                return;
            }
        }
        self.is_up(context);
    }

    /// Takes note that an order did not reach the program: it is of no more use.
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
            self.cause.get_or_insert(FailureCause::NotAvailable(why));
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
            // One that has not said hello has no channel for an order yet.
            Stage::Starting { .. } | Stage::Removing { .. } | Stage::Replacing { .. } | Stage::Refused => {
                (self.next, self.probation) = (None, None);
                self.force_out(context);
            }
            Stage::Prepared | Stage::Connecting { .. } | Stage::Idle | Stage::Running | Stage::Stopping { .. } => {
                if self.is_controller() {
                    let until = context.now + self.stop_within + GRACE;
                    self.stage = Stage::Leaving { until, forced: false };
                    self.tell(Order::Exit, context);
                } else {
                    self.force_out(context);
                }
            }
        }
    }

    fn is_controller(&self) -> bool {
        self.order.kind == LeafKind::Controller
    }

    fn tell(&self, order: Order, context: &mut InstanceContext<'_>) {
        context.effects.push(Effect::Control { process: self.order.process.clone(), order });
    }

    fn tell_shim(&self, order: ShimOrder, context: &mut InstanceContext<'_>) {
        context.effects.push(Effect::Shim { process: self.order.process.clone(), order });
    }
}
