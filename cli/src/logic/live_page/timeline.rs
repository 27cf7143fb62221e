//! The timeline of a mission for its page, with the lanes of a report.

use crate::logic::page::axis::TimeAxis;
use crate::logic::page::lanes::{LANES_MAX, State, lanes, rows};
use comms::logic::time::Time;
use language::plan::Plan;
use node::logic::table::counted;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::str::FromStr;
use std::sync::Arc;
use std::time::Duration;
use view::{Health, LiveDeployment, Model, PastChange};

/// A timeline that a page asks for: `17` is all of the mission with plan 17, and `17-60` its last 60 s.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct AskedTimeline {
    plan: u64,
    last: Option<Duration>,
}

impl FromStr for AskedTimeline {
    type Err = ();

    fn from_str(text: &str) -> Result<Self, ()> {
        let (plan, last) = text.split_once('-').map_or((text, None), |(plan, last)| (plan, Some(last)));
        let last: Option<u32> = last.map(|text| text.parse().map_err(|_not_a_number| ())).transpose()?;
        Ok(Self {
            plan: plan.parse().map_err(|_not_a_number| ())?,
            last: last.map(|last| Duration::from_secs(last.into())),
        })
    }
}

/// The parts of a timeline, copied from the model so that it can be drawn without it.
#[derive(Debug)]
pub(crate) struct Past {
    plan: Arc<Plan>,
    changes: Vec<PastChange>,
    /// The processes that run, by path: where no change tells more, they have always run.
    running: BTreeMap<String, bool>,
    /// When the times of the picture begin to count.
    zero: Time,
    is_since_go: bool,
    begin: Time,
    end: Time,
}

impl AskedTimeline {
    /// Returns the parts of the timeline. None if the model has no such plan any more, or if the plan was too large to be kept.
    pub(crate) fn past(self, model: &Model, now: Time) -> Option<Past> {
        let live = model.planned(self.plan)?;
        let plan = live.plan.as_ref()?.plan.clone()?;
        let mut changes: Vec<PastChange> = model.history(&live.id).cloned().collect();
        changes.sort_by_key(|change| change.at);
        let end = live.end.as_ref().map_or(now, |end| end.at);
        let known = changes.first().map(|change| change.at).into_iter();
        let known = known.chain(live.processes.values().map(|process| process.since.at)).min().unwrap_or(end);
        // Where the oldest changes have left, the picture would show too little.
        let known = if model.history_left() > known { model.history_left() } else { known };
        let zero = live.began.unwrap_or(known);
        let last = self.last.map_or(Time::ZERO, |last| {
            Time::from_nanos(end.nanos().saturating_sub(u64::try_from(last.as_nanos()).unwrap_or(u64::MAX)))
        });
        let begin = known.max(zero).max(last);
        Some(Past { plan, changes, running: running(live), zero, is_since_go: live.began.is_some(), begin, end })
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
    let mut lanes = lanes(&past.plan);
    let hidden = lanes.len().saturating_sub(LANES_MAX);
    lanes.truncate(LANES_MAX);
    let mut by_path: BTreeMap<&str, Vec<&PastChange>> = BTreeMap::new();
    for change in &past.changes {
        by_path.entry(&change.path).or_default().push(change);
    }
    for lane in &mut lanes {
        let changes = by_path.remove(lane.path.as_str()).unwrap_or_default();
        lane.begins = match (changes.first(), past.running.get(&lane.path)) {
            (Some(first), _) => State::before(&first.change, lane.leaf),
            (None, Some(true)) => State::Running,
            (None, Some(false)) if lane.leaf => State::Idle,
            (None, Some(false) | None) => State::Absent,
        };
        lane.changes = changes.into_iter().map(|one| (since(one.at), &one.change)).collect();
    }
    let (begin, end) = (since(past.begin), since(past.end));
    let svg = rows(&lanes, end, &TimeAxis::plain(begin, end));
    // A report stands in HTML, where the name of the format is understood without an address.
    let svg = svg.replacen("<svg ", "<svg xmlns=\"http://www.w3.org/2000/svg\" ", 1);
    let zero = if past.is_since_go { "seconds since GO" } else { "seconds since this view began to look" };
    let more = if hidden > 0 { format!("; not shown: {}", counted(hidden, "row")) } else { String::new() };
    json!({ "svg": svg, "note": format!("{zero}{more}") })
}
