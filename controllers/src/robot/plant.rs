//! Robot, hand and door together, one millisecond at a time.

use super::contact::{Grasp, Hand, LEVER_THICKNESS, Push};
use super::door::{Description, Door, Handle};
use super::drive::{Drive, Limits};
use super::force_torque::ForceTorque;
use crate::control::caster::{self, Casters, Pose};
use crate::control::puma560::{self, Joints};
use crate::control::ramp::towards;
use crate::control::redundancy;
use crate::sdk::Random;
use comms::logic::time::Time;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use std::time::Duration;

/// One step.
pub const STEP: Duration = Duration::from_millis(1);
/// The widest the fingers open (m).
pub const GRIP_MAX: f64 = 0.10;
const DT: f64 = 1e-3;
const GRIP_SPEED: f64 = 0.12;
const GRIP_FORCE: f64 = 40.0;
const GRIP_FORCE_RISE: f64 = 400.0;
/// The wheels are smaller than the odometry believes, by this factor.
const WHEEL_SCALE: f64 = 1.0 / 1.01;
const BASE: Limits<3> = Limits { lag: 0.08, acceleration: [1.0, 1.0, 1.5], speed: [0.6, 0.6, 0.7] };
const ARM: Limits<6> = Limits { lag: 0.02, acceleration: [8.0; 6], speed: puma560::RATES_MAX };

/// What goes wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Faults {
    /// The lever leaves the fingers for good when the door is this far open (rad).
    pub lose_at: f64,
    /// A held lever slips out at this force (N).
    pub slip_force: f64,
    /// The base's wheels turn on the spot from then on (s since the start), and for how long (s).
    pub base_slip: (f64, f64),
}

impl Faults {
    /// Nothing goes wrong.
    pub const NONE: Self = Self { lose_at: f64::INFINITY, slip_force: 160.0, base_slip: (f64::INFINITY, 0.0) };
}

/// Everything that moves.
#[derive(Clone, Debug)]
pub struct Plant {
    /// Time of the last step.
    pub now: Time,
    /// The door.
    pub door: Door,
    /// The drives of the base: x, y (m/s), yaw (rad/s), base axes.
    pub base_drive: Drive<3>,
    /// The drives of the arm (rad/s).
    pub arm_drive: Drive<6>,
    /// The wrist sensor.
    pub force_torque: ForceTorque,
    /// The generator of all noise.
    pub random: Random,
    /// What goes wrong.
    pub faults: Faults,
    began: Time,
    lost: bool,
    base: Pose,
    joints: Joints,
    casters: Casters,
    grip: f64,
    grip_target: f64,
    grip_force: f64,
    grasp: Grasp,
    push: Push,
    limits_hit: u32,
}

impl Plant {
    /// Returns the robot before a door at time `now`; the seed moves it a little and makes the noise.
    pub fn new(description: Description, seed: u64, now: Time) -> Self {
        let mut random = Random::new(seed);
        let mut off = |span: f64| random.between(-span, span);
        let base = Pose::new(-1.75 + off(0.08), 0.22 + off(0.06), -0.06 + off(0.05));
        let force_torque = ForceTorque::new(&mut random);
        let casters = Casters::from_fn(|i, _| if i < 4 { random.between(-3.0, 3.0) } else { 0.0 });
        Self {
            now,
            door: Door::new(description),
            base_drive: Drive::new(BASE),
            arm_drive: Drive::new(ARM),
            force_torque,
            random,
            faults: Faults::NONE,
            began: now,
            lost: false,
            base,
            joints: puma560::door_posture(),
            casters,
            grip: 0.0,
            grip_target: 0.0,
            grip_force: 0.0,
            grasp: Grasp::default(),
            push: Push::default(),
            limits_hit: 0,
        }
    }

    /// Returns where the base is: x, y (m), yaw (rad).
    pub fn base(&self) -> &Pose {
        &self.base
    }

    /// Returns the joint angles (rad).
    pub fn joints(&self) -> &Joints {
        &self.joints
    }

    /// Returns the encoders of the casters (rad).
    pub fn casters(&self) -> &Casters {
        &self.casters
    }

    /// Returns the width between the fingers (m) and the force with which they press (N).
    pub fn grip(&self) -> (f64, f64) {
        (self.grip, self.grip_force)
    }

    /// Returns the force on the hand by what it touches (N), world axes.
    pub fn force(&self) -> &Vector3<f64> {
        &self.push.force
    }

    /// Returns how many steps a joint has been held back at its limit.
    pub fn limits_hit(&self) -> u32 {
        self.limits_hit
    }

