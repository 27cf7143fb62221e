//! The state of all wires at their consumer: puts arrivals into the order of the switches.

use super::{Boundary, Expect, HOLD_WITHIN};
use crate::logic::time::Time;
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// How many switches a consumer expects at one time. For a further one, the oldest is given up.
const EXPECTED_MAX: usize = 64;
/// How many unlinked wires are remembered. For a further one, the lowest number is dropped.
const UNLINKED_MAX: usize = 4096;

/// An arrival on a wire.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Arrival<T> {
    /// A value.
    Value(T),
    /// A word between values.
    Boundary(Boundary),
}

/// The consumer's events, in the order in which it has to process them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Passed<T> {
    /// A value.
    Value(T),
    /// All values of an expected switch have arrived, or the consumer does not wait for them any longer.
    Taken(Taken),
}

/// The result of a switch at a consumer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Taken {
    /// The switch.
    pub generation: u64,
    /// How many values of the closed wires were sent but did not arrive, plus how many values were lost for lack of
    /// room while they were held back.
    pub lost: u64,
    /// How many values came over old wires after these were given up, since the last switch. They were dropped.
    pub late: u64,
    /// Wires whose boundaries did not arrive in time.
    pub missing: Vec<u32>,
}

/// The wires of one consumer.
#[derive(Debug)]
pub struct Intake<T> {
    wires: BTreeMap<u32, Wire<T>>,
    expected: BTreeMap<u64, Expected>,
    /// Wires that are not linked any more. Nothing is expected from them.
    unlinked: BTreeSet<u32>,
    late: u64,
}

#[derive(Debug)]
struct Wire<T> {
    /// The generation of its last opening, and of the last closing after that.
    opened: Option<u64>,
    closed: Option<u64>,
    /// How many values have come since its opening; none if the opening has not come.
    received: Option<u64>,
    /// The waiting values, and their limit.
    held: VecDeque<T>,
    /// The switch for which values are held back, the latest time to release them, and the wires that have to close
    /// first.
    hold: Option<(u64, Time)>,
    after: BTreeSet<u32>,
    /// The wire was given up: values are late until a boundary comes.
    given_up: bool,
    /// How many values were lost since the last opening.
    lost: u64,
}

#[derive(Debug)]
struct Expected {
    what: Expect,
    until: Time,
}

impl<T> Default for Intake<T> {
    fn default() -> Self {
        Self { wires: BTreeMap::new(), expected: BTreeMap::new(), unlinked: BTreeSet::new(), late: 0 }
    }
}

impl<T> Default for Wire<T> {
    fn default() -> Self {
        Self {
            opened: None,
            closed: None,
            received: None,
            held: VecDeque::new(),
            hold: None,
            after: BTreeSet::new(),
            given_up: false,
            lost: 0,
        }
    }
}

impl<T> Intake<T> {
    /// Takes an arrival on a wire. At most `held_max` values are held back; for a further one, the oldest is dropped.
    pub fn arrive(&mut self, now: Time, wire: u32, held_max: usize, arrival: Arrival<T>, out: &mut Vec<Passed<T>>) {
        match arrival {
            // The value was in transit when the wire was removed.
            Arrival::Value(_) if self.unlinked.contains(&wire) => self.late += 1,
            Arrival::Boundary(_) if self.unlinked.contains(&wire) => {}
            Arrival::Value(value) => self.value(wire, held_max, value, out),
            Arrival::Boundary(Boundary::Opened { generation, after }) => self.opened(now, wire, generation, after),
            Arrival::Boundary(Boundary::Closed { generation, sent }) => self.closed(wire, generation, sent),
        }
        self.settle(out);
    }

    /// Expects a switch. A second call for the same switch has no effect.
    pub fn expect(&mut self, now: Time, what: Expect, out: &mut Vec<Passed<T>>) {
        if self.expected.len() >= EXPECTED_MAX
            && let Some((_, given_up)) = self.expected.pop_first()
        {
            out.push(Passed::Taken(self.taken(&given_up.what)));
        }
        self.expected.entry(what.generation).or_insert(Expected { what, until: now + HOLD_WITHIN });
        self.settle(out);
    }

    /// Gives up the expected switches whose time is over.
    pub fn tick(&mut self, now: Time, out: &mut Vec<Passed<T>>) {
        let late: BTreeSet<u32> = self
            .wires
            .values()
            .filter(|wire| wire.hold.is_some_and(|(_, until)| until <= now))
            .flat_map(|wire| wire.after.iter().copied())
            .collect();
        for wire in late {
            self.wires.entry(wire).or_default().given_up = true;
        }
        for wire in self.wires.values_mut().filter(|wire| wire.hold.is_some_and(|(_, until)| until <= now)) {
            wire.release(out);
        }
        let over = self.expected.extract_if(.., |_, expected| expected.until <= now).collect::<Vec<_>>();
        for (_, expected) in over {
            out.push(Passed::Taken(self.taken(&expected.what)));
        }
        self.settle(out);
    }

    /// Returns the time at which [`Intake::tick`] has to be called.
    pub fn deadline(&self) -> Option<Time> {
        let holds = self.wires.values().filter_map(|wire| wire.hold.map(|(_, until)| until));
        holds.chain(self.expected.values().map(|expected| expected.until)).min()
    }

    /// Notes that a wire is linked, before any message comes over it.
    pub fn link(&mut self, wire: u32) {
        self.unlinked.remove(&wire);
    }

