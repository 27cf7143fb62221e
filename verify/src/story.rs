//! Describes the events on a way through a system, in words of the spec.

mod event;
pub(crate) mod inside;
mod states;

use crate::explore::Graph;
use crate::model::{Model, Seat, times_of};
use crate::system::MemberRef;
use crate::system::{Change, Changed, FaultKind, Frame, Label, LossKind, Phase, System};
use event::event;
use language::TraceEvent;
use language::algebra::Activity;
use language::automaton::Failure;
use language::plan::{Expression, MemberKind};
use std::time::Duration;

/// One step of a story.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Step {
    /// The event.
    pub cause: String,
    /// The immediate effects, with one clause each.
    pub effects: Vec<String>,
    /// The cause in a form for programs. Empty if the cause has no name, for example an event of a piece of a group.
    pub events: Vec<TraceEvent>,
    /// The changes of the spec's processes.
    pub moves: Vec<Move>,
}

/// A change of a process's state.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Move {
    /// The name of the process.
    pub process: String,
    /// The host of the process; for a group, the host of its supervisor.
    pub host: String,
    /// The new state of the process.
    pub became: Became,
}

/// The new state of a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Became {
    /// The process is started.
    Active,
    /// The process is asked to stop.
    Stopping,
    /// The process is done.
    Done,
    /// The process has failed.
    Failed,
    /// The process has stopped.
    Stopped,
}

/// The way to a violation: the events step by step, and the processes that run at the end.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Story {
    /// The steps, the first first.
    pub steps: Vec<Step>,
    /// The index of the step from which the story repeats for ever. It is the number of steps if nothing happens any
    /// more.
    pub again: Option<usize>,
    /// The processes that run at the end.
    pub running: Vec<String>,
    /// The processes that are being stopped at the end.
    pub stopping: Vec<String>,
    /// Processes that may run at the end but are not part of the story, since they share nothing with its subject.
    pub untold: Vec<String>,
    /// The started processes whose orders and reports take time between hosts, by their paths.
    pub travels: Vec<String>,
    /// How the whole has ended; none if it has not ended.
    pub ended: Option<Became>,
}

/// Returns the story of the shortest way to a state of a graph.
pub(crate) fn story(system: &System<'_>, graph: &Graph, state: u32) -> Story {
    tell(system, &graph.way(state))
}

/// Returns the story of the shortest way to a state, and from there to a state in which nothing happens any more.
pub(crate) fn story_to_the_end(system: &System<'_>, graph: &Graph, state: u32) -> Story {
    let way: Vec<Label> = graph.way(state).into_iter().chain(graph.dead_end(system, state)).collect();
    tell(system, &way)
}

/// Tells a way.
pub(crate) fn tell(system: &System<'_>, way: &[Label]) -> Story {
    tell_run(system, way, None)
}

/// Returns the story of a way, and of the cycle after it that repeats for ever.
pub(crate) fn tell_run(system: &System<'_>, way: &[Label], again: Option<&[Label]>) -> Story {
    let mut frame = system.initial();
    let (mut story, mut changes, mut stepper) = (Story::default(), Vec::new(), system.stepper());
    for (number, &label) in way.iter().chain(again.unwrap_or_default()).enumerate() {
        if number == way.len() {
            story.again = Some(story.steps.len());
        }
        let cause = cause(system, label);
        let before = states::names(system, &frame);
        let inside = inside::steps(system, &frame, label);
        stepper.apply(&mut frame, label, Some(&mut changes));
        let mut effects = effects(system, label, &changes);
        effects.extend(states::entered(system, &before, &frame));
        let sent = changes.iter().filter(|change| change.what == Changed::Sent);
        story.travels.extend(sent.filter_map(|change| event::path(system, change.unit, change.member?)));
        let event = event(system, label);
        let moves: Vec<Move> = changes.iter().filter_map(|change| move_of(system, change)).collect();
        if let Some(mut steps) = inside {
            if let Some(last) = steps.last_mut() {
                last.effects.extend(effects);
                last.moves.extend(moves);
            }
            story.steps.append(&mut steps);
            continue;
        }
        match story.steps.last_mut() {
            // Answers to stops are joined to one step while they have no other effect.
            Some(last)
                if matches!(label, Label::Stopped(..))
                    && effects.is_empty()
                    && is_stop(last)
                    && number != way.len() =>
            {
                let name = cause.strip_suffix(STOPPED).unwrap_or(&cause);
                last.cause = last.cause.replace(STOPPED, &format!(", {name}{STOPPED}"));
                last.moves.extend(moves);
                // If one of the joined events has no name, none of them is listed.
                match event {
                    Some(event) if !last.events.is_empty() => last.events.push(event),
                    _ => last.events.clear(),
                }
            }
            Some(_) | None => {
                story.steps.push(Step { cause, effects, events: event.into_iter().collect(), moves });
            }
        }
    }
    if again.is_some_and(<[Label]>::is_empty) {
        story.again = Some(story.steps.len());
    }
    (story.running, story.stopping) = running(system, &frame);
    story.untold = untold(system, &frame);
    story.travels.sort();
    story.travels.dedup();
    story.ended = match frame.phase {
        Phase::Done => Some(Became::Done),
        Phase::Aborted => Some(Became::Failed),
        Phase::Stopped => Some(Became::Stopped),
        Phase::Idle | Phase::Running | Phase::Stopping => None,
    };
    story
}

