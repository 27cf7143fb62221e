//! Calls: one request, and one answer or a stream of them.
//!
//! A caller asks for a stream piece by piece ([`super::stream`]). The stream ends with a mark: the number of its answers,
//! and their digest. A stream that ends in any other way is broken, and its caller gets an error, because the answers so
//! far may be incomplete. The network does not always show that a stream is broken: both ends may miss the loss of a link,
//! or the server may hang. So a server regularly sends that it is still there ([`super::Request::still_here`]), which
//! callers do not see. A stream that is silent for too long ends with an error.

mod error;
mod window;

pub use error::CallError;

use super::Session;
use super::expect::Expect;
use super::open::plain;
use super::proof::Author;
use super::serve::REFUSED;
use super::stream::{End, Incoming, Piece, Pull, Silence, StreamId};
use crate::io::{clock, entropy};
use crate::logic::time::Time;
use crate::logic::{codec, key};
use std::fmt;
use std::pin::pin;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::task::{Context, Waker};
use std::time::Duration;
use tokio::sync::oneshot;
use window::Window;
use zenoh::Wait;
use zenoh::bytes::Encoding;
use zenoh::cancellation::CancellationToken;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, QueryTarget, Reply, ReplyError};

/// How long a pull may wait. A server answers a pull when it has something, but zenoh requires a limit. This one is longer
/// than every silence.
///
/// Zenoh keeps half a kilobyte for each query until its limit is over, even if the query is answered. So a long limit is a
/// leak.
const PULL_TIMEOUT: Duration = Duration::from_secs(60);
/// How long zenoh keeps the query that tells a server that a stream has no reader any more.
const LEAVE_TIMEOUT: Duration = Duration::from_secs(1);

/// The sender of the answer to a question, with the time of the answer. It is taken once the question is answered, given up
/// or closed.
type Sink = Mutex<Option<oneshot::Sender<(Reply, Time)>>>;

/// A question in zenoh. Dropping this closes the question, which would otherwise stay open as long as its server runs.
struct Open {
    token: CancellationToken,
    /// Zenoh holds the sink for as long as an answer may come.
    sink: Weak<Sink>,
}

impl Open {
    fn is_open(&self) -> bool {
        self.sink.strong_count() > 0
    }

