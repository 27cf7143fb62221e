//! The estimate of a hinge by the hand that holds the handle: the direction and the curvature of the handle's path.
//!
//! Fingers that hold a handle turn with it. So, seen from the hand, the handle keeps moving in the same direction. The
//! angle between this direction and the hand's axis is adapted by the force across the path, and the curvature of the
//! path by the torque about the vertical. Neither odometry nor a map is used, so slipping wheels do not falsify the
//! estimate.
//!
//! Convergence: let e be the error of the direction, k the stiffness across, g the compliance, v the speed. The force
//! across settles at v e / g within 1/(k g), then de/dt = -rate v² / g · e. So an error shrinks by exp(-rate/g · ∫v²
//! dt) as long as the hand moves. Here g is 1/2000 m/s/N, and up to 1/600 for forces that stay ([`super::compliant`]).
//! With the turning compliance c and the turning stiffness s, the error x of the curvature obeys x'' + c s x' + rate v²
//! s x = 0, which is stable for every positive rate. Without motion nothing is learnt.
//!
//! A hand that turns about the handle (see [`super::swivel`]) feels no such torque. It knows by how much it turns and
//! how the path curves, so both turns update the direction, and the force across adapts the curvature at the rate slow.
//! With k = 1/g, the errors e of the direction and c of the curvature obey e' = -rate v² k e + v c, c' = -slow v² k e.
//! This is stable for all positive rates, and aperiodic as long as 4 slow < rate² v k.
//!
//! Source: after Karayiannidis, Smith, Viña, Ögren and Kragic, "An adaptive control approach for opening doors and
//! drawers under uncertainties", IEEE Trans. Robotics 32(1), 2016: direction and axis in the frame of the hand, driven
//! by force and torque errors times the speed. The planar form, the projection and the rates are ours.

/// The rate at which the direction is adapted (rad/s per N and m/s).
const DIRECTION_RATE: f64 = 0.036;
/// The rate at which the curvature is adapted (1/m/s per Nm and m/s).
const CURVATURE_RATE: f64 = 2.0;
/// The rate at which the force across the path adapts the curvature (1/m/s per N and m/s).
const BEND_RATE: f64 = 0.06;
/// The share of the observed curvature that replaces the estimated one at each observation.
const SEEN: f64 = 0.1;
/// The greatest angle between the direction and the axis of the hand (rad): for a hand that turns
/// with the door, and for a hand that does not turn.
const BESIDE_MAX: (f64, f64) = (0.5, 1.5);
/// The range of the curvatures of doors (1/m): radii of 0.33 to 2 m.
const CURVATURE: (f64, f64) = (0.5, 3.0);
/// The estimated direction and curvature of the handle's path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hinge {
    /// The direction of the handle's path, counter-clockwise from the hand's axis (rad).
    beside: f64,
    /// The curvature of the path (1/m), not negative.
    curvature: f64,
}

impl Hinge {
    /// Returns the initial estimate: the handle moves along the hand's axis, on a circle of `radius` (m).
    pub fn new(radius: f64) -> Self {
        Self { beside: 0.0, curvature: (1.0 / radius.max(0.1)).clamp(CURVATURE.0, CURVATURE.1) }
    }

    /// Learns from `dt` (s) of motion at `speed` (m/s). `force_left` (N) is the force on the hand to the left of the
    /// path. `torque` (Nm) is the torque on the hand about the vertical, positive in the direction in which the door
    /// turns.
    pub fn update(&mut self, speed: f64, force_left: f64, torque: f64, dt: f64) {
        self.adapt(speed, force_left, dt, BESIDE_MAX.0);
        let curvature = self.curvature + CURVATURE_RATE * speed * torque * dt;
        self.curvature = curvature.clamp(CURVATURE.0, CURVATURE.1);
    }

    /// Learns like [`Hinge::update`], but from the force alone. In this time the hand has turned by `turned` (rad,
    /// counter-clockwise). `sense` is +1 if the door turns counter-clockwise, else -1.
    pub fn update_turning(&mut self, speed: f64, force_left: f64, turned: f64, sense: f64, dt: f64) {
        self.beside += sense * speed * self.curvature * dt - turned;
        self.adapt(speed, force_left, dt, BESIDE_MAX.1);
        let curvature = self.curvature + BEND_RATE * speed * sense * force_left * dt;
        self.curvature = curvature.clamp(CURVATURE.0, CURVATURE.1);
    }

    /// Takes the observed distance of the hinge (m); a distance that is not positive is ignored. If
    /// a hand estimates by the force alone, it needs the observation. Its estimate takes half of
    /// the path, and until then slipping wheels could not be distinguished from an unfinished
    /// estimate.
    pub fn see(&mut self, radius: f64) {
        if radius > 0.0 {
            self.curvature += SEEN * ((1.0 / radius).clamp(CURVATURE.0, CURVATURE.1) - self.curvature);
        }
    }

