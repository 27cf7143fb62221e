//! Calls from program to program, over the links of a data session. [`crate::logic::object`] defines their meaning.
//!
//! Only [`DataSession::call_and_wait`] waits for an answer; otherwise zenoh passes the answer to a callback on one of
//! its threads. Sending may wait for a congested link, so control loops neither call nor answer themselves: answers
//! are sent on separate threads, and a calling program has a thread for its calls.

use super::calls::{CallGate, CallWay, Outgoing as Prepared, Sender};
use super::seal::Sealed;
use super::{DataError, DataSession, Sealer, session_error};
use crate::io::clock::now;
use crate::logic::codec::{self, CodecError};
use crate::logic::key::ObjectKeys;
use crate::logic::object::{CallId, ObjectAnswer, ObjectCall, ObjectCancel, ObjectError};
use crate::logic::seal::Content;
use crate::logic::time::Time;
use std::fmt;
use std::pin::pin;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Waker};
use std::time::Duration;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::cancellation::CancellationToken;
use zenoh::pubsub::Subscriber;
use zenoh::qos::{CongestionControl, Priority};
use zenoh::query::{ConsolidationMode, Query, QueryTarget, Queryable, Reply};
use zenoh::sample::Sample;

/// The most answers that wait to be sent. A further answer is lost, and its caller gets an error.
const ANSWERS_MAX: usize = 256;
/// How many answers are sent at the same time. A caller whose link takes nothing blocks one of these threads, until its
/// link is given up.
const ANSWERING: usize = 4;
/// The error text of zenoh for an answer that did not arrive in time.
const TIMEOUT: &[u8] = b"Timeout";

/// Serves the calls of one key. The service ends when this is dropped.
#[derive(Debug)]
pub struct ObjectServer {
    _queryable: Queryable<()>,
    _cancels: Subscriber<()>,
}

/// An event of an [`ObjectServer`]. It is passed on from zenoh's threads, so it must only be stored.
#[derive(Debug)]
pub enum ObjectEvent {
    /// A call has arrived.
    Called(Box<IncomingCall>),
    /// The caller of this call no longer waits.
    Cancelled(CallId),
}

/// A call that has arrived. If it is dropped without an answer, the caller receives `Gone`.
#[derive(Debug)]
pub struct IncomingCall {
    /// The call.
    pub call: ObjectCall,
    /// The time after which the caller no longer waits, on the clock of this host.
    pub deadline: Time,
    /// Whether it comes from a command line, through a node of the team, and not from a program.
    pub is_visit: bool,
    /// The way of the answer.
    pub way: AnswerWay,
}

/// The way of one answer. Answering and dropping do not wait, as long as the queue of answers has room.
#[derive(Debug)]
pub struct AnswerWay {
    /// `None` after the answer.
    query: Option<Query>,
    answers: SyncSender<Outgoing>,
    /// In a team: the sealer of the answer for its caller, and the number of the call.
    sealer: Option<(Arc<Sealer>, u64)>,
}

/// An answer in transit with its attachment, or none: dropping a query tells its caller that no answer comes.
type Outgoing = (Query, Option<(ZBytes, Option<Vec<u8>>)>);

/// A call whose answer has not come yet. Dropping it cancels the call and tells the server.
pub struct PendingCall {
    id: CallId,
    session: zenoh::Session,
    way: CallWay,
    cancel_key: String,
    token: CancellationToken,
    sink: Arc<Sink>,
}

/// Takes the result of one call.
type Take = Box<dyn FnOnce(Result<Vec<u8>, ObjectError>) + Send>;

/// Where the one result of a call goes.
struct Sink(Mutex<Option<Take>>);

impl Sink {
    fn take(&self) -> Option<Take> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    fn is_taken(&self) -> bool {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).is_none()
    }

    fn put(&self, result: Result<Vec<u8>, ObjectError>) {
        if let Some(take) = self.take() {
            take(result);
        }
    }
}

