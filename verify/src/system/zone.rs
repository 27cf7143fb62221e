//! The order in which the timers of an activity may elapse.
//!
//! A supervisor makes the timers of an activity elapse in the order of their due times. If several timers are due at the
//! same time, the timer that began first elapses first. A *zone* is a set of possible due times. It has an upper bound
//! for each difference between two due times, and between a due time and now. Between two events any time may pass, up to
//! the next due time. Source: D. L. Dill, "Timing assumptions and verification of finite-state concurrent systems", 1989.
//!
//! Bounds far from 0 are rounded up, so that a short period beside a long time does not create a zone for each tick.

use super::Frame;
use super::order::Order;
use crate::model::times_of;
use language::algebra::{Command, Program};
use language::automaton::{Action, Target, Transition};
use language::plan::{Expression, TIMER_LEAST};
use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// The longest time, in nanoseconds: 36 years. Longer times are treated as this long.
const LONGEST: u64 = 1 << 60;
/// For each number of timers that are armed together: how many significant bits a bound has. The sign is always exact.
const BITS: [u32; 6] = [8, 8, 8, 6, 5, 5];

/// An upper bound of a difference: twice the bound, plus 1 if the difference may equal the bound.
type Bound = i64;

const fn at_most(bound: i64) -> Bound {
    bound << 1 | 1
}

const LESS: Bound = 0;

fn sum(one: Bound, other: Bound) -> Bound {
    (one >> 1).saturating_add(other >> 1) << 1 | one & other & 1
}

/// The possible due times of the armed timers. In `bounds`, row 0 and column 0 stand for now, and the others for the timers
/// in the order in which they began.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Zone {
    timers: Vec<u32>,
    bounds: Vec<Bound>,
}

impl Zone {
    fn new() -> Self {
        Self { timers: Vec::new(), bounds: vec![at_most(0)] }
    }

    fn size(&self) -> usize {
        self.timers.len() + 1
    }

    fn bound(&self, row: usize, column: usize) -> Bound {
        self.bounds[row * self.size() + column]
    }

    fn tighten(&mut self, row: usize, column: usize, bound: Bound) {
        let place = row * self.size() + column;
        self.bounds[place] = self.bounds[place].min(bound);
    }

    /// Makes each bound as tight as the other bounds imply.
    fn close(&mut self) {
        for middle in 0..self.size() {
            for row in 0..self.size() {
                for column in 0..self.size() {
                    let through = sum(self.bound(row, middle), self.bound(middle, column));
                    self.tighten(row, column, through);
                }
            }
        }
    }

    fn is_possible(&self) -> bool {
        (0..self.size()).all(|row| self.bound(row, row) >= at_most(0))
    }

    fn place(&self, timer: u32) -> Option<usize> {
        self.timers.iter().position(|other| *other == timer).map(|place| place + 1)
    }

    /// Keeps some timers alone.
    fn retain(&mut self, keeps: impl Fn(u32) -> bool) {
        let places: Vec<usize> =
            (0..self.size()).filter(|&place| place == 0 || keeps(self.timers[place - 1])).collect();
        let pairs = places.iter().flat_map(|&row| places.iter().map(move |&column| (row, column)));
        self.bounds = pairs.map(|(row, column)| self.bound(row, column)).collect();
        self.timers.retain(|&timer| keeps(timer));
    }

    /// Returns the zone just after a timer has elapsed; none if another timer elapses before it.
    fn elapsed(&self, timer: u32) -> Option<Self> {
        let (own, mut zone) = (self.place(timer)?, self.clone());
        for other in 1..self.size() {
            zone.tighten(own, other, if own <= other { at_most(0) } else { LESS });
        }
        zone.tighten(own, 0, at_most(0));
        zone.tighten(0, own, at_most(0));
        zone.close();
        zone.is_possible().then(|| {
            zone.retain(|other| other != timer);
            zone
        })
    }

    /// A timer begins now.
    fn arm(&mut self, timer: u32, time: i64) {
        self.retain(|other| other != timer);
        let (size, old) = (self.size(), self.clone());
        let bound = |row: usize, column: usize| match (row == size, column == size) {
            (true, true) => at_most(0),
            (true, false) => sum(at_most(time), old.bound(0, column)),
            (false, true) => sum(old.bound(row, 0), at_most(-time)),
            (false, false) => old.bound(row, column),
        };
        self.bounds = (0..=size).flat_map(|row| (0..=size).map(move |column| bound(row, column))).collect();
        self.timers.push(timer);
    }

