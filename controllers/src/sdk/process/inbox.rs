//! What waits for the control loop: commands in order, and samples that have arrived.

use super::cycle::Command;
use comms::io::clock::{Wakeup, now};
use comms::logic::time::Time;
use std::collections::VecDeque;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// How many samples wait for one input; its oldest gives way, so that one busy input cannot push out another's.
const SAMPLES_MAX: usize = 64;
/// How many commands wait; a controller that has not taken so many is stuck.
const COMMANDS_MAX: usize = 64;

/// A sample that has arrived.
#[derive(Debug)]
pub(super) struct Arrived {
    pub(super) port: &'static str,
    pub(super) bytes: Vec<u8>,
    pub(super) at: Time,
}

#[derive(Debug, Default)]
struct Waiting {
    commands: VecDeque<Command>,
    samples: VecDeque<Arrived>,
    left: bool,
}

/// Filled by the listener and zenoh's threads, emptied by the cycle.
#[derive(Debug, Default)]
pub(super) struct Inbox {
    waiting: Mutex<Waiting>,
    has_left: Condvar,
    pub(super) wakeup: Wakeup,
}

impl Inbox {
    /// Puts a command in the queue; says whether there was room.
    pub(super) fn command(&self, command: Command) -> bool {
        let room = {
            let commands = &mut self.lock().commands;
            let room = commands.len() < COMMANDS_MAX || matches!(command, Command::Leave);
            if room {
                commands.push_back(command);
            }
            room
        };
        self.wakeup.wake();
        room
    }

    pub(super) fn sample(&self, port: &'static str, bytes: Vec<u8>) {
        let arrived = Arrived { port, bytes, at: now() };
        {
            let mut waiting = self.lock();
            let same = |other: &Arrived| other.port == port;
            if waiting.samples.iter().filter(|other| same(other)).count() >= SAMPLES_MAX {
                let oldest = waiting.samples.iter().position(same);
                oldest.and_then(|oldest| waiting.samples.remove(oldest));
            }
            waiting.samples.push_back(arrived);
        }
        self.wakeup.wake();
    }

    pub(super) fn next_command(&self) -> Option<Command> {
        self.lock().commands.pop_front()
    }

    pub(super) fn take_samples(&self) -> VecDeque<Arrived> {
        std::mem::take(&mut self.lock().samples)
    }

    /// Says that the cycle runs no more.
    pub(super) fn leave(&self) {
        self.lock().left = true;
        self.has_left.notify_all();
    }

    /// Waits until the cycle runs no more; its own limits bound that.
    pub(super) fn wait_left(&self) {
        let waiting = self.has_left.wait_while(self.lock(), |waiting| !waiting.left);
        drop(waiting.unwrap_or_else(PoisonError::into_inner));
    }

    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
