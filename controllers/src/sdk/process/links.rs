//! The data links of one program: dials the producers of its inputs, and opens and closes the wires of its outputs.

use super::agreement;
use super::devices::Devices;
use super::inbox::{Hold, Inbox};
use super::keyring::{Keyring, Use};
use super::objects::Callers;
use super::wire::{Fetch, Push, Transport, Ways, Wire, WireInput, port, wire};
use crate::sdk::interface::{Direction, Interface};
use crate::sdk::module::{InnerValue, Outlets};
use comms::io::clock::now;
use comms::io::data::{DataError, DataSession, Payload, Responder};
use comms::io::direct::{DirectPath, Filler, Memory, Parcel};
use comms::logic::codec::Enveloped;
use comms::logic::control::{CallRoute, Device, Dial, Incoming, Outgoing, Partner, Shape};
use comms::logic::human::span;
use comms::logic::switch::{Boundary, Flip, Opening};
use comms::logic::time::Time;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// The time limit for reaching another program: dialling takes four round trips, of 3 s each on a long link.
const DIAL_WITHIN: Duration = Duration::from_secs(18);
/// How long this program waits for all other programs together after a restart. Some may be gone for ever.
const REJOIN_WITHIN: Duration = Duration::from_secs(1);

/// The orders of the node: the wires and devices to link.
#[derive(Debug)]
pub(super) struct LinkOrders {
    pub(super) instance: String,
    pub(super) robot: String,
    pub(super) incoming: Vec<Incoming>,
    pub(super) outgoing: Vec<Outgoing>,
    pub(super) devices: Vec<Device>,
}

#[derive(Debug, Default)]
struct Made {
    /// By the number of the wire; the fetches and the subscriptions of inputs are sorted in the same way.
    wires: BTreeMap<u32, Wire>,
    fetches: BTreeMap<u32, Arc<Fetch>>,
    inputs: BTreeMap<u32, (Responder, WireInput)>,
    /// By output, the memory that the output shares with consumers of this host.
    memories: BTreeMap<&'static str, Memory>,
    devices: Devices,
}

/// All links of the program. The listener flips flags while the cycle sends.
#[derive(Debug, Default)]
pub(super) struct Links {
    made: Mutex<Made>,
    /// Whether links have been made.
    are_made: AtomicBool,
    /// Held while links are added to existing ones.
    turn: Mutex<()>,
    told: Mutex<PendingConfig>,
    callers: Callers,
    /// The keys, in a team.
    keyring: Option<Arc<Keyring>>,
    /// The direct path to programs of this host, if there is one.
    direct: Option<Arc<DirectPath>>,
    /// Whether a consumer of a latched wire has come since the loop last looked.
    has_come: Arc<AtomicBool>,
}

/// The configuration that arrives before the links are made.
#[derive(Debug, Default)]
struct PendingConfig {
    /// By wire, how data moves.
    shapes: BTreeMap<u32, Shape>,
    /// The calls of other programs.
    calls: Vec<CallRoute>,
    /// Whether the other programs already run.
    rejoins: bool,
}

/// How long this program waits for others.
#[derive(Clone, Copy, Debug)]
enum DialBudget {
    /// This time for each program. If one of them is missing, no links are made.
    Each(Duration),
    /// Until this time for all programs together. A program that is missing then is linked when it starts.
    Until(Time),
}

impl Links {
    /// Returns an empty set of links. With keys, all messages over the links are sealed.
    pub(super) fn new(keyring: Option<Arc<Keyring>>, direct: Option<Arc<DirectPath>>) -> Self {
        Self { keyring, direct, ..Self::default() }
    }

    /// Returns the keys; none without a team.
    pub(super) fn keyring(&self) -> Option<&Keyring> {
        self.keyring.as_deref()
    }

    /// Takes the programs at the other ends of wires, in a team.
    pub(super) fn take_partners(&self, partners: Vec<Partner>) {
        if let Some(keyring) = self.keyring() {
            keyring.take(partners);
        }
        self.direct.iter().for_each(|direct| direct.keys_changed());
    }

    /// Records how data moves on wires that are made later.
    pub(super) fn shape(&self, wires: Vec<Shape>) {
        self.told().shapes.extend(wires.into_iter().map(|shape| (shape.wire, shape)));
    }

    /// Records the calls that the program makes.
    pub(super) fn call(&self, calls: Vec<CallRoute>) {
        self.told().calls = calls;
    }

    /// Returns the calls that the program makes.
    pub(super) fn callers(&self) -> &Callers {
        &self.callers
    }

    /// Records that the other programs already run.
    pub(super) fn rejoin(&self) {
        self.told().rejoins = true;
    }

