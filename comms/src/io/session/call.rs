//! Calls: one request, one answer or a stream of them.
//!
//! A stream ends when its server has said everything, or is gone. The network does not always tell: a link may be lost that
//! both ends take for whole, or the server may stand still. So a server says now and then that it is still there
//! ([`Request::still_here`]), which callers do not see, and a stream without a word for too long ends with an error.

use super::Session;
use super::open::plain;
use crate::io::clock;
use crate::io::queue::{self, Receiver};
use crate::logic::port::{Policy, Pushed};
use crate::logic::time::Time;
use std::time::Duration;
use thiserror::Error;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::qos::CongestionControl;
use zenoh::query::{ConsolidationMode, Query, Queryable, Reply};

/// Marks an error reply as ours; zenoh makes error replies of its own.
const REFUSED: &str = "dca/refused";
/// Marks an answer that says only that the server is still there.
const STILL_HERE: &str = "dca/here";
/// A stream of answers lives as long as its server does; zenoh wants a limit all the same.
const STREAM_TIMEOUT: Duration = Duration::from_secs(365 * 24 * 3600);
/// Answers of a stream that have not been taken yet.
const REPLIES_MAX: usize = 1024;
/// Requests that have not been taken yet.
const REQUESTS_MAX: usize = 256;

/// Why a call has no answer.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum CallError {
    /// Nobody serves the key, or the server vanished or gave up before its first answer.
    #[error("nobody answers at `{key}`")]
    Unreachable {
        /// What was called.
        key: String,
    },
    /// No answer in time. The request may have been carried out.
    #[error("no answer from `{key}` within {within:?}")]
    Timeout {
        /// What was called.
        key: String,
        /// The time given.
        within: Duration,
    },
    /// The server of a stream has not said for so long that it is still there.
    #[error("`{key}` has said nothing for {silent:?}")]
    Silent {
        /// What was called.
        key: String,
        /// How long.
        silent: Duration,
    },
    /// The server's reason.
    #[error("{reason}")]
    Refused {
        /// For a person.
        reason: String,
    },
    /// More answers came than were taken; the stream ends here.
    #[error("answers from `{key}` came faster than they were taken")]
    Overrun {
        /// What was called.
        key: String,
    },
    /// The session is closed, or zenoh refuses.
    #[error("cannot call `{key}`: {cause}")]
    Session {
        /// What was called.
        key: String,
        /// Zenoh's words.
        cause: String,
    },
}

/// The answers to one call.
#[derive(Debug)]
pub struct Replies {
    key: String,
    within: Duration,
    silence_max: Option<Duration>,
    heard: Time,
    replies: Receiver<Reply>,
    state: Stream,
}

#[derive(Debug, PartialEq, Eq)]
enum Stream {
    Empty,
    Flowing,
    Ended,
}

/// Receives the calls to a key until it is dropped.
#[derive(Debug)]
pub struct Server {
    requests: Receiver<Request>,
    _queryable: Queryable<()>,
}

/// One call. Dropping it ends the answer.
#[derive(Debug)]
pub struct Request {
    query: Query,
}

impl Session {
    /// Calls the server of `key` and returns its first answer.
    ///
    /// # Errors
    /// See [`CallError`].
    ///
    /// # Cancellation
    /// The request may be carried out all the same.
    pub async fn call(&self, key: &str, payload: Vec<u8>, within: Duration) -> Result<Vec<u8>, CallError> {
        let mut replies = self.ask(key, payload, within)?;
        let timeout = || CallError::Timeout { key: key.to_owned(), within };
        // Zenoh ends the stream at the same moment; ours is for the case that it does not.
        let slack = within + Duration::from_millis(500);
        let first = tokio::time::timeout(slack, replies.next()).await.map_err(|_elapsed| timeout())?;
        first.unwrap_or_else(|| Err(CallError::Unreachable { key: key.to_owned() }))
    }

    /// Calls the server of `key`; the stream ends when the server has said everything, or is gone, or has not said for
    /// `silence_max` that it is still there.
    ///
    /// # Errors
    /// If the session is closed. A missing server shows in the stream.
    pub fn call_stream(&self, key: &str, payload: Vec<u8>, silence_max: Duration) -> Result<Replies, CallError> {
        let replies = self.ask(key, payload, STREAM_TIMEOUT)?;
        Ok(Replies { silence_max: Some(silence_max), ..replies })
    }

    fn ask(&self, key: &str, payload: Vec<u8>, within: Duration) -> Result<Replies, CallError> {
        let (reply_tx, replies) = queue::channel(Policy::reject(REPLIES_MAX));
        // The closure goes, and with it the sender, when the last answer is in or the server is gone.
        let asked = self
            .opened
            .session
            .get(key)
            .payload(payload)
            .consolidation(ConsolidationMode::None)
            .congestion_control(CongestionControl::Block)
            .timeout(within)
            .callback(move |reply| drop(reply_tx.push(reply)))
            .wait();
        asked.map_err(|cause| CallError::Session { key: key.to_owned(), cause: plain(&cause) })?;
        let (key, heard) = (key.to_owned(), clock::now());
        Ok(Replies { key, within, silence_max: None, heard, replies, state: Stream::Empty })
    }

