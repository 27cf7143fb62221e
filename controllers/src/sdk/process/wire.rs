//! The two ends of a wire in a program: how values leave it, and how they come in.

use super::agreement;
use super::inbox::{Hold, Inbox};
use super::keyring::{Keyring, Use};
use crate::sdk::interface::{Binding, Direction, Interface, PortInterface};
use comms::io::clock::now;
use comms::io::data::{
    DataError, DataSession, DeviceGate, Opener, Payload, PendingFetch, Priority, Publisher, Responder, Sealer,
    Subscription,
};
use comms::io::direct::{DirectPath, Inlet, Memory, Outlet, Parcel};
use comms::logic::control::{Dial, Incoming, Outgoing, Shape};
use comms::logic::key;
use comms::logic::switch::{Arrival, Boundary, Flow, Sequence};
use comms::logic::time::Time;
use std::borrow::Cow;
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// The time limit for a producer on the same host to accept a consumer. After this the wire uses zenoh.
const DIRECT_WITHIN: Duration = Duration::from_secs(2);
/// The same limit if no time is left, because a restarted program has waited for programs that are gone. A producer that runs
/// accepts within milliseconds.
const DIRECT_AT_LEAST: Duration = Duration::from_millis(100);
/// The longest time for an answer to a consumer that fetches. It is equal to the time for which a silent link is kept.
const ANSWER_WITHIN: Duration = Duration::from_secs(5);
/// How many questions of one wire may be in transit.
const ASKED_MAX: usize = 8;

/// The path from an output to one consumer.
#[derive(Debug)]
pub(super) struct Wire {
    pub(super) port: &'static str,
    pub(super) flow: Flow,
    pub(super) way: Transport,
    place: Place,
    /// In a team, publishes to people the values that are sealed for the consumer.
    seen: Option<Publisher>,
}

/// Where the consumer of a wire is, as its connections have shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Place {
    /// No consumer has been connected.
    #[default]
    Unknown,
    ThisHost,
    OtherHost,
}

impl Wire {
    /// Notes whether a consumer is there for a value that has passed the flow.
    pub(super) fn passed(&mut self) {
        self.flow.sent(self.has_consumer());
        self.reach();
    }

    /// Notes whether the consumer gets the last message. The values for a consumer on another host that is not connected
    /// are counted. A consumer on this host that is not connected has ended, so it loses nothing. Neither does a
    /// consumer that has not come yet.
    pub(super) fn reach(&mut self) {
        let Transport::Push(Push { publisher, outlet }) = &self.way else { return self.flow.reached() };
        let is_direct = || outlet.as_ref().is_some_and(Outlet::is_connected);
        self.place = match self.place {
            Place::Unknown | Place::OtherHost if is_direct() => Place::ThisHost,
            Place::Unknown if publisher.is_heard() => Place::OtherHost,
            place @ (Place::Unknown | Place::ThisHost | Place::OtherHost) => place,
        };
        if self.place != Place::OtherHost || publisher.is_heard() {
            self.flow.reached();
        }
    }

    /// Sends a value that has passed the flow to a consumer on the same host. Returns whether the value has no other
    /// receiver.
    pub(super) fn send_directly(&self, parcel: &mut Parcel<'_>) -> bool {
        match &self.way {
            Transport::Push(push) => push.put_directly(parcel, self.flow.number()) && !self.is_seen(),
            Transport::Pull { .. } => true,
        }
    }

    /// Returns whether a consumer on this host is the only receiver of the values.
    pub(super) fn is_direct(&self) -> bool {
        let Transport::Push(Push { publisher, outlet }) = &self.way else { return false };
        let is_connected = outlet.as_ref().is_some_and(Outlet::is_connected);
        is_connected && !publisher.is_heard_over_zenoh() && !self.is_seen() && !self.flow.is_latched()
    }

    /// Sends the last value again. If no consumer is there, the wire owes the value.
    pub(super) fn repeat(&mut self, last: Vec<u8>) {
        self.flow.repeated(self.has_consumer());
        self.reach();
        if !self.send_directly(&mut Parcel::new(&last)) {
            self.send(&last.into());
        }
    }

