//! Robot, hand and door together, one millisecond at a time.

use super::body::{Body, Load, Wall, Yielding};
use super::camera::Camera;
use super::contact::{Grasp, Hand, Push};
use super::door::{Door, Handle};
use super::drive::{Drive, Limits};
use super::force_torque::ForceTorque;
use super::laser;
use super::room::{self, walls};
use super::setup::{Machine, Setup, Turned};
use crate::control::caster::{self, Casters, Pose};
use crate::control::puma560::{self, Joints};
use crate::control::ramp::towards;
use crate::control::redundancy;
use crate::sdk::Random;
use comms::logic::time::Time;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use std::time::Duration;

/// The duration of one step.
pub const STEP: Duration = Duration::from_millis(1);
/// The largest distance between the fingers (m).
pub const GRIP_MAX: f64 = 0.10;
const DT: f64 = 1e-3;
/// The acceleration of gravity (m/s²).
const GRAVITY: f64 = 9.81;
const GRIP_FORCE_RISE: f64 = 400.0;
/// The force on the bumper from which the base notices it (N).
const BUMPED: f64 = 8.0;
/// The time in which a visitor's torque on the leaf rises (s), as in a person's push.
const SHUT_RISE: f64 = 0.2;
/// The limits of the drives of our base, without their lag.
const BASE: Limits<3> = Limits { lag: 0.0, acceleration: [1.0, 1.0, 1.5], speed: [0.6, 0.6, 0.7] };
/// The limits of the drives of our arm, without their lag.
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
    shutting_since: Option<Time>,
    turning_since: Option<Time>,
    /// The rate at which something outside turns the base (rad/s).
    outside: f64,
    jumped: bool,
    lost: bool,
    base: Pose,
    joints: Joints,
    casters: Casters,
    grip: f64,
    grip_target: f64,
    grip_force: f64,
    grip_force_max: f64,
    grasp: Grasp,
    push: Push,
    /// The force of a visitor on the hand (N, world axes).
    visitor: Vector3<f64>,
    yielding: Yielding,
    /// The largest force of the last step between the robot and leaf, jambs or walls (N), and that on its bumper.
    collision: f64,
    bumper: f64,
    /// The velocity of the hand in the previous step (m/s), for the inertia of a payload.
    hand_velocity: Option<Vector3<f64>>,
    limits_hit: u32,
}

impl Plant {
    /// Returns a robot before a door at the time `now`.
    pub fn new(setup: Setup, now: Time) -> Self {
        let mut random = Random::new(setup.seed);
        let mut off = |span: f64| random.between(-span, span) * setup.start.spread;
        let start = &setup.start;
        let base = Pose::new(-start.distance + off(0.08), start.aside + off(0.06), start.yaw + off(0.05));
        let force_torque = ForceTorque::new(setup.sensors.force(), &mut random);
        let casters = Casters::from_fn(|i, _| if i < 4 { random.between(-3.0, 3.0) } else { 0.0 });
        // Calibrations are drawn separately, so that the noise is the same in worlds with and without errors.
        let mut calibration = Random::new(!setup.seed);
        let mut joints = puma560::door_posture();
        joints[5] = start.wrist;
        Self {
            now,
            door: Door::new(setup.door),
            base_drive: Drive::new(base_limits(&setup.machine)),
            arm_drive: Drive::new(arm_limits(&setup.machine)),
            force_torque,
            random,
            camera: setup.sensors.camera(&mut calibration),
            joint_offsets: setup.sensors.joint_offsets(&mut calibration),
            grasp: Grasp::new(setup.contact),
            setup,
            began: now,
            slipping_since: None,
            shutting_since: None,
            turning_since: None,
            outside: 0.0,
            jumped: false,
            lost: false,
            base,
            joints,
            casters,
            grip: 0.0,
            grip_target: 0.0,
            grip_force: 0.0,
            grip_force_max: setup.machine.grip_force,
            push: Push::default(),
            visitor: Vector3::zeros(),
            yielding: Yielding::default(),
            collision: 0.0,
            bumper: 0.0,
            hand_velocity: None,
            limits_hit: 0,
        }
    }

