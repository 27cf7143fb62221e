//! What each single fault does, in every state that a run without faults can be in.
//!
//! For each program the groups on the way to it are looked into; all others are boxes that end as they do without faults.

use crate::explore::{Found, Graph, Limits, Nobody, explore, is_natural};
use crate::model::{Model, short};
use crate::property::around;
use crate::story::{Story, running, seconds, story, timer_of};
use crate::system::{FaultKind, Frame, Injection, Label, Mode, Occupant, System};
use language::algebra::Activity;
use language::plan::MemberKind;
use std::collections::BTreeMap;
use std::time::Duration;

/// How bad a fault is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Something that the spec foresees goes on in its place.
    Handled,
    /// Everything is stopped.
    Safe,
    /// The rest goes on without it.
    Degraded,
    /// It never ends, and only a stop from outside helps.
    Stuck,
}

/// One row: a fault of one program in one phase of the run.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// The path of the program.
    pub program: String,
    /// The fault.
    pub kind: FaultKind,
    /// What runs beside it when it happens: the steps, no services.
    pub phase: String,
    /// What follows at once.
    pub effect: String,
    /// What still runs once all stops are answered.
    pub running: Vec<String>,
    /// The longest time until everything has stopped, when everything does: the longest limit of what is stopped.
    pub safe_within: Option<Duration>,
    /// How bad it is.
    pub severity: Severity,
    /// How it comes to that.
    pub story: Story,
}

/// The rows of all programs, and whether a limit was reached.
#[derive(Debug, Default)]
pub struct Table {
    /// The rows, in the order of the plan.
    pub rows: Vec<Row>,
    /// The programs that were not looked at whole.
    pub unfinished: Vec<String>,
    /// How many states were looked at.
    pub states: u64,
}

/// What the columns of a table are called.
pub const COLUMNS: [&str; 7] = ["program", "fault", "while", "at once", "still runs", "safe within", "verdict"];

impl Row {
    /// Returns what stands in the columns.
    pub fn cells(&self) -> [String; 7] {
        let running = if self.running.is_empty() { "nothing".to_owned() } else { self.running.join(", ") };
        let safe = self.safe_within.map_or_else(String::new, seconds);
        let (kind, word) = (self.kind.word().to_owned(), self.severity.word().to_owned());
        [self.program.clone(), kind, self.phase.clone(), self.effect.replace('`', ""), running, safe, word]
    }
}

impl Table {
    /// Returns the table in Markdown.
    pub fn markdown(&self) -> String {
        let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
        let rows: String = self.rows.iter().map(|row| line(&row.cells())).collect();
        format!("{}{}{rows}", line(&COLUMNS.map(str::to_owned)), "|---".repeat(COLUMNS.len()) + "|\n")
    }
}

const KINDS: [FaultKind; 3] = [FaultKind::Crash, FaultKind::Hang, FaultKind::Unanswered];

/// Injects every fault into every program.
pub(crate) fn table(model: &Model<'_>, limits: &Limits<'_>) -> Table {
    let mut table = Table::default();
    for (group, source) in (0_u32..).zip(&model.plan.groups) {
        for (slot, member) in (0_u32..).zip(&source.members) {
            if let MemberKind::Leaf(leaf) = member.kind {
                of_leaf(model, (group, slot, leaf), limits, &mut table);
            }
        }
    }
    table.rows.sort_by_key(|row| row.program.clone());
    table
}

fn of_leaf(model: &Model<'_>, (group, slot, leaf): (u32, u32, u32), limits: &Limits<'_>, table: &mut Table) {
    for kind in KINDS {
        if !limits.goes_on.goes_on() {
            table.unfinished.push(short(&model.plan.leaves[leaf as usize].path));
            return;
        }
        let mut system = around(model, 0, &[(group, slot)]);
        let Some((unit, member)) = system.find(group, slot) else { return };
        system.mode = Mode { fault: Some(Injection { unit, member, kind }), ..Mode::default() };
        let Found { graph, .. } = explore(&system, limits, true, &Nobody);
        table.states += u64::from(graph.store.count());
        if graph.reached.is_some() {
            table.unfinished.push(short(&model.plan.leaves[leaf as usize].path));
            return;
        }
        let over = graph.which(&system, |frame| frame.phase.is_over());
        let ends = graph.can_reach(&over, &is_natural);
        let mut rows: BTreeMap<String, Row> = BTreeMap::new();
        let (mut before, mut after) = (system.initial(), system.initial());
        for state in 0..graph.store.count() {
            for (_, target) in graph.from(state).filter(|(label, _)| matches!(label, Label::Fault(..))) {
                system.unpack(graph.store.get(state), &mut before);
                // Who is being stopped cannot hang any more: it is killed when it does not answer.
                if kind == FaultKind::Hang && is_being_stopped(&system, &before, unit) {
                    continue;
                }
                system.unpack(graph.store.get(target), &mut after);
                let case = Case { system: &system, graph: &graph, ends: &ends, kind, struck: (unit, member) };
                let row = case.row(leaf, (&before, &after), target);
                let worse = rows.get(&row.phase).is_none_or(|known| known.severity < row.severity);
                if worse {
                    rows.insert(row.phase.clone(), row);
                }
            }
        }
        table.rows.extend(rows.into_values());
    }
}

/// Whether an order to stop is on its way to a unit, or to one around it.
fn is_being_stopped(system: &System<'_>, frame: &Frame, unit: usize) -> bool {
    let outwards = std::iter::successors(Some(unit), |&unit| system.units[unit].parent.map(|(around, _)| around));
    outwards.into_iter().any(|unit| {
        let around = system.units[unit].parent;
        let is_asked = |(unit, member): (usize, u32)| frame.states[unit].activity(member) == Activity::Stopping;
        frame.ordered[unit] || around.is_some_and(is_asked)
    })
}

