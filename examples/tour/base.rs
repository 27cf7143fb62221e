//! The hardware level: motors, encoders, sonars, a reader of tags and a battery, all simulated.
//!
//! The model of the drive: each wheel follows its ordered speed with a limited acceleration. The encoders count the turns of
//! the wheels. The floor moves less or more than this, because the wheels slip. Two robots have a model each, so they do not
//! see each other.

use super::battery::Battery;
use super::museum::{EXHIBITS, Point, SONAR_MAX, SONARS, TAGS, range, sees, wrapped};
use super::{FRESH, FloorPose, PERIOD};
use crate::headline;
use controllers::sdk::serde::{Deserialize, Serialize};
use controllers::sdk::{
    About, Arguments, Controller, In, Inputs, Kind, Message, Out, Outputs, Parameter, Progress, Quantity, Random,
    Signal, Tick,
};
use std::time::Duration;

/// Half of the distance between the wheels.
pub(super) const TRACK_HALF: f64 = 0.2;
/// The greatest speed of a wheel (m/s).
const WHEEL_SPEED_MAX: f64 = 1.2;
/// The greatest acceleration of a wheel (m/s²).
const WHEEL_ACCELERATION: f64 = 2.0;
/// The standard deviation of the slip of a wheel, as a part of its way in one period.
const SLIP: f64 = 0.05;
/// The standard deviations of a measured distance, and of a measured bearing.
const DISTANCE_NOISE: f64 = 0.02;
const BEARING_NOISE: f64 = 0.02;
/// The distance from which a tag can be read.
const TAG_DISTANCE: f64 = 4.0;
/// The distance from the dock at which the battery is charged, and how fast (%/s).
const DOCK_DISTANCE: f64 = 0.25;
const CHARGING: f64 = 20.0;

/// How the base shall move.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
pub(super) struct Twist {
    /// (m/s)
    pub(super) forward: f64,
    /// (rad/s)
    pub(super) turn: f64,
}

impl Message for Twist {
    const TYPE: &'static str = "Twist";
    const FIELDS: &'static str = "forward: Speed, turn: AngularSpeed";
}

/// How far each wheel has turned since the base was started.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
pub(super) struct Encoders {
    pub(super) left: f64,
    pub(super) right: f64,
}

impl Message for Encoders {
    const TYPE: &'static str = "Encoders";
    const FIELDS: &'static str = "left: Length, right: Length";
}

/// The distances that the sonars measure, in the order of [`SONARS`]. A missing echo counts as [`SONAR_MAX`].
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
pub(super) struct Ranges {
    pub(super) distances: Vec<f64>,
}

impl Message for Ranges {
    const TYPE: &'static str = "Ranges";
    const FIELDS: &'static str = "distances: Length[]";
}

/// The tags that the robot reads: their numbers in [`TAGS`], distances and bearings.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
pub(super) struct Sightings {
    pub(super) tags: Vec<f64>,
    pub(super) distances: Vec<f64>,
    pub(super) bearings: Vec<f64>,
}

impl Message for Sightings {
    const TYPE: &'static str = "Sightings";
    const FIELDS: &'static str = "tags: Number[], distances: Length[], bearings: Angle[]";
}

#[derive(Inputs)]
pub(super) struct BaseInputs {
    /// How to move. Without a recent value, the base stops.
    #[port("Twist", optional)]
    twist: In<Twist>,
}

#[derive(Outputs)]
pub(super) struct BaseOutputs {
    /// The turns of the wheels.
    #[port("Encoders")]
    encoders: Out<Encoders>,
    /// The sonars.
    #[port("Ranges")]
    ranges: Out<Ranges>,
    /// The tags in view.
    #[port("Sightings")]
    sightings: Out<Sightings>,
    /// The battery.
    #[port("Battery")]
    battery: Out<Battery>,
}

/// The simulated base.
pub(super) struct RoverBase {
    dock: Point,
    /// (%/s)
    drain: f64,
    place: FloorPose,
    /// The speeds of the left and of the right wheel (m/s).
    wheels: [f64; 2],
    encoders: Encoders,
    charge: f64,
    random: Random,
}

impl RoverBase {
    /// Moves for a time towards an ordered motion.
    fn drive(&mut self, ordered: Twist, dt: f64) {
        let turn = ordered.turn * TRACK_HALF;
        let wanted = [ordered.forward - turn, ordered.forward + turn];
        let mut ways = [0.0; 2];
        for ((wheel, wanted), way) in self.wheels.iter_mut().zip(wanted).zip(&mut ways) {
            let wanted = wanted.clamp(-WHEEL_SPEED_MAX, WHEEL_SPEED_MAX);
            let change = WHEEL_ACCELERATION * dt;
            *wheel += (wanted - *wheel).clamp(-change, change);
            *way = *wheel * dt;
        }
        self.encoders.left += ways[0];
        self.encoders.right += ways[1];
        let [left, right] = ways.map(|way| way * (1.0 + self.random.normal(SLIP)));
        let (forward, turned) = ((left + right) / 2.0, (right - left) / (2.0 * TRACK_HALF));
        let direction = self.place.yaw + turned / 2.0;
        let next = Point::new(self.place.x + forward * direction.cos(), self.place.y + forward * direction.sin());
        // A wall stops the base.
        if super::museum::clearance(next) > 0.15 {
            (self.place.x, self.place.y) = (next.x, next.y);
        }
        self.place.yaw = wrapped(self.place.yaw + turned);
    }

