//! The effects of each single fault, and of each pair of faults, in every state that a run without faults can reach.
//!
//! For a fault of a program, the groups around the program are explored in detail. All other groups are black boxes that end as in a run
//! without faults. For the loss of a host, every group that the loss may split is explored in detail.

mod case;
mod link;
mod pairs;
mod readers;
mod settle;
mod span;
mod watcher;

use crate::explore::{Limits, Nobody, WorkDone, explore};
use crate::model::{Model, short};
use crate::property::{Opened, around};
use crate::story::{Story, seconds};
use crate::system::MemberRef;
use crate::system::{FaultKind, Injection, Loss, LossKind, Mode, System, crashes, is_torn};
use crate::threads::{Alone, each};
use crate::times::Times;
use case::{Case, Struck};
use language::plan::MemberKind;
pub(crate) use pairs::pairs;
pub(crate) use settle::{ABSENT_AFTER, MISSED_AFTER, NOTED_AFTER, stops_by_itself_after};
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// The severity of a fault; the worst comes last.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Another process that the spec provides continues in place of the struck one, or ends it.
    Handled,
    /// Everything is stopped.
    Safe,
    /// The other processes continue without the struck one, and the mission can be done.
    Degraded,
    /// The other processes continue without the struck one, although the mission can only fail.
    FailsLater,
    /// The other processes continue, but some program among them gets no data any more.
    Blind,
    /// It is unknown whether the program has stopped.
    Unconfirmed,
    /// A program is running that the mission cannot reach.
    Adrift,
    /// A process never ends by itself; only a stop from outside helps.
    Stuck,
}

/// The result for the mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mission {
    /// The mission is done.
    Done,
    /// The mission has failed, or can only fail.
    Fails,
    /// The mission can be done, and it can fail because of the fault, even if no limit passes.
    MayFail,
    /// The mission can be done. Because of the fault, it fails only at a limit.
    CanBeDone,
    /// Only a limit can end the mission, and then it has failed.
    EndsByLimit,
    /// The mission never ends.
    NeverEnds,
    /// The mission is a service, and continues.
    GoesOn,
    /// The mission's own host is lost.
    IsLost,
}

/// One row: a fault of one program or host in one phase of the run, or two faults.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// The path of the program, the name of the host, or the two hosts of a lost link. For two faults: both, joined by `and`.
    pub program: String,
    /// The fault, or both faults.
    pub fault: String,
    /// The running steps at the moment of the fault, without services.
    pub phase: String,
    /// The immediate effects. For the loss of a host: the effects once the other hosts have noticed it.
    pub effect: String,
    /// The processes that still run once all stops are answered.
    pub running: Vec<String>,
    /// The longest time until everything has stopped, if everything stops.
    pub safe_within: Option<Duration>,
    /// The result for the mission.
    pub mission: Mission,
    /// The severity of the effects.
    pub severity: Severity,
    /// A run that leads to this result.
    pub story: Story,
}

/// The rows, and whether a limit was reached.
#[derive(Debug, Default)]
pub struct Table {
    /// The rows: programs by name, then hosts, then links.
    pub rows: Vec<Row>,
    /// The programs and hosts that were not explored completely.
    pub unfinished: Vec<String>,
    /// How many states were looked at.
    pub states: u64,
    /// For pairs of faults: the number of pairs that are not worse than one of their two faults alone.
    pub harmless: u64,
}

/// The headings of a table.
pub const COLUMNS: [&str; 8] =
    ["program", "fault", "while", "at once", "still runs", "safe within", "mission", "verdict"];

