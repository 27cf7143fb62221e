//! Machines by number, with an index of their deadlines. So an input about one machine does not require a walk over all machines.

use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// A machine of a [`TimedMap`].
pub trait Timed {
    /// Returns the time at which the machine must be called. None if there is no such time.
    fn deadline(&self) -> Option<Time>;

    /// Returns whether the machine will have no more effects.
    fn is_over(&self) -> bool;
}

/// Machines by number. They are changed only through [`TimedMap::with`] and [`TimedMap::each`], which update the index.
#[derive(Debug, Serialize, Deserialize)]
pub struct TimedMap<T> {
    all: BTreeMap<u32, T>,
    /// The deadline of each machine that has one.
    due: BTreeSet<(Time, u32)>,
    /// The same deadlines by number.
    deadlines: BTreeMap<u32, Time>,
    /// The numbers of the machines that are not over.
    unfinished: BTreeSet<u32>,
    /// How many machines were visited in total, except by [`TimedMap::iter`]. A test compares this with the number of inputs.
    #[serde(skip)]
    visits: u64,
}

impl<T> Default for TimedMap<T> {
    fn default() -> Self {
        Self {
            all: BTreeMap::new(),
            due: BTreeSet::new(),
            deadlines: BTreeMap::new(),
            unfinished: BTreeSet::new(),
            visits: 0,
        }
    }
}

impl<T> TimedMap<T> {
    /// Returns a machine.
    pub fn get(&self, number: u32) -> Option<&T> {
        self.all.get(&number)
    }

    /// Returns whether a machine of this number exists.
    pub fn contains(&self, number: u32) -> bool {
        self.all.contains_key(&number)
    }

    /// Returns all machines, in order of number. This is a full walk, for questions of users and for losses of hosts.
    pub fn iter(&self) -> impl Iterator<Item = (u32, &T)> {
        self.all.iter().map(|(number, machine)| (*number, machine))
    }

    /// Returns all numbers, in order, at the beginning of a walk.
    pub fn numbers(&mut self) -> Vec<u32> {
        self.visits += self.all.len() as u64;
        self.all.keys().copied().collect()
    }

    /// Returns the machines whose deadlines have come, in order of number.
    pub fn due(&mut self, now: Time) -> Vec<u32> {
        let mut due: Vec<u32> = self.due.iter().take_while(|(at, _)| *at <= now).map(|(_, number)| *number).collect();
        self.visits += due.len() as u64;
        due.sort_unstable();
        due
    }

    /// Returns the earliest deadline.
    pub fn deadline(&self) -> Option<Time> {
        self.due.first().map(|(at, _)| *at)
    }

    /// Returns whether all machines are over.
    pub fn are_over(&self) -> bool {
        self.unfinished.is_empty()
    }

    /// Returns how many machines were visited in total.
    pub fn visits(&self) -> u64 {
        self.visits
    }
}

impl<T: Timed> TimedMap<T> {
    /// Adds a machine.
    pub fn insert(&mut self, number: u32, machine: T) {
        self.all.insert(number, machine);
        self.note(number);
    }

    /// Removes a machine.
    pub fn remove(&mut self, number: u32) {
        self.all.remove(&number);
        self.unfinished.remove(&number);
        if let Some(at) = self.deadlines.remove(&number) {
            self.due.remove(&(at, number));
        }
    }

    /// Does something with a machine; returns nothing if no machine has that number.
    pub fn with<R>(&mut self, number: u32, act: impl FnOnce(&mut T) -> R) -> Option<R> {
        self.visits += 1;
        let result = act(self.all.get_mut(&number)?);
        self.note(number);
        Some(result)
    }

    /// Does something with every machine. This is a full walk.
    pub fn each(&mut self, mut act: impl FnMut(u32, &mut T)) {
        for number in self.numbers() {
            self.with(number, |machine| act(number, machine));
        }
    }

    fn note(&mut self, number: u32) {
        let Some(machine) = self.all.get(&number) else { return };
        if machine.is_over() {
            self.unfinished.remove(&number);
        } else {
            self.unfinished.insert(number);
        }
        let now = machine.deadline();
        let before = match now {
            Some(at) => self.deadlines.insert(number, at),
            None => self.deadlines.remove(&number),
        };
        if before != now {
            if let Some(at) = before {
                self.due.remove(&(at, number));
            }
            self.due.extend(now.map(|at| (at, number)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug)]
    struct Alarm(Option<u64>);

    impl Timed for Alarm {
        fn deadline(&self) -> Option<Time> {
            self.0.map(Time::from_nanos)
        }

        fn is_over(&self) -> bool {
            self.0.is_none()
        }
    }

    /// Returns alarms with the numbers below `count`, each at the time that `at` returns for its number.
    fn alarms(count: u32, at: impl Fn(u32) -> u64) -> TimedMap<Alarm> {
        let mut alarms = TimedMap::default();
        (0..count).for_each(|number| alarms.insert(number, Alarm(Some(at(number)))));
        alarms
    }

    /// The index agrees with a walk over all machines.
    #[test]
    fn the_index_is_as_a_walk() {
        let mut alarms = alarms(50, |number| u64::from(number % 7));
        let mut seed = 1_u64;
        for _ in 0..5000 {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let (number, at) = (u32::try_from(seed >> 58).unwrap_or(0), seed >> 40 & 63);
            alarms.with(number, |alarm| alarm.0 = (at > 9).then_some(at));
            let now = Time::from_nanos(seed >> 33 & 63);
            let is_due = |(number, alarm): (u32, &Alarm)| alarm.deadline().filter(|at| *at <= now).map(|_| number);
            assert_eq!(alarms.due(now), alarms.iter().filter_map(is_due).collect::<Vec<_>>());
            assert_eq!(alarms.deadline(), alarms.iter().filter_map(|(_, alarm)| alarm.deadline()).min());
            assert_eq!(alarms.are_over(), alarms.iter().all(|(_, alarm)| alarm.is_over()));
        }
        alarms.remove(3);
        assert!(!alarms.contains(3) && alarms.due(Time::from_nanos(63)).iter().all(|number| *number != 3));
        alarms.each(|_, alarm| alarm.0 = None);
        assert_eq!((alarms.deadline(), alarms.are_over()), (None, true));
    }

    #[test]
    fn what_is_not_due_is_not_looked_at() {
        let mut alarms = alarms(10_000, |_| 1000);
        let before = alarms.visits();
        alarms.with(7, |alarm| alarm.0 = Some(1));
        assert_eq!((alarms.due(Time::from_nanos(10)), alarms.deadline()), (vec![7], Some(Time::from_nanos(1))));
        assert_eq!(alarms.visits() - before, 2);
    }
}
