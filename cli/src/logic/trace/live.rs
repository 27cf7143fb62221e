//! Traces of missions that run, from the events of their homes.
//!
//! A span is given out once it has ended, and is then forgotten, so that a mission that runs for weeks needs no more memory than one of
//! a minute. Processes that ended before the view began are left out.

use super::{SpanEnd, Spans, Trace, trace_id};
use node::logic::protocol::{Change, Event, Report};
use serde_json::Value;
use std::collections::BTreeMap;
use std::time::Duration;
use view::MissionId;

/// The most missions that are followed. Beyond it, the mission that was silent for longest is forgotten.
const MISSIONS_MAX: usize = 256;

/// The missions that are followed.
#[derive(Debug, Default)]
pub(crate) struct Traces {
    missions: BTreeMap<MissionId, Mission>,
}

#[derive(Debug)]
struct Mission {
    trace: Trace,
    spans: Spans,
}

/// Spans as one request, and how many they are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Batch {
    pub(crate) request: String,
    pub(crate) spans: usize,
}

impl Traces {
    /// Takes an event. If it is `of_the_past`, the spans that it ends are not given out.
    pub(crate) fn take(&mut self, id: &MissionId, event: &Event, of_the_past: bool) {
        let at = event.time;
        if !self.missions.contains_key(id) {
            if !begins(&event.report) {
                return;
            }
            self.make_room();
            self.missions.insert(id.clone(), Mission::new(id, at));
        }
        let Some(mission) = self.missions.get_mut(id) else { return };
        mission.take(event, at);
        if of_the_past {
            mission.spans.all.retain(|_, span| span.end.is_none());
            self.missions.retain(|_, mission| !mission.spans.active.is_empty());
        }
    }

    /// Returns the spans that have ended since the last call, as requests.
    pub(crate) fn ended(&mut self) -> Vec<Batch> {
        let batches = self.missions.values_mut().flat_map(Mission::ended).collect();
        self.missions.retain(|_, mission| !mission.spans.active.is_empty());
        batches
    }

    fn make_room(&mut self) {
        while self.missions.len() >= MISSIONS_MAX {
            let silent = self.missions.iter().min_by_key(|(_, mission)| mission.spans.now);
            let Some(silent) = silent.map(|(id, _)| id.clone()) else { return };
            self.missions.remove(&silent);
        }
    }
}

impl Mission {
    fn new(id: &MissionId, at: Duration) -> Self {
        let deployment = id.deployment.to_string();
        let trace = Trace { id: trace_id(&id.key(), at), deployment, file: None, go: Duration::ZERO };
        let mut spans = Spans::default();
        spans.begin("", Some(&id.home), at);
        Self { trace, spans }
    }

    fn take(&mut self, event: &Event, at: Duration) {
        if let Report::Process { path, change, .. } = &event.report {
            self.spans.change(path, Some(&event.host), change, at);
        } else if let Report::Finished { ending, .. } = &event.report {
            self.finish(SpanEnd::of(ending), at);
        } else if let Report::Refused { reasons } = &event.report {
            self.finish(SpanEnd { text: reasons.join("; "), is_failure: true, origin: None }, at);
        }
    }

    /// The mission ends, and so do all processes that are still active.
    fn finish(&mut self, end: SpanEnd, at: Duration) {
        self.spans.close("", end, at);
        for place in std::mem::take(&mut self.spans.active).into_values() {
            if let Some(span) = self.spans.all.get_mut(&place) {
                span.end = Some(at);
            }
        }
    }

    fn ended(&mut self) -> Vec<Batch> {
        let ended: Vec<_> = self.spans.all.extract_if(.., |_, span| span.end.is_some()).map(|(_, span)| span).collect();
        let shown: Vec<Value> = ended.iter().map(|span| self.trace.span(span, &self.spans)).collect();
        let chunks = shown.chunks(super::SPANS_MAX);
        chunks.map(|spans| Batch { request: self.trace.line(spans), spans: spans.len() }).collect()
    }
}

/// Returns whether a mission may be known from this report on. The reports after its end are about no mission.
fn begins(report: &Report) -> bool {
    matches!(report, Report::Accepted { .. } | Report::Go { .. } | Report::Process { change: Change::Activated, .. })
}

