//! Detects a force that rises by more than its own noise.
//!
//! A fixed number of samples above a threshold sees touches that are noise: with 3.6 N of noise on each axis, three
//! samples in a row are beyond 5 N many times a second. So the noise is measured, from the differences between
//! successive samples. Means over several windows of increasing length are each compared with the threshold and with
//! the noise of such a mean. A stiff touch rises so quickly that the shortest window sees it; a soft touch needs a
//! longer window. A touch stays: if a mean vanishes without its largest samples, it is a spike of the sensor.
//!
//! Source: sliding windows of a generalised likelihood ratio, Basseville and Nikiforov, "Detection of Abrupt Changes",
//! 1993, section 2.4; the windows are ours.

use nalgebra::Vector3;
use std::collections::VecDeque;

/// Lengths of the windows, in samples.
const WINDOWS: [usize; 4] = [3, 6, 12, 24];
/// The number of largest samples that each window leaves out. The mean of its other samples has to be above the share
/// `STAYS` of the threshold.
const SPIKES: [usize; 4] = [2, 3, 4, 6];
const STAYS: f64 = 0.25;
/// The number of standard deviations that the noise of a mean of three axes exceeds once in some 10⁶ windows.
const SURE: f64 = 5.5;
/// The limit up to which a step counts as noise, as a multiple of the variance.
const SPIKE: f64 = 16.0;
/// The number of samples over which the noise is estimated, and the number of samples before which nothing is reported.
const MEMORY: f64 = 125.0;
const FIRST: u32 = 12;
/// The ratio of the mean of the steps to their median: for three axes it is 1.27, and a few samples may give less.
const MEDIAN_OF_STEPS: f64 = 1.8;
/// The least variance of a sensor whose first samples are equal (N²).
const VARIANCE_MIN: f64 = 1e-4;

/// Watches the samples of a force.
#[derive(Clone, Debug, PartialEq)]
pub struct Touch {
    /// The time after which a force is treated as part of the background (s). None if this never happens.
    forgets: Option<f64>,
    usual: Vector3<f64>,
    last: Option<Vector3<f64>>,
    before: Option<Vector3<f64>>,
    /// The variance along one axis (N²).
    variance: f64,
    count: u32,
    recent: VecDeque<Vector3<f64>>,
    first: Vec<Vector3<f64>>,
}

impl Touch {
    /// Begins. A force that stays for longer than `forgets` (s) becomes part of the background. With none, the
    /// background is zero.
    pub fn new(forgets: Option<f64>) -> Self {
        Self {
            forgets,
            usual: Vector3::zeros(),
            last: None,
            before: None,
            variance: 0.0,
            count: 0,
            recent: VecDeque::with_capacity(WINDOWS[WINDOWS.len() - 1]),
            first: Vec::new(),
        }
    }

    /// Takes a sample (N), `dt` (s) after the last one. Returns the mean force above the background, if it is larger
    /// than `threshold` (N) and more than noise. A sample that is not finite is skipped: its noise would hide every
    /// later touch.
    pub fn update(&mut self, force: &Vector3<f64>, threshold: f64, dt: f64) -> Option<Vector3<f64>> {
        if !force.norm_squared().is_finite() {
            return None;
        }
        self.count = self.count.saturating_add(1);
        if self.count < FIRST {
            self.first.push(*force);
            return None;
        }
        if self.count == FIRST {
            self.begin();
        }
        let share = |memory: f64| (1.0 / f64::from(self.count)).max(memory);
        if let Some(forgets) = self.forgets {
            self.usual += (self.middle(force) - self.usual) * share(1.0 - (-dt / forgets).exp());
        }
        if let Some(last) = self.last {
            // Two samples, three axes.
            let step = (force - last).norm_squared() / 6.0;
            // A spike counts as noise only up to a limit.
            let step = step.min(SPIKE * self.variance);
            self.variance += (step - self.variance) * (1.0 / f64::from(self.count - 1)).max(1.0 / MEMORY);
        }
        (self.before, self.last) = (self.last, Some(*force));
        if self.recent.len() == WINDOWS[WINDOWS.len() - 1] {
            self.recent.pop_front();
        }
        self.recent.push_back(force - self.usual);
        WINDOWS.iter().zip(SPIKES).find_map(|(&window, spikes)| {
            let mean = self.recent.iter().rev().take(window).sum::<Vector3<f64>>() / window as f64;
            let noise = (self.variance / window as f64).sqrt();
            let is_more = mean.norm() > threshold.max(SURE * noise);
            (is_more && self.stays(window, spikes, &mean) > STAYS * threshold).then_some(mean)
        })
    }

    /// Estimates the background and the noise from the first samples: their medians, so that no spike among them
    /// counts.
    fn begin(&mut self) {
        let first = std::mem::take(&mut self.first);
        if self.forgets.is_some() {
            self.usual = median(&first);
        }
        let steps = first.windows(2).map(|two| (two[1] - two[0]).norm_squared() / 6.0);
        self.variance = (MEDIAN_OF_STEPS * middle(steps.collect())).max(VARIANCE_MIN);
        self.recent.extend(first.iter().map(|force| force - self.usual));
        (self.before, self.last) = (first.iter().rev().nth(1).copied(), first.last().copied());
    }

    /// The median of a sample and the two before it, along each axis: a spike does not belong to the background.
    fn middle(&self, force: &Vector3<f64>) -> Vector3<f64> {
        let (Some(last), Some(before)) = (self.last, self.before) else { return *force };
        Vector3::from_fn(|i, _| {
            let mut three = [force[i], last[i], before[i]];
            three.sort_by(f64::total_cmp);
            three[1]
        })
    }

