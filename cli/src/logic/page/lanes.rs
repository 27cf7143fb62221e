//! The lanes of the page: when each process ran, and how that ended. The page of a live view has the same lanes.

use crate::logic::mission::{Mission, seconds, short};
use crate::logic::page::axis::{LEFT, TimeAxis, fits, svg};
use crate::logic::page::text::escape;
use crate::logic::record::{Entry, Run};
use language::plan::{MemberKind, Plan};
use node::logic::protocol::{Change, Ending, Report};
use node::logic::table::counted;
use std::collections::BTreeMap;
use std::time::Duration;
use view::sentence::change_text;

/// Height of a lane.
const LANE: f64 = 18.0;
/// The most lanes; with more, the picture would be unreadable.
const LANES_MAX: usize = 250;
/// The indentation of a member relative to its group.
const INDENT: usize = 2;
/// The longest name, in letters.
const NAME_MAX: usize = 25;

/// The row of a process.
#[derive(Debug)]
pub(crate) struct Lane<'a> {
    pub(crate) path: String,
    depth: usize,
    pub(crate) leaf: bool,
    /// Its state before its first change.
    pub(crate) begins: State,
    pub(crate) changes: Vec<(Duration, &'a Change)>,
}

/// A change of a process, for its lane.
#[derive(Debug)]
pub(crate) struct LaneChange<'a> {
    /// The absolute path of the process.
    pub(crate) path: &'a str,
    pub(crate) at: Duration,
    pub(crate) change: &'a Change,
}

/// The state of a process, as a lane shows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum State {
    Absent,
    Idle,
    Running,
    Stopping,
}

/// Returns the picture of a run with its legend.
pub(super) fn figure(run: &Run, mission: &Mission, axis: &TimeAxis) -> String {
    let changes = run.entries.iter().filter_map(|entry| {
        let Entry::Report(Report::Process { path, change, at }) = entry else { return None };
        Some(LaneChange { path, at: *at, change })
    });
    let (lanes, hidden) = lanes(&run.header.plan, changes);
    let (legend, mut picture) = (legend(), rows(&lanes, mission.now(), axis));
    if hidden > 0 {
        picture.push_str(&format!("<p class=\"quiet\">Not shown: {}.</p>\n", counted(hidden, "row")));
    }
    format!(
        "<figure>\n<figcaption><b>processes</b>\n<span class=\"legend\">\n{legend}</span></figcaption>\n{picture}</figure>\n"
    )
}

/// Returns the keys of the colours and signs.
fn legend() -> String {
    let mut text = String::new();
    for (class, name) in [("idle", "idle"), ("running", "running"), ("stopping", "stopping")] {
        text.push_str(&format!(
            "<span class=\"key\"><svg viewBox=\"0 0 24 10\"><rect class=\"{class}\" x=\"0\" y=\"{}\" width=\"24\" \
             height=\"{}\"/></svg>{name}</span>\n",
            if class == "idle" { 4 } else { 0 },
            if class == "idle" { 2 } else { 10 }
        ));
    }
    text.push_str("<span class=\"key\"><span class=\"good\">●</span>done</span>\n");
    text.push_str("<span class=\"key\"><span class=\"bad\">✕</span>failed</span>\n");
    text
}

/// Returns the lanes up to `now` as SVG.
pub(crate) fn rows(lanes: &[Lane<'_>], now: Duration, axis: &TimeAxis) -> String {
    let height = LANE * f64::from(u32::try_from(lanes.len()).unwrap_or(u32::MAX));
    let mut text = svg("plot", height + 20.0, "when each process ran");
    text.push_str(&axis.behind(height));
    text.push_str(&axis.ticks(height));
    for (row, lane) in (0_u32..).zip(lanes) {
        text.push_str(&lane_picture(lane, f64::from(row) * LANE, now, axis));
    }
    text.push_str(&axis.cursor(height));
    text.push_str("</svg>\n");
    text
}

/// Returns the lanes of the processes of a plan with their changes, and how many more there would be.
pub(crate) fn lanes<'a>(plan: &Plan, changes: impl Iterator<Item = LaneChange<'a>>) -> (Vec<Lane<'a>>, usize) {
    let mut by_path: BTreeMap<&str, Vec<(Duration, &Change)>> = BTreeMap::new();
    for LaneChange { path, at, change } in changes {
        by_path.entry(path).or_default().push((at, change));
    }
    let mut lanes = empty_lanes(plan);
    let hidden = lanes.len().saturating_sub(LANES_MAX);
    lanes.truncate(LANES_MAX);
    for lane in &mut lanes {
        lane.changes = by_path.remove(lane.path.as_str()).unwrap_or_default();
    }
    (lanes, hidden)
}

