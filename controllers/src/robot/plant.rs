//! Robot, hand and door together, one millisecond at a time.

use super::camera::Camera;
use super::contact::{Grasp, Hand, Push};
use super::door::{Door, Handle};
use super::drive::{Drive, Limits};
use super::force_torque::ForceTorque;
use super::laser;
use super::setup::Setup;
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
/// (m/s²).
const GRAVITY: f64 = 9.81;
const GRIP_SPEED: f64 = 0.12;
const GRIP_FORCE: f64 = 40.0;
const GRIP_FORCE_RISE: f64 = 400.0;
/// What the drives of the base can do, but for their lag.
const BASE: Limits<3> = Limits { lag: 0.0, acceleration: [1.0, 1.0, 1.5], speed: [0.6, 0.6, 0.7] };
/// And those of the arm.
const ARM: Limits<6> = Limits { lag: 0.0, acceleration: [8.0; 6], speed: puma560::RATES_MAX };

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
    setup: Setup,
    camera: Camera,
    joint_offsets: Joints,
    began: Time,
    slipping_since: Option<Time>,
    lost: bool,
    base: Pose,
    joints: Joints,
    casters: Casters,
    grip: f64,
    grip_target: f64,
    grip_force: f64,
    grasp: Grasp,
    push: Push,
    /// Of the hand in the step before (m/s), for what a payload's inertia does.
    hand_velocity: Option<Vector3<f64>>,
    limits_hit: u32,
}

impl Plant {
    /// Returns the robot before a door at time `now`.
    pub fn new(setup: Setup, now: Time) -> Self {
        let mut random = Random::new(setup.seed);
        let mut off = |span: f64| random.between(-span, span) * setup.start.spread;
        let start = &setup.start;
        let base = Pose::new(-start.distance + off(0.08), start.aside + off(0.06), start.yaw + off(0.05));
        let force_torque = ForceTorque::new(setup.sensors.force(), &mut random);
        let casters = Casters::from_fn(|i, _| if i < 4 { random.between(-3.0, 3.0) } else { 0.0 });
        // Calibrations are drawn apart, so that a world without errors has the noise of one with errors.
        let mut calibration = Random::new(!setup.seed);
        let mut joints = puma560::door_posture();
        joints[5] = start.wrist;
        Self {
            now,
            door: Door::new(setup.door),
            base_drive: Drive::new(Limits { lag: setup.machine.base_lag, ..BASE }),
            arm_drive: Drive::new(Limits { lag: setup.machine.arm_lag, ..ARM }),
            force_torque,
            random,
            camera: setup.sensors.camera(&mut calibration),
            joint_offsets: setup.sensors.joint_offsets(&mut calibration),
            grasp: Grasp::new(setup.contact),
            setup,
            began: now,
            slipping_since: None,
            lost: false,
            base,
            joints,
            casters,
            grip: 0.0,
            grip_target: 0.0,
            grip_force: 0.0,
            push: Push::default(),
            hand_velocity: None,
            limits_hit: 0,
        }
    }

    /// Returns where the base is: x, y (m), yaw (rad).
    pub fn base(&self) -> &Pose {
        &self.base
    }

    /// Returns what the encoders of the arm say (rad).
    pub fn encoders(&self) -> Joints {
        self.joints + self.joint_offsets
    }

    /// Returns one sweep of the laser (m).
    pub fn sweep(&mut self) -> Vec<f64> {
        laser::sweep(&self.base, &self.door, &self.setup.sensors.laser(), &mut self.random)
    }

    /// Returns what the camera finds in one image: column, row (px) and depth (m) of each mark.
    pub fn look(&mut self) -> [Option<[f64; 3]>; 4] {
        self.camera.look(&self.hand().world_from_tool, &self.door.handle(), &mut self.random)
    }

    /// Returns whether the fingers hold the lever.
    pub fn holds(&self) -> bool {
        self.grasp.holds()
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
        self.lost |= self.door.angle >= self.setup.faults.lose_at;
        if self.lost {
            self.grasp.release();
        }
        self.push = self.grasp.push(&hand, &handle);
        self.door.step(&-self.push.force, &-self.push.torque, DT);
        self.step_robot();
        self.step_grip(&hand, &handle);
        let tool_from_world = hand.world_from_tool.rotation.inverse();
        let load = self.load(&hand);
        let force = tool_from_world * (self.push.force + visitor + load);
        let torque = tool_from_world * self.push.torque;
        self.force_torque.step(&[force.x, force.y, force.z, torque.x, torque.y, torque.z], DT);
    }

