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
//! A change that has failed on a host is taken back by the same steps from `Apply` on, with the previous plan.

use super::LeafFacts;
use language::plan::Plan;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// A request to change a running deployment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ChangeRequest {
    /// Its name.
    pub name: String,
    /// The epoch that was seen.
    pub epoch: u64,
    /// The revision that was seen: another one since then refuses the change.
    pub revision: u32,
    /// The new plan, with numbers of its own.
    pub plan: Plan,
    /// Processes whose programs are started again although their plan is the same: absolute paths.
    pub again: Vec<String>,
    /// How long a new program has to stay healthy; otherwise its predecessor is restored.
    pub probation: Duration,
    /// The user who wants it, for the records, such as `ann@c1`.
    pub by: String,
}

/// The deployment that runs under a name, and the revision of its plan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Revision {
    /// The epoch of the deployment.
    pub epoch: u64,
    /// How often it was changed since it was deployed.
    pub revision: u32,
    /// Its present plan: during a change the next one, once the hosts take it on.
    pub plan: Plan,
    /// The change that is being made.
    pub change: Option<ChangeUnderway>,
}

/// A change that is being made.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChangeUnderway {
    /// The revision of the deployment once the change has held.
    pub revision: u32,
    /// The user who wants it.
    pub by: String,
    /// The stage of the change.
    pub stage: ChangeStage,
}

/// The stage of a change.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ChangeStage {
    /// The hosts examine whether the change could be made; nothing has changed.
    Examined,
    /// Programs are started and links made.
    Applied,
    /// It is made, and new programs have to stay healthy.
    Probation,
    /// It has failed, and the previous state is restored.
    TakenBack,
}

/// A step of a change, from the home to a host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ChangeOrder {
    /// Say whether this plan could be taken on here.
    Examine {
        /// Numbers the change, and is echoed.
        number: u32,
        /// The next plan, with the numbers of the running one.
        plan: Plan,
    },
    /// Take the plan on: end and start programs. The connection sets stay as they are.
    Apply {
        /// Echoed.
        number: u32,
        /// The next plan.
        plan: Plan,
        /// Leaves whose programs are started again although their plan is the same.
        again: Vec<u32>,
        /// How long a new program has to stay healthy.
        probation: Duration,
    },
    /// Make the links of the plan that was applied, in addition to the present ones.
    Link {
        /// Echoed.
        number: u32,
    },
    /// Use the connection sets of the plan that was applied.
    Adopt {
        /// Echoed.
        number: u32,
    },
    /// The change is made, or taken back, everywhere: programs that only the previous plan has leave, and their devices
    /// are free. Not answered.
    Settle {
        /// The change.
        number: u32,
    },
    /// `Link`, where programs were added.
    LinkAlso {
        /// Echoed.
        number: u32,
        /// Where those programs are.
        facts: Vec<LeafFacts>,
    },
}

/// The answer of a host.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ChangeReply {
    /// To `Examine`.
    Examined {
        /// As ordered.
        number: u32,
        /// The reasons against the plan; none if the host could take it on.
        reasons: Vec<String>,
    },
    /// To `Apply`: every program of the host is up again.
    Applied {
        /// As ordered.
        number: u32,
    },
    /// To `Link`: every new link of the host stands.
    Linked {
        /// As ordered.
        number: u32,
    },
    /// To `Adopt`: every new program of the host has passed its probation.
    Healthy {
        /// As ordered.
        number: u32,
    },
    /// A new program was unhealthy, and its predecessor was restored; or its links could not be made.
    Failed {
        /// As ordered.
        number: u32,
        /// A sentence for a person.
        reason: String,
    },
    /// The answer to `Apply`: every program of the host is up, including the added ones.
    Joined {
        /// As ordered.
        number: u32,
        /// The locations of the added programs.
        facts: Vec<LeafFacts>,
    },
}

impl ChangeOrder {
    /// Returns the answer of a host that cannot carry the step out.
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
