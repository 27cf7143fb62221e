//! The events and commands of the algebra.

use crate::automaton::{self, Failure};
use crate::plan::text_value;
use crate::script::ScriptError;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::time::Duration;

/// The longest tag of an outcome, in bytes.
pub const TAG_MAX: usize = 64;

/// Bytes that one process leaves for the next, of any size; its receiver interprets them. Cloning shares the bytes.
///
/// # Tags
/// A process with several normal ends (`done(found: Pose | missing)`) puts the tag of its end before its value: one byte
/// with the length of the tag, 1 to [`TAG_MAX`], then the tag, then the value. These are the bytes that postcard makes of
/// the pair `(tag, value)`, so a controller needs no code of its own for it. Only a `match` looks at a tag, and takes it
/// off without a copy; nothing in the bytes says whether there is one, so the interface of the process has to.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Value {
    shared: Option<Arc<[u8]>>,
    /// How many bytes a `match` has taken off.
    from: usize,
}

impl Value {
    /// The empty value.
    pub const EMPTY: Self = Self { shared: None, from: 0 };

    /// Returns a value that holds `bytes`.
    pub fn new(bytes: &[u8]) -> Self {
        if bytes.is_empty() { Self::EMPTY } else { Self { shared: Some(bytes.into()), from: 0 } }
    }

    /// Returns `bytes` with a tag before them; none if the tag is empty or longer than [`TAG_MAX`].
    pub fn tagged(tag: &str, bytes: &[u8]) -> Option<Self> {
        let length = u8::try_from(tag.len()).ok().filter(|&length| (1..=TAG_MAX).contains(&usize::from(length)))?;
        Some(Self::new(&[&[length], tag.as_bytes(), bytes].concat()))
    }

    /// Returns the bytes.
    pub fn bytes(&self) -> &[u8] {
        self.shared.as_deref().and_then(|bytes| bytes.get(self.from..)).unwrap_or(&[])
    }

    /// Returns the tag that the bytes begin with, if they can be read so.
    pub fn tag(&self) -> Option<&str> {
        let (&length, rest) = self.bytes().split_first()?;
        let tag = rest.get(..usize::from(length)).filter(|tag| (1..=TAG_MAX).contains(&tag.len()))?;
        std::str::from_utf8(tag).ok()
    }

    /// Returns the place of this value among others, or else the place of the first one with its tag.
    pub fn place_in(&self, values: &[Self]) -> Option<usize> {
        let has_same_tag = |other: &Self| self.tag().is_some() && other.tag() == self.tag();
        values.iter().position(|other| other == self).or_else(|| values.iter().position(has_same_tag))
    }

    /// Returns the text that the bytes are, if they can be read so: a length, seven bits a byte, and the text.
    pub fn text(&self) -> Option<&str> {
        let bytes = self.bytes();
        let start = bytes.iter().position(|byte| byte & 0x80 == 0)? + 1;
        let groups = bytes.iter().take(start.min(4)).rev();
        let length = groups.fold(0, |length, byte| length << 7 | usize::from(byte & 0x7f));
        let text = bytes.get(start..).filter(|text| text.len() == length)?;
        std::str::from_utf8(text).ok()
    }

