//! Answers that promise that a deployment does not begin again: each is sent once the disk has forgotten the deployment.

use super::calls::STOPPED;
use super::{Agent, AwaitingHosts};
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
    /// Returns whether no answer waits.
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Forgets a caller that has gone away. The disk still forgets the deployment.
    pub(super) fn forget(&mut self, call: u64) {
        let is_other = |promise: &Promise| !matches!(promise, Promise::Stopped(waiting) if *waiting == call);
        self.0.values_mut().for_each(|promises| promises.retain(is_other));
    }
}

impl Agent {
    /// Sends this answer once the disk has forgotten a deployment. The disk was asked before.
    pub(super) fn promise(&mut self, deployment: Deployment, promise: Promise) {
        self.callers.promises.0.entry(deployment).or_default().push(promise);
    }

    /// Stops a deployment of this name that has not begun, and answers when it is certain that it never begins. Returns whether
    /// there is such a deployment.
    pub(super) fn stop_waiting(&mut self, call: u64, name: &str, out: &mut Out<'_>) -> bool {
        let is_meant = |one: &&AwaitingHosts| one.plan.name == name;
        let Some(one) = self.pending.awaiting.iter().find(is_meant) else { return false };
        let before = one.resumed.as_ref().map(|resumed| resumed.before().clone());
        self.stop_gathering(|plan| plan.name == name, STOPPED, out);
        if let Some(before) = before {
            self.promise(before, Promise::Stopped(call));
        } else {
            out.answer_last(call, Answer::Stop(StopReply::Stopped));
        }
        true
    }

    /// Takes note that the disk has forgotten a deployment, or why it has not.
    pub(super) fn unkept(&mut self, deployment: &Deployment, written: &Result<(), String>, out: &mut Out<'_>) {
        if let Some(home) = self.coordinators.get_mut(deployment) {
            home.unkept(out);
        }
        for promise in self.callers.promises.0.remove(deployment).unwrap_or_default() {
            match promise {
                Promise::Stopped(call) => {
                    let refused = |why: &String| Answer::Refused(self.not_for_good(&deployment.name, why));
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

    fn not_for_good(&self, name: &str, why: &str) -> String {
        format!(
            "`{name}` does not begin while this node runs, but it may after a reboot: host `{}` cannot write down that it was stopped: {why}",
            self.identity.host
        )
    }

    /// Asks the disk again, because a killed node has not heard the answers.
    pub(super) fn unkeep_again(&mut self, out: &mut Out<'_>) {
        let promised = self.callers.promises.0.keys();
        out.effects.extend(promised.map(|deployment| Effect::Unkeep { deployment: deployment.clone() }));
        self.coordinators.values_mut().for_each(|home| home.unkeep_again(out));
    }
}
