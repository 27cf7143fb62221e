//! Another program takes the place of this one while the deployment runs.
//!
//! The program is asked to leave. When nothing of it is left, the next program is started as after a restart: it gets
//! the links and the activation of its predecessor. A new program is unhealthy if it dies, cannot make its links or
//! aborts during its probation. A service is also unhealthy if it ends. Then the predecessor is started again in its
//! place. The supervisor of the program gets no report of these steps.

use super::{GRACE, Instance, InstanceContext, KILL_WITHIN, Note, Restarts, Stage, watchdog};
use crate::logic::effect::SpawnOrder;
use crate::logic::protocol::{Change, Ending, FailureCause};
use comms::logic::control::Order;
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use shim::protocol::ShimOrder;
use std::time::Duration;

/// How a program is started, and how long its stop may take.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Start {
    /// The order that starts the program.
    pub order: SpawnOrder,
    /// How long the program may take to stop.
    pub stop_within: Duration,
}

impl Start {
    /// Returns the restarts of a program that has not died yet.
    pub(super) fn restarts(&self) -> Restarts {
        Restarts::new(self.order.process.leaf, &self.order.policy)
    }
}

/// The restarts of the previous program.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Saved {
    restarts: Restarts,
    /// Whether the next program gets these restarts, because it is the previous program.
    is_due: bool,
}

/// A program that has recently taken the place of another one.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Probation {
    /// The program that is started again if the new program is unhealthy; nothing once that was done.
    before: Option<Start>,
    /// How long the program has to stay healthy after its start.
    length: Duration,
    /// Whether the program was activated.
    was_activated: bool,
    /// The end of the probation. Nothing before the program has started, and nothing during its first `Init`.
    until: Option<Time>,
    /// Whether the program was added. An added program has no predecessor that could be started again.
    is_new: bool,
}

impl Instance {
    /// Returns whether this order would start the same program. Differences in the handling of its death or stop are ignored.
    pub fn is_same_program(&self, Start { order, .. }: &Start) -> bool {
        let mut own = self.start.order.clone();
        (own.policy.restart, own.policy.link_loss) = (order.policy.restart, order.policy.link_loss);
        own.policy.backoff = order.policy.backoff;
        own.is_service = order.is_service;
        own == *order
    }

    /// Starts a program that is added while the deployment runs.
    pub fn add(start: Start, probation: Duration, context: &mut InstanceContext<'_>) -> Self {
        let length = watchdog::probation(start.order.kind, &start.order.policy, probation);
        let mut instance = Self::spawn(start, context);
        instance.probation = Some(Probation { before: None, length, was_activated: false, until: None, is_new: true });
        instance
    }

    /// Notes that an added program has started and has made its links.
    pub fn is_added(&mut self, context: &mut InstanceContext<'_>) {
        if self.probation.is_some() && self.stage == Stage::Idle {
            self.is_up(context);
        }
    }

    /// Adopts the new handling of the program's death and stop.
    pub fn settle(&mut self, start: Start) {
        if self.restarts.differ(&start.order.policy) {
            self.restarts = start.restarts();
        }
        self.start = start;
    }

    /// Stops the program and starts the next one in its place. Reports [`Note::Replaced`] when the next program has
    /// started, or [`Note::Unhealthy`].
    pub fn replace(&mut self, next: Start, probation: Duration, context: &mut InstanceContext<'_>) {
        if self.is_unconfirmed() {
            let why = "the previous program of the process may still run".to_owned();
            return context.notes.push(Note::Unhealthy(why));
        }
        let before = Some(self.start.clone());
        let length = watchdog::probation(next.order.kind, &next.order.policy, probation);
        self.probation = Some(Probation { before, length, was_activated: false, until: None, is_new: false });
        if self.saved.as_ref().is_none_or(|saved| !saved.is_due) {
            self.saved = Some(Saved { restarts: self.restarts.clone(), is_due: false });
        }
        context.notes.push(Note::Changed(Change::Replacing));
        match self.stage {
            Stage::Dead | Stage::Waiting { .. } => self.take_place(next, context),
            Stage::Prepared | Stage::Connecting { .. } | Stage::Idle | Stage::Running | Stage::Stopping { .. } => {
                self.make_place(next, self.is_controller(), context);
            }
            // A program that has not said hello has no channel for an order yet.
            Stage::Starting { .. } | Stage::Removing { .. } | Stage::Refused => {
                self.make_place(next, false, context);
            }
            Stage::Replacing { .. } => self.next = Some(next),
            // A program that is to leave is not replaced.
            Stage::Leaving { .. } => {}
        }
    }

    /// Starts the previous program in the place of this one, because a change is taken back. The previous program has
    /// as many restarts left as before the change.
    pub fn take_back(&mut self, before: Start, probation: Duration, context: &mut InstanceContext<'_>) {
        self.saved.iter_mut().for_each(|saved| saved.is_due = true);
        self.replace(before, probation, context);
    }

    /// Restarts the program because another program of its group, `with`, has died. Nothing is done if the program is
    /// being started, and so is new already. Nothing is done either if it is stopping or is never restarted.
    pub fn renew(&mut self, with: &str, context: &mut InstanceContext<'_>) {
        let runs = self.stage == Stage::Running || self.stage == Stage::Idle && self.is_controller();
        if !runs || !self.restarts.are_allowed() || self.probation.is_some() {
            return;
        }
        self.make_place(self.start.clone(), self.is_controller(), context);
        context.notes.push(Note::Changed(Change::Renewing { with: with.to_owned() }));
    }

