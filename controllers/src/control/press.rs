//! Pressing a lever handle that the hand already holds, until it yields.
//!
//! The hand goes straight down first. As the lever turns, it twists the hand, which shows the side to which the lever
//! points. Then the hand follows the arc of a lever of medium length and rolls with it. It gives way to every force except the vertical
//! force. So it does not need the length of the lever or the angle of its latch. The lever is down when it meets its stop, a force against
//! the motion that rises steeply, or when the force drops. Only the force along when it meets its stop, a force against the motion that
//! rises steeply, or when the force drops. Only the force along the arc is used. A base that slips or catches up pulls at the lever from
//! the side, and this force does not press the lever.
//!
//! Source: ours; constants found with the door model, for levers of 0.05 to 0.16 m that stop beyond 20 degrees.

use super::compliant::Compliance;
use super::filter::LowPass;
use nalgebra::{Isometry3, Vector3, Vector6};
use std::collections::VecDeque;

/// Speed of the hand (m/s).
pub const SPEED: f64 = 0.020;
/// The assumed distance from the lever's axis to the hand (m): a lever of medium length.
pub const LEVER: f64 = 0.10;
/// No lever goes down further (m).
pub const DEPTH_MAX: f64 = 0.16;
/// The twist of the hand (Nm) that shows to which side the lever points, and the twist that shows that this side was
/// wrong.
const TWIST: (f64, f64) = (0.2, 0.8);
/// First the hand gives way to the force left from closing the fingers, until it is below this (N), or for this time
/// (s).
const RELAX: (f64, f64) = (5.0, 1.0);
/// A lever that resists before this depth (m) does not go down.
const MOVES: f64 = 0.015;
/// A force above any that pressing a lever needs (N).
const FORCE_MAX: f64 = 45.0;
/// The force of a stop grows faster than this (N/m): a lever's spring has some 400, its stop and the fingers 2800 or
/// more.
const STOP_SLOPE: f64 = 1700.0;
/// The slope of a lever's spring stays below this (N/m).
const SPRING_SLOPE: f64 = 600.0;
/// The distance over which the slope is measured (m): at least the first value, and up to the second one with a noisy
/// sensor.
const SLOPE_WAY: (f64, f64) = (0.003, 0.008);
/// The number of standard deviations from which a slope is certain.
const SURE: f64 = 4.0;
/// The number of samples over which the noise is estimated.
const NOISE_SAMPLES: f64 = 60.0;
/// If the force has been this large (N) and drops below two fifths of its largest value, the lever has given way.
const DROP_FROM: f64 = 12.0;
/// A lever at its stop is eased until its force is at most this much above the force of its spring
/// (N), at this speed (m/s), for at most this time (s).
const EASE: f64 = 5.0;
const EASE_SPEED: f64 = 0.010;
const EASE_TIME: f64 = 0.6;
/// The roll of the hand as a share of the turn of the lever. The fingers slip a little on the lever, so the hand rolls
/// less.
pub const ROLL: f64 = 0.9;
const CUTOFF: f64 = 12.0;

/// The state of one pressing.
#[derive(Clone, Debug, PartialEq)]
pub struct Press {
    /// The height of the hand at which the press began (m); none until the hand has relaxed.
    height: Option<f64>,
    time: f64,
    give: Compliance,
    /// The horizontal direction to the robot's left (a unit vector, base axes).
    left: Vector3<f64>,
    /// The direction in which the lever points, once known.
    lever: Option<Vector3<f64>>,
    filter: LowPass<3>,
    /// Depths (m) and forces (N) of the last few millimetres, as they were measured.
    way: VecDeque<(f64, f64)>,
    largest: f64,
    /// At the stop: the force of the spring (N), and for how long the hand has eased since then (s).
    eases: Option<(f64, f64)>,
    /// The last sample of the force against the motion (N), and the variance of its noise (N²).
    last: Option<f64>,
    variance: f64,
}

/// The state of a press.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// On the way.
    Pressing,
    /// The lever is at its stop, or has given way.
    Down,
    /// The lever resists at once, or it never resists.
    Stuck,
}

/// The motion that the law asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Down {
    /// Velocity of the hand (m/s, rad/s, tool axes).
    pub twist_in_tool: Vector6<f64>,
    /// How far the hand has moved downwards (m).
    pub depth: f64,
    /// The state of the lever.
    pub state: State,
}