    fn told(&self) -> MutexGuard<'_, PendingConfig> {
        self.told.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn shape_of(&self, wire: u32) -> Shape {
        self.told().shapes.get(&wire).copied().unwrap_or(Shape { wire, ..Shape::default() })
    }

    /// Returns whether links have been made.
    pub(super) fn are_made(&self) -> bool {
        self.are_made.load(Ordering::Acquire)
    }

    /// Waits until no other thread adds links.
    pub(super) fn turn(&self) -> MutexGuard<'_, ()> {
        self.turn.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Makes all links; the wires stay closed. Existing links stay open or closed, unless these orders no longer contain
    /// them. If one link cannot be made, nothing changes.
    pub(super) fn make(
        &self,
        session: &Arc<DataSession>,
        interface: &Interface,
        orders: LinkOrders,
        inbox: &Arc<Inbox>,
    ) -> Result<(), String> {
        let is_first = !self.are_made();
        let budget = if is_first && self.told().rejoins {
            DialBudget::Until(now() + REJOIN_WITHIN)
        } else {
            DialBudget::Each(DIAL_WITHIN)
        };
        let (mut made, keyring) = (Made::default(), self.keyring());
        for outgoing in orders.outgoing.iter().filter(|outgoing| !self.lock().wires.contains_key(&outgoing.wire)) {
            let shape = self.shape_of(outgoing.wire);
            let (direct, memories) = (self.direct.as_deref(), &mut self.lock().memories);
            let wire = wire(session, direct, interface, keyring, outgoing, shape, memories)?;
            self.watch(&wire, inbox);
            made.wires.insert(outgoing.wire, wire);
        }
        if is_first {
            made.devices = Devices::make(session, keyring, interface, &orders, inbox)?;
        }
        let dial = |to: &Dial| budget.dial(session, to).map_err(|error| error.to_string());
        for device in orders.devices.iter().filter(|_| is_first) {
            dial(&device.owner).map_err(|why| format!("device `{}`: {why}", device.device))?;
        }
        for incoming in orders.incoming.iter().filter(|incoming| !self.lock().hears(incoming.wire)) {
            dial(&incoming.producer).map_err(|why| format!("input `{}`: {why}", incoming.port))?;
            let (number, input) = (incoming.wire, port(interface, &incoming.port, Direction::In)?);
            let port = input.name;
            if incoming.pull {
                let (key, session) = (incoming.key.clone(), Arc::clone(session));
                let opener = keyring.map(|keyring| keyring.opener(number, Use::Values, &key));
                made.fetches.insert(number, Arc::new(Fetch::new(port, key, session, opener)));
            } else {
                let hold = Hold::of(&self.shape_of(number));
                inbox.link(number);
                let declared = agreement::declare(session, keyring, number, &incoming.key, input);
                let declared = declared.map_err(|error| error.to_string())?;
                let hearing = WireInput::of(self.ways(session, inbox), incoming, input, hold, budget.left())?;
                made.inputs.insert(number, (declared, hearing));
            }
        }
        let calls = self.told().calls.clone();
        for call in &calls {
            dial(&call.server).map_err(|why| format!("call `{}`: {why}", call.call))?;
        }
        self.callers.take(session, keyring, &orders.instance, interface, &calls, inbox)?;
        // Consumers get their inputs before any producer sends: a value that is sent only once must find its consumer.
        for wire in made.wires.values() {
            if let Transport::Push(Push { publisher, .. }) = &wire.way
                && !publisher.wait_heard(budget.left())
                && matches!(budget, DialBudget::Each(_))
            {
                let within = span(DIAL_WITHIN);
                return Err(format!("output `{}`: its consumer has not come within {within}", wire.port));
            }
        }
        for outgoing in &orders.outgoing {
            let port = port(interface, &outgoing.port, Direction::Out)?;
            let Some(push) = made.heard(outgoing.wire) else { continue };
            push.check(session, keyring, outgoing, port)?;
        }
        inbox.forget(self.lock().take(made, &orders, is_first));
        self.are_made.store(true, Ordering::Release);
        Ok(())
    }

    /// Opens or closes wires outside of a switch.
    pub(super) fn switch(&self, wires: &[u32], open: bool) {
        let flip = if open {
            let open = wires.iter().map(|wire| Opening { wire: *wire, after: Vec::new() }).collect();
            Flip { open, ..Flip::default() }
        } else {
            Flip { close: wires.to_vec(), ..Flip::default() }
        };
        self.flip(&flip);
    }

