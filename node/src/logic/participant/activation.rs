//! The orders of supervisors to run and to stop the processes of this host.

use super::Participant;
use crate::logic::effect::Out;
use crate::logic::protocol::{Change, Ending, Failure, FailureCause, Target};

/// Returns why nothing begins in a part that is at its end, or is not there any more.
pub(in crate::logic) fn gone() -> FailureCause {
    FailureCause::NotAvailable("its node has left the deployment".to_owned())
}

impl Participant {
    /// Runs a process of this host, for its supervisor.
    pub(super) fn activate(&mut self, target: Target, activation: u32, value: Vec<u8>, out: &mut Out<'_>) {
        match target {
            target if self.is_leaving() => {
                let (origin, at) = (String::new(), self.since_go(out.now));
                let failure = Failure { origin, cause: gone(), at };
                self.tell_supervisor(target, activation, Ending::Aborted(failure), out);
            }
            target if self.is_early(target, out.now) => self.begin_later(target, activation, value),
            Target::Leaf(leaf) if self.externals.contains_key(&leaf) => self.attach(leaf, activation, out),
            Target::Leaf(leaf) if self.refuse_held(leaf, activation, out) => {}
            Target::Leaf(leaf) => {
                self.with_instance(leaf, out, |instance, context| instance.activate(activation, value, context));
            }
            Target::Group(group) => {
                if let Some(executer) = self.executers.get(group).filter(|executer| executer.is_running()) {
                    if executer.activation() != activation {
                        let origin = self.plan.groups.get(group as usize).map(|group| group.path.clone());
                        let (origin, at) = (origin.unwrap_or_default(), self.since_go(out.now));
                        let failure = Failure { origin, cause: FailureCause::Busy, at };
                        self.tell_supervisor(target, activation, Ending::Aborted(failure), out);
                    }
                    return;
                }
                self.happened(target, Change::Activated, out);
                self.with_executer(group, out, |executer, at, out| executer.activate(activation, &value, at, out));
            }
        }
    }

    /// Stops an activation of one.
    pub(super) fn stop(&mut self, target: Target, activation: u32, out: &mut Out<'_>) {
        match target {
            target if self.never_begins(target, activation) => {
                self.tell_supervisor(target, activation, Ending::Stopped, out);
            }
            Target::Leaf(leaf) if self.externals.contains_key(&leaf) => self.detach(leaf, activation, out),
            Target::Leaf(leaf) => self.with_instance(leaf, out, |instance, context| instance.stop(activation, context)),
            Target::Group(group) => {
                self.happened(target, Change::Stopping, out);
                self.with_executer(group, out, |executer, at, out| executer.stop(activation, at, out));
            }
        }
    }
}
