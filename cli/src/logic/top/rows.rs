//! The rows of each page of `dca top`.

use super::table::{Column, Width};
use super::{Program, ProgramOutput, Tab};
use comms::logic::time::Time;
use std::collections::BTreeMap;
use std::time::Duration;
use view::sentence::time_of_day;
use view::{Health, LiveDeployment, Model, Presence, Process, Question, Robot, RobotId, STALE_AFTER, Wire};

/// The importance of a row, for its colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Tone {
    Plain,
    Good,
    Quiet,
    Changing,
    Bad,
    Title,
}

/// A row.
#[derive(Clone, Debug)]
pub(crate) struct Row {
    /// Stays the same while its cells change.
    pub(crate) id: String,
    pub(crate) cells: Vec<String>,
    pub(crate) tone: Tone,
}

impl Row {
    /// Returns all cells, for a filter.
    pub(crate) fn text(&self) -> String {
        self.cells.join("  ")
    }
}

const fn column(title: &'static str, width: Width) -> Column {
    Column { title, width, is_right: false }
}

const fn number(title: &'static str, width: Width) -> Column {
    Column { title, width, is_right: true }
}

const ROBOTS: [Column; 7] = [
    column("ROBOT", Width::UpTo(20)),
    column("STATE", Width::UpTo(16)),
    number("DATA", Width::UpTo(6)),
    number("UP", Width::UpTo(6)),
    number("PROCESSES", Width::UpTo(9)),
    column("DATABASE", Width::Spare(24)),
    column("NOTE", Width::Rest),
];
const PROCESSES: [Column; 6] = [
    column("PROCESS", Width::Rest),
    column("STATE", Width::UpTo(24)),
    number("SINCE", Width::UpTo(7)),
    column("HOST", Width::UpTo(12)),
    number("PID", Width::Spare(8)),
    number("RESTARTS", Width::Spare(8)),
];
const WIRES: [Column; 5] = [
    column("WIRE", Width::Rest),
    number("RATE", Width::UpTo(10)),
    number("LOST", Width::UpTo(9)),
    number("LOST/S", Width::UpTo(8)),
    number("REFUSED", Width::Spare(8)),
];
const EVENTS: [Column; 4] = [
    column("TIME", Width::UpTo(8)),
    column("HOST", Width::UpTo(10)),
    column("DEPLOYMENT", Width::Spare(24)),
    column("EVENT", Width::Rest),
];
const OUTPUT: [Column; 1] = [column("LINE", Width::Rest)];
const QUESTIONS: [Column; 4] = [
    column("ACTIVITY", Width::UpTo(28)),
    number("NUMBER", Width::UpTo(6)),
    column("QUESTION", Width::Rest),
    column("ANSWERS", Width::UpTo(24)),
];

/// Returns the columns of a page.
pub(crate) fn columns(tab: Tab) -> &'static [Column] {
    match tab {
        Tab::Robots => &ROBOTS,
        Tab::Processes => &PROCESSES,
        Tab::Wires => &WIRES,
        Tab::Events => &EVENTS,
        Tab::Output => &OUTPUT,
        Tab::Questions => &QUESTIONS,
    }
}

/// Returns the rows of a page.
pub(crate) fn rows(model: &Model, now: Time, tab: Tab, program: Option<&Program>) -> Vec<Row> {
    match tab {
        Tab::Robots => robot_rows(model, now),
        Tab::Processes => model.deployments().flat_map(|live| deployment_rows(model, now, live)).collect(),
        Tab::Wires => wires(model).map(|(live, wire)| wire_row(now, live, wire)).collect(),
        Tab::Events => model.events().map(event_row).collect(),
        Tab::Output => output_rows(model, program),
        Tab::Questions => model.questions().map(|question| question_row(&question)).collect(),
    }
}