    /// Sends the fingers to a width (m).
    pub fn grip_to(&mut self, width: f64) {
        self.grip_target = width.clamp(0.0, GRIP_MAX);
    }

    /// Returns pose and motion of the hand in the world frame.
    pub fn hand(&self) -> Hand {
        let forward = puma560::forward(&self.joints);
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.base.z);
        let world_from_base = Isometry3::from_parts(Vector3::new(self.base.x, self.base.y, 0.0).into(), yaw);
        let rates = redundancy::Rates::from_fn(|i, _| {
            if i < 3 { self.base_drive.velocity[i] } else { self.arm_drive.velocity[i - 3] }
        });
        let twist = redundancy::jacobian_in_base(&forward) * rates;
        Hand {
            world_from_tool: world_from_base * forward.base_from_tool,
            velocity: yaw * Vector3::new(twist[0], twist[1], twist[2]),
            angular: yaw * Vector3::new(twist[3], twist[4], twist[5]),
        }
    }

    /// Lets one millisecond pass, while a visitor pushes the hand with a force (N), world axes. A push is felt by the
    /// sensor; the drives are stiff.
    pub fn step(&mut self, visitor: &Vector3<f64>) {
        self.now = self.now + STEP;
        let (hand, handle) = (self.hand(), self.door.handle());
        self.lost |= self.door.angle >= self.faults.lose_at;
        if self.lost {
            self.grasp.release();
        }
        self.push = self.grasp.push(&hand, &handle, self.faults.slip_force);
        self.door.step(&-self.push.force, &-self.push.torque, DT);
        self.step_robot();
        self.step_grip(&hand, &handle);
        let tool_from_world = hand.world_from_tool.rotation.inverse();
        let (force, torque) = (tool_from_world * (self.push.force + visitor), tool_from_world * self.push.torque);
        self.force_torque.step(&[force.x, force.y, force.z, torque.x, torque.y, torque.z], DT);
    }

    fn step_robot(&mut self) {
        self.base_drive.step(self.now, DT);
        self.arm_drive.step(self.now, DT);
        let body = Vector3::from(self.base_drive.velocity);
        let (from, span) = self.faults.base_slip;
        let slips = (0.0..span).contains(&(self.now.since(self.began).as_secs_f64() - from));
        if !slips {
            self.base = caster::advance(&self.base, &(body * DT));
        }
        let steering = std::array::from_fn(|i| self.casters[i]);
        self.casters += caster::rates_from_body(&steering, caster::WHEEL_RADIUS * WHEEL_SCALE) * body * DT;
        let wanted = self.joints + Joints::from(self.arm_drive.velocity) * DT;
        self.joints = wanted.zip_zip_map(&puma560::lowest(), &puma560::highest(), f64::clamp);
        if (self.joints - wanted).amax() > 0.0 {
            self.limits_hit += 1;
        }
    }

    /// The fingers stop at the lever if it is between them.
    fn step_grip(&mut self, hand: &Hand, handle: &Handle) {
        let next = towards(self.grip, self.grip_target, GRIP_SPEED * DT);
        let closes = self.grip >= LEVER_THICKNESS && next < LEVER_THICKNESS;
        if closes && !self.lost && (self.grasp.holds() || Grasp::reaches(hand, handle)) {
            if !self.grasp.holds() {
                self.grasp.take(hand, handle);
            }
            self.grip = LEVER_THICKNESS;
            self.grip_force = (self.grip_force + GRIP_FORCE_RISE * DT).min(GRIP_FORCE);
            return;
        }
        if next > LEVER_THICKNESS || !self.grasp.holds() {
            self.grasp.release();
        }
        self.grip = next;
        // Closed on nothing, the fingers press against each other.
        self.grip_force = if next <= 0.0 { GRIP_FORCE } else { 0.0 };
    }
}

#[cfg(test)]
mod tests {
    use super::super::door::Lock;
    use super::*;
    use crate::control::caster::Odometry;

    #[test]
    fn odometry_believes_one_percent_too_much() {
        let description = Description { radius: 0.82, closer: 8.0, lock: Lock::Unlocked };
        let mut plant = Plant::new(description, 1, Time::ZERO);
        let (start, mut odometry) = (*plant.base(), Odometry::default());
        for i in 0..3000 {
            plant.base_drive.command(Some(&[-0.2, 0.1, 0.0]), plant.now);
            plant.step(&Vector3::zeros());
            if i % 8 == 0 {
                odometry.update(plant.casters());
            }
        }
        let truth = (plant.base().xy() - start.xy()).norm();
        // The casters swing round first, which adds a little.
        assert!((odometry.pose().xy().norm() / truth - 1.01).abs() < 0.005);
    }
}