    fn ranges(&mut self) -> Ranges {
        let from = Point::new(self.place.x, self.place.y);
        let measured = SONARS.map(|angle| {
            let distance = range(from, self.place.yaw + angle, SONAR_MAX);
            // One echo in a hundred is missing.
            let is_lost = self.random.unit() < 0.01;
            if is_lost { SONAR_MAX } else { (distance + self.random.normal(DISTANCE_NOISE)).clamp(0.0, SONAR_MAX) }
        });
        Ranges { distances: measured.to_vec() }
    }

    fn sightings(&mut self) -> Sightings {
        let from = Point::new(self.place.x, self.place.y);
        let mut seen = Sightings::default();
        for (number, tag) in TAGS.iter().enumerate() {
            let distance = from.distance(*tag);
            if distance < TAG_DISTANCE && sees(from, *tag) {
                let bearing = (tag.y - from.y).atan2(tag.x - from.x) - self.place.yaw;
                seen.tags.push(number as f64);
                seen.distances.push(distance + self.random.normal(DISTANCE_NOISE));
                seen.bearings.push(wrapped(bearing + self.random.normal(BEARING_NOISE)));
            }
        }
        seen
    }
}

impl Controller for RoverBase {
    type Inputs = BaseInputs;
    type Outputs = BaseOutputs;
    const TYPE: &'static str = "RoverBase";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[
            Parameter::new("x", Kind::Quantity(Quantity::Length, 0.0, 10.0)),
            Parameter::new("y", Kind::Quantity(Quantity::Length, 0.0, 6.0)),
            Parameter::new("charge", Kind::Number(1.0, 100.0)).or("100"),
            Parameter::new("drain", Kind::Number(0.0, 10.0)).or("0.5"),
            Parameter::new("seed", Kind::Whole(0.0, 1e9)).or("1"),
        ];
        About::service("A simulated base, at its dock at first, with sonars, a reader of tags and a battery.")
            .remembers()
            .every(PERIOD)
            .with(PARAMETERS)
            .signals_every(Duration::from_millis(200))
    }

    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the seed is within its range")]
    fn new(arguments: &Arguments) -> Result<Self, String> {
        let dock = Point::new(arguments.number("x"), arguments.number("y"));
        let place = FloorPose { x: dock.x, y: dock.y, yaw: std::f64::consts::FRAC_PI_2 };
        let random = Random::new(arguments.number("seed") as u64);
        let (charge, drain) = (arguments.number("charge"), arguments.number("drain"));
        Ok(Self { dock, drain, place, wheels: [0.0; 2], encoders: Encoders::default(), charge, random })
    }

    fn main_calc(&mut self, tick: Tick, inputs: &BaseInputs, outputs: &mut BaseOutputs) -> Progress {
        let dt = tick.dt().min(0.2);
        let ordered = inputs.twist.fresh_within(tick.now, FRESH).copied().unwrap_or_default();
        self.drive(ordered, dt);
        let from = Point::new(self.place.x, self.place.y);
        let is_docked = from.distance(self.dock) < DOCK_DISTANCE;
        let change = if is_docked { CHARGING } else { -self.drain };
        self.charge = (self.charge + change * dt).min(100.0);
        if self.charge <= 0.0 {
            return Progress::Aborted("the battery is empty".to_owned());
        }
        outputs.encoders.send(self.encoders);
        outputs.ranges.send(self.ranges());
        outputs.sightings.send(self.sightings());
        outputs.battery.send(Battery { charge: self.charge });
        Progress::Continue
    }

    fn signals(&self) -> Vec<Signal> {
        let FloorPose { x, y, .. } = self.place;
        let near = |exhibit: &super::museum::Exhibit| exhibit.place.distance(Point::new(x, y));
        let nearest = EXHIBITS.iter().skip(1).map(near).fold(f64::INFINITY, f64::min);
        vec![
            headline("charge", "%", self.charge),
            Signal { name: "x".into(), unit: "m".into(), value: x, headline: false },
            Signal { name: "y".into(), unit: "m".into(), value: y, headline: false },
            Signal { name: "nearest exhibit".into(), unit: "m".into(), value: nearest, headline: false },
        ]
    }
}
