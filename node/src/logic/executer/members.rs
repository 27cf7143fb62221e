//! The members of a group, one record each: whether the member runs, as which program, and its last value and failure.
//!
//! ```text
//! Idle ─the algebra activates it─▶ Waiting ─wires, pace and fences allow it─▶ Active ─it has ended─▶ Idle
//!                                     └─ stopped before it began: Active until its end is reported ─┘
//! ```

use crate::logic::protocol::Failure;
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// A member of a group, in one of its activations.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MemberRef {
    /// The slot of the member in its group.
    pub slot: u32,
    /// The number of the activation.
    pub activation: u32,
}

/// An activation that has not gone out.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Waiting {
    pub(super) activation: u32,
    pub(super) value: Vec<u8>,
    /// When it was decided.
    pub(super) decided: Time,
    /// The generations of wires that it waits for.
    pub(super) wires: BTreeSet<u64>,
    /// When it goes out without them.
    pub(super) until: Time,
    /// When it goes out at the earliest.
    pub(super) not_before: Time,
}

/// Whether a member runs, as its supervisor sees it.
#[derive(Debug, Default, Serialize, Deserialize)]
enum Run {
    #[default]
    Idle,
    Waiting(Waiting),
    /// It runs, and has this activation.
    Active(u32),
}

/// The state of one member, as its supervisor knows it.
#[derive(Debug, Default, Serialize, Deserialize)]
struct Member {
    run: Run,
    /// When it was told to run last, and with which value.
    told_at: Option<Time>,
    value: Vec<u8>,
    /// Why its last activation failed, for the reason of the group.
    failure: Option<Failure>,
    /// The leaf of the member. During a change, it may be a leaf of the previous plan.
    acting: Option<u32>,
    /// The leaf that it is from its next activation on, if it was being stopped when its program changed.
    acting_next: Option<u32>,
}

/// The members of one group, by slot.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Members {
    records: BTreeMap<u32, Member>,
    /// Whether activations wait for the home: the node was away.
    are_held: bool,
}

impl Members {
    /// Returns idle members that are these leaves.
    pub(super) fn new(acting: BTreeMap<u32, u32>) -> Self {
        let member = |(slot, leaf)| (slot, Member { acting: Some(leaf), ..Member::default() });
        Self { records: acting.into_iter().map(member).collect(), are_held: false }
    }

    /// Returns the activation of a member that has not ended.
    pub(super) fn activation(&self, slot: u32) -> Option<u32> {
        self.records.get(&slot).and_then(Member::activation)
    }

    /// Returns every activation that has not ended.
    pub(super) fn activations(&self) -> impl Iterator<Item = MemberRef> {
        self.records
            .iter()
            .filter_map(|(slot, member)| Some(MemberRef { slot: *slot, activation: member.activation()? }))
    }

    pub(super) fn is_active(&self, slot: u32) -> bool {
        self.activation(slot).is_some()
    }

    /// Returns whether this activation is the present one of its member.
    pub(super) fn is_current(&self, run: MemberRef) -> bool {
        self.activation(run.slot) == Some(run.activation)
    }

    pub(super) fn is_waiting(&self, slot: u32) -> bool {
        self.waiting(slot).is_some()
    }

    /// Returns the members whose activations have not gone out.
    pub(super) fn all_waiting(&self) -> impl Iterator<Item = u32> {
        self.records.iter().filter(|(_, member)| member.waiting().is_some()).map(|(slot, _)| *slot)
    }

    fn waiting(&self, slot: u32) -> Option<&Waiting> {
        self.records.get(&slot)?.waiting()
    }

    /// Takes note that the algebra has activated a member.
    pub(super) fn activate(&mut self, run: MemberRef) {
        self.record(run.slot).run = Run::Active(run.activation);
    }

    /// Lets a member wait with its activation.
    pub(super) fn wait(&mut self, slot: u32, waiting: Waiting) {
        self.record(slot).run = Run::Waiting(waiting);
    }

    /// Takes note that the present activation of a member has ended.
    pub(super) fn end(&mut self, slot: u32) {
        self.record(slot).run = Run::Idle;
    }