impl Press {
    /// Begins with the hand at `base_from_tool` (m, base frame), facing the door.
    pub fn new(base_from_tool: &Isometry3<f64>) -> Self {
        let ahead = base_from_tool.rotation * Vector3::z();
        let left = Vector3::z().cross(&ahead).try_normalize(1e-6).unwrap_or_else(Vector3::y);
        Self {
            height: None,
            time: 0.0,
            give: Compliance::default(),
            left,
            lever: None,
            filter: LowPass::new(CUTOFF),
            way: VecDeque::new(),
            largest: 0.0,
            eases: None,
            last: None,
            variance: 0.0,
        }
    }

    /// Takes the pose of the hand and the wrench on it (N, Nm, tool axes), `dt` (s) after the last call. `delay` (s) is
    /// the delay of the force loop.
    pub fn update(
        &mut self,
        base_from_tool: &Isometry3<f64>,
        wrench_in_tool: &Vector6<f64>,
        delay: f64,
        dt: f64,
    ) -> Down {
        let rotation = base_from_tool.rotation;
        let force: Vector3<f64> = rotation * wrench_in_tool.fixed_rows::<3>(0);
        let torque: Vector3<f64> = wrench_in_tool.fixed_rows::<3>(3).into();
        let height = self.height.unwrap_or(base_from_tool.translation.z);
        let felt = -force.dot(&self.along(height - base_from_tool.translation.z));
        if let Some(last) = self.last.replace(felt) {
            self.variance += (0.5 * (felt - last).powi(2) - self.variance) / NOISE_SAMPLES;
        }
        let [upward, twist, steady] = self.filter.update(&[force.z, torque.z, felt], dt);
        // A pressed lever pushes back along its arc; only the force across the arc strains it.
        let along = self.height.map_or_else(Vector3::zeros, |height| self.along(height - base_from_tool.translation.z));
        let across = rotation.inverse() * (force - along * force.dot(&along));
        let mut strain = *wrench_in_tool;
        strain.fixed_rows_mut::<3>(0).copy_from(&across);
        let give = self.give.update(&strain, None, delay, dt);
        let give_turn: Vector3<f64> = give.fixed_rows::<3>(3).into();
        self.time += dt;
        if self.height.is_none() && self.time < RELAX.1 && (force.norm() > RELAX.0 || self.time < 0.1) {
            return Down { twist_in_tool: give, depth: 0.0, state: State::Pressing };
        }
        let depth = *self.height.get_or_insert(base_from_tool.translation.z) - base_from_tool.translation.z;
        // A lever that points to the right turns clockwise as the robot sees it, about the approach.
        let enough = if self.lever.is_none() { TWIST.0 } else { TWIST.1 };
        if twist.abs() > enough {
            let lever = self.left * -twist.signum();
            if self.lever.replace(lever) != Some(lever) {
                // Forces along the new arc cannot be compared with the earlier ones.
                self.way.clear();
                self.last = None;
            }
        }
        let mut give: Vector3<f64> = rotation * give.fixed_rows::<3>(0);
        give.z = 0.0;
        let state = self.state(depth, upward, felt);
        let (state, speed) = self.ease(state, steady, dt);
        let linear = give + self.along(depth) * speed;
        let roll = |lever: Vector3<f64>| lever.cross(&-Vector3::z()) * (ROLL * speed / LEVER);
        let angular = self.lever.map_or_else(Vector3::zeros, roll);
        let linear = rotation.inverse() * linear;
        let angular = rotation.inverse() * angular + give_turn;
        Down {
            twist_in_tool: Vector6::new(linear.x, linear.y, linear.z, angular.x, angular.y, angular.z),
            depth,
            state,
        }
    }

    /// Returns the state of the lever and the speed of the hand downwards (m/s). At the stop the hand moves back until
    /// the force is hardly larger than the force of the lever's spring.
    fn ease(&mut self, state: State, felt: f64, dt: f64) -> (State, f64) {
        if state == State::Down && self.eases.is_none() {
            let spring = self.way.iter().map(|(_, felt)| *felt).fold(felt, f64::min);
            self.eases = Some((spring, 0.0));
        }
        let Some((spring, time)) = &mut self.eases else { return (state, SPEED) };
        *time += dt;
        let is_easy = felt < *spring + EASE || *time > EASE_TIME;
        (if is_easy { State::Down } else { State::Pressing }, -EASE_SPEED)
    }

