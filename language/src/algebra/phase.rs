//! The phase of one node of an expression. Programs and states share it.

use serde::{Deserialize, Serialize};

/// The phase of a node.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub(super) enum Phase {
    #[default]
    Idle,
    Running,
    Second,
    Stopping,
    Draining,
    Done,
    Waiting,
}

impl Phase {
    pub(super) fn is_active(self) -> bool {
        match self {
            Self::Running | Self::Second | Self::Stopping | Self::Draining | Self::Waiting => true,
            Self::Idle | Self::Done => false,
        }
    }
}
