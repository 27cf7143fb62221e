//! Calls: one request, one answer or a stream of them.
//!
//! A stream ends with a mark: how many answers it has, and their digest ([`Request::finish`]). A stream that ends in any
//! other way is broken, and its caller gets an error: what has come may be a part. The network does not always tell: a link
//! may be lost that both ends take for whole, or the server may stand still. So a server says now and then that it is still
//! there ([`Request::still_here`]), which callers do not see, and a stream without a word for too long ends with an error.

use super::Session;
use super::open::plain;
use super::tally::Tally;
use crate::io::clock;
use crate::io::queue::{self, Receiver, Sender};
use crate::logic::human::span;
use crate::logic::port::{Policy, Pushed};
use crate::logic::time::Time;
use std::fmt;
use std::pin::pin;
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::task::{Context, Waker};
use std::time::Duration;
use thiserror::Error;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::cancellation::CancellationToken;
use zenoh::qos::CongestionControl;
use zenoh::query::{ConsolidationMode, Query, Queryable, Reply};

/// Marks an error reply as ours; zenoh makes error replies of its own.
const REFUSED: &str = "dca/refused";
/// Marks an answer that says only that the server is still there.
const STILL_HERE: &str = "dca/here";
/// Marks the end of a stream that is complete.
const END: &str = "dca/end";
/// Marks an error reply that ends a stream before it is complete.
const BROKEN: &str = "dca/broken";
/// A stream of answers lives as long as its server does, and as somebody takes them ([`Query`]); zenoh wants a limit all the
/// same.
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
    #[error("no answer from `{key}` within {}", span(*.within))]
    Timeout {
        /// What was called.
        key: String,
        /// The time given.
        within: Duration,
    },
    /// The server of a stream has not said for so long that it is still there.
    #[error("`{key}` has said nothing for {}", span(*.silent))]
    Silent {
        /// What was called.
        key: String,
        /// How long.
        silent: Duration,
    },
    /// The stream has ended without its mark, or its answers are not those that the mark counts.
    #[error("the answers from `{key}` broke off after {count}: {why}")]
    Broken {
        /// What was called.
        key: String,
        /// How many answers came.
        count: u64,
        /// For a person.
        why: String,
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

/// What a question is answered into, until it is answered in full, given up or closed.
type Sink = Mutex<Option<Sender<Reply>>>;

/// A question in zenoh, which would stay open for as long as its server does. Dropped, it is closed.
struct Open {
    token: CancellationToken,
    /// Zenoh holds this for as long as it may answer.
    sink: Weak<Sink>,
}

impl Open {
    fn is_open(&self) -> bool {
        self.sink.strong_count() > 0
    }

    fn close(&self) {
        if self.is_open() {
            // The first poll does it; what would be waited for is a callback that runs at this moment.
            let closing = pin!(self.token.cancel().into_future());
            drop(closing.poll(&mut Context::from_waker(Waker::noop())));
        }
    }
}

impl Drop for Open {
    fn drop(&mut self) {
        self.close();
    }
}

impl fmt::Debug for Open {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Open").field("is_open", &self.is_open()).finish_non_exhaustive()
    }
}

/// The answers to one call. Dropped, nothing more is asked for.
#[derive(Debug)]
pub struct Replies {
    key: String,
    within: Duration,
    silence_max: Option<Duration>,
    heard: Time,
    replies: Receiver<Reply>,
    tally: Tally,
    state: Stream,
    open: Open,
}

#[derive(Debug, PartialEq, Eq)]
enum Stream {
    /// Nothing has come.
    Silent,
    /// The server has said something.
    Flowing,
    Ended,
}

/// Receives the calls to a key until it is dropped.
#[derive(Debug)]
pub struct Server {
    requests: Receiver<Request>,
    _queryable: Queryable<()>,
}

/// One call. Whoever asked for one answer has it with the first; a stream is complete only with [`Request::finish`], and
/// broken if the request is dropped before.
#[derive(Debug)]
pub struct Request {
    query: Query,
    tally: Tally,
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

    /// Calls the server of `key`; the stream ends when the server has said everything, and with an error if the server is
    /// gone, or has not said for `silence_max` that it is still there.
    ///
    /// # Errors
    /// If the session is closed. A missing server shows in the stream.
    pub fn call_stream(&self, key: &str, payload: Vec<u8>, silence_max: Duration) -> Result<Replies, CallError> {
        let mut replies = self.ask(key, payload, STREAM_TIMEOUT)?;
        replies.silence_max = Some(silence_max);
        Ok(replies)
    }

    fn ask(&self, key: &str, payload: Vec<u8>, within: Duration) -> Result<Replies, CallError> {
        let (reply_tx, replies) = queue::channel(Policy::reject(REPLIES_MAX));
        // The closure goes, and with it the sender, when the last answer is in or the server is gone. After an answer that
        // found no room nothing is taken any more: there would be a hole.
        let sink: Arc<Sink> = Arc::new(Mutex::new(Some(reply_tx)));
        let open = Open { token: CancellationToken::default(), sink: Arc::downgrade(&sink) };
        let take = move |reply| {
            let mut sink = sink.lock().unwrap_or_else(PoisonError::into_inner);
            let rejected = sink.as_ref().is_some_and(|sink| matches!(sink.push(reply), Pushed::Rejected(_)));
            sink.take_if(|_| rejected);
        };
        let asked = self
            .opened
            .session
            .get(key)
            .payload(payload)
            .consolidation(ConsolidationMode::None)
            .congestion_control(CongestionControl::Block)
            .timeout(within)
            .cancellation_token(open.token.clone())
            .callback(take)
            .wait();
        asked.map_err(|cause| CallError::Session { key: key.to_owned(), cause: plain(&cause) })?;
        let (key, heard) = (key.to_owned(), clock::now());
        let (tally, state) = (Tally::default(), Stream::Silent);
        Ok(Replies { key, within, silence_max: None, heard, replies, tally, state, open })
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
            if let Pushed::Rejected(request) = request_tx.push(Request { query, tally: Tally::default() }) {
                request.refuse("it has too many requests waiting; try again");
            }
        };
        let queryable = self.opened.session.declare_queryable(key).complete(true).callback(on_query).wait();
        let queryable = queryable.map_err(|cause| CallError::Session { key: key.to_owned(), cause: plain(&cause) })?;
        Ok(Server { requests, _queryable: queryable })
    }
}

