//! What becomes of a deployment that ran when the machine of its home was rebooted.

use serde::{Deserialize, Serialize};

/// What a home does after a reboot with a deployment that ran before it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum OnBoot {
    /// It says that the deployment did not go on, and forgets it: a machine that moves when its power comes back is a hazard.
    #[default]
    None,
    /// It deploys the same plan again, which begins anew.
    Resume,
}
