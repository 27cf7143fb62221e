//! The words that go in and out of the algebra.

use std::sync::Arc;
use std::time::Duration;

/// Bytes that one process leaves for the next, of any size; its receiver interprets them. Cloning shares the bytes.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Value(Option<Arc<[u8]>>);

impl Value {
    /// The empty value.
    pub const EMPTY: Self = Self(None);

    /// Returns a value that holds `bytes`.
    pub fn new(bytes: &[u8]) -> Self {
        if bytes.is_empty() { Self::EMPTY } else { Self(Some(bytes.into())) }
    }

    /// Returns the bytes.
    pub fn bytes(&self) -> &[u8] {
        self.0.as_deref().unwrap_or(&[])
    }

    /// Returns the values that several processes leave together.
    ///
    /// One value is itself, and values that are all empty are the empty value. Else each value stands as its length (8
    /// bytes, least significant first) and its bytes.
    pub fn tuple<'a>(values: impl Iterator<Item = &'a Self> + Clone) -> Self {
        let mut some = values.clone();
        match (some.next(), some.next()) {
            (None, _) => return Self::EMPTY,
            (Some(value), None) => return value.clone(),
            (Some(_), Some(_)) => {}
        }
        if values.clone().all(|value| value.0.is_none()) {
            return Self::EMPTY;
        }
        let mut bytes = Vec::new();
        for value in values {
            bytes.extend((value.bytes().len() as u64).to_le_bytes());
            bytes.extend(value.bytes());
        }
        Self::new(&bytes)
    }
}

/// Numbers the activations of one member from 1; an event with an older number is dropped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Activation(pub u32);

/// What happened.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Event {
    /// The group is activated with an initial value.
    Start(Value),
    /// The group is asked to stop.
    Stop,
    /// A member ended normally, after its clean-up.
    Done {
        /// Slot of the member.
        member: u32,
        /// Which of its activations.
        activation: Activation,
        /// What it leaves.
        value: Value,
    },
    /// A member failed; nothing of this activation runs any more.
    Aborted {
        /// Slot of the member.
        member: u32,
        /// Which of its activations.
        activation: Activation,
        /// What the member says of it: opaque here.
        report: Value,
    },
    /// A member confirms a stop.
    Stopped {
        /// Slot of the member.
        member: u32,
        /// Which of its activations.
        activation: Activation,
    },
    /// Nobody can confirm that a member has stopped (its host is lost).
    StopUnconfirmed {
        /// Slot of the member.
        member: u32,
        /// Which of its activations.
        activation: Activation,
    },
    /// A timer armed by [`Command::Arm`] ran out.
    Elapsed {
        /// The timer.
        timer: u32,
        /// Which of its arms.
        activation: Activation,
    },
}

/// What to do about it, in this order.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Command {
    /// Open a connection set; sets are opened before their owner is activated.
    Connect {
        /// Index of the set in the group.
        set: u32,
    },
    /// Close a connection set.
    Disconnect {
        /// Index of the set in the group.
        set: u32,
    },
    /// Initialise a member with a value and run it.
    Activate {
        /// Slot of the member.
        member: u32,
        /// Which of its activations.
        activation: Activation,
        /// For its `Init`.
        value: Value,
    },
    /// Stop a member.
    Stop {
        /// Slot of the member.
        member: u32,
        /// Which of its activations.
        activation: Activation,
    },
    /// Deliver [`Event::Elapsed`] after this time.
    Arm {
        /// The timer.
        timer: u32,
        /// Which of its arms.
        activation: Activation,
        /// How long.
        after: Duration,
    },
    /// Forget a timer.
    Cancel {
        /// The timer.
        timer: u32,
        /// Which of its arms.
        activation: Activation,
    },
}

/// How a group ended.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Outcome {
    /// Normally.
    Done(Value),
    /// By a failure.
    Aborted(Reason),
    /// Because it was asked to.
    Stopped,
}

/// Why a group aborted.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Reason {
    /// The member it began with; none for a constant such as `fail`.
    pub member: Option<u32>,
    /// What it was.
    pub cause: Cause,
}

/// What went wrong.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Cause {
    /// The member's own report.
    Reported(Value),
    /// It was activated while it was already running.
    Busy,
    /// Nobody could confirm that it stopped.
    StopUnconfirmed,
    /// A service ended, which breaks its contract.
    ServiceEnded,
    /// `fail("why")`.
    Failed(Arc<str>),
}
