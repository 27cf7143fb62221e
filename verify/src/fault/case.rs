//! The result of one fault, or of two: its severity and its row.

use super::readers::Readers;
use super::settle::{Settled, longest_stop, settle, stops_by_itself_after};
use super::watcher::is_watcher;
use super::{Mission, Row, Severity};
use crate::explore::Graph;
use crate::limits::is_limit;
use crate::model::{Seat, short};
use crate::story::{Step, Story, effects, member_name, running, seconds, tell, timer_of};
use crate::system::MemberRef;
use crate::system::{FaultKind, Frame, Label, Occupant, Phase, Stepper, System, is_restarted, taken_along};
use crate::times::Times;
use language::algebra::Activity;
use std::cell::RefCell;
use std::time::Duration;

/// The target of a fault in a system.
#[derive(Clone, Copy, Debug)]
pub(super) struct Struck {
    pub(super) kind: FaultKind,
    /// The struck program; none for a host.
    pub(super) seat: Option<MemberRef>,
}

/// A fault, or two faults, in all states in which they can happen.
pub(super) struct Case<'c, 'm, 'a> {
    times: &'c Times<'m, 'a>,
    system: &'c System<'a>,
    graph: &'c Graph,
    struck: Vec<Struck>,
    /// For each state, whether the mission can end from it, whether it can be done (also after a limit that something
    /// catches), and whether it can fail without a limit that passes.
    ends: Vec<bool>,
    done: Vec<bool>,
    fails: Vec<bool>,
    /// For each step that may hang, and for each state, whether something can end the step.
    ended: Vec<Vec<bool>>,
    /// For each unit, which of its timers are limits.
    limits: Vec<Vec<bool>>,
    readers: Readers<'c, 'a>,
    stepper: RefCell<Stepper<'c>>,
}

/// The result of a fault in one state.
#[derive(Debug)]
pub(super) struct Judged {
    pub(super) phase: String,
    pub(super) severity: Severity,
    /// The longest time until nothing runs, if it is limited.
    pub(super) safe_within: Option<Duration>,
    mission: Mission,
    settled: Settled,
    /// The state in which the fault happens, and the state after it.
    before: Frame,
    state: u32,
    fault: Label,
    after: Frame,
}

impl<'c, 'm, 'a> Case<'c, 'm, 'a> {
    pub(super) fn new(times: &'c Times<'m, 'a>, system: &'c System<'a>, graph: &'c Graph, struck: Vec<Struck>) -> Self {
        let limits: Vec<Vec<bool>> = (0..system.units.len())
            .map(|unit| is_limit(&system.model.parts[system.units[unit].part].expression))
            .collect();
        let is_lossy = system.mode.lost.is_some();
        // A program that was given up fails at each further start.
        let is_given_up = |seat: MemberRef| {
            let given_up = |kind| matches!(kind, FaultKind::GivenUp | FaultKind::Unanswered);
            struck.iter().any(|struck| struck.seat == Some(seat) && given_up(struck.kind))
        };
        let fails =
            |unit: u16, member: u16| is_lossy || is_given_up(MemberRef { unit: unit.into(), member: member.into() });
        let counts = |label: Label| {
            system.is_natural(label) || matches!(label, Label::Aborted(unit, member, _) if fails(unit, member))
        };
        let passes =
            |unit: u16, timer: u16| limits[usize::from(unit)].get(usize::from(timer)).is_some_and(|limit| *limit);
        let is_passed = |label: Label| matches!(label, Label::Elapsed(unit, timer) if passes(unit, timer));
        let is_free = |label: Label| counts(label) && !is_passed(label);
        let phases: Vec<Phase> =
            (0..graph.store.count()).map(|state| system.phase_of(graph.store.get(state))).collect();
        let phase = |which: fn(Phase) -> bool| phases.iter().map(|phase| which(*phase)).collect::<Vec<_>>();
        let ends = graph.can_reach(&phase(Phase::is_over), &counts);
        let done = graph.can_reach(&phase(|phase| phase == Phase::Done), &counts);
        let fails = graph.can_reach(&phase(|phase| phase == Phase::Aborted), &is_free);
        let hung = struck.iter().filter(|struck| struck.kind == FaultKind::Hang).filter_map(|struck| struck.seat);
        let ended = hung.filter(|seat| is_step(system, *seat)).map(|MemberRef { unit, member }| {
            let idle = graph.which(system, |frame| frame.states[unit].activity(member) == Activity::Idle);
            graph.can_reach(&idle, &counts)
        });
        let ended = ended.collect();
        let (readers, stepper) = (Readers::new(system, graph), RefCell::new(system.stepper()));
        Self { times, system, graph, struck, ends, done, fails, ended, limits, readers, stepper }
    }

