//! The timeline of a mission for its page, with the lanes of a report.

use super::asked::Asked;
use crate::logic::page::axis::TimeAxis;
use crate::logic::page::lanes::{LaneChange, State, lanes, rows};
use comms::logic::time::Time;
use language::plan::Plan;
use node::logic::table::counted;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use view::{Health, LiveDeployment, Model, PastChange};

/// The parts of a timeline, copied from the model so that it can be drawn without it.
#[derive(Debug)]
pub(crate) struct Past {
    plan: Arc<Plan>,
    changes: Vec<PastChange>,
    /// The processes that run, by path. Without an earlier change, they have always run.
    running: BTreeMap<String, bool>,
    /// When the times of the picture begin to count.
    zero: Time,
    is_since_go: bool,
    begin: Time,
    end: Time,
}

impl Past {
    /// Returns the parts of a timeline. None if the model has no such plan any more, or if the plan was too large to be kept.
    pub(crate) fn new(asked: Asked, model: &Model, now: Time) -> Option<Self> {
        let (live, plan) = asked.find(model)?;
        let mut changes: Vec<PastChange> = model.history(&live.id).cloned().collect();
        changes.sort_by_key(|change| change.at);
        let end = live.end.as_ref().map_or(now, |end| end.at);
        let known = changes.first().map(|change| change.at).into_iter();
        let known = known.chain(live.processes.values().map(|process| process.since.at)).min().unwrap_or(end);
        // Where the oldest changes have left, the picture would show too little.
        let known = known.max(model.history_left());
        let zero = live.began.unwrap_or(known);
        let last = asked.more.map_or(Time::ZERO, |seconds| end.before(Duration::from_secs(seconds.into())));
        let begin = known.max(zero).max(last);
        Some(Self { plan, changes, running: running(live), zero, is_since_go: live.began.is_some(), begin, end })
    }
}

fn running(live: &LiveDeployment) -> BTreeMap<String, bool> {
    live.processes.iter().map(|(path, process)| (path.clone(), process.health() == Health::Running)).collect()
}

/// Returns the timeline as JSON, or the reason why there is none. It may take a while: the caller holds no lock.
pub(crate) fn timeline(past: Option<&Past>) -> Value {
    let Some(past) = past else {
        return json!({ "why": "the mission is too large for a timeline, or it is no longer shown" });
    };
    let since = |at: Time| at.since(past.zero);
    let changes = past.changes.iter();
    let changes = changes.map(|one| LaneChange { path: &one.path, at: since(one.at), change: &one.change });
    let (mut lanes, hidden) = lanes(&past.plan, changes);
    for lane in &mut lanes {
        lane.begins = match (lane.changes.first(), past.running.get(&lane.path)) {
            (Some((_, first)), _) => State::before(first, lane.leaf),
            (None, Some(true)) => State::Running,
            (None, Some(false)) if lane.leaf => State::Idle,
            (None, Some(false) | None) => State::Absent,
        };
    }
    let (begin, end) = (since(past.begin), since(past.end));
    let svg = rows(&lanes, end, &TimeAxis::plain(begin, end));
    // A report is inside HTML, where the name of the format is understood without an address.
    let svg = svg.replacen("<svg ", "<svg xmlns=\"http://www.w3.org/2000/svg\" ", 1);
    let zero = if past.is_since_go { "seconds since GO" } else { "seconds since this view began to look" };
    let more = if hidden > 0 { format!("; not shown: {}", counted(hidden, "row")) } else { String::new() };
    json!({ "svg": svg, "note": format!("{zero}{more}") })
}