    /// Returns the pose of the base in the world frame: x, y (m), yaw (rad).
    pub fn base(&self) -> &Pose {
        &self.base
    }

    /// Returns the angles from the encoders of the arm (rad).
    pub fn encoders(&self) -> Joints {
        self.joints + self.joint_offsets
    }

    /// Returns one sweep of the laser (m).
    pub fn sweep(&mut self) -> Vec<f64> {
        let room = room::stretches(&self.setup.room, &self.door, self.time());
        laser::sweep(&self.base, &room, &self.setup.sensors.laser(), &mut self.random)
    }

    /// Returns the marks that the camera finds in one image: column, row (px) and depth (m) of each.
    pub fn look(&mut self) -> [Option<[f64; 3]>; 4] {
        self.camera.look(&self.hand().world_from_tool, &self.door.handle(), &mut self.random)
    }

    /// Returns whether the fingers hold the lever.
    pub fn holds(&self) -> bool {
        self.grasp.holds()
    }

    /// Returns the time since the start (s).
    fn time(&self) -> f64 {
        self.now.since(self.began).as_secs_f64()
    }

    /// Returns the walls of the room and the leaf, seen from above.
    fn walls(&self) -> Vec<Wall> {
        walls(&self.setup.room, &self.door, self.time())
    }

    /// Returns the readings of the casters' encoders (rad).
    pub fn casters(&self) -> Casters {
        let mut casters = self.casters;
        casters[0] += if self.jumped { self.setup.faults.jump.by } else { 0.0 };
        casters
    }

    /// Returns the distance between the fingers that the gripper reports (m), and the force with which they press (N).
    pub fn grip_said(&self) -> (f64, f64) {
        let says = self.setup.sensors.grip_says;
        (if says < 0.0 { self.grip } else { says }, self.grip_force)
    }

    /// Returns the distance between the fingers (m) and the force with which they press (N).
    pub fn grip(&self) -> (f64, f64) {
        (self.grip, self.grip_force)
    }

    /// Returns the force on the hand from contacts and from a person who pushes it (N), world axes.
    pub fn force(&self) -> Vector3<f64> {
        self.push.force + self.visitor
    }

    /// Returns the largest force between the robot's body and leaf, jambs or walls (N).
    pub fn collision(&self) -> f64 {
        self.collision
    }

    /// Returns whether the bumper around the base is pressed.
    pub fn bumped(&self) -> bool {
        self.bumper > BUMPED
    }

    /// Returns the distance from the base to leaf, jambs and walls (m).
    pub fn base_room(&self) -> f64 {
        Body::new(&self.base, &self.joints).base_room(&self.walls())
    }

    /// Returns the rates of the joints (rad/s), as the encoders measure them.
    pub fn joint_rates(&self) -> [f64; 6] {
        std::array::from_fn(|i| self.rates()[i + 3])
    }

    /// Returns the rates of the axes: the commands of the drives, and the effect of forces.
    fn rates(&self) -> redundancy::Rates {
        let driven = redundancy::Rates::from_fn(|i, _| {
            if i < 3 { self.base_drive.velocity[i] } else { self.arm_drive.velocity[i - 3] }
        });
        driven + self.yielding.droop + self.yielding.excess
    }

    /// Returns in how many steps a joint was stopped at its limit.
    pub fn limits_hit(&self) -> u32 {
        self.limits_hit
    }

    /// Sends the fingers to a width (m). They press with no more than `force` (N), and no more than they can. Numbers
    /// that are not finite are ignored.
    pub fn grip_to(&mut self, width: f64, force: f64) {
        if !width.is_finite() || !force.is_finite() {
            return;
        }
        self.grip_target = width.clamp(0.0, GRIP_MAX);
        self.grip_force_max = force.clamp(0.0, self.setup.machine.grip_force);
    }