/// Zenoh keeps this value for as long as an answer may come.
struct Awaiting {
    sink: Arc<Sink>,
    until: Time,
    within: Duration,
}

impl Drop for Awaiting {
    fn drop(&mut self) {
        let is_late = now() >= self.until;
        self.sink.put(Err(if is_late { ObjectError::Deadline { within: self.within } } else { ObjectError::Gone }));
    }
}

impl DataSession {
    /// Serves calls. With a gate, it serves only the calls that the gate lets in.
    ///
    /// # Errors
    /// If the session is closed, or no thread can be started.
    pub fn serve_calls(
        &self,
        keys: &ObjectKeys,
        gate: Option<Arc<CallGate>>,
        serve: impl Fn(ObjectEvent) + Send + Sync + 'static,
    ) -> Result<ObjectServer, DataError> {
        let ObjectKeys { call: key, cancel: cancel_key } = keys;
        let (answers, to_send) = sync_channel(ANSWERS_MAX);
        let to_send = Arc::new(Mutex::new(to_send));
        for _ in 0..ANSWERING {
            let to_send = Arc::clone(&to_send);
            let thread = std::thread::Builder::new().name("answers".to_owned()).spawn(move || send_all(&to_send));
            thread.map_err(|cause| DataError::Session { key: key.to_owned(), cause: cause.to_string() })?;
        }
        let serve = Arc::new(serve);
        let (cancelled, admits) = (Arc::clone(&serve), gate.clone());
        let on_query = move |query: Query| hear(query, admits.as_deref(), &answers, &*serve);
        let queryable = self.opened.session.declare_queryable(key).complete(true).callback(on_query).wait();
        let queryable = queryable.map_err(|cause| session_error(key, &cause))?;
        let on_cancel = move |sample: Sample| {
            let (beside, bytes) = (sample.attachment(), sample.payload());
            let admitted = admit(gate.as_deref(), Content::Cancel, beside, bytes, sample.key_expr());
            let Some((sender, bytes)) = admitted else { return };
            if let Ok(ObjectCancel { id }) = codec::decode(&bytes)
                && may_be(gate.as_deref(), sender.as_ref(), &id.session)
            {
                cancelled(ObjectEvent::Cancelled(id));
            }
        };
        let cancels = self.opened.session.declare_subscriber(cancel_key).callback(on_cancel).wait();
        let cancels = cancels.map_err(|cause| session_error(cancel_key, &cause))?;
        Ok(ObjectServer { _queryable: queryable, _cancels: cancels })
    }

    /// Calls the server of these keys. `take` gets the one result, on one of zenoh's threads, so it must not wait. The call
    /// itself may wait for a congested link.
    ///
    /// # Errors
    /// If the argument is too large, or the session is closed. The call was not sent then.
    pub fn call(
        &self,
        keys: &ObjectKeys,
        way: &CallWay,
        call: &ObjectCall,
        take: impl FnOnce(Result<Vec<u8>, ObjectError>) + Send + 'static,
    ) -> Result<PendingCall, ObjectError> {
        ObjectError::check_size(call.argument.0.len())?;
        let refused = |reason: String| ObjectError::Refused { reason };
        let bytes = codec::encode(call).map_err(|error| refused(error.to_string()))?;
        let Prepared { bytes, beside, number } = way.prepare(&keys.call, Content::Call, bytes).map_err(refused)?;
        let sink = Arc::new(Sink(Mutex::new(Some(Box::new(take)))));
        let within = call.within;
        let awaiting = Awaiting { sink: Arc::clone(&sink), until: now() + within, within };
        let theirs = way.clone();
        let on_reply = move |reply: Reply| match &theirs {
            CallWay::Open | CallWay::Signed(_) => awaiting.sink.put(result_of(&reply, within)),
            CallWay::Sealed { answer, .. } => {
                // An error has no seal, and may come from any session.
                let opened = reply
                    .result()
                    .ok()
                    .and_then(|sample| answer.open(sample.attachment(), number, sample.payload(), || None));
                if let Some((Content::Answer, bytes)) = opened {
                    awaiting.sink.put(read(&bytes));
                }
            }
        };
        let target = if matches!(way, CallWay::Sealed { .. }) { QueryTarget::All } else { QueryTarget::default() };
        let token = CancellationToken::default();
        let asking = self
            .opened
            .session
            .get(keys.call.as_str())
            .target(target)
            .payload(bytes)
            .attachment(beside)
            .consolidation(ConsolidationMode::None)
            .congestion_control(CongestionControl::Block)
            .priority(Priority::InteractiveLow)
            .express(true)
            .timeout(within)
            .cancellation_token(token.clone())
            .callback(on_reply);
        if let Err(cause) = asking.wait() {
            drop(sink.take());
            return Err(refused(crate::io::session::plain(&cause)));
        }
        let (session, cancel_key) = (self.opened.session.clone(), keys.cancel.clone());
        Ok(PendingCall { id: call.id.clone(), session, way: way.clone(), cancel_key, token, sink })
    }