    /// Serves `key`, which may be an expression such as [`crate::logic::key::rpc_any`].
    ///
    /// Of requests that wait, 256 are kept; more are refused.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn serve(&self, key: &str) -> Result<Server, CallError> {
        let (request_tx, requests) = queue::channel(Policy::reject(REQUESTS_MAX));
        let on_query = move |query| {
            if let Pushed::Rejected(request) = request_tx.push(Request { query }) {
                request.refuse("it has too many requests waiting; try again");
            }
        };
        let queryable = self.opened.session.declare_queryable(key).complete(true).callback(on_query).wait();
        let queryable = queryable.map_err(|cause| CallError::Session { key: key.to_owned(), cause: plain(&cause) })?;
        Ok(Server { requests, _queryable: queryable })
    }
}

impl Replies {
    /// Returns the next answer; none when the server has said everything or is gone. After an error there is nothing
    /// more. A server that is not there, or goes without a word, is [`CallError::Unreachable`].
    ///
    /// # Cancellation
    /// Safe.
    pub async fn next(&mut self) -> Option<Result<Vec<u8>, CallError>> {
        if self.state == Stream::Ended {
            return None;
        }
        let answer = loop {
            let reply = tokio::select! {
                // What is there counts, however late it is looked at.
                biased;
                reply = self.replies.recv() => reply,
                silent = over(self.heard, self.silence_max) => {
                    break Some(Err(CallError::Silent { key: self.key.clone(), silent }));
                }
            };
            self.heard = clock::now();
            break match reply.map(Reply::into_result) {
                Some(Ok(sample)) if *sample.encoding() == Encoding::from(STILL_HERE) => continue,
                Some(Ok(sample)) => {
                    self.state = Stream::Flowing;
                    return Some(Ok(sample.payload().to_bytes().into_owned()));
                }
                Some(Err(error)) => Some(Err(self.error(&error))),
                None if self.replies.lost() > 0 => Some(Err(CallError::Overrun { key: self.key.clone() })),
                None if self.state == Stream::Empty => Some(Err(CallError::Unreachable { key: self.key.clone() })),
                None => None,
            };
        };
        self.state = Stream::Ended;
        answer
    }

    fn error(&self, error: &zenoh::query::ReplyError) -> CallError {
        let text = String::from_utf8_lossy(&error.payload().to_bytes()).into_owned();
        if *error.encoding() == Encoding::from(REFUSED) {
            CallError::Refused { reason: text }
        } else if text == "Timeout" {
            CallError::Timeout { key: self.key.clone(), within: self.within }
        } else {
            CallError::Session { key: self.key.clone(), cause: text }
        }
    }
}

/// Waits until nothing has been heard for too long, if there is such a limit.
///
/// # Cancellation
/// Safe.
async fn over(heard: Time, silence_max: Option<Duration>) -> Duration {
    let Some(silence_max) = silence_max else { return std::future::pending().await };
    clock::sleep_until(heard + silence_max).await;
    silence_max
}

impl Server {
    /// Returns the next call; none once the session is closed.
    ///
    /// # Cancellation
    /// Safe.
    pub async fn next(&mut self) -> Option<Request> {
        self.requests.recv().await
    }
}

impl Request {
    /// Returns the key that was called.
    pub fn key(&self) -> &str {
        self.query.key_expr().as_str()
    }

    /// Returns what was sent along.
    pub fn payload(&self) -> Vec<u8> {
        self.query.payload().map(|payload| payload.to_bytes().into_owned()).unwrap_or_default()
    }

    /// Answers, once or many times. Waits when the link is congested. An asker that is gone is not an error.
    pub fn reply(&self, bytes: Vec<u8>) {
        self.send(bytes, Encoding::default());
    }

    /// Says that more may come, without an answer.
    pub fn still_here(&self) {
        self.send(Vec::new(), Encoding::from(STILL_HERE));
    }

    fn send(&self, bytes: Vec<u8>, encoding: Encoding) {
        if let Err(error) = self.query.reply(self.query.key_expr().clone(), bytes).encoding(encoding).wait() {
            tracing::debug!(key = self.key(), %error, "an answer was not sent");
        }
    }

    /// Answers with a reason for a person, and ends.
    pub fn refuse(self, reason: &str) {
        if let Err(error) = self.query.reply_err(reason).encoding(REFUSED).wait() {
            tracing::debug!(key = self.key(), %error, "a refusal was not sent");
        }
    }
}