    /// Withdraws an activation that has not gone out. Returns whether it was one.
    pub(super) fn withdraw(&mut self, run: MemberRef) -> bool {
        let waits = self.waiting(run.slot).is_some_and(|waiting| waiting.activation == run.activation);
        if waits {
            self.activate(run);
        }
        waits
    }

    /// Withdraws every activation that has not gone out.
    pub(super) fn withdraw_all(&mut self) {
        for member in self.records.values_mut() {
            if let Run::Waiting(Waiting { activation, .. }) = member.run {
                member.run = Run::Active(activation);
            }
        }
    }

    /// Lets activations wait for the home, or no longer.
    pub(super) fn hold(&mut self, are_held: bool) {
        self.are_held = are_held;
    }

    /// Takes out the activations that wait for nothing any more, and that no fence keeps back.
    pub(super) fn take_ready(&mut self, now: Time, is_open: impl Fn(u32) -> bool) -> Vec<(u32, Waiting)> {
        let mut ready = Vec::new();
        for (slot, member) in self.records.iter_mut().filter(|_| !self.are_held) {
            if let Run::Waiting(waiting) = &member.run
                && waiting.ready_at() <= now
                && is_open(*slot)
            {
                let next = Run::Active(waiting.activation);
                if let Run::Waiting(waiting) = std::mem::replace(&mut member.run, next) {
                    ready.push((*slot, waiting));
                }
            }
        }
        ready
    }

    /// Returns when the next activation waits for nothing any more, of those that no fence keeps back.
    pub(super) fn deadline(&self, is_open: impl Fn(u32) -> bool) -> Option<Time> {
        let waiting = self.records.iter().filter_map(|(slot, member)| Some((*slot, member.waiting()?)));
        let open = waiting.filter(|(slot, _)| !self.are_held && is_open(*slot));
        open.map(|(_, waiting)| waiting.ready_at()).min()
    }

    /// Takes note that generations of wires need not be waited for any more.
    pub(super) fn confirm(&mut self, generations: &BTreeSet<u64>) {
        for member in self.records.values_mut() {
            if let Run::Waiting(waiting) = &mut member.run {
                waiting.wires.retain(|generation| !generations.contains(generation));
            }
        }
    }

    /// Takes note that a member is told to run.
    pub(super) fn told(&mut self, slot: u32, now: Time, value: &[u8]) {
        let member = self.record(slot);
        (member.told_at, member.value) = (Some(now), value.to_vec());
    }

    /// Returns when a member may be told to run again.
    pub(super) fn next_at(&self, slot: u32, pace: Duration) -> Option<Time> {
        self.records.get(&slot)?.told_at.map(|last| last + pace)
    }

    /// Returns the value of the last activation that was ordered.
    pub(super) fn value(&self, slot: u32) -> Vec<u8> {
        self.records.get(&slot).map(|member| member.value.clone()).unwrap_or_default()
    }

    /// Takes note of why a member has failed.
    pub(super) fn fail(&mut self, slot: u32, why: Failure) {
        self.record(slot).failure = Some(why);
    }

    /// Returns why the last activation of a member that failed has failed.
    pub(super) fn failure(&self, slot: u32) -> Option<&Failure> {
        self.records.get(&slot)?.failure.as_ref()
    }

    pub(super) fn forget_failures(&mut self) {
        self.records.values_mut().for_each(|member| member.failure = None);
    }

    /// Returns the leaf of a member.
    pub(super) fn acting(&self, slot: u32) -> Option<u32> {
        self.records.get(&slot)?.acting
    }

    /// Returns the leaf of each member.
    pub(super) fn all_acting(&self) -> impl Iterator<Item = (u32, u32)> {
        self.records.iter().filter_map(|(slot, member)| Some((*slot, member.acting?)))
    }

    /// Makes a member another leaf.
    pub(super) fn act_as(&mut self, slot: u32, leaf: u32) {
        self.record(slot).acting = Some(leaf);
    }

