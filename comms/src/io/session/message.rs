//! Messages from node to node, and liveliness tokens.

use super::Session;
use super::call::CallError;
use super::open::plain;
use super::proof::{self, Authenticator, Author};
use crate::io::queue::{self, Receiver};
use crate::logic::port::Policy;
use std::sync::Arc;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;
use zenoh::qos::CongestionControl;
use zenoh::sample::{Sample, SampleKind};

/// Appearances and departures that have not been taken yet.
const PRESENCES_MAX: usize = 4096;

/// A key, and the bytes that were put on it.
type Message = (String, Vec<u8>);

/// Receives messages on a key until it is dropped.
#[derive(Debug)]
pub struct Subscription {
    samples: Receiver<(Message, Option<ZBytes>)>,
    authenticator: Option<Arc<dyn Authenticator>>,
    _subscriber: Subscriber<()>,
}

/// Announces a key until it is dropped or its process ends.
#[derive(Debug)]
pub struct Token {
    _token: LivelinessToken,
}

/// Receives the keys that appear and vanish, until it is dropped.
#[derive(Debug)]
pub struct Watch {
    presences: Receiver<Presence>,
    _subscriber: Subscriber<()>,
}

/// Makes other sessions send their beats, until it is dropped.
#[derive(Debug)]
pub struct Beats {
    _subscriber: Subscriber<()>,
}

/// A change of presence.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Presence {
    /// This key was announced. It may have been announced before the watch began.
    Appeared(String),
    /// The token was withdrawn, or its process or host cannot be reached any more.
    Vanished(String),
}

impl Session {
    /// Sends to the present subscribers of `key`. The message is lost if there are none, or if the link is congested or
    /// cut. Senders repeat it if necessary.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn put(&self, key: &str, bytes: Vec<u8>) -> Result<(), CallError> {
        self.put_signed(key, bytes, false)
    }

    /// Like [`Session::put`]. In a team the message also carries the sender's credential, for receivers that do not know
    /// its key yet.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn put_shown(&self, key: &str, bytes: Vec<u8>) -> Result<(), CallError> {
        self.put_signed(key, bytes, true)
    }

    fn put_signed(&self, key: &str, bytes: Vec<u8>, shows: bool) -> Result<(), CallError> {
        let proof = proof::beside(self.authenticator.as_ref(), || proof::put(key, &bytes), shows);
        // Not sent as express: a busy machine drops some express messages, and a node repeats a message only after 200 ms.
        let put = self.opened.session.put(key, bytes).congestion_control(CongestionControl::Drop);
        let put = if let Some(proof) = proof { put.attachment(proof).wait() } else { put.wait() };
        put.map_err(|cause| session_error(key, &cause))
    }

    /// Sends a beat of this session to the sessions that use [`Session::hear_beats`]. A beat has no content, so it is not
    /// signed. While bytes are in transit, the system notices when a link is cut.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn beat(&self, key: &str) -> Result<(), CallError> {
        let put = self.opened.session.put(key, Vec::new()).congestion_control(CongestionControl::Drop);
        put.wait().map_err(|cause| session_error(key, &cause))
    }

    /// Makes other sessions send their beats on `key` until the returned value is dropped. The content of the beats is
    /// ignored.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn hear_beats(&self, key: &str) -> Result<Beats, CallError> {
        let subscriber = self.opened.session.declare_subscriber(key).callback(drop::<Sample>).wait();
        subscriber.map(|subscriber| Beats { _subscriber: subscriber }).map_err(|cause| session_error(key, &cause))
    }

    /// Receives messages on keys that match `key`. `policy` is the policy of the queue.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn subscribe(&self, key: &str, policy: Policy) -> Result<Subscription, CallError> {
        let (sample_tx, samples) = queue::channel(policy);
        let on_sample = move |sample: Sample| {
            let message = (sample.key_expr().as_str().to_owned(), sample.payload().to_bytes().into_owned());
            sample_tx.push((message, sample.attachment().cloned()));
        };
        let subscriber = self.opened.session.declare_subscriber(key).callback(on_sample).wait();
        let subscriber = subscriber.map_err(|cause| session_error(key, &cause))?;
        Ok(Subscription { samples, authenticator: self.authenticator.clone(), _subscriber: subscriber })
    }

    /// Announces `key` to all watchers.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn announce(&self, key: &str) -> Result<Token, CallError> {
        let token = self.opened.session.liveliness().declare_token(key).wait();
        token.map(|token| Token { _token: token }).map_err(|cause| session_error(key, &cause))
    }

    /// Watches the announcements of keys that match `key`, beginning with the present ones.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn watch(&self, key: &str) -> Result<Watch, CallError> {
        let (presence_tx, presences) = queue::channel(Policy::reject(PRESENCES_MAX));
        let on_change = move |sample: Sample| {
            let key = sample.key_expr().as_str().to_owned();
            presence_tx.push(match sample.kind() {
                SampleKind::Put => Presence::Appeared(key),
                SampleKind::Delete => Presence::Vanished(key),
            });
        };
        let liveliness = self.opened.session.liveliness();
        let subscriber = liveliness.declare_subscriber(key).history(true).callback(on_change).wait();
        let subscriber = subscriber.map_err(|cause| session_error(key, &cause))?;
        Ok(Watch { presences, _subscriber: subscriber })
    }
}

impl Subscription {
    /// Returns the next key and its message; none once the session is closed.
    ///
    /// # Cancellation
    /// Safe.
    pub async fn next(&mut self) -> Option<(String, Vec<u8>)> {
        self.samples.recv().await.map(|(message, _)| message)
    }

    /// Like [`Subscription::next`], and also returns the author.
    ///
    /// # Cancellation
    /// Safe.
    pub async fn next_signed(&mut self) -> Option<(String, Vec<u8>, Author)> {
        let ((key, bytes), proof) = self.samples.recv().await?;
        let author = proof::author(self.authenticator.as_ref(), proof.as_ref(), || proof::put(&key, &bytes));
        Some((key, bytes, author))
    }

    /// Returns how many samples were lost because the queue was full.
    pub fn lost(&self) -> u64 {
        self.samples.lost()
    }
}

impl Watch {
    /// Returns the next change; none once the session is closed.
    ///
    /// # Cancellation
    /// Safe.
    pub async fn next(&mut self) -> Option<Presence> {
        self.presences.recv().await
    }
}

fn session_error(key: &str, cause: &zenoh::Error) -> CallError {
    CallError::Session { key: key.to_owned(), cause: plain(cause) }
}