impl Row {
    /// Returns the cells of the columns.
    pub fn cells(&self) -> [String; 8] {
        let running = if self.running.is_empty() { "nothing".to_owned() } else { self.running.join(", ") };
        let safe = self.safe_within.map_or_else(String::new, seconds);
        let (mission, word) = (self.mission.word().to_owned(), self.severity.word().to_owned());
        let effect = self.effect.replace('`', "");
        [self.program.clone(), self.fault.clone(), self.phase.clone(), effect, running, safe, mission, word]
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

/// One possible fault.
#[derive(Clone, Debug)]
struct Strike {
    /// The name of the struck program or host.
    name: String,
    kind: FaultKind,
    target: Target,
}

/// The target of a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Target {
    /// A program: its group and slot.
    Program(u32, u32),
    Host(Loss),
}

/// Explores every fault of every program, and the loss of every host and link.
pub(crate) fn table(times: &Times<'_, '_>, limits: &Limits<'_>) -> Table {
    let (model, assumed) = (times.model, &times.assumed);
    let all = strikes(model);
    let jobs: Vec<&[Strike]> = all.chunk_by(|one, other| one.name == other.name).collect();
    // If there are many small explorations, each of them runs on one thread.
    let is_many = jobs.len() >= 2 * limits.threads.count();
    let threads = if is_many { &Alone } else { limits.threads };
    let own = Limits { threads, goes_on: limits.goes_on, ..*limits };
    let (done, of) = (AtomicUsize::new(0), jobs.len());
    let found = each(if is_many { limits.threads } else { &Alone }, jobs, |_, strikes| {
        let (times, mut table) = (Times::new(model, assumed.clone()), Table::default());
        for strike in strikes {
            // One reached limit is enough to report a program as unfinished.
            if table.unfinished.is_empty() {
                of_strikes(&times, &[strike], &own, &mut table);
            }
        }
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        limits.goes_on.hear(WorkDone::Jobs { what: "programs and hosts", done, of });
        table
    });
    let mut table = Table::default();
    for mut one in found {
        table.rows.append(&mut one.rows);
        table.unfinished.append(&mut one.unfinished);
        table.states += one.states;
    }
    link::rows(times, limits, &mut table);
    table
}

/// Returns every single fault: programs by name, then hosts.
fn strikes(model: &Model<'_>) -> Vec<Strike> {
    let mut strikes = Vec::new();
    for (group, source) in (0_u32..).zip(&model.plan.groups) {
        for (slot, member) in (0_u32..).zip(&source.members) {
            // Event actions do not contain the ports of an activity, so the activity continues without them.
            if let MemberKind::Leaf(leaf) = member.kind
                && !model.plan.has_ports(leaf)
            {
                let name = short(&model.plan.leaves[leaf as usize].path);
                let target = Target::Program(group, slot);
                let kinds = crashes(model, group, leaf).into_iter().chain([FaultKind::Hang, FaultKind::Unanswered]);
                strikes.extend(kinds.map(|kind| Strike { name: name.clone(), kind, target }));
            }
        }
    }
    strikes.sort_by(|one, other| one.name.cmp(&other.name));
    let hosts = &model.plan.hosts;
    let home = model.plan.groups[0].host;
    let loss = |host: u32, kind| Target::Host(Loss { host, kind });
    for (host, name) in (0_u32..).zip(hosts).filter(|_| hosts.len() > 1) {
        let name = format!("host {name}");
        let target = loss(host, LossKind::Death);
        strikes.push(Strike { name: name.clone(), kind: FaultKind::HostLost, target });
        if hosts.len() > 2 {
            strikes.push(Strike { name, kind: FaultKind::CutOff, target: loss(host, LossKind::Cut) });
        }
    }
    if let [one, other] = hosts.as_slice() {
        let away = u32::from(home == 0);
        let name = format!("{one} - {other}");
        strikes.push(Strike { name, kind: FaultKind::LinkLost, target: loss(away, LossKind::Cut) });
    }
    strikes
}

/// Returns the system in which some faults may happen; none if a program is not in it.
fn system_of<'a>(model: &'a Model<'a>, strikes: &[&Strike]) -> Option<System<'a>> {
    let programs = strikes.iter().filter_map(|strike| match strike.target {
        Target::Program(group, slot) => Some((group, slot, strike.kind)),
        Target::Host(_) => None,
    });
    let programs: Vec<(u32, u32, FaultKind)> = programs.collect();
    let named: Vec<(u32, u32)> = programs.iter().map(|(group, slot, _)| (*group, *slot)).collect();
    let loss = strikes.iter().find_map(|strike| match strike.target {
        Target::Host(loss) => Some(loss),
        Target::Program(..) => None,
    });
    let mut system = match loss {
        Some(_) => torn(model, &named),
        None => around(model, 0, &named, Opened::Hanging),
    };
    let mut injections = Vec::new();
    for (group, slot, kind) in programs {
        let MemberRef { unit, member } = system.find(group, slot)?;
        injections.push(Some(Injection { unit, member, kind }));
    }
    // A loss counts as the first fault.
    if loss.is_some() {
        injections.insert(0, None);
    }
    injections.resize(2, None);
    system.mode = Mode { fault: injections[0], second: injections[1], ..Mode::default() };
    if let Some(loss) = loss {
        system.lose(loss);
    }
    for fault in injections.into_iter().flatten() {
        system.follow_fault(MemberRef { unit: fault.unit, member: fault.member }, fault.kind);
    }
    Some(system)
}

/// Returns the system of the whole. Explored in detail is every group that a loss may split, that may hang, or that contains one of these
/// members.
pub(crate) fn torn<'a>(model: &'a Model<'a>, named: &[(u32, u32)]) -> System<'a> {
    let is_open = |group: u32| is_torn(model, group) || model.parts[group as usize].may_hang;
    let mut open: Vec<bool> = (0_u32..).zip(&model.plan.groups).map(|(group, _)| is_open(group)).collect();
    for &(group, _) in named {
        open[group as usize] = true;
    }
    for group in (0..open.len()).rev() {
        // A group has a greater number than the group that contains it.
        if let Some((around, _)) = model.around[group].filter(|_| open[group]) {
            open[around as usize] = true;
        }
    }
    System::new(model, 0, &|part| open[model.parts[part].group as usize])
}

/// Returns the key by which rows are sorted, the worst last. Among rows that are safe in the end, a longer time is worse, and an unlimited
/// time is the worst.
fn rank(severity: Severity, safe_within: Option<Duration>) -> (Severity, Duration) {
    (severity, safe_within.unwrap_or(Duration::MAX))
}

/// The rows of a fault in one phase of the run.
#[derive(Debug, Default)]
struct PhaseRows {
    worst: Option<case::Judged>,
    /// The first state in which another process continues in place of the struck one.
    handled: Option<case::Judged>,
}

impl PhaseRows {
    fn note(&mut self, judged: case::Judged) {
        let rank = |judged: &case::Judged| rank(judged.severity, judged.safe_within);
        if self.worst.as_ref().is_none_or(|worst| rank(worst) < rank(&judged)) {
            let before = self.worst.replace(judged);
            self.handled = self.handled.take().or(before.filter(|it| it.severity == Severity::Handled));
        } else if judged.severity == Severity::Handled && self.handled.is_none() {
            self.handled = Some(judged);
        }
    }

