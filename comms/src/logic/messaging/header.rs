//! The header of a message. Queues and routers read only the header, never the data.

use serde::{Deserialize, Serialize};
use std::fmt;
use thiserror::Error;

/// The longest category, sender, recipient or type name, in bytes.
pub const NAME_SIZE_MAX: usize = 255;
/// The most bytes of data in a message.
pub const DATA_SIZE_MAX: usize = 1 << 20;

/// The header of a message. Its fields come from the paper.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Header {
    /// The context: `motion`, `speech`. Filters use it.
    pub category: String,
    /// The identifier: no two messages have the same one. A message that is sent again keeps its identifier.
    pub id: MessageId,
    /// The queue to which a reply is sent: `main/planner.Replies`. A sender without a queue gives its own name.
    pub sender: String,
    /// The queue or router to which the message was given.
    pub recipient: String,
    /// A message with a greater number goes first.
    pub priority: u8,
    /// Connects a reply with its request: both messages have the same number. 0 in all other messages.
    pub marker: u64,
}

/// The identifier of a message: its sender, and its number among the sender's messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct MessageId {
    /// A random number that the sender draws at each start.
    pub life: u64,
    /// The number of the message since that start, from 1.
    pub number: u64,
}

/// A message: its header, the type of its data, and the data.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Message {
    /// The part that queues and routers read.
    pub header: Header,
    /// The type of the data, by its name in interfaces: `Wrench`.
    pub type_name: String,
    /// The fencing number of the lock under which the message was sent, for queues in front of a resource.
    pub fence: Option<u64>,
    /// A value of that type, encoded by postcard.
    pub data: Vec<u8>,
}

/// Why no queue can send or receive a message.
#[derive(Clone, Debug, Error, PartialEq, Eq, Serialize, Deserialize)]
pub enum Malformed {
    /// A part of the header is too long.
    #[error("its {part} has {size} bytes, and {NAME_SIZE_MAX} are allowed")]
    Name {
        /// `category`, `sender`, `recipient` or `type`.
        part: String,
        /// The size of this part, in bytes.
        size: u64,
    },
    /// The data is too long.
    #[error("it has {size} bytes of data, and {size_max} are allowed")]
    Data {
        /// The size of the data, in bytes.
        size: u64,
        /// The limit.
        size_max: u64,
    },
    /// The message has the number 0, which is not valid.
    #[error("its identifier has the number 0; the first number is 1")]
    Number,
}

impl Message {
    /// Checks the limits of each part.
    ///
    /// # Errors
    /// The first part that is too long.
    pub fn check(&self) -> Result<(), Malformed> {
        let header = &self.header;
        let names = [
            ("category", &header.category),
            ("sender", &header.sender),
            ("recipient", &header.recipient),
            ("type", &self.type_name),
        ];
        for (part, name) in names {
            if name.len() > NAME_SIZE_MAX {
                return Err(Malformed::Name { part: part.to_owned(), size: count(name.len()) });
            }
        }
        if self.data.len() > DATA_SIZE_MAX {
            return Err(Malformed::Data { size: count(self.data.len()), size_max: count(DATA_SIZE_MAX) });
        }
        if header.id.number == 0 {
            return Err(Malformed::Number);
        }
        Ok(())
    }
}

impl fmt::Display for MessageId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:016x}.{}", self.life, self.number)
    }
}

/// Converts a size or a count to the type that messages use.
pub(super) fn count(size: usize) -> u64 {
    u64::try_from(size).unwrap_or(u64::MAX)
}

/// A message for tests.
#[cfg(test)]
pub(super) fn sample(life: u64, number: u64, priority: u8) -> Message {
    let header = Header {
        category: "motion".into(),
        id: MessageId { life, number },
        sender: "main/planner.Replies".into(),
        recipient: "main/robot.Commands".into(),
        priority,
        marker: 0,
    };
    Message { header, type_name: "Speed".into(), fence: None, data: vec![] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_part_has_a_limit() {
        let change = |change: fn(&mut Message)| {
            let mut message = sample(1, 1, 0);
            change(&mut message);
            message.check().map_err(|malformed| malformed.to_string())
        };
        assert_eq!(change(|_| ()), Ok(()));
        assert_eq!(change(|message| message.data = vec![0; DATA_SIZE_MAX]), Ok(()));
        assert_eq!(change(|message| message.header.category = "c".repeat(NAME_SIZE_MAX)), Ok(()));
        for (refused, why) in [
            (change(|message| message.header.category = "c".repeat(256)), "its category has 256 bytes"),
            (change(|message| message.header.sender = "c".repeat(256)), "its sender has 256 bytes"),
            (change(|message| message.header.recipient = "c".repeat(256)), "its recipient has 256 bytes"),
            (change(|message| message.type_name = "c".repeat(256)), "its type has 256 bytes"),
            (change(|message| message.data = vec![0; DATA_SIZE_MAX + 1]), "it has 1048577 bytes of data"),
            (change(|message| message.header.id.number = 0), "its identifier has the number 0"),
        ] {
            assert!(refused.as_ref().is_err_and(|text| text.starts_with(why)), "{refused:?}");
        }
    }
}
