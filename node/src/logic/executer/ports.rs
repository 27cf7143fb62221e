//! The values that an activity sends: the program that has its ports gets an order to send each value, and reports when
//! it has sent the value.

use serde::{Deserialize, Serialize};

/// How many values the program may have that it has not sent. While a node is away, a program keeps 256 notices for it: the
/// answers to these, and the messages that it has handed over.
const SENDING_MAX: u64 = 128;

/// The values on their way from an activity to the program that has its ports.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct PortLine {
    /// The number of the last value that was ordered to be sent, and of the last value that was sent.
    ordered: u64,
    sent: u64,
    /// Values that are not ordered yet.
    waiting: Vec<Sending>,
}

/// A value that an activity sends.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sending {
    /// Its number.
    pub number: u64,
    /// The output.
    pub port: String,
    /// The value, encoded.
    pub value: Vec<u8>,
}

impl PortLine {
    /// Notes a value to send; says whether there is room for it.
    pub(super) fn send(&mut self, port: &str, value: &[u8]) -> bool {
        if self.ordered - self.sent >= SENDING_MAX {
            return false;
        }
        self.ordered += 1;
        self.waiting.push(Sending { number: self.ordered, port: port.to_owned(), value: value.to_vec() });
        true
    }

    /// Returns the values that are to be sent now.
    pub(super) fn take(&mut self) -> Vec<Sending> {
        std::mem::take(&mut self.waiting)
    }

    /// Takes note that a value was sent.
    pub(super) fn sent(&mut self, number: u64) {
        self.sent = self.sent.max(number).min(self.ordered);
    }

    /// Takes note that the program is gone; returns how many values it had to send.
    pub(super) fn lost(&mut self) -> u64 {
        let count = self.ordered - self.sent;
        self.sent = self.ordered;
        count
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_so_many_values_are_on_their_way() {
        let mut line = PortLine::default();
        let sent = (0..200).filter(|_| line.send("say", b"x")).count();
        assert_eq!((sent, line.take().len(), line.take().len()), (128, 128, 0));
        line.sent(3);
        line.sent(1);
        assert_eq!((0..200).filter(|_| line.send("say", b"x")).count(), 3);
        assert_eq!((line.lost(), line.lost()), (128, 0));
    }
}