    /// Stops the program, so that `next` can take its place. If the program takes orders, it is asked to leave.
    /// Otherwise its shim ends it.
    fn make_place(&mut self, next: Start, takes_orders: bool, context: &mut InstanceContext<'_>) {
        let is_stopping = matches!(self.stage, Stage::Stopping { .. });
        let until = context.now + self.start.stop_within + GRACE;
        self.next = Some(next);
        if takes_orders {
            self.stage = Stage::Replacing { until, forced: false, is_stopping };
            self.tell(Order::Exit, context);
        } else {
            self.stage = Stage::Replacing { until: until + KILL_WITHIN, forced: true, is_stopping };
            self.tell_shim(ShimOrder::Stop { grace: self.start.stop_within.max(GRACE) }, context);
        }
    }

    /// Handles the time limit of a program that is to make room for another.
    pub(super) fn tick_replacing(&mut self, forced: bool, is_stopping: bool, context: &mut InstanceContext<'_>) {
        if !forced {
            let until = context.now + GRACE + KILL_WITHIN;
            self.stage = Stage::Replacing { until, forced: true, is_stopping };
            return self.tell_shim(ShimOrder::Stop { grace: GRACE }, context);
        }
        (self.stage, self.program.cause) = (Stage::Dead, Some(FailureCause::StopUnconfirmed));
        (self.probation, self.next) = (None, None);
        context.notes.push(Note::Unhealthy("the previous program could not be ended".to_owned()));
        self.finish(Ending::Unconfirmed, context);
    }

    /// Starts the next program in the place of this one, of which nothing is left.
    pub(super) fn replaced(&mut self, is_stopping: bool, context: &mut InstanceContext<'_>) {
        if is_stopping {
            self.finish(Ending::Stopped, context);
        }
        let Some(next) = self.next.take() else { return };
        self.take_place(next, context);
    }

    /// Notes that the program has started and continues the work of its predecessor.
    pub(super) fn is_up(&mut self, context: &mut InstanceContext<'_>) {
        if let Some(probation) = self.probation.as_mut().filter(|probation| probation.until.is_none()) {
            probation.until = Some(context.now + probation.length);
            context.notes.push(Note::Replaced);
        }
        self.tick_probation(context);
    }

    /// Notes that a controller gets the order to initialise itself. At the first such order, the probation is
    /// suspended, and begins again when `Init` has succeeded.
    pub(super) fn suspend_probation(&mut self) {
        if let Some(probation) = self.probation.as_mut().filter(|probation| !probation.was_activated) {
            (probation.was_activated, probation.until) = (true, None);
        }
    }

    /// Returns whether the previous program is being started again.
    pub fn is_returning(&self) -> bool {
        self.probation.as_ref().is_some_and(|probation| probation.before.is_none() && !probation.is_new)
    }

    /// Starts the previous program again if this program is on probation; returns whether it was on probation.
    pub(super) fn put_back(&mut self, cause: &FailureCause, context: &mut InstanceContext<'_>) -> bool {
        if self.probation.take_if(|probation| probation.is_new).is_some() {
            // The supervisor of this added program gets no report: the program is stopped and removed.
            self.forget_program();
            self.stage = Stage::Waiting { until: None };
            context.notes.push(Note::Unhealthy(cause.to_string()));
            return true;
        }
        let Some(before) = self.probation.as_mut().and_then(|probation| probation.before.take()) else {
            let is_returning = self.probation.take().is_some();
            let why = || format!("the previous program was started again, and has failed too: {cause}");
            context.notes.extend(is_returning.then(|| Note::Unhealthy(why())));
            return false;
        };
        self.probation =
            Some(Probation { before: None, length: Duration::ZERO, was_activated: true, until: None, is_new: false });
        context.notes.push(Note::Changed(Change::Reverting { cause: cause.clone() }));
        context.notes.push(Note::Unhealthy(cause.to_string()));
        self.saved.iter_mut().for_each(|saved| saved.is_due = true);
        self.take_place(before, context);
        true
    }

    /// Returns whether the program is a service that has recently replaced another program. If it ends, it is unhealthy.
    pub(super) fn is_new_service(&self) -> bool {
        self.start.order.is_service && self.probation.is_some() && !self.is_returning()
    }

    /// Handles a new program that announces its end. Such a program is ended, and treated as unhealthy. Returns whether this was the case.
    pub(super) fn is_turned_away(&mut self, cause: FailureCause, context: &mut InstanceContext<'_>) -> bool {
        let is_new = self.probation.is_some() && !self.is_returning() && self.stage == Stage::Running;
        if is_new {
            self.program.cause = Some(cause);
            self.stage = Stage::Removing { until: context.now + GRACE + KILL_WITHIN };
            self.tell_shim(ShimOrder::Stop { grace: GRACE }, context);
        }
        is_new
    }

    /// Declares the program healthy if the time of its probation is over.
    pub(super) fn tick_probation(&mut self, context: &mut InstanceContext<'_>) {
        if self.probation_until().is_some_and(|until| until <= context.now) {
            self.probation = None;
            context.notes.push(Note::Healthy);
        }
    }

    /// Returns until when the program is on probation.
    pub(super) fn probation_until(&self) -> Option<Time> {
        self.probation.as_ref().and_then(|probation| probation.until)
    }

    fn take_place(&mut self, next: Start, context: &mut InstanceContext<'_>) {
        let saved = self.saved.take_if(|saved| saved.is_due);
        if self.probation.is_some() {
            self.restarts = saved.map_or_else(|| next.restarts(), |saved| saved.restarts);
        }
        self.failed = None;
        self.start = next;
        self.forget_program();
        self.start(context);
    }
}
