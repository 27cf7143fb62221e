//! Unloading: a hand that stops lets go of the force that it had.
//!
//! An arm that only stops stays tensioned against the held object: after a locked door it still pressed with 64 N. So
//! the arm gives way until the force is nearly zero. A stiff grasp or a pressed lever pushes less and less on the way.
//! A door closer keeps pushing, and giving way to it only shuts the door. So the hand then returns to the place where
//! its force had last fallen, and holds the door there.
//!
//! Source: ours; an admittance as in [`super::compliant`], which explains the value of its gain.

use super::filter::Debounce;
use super::oscillation::OscillationGuard;
use nalgebra::{Vector3, Vector6};

/// The gain for forces (m/s/N) and torques (rad/s/Nm), and the largest speeds (m/s, rad/s).
const GAIN: f64 = 1.0 / 450.0;
const TURN: f64 = 0.06;
const SPEED_MAX: f64 = 0.04;
const TURN_MAX: f64 = 0.2;
/// A hand that feels less than the first at the beginning has nothing to let go of (N); it has let go once it feels
/// less than the second so many times in a row.
const LOADED: f64 = 7.0;
const AT_EASE: f64 = 3.5;
const IN_A_ROW: u32 = 5;
/// Over this distance (m) a tensioned force falls by at least this much (N): 170 N/m, below the spring of a lever.
const STRETCH: f64 = 0.012;
const FALL: f64 = 2.0;
/// The longest way (m) and time (s).
const WAY_MAX: f64 = 0.06;
const TIME_MAX: f64 = 2.6;
/// A force that is smaller than before by this much has fallen (N): more than noise.
const FALLEN: f64 = 1.0;
/// The gain and the largest speed with which the hand goes back (1/s, m/s), and how near is there (m). It goes back
/// more slowly the more its force is greater than it was at first, and not at all with so much more (N): friction and
/// the leaf's inertia.
const BACK_GAIN: f64 = 12.0;
const BACK_MAX: f64 = 0.05;
const BACK_AT: f64 = 0.001;
const BACK_HARDER: f64 = 20.0;

/// A hand that unloads itself.
#[derive(Clone, Debug, PartialEq)]
pub struct Unloading {
    guard: OscillationGuard,
    at_ease: Debounce,
    way: f64,
    time: f64,
    /// The way and the force (N) at the last look whether the force falls.
    looked: Option<(f64, f64)>,
    /// From where it began to where the hand is (m, tool axes).
    place: Vector3<f64>,
    least: Option<Least>,
    goes_back: bool,
    is_over: bool,
}

/// The place (m, tool axes) at which a force had last fallen, its size there, and its size at first (N).
#[derive(Clone, Copy, Debug, PartialEq)]
struct Least {
    place: Vector3<f64>,
    force: f64,
    first: f64,
}

impl Default for Unloading {
    fn default() -> Self {
        let (guard, at_ease) = (OscillationGuard::default(), Debounce::new(IN_A_ROW));
        let (place, least) = (Vector3::zeros(), None);
        Self { guard, at_ease, way: 0.0, time: 0.0, looked: None, place, least, goes_back: false, is_over: false }
    }
}

