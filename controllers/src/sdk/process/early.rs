//! Values that reach a controller before its activation begins.
//!
//! A supervisor decides to start several programs in one step, and each program begins when it has received its order. So a producer may
//! send a moment before its consumer has begun. The consumer gets the values that arrive after the decision to start it. Earlier values
//! are dropped, except for the last value of each latched wire. Calls wait in the [`CallTable`](comms::logic::object::CallTable).

use super::inbox::Arrived;
use comms::io::direct::Value;
use comms::logic::object::BEGIN_WITHIN;
use comms::logic::time::Time;
use std::collections::{BTreeMap, VecDeque};

/// The values that wait for the next activation.
#[derive(Debug, Default)]
pub(super) struct Early {
    /// By input, in the order of their arrival.
    samples: BTreeMap<&'static str, VecDeque<Arrived>>,
}

impl Early {
    /// Keeps a value that has come while nothing runs. A long value replaces all values of its input, because it lies in the memory of
    /// its producer.
    pub(super) fn keep(&mut self, sample: Arrived) {
        let is_long = matches!(sample.value, Value::Loaned(_));
        let others_max = if is_long { 0 } else { sample.hold.count_max.saturating_sub(1) };
        let waiting = self.samples.entry(sample.port).or_default();
        while let Some(first) = waiting.front()
            && (waiting.len() > others_max || sample.at.since(first.at) > BEGIN_WITHIN)
        {
            waiting.pop_front();
        }
        waiting.push_back(sample);
    }

    /// Returns the values for an activation that was decided at `since`, in the order of their arrival.
    pub(super) fn begin(&mut self, since: Time) -> Vec<Arrived> {
        let mut all = Vec::new();
        for mut waiting in std::mem::take(&mut self.samples).into_values() {
            let last = waiting.pop_back();
            all.extend(waiting.into_iter().filter(|sample| sample.at >= since));
            all.extend(last.filter(|sample| sample.at >= since || sample.hold.is_latched));
        }
        all.sort_by_key(|sample| sample.at);
        all
    }
}

#[cfg(test)]
mod tests {
    use super::super::inbox::Hold;
    use super::*;
    use comms::logic::control::Shape;
    use std::time::Duration;

    const DECIDED: Time = Time::from_nanos(10_000_000_000);

    fn sample(port: &'static str, number: u8, at: Time, shape: &Shape) -> Arrived {
        Arrived { port, value: vec![number].into(), at, wire: None, hold: Hold::of(shape) }
    }

    /// Returns the numbers that an activation gets.
    fn begun(early: &mut Early) -> Vec<u8> {
        let number = |sample: Arrived| match sample.value {
            Value::Own(bytes) => bytes[0],
            Value::Loaned(_) => panic!("the test has no shared memory"),
        };
        early.begin(DECIDED).into_iter().map(number).collect()
    }

    fn before(millis: u64) -> Time {
        DECIDED.before(Duration::from_millis(millis))
    }

    fn after(millis: u64) -> Time {
        DECIDED + Duration::from_millis(millis)
    }

    #[test]
    fn what_comes_after_the_decision_is_kept_in_order() {
        let mut early = Early::default();
        let shape = Shape::default();
        for (port, number, at) in [
            ("B", 1, before(2)),
            ("A", 2, before(1)),
            ("B", 3, DECIDED),
            ("A", 4, after(1)),
            ("B", 5, after(2)),
            ("A", 6, after(3)),
        ] {
            early.keep(sample(port, number, at, &shape));
        }
        assert_eq!(begun(&mut early), [3, 4, 5, 6]);
        assert!(begun(&mut early).is_empty(), "the next activation gets nothing of it");
    }

    #[test]
    fn a_latched_wire_keeps_its_last_value_and_what_comes_after_the_decision() {
        let mut early = Early::default();
        let latched = Shape { latch: true, ..Shape::default() };
        early.keep(sample("In", 1, before(9_000), &latched));
        early.keep(sample("In", 2, before(5_000), &latched));
        assert_eq!(begun(&mut early), [2]);
        early.keep(sample("In", 3, before(1), &latched));
        early.keep(sample("In", 4, after(1), &latched));
        early.keep(sample("In", 5, after(2), &latched));
        assert_eq!(begun(&mut early), [4, 5]);
    }

    #[test]
    fn a_queue_keeps_no_more_than_it_has_room_for() {
        let mut early = Early::default();
        let short = Shape { queue: Some(2), ..Shape::default() };
        (0..5).for_each(|number| early.keep(sample("In", number, after(number.into()), &short)));
        assert_eq!(begun(&mut early), [3, 4]);
        let long = Shape { queue: Some(1_000), ..Shape::default() };
        (0..100).for_each(|number| early.keep(sample("In", number, after(100 * u64::from(number)), &long)));
        assert_eq!(early.samples["In"].len(), 11, "a second of values waits");
    }
}
