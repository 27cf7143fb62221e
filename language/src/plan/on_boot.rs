//! The fate of a running deployment after its home's machine was rebooted.

use serde::{Deserialize, Serialize};

/// The home's action after a reboot with a deployment that ran before it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum OnBoot {
    /// It reports that the deployment did not continue, and forgets it, because a machine that moves when its power returns is a hazard.
    #[default]
    None,
    /// It deploys the same plan again, which starts from the beginning.
    Resume,
}