    /// Calls `take` with the result of the last fault, for every state in which the fault happens.
    pub(super) fn each_fault(&self, mut take: impl FnMut(Judged)) {
        let (mut before, mut after) = (self.system.initial(), self.system.initial());
        for state in 0..self.graph.store.count() {
            for (label, target) in self.graph.from(state) {
                if !matches!(label, Label::Fault(..) | Label::Second(..) | Label::Lost) {
                    continue;
                }
                self.system.unpack(self.graph.store.get(state), &mut before);
                self.system.unpack(self.graph.store.get(target), &mut after);
                if !after.is_faulty || self.struck.len() > 1 && !after.is_twice_faulty {
                    continue;
                }
                let judged = self.judge(&before, &after, state, label, target);
                // A process that is being stopped ends in any case, regardless of the fault.
                if self.is_asked(&before, label) && judged.severity < Severity::Adrift {
                    continue;
                }
                take(judged);
            }
        }
    }

    fn judge(&self, before: &Frame, after: &Frame, state: u32, fault: Label, target: u32) -> Judged {
        let settled = self.settle(after);
        let mission = self.mission(&settled, target);
        let severity = self.severity(before, after, &settled, mission, fault, target);
        // The mission could also fail without the fault.
        let may_anyway = mission == Mission::MayFail && self.fails[state as usize];
        let mission = if may_anyway { Mission::CanBeDone } else { mission };
        let safe_within = self.safe_within(&settled).filter(|_| severity == Severity::Safe);
        let (phase, before, after) = (self.phase(before), before.clone(), after.clone());
        Judged { phase, severity, safe_within, mission, settled, before, state, fault, after }
    }

    fn settle(&self, frame: &Frame) -> Settled {
        settle(self.times, self.system, &mut self.stepper.borrow_mut(), frame)
    }

    /// Returns whether a program that crashes or hangs, or a group around it, has been asked to stop.
    fn is_asked(&self, frame: &Frame, fault: Label) -> bool {
        let seat = struck_by(fault);
        let is_own = |struck: &&Struck| struck.seat == seat && struck.kind != FaultKind::Unanswered;
        if seat.is_none() || !self.struck.iter().any(|struck| is_own(&struck)) {
            return false;
        }
        let mut seats = std::iter::successors(seat, |MemberRef { unit, .. }| self.system.units[*unit].parent);
        seats.any(|MemberRef { unit, member }| {
            frame.ordered[unit] || frame.states[unit].activity(member) == Activity::Stopping
        })
    }

    fn mission(&self, settled: &Settled, target: u32) -> Mission {
        let target = target as usize;
        match settled.frame.phase {
            Phase::Done => return Mission::Done,
            Phase::Aborted | Phase::Stopped => return Mission::Fails,
            Phase::Idle | Phase::Running | Phase::Stopping => {}
        }
        if self.system.is_silent(&settled.frame, 0) {
            return Mission::IsLost;
        }
        // A fault may also end a mission that never ends without a fault.
        if self.system.program(0).is_service() && !self.ends[target] {
            return Mission::GoesOn;
        }
        match (self.done[target], self.fails[target]) {
            (true, true) => Mission::MayFail,
            (true, false) => Mission::CanBeDone,
            (false, true) => Mission::Fails,
            (false, false) if self.ends[target] => Mission::EndsByLimit,
            (false, false) => Mission::NeverEnds,
        }
    }

