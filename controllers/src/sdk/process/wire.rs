//! The two ends of a wire in a program: how values leave it, and how they come in.

use super::inbox::{Hold, Inbox};
use super::keyring::{Keyring, Use};
use crate::sdk::interface::{Binding, Direction, Interface, PortInterface};
use comms::io::clock::now;
use comms::io::data::{
    DataError, DataSession, DeviceGate, Opener, Payload, PendingFetch, Priority, Publisher, Responder, Sealer,
    Subscription,
};
use comms::logic::control::{Incoming, Outgoing, Shape};
use comms::logic::key;
use comms::logic::switch::{Arrival, Boundary, Flow, Sequence};
use std::borrow::Cow;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// An output's way to one consumer.
#[derive(Debug)]
pub(super) struct Wire {
    pub(super) port: &'static str,
    pub(super) flow: Flow,
    pub(super) way: Transport,
    /// Shows people what is sealed for the consumer.
    seen: Option<Publisher>,
}

impl Wire {
    /// Sends a value that has passed.
    pub(super) fn send(&self, payload: &Payload) {
        let Transport::Push(publisher) = &self.way else { return };
        put_numbered(publisher, payload.clone(), self.flow.number());
        if let Some(seen) = self.seen.as_ref().filter(|seen| seen.is_heard()) {
            put(seen, payload.clone());
        }
    }
}

#[derive(Debug)]
pub(super) enum Transport {
    Push(Publisher),
    /// The latest value, for the consumer to fetch; kept only while the wire is open.
    Pull {
        latest: Arc<Mutex<Option<Vec<u8>>>>,
        _answering: Responder,
    },
}

impl Transport {
    /// Says a word between the values of a wire that is pushed.
    pub(super) fn mark(&self, boundary: &Boundary, number: u32) {
        if let Self::Push(publisher) = self
            && let Err(error) = publisher.mark(boundary, number)
        {
            tracing::debug!(%error, "a switch was not told");
        }
    }

    /// Has this value for who fetches it.
    pub(super) fn keep(&self, value: Option<Vec<u8>>) {
        if let Self::Pull { latest, .. } = self {
            *latest.lock().unwrap_or_else(PoisonError::into_inner) = value;
        }
    }
}

/// A pull wire's other end.
#[derive(Debug)]
pub(super) struct Fetch {
    pub(super) port: &'static str,
    pub(super) key: String,
    pub(super) session: Arc<DataSession>,
    /// Opens what the producer has sealed, in a team.
    pub(super) opener: Option<Arc<Opener>>,
}

impl Fetch {
    fn ask(&self, within: Duration) -> Result<PendingFetch, DataError> {
        match &self.opener {
            None => self.session.ask(&self.key, within),
            Some(opener) => self.session.ask_sealed(&self.key, Arc::clone(opener), within),
        }
    }
}

/// Fetches the latest values of several producers at once, in their order; none for a wire that is closed, or for a producer
/// that does not answer within the time that all of them have together.
pub(super) fn fetch_all(fetches: &[Arc<Fetch>], within: Duration) -> Vec<(&'static str, Vec<u8>)> {
    let until = now() + within;
    let asked: Vec<_> = fetches.iter().map(|fetch| (fetch.port, fetch.ask(within))).collect();
    let answered = asked.into_iter().map(|(port, asked)| (port, asked.and_then(|asked| asked.answer(until))));
    answered
        .filter_map(|(port, answer)| match answer {
            Ok(bytes) => Some((port, bytes?)),
            Err(error) => {
                tracing::debug!(port, %error, "a value cannot be fetched");
                None
            }
        })
        .collect()
}

