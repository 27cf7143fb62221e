//! The reaction of a group when a program of one of its members has died and is started again.
//!
//! Restarts happen below the event actions of the group: an activation outlives its program, and the expression gets no
//! event. The strategy of the group may restart programs of other members with it, since they may depend on state of
//! the dead one. A group allows a limited number of restarts within a time. When the limit is exceeded, the group stops
//! everything and has aborted, and the group above decides.

use super::{ExecContext, leaf_host};
use crate::logic::effect::Out;
use crate::logic::protocol::{Ending, Failure, FailureCause, ToParticipant};
use comms::logic::time::Time;
use language::plan::{Intensity, MemberKind, Plan, Strategy, Supervision};
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

/// The reaction of a group to a restart.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// The group tolerates the restart.
    Bears,
    /// It stops everything, and aborts with this cause.
    Escalates(FailureCause),
    /// It stops already.
    IsStopping,
}

impl Supervised {
    /// Takes note that the program of a member has died of a cause and is started again.
    pub(super) fn restarted(&mut self, intensity: Option<Intensity>, cause: &FailureCause, now: Time) -> Verdict {
        if self.escalated.is_some() {
            return Verdict::IsStopping;
        }
        let Some(Intensity { restarts, within }) = intensity else { return Verdict::Bears };
        self.recent.push_back(now);
        while self.recent.front().is_some_and(|at| now.since(*at) >= within) {
            self.recent.pop_front();
        }
        if self.recent.len() <= restarts as usize {
            return Verdict::Bears;
        }
        Verdict::Escalates(FailureCause::Intensity { last: cause.to_string(), restarts, within })
    }

    /// The group aborts with this once it has stopped.
    pub(super) fn give_up(&mut self, why: Failure) {
        self.escalated.get_or_insert(why);
    }

    /// Returns how the group ended: a restart too many is its failure, unless something could not be stopped.
    pub(super) fn escalate(&mut self, ending: Ending) -> Ending {
        match (self.escalated.take(), ending) {
            (Some(_), Ending::Aborted(failure)) if failure.cause.is_unconfirmed_stop() => Ending::Aborted(failure),
            (Some(failure), _) => Ending::Aborted(failure),
            (None, ending) => ending,
        }
    }
}

/// Restarts the programs that are restarted together with a member of a group; `with` is the path of the member.
pub(super) fn renew_others(group: u32, slot: u32, with: &str, context: ExecContext<'_>, out: &mut Out<'_>) {
    let mut leaves = BTreeMap::<&str, Vec<u32>>::new();
    for leaf in leaves_with(context.plan, group, slot) {
        leaf_host(context.plan, leaf).into_iter().for_each(|host| leaves.entry(host).or_default().push(leaf));
    }
    for (host, leaves) in leaves {
        let message = ToParticipant::Renew { leaves, with: with.to_owned() };
        out.send(host, context.deployment.to_participant(message));
    }
}

/// Returns whether a supervisor wants reports of restarts of its members.
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    /// Only recent restarts count. The restart that exceeds the limit ends the group, once.
    #[test]
    fn a_group_bears_so_many_restarts_within_a_time() {
        let at = |seconds: u64| Time::from_nanos(seconds * 1_000_000_000);
        let intensity = Intensity { restarts: 2, within: Duration::from_secs(10) };
        let (mut supervised, cause) = (Supervised::default(), FailureCause::Exit(1));
        let restart = |supervised: &mut Supervised, second| supervised.restarted(Some(intensity), &cause, at(second));
        assert_eq!([0, 9, 10, 19].map(|second| restart(&mut supervised, second)), [const { Verdict::Bears }; 4]);
        let Verdict::Escalates(cause) = restart(&mut supervised, 19) else { panic!("{supervised:?}") };
        let failure = Failure { origin: "main/a".into(), cause, at: Duration::ZERO };
        supervised.give_up(failure.clone());
        assert_eq!(restart(&mut supervised, 20), Verdict::IsStopping);
        assert_eq!(supervised.escalate(Ending::Stopped), Ending::Aborted(failure));
        assert_eq!(supervised.escalate(Ending::Stopped), Ending::Stopped);
        assert_eq!(supervised.restarted(None, &FailureCause::Exit(1), at(21)), Verdict::Bears);
    }
}