    /// Returns the direction in which the lever's end moves at `depth` (m), a unit vector. It is straight down until
    /// the side to which the lever points is known.
    fn along(&self, depth: f64) -> Vector3<f64> {
        let Some(lever) = self.lever else { return -Vector3::z() };
        let (s, c) = (depth / LEVER).clamp(0.0, 0.9).asin().sin_cos();
        -Vector3::z() * c - lever * s
    }

    /// Returns the distance (m) over which a stop's slope can be distinguished from a spring's slope, with samples
    /// `apart` (m) from each other. The deviation of a line's slope, deviation / way / sqrt(samples / 12), has to be
    /// small enough.
    fn slope_way(&self, apart: f64) -> f64 {
        let enough = (STOP_SLOPE - SPRING_SLOPE) / SURE;
        let way = ((12.0 * apart * self.variance).sqrt() / enough).powf(2.0 / 3.0);
        way.clamp(SLOPE_WAY.0, SLOPE_WAY.1)
    }

    fn state(&mut self, depth: f64, upward: f64, felt: f64) -> State {
        let apart = self.way.back().map_or(0.0, |(last, _)| depth - last);
        if self.way.is_empty() || apart > 0.0 {
            self.way.push_back((depth, felt));
        }
        let length = self.slope_way(apart.clamp(1e-5, 1e-3));
        while self.way.get(1).is_some_and(|(next, _)| depth - next > length) {
            self.way.pop_front();
        }
        let (mean, slope) = line(&self.way);
        let is_long = self.way.front().is_some_and(|(from, _)| depth - from > 0.8 * length);
        let stops = is_long && slope > STOP_SLOPE && upward > DROP_FROM;
        if is_long {
            self.largest = self.largest.max(mean);
        }
        let drops = is_long && self.largest > DROP_FROM && mean < 0.4 * self.largest;
        match (depth > MOVES, upward > FORCE_MAX) {
            (true, true) => State::Down,
            (true, false) if stops || drops => State::Down,
            (false, true) => State::Stuck,
            _ if depth > DEPTH_MAX => State::Stuck,
            _ => State::Pressing,
        }
    }
}