    fn close(&self) {
        if self.is_open() {
            // The first poll cancels the query. Further polls would only wait for a callback that is running now.
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

/// The outgoing calls of a session.
#[derive(Debug, Default)]
pub(super) struct Calls {
    /// How many streams were made.
    made: AtomicU64,
    /// How many streams are open.
    open: Arc<AtomicUsize>,
}

/// A question that is on its way, and its first answer.
#[derive(Debug)]
struct PendingCall {
    answer: oneshot::Receiver<(Reply, Time)>,
    at: Time,
    /// Closes the question when it is dropped.
    _open: Open,
}

/// The answers to one call. Dropping it ends the stream: no more answers are requested.
#[derive(Debug)]
pub struct Replies {
    key: String,
    /// The key of the server that is asked for the next piece. Several servers may serve one key; the stream stays with the
    /// first.
    server: String,
    session: zenoh::Session,
    stream: StreamId,
    /// In a team, the node that has to answer.
    expect: Option<Arc<Expect>>,
    silence: Silence,
    incoming: Incoming,
    window: Window,
    asked: Option<PendingCall>,
    state: Stream,
}

#[derive(Debug, PartialEq, Eq)]
enum Stream {
    /// No answer has come.
    Silent,
    /// The server has answered.
    Flowing,
    Ended,
}

impl Session {
    /// Returns the key that calls the server of `key` at the other end of this session's link. None unless the session has
    /// exactly one link, like a command line. Several servers may serve one key: two nodes of one name, for example.
    pub fn at_the_other_end(&self, key: &str) -> Option<String> {
        match &self.opened.linked_to()[..] {
            [session] => Some(key::of_session(key, session)),
            _ => None,
        }
    }

    /// Calls the server of `key` and returns its first answer.
    ///
    /// # Errors
    /// See [`CallError`].
    ///
    /// # Cancellation
    /// The request may still be carried out.
    pub async fn call(&self, key: &str, payload: Vec<u8>, within: Duration) -> Result<Vec<u8>, CallError> {
        self.call_signed(key, payload, within).await.map(|(answer, _)| answer)
    }

    /// Like [`Session::call`], and also returns the author of the answer. In a team a node signs the question.
    ///
    /// # Errors
    /// See [`CallError`].
    ///
    /// # Cancellation
    /// The request may still be carried out.
    pub async fn call_signed(
        &self,
        key: &str,
        payload: Vec<u8>,
        within: Duration,
    ) -> Result<(Vec<u8>, Author), CallError> {
        let (pull, expect) = self.one(key, &payload)?.unzip();
        let options = AskOptions { pull, expect: expect.clone() };
        let asked = ask(&self.opened.session, key, payload, options, within)?;
        let called = key::without_session(key);
        let timeout = || CallError::Timeout { key: called.to_owned(), within };
        // Zenoh gives up after `within`. This later limit applies if zenoh fails to do so.
        let slack = within + Duration::from_millis(500);
        let answer = tokio::time::timeout(slack, asked.answer).await.map_err(|_elapsed| timeout())?;
        let Ok((reply, _)) = answer else { return Err(unanswered(called, expect.as_deref())) };
        match reply.into_result() {
            Ok(sample) => {
                let author = expect.map_or(Author::Anybody, |expect| expect.author());
                Ok((sample.payload().to_bytes().into_owned(), author))
            }
            Err(error) if *error.payload().to_bytes() == *b"Timeout" => Err(timeout()),
            Err(error) => Err(refused(called, &error)),
        }
    }

    /// Prepares a question with one answer in a team: returns its attachment, and the node that has to answer.
    fn one(&self, key: &str, payload: &[u8]) -> Result<Option<(Pull, Arc<Expect>)>, CallError> {
        let Some(authenticator) = &self.authenticator else { return Ok(None) };
        let failed = |error: std::io::Error| CallError::Session { key: key.to_owned(), cause: error.to_string() };
        let nonce = entropy::bytes().map_err(failed)?;
        let expect = Expect::new(authenticator, key, &nonce, payload);
        let proof = authenticator.sign(expect.question(), true);
        Ok(Some((Pull::One { nonce, proof }, expect)))
    }

    /// Calls the server of `key`, which sends a stream of answers. The stream ends after the last
    /// answer. It ends with an error if the server vanishes, or sends no sign of life for
    /// `silence_max`. The server waits for a caller that takes no answers.
    ///
    /// # Errors
    /// If the session is closed. A missing server is an error in the stream.
    pub fn call_stream(&self, key: &str, payload: Vec<u8>, silence_max: Duration) -> Result<Replies, CallError> {
        let number = self.calls.made.fetch_add(1, Ordering::Relaxed);
        let stream = StreamId { session: self.id(), number };
        let expected = self.authenticator.as_ref();
        let expect = expected.map(|authenticator| Expect::new(authenticator, key, &stream.nonce(), &payload));
        let mut replies = Replies {
            key: key::without_session(key).to_owned(),
            server: key.to_owned(),
            session: self.opened.session.clone(),
            stream,
            expect,
            silence: Silence::begin(clock::now(), silence_max),
            incoming: Incoming::default(),
            window: Window::open(&self.calls.open),
            asked: None,
            state: Stream::Silent,
        };
        replies.pull(Some(payload))?;
        Ok(replies)
    }
}

/// The attachment of a question, and the node whose answers are accepted.
#[derive(Debug, Default)]
struct AskOptions {
    pull: Option<Pull>,
    expect: Option<Arc<Expect>>,
}

/// Returns why a question has no accepted answer.
fn unanswered(key: &str, expect: Option<&Expect>) -> CallError {
    let key = key.to_owned();
    match expect.and_then(Expect::why_not) {
        None => CallError::Unreachable { key },
        Some((true, reason)) => CallError::Refused { reason },
        Some((false, why)) => CallError::Forged { key, why },
    }
}

/// Asks the server of `key` for one answer.
fn ask(
    session: &zenoh::Session,
    key: &str,
    payload: Vec<u8>,
    AskOptions { pull, expect }: AskOptions,
    within: Duration,
) -> Result<PendingCall, CallError> {
    let failed = |cause: String| CallError::Session { key: key::without_session(key).to_owned(), cause };
    let (answer_tx, answer) = oneshot::channel();
    // Zenoh drops the closure, and with it the sender, when the answer has arrived or the server has vanished.
    let sink: Arc<Sink> = Arc::new(Mutex::new(Some(answer_tx)));
    let open = Open { token: CancellationToken::default(), sink: Arc::downgrade(&sink) };
    // Another server of the same key must not be asked instead of the intended one.
    let target = if expect.is_some() { QueryTarget::All } else { QueryTarget::default() };
    let take = move |reply| {
        if expect.as_ref().is_some_and(|expect| !expect.takes(&reply)) {
            return;
        }
        let sink = sink.lock().unwrap_or_else(PoisonError::into_inner).take();
        if let Some(sink) = sink {
            // A caller that has given up does not want the answer.
            drop(sink.send((reply, clock::now())));
        }
    };
    let mut asking = session
        .get(key)
        .payload(payload)
        .consolidation(ConsolidationMode::None)
        .congestion_control(CongestionControl::Block)
        .target(target)
        .timeout(within)
        .cancellation_token(open.token.clone());
    if let Some(pull) = pull {
        let attachment = codec::encode(&pull).map_err(|error| failed(error.to_string()))?;
        asking = asking.attachment(attachment);
        if !matches!(pull, Pull::One { .. }) {
            // Messages between nodes have priority over answers for readers.
            asking = asking.priority(Priority::DataLow);
        }
    }
    asking.callback(take).wait().map_err(|cause| failed(plain(&cause)))?;
    Ok(PendingCall { answer, at: clock::now(), _open: open })
}

/// Returns why a server gives no answer.
fn refused(key: &str, error: &ReplyError) -> CallError {
    let text = String::from_utf8_lossy(&error.payload().to_bytes()).into_owned();
    if *error.encoding() == Encoding::from(REFUSED) {
        CallError::Refused { reason: text }
    } else {
        CallError::Session { key: key.to_owned(), cause: text }
    }
}

impl Replies {
    /// Returns the next answer; none after the last answer, or after an error. [`CallError::Unreachable`]: the server is
    /// missing, or vanished before its first answer. [`CallError::Broken`]: it vanished later, or answers are missing.
    ///
    /// # Cancellation
    /// Safe.
    pub async fn next(&mut self) -> Option<Result<Vec<u8>, CallError>> {
        if self.state == Stream::Ended {
            return None;
        }
        let end = loop {
            match self.incoming.next() {
                Ok(Some(answer)) => return Some(Ok(answer)),
                Ok(None) => {}
                Err(error) => break Some(self.broken(&error.to_string())),
            }
            match self.incoming.end() {
                None => {}
                Some(End::Whole(_)) => break None,
                Some(End::Broken(why)) => break Some(self.broken(&why)),
                Some(End::Refused(reason)) => break Some(CallError::Refused { reason }),
            }
            if let Err(error) = self.more().await {
                break Some(error);
            }
        };
        self.state = Stream::Ended;
        self.asked = None;
        end.map(Err)
    }

    /// Takes the next piece, and requests the following one, so that this is in transit while the caller reads.
    async fn more(&mut self) -> Result<(), CallError> {
        let Some(asked) = &mut self.asked else { return Err(self.broken("nothing more was asked for")) };
        let answer = tokio::select! {
            // An answer that has already arrived is taken, even if it is late.
            biased;
            answer = &mut asked.answer => answer,
            () = over(&mut self.silence) => {
                return Err(CallError::Silent { key: self.key.clone(), silent: self.silence.max() });
            }
        };
        let reply = match answer {
            Ok((reply, at)) => {
                let took = at - asked.at;
                if let (Stream::Silent, Some(server)) = (&self.state, reply.replier_id()) {
                    self.server = key::of_session(&self.key, &server.zid().to_string());
                }
                reply.into_result().map(|sample| (sample, took))
            }
            Err(_) if self.state == Stream::Silent => {
                return Err(unanswered(&self.key, self.expect.as_deref()));
            }
            Err(_) => return Err(self.broken("the program or the link to it was lost during the answer")),
        };
        let (sample, took) = reply.map_err(|error| self.without_answer(&error))?;
        let piece: Piece =
            codec::decode(&sample.payload().to_bytes()).map_err(|error| self.broken(&error.to_string()))?;
        self.state = Stream::Flowing;
        if piece.was_ready {
            self.window.arrived(piece.bytes.len(), took);
        }
        let is_last = piece.end.is_some();
        self.incoming.take(piece);
        if is_last { Ok(()) } else { self.pull(None) }
    }

    /// Requests the next piece. The request for the first piece also carries the call itself.
    fn pull(&mut self, first: Option<Vec<u8>>) -> Result<(), CallError> {
        let (stream, size) = (self.stream.clone(), self.window.next());
        let pull = if first.is_some() { Pull::First { stream, size } } else { Pull::Next { stream, size } };
        let payload = first.unwrap_or_default();
        let options = AskOptions { pull: Some(pull), expect: self.expect.clone() };
        let within = PULL_TIMEOUT.max(4 * self.silence.max());
        self.asked = Some(ask(&self.session, &self.server, payload, options, within)?);
        self.silence.restart(clock::now());
        Ok(())
    }

    /// Returns the error for a server that does not answer, or not any more.
    fn without_answer(&self, error: &ReplyError) -> CallError {
        let error = refused(&self.key, error);
        match error {
            CallError::Refused { reason } if self.state == Stream::Flowing => self.broken(&reason),
            CallError::Refused { .. }
            | CallError::Unreachable { .. }
            | CallError::Timeout { .. }
            | CallError::Silent { .. }
            | CallError::Broken { .. }
            | CallError::Forged { .. }
            | CallError::Session { .. } => error,
        }
    }

    fn broken(&self, why: &str) -> CallError {
        CallError::Broken { key: self.key.clone(), count: self.incoming.count(), why: why.to_owned() }
    }
}

impl Drop for Replies {
    fn drop(&mut self) {
        if self.state == Stream::Ended && self.incoming.end().is_some() {
            return;
        }
        // The server does not have to keep answers without a reader. If this message is lost, the
        // server later drops the answers by itself.
        let Ok(leave) = codec::encode(&Pull::Leave { stream: self.stream.clone() }) else { return };
        let leaving = self.session.get(&self.server).attachment(leave).congestion_control(CongestionControl::Drop);
        if let Err(error) = leaving.timeout(LEAVE_TIMEOUT).callback(drop).wait() {
            tracing::debug!(key = self.key, %error, "cannot tell the server that its caller has left");
        }
    }
}

/// Waits until the server has been silent for too long.
///
/// # Cancellation
/// Safe.
async fn over(silence: &mut Silence) {
    while let Some(at) = silence.look(clock::now()) {
        clock::sleep_until(at).await;
    }
}