    /// Returns whether a consumer has come to which the wire owes its last value.
    pub(super) fn owes(&self) -> bool {
        self.flow.owes() && self.has_consumer()
    }

    /// Returns whether there is a consumer.
    pub(super) fn has_consumer(&self) -> bool {
        match &self.way {
            Transport::Push(Push { publisher, .. }) => publisher.is_heard(),
            Transport::Pull { .. } => true,
        }
    }

    /// Calls `on_arrival` whenever a consumer comes that may lack the last value.
    pub(super) fn on_arrival(&self, on_arrival: impl Fn() + Send + Sync + 'static) {
        if let Transport::Push(Push { publisher, .. }) = &self.way
            && self.flow.is_latched()
        {
            publisher.on_arrival(on_arrival);
        }
    }

    /// Returns whether people watch the values that are sealed for the consumer.
    fn is_seen(&self) -> bool {
        self.seen.as_ref().is_some_and(Publisher::is_heard)
    }

    /// Sends a value that has passed the flow, over zenoh.
    pub(super) fn send(&self, payload: &Payload) {
        let Transport::Push(Push { publisher, .. }) = &self.way else { return };
        put_numbered(publisher, payload.clone(), self.flow.number());
        if let Some(seen) = self.seen.as_ref().filter(|seen| seen.is_heard()) {
            put_numbered(seen, payload.clone(), self.flow.number());
        }
    }

    /// Sends a boundary between the values, with the number of the previous value, to the consumer and to people who
    /// watch.
    pub(super) fn mark(&self, boundary: &Boundary, number: u32) {
        let Transport::Push(Push { publisher, outlet }) = &self.way else { return };
        let is_direct = outlet.as_ref().is_some_and(|outlet| outlet.mark(boundary, number));
        let zenoh = Some(publisher).filter(|publisher| !is_direct || publisher.is_heard_over_zenoh());
        let seen = self.seen.as_ref().filter(|seen| seen.is_heard());
        for publisher in zenoh.into_iter().chain(seen) {
            if let Err(error) = publisher.mark(boundary, number) {
                tracing::debug!(%error, "cannot report a switch");
            }
        }
    }
}

#[derive(Debug)]
pub(super) enum Transport {
    Push(Push),
    /// The latest value, which the consumer fetches. It is kept only while the wire is open.
    Pull {
        latest: Arc<Mutex<Option<Vec<u8>>>>,
        _answering: Responder,
    },
}

/// The two paths of a pushed value: its consumer has chosen one of them, and people who watch use zenoh.
#[derive(Debug)]
pub(super) struct Push {
    pub(super) publisher: Publisher,
    /// The path on the same host.
    outlet: Option<Outlet>,
}

impl Push {
    fn put_directly(&self, parcel: &mut Parcel<'_>, number: u32) -> bool {
        self.outlet.as_ref().is_some_and(|outlet| outlet.send(parcel, number)) && !self.publisher.is_heard_over_zenoh()
    }

    /// Checks whether the consumer takes the type that this output sends.
    ///
    /// # Errors
    /// If the types differ; both definitions are shown.
    pub(super) fn check(
        &self,
        session: &DataSession,
        keyring: Option<&Keyring>,
        outgoing: &Outgoing,
        output: &PortInterface,
    ) -> Result<(), String> {
        match self.outlet.as_ref().and_then(Outlet::form) {
            Some(form) => agreement::compare(&form, output),
            None => agreement::check(session, keyring, outgoing.wire, &outgoing.key, output),
        }
    }
}

impl Transport {
    /// Stores this value for fetches.
    pub(super) fn keep(&self, value: Option<Vec<u8>>) {
        if let Self::Pull { latest, .. } = self {
            *latest.lock().unwrap_or_else(PoisonError::into_inner) = value;
        }
    }
}

/// The consumer's end of a wire whose values it fetches.
#[derive(Debug)]
pub(super) struct Fetch {
    port: &'static str,
    key: String,
    session: Arc<DataSession>,
    /// Opens the values that the producer has sealed, in a team.
    opener: Option<Arc<Opener>>,
    /// The questions without an answer, the oldest first.
    asked: Mutex<VecDeque<PendingFetch>>,
}

