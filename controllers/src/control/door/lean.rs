//! How hard the hand leans on the door: the largest pull rises slowly while the door does not move, and after the door has moved.
//!
//! A hand that leans as hard as it may on a door that stands still is stalled after a while.

use crate::control::filter::LowPass;
use crate::control::swing::{Attempt, PULL_MAX, TOTAL_MAX};

/// The rate at which a door is leant on harder (N/s).
const LEAN: f64 = 15.0;
/// The same for a door that is pushed, once it goes and slows the hand down, up to that force (N/s, N).
const LEAN_SLOWLY: f64 = 4.0;
const PUSH_EASY: f64 = 58.0;
/// Below the largest pull, the range in which the hand slows down (N).
pub(super) const PULL_FADE: f64 = 25.0;
/// The frequency below which a part of the pull counts as slow (Hz).
const PULL_SLOW: f64 = 0.3;
/// The time in which a stall does not count after the begin of an attempt (s).
const RAMP: f64 = 1.0;
/// A pull this far below the largest does not move the door (N).
const STALL_PULL: f64 = 12.0;
const STALL_TIME: f64 = 0.5;

/// The pull on the door in the present attempt.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Lean {
    /// The pull at which the hand stops without a force beside the path (N).
    pull_max: f64,
    slow: LowPass<1>,
    beside: LowPass<1>,
    /// The time of this attempt, and of its present stall (s).
    time: f64,
    stalled: f64,
}

/// The state of a hand that leans on a door.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Leaning {
    /// The slow part of the pull (N).
    pub(super) slow_pull: f64,
    /// The pull at which the hand stops now and finally (N).
    pub(super) most: f64,
    pub(super) hardest: f64,
    /// Whether the hand stands still.
    pub(super) is_still: bool,
    /// Whether the door has come, and whether it is pushed.
    pub(super) has_come: bool,
    pub(super) is_pushed: bool,
}

impl Lean {
    /// Begins an attempt.
    pub(super) fn new(limits: Attempt) -> Self {
        let pull_max = limits.pull.min(PULL_MAX.0);
        Self { pull_max, slow: LowPass::new(PULL_SLOW), beside: LowPass::new(PULL_SLOW), time: 0.0, stalled: 0.0 }
    }

    /// Begins another attempt. The force beside the path is known.
    pub(super) fn restart(&mut self, limits: Attempt) {
        *self = Self { beside: self.beside, ..Self::new(limits) };
    }

    /// Lets `dt` (s) pass.
    pub(super) fn pass(&mut self, dt: f64) {
        self.time += dt;
    }

    /// Takes the pull (N), `dt` (s) after the last one, and returns the slow part of it.
    pub(super) fn feel(&mut self, pull: f64, dt: f64) -> f64 {
        let [slow] = self.slow.update(&[pull], dt);
        slow
    }

    /// Returns the pull at which the hand stops now (N), with a force `beside` the path (N).
    pub(super) fn most(&mut self, beside: f64, limits: Attempt, dt: f64) -> f64 {
        let [beside] = self.beside.update(&[beside.min(TOTAL_MAX)], dt);
        let total = limits.total;
        self.pull_max.min((total.powi(2) - beside.min(total).powi(2)).sqrt())
    }

    /// Leans harder on a door that does not move, and counts for how long that is of no use.
    pub(super) fn lean(&mut self, leaning: &Leaning, dt: f64) {
        let Leaning { slow_pull, most, hardest, is_still, has_come, is_pushed } = *leaning;
        if has_come && self.pull_max < PULL_MAX.0 {
            self.pull_max = (self.pull_max + LEAN * dt).min(PULL_MAX.0);
        }
        let lags = is_pushed && has_come && slow_pull > most - PULL_FADE;
        if lags && self.pull_max < PUSH_EASY {
            self.pull_max = (self.pull_max + LEAN_SLOWLY * dt).min(PUSH_EASY);
        }
        let stalls = self.time > RAMP && slow_pull > most - STALL_PULL && is_still;
        if stalls && self.pull_max < hardest.min(most + 1.0) {
            self.pull_max = (self.pull_max + LEAN * dt).min(hardest);
        } else {
            self.stalled = if stalls { self.stalled + dt } else { (self.stalled - dt).max(0.0) };
        }
    }

    /// Returns whether leaning has been of no use for long enough.
    pub(super) const fn is_stalled(&self) -> bool {
        self.stalled > STALL_TIME
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::swing::HARD;

    fn stuck(most: f64) -> Leaning {
        Leaning { slow_pull: most, most, hardest: HARD.pull, is_still: true, has_come: false, is_pushed: false }
    }

    /// The hand leans harder until it may not lean harder, and is stalled half a second after that.
    #[test]
    fn it_leans_harder_and_then_gives_up() {
        let mut lean = Lean::new(HARD);
        let (mut most, mut steps) = (lean.most(0.0, HARD, 0.01), 0);
        assert!(most <= PULL_MAX.0);
        while !lean.is_stalled() {
            lean.pass(0.01);
            most = lean.most(0.0, HARD, 0.01);
            lean.lean(&stuck(most), 0.01);
            steps += 1;
            assert!(steps < 1000, "{most} N");
        }
        assert!((most - HARD.pull.min(HARD.total)).abs() < 1.0, "{most} N");
        // A hand that moves is not stalled, and the next attempt begins again.
        lean.lean(&Leaning { is_still: false, ..stuck(most) }, 0.1);
        assert!(!lean.is_stalled());
        lean.restart(HARD);
        assert!(lean.most(0.0, HARD, 0.01) <= PULL_MAX.0);
    }

    /// A force beside the path leaves less for the pull.
    #[test]
    fn a_force_beside_the_path_takes_from_the_pull() {
        let mut lean = Lean::new(HARD);
        let most: Vec<f64> = (0..1000).map(|_| lean.most(HARD.total, HARD, 0.01)).collect();
        assert!(most[0] > 40.0 && most[999] < 5.0, "{most:?}");
    }
}
