//! The facts about a program that has started.

use comms::logic::control::Location;
use serde::{Deserialize, Serialize};

/// The facts that a program reports about itself at its start.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeafFacts {
    /// Index into `Plan::leaves`.
    pub leaf: u32,
    /// The address of its data session, if it has one.
    pub location: Option<Location>,
    /// The devices whose keys belong to it.
    pub owns: Vec<String>,
    /// The devices of other programs that it needs.
    pub needs: Vec<String>,
    /// Whether it publishes signals.
    pub signals: bool,
}

impl LeafFacts {
    /// Returns the facts of a program that takes no part in communication.
    pub fn plain(leaf: u32) -> Self {
        Self { leaf, location: None, owns: Vec::new(), needs: Vec::new(), signals: false }
    }
}