    /// Returns pose and motion of the hand in the world frame.
    pub fn hand(&self) -> Hand {
        let forward = puma560::forward(&self.joints);
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.base.z);
        let world_from_base = Isometry3::from_parts(Vector3::new(self.base.x, self.base.y, 0.0).into(), yaw);
        let mut rates = self.rates();
        rates[2] += self.outside;
        let twist = redundancy::jacobian_in_base(&forward) * rates;
        Hand {
            world_from_tool: world_from_base * forward.base_from_tool,
            velocity: yaw * Vector3::new(twist[0], twist[1], twist[2]),
            angular: yaw * Vector3::new(twist[3], twist[4], twist[5]),
        }
    }

    /// Advances everything by one millisecond, while a visitor pushes the hand with a force (N, world axes). The sensor
    /// measures this force, and the robot gives way as far as its drives do.
    pub fn step(&mut self, visitor: &Vector3<f64>) {
        self.now = self.now + STEP;
        let (hand, handle) = (self.hand(), self.door.handle());
        self.lost |= self.door.angle >= self.setup.faults.lose_at;
        self.jumped |= self.door.angle >= self.setup.faults.jump.at;
        self.outside = self.turned_outside();
        if self.lost {
            self.grasp.release();
        }
        self.push = self.grasp.push(&hand, &handle);
        self.visitor = *visitor;
        let share = self.shut_share();
        self.door.push_shut(share * self.setup.faults.shut_torque, DT);
        self.door.step(&-self.push.force, &-self.push.torque, DT);
        self.step_body(&hand, visitor);
        self.step_robot();
        self.step_grip(&hand, &handle);
        let tool_from_world = hand.world_from_tool.rotation.inverse();
        let load = self.load(&hand);
        let force = tool_from_world * (self.push.force + visitor + load);
        let torque = tool_from_world * self.push.torque;
        self.force_torque.step(&[force.x, force.y, force.z, torque.x, torque.y, torque.z], DT);
    }

    /// The force of a payload on the hand (N, world axes): its weight and its inertia.
    fn load(&mut self, hand: &Hand) -> Vector3<f64> {
        let before = self.hand_velocity.replace(hand.velocity).unwrap_or(hand.velocity);
        let acceleration = (hand.velocity - before) / DT;
        -(acceleration + Vector3::z() * GRAVITY) * self.setup.machine.payload
    }

    /// Returns whether the wheels turn on the spot.
    fn slips(&mut self) -> bool {
        let faults = &self.setup.faults;
        let is_time = self.now.since(self.began).as_secs_f64() >= faults.base_slip.time;
        let is_pressed = self.door.lever >= faults.base_slip.lever || self.door.angle >= faults.base_slip.door;
        if self.slipping_since.is_none() && (is_time || is_pressed) {
            self.slipping_since = Some(self.now);
        }
        self.slipping_since.is_some_and(|since| self.now.since(since).as_secs_f64() < faults.base_slip_for)
    }

    /// Returns the rate at which something outside turns the base (rad/s).
    fn turned_outside(&mut self) -> f64 {
        let Turned { at, rate, span } = self.setup.faults.turned;
        if self.turning_since.is_none() && self.door.angle >= at {
            self.turning_since = Some(self.now);
        }
        let turns = self.turning_since.is_some_and(|since| self.now.since(since).as_secs_f64() < span);
        if turns { rate } else { 0.0 }
    }

    /// Returns the share of its full torque with which a visitor leans on the leaf.
    fn shut_share(&mut self) -> f64 {
        let faults = &self.setup.faults;
        if self.shutting_since.is_none() && self.door.angle >= faults.shut_at {
            self.shutting_since = Some(self.now);
        }
        let since = self.shutting_since.map(|since| self.now.since(since).as_secs_f64());
        since.filter(|since| *since < faults.shut_for).map_or(0.0, |since| (since / SHUT_RISE).min(1.0))
    }

    /// Finds the collisions and forces on the robot, and how far its drives give way.
    fn step_body(&mut self, hand: &Hand, visitor: &Vector3<f64>) {
        let body = Body::new(&self.base, &self.joints);
        let at = hand.world_from_tool.translation.vector;
        let mut loads = vec![Load { at, force: self.push.force + visitor, torque: self.push.torque, joints: 6 }];
        (self.collision, self.bumper) = (0.0, 0.0);
        for hit in body.hits(&self.walls()) {
            if hit.wall == room::LEAF {
                self.door.push_leaf(&hit.at, &-hit.load.force.xy(), DT);
            }
            let force = hit.load.force.norm();
            self.collision = self.collision.max(force);
            self.bumper = if hit.load.joints == 0 { self.bumper.max(force) } else { self.bumper };
            loads.push(hit.load);
        }
        self.yielding = body.yielding(&self.setup.machine, &loads);
    }

    fn step_robot(&mut self) {
        self.base_drive.step(self.now, DT);
        self.arm_drive.step(self.now, DT);
        let rates = self.rates();
        let body: Vector3<f64> = rates.fixed_rows::<3>(0).into();
        if !self.slips() {
            self.base = caster::advance(&self.base, &(body * DT));
        }
        self.base.z += self.outside * DT;
        // Beyond their traction the wheels slide, and their encoders do not measure this.
        let rolled = body - self.yielding.excess.fixed_rows::<3>(0);
        let steering = std::array::from_fn(|i| self.casters[i]);
        let radius = caster::WHEEL_RADIUS / (1.0 + self.setup.machine.wheel_error);
        self.casters += caster::rates_from_body(&steering, radius) * rolled * DT;
        let wanted = self.joints + rates.fixed_rows::<6>(3) * DT;
        self.joints = wanted.zip_zip_map(&puma560::lowest(), &puma560::highest(), f64::clamp);
        if (self.joints - wanted).amax() > 0.0 {
            self.limits_hit += 1;
        }
    }

    /// Moves the fingers. They stop at the lever if it is between them.
    fn step_grip(&mut self, hand: &Hand, handle: &Handle) {
        let next = towards(self.grip, self.grip_target, self.setup.machine.grip_speed * DT);
        let thickness = self.setup.door.lever_thickness;
        // Fingers that have lost a lever close to its thickness; they can hold it again only once they have opened.
        let closes = self.grip > thickness && next <= thickness || self.grasp.holds() && next < thickness;
        if closes && !self.lost && (self.grasp.holds() || self.grasp.reaches(hand, handle)) {
            if !self.grasp.holds() {
                self.grasp.take(hand, handle);
            }
            self.grip = thickness;
            self.grip_force = towards(self.grip_force, self.grip_force_max, GRIP_FORCE_RISE * DT);
            self.grasp.centre(hand, handle, self.grip_force);
            return;
        }
        if next > thickness || !self.grasp.holds() {
            self.grasp.release();
        }
        self.grip = next;
        // If the fingers closed on nothing, they press against each other.
        self.grip_force = if next <= 0.0 { self.grip_force_max } else { 0.0 };
    }
}