    /// Closes and opens wires between two values. Earlier values are not delivered late, except the last value of a
    /// latched wire. A repeated call only repeats the boundaries.
    pub(super) fn flip(&self, flip: &Flip) {
        let opened: Vec<u32> = flip.open.iter().map(|opening| opening.wire).collect();
        self.callers.switch(&flip.close, false);
        self.callers.switch(&opened, true);
        self.lock().flip(flip, now());
    }

    /// Wakes the loop when a consumer of this wire comes, if the wire may owe it a value.
    fn watch(&self, wire: &Wire, inbox: &Arc<Inbox>) {
        let (has_come, inbox) = (Arc::clone(&self.has_come), Arc::clone(inbox));
        wire.on_arrival(move || {
            has_come.store(true, Ordering::Release);
            inbox.wake();
        });
    }

    /// Sends the last values of latched wires to consumers that have come too late for them. The consumer of a program
    /// that was started again may be linked later than the program, and its node cannot know when.
    pub(super) fn repeat_owed(&self) {
        if self.has_come.swap(false, Ordering::AcqRel) {
            self.lock().repeat_owed(now());
        }
    }

    /// Sends a value of an output to all of its present consumers.
    pub(super) fn send(&self, port: &str, bytes: Vec<u8>) {
        let (mut made, now) = (self.lock(), now());
        made.devices.taps.pass(port, &bytes);
        let mut passing = Vec::new();
        for (&number, wire) in made.wires.iter_mut().filter(|(_, wire)| wire.port == port) {
            if wire.flow.offer(&bytes, now) {
                wire.passed();
                passing.push(number);
                if matches!(wire.way, Transport::Pull { .. }) {
                    wire.way.keep(Some(bytes.clone()));
                }
            }
        }
        made.memories.get(port).into_iter().for_each(|memory| memory.note(bytes.len()));
        let mut parcel = Parcel::new(&bytes);
        passing.retain(|number| !made.wires.get(number).is_some_and(|wire| wire.send_directly(&mut parcel)));
        let payload = Payload::from(bytes);
        made.devices.send(port, &payload);
        for wire in passing.iter().filter_map(|number| made.wires.get(number)) {
            wire.send(&payload);
        }
    }

    /// Sends a long value of an output that is encoded directly into memory, if all its present receivers share that
    /// memory.
    fn send_filled(&self, port: &str, fill: &mut dyn FnMut(&mut Filler<'_>) -> bool) -> bool {
        let (mut made, now) = (self.lock(), now());
        let Made { wires, memories, devices, .. } = &mut *made;
        let mut own: Vec<&mut Wire> = wires.values_mut().filter(|wire| wire.port == port).collect();
        let Some(memory) = memories.get(port) else { return false };
        if devices.hears(port) || !own.iter().all(|wire| wire.is_direct()) {
            return false;
        }
        let Some(mut parcel) = Parcel::filled(memory, fill) else { return false };
        devices.taps.count(port);
        for wire in &mut own {
            // A consumer may have gone a moment ago.
            if wire.flow.pass(now) {
                wire.reach();
                if !wire.send_directly(&mut parcel) {
                    wire.send(&parcel.to_vec(memory).into());
                }
            }
        }
        true
    }

    /// Returns the values of each wire that were sent while its consumer was not connected, and that the consumer does
    /// not count yet.
    pub(super) fn undelivered(&self) -> Vec<(u32, u64)> {
        let made = self.lock();
        let counts = made.wires.iter().map(|(number, wire)| (*number, u64::from(wire.flow.undelivered())));
        counts.filter(|(_, count)| *count > 0).collect()
    }

    /// Publishes signals, or their peaks between two samples.
    pub(super) fn show(&self, signals: &impl Enveloped) {
        self.lock().devices.show(signals);
    }

    /// Returns the inputs whose values have to be fetched before each calculation.
    pub(super) fn fetches(&self) -> Vec<Arc<Fetch>> {
        self.lock().fetches.values().cloned().collect()
    }

    /// Returns whether a wire from the program with this session uses the direct path.
    pub(super) fn hears_directly(&self, session: &str) -> bool {
        self.lock().inputs.values().any(|(_, hearing)| hearing.of_producer(session))
    }

    /// Subscribes again to a program on this host that was restarted. This takes some time; hold [`Links::turn`] for
    /// it.
    pub(super) fn relink(&self, session: &DataSession, inbox: &Arc<Inbox>, lost: &str, found: &Dial) {
        let of_lost = |_: &u32, (_, hearing): &mut (Responder, WireInput)| hearing.of_producer(lost);
        let moved: Vec<_> = self.lock().inputs.extract_if(.., of_lost).collect();
        for (wire, (declared, hearing)) in moved {
            match hearing.from(self.ways(session, inbox), found) {
                Ok(hearing) => drop(self.lock().inputs.insert(wire, (declared, hearing))),
                Err(error) => tracing::warn!(error, wire, "no more values are received from a wire"),
            }
        }
    }

    fn ways<'a>(&'a self, session: &'a DataSession, inbox: &'a Arc<Inbox>) -> Ways<'a> {
        Ways { session, direct: self.direct.as_deref(), inbox, keyring: self.keyring() }
    }

    /// Drops every link.
    pub(super) fn clear(&self) {
        self.callers.clear();
        *self.lock() = Made::default();
    }

    fn lock(&self) -> MutexGuard<'_, Made> {
        self.made.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl DialBudget {
    fn left(self) -> Duration {
        match self {
            Self::Each(within) => within,
            Self::Until(until) => until.since(now()),
        }
    }

    fn dial(self, session: &DataSession, to: &Dial) -> Result<(), DataError> {
        let linked = session.dial(to, self.left());
        match self {
            Self::Each(_) => linked,
            Self::Until(_) => linked.or_else(|_late| session.keep(to)),
        }
    }
}

