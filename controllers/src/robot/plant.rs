//! Robot, hand and door together, one millisecond at a time.

use super::arm::Arm;
use super::base::{Base, Motion};
use super::body::{Body, Load, Wall, Yielding};
use super::camera::Camera;
use super::contact::{Hand, Push};
use super::door::Door;
use super::fault::Active;
use super::force_torque::ForceTorque;
use super::gripper::Gripper;
use super::laser;
use super::room::{self, walls};
use super::setup::{Machine, Setup};
use crate::control::caster::{Casters, Pose};
use crate::control::puma560;
use crate::control::redundancy;
use crate::sdk::Random;
use comms::logic::time::Time;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use std::time::Duration;

/// The duration of one step.
pub const STEP: Duration = Duration::from_millis(1);
/// The length of a step (s).
pub(super) const DT: f64 = 1e-3;
/// The acceleration of gravity (m/s²).
const GRAVITY: f64 = 9.81;
/// The force on its bumper that the base notices (N).
const BUMPED: f64 = 8.0;

/// Everything that moves.
#[derive(Clone, Debug)]
pub struct Plant {
    /// Time of the last step.
    pub now: Time,
    /// The door.
    pub door: Door,
    /// The base.
    pub base: Base,
    /// The arm.
    pub arm: Arm,
    /// The gripper.
    pub gripper: Gripper,
    /// The wrist sensor.
    pub force_torque: ForceTorque,
    /// The generator of all noise.
    pub random: Random,
    setup: Setup,
    camera: Camera,
    began: Time,
    faults: Active,
    forces: Forces,
}

/// The forces on the robot in the last step.
#[derive(Clone, Debug, Default)]
struct Forces {
    /// Of the lever on the hand.
    push: Push,
    /// The force of a visitor on the hand (N, world axes).
    visitor: Vector3<f64>,
    /// How far the drives give way.
    yielding: Yielding,
    /// The largest force between the robot and leaf, jambs or walls (N), and that on its bumper.
    collision: f64,
    bumper: f64,
    /// The velocity of the hand in the previous step (m/s), for the inertia of a payload.
    hand_velocity: Option<Vector3<f64>>,
}

impl Forces {
    /// Finds the collisions and forces on the robot, and how far its drives give way.
    fn step(&mut self, body: &Body, hand: &Hand, machine: &Machine, walls: &[Wall], door: &mut Door) {
        let at = hand.world_from_tool.translation.vector;
        let mut loads = vec![Load { at, force: self.push.force + self.visitor, torque: self.push.torque, joints: 6 }];
        (self.collision, self.bumper) = (0.0, 0.0);
        for hit in body.hits(walls) {
            if hit.wall == room::LEAF {
                door.push_leaf(&hit.at, &-hit.load.force.xy(), DT);
            }
            let force = hit.load.force.norm();
            self.collision = self.collision.max(force);
            self.bumper = if hit.load.joints == 0 { self.bumper.max(force) } else { self.bumper };
            loads.push(hit.load);
        }
        self.yielding = body.yielding(machine, &loads);
    }

    /// The force of a payload (kg) on the hand (N, world axes): its weight and its inertia.
    fn payload(&mut self, hand: &Hand, mass: f64) -> Vector3<f64> {
        let before = self.hand_velocity.replace(hand.velocity).unwrap_or(hand.velocity);
        let acceleration = (hand.velocity - before) / DT;
        -(acceleration + Vector3::z() * GRAVITY) * mass
    }
}

