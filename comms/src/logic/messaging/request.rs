//! Requests and replies over queues. A reply has the marker of its request, and is sent to the queue that the request
//! names as its sender.
//!
//! Invariant: each request ends once, with its reply or with the reason why it has none.

use super::header::{Message, MessageId};
use super::queue::{Receipt, Rejected};
use crate::logic::time::Time;
use std::collections::BTreeMap;
use std::time::Duration;
use thiserror::Error;

/// How many requests of one program may be open.
pub const OPEN_MAX: usize = 1024;

/// How a request ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RequestEnd {
    /// The request has this reply.
    Reply(Message),
    /// The request has no reply, for this reason.
    Failed(RequestFailure),
}

/// Why a request has no reply.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum RequestFailure {
    /// There is no queue of that name.
    #[error("the queue does not exist")]
    Unknown,
    /// The queue has rejected the request.
    #[error("the queue has rejected the request: {0}")]
    Rejected(Rejected),
    /// No reply came in time. It is not known whether the request was received.
    #[error("no reply came in time")]
    Deadline,
    /// Too many requests are open.
    #[error("{OPEN_MAX} requests are open already")]
    TooMany,
}

/// The open requests of a program.
#[derive(Clone, Debug, Default)]
pub struct Requests {
    /// By their markers.
    open: BTreeMap<u64, Time>,
    marker: u64,
    late: u64,
}

impl Requests {
    /// Begins a request: returns the marker for its header. The request ends at `now + within` at the latest.
    ///
    /// # Errors
    /// If too many requests are open.
    pub fn begin(&mut self, now: Time, within: Duration) -> Result<u64, RequestFailure> {
        if self.open.len() >= OPEN_MAX {
            return Err(RequestFailure::TooMany);
        }
        self.marker += 1;
        self.open.insert(self.marker, now + within);
        Ok(self.marker)
    }

    /// Takes the receipt of a request; `None` means that the queue's name is unknown. Returns the end of the request,
    /// if the receipt ends it.
    pub fn received(&mut self, marker: u64, receipt: Option<Receipt>) -> Option<RequestEnd> {
        let failure = match receipt {
            Some(Receipt::Accepted) => return None,
            Some(Receipt::Rejected(rejected)) => RequestFailure::Rejected(rejected),
            None => RequestFailure::Unknown,
        };
        self.open.remove(&marker).map(|_| RequestEnd::Failed(failure))
    }

    /// Takes a message that may be a reply. Returns the marker of the request that it ends, and the end. A late or
    /// repeated reply is only counted.
    pub fn replied(&mut self, now: Time, reply: Message) -> Option<(u64, RequestEnd)> {
        let marker = reply.header.marker;
        match self.open.remove(&marker) {
            Some(until) if now < until => Some((marker, RequestEnd::Reply(reply))),
            Some(_) => {
                self.late += 1;
                Some((marker, RequestEnd::Failed(RequestFailure::Deadline)))
            }
            None => {
                self.late += 1;
                None
            }
        }
    }

    /// Returns one request whose time is over. Call this until it returns none.
    pub fn time_out(&mut self, now: Time) -> Option<(u64, RequestEnd)> {
        let marker = self.open.iter().find(|(_, until)| **until <= now).map(|(&marker, _)| marker)?;
        self.open.remove(&marker);
        Some((marker, RequestEnd::Failed(RequestFailure::Deadline)))
    }

    /// Returns the time at which the next request times out.
    pub fn deadline(&self) -> Option<Time> {
        self.open.values().min().copied()
    }

    /// Returns how many replies came too late or repeatedly.
    pub const fn late(&self) -> u64 {
        self.late
    }
}

/// Numbers the messages of a sender since its start.
#[derive(Clone, Debug)]
pub struct Numbering(MessageId);

impl Numbering {
    /// Returns the numbering for `life`, the random number that a sender draws at its start.
    pub const fn new(life: u64) -> Self {
        Self(MessageId { life, number: 0 })
    }