    /// What a payload does to the hand (N, world axes): its weight and its inertia.
    fn load(&mut self, hand: &Hand) -> Vector3<f64> {
        let before = self.hand_velocity.replace(hand.velocity).unwrap_or(hand.velocity);
        let acceleration = (hand.velocity - before) / DT;
        -(acceleration + Vector3::z() * GRAVITY) * self.setup.machine.payload
    }

    /// Whether the wheels turn on the spot.
    fn slips(&mut self) -> bool {
        let faults = &self.setup.faults;
        let is_time = self.now.since(self.began).as_secs_f64() >= faults.base_slip.time;
        let is_pressed = self.door.lever >= faults.base_slip.lever || self.door.angle >= faults.base_slip.door;
        if self.slipping_since.is_none() && (is_time || is_pressed) {
            self.slipping_since = Some(self.now);
        }
        self.slipping_since.is_some_and(|since| self.now.since(since).as_secs_f64() < faults.base_slip_for)
    }

    fn step_robot(&mut self) {
        self.base_drive.step(self.now, DT);
        self.arm_drive.step(self.now, DT);
        let body = Vector3::from(self.base_drive.velocity);
        if !self.slips() {
            self.base = caster::advance(&self.base, &(body * DT));
        }
        let steering = std::array::from_fn(|i| self.casters[i]);
        self.casters +=
            caster::rates_from_body(&steering, caster::WHEEL_RADIUS / (1.0 + self.setup.machine.wheel_error))
                * body
                * DT;
        let wanted = self.joints + Joints::from(self.arm_drive.velocity) * DT;
        self.joints = wanted.zip_zip_map(&puma560::lowest(), &puma560::highest(), f64::clamp);
        if (self.joints - wanted).amax() > 0.0 {
            self.limits_hit += 1;
        }
    }

    /// The fingers stop at the lever if it is between them.
    fn step_grip(&mut self, hand: &Hand, handle: &Handle) {
        let next = towards(self.grip, self.grip_target, GRIP_SPEED * DT);
        let thickness = self.setup.door.lever_thickness;
        let closes = self.grip >= thickness && next < thickness;
        if closes && !self.lost && (self.grasp.holds() || self.grasp.reaches(hand, handle)) {
            if !self.grasp.holds() {
                self.grasp.take(hand, handle);
            }
            self.grip = thickness;
            self.grip_force = (self.grip_force + GRIP_FORCE_RISE * DT).min(GRIP_FORCE);
            return;
        }
        if next > thickness || !self.grasp.holds() {
            self.grasp.release();
        }
        self.grip = next;
        // Closed on nothing, the fingers press against each other.
        self.grip_force = if next <= 0.0 { GRIP_FORCE } else { 0.0 };
    }
}

#[cfg(test)]
mod tests {
    use super::super::setup::Machine;
    use super::*;
    use crate::control::caster::Odometry;

    #[test]
    fn odometry_believes_too_much_by_the_error_of_the_wheels() {
        for wheel_error in [0.01, -0.05] {
            let machine = Machine { wheel_error, ..Machine::default() };
            let mut plant = Plant::new(Setup { seed: 1, machine, ..Setup::default() }, Time::ZERO);
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
            assert!((odometry.pose().xy().norm() / truth - 1.0 - wheel_error).abs() < 0.005);
        }
    }

    #[test]
    fn a_payload_weighs_on_the_sensor() {
        let machine = Machine { payload: 1.5, ..Machine::default() };
        let mut plant = Plant::new(Setup { seed: 1, machine, ..Setup::default() }, Time::ZERO);
        let mut light = Plant::new(Setup { seed: 1, ..Setup::default() }, Time::ZERO);
        for _ in 0..200 {
            plant.step(&Vector3::zeros());
            light.step(&Vector3::zeros());
        }
        let difference: Vec<f64> = plant
            .force_torque
            .read(&mut Random::new(1))
            .iter()
            .zip(light.force_torque.read(&mut Random::new(1)))
            .map(|(loaded, light)| loaded - light)
            .collect();
        // The hand is level, its y axis up: 1.5 kg weigh 14.7 N.
        assert!((difference[1] + 1.5 * 9.81).abs() < 1e-6 && difference[0].abs() < 1e-6, "{difference:?}");
    }
}