/// Returns the change of a process of the spec; none for the whole and for a piece of a group.
fn move_of(system: &System<'_>, change: &Change) -> Option<Move> {
    let member = change.member?;
    let process = member_name(system, change.unit, member)?;
    let host = host_name(system, MemberRef { unit: change.unit, member }).to_owned();
    let became = match change.what {
        Changed::Sent => return None,
        Changed::Started => Became::Active,
        Changed::Stopping => Became::Stopping,
        Changed::Done(_) => Became::Done,
        Changed::Aborted(_) => Became::Failed,
        Changed::Stopped => Became::Stopped,
        Changed::Away => Became::Failed,
    };
    Some(Move { process, host, became })
}

const STOPPED: &str = " stopped";

fn is_stop(step: &Step) -> bool {
    step.effects.is_empty() && step.cause.ends_with(STOPPED)
}

/// Returns the host of a member; empty for a piece of a group.
fn host_name<'s>(system: &'s System<'_>, MemberRef { unit, member }: MemberRef) -> &'s str {
    let plan = system.model.plan;
    let group = &plan.groups[system.model.parts[system.units[unit].part].group as usize];
    let host = group.members.get(member as usize).map(|source| match source.kind {
        MemberKind::Leaf(leaf) => plan.leaves[leaf as usize].host,
        MemberKind::Group(inner) => plan.groups[inner as usize].host,
    });
    host.and_then(|host| plan.hosts.get(host as usize)).map_or("", String::as_str)
}

/// Returns the running members, and the members that are being stopped. Groups that were explored
/// in detail are left out, but their members are included.
pub(crate) fn running(system: &System<'_>, frame: &Frame) -> (Vec<String>, Vec<String>) {
    let (mut running, mut stopping) = (Vec::new(), Vec::new());
    for MemberRef { unit, member } in there(system, frame) {
        let Some(name) = member_name(system, unit, member) else { continue };
        match frame.states[unit].activity(member) {
            Activity::Stopping if !system.is_silent(frame, unit) => stopping.push(name),
            Activity::Stopping | Activity::Active | Activity::Idle => running.push(name),
        }
    }
    (running, stopping)
}

/// Returns the active members, while the whole continues or a part of it runs beyond a loss.
fn there(system: &System<'_>, frame: &Frame) -> Vec<MemberRef> {
    let is_on = frame.phase != Phase::Idle && (!frame.phase.is_over() || system.is_split(frame));
    if is_on { system.there(frame) } else { Vec::new() }
}

/// Returns the processes in the black boxes of pieces of groups that continue.
fn untold(system: &System<'_>, frame: &Frame) -> Vec<String> {
    let pieces = there(system, frame)
        .into_iter()
        .filter(|MemberRef { unit, member }| member_name(system, *unit, *member).is_none());
    let mut names = Vec::new();
    for MemberRef { unit, member } in pieces {
        let part = &system.model.parts[system.units[unit].part];
        if let Some(Seat::Part(piece)) = part.members.get(member as usize) {
            let held = system.model.held(*piece).into_iter();
            names.extend(held.map(|(_, slot)| system.model.name(part.group, slot)));
        }
    }
    names
}

/// Returns the name of a member; none for a piece of a group.
pub(crate) fn member_name(system: &System<'_>, unit: usize, member: u32) -> Option<String> {
    let part = &system.model.parts[system.units[unit].part];
    let group = &system.model.plan.groups[part.group as usize];
    (usize::try_from(member).ok()? < group.members.len()).then(|| system.model.name(part.group, member))
}

fn lost_host<'s>(system: &'s System<'_>) -> &'s str {
    let host = system.mode.lost.and_then(|loss| system.model.plan.hosts.get(loss.host as usize));
    host.map_or("", String::as_str)
}