impl Plant {
    /// Returns a robot before a door at the time `now`.
    pub fn new(setup: Setup, now: Time) -> Self {
        let mut random = Random::new(setup.seed);
        let mut off = |span: f64| random.between(-span, span) * setup.start.spread;
        let start = &setup.start;
        let pose = Pose::new(-start.distance + off(0.08), start.aside + off(0.06), start.yaw + off(0.05));
        let force_torque = ForceTorque::new(setup.sensors.force(), &mut random);
        let casters = Casters::from_fn(|i, _| if i < 4 { random.between(-3.0, 3.0) } else { 0.0 });
        // Calibrations are drawn separately, so that the noise is the same in worlds with and without errors.
        let mut calibration = Random::new(!setup.seed);
        let mut joints = puma560::door_posture();
        joints[5] = start.wrist;
        Self {
            now,
            door: Door::new(setup.door),
            base: Base::new(&setup.machine, pose, casters),
            force_torque,
            random,
            camera: setup.sensors.camera(&mut calibration),
            arm: Arm::new(&setup.machine, joints, setup.sensors.joint_offsets(&mut calibration)),
            gripper: Gripper::new(&setup.machine, setup.contact),
            faults: Active::new(setup.faults, now),
            setup,
            began: now,
            forces: Forces::default(),
        }
    }

    /// Returns one sweep of the laser (m).
    pub fn sweep(&mut self) -> Vec<f64> {
        let room = room::stretches(&self.setup.room, &self.door, self.time());
        laser::sweep(self.base.pose(), &room, &self.setup.sensors.laser(), &mut self.random)
    }

    /// Returns the marks that the camera finds in one image: column, row (px) and depth (m) of each.
    pub fn look(&mut self) -> [Option<[f64; 3]>; 4] {
        self.camera.look(&self.hand().world_from_tool, &self.door.handle(), &mut self.random)
    }

    /// The time since the start (s).
    fn time(&self) -> f64 {
        self.now.since(self.began).as_secs_f64()
    }

    /// Returns the walls of the room and the leaf, seen from above.
    fn walls(&self) -> Vec<Wall> {
        walls(&self.setup.room, &self.door, self.time())
    }

    /// Returns the readings of the casters' encoders (rad).
    pub fn casters(&self) -> Casters {
        let mut casters = *self.base.casters();
        casters[0] += self.faults.jump();
        casters
    }

    /// Returns the distance between the fingers that the gripper reports (m).
    pub fn width_reported(&self) -> f64 {
        let says = self.setup.sensors.grip_says;
        if says < 0.0 { self.gripper.width() } else { says }
    }

    /// Returns the force on the hand from contacts and from a person who pushes it (N), world axes.
    pub fn force(&self) -> Vector3<f64> {
        self.forces.push.force + self.forces.visitor
    }

    /// Returns the largest force between the robot's body and leaf, jambs or walls (N).
    pub fn collision(&self) -> f64 {
        self.forces.collision
    }

    /// Returns whether the bumper around the base is pressed.
    pub fn bumped(&self) -> bool {
        self.forces.bumper > BUMPED
    }

    /// Returns the distance from the base to leaf, jambs and walls (m).
    pub fn base_room(&self) -> f64 {
        self.body().base_room(&self.walls())
    }

    /// Returns the rates of the joints (rad/s), as the encoders measure them.
    pub fn joint_rates(&self) -> [f64; 6] {
        std::array::from_fn(|i| self.rates()[i + 3])
    }

    /// Returns the rates of the axes: the commands of the drives, and the effect of forces.
    fn rates(&self) -> redundancy::Rates {
        let driven = redundancy::Rates::from_fn(|i, _| {
            if i < 3 { self.base.drive.velocity[i] } else { self.arm.drive.velocity[i - 3] }
        });
        driven + self.forces.yielding.droop + self.forces.yielding.excess
    }

    fn body(&self) -> Body {
        Body::new(self.base.pose(), self.arm.joints())
    }

