//! The activation of an instance, from the order of its supervisor to its one ending.

use super::{DeathTold, Instance, InstanceContext, KILL_WITHIN, Note, Stage};
use crate::logic::protocol::{Change, Ending, Failure, FailureCause};
use comms::logic::control::Order;
use serde::{Deserialize, Serialize};
use shim::protocol::ShimOrder;

/// An activation that has not ended.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Current {
    pub(super) number: u32,
    /// For its `Init`, in case another program takes its place.
    pub(super) value: Vec<u8>,
    /// The host whose loss stops it.
    pub(super) lost: Option<String>,
}

impl Instance {
    /// Initialises and runs the program, or notes that this is to be done once it is there again.
    pub fn activate(&mut self, activation: u32, value: Vec<u8>, context: &mut InstanceContext<'_>) {
        if self.current.as_ref().is_some_and(|current| current.number == activation) {
            return;
        }
        if let Some(cause) = self.obstacle() {
            self.death = self.death.map(|_| DeathTold::Yes);
            let failure = self.failure(cause, context);
            return context.notes.push(Note::Ended(activation, Ending::Aborted(failure)));
        }
        self.current = Some(Current { number: activation, value: value.clone(), lost: None });
        context.notes.push(Note::Changed(Change::Activated));
        match self.stage {
            Stage::Idle if self.checks_in => {}
            Stage::Idle => self.run(value, context),
            Stage::Waiting { until: None } => self.start(context),
            // It has died: who activates it again means another program of its kind.
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

    /// Returns whether a program that has died is started again with its next activation: it took part, nothing of it is left, its
    /// death was told, and it was not given up by its own policy.
    fn is_renewable(&self) -> bool {
        let is_told = self.death == Some(DeathTold::Yes) && !self.is_unconfirmed();
        is_told && self.joined && self.is_controller() && !self.restarts.are_allowed()
    }

    /// Returns why it cannot be activated, if so.
    pub(super) fn obstacle(&self) -> Option<FailureCause> {
        let takes_part = match self.stage {
            Stage::Dead if self.is_renewable() => true,
            Stage::Leaving { .. } | Stage::Dead => {
                let gone = || FailureCause::NotAvailable("its program is not running".into());
                return Some(self.cause.clone().unwrap_or_else(gone));
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
            self.cut_off.first().cloned().map(FailureCause::HostLost)
        }
    }

    /// Stops an activation; one that is over is left to the ending already sent.
    pub fn stop(&mut self, activation: u32, context: &mut InstanceContext<'_>) {
        if self.current.as_ref().is_none_or(|current| current.number != activation) {
            return;
        }
        match self.stage {
            Stage::Running => {
                context.notes.push(Note::Changed(Change::Stopping));
                if self.is_controller() {
                    self.stage = Stage::Stopping { until: context.now + self.stop_within, forced: false };
                    self.tell(Order::Stop { activation }, context);
                } else {
                    let until = context.now + self.stop_within + KILL_WITHIN;
                    self.stage = Stage::Stopping { until, forced: true };
                    self.tell_shim(ShimOrder::Stop { grace: self.stop_within }, context);
                }
            }
            // The program died and has not been activated since, or waits for its home: nothing moves.
            Stage::Idle
            | Stage::Waiting { .. }
            | Stage::Removing { .. }
            | Stage::Starting { .. }
            | Stage::Prepared
            | Stage::Connecting { .. } => self.finish(Ending::Stopped, context),
            // It is on its way out: what moves ends with it.
            Stage::Replacing { until, forced, .. } => {
                self.stage = Stage::Replacing { until, forced, is_stopping: true };
            }
            Stage::Stopping { .. } | Stage::Leaving { .. } | Stage::Refused | Stage::Dead => {}
        }
    }

    /// Stops what runs because `host` is lost, which then counts as its failure; nothing new begins until [`Self::reach`].
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
        self.checks_in = true;
    }

    /// Goes on.
    pub fn checked_in(&mut self, context: &mut InstanceContext<'_>) {
        self.checks_in = false;
        if self.stage == Stage::Idle && self.current.is_some() {
            self.resume(None, context);
        }
    }

    /// Begins nothing new while `host` is lost.
    pub fn hold(&mut self, host: &str) {
        self.cut_off.insert(host.to_owned());
    }

    /// Takes note that `host` is back.
    pub fn reach(&mut self, host: &str) {
        self.cut_off.remove(host);
    }

    /// Ends the current activation, if there is one. What stopped because a host was lost has failed.
    pub(super) fn finish(&mut self, ending: Ending, context: &mut InstanceContext<'_>) {
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

    pub(super) fn failure(&self, cause: FailureCause, context: &InstanceContext<'_>) -> Failure {
        Failure { origin: self.order.path.clone(), cause, at: context.since_go }
    }
}