    fn severity(
        &self,
        before: &Frame,
        after: &Frame,
        settled: &Settled,
        mission: Mission,
        fault: Label,
        target: u32,
    ) -> Severity {
        let there = self.system.there(&settled.frame);
        if there.iter().any(|seat| self.system.is_adrift(&settled.frame, *seat)) {
            return Severity::Adrift;
        }
        if mission == Mission::NeverEnds || settled.is_restless || self.waits(&settled.frame) {
            return Severity::Stuck;
        }
        if self.struck.iter().any(|struck| struck.kind == FaultKind::Unanswered) {
            return Severity::Unconfirmed;
        }
        if there.is_empty() && (settled.frame.phase.is_over() || mission == Mission::IsLost) {
            return Severity::Safe;
        }
        if self.ended.iter().any(|ended| !ended[target as usize]) {
            return Severity::Stuck;
        }
        if let Some(hung) = self.hung(fault) {
            let goes_on = !is_step(self.system, hung) || is_watcher(self.system, &settled.frame, hung);
            return match self.leaf(hung) {
                _ if mission == Mission::Fails => Severity::FailsLater,
                _ if !goes_on => Severity::Handled,
                Some(leaf) if self.readers.hear(leaf, target) => Severity::Blind,
                Some(_) | None if mission == Mission::EndsByLimit => Severity::FailsLater,
                Some(_) | None => Severity::Degraded,
            };
        }
        if self.restarted(fault).is_some() {
            return if mission == Mission::Fails { Severity::FailsLater } else { Severity::Handled };
        }
        let (were, are) = (self.others(before), self.others(&settled.frame));
        let is_back = struck_by(fault).is_some_and(|MemberRef { unit, member }| {
            settled.frame.states[unit].activity(member) == Activity::Active
                && !self.system.is_refused(&settled.frame, MemberRef { unit, member })
        });
        let is_new = is_back || are.iter().any(|seat| !were.contains(seat));
        let starts_anew = is_new || self.new_pause(before, after).is_some();
        let waits = are.iter().any(|MemberRef { unit, member }| {
            self.system.waits_for_ever(&settled.frame, MemberRef { unit: *unit, member: *member })
        });
        match [Mission::Fails, Mission::EndsByLimit].contains(&mission) {
            _ if starts_anew && !waits => Severity::Handled,
            true => Severity::FailsLater,
            false if is_back || were != are => Severity::Handled,
            false if self.readers.miss(&self.gone(before, &settled.frame), &settled.frame, target) => Severity::Blind,
            false => Severity::Degraded,
        }
    }

    /// Returns whether a process waits for a resource that a lost host may still use. Only for a mission that is a
    /// service.
    fn waits(&self, frame: &Frame) -> bool {
        let waits = |unit: usize| {
            let mut members = frame.states[unit].members_active();
            members.any(|member| self.system.waits_for_ever(frame, MemberRef { unit, member }))
        };
        self.system.program(0).is_service() && (0..self.system.units.len()).any(waits)
    }

    /// The program in a seat.
    fn leaf(&self, MemberRef { unit, member }: MemberRef) -> Option<u32> {
        match self.system.model.parts[self.system.units[unit].part].members.get(member as usize) {
            Some(Seat::Leaf(leaf)) => Some(*leaf),
            Some(Seat::Part(_)) | None => None,
        }
    }

    /// Returns the programs that ran before a fault and do not run after it.
    fn gone(&self, before: &Frame, after: &Frame) -> Vec<u32> {
        let left = self.system.there(after);
        let gone = self.system.there(before).into_iter().filter(|seat| !left.contains(seat));
        gone.flat_map(|MemberRef { unit, member }| self.system.model.leaves_in(self.system.units[unit].part, member))
            .collect()
    }

    /// Returns the program that hangs because of this fault, if there is one.
    fn hung(&self, fault: Label) -> Option<MemberRef> {
        let seat = struck_by(fault)?;
        self.struck.iter().any(|struck| struck.seat == Some(seat) && struck.kind == FaultKind::Hang).then_some(seat)
    }

