//! The delay between the devices and their clients.

use crate::sdk::Random;
use comms::logic::time::Time;
use std::collections::VecDeque;
use std::time::Duration;

/// The delays of samples and commands between a device and its bus, in addition to the delays of the network.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Delays {
    /// The delays of the samples of arm, base, wrist, gripper, laser and camera.
    pub(super) state: [Duration; 6],
    /// The delay of commands.
    pub(super) command: Duration,
    /// Each delay is longer by a random time up to this.
    pub(super) jitter: Duration,
}

/// The largest number of values in transit at once; if there are more, the oldest is lost.
const CAPACITY: usize = 1000;

/// Values in transit, in order: no value overtakes another.
#[derive(Clone, Debug)]
pub(super) struct Delayed<T> {
    queue: VecDeque<(Time, T)>,
}

impl<T> Default for Delayed<T> {
    fn default() -> Self {
        Self { queue: VecDeque::new() }
    }
}

impl<T> Delayed<T> {
    /// Puts `value` in transit at `now`. It arrives `delay` later, plus a random time up to `jitter`.
    pub(super) fn put(&mut self, now: Time, value: T, delay: Duration, jitter: Duration, random: &mut Random) {
        // Without jitter no number is drawn, so the noise of a world stays the same.
        let jitter = if jitter.is_zero() { jitter } else { jitter.mul_f64(random.unit()) };
        let last = self.queue.back().map_or(Time::ZERO, |(at, _)| *at);
        if self.queue.len() == CAPACITY {
            self.queue.pop_front();
        }
        self.queue.push_back(((now + delay + jitter).max(last), value));
    }

    /// Returns the next value that has arrived.
    pub(super) fn take(&mut self, now: Time) -> Option<T> {
        self.queue.front().filter(|(at, _)| *at <= now)?;
        self.queue.pop_front().map(|(_, value)| value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_early_and_nothing_overtakes() {
        let at = |ms| Time::ZERO + Duration::from_millis(ms);
        let (mut way, mut random) = (Delayed::default(), Random::new(3));
        for number in 0..200u64 {
            let (delay, jitter) = (Duration::from_millis(20), Duration::from_millis(30));
            way.put(at(4 * number), number, delay, jitter, &mut random);
        }
        let mut arrived = Vec::new();
        for ms in 0..1000 {
            while let Some(number) = way.take(at(ms)) {
                assert!((4 * number + 20..=4 * number + 51).contains(&ms), "{number} at {ms}");
                arrived.push(number);
            }
        }
        assert_eq!(arrived, (0..200).collect::<Vec<_>>());
    }
}
