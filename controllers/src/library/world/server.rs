//! The command side of the devices: a lock for each, a queue of commands beside its port, and the count of refusals.
//!
//! Each command is checked at its device. A command under a grant that has ended since then is
//! refused, even if it was in transit for long.

use crate::message::{BaseVelocity, Grip, JointVelocity};
use crate::robot::drive::Owner;
use crate::sdk::messaging::{
    Full, Lock, LockAnswer, LockRequest, LockSettings, Queue, QueueMessage, QueueStatus, Receipt, Rejected, Taken,
};
use crate::sdk::{Arguments, Message, Reply};
use comms::logic::time::Time;
use std::time::Duration;

/// The lease of a grant without renewal, and the time that a client with a greater priority waits for the holder to
/// come to rest.
///
/// The lease only decides when another client of the same priority gets the device: the watchdog stops the device long
/// before. With a lease of 500 ms, a machine at a load of 36 took the arm from a mission that was alive.
pub(super) const LOCK: LockSettings =
    LockSettings { lease: Duration::from_secs(2), preempt_after: Some(Duration::from_millis(300)), waiting_max: 8 };
/// How many commands wait for the next calculation; if there are more, the newest remain.
const COMMANDS_MAX: usize = 4;

/// The commands that are obeyed while no client holds the lock of a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Unlocked {
    /// The commands of any sender, one sender at a time.
    Anyone,
    /// No commands.
    Nobody,
}

/// One device, commanded by values of type `T`.
#[derive(Debug)]
pub(super) struct Server<T> {
    unlocked: Unlocked,
    lock: Lock,
    commands: Queue<T>,
    owner: Owner,
    /// When a command was last obeyed.
    commanded: Option<Time>,
    refused: u64,
    /// The number of commands that the port has refused in this activation, because a number in them was not finite.
    not_finite: u64,
}

impl<T: Message> Server<T> {
    fn new(unlocked: Unlocked) -> Self {
        let commands = Queue::new(COMMANDS_MAX, Full::DropOldest);
        Self {
            unlocked,
            lock: Lock::new(LOCK),
            commands,
            owner: Owner::default(),
            commanded: None,
            refused: 0,
            not_finite: 0,
        }
    }

    /// Hands a request to the lock.
    pub(super) fn ask(&mut self, request: LockRequest, reply: Reply<LockAnswer>) {
        self.lock.ask(request, reply);
    }

    /// Takes a command into the queue, but only from the holder of the lock.
    pub(super) fn receive(&mut self, message: QueueMessage) -> Receipt {
        let receipt = self.commands.receive_under(&mut self.lock, message);
        if matches!(receipt, Receipt::Rejected(Rejected::Fenced(_) | Rejected::WrongType { .. })) {
            self.refused += 1;
        }
        receipt
    }

    /// Returns the next command of the queue. Each calculation calls this until no command is left; the call also
    /// maintains the lock.
    pub(super) fn take(&mut self, now: Time) -> Option<Taken<T>> {
        self.commands.take_under(&mut self.lock, now)
    }

    /// Returns whether a command from `owner` with this fencing number is obeyed.
    pub(super) fn admit(&mut self, owner: &str, fence: Option<u64>, now: Time) -> bool {
        let is_locked = self.unlocked == Unlocked::Nobody || fence.is_some() || self.lock.held(now).is_some();
        let is_obeyed = if is_locked { self.lock.admit(fence).is_ok() } else { self.owner.admit(owner, now) };
        if is_obeyed {
            self.commanded = Some(now);
        } else if is_locked {
            self.refused += 1;
        }
        is_obeyed
    }

    /// Takes the number of commands that the port has refused in this activation.
    pub(super) fn note_refused(&mut self, not_finite: u64) {
        self.not_finite = not_finite;
    }

    /// Lets another sender command the device without the lock.
    pub(super) fn release(&mut self) {
        self.owner.release();
    }

    /// Returns the time of the last obeyed command (s since the start of the host; 0 if there was none), the number of
    /// refusals, and the holder of the lock.
    pub(super) fn status(&self) -> (f64, f64, String) {
        let commanded = self.commanded.map_or(0.0, super::super::seconds);
        (commanded, (self.refused + self.not_finite) as f64, self.holder().unwrap_or_default())
    }

    /// Returns the status of the queue.
    pub(super) fn queue(&self) -> QueueStatus {
        self.commands.status()
    }

    fn holder(&self) -> Option<String> {
        self.lock.status().holder
    }
}

/// The servers of all devices that move.
#[derive(Debug)]
pub(super) struct Servers {
    pub(super) base: Server<BaseVelocity>,
    pub(super) arm: Server<JointVelocity>,
    pub(super) gripper: Server<Grip>,
}

impl Servers {
    /// Returns the servers of devices without a holder.
    pub(super) fn new(arguments: &Arguments) -> Self {
        let unlocked = if arguments.text("commands") == "holder" { Unlocked::Nobody } else { Unlocked::Anyone };
        Self { base: Server::new(unlocked), arm: Server::new(unlocked), gripper: Server::new(unlocked) }
    }

    /// Lets any sender command the devices without the lock; a holder of a lock keeps it.
    pub(super) fn begin(&mut self) {
        self.base.release();
        self.arm.release();
        self.gripper.release();
    }

    /// Returns a device whose lock is held, and the name of the holder.
    pub(super) fn held(&self) -> Option<(&'static str, String)> {
        let all = [("base", self.base.holder()), ("arm", self.arm.holder()), ("gripper", self.gripper.holder())];
        all.into_iter().find_map(|(device, holder)| Some((device, holder?)))
    }
}
