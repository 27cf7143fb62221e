//! The wrist sensor: low-pass, offset, noise; can be set to zero.

use crate::control::filter::LowPass;
use crate::sdk::Random;

const CUTOFF: f64 = 60.0;
const FORCE_NOISE: f64 = 0.4;
const TORQUE_NOISE: f64 = 0.02;
/// Samples of 1 ms averaged when it is set to zero.
const ZERO_SAMPLES: u32 = 100;

/// The sensor's state; wrenches are force (N), then torque (Nm), tool axes.
#[derive(Clone, Debug)]
pub struct ForceTorque {
    filter: LowPass<6>,
    filtered: [f64; 6],
    offset: [f64; 6],
    zero: [f64; 6],
    zeroing: Option<(u32, [f64; 6])>,
    zeroed: u32,
}

impl ForceTorque {
    /// Returns a sensor with a random offset of a few newtons.
    pub fn new(random: &mut Random) -> Self {
        let offset = std::array::from_fn(|i| if i < 3 { random.between(-3.0, 3.0) } else { random.between(-0.1, 0.1) });
        let filter = LowPass::new(CUTOFF);
        Self { filter, filtered: [0.0; 6], offset, zero: [0.0; 6], zeroing: None, zeroed: 0 }
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
        std::array::from_fn(|i| {
            let noise = random.normal(if i < 3 { FORCE_NOISE } else { TORQUE_NOISE });
            self.filtered[i] + self.offset[i] - self.zero[i] + noise
        })
    }
}