impl Fetch {
    pub(super) fn new(port: &'static str, key: String, session: Arc<DataSession>, opener: Option<Arc<Opener>>) -> Self {
        Self { port, key, session, opener, asked: Mutex::default() }
    }

    fn ask(&self) {
        let mut asked = self.asked.lock().unwrap_or_else(PoisonError::into_inner);
        if asked.len() >= ASKED_MAX {
            return;
        }
        let question = match &self.opener {
            None => self.session.ask(&self.key, ANSWER_WITHIN),
            Some(opener) => self.session.ask_sealed(&self.key, Arc::clone(opener), ANSWER_WITHIN),
        };
        match question {
            Ok(question) => asked.push_back(question),
            Err(error) => tracing::debug!(port = self.port, %error, "a value cannot be fetched"),
        }
    }

    /// Returns the answer to the latest question that has one, and forgets earlier questions.
    fn newest(&self, until: Time) -> Option<Vec<u8>> {
        let mut asked = self.asked.lock().unwrap_or_else(PoisonError::into_inner);
        for index in (0..asked.len()).rev() {
            // Only the last question still has time; the earlier ones have used theirs.
            let until = if index + 1 == asked.len() { until } else { Time::ZERO };
            match asked[index].answer_by(until) {
                None => {}
                Some(Ok(value)) => {
                    asked.drain(..=index);
                    return value;
                }
                Some(Err(error)) => {
                    tracing::debug!(port = self.port, %error, "a value cannot be fetched");
                    asked.remove(index);
                }
            }
        }
        None
    }
}

/// Fetches the latest values of several producers at once, in their order, and waits no longer than `within` for all of
/// them together. The next call takes an answer that comes later. A closed wire has no value, nor does a producer
/// without a new one.
pub(super) fn fetch_all(fetches: &[Arc<Fetch>], within: Duration) -> Vec<(&'static str, Vec<u8>)> {
    let until = now() + within;
    fetches.iter().for_each(|fetch| fetch.ask());
    fetches.iter().filter_map(|fetch| Some((fetch.port, fetch.newest(until)?))).collect()
}

pub(super) fn subscribe(
    session: &DataSession,
    gate: Option<Arc<DeviceGate>>,
    key: &str,
    port: &'static str,
    hold: Hold,
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

/// The paths by which values reach a program.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ways<'a> {
    pub(super) session: &'a DataSession,
    /// The direct path to programs of the same host.
    pub(super) direct: Option<&'a DirectPath>,
    pub(super) inbox: &'a Arc<Inbox>,
    pub(super) keyring: Option<&'a Keyring>,
}

/// The consumer's end of a pushed wire. The wire ends when this is dropped.
#[derive(Debug)]
pub(super) enum WireInput {
    Zenoh { _subscription: Subscription },
    Direct(Box<DirectInput>),
}

/// An input whose producer is on the same host.
#[derive(Debug)]
pub(super) struct DirectInput {
    incoming: Incoming,
    input: PortInterface,
    hold: Hold,
    inlet: Inlet,
}

impl WireInput {
    /// Subscribes to a wire: directly if its producer is on the same host and accepts in time, otherwise over zenoh.
    pub(super) fn of(
        ways: Ways<'_>,
        incoming: &Incoming,
        input: &PortInterface,
        hold: Hold,
        within: Duration,
    ) -> Result<Self, String> {
        if let Some(inlet) = ways.directly(incoming, input, hold, within.clamp(DIRECT_AT_LEAST, DIRECT_WITHIN), None) {
            let (incoming, input) = (incoming.clone(), input.clone());
            return Ok(Self::Direct(Box::new(DirectInput { incoming, input, hold, inlet })));
        }
        ways.over_zenoh(incoming, input.name, hold)
    }

    /// Returns whether the input has a direct path to this producer.
    pub(super) fn of_producer(&self, session: &str) -> bool {
        matches!(self, Self::Direct(hearing) if hearing.incoming.producer.session == session)
    }

