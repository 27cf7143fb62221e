//! The sentences about the loss of a host, and the effects of such a loss on the other hosts.

use super::watch::{Forbidden, Goal};
use super::{Question, follow_events, place_of};
use crate::fault::{ABSENT_AFTER, MISSED_AFTER, NOTED_AFTER, stops_by_itself_after, torn};
use crate::finding::{Assumption, Finding, Verdict};
use crate::story::seconds;
use crate::system::{Loss, LossKind, Mode, System};
use language::plan::{LinkLoss, MemberKind};
use language::sites::{Consequence, Occurrence, ProcessRef};
use std::time::Duration;

/// The time from the loss of a host until the stop of a program begins.
#[derive(Clone, Copy, Debug)]
struct StopWait {
    time: Duration,
    /// The program, if it stops because of its own policy. Otherwise, a supervisor or a node orders the stop.
    by_itself: Option<u32>,
}

impl<'m> Question<'_, 'm, '_> {
    /// Adds an assumption to the proof that some processes never run at the same time, if they may do so after the loss
    /// of a host: it is then unknown whether the processes there have stopped.
    pub(super) fn unless_lost(&self, found: Finding, first: Option<ProcessRef>, all: &[ProcessRef]) -> Finding {
        let hosts = &self.times.model.plan.hosts;
        if found.verdict != Verdict::Proved || hosts.len() < 2 {
            return found;
        }
        // The view from the home comes first.
        let home = self.times.model.plan.groups[0].host;
        let mut losses: Vec<(Loss, &String)> = Vec::new();
        for (host, name) in (0_u32..).zip(hosts) {
            losses.extend([LossKind::Death, LossKind::Cut].map(|kind| (Loss { host, kind }, name)));
        }
        losses.sort_by_key(|(loss, _)| loss.host == home);
        let assumed = losses.into_iter().find_map(|(loss, name)| {
            let found = self.beside_each_other(loss, first, all)?;
            let once = if loss.kind == LossKind::Cut { "is cut off" } else { "is lost" };
            let text = match (found.verdict, all.len()) {
                (Verdict::Open, _) => "no host is lost: the case of a lost host was not decided".to_owned(),
                (_, 2) => format!("no host is lost: once `{name}` {once}, both processes may run"),
                (_, _) => format!("no host is lost: once `{name}` {once}, two of the processes may run"),
            };
            Some(Assumption { text, story: found.story })
        });
        Finding { assumes: assumed, ..found }
    }

    /// Returns a finding that shows how two of these processes may run at the same time after a loss.
    fn beside_each_other(&self, loss: Loss, first: Option<ProcessRef>, all: &[ProcessRef]) -> Option<Finding> {
        let whom = first.iter().chain(all);
        let named: Vec<(u32, u32)> = whom.filter_map(|who| Some((who.group, who.member?))).collect();
        let goal = Goal::Never(first, Forbidden::BesideEachOther(all.to_vec()));
        let mut system = torn(self.times.model, &named);
        system.notes = goal.notes();
        follow_events(&mut system, &goal);
        system.mode.hears_late = true;
        system.lose(loss);
        self.is_safe(&system, &goal)
    }

    /// Returns a finding if a stop because of the loss of a host may take longer, measured from the moment of the loss.
    fn stops_after_loss(&self, host: u32, lost: &[ProcessRef], who: ProcessRef, limit: Duration) -> Option<Finding> {
        let own = match who.member {
            Some(slot) => self.times.of_member(who.group, slot).stop,
            None => self.times.of_group(who.group).stop,
        };
        let Some(own) = own else { return self.is_slow(None, limit) };
        // The process's supervisor may be on the lost host, or cut off from it. The process then stops by itself.
        let waits =
            self.leaves_of(who).into_iter().map(|leaf| self.stop_begins(host, leaf)).max_by_key(|wait| wait.time);
        let wait = waits.unwrap_or(StopWait { time: NOTED_AFTER, by_itself: None });
        if wait.time.saturating_add(own) > limit {
            return Some(self.fails(&self.sum_after_loss(wait, own), None));
        }
        let is_ordered = self.leaves_of(who).into_iter().any(|leaf| self.stop_begins(host, leaf).by_itself.is_none());
        // If the host returns at once, the deaths of its programs are reported without a delay.
        let rest = if is_ordered { limit.saturating_sub(NOTED_AFTER) } else { limit };
        lost.iter().find_map(|member| self.stops_after(*member, who, rest))
    }

    /// Returns the longest time from the loss of a host until the stop of a program begins.
    fn stop_begins(&self, host: u32, leaf: u32) -> StopWait {
        let policy = self.times.model.plan.leaves[leaf as usize].policy.link_loss;
        match policy {
            LinkLoss::SafeStopAfter(_) if self.is_cut_off(host, leaf) => {
                StopWait { time: stops_by_itself_after(policy), by_itself: Some(leaf) }
            }
            LinkLoss::SafeStopAfter(_) | LinkLoss::Leave | LinkLoss::Keep | LinkLoss::Hold => {
                StopWait { time: NOTED_AFTER, by_itself: None }
            }
        }
    }