/// Returns the process of a row.
pub(crate) fn program_of(model: &Model, id: &str) -> Option<Program> {
    let mut all = model.deployments().flat_map(|live| live.processes.values().map(move |process| (live, process)));
    let (live, process) = all.find(|(live, process)| process_id(live, process) == id)?;
    Some(program(live, process))
}

/// Returns the output at the beginning of the wire of a row.
pub(crate) fn output_of(model: &Model, id: &str) -> Option<ProgramOutput> {
    let (live, wire) = wires(model).find(|(live, wire)| wire_id(live, wire) == id)?;
    Some(ProgramOutput { program: program(live, live.processes.get(&wire.from.path)?), port: wire.from.port.clone() })
}

/// Returns the question of a row.
pub(crate) fn question_of<'a>(model: &'a Model, id: &str) -> Option<Question<'a>> {
    model.questions().find(|question| question_id(question) == id)
}

fn program(live: &LiveDeployment, process: &Process) -> Program {
    Program { mission: live.id.clone(), host: process.host.clone(), path: process.path.clone() }
}

fn wires(model: &Model) -> impl Iterator<Item = (&LiveDeployment, &Wire)> {
    model.deployments().flat_map(|live| model.wires(live).map(move |wire| (live, wire)))
}

fn process_id(live: &LiveDeployment, process: &Process) -> String {
    format!("{}:{}", live.id.key(), process.path)
}

fn wire_id(live: &LiveDeployment, wire: &Wire) -> String {
    format!("{}:{}", live.id.key(), wire.name)
}

fn question_id(question: &Question<'_>) -> String {
    format!("{}:{} {}", question.mission.key(), question.path, question.question.number)
}

fn robot_rows(model: &Model, now: Time) -> Vec<Row> {
    let mut counts: BTreeMap<RobotId, usize> = BTreeMap::new();
    for live in model.deployments() {
        for process in live.processes.values() {
            *counts.entry(live.id.robot(&process.host)).or_default() += 1;
        }
    }
    let count = |robot: &Robot| counts.get(&robot.id).copied().unwrap_or_default();
    model.robots().map(|robot| robot_row(now, robot, count(robot))).collect()
}

fn robot_row(now: Time, robot: &Robot, count: usize) -> Row {
    let freshness = robot.freshness(now);
    let (state, tone) = match &robot.presence {
        Presence::Here if robot.estop.is_some() => ("stopped", Tone::Bad),
        Presence::Here if freshness.is_live() => (robot.presence.word(), Tone::Good),
        Presence::Here => ("not live", Tone::Bad),
        Presence::Silent(_) | Presence::Lost => (robot.presence.word(), Tone::Bad),
    };
    let age = robot.heard.map_or_else(|| "-".to_owned(), |heard| age(now.since(heard)));
    let note = match (&robot.estop, &robot.presence) {
        (Some(estop), _) => estop.clone(),
        (None, Presence::Silent(why)) => why.clone(),
        (None, Presence::Here | Presence::Lost) => robot.waiting.join("; "),
    };
    let up = robot.up(now).map_or_else(|| "-".to_owned(), self::age);
    let database = robot.database.as_ref().map(ToString::to_string).unwrap_or_default();
    let note = if note.is_empty() { robot.guard.clone() } else { note };
    Row {
        id: robot.id.to_string(),
        cells: vec![robot.id.to_string(), state.to_owned(), age, up, count.to_string(), database, note],
        tone,
    }
}

fn deployment_rows(model: &Model, now: Time, live: &LiveDeployment) -> Vec<Row> {
    let tone = if live.end.as_ref().is_some_and(|end| end.is_failed) { Tone::Bad } else { Tone::Title };
    let since = live.end.as_ref().map(|end| end.at).or(live.began);
    let since = since.map_or_else(String::new, |at| age(now.since(at)));
    let none = String::new;
    let title = Row {
        id: live.id.key(),
        cells: vec![live.id.to_string(), live.phase(), since, live.id.home.clone(), none(), none()],
        tone,
    };
    std::iter::once(title)
        .chain(live.processes.values().map(|process| process_row(model, now, live, process)))
        .collect()
}