    /// Subscribes to the same wire at a producer that was restarted.
    pub(super) fn from(self, ways: Ways<'_>, found: &Dial) -> Result<Self, String> {
        let Self::Direct(hearing) = self else { return Ok(self) };
        let DirectInput { mut incoming, input, hold, inlet } = *hearing;
        incoming.producer = found.clone();
        match ways.directly(&incoming, &input, hold, DIRECT_WITHIN, Some(inlet)) {
            Some(inlet) => Ok(Self::Direct(Box::new(DirectInput { incoming, input, hold, inlet }))),
            None => ways.over_zenoh(&incoming, input.name, hold),
        }
    }
}

impl Ways<'_> {
    fn directly(
        self,
        incoming: &Incoming,
        input: &PortInterface,
        hold: Hold,
        within: Duration,
        replaced: Option<Inlet>,
    ) -> Option<Inlet> {
        let (direct, place) = (self.direct?, incoming.producer.direct()?);
        let (inbox, wire, port) = (Arc::clone(self.inbox), incoming.wire, input.name);
        let on_arrival = move |arrival, sequence| inbox.arrive(wire, Some(sequence), port, hold, arrival);
        let form = agreement::form(input);
        let connected = direct.inlet(&place, within, &incoming.key, form, replaced, on_arrival);
        connected.inspect_err(|error| tracing::debug!(%error, port = input.name, "a wire is not direct")).ok()
    }

    fn over_zenoh(self, incoming: &Incoming, port: &'static str, hold: Hold) -> Result<WireInput, String> {
        let (inbox, wire) = (Arc::clone(self.inbox), incoming.wire);
        let hear = move |arrival: Arrival<Cow<'_, [u8]>>, sequence: Option<Sequence>| {
            let arrival = match arrival {
                Arrival::Value(bytes) => Arrival::Value(bytes.into_owned().into()),
                Arrival::Boundary(boundary) => Arrival::Boundary(boundary),
            };
            inbox.arrive(wire, sequence, port, hold, arrival);
        };
        let key = &incoming.key;
        let heard = match self.keyring {
            None => self.session.on_wire(key, hear),
            Some(keyring) => self.session.on_sealed_wire(key, keyring.opener(wire, Use::Values, key), hear),
        };
        heard.map(|subscription| WireInput::Zenoh { _subscription: subscription }).map_err(|error| error.to_string())
    }
}

/// Makes the producer's end of a wire; values of one output share memory.
pub(super) fn wire(
    session: &DataSession,
    direct: Option<&DirectPath>,
    interface: &Interface,
    keyring: Option<&Keyring>,
    outgoing: &Outgoing,
    shape: Shape,
    memories: &mut BTreeMap<&'static str, Memory>,
) -> Result<Wire, String> {
    let port = port(interface, &outgoing.port, Direction::Out)?.name;
    let failed = |error: DataError| format!("output `{port}`: {error}");
    let key = &outgoing.key;
    let sealer = keyring.map(|keyring| keyring.sealer(outgoing.wire, Use::Values, key));
    let way = if outgoing.pull {
        let latest: Arc<Mutex<Option<Vec<u8>>>> = Arc::default();
        let theirs = Arc::clone(&latest);
        let answer = move || theirs.lock().unwrap_or_else(PoisonError::into_inner).clone();
        Transport::Pull { latest, _answering: answer_with(session, key, sealer, answer).map_err(failed)? }
    } else {
        let publisher = session.publisher(key, Priority::Wire).map_err(failed)?;
        let publisher = sealer.into_iter().fold(publisher, Publisher::sealed);
        let outlet = direct.map(|direct| direct.outlet(key, memories.entry(port).or_default(), &publisher));
        Transport::Push(Push { publisher, outlet })
    };
    let seen = keyring.filter(|_| !outgoing.pull);
    let seen = seen.map(|_| session.publisher(&key::wire_seen(key), Priority::Background)).transpose();
    Ok(Wire { port, flow: Flow::new(shape), way, place: Place::default(), seen: seen.map_err(failed)? })
}

/// Answers fetches. In a team, only the other end can read the answers.
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
