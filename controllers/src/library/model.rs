//! ModelBasedCtrl: opens a door about the hinge whose position it estimates.

use super::{SENSED, StuckLaser, distance};
use crate::control::angle::wrapped;
use crate::control::caster::Pose;
use crate::control::clearance::{Memory, ROOM_MIN, clearance};
use crate::control::compliant::loop_delay;
use crate::control::door::{Failure, Opening, Posture, Pull};
use crate::control::filter::{Despike, LowPass};
use crate::control::history::History;
use crate::control::landmark::Landmark;
use crate::control::leaf::{Leaf, Wall};
use crate::control::line::horizontal;
use crate::control::opened::{Doubt, Evidence, Expected, Verdict, Watch};
use crate::control::puma560;
use crate::control::swing::Opens;
use crate::control::unload::Unloading;
use crate::message::{BasePose, Constraint, GripperState, JointState, LaserState, Velocity, Wrench};
use crate::sdk::{About, Arguments, Controller, In, Inputs, Kind, Out, Outputs, Parameter, Progress, Quantity, Tick};
use comms::logic::signals::Signal;
use comms::logic::time::Time;
use nalgebra::{Isometry3, Rotation2, UnitQuaternion, Vector2, Vector3, Vector6};
use std::time::Duration;

/// The longest time of an opening.
const TIMEOUT: Duration = Duration::from_secs(55);
/// The angle before its goal from which a door is slowed down (rad), and the smallest share of its speed.
const BRAKE: f64 = 0.2;
const PACE_MIN: f64 = 0.25;
const PUSH_PACE_MIN: f64 = 0.6;
/// The clearance above the least one at which the robot slows down (m): a sweep is 50 ms old, and a base takes 200 ms
/// to stop. Then the longest search for the wall.
const ROOM_SLOW: f64 = 0.04;
const LOOK: Duration = Duration::from_secs(2);
/// A remembered wall is assumed to be this much nearer (m): wheels are wrong by a few per cent.
const REMEMBERED: f64 = 0.03;
/// If hand and leaf are turned against each other by more than `HELD` (rad), the points of the leaf behind the fingers
/// count as held. This part of the leaf has this depth, and this width to each side (m).
const HELD: f64 = 0.3;
const HELD_DEPTH: f64 = 0.16;
const HELD_BESIDE: f64 = 0.3;
/// A force has changed if it differs by this much from the force when the load was off (N). Only its part below the
/// second value counts (Hz).
const CHANGED: f64 = 8.0;
const LEFT_SLOW: f64 = 2.0;
/// The longest wait at rest while inputs are too old.
const PATIENCE: Duration = Duration::from_secs(1);

/// The inputs of the controller.
#[derive(Debug, Inputs)]
pub(super) struct Inputs {
    /// The wrench on the hand.
    #[port("In1")]
    wrench: In<Wrench>,
    /// The arm's joints.
    #[port("In2")]
    joints: In<JointState>,
    /// The pose of the base.
    #[port("In3")]
    pose: In<BasePose>,
    /// The gripper, which holds the handle as long as its width says so.
    #[device("gripper/state")]
    gripper: In<GripperState>,
    /// The laser, which sees how far the leaf is open.
    #[device("laser/state")]
    laser: In<LaserState>,
}

/// The outputs of the controller.
#[derive(Debug, Outputs)]
pub(super) struct Outputs {
    /// The velocity of the hand.
    #[port("Out1")]
    velocity: Out<Velocity>,
    /// The direction in which the hand is led, for compliance beside it.
    #[port("Out2")]
    guide: Out<Constraint>,
}

