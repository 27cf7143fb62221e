//! How far the door has certainly moved, without the motion of the wheels and of the grasp.

use super::SPEED;
use super::attempts::Attempts;
use crate::control::filter::LowPass;
use crate::control::steps::Steps;
use crate::control::swing::Swing;

/// The frequency of the low-pass filter of the pull (Hz).
const PULL_QUICK: f64 = 6.0;
/// A grasp gives by no more than the first value and is never taken for stiffer than the second (m/N). A measured
/// compliance is multiplied by `SOFTER`.
const SOFT: (f64, f64) = (1.0 / 3000.0, 1.0 / 20_000.0);
const SOFTER: f64 = 1.3;
/// The force from which the softness is measured (N).
const SOFT_FROM: f64 = 20.0;
/// The wheels are believed up to this much beyond the commanded motion of the hand (m/s).
const BELIEVED: f64 = 0.02;

/// The way of the handle in the present attempt.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Travel {
    /// (m).
    travelled: f64,
    steps: Steps,
    /// The way of the hand in this attempt (m), and the pull when it began (N).
    tried: f64,
    pull_from: Option<f64>,
    quick: LowPass<1>,
    /// The largest compliance of the grasp (m/N).
    soft: f64,
}

/// The motion of the hand along the path of the handle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct HandMotion {
    /// (m/s).
    pub(super) speed: f64,
    /// As it was commanded (m/s).
    pub(super) commanded: f64,
    /// With which the hand pulls (N).
    pub(super) pull: f64,
}

impl Default for Travel {
    fn default() -> Self {
        let quick = LowPass::new(PULL_QUICK);
        Self { travelled: 0.0, steps: Steps::default(), tried: 0.0, pull_from: None, quick, soft: SOFT.0 }
    }
}

impl Travel {
    /// Returns the way in the present attempt (m).
    pub(super) const fn travelled(&self) -> f64 {
        self.travelled
    }

    /// Returns whether the door has moved the way it is tried.
    pub(super) fn has_come(&self, attempts: &Attempts) -> bool {
        self.travelled > attempts.certain_way()
    }

    /// Takes a motion of `dt` (s), and returns the way of the handle in it (m). The wheels' motion counts only as far as the
    /// hand can have moved. Until the door has certainly moved, the possible play of the grasp is subtracted.
    pub(super) fn advance(&mut self, motion: &HandMotion, attempts: &Attempts, dt: f64) -> f64 {
        let HandMotion { speed, commanded, pull } = motion;
        let side = side(attempts.swing());
        let [quick] = self.quick.update(&[side * pull], dt);
        let moved = if self.has_come(attempts) {
            self.steps.take(speed * dt, commanded.max(0.0) * dt)
        } else {
            self.tried += speed.clamp(-SPEED, commanded.max(0.0) + BELIEVED) * dt;
            let strained = side * quick - *self.pull_from.get_or_insert(side * quick);
            (self.tried - strained.max(0.0) * self.soft - self.travelled).max(0.0)
        };
        self.travelled += moved;
        moved
    }

    /// Forgets the way of an attempt in this direction, and returns it (m). The hand that has strained a door that does not move has
    /// measured the give of its grasp.
    pub(super) fn restart(&mut self, swing: Swing) -> f64 {
        let [pull] = self.quick.update(&[0.0], 0.0);
        let strained = side(swing) * pull - self.pull_from.unwrap_or_default();
        if strained > SOFT_FROM {
            self.soft = self.soft.min((SOFTER * self.tried / strained).max(SOFT.1));
        }
        (self.tried, self.pull_from) = (0.0, None);
        std::mem::take(&mut self.travelled)
    }
}

/// +1 for a pull, -1 for a push.
const fn side(swing: Swing) -> f64 {
    match swing {
        Swing::Pull => 1.0,
        Swing::Push => -1.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::swing::Opens;

    /// A hand that strains a grasp of 3000 N/m and more has not moved the door. One without strain has.
    #[test]
    fn the_give_of_the_grasp_does_not_count() {
        let attempts = Attempts::new(Opens::Pull);
        let (mut strained, mut free) = (Travel::default(), Travel::default());
        for step in 0..200 {
            let pull = 3000.0 * 1e-4 * f64::from(step);
            let motion = HandMotion { speed: 0.01, commanded: 0.01, pull };
            strained.advance(&motion, &attempts, 0.01);
            free.advance(&HandMotion { pull: 0.0, ..motion }, &attempts, 0.01);
        }
        assert!(strained.travelled() < 1e-3 && !strained.has_come(&attempts), "{}", strained.travelled());
        assert!((free.travelled() - 0.02).abs() < 1e-3 && free.has_come(&attempts), "{}", free.travelled());
        assert!(free.restart(Swing::Pull) > 0.0 && free.travelled() == 0.0);
    }
}
