//! The right of a controller to command a device: by the lock of the device if the spec connects it, else only by the
//! controller's name.
//!
//! A controller that holds the lock stamps each command with the fencing number of its grant. A controller that loses
//! the lock ends, because the new holder may have moved the device.

use crate::sdk::messaging::{Denied, LockAnswer, LockRequest, LockUser};
use crate::sdk::{Arguments, Calls, Kind, Parameter};
use comms::logic::time::Time;
use std::time::Duration;

/// How long a user waits for a device that another client holds: longer than the lease of a client that has died.
const PATIENCE: Duration = Duration::from_secs(5);
/// How long a stop waits until the server knows that its lock is free again. After this time, the lease ends the lock.
const RELEASE_WITHIN: Duration = Duration::from_millis(100);

/// The order of clients that want one device: a greater number goes first.
pub(super) const PRIORITY: Parameter = Parameter::new("priority", Kind::Whole(0.0, 255.0)).or("0");

/// The calls of the lock of a device.
pub(super) type LockCalls = Calls<LockRequest, LockAnswer>;

/// The commands that may be sent to a device now.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Right {
    /// Commands with this fencing number; without a number if the spec connects no lock.
    Command(Option<u64>),
    /// No commands yet.
    Wait,
    /// No commands any more: the lock is lost. The text is the reason, for a person.
    Lost(String),
}

/// The user of the lock of one device.
#[derive(Debug)]
pub(super) struct Grant {
    device: &'static str,
    name: String,
    priority: u8,
    user: LockUser,
    /// Since when the controller has waited for the lock.
    waiting: Option<Time>,
    /// The fencing number of the last grant.
    fence: Option<u64>,
    /// Whether a stop has nothing more to send.
    has_said_all: bool,
    /// When the lock was released.
    released: Option<Time>,
}

impl Grant {
    /// Returns a user that has not yet asked for the lock; `device` is the name for messages.
    ///
    /// # Errors
    /// If the system gives no random number for the user.
    pub(super) fn new(device: &'static str, arguments: &Arguments) -> Result<Self, String> {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the parameter is from 0 to 255")]
        let priority = arguments.number("priority") as u8;
        let name = arguments.full_name();
        let user = user(&name)?;
        Ok(Self { device, name, priority, user, waiting: None, fence: None, has_said_all: false, released: None })
    }

    /// Begins an activation. A grant from an earlier activation is not used.
    ///
    /// # Errors
    /// As in [`Grant::new`].
    pub(super) fn begin(&mut self) -> Result<(), String> {
        self.user = user(&self.name)?;
        (self.waiting, self.fence, self.has_said_all, self.released) = (None, None, false, None);
        Ok(())
    }

    /// Acquires or renews the lock. Returns the commands that may be sent in this calculation.
    pub(super) fn ask(&mut self, now: Time, calls: &mut LockCalls) -> Right {
        if !calls.is_connected() {
            return Right::Command(None);
        }
        let device = self.device;
        if self.user.held(now).is_none() {
            match self.user.lost() {
                Some(why @ (Denied::Preempted | Denied::TooManyWait)) => {
                    return Right::Lost(format!("lost the {device}: {why}"));
                }
                // The next fencing number shows that no other client has had the device in between.
                Some(Denied::Expired | Denied::Released | Denied::NotHeld) | None => self.user.want(self.priority),
            }
        }
        self.user.work(now, calls);
        let Some(fence) = self.user.held(now) else { return self.wait(now) };
        if self.fence.replace(fence).is_some_and(|before| fence > before.saturating_add(1)) {
            return Right::Lost(format!("lost the {device}: another client has had it in the meantime"));
        }
        self.waiting = None;
        if self.user.is_wanted() {
            return Right::Lost(format!("lost the {device}: {}", Denied::Preempted));
        }
        Right::Command(Some(fence))
    }

    /// Renews the lock while the device comes to rest. Returns the commands that may be sent in this calculation of a
    /// stop. A lost lock is not acquired again: the watchdog brings the device to rest.
    pub(super) fn keep(&mut self, now: Time, calls: &mut LockCalls) -> Right {
        if !calls.is_connected() {
            return Right::Command(None);
        }
        if self.has_said_all {
            return Right::Wait;
        }
        self.user.work(now, calls);
        self.user.held(now).map_or(Right::Wait, |fence| Right::Command(Some(fence)))
    }

    /// Releases the lock once its user `rests`. Returns whether the stop is over. The last command has one calculation
    /// to arrive before its fencing number is no longer valid.
    pub(super) fn is_over(&mut self, now: Time, rests: bool, calls: &mut LockCalls) -> bool {
        if !calls.is_connected() {
            return rests;
        }
        if !self.has_said_all && self.user.held(now).is_some() {
            self.has_said_all = rests;
            return false;
        }
        self.has_said_all = true;
        if self.released.is_none() {
            self.released = Some(now);
            self.user.let_go();
        }
        self.user.work(now, calls);
        self.user.is_idle() || self.released.is_some_and(|at| now.since(at) >= RELEASE_WITHIN)
    }

    fn wait(&mut self, now: Time) -> Right {
        let since = *self.waiting.get_or_insert(now);
        if now.since(since) < PATIENCE {
            return Right::Wait;
        }
        let (device, holder) = (self.device, self.user.holder());
        Right::Lost(if holder.is_empty() {
            format!("the lock of the {device} does not answer")
        } else {
            format!("the {device} is held by `{holder}`")
        })
    }
}

fn user(name: &str) -> Result<LockUser, String> {
    LockUser::new(name).map_err(|cause| format!("no number for a user of a lock: {cause}"))
}
