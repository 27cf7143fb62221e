//! The search for an object that is out of sight. First the hand moves back, because a near object does not fit the
//! image. Then it turns to both sides, further each time.
//!
//! Source: ours.

use super::ramp::towards;
use nalgebra::Vector6;

/// The time for which the hand first stands still and looks (s).
const STAND: f64 = 0.4;
/// The speed of the way back (m/s), and its length (m).
const BACK_SPEED: f64 = 0.06;
const BACK: f64 = 0.25;
/// The speed of the turns (rad/s), and the angles to which the hand turns, one after the other (rad, positive to the
/// left).
const TURN_SPEED: f64 = 0.3;
const SIDES: [f64; 5] = [0.35, -0.35, 0.8, -0.8, 0.0];
/// The acceleration of both motions (m/s², rad/s²).
const ACCELERATION: f64 = 0.4;

/// The state of the search.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Search {
    time: f64,
    back: f64,
    turned: f64,
    side: usize,
    speed: (f64, f64),
}

/// The result of a look that has found no handle anywhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Nowhere;

impl Search {
    /// Returns the velocity of the hand (m/s, rad/s, tool axes) for the next `dt` (s), with the vertical `up_in_tool`.
    ///
    /// # Errors
    /// If the search has looked everywhere.
    pub fn advance(&mut self, up_in_tool: &nalgebra::Vector3<f64>, dt: f64) -> Result<Vector6<f64>, Nowhere> {
        self.time += dt;
        let (mut linear, mut angular) = (0.0, 0.0);
        if self.time > STAND && self.back < BACK {
            linear = BACK_SPEED;
        } else if self.time > STAND {
            let Some(side) = SIDES.get(self.side) else { return Err(Nowhere) };
            let left = side - self.turned;
            if left.abs() < 0.02 {
                self.side += 1;
            }
            // The hand turns no faster than it can still brake.
            angular = left.signum() * TURN_SPEED.min((2.0 * ACCELERATION * left.abs()).sqrt());
        }
        let step = ACCELERATION * dt;
        self.speed = (towards(self.speed.0, linear, step), towards(self.speed.1, angular, step));
        self.back += self.speed.0 * dt;
        self.turned += self.speed.1 * dt;
        let turn = up_in_tool * self.speed.1;
        Ok(Vector6::new(0.0, 0.0, -self.speed.0, turn.x, turn.y, turn.z))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn it_looks_back_and_to_both_sides_and_gives_up() {
        let (mut search, mut back, mut turned, mut time, dt) = (Search::default(), 0.0, 0.0f64, 0.0, 0.02);
        let (mut left, mut right) = (0.0f64, 0.0f64);
        while let Ok(twist) = search.advance(&Vector3::y(), dt) {
            assert!(twist[2].abs() <= BACK_SPEED + 1e-9 && twist[4].abs() <= TURN_SPEED + 1e-9, "{twist}");
            (back, turned, time) = (back - twist[2] * dt, turned + twist[4] * dt, time + dt);
            (left, right) = (left.max(turned), right.min(turned));
            assert!(time < 40.0, "it looks for ever");
        }
        assert!((back - BACK).abs() < 0.02 && left > 0.75 && right < -0.75 && turned.abs() < 0.05, "{back} {turned}");
    }
}
