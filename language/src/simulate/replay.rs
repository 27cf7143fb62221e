//! Plays a story of a verifier. Each event happens when the story says so, also events that normally take no time in a simulation.
//!
//! The story decides when a program stops that was asked to stop, when an order to stop reaches a group, and when a timer runs out. The
//! clock does not matter.

mod way;

use super::{ActivationRef, Ending, GroupEnd, ProgramFault, Simulation, TraceEvent, Transition};
use crate::algebra::{Cause, Event, Outcome, Reason, Value};
use crate::automaton::Failure;
use crate::plan::{MemberKind, Plan, Restart, Strategy};
use std::collections::{BTreeMap, BTreeSet};
use way::Goal;

/// The reason why an event of a story could not happen.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ReplayError {
    /// The plan has no such process.
    #[error("there is no process `{path}` any more")]
    Unknown {
        /// The path.
        path: String,
    },
    /// The process is not in a state in which this could happen.
    #[error("`{event}` cannot happen here: {why}")]
    Impossible {
        /// The event.
        event: TraceEvent,
        /// The reason why it is not possible.
        why: &'static str,
    },
    /// The event is about the loss of a host, which a simulation does not have.
    #[error("`{event}` is about hosts, which a simulation does not have")]
    Unsupported {
        /// The event.
        event: TraceEvent,
    },
}

/// The open state of the story.
#[derive(Clone, Debug, Default)]
pub(super) struct Pending {
    /// The group that the story is about.
    pub(super) root: usize,
    /// The leaves that were asked to stop.
    pub(super) stopping: BTreeMap<u32, ActivationRef>,
    /// The groups to which an order to stop is still on its way.
    pub(super) ordered: BTreeSet<usize>,
    /// The groups that stop because their programs have died too often. The end of such a group is a failure.
    pub(super) escalating: BTreeSet<usize>,
    /// The processes whose orders and reports take time between hosts.
    travels: BTreeSet<String>,
    /// The orders to start that are still on their way, by path.
    sent: BTreeMap<String, (ActivationRef, Value)>,
    /// The reports of groups that have ended, which are still on their way to the supervisors.
    reports: BTreeMap<usize, (usize, Event)>,
    hung: BTreeSet<u32>,
    /// The leaves that have died and are started again.
    away: BTreeSet<u32>,
    /// The leaves that can no longer be started.
    pub(super) given_up: BTreeSet<u32>,
}

impl<'a> Simulation<'a> {
    /// Prepares to play a story about a group. Nothing has happened yet, and [`Simulation::occur`] lets events happen. For the processes in
    /// `travels`, orders to start and reports of ends arrive when the story says so. For all other processes, they arrive at once.
    ///
    /// # Errors
    /// If the plan has no such group.
    pub fn replay(plan: &'a Plan, group: &str, travels: &[String]) -> Result<Self, ReplayError> {
        let root = plan.groups.iter().position(|candidate| candidate.path == group);
        let root = root.ok_or_else(|| ReplayError::Unknown { path: group.to_owned() })?;
        let mut simulation = Self::idle(plan);
        simulation.pending = Some(Pending { root, travels: travels.iter().cloned().collect(), ..Pending::default() });
        Ok(simulation)
    }