    /// A force to the left means that the hand is too far to the right, so the path leads further to the left.
    fn adapt(&mut self, speed: f64, force_left: f64, dt: f64, most: f64) {
        self.beside = (self.beside + DIRECTION_RATE * speed * force_left * dt).clamp(-most, most);
    }

    /// Returns the angle of the path, counter-clockwise from the hand's axis (rad).
    pub fn beside(&self) -> f64 {
        self.beside
    }

    /// Returns the distance of the hinge (m).
    pub fn radius(&self) -> f64 {
        1.0 / self.curvature
    }

    /// Returns the curvature of the handle's way (1/m).
    pub fn curvature(&self) -> f64 {
        self.curvature
    }
}

#[cfg(test)]
mod tests {
    use super::super::compliant::ACROSS;
    use super::*;

    /// A handle on a circle of `radius` (m), and a hand that starts askew by `askew` (rad): returns the estimate, and
    /// the largest force across in the last second.
    fn open(radius: f64, askew: f64, speed: f64, seconds: f64) -> (Hinge, f64) {
        let (stiffness, turning, gain, turn_gain, dt) = (6000.0, 8.0, 1.0 / ACROSS, 0.12, 2e-3);
        // The distance of the hand across the path, and the hand's yaw relative to the handle's yaw.
        let (mut off, mut yaw, mut late) = (0.0f64, askew, 0.0f64);
        let mut hinge = Hinge::new(0.7);
        let mut time = 0.0;
        while time < seconds {
            time += dt;
            let (force, torque) = (-stiffness * off, -turning * (yaw - askew));
            hinge.update(speed, force, torque, dt);
            // The deviation of the command from the tangent, plus the compliance.
            off += dt * (speed * (yaw + hinge.beside()) + force * gain);
            yaw += dt * (speed * (hinge.curvature() - 1.0 / radius) + torque * turn_gain);
            if time > seconds - 1.0 {
                late = late.max(force.abs());
            }
        }
        (hinge, late)
    }

    #[test]
    fn direction_and_radius_converge() {
        for radius in [0.5, 0.82, 1.2] {
            for askew in [-0.15, 0.0, 0.15] {
                let (hinge, late) = open(radius, askew, 0.12, 10.0);
                assert!((hinge.beside() + askew).abs() < 0.04, "{hinge:?} for {radius} m, {askew}");
                assert!((hinge.radius() / radius - 1.0).abs() < 0.16, "{hinge:?} for {radius} m, {askew}");
                assert!(late < 2.0, "{late} N");
            }
        }
    }

    #[test]
    fn a_hand_that_turns_by_itself_learns_by_the_force_alone() {
        let (stiffness, speed, dt) = (6000.0, 0.12, 2e-3);
        for sense in [1.0, -1.0] {
            for radius in [0.6, 0.82, 1.1] {
                // The hand's heading, the heading of the handle's path, and the distance of the hand across it (rad,
                // rad, m).
                let (mut hand, mut way, mut off) = (0.0f64, 0.1f64, 0.0f64);
                let (mut hinge, mut late) = (Hinge::new(0.7), 0.0f64);
                // Until the door is open by 1.2 rad.
                let ends = 1.2 * radius / speed;
                let mut time = 0.0;
                while time < ends {
                    time += dt;
                    let force = -stiffness * off;
                    let turned = 0.2 * f64::sin(time) * dt;
                    hinge.update_turning(speed, force, turned, sense, dt);
                    hand += turned;
                    way += sense * speed / radius * dt;
                    off += dt * (speed * (hand + hinge.beside() - way) + force / ACROSS);
                    if time > 0.8 * ends {
                        late = late.max(force.abs());
                    }
                }
                assert!((hand + hinge.beside() - way).abs() < 0.05 && late < 8.0, "{hinge:?} {radius} m, {late} N");
                assert!((hinge.radius() / radius - 1.0).abs() < 0.12, "{hinge:?} for {radius} m");
            }
        }
    }

    #[test]
    fn what_is_seen_is_learnt_at_once() {
        let mut hinge = Hinge::new(0.7);
        (0..40).for_each(|_| hinge.see(1.05));
        assert!((hinge.radius() - 1.05).abs() < 0.01, "{hinge:?}");
        for radius in [f64::NAN, 0.0, -1.0, 1e9] {
            hinge.see(radius);
            assert!((0.9..2.1).contains(&hinge.radius()), "{radius}: {hinge:?}");
        }
    }

    #[test]
    fn a_hand_that_stands_learns_nothing() {
        let mut hinge = Hinge::new(0.7);
        for _ in 0..10_000 {
            hinge.update(0.0, 20.0, 2.0, 2e-3);
        }
        assert_eq!(hinge, Hinge::new(0.7));
    }

    #[test]
    fn what_it_says_stays_a_door() {
        let mut hinge = Hinge::new(0.7);
        for _ in 0..10_000 {
            hinge.update(0.12, 500.0, -50.0, 2e-3);
        }
        assert!(hinge.beside() <= BESIDE_MAX.0 && hinge.radius() <= 2.0, "{hinge:?}");
    }
}