fn cause(system: &System<'_>, label: Label) -> String {
    let group = |unit: u16| system.model.group_name(system.model.parts[system.units[usize::from(unit)].part].group);
    let name = |unit: u16, member: u16| {
        let name = member_name(system, usize::from(unit), u32::from(member));
        name.map_or_else(|| format!("a part of `{}`", group(unit)), |name| format!("`{name}`"))
    };
    match label {
        Label::Start => format!("`{}` starts", group(0)),
        Label::StartWith(value) => format!("`{}` starts with {}", group(0), system.tag(value).unwrap_or_default()),
        Label::Stop => format!("`{}` is asked to stop", group(0)),
        Label::Done(unit, member, value) => match system.tag(value) {
            Some(tag) => format!("{} is done: {tag}", name(unit, member)),
            None => format!("{} is done", name(unit, member)),
        },
        Label::Aborted(unit, member, why) => match system.reason_told(why) {
            Some(reason) => format!("{} fails: {reason}", name(unit, member)),
            None => format!("{} fails", name(unit, member)),
        },
        Label::Stopped(unit, member) => format!("{}{STOPPED}", name(unit, member)),
        Label::Elapsed(unit, timer) => {
            let part = &system.model.parts[system.units[usize::from(unit)].part];
            let time = timer_of(&part.expression, usize::from(timer));
            let time = time.map_or_else(|| "some seconds".to_owned(), seconds);
            states::timer(&part.expression, usize::from(timer), &group(unit), &time)
                .unwrap_or_else(|| format!("{time} have passed"))
        }
        Label::Reached(unit) => format!("the order to stop reaches `{}`", group(unit)),
        Label::Arrived(unit, member) => {
            let host = host_name(system, MemberRef { unit: usize::from(unit), member: u32::from(member) });
            format!("the order to start {} reaches `{host}`", name(unit, member))
        }
        Label::Told(unit, number) => {
            format!("`{}` gets {}", group(unit), system.message_name(usize::from(unit), number))
        }
        Label::Script(unit, kind) => {
            format!("the next script of `{}` will fail: {}", group(unit), Failure::of_script(kind))
        }
        Label::Heard(unit, member) => {
            format!("the report that {} has ended reaches `{}`", name(unit, member), group(unit))
        }
        Label::Lost => {
            let what = match system.mode.lost.map(|loss| loss.kind) {
                Some(LossKind::Cut) => "IS CUT OFF",
                Some(LossKind::Death) | None => "IS LOST",
                Some(LossKind::Programs) => "LOSES ALL ITS PROGRAMS, as when it starts again",
            };
            format!("the host `{}` {what}", lost_host(system))
        }
        Label::Noted(host) => {
            let host = system.model.plan.hosts.get(usize::from(host)).map_or("", String::as_str);
            match lost_host(system) {
                lost if lost == host => format!("`{host}` notes that it reaches no other host"),
                lost => format!("`{host}` notes that `{lost}` is lost"),
            }
        }
        Label::Died(unit, member) => format!("{} dies: it is away until it is started again", name(unit, member)),
        Label::Back(unit, member) => format!("{} runs again, and has forgotten what it knew", name(unit, member)),
        Label::TooMany(unit) => {
            format!("a program of `{}` dies, once more than the group allows", group(unit))
        }
        Label::Fault(unit, member) => format!("{} {}", name(unit, member), fault(system, unit, member, false)),
        Label::Second(unit, member) => format!("{} {}", name(unit, member), fault(system, unit, member, true)),
    }
}

