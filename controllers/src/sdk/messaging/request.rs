//! Requests over queues: a question goes to one queue and its answer to another. A marker links the two.

use super::queue::{Label, Queue, QueueClient, SendEnd, Taken};
use super::{Full, Header, QueueMessage, QueueStatus, Receipt, Rejected};
use crate::sdk::calls::Calls;
use crate::sdk::port::Message;
use comms::logic::messaging::request::{OPEN_MAX, RequestEnd, Requests};
use comms::logic::object::ObjectError;
use comms::logic::time::Time;
use std::collections::{BTreeMap, VecDeque};
use std::io;
use std::time::Duration;
use thiserror::Error;

/// Why a request has no answer.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum RequestFailure {
    /// The queue has rejected the request: it was not carried out.
    #[error("the queue has rejected the request: {0}")]
    Rejected(Rejected),
    /// No queue is available: the request was not carried out.
    #[error("there is no queue: {0}")]
    Unknown(ObjectError),
    /// The program of the queue was gone at each attempt: it is unknown whether the request was received.
    #[error("the program of the queue is gone")]
    Gone,
    /// The time limit has passed. It is unknown whether the request was carried out.
    #[error("no answer came in time")]
    Deadline,
    /// Too many requests are open, or this one is too long: the request was not sent.
    #[error("the request was not sent: {0}")]
    NotSent(String),
}

/// How a request ended: with its answer, or with the reason why there is none.
pub type Answered<R> = Result<Taken<R>, RequestFailure>;

/// Sends requests to another process's queue, and takes the answers in its own queue. It is a field of a controller,
/// together with `#[calls("Questions")] questions: Calls<QueueMessage, Receipt>`. The answers come through a procedure
/// that the controller exports: `exports.procedure("Answers", "...", |robot: &mut Robot, message|
/// Ok(robot.planner.receive(message)))`.
///
/// Each request ends once. If a request has no receipt, it is sent again with the same identifier, so it is taken only
/// once.
#[derive(Debug)]
pub struct Requester<Q, R> {
    client: QueueClient<Q>,
    open: Requests,
    /// By the number of a message, the marker of its request.
    markers: BTreeMap<u64, u64>,
    answers: Queue<R>,
    ends: VecDeque<(u64, Answered<R>)>,
}

impl<Q: Message, R: Message> Requester<Q, R> {
    /// Returns a requester that has not asked anything. Answers go to `instance`, the path of this process
    /// ([`crate::sdk::Arguments::instance`]). The queue of answers has room for as many answers as there may be
    /// requests.
    ///
    /// # Errors
    /// If the system gives no random number for the requester.
    pub fn new(instance: &str) -> io::Result<Self> {
        let client = QueueClient::new(instance)?;
        let answers = Queue::new(OPEN_MAX, Full::Reject);
        Ok(Self { client, open: Requests::default(), markers: BTreeMap::new(), answers, ends: VecDeque::new() })
    }

    /// Sends a question with the next [`Requester::work`]; returns the marker of the request, with which its end is
    /// reported.
    ///
    /// # Errors
    /// If too many requests are open or in transit, or the question is too long.
    pub fn ask(
        &mut self,
        now: Time,
        category: &str,
        priority: u8,
        question: &Q,
        within: Duration,
    ) -> Result<u64, RequestFailure> {
        let not_sent = |why: String| RequestFailure::NotSent(why);
        let marker = self.open.begin(now, within).map_err(|why| not_sent(why.to_string()))?;
        match self.client.send(now, Label { category, priority, marker }, question, None, within) {
            Ok(number) => {
                self.markers.insert(number, marker);
                Ok(marker)
            }
            Err(why) => {
                // The request has not begun, so its end is not reported.
                self.open.received(marker, None);
                Err(not_sent(why))
            }
        }
    }

    /// Receives an answer: the procedure that this process exports.
    pub fn receive(&mut self, message: QueueMessage) -> Receipt {
        self.answers.receive(message)
    }

    /// Sends the requests that are due, and takes answers. Called once in each calculation.
    pub fn work(&mut self, now: Time, calls: &mut Calls<QueueMessage, Receipt>) {
        self.client.work(now, calls);
        while let Some((number, end)) = self.client.end_of() {
            let Some(marker) = self.markers.remove(&number) else { continue };
            let failure = match end {
                // Its answer, or its time limit, ends the request.
                SendEnd::Accepted | SendEnd::Deadline => continue,
                SendEnd::Rejected(rejected) => RequestFailure::Rejected(rejected),
                SendEnd::Unknown(error) => RequestFailure::Unknown(error),
                SendEnd::Gone => RequestFailure::Gone,
            };
            // An answer that has already arrived says more than this result.
            if self.open.received(marker, None).is_some() {
                self.ends.push_back((marker, Err(failure)));
            }
        }
        while let Some(taken) = self.answers.take(now) {
            let header = taken.header.clone();
            let reply = QueueMessage { header, type_name: String::new(), fence: None, data: Vec::new() };
            match self.open.replied(now, reply) {
                Some((marker, RequestEnd::Reply(_))) => self.ends.push_back((marker, Ok(taken))),
                Some((marker, RequestEnd::Failed(_))) => self.ends.push_back((marker, Err(RequestFailure::Deadline))),
                // The answer arrived too late, or twice.
                None => {}
            }
        }
        while let Some((marker, _)) = self.open.time_out(now) {
            self.ends.push_back((marker, Err(RequestFailure::Deadline)));
        }
    }

    /// Returns how a request ended, with its marker. Callers repeat this until it returns none.
    pub fn end_of(&mut self) -> Option<(u64, Answered<R>)> {
        self.ends.pop_front()
    }

    /// Returns how many answers arrived too late, or twice.
    pub const fn late(&self) -> u64 {
        self.open.late()
    }

    /// Returns the status of the queue of answers for people.
    pub fn status(&self) -> QueueStatus {
        self.answers.status()
    }
}

/// Sends answers to the senders of requests, together with a field `#[calls("Answers")] answers: Calls<QueueMessage,
/// Receipt>`. The spec connects this field with the queue of answers of each sender.
#[derive(Debug)]
pub struct Replier<R> {
    client: QueueClient<R>,
}

impl<R: Message> Replier<R> {
    /// Returns a replier that has not answered anything. `instance` is the path of this process.
    ///
    /// # Errors
    /// If the system gives no random number for the replier.
    pub fn new(instance: &str) -> io::Result<Self> {
        Ok(Self { client: QueueClient::new(instance)? })
    }

    /// Answers a request with the next [`Replier::work`]; returns the number of the answer. `to` is the header of the request.
    ///
    /// # Errors
    /// If too many answers are in transit, or the answer is too long.
    pub fn reply(&mut self, now: Time, to: &Header, answer: &R, within: Duration) -> Result<u64, String> {
        let label = Label { category: &to.category, priority: to.priority, marker: to.marker };
        self.client.send_to(now, label, &to.sender, answer, within)
    }

    /// Sends the answers that are due, and takes receipts. Called once in each calculation.
    pub fn work(&mut self, now: Time, calls: &mut Calls<QueueMessage, Receipt>) {
        self.client.work(now, calls);
    }

    /// Returns how the sending of an answer ended, with its number. Callers repeat this until it returns none.
    /// [`SendEnd::Unknown`] with [`ObjectError::NotConnected`] means that the spec does not connect the caller.
    pub fn end_of(&mut self) -> Option<(u64, SendEnd)> {
        self.client.end_of()
    }
}

#[cfg(test)]
mod tests;
