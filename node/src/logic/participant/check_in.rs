//! A part whose node was away for long: until its home has answered, nothing begins, since the home may have given it up.
//!
//! What runs goes on, and can be stopped. Programs that have died, and those that are back, wait to be started again, and to go on where
//! they were; so do the activations of others, and those that supervisors of this host decide.

use super::{Participant, Phase};
use crate::logic::effect::Out;
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// How long a home is waited for that is there and does not answer: longer than it takes until one that is not there is lost.
const WITHIN: Duration = Duration::from_secs(30);

/// A question to the home.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct CheckIn {
    number: u64,
    until: Time,
}

impl Participant {
    /// Waits for the answer of its home to this question; says whether it does. Without its home it is on its own.
    pub fn check_in(&mut self, number: u64, now: Time) -> bool {
        let is_alone = self.phase == Phase::Leaving || self.is_home_lost();
        if !is_alone {
            self.check_in = Some(CheckIn { number, until: now + WITHIN });
            self.instances.each(|_, instance| instance.check_in());
            self.executers.each(|_, executer| executer.check_in());
        }
        !is_alone
    }

    /// Returns the question that its home has not answered.
    pub fn checks_in(&self) -> Option<u64> {
        self.check_in.map(|check_in| check_in.number)
    }

    /// Goes on: its home has answered, or is lost.
    pub fn checked_in(&mut self, out: &mut Out<'_>) {
        if self.check_in.take().is_none() {
            return;
        }
        for leaf in self.instances.numbers() {
            self.with_instance(leaf, out, |instance, context| instance.checked_in(context));
        }
        self.activate_waiting(out);
        self.each_executer(out, |executer, at, out| executer.checked_in(at, out));
    }

    /// Does not wait for ever.
    pub(super) fn tick_check_in(&mut self, out: &mut Out<'_>) {
        if self.check_in.is_some_and(|check_in| check_in.until <= out.now) {
            let (deployment, home) = (&self.deployment, &self.home);
            tracing::warn!(%deployment, home, "the home has not said whether it has given this host up: its part goes on");
            self.checked_in(out);
        }
    }

    /// Returns when [`Participant::tick_check_in`] wants to be called.
    pub(super) fn check_in_deadline(&self) -> Option<Time> {
        self.check_in.map(|check_in| check_in.until)
    }
}
