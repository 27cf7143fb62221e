//! The phases of a mission: which step of the main sequence runs, since when, and how each step ended.
//!
//! The steps come from the first group whose expression contains a sequence; the groups are searched breadth first from
//! `main`. The steps are the parts of its chain of `;`, `:`, `;;` and `else`, flattened. Members that run beside the
//! chain (`motion # (a ; b)`) are background and belong to no phase. If no group has a sequence, the whole expression
//! is the only step.
//!
//! If that group is an activity, a phase lasts as long as the activity stays in the same states.

mod steps;

use language::automaton::StateKind;
use language::plan::{Expression, Group, Plan};
use node::logic::protocol::{Change, Ending};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use steps::{Step, steps};

/// The most phases that are kept. Older ones are dropped and counted, because a loop can have any number of phases.
pub const PHASES_MAX: usize = 1_000;

/// The step of a phase whose step is not in the present plan.
const GONE: usize = usize::MAX;

/// How many phases are searched, from the last one back, for the phase of a late value.
const LATE_MAX: usize = 8;

/// The longest time between two reports of one reaction of an activity. If an activity leaves a state later than this
/// after the end of a member and the stops that followed, another event was the cause.
const REACTION_MAX: Duration = Duration::from_millis(250);

/// A period in which one step of the main sequence ran.
#[derive(Clone, Debug, PartialEq)]
pub struct Phase {
    /// The step as written in the spec: `(opengrip, approach) # hit`. For an activity, its states.
    pub name: String,
    /// The time since GO at the begin.
    pub begin: Duration,
    /// The time since GO at the end; nothing while the phase runs.
    pub end: Option<Duration>,
    /// The member whose end ended the phase. Nothing while the phase runs, or if it was stopped from outside.
    pub decided: Option<DecidingMember>,
    /// The reports after that end. Nothing once it is known whether the end made the activity leave its state.
    aftermath: Option<Aftermath>,
    step: usize,
    members: usize,
    is_state: bool,
    seen: BTreeSet<u32>,
    active: BTreeSet<u32>,
    stopping: BTreeSet<u32>,
    peaks: Vec<Option<f64>>,
}

/// The reports after the end of a member of an activity.
#[derive(Clone, Debug, Default, PartialEq)]
struct Aftermath {
    /// The time of the end, or of the last stop that followed it.
    last: Duration,
    /// The members that have begun since then.
    begun: BTreeSet<u32>,
}

/// The member whose end ended a phase.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DecidingMember {
    /// Its name within its group.
    pub member: String,
    /// How it ended.
    pub ending: Ending,
}

impl Phase {
    /// Returns the largest magnitude of a track in this phase, if the track had a value. `track` is the index in `Mission::tracks`.
    pub fn peak(&self, track: usize) -> Option<f64> {
        self.peaks.get(track).copied().flatten()
    }

    /// Returns in a few words how the phase ended: `distdetect done`, `aborted: blocked`, `stopped`, `running`.
    pub fn ended(&self) -> String {
        let Some(DecidingMember { member, ending }) = &self.decided else {
            let ended = if self.is_state { "left" } else { "stopped" };
            return if self.end.is_some() { ended } else { "running" }.to_owned();
        };
        let how = match ending {
            Ending::Done(_) => "done".to_owned(),
            Ending::Aborted(failure) => format!("aborted: {}", failure.cause),
            Ending::Stopped => "stopped".to_owned(),
            Ending::Unconfirmed => "unconfirmed".to_owned(),
        };
        if self.members == 1 { how } else { format!("{member} {how}") }
    }

    /// Returns whether the member that ended the phase failed.
    pub fn failed(&self) -> bool {
        self.decided.as_ref().is_some_and(|decided| matches!(decided.ending, Ending::Aborted(_) | Ending::Unconfirmed))
    }

    /// Returns how long the phase took, or how long it has run at `now`.
    pub fn took(&self, now: Duration) -> Duration {
        self.end.unwrap_or(now).saturating_sub(self.begin)
    }