pub(super) fn subscribe(
    (session, gate): (&DataSession, Option<Arc<DeviceGate>>),
    key: &str,
    (port, hold): (&'static str, Hold),
    inbox: &Arc<Inbox>,
) -> Result<Subscription, String> {
    let inbox = Arc::clone(inbox);
    let hear = move |bytes: Cow<'_, [u8]>| inbox.sample(port, bytes.into_owned(), hold);
    let subscription = match gate {
        None => session.on_sample(key, hear),
        Some(gate) => session.on_vouched(key, gate, hear),
    };
    subscription.map_err(|error| error.to_string())
}

/// Hears a wire.
pub(super) fn hear(
    session: &DataSession,
    incoming: &Incoming,
    input: (&'static str, Hold),
    (inbox, keyring): (&Arc<Inbox>, Option<&Keyring>),
) -> Result<Subscription, String> {
    let (inbox, wire) = (Arc::clone(inbox), incoming.wire);
    let hear = move |arrival: Arrival<Cow<'_, [u8]>>, sequence: Option<Sequence>| {
        let arrival = match arrival {
            Arrival::Value(bytes) => Arrival::Value(bytes.into_owned()),
            Arrival::Boundary(boundary) => Arrival::Boundary(boundary),
        };
        inbox.arrive((wire, sequence), input, arrival);
    };
    let key = &incoming.key;
    let heard = match keyring {
        None => session.on_wire(key, hear),
        Some(keyring) => session.on_sealed_wire(key, keyring.opener((wire, Use::Values), key), hear),
    };
    heard.map_err(|error| error.to_string())
}

pub(super) fn wire(
    session: &DataSession,
    (interface, keyring): (&Interface, Option<&Keyring>),
    outgoing: &Outgoing,
    shape: Shape,
) -> Result<Wire, String> {
    let port = port(interface, &outgoing.port, Direction::Out)?.name;
    let failed = |error: DataError| format!("output `{port}`: {error}");
    let key = &outgoing.key;
    let sealer = keyring.map(|keyring| keyring.sealer((outgoing.wire, Use::Values), key));
    let way = if outgoing.pull {
        let latest: Arc<Mutex<Option<Vec<u8>>>> = Arc::default();
        let theirs = Arc::clone(&latest);
        let answer = move || theirs.lock().unwrap_or_else(PoisonError::into_inner).clone();
        Transport::Pull { latest, _answering: answer_with(session, key, sealer, answer).map_err(failed)? }
    } else {
        let publisher = session.publisher(key, Priority::Wire).map_err(failed)?;
        Transport::Push(sealer.into_iter().fold(publisher, Publisher::sealed))
    };
    let seen = keyring.filter(|_| !outgoing.pull);
    let seen = seen.map(|_| session.publisher(&key::wire_seen(key), Priority::Background)).transpose();
    Ok(Wire { port, flow: Flow::new(shape), way, seen: seen.map_err(failed)? })
}

/// Answers who fetches; in a team for the other end alone.
pub(super) fn answer_with(
    session: &DataSession,
    key: &str,
    sealer: Option<Arc<Sealer>>,
    answer: impl Fn() -> Option<Vec<u8>> + Send + Sync + 'static,
) -> Result<Responder, DataError> {
    match sealer {
        None => session.answer(key, answer),
        Some(sealer) => session.answer_sealed(key, sealer, answer),
    }
}

pub(super) fn port<'a>(
    interface: &'a Interface,
    name: &str,
    direction: Direction,
) -> Result<&'a PortInterface, String> {
    let found = interface.port(name).filter(|port| port.direction == direction && port.binding == Binding::Wire);
    let word = if direction == Direction::In { "input" } else { "output" };
    found.ok_or_else(|| format!("`{}` has no {word} `{name}`", interface.type_name))
}

/// Sends a value over a wire.
fn put_numbered(publisher: &Publisher, payload: Payload, number: u32) {
    if let Err(error) = publisher.put_numbered(payload, number) {
        tracing::debug!(%error, "a value was not sent");
    }
}

pub(super) fn put(publisher: &Publisher, payload: Payload) {
    if let Err(error) = publisher.put(payload) {
        tracing::debug!(%error, "a sample was not sent");
    }
}
