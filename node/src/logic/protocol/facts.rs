//! The facts of a program once it is up.

use comms::logic::control::Location;
use serde::{Deserialize, Serialize};

/// The facts that a program states about itself at its start.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeafFacts {
    /// Index into `Plan::leaves`.
    pub leaf: u32,
    /// Where its data session is, if it has one.
    pub location: Option<Location>,
    /// Devices whose keys it owns.
    pub owns: Vec<String>,
    /// Devices of others that it needs.
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
