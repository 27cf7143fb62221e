//! ModelBasedCtrl: opens a door about the hinge whose position it estimates.

mod eyes;
mod rest;
mod track;

use super::{SENSED, StuckLaser};
use crate::control::clearance::ROOM_MIN;
use crate::control::compliant::loop_delay;
use crate::control::door::{Failure, Opening, Posture, Pull};
use crate::control::leaf::Leaf;
use crate::control::opened::{Doubt, Evidence, Expected, Verdict, Watch};
use crate::control::swing::Opens;
use crate::message::{BasePose, Constraint, GripperState, JointState, LaserState, Velocity, Wrench};
use crate::sdk::{About, Arguments, Controller, In, Inputs, Kind, Out, Outputs, Parameter, Progress, Quantity, Tick};
use comms::logic::signals::Signal;
use eyes::Eyes;
use nalgebra::Vector6;
use rest::Rest;
use std::time::Duration;
use track::{Place, Track};

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
/// The longest wait at rest for inputs that are too old.
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
    /// The gripper. Its width shows whether it holds the handle.
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
    /// The direction in which the hand is led. The hand gives way to forces across this direction.
    #[port("Out2")]
    guide: Out<Constraint>,
}

/// Pulls or pushes a door open about its hinge, whose position it estimates on the way. Ends when the laser sees the
/// leaf at the goal, or when nothing moves.
#[derive(Debug)]
pub(super) struct ModelBasedCtrl {
    settings: Settings,
    watch: Watch,
    stuck: StuckLaser,
    eyes: Eyes,
    track: Track,
    opening: Option<Opening>,
    pull: Option<Pull>,
    rest: Rest,
    /// The time since every input was fresh.
    blind: Duration,
    spent: Duration,
}

/// The parameters of the controller.
#[derive(Clone, Copy, Debug)]
struct Settings {
    /// The angle to which it opens the door (rad).
    goal: f64,
    /// The first guess at the distance of the hinge (m).
    radius: f64,
    opens: Opens,
    expected: Expected,
}

/// The fresh inputs of one calculation.
struct Known {
    /// Of base and hand, at the time of the older measurement of the two.
    place: Place,
    wrench: Vector6<f64>,
    /// Between the fingers (m).
    width: f64,
}

impl ModelBasedCtrl {
    /// Returns a controller that has seen nothing yet.
    fn with(settings: Settings) -> Self {
        Self {
            settings,
            watch: Watch::new(settings.goal, settings.expected),
            stuck: StuckLaser::default(),
            eyes: Eyes::default(),
            track: Track::default(),
            opening: None,
            pull: None,
            rest: Rest::default(),
            blind: Duration::ZERO,
            spent: Duration::ZERO,
        }
    }

    /// Returns the state from the inputs while all of them are fresh.
    fn known(&mut self, tick: Tick, inputs: &Inputs) -> Option<Known> {
        let width = inputs.gripper.fresh_within(tick.now, SENSED)?.width;
        let wrench = inputs.wrench.fresh_within(tick.now, SENSED)?;
        let joints = inputs.joints.fresh_within(tick.now, SENSED)?;
        let pose = inputs.pose.fresh_within(tick.now, SENSED)?;
        let (posed, bent) = (inputs.pose.measured()?, inputs.joints.measured()?);
        self.track.push_pose(posed, &pose.pose, tick.dt());
        self.track.push_joints(bent, joints.angles);
        let place = self.track.at(bent.min(posed))?;
        let ([x, y, z], [a, b, c]) = (wrench.force, wrench.torque);
        Some(Known { place, wrench: Vector6::new(x, y, z, a, b, c), width })
    }

    /// Searches a new sweep, if there is one, for the leaf.
    fn look(&mut self, inputs: &Inputs) -> Option<Leaf> {
        let (sweep, opening) = (inputs.laser.fresh()?, self.opening.as_ref()?);
        self.eyes.look(&sweep.ranges, inputs.laser.measured()?, &self.track, opening)
    }

    /// Returns the velocity of the hand: from the law, or from a hand at rest that takes off its load.
    fn velocity(&mut self, known: &Known, pull: &Pull, delay: f64, dt: f64) -> Velocity {
        let slow = self.rest.feel(&known.wrench, dt);
        if self.watch.is_at_rest() {
            return self.rest.velocity(&known.wrench, slow, delay, dt);
        }
        self.rest.restart();
        let base = known.place.odometry_from_base.rotation.inverse() * pull.base.push(0.0);
        let null = std::array::from_fn(|i| if i < 2 { base[i] } else { 0.0 });
        // If the wall is out of sight, the angle of the leaf depends on the turn of the base that the wheels report. So
        // the base does not turn.
        let steady = self.opening.as_ref().is_some_and(Opening::pushes) || self.eyes.wall().turned().is_some();
        Velocity { twist: pull.twist_in_tool.into(), null, steady, rests: false }
    }

