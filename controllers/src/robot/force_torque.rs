//! The wrist sensor: it has a low-pass filter, offset and noise, and can be set to zero.

use crate::control::filter::LowPass;
use crate::sdk::Random;

const CUTOFF: f64 = 60.0;
/// The number of samples of 1 ms that are averaged when the sensor is set to zero.
const ZERO_SAMPLES: u32 = 100;

/// The errors of the sensor's readings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Errors {
    /// The noise of each force (N, standard deviation).
    pub force_noise: f64,
    /// The noise of each torque (Nm, standard deviation).
    pub torque_noise: f64,
    /// Each force has an offset up to this (N), drawn once. Setting the sensor to zero removes it.
    pub offset: f64,
    /// The drift: a false force along the approach (N) that setting the sensor to zero does not remove.
    pub bias: f64,
    /// A false force across the approach in single readings (N); `spikes` is the share of such readings.
    pub spike: f64,
    /// The share of readings with a spike.
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

    /// Begins to set the sensor to zero, if it has been set to zero `after` times.
    pub fn set_zero(&mut self, after: u32) {
        if after == self.zeroed && self.zeroing.is_none() {
            self.zeroing = Some((0, [0.0; 6]));
        }
    }

    /// Returns how often the sensor has been set to zero.
    pub fn zeroed(&self) -> u32 {
        self.zeroed
    }

    /// Advances the sensor by `dt` (s) with `wrench` (N, Nm, tool axes) on the hand.
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

    /// Returns a reading with its errors (N, Nm, tool axes).
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