    /// Returns the paths of the leaves that were asked to stop and have not stopped yet.
    pub fn stopping(&self) -> Vec<&'a str> {
        let leaves = self.pending.iter().flat_map(|pending| pending.stopping.keys());
        leaves.map(|&leaf| self.plan.leaves[leaf as usize].path.as_str()).collect()
    }

    /// Lets an event of the story happen.
    ///
    /// # Errors
    /// If the event cannot happen here. Then nothing has changed.
    pub fn occur(&mut self, event: &TraceEvent) -> Result<(), ReplayError> {
        self.known(event)?;
        self.happens(event).map_err(|why| {
            let event = event.clone();
            match self.is_about_hosts(&event) {
                true => ReplayError::Unsupported { event },
                false => ReplayError::Impossible { event, why },
            }
        })
    }

    /// Returns whether an event comes from the loss of a host, or may do so. For example, a group on another host fails for its supervisor
    /// when its host is lost.
    fn is_about_hosts(&self, event: &TraceEvent) -> bool {
        let groups = &self.plan.groups;
        match event {
            TraceEvent::Lost(_) | TraceEvent::Cut(_) | TraceEvent::Noted(_) => true,
            TraceEvent::Fails(path, _) => {
                let seat = self.group(path).and_then(|group| Some((group, self.seats.get(&group)?)));
                seat.is_some_and(|(group, seat)| groups[seat.group].host != groups[group].host)
            }
            TraceEvent::Start(_)
            | TraceEvent::Stop
            | TraceEvent::Done(..)
            | TraceEvent::Stopped(_)
            | TraceEvent::Elapsed(..)
            | TraceEvent::Reached(_)
            | TraceEvent::Arrived(_)
            | TraceEvent::Heard(_)
            | TraceEvent::Struck(..)
            | TraceEvent::Dies(_)
            | TraceEvent::Back(_)
            | TraceEvent::TooMany(_)
            | TraceEvent::Told(..)
            | TraceEvent::Script(..) => false,
        }
    }

    /// Checks that the plan has the process or group of the event.
    fn known(&self, event: &TraceEvent) -> Result<(), ReplayError> {
        let Some(path) = event.path() else { return Ok(()) };
        let is_known = self.leaf(path).is_some() || self.group(path).is_some();
        is_known.then_some(()).ok_or_else(|| ReplayError::Unknown { path: path.to_owned() })
    }

    fn leaf(&self, path: &str) -> Option<u32> {
        (0..).zip(&self.plan.leaves).find(|(_, leaf)| leaf.path == path).map(|(number, _)| number)
    }

    fn group(&self, path: &str) -> Option<usize> {
        self.plan.groups.iter().position(|group| group.path == path)
    }

    fn pending(&mut self) -> &mut Pending {
        self.pending.get_or_insert_default()
    }

    fn happens(&mut self, event: &TraceEvent) -> Result<(), &'static str> {
        match event {
            TraceEvent::Start(_) => self.begin(),
            TraceEvent::Stop => {
                let root = self.pending().root;
                self.queue.push_back((root, Event::Stop));
                self.react();
                Ok(())
            }
            TraceEvent::Done(path, tag) => match self.leaf(path) {
                Some(leaf) => {
                    let ending = tag.as_ref().map_or(Ending::Done, |tag| Ending::Outcome(tag.clone()));
                    self.ends_by_itself(leaf, ending)
                }
                None => self.bring(path, &Goal::Done(tag.clone())),
            },
            TraceEvent::Fails(path, failure) => match self.leaf(path) {
                Some(leaf) => self.fails(leaf, failure.as_ref()),
                None => self.bring(path, &Goal::Failed(failure.clone())),
            },
            TraceEvent::Stopped(path) => match self.leaf(path) {
                Some(leaf) => self.answers(leaf, false),
                None => self.bring(path, &Goal::Stopped),
            },
            TraceEvent::Elapsed(path, number) => self.runs_out(path, *number),
            TraceEvent::Reached(path) => self.reached(path),
            TraceEvent::Struck(fault, path) => self.struck(*fault, path),
            TraceEvent::Dies(path) => self.dies(self.leaf(path).ok_or("it is a group")?),
            TraceEvent::Back(path) => {
                let leaf = self.leaf(path).ok_or("it is a group")?;
                self.pending().away.remove(&leaf).then_some(()).ok_or("it is not away")
            }
            TraceEvent::TooMany(path) => {
                let group = self.group(path).ok_or("it is not a group")?;
                self.escalates(group)
            }
            TraceEvent::Told(path, number) => self.told(path, *number),
            TraceEvent::Script(path, kind) => {
                let group = self.group(path).ok_or("it is not a group")?;
                self.states[group].fail_script(*kind);
                Ok(())
            }
            TraceEvent::Lost(_) | TraceEvent::Cut(_) | TraceEvent::Noted(_) => Err("a simulation has no hosts"),
            TraceEvent::Arrived(path) => self.arrives(path),
            TraceEvent::Heard(path) => {
                let group = self.group(path).ok_or("it is not a group")?;
                let report = self.pending().reports.remove(&group).ok_or("no report of its end is on its way")?;
                self.queue.push_back(report);
                self.react();
                Ok(())
            }
        }
    }

    fn begin(&mut self) -> Result<(), &'static str> {
        let root = self.pending().root;
        self.note(self.plan.groups[root].path.clone(), Transition::Started);
        self.queue.push_back((root, Event::Start(Value::EMPTY)));
        self.react();
        Ok(())
    }

    fn ends_by_itself(&mut self, leaf: u32, ending: Ending) -> Result<(), &'static str> {
        let pending = self.pending();
        if pending.hung.contains(&leaf) {
            return Err("it hangs");
        }
        if pending.away.contains(&leaf) {
            return Err("it is away until it is started again");
        }
        if pending.given_up.contains(&leaf) {
            return Err("it cannot be started any more");
        }
        self.leaves.contains_key(&leaf).then_some(()).ok_or("it does not run")?;
        self.end_leaf(leaf, ending);
        Ok(())
    }

    fn fails(&mut self, leaf: u32, failure: Option<&Failure>) -> Result<(), &'static str> {
        if self.pending().stopping.contains_key(&leaf) {
            return self.answers(leaf, self.pending.as_ref().is_some_and(|pending| pending.given_up.contains(&leaf)));
        }
        self.leaves.contains_key(&leaf).then_some(()).ok_or("it does not run")?;
        self.pending().away.remove(&leaf);
        let ending = match failure {
            Some(Failure::Crash) => Ending::Crashed,
            Some(Failure::HostLost) => Ending::HostLost,
            Some(_) | None => Ending::Aborted("it failed".to_owned()),
        };
        self.end_leaf(leaf, ending);
        Ok(())
    }

    /// Lets a leaf with an order to stop answer: it has stopped, or its stop is unconfirmed.
    fn answers(&mut self, leaf: u32, is_unconfirmed: bool) -> Result<(), &'static str> {
        let seat = self.pending().stopping.remove(&leaf).ok_or("it was not asked to stop")?;
        let ActivationRef { group, member, activation } = seat;
        let path = self.plan.leaves[leaf as usize].path.clone();
        if is_unconfirmed {
            self.note(path, Transition::Aborted("its stop could not be confirmed".to_owned()));
            self.queue.push_back((group, Event::StopUnconfirmed { member, activation }));
        } else {
            self.pending().away.remove(&leaf);
            self.note(path, Transition::Stopped);
            self.queue.push_back((group, Event::Stopped { member, activation }));
        }
        self.react();
        Ok(())
    }

    fn runs_out(&mut self, path: &str, number: u32) -> Result<(), &'static str> {
        let group = self.group(path).ok_or("it is not a group")?;
        let is_it = |timer: &super::Timer| timer.group == group && timer.timer + 1 == number;
        let found = self.clock.timers.iter().find(|(_, timer)| is_it(timer)).map(|(due, timer)| (*due, *timer));
        let (due, timer) = found.ok_or("no such time runs")?;
        self.clock.timers.remove(&due);
        self.set_now(due.0.max(self.clock.now));
        self.note_wait(timer, &Transition::Done);
        self.queue.push_back((group, Event::Elapsed { timer: timer.timer, activation: timer.activation }));
        self.react();
        Ok(())
    }

    fn reached(&mut self, path: &str) -> Result<(), &'static str> {
        let group = self.group(path).ok_or("it is not a group")?;
        self.pending().ordered.remove(&group).then_some(()).ok_or("no order to stop is on its way")?;
        self.queue.push_back((group, Event::Stop));
        self.react();
        Ok(())
    }

    fn struck(&mut self, fault: ProgramFault, path: &str) -> Result<(), &'static str> {
        let leaf = self.leaf(path).ok_or("it is a group")?;
        let is_running = self.leaves.contains_key(&leaf);
        let is_restarted = self.plan.leaves[leaf as usize].policy.restart != Restart::Temporary;
        match fault {
            ProgramFault::Unanswered => {
                self.pending().stopping.contains_key(&leaf).then_some(()).ok_or("it was not asked to stop")?;
                self.pending().given_up.insert(leaf);
                self.answers(leaf, true)
            }
            _ if !is_running => Err("it does not run"),
            ProgramFault::Hang => {
                self.pending().hung.insert(leaf);
                Ok(())
            }
            ProgramFault::Crash if is_restarted => self.dies(leaf),
            ProgramFault::Crash => self.fails(leaf, Some(&Failure::Crash)),
            ProgramFault::CrashTooOften => {
                self.pending().given_up.insert(leaf);
                self.fails(leaf, Some(&Failure::Crash))
            }
            ProgramFault::CrashTooMany => {
                let group = self.leaves.get(&leaf).map(|seat| seat.group).ok_or("it does not run")?;
                self.escalates(group)
            }
        }
    }

    /// Lets a program die that is started again. By the strategy of its group, other programs of the group stop with it.
    fn dies(&mut self, leaf: u32) -> Result<(), &'static str> {
        let seat = *self.leaves.get(&leaf).ok_or("it does not run")?;
        let group = &self.plan.groups[seat.group];
        let mut with = vec![leaf];
        for (slot, _) in (0_u32..).zip(&group.members) {
            let is_with = match group.supervision.strategy {
                Strategy::OneForOne => false,
                Strategy::OneForAll => slot != seat.member,
                Strategy::RestForOne => slot > seat.member,
            };
            if is_with {
                self.below(seat.group, slot, &mut with);
            }
        }
        let plan = self.plan;
        with.retain(|leaf| plan.leaves[*leaf as usize].policy.restart != Restart::Temporary);
        with.retain(|leaf| self.leaves.contains_key(leaf));
        self.pending().away.extend(with);
        Ok(())
    }

    fn below(&self, group: usize, slot: u32, leaves: &mut Vec<u32>) {
        match self.plan.groups[group].members[slot as usize].kind {
            MemberKind::Leaf(leaf) => leaves.push(leaf),
            MemberKind::Group(inner) => {
                let slots = (0_u32..).zip(&self.plan.groups[inner as usize].members);
                slots.for_each(|(slot, _)| self.below(inner as usize, slot, leaves));
            }
        }
    }

    fn escalates(&mut self, group: usize) -> Result<(), &'static str> {
        let is_running = self.seats.contains_key(&group) || self.pending().root == group;
        is_running.then_some(()).ok_or("it does not run")?;
        self.pending().escalating.insert(group);
        self.queue.push_back((group, Event::Stop));
        self.react();
        Ok(())
    }

    // ---- what supervisors do ----

    pub(super) fn is_asked(&mut self, leaf: u32) {
        let path = &self.plan.leaves[leaf as usize].path;
        let sent = self.pending.as_ref().and_then(|pending| pending.sent.get(path)).map(|(seat, _)| *seat);
        if let Some(seat) = self.leaves.remove(&leaf).or(sent) {
            self.note(self.plan.leaves[leaf as usize].path.clone(), Transition::Stopping);
            self.pending().stopping.insert(leaf, seat);
        }
    }

    /// Returns whether the order to start a process must travel. If so, the order is now on its way.
    pub(super) fn is_sent(&mut self, path: &str, seat: ActivationRef, value: &Value) -> bool {
        let Some(pending) = self.pending.as_mut().filter(|pending| pending.travels.contains(path)) else {
            return false;
        };
        pending.sent.insert(path.to_owned(), (seat, value.clone()));
        true
    }

    fn arrives(&mut self, path: &str) -> Result<(), &'static str> {
        let (seat, value) = self.pending().sent.remove(path).ok_or("no order to start it is on its way")?;
        self.note(path.to_owned(), Transition::Started);
        match self.plan.groups[seat.group].members[seat.member as usize].kind {
            // If the leaf was asked to stop in the meantime, it answers that order instead of running.
            MemberKind::Leaf(leaf) if self.pending().stopping.contains_key(&leaf) => {}
            MemberKind::Leaf(leaf) => {
                self.leaves.insert(leaf, seat);
            }
            MemberKind::Group(inner) => {
                self.seats.insert(inner as usize, seat);
                self.queue.push_back((inner as usize, Event::Start(value)));
                self.react();
            }
        }
        Ok(())
    }

    /// Returns whether the report of a group's end must travel. If so, the report is now on its way.
    pub(super) fn is_reported(&mut self, group: usize, report: &(usize, Event)) -> bool {
        let path = &self.plan.groups[group].path;
        let Some(pending) = self.pending.as_mut().filter(|pending| pending.travels.contains(path)) else {
            return false;
        };
        pending.reports.insert(group, report.clone());
        true
    }

    pub(super) fn is_ordered(&mut self, group: usize) {
        let path = self.plan.groups[group].path.clone();
        let is_under_way = self.pending().sent.contains_key(&path);
        self.note(path, Transition::Stopping);
        if is_under_way || self.seats.contains_key(&group) {
            self.pending().ordered.insert(group);
        }
    }

    /// Returns the outcome of a group. If its programs have died too often, the outcome is a failure.
    pub(super) fn escalated(&mut self, group: usize, outcome: Outcome) -> Outcome {
        let is_escalated = self.pending.as_mut().is_some_and(|pending| pending.escalating.remove(&group));
        let is_unconfirmed = matches!(&outcome, Outcome::Aborted(reason) if reason.cause == Cause::StopUnconfirmed);
        if !is_escalated || is_unconfirmed {
            return outcome;
        }
        Outcome::Aborted(Reason { member: None, cause: Cause::Reported(Failure::Crash.report()) })
    }

    pub(super) fn note_end(&mut self, group: usize, transition: &Transition, outcome: &Outcome) {
        if let Some(pending) = &mut self.pending {
            pending.ordered.remove(&group);
        }
        let tag = if let Outcome::Done(value) = outcome { value.tag().map(str::to_owned) } else { None };
        let failure = if let Outcome::Aborted(reason) = outcome { Some(Failure::of(&reason.cause)) } else { None };
        self.record.ends.insert(group, GroupEnd { transition: transition.clone(), tag, failure });
    }
}
