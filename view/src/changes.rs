//! The changes since the last look of a viewer.

use crate::deployment::{LiveDeployment, Process};
use crate::identity::{MissionId, RobotId};
use crate::model::EventLine;
use crate::robot::Robot;
use crate::wires::Wire;
use std::fmt;
use std::str::FromStr;

/// The place up to which a viewer knows a model. Written as `MODEL-NUMBER`, for example `17-2048`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Position {
    /// The model: a model that was started again has another number here.
    pub model: u64,
    /// The number of the last input.
    pub number: u64,
}

impl fmt::Display for Position {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}-{}", self.model, self.number)
    }
}

impl FromStr for Position {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        let (model, number) = text.split_once('-').ok_or(())?;
        let read = |text: &str| text.parse().map_err(|_not_a_number| ());
        Ok(Self { model: read(model)?, number: read(number)? })
    }
}

/// A thing that a model no longer has.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Gone {
    /// The robot has left.
    Robot(RobotId),
    /// A deployment that is over is no longer kept.
    Deployment(MissionId),
    /// A process is no longer part of its deployment on any host that answers.
    Process(MissionId, String),
    /// A wire is no longer part of its deployment.
    Wire(MissionId, String),
}

/// The changes since a position. An item that has changed several times is here once, with its latest state. Output of
/// programs is not among them.
#[derive(Clone, Debug)]
pub struct Changes<'a> {
    /// The position to ask from the next time.
    pub position: Position,
    /// Whether these are all items of the model. Then a viewer discards its earlier items.
    pub is_whole: bool,
    /// The robots that have changed. A new age alone is not a change.
    pub robots: Vec<&'a Robot>,
    /// The deployments whose phase or end has changed.
    pub deployments: Vec<&'a LiveDeployment>,
    /// The processes that have changed.
    pub processes: Vec<(&'a MissionId, &'a Process)>,
    /// The wires that have changed.
    pub wires: Vec<(&'a MissionId, &'a Wire)>,
    /// New events, the oldest first.
    pub events: Vec<&'a EventLine>,
    /// Items that are gone.
    pub gone: Vec<&'a Gone>,
}

impl Changes<'_> {
    /// Returns whether nothing has changed.
    pub fn is_empty(&self) -> bool {
        let items = self.robots.len() + self.deployments.len() + self.processes.len() + self.wires.len();
        !self.is_whole && items + self.events.len() + self.gone.len() == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_position_is_read_as_it_is_written() {
        let position = Position { model: 17, number: 2048 };
        assert_eq!(position.to_string().parse(), Ok(position));
        for wrong in ["", "17", "17-", "-5", "a-b", "1-2-3", "99999999999999999999-1"] {
            assert_eq!(wrong.parse::<Position>(), Err(()), "{wrong}");
        }
    }
}