/// Returns an empty lane for each process, each group before its members.
fn empty_lanes<'a>(plan: &Plan) -> Vec<Lane<'a>> {
    let mut lanes = Vec::new();
    let mut stack = vec![(MemberKind::Group(0), 0)];
    while let Some((kind, depth)) = stack.pop() {
        let (path, leaf) = match kind {
            MemberKind::Leaf(leaf) => {
                (usize::try_from(leaf).ok().and_then(|leaf| plan.leaves.get(leaf)).map(|leaf| &leaf.path), true)
            }
            MemberKind::Group(group) => {
                let group = usize::try_from(group).ok().and_then(|group| plan.groups.get(group));
                let members = group.map_or(&[][..], |group| &group.members);
                stack.extend(members.iter().rev().map(|member| (member.kind, depth + 1)));
                (group.map(|group| &group.path), false)
            }
        };
        // The second half of the bound is for plans that go in circles.
        let Some(path) = path.filter(|_| lanes.len() < plan.groups.len() + plan.leaves.len()) else { continue };
        let begins = if leaf { State::Idle } else { State::Absent };
        lanes.push(Lane { path: path.clone(), depth, leaf, begins, changes: Vec::new() });
    }
    lanes
}

fn lane_picture(lane: &Lane<'_>, top: f64, now: Duration, axis: &TimeAxis) -> String {
    let name = lane.path.rsplit('/').next().unwrap_or(&lane.path);
    let name: String = "\u{a0}".repeat(INDENT * lane.depth).chars().chain(name.chars()).take(NAME_MAX).collect();
    let kind = if lane.leaf { "lane" } else { "lane group" };
    let mut text = format!(
        "<g><title>{}</title><text class=\"{kind}\" x=\"4\" y=\"{:.1}\">{}</text>\
         <line class=\"grid\" x1=\"4\" x2=\"{LEFT}\" y1=\"{y:.1}\" y2=\"{y:.1}\"/></g>\n",
        escape(&lane.path),
        top + 13.0,
        escape(&name),
        y = top + LANE
    );
    let (mut state, mut since) = (lane.begins, Duration::ZERO);
    let mut marks = String::new();
    for (at, change) in &lane.changes {
        text.push_str(&span(lane, state, since, *at, top, axis));
        state = after(state, change, lane.leaf);
        since = *at;
        marks.push_str(&mark(lane, *at, change, top, axis));
    }
    text.push_str(&span(lane, state, since, now, top, axis));
    text.push_str(&states(lane, now, top, axis));
    text + &marks
}

/// Returns the states of an activity as bands in its lane, each with its name where there is room. Of the bands that would begin
/// within one point of the picture, only the last one is drawn: an activity may change its state a thousand times a second.
fn states(lane: &Lane<'_>, now: Duration, top: f64, axis: &TimeAxis) -> String {
    let mut bands: Vec<StateBand> = Vec::new();
    for (at, change) in &lane.changes {
        let entered = if let Change::Entered { states } = change { Some(states) } else { None };
        if entered.is_none() && !matches!(change, Change::Ended(_) | Change::Died(_)) {
            continue;
        }
        if let Some(last) = bands.last_mut() {
            last.end.get_or_insert(*at);
        }
        if let Some(states) = entered {
            bands.pop_if(|last| axis.x(*at) - axis.x(last.begin) < 1.0);
            bands.push(StateBand { name: states.join(", "), begin: *at, end: None });
        }
    }
    let shown = bands.iter().filter(|band| !axis.is_before(band.end.unwrap_or(now)));
    shown.map(|band| band.picture(lane, band.end.unwrap_or(now), top, axis)).collect()
}

/// The time that an activity spends in the same states.
#[derive(Debug)]
struct StateBand {
    name: String,
    begin: Duration,
    end: Option<Duration>,
}

