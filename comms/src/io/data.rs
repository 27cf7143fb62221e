//! The data session of a controller: samples go straight from controller to controller.
//!
//! It has no discovery. A wire is a link dialled from the consumer to the producer, at an address that the node gives.
//! A link that is lost is dialled again until the session closes. Nothing here needs tokio, and nothing may be called
//! from a tokio task.

mod answers;
mod calls;
mod devices;
mod listeners;
mod object;
mod seal;
mod sealed;

use answers::Answers;
pub(crate) use listeners::Listeners;

pub use calls::{CallGate, CallWay, Caller, Signs, Visitor, call_digest};
pub use devices::{DeviceGate, Voucher};
pub use object::{AnswerWay, IncomingCall, ObjectEvent, ObjectServer, PendingCall};
pub use seal::{Cover, Opener, SealCounter, SealKey, Sealer};

use crate::io::clock::now;
use crate::io::session::{
    Identity, OpenError, Opened, Reach, Redial, Search, Settings, TunnelOptions, dialled, locator, unix_locator,
};
use crate::logic::codec;
use crate::logic::control::{Dial, Location};
use crate::logic::human::span;
use crate::logic::seal::Content;
use crate::logic::switch::{Arrival, Boundary, Sequence};
use crate::logic::time::Time;
use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::Duration;
use thiserror::Error;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::pubsub::Subscriber;
use zenoh::qos::CongestionControl;
use zenoh::query::{Query, Queryable, Reply, ReplyError};
use zenoh::sample::{Sample, SourceInfo};

/// How long [`DataSession::close`] waits. Without this limit zenoh can take 10 s when a peer has vanished.
const CLOSE_WITHIN: Duration = Duration::from_secs(1);

/// An open data session.
#[derive(Debug)]
pub struct DataSession {
    opened: Opened,
    answers: Answers,
}

/// How urgent samples are when a link is congested.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Priority {
    /// Commands and states of devices.
    Device,
    /// Samples of wires.
    Wire,
    /// Data for people, such as plots. All other data goes first.
    Background,
}

/// Why something on a data session failed.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum DataError {
    /// A program could not be reached.
    #[error("cannot reach session {session}: {reason}")]
    Dial {
        /// The session dialled.
        session: String,
        /// The reason, in zenoh's words.
        reason: String,
    },
    /// Zenoh refuses.
    #[error("cannot use `{key}`: {cause}")]
    Session {
        /// The key.
        key: String,
        /// The text of the error.
        cause: String,
    },
    /// No answer in time.
    #[error("no answer from `{key}` within {}", span(*.within))]
    Timeout {
        /// The key.
        key: String,
        /// The time given.
        within: Duration,
    },
}

/// Publishes on one key until it is dropped.
#[derive(Debug)]
pub struct Publisher {
    publisher: zenoh::pubsub::Publisher<'static>,
    listeners: Arc<Listeners>,
    /// Seals its numbered values.
    sealer: Option<Arc<Sealer>>,
}

/// Bytes to be sent; a clone is the same bytes, not a copy.
#[derive(Clone, Debug)]
pub struct Payload(ZBytes);

/// The subscription of one key. It ends when this is dropped.
#[derive(Debug)]
pub struct Subscription {
    _subscriber: Subscriber<()>,
}

/// The answering side of one key. It ends when this is dropped.
#[derive(Debug)]
pub struct Responder {
    _queryable: Queryable<()>,
}

/// A fetch whose answer has not come yet.
#[derive(Debug)]
pub struct PendingFetch {
    key: String,
    within: Duration,
    reply: Receiver<Result<Vec<u8>, ReplyError>>,
}

impl DataSession {
    /// Opens a data session that listens on the Unix socket `socket` and, with [`Reach::Lan`] or [`Reach::Team`], on
    /// one TCP port of each network interface.
    ///
    /// # Errors
    /// If the socket cannot be used.
    pub fn open(socket: &Path, reach: Reach) -> Result<Self, OpenError> {
        let (mut listen, mut tunnels) = (vec![unix_locator(socket)?], None);
        match reach {
            Reach::Host => {}
            Reach::Lan => listen.extend(dialled().into_iter().map(|address| locator(address, 0))),
            Reach::Team(identity) => {
                let listen = dialled().into_iter().map(|address| (address, 0).into()).collect();
                tunnels = Some(TunnelOptions { identity, listen, entrance: socket.to_owned() });
            }
        }
        let settings = Settings::data().listen(&listen);
        Ok(Self { opened: Opened::open(settings, Redial::Listed, Search::Off, tunnels)?, answers: Answers::default() })
    }