/// Pulls or pushes a door open about its hinge, whose position it estimates on the way. Ends when the laser sees the
/// leaf at the goal, or when nothing moves.
#[derive(Debug)]
pub(super) struct ModelBasedCtrl {
    goal: f64,
    radius: f64,
    opens: Opens,
    expected: Expected,
    opening: Option<Opening>,
    watch: Watch,
    wall: Wall,
    stuck: StuckLaser,
    landmark: Landmark,
    memory: Memory,
    /// The pose of the base at the last sweep, in the odometry frame.
    swept_from: Option<Pose>,
    anchor: Anchor,
    poses: History<3>,
    joints: History<6>,
    pull: Option<Pull>,
    rest: Rest,
    /// As seen last.
    leaf: Option<Leaf>,
    /// The last observed distance from the robot to the nearest obstacle (m).
    room: Option<f64>,
    /// The time since every input was fresh.
    blind: Duration,
    spent: Duration,
}

/// The end of an opening: the hand takes off its load, and stays where it is as long as the force does not change.
#[derive(Debug)]
struct Rest {
    despike: Despike,
    slow: LowPass<3>,
    unloading: Unloading,
    /// The force when the load was off (N, tool axes).
    left: Option<Vector3<f64>>,
}

impl Default for Rest {
    fn default() -> Self {
        let (despike, slow) = (Despike::default(), LowPass::new(LEFT_SLOW));
        Self { despike, slow, unloading: Unloading::of_a_door(), left: None }
    }
}

impl Rest {
    /// Takes the wrench on the hand (N, Nm, tool axes), `dt` (s) after the last one. Returns the slow part of its force.
    fn feel(&mut self, wrench: &Vector6<f64>, dt: f64) -> Vector3<f64> {
        let force: Vector3<f64> = self.despike.update(wrench).fixed_rows::<3>(0).into();
        self.slow.update(&force.into(), dt).into()
    }

    /// Begins again with a hand whose load is not off.
    fn restart(&mut self) {
        (self.unloading, self.left) = (Unloading::of_a_door(), None);
    }

    /// Returns the velocity of a hand at rest that feels `wrench` (N, Nm, tool axes), `dt` (s) after the last call.
    /// `slow` is the slow part of the force (N), and `delay` (s) the delay of the force loop.
    fn velocity(&mut self, wrench: &Vector6<f64>, slow: Vector3<f64>, delay: f64, dt: f64) -> Velocity {
        if self.left.is_some_and(|left| (slow - left).norm() > CHANGED) {
            // A visitor pushes the hand, or the leaf moves.
            self.restart();
        }
        let twist = if self.left.is_none() { self.unloading.update(wrench, delay, dt) } else { None };
        if twist.is_none() {
            self.left.get_or_insert(slow);
        }
        Velocity { rests: true, ..Velocity::of_hand(twist.unwrap_or_default().into()) }
    }
}

/// Keeps poses of the odometry consistent when the odometry restarts.
#[derive(Clone, Copy, Debug, Default)]
struct Anchor {
    ours_from_odometry: Option<Isometry3<f64>>,
    last: Option<Isometry3<f64>>,
    jumps: u32,
}

/// No base moves this far between two calculations (m).
const JUMP: f64 = 0.03;

impl Anchor {
    fn ours(&mut self, odometry_from_base: &Isometry3<f64>, dt: f64) -> Isometry3<f64> {
        let mut ours = self.ours_from_odometry.unwrap_or_default() * odometry_from_base;
        if let Some(last) = self.last {
            let step = last.inv_mul(&ours);
            let most = JUMP + dt;
            if step.translation.vector.norm() > most || step.rotation.angle() > most {
                // The odometry has restarted: the base has not moved, but its frame has.
                self.ours_from_odometry = Some(last * odometry_from_base.inverse());
                self.jumps += 1;
                ours = last;
            }
        }
        self.last = Some(ours);
        ours
    }
}

/// The fresh inputs of one calculation.
struct Known {
    odometry_from_base: Isometry3<f64>,
    base_from_tool: Isometry3<f64>,
    wrench: Vector6<f64>,
    width: f64,
}

