//! A change of a deployment while it runs: the request, and the steps between its home and its hosts.
//!
//! ```text
//! home                          each host
//!   ──Examine──▶  could it?     ──Examined──▶   one reason, and nothing has changed anywhere
//!   ──Apply────▶  programs         ──Applied──▶
//!                                  ──Joined───▶   the same, and where programs are that were added
//!   ──Link─────▶  links            ──Linked───▶   (`LinkAlso`: with those)
//!   ──Adopt────▶  connection sets  ──Healthy──▶  once new programs have passed their probation
//!                                  ──Failed───▶  one has not; on its host the program before is started again
//! ```
//! If a change fails on a host, it is undone by the same steps from `Apply` on, with the previous plan.

use super::LeafFacts;
use language::plan::Plan;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// A request to change a running deployment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ChangeRequest {
    /// The name of the deployment.
    pub name: String,
    /// The epoch that the user has seen.
    pub epoch: u64,
    /// The revision that the user has seen. If it has changed since then, the change is refused.
    pub revision: u32,
    /// The new plan, with its own numbers.
    pub plan: Plan,
    /// Processes whose programs are restarted although their plan is the same: absolute paths.
    pub again: Vec<String>,
    /// How long a new program has to stay healthy; otherwise its predecessor is restored.
    pub probation: Duration,
    /// The user who makes the change, for the records, such as `ann@c1`.
    pub by: String,
}

/// The running deployment of a name, and the revision of its plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Revision {
    /// The epoch of the deployment.
    pub epoch: u64,
    /// The number of changes since it was deployed.
    pub revision: u32,
    /// The present plan. During a change, this is the next plan as soon as the hosts apply it.
    pub plan: Plan,
    /// The change that is being made.
    pub change: Option<ChangeUnderway>,
}

/// A change that is being made.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChangeUnderway {
    /// The revision that the deployment gets when the change is complete.
    pub revision: u32,
    /// The user who makes the change.
    pub by: String,
    /// The stage of the change.
    pub stage: ChangeStage,
}

/// The stage of a change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ChangeStage {
    /// The hosts examine whether the change can be made. Nothing has changed.
    Examined,
    /// Programs are started and links made.
    Applied,
    /// The change is made, and new programs have to stay healthy for a while.
    Probation,
    /// The change has failed, and the previous state is being restored.
    TakenBack,
}

/// A step of a change, from the home to a host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ChangeOrder {
    /// Say whether this host could apply the plan.
    Examine {
        /// The number of the change; the answer repeats it.
        number: u32,
        /// The next plan, which keeps the numbers of the running plan.
        plan: Plan,
    },
    /// Apply the plan: end and start programs. The connection sets stay unchanged.
    Apply {
        /// The number of the change; the answer repeats it.
        number: u32,
        /// The next plan.
        plan: Plan,
        /// Leaves whose programs are restarted although their plan is the same.
        again: Vec<u32>,
        /// How long a new program has to stay healthy.
        probation: Duration,
    },
    /// Make the links of the applied plan, in addition to the present links.
    Link {
        /// The number of the change; the answer repeats it.
        number: u32,
    },
    /// Use the connection sets of the applied plan.
    Adopt {
        /// The number of the change; the answer repeats it.
        number: u32,
    },
    /// The change is complete or undone everywhere. Programs that only the previous plan has end, and their devices are
    /// free. This has no answer.
    Settle {
        /// The change.
        number: u32,
    },
    /// The same as `Link`, if programs were added.
    LinkAlso {
        /// The number of the change; the answer repeats it.
        number: u32,
        /// Where the added programs are.
        facts: Vec<LeafFacts>,
    },
}

/// The answer of a host.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ChangeReply {
    /// The answer to `Examine`.
    Examined {
        /// The number of the order.
        number: u32,
        /// The reasons against the plan; none if the host could apply it.
        reasons: Vec<String>,
    },
    /// The answer to `Apply`: every program of the host runs again.
    Applied {
        /// The number of the order.
        number: u32,
    },
    /// The answer to `Link`: every new link of the host is up.
    Linked {
        /// The number of the order.
        number: u32,
    },
    /// The answer to `Adopt`: every new program of the host has passed its probation.
    Healthy {
        /// The number of the order.
        number: u32,
    },
    /// A new program was unhealthy, and its predecessor was restored. Or the links of a new program could not be made.
    Failed {
        /// The number of the order.
        number: u32,
        /// A sentence for a person.
        reason: String,
    },
    /// The answer to `Apply`: every program of the host runs, including the added ones.
    Joined {
        /// The number of the order.
        number: u32,
        /// The locations of the added programs.
        facts: Vec<LeafFacts>,
    },
}

impl ChangeOrder {
    /// Returns the answer of a host that cannot carry out the step.
    pub fn failed(&self, reason: String) -> ChangeReply {
        let (Self::Examine { number, .. }
        | Self::Apply { number, .. }
        | Self::Link { number }
        | Self::Adopt { number }
        | Self::LinkAlso { number, .. }
        | Self::Settle { number }) = self;
        ChangeReply::Failed { number: *number, reason }
    }
}