    /// Opens a data session that dials others, and that others cannot dial. With an identity it is in a team: it dials
    /// other hosts through tunnels, whose sockets are in a folder that only this user can enter.
    ///
    /// # Errors
    /// If zenoh refuses.
    pub fn open_observer(team: Option<(Arc<dyn Identity>, PathBuf)>) -> Result<Self, OpenError> {
        let tunnels = team.map(|(identity, folder)| {
            let (listen, entrance) = (Vec::new(), folder.join("nobody"));
            TunnelOptions { identity, listen, entrance }
        });
        Ok(Self {
            opened: Opened::open(Settings::data(), Redial::Listed, Search::Off, tunnels)?,
            answers: Answers::default(),
        })
    }

    /// Returns where others can dial this session.
    pub fn location(&self) -> Location {
        let (local, remote) =
            self.opened.locators().into_iter().partition(|locator| locator.starts_with("unixsock-stream/"));
        Location { session: self.opened.id(), local, remote, keys: Vec::new() }
    }

    /// Links to another session, and restores the link when it is lost. Waits at most `within` for the first link.
    ///
    /// # Errors
    /// If it cannot be reached in time.
    pub fn dial(&self, dial: &Dial, within: Duration) -> Result<(), DataError> {
        let dialled = self.opened.dial(&dial.session, &dial.of_session(), within);
        dialled.map_err(|reason| DataError::Dial { session: dial.session.clone(), reason })
    }

    /// Links to another session as soon as that can be reached, and restores the link when it is lost. Does not wait.
    ///
    /// # Errors
    /// If the address cannot be dialled.
    pub fn keep(&self, dial: &Dial) -> Result<(), DataError> {
        let kept = self.opened.keep(&dial.session, &dial.of_session());
        kept.map_err(|reason| DataError::Dial { session: dial.session.clone(), reason })
    }

    /// Stops dialling a session; an existing link is kept.
    pub fn forget(&self, session: &str) {
        self.opened.forget(session);
    }

