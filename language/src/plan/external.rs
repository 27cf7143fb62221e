//! Processes of other deployments that a plan uses.

use super::Plan;
use serde::{Deserialize, Serialize};
use std::fmt;

/// A process of another deployment, on the host of the leaf that refers to it.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct External {
    /// The name of that deployment.
    pub deployment: String,
    /// The absolute path of the process there.
    pub path: String,
}

impl fmt::Display for External {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "`{}` of `{}`", self.path, self.deployment)
    }
}

impl Plan {
    /// Returns the process of another deployment that a leaf refers to, if it does.
    pub fn external(&self, leaf: u32) -> Option<&External> {
        self.leaves.get(leaf as usize)?.external.as_ref()
    }
}
