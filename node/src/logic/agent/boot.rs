//! The deployments that ran here before this node. Each is reported as over, and resumed if its spec says so and the
//! machine was rebooted.
//!
//! A deployment that is resumed waits for the other hosts, which may boot later, and for a possible message from them
//! that it was stopped in the meantime. It is deployed again under the next epoch, so everything left of the previous
//! epoch is fenced off. If a user stops a deployment whose home does not answer, the nodes that do answer keep
//! *tombstones*. Each of these hosts tells the home when the home returns. The home then does not
//! resume the deployment, or ends it, and reports this.

use super::pending::AwaitingHosts;
use crate::logic::effect::Effect;
use crate::logic::protocol::{Deployment, Kept, Signed, StartMode};
use comms::logic::time::Time;
use language::plan::Plan;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::time::Duration;

/// How long a node waits after its start for messages of others, before it resumes anything.
const BOOT_WAIT: Duration = Duration::from_secs(10);
/// How long it waits for hosts that take part, which may boot later.
const BOOT_WITHIN: Duration = Duration::from_secs(120);

/// Where a deployment that waits comes from, if no call has asked for it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Resumed {
    /// The deployment that ran before the reboot.
    pub(super) from: Deployment,
    /// The epoch under which a user has deployed it.
    pub(super) origin: u64,
    /// The earliest time at which it may begin; nothing once that time has passed.
    pub(super) earliest: Option<Time>,
    permission: Permission,
}

/// Whether the user who signed the deployment may still have it: the key may have been revoked since.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Permission {
    /// Not known yet. The question comes last, so that all hosts that know of a revocation have answered before.
    Unknown,
    /// Asked.
    Asked,
    /// Given.
    Given,
}

/// A deployment that ran before a reboot, and that its spec wants to be resumed.
#[derive(Debug)]
pub(super) struct Interrupted {
    pub(super) from: Deployment,
    pub(super) origin: u64,
    /// The user who wanted it.
    pub(super) by: String,
    pub(super) plan: Plan,
    pub(super) signed: Option<Signed>,
}

impl Interrupted {
    /// Waits for the hosts of the deployment.
    pub(super) fn wait(self, now: Time) -> AwaitingHosts {
        let Self { from, origin, by, plan, signed } = self;
        let earliest = Some(now + BOOT_WAIT);
        AwaitingHosts {
            until: now + BOOT_WITHIN,
            call: None,
            plan,
            by,
            signed: signed.map(Arc::new),
            resumed: Some(Resumed { from, origin, earliest, permission: Permission::Unknown }),
            start: StartMode::AtOnce,
        }
    }
}

impl Resumed {
    /// Takes the permission.
    pub(super) const fn permit(&mut self) {
        self.permission = Permission::Given;
    }

    /// Returns whether the permission is given.
    pub(super) fn is_permitted(&self) -> bool {
        self.permission == Permission::Given
    }

    /// Returns whether the permission was asked for, and is not known.
    pub(super) fn is_asked(&self) -> bool {
        self.permission == Permission::Asked
    }

    /// Asks whether the signer of the deployment may still have it, once.
    pub(super) fn ask(&mut self, signed: &Option<Arc<Signed>>) -> Option<Effect> {
        let is_new = self.permission == Permission::Unknown;
        is_new.then(|| {
            self.permission = Permission::Asked;
            self.judge(signed)
        })
    }

    /// Returns the question whether the signer of the deployment may still have it.
    pub(super) fn judge(&self, signed: &Option<Arc<Signed>>) -> Effect {
        Effect::JudgeResumed { deployment: self.from.clone(), signed: signed.clone() }
    }

    /// Returns the record on the disk of a deployment that is resumed, until it has begun.
    pub(super) fn kept(&self, one: &AwaitingHosts) -> Kept {
        let resume = Some((one.plan.clone(), one.signed.as_deref().cloned()));
        let (by, hosts) = (one.by.clone(), one.plan.hosts.clone());
        let (deployment, origin) = (self.from.clone(), self.origin);
        Kept { deployment, origin, by, hosts, has_ended: true, waits: true, resume }
    }
}