impl Made {
    fn flip(&mut self, flip: &Flip, now: Time) {
        let Flip { generation, close, open } = flip;
        for wire in close {
            let Some(wire) = self.wires.get_mut(wire) else { continue };
            let sent = wire.flow.close();
            wire.mark(&Boundary::Closed { generation: *generation, sent }, wire.flow.number());
            wire.reach();
            wire.way.keep(None);
        }
        for Opening { wire, after } in open {
            let Some(wire) = self.wires.get_mut(wire) else { continue };
            let (was_open, before) = (wire.flow.is_open(), wire.flow.number());
            let last = wire.flow.open(now);
            wire.mark(&Boundary::Opened { generation: *generation, after: after.clone() }, before);
            wire.reach();
            match (&wire.way, last) {
                (Transport::Push(_), Some(last)) => wire.repeat(last),
                (Transport::Push(_), None) => {}
                (Transport::Pull { .. }, _) if was_open => {}
                (Transport::Pull { .. }, last) => wire.way.keep(last),
            }
        }
    }

    /// Closes and opens the wires that owe their last values, as their node does for a consumer that was started again.
    fn repeat_owed(&mut self, now: Time) {
        let close: Vec<u32> = self.wires.iter().filter(|(_, wire)| wire.owes()).map(|(number, _)| *number).collect();
        let open = close.iter().map(|wire| Opening { wire: *wire, after: Vec::new() }).collect();
        self.flip(&Flip { close, open, ..Flip::default() }, now);
    }

    /// Returns the way of a new wire whose consumer listens.
    fn heard(&self, wire: u32) -> Option<&Push> {
        match &self.wires.get(&wire)?.way {
            Transport::Push(push) if push.publisher.is_heard() => Some(push),
            Transport::Push(_) | Transport::Pull { .. } => None,
        }
    }

    /// Returns whether an input has this wire.
    fn hears(&self, wire: u32) -> bool {
        self.fetches.contains_key(&wire) || self.inputs.contains_key(&wire)
    }

    /// Adds new links, and drops the links that the orders do not name. Returns the dropped inputs.
    fn take(&mut self, new: Self, orders: &LinkOrders, is_first: bool) -> Vec<u32> {
        let (outgoing, incoming): (BTreeSet<u32>, BTreeSet<u32>) = (
            orders.outgoing.iter().map(|outgoing| outgoing.wire).collect(),
            orders.incoming.iter().map(|incoming| incoming.wire).collect(),
        );
        self.wires.retain(|wire, _| outgoing.contains(wire));
        self.fetches.retain(|wire, _| incoming.contains(wire));
        let dropped = self.inputs.extract_if(.., |wire, _| !incoming.contains(wire)).map(|(wire, _)| wire).collect();
        self.wires.extend(new.wires);
        self.fetches.extend(new.fetches);
        self.inputs.extend(new.inputs);
        if is_first {
            self.devices = new.devices;
        }
        dropped
    }
}

impl Outlets for &Links {
    fn send(&mut self, port: &'static str, bytes: Vec<u8>) {
        Links::send(self, port, bytes);
    }

    fn skip(&mut self, port: &'static str, count: u32) {
        self.lock().wires.values_mut().filter(|wire| wire.port == port).for_each(|wire| wire.flow.skip(count));
    }

    fn show_inner(&mut self, values: &mut Vec<InnerValue>, heard: &mut [bool]) {
        self.lock().devices.taps.show_inner(values, heard);
    }

    fn send_filled(&mut self, port: &'static str, fill: &mut dyn FnMut(&mut Filler<'_>) -> bool) -> bool {
        Links::send_filled(self, port, fill)
    }
}

#[cfg(test)]
mod tests;
