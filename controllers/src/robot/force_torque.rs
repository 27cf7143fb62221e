//! The wrist sensor: low-pass, offset, noise; can be set to zero.

use crate::control::filter::LowPass;
use crate::sdk::Random;

const CUTOFF: f64 = 60.0;
/// Samples of 1 ms averaged when it is set to zero.
const ZERO_SAMPLES: u32 = 100;

/// The errors of its readings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Errors {
    /// Of each force (N, standard deviation).
    pub force_noise: f64,
    /// Of each torque (Nm, standard deviation).
    pub torque_noise: f64,
    /// Each force is off by up to this (N), drawn once; setting the sensor to zero takes it out.
    pub offset: f64,
    /// A force along the approach that is not there (N) and that setting to zero does not take out: drift.
    pub bias: f64,
    /// A false force across the approach in single readings (N), and the share of such readings.
    pub spike: f64,
    /// See above.
    pub spikes: f64,
}

/// The sensor's state; wrenches are force (N), then torque (Nm), tool axes.
#[derive(Clone, Debug)]
pub struct ForceTorque {
    errors: Errors,
    filter: LowPass<6>,
    filtered: [f64; 6],
    offset: [f64; 6],
    zero: [f64; 6],
    zeroing: Option<(u32, [f64; 6])>,
    zeroed: u32,
}

impl ForceTorque {
    /// Returns a sensor with a random offset.
    pub fn new(errors: Errors, random: &mut Random) -> Self {
        let span = |i| if i < 3 { errors.offset } else { 0.1 };
        let offset = std::array::from_fn(|i| random.between(-span(i), span(i)));
        let filter = LowPass::new(CUTOFF);
        Self { errors, filter, filtered: [0.0; 6], offset, zero: [0.0; 6], zeroing: None, zeroed: 0 }
    }

    /// Begins to set it to zero, if it has been `after` times.
    pub fn set_zero(&mut self, after: u32) {
        if after == self.zeroed && self.zeroing.is_none() {
            self.zeroing = Some((0, [0.0; 6]));
        }
    }

    /// Returns how often it has been set to zero.
    pub fn zeroed(&self) -> u32 {
        self.zeroed
    }

    /// Lets `dt` (s) pass with `wrench` on the hand.
    pub fn step(&mut self, wrench: &[f64; 6], dt: f64) {
        self.filtered = self.filter.update(wrench, dt);
        if let Some((count, sum)) = &mut self.zeroing {
            *count += 1;
            for (sum, (filtered, offset)) in sum.iter_mut().zip(self.filtered.iter().zip(&self.offset)) {
                *sum += filtered + offset;
            }
            if *count == ZERO_SAMPLES {
                self.zero = sum.map(|sum| sum / f64::from(ZERO_SAMPLES));
                self.zeroed += 1;
                self.zeroing = None;
            }
        }
    }

    /// Returns a reading.
    pub fn read(&self, random: &mut Random) -> [f64; 6] {
        let spike =
            if self.errors.spikes > 0.0 && random.unit() < self.errors.spikes { self.errors.spike } else { 0.0 };
        std::array::from_fn(|i| {
            let noise = random.normal(if i < 3 { self.errors.force_noise } else { self.errors.torque_noise });
            let bias = if i == 2 {
                self.errors.bias
            } else if i == 0 {
                spike
            } else {
                0.0
            };
            self.filtered[i] + self.offset[i] - self.zero[i] + bias + noise
        })
    }
}