impl ModelBasedCtrl {
    /// Returns the state from the inputs if all of them are fresh. The poses of arm and base are those at the older of
    /// their two times of measurement.
    fn known(&mut self, tick: Tick, inputs: &Inputs) -> Option<Known> {
        let width = inputs.gripper.fresh_within(tick.now, SENSED)?.width;
        let wrench = inputs.wrench.fresh_within(tick.now, SENSED)?;
        let joints = inputs.joints.fresh_within(tick.now, SENSED)?;
        let pose = inputs.pose.fresh_within(tick.now, SENSED)?;
        let ours = self.anchor.ours(&planar(&pose.pose), tick.dt());
        let turned = ours.rotation.euler_angles().2;
        self.poses.push(inputs.pose.measured()?, [ours.translation.x, ours.translation.y, turned]);
        self.joints.push(inputs.joints.measured()?, joints.angles);
        let (odometry_from_base, base_from_tool) = self.at(inputs.joints.measured()?.min(inputs.pose.measured()?))?;
        let ([x, y, z], [a, b, c]) = (wrench.force, wrench.torque);
        Some(Known { odometry_from_base, base_from_tool, wrench: Vector6::new(x, y, z, a, b, c), width })
    }

    /// Returns where base and hand were at `time`.
    fn at(&self, time: Time) -> Option<(Isometry3<f64>, Isometry3<f64>)> {
        let (pose, angles) = (self.poses.at(time)?, self.joints.at(time)?);
        Some((planar(&pose), puma560::forward(&angles.into()).base_from_tool))
    }

    /// Searches for the leaf in a new sweep, if there is one. The leaf is turned by `askew` (rad) from the direction of
    /// the hand. Angles are positive in the direction in which a door opens with `sense`.
    fn look(&mut self, inputs: &Inputs, sense: f64, askew: f64) -> Option<Leaf> {
        let sweep = inputs.laser.fresh()?;
        let (at, base_from_tool) = self.at(inputs.laser.measured()?)?;
        let at = Pose::new(at.translation.x, at.translation.y, at.rotation.euler_angles().2);
        let from = self.swept_from.replace(at).unwrap_or(at);
        let turned = wrapped(at.z - from.z);
        let by = Rotation2::new(-from.z) * (at.xy() - from.xy());
        let points = distance::points(&sweep.ranges, std::f64::consts::PI);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), askew) * base_from_tool.rotation;
        let facing = Isometry3::from_parts(base_from_tool.translation, turn);
        // A wrist that turns about the handle comes near the leaf that it holds. The law limits this distance.
        let others: Vec<_> =
            points.iter().filter(|point| askew.abs() < HELD || !is_held(point, &facing)).copied().collect();
        let joints = self.joints.at(inputs.laser.measured()?)?.into();
        let remembered = clearance(&self.memory.around(&at), &joints).map(|room| room - REMEMBERED);
        self.room = clearance(&others, &joints).into_iter().chain(remembered).reduce(f64::min);
        let leaf = self.wall.update(&points, &Vector3::new(by.x, by.y, turned), &facing)?;
        let distance = leaf.away + leaf.normal.dot(&base_from_tool.translation.vector.xy());
        self.memory.remember(&points, &leaf.normal, distance, &at);
        self.mark(&leaf, &base_from_tool, &at);
        let leaf = Leaf { angle: sense * leaf.angle, hand: sense * leaf.hand, ..leaf };
        self.leaf = Some(leaf);
        self.leaf
    }

    /// Returns the velocity of the hand: from the law, or from a hand at rest that takes off its load.
    fn velocity(&mut self, known: &Known, pull: &Pull, delay: f64, dt: f64) -> Velocity {
        let slow = self.rest.feel(&known.wrench, dt);
        if self.watch.is_at_rest() {
            return self.rest.velocity(&known.wrench, slow, delay, dt);
        }
        self.rest.restart();
        let base = known.odometry_from_base.rotation.inverse() * pull.base.push(0.0);
        let null = std::array::from_fn(|i| if i < 2 { base[i] } else { 0.0 });
        // If the wall is out of sight, the angle of the leaf depends on the turn of the base that the wheels report. So
        // the base does not turn.
        let steady = self.opening.as_ref().is_some_and(Opening::pushes) || self.wall.turned().is_some();
        Velocity { twist: pull.twist_in_tool.into(), null, steady, rests: false }
    }

    /// Takes the place of the hinge from a leaf that the hand holds, for a base at `at`.
    fn mark(&mut self, leaf: &Leaf, base_from_tool: &Isometry3<f64>, at: &Pose) {
        let (Some(radius), Some(opening)) = (self.wall.radius(), &self.opening) else { return };
        let left = Vector2::new(-leaf.normal.y, leaf.normal.x);
        let from_base = base_from_tool.translation.vector.xy() + left * (opening.left() * radius);
        let hinge = at.xy() + Rotation2::new(at.z) * from_base;
        self.landmark.update(&hinge, &at.xy(), self.wall.turned().is_none());
    }

    fn result(&mut self, pull: &Pull, evidence: &Evidence) -> Progress {
        match pull.failure {
            Some(Failure::Locked) => {
                let why = match self.opens {
                    Opens::Either => {
                        "locked, or shut by more than 70 N: the lever is down as far as it was pressed, and the door moves neither when it is pulled nor when it is pushed"
                    }
                    Opens::Pull => {
                        "locked, or to be pushed, or shut by more than 70 N: the lever is down as far as it was pressed, and the door does not come when it is pulled"
                    }
                    Opens::Push => {
                        "locked, or to be pulled, or shut by more than 70 N: the lever is down as far as it was pressed, and the door does not go when it is pushed"
                    }
                };
                return Progress::Aborted(why.to_owned());
            }
            Some(Failure::Blocked) => {
                let why = "blocked: it pulls or pushes and the door does not move any further";
                return Progress::Aborted(why.to_owned());
            }
            None => {}
        }
        if self.room.is_some_and(|room| room < ROOM_MIN) {
            return Progress::Aborted("no room: something is less than 30 mm from the robot".to_owned());
        }
        if !self.wall.is_found() && self.spent > LOOK {
            return refuse(Doubt::Unseen);
        }
        match (self.watch.update(evidence), evidence.leaf) {
            (Verdict::Doubt(doubt), _) => refuse(doubt),
            (Verdict::Open, Some(leaf)) => Progress::done(&[leaf.angle, evidence.radius]),
            _ if self.spent > TIMEOUT => Progress::Aborted("the door is not open after 55 s".to_owned()),
            _ => Progress::Continue,
        }
    }
}

