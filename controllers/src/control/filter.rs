//! Small filters: low-pass, spikes, debounce.

use nalgebra::Vector6;

/// A first-order low-pass filter for steps of different lengths.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LowPass<const N: usize> {
    cutoff: f64,
    state: [f64; N],
}

impl<const N: usize> LowPass<N> {
    /// Returns a filter with its -3 dB point at `cutoff` (Hz), at rest at zero.
    pub const fn new(cutoff: f64) -> Self {
        Self { cutoff, state: [0.0; N] }
    }

    /// Returns the filtered value after `dt` (s) of `input`: exact for an input that is constant over the step.
    pub fn update(&mut self, input: &[f64; N], dt: f64) -> [f64; N] {
        let share = 1.0 - (-std::f64::consts::TAU * self.cutoff * dt).exp();
        for (state, input) in self.state.iter_mut().zip(input) {
            *state += share * (input - *state);
        }
        self.state
    }
}

/// A force that differs by more than this from the previous one (N) is a spike of the sensor, unless the next sample
/// confirms it. For comparison: a hand at 18 mm/s against 64 kN/m raises the force by 9 N in 8 ms.
const JUMP: f64 = 15.0;

/// Replaces single wrong readings of a force sensor by the previous reading. A true jump is reported one sample late.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Despike {
    last: Option<Vector6<f64>>,
    doubted: bool,
}

impl Despike {
    /// Takes a wrench (N, Nm); returns the filtered wrench.
    pub fn update(&mut self, wrench: &Vector6<f64>) -> Vector6<f64> {
        let jumps = |last: &Vector6<f64>| (wrench - last).fixed_rows::<3>(0).norm() > JUMP;
        self.doubted = !self.doubted && self.last.as_ref().is_some_and(jumps);
        if !self.doubted {
            self.last = Some(*wrench);
        }
        self.last.unwrap_or(*wrench)
    }

    /// Returns the last accepted wrench (N, Nm); none before the first wrench.
    pub fn last(&self) -> Option<Vector6<f64>> {
        self.last
    }
}

/// Accepts a condition once it has been true often enough in a row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Debounce {
    needed: u32,
    seen: u32,
}

impl Debounce {
    /// Returns a filter that needs `needed` true values in a row.
    pub const fn new(needed: u32) -> Self {
        Self { needed, seen: 0 }
    }

    /// Takes one value; returns whether there were enough true values in a row.
    pub fn update(&mut self, yes: bool) -> bool {
        self.seen = if yes { self.seen.saturating_add(1) } else { 0 };
        self.is_sure()
    }

    /// Returns whether the last values were enough true values in a row.
    pub fn is_sure(&self) -> bool {
        self.seen >= self.needed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn step_response() {
        // After one time constant the response is 1 - 1/e, for any step size.
        let tau = 1.0 / (std::f64::consts::TAU * 5.0);
        for steps in [1, 7] {
            let mut filter = LowPass::<1>::new(5.0);
            let last = (0..steps).map(|_| filter.update(&[1.0], tau / f64::from(steps))[0]).last().unwrap();
            assert!((last - (1.0 - (-1.0f64).exp())).abs() < 1e-12);
        }
    }

    #[test]
    fn single_readings_that_are_far_off_do_not_count() {
        let mut despike = Despike::default();
        let got: Vec<f64> = [1.0, 100.0, 2.0, -60.0, 3.0, 40.0, 41.0, 42.0]
            .map(|force| despike.update(&Vector6::new(0.0, 0.0, force, 0.0, 0.0, 0.0)).z)
            .to_vec();
        assert_eq!(got, [1.0, 1.0, 2.0, 2.0, 3.0, 3.0, 41.0, 42.0], "a jump that stays is one sample late");
    }

    #[test]
    fn one_no_starts_over() {
        let mut debounce = Debounce::new(3);
        let got: Vec<bool> = [true, true, false, true, true, true].iter().map(|&yes| debounce.update(yes)).collect();
        assert_eq!(got, [false, false, false, false, false, true]);
    }
}