    fn result(&mut self, pull: &Pull, evidence: &Evidence) -> Progress {
        match pull.failure {
            Some(Failure::Locked) => {
                let why = match self.settings.opens {
                    Opens::Either => {
                        "locked, or shut by more than 70 N: the lever is down as far as it was pressed, and the door does not move when \
                         it is pulled or pushed"
                    }
                    Opens::Pull => {
                        "locked, or to be pushed, or shut by more than 70 N: the lever is down as far as it was pressed, and the door \
                         does not come when it is pulled"
                    }
                    Opens::Push => {
                        "locked, or to be pulled, or shut by more than 70 N: the lever is down as far as it was pressed, and the door \
                         does not go when it is pushed"
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
        if self.eyes.room().is_some_and(|room| room < ROOM_MIN) {
            return Progress::Aborted("no room: something is less than 30 mm from the robot".to_owned());
        }
        if !self.eyes.wall().is_found() && self.spent > LOOK {
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

/// The reason for a doubt.
fn refuse(doubt: Doubt) -> Progress {
    let reason = match doubt {
        Doubt::Handle => "lost the handle: the width between the fingers is not the width of a handle",
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
            "the leaf seems to have turned further than the handle has gone: the laser does not see the leaf or wall of this door"
        }
        Doubt::Left => "lost the handle: the leaf is not as far from the hand as when the opening began",
        Doubt::Hinge => "the hinge estimate is wrong: no door has such a radius",
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
            "Opens a door to an angle [rad] about its hinge, which it first assumes at a radius [m]. Pulls, pushes, or finds out the \
             direction; ends only if it holds the handle.",
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
        Ok(Self::with(Settings {
            goal: arguments.number("goal"),
            radius: arguments.number("radius"),
            opens: match arguments.text("swing") {
                "pull" => Opens::Pull,
                "push" => Opens::Push,
                _ => Opens::Either,
            },
            expected,
        }))
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        *self = Self::with(self.settings);
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
        let Place { odometry_from_base, base_from_tool, .. } = known.place;
        let base = odometry_from_base.translation.vector.xy();
        let posture = Posture { odometry_from_tool: odometry_from_base * base_from_tool, base };
        // If the hand stops, a door that still moves runs into it.
        let Settings { goal, radius, opens, .. } = self.settings;
        let left = self.eyes.leaf().map_or(goal, |leaf| goal + self.watch.slip() - leaf.angle);
        let room = self.eyes.room().map_or(1.0, |room| ((room - ROOM_MIN) / ROOM_SLOW).clamp(PACE_MIN, 1.0));
        let opening = self.opening.get_or_insert_with(|| Opening::new(&posture, radius, opens));
        // A pushed door is slower anyway, and does not run into the hand.
        let slowest = if opening.pushes() { PUSH_PACE_MIN } else { PACE_MIN };
        let pace = (left / BRAKE).clamp(slowest, 1.0).min(room) * self.watch.pace();
        let delay = loop_delay(inputs.wrench.age(tick.now).unwrap_or_default().as_secs_f64());
        let pull = opening.update(&posture, &known.wrench, pace, delay, tick.dt());
        let (radius, sense) = (opening.hinge().radius(), opening.sense());
        self.pull = Some(pull);
        let leaf = self.look(inputs);
        if let (Some(leaf), Some(opening)) = (leaf, &mut self.opening) {
            let wall = self.eyes.wall();
            opening.see(sense * leaf.angle, wall.radius().filter(|_| wall.turned().is_none()));
        }
        outputs.velocity.send(self.velocity(&known, &pull, delay, tick.dt()));
        outputs.guide.send(Constraint {
            tangent: pull.guide.tangent_in_tool.into(),
            up: pull.guide.up_in_tool.into(),
            upward: pull.guide.upward,
            turned: pull.guide.turned,
        });
        let (seen_radius, turned) = (self.eyes.wall().radius(), self.eyes.wall().turned());
        let way = self.opening.as_ref().map_or(0.0, Opening::way);
        let (believed, moved) = (pull.angle, self.eyes.turned());
        let (width, unloaded) = (known.width, self.rest.is_unloaded());
        let evidence = Evidence { width, believed, leaf, radius, seen_radius, turned, moved, way, unloaded };
        self.result(&pull, &evidence)
    }

    fn signals(&self) -> Vec<Signal> {
        let radius = self.opening.as_ref().map_or(f64::NAN, |opening| opening.hinge().radius());
        let [pull, pull_max, pace] = self.pull.map_or([f64::NAN; 3], |pull| pull.effort);
        let seen = |angle: fn(Leaf) -> f64| self.eyes.leaf().map_or(f64::NAN, |leaf| angle(leaf).to_degrees());
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
            signal("hand to leaf", "mm", self.eyes.leaf().map_or(f64::NAN, |leaf| 1e3 * leaf.away)),
            signal("seen radius", "m", self.eyes.wall().radius().unwrap_or(f64::NAN)),
            signal("turned without the wall", "deg", self.eyes.wall().turned().map_or(f64::NAN, f64::to_degrees)),
            signal("turned without the wheels", "deg", self.eyes.turned().to_degrees()),
            signal("room", "m", self.eyes.room().unwrap_or(f64::NAN)),
            signal("odometry jumps", "", f64::from(self.track.jumps())),
        ]
    }
}