    /// Returns the program that is restarted after this fault, if there is one.
    fn restarted(&self, fault: Label) -> Option<MemberRef> {
        let seat = struck_by(fault).filter(|seat| self.system.is_restarted(*seat))?;
        self.struck.iter().any(|struck| struck.seat == Some(seat) && struck.kind == FaultKind::Crash).then_some(seat)
    }

    /// Returns the clause about a restarted program.
    fn restart(&self, MemberRef { unit, member }: MemberRef) -> String {
        let model = self.system.model;
        let group = model.parts[self.system.units[unit].part].group;
        let slots = taken_along(model, group, member).into_iter();
        let leaves = slots.flat_map(|slot| model.leaves_below(group, slot)).filter(|leaf| is_restarted(model, *leaf));
        let with: Vec<String> = leaves.map(|leaf| short(&model.plan.leaves[leaf as usize].path)).collect();
        match with.as_slice() {
            [] => "it is started again".to_owned(),
            with => format!("it is started again, and with it {}", with.join(", ")),
        }
    }

    /// Returns the members that run and are not being stopped, except the targets of the faults. Members on a lost
    /// host are included.
    fn others(&self, frame: &Frame) -> Vec<MemberRef> {
        let is_struck = |seat: MemberRef| self.struck.iter().any(|struck| struck.seat == Some(seat));
        let is_stopping =
            |MemberRef { unit, member }: MemberRef| frame.states[unit].activity(member) == Activity::Stopping;
        let there = self.system.there(frame).into_iter();
        there.filter(|seat| !is_struck(*seat) && !self.system.is_on_lost(*seat) && !is_stopping(*seat)).collect()
    }

    fn names(&self) -> Vec<String> {
        let seats = self.struck.iter().filter_map(|struck| struck.seat);
        seats.filter_map(|MemberRef { unit, member }| member_name(self.system, unit, member)).collect()
    }

    /// Returns the pause before the run continues after a fault: the time of a timer that was not armed before.
    fn new_pause(&self, before: &Frame, after: &Frame) -> Option<Duration> {
        (0..self.system.units.len()).find_map(|unit| {
            let program = self.system.program(unit);
            let is_new = |&timer: &u32| {
                after.states[unit].is_armed(program, timer) && !before.states[unit].is_armed(program, timer)
            };
            let timer = (0..program.timers()).find(is_new)?;
            self.time_of(unit, timer)
        })
    }

    fn time_of(&self, unit: usize, timer: u32) -> Option<Duration> {
        timer_of(&self.system.model.parts[self.system.units[unit].part].expression, timer as usize)
    }

    /// Returns the phase of the run: the running members that will end.
    fn phase(&self, frame: &Frame) -> String {
        let own = self.names();
        let (mut steps, mut stopping) = (Vec::new(), Vec::new());
        for MemberRef { unit, member } in self.system.there(frame) {
            let Some(name) = member_name(self.system, unit, member).filter(|name| !own.contains(name)) else {
                continue;
            };
            match frame.states[unit].activity(member) {
                Activity::Stopping => stopping.push(name),
                Activity::Active | Activity::Idle if is_step(self.system, MemberRef { unit, member }) => {
                    steps.push(name);
                }
                Activity::Active | Activity::Idle => {}
            }
        }
        match (steps.is_empty(), stopping.is_empty()) {
            (false, _) => steps.join(", "),
            (true, true) if self.struck.iter().any(|struck| struck.seat.is_some()) => "alone".to_owned(),
            (true, _) => "between two steps".to_owned(),
        }
    }

    // ---- the row ----

    pub(super) fn row(&self, program: String, fault: String, judged: Judged) -> Row {
        let told = self.story(&judged);
        let effect = self.effect(&judged);
        let Judged { phase, severity, safe_within, mission, settled, .. } = judged;
        let (mut running, stopping) = running(self.system, &settled.frame);
        running.extend(stopping);
        for struck in self.struck.iter().filter(|struck| struck.kind == FaultKind::Unanswered) {
            let name = struck.seat.and_then(|MemberRef { unit, member }| member_name(self.system, unit, member));
            running.extend(name.map(|name| format!("perhaps {name}")));
        }
        Row { program, fault, phase, effect, running, safe_within, mission, severity, story: told }
    }

