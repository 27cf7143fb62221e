//! How far a hand has moved, by its measured and by its commanded motion, which both arrive in bursts.
//!
//! A measured motion is used only up to the commanded motion, because wheels may spin. A commanded
//! motion is used only up to the measured motion.
//!
//! Source: ours.

/// A burst of motion is no longer than this (m).
const BURST: f64 = 0.02;

/// The measured and the commanded motion, each without the part that the other one has confirmed (m). On a busy
/// machine, samples and calculations come in bursts: if a measured step is longer than the commanded one, it contains
/// the rest of an earlier step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Steps {
    measured: f64,
    commanded: f64,
}

impl Steps {
    /// Takes the measured and the commanded motion since the last call (m). Returns the part that both confirm (m).
    pub fn take(&mut self, measured: f64, commanded: f64) -> f64 {
        (self.measured, self.commanded) = (self.measured + measured, self.commanded + commanded);
        let step = self.measured.min(self.commanded).max(0.0);
        self.measured = (self.measured - step).clamp(-BURST, BURST);
        self.commanded = (self.commanded - step).clamp(0.0, BURST);
        step
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// With samples 1 to 9 steps apart, as on a busy machine, a clamp of each step alone lost 40 % of the way.
    #[test]
    fn a_way_in_bursts_is_as_long_as_it_is() {
        let (mut steps, mut random, mut owed, mut went) = (Steps::default(), crate::sdk::Random::new(1), 0.0, 0.0);
        for _ in 0..1000 {
            owed += 1e-3;
            let step = if random.unit() < 0.2 { std::mem::take(&mut owed) } else { 0.0 };
            went += steps.take(step, 1e-3);
        }
        assert!((went - 1.0).abs() < BURST + 1e-9, "{went}");
        // Spinning wheels are not believed: the hand was commanded to go half as far.
        let mut steps = Steps::default();
        let went: f64 = (0..1000).map(|_| steps.take(2e-3, 1e-3)).sum();
        assert!((went - 1.0).abs() < 1e-9, "{went}");
        let went: f64 = (0..1000).map(|_| Steps::default().take(-1e-3, 1e-3)).sum();
        assert!(went <= 0.0, "{went}");
    }
}
