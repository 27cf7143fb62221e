//! The hinge as a landmark: a point that does not move, seen from a base that may be moved by something else than its
//! wheels.
//!
//! The place of the hinge follows from the hand at the handle, the direction of the leaf and its radius. These come
//! from the arm and the laser, not from the wheels. In the frame of the wheels the hinge has to stay in place. A base
//! that is turned from outside by d, about its own middle, sees the hinge move by d times its distance. So the apparent
//! motion divided by the distance is the possible turn of the base. Only a turn about the hinge itself, with the leaf
//! in the hand, is not noticed. A wrong wheel size also moves the hinge, by its error times the path; this counts as a
//! possible turn as well.
//!
//! Source: ours; a point landmark fixes two of the three coordinates of a pose, Thrun, Burgard, Fox, "Probabilistic
//! Robotics", 2005, section 7.5.

use nalgebra::Vector2;

/// The weight of the newest sweep in the mean place of the hinge: a mean over some five sweeps.
const SHARE: f64 = 0.3;
/// The least distance by which the apparent motion of the hinge is divided (m).
const NEAR: f64 = 0.3;

/// Where a hinge was and where it is now, in the odometry frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Landmark {
    /// Where the hinge was when the wall was last in sight (m, odometry frame).
    was: Option<Vector2<f64>>,
    is: Option<Vector2<f64>>,
    turned: f64,
}

impl Landmark {
    /// Takes where the hinge and the base are (m, odometry frame). While the wall is in sight, the present place of the
    /// hinge becomes the reference.
    pub fn update(&mut self, hinge: &Vector2<f64>, base: &Vector2<f64>, is_in_sight: bool) {
        let is = self.is.map_or(*hinge, |is| is + (hinge - is) * SHARE);
        self.is = Some(is);
        if is_in_sight {
            self.was = Some(is);
        }
        let off = self.was.map_or(0.0, |was| (is - was).norm());
        self.turned = off / (hinge - base).norm().max(NEAR);
    }

    /// Returns how far the base may have turned without its wheels since the wall was last in sight (rad).
    pub fn turned(&self) -> f64 {
        self.turned
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation2;

    /// A base that drives past a hinge for 4 s at 0.1 m/s and is turned by `rate` (rad/s) from outside. Returns the
    /// possible turn of the base (rad).
    fn turned(rate: f64, wheel_error: f64) -> f64 {
        let (hinge, mut base, mut yaw, mut believed) =
            (Vector2::new(0.8, 0.5), Vector2::zeros(), 0.0f64, Vector2::zeros());
        let mut landmark = Landmark::default();
        for sweep in 0..100 {
            let step = if sweep < 20 { 0.0 } else { 0.005 };
            yaw += if (20..40).contains(&sweep) { rate * 0.05 } else { 0.0 };
            base += Rotation2::new(yaw) * Vector2::new(step, 0.0);
            believed += Vector2::new(step * (1.0 + wheel_error), 0.0);
            let seen = Rotation2::new(-yaw) * (hinge - base);
            landmark.update(&(believed + seen), &believed, sweep < 20);
        }
        landmark.turned()
    }

    #[test]
    fn a_base_that_is_turned_sees_its_hinge_move() {
        assert!(turned(0.0, 0.0) < 1e-9);
        for rate in [-0.15, 0.1, 0.2] {
            assert!(turned(rate, 0.0) > 0.9 * f64::abs(rate), "{rate}: {}", turned(rate, 0.0));
        }
        // 40 cm with wheels that are wrong by 5 %: 2 cm at half a metre.
        assert!(turned(0.0, 0.05) < 0.06, "{}", turned(0.0, 0.05));
    }
}