/// The mean of the forces (N), and their slope over the depths (N/m) by least squares.
fn line(way: &VecDeque<(f64, f64)>) -> (f64, f64) {
    let count = way.len().max(1) as f64;
    let middle = way.iter().map(|(depth, _)| depth).sum::<f64>() / count;
    let mean = way.iter().map(|(_, force)| force).sum::<f64>() / count;
    let spread: f64 = way.iter().map(|(depth, _)| (depth - middle).powi(2)).sum();
    let together: f64 = way.iter().map(|(depth, force)| (depth - middle) * (force - mean)).sum();
    (mean, if spread > 0.0 { together / spread } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Rotation3, UnitQuaternion};

    /// A lever of a length (m) that points to the left or right, with a spring and a stop, in fingers of 6 kN/m.
    struct Lever {
        length: f64,
        left: bool,
        stop: f64,
        /// The depth at which the lever gives way (m).
        yields: f64,
        /// From this depth on (m) the base slips for a second, and the hand does not move aside.
        slips: f64,
    }

    impl Lever {
        /// Presses with a hand that faces x. Returns the final state, the depth (m) and the largest force (N).
        fn press(&self) -> (State, f64, f64) {
            let (state, depth, peak, _) = self.press_and_hold();
            (state, depth, peak)
        }

        /// Like [`Lever::press`], and also returns the force in the end (N).
        fn press_and_hold(&self) -> (State, f64, f64, f64) {
            let axes = [Vector3::y(), Vector3::z(), Vector3::x()];
            let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_basis_unchecked(&axes));
            let mut pose = Isometry3::from_parts(Vector3::new(0.5, 0.0, 1.0).into(), rotation);
            let side = if self.left { 1.0 } else { -1.0 };
            let axis = Vector3::new(0.5, -side * self.length, 1.0);
            let (mut press, mut angle, mut roll, mut peak, dt) = (Press::new(&pose), 0.0f64, 0.0, 0.0f64, 2e-3);
            let mut slipped = 0.0;
            for _ in 0..5000 {
                // The lever is where its spring and the hand balance; the hand is a spring on it.
                for _ in 0..50 {
                    let end = axis + Vector3::new(0.0, side * angle.cos(), -angle.sin()) * self.length;
                    let along = Vector3::new(0.0, -side * angle.sin(), -angle.cos());
                    let pull = (pose.translation.vector - end).dot(&along) * 6000.0 * self.length;
                    let spring = if angle > self.yields { 0.0 } else { 0.6 + 1.8 * angle };
                    let stop = 400.0 * (angle - self.stop).max(0.0);
                    angle = (angle + (pull - spring - stop) * 1e-3).max(0.0);
                }
                let end = axis + Vector3::new(0.0, side * angle.cos(), -angle.sin()) * self.length;
                let force = (end - pose.translation.vector) * 6000.0;
                let torque = -side * 6.0 * (angle - roll);
                let in_tool = pose.rotation.inverse() * force;
                let down =
                    press.update(&pose, &Vector6::new(in_tool.x, in_tool.y, in_tool.z, 0.0, 0.0, torque), 0.03, dt);
                peak = peak.max(force.norm());
                if down.state != State::Pressing {
                    return (down.state, down.depth, peak, force.norm());
                }
                let mut v: Vector3<f64> = pose.rotation * down.twist_in_tool.fixed_rows::<3>(0);
                if down.depth > self.slips && slipped < 1.0 {
                    slipped += dt;
                    v.y = 0.0;
                }
                let w: Vector3<f64> = pose.rotation * down.twist_in_tool.fixed_rows::<3>(3);
                pose.translation.vector += v * dt;
                pose.rotation = UnitQuaternion::from_scaled_axis(w * dt) * pose.rotation;
                roll += -side * w.x * dt;
            }
            (State::Pressing, 0.0, peak, 0.0)
        }
    }

    #[test]
    fn any_lever_goes_to_its_stop() {
        for length in [0.06, 0.09, 0.12, 0.15] {
            for left in [true, false] {
                for stop in [0.6, 0.8] {
                    let (state, depth, peak) = Lever { length, left, stop, yields: 9.0, slips: 9.0 }.press();
                    assert_eq!(state, State::Down, "{length} {left} {stop}");
                    // At the stop, except for the give of the fingers, 45 N at 6 kN/m.
                    let wanted = length * f64::sin(stop);
                    assert!((wanted - 0.004..wanted + 0.012).contains(&depth), "{depth} of {wanted}");
                    assert!(peak < 60.0, "{peak} N: {length} {left} {stop}");
                }
            }
        }
    }

    /// The stop is found with 40 N and more; holding the lever down needs less.
    #[test]
    fn a_lever_at_its_stop_is_held_with_hardly_more_than_its_spring() {
        for length in [0.07, 0.09, 0.12] {
            for left in [true, false] {
                let (state, _, _, last) = Lever { length, left, stop: 0.8, yields: 9.0, slips: 9.0 }.press_and_hold();
                let spring = (0.6 + 1.8 * 0.8) / length;
                assert!(state == State::Down && last < spring + 12.0, "{length} {left}: {last} of {spring} N");
            }
        }
    }

    #[test]
    fn a_base_that_slips_is_no_stop() {
        for length in [0.07, 0.09, 0.12] {
            for left in [true, false] {
                for slips in [0.010, 0.016, 0.022] {
                    let (state, depth, peak) = Lever { length, left, stop: 0.8, yields: 9.0, slips }.press();
                    let wanted = length * f64::sin(0.8);
                    assert!(state == State::Down && depth > wanted - 0.004, "{depth} of {wanted} {slips}: {state:?}");
                    assert!(peak < 60.0, "{peak} N: {length} {left} {slips}");
                }
            }
        }
    }

    #[test]
    fn a_lever_that_gives_way_is_down() {
        let (state, depth, _) = Lever { length: 0.09, left: true, stop: 0.8, yields: 0.5, slips: 9.0 }.press();
        assert_eq!(state, State::Down);
        assert!((0.035..0.055).contains(&depth), "{depth}");
    }

    #[test]
    fn a_lever_that_does_not_move_is_stuck() {
        let (state, depth, peak) = Lever { length: 0.09, left: true, stop: 0.0, yields: 9.0, slips: 9.0 }.press();
        assert_eq!(state, State::Stuck);
        assert!(depth < MOVES && peak < 60.0, "{depth} {peak}");
    }
}