    /// Calls like [`DataSession::call`], and waits for the result.
    ///
    /// # Errors
    /// The reason, if the call has no result.
    pub fn call_and_wait(&self, keys: &ObjectKeys, way: &CallWay, call: &ObjectCall) -> Result<Vec<u8>, ObjectError> {
        let (result_tx, result) = sync_channel(1);
        // The receiver is gone only if the wait below has ended.
        let take = move |result| result_tx.try_send(result).unwrap_or_default();
        let _pending = self.call(keys, way, call, take)?;
        // Zenoh ends the call in time. This limit applies if zenoh fails to do so.
        let late = ObjectError::Deadline { within: call.within };
        result.recv_timeout(call.within + Duration::from_millis(500)).map_err(|_late| late)?
    }

    /// Returns whether there is a link to a session.
    pub fn is_linked(&self, session: &str) -> bool {
        self.opened.is_linked_to(session)
    }

    /// Returns the id of this session, as in a `Dial`.
    pub fn id(&self) -> String {
        self.opened.id()
    }
}

/// Returns the message, and its sender if a gate knows the sender. None if the gate refuses the message.
fn admit(
    gate: Option<&CallGate>,
    content: Content,
    beside: Option<&ZBytes>,
    bytes: &ZBytes,
    key: &str,
) -> Option<(Option<Sender>, Vec<u8>)> {
    let Some(gate) = gate else { return Some((None, bytes.to_bytes().into_owned())) };
    gate.open(content, beside, bytes, key).map(|(sender, bytes)| (Some(sender), bytes))
}

/// Returns whether the sender of a call may name this session as its own.
fn may_be(gate: Option<&CallGate>, sender: Option<&Sender>, session: &str) -> bool {
    gate.zip(sender).is_none_or(|(gate, sender)| gate.may_be(sender, session))
}

/// Takes a caller's message. Called by zenoh.
fn hear(
    query: Query,
    gate: Option<&CallGate>,
    answers: &SyncSender<Outgoing>,
    serve: &(impl Fn(ObjectEvent) + ?Sized),
) {
    let (nothing, key) = (ZBytes::new(), query.key_expr().clone());
    let (beside, bytes) = (query.attachment(), query.payload().unwrap_or(&nothing));
    // Dropping the query tells its caller that no server answers.
    let Some((sender, bytes)) = admit(gate, Content::Call, beside, bytes, &key) else { return };
    let call = codec::decode::<ObjectCall>(&bytes);
    let is_own = |call: &ObjectCall| may_be(gate, sender.as_ref(), &call.id.session);
    let call = call.and_then(|call| if is_own(&call) { Ok(call) } else { Err(CodecError::Foreign) });
    let is_visit = matches!(sender, Some(Sender::Visitor));
    let sealer = match sender {
        Some(Sender::Caller(_, sealer, number)) => Some((sealer, number)),
        Some(Sender::Visitor) | None => None,
    };
    let way = AnswerWay { query: Some(query), answers: answers.clone(), sealer };
    match call {
        Ok(call) => {
            let deadline = now() + call.within;
            serve(ObjectEvent::Called(Box::new(IncomingCall { call, deadline, is_visit, way })));
        }
        Err(error) => way.answer(Err(ObjectError::Refused { reason: format!("the call cannot be read: {error}") })),
    }
}

