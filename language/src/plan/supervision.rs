//! The supervision of a group: the strategy for its programs when one of them dies and is restarted.

use serde::{Deserialize, Serialize};
use std::time::Duration;

/// The most restarts that a group may allow.
pub const RESTARTS_MAX: u32 = 1000;

/// How a group supervises its programs. By default, each program is restarted alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Supervision {
    /// The programs that are restarted together with the dead program.
    pub strategy: Strategy,
    /// How often programs of the group are started again before the group aborts. Without it only the node's own bound for each
    /// program applies.
    pub intensity: Option<Intensity>,
}

/// The strategies for a group whose program dies and is restarted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Strategy {
    /// That one.
    #[default]
    OneForOne,
    /// All of the group.
    OneForAll,
    /// The dead program, and all programs that are declared after it.
    RestForOne,
}

/// How many restarts a group bears.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Intensity {
    /// So many restarts are borne,
    pub restarts: u32,
    /// within this time.
    pub within: Duration,
}
