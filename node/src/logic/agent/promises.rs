//! Answers that promise that a deployment does not begin again: each is sent once the disk has forgotten the deployment.

use crate::logic::effect::{Effect, Out};
use crate::logic::protocol::{Answer, Body, Deployment, Message, StopReply};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The answers that wait for the disk, by the deployment that the disk is to forget.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Promises(BTreeMap<Deployment, Vec<Promise>>);

/// An answer that waits for the disk.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) enum Promise {
    /// To the call that has asked for the stop.
    Stopped(u64),
    /// To the host that keeps a tombstone of this deployment.
    Mourned(String, Deployment),
}

impl Promises {
    /// Sends this answer once the disk has forgotten a deployment. The disk was asked before.
    pub(super) fn add(&mut self, deployment: Deployment, promise: Promise) {
        self.0.entry(deployment).or_default().push(promise);
    }

    /// Returns whether no answer waits.
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Forgets a caller that has gone away. The disk still forgets the deployment.
    pub(super) fn forget(&mut self, call: u64) {
        let is_other = |promise: &Promise| !matches!(promise, Promise::Stopped(waiting) if *waiting == call);
        self.0.values_mut().for_each(|promises| promises.retain(is_other));
    }

    /// Takes note that the deployment was removed from the disk of this host, or why this failed. Sends the answers that wait for this.
    pub(super) fn unkept(
        &mut self,
        deployment: &Deployment,
        host: &str,
        written: &Result<(), String>,
        out: &mut Out<'_>,
    ) {
        for promise in self.0.remove(deployment).unwrap_or_default() {
            match promise {
                Promise::Stopped(call) => {
                    let refused = |why: &String| Answer::Refused(not_for_good(&deployment.name, host, why));
                    let said = written.as_ref().map_or_else(refused, |()| Answer::Stop(StopReply::Stopped));
                    out.answer_last(call, said);
                }
                // A host that misses this answer sends its tombstone again after its return.
                Promise::Mourned(to, stopped) if written.is_ok() => {
                    out.send(&to, Message { deployment: stopped, body: Body::Mourned });
                }
                Promise::Mourned(..) => {}
            }
        }
    }

    /// Asks the disk again, because a killed node has not received the answers.
    pub(super) fn unkeep_again(&self, out: &mut Out<'_>) {
        out.effects.extend(self.0.keys().map(|deployment| Effect::Unkeep { deployment: deployment.clone() }));
    }
}

fn not_for_good(name: &str, host: &str, why: &str) -> String {
    format!(
        "`{name}` does not begin while this node runs, but may begin after a reboot: host `{host}` cannot store that `{name}` was \
         stopped: {why}"
    )
}