/// Returns whether a point (m, base axes) is on the part of the leaf right before the fingers. `base_from_facing` is a
/// pose that faces the leaf.
fn is_held(point: &Vector2<f64>, base_from_facing: &Isometry3<f64>) -> bool {
    let normal = horizontal(&(base_from_facing.rotation * Vector3::z()));
    let from = point - base_from_facing.translation.vector.xy();
    (0.0..HELD_DEPTH).contains(&normal.dot(&from)) && normal.perp(&from).abs() < HELD_BESIDE
}

/// Returns a pose on the floor from x, y (m), yaw (rad).
fn planar([x, y, yaw]: &[f64; 3]) -> Isometry3<f64> {
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), *yaw);
    Isometry3::from_parts(Vector3::new(*x, *y, 0.0).into(), yaw)
}

/// Returns the abort for a doubt, with its reason.
fn refuse(doubt: Doubt) -> Progress {
    let reason = match doubt {
        Doubt::Handle => "lost the handle: the fingers are not as far apart as a handle is wide",
        Doubt::Unseen => "the laser does not see the leaf: it is not known whether the door is open",
        Doubt::Behind => "the door is not as far open as the hand has moved: the wheels or the fingers slip",
        Doubt::Turn => "the hand has not turned with the door: its direction and the leaf's differ",
        Doubt::Wheels => {
            "the wheels have slipped, or may have: the wall is out of sight, and the hinge is not as far away as it was seen"
        }
        Doubt::Moved => {
            "the base was turned, and not by its wheels: it does not see the hinge where it was, and the wall is out of sight"
        }
        Doubt::Way => {
            "the leaf seems to have turned further than the handle has gone: what the laser sees is not this door's leaf or wall"
        }
        Doubt::Left => "lost the handle: the leaf is not as far from the hand as when the opening began",
        Doubt::Hinge => "the hinge estimate is not sane: its radius is not that of a door",
    };
    Progress::Aborted(reason.to_owned())
}