    /// Lets any time pass in which no timer elapses.
    fn pass(&mut self) {
        for column in 1..self.size() {
            self.bounds[column] = at_most(0);
        }
        self.close();
        let bits = BITS[self.timers.len().min(BITS.len() - 1)];
        self.bounds.iter_mut().for_each(|bound| *bound = rounded(*bound, bits));
    }
}

/// Returns a bound with at most `bits` significant bits, rounded up.
fn rounded(bound: Bound, bits: u32) -> Bound {
    let value = bound >> 1;
    let shift = (u64::BITS - value.unsigned_abs().leading_zeros()).saturating_sub(bits);
    let round = (value + (1 << shift) - 1) >> shift << shift;
    if round == value { bound } else { at_most(round) }
}

/// The zones of one activity that were found, by number.
#[derive(Debug)]
struct Zones {
    /// Whether the order of each timer matters.
    matters: Vec<bool>,
    /// The greatest time of which all times of the activity are multiples, in nanoseconds.
    unit: u64,
    known: Mutex<BTreeMap<u64, Arc<Known>>>,
}

/// A zone, and the timers that may elapse next.
#[derive(Debug)]
struct Known {
    zone: Zone,
    next: Vec<u32>,
}

impl Zones {
    /// Returns the zones of an activity. None for any other expression, or if it has fewer than two timers whose order matters.
    fn of(expression: &Expression) -> Option<Self> {
        let Expression::Chart(chart) = expression else { return None };
        let timed = chart.chart.transitions.iter().filter(|transition| transition.trigger.time().is_some());
        let mut matters: Vec<bool> = timed.map(has_effect).collect();
        let times = times_of(expression);
        matters.resize(times.len(), true);
        let unit = times.iter().map(|time| nanoseconds(*time)).fold(0, common);
        let is_ordered = matters.iter().filter(|matters| **matters).count() > 1;
        is_ordered.then(|| Self { matters, unit: unit.max(1), known: Mutex::default() })
    }

    fn matters(&self, timer: u32) -> bool {
        self.matters.get(timer as usize).is_some_and(|matters| *matters)
    }

    /// Returns the zone with a number. Number 0 is the zone without timers.
    fn known(&self, number: u64) -> Option<Arc<Known>> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner).get(&number).cloned()
    }

    fn number(&self, zone: Zone) -> u64 {
        if zone.timers.is_empty() {
            return 0;
        }
        let mut hasher = DefaultHasher::new();
        zone.hash(&mut hasher);
        let mut number = hasher.finish().max(1);
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        while known.get(&number).is_some_and(|other| other.zone != zone) {
            number = number.wrapping_add(1).max(1);
        }
        known.entry(number).or_insert_with(|| {
            let next = zone.timers.iter().copied().filter(|&timer| zone.elapsed(timer).is_some()).collect();
            Arc::new(Known { zone, next })
        });
        number
    }
}

/// Returns whether a transition has an effect other than lines for people.
fn has_effect(transition: &Transition) -> bool {
    let is_shown = |action: &Action| matches!(action, Action::Log(_) | Action::Send { .. });
    transition.target != Target::Stay || !transition.actions.iter().all(is_shown)
}

/// Returns the time of a timer.
pub(super) fn nanoseconds(time: Duration) -> u64 {
    u64::try_from(time.max(TIMER_LEAST).as_nanos()).unwrap_or(LONGEST).min(LONGEST)
}

/// The greatest common divisor.
fn common(one: u64, other: u64) -> u64 {
    if other == 0 { one } else { common(other, one % other) }
}

/// The order of the timers in a system.
#[derive(Debug, Default)]
pub(super) struct Clocks {
    /// The zones of the activities. A configuration has one number for each.
    zones: Vec<Clock>,
    /// For each unit, the order of its timers, if there is one.
    orders: Vec<Option<Order>>,
}

/// The zones of one unit.
#[derive(Debug)]
struct Clock {
    unit: usize,
    zones: Zones,
}

impl Clocks {
    /// Adds the next unit.
    pub(super) fn add(&mut self, expression: &Expression) {
        let unit = self.orders.len();
        self.zones.extend(Zones::of(expression).map(|zones| Clock { unit, zones }));
        self.orders.push(Order::of(expression));
    }

    /// Allows any order of the timers of expressions.
    pub(super) fn forget_order(&mut self) {
        self.orders.fill_with(|| None);
    }

    /// Returns how many numbers a configuration has.
    pub(super) fn count(&self) -> usize {
        self.zones.len()
    }

    fn place(&self, unit: usize) -> Option<(usize, &Zones)> {
        let place = self.zones.iter().position(|clock| clock.unit == unit)?;
        Some((place, &self.zones[place].zones))
    }