#[cfg(test)]
mod tests {
    use super::*;
    use node::logic::protocol::{Deployment, Ending};
    use view::Fleet;

    fn event(number: u64, report: Report) -> Event {
        let deployment = Deployment { name: "walk".to_owned(), epoch: 1 };
        let time = Duration::from_secs(1_000 + number);
        Event { deployment, number, host: "c1".to_owned(), ago: Duration::ZERO, report, time }
    }

    fn process(number: u64, path: &str, change: Change) -> Event {
        event(number, Report::Process { path: path.to_owned(), change, at: Duration::from_secs(number) })
    }

    fn done() -> Ending {
        Ending::Done(Vec::new())
    }

    fn finished(number: u64) -> Event {
        event(number, Report::Finished { ending: done(), at: Duration::from_secs(number), unconfirmed: Vec::new() })
    }

    fn id(home: &str) -> MissionId {
        let deployment = Deployment { name: "walk".to_owned(), epoch: 1 };
        MissionId { deployment, home: home.to_owned(), fleet: Fleet::Standing }
    }

    fn names(batches: &[Batch]) -> Vec<String> {
        let read = |batch: &Batch| serde_json::from_str::<Value>(&batch.request).expect("a request is JSON");
        let spans = |line: Value| line["resourceSpans"][0]["scopeSpans"][0]["spans"].as_array().cloned();
        let name = |span: Value| span["name"].as_str().unwrap_or_default().to_owned();
        batches.iter().map(read).filter_map(spans).flatten().map(name).collect()
    }

    /// A mission that begins the same process again and again keeps only what is active.
    #[test]
    fn what_has_ended_is_given_out_and_forgotten() {
        let (mut traces, id) = (Traces::default(), id("c1"));
        traces.take(&id, &process(0, "main", Change::Activated), false);
        for round in 0..1_000 {
            traces.take(&id, &process(2 * round, "main/look", Change::Activated), false);
            assert!(traces.ended().is_empty());
            traces.take(&id, &process(2 * round + 1, "main/look", Change::Ended(done())), false);
            assert_eq!(names(&traces.ended()), ["look"]);
            assert_eq!(traces.missions[&id].spans.all.len(), 2);
        }
        traces.take(&id, &process(2_000, "main", Change::Ended(done())), false);
        traces.take(&id, &finished(2_001), false);
        assert_eq!(names(&traces.ended()), ["walk@1", "main"]);
        assert!(traces.missions.is_empty());
        traces.take(&id, &process(2_002, "main/look", Change::Ended(done())), false);
        assert!(traces.ended().is_empty() && traces.missions.is_empty(), "a late word begins no mission");
    }

    /// A view that begins in the middle of a mission gives out the processes that end later, with their true begin.
    #[test]
    fn the_past_is_not_given_out() {
        let (mut traces, id) = (Traces::default(), id("c1"));
        traces.take(&id, &process(0, "main", Change::Activated), true);
        traces.take(&id, &process(1, "main/look", Change::Activated), true);
        traces.take(&id, &process(2, "main/look", Change::Ended(done())), true);
        traces.take(&id, &process(3, "main/dock", Change::Activated), true);
        traces.take(&id, &process(9, "main/dock", Change::Ended(done())), false);
        let ended = traces.ended();
        assert_eq!(names(&ended), ["dock"]);
        assert!(ended[0].request.contains("\"startTimeUnixNano\":\"1003000000000\""), "{ended:?}");
        traces.take(&id, &finished(10), true);
        assert!(traces.missions.is_empty(), "the mission is over");
    }

    #[test]
    fn the_mission_that_was_silent_for_longest_makes_room() {
        let mut traces = Traces::default();
        for number in 0..=MISSIONS_MAX {
            let at = if number == 7 { 0 } else { number as u64 + 1 };
            traces.take(&id(&format!("c{number}")), &process(at, "main", Change::Activated), false);
        }
        assert_eq!((traces.missions.len(), traces.missions.contains_key(&id("c7"))), (MISSIONS_MAX, false));
    }
}