/// One kind of fault of one program.
struct Case<'c, 'a> {
    system: &'c System<'a>,
    graph: &'c Graph,
    /// For each state, whether the end can be reached from it.
    ends: &'c [bool],
    kind: FaultKind,
    struck: (usize, u32),
}

impl Case<'_, '_> {
    fn row(&self, leaf: u32, (before, after): (&Frame, &Frame), target: u32) -> Row {
        let model = self.system.model;
        let settled = self.settle(after);
        let told = story(self.system, self.graph, target);
        let effect = told.steps.last().map(|step| step.effects.join("; ")).filter(|effect| !effect.is_empty());
        let (running, _) = running(self.system, &settled);
        let severity = self.severity(before, after, &settled, target);
        let is_over = settled.phase.is_over();
        Row {
            program: short(&model.plan.leaves[leaf as usize].path),
            kind: self.kind,
            phase: self.phase(before),
            effect: effect.unwrap_or_else(|| match self.new_pause(before, after) {
                Some(pause) => format!("a pause of {} begins", seconds(pause)),
                None => "nothing follows at once".to_owned(),
            }),
            safe_within: is_over.then(|| self.longest_stop(before)),
            running,
            severity,
            story: told,
        }
    }

    /// Lets all stops be answered.
    fn settle(&self, frame: &Frame) -> Frame {
        let mut frame = frame.clone();
        let (mut labels, mut changes, mut stepper) = (Vec::new(), Vec::new(), self.system.stepper());
        loop {
            self.system.labels(&frame, &mut labels);
            let answer = labels.iter().find(|label| matches!(label, Label::Stopped(..) | Label::Reached(_)));
            let Some(&answer) = answer else { return frame };
            stepper.apply(&mut frame, answer, Some(&mut changes));
        }
    }

    fn severity(&self, before: &Frame, after: &Frame, settled: &Frame, target: u32) -> Severity {
        let is_task = !self.system.program(0).is_service();
        if settled.phase.is_over() {
            return Severity::Safe;
        }
        if is_task && !self.ends[target as usize] {
            return Severity::Stuck;
        }
        if self.kind == FaultKind::Hang {
            return if self.is_limited(before) { Severity::Handled } else { Severity::Degraded };
        }
        let others = |frame: &Frame| {
            let (running, _) = running(self.system, frame);
            let own = crate::story::member_name(self.system, self.struck.0, self.struck.1);
            running.into_iter().filter(|name| Some(name) != own.as_ref()).collect::<Vec<_>>()
        };
        let goes_on = others(before) == others(settled) && before.phase == after.phase;
        if goes_on && self.new_pause(before, after).is_none() { Severity::Degraded } else { Severity::Handled }
    }

    /// The pause that a fault sets off, after which something goes on: a timer that was not armed before.
    fn new_pause(&self, before: &Frame, after: &Frame) -> Option<Duration> {
        (0..self.system.units.len()).find_map(|unit| {
            let program = self.system.program(unit);
            let is_new = |&timer: &u32| {
                after.states[unit].is_armed(program, timer) && !before.states[unit].is_armed(program, timer)
            };
            let timer = (0..program.timers()).find(is_new)?;
            timer_of(&self.system.model.parts[self.system.units[unit].part].expression, timer as usize)
        })
    }

    /// Whether the program that hangs is one that was to end, so that something has to end it.
    fn is_limited(&self, _: &Frame) -> bool {
        let (unit, member) = self.struck;
        match &self.system.units[unit].seats[member as usize] {
            Occupant::Box(ends) => !ends[0].done.is_empty(),
            Occupant::Unit(_) => true,
        }
    }

    /// What runs and will end: the step that the run is in.
    fn phase(&self, frame: &Frame) -> String {
        let mut names = Vec::new();
        for (unit, state) in frame.states.iter().enumerate() {
            for member in state.members_active() {
                let Occupant::Box(ends) = &self.system.units[unit].seats[member as usize] else { continue };
                let is_step = !ends[0].done.is_empty() || (unit, member) == self.struck;
                let is_there = state.activity(member) == Activity::Active || (unit, member) == self.struck;
                if is_step && is_there {
                    names.extend(crate::story::member_name(self.system, unit, member));
                }
            }
        }
        let own = crate::story::member_name(self.system, self.struck.0, self.struck.1);
        names.retain(|name| Some(name) != own.as_ref());
        if names.is_empty() { "alone".to_owned() } else { names.join(", ") }
    }

    /// The longest limit of a stop among what runs.
    fn longest_stop(&self, frame: &Frame) -> Duration {
        let model = self.system.model;
        let mut longest = Duration::ZERO;
        for (unit, state) in frame.states.iter().enumerate() {
            let group = model.parts[self.system.units[unit].part].group;
            let members = model.plan.groups[group as usize].members.len();
            for member in state.members_active().filter(|&member| (member as usize) < members) {
                let leaves = model.leaves_below(group, member);
                let times = leaves.into_iter().map(|leaf| model.plan.leaves[leaf as usize].stop_within);
                longest = times.fold(longest, Duration::max);
            }
        }
        longest
    }
}

impl Severity {
    /// The word for it.
    pub fn word(self) -> &'static str {
        match self {
            Self::Handled => "handled",
            Self::Safe => "safe",
            Self::Degraded => "goes on without",
            Self::Stuck => "STUCK",
        }
    }
}

impl FaultKind {
    /// The word for it.
    pub fn word(self) -> &'static str {
        match self {
            Self::Crash => "crash",
            Self::Hang => "hang",
            Self::Unanswered => "stop unanswered",
            Self::HostLost => "loss of host",
        }
    }
}