    /// Returns whether no other timer of a unit elapses before this one.
    pub(super) fn may_elapse(&self, frame: &Frame, unit: usize, program: &Program, timer: u32) -> bool {
        let earlier = self.orders[unit].as_ref().map_or(&[][..], |order| order.before(timer));
        if earlier.iter().any(|earlier| frame.states[unit].is_armed(program, *earlier)) {
            return false;
        }
        let Some((place, zones)) = self.place(unit).filter(|(_, zones)| zones.matters(timer)) else { return true };
        let known = zones.known(frame.zones[place]);
        known.is_none_or(|known| known.next.contains(&timer) || known.zone.place(timer).is_none())
    }

    /// Updates the timers of a unit after its reaction to an event, which may be the end of a timer.
    pub(super) fn follow(&self, frame: &mut Frame, unit: usize, program: &Program, reaction: &TimedReaction<'_>) {
        let Some((place, zones)) = self.place(unit) else { return };
        let TimedReaction { elapsed, commands } = *reaction;
        let known = zones.known(frame.zones[place]);
        let begins = commands.iter().any(|command| matches!(command, Command::Arm { .. }));
        if known.is_none() && !begins {
            return;
        }
        let mut zone = known.map_or_else(Zone::new, |known| known.zone.clone());
        zone.close();
        if let Some(after) = elapsed.and_then(|timer| zone.elapsed(timer)) {
            zone = after;
        }
        let state = &frame.states[unit];
        zone.retain(|timer| state.is_armed(program, timer) && Some(timer) != elapsed);
        for command in commands {
            if let Command::Arm { timer, after, .. } = command
                && zones.matters(*timer)
                && state.is_armed(program, *timer)
            {
                let time = i64::try_from(nanoseconds(*after) / zones.unit).unwrap_or(i64::MAX);
                zone.arm(*timer, time);
            }
        }
        zone.pass();
        frame.zones[place] = zones.number(zone);
    }
}

/// The part of a reaction that concerns timers.
#[derive(Clone, Copy, Debug)]
pub(super) struct TimedReaction<'c> {
    /// The elapsed timer, if this is the event.
    pub(super) elapsed: Option<u32>,
    pub(super) commands: &'c [Command],
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the timers that may elapse next.
    fn next(zone: &Zone) -> Vec<u32> {
        zone.timers.iter().copied().filter(|&timer| zone.elapsed(timer).is_some()).collect()
    }

    fn armed(timers: &[(u32, i64)]) -> Zone {
        let mut zone = Zone::new();
        timers.iter().for_each(|&(timer, time)| zone.arm(timer, time));
        zone.pass();
        zone
    }

    /// Makes a timer elapse, after which others begin.
    fn after(zone: &Zone, timer: u32, then: &[(u32, i64)]) -> Zone {
        let mut zone = zone.elapsed(timer).expect("it may run out");
        then.iter().for_each(|&(timer, time)| zone.arm(timer, time));
        zone.pass();
        zone
    }

    #[test]
    fn timers_that_begin_together_have_one_order() {
        assert_eq!(next(&armed(&[(0, 5), (1, 3)])), [1]);
        assert_eq!(next(&armed(&[(1, 3), (0, 3)])), [1]);
        assert_eq!(next(&armed(&[(0, 100_000), (1, 1), (2, 99_999), (3, 7), (4, 8), (5, 9)])), [1]);
    }

    #[test]
    fn times_on_a_way_add_up() {
        let first = armed(&[(0, 5), (1, 2)]);
        let second = after(&first, 1, &[(2, 2)]);
        assert_eq!(next(&second), [2]);
        assert_eq!(next(&after(&second, 2, &[(3, 2)])), [0]);
        // Both are due at the same time: the timer that began first elapses.
        assert_eq!(next(&after(&second, 2, &[(3, 1)])), [0]);
    }

    /// A message comes at any time, so a timer that begins with it may elapse earlier or later than the other one.
    #[test]
    fn an_event_without_a_time_leaves_the_order_open() {
        let mut zone = armed(&[(0, 5)]);
        zone.arm(1, 3);
        zone.pass();
        assert_eq!(next(&zone), [0, 1]);
        let mut zone = armed(&[(0, 5)]);
        zone.arm(1, 5);
        zone.pass();
        assert_eq!(next(&zone), [0]);
    }

    #[test]
    fn a_bound_is_rounded_up_and_keeps_its_sign() {
        for value in [-100_001, -257, -33, -1, 0, 1, 31, 255, 257, 70_000] {
            for bits in 2..9 {
                let round = rounded(at_most(value), bits) >> 1;
                assert!(round >= value && round.signum() == value.signum(), "{value} {bits}: {round}");
            }
        }
    }
}