    fn story(&self, judged: &Judged) -> Story {
        let mut way = self.graph.way(judged.state);
        way.push(judged.fault);
        let mut told = tell(self.system, &way);
        if self.system.mode.lost.is_some() {
            (told.running, told.stopping) = running(self.system, &judged.settled.frame);
            told.steps.push(Step {
                cause: "all hosts have noted this, and all stops are answered".to_owned(),
                effects: judged.settled.noted.clone(),
                events: Vec::new(),
                moves: Vec::new(),
            });
        }
        told
    }

    fn effect(&self, judged: &Judged) -> String {
        let Judged { settled, before, after, fault, .. } = judged;
        let (mut frame, mut changes) = (before.clone(), Vec::new());
        self.stepper.borrow_mut().apply(&mut frame, *fault, Some(&mut changes));
        let last = effects(self.system, *fault, &changes);
        let all: Vec<String> = last.into_iter().chain(settled.noted.iter().cloned()).collect();
        if settled.is_restless {
            return "it is tried again and again".to_owned();
        }
        if !all.is_empty() {
            return all.join("; ");
        }
        if let Some(seat) = self.restarted(*fault) {
            return self.restart(seat);
        }
        if let Some(pause) = self.new_pause(before, after) {
            return format!("a pause of {} begins", seconds(pause));
        }
        match self.hung(*fault).and_then(|seat| self.limit_that_ends(after, seat)) {
            Some(limit) => format!("nothing follows at once; the limit of {} ends it", seconds(limit)),
            None if self.struck.last().is_some_and(|struck| struck.kind == FaultKind::Hang) => "unnoticed".to_owned(),
            None => "nothing follows at once".to_owned(),
        }
    }

    /// Returns the shortest limit that ends the hanging program.
    fn limit_that_ends(&self, frame: &Frame, seat: MemberRef) -> Option<Duration> {
        let MemberRef { unit, member } = seat;
        if !is_step(self.system, seat) {
            return None;
        }
        let mut labels = Vec::new();
        self.system.labels(frame, &mut labels);
        let mut limits = Vec::new();
        for &label in &labels {
            let Label::Elapsed(of, timer) = label else { continue };
            if !self.limits[usize::from(of)].get(usize::from(timer)).is_some_and(|limit| *limit) {
                continue;
            }
            let mut passed = frame.clone();
            self.stepper.borrow_mut().apply(&mut passed, label, None);
            let left = self.settle(&passed).frame;
            if left.states[unit].activity(member) == Activity::Idle {
                limits.extend(self.time_of(usize::from(of), u32::from(timer)));
            }
        }
        limits.into_iter().min()
    }

    /// Returns the longest time until nothing runs, if everything ends.
    fn safe_within(&self, settled: &Settled) -> Option<Duration> {
        // Programs beyond the loss stop by themselves at the same time.
        settled.beyond.iter().try_fold(settled.after?, |longest, seat| {
            let waits = stops_by_itself_after(self.system.link_loss(*seat));
            Some(longest.max(waits.saturating_add(longest_stop(self.times, self.system, *seat)?)))
        })
    }
}

/// Returns whether a member is a step, which ends, and not a service.
pub(super) fn is_step(system: &System<'_>, MemberRef { unit, member }: MemberRef) -> bool {
    match &system.units[unit].seats[member as usize] {
        Occupant::Box(ends) => !ends[0].done.is_empty(),
        Occupant::Unit(_) => true,
    }
}

/// Returns the program that a fault strikes.
fn struck_by(fault: Label) -> Option<MemberRef> {
    if let Label::Fault(unit, member) | Label::Second(unit, member) = fault {
        Some(MemberRef { unit: usize::from(unit), member: u32::from(member) })
    } else {
        None
    }
}