    /// The mean force along `mean` in the newest `window` samples without the largest `spikes` of them (N).
    fn stays(&self, window: usize, spikes: usize, mean: &Vector3<f64>) -> f64 {
        let along = mean.normalize();
        let mut forces: Vec<f64> = self.recent.iter().rev().take(window).map(|force| force.dot(&along)).collect();
        forces.sort_by(f64::total_cmp);
        forces.truncate(forces.len().saturating_sub(spikes).max(1));
        forces.iter().sum::<f64>() / forces.len() as f64
    }
}

/// Returns the median of some forces along each axis (N); not a number if there are none.
pub fn median(forces: &[Vector3<f64>]) -> Vector3<f64> {
    Vector3::from_fn(|i, _| middle(forces.iter().map(|force| force[i]).collect()))
}

fn middle(mut numbers: Vec<f64>) -> f64 {
    numbers.sort_by(f64::total_cmp);
    numbers.get(numbers.len() / 2).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sdk::Random;

    const DT: f64 = 0.008;

    /// A free hand for 12 s, then a touch that grows by `slope` (N/s). Returns the time until the touch is noticed (s),
    /// or why it is not.
    fn noticed(noise: f64, slope: f64, seed: u64) -> Result<f64, &'static str> {
        let (mut touch, mut random) = (Touch::new(Some(1.5)), Random::new(seed));
        // The constant force of a payload that the hand does not know.
        let weight = Vector3::new(2.0, -14.0, 1.0);
        for i in 0..3000 {
            let time = f64::from(i) * DT - 12.0;
            let pushed = Vector3::new(0.0, 0.0, -slope * time.max(0.0));
            let noise = Vector3::from_fn(|_, _| random.normal(noise));
            if touch.update(&(weight + pushed + noise), 5.0, DT).is_some() {
                return if time > 0.0 { Ok(time) } else { Err("noise") };
            }
        }
        Err("never")
    }

    #[test]
    fn noise_is_no_touch() {
        for noise in [0.1, 0.4, 1.2, 3.6] {
            for seed in 0..50 {
                let time = noticed(noise, 300.0, seed);
                assert!(time.is_ok_and(|time| time < 0.1), "{time:?} with {noise} N, seed {seed}");
            }
        }
    }

    /// The fingers closed on nothing before the hand was there.
    #[test]
    fn spikes_of_the_sensor_are_no_touch() {
        for (spike, share) in [(60.0, 0.01), (200.0, 0.005), (20.0, 0.01)] {
            for seed in 0..20 {
                let (mut touch, mut random) = (Touch::new(Some(1.5)), Random::new(seed));
                let mut noticed = None;
                for i in 0..2000 {
                    let pushed = if i < 1800 { 0.0 } else { 2.0 * f64::from(i - 1800) };
                    let spike = if random.unit() < share { spike } else { 0.0 };
                    let noise = Vector3::from_fn(|_, _| random.normal(0.4));
                    let force = Vector3::new(spike, 0.0, -pushed) + noise;
                    noticed = noticed.or(touch.update(&force, 5.0, DT).map(|_| i));
                }
                assert!(noticed.is_some_and(|i| (1800..1812).contains(&i)), "{spike} N, {share}, {seed}: {noticed:?}");
            }
        }
    }

    /// A spike in the first sample once became the background for a while, and raised the noise for longer.
    #[test]
    fn a_spike_in_the_first_samples_neither_is_a_touch_nor_hides_one() {
        for first in [vec![0], vec![1], vec![0, 1], vec![5], vec![11]] {
            for seed in 0..20 {
                let (mut touch, mut random) = (Touch::new(Some(1.5)), Random::new(seed));
                let noticed = (0..200).find(|i| {
                    let spike = if first.contains(i) { 60.0 } else { 0.0 };
                    let pushed = 2.0 * f64::from((i - 40).max(0));
                    let noise = Vector3::from_fn(|_, _| random.normal(0.4));
                    touch.update(&(Vector3::new(spike, 0.0, -pushed) + noise), 5.0, DT).is_some()
                });
                assert!(noticed.is_some_and(|i| (41..50).contains(&i)), "{first:?}, {seed}: {noticed:?}");
            }
        }
    }

    #[test]
    fn a_sample_that_is_not_finite_does_not_blind_it() {
        for number in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX] {
            let mut touch = Touch::new(Some(1.5));
            let free = Vector3::new(2.0, -14.0, 1.0);
            for i in 0..200 {
                let force = if i == 100 { Vector3::new(0.0, number, 0.0) } else { free };
                assert_eq!(touch.update(&force, 5.0, DT), None, "{number}");
            }
            let felt = (0..3).find_map(|_| touch.update(&(free + Vector3::z() * 20.0), 5.0, DT));
            assert!(felt.is_some_and(|force| force.norm() > 5.0), "{number}: {felt:?}");
        }
    }

    #[test]
    fn a_quiet_sensor_notices_a_stiff_touch_within_three_samples_of_the_threshold() {
        // 64 kN/m at 9 mm/s: 5 N after 8.7 ms.
        let time = noticed(0.05, 576.0, 1);
        assert!(time.is_ok_and(|time| time < 0.0087 + 3.0 * DT), "{time:?}");
        // A soft touch, 4 kN/m, 36 N/s: 5 N after 140 ms, and a tenth of it has been forgotten.
        let time = noticed(0.4, 36.0, 1);
        assert!(time.is_ok_and(|time| time < 0.2), "{time:?}");
    }
}
