//! The reaction of a group when a program of one of its members has died and is started again.
//!
//! Restarts happen below the event actions of the group: an activation outlives its program, and the expression hears
//! nothing. The strategy of the group may restart programs of other members with it, since they may depend on state of
//! the dead one. A group allows a limited number of restarts within a time. When the limit is exceeded, the group stops
//! everything and has aborted, and the group above decides.

use super::{ExecContext, Executer, member_path};
use crate::logic::effect::Out;
use crate::logic::protocol::{Ending, Failure, FailureCause, ToParticipant};
use comms::logic::time::Time;
use language::algebra::Event;
use language::plan::{MemberKind, Plan, Strategy, Supervision};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// The restarts of the programs of a group.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Supervised {
    /// The restarts of this activation, as long ago as they count.
    recent: VecDeque<Time>,
    /// Why the group aborts, once there was a restart too many.
    escalated: Option<Failure>,
}

impl Executer {
    /// Takes note that the program of a member has died and is started again. Returns how the group ended, if it did.
    pub fn member_restarted(
        &mut self,
        slot: u32,
        cause: &FailureCause,
        context: ExecContext<'_>,
        out: &mut Out<'_>,
    ) -> Option<Ending> {
        let group = context.plan.groups.get(self.group as usize).filter(|_| self.run.is_on)?;
        if context.plan.ports_of(self.group).is_some_and(|(ports, _)| ports == slot) {
            return None;
        }
        if self.supervised.escalated.is_some() {
            return None;
        }
        if let Some(intensity) = group.supervision.intensity {
            let recent = &mut self.supervised.recent;
            recent.push_back(out.now);
            while recent.front().is_some_and(|at| out.now.since(*at) >= intensity.within) {
                recent.pop_front();
            }
            if recent.len() > intensity.restarts as usize {
                let (restarts, within) = (intensity.restarts, intensity.within);
                let cause = FailureCause::Intensity { last: cause.to_string(), restarts, within };
                let origin = member_path(context.plan, group, slot).unwrap_or_default();
                self.supervised.escalated = Some(Failure { origin, cause, at: context.since_go });
                return self.react(Event::Stop, context, out);
            }
        }
        let origin = member_path(context.plan, group, slot).unwrap_or_default();
        let mut leaves = BTreeMap::<&str, Vec<u32>>::new();
        for leaf in leaves_with(context.plan, self.group, slot) {
            let host =
                context.plan.leaves.get(leaf as usize).and_then(|leaf| context.plan.hosts.get(leaf.host as usize));
            host.into_iter().for_each(|host| leaves.entry(host).or_default().push(leaf));
        }
        for (host, leaves) in leaves {
            let message = ToParticipant::Renew { leaves, with: origin.clone() };
            out.send(host, context.deployment.to_participant(message));
        }
        None
    }

    /// Forgets the restarts of an earlier activation.
    pub(super) fn forget_restarts(&mut self) {
        self.supervised = Supervised::default();
    }

    /// The group aborts with this once it has stopped.
    pub(super) fn give_up(&mut self, why: Failure) {
        self.supervised.escalated.get_or_insert(why);
    }

    /// Returns how the group ended: a restart too many is its failure, unless something could not be stopped.
    pub(super) fn escalate(&mut self, ending: Ending) -> Ending {
        match (self.supervised.escalated.take(), ending) {
            (Some(_), Ending::Aborted(failure)) if failure.cause.is_unconfirmed_stop() => Ending::Aborted(failure),
            (Some(failure), _) => Ending::Aborted(failure),
            (None, ending) => ending,
        }
    }
}

/// Returns whether a supervisor wants to hear of restarts of its members.
pub fn wants_restarts(supervision: &Supervision) -> bool {
    *supervision != Supervision::default()
}

/// Returns the leaves that are restarted together with a member of a group.
fn leaves_with(plan: &Plan, group: u32, slot: u32) -> BTreeSet<u32> {
    let Some(group) = plan.groups.get(group as usize) else { return BTreeSet::new() };
    let is_meant = |other: u32| match group.supervision.strategy {
        Strategy::OneForOne => false,
        Strategy::OneForAll => other != slot,
        Strategy::RestForOne => other > slot,
    };
    let members = (0_u32..).zip(&group.members).filter(|(other, _)| is_meant(*other));
    let mut kinds: Vec<MemberKind> = members.map(|(_, member)| member.kind).collect();
    let (mut leaves, mut seen) = (BTreeSet::new(), BTreeSet::new());
    while let Some(kind) = kinds.pop() {
        match kind {
            MemberKind::Leaf(leaf) => drop(leaves.insert(leaf)),
            // A plan from elsewhere may be wrong: a circle of groups would never end.
            MemberKind::Group(number) if seen.insert(number) => {
                let members = plan.groups.get(number as usize).map_or(&[][..], |group| &group.members);
                kinds.extend(members.iter().map(|member| member.kind));
            }
            MemberKind::Group(_) => {}
        }
    }
    leaves
}