    /// Returns the value behind the tag, which the bytes must begin with.
    pub(crate) fn without_tag(self) -> Self {
        let length = self.tag().map_or(0, |tag| tag.len() + 1);
        Self { from: self.from + length, ..self }
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
        if values.clone().all(|value| value.bytes().is_empty()) {
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

/// Values are equal when their bytes are, however they are shared.
impl PartialEq for Value {
    fn eq(&self, other: &Self) -> bool {
        self.bytes() == other.bytes()
    }
}

impl Eq for Value {}

impl std::hash::Hash for Value {
    fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
        self.bytes().hash(state);
    }
}

/// Numbers the activations of one member from 1; an event with an older number is dropped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Activation(pub u32);

/// One thing that has happened to a group: the input of [`step`](super::step).
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Event {
    /// The group is activated with an initial value.
    Start(Value),
    /// The group is asked to stop.
    Stop,
    /// A member ended normally, after its clean-up.
    Done {
        /// Slot of the member.
        member: u32,
        /// The activation of the member that is done.
        activation: Activation,
        /// The value that the member leaves for the next process.
        value: Value,
    },
    /// A member failed; nothing of this activation runs any more.
    Aborted {
        /// Slot of the member.
        member: u32,
        /// The activation of the member that has aborted.
        activation: Activation,
        /// The member's report of its failure: see [`Failure::of_report`].
        report: Value,
    },
    /// A member confirms a stop.
    Stopped {
        /// Slot of the member.
        member: u32,
        /// The activation of the member that has stopped.
        activation: Activation,
    },
    /// Nobody can confirm that a member has stopped (its host is lost).
    StopUnconfirmed {
        /// Slot of the member.
        member: u32,
        /// The activation of the member whose stop is not confirmed.
        activation: Activation,
    },
    /// A timer armed by [`Command::Arm`] ran out.
    Elapsed {
        /// The timer.
        timer: u32,
        /// The arming of the timer that has elapsed.
        activation: Activation,
    },
    /// A message has arrived for an activity.
    Message {
        /// The number of the input port.
        port: u32,
        /// The numbers of the filters that let it through.
        filters: Vec<u32>,
        /// The priority; of messages that wait, a greater one comes first.
        priority: u8,
        /// The content.
        value: Value,
    },
    /// The surroundings of an activity have noticed something.
    Notice(u32),
}

impl Event {
    /// Returns the same event for the automaton of an activity, if it is a message or a notice.
    pub fn told(self) -> Option<automaton::Event> {
        match self {
            Self::Message { port, filters, priority, value } => {
                let filters = filters.into_iter().map(|filter| filter as usize).collect();
                Some(automaton::Event::Message { port: port as usize, filters, priority, value })
            }
            Self::Notice(notice) => Some(automaton::Event::Notice(notice as usize)),
            Self::Start(_)
            | Self::Stop
            | Self::Done { .. }
            | Self::Aborted { .. }
            | Self::Stopped { .. }
            | Self::StopUnconfirmed { .. }
            | Self::Elapsed { .. } => None,
        }
    }
}

/// One order of a supervisor. A step gives them in the order in which they are to be carried out.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
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
        /// The activation that begins.
        activation: Activation,
        /// For its `Init`.
        value: Value,
    },
    /// Stop a member.
    Stop {
        /// Slot of the member.
        member: u32,
        /// The activation that is to stop.
        activation: Activation,
    },
    /// Deliver [`Event::Elapsed`] after this time.
    Arm {
        /// The timer.
        timer: u32,
        /// The number of this arming.
        activation: Activation,
        /// How long.
        after: Duration,
    },
    /// Forget a timer.
    Cancel {
        /// The timer.
        timer: u32,
        /// The number of the arming that is cancelled.
        activation: Activation,
    },
    /// Send a value of an activity.
    Send {
        /// The number of the output port.
        output: u32,
        /// The value.
        value: Value,
    },
    /// Write a line of an activity for people.
    Log {
        /// The line.
        text: Arc<str>,
    },
    /// A message for an activity was lost, because too many wait at its port.
    Lost {
        /// The number of the input port.
        port: u32,
    },
}

/// How a group ended.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Outcome {
    /// A normal end.
    Done(Value),
    /// By a failure.
    Aborted(Reason),
    /// Because it was asked to.
    Stopped,
}

impl Reason {
    /// Returns the report of this abort to the supervisor around the group, which reads the same [`Failure`] from it; empty for
    /// the report of a program, which has no name.
    pub fn report(&self) -> Value {
        match &self.cause {
            Cause::Failed(why) => text_value(why),
            Cause::Reported(report) if Failure::of_report(report) == Failure::Reported => Value::EMPTY,
            Cause::Reported(report) => report.clone(),
            Cause::Busy | Cause::StopUnconfirmed | Cause::ServiceEnded | Cause::NoMatch | Cause::Script(_) => {
                Failure::of(&self.cause).report()
            }
        }
    }
}

/// Why a group aborted.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Reason {
    /// The member in which the failure began. None for a constant such as `fail`.
    pub member: Option<u32>,
    /// The cause of the abort.
    pub cause: Cause,
}

/// The cause of an abort.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Cause {
    /// The member's own report: see [`Failure::of_report`].
    Reported(Value),
    /// The member was activated while it was already running.
    Busy,
    /// Nobody could confirm that it stopped.
    StopUnconfirmed,
    /// A service ended, which breaks its contract.
    ServiceEnded,
    /// `fail("why")`.
    Failed(Arc<str>),
    /// No arm of a `match` has the tag of the outcome.
    NoMatch,
    /// A script of the activity gave no value.
    Script(ScriptError),
}