    /// Makes a member another leaf from its next activation on.
    pub(super) fn act_next_as(&mut self, slot: u32, leaf: u32) {
        self.record(slot).acting_next = Some(leaf);
    }

    /// Makes a member that is activated the leaf that it was to be from now on.
    pub(super) fn renew(&mut self, slot: u32) {
        let member = self.record(slot);
        member.acting = member.acting_next.take().or(member.acting);
    }

    /// Forgets which leaves members were to be from their next activation on.
    pub(super) fn forget_next(&mut self) {
        self.records.values_mut().for_each(|member| member.acting_next = None);
    }

    fn record(&mut self, slot: u32) -> &mut Member {
        self.records.entry(slot).or_default()
    }
}

impl Member {
    fn waiting(&self) -> Option<&Waiting> {
        if let Run::Waiting(waiting) = &self.run { Some(waiting) } else { None }
    }

    fn activation(&self) -> Option<u32> {
        match &self.run {
            Run::Idle => None,
            Run::Waiting(waiting) => Some(waiting.activation),
            Run::Active(activation) => Some(*activation),
        }
    }
}

impl Waiting {
    fn ready_at(&self) -> Time {
        if self.wires.is_empty() { self.not_before } else { self.not_before.max(self.until) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(millis: u64) -> Time {
        Time::ZERO + Duration::from_millis(millis)
    }

    fn waiting(wires: &[u64]) -> Waiting {
        let wires = wires.iter().copied().collect();
        Waiting { activation: 7, value: vec![1], decided: at(0), wires, until: at(1000), not_before: at(10) }
    }

    #[test]
    fn an_activation_waits_for_wires_pace_fences_and_the_home() {
        let run = MemberRef { slot: 2, activation: 7 };
        let mut members = Members::new([(2, 5)].into());
        members.activate(run);
        members.wait(2, waiting(&[3, 4]));
        assert!(members.is_current(run) && members.is_waiting(2));
        assert_eq!(members.deadline(|_| true), Some(at(1000)), "it goes on without a word of the producers");
        members.confirm(&[3].into());
        assert!(members.take_ready(at(500), |_| true).is_empty());
        members.confirm(&[4].into());
        assert_eq!(members.deadline(|_| true), Some(at(10)));
        assert_eq!(members.deadline(|_| false), None, "no time is known at which a fence opens");
        assert!(members.take_ready(at(500), |_| false).is_empty());
        members.hold(true);
        assert!(members.take_ready(at(500), |_| true).is_empty() && members.deadline(|_| true).is_none());
        members.hold(false);
        let ready = members.take_ready(at(500), |_| true);
        assert_eq!(ready.iter().map(|(slot, waiting)| (*slot, waiting.activation)).collect::<Vec<_>>(), [(2, 7)]);
        assert!(members.is_current(run) && !members.is_waiting(2));
        members.end(2);
        assert!(!members.is_active(2));
    }

    #[test]
    fn what_has_not_begun_is_withdrawn_and_ends_all_the_same() {
        let run = MemberRef { slot: 0, activation: 7 };
        let mut members = Members::default();
        members.wait(0, waiting(&[]));
        assert!(!members.withdraw(MemberRef { activation: 6, ..run }), "another one waits");
        assert!(members.withdraw(run) && !members.withdraw(run));
        assert!(members.is_current(run), "its end is not reported yet");
        members.wait(0, waiting(&[]));
        members.withdraw_all();
        assert!(members.is_current(run) && !members.is_waiting(0));
    }

    #[test]
    fn a_member_that_was_being_stopped_is_its_next_program_once_it_is_activated() {
        let mut members = Members::new([(0, 5), (1, 6)].into());
        members.act_as(0, 8);
        members.act_next_as(1, 9);
        assert_eq!(members.all_acting().collect::<Vec<_>>(), [(0, 8), (1, 6)]);
        members.renew(0);
        members.renew(1);
        assert_eq!(members.all_acting().collect::<Vec<_>>(), [(0, 8), (1, 9)]);
        members.act_next_as(1, 10);
        members.forget_next();
        members.renew(1);
        assert_eq!(members.acting(1), Some(9));
    }
}
