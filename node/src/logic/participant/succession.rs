//! Programs of this host that take the place of others while both are there.
//!
//! The change starts and links the next program as if it were added. Then its supervisor has it take over the
//! activation of its predecessor, which keeps running in the meantime. Once it runs, the supervisor hands the
//! connections over, and stops the predecessor. The predecessor leaves when the change has held; it stays until then,
//! in case the next program is unhealthy.

use super::Participant;
use crate::logic::effect::Out;
use crate::logic::executer::MemberRef;
use crate::logic::instance::Instance;
use crate::logic::protocol::{Change, Ending, Target, ToParticipant};
use language::plan::MemberKind;
use serde::{Deserialize, Serialize};

/// A program that is to take the place of another one.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Succeeding {
    by: Supervisor,
    /// The next activation and its value, if the program first has to finish a stop.
    then: Option<(u32, Vec<u8>)>,
}

/// The supervisor of a group.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Supervisor {
    pub(super) group: u32,
    pub(super) host: String,
}

impl Participant {
    /// Activates a program beside another one, for a supervisor.
    pub(super) fn succeed(&mut self, by: Supervisor, leaf: u32, activation: u32, value: Vec<u8>, out: &mut Out<'_>) {
        let Some(instance) = self.instances.get(leaf) else { return };
        // A program that was not healthy is taken away again: its home knows.
        if self.is_adding(leaf) && !instance.is_linked() {
            return;
        }
        let (is_active, is_stopping) = (instance.is_active(), instance.is_stopping());
        let then = is_stopping.then(|| (activation, value.clone()));
        self.changes.succeeding.insert(leaf, Succeeding { by, then });
        if !is_active {
            self.with_instance(leaf, out, |instance, context| instance.activate(activation, value, context));
        } else if !is_stopping {
            // The program was never stopped.
            self.has_begun(leaf, out);
        }
    }

    /// Activates a program again that has finished its earlier stop; returns whether it did so.
    pub(super) fn begins_again(&mut self, leaf: u32, ending: &Ending, out: &mut Out<'_>) -> bool {
        let Some(succeeding) = self.changes.succeeding.get_mut(&leaf) else { return false };
        match succeeding.then.take().filter(|_| *ending == Ending::Stopped) {
            Some((activation, value)) => {
                self.with_instance(leaf, out, |instance, context| instance.activate(activation, value, context));
                true
            }
            None => {
                self.changes.succeeding.remove(&leaf);
                false
            }
        }
    }

    /// A change is not over before programs have handed their connections over.
    pub(super) fn report_handover(&mut self, out: &mut Out<'_>) {
        if self.changes.current.is_some() && !self.hands_over() {
            self.report_change(out);
        }
    }

    /// Returns whether a supervisor of this host hands connections over.
    pub(super) fn hands_over(&self) -> bool {
        self.executers.iter().any(|(_, executer)| executer.hands_over())
    }

    /// Tells a supervisor of this host how a member has ended.
    pub(super) fn member_ended(&mut self, target: Target, activation: u32, ending: Ending, out: &mut Out<'_>) {
        let Some(&(group, slot)) = self.site.supervisors.get(&target) else { return };
        self.with_executer(group, out, |executer, at, out| {
            if !executer.speaks(slot, target, at, out) {
                return None;
            }
            executer.ended(MemberRef { slot, activation }, ending, at, out)
        });
    }

    /// Tells a supervisor that a program runs that is to take the place of another one.
    pub(super) fn has_begun(&mut self, leaf: u32, out: &mut Out<'_>) {
        let Some(Succeeding { by: Supervisor { group, host }, .. }) = self.changes.succeeding.remove(&leaf) else {
            return;
        };
        let is_other = |other: u32| other != leaf && self.path(other) == self.path(leaf);
        let is_handed_over = self.instances.iter().any(|(other, instance)| is_other(other) && instance.is_linked());
        let word = ToParticipant::Succeeding { group, leaf, is_handed_over };
        self.site.tell(&host, word, out);
        if self.instances.get(leaf).is_some_and(Instance::is_active) {
            self.happened(Target::Leaf(leaf), Change::Resumed, out);
        }
    }

    /// Returns whether the plan has another program in the place of this one, which is about to leave.
    pub(super) fn is_succeeded(&self, leaf: u32) -> bool {
        let Some((group, slot)) = self.site.supervisors.get(&Target::Leaf(leaf)) else { return true };
        let members = self.site.plan.groups.get(*group as usize).map_or(&[][..], |group| &group.members);
        members.get(*slot as usize).is_none_or(|member| member.kind != MemberKind::Leaf(leaf))
    }

    /// Reports a change to the users who watch. They see a process with two programs as one.
    pub(super) fn tell_change(&self, leaf: u32, change: Change, out: &mut Out<'_>) {
        if matches!(change, Change::Stopping | Change::Ended(Ending::Stopped)) && self.is_succeeded(leaf) {
            return;
        }
        let is_next = change == Change::Activated && self.changes.succeeding.contains_key(&leaf);
        let change = if is_next { Change::Replacing } else { change };
        self.happened(Target::Leaf(leaf), change, out);
    }
}
