//! Where a door turns, from where its handle has been.
//!
//! Recursive least squares on the circle through the first point: with d the way from there and theta the vector from
//! there to the hinge, `|d|² = 2 d·theta`. A prior says that the hinge lies along the door; points count only after
//! enough travel, for a hand that trembles on the spot knows nothing.
//!
//! Source: recursive least squares with a prior, Ljung, "System Identification", 1999, section 11.2; the circle equation
//! is ours.

use nalgebra::{Matrix2, Vector2};

const STEP_MIN: f64 = 0.002;
const ARC_MIN: f64 = 0.03;
const SIGMA: f64 = 0.0015;

/// The estimate.
#[derive(Clone, Debug, PartialEq)]
pub struct Hinge {
    start: Vector2<f64>,
    last: Vector2<f64>,
    to_hinge: Vector2<f64>,
    covariance: Matrix2<f64>,
    arc: f64,
}

impl Hinge {
    /// Returns the prior: the hand is at `start` (m), the hinge `radius` (m) away along the unit vector `along_door`.
    pub fn new(start: Vector2<f64>, along_door: Vector2<f64>, radius: f64) -> Self {
        let across = Vector2::new(-along_door.y, along_door.x);
        // The direction to the hinge is known better than its distance: deviations of 0.14 m and 0.30 m.
        let covariance = across * across.transpose() * 0.02 + along_door * along_door.transpose() * 0.09;
        Self { start, last: start, to_hinge: along_door * radius, covariance, arc: 0.0 }
    }

    /// Takes the hand's position (m), in the frame of the first.
    pub fn update(&mut self, hand: Vector2<f64>) {
        let step = (hand - self.last).norm();
        if step < STEP_MIN {
            return;
        }
        self.arc += step;
        self.last = hand;
        let d = hand - self.start;
        let x = d * 2.0;
        // An error of sigma across the circle changes |d|² - 2 d·theta by 2 |theta| sigma.
        let variance = 2.0 * (2.0 * self.to_hinge.norm().max(0.2) * SIGMA).powi(2);
        let gain = self.covariance * x / (variance + x.dot(&(self.covariance * x)));
        self.to_hinge += gain * (d.norm_squared() - x.dot(&self.to_hinge));
        self.covariance -= gain * x.transpose() * self.covariance;
    }

    /// Returns where the hinge is (m).
    pub fn centre(&self) -> Vector2<f64> {
        self.start + self.to_hinge
    }

    /// Returns how far it is from the handle (m).
    pub fn radius(&self) -> f64 {
        self.to_hinge.norm()
    }

    /// Returns whether the hand has moved far enough for the estimate to be more than the prior.
    pub fn is_valid(&self) -> bool {
        self.arc > ARC_MIN
    }

    /// Returns the angle about the hinge from the start to `hand` (rad), positive counter-clockwise, in (-pi, pi].
    pub fn angle(&self, hand: Vector2<f64>) -> f64 {
        let (from, to) = (-self.to_hinge, hand - self.centre());
        from.perp(&to).atan2(from.dot(&to))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_a_circle() {
        let (centre, radius) = (Vector2::new(0.1, 0.82), 0.82);
        let at = |angle: f64| centre + Vector2::new(-angle.sin(), -angle.cos()) * radius;
        let mut hinge = Hinge::new(at(0.0), Vector2::new(0.05, 1.0).normalize(), 0.70);
        assert!(!hinge.is_valid());
        for i in 1..=120 {
            hinge.update(at(f64::from(i) * 0.01));
        }
        // No noise: what is left is the prior's weight against 120 points, below a millimetre.
        assert!((hinge.radius() - radius).abs() < 1e-3 && hinge.is_valid());
        assert!((hinge.angle(at(1.2)) + 1.2).abs() < 2e-3);
    }

    #[test]
    fn trembling_teaches_nothing() {
        let mut hinge = Hinge::new(Vector2::zeros(), Vector2::y(), 0.70);
        for i in 0..1000 {
            hinge.update(Vector2::new(0.001 * f64::from(i % 2), 0.0));
        }
        assert!((hinge.radius() - 0.70).abs() < 1e-15 && !hinge.is_valid());
    }
}
