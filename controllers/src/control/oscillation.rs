//! Oscillation of a force loop, and the share of its gain that it may keep.
//!
//! The stability of a loop depends on the stiffness of the object in the hand, which is not known in advance: fingers
//! on a lever may be eight times as stiff as the budget of [`super::compliant`] assumes. A loop beyond its budget
//! swings to and fro, and the swings grow. So swings are counted. A swing counts if it is larger
//! than the noise, and comes soon after the previous swing. A single push or step is not a swing.
//! From the third swing on, each swing reduces the gain. The gain of a calm loop slowly recovers.
//!
//! Source: Dimeas and Aspragathos, "Online stability in human-robot cooperation with admittance control", IEEE Trans.
//! Haptics 9(2), 2016: an unstable contact is found by its oscillation, and the gain is adapted; the way of counting is
//! ours.

use super::filter::LowPass;
use nalgebra::Vector3;

/// The least size of a swing: in N, and in standard deviations of the noise.
const SWING: (f64, f64) = (8.0, 4.0);
/// The next swing follows within this time (s): at 2 Hz and more.
const SOON: f64 = 0.25;
/// From this number of swings in a row on, each swing reduces the gain.
const IN_A_ROW: u32 = 3;
/// The share of the gain that remains after such a swing, and the least share that always remains.
const LEFT: f64 = 0.75;
const SHARE_MIN: f64 = 0.12;
/// The rate at which the share of the gain recovers (1/s).
const BACK: f64 = 0.04;
const CUTOFF: f64 = 15.0;
/// The number of samples over which the noise is estimated.
const NOISE_SAMPLES: f64 = 60.0;

/// Swings of one axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Swings {
    /// The lowest and the highest force since the last turn (N).
    low: f64,
    high: f64,
    /// +1 while the force rises, -1 while it falls.
    sense: f64,
    since: f64,
    count: u32,
}

impl Swings {
    /// Takes a value, `dt` (s) after the last one. Returns whether it completes a swing that reduces the gain.
    fn update(&mut self, value: f64, swing: f64, dt: f64) -> bool {
        self.since += dt;
        (self.low, self.high) = (self.low.min(value), self.high.max(value));
        let (rises, falls) = (value - self.low > swing, self.high - value > swing);
        let turned = (rises && self.sense <= 0.0) || (falls && self.sense >= 0.0);
        if turned {
            self.count = if self.since < SOON { self.count + 1 } else { 1 };
            self.sense = if rises && self.sense <= 0.0 { 1.0 } else { -1.0 };
            (self.low, self.high, self.since) = (value, value, 0.0);
        }
        // During a rise, only the highest value is used. During a fall, only the lowest value is used.
        if self.sense > 0.0 {
            self.low = self.high;
        } else if self.sense < 0.0 {
            self.high = self.low;
        }
        turned && self.count >= IN_A_ROW
    }
}

/// Watches the force of a loop, and returns the share of its gain that the loop may keep.
#[derive(Clone, Debug, PartialEq)]
pub struct OscillationGuard {
    axes: [Swings; 3],
    filter: LowPass<3>,
    last: Option<Vector3<f64>>,
    /// The variance of the noise along one axis (N²).
    variance: f64,
    share: f64,
}

impl Default for OscillationGuard {
    fn default() -> Self {
        let axes = [Swings::default(); 3];
        Self { axes, filter: LowPass::new(CUTOFF), last: None, variance: 0.0, share: 1.0 }
    }
}

impl OscillationGuard {
    /// Takes a force (N), `dt` (s) after the last one. Returns the share of its gain that the loop may use, at most 1.
    pub fn update(&mut self, force: &Vector3<f64>, dt: f64) -> f64 {
        if let Some(last) = self.last.replace(*force) {
            self.variance += ((force - last).norm_squared() / 6.0 - self.variance) / NOISE_SAMPLES;
        }
        let swing = SWING.0.max(SWING.1 * self.variance.sqrt());
        let values = self.filter.update(&(*force).into(), dt);
        self.share = (self.share + BACK * dt).min(1.0);
        for (axis, value) in self.axes.iter_mut().zip(values) {
            if axis.update(value, swing, dt) {
                self.share = (self.share * LEFT).max(SHARE_MIN);
            }
        }
        self.share
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sdk::Random;

    const DT: f64 = 0.008;

    fn share_after(seconds: f64, force: impl Fn(f64) -> f64, noise: f64) -> f64 {
        let (mut guard, mut random, mut time, mut share) = (OscillationGuard::default(), Random::new(3), 0.0, 1.0);
        while time < seconds {
            time += DT;
            let noise = Vector3::from_fn(|_, _| random.normal(noise));
            share = guard.update(&(Vector3::new(force(time), 0.0, -3.0) + noise), DT);
        }
        share
    }

    #[test]
    fn a_push_a_step_and_noise_are_no_swing() {
        let forces: [fn(f64) -> f64; 3] =
            [|_| 0.0, |time| if time > 1.0 { 50.0 } else { 0.0 }, |time| 40.0 * (2.0 * time).sin()];
        for force in forces {
            for noise in [0.1, 1.2, 3.6] {
                let share = share_after(20.0, force, noise);
                assert!(share > 0.98, "{share} with {noise} N");
            }
        }
    }

    #[test]
    fn a_loop_that_swings_loses_gain_within_a_few_swings() {
        for hertz in [3.0, 8.0, 12.0] {
            let share = share_after(4.0 / hertz, |time| 20.0 * (std::f64::consts::TAU * hertz * time).sin(), 0.4);
            assert!(share < 0.6, "{share} at {hertz} Hz");
        }
    }
}