    /// Notes that an activity leaves the states of this phase. If it has stayed in them after the last end of a member,
    /// this end was not the cause.
    fn leave(&mut self, at: Duration) {
        if self.aftermath.take().is_some_and(|after| at.saturating_sub(after.last) > REACTION_MAX) {
            self.decided = None;
        }
    }

    /// Notes a stop. If it comes late, or stops a member that has begun since the last end, it does not follow this end.
    fn stop(&mut self, member: u32, at: Duration) {
        self.stopping.insert(member);
        let Some(after) = &mut self.aftermath else { return };
        if after.begun.contains(&member) || at.saturating_sub(after.last) > REACTION_MAX {
            (self.decided, self.aftermath) = (None, None);
        } else {
            after.last = at;
        }
    }

    fn change(&mut self, member: u32, name: &str, change: &Change, at: Duration) {
        match change {
            Change::Activated => {
                self.seen.insert(member);
                self.active.insert(member);
                self.stopping.remove(&member);
                if let Some(after) = &mut self.aftermath {
                    after.begun.insert(member);
                }
                // In an activity, a program that begins now belongs to the state that is reported next.
                if !self.is_state {
                    (self.end, self.decided) = (None, None);
                }
            }
            Change::Stopping => self.stop(member, at),
            Change::Ended(ending) => {
                self.active.remove(&member);
                // The loser of `#` also ends, but only because it was asked to stop. So it does not decide how the phase ended.
                if !self.stopping.contains(&member) && *ending != Ending::Stopped {
                    self.decided = Some(DecidingMember { member: name.to_owned(), ending: ending.clone() });
                    self.aftermath = self.is_state.then(|| Aftermath { last: at, ..Aftermath::default() });
                } else if let Some(after) = &mut self.aftermath {
                    after.last = at;
                }
                if self.active.is_empty() && !self.is_state {
                    self.end.get_or_insert(at);
                }
            }
            Change::Died(_)
            | Change::Started { .. }
            | Change::Restarting { .. }
            | Change::Resumed
            | Change::Held { .. }
            | Change::HeldBy { .. }
            | Change::EndedLate
            | Change::Switched(_)
            | Change::Says { .. }
            | Change::Entered { .. }
            | Change::Configured { .. }
            | Change::Replacing
            | Change::Renewing { .. }
            | Change::Reverting { .. } => {}
        }
    }
}

/// The activity whose states are the phases.
#[derive(Debug, Clone)]
struct ActivityNames {
    path: String,
    /// The width for the names of the states: the longest name, or twice as much if the activity has parallel states.
    width: usize,
}

impl ActivityNames {
    fn of(group: &Group) -> Option<Self> {
        let Expression::Chart(chart) = &group.expression else { return None };
        let states = &chart.chart.states;
        let longest = states.iter().map(|state| state.name.chars().count()).max().unwrap_or(0);
        let is_parallel = states.iter().any(|state| state.kind == StateKind::Parallel);
        let width = if is_parallel { 2 * longest + ", ".len() } else { longest };
        Some(Self { path: group.path.clone(), width })
    }
}

/// The phases so far.
#[derive(Debug, Clone)]
pub(super) struct Phases {
    steps: Vec<Step>,
    /// The activity whose states are the phases.
    activity: Option<ActivityNames>,
    /// The slot of each member of the group with the steps, by absolute path.
    slots: BTreeMap<String, (u32, String)>,
    /// The programs inside members that are groups, by absolute path, and whether each runs now.
    inner: BTreeMap<String, bool>,
    phases: Vec<Phase>,
    dropped: usize,
}

impl Phases {
    pub(super) fn new(plan: &Plan) -> Self {
        let (group, steps) = steps(plan);
        let activity = group.and_then(ActivityNames::of);
        let mut slots = BTreeMap::new();
        if let Some(group) = group {
            for (slot, member) in (0..).zip(&group.members) {
                slots.insert(format!("{}/{}", group.path, member.name), (slot, member.name.clone()));
            }
        }
        let of_member = |path: &&String| slots.keys().any(|member| is_below(path, member));
        let inner = plan.leaves.iter().map(|leaf| &leaf.path).filter(of_member).map(|path| (path.clone(), false));
        let inner = inner.collect();
        Self { steps, activity, slots, inner, phases: Vec::new(), dropped: 0 }
    }

