//! The two ends of a wire in a program: how values leave it, and how they come in.

use super::inbox::{Hold, Inbox};
use crate::sdk::interface::{Binding, Direction, Interface, PortInterface};
use comms::io::clock::now;
use comms::io::data::{DataError, DataSession, Payload, Priority, Publisher, Responder, Subscription};
use comms::logic::control::{Incoming, Outgoing, Shape};
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
}

/// Fetches the latest values of several producers at once, in their order; none for a wire that is closed, or for a producer
/// that does not answer within the time that all of them have together.
pub(super) fn fetch_all(fetches: &[Arc<Fetch>], within: Duration) -> Vec<(&'static str, Vec<u8>)> {
    let until = now() + within;
    let asked: Vec<_> = fetches.iter().map(|fetch| (fetch.port, fetch.session.ask(&fetch.key, within))).collect();
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
    session: &DataSession,
    key: &str,
    (port, hold): (&'static str, Hold),
    inbox: &Arc<Inbox>,
) -> Result<Subscription, String> {
    let inbox = Arc::clone(inbox);
    let subscription = session.on_sample(key, move |bytes| inbox.sample(port, bytes.into_owned(), hold));
    subscription.map_err(|error| error.to_string())
}

/// Hears a wire.
pub(super) fn hear(
    session: &DataSession,
    incoming: &Incoming,
    input: (&'static str, Hold),
    inbox: &Arc<Inbox>,
) -> Result<Subscription, String> {
    let (inbox, wire) = (Arc::clone(inbox), incoming.wire);
    let hear = move |arrival: Arrival<Cow<'_, [u8]>>, sequence: Option<Sequence>| {
        let arrival = match arrival {
            Arrival::Value(bytes) => Arrival::Value(bytes.into_owned()),
            Arrival::Boundary(boundary) => Arrival::Boundary(boundary),
        };
        inbox.arrive((wire, sequence), input, arrival);
    };
    session.on_wire(&incoming.key, hear).map_err(|error| error.to_string())
}

pub(super) fn wire(
    session: &DataSession,
    interface: &Interface,
    outgoing: &Outgoing,
    shape: Shape,
) -> Result<Wire, String> {
    let port = port(interface, &outgoing.port, Direction::Out)?.name;
    let failed = |error: DataError| format!("output `{port}`: {error}");
    let way = if outgoing.pull {
        let latest: Arc<Mutex<Option<Vec<u8>>>> = Arc::default();
        let theirs = Arc::clone(&latest);
        let answer = move || theirs.lock().unwrap_or_else(PoisonError::into_inner).clone();
        Transport::Pull { latest, _answering: session.answer(&outgoing.key, answer).map_err(failed)? }
    } else {
        Transport::Push(session.publisher(&outgoing.key, Priority::Wire).map_err(failed)?)
    };
    Ok(Wire { port, flow: Flow::new(shape), way })
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
pub(super) fn put_numbered(publisher: &Publisher, payload: Payload, number: u32) {
    if let Err(error) = publisher.put_numbered(payload, number) {
        tracing::debug!(%error, "a value was not sent");
    }
}

pub(super) fn put(publisher: &Publisher, payload: Payload) {
    if let Err(error) = publisher.put(payload) {
        tracing::debug!(%error, "a sample was not sent");
    }
}