    /// Prepares to publish on `key`. When a link is congested, samples are dropped; the sender does not wait.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn publisher(&self, key: &str, priority: Priority) -> Result<Publisher, DataError> {
        let is_sample = priority == Priority::Wire;
        let priority = match priority {
            Priority::Device => zenoh::qos::Priority::RealTime,
            Priority::Wire => zenoh::qos::Priority::InteractiveHigh,
            Priority::Background => zenoh::qos::Priority::Background,
        };
        let publisher = self
            .opened
            .session
            .declare_publisher(key.to_owned())
            .congestion_control(CongestionControl::Drop)
            .priority(priority)
            // Zenoh has two batches. With a separate batch for each sample, both would be full whenever the sender
            // waits for a processor: at 1 kHz, two busy cores dropped some samples a second.
            .express(!is_sample)
            .wait()
            .map_err(|cause| session_error(key, &cause))?;
        let listeners = Arc::new(Listeners::default());
        let listener = Arc::clone(&listeners);
        publisher
            .matching_listener()
            .callback(move |status| listener.set(status.matching()))
            .background()
            .wait()
            .map_err(|cause| session_error(key, &cause))?;
        // The listener reports only changes, and a subscriber may have been there before.
        if publisher.matching_status().wait().is_ok_and(|status| status.matching()) {
            listeners.set(true);
        }
        Ok(Publisher { publisher, listeners, sealer: None })
    }

    /// Calls `on_sample` with each sample put on `key`, without the boundaries between them. It runs on zenoh's
    /// threads, so it must only store the sample. A sample that arrived in pieces is already owned.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn on_sample(
        &self,
        key: &str,
        mut on_sample: impl FnMut(Cow<'_, [u8]>) + Send + Sync + 'static,
    ) -> Result<Subscription, DataError> {
        let on_sample = move |sample: Sample| {
            if sample.attachment().is_none() {
                on_sample(sample.payload().to_bytes());
            }
        };
        self.on_samples(key, on_sample)
    }

    /// Calls `on_arrival` with each value put on `key`, and with each boundary between values, under the rules of
    /// [`DataSession::on_sample`]. A numbered value comes with its number.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn on_wire(
        &self,
        key: &str,
        mut on_arrival: impl FnMut(Arrival<Cow<'_, [u8]>>, Option<Sequence>) + Send + Sync + 'static,
    ) -> Result<Subscription, DataError> {
        let on_sample = move |sample: Sample| match sample.attachment().map(|word| codec::decode(&word.to_bytes())) {
            None => on_arrival(Arrival::Value(sample.payload().to_bytes()), sequence(&sample)),
            Some(Ok(boundary)) => on_arrival(Arrival::Boundary(boundary), sequence(&sample)),
            Some(Err(error)) => {
                tracing::warn!(key = sample.key_expr().as_str(), %error, "a word between values is ignored");
            }
        };
        self.on_samples(key, on_sample)
    }

    /// Calls `on_sample` with each sample of a device that the gate lets in, under the rules of
    /// [`DataSession::on_sample`].
    ///
    /// # Errors
    /// If the session is closed.
    pub fn on_vouched(
        &self,
        key: &str,
        gate: Arc<DeviceGate>,
        mut on_sample: impl FnMut(Cow<'_, [u8]>) + Send + Sync + 'static,
    ) -> Result<Subscription, DataError> {
        self.on_samples(key, move |sample: Sample| gate.admit(&sample).into_iter().for_each(&mut on_sample))
    }

    /// Answers each fetch of `key` with the result of `answer`; if there is none, it sends no answer.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn answer(
        &self,
        key: &str,
        answer: impl Fn() -> Option<Vec<u8>> + Send + Sync + 'static,
    ) -> Result<Responder, DataError> {
        let on_query = move |query: &Query| {
            let Some(bytes) = answer() else { return };
            if let Err(error) = query.reply(query.key_expr().clone(), bytes).wait() {
                tracing::debug!(key = query.key_expr().as_str(), %error, "an answer was not sent");
            }
        };
        self.answers.serve(&self.opened.session, key, on_query)
    }

    fn on_samples(
        &self,
        key: &str,
        on_sample: impl FnMut(Sample) + Send + Sync + 'static,
    ) -> Result<Subscription, DataError> {
        let subscriber = self.opened.session.declare_subscriber(key).callback_mut(on_sample).wait();
        subscriber
            .map(|subscriber| Subscription { _subscriber: subscriber })
            .map_err(|cause| session_error(key, &cause))
    }

    /// Fetches the present value of the producer of `key`; none if the producer has no value, or cannot be reached.
    ///
    /// # Errors
    /// If the producer is there, but does not answer in time.
    pub fn fetch(&self, key: &str, within: Duration) -> Result<Option<Vec<u8>>, DataError> {
        self.ask(key, within)?.answer(now() + within)
    }

    /// Sends a query for a key without waiting. An answer that comes after `within` is not taken.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn ask(&self, key: &str, within: Duration) -> Result<PendingFetch, DataError> {
        let (reply_tx, reply) = sync_channel(1);
        // A key has one producer. If a second answer comes, the queue is full and the answer is dropped.
        let on_reply = move |reply: Reply| {
            let answer = reply.into_result().map(|sample| sample.payload().to_bytes().into_owned());
            drop(reply_tx.try_send(answer));
        };
        let asked = self.opened.session.get(key).timeout(within).callback(on_reply).wait();
        asked.map_err(|cause| session_error(key, &cause))?;
        Ok(PendingFetch { key: key.to_owned(), within, reply })
    }

    /// Closes the session, in at most 1 s.
    pub fn close(self) {
        let (closed_tx, closed) = sync_channel(1);
        let closing = move || {
            self.opened.close();
            closed_tx.send(()).unwrap_or_default();
        };
        match std::thread::Builder::new().name("dca-close".to_owned()).spawn(closing) {
            Ok(_) if closed.recv_timeout(CLOSE_WITHIN).is_err() => tracing::debug!("the session is still closing"),
            Ok(_) => {}
            Err(error) => tracing::debug!(%error, "no thread to close the session on"),
        }
    }
}

