//! Calls that wait for an answer: calls of a mission to a server of ROS 2, and calls of clients of ROS 2 to a procedure.

use comms::logic::object::ObjectError;
use std::collections::{BTreeMap, VecDeque};
use thiserror::Error;

/// The largest number of waiting calls of one service.
pub(crate) const WAITING_MAX: usize = 64;

/// Why a call to a server of ROS 2 has no result.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub(crate) enum Failure {
    /// The call was not sent to any server.
    #[error("no node of ROS 2 answers the service `{0}`")]
    NoServer(String),
    /// The server or the link to it is gone, or the server has dropped the call.
    #[error("the service `{0}` of ROS 2 was called, but its server has ended or has dropped the call")]
    Gone(String),
    /// The call or its answer is not valid, or the server refuses it.
    #[error("{0}")]
    Refused(String),
    /// Too many calls wait.
    #[error("{WAITING_MAX} calls of the service are waiting already")]
    Busy,
}

impl From<Failure> for ObjectError {
    fn from(failure: Failure) -> Self {
        match failure {
            Failure::Gone(_) => Self::Unanswered { reason: failure.to_string() },
            Failure::Busy => Self::Busy { waiting: u32::try_from(WAITING_MAX).unwrap_or(u32::MAX) },
            Failure::NoServer(_) | Failure::Refused(_) => Self::Refused { reason: failure.to_string() },
        }
    }
}

impl Failure {
    /// Returns the error of a call to a node. Without a server the call is unanswered, because only the node itself can refuse it.
    pub(crate) fn of_node(self) -> ObjectError {
        match self {
            Self::NoServer(_) => ObjectError::Unanswered { reason: self.to_string() },
            Self::Gone(_) | Self::Refused(_) | Self::Busy => self.into(),
        }
    }
}

/// The result of an attempt to remove a call.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Taken<T> {
    /// The call.
    Call(T),
    /// The call stays, and waits for another answer.
    Waits,
    /// The call has its answer, or its caller no longer waits.
    Over,
}

/// Calls that wait for an answer, by number.
#[derive(Debug)]
pub(crate) struct Replies<T> {
    last: u64,
    waiting: BTreeMap<u64, T>,
}

impl<T> Default for Replies<T> {
    fn default() -> Self {
        Self { last: 0, waiting: BTreeMap::new() }
    }
}

impl<T> Replies<T> {
    /// Adds a call; returns its number.
    ///
    /// # Errors
    /// If too many calls wait; the call is returned.
    pub(crate) fn add(&mut self, call: T) -> Result<u64, T> {
        if self.waiting.len() >= WAITING_MAX {
            return Err(call);
        }
        self.last += 1;
        self.waiting.insert(self.last, call);
        Ok(self.last)
    }

    /// Removes a call; returns none if the call has its answer, or its caller no longer waits.
    pub(crate) fn take(&mut self, number: u64) -> Option<T> {
        self.waiting.remove(&number)
    }

    /// Removes a call, unless it waits for another answer.
    pub(crate) fn take_unless(&mut self, number: u64, waits: impl Fn(&T) -> bool) -> Taken<T> {
        if self.waiting.get(&number).is_some_and(waits) {
            return Taken::Waits;
        }
        self.take(number).map_or(Taken::Over, Taken::Call)
    }

    /// Removes the calls whose callers no longer wait; returns the number of these calls.
    pub(crate) fn forget(&mut self, is_wanted: impl Fn(&T) -> bool) -> u64 {
        let before = self.waiting.len();
        self.waiting.retain(|_, call| is_wanted(call));
        u64::try_from(before - self.waiting.len()).unwrap_or(u64::MAX)
    }
}

/// Requests of clients of ROS 2. Some wait for the loop, others for the procedure.
#[derive(Debug)]
pub(crate) struct Requests<T> {
    new: VecDeque<(u64, Vec<u8>)>,
    replies: Replies<T>,
}

impl<T> Default for Requests<T> {
    fn default() -> Self {
        Self { new: VecDeque::new(), replies: Replies::default() }
    }
}

impl<T> Requests<T> {
    /// Adds a request with its argument.
    ///
    /// # Errors
    /// If too many requests wait; the request is returned.
    pub(crate) fn add(&mut self, request: T, argument: Vec<u8>) -> Result<(), T> {
        let number = self.replies.add(request)?;
        self.new.push_back((number, argument));
        Ok(())
    }

    /// Returns the next request for the procedure.
    pub(crate) fn next(&mut self) -> Option<(u64, Vec<u8>)> {
        self.new.pop_front()
    }

    /// Removes a request that has its answer.
    pub(crate) fn take(&mut self, number: u64) -> Option<T> {
        self.replies.take(number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limited_number_of_calls_waits() {
        let mut replies = Replies::default();
        for number in 1..=WAITING_MAX {
            assert_eq!(replies.add(number), Ok(number as u64));
        }
        assert_eq!(replies.add(0), Err(0));
        assert_eq!((replies.take(7), replies.take(7)), (Some(7), None));
        assert_eq!(replies.add(65), Ok(65), "a number is used once");
        assert_eq!(replies.take_unless(65, |call| *call == 65), Taken::Waits);
        assert_eq!(replies.take_unless(7, |call| *call == 65), Taken::Over);
        assert_eq!(replies.forget(|call| *call > 60), 59);
        assert_eq!((replies.take(60), replies.take(61)), (None, Some(61)));
        assert_eq!(replies.take_unless(62, |call| *call == 65), Taken::Call(62));
    }

    #[test]
    fn requests_come_in_their_order_and_are_answered_in_any() {
        let mut requests = Requests::default();
        for letter in ['a', 'b'] {
            requests.add(letter, vec![letter as u8]).unwrap();
        }
        let (first, second) = (requests.next().unwrap(), requests.next().unwrap());
        assert_eq!((first.1, second.1, requests.next()), (vec![b'a'], vec![b'b'], None));
        assert_eq!((requests.take(second.0), requests.take(first.0)), (Some('b'), Some('a')));
    }
}