    /// Returns the times whose sum exceeds a limit, and the way to a shorter sum.
    fn sum_after_loss(&self, wait: StopWait, own: Duration) -> String {
        let model = self.times.model;
        let total = seconds(wait.time.saturating_add(own));
        let stop = format!("the stop takes up to {}", seconds(own));
        let Some(leaf) = wait.by_itself else {
            let lost = seconds(NOTED_AFTER);
            return format!(
                "it may take {total}: a host counts as lost up to {lost} after its loss, and {stop}; `on_link_loss safe_stop_after 1 s` of a \
                 program beyond the loss is faster"
            );
        };
        let name = place_of(model, leaf).map_or_else(String::new, |(group, slot)| model.name(group, slot));
        let from = match model.plan.leaves[leaf as usize].policy.link_loss {
            LinkLoss::SafeStopAfter(time) if wait.time > MISSED_AFTER => {
                format!(
                    "{} after the start of the absence, which is up to {} after the loss",
                    seconds(time),
                    seconds(ABSENT_AFTER)
                )
            }
            LinkLoss::SafeStopAfter(_) | LinkLoss::Leave | LinkLoss::Keep | LinkLoss::Hold => format!(
                "once its node misses the host, up to {} after the loss; no policy is faster, so let the program check the age of its input",
                seconds(MISSED_AFTER)
            ),
        };
        format!("it may take {total}: {stop}, and `{name}` stops by itself {from}")
    }

    /// Returns whether the loss of a host separates a program from its home host, or from a supervisor above it.
    fn is_cut_off(&self, lost: u32, leaf: u32) -> bool {
        let model = self.times.model;
        let own = model.plan.leaves[leaf as usize].host;
        let group = place_of(model, leaf).map(|(group, _)| group);
        let mut above = std::iter::successors(group, |group| Some(model.around[*group as usize]?.0));
        above.any(|group| (model.plan.groups[group as usize].host == lost) != (own == lost))
    }

    /// Checks a sentence about the loss of a host. The host may die or be cut off. Or the host
    /// returns at once, and every program on it has died. These deaths are reported one by one.
    pub(super) fn on_loss(&self, host: &str, consequence: &Consequence) -> Finding {
        let model = self.times.model;
        let Some(host) = (0_u32..).zip(&model.plan.hosts).find(|(_, name)| *name == host).map(|(host, _)| host) else {
            return self.open("no such host");
        };
        let is_there = |&(group, slot): &(u32, u32)| match model.plan.groups[group as usize].members[slot as usize].kind
        {
            MemberKind::Leaf(leaf) => model.plan.leaves[leaf as usize].host == host,
            MemberKind::Group(_) => false,
        };
        let lost = self
            .struck(None)
            .into_iter()
            .filter(is_there)
            .map(|(group, slot)| ProcessRef { group, member: Some(slot) });
        let lost: Vec<ProcessRef> = lost.collect();
        let (goal, other) = match consequence {
            Consequence::Stopped(who, limit) => {
                if let Some(found) = limit.and_then(|limit| self.stops_after_loss(host, &lost, *who, limit)) {
                    return found;
                }
                (Goal::StillRuns(None, *who), *who)
            }
            Consequence::Never(other) => (Goal::Then(None, other.clone()), other.who),
            Consequence::Eventually(other) => (Goal::Owed(None, other.clone()), other.who),
        };
        if let Some(found) = self.on_loss_of_all(host, consequence) {
            return found;
        }
        // After its return the host runs nothing, so the resources that were kept for it are free.
        let whom: Vec<ProcessRef> = lost.into_iter().chain([other]).collect();
        let mode = Mode { lost: Some(Loss { host, kind: LossKind::Programs }), ..Mode::default() };
        let mut system = self.system(&whom, mode);
        follow_events(&mut system, &goal);
        self.on_loss_in(&system, consequence, &goal).unwrap_or_else(|| self.proved())
    }

    fn on_loss_in(&self, system: &System<'_>, consequence: &Consequence, goal: &Goal) -> Option<Finding> {
        match consequence {
            Consequence::Never(_) | Consequence::Stopped(..) => self.is_safe(system, goal),
            Consequence::Eventually(_) => self.is_live(system, goal, &|_| true),
        }
    }

    /// Checks the losses of a host with its supervisors. The host either dies, or continues but cannot be reached. In
    /// both cases the sentence has to hold for the whole mission.
    fn on_loss_of_all(&self, host: u32, consequence: &Consequence) -> Option<Finding> {
        let model = self.times.model;
        let seen = |who: ProcessRef| match (who.member, model.around[who.group as usize]) {
            (None, Some((group, slot))) => ProcessRef { group, member: Some(slot) },
            (_, _) => who,
        };
        let (goal, other) = match consequence {
            Consequence::Stopped(who, _) => (Goal::StillRuns(None, seen(*who)), seen(*who)),
            Consequence::Never(event) => {
                let event = Occurrence { who: seen(event.who), kind: event.kind.clone() };
                (Goal::Then(None, event.clone()), event.who)
            }
            Consequence::Eventually(event) => {
                let event = Occurrence { who: seen(event.who), kind: event.kind.clone() };
                (Goal::Owed(None, event.clone()), event.who)
            }
        };
        let named = other.member.map(|slot| (other.group, slot));
        [LossKind::Death, LossKind::Cut].into_iter().find_map(|kind| {
            let mut system = torn(model, named.as_slice());
            system.notes = 1;
            follow_events(&mut system, &goal);
            system.mode.hears_late = true;
            system.lose(Loss { host, kind });
            self.on_loss_in(&system, consequence, &goal)
        })
    }
}
