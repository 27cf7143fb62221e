//! The interpretation of the sonars: single wrong echoes are removed, and the free way ahead is found.

use super::PERIOD;
use super::base::Ranges;
use super::museum::{SONAR_MAX, SONARS};
use controllers::sdk::serde::{Deserialize, Serialize};
use controllers::sdk::{About, Arguments, Controller, In, Inputs, Message, Out, Outputs, Progress, Tick};
use std::collections::VecDeque;

/// How many measurements of each sonar are compared. The middle one is used.
const COMPARED: usize = 3;

/// The walls around the robot.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
pub(super) struct Walls {
    /// For each sonar in the order of [`SONARS`]. Without a near wall, the distance is [`SONAR_MAX`].
    pub(super) distances: Vec<f64>,
    /// How far the way ahead is free.
    pub(super) ahead: f64,
}

impl Message for Walls {
    const TYPE: &'static str = "Walls";
    const FIELDS: &'static str = "distances: Length[], ahead: Length";
}

#[derive(Inputs)]
pub(super) struct SonarInputs {
    /// The measurements.
    #[port("Ranges")]
    ranges: In<Ranges>,
}

#[derive(Outputs)]
pub(super) struct SonarOutputs {
    /// The walls around the robot.
    #[port("Walls")]
    walls: Out<Walls>,
}

/// Compares the last measurements of each sonar.
#[derive(Default)]
pub(super) struct SonarWalls {
    last: VecDeque<Vec<f64>>,
}

impl SonarWalls {
    /// Takes measurements; returns the walls that they show.
    fn take(&mut self, distances: &[f64]) -> Walls {
        self.last.push_back(distances.to_vec());
        while self.last.len() > COMPARED {
            self.last.pop_front();
        }
        let middle = |sonar: usize| {
            let mut values: Vec<f64> =
                self.last.iter().map(|all| all.get(sonar).copied().unwrap_or(SONAR_MAX)).collect();
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied().unwrap_or(SONAR_MAX)
        };
        let distances: Vec<f64> = (0..SONARS.len()).map(middle).collect();
        let ahead = distances.first().copied().unwrap_or(SONAR_MAX);
        Walls { distances, ahead }
    }
}

impl Controller for SonarWalls {
    type Inputs = SonarInputs;
    type Outputs = SonarOutputs;
    const TYPE: &'static str = "SonarWalls";

    fn about() -> About {
        About::service("Finds the walls in the measurements of the sonars.").every(PERIOD).triggered_by("Ranges")
    }

    fn new(_: &Arguments) -> Result<Self, String> {
        Ok(Self::default())
    }

    fn main_calc(&mut self, _: Tick, inputs: &SonarInputs, outputs: &mut SonarOutputs) -> Progress {
        if let Some(ranges) = inputs.ranges.fresh() {
            outputs.walls.send(self.take(&ranges.distances));
        }
        Progress::Continue
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_single_wrong_echo_is_ignored() {
        let mut sonar = SonarWalls::default();
        for (measured, expected) in [(1.0, 1.0), (1.0, 1.0), (SONAR_MAX, 1.0), (0.9, 1.0), (0.9, 0.9)] {
            assert_eq!(sonar.take(&[measured]).ahead.to_bits(), f64::to_bits(expected), "{measured}");
        }
        assert_eq!(sonar.take(&[]).distances.len(), SONARS.len(), "missing sonars see no wall");
    }
}
