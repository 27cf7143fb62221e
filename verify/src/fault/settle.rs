//! The state after a fault, once every supervisor has received all news and all stops are answered, each as late as possible.

use crate::model::Seat;
use crate::story::effects;
use crate::system::MemberRef;
use crate::system::{Change, Frame, Label, Stepper, System};
use crate::times::Times;
use language::plan::LinkLoss;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// The longest time from the loss of a host until every other host has noticed it. The next question comes within 1 s, the host counts
/// as absent 1 s after that question, and as lost 5 s later. Round trips are added to this time.
pub(crate) const NOTED_AFTER: Duration = Duration::from_secs(7);
/// The longest time from the loss of a host to the start of its absence. The time of `safe_stop_after` is measured from then.
pub(crate) const ABSENT_AFTER: Duration = Duration::from_secs(2);
/// The longest time from the loss of a host until every other host misses it. The next question comes within 1 s, and its answer is
/// missing 2.5 s later. No program stops by itself before its node misses the host.
pub(crate) const MISSED_AFTER: Duration = Duration::from_millis(3500);

/// Returns the longest time from the loss of a host until a program beyond it stops by itself, if it does.
pub(crate) fn stops_by_itself_after(policy: LinkLoss) -> Duration {
    match policy {
        LinkLoss::SafeStopAfter(time) => time.saturating_add(ABSENT_AFTER).max(MISSED_AFTER),
        LinkLoss::Leave | LinkLoss::Keep | LinkLoss::Hold => NOTED_AFTER,
    }
}

/// After this many answers without a pause in between, a process counts as retried for ever.
const ANSWERS_MAX: usize = 2000;

/// The state after a fault has settled.
#[derive(Debug)]
pub(super) struct Settled {
    pub(super) frame: Frame,
    /// How long settling took; none if it is not limited.
    pub(super) after: Option<Duration>,
    /// The programs that ran beyond the loss of a host. They stop by themselves, according to their `on_link_loss`.
    pub(super) beyond: BTreeSet<MemberRef>,
    /// The actions of the nodes when they noticed the loss of a host.
    pub(super) noted: Vec<String>,
    /// Whether the state never settles.
    pub(super) is_restless: bool,
}

/// Makes the nodes notice a loss, and answers all stops. Programs that could be done in that time keep running.
pub(super) fn settle<'s>(
    times: &Times<'_, '_>,
    system: &'s System<'_>,
    stepper: &mut Stepper<'s>,
    frame: &Frame,
) -> Settled {
    let mut settled = Settled {
        frame: frame.clone(),
        after: Some(Duration::ZERO),
        beyond: BTreeSet::new(),
        noted: Vec::new(),
        is_restless: false,
    };
    let (mut labels, mut changes) = (Vec::new(), Vec::<Change>::new());
    let mut now = Duration::ZERO;
    let mut since: BTreeMap<(u16, u16), Duration> = BTreeMap::new();
    for _ in 0..ANSWERS_MAX {
        if system.mode.lost.is_some() {
            let there = system.there(&settled.frame).into_iter();
            settled.beyond.extend(there.filter(|seat| system.is_cut_off(&settled.frame, *seat)));
        }
        system.labels(&settled.frame, &mut labels);
        let mut next: Option<(Duration, Label)> = None;
        since.retain(|seat, _| labels.contains(&Label::Stopped(seat.0, seat.1)));
        for &label in &labels {
            let due = match label {
                Label::Reached(_) | Label::Arrived(..) | Label::Heard(..) | Label::Back(..) => now,
                Label::Aborted(unit, member, _)
                    if system.is_refused(&settled.frame, MemberRef { unit: unit.into(), member: member.into() }) =>
                {
                    now
                }
                Label::Noted(_) => now.max(NOTED_AFTER),
                Label::Stopped(unit, member) => {
                    let since = *since.entry((unit, member)).or_insert(now);
                    let limit = longest_stop(times, system, MemberRef { unit: unit.into(), member: member.into() });
                    settled.after = settled.after.filter(|_| limit.is_some());
                    since.saturating_add(limit.unwrap_or_default())
                }
                Label::Start
                | Label::StartWith(_)
                | Label::Stop
                | Label::Done(..)
                | Label::Aborted(..)
                | Label::Elapsed(..)
                | Label::Told(..)
                | Label::Script(..)
                | Label::Died(..)
                | Label::TooMany(_)
                | Label::Fault(..)
                | Label::Second(..)
                | Label::Lost => continue,
            };
            if next.is_none_or(|(soonest, _)| due < soonest) {
                next = Some((due, label));
            }
        }
        let Some((due, label)) = next else {
            settled.after = settled.after.map(|_| now);
            return settled;
        };
        now = now.max(due);
        let is_noted = matches!(label, Label::Noted(_));
        stepper.apply(&mut settled.frame, label, is_noted.then_some(&mut changes));
        if is_noted {
            settled.noted.extend(effects(system, label, &changes));
        }
    }
    settled.is_restless = true;
    settled
}

/// Returns the longest time that stopping a member takes.
pub(super) fn longest_stop(
    times: &Times<'_, '_>,
    system: &System<'_>,
    MemberRef { unit, member }: MemberRef,
) -> Option<Duration> {
    let part = &system.model.parts[system.units[unit].part];
    match part.members.get(member as usize) {
        Some(Seat::Leaf(leaf)) => Some(system.model.plan.leaves[*leaf as usize].stop_within),
        Some(Seat::Part(inner)) => times.of_group(system.model.parts[*inner].group).stop,
        None => Some(Duration::ZERO),
    }
}