fn base_limits(machine: &Machine) -> Limits<3> {
    Limits {
        lag: machine.base_lag,
        acceleration: BASE.acceleration.map(|most| most * machine.base_acceleration),
        speed: BASE.speed.map(|most| most * machine.base_speed),
    }
}

fn arm_limits(machine: &Machine) -> Limits<6> {
    Limits {
        lag: machine.arm_lag,
        acceleration: ARM.acceleration.map(|most| most * machine.arm_acceleration),
        speed: ARM.speed.map(|most| most * machine.arm_speed),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::caster::Odometry;

    #[test]
    fn odometry_believes_too_much_by_the_error_of_the_wheels() {
        for wheel_error in [0.01, -0.05] {
            let machine = Machine { wheel_error, ..Machine::default() };
            let mut plant = Plant::new(Setup { seed: 1, machine, ..Setup::default() }, Time::ZERO);
            let (start, mut odometry) = (*plant.base(), Odometry::default());
            let mut calibrated = Odometry::new(caster::WHEEL_RADIUS / (1.0 + wheel_error));
            for i in 0..3000 {
                plant.base_drive.command(Some(&[-0.2, 0.1, 0.0]), plant.now);
                plant.step(&Vector3::zeros());
                if i % 8 == 0 {
                    odometry.update(&plant.casters());
                    calibrated.update(&plant.casters());
                }
            }
            let truth = (plant.base().xy() - start.xy()).norm();
            // First the casters swing round, which adds a little.
            assert!((odometry.pose().xy().norm() / truth - 1.0 - wheel_error).abs() < 0.005);
            // Measured wheel sizes give the right distance.
            assert!((calibrated.pose().xy().norm() / truth - 1.0).abs() < 0.005);
        }
    }

    #[test]
    fn the_base_has_the_acceleration_that_the_controllers_count_on() {
        for (has, believed) in BASE.acceleration.iter().zip(redundancy::BASE_ACCELERATION_MAX) {
            assert!((has - believed).abs() < 1e-12);
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
            let torques = Body::new(&plant.base, &plant.joints).torques(&load);
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
            plant.base_drive.command(Some(&[0.0, 0.3, 0.0]), plant.now);
            plant.step(&Vector3::zeros());
        }
        // The side wall is at 2.5 m, and the base's radius is 0.31 m. Its bumper is pressed by the force that slides
        // its wheels: 200 N, and 150 N for sliding at 0.3 m/s. This gives 45 mm at 2 N/mm, and 12 mm more at 22 N/mm.
        assert!((plant.base().y - (2.5 - 0.31 + 0.0568)).abs() < 2e-3, "{}", plant.base());
        assert!((plant.collision() - 350.0).abs() < 25.0, "{}", plant.collision());
    }

    /// A hand at a lever that slips out of its fingers at 10 N.
    fn at_the_lever() -> Plant {
        let hand = puma560::forward(&puma560::door_posture()).base_from_tool.translation.vector;
        let mut setup = Setup { seed: 1, ..Setup::default() };
        setup.start.distance = hand.x + setup.door.lever_standoff;
        (setup.start.aside, setup.start.yaw, setup.start.spread) = (-hand.y, 0.0, 0.0);
        (setup.door.lever_height, setup.contact.slip_force) = (hand.z, 10.0);
        Plant::new(setup, Time::ZERO)
    }

    #[test]
    fn a_lever_that_has_slipped_out_is_not_held_again_before_the_fingers_open() {
        let mut plant = at_the_lever();
        let grip = |plant: &mut Plant, width: f64| {
            plant.grip_to(width, 40.0);
            let mut held = false;
            for _ in 0..1500 {
                plant.step(&Vector3::zeros());
                held |= plant.holds();
            }
            held
        };
        assert!(!grip(&mut plant, GRIP_MAX), "the fingers are open");
        assert!(grip(&mut plant, 0.0) && plant.holds(), "the fingers are closed");
        while plant.holds() {
            assert!(plant.now < Time::ZERO + Duration::from_secs(6), "it does not slip");
            plant.base_drive.command(Some(&[-0.05, 0.0, 0.0]), plant.now);
            plant.step(&Vector3::zeros());
        }
        // The lever is a millimetre or two away, still well within reach, and the fingers continue to close.
        assert!(plant.grasp.reaches(&plant.hand(), &plant.door.handle()));
        assert!(!grip(&mut plant, 0.0) && plant.grip().0 <= 0.0, "{:?}", plant.grip());
        assert!(!grip(&mut plant, GRIP_MAX));
        assert!(plant.grasp.reaches(&plant.hand(), &plant.door.handle()));
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