impl Unloading {
    /// Returns the velocity (m/s, rad/s, tool axes) that takes the load off a hand that feels `wrench_in_tool` (N, Nm),
    /// `dt` (s) after the last call; none once it is over.
    pub fn update(&mut self, wrench_in_tool: &Vector6<f64>, dt: f64) -> Option<Vector6<f64>> {
        let force: Vector3<f64> = wrench_in_tool.fixed_rows::<3>(0).into();
        let torque: Vector3<f64> = wrench_in_tool.fixed_rows::<3>(3).into();
        let (size, share) = (force.norm(), self.guard.update(&force, dt));
        let (way, before) = *self.looked.get_or_insert((0.0, size));
        let least = self.least.get_or_insert(Least { place: self.place, force: size, first: size });
        if size < least.force - FALLEN {
            (least.place, least.force) = (self.place, size);
        }
        let least = *least;
        self.is_over |= self.time <= 0.0 && size < LOADED;
        self.time += dt;
        if self.way - way >= STRETCH {
            // A growing force comes from something other than a door closer, and is not pushed back.
            self.is_over |= size - before > FALL;
            self.goes_back |= before - size < FALL;
            self.looked = Some((self.way, size));
        }
        let eased = !self.goes_back && self.at_ease.update(size < AT_EASE);
        self.is_over |= eased || self.way > WAY_MAX || self.time > TIME_MAX || !size.is_finite();
        let twist = match self.goes_back {
            _ if self.is_over => None,
            true => self.back(&least, size, share),
            false => {
                let linear = (force * GAIN * share).cap_magnitude(SPEED_MAX);
                let angular = (torque * TURN * share).cap_magnitude(TURN_MAX);
                Some(Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z))
            }
        };
        let linear = twist.map_or_else(Vector3::zeros, |twist| twist.fixed_rows::<3>(0).into());
        (self.place, self.way) = (self.place + linear * dt, self.way + linear.norm() * dt);
        self.is_over |= twist.is_none();
        twist
    }

    /// Returns the velocity (m/s, rad/s, tool axes) back to the place where the force was `least`; none once the hand
    /// is there.
    fn back(&self, least: &Least, size: f64, share: f64) -> Option<Vector6<f64>> {
        let missing = least.place - self.place;
        let slower = (1.0 - (size - least.first) / BACK_HARDER).clamp(0.0, 1.0) * share;
        let linear = (missing * BACK_GAIN).cap_magnitude(BACK_MAX) * slower;
        (missing.norm() >= BACK_AT).then(|| Vector6::new(linear.x, linear.y, linear.z, 0.0, 0.0, 0.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 0.01;
    /// From the sensor to the motion of the hand (steps).
    const DELAY: usize = 4;

    /// A hand against a spring of `stiffness` (N/m) and a `constant` force (N): returns the remaining force, the
    /// distance (m) and the time (s).
    fn unloaded(stiffness: f64, load: f64, constant: f64) -> (f64, f64, f64) {
        let (mut unloading, mut felt) = (Unloading::default(), vec![load + constant; DELAY]);
        let (mut at, mut time) = (0.0, 0.0);
        loop {
            let Some(twist) = unloading.update(&(Vector6::z() * felt.remove(0)), DT) else {
                return ((load - stiffness * at).max(0.0) + constant, at, time);
            };
            at += twist[2] * DT;
            time += DT;
            felt.push((load - stiffness * at).max(0.0) + constant);
            assert!(time < 5.0, "it never ends");
        }
    }

    #[test]
    fn what_is_wound_up_is_let_go_of() {
        // Soft and stiff grasps, and the spring of a lever.
        for (stiffness, load) in [(6000.0, 64.0), (6000.0, 20.0), (48_000.0, 100.0), (600.0, 20.0)] {
            let (left, way, time) = unloaded(stiffness, load, 0.0);
            assert!(left < 4.0 && way < WAY_MAX && time < TIME_MAX, "{stiffness} N/m: {left} N, {way} m, {time} s");
        }
    }

    #[test]
    fn what_pushes_on_is_held_where_it_was() {
        // A door closer alone, then one in a grasp that is wound up by 3 mm and 5 mm: those are let go of.
        for (load, wound_up) in [(0.0, 0.0), (18.0, 0.003), (30.0, 0.005)] {
            let (left, way, time) = unloaded(6000.0, load, 12.0);
            assert!((left - 12.0).abs() < 2.5, "{load} N: {left} N");
            // The delay adds the distance that the hand covers in it.
            assert!((way - wound_up).abs() < 0.003 && time < TIME_MAX, "{load} N: {way} m, {time} s");
        }
    }

    #[test]
    fn what_pushes_harder_and_harder_is_not_pushed_back() {
        let (mut unloading, mut at, mut furthest, mut force) = (Unloading::default(), 0.0, 0.0_f64, 40.0);
        while let Some(twist) = unloading.update(&(Vector6::z() * force), DT) {
            at += twist[2] * DT;
            furthest = furthest.max(at);
            force += 15.0 * DT;
        }
        assert!(at >= furthest && at < 1.2 * STRETCH, "{at} of {furthest} m");
    }

    #[test]
    fn a_free_hand_stays_where_it_is() {
        assert_eq!(Unloading::default().update(&(Vector6::x() * 6.0), DT), None);
        assert_eq!(Unloading::default().update(&(Vector6::x() * f64::NAN), DT), None);
    }
}