    /// Returns pose and motion of the hand in the world frame.
    pub fn hand(&self) -> Hand {
        let (forward, pose) = (puma560::forward(self.arm.joints()), self.base.pose());
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), pose.z);
        let world_from_base = Isometry3::from_parts(Vector3::new(pose.x, pose.y, 0.0).into(), yaw);
        let mut rates = self.rates();
        rates[2] += self.faults.turn();
        let twist = redundancy::jacobian_in_base(&forward) * rates;
        Hand {
            world_from_tool: world_from_base * forward.base_from_tool,
            velocity: yaw * Vector3::new(twist[0], twist[1], twist[2]),
            angular: yaw * Vector3::new(twist[3], twist[4], twist[5]),
        }
    }

    /// Advances everything by one millisecond, while a visitor pushes the hand with a force (N,
    /// world axes). The sensor measures this force, and the robot moves as far as its drives give
    /// way.
    pub fn step(&mut self, visitor: &Vector3<f64>) {
        self.now = self.now + STEP;
        let (hand, handle) = (self.hand(), self.door.handle());
        self.faults.look(&self.door, self.now);
        if self.faults.has_lost() {
            self.gripper.release();
        }
        (self.forces.push, self.forces.visitor) = (self.gripper.push(&hand, &handle), *visitor);
        let push = self.forces.push;
        self.door.push_shut(self.faults.shut_torque(self.now), DT);
        self.door.step(&-push.force, &-push.torque, DT);
        let (body, walls) = (self.body(), self.walls());
        self.forces.step(&body, &hand, &self.setup.machine, &walls, &mut self.door);
        self.step_robot();
        let thickness = self.setup.door.lever.thickness;
        if self.faults.has_lost() {
            self.gripper.step_without(thickness);
        } else {
            self.gripper.step(&hand, &handle, thickness);
        }
        let tool_from_world = hand.world_from_tool.rotation.inverse();
        let load = self.forces.payload(&hand, self.setup.machine.payload);
        let force = tool_from_world * (push.force + visitor + load);
        let torque = tool_from_world * push.torque;
        self.force_torque.step(&[force.x, force.y, force.z, torque.x, torque.y, torque.z], DT);
    }

    fn step_robot(&mut self) {
        self.base.drive.step(self.now, DT);
        self.arm.drive.step(self.now, DT);
        let rates = self.rates();
        self.base.advance(&Motion {
            body: rates.fixed_rows::<3>(0).into(),
            slid: self.forces.yielding.excess.fixed_rows::<3>(0).into(),
            slips: self.faults.slips(&self.door, self.now),
            turned: self.faults.turn(),
        });
        self.arm.advance(&rates.fixed_rows::<6>(3).into());
    }
}

#[cfg(test)]
mod tests {
    use super::super::gripper::GRIP_MAX;
    use super::*;
    use crate::control::caster::{self, Odometry};

    #[test]
    fn odometry_believes_too_much_by_the_error_of_the_wheels() {
        for wheel_error in [0.01, -0.05] {
            let machine = Machine { wheel_error, ..Machine::default() };
            let mut plant = Plant::new(Setup { seed: 1, machine, ..Setup::default() }, Time::ZERO);
            let (start, mut odometry) = (*plant.base.pose(), Odometry::default());
            let mut calibrated = Odometry::new(caster::WHEEL_RADIUS / (1.0 + wheel_error));
            for i in 0..3000 {
                plant.base.drive.command(Some(&[-0.2, 0.1, 0.0]), plant.now);
                plant.step(&Vector3::zeros());
                if i % 8 == 0 {
                    odometry.update(&plant.casters());
                    calibrated.update(&plant.casters());
                }
            }
            let truth = (plant.base.pose().xy() - start.xy()).norm();
            // First the casters swing round, which adds a little.
            assert!((odometry.pose().xy().norm() / truth - 1.0 - wheel_error).abs() < 0.005);
            // Measured wheel sizes give the right distance.
            assert!((calibrated.pose().xy().norm() / truth - 1.0).abs() < 0.005);
        }
    }