impl Controller for ModelBasedCtrl {
    type Inputs = Inputs;
    type Outputs = Outputs;
    const TYPE: &'static str = "ModelBasedCtrl";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[
            Parameter::new("goal", Kind::Quantity(Quantity::Angle, 0.1, 2.5)).or("1.2217"),
            Parameter::new("radius", Kind::Quantity(Quantity::Length, 0.3, 1.5)).or("0.7"),
            Parameter::new("swing", Kind::Text(&["either", "pull", "push"])).or("either"),
            Parameter::new("width_min", Kind::Quantity(Quantity::Length, 0.001, 0.2)).or("0.006"),
            Parameter::new("width_max", Kind::Quantity(Quantity::Length, 0.001, 0.2)).or("0.07"),
            Parameter::new("radius_min", Kind::Quantity(Quantity::Length, 0.1, 1.5)).or("0.3"),
            Parameter::new("radius_max", Kind::Quantity(Quantity::Length, 0.3, 3.0)).or("1.5"),
        ];
        About::task(
            "Opens a door to an angle [rad] about its hinge, first guessed at a radius [m]: pulls, pushes, or finds out which; \
            ends only if it holds the handle.",
        )
            .remembers()
            .every(Duration::from_millis(20))
            .triggered_by("In1")
            .with(PARAMETERS)
            .signals_every(Duration::from_millis(100))
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let expected = Expected {
            width: (arguments.number("width_min"), arguments.number("width_max")),
            radius: (arguments.number("radius_min"), arguments.number("radius_max")),
        };
        let ((width_min, width_max), (radius_min, radius_max)) = (expected.width, expected.radius);
        if width_min > width_max || radius_min > radius_max {
            return Err("`width_min` and `radius_min` must not exceed `width_max` and `radius_max`".to_owned());
        }
        let goal = arguments.number("goal");
        Ok(Self {
            goal,
            radius: arguments.number("radius"),
            opens: match arguments.text("swing") {
                "pull" => Opens::Pull,
                "push" => Opens::Push,
                _ => Opens::Either,
            },
            expected,
            opening: None,
            watch: Watch::new(goal, expected),
            wall: Wall::default(),
            stuck: StuckLaser::default(),
            landmark: Landmark::default(),
            memory: Memory::default(),
            swept_from: None,
            anchor: Anchor::default(),
            poses: History::default(),
            joints: History::default(),
            pull: None,
            rest: Rest::default(),
            leaf: None,
            room: None,
            blind: Duration::ZERO,
            spent: Duration::ZERO,
        })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        (self.opening, self.pull, self.leaf, self.room) = (None, None, None, None);
        self.rest = Rest::default();
        (self.watch, self.wall) = (Watch::new(self.goal, self.expected), Wall::default());
        (self.stuck, self.swept_from, self.anchor) = (StuckLaser::default(), None, Anchor::default());
        (self.landmark, self.memory) = (Landmark::default(), Memory::default());
        (self.poses, self.joints) = (History::default(), History::default());
        (self.blind, self.spent) = (Duration::ZERO, Duration::ZERO);
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &Inputs, outputs: &mut Outputs) -> Progress {
        self.spent += tick.elapsed;
        if let Some(why) = inputs.laser.fresh().and_then(|sweep| self.stuck.problem(&sweep.ranges)) {
            return Progress::Aborted(why);
        }
        let Some(known) = self.known(tick, inputs) else {
            // Without sensors the controller does not pull. The other controllers receive a fresh zero.
            outputs.velocity.send(Velocity::REST);
            self.blind += tick.elapsed;
            return if self.blind > PATIENCE {
                Progress::Aborted(
                    "inputs are too old: forces, joint angles, odometry or the gripper's width".to_owned(),
                )
            } else {
                Progress::Continue
            };
        };
        self.blind = Duration::ZERO;
        let hand = known.odometry_from_base * known.base_from_tool;
        let base = known.odometry_from_base.translation.vector.xy();
        let posture = Posture { odometry_from_tool: hand, base };
        // If the hand stops, a door that still moves runs into it.
        let left = self.leaf.map_or(self.goal, |leaf| self.goal + self.watch.slip() - leaf.angle);
        let room = self.room.map_or(1.0, |room| ((room - ROOM_MIN) / ROOM_SLOW).clamp(PACE_MIN, 1.0));
        let opening = self.opening.get_or_insert_with(|| Opening::new(&posture, self.radius, self.opens));
        // A pushed door is slower anyway, and does not run into the hand.
        let slowest = if opening.pushes() { PUSH_PACE_MIN } else { PACE_MIN };
        let pace = (left / BRAKE).clamp(slowest, 1.0).min(room) * self.watch.pace();
        let delay = loop_delay(inputs.wrench.age(tick.now).unwrap_or_default().as_secs_f64());
        let pull = opening.update(&posture, &known.wrench, pace, delay, tick.dt());
        let (radius, sense, askew) = (opening.hinge().radius(), opening.sense(), opening.askew());
        self.pull = Some(pull);
        let leaf = self.look(inputs, sense, askew);
        if let (Some(leaf), Some(opening)) = (leaf, &mut self.opening) {
            let is_in_sight = self.wall.turned().is_none();
            opening.see(sense * leaf.angle, self.wall.radius().filter(|_| is_in_sight));
        }
        outputs.velocity.send(self.velocity(&known, &pull, delay, tick.dt()));
        outputs.guide.send(Constraint {
            tangent: pull.guide.tangent_in_tool.into(),
            up: pull.guide.up_in_tool.into(),
            upward: pull.guide.upward,
            turned: pull.guide.turned,
        });
        let (seen_radius, turned) = (self.wall.radius(), self.wall.turned());
        let way = self.opening.as_ref().map_or(0.0, Opening::way);
        let (believed, moved) = (pull.angle, self.landmark.turned());
        let (width, unloaded) = (known.width, self.rest.left.is_some());
        let evidence = Evidence { width, believed, leaf, radius, seen_radius, turned, moved, way, unloaded };
        self.result(&pull, &evidence)
    }

    fn signals(&self) -> Vec<Signal> {
        let radius = self.opening.as_ref().map_or(f64::NAN, |opening| opening.hinge().radius());
        let [pull, pull_max, pace] = self.pull.map_or([f64::NAN; 3], |pull| pull.effort);
        let seen = |angle: fn(Leaf) -> f64| self.leaf.map_or(f64::NAN, |leaf| angle(leaf).to_degrees());
        let signal =
            |name: &str, unit: &str, value| Signal { name: name.into(), unit: unit.into(), value, headline: false };
        vec![
            signal("estimated angle", "deg", self.pull.map_or(0.0, |pull| pull.angle).to_degrees()),
            signal("estimated radius", "m", radius),
            signal("pull", "N", pull),
            signal("largest pull", "N", pull_max),
            signal("pace", "", pace),
            signal("seen angle", "deg", seen(|leaf| leaf.angle)),
            signal("slip at most", "deg", self.watch.slip().to_degrees()),
            signal("hand turned", "deg", seen(|leaf| leaf.hand)),
            signal("hand to leaf", "mm", self.leaf.map_or(f64::NAN, |leaf| 1e3 * leaf.away)),
            signal("seen radius", "m", self.wall.radius().unwrap_or(f64::NAN)),
            signal("turned without the wall", "deg", self.wall.turned().map_or(f64::NAN, f64::to_degrees)),
            signal("turned without the wheels", "deg", self.landmark.turned().to_degrees()),
            signal("room", "m", self.room.unwrap_or(f64::NAN)),
            signal("odometry jumps", "", f64::from(self.anchor.jumps)),
        ]
    }
}
