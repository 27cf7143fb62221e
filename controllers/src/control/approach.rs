//! The speed of a hand that approaches an object at a roughly known distance: fast over the free part of the path, then
//! slow until contact.
//!
//! The impact of the hand grows with its speed, its stiffness and the time until it stops: 7 mm/s and 50 ms are 22 N at
//! 64 kN/m.
//!
//! Source: ours; the braking distance assumes a constant deceleration.

use super::ramp::towards;

/// A straight path with two speeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Approach {
    /// The largest speed (m/s).
    pub fast: f64,
    /// The speed over the last part of the path (m/s).
    pub slow: f64,
    /// The length of the fast part (m).
    pub free: f64,
    /// The length of the whole path (m).
    pub length: f64,
    /// The acceleration and the deceleration (m/s²).
    pub acceleration: f64,
}

/// A position on the path, and the speed there.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Progress {
    /// The distance from the start of the path (m).
    pub travelled: f64,
    /// The present speed (m/s).
    pub speed: f64,
}

impl Approach {
    /// Returns the progress `dt` (s) after `at`. At the end of the path the speed is zero.
    pub fn advance(&self, at: Progress, dt: f64) -> Progress {
        let slow = self.slow.min(self.fast);
        let before = (self.free.min(self.length) - at.travelled).max(0.0);
        let wanted = (slow.powi(2) + 2.0 * self.acceleration * before).sqrt().min(self.fast);
        let to_end = (2.0 * self.acceleration * (self.length - at.travelled).max(0.0)).sqrt();
        let speed = towards(at.speed, wanted.min(to_end), self.acceleration * dt);
        if at.travelled >= self.length - 1e-4 {
            return Progress { speed: 0.0, ..at };
        }
        Progress { travelled: at.travelled + speed * dt, speed: speed.max(1e-4) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_slow_before_what_it_meets() {
        let way = Approach { fast: 0.04, slow: 0.007, free: 0.13, length: 0.25, acceleration: 0.1 };
        let (mut at, dt, mut time) = (Progress::default(), 0.01, 0.0);
        let mut fastest: f64 = 0.0;
        loop {
            let next = way.advance(at, dt);
            if next.speed <= 0.0 {
                break;
            }
            assert!((next.speed - at.speed).abs() <= 0.1 * dt + 1e-4, "{next:?}");
            // Euler steps brake a step late.
            assert!(next.travelled < 0.131 || next.speed < 0.0085, "{next:?}");
            fastest = fastest.max(next.speed);
            (at, time) = (next, time + dt);
            assert!(time < 30.0, "it never ends: {at:?}");
        }
        assert!((fastest - 0.04).abs() < 1e-9 && (at.travelled - 0.25).abs() < 1e-3, "{at:?}");
        // 0.13 m at 40 mm/s, 0.12 m at 7 mm/s, and the ramps.
        assert!((19.0..22.0).contains(&time), "{time}");
    }
}
