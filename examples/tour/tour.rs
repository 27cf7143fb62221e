//! The programs of the tour guides of `specs/tour_guide.dca`. Two robots show the exhibits of a museum, and share a desk, a
//! speech service and a camera.
//!
//! Each module is one component. Lengths are in metres, angles in radians, times in seconds. The floor has its origin in a
//! corner of the museum. The angle of a pose is measured from the x axis, counter-clockwise.

mod base;
mod battery;
mod camera;
mod desk;
mod drive;
mod ear;
mod localisation;
mod museum;
mod odometry;
mod planner;
mod sonar;
mod speech;

use controllers::sdk::serde::{Deserialize, Serialize};
use controllers::sdk::{Message, Registry};
use std::time::Duration;

/// The period of the programs of a robot.
const PERIOD: Duration = Duration::from_millis(50);
/// How old a value of the robot's own programs may be.
const FRESH: Duration = Duration::from_millis(500);
/// How long an off-board service has for an answer.
const ANSWER_WITHIN: Duration = Duration::from_secs(2);

/// A place on the floor, and a direction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
struct FloorPose {
    x: f64,
    y: f64,
    yaw: f64,
}

impl Message for FloorPose {
    const TYPE: &'static str = "FloorPose";
    const FIELDS: &'static str = "x: Length, y: Length, yaw: Angle";
}

/// The exhibits that visitors want to see, in their order. The number of an exhibit points into [`museum::EXHIBITS`].
/// Number 0 is the dock.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
struct Tour {
    number: f64,
    stops: Vec<f64>,
}

impl Message for Tour {
    const TYPE: &'static str = "Tour";
    const FIELDS: &'static str = "number: Number, stops: Number[]";
}

impl Tour {
    /// Returns the number of the next exhibit. None if the tour is over.
    fn next(&self) -> Option<usize> {
        exhibit(*self.stops.first()?)
    }

    /// Returns the tour behind its next exhibit.
    fn rest(&self) -> Self {
        Self { number: self.number, stops: self.stops.iter().skip(1).copied().collect() }
    }
}

/// The way to the next exhibit of a tour: a line with corners.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
struct TourLeg {
    number: f64,
    /// As in [`Tour`]. The first of them is the end of this way.
    stops: Vec<f64>,
    x: Vec<f64>,
    y: Vec<f64>,
}

impl Message for TourLeg {
    const TYPE: &'static str = "TourLeg";
    const FIELDS: &'static str = "number: Number, stops: Number[], x: Length[], y: Length[]";
}

impl TourLeg {
    fn tour(&self) -> Tour {
        Tour { number: self.number, stops: self.stops.clone() }
    }
}

/// Returns the place of an exhibit in the list, for a number in a message. None if there is no such exhibit.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the range is checked")]
fn exhibit(number: f64) -> Option<usize> {
    let is_there = number >= 0.0 && number < museum::EXHIBITS.len() as f64;
    is_there.then_some(number as usize)
}

/// Reads the value with which a process starts.
///
/// # Errors
/// Says for a person why the bytes are not a value of this type.
fn start<T: Message>(value: &[u8]) -> Result<T, String> {
    postcard::from_bytes(value).map_err(|cause| format!("its start value is not a `{}`: {cause}", T::TYPE))
}

/// Adds the controllers of this example.
pub(crate) fn add(registry: &mut Registry) {
    registry.add::<base::RoverBase>().add::<odometry::Odometry>().add::<sonar::SonarWalls>();
    registry.add::<localisation::Localisation>().add::<planner::PlanLeg>().add::<drive::DriveLeg>();
    registry.add::<battery::LowBattery>().add::<battery::Charge>().add::<ear::Ear>().add::<desk::NextTour>();
    registry.add::<camera::Look>().add::<speech::Say>();
    registry.add::<desk::Desk>().add::<camera::CameraService>().add::<speech::SpeechService>();
}
