//! One live model of all robots, for every view: `dca top` draws it, and a page can show it.
//!
//! A [`Model`] takes [`Input`]s, which are answers and events of nodes, with the time at which they came. It holds what
//! people look at: robots, deployments with their processes and wires, events, output, and open questions. Every list
//! has a limit. Each input has a number, so a viewer asks for the changes since the last number that it has.
//!
//! The model is pure. It reads no clock and asks no node, so it is tested on virtual time.
//!
//! ```
//! use comms::logic::time::Time;
//! use std::time::Duration;
//! use view::{Fleet, Freshness, Input, Model, Position, RobotId};
//!
//! let mut model = Model::new(1);
//! let robot = RobotId { host: "r1".into(), fleet: Fleet::Standing };
//! model.apply(Time::ZERO, Input::Silent { robot: robot.clone(), why: "it does not answer".into() });
//! let changes = model.since(Position::default());
//! assert_eq!(changes.robots[0].id, robot);
//! assert!(model.since(changes.position).is_empty());
//! let later = Time::ZERO + Duration::from_secs(5);
//! assert_eq!(model.freshness(later), Freshness::Never);
//! ```

mod changes;
mod deployment;
mod freshness;
mod history;
mod identity;
mod input;
mod mark;
mod model;
mod output;
mod ring;
mod robot;
pub mod sentence;
#[cfg(test)]
mod tests;
mod text;
mod wires;

pub use changes::{Changes, Gone, Position};
pub use deployment::{End, Health, KnownPlan, LiveDeployment, Process, Question, Since};
pub use freshness::{Freshness, STALE_AFTER};
pub use history::PastChange;
pub use identity::{Fleet, MissionId, RobotId};
pub use input::{Input, Measured};
pub use mark::{LastEnd, Mark};
pub use model::{EventLine, Model};
pub use output::{Lines, OutputLine};
pub use robot::{DatabaseLag, Presence, Robot};
pub use wires::{Rate, Wire, WireEnd};