    /// Returns the programs that run inside the members of the current phase, including services. Their paths are
    /// relative to the group with the steps: `hit/force`.
    pub(super) fn inner(&self) -> impl Iterator<Item = &str> {
        let phase = self.phases.last();
        let active = move |slot: &u32| phase.is_some_and(|phase| phase.active.contains(slot));
        let members: Vec<&String> =
            self.slots.iter().filter(|(_, (slot, _))| active(slot)).map(|(path, _)| path).collect();
        let running = self.inner.iter().filter(|(_, runs)| **runs).map(|(path, _)| path.as_str());
        running.filter_map(move |path| {
            let member = members.iter().find(|member| is_below(path, member))?;
            path.get(member.rfind('/')? + 1..)
        })
    }

    /// Continues with the steps of another plan. Ended phases stay unchanged. The running phase becomes the step of the
    /// new plan that contains its running members.
    pub(super) fn replan(&mut self, plan: &Plan) {
        let next = Self::new(plan);
        let old = std::mem::replace(&mut self.slots, next.slots);
        let ran = std::mem::replace(&mut self.inner, next.inner);
        for (path, runs) in &mut self.inner {
            *runs = ran.get(path).copied().unwrap_or_default();
        }
        let moved = old.iter().filter_map(|(path, (slot, _))| Some((*slot, self.slots.get(path)?.0)));
        let moved: BTreeMap<u32, u32> = moved.collect();
        let taken_over =
            |slots: &BTreeSet<u32>| slots.iter().filter_map(|slot| moved.get(slot).copied()).collect::<BTreeSet<u32>>();
        (self.steps, self.activity) = (next.steps, next.activity);
        for (back, phase) in self.phases.iter_mut().rev().enumerate() {
            if back >= LATE_MAX {
                phase.active.clear();
                continue;
            }
            (phase.seen, phase.active) = (taken_over(&phase.seen), taken_over(&phase.active));
            phase.stopping = taken_over(&phase.stopping);
            let ran = if phase.active.is_empty() { &phase.seen } else { &phase.active };
            let shared = |step: &Step| step.members.intersection(ran).count();
            let best = (0..self.steps.len()).rev().max_by_key(|step| shared(&self.steps[*step]));
            let best = best.filter(|step| shared(&self.steps[*step]) > 0);
            phase.step = best.unwrap_or(GONE);
            if phase.is_state {
                continue;
            }
            if let (None, Some(step)) = (phase.end, best.and_then(|step| self.steps.get(step))) {
                (phase.name, phase.members) = (step.name.clone(), step.members.len());
            }
        }
    }

    pub(super) fn all(&self) -> &[Phase] {
        &self.phases
    }

    pub(super) fn dropped(&self) -> usize {
        self.dropped
    }

    /// Returns the length of the longest name. With it, lines are aligned from the first phase on.
    pub(super) fn name_width(&self) -> usize {
        let states = self.activity.as_ref().map(|activity| activity.width);
        states.or_else(|| self.steps.iter().map(|step| step.name.chars().count()).max()).unwrap_or(0)
    }

    pub(super) fn change(&mut self, path: &str, change: &Change, at: Duration) {
        if let Some(runs) = self.inner.get_mut(path) {
            *runs = *change == Change::Activated || *runs && !matches!(change, Change::Ended(_));
        }
        if self.is_of_states(path)
            && let Change::Entered { states } = change
        {
            return self.enter(states.join(", "), at);
        }
        if self.is_of_states(path) && matches!(change, Change::Ended(_)) {
            self.leave(at);
        }
        let Some((member, name)) = self.slots.get(path).cloned() else { return };
        if *change == Change::Activated {
            let Some(step) = self.step_of(member) else { return };
            let is_next = |phase: &Phase| !phase.is_state && (phase.step != step || phase.seen.contains(&member));
            if self.phases.last().is_none_or(is_next) {
                self.begin(step, at);
            }
        }
        // This is usually the current phase. If an end is reported late, it belongs to an earlier phase, in which the member was active.
        let is_of = |phase: &&mut Phase| phase.active.contains(&member) && phase.begin <= at;
        let phase = match change {
            Change::Activated => self.phases.last_mut(),
            Change::Stopping
            | Change::Ended(_)
            | Change::Died(_)
            | Change::Started { .. }
            | Change::Restarting { .. }
            | Change::Resumed
            | Change::Held { .. }
            | Change::HeldBy { .. }
            | Change::EndedLate
            | Change::Switched(_)
            | Change::Says { .. }
            | Change::Entered { .. }
            | Change::Configured { .. }
            | Change::Replacing
            | Change::Renewing { .. }
            | Change::Reverting { .. } => self.phases.iter_mut().rev().take(3).find(is_of),
        };
        if let Some(phase) = phase {
            phase.change(member, &name, change, at);
        }
        if let Change::Ended(_) = change {
            // The member was active in each round of a loop, so it is removed from each.
            for phase in self.phases.iter_mut().rev().take(LATE_MAX) {
                phase.active.remove(&member);
            }
        }
    }

