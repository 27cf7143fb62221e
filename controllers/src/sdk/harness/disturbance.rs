//! The effects of a busy machine and a bad network on calculations and samples.

use std::time::Duration;

/// How bad the machine and the network are.
#[derive(Clone, Debug, PartialEq)]
pub struct Disturbance {
    /// The shortest transfer time of a sample.
    pub transfer: Duration,
    /// The largest additional transfer time, evenly distributed.
    pub transfer_jitter: Duration,
    /// The probability that a calculation is delayed.
    pub hold_chance: f64,
    /// The longest such delay. Delays are evenly distributed between a third of this time and this time.
    pub hold_max: Duration,
    /// The probability that a sample is lost.
    pub drop_chance: f64,
    /// The seed of the random numbers.
    pub seed: u64,
}

impl Disturbance {
    /// A quiet machine: 0.1 ms per hop, without delays or losses.
    pub const NONE: Self = Self {
        transfer: Duration::from_micros(100),
        transfer_jitter: Duration::ZERO,
        hold_chance: 0.0,
        hold_max: Duration::ZERO,
        drop_chance: 0.0,
        seed: 0,
    };

    /// Two busy cores: one calculation in 50 is delayed by 10 to 30 ms, and one sample in 200 is lost.
    pub const fn busy(seed: u64) -> Self {
        Self {
            transfer: Duration::from_micros(100),
            transfer_jitter: Duration::from_millis(1),
            hold_chance: 0.02,
            hold_max: Duration::from_millis(30),
            drop_chance: 0.005,
            seed,
        }
    }
}