    /// Returns the identifier of the next message.
    pub const fn next(&mut self) -> MessageId {
        self.0.number += 1;
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::super::header::sample;
    use super::*;
    use proptest::prelude::*;

    #[derive(Clone, Debug)]
    enum Step {
        Begin(u64),
        Receive(u64, bool),
        Reply(u64),
        Wait(u64),
    }

    fn steps() -> impl Strategy<Value = Vec<Step>> {
        let step = prop_oneof![
            (1_u64..50).prop_map(Step::Begin),
            (1_u64..20, any::<bool>()).prop_map(|(marker, accepted)| Step::Receive(marker, accepted)),
            (0_u64..20).prop_map(Step::Reply),
            (0_u64..30).prop_map(Step::Wait),
        ];
        prop::collection::vec(step, 0..80)
    }

    proptest! {
        /// Compared with a list of all requests, each with the number of its ends.
        #[test]
        fn each_request_ends_once(steps in steps()) {
            let (mut requests, mut now) = (Requests::default(), Time::ZERO);
            let mut all: Vec<(u64, Time, u32)> = Vec::new();
            let end = |all: &mut Vec<(u64, Time, u32)>, marker: u64| {
                all.iter_mut().find(|(one, ..)| *one == marker).unwrap().2 += 1;
            };
            let rejected = || Some(Receipt::Rejected(Rejected::Full { capacity: 1 }));
            for step in steps {
                match step {
                    Step::Begin(ms) => {
                        let within = Duration::from_millis(ms);
                        let marker = requests.begin(now, within).unwrap();
                        all.push((marker, now + within, 0));
                    }
                    Step::Receive(marker, accepted) => {
                        let is_open = all.iter().any(|&(one, _, ends)| one == marker && ends == 0);
                        let receipt = if accepted { Some(Receipt::Accepted) } else { rejected() };
                        let ended = requests.received(marker, receipt);
                        prop_assert_eq!(ended.is_some(), is_open && !accepted);
                        if ended.is_some() {
                            end(&mut all, marker);
                        }
                    }
                    Step::Reply(marker) => {
                        let known = all.iter().find(|&&(one, _, ends)| one == marker && ends == 0).copied();
                        let mut reply = sample(9, 1, 0);
                        reply.header.marker = marker;
                        let expected = known.map(|(_, until, _)| if now < until {
                            (marker, RequestEnd::Reply(reply.clone()))
                        } else {
                            (marker, RequestEnd::Failed(RequestFailure::Deadline))
                        });
                        prop_assert_eq!(requests.replied(now, reply), expected.clone());
                        if expected.is_some() {
                            end(&mut all, marker);
                        }
                    }
                    Step::Wait(ms) => {
                        now = now + Duration::from_millis(ms);
                        while let Some((marker, ended)) = requests.time_out(now) {
                            prop_assert_eq!(ended, RequestEnd::Failed(RequestFailure::Deadline));
                            end(&mut all, marker);
                        }
                    }
                }
                prop_assert!(all.iter().all(|(.., ends)| *ends <= 1));
                let open = all.iter().filter(|(.., ends)| *ends == 0);
                prop_assert_eq!(requests.deadline(), open.map(|(_, until, _)| *until).min());
            }
        }
    }

    #[test]
    fn a_program_has_so_many_open_requests() {
        let mut requests = Requests::default();
        for _ in 0..OPEN_MAX {
            requests.begin(Time::ZERO, Duration::from_secs(1)).unwrap();
        }
        assert_eq!(requests.begin(Time::ZERO, Duration::from_secs(1)), Err(RequestFailure::TooMany));
        assert_eq!(requests.received(3, None), Some(RequestEnd::Failed(RequestFailure::Unknown)));
        assert_eq!(requests.begin(Time::ZERO, Duration::from_secs(1)), Ok(1025));
    }
}