    pub(super) fn sample(&mut self, track: usize, value: f64, at: Duration) {
        // A peak is reported a moment later. Then the next phase may have begun.
        let is_in = |phase: &&mut Phase| phase.begin <= at && phase.end.is_none_or(|end| at < end);
        if let Some(phase) = self.phases.iter_mut().rev().take(LATE_MAX).find(is_in) {
            if phase.peaks.len() <= track {
                phase.peaks.resize(track + 1, None);
            }
            let peak = phase.peaks[track].get_or_insert(0.0);
            *peak = peak.max(value.abs());
        }
    }

    /// Notes that the current phase ends.
    fn leave(&mut self, at: Duration) {
        if let Some(phase) = self.phases.last_mut() {
            phase.leave(at);
        }
    }

    pub(super) fn finish(&mut self, at: Duration) {
        self.leave(at);
        if let Some(phase) = self.phases.last_mut() {
            phase.end.get_or_insert(at);
        }
    }

    /// Returns the step in which `member` was activated. This is the current step if the member has not been active in
    /// it, else the next step that contains the member. In a loop, the search continues with the first step.
    fn step_of(&self, member: u32) -> Option<usize> {
        let from = match self.phases.last().filter(|phase| phase.step != GONE) {
            Some(phase) => phase.step + usize::from(phase.seen.contains(&member)),
            None => 0,
        };
        (from..self.steps.len()).chain(0..from).find(|step| self.steps[*step].members.contains(&member))
    }

    /// Returns whether the states of a process are the phases.
    pub(super) fn is_of_states(&self, path: &str) -> bool {
        self.activity.as_ref().is_some_and(|activity| activity.path == path)
    }

    /// Notes that the activity has entered other states. The first program of the new states may have been reported before.
    fn enter(&mut self, states: String, at: Duration) {
        let is_unnamed = |phase: &Phase| self.steps.get(phase.step).is_some_and(|step| step.name == phase.name);
        if !self.phases.last().is_some_and(is_unnamed) {
            self.begin(0, at);
        }
        if let Some(phase) = self.phases.last_mut() {
            phase.name = states;
        }
    }

    fn begin(&mut self, step: usize, at: Duration) {
        self.leave(at);
        if let Some(phase) = self.phases.last_mut() {
            phase.end.get_or_insert(at);
        }
        if self.phases.len() == PHASES_MAX {
            self.phases.remove(0);
            self.dropped += 1;
        }
        // A member that runs beside a loop belongs to each round of the loop.
        let again = self.phases.last().filter(|phase| phase.step == step);
        let active = again.map(|phase| phase.active.clone()).unwrap_or_default();
        let Step { name, members } = &self.steps[step];
        self.phases.push(Phase {
            name: name.clone(),
            begin: at,
            end: None,
            decided: None,
            aftermath: None,
            step,
            members: members.len(),
            is_state: self.activity.is_some(),
            seen: BTreeSet::new(),
            active,
            stopping: BTreeSet::new(),
            peaks: Vec::new(),
        });
    }
}

/// Returns whether `path` is inside `above`.
fn is_below(path: &str, above: &str) -> bool {
    path.strip_prefix(above).is_some_and(|rest| rest.starts_with('/'))
}