    /// Returns the worst row. If the worst is `safe`, but processes continue in other states, the row of such a state comes first: `safe`
    /// alone would promise too much.
    fn rows(self) -> impl Iterator<Item = case::Judged> {
        let is_safe = self.worst.as_ref().is_some_and(|worst| worst.severity == Severity::Safe);
        self.handled.filter(|_| is_safe).into_iter().chain(self.worst)
    }
}

/// Explores the effects of some faults together, and adds the rows of each phase.
fn of_strikes(times: &Times<'_, '_>, strikes: &[&Strike], limits: &Limits<'_>, table: &mut Table) {
    let name = || strikes.iter().map(|strike| strike.name.as_str()).collect::<Vec<_>>().join(" and ");
    if !limits.goes_on.goes_on() {
        return table.unfinished.push(name());
    }
    let Some(system) = system_of(times.model, strikes) else { return };
    let graph = explore(&system, limits, true, &Nobody).graph;
    table.states += u64::from(graph.store.count());
    if graph.reached.is_some() {
        return table.unfinished.push(name());
    }
    let struck = strikes.iter().map(|strike| Struck {
        kind: strike.kind,
        seat: match strike.target {
            Target::Program(group, slot) => system.find(group, slot),
            Target::Host(_) => None,
        },
    });
    let case = Case::new(times, &system, &graph, struck.collect());
    let words: Vec<&str> = strikes.iter().map(|strike| strike.kind.word()).collect();
    let mut phases: BTreeMap<String, PhaseRows> = BTreeMap::new();
    case.each_fault(|judged| phases.entry(judged.phase.clone()).or_default().note(judged));
    let rows = phases.into_values().flat_map(PhaseRows::rows);
    table.rows.extend(rows.map(|judged| case.row(name(), words.join(" and "), judged)));
}

impl Severity {
    /// Returns the name of the severity.
    pub fn word(self) -> &'static str {
        match self {
            Self::Handled => "handled",
            Self::Safe => "safe",
            Self::Degraded => "goes on without",
            Self::FailsLater => "fails later",
            Self::Blind => "goes on BLIND",
            Self::Unconfirmed => "UNCONFIRMED",
            Self::Adrift => "OUT OF REACH",
            Self::Stuck => "STUCK",
        }
    }
}

impl Mission {
    /// Returns the words for the result.
    pub fn word(self) -> &'static str {
        match self {
            Self::Done => "is done",
            Self::Fails => "fails",
            Self::MayFail => "may fail",
            Self::CanBeDone => "can be done",
            Self::EndsByLimit => "fails at a limit",
            Self::NeverEnds => "never ends",
            Self::GoesOn => "goes on",
            Self::IsLost => "is lost",
        }
    }
}

impl FaultKind {
    /// Returns the name of the fault.
    pub fn word(self) -> &'static str {
        match self {
            Self::Crash => "crash",
            Self::Hang => "hang",
            Self::Unanswered => "stop unanswered",
            Self::HostLost => "loss of host",
            Self::CutOff => "cut off",
            Self::LinkLost => "loss of link",
            Self::GivenUp => "crash, too often",
            Self::TooMany => "crash, too many",
        }
    }
}