    /// Removes a wire that is no longer linked. Its held values pass, and its end is no longer expected.
    pub fn forget(&mut self, number: u32, out: &mut Vec<Passed<T>>) {
        if self.unlinked.len() >= UNLINKED_MAX {
            self.unlinked.pop_first();
        }
        self.unlinked.insert(number);
        if let Some(mut wire) = self.wires.remove(&number) {
            wire.release(out);
        }
        for other in self.wires.values_mut() {
            other.after.remove(&number);
        }
        self.settle(out);
    }

    fn value(&mut self, wire: u32, held_max: usize, value: T, out: &mut Vec<Passed<T>>) {
        let wire = self.wires.entry(wire).or_default();
        if wire.given_up {
            self.late += 1;
            return;
        }
        if let Some(received) = &mut wire.received {
            *received += 1;
        }
        if wire.hold.is_none() {
            return out.push(Passed::Value(value));
        }
        if wire.held.len() >= held_max.max(1) {
            wire.held.pop_front();
            wire.lost += 1;
        }
        wire.held.push_back(value);
    }

    fn opened(&mut self, now: Time, number: u32, generation: u64, after: Vec<u32>) {
        let is_closed = |wire: &u32| {
            self.unlinked.contains(wire)
                || self.wires.get(wire).is_some_and(|wire| wire.given_up || wire.was_closed(generation))
        };
        let after: BTreeSet<u32> = after.into_iter().filter(|wire| *wire != number && !is_closed(wire)).collect();
        let is_aligned = self.expected.get(&generation).is_some_and(|expected| expected.what.open.len() > 1);
        let wire = self.wires.entry(number).or_default();
        if generation > 0 && wire.opened == Some(generation) {
            // The switch was already reported.
            return;
        }
        if wire.opened.is_none() || generation == 0 {
            (wire.received, wire.lost) = (Some(0), 0);
        }
        (wire.opened, wire.closed, wire.given_up) = (Some(generation), None, false);
        if generation > 0 && (!after.is_empty() || is_aligned) {
            wire.hold = Some((generation, now + HOLD_WITHIN));
            wire.after = after;
        }
    }

    fn closed(&mut self, number: u32, generation: u64, sent: u64) {
        let wire = self.wires.entry(number).or_default();
        if wire.closed.is_none() {
            wire.lost += wire.received.map_or(0, |received| sent.saturating_sub(received));
        }
        (wire.opened, wire.received, wire.given_up) = (None, None, false);
        if generation > 0 && wire.hold.is_some_and(|(held, _)| held == generation) {
            // The same switch has closed and opened this wire: the opening is withdrawn, and its values are dropped.
            wire.held.clear();
            (wire.hold, wire.lost) = (None, 0);
            wire.after.clear();
        }
        wire.closed = wire.closed.max(Some(generation));
        for other in self.wires.values_mut().filter(|other| other.hold.is_some_and(|(held, _)| held <= generation)) {
            other.after.remove(&number);
        }
    }

    /// Passes the values that need not wait any longer, and reports the complete switches.
    fn settle(&mut self, out: &mut Vec<Passed<T>>) {
        let is_complete = |expected: &Expect| self.missing(expected).next().is_none();
        let complete: BTreeSet<u64> = self
            .expected
            .iter()
            .filter(|(_, expected)| is_complete(&expected.what))
            .map(|(number, _)| *number)
            .collect();
        for generation in &complete {
            if let Some(expected) = self.expected.remove(generation) {
                // The values before the switch have passed. The boundary follows, and then the values after it.
                out.push(Passed::Taken(self.taken(&expected.what)));
            }
        }
        for wire in self.wires.values_mut() {
            let waits = |(generation, _): (u64, Time)| {
                !wire.after.is_empty()
                    || self.expected.get(&generation).is_some_and(|expected| expected.what.open.len() > 1)
            };
            if wire.hold.is_some_and(|hold| !waits(hold)) {
                wire.release(out);
            }
        }
    }

    /// Returns the wires of a switch whose boundaries have not arrived.
    fn missing<'a>(&'a self, what: &'a Expect) -> impl Iterator<Item = u32> + 'a {
        let is = |wire: &u32, was: fn(&Wire<T>, u64) -> bool| {
            self.unlinked.contains(wire) || self.wires.get(wire).is_some_and(|wire| was(wire, what.generation))
        };
        let open = what.close.iter().filter(move |wire| !is(wire, Wire::was_closed));
        let closed = what.open.iter().filter(move |wire| !is(wire, Wire::was_opened));
        open.chain(closed).copied()
    }

    fn taken(&mut self, what: &Expect) -> Taken {
        let missing = self.missing(what).collect();
        let wires = what.close.iter().chain(&what.open);
        let mut lost = 0;
        for wire in wires {
            if let Some(wire) = self.wires.get_mut(wire) {
                lost += std::mem::take(&mut wire.lost);
            }
        }
        Taken { generation: what.generation, lost, late: std::mem::take(&mut self.late), missing }
    }
}

impl<T> Wire<T> {
    /// Returns whether this switch or a later one has closed the wire. A later switch may have opened it again.
    fn was_closed(&self, generation: u64) -> bool {
        self.closed.is_some_and(|closed| closed >= generation) || self.opened.is_some_and(|opened| opened > generation)
    }

    /// Returns whether this switch or a later one has opened the wire. A later switch may have closed it again.
    fn was_opened(&self, generation: u64) -> bool {
        self.opened.is_some_and(|opened| opened >= generation) || self.closed.is_some_and(|closed| closed >= generation)
    }

    fn release(&mut self, out: &mut Vec<Passed<T>>) {
        self.hold = None;
        self.after.clear();
        out.extend(self.held.drain(..).map(Passed::Value));
    }
}

#[cfg(test)]
mod tests;