impl Replies {
    /// Returns the next answer; none when the server has said everything. After an error there is nothing more. A server
    /// that is not there, or goes without a word, is [`CallError::Unreachable`]; one that goes after its first word, or
    /// some of whose answers are missing, is [`CallError::Broken`].
    ///
    /// # Cancellation
    /// Safe.
    pub async fn next(&mut self) -> Option<Result<Vec<u8>, CallError>> {
        if self.state == Stream::Ended {
            return None;
        }
        let end = loop {
            let reply = tokio::select! {
                // What is there counts, however late it is looked at.
                biased;
                reply = self.replies.recv() => reply,
                silent = over(self.heard, self.silence_max) => {
                    break Some(CallError::Silent { key: self.key.clone(), silent });
                }
            };
            self.heard = clock::now();
            let key = || self.key.clone();
            let sample = match reply.map(Reply::into_result) {
                Some(Ok(sample)) => sample,
                Some(Err(error)) => break Some(self.error(&error)),
                None if self.replies.lost() > 0 => break Some(CallError::Overrun { key: key() }),
                None if self.state == Stream::Silent => break Some(CallError::Unreachable { key: key() }),
                None => break Some(self.broken("it went away in the middle")),
            };
            self.state = Stream::Flowing;
            let payload = sample.payload().to_bytes();
            if *sample.encoding() == Encoding::from(END) {
                let whole = *payload == self.tally.mark();
                break (!whole).then(|| self.broken("some of them are missing"));
            }
            if *sample.encoding() != Encoding::from(STILL_HERE) {
                self.tally.add(&payload);
                return Some(Ok(payload.into_owned()));
            }
        };
        self.state = Stream::Ended;
        // After an error the server may go on for as long as it likes.
        self.open.close();
        end.map(Err)
    }

    fn broken(&self, why: &str) -> CallError {
        CallError::Broken { key: self.key.clone(), count: self.tally.count(), why: why.to_owned() }
    }

    fn error(&self, error: &zenoh::query::ReplyError) -> CallError {
        let text = String::from_utf8_lossy(&error.payload().to_bytes()).into_owned();
        if *error.encoding() == Encoding::from(REFUSED) {
            CallError::Refused { reason: text }
        } else if *error.encoding() == Encoding::from(BROKEN) {
            self.broken(&text)
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
    pub fn reply(&mut self, bytes: Vec<u8>) {
        self.tally.add(&bytes);
        self.send(bytes, Encoding::default());
    }

    /// Says that more may come, without an answer.
    pub fn still_here(&self) {
        self.send(Vec::new(), Encoding::from(STILL_HERE));
    }

    /// Says that this was everything.
    pub fn finish(self) {
        self.send(self.tally.mark().to_vec(), Encoding::from(END));
    }

    /// Says that this was not everything, and why, for a person.
    pub fn break_off(self, why: &str) {
        self.refuse_as(BROKEN, why);
    }

    fn send(&self, bytes: Vec<u8>, encoding: Encoding) {
        if let Err(error) = self.query.reply(self.query.key_expr().clone(), bytes).encoding(encoding).wait() {
            tracing::debug!(key = self.key(), %error, "an answer was not sent");
        }
    }

    /// Answers with a reason for a person, and ends.
    pub fn refuse(self, reason: &str) {
        self.refuse_as(REFUSED, reason);
    }

    fn refuse_as(&self, encoding: &'static str, reason: &str) {
        if let Err(error) = self.query.reply_err(reason).encoding(encoding).wait() {
            tracing::debug!(key = self.key(), %error, "a refusal was not sent");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::session::{NodeOptions, Reach};
    use crate::logic::key::{self, HostName};

    #[tokio::test(flavor = "multi_thread")]
    async fn a_question_is_closed_when_its_answers_end_or_nobody_takes_them() {
        let folder = std::env::temp_dir().join(format!("dca-call-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let name = HostName::parse("c1").unwrap();
        let options = NodeOptions { name, socket: folder.join("s"), reach: Reach::Host, port: 0, peers: Vec::new() };
        let session = Session::open_node(options).await.unwrap();
        let mut server = session.serve(&key::rpc_any("c1")).unwrap();
        let long = Duration::from_secs(60);
        let ask = || session.call_stream(&key::rpc("c1", "many"), Vec::new(), long).unwrap();
        // More answers than are taken.
        let mut replies = ask();
        let mut request = server.next().await.unwrap();
        (0..2 * REPLIES_MAX).for_each(|_| request.reply(Vec::new()));
        let end = loop {
            match replies.next().await {
                Some(Ok(_)) => assert!(replies.open.is_open(), "zenoh may answer"),
                end => break end,
            }
        };
        assert!(matches!(end, Some(Err(CallError::Overrun { .. }))), "{end:?}");
        assert!(!replies.open.is_open(), "the server goes on, and is not heard");
        // Nobody takes the answers of a server that has not ended.
        let replies = ask();
        let other = server.next().await.unwrap();
        let sink = replies.open.sink.clone();
        drop(replies);
        assert_eq!(sink.strong_count(), 0);
        drop((request, other, server));
        session.close().await;
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
