//! Values and calls that reach a controller before its activation begins.
//!
//! A supervisor decides to start several programs in one step, and each program begins when it has received its order. So a producer may
//! send, and a caller may call, a moment before the other program has begun. The controller gets all values that arrive after the
//! decision to start it, and calls wait up to a second for it. Earlier values are dropped, except for the last value of each latched
//! wire.

use super::inbox::{Arrived, ToServe};
use comms::io::direct::Value;
use comms::logic::time::Time;
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// How long an order to begin may take. A value is kept, and a call waits, for so long.
const BEGIN_WITHIN: Duration = Duration::from_secs(1);
/// The most calls that wait.
const CALLS_MAX: usize = 64;

/// The values and calls that wait for the next activation.
#[derive(Debug, Default)]
pub(super) struct Early {
    /// By input, in the order of their arrival.
    samples: BTreeMap<&'static str, VecDeque<Arrived>>,
    /// Each call with the time until which it waits.
    calls: VecDeque<(Time, ToServe)>,
}

impl Early {
    /// Keeps a value that has come while nothing runs. Of long values only the last one of an input is kept, because they lie in the
    /// memory of their producer.
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

    /// Lets a call wait for an activation, but at most for half of the time that its caller has left. Returns the call if
    /// too many calls already wait.
    pub(super) fn hold(&mut self, call: ToServe, now: Time) -> Option<ToServe> {
        if self.calls.len() >= CALLS_MAX {
            return Some(call);
        }
        let until = now + BEGIN_WITHIN.min(call.deadline.since(now) / 2);
        self.calls.push_back((until, call));
        None
    }

    /// Takes a call that has waited long enough, or any call if an activation runs. Calls whose callers have gone are dropped.
    pub(super) fn take_call(&mut self, now: Time, runs: bool) -> Option<ToServe> {
        self.calls.retain(|(_, call)| call.reply.is_wanted());
        let next = self.calls.iter().position(|(until, _)| runs || *until <= now)?;
        self.calls.remove(next).map(|(_, call)| call)
    }

    /// Returns when a call has waited long enough.
    pub(super) fn deadline(&self) -> Option<Time> {
        self.calls.iter().map(|(until, _)| *until).min()
    }
}

#[cfg(test)]
mod tests {
    use super::super::inbox::Hold;
    use super::*;
    use crate::sdk::export::RawReply;
    use comms::logic::control::Shape;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};

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
        Time::from_nanos(DECIDED.nanos() - millis * 1_000_000)
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

    #[test]
    fn a_call_waits_for_an_activation_but_not_for_ever() {
        let now = Time::from_nanos(1_000_000_000);
        let wanted = Arc::new(AtomicBool::new(true));
        let call = |name: &str, within: Duration, is_wanted: bool| {
            let wanted = Arc::clone(&wanted);
            let reply = RawReply::new(|_| (), move || is_wanted || wanted.load(Ordering::Relaxed));
            ToServe { name: name.to_owned(), argument: Vec::new(), deadline: now + within, reply }
        };
        let name = |taken: Option<ToServe>| taken.map(|call| call.name);
        let mut early = Early::default();
        assert!(early.hold(call("long", Duration::from_secs(9), true), now).is_none());
        assert!(early.hold(call("short", Duration::from_millis(100), false), now).is_none());
        assert_eq!(early.deadline(), Some(now + Duration::from_millis(50)));
        assert_eq!(name(early.take_call(now + Duration::from_millis(49), false)), None);
        assert_eq!(name(early.take_call(now + Duration::from_millis(50), false)).as_deref(), Some("short"));
        assert_eq!(
            name(early.take_call(now + Duration::from_millis(50), true)).as_deref(),
            Some("long"),
            "an activation runs"
        );
        assert!(early.hold(call("gone", Duration::from_secs(9), false), now).is_none());
        wanted.store(false, Ordering::Relaxed);
        assert_eq!(name(early.take_call(now + BEGIN_WITHIN, false)), None, "its caller has gone");
        (0..CALLS_MAX).for_each(|_| assert!(early.hold(call("one", Duration::from_secs(9), true), now).is_none()));
        assert_eq!(name(early.hold(call("more", Duration::from_secs(9), true), now)).as_deref(), Some("more"));
    }
}