/// Returns the effect of a fault on a member, as a verb.
fn fault(system: &System<'_>, unit: u16, member: u16, is_second: bool) -> &'static str {
    let injected = if is_second { system.mode.second } else { system.mode.fault };
    match injected.map(|fault| fault.kind) {
        Some(FaultKind::Crash)
            if system.is_restarted(MemberRef { unit: usize::from(unit), member: u32::from(member) }) =>
        {
            "CRASHES: it is started again, and has lost its state"
        }
        Some(kind) => kind.verb(),
        None => "fails",
    }
}

/// Returns the effects of some changes, with one clause each.
pub(crate) fn effects(system: &System<'_>, label: Label, changes: &[Change]) -> Vec<String> {
    let subject = match label {
        Label::Done(unit, member, _) | Label::Aborted(unit, member, _) | Label::Stopped(unit, member) => {
            Some((usize::from(unit), u32::from(member)))
        }
        Label::Fault(unit, member)
        | Label::Second(unit, member)
        | Label::Died(unit, member)
        | Label::Heard(unit, member)
        | Label::Back(unit, member) => Some((usize::from(unit), u32::from(member))),
        Label::Start
        | Label::StartWith(_)
        | Label::Stop
        | Label::Elapsed(..)
        | Label::Told(..)
        | Label::Script(..)
        | Label::Reached(_)
        | Label::Arrived(..)
        | Label::TooMany(_)
        | Label::Lost
        | Label::Noted(_) => None,
    };
    let (mut starts, mut sent, mut stops, mut ends) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for change in changes {
        let Some(member) = change.member else {
            match &change.what {
                Changed::Done(_) => ends.push(format!("`{}` is done", root_name(system))),
                Changed::Aborted(_) => ends.push(format!("`{}` fails", root_name(system))),
                Changed::Stopped => ends.push(format!("`{}` has stopped", root_name(system))),
                Changed::Started | Changed::Sent | Changed::Stopping | Changed::Away => {}
            }
            continue;
        };
        let Some(name) = member_name(system, change.unit, member) else { continue };
        let is_told = !matches!(change.what, Changed::Started) || matches!(label, Label::Back(..));
        if subject == Some((change.unit, member)) && is_told {
            continue;
        }
        match &change.what {
            Changed::Started => starts.push(format!("`{name}`")),
            Changed::Sent => sent.push(format!("`{name}`")),
            Changed::Stopping => stops.push(format!("`{name}`")),
            Changed::Done(_) => ends.push(format!("`{name}` is done")),
            Changed::Aborted(_) => ends.push(format!("`{name}` fails")),
            Changed::Stopped => ends.push(format!("`{name}` has stopped")),
            Changed::Away => ends.push(format!("`{name}` is started again with it")),
        }
    }
    let mut all = ends;
    if !stops.is_empty() {
        all.push(format!("stops {}", stops.join(", ")));
    }
    if !starts.is_empty() {
        all.push(format!("starts {}", starts.join(", ")));
    }
    if !sent.is_empty() {
        all.push(format!("sends the order to start {}", sent.join(", ")));
    }
    all
}

fn root_name(system: &System<'_>) -> String {
    system.model.group_name(system.model.parts[system.units[0].part].group)
}

/// Returns the time of a timer, by its number in textual order.
pub(crate) fn timer_of(expression: &Expression, timer: usize) -> Option<Duration> {
    times_of(expression).get(timer).copied()
}

/// Returns a time in the form that people write.
pub fn seconds(time: Duration) -> String {
    let seconds = time.as_secs_f64();
    if seconds >= 1.0 || seconds == 0.0 { format!("{seconds} s") } else { format!("{} ms", seconds * 1000.0) }
}

impl Story {
    /// The story as lines, numbered.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        for (number, step) in (1..).zip(&self.steps) {
            if self.again == Some(number - 1) {
                lines.push("     … and then for ever:".to_owned());
            }
            let effects =
                if step.effects.is_empty() { String::new() } else { format!(": {}", step.effects.join("; ")) };
            lines.push(format!("{number:>3}  {}{effects}", step.cause));
        }
        if self.again == Some(self.steps.len()) {
            lines.push("     … and then nothing happens any more".to_owned());
        }
        if !self.running.is_empty() {
            lines.push(format!("     now runs: {}", self.running.join(", ")));
        }
        if !self.stopping.is_empty() {
            lines.push(format!("     is being stopped: {}", self.stopping.join(", ")));
        }
        if !self.untold.is_empty() {
            lines.push(format!("     may run beside it: {}", self.untold.join(", ")));
        }
        lines
    }
}

impl FaultKind {
    /// The fault as a verb.
    pub fn verb(self) -> &'static str {
        match self {
            Self::Crash => "CRASHES",
            Self::Hang => "HANGS: it never ends by itself",
            Self::Unanswered => "DOES NOT ANSWER the stop",
            Self::HostLost => "is lost with its host",
            Self::CutOff => "is cut off with its host",
            Self::LinkLost => "loses its link",
            Self::GivenUp => "CRASHES, too often to be started again",
            Self::TooMany => "CRASHES, once more than its group allows",
        }
    }
}

/// The place of a node of a part.
pub(crate) fn place(model: &Model<'_>, part: usize, node: usize) -> language::Span {
    let part = &model.parts[part];
    let sites = &model.sites.groups[part.group as usize];
    let number = part.nodes.get(node).map_or(0, |&number| number as usize);
    sites.nodes.get(number).copied().unwrap_or(sites.name)
}