impl StateBand {
    fn picture(&self, lane: &Lane<'_>, end: Duration, top: f64, axis: &TimeAxis) -> String {
        let (x, y, name) = (axis.x(self.begin), top + 2.0, escape(&self.name));
        let width = (axis.x(end) - x).max(1.0);
        let shown = if fits(&self.name, width) {
            format!("<text class=\"state\" x=\"{:.1}\" y=\"{:.1}\">{name}</text>", x + 4.0, top + 13.0)
        } else {
            String::new()
        };
        format!(
            "<g><title>{} in {name}, {} to {}</title>\
             <rect class=\"state\" x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{:.1}\"/>{shown}</g>\n",
            escape(short(&lane.path)),
            seconds(self.begin),
            seconds(end),
            LANE - 4.0
        )
    }
}

impl State {
    /// Returns the state before a change, as far as the change shows it.
    pub(crate) fn before(change: &Change, leaf: bool) -> Self {
        match change {
            Change::Stopping | Change::Ended(_) | Change::Says { .. } | Change::Entered { .. } => Self::Running,
            Change::Activated | Change::Died(_) | Change::Configured { .. } if leaf => Self::Idle,
            Change::Restarting { .. } | Change::Renewing { .. } | Change::Replacing | Change::Reverting { .. } => {
                Self::Running
            }
            Change::Activated
            | Change::Died(_)
            | Change::Configured { .. }
            | Change::Started { .. }
            | Change::Held { .. }
            | Change::HeldBy { .. }
            | Change::EndedLate
            | Change::Switched(_)
            | Change::Resumed => Self::Absent,
        }
    }
}

fn after(state: State, change: &Change, leaf: bool) -> State {
    match change {
        Change::Activated | Change::Resumed => State::Running,
        Change::Stopping => State::Stopping,
        Change::Restarting { .. } | Change::Renewing { .. } | Change::Replacing | Change::Reverting { .. } => {
            State::Absent
        }
        Change::Ended(_) if leaf => State::Idle,
        Change::Ended(_) | Change::Died(_) => State::Absent,
        Change::Started { .. } if state == State::Absent => State::Idle,
        Change::Started { .. }
        | Change::Held { .. }
        | Change::HeldBy { .. }
        | Change::EndedLate
        | Change::Switched(_)
        | Change::Configured { .. }
        | Change::Says { .. }
        | Change::Entered { .. } => state,
    }
}

fn span(lane: &Lane<'_>, state: State, begin: Duration, end: Duration, top: f64, axis: &TimeAxis) -> String {
    let (class, inset) = match state {
        State::Absent => return String::new(),
        State::Idle => ("idle", 8.0),
        State::Running => ("running", 3.0),
        State::Stopping => ("stopping", 3.0),
    };
    if end <= begin || axis.is_before(end) {
        return String::new();
    }
    let (x, width) = (axis.x(begin), (axis.x(end) - axis.x(begin)).max(1.0));
    format!(
        "<rect class=\"{class}\" x=\"{x:.1}\" y=\"{:.1}\" width=\"{width:.1}\" height=\"{:.1}\">\
         <title>{} {class}, {} to {}</title></rect>\n",
        top + inset,
        LANE - 2.0 * inset,
        escape(short(&lane.path)),
        seconds(begin),
        seconds(end)
    )
}

fn mark(lane: &Lane<'_>, at: Duration, change: &Change, top: f64, axis: &TimeAxis) -> String {
    if axis.is_before(at) {
        return String::new();
    }
    let (class, sign) = match change {
        Change::Ended(Ending::Done(_)) => ("good", "●"),
        Change::Ended(Ending::Aborted(_) | Ending::Unconfirmed) | Change::Died(_) => ("bad", "✕"),
        Change::Restarting { .. } | Change::Renewing { .. } | Change::Reverting { .. } => ("bad", "↻"),
        Change::Replacing => ("good", "↻"),
        Change::Held { .. } | Change::HeldBy { .. } => ("bad", "…"),
        Change::Configured { .. } => ("good", "◆"),
        Change::Says { .. } => ("good", "·"),
        Change::Ended(Ending::Stopped)
        | Change::Activated
        | Change::Stopping
        | Change::Started { .. }
        | Change::EndedLate
        | Change::Switched(_)
        | Change::Entered { .. }
        | Change::Resumed => return String::new(),
    };
    format!(
        "<text class=\"mark {class}\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\"><title>{} {} at {}</title>{sign}</text>\n",
        axis.x(at),
        top + 13.5,
        escape(short(&lane.path)),
        escape(&change_text(change)),
        seconds(at)
    )
}
