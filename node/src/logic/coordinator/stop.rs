//! The end of a deployment before its `main` has ended. This file has the callers that asked for the end, and whether
//! the disk has forgotten the deployment.

use crate::logic::effect::{Effect, Out};
use crate::logic::protocol::{Answer, Deployment, StopReply};
use serde::{Deserialize, Serialize};

#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Stop {
    pub(super) by: StopBy,
    /// The callers that wait for the end.
    pub(super) calls: Vec<u64>,
    /// How many times the disk still has to confirm that it has forgotten the deployment.
    pub(super) unkeeping: u32,
}

/// Why a deployment is to end.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub(super) enum StopBy {
    #[default]
    None,
    /// Its node leaves, perhaps for a reboot.
    Node,
    /// A user asked for it.
    User,
}

impl Stop {
    /// Takes the request of a caller, or the departure of the node.
    pub(super) fn ask(&mut self, call: Option<u64>) {
        self.calls.extend(call);
        self.by = self.by.max(if call.is_some() { StopBy::User } else { StopBy::Node });
    }

    /// Orders the disk to forget the deployment. A user who asked for the end waits until the record is removed from the disk.
    pub(super) fn unkeep(&mut self, deployment: &Deployment, out: &mut Out<'_>) {
        self.unkeeping += u32::from(self.by == StopBy::User);
        out.effects.push(Effect::Unkeep { deployment: deployment.clone() });
    }

    /// Answers the callers when nothing is left of the deployment.
    pub(super) fn answer(&mut self, out: &mut Out<'_>) {
        for call in std::mem::take(&mut self.calls) {
            out.answer_last(call, Answer::Stop(StopReply::Stopped));
        }
    }
}