fn send_all(answers: &Mutex<Receiver<Outgoing>>) {
    loop {
        let next = answers.lock().unwrap_or_else(PoisonError::into_inner).recv();
        let Ok((query, answer)) = next else { return };
        let Some((bytes, beside)) = answer else { continue };
        if let Err(error) = query.reply(query.key_expr().clone(), bytes).attachment(beside).express(true).wait() {
            tracing::debug!(key = query.key_expr().as_str(), %error, "an answer was not sent");
        }
    }
}

fn result_of(reply: &Reply, within: Duration) -> Result<Vec<u8>, ObjectError> {
    match reply.result() {
        Ok(sample) => read(&sample.payload().to_bytes()),
        Err(error) if *error.payload().to_bytes() == *TIMEOUT => Err(ObjectError::Deadline { within }),
        Err(_) => Err(ObjectError::Gone),
    }
}

fn read(answer: &[u8]) -> Result<Vec<u8>, ObjectError> {
    match codec::decode::<ObjectAnswer>(answer) {
        Ok(answer) => answer.into(),
        Err(error) => Err(ObjectError::Refused { reason: format!("the answer cannot be read: {error}") }),
    }
}

impl AnswerWay {
    /// Sends the answer.
    pub fn answer(mut self, result: Result<Vec<u8>, ObjectError>) {
        let Some(query) = self.query.take() else { return };
        let answer = codec::encode(&ObjectAnswer::from(result));
        let answer = answer.map_err(|error| tracing::warn!(%error, "an answer cannot be written")).ok();
        let answer = match self.sealer.take() {
            None => answer.map(|bytes| (bytes.into(), None)),
            // Sealed, so only the caller can read the answer. A caller without a key has ended.
            Some((sealer, number)) => answer
                .and_then(|bytes| sealer.seal(Content::Answer, number, &bytes.into()))
                .map(|Sealed { bytes, seal, .. }| (bytes, Some(seal))),
        };
        if self.answers.try_send((query, answer)).is_err() {
            tracing::warn!("an answer is lost: too many earlier answers are still waiting");
        }
    }
}

impl Drop for AnswerWay {
    fn drop(&mut self) {
        if let Some(query) = self.query.take() {
            // If the queue is full, the query is dropped here, which may wait for its link.
            self.answers.try_send((query, None)).unwrap_or_default();
        }
    }
}

impl PendingCall {
    /// Returns whether the result has come.
    pub fn is_over(&self) -> bool {
        self.sink.is_taken()
    }
}

impl Drop for PendingCall {
    fn drop(&mut self) {
        if self.sink.is_taken() {
            return;
        }
        drop(self.sink.take());
        // The first poll cancels the query. Further polls would only wait for a callback that is running now.
        let closing = pin!(self.token.cancel().into_future());
        drop(closing.poll(&mut Context::from_waker(Waker::noop())));
        let Ok(cancel) = codec::encode(&ObjectCancel { id: self.id.clone() }) else { return };
        let Ok(prepared) = self.way.prepare(&self.cancel_key, Content::Cancel, cancel) else { return };
        let told = self.session.put(&self.cancel_key, prepared.bytes).attachment(prepared.beside);
        if let Err(error) = told.congestion_control(CongestionControl::Drop).express(true).wait() {
            tracing::debug!(%error, "cannot tell the other end that its caller has left");
        }
    }
}

impl fmt::Debug for PendingCall {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("PendingCall").field("id", &self.id).finish_non_exhaustive()
    }
}