fn process_row(model: &Model, now: Time, live: &LiveDeployment, process: &Process) -> Row {
    let depth = process.path.matches('/').count();
    let name = process.path.rsplit('/').next().unwrap_or(&process.path);
    let health = model.health(&live.id, process);
    let tone = match health {
        Health::Running => Tone::Good,
        Health::Quiet => Tone::Quiet,
        Health::Changing => Tone::Changing,
        Health::Failed | Health::Unknown => Tone::Bad,
    };
    let mark = if process.since.is_exact { "" } else { ">" };
    let cells = vec![
        format!("{}{name}: {}", "  ".repeat(depth + 1), process.kind),
        process.state_text(health),
        format!("{mark}{}", age(now.since(process.since.at))),
        process.host.clone(),
        process.pid.map(|pid| pid.to_string()).unwrap_or_default(),
        if process.restarts == 0 { String::new() } else { process.restarts.to_string() },
    ];
    Row { id: process_id(live, process), cells, tone }
}

fn wire_row(now: Time, live: &LiveDeployment, wire: &Wire) -> Row {
    let is_measured = |at: Time| now.since(at) < STALE_AFTER;
    let rate = wire.rate.filter(|rate| is_measured(rate.at)).map(|rate| format!("{:.1} Hz", rate.hertz));
    let is_losing = wire.lost_a_second > 0.0 || wire.undelivered > 0;
    let count = |count: u64| if count == 0 { "-".to_owned() } else { count.to_string() };
    let lost_a_second = if wire.lost_a_second > 0.0 { format!("{:.1}", wire.lost_a_second) } else { "-".to_owned() };
    let name = format!(
        "{}: {}.{} -> {}.{}",
        live.id.deployment.name, wire.from.path, wire.from.port, wire.to.path, wire.to.port
    );
    let cells = vec![name, rate.unwrap_or_default(), count(wire.missing()), lost_a_second, count(wire.refused)];
    let tone = match (is_losing, wire.missing() + wire.refused) {
        (true, _) => Tone::Bad,
        (false, 1..) => Tone::Changing,
        (false, 0) => Tone::Plain,
    };
    Row { id: wire_id(live, wire), cells, tone }
}

fn event_row(event: &view::EventLine) -> Row {
    let time = event.time.map(time_of_day).unwrap_or_default();
    let deployment = event.mission.as_ref().map(ToString::to_string).unwrap_or_default();
    let text = event.path.as_ref().map_or_else(|| event.text.clone(), |path| format!("{path}  {}", event.text));
    let tone = if event.is_failure { Tone::Bad } else { Tone::Plain };
    Row { id: event.ordinal.to_string(), cells: vec![time, event.robot.host.clone(), deployment, text], tone }
}

fn output_rows(model: &Model, program: Option<&Program>) -> Vec<Row> {
    let Some(program) = program else { return Vec::new() };
    let own = model.lines().filter(|line| line.mission == program.mission && line.path == program.path);
    own.map(|line| Row { id: line.ordinal.to_string(), cells: vec![line.text.clone()], tone: Tone::Plain }).collect()
}

fn question_row(question: &Question<'_>) -> Row {
    let open = question.question;
    let cells = vec![
        format!("{}:{}", question.mission.deployment.name, question.path),
        open.number.to_string(),
        open.text.clone(),
        open.options.join(", "),
    ];
    Row { id: question_id(question), cells, tone: Tone::Changing }
}

/// Returns a span of time in at most four characters and a unit: `42s`, `12m`, `5h`, `3d`.
pub(crate) fn age(time: Duration) -> String {
    match time.as_secs() {
        seconds @ 0..120 => format!("{seconds}s"),
        seconds @ 120..7200 => format!("{}m", seconds / 60),
        seconds @ 7200..172_800 => format!("{}h", seconds / 3600),
        seconds => format!("{}d", seconds / 86_400),
    }
}
