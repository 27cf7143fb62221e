//! Ramps: rate limits and the trapezoid.

/// Returns `from` moved towards `to` by at most `step`, which is not negative.
pub fn towards(from: f64, to: f64, step: f64) -> f64 {
    from + (to - from).clamp(-step.max(0.0), step.max(0.0))
}

/// Returns `from` moved straight towards `to`, as far as no axis moves by more than its step. So
/// the direction stays the same. A separate limit for each axis would change the direction.
pub fn towards_together<const N: usize>(from: &[f64; N], to: &[f64; N], steps: &[f64; N]) -> [f64; N] {
    let too_far = |i: usize| (to[i] - from[i]).abs() / steps[i].max(f64::MIN_POSITIVE);
    let share = 1.0 / (0..N).map(too_far).fold(1.0, f64::max);
    std::array::from_fn(|i| if share < 1.0 { from[i] + (to[i] - from[i]) * share } else { to[i] })
}

/// A straight motion at rest at both ends: constant acceleration, cruise, constant deceleration.
///
/// Source: Biagiotti and Melchiorri, "Trajectory Planning for Automatic Machines and Robots", 2008, section 3.2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trapezoid {
    length: f64,
    speed: f64,
    acceleration: f64,
}

impl Trapezoid {
    /// Returns the motion over `length` (m) at most at `speed` (m/s) with `acceleration` (m/s²), all positive.
    pub fn new(length: f64, speed: f64, acceleration: f64) -> Self {
        Self { length, speed: speed.min((length * acceleration).sqrt()), acceleration }
    }

    /// Returns how long it takes (s).
    pub fn duration(&self) -> f64 {
        self.length / self.speed + self.speed / self.acceleration
    }

    /// Returns the speed (m/s) at `time` (s) since the start; zero before and after.
    pub fn speed_at(&self, time: f64) -> f64 {
        let left = (self.duration() - time).min(time);
        (self.acceleration * left).clamp(0.0, self.speed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn covers_its_length() {
        for (length, speed) in [(0.25, 0.03), (0.001, 0.5)] {
            let motion = Trapezoid::new(length, speed, 0.2);
            let n = 20_000;
            let dt = motion.duration() / f64::from(n);
            let travelled: f64 = (0..n).map(|i| motion.speed_at((f64::from(i) + 0.5) * dt) * dt).sum();
            // The midpoint rule is exact but in the two steps with a corner: an error of a dt² each.
            assert!((travelled - length).abs() < 2.0 * 0.2 * dt * dt + 1e-12, "{travelled}");
        }
    }

    #[test]
    fn together_they_keep_the_direction() {
        let (from, to) = ([1.0, -2.0, 0.5], [4.0, -1.0, 0.5]);
        let got = towards_together(&from, &to, &[0.3, 0.5, 0.1]);
        // The first axis is the slowest to arrive: a tenth of the way.
        for i in 0..3 {
            assert!((got[i] - (from[i] + 0.1 * (to[i] - from[i]))).abs() < 1e-12, "{got:?}");
        }
        let near = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12);
        assert!(near(towards_together(&from, &to, &[3.0, 1.0, 0.0]), to));
        assert!(near(towards_together(&from, &to, &[0.0; 3]), from));
    }

    #[test]
    fn never_overshoots() {
        assert!((towards(0.0, 1.0, 0.3) - 0.3).abs() < 1e-15);
        assert!((towards(0.9, 1.0, 0.3) - 1.0).abs() < 1e-15);
        assert!((towards(0.5, -1.0, 0.3) - 0.2).abs() < 1e-15);
    }
}