impl PendingFetch {
    /// Waits for the answer; none if no session answers for the key. An answer that has already arrived is taken even
    /// after `until`.
    ///
    /// # Errors
    /// If a session is there, but does not answer before `until`.
    pub fn answer(self, until: Time) -> Result<Option<Vec<u8>>, DataError> {
        self.answer_by(until).unwrap_or_else(|| Err(self.timeout()))
    }

    /// Waits as [`Self::answer`] does; none if the answer may still come.
    pub fn answer_by(&self, until: Time) -> Option<Result<Option<Vec<u8>>, DataError>> {
        match self.reply.recv_timeout(until.since(now())) {
            Ok(Ok(bytes)) => Some(Ok(Some(bytes))),
            Ok(Err(_)) => Some(Err(self.timeout())),
            Err(RecvTimeoutError::Disconnected) => Some(Ok(None)),
            Err(RecvTimeoutError::Timeout) => None,
        }
    }

    fn timeout(&self) -> DataError {
        DataError::Timeout { key: self.key.clone(), within: self.within }
    }
}

impl Publisher {
    /// Sends a sample to the present subscribers.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn put(&self, payload: impl Into<Payload>) -> Result<(), DataError> {
        self.publisher
            .put(payload.into().0)
            .wait()
            .map_err(|cause| session_error(self.publisher.key_expr().as_str(), &cause))
    }

    /// Sends a value with its sequence number to the present subscribers.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn put_numbered(&self, payload: impl Into<Payload>, number: u32) -> Result<(), DataError> {
        if let Some(sealer) = &self.sealer {
            return self.put_sealed(sealer, Content::Value, &payload.into().0, number);
        }
        self.publisher
            .put(payload.into().0)
            .source_info(self.source_info(number))
            .wait()
            .map_err(|cause| session_error(self.publisher.key_expr().as_str(), &cause))
    }

    fn source_info(&self, number: u32) -> SourceInfo {
        SourceInfo::new(self.publisher.id(), number)
    }

    /// Sends a boundary between values, with the number of the previous value.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn mark(&self, boundary: &Boundary, number: u32) -> Result<(), DataError> {
        let failed = |cause: String| DataError::Session { key: self.publisher.key_expr().to_string(), cause };
        let word = codec::encode(boundary).map_err(|error| failed(error.to_string()))?;
        if let Some(sealer) = &self.sealer {
            return self.put_sealed(sealer, Content::Boundary, &word.into(), number);
        }
        let put = self.publisher.put(ZBytes::new()).attachment(word).source_info(self.source_info(number)).wait();
        put.map_err(|cause| failed(crate::io::session::plain(&cause)))
    }

    /// Returns whether there is a subscriber.
    pub fn is_heard(&self) -> bool {
        self.listeners.is_any()
    }

    /// Returns whether there is a subscriber over zenoh: a consumer on another host, or a person.
    pub fn is_heard_over_zenoh(&self) -> bool {
        self.listeners.is_zenoh()
    }

    /// Waits for a subscriber. Returns whether one came within the given time.
    pub fn wait_heard(&self, within: Duration) -> bool {
        self.listeners.wait(within)
    }

    /// Calls `on_arrival` whenever a subscriber comes, on a thread that must not wait. Only the first call has an effect.
    pub fn on_arrival(&self, on_arrival: impl Fn() + Send + Sync + 'static) {
        self.listeners.on_arrival(on_arrival);
    }

    /// Returns the present subscribers; the value is updated when they change.
    pub(crate) fn listeners(&self) -> Arc<Listeners> {
        Arc::clone(&self.listeners)
    }
}

impl From<Vec<u8>> for Payload {
    fn from(bytes: Vec<u8>) -> Self {
        Self(bytes.into())
    }
}

fn sequence(sample: &Sample) -> Option<Sequence> {
    let source = sample.source_info()?;
    let id = source.source_id();
    Some(Sequence { publisher: (u128::from_le_bytes(id.zid().to_le_bytes()), id.eid()), number: source.source_sn() })
}

fn session_error(key: &str, cause: &zenoh::Error) -> DataError {
    DataError::Session { key: key.to_owned(), cause: crate::io::session::plain(cause) }
}