    #[test]
    fn a_visitor_moves_the_robot_and_does_the_work_that_the_drives_take() {
        let mut plant = Plant::new(Setup { seed: 1, ..Setup::default() }, Time::ZERO);
        let force = Vector3::new(0.0, 60.0, 0.0);
        let (before, mut taken) = (plant.hand().world_from_tool.translation.vector, 0.0);
        for _ in 0..1000 {
            plant.step(&force);
            assert_eq!(plant.force(), force, "it is felt");
            let load = Load {
                at: plant.hand().world_from_tool.translation.vector,
                force,
                torque: Vector3::zeros(),
                joints: 6,
            };
            let torques = plant.body().torques(&load);
            taken += torques.dot(&plant.rates()) * DT;
        }
        let moved = plant.hand().world_from_tool.translation.vector - before;
        // The same force acts on hand and axes: the path of the hand times the force equals the paths of the axes times
        // their torques.
        assert!(moved.y > 2e-3, "{moved}");
        assert!((force.dot(&moved) / taken - 1.0).abs() < 0.01, "{} {taken}", force.dot(&moved));
    }

    #[test]
    fn a_base_that_drives_at_a_wall_stops_there_with_its_wheels_sliding() {
        let start = super::super::setup::Start { distance: 1.3, aside: 2.0, yaw: 0.0, spread: 0.0, wrist: 0.0 };
        let mut plant = Plant::new(Setup { seed: 1, start, ..Setup::default() }, Time::ZERO);
        for _ in 0..4000 {
            plant.base.drive.command(Some(&[0.0, 0.3, 0.0]), plant.now);
            plant.step(&Vector3::zeros());
        }
        // The side wall is at 2.5 m, and the base's radius is 0.31 m. Its bumper is pressed by the force that slides
        // its wheels: 200 N, and 150 N for sliding at 0.3 m/s. This gives 45 mm at 2 N/mm, and 12 mm more at 22 N/mm.
        assert!((plant.base.pose().y - (2.5 - 0.31 + 0.0568)).abs() < 2e-3, "{}", plant.base.pose());
        assert!((plant.collision() - 350.0).abs() < 25.0, "{}", plant.collision());
    }

    /// A hand at a lever that slips out of its fingers at 10 N.
    fn at_the_lever() -> Plant {
        let hand = puma560::forward(&puma560::door_posture()).base_from_tool.translation.vector;
        let mut setup = Setup { seed: 1, ..Setup::default() };
        setup.start.distance = hand.x + setup.door.lever.standoff;
        (setup.start.aside, setup.start.yaw, setup.start.spread) = (-hand.y, 0.0, 0.0);
        (setup.door.lever.height, setup.contact.slip_force) = (hand.z, 10.0);
        Plant::new(setup, Time::ZERO)
    }

    #[test]
    fn a_lever_that_has_slipped_out_is_not_held_again_before_the_fingers_open() {
        let mut plant = at_the_lever();
        let grip = |plant: &mut Plant, width: f64| {
            plant.gripper.close_to(width, 40.0);
            let mut held = false;
            for _ in 0..1500 {
                plant.step(&Vector3::zeros());
                held |= plant.gripper.holds();
            }
            held
        };
        assert!(!grip(&mut plant, GRIP_MAX), "the fingers are open");
        assert!(grip(&mut plant, 0.0) && plant.gripper.holds(), "the fingers are closed");
        while plant.gripper.holds() {
            assert!(plant.now < Time::ZERO + Duration::from_secs(6), "it does not slip");
            plant.base.drive.command(Some(&[-0.05, 0.0, 0.0]), plant.now);
            plant.step(&Vector3::zeros());
        }
        // The lever is a millimetre or two away, still well within reach, and the fingers continue to close.
        assert!(plant.gripper.reaches(&plant.hand(), &plant.door.handle()));
        assert!(!grip(&mut plant, 0.0) && plant.gripper.width() <= 0.0, "{}", plant.gripper.width());
        assert!(!grip(&mut plant, GRIP_MAX));
        assert!(plant.gripper.reaches(&plant.hand(), &plant.door.handle()));
        assert!(grip(&mut plant, 0.0), "fingers that have opened hold it again");
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
