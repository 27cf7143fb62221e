//! Missions as traces of OpenTelemetry: the mission and each activation of a process are spans. A trace is made from a
//! record, or while the mission runs.
//!
//! The form is the same as in the OTLP file exporter: each line is one `ExportTraceServiceRequest` in JSON. Collectors read
//! such lines from a file, or as a POST to `/v1/traces`. The same record always gives the same bytes.
//! Source: OpenTelemetry Protocol 1.5, JSON Protobuf Encoding; OTLP File Exporter.

use crate::logic::record::{Entry, Run};
use language::plan::Plan;
use node::logic::protocol::{Change, Ending, Report};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::time::Duration;
use view::sentence::{change_text, ending_text};

pub(crate) mod live;

/// The most spans in one line. Collectors accept 4 MiB at a time, and a span has about 1 KiB.
const SPANS_MAX: usize = 1_000;
/// The most events of one span. The record contains all of them.
const EVENTS_MAX: usize = 128;
/// The kind of a span that is neither a request nor a response.
const INTERNAL: u8 = 1;
const STATUS_OK: u8 = 1;
const STATUS_ERROR: u8 = 2;

/// One activation of a process, or the mission.
#[derive(Debug)]
struct Span {
    /// Its place in the trace, counted from 0: the mission.
    place: usize,
    path: String,
    host: Option<String>,
    parent: Option<usize>,
    begin: Duration,
    end: Option<Duration>,
    /// How the span ended, in words. For a failure, also the process where it began.
    outcome: Option<SpanEnd>,
    events: Vec<(Duration, String)>,
    events_dropped: usize,
}

#[derive(Debug)]
struct SpanEnd {
    text: String,
    is_failure: bool,
    origin: Option<String>,
}

impl SpanEnd {
    fn of(ending: &Ending) -> Self {
        let (is_failure, origin) = match ending {
            Ending::Aborted(failure) => (true, Some(failure.origin.clone())),
            Ending::Unconfirmed => (true, None),
            Ending::Done(_) | Ending::Stopped => (false, None),
        };
        Self { text: ending_text(ending), is_failure, origin }
    }
}

/// The spans of a mission.
#[derive(Debug, Default)]
struct Spans {
    /// The spans by their places, in the order of their beginnings.
    all: BTreeMap<usize, Span>,
    /// The number of spans that have begun.
    begun: usize,
    /// The span of each process that is active now.
    active: BTreeMap<String, usize>,
    /// The latest span of each process. A failure refers to the span of the process where it began.
    latest: BTreeMap<String, usize>,
    now: Duration,
}

impl Spans {
    fn of(run: &Run) -> Self {
        let mut spans = Self::default();
        let hosts = hosts(&run.header.plan);
        spans.begin("", None, Duration::ZERO);
        for entry in &run.entries {
            match entry {
                Entry::Report(Report::Process { path, change, at }) => {
                    spans.change(path, hosts.get(path.as_str()).copied(), change, *at);
                }
                Entry::Report(Report::Finished { ending, at, .. }) => spans.end("", ending, *at),
                Entry::Report(_) => {}
                Entry::Signals { at, .. }
                | Entry::Output { at, .. }
                | Entry::Port { at, .. }
                | Entry::Missing { at, .. } => {
                    spans.now = spans.now.max(*at);
                }
            }
        }
        spans
    }

    fn begin(&mut self, path: &str, host: Option<&str>, at: Duration) {
        // `main` belongs to the span of the mission, and each other process to the span of its group.
        let around = path.rsplit_once('/').map_or("", |(around, _)| around);
        let place = self.begun;
        let span = Span {
            place,
            path: path.to_owned(),
            host: host.map(str::to_owned),
            parent: (!path.is_empty()).then(|| self.active.get(around).copied().unwrap_or_default()),
            begin: at,
            end: None,
            outcome: None,
            events: Vec::new(),
            events_dropped: 0,
        };
        self.begun += 1;
        self.all.insert(place, span);
        self.active.insert(path.to_owned(), place);
        self.latest.insert(path.to_owned(), place);
        self.now = self.now.max(at);
    }

    fn end(&mut self, path: &str, ending: &Ending, at: Duration) {
        self.close(path, SpanEnd::of(ending), at);
    }

    fn close(&mut self, path: &str, end: SpanEnd, at: Duration) {
        self.now = self.now.max(at);
        let Some(span) = self.active.remove(path).and_then(|place| self.all.get_mut(&place)) else { return };
        span.end = Some(at);
        span.outcome = Some(end);
    }

    fn change(&mut self, path: &str, host: Option<&str>, change: &Change, at: Duration) {
        if let Change::Activated = change {
            self.begin(path, host, at);
        } else if let Change::Ended(ending) = change {
            self.end(path, ending, at);
        } else {
            self.event(path, change, at);
        }
    }

    /// Adds an event to the span of the process. If the process is not active, adds it to the span of the mission.
    fn event(&mut self, path: &str, change: &Change, at: Duration) {
        self.now = self.now.max(at);
        let place = self.active.get(path).copied();
        let text = if place.is_some() { change_text(change) } else { format!("{path} {}", change_text(change)) };
        let Some(span) = self.all.get_mut(&place.unwrap_or_default()) else { return };
        if span.events.len() < EVENTS_MAX {
            span.events.push((at, text));
        } else {
            span.events_dropped += 1;
        }
    }
}

/// Returns the lines of a record's trace. The name of the deployment becomes the name of the
/// service. Times are measured from `go`, which is a time since 1970.
pub(crate) fn lines(run: &Run, go: Duration) -> Vec<String> {
    let accepted = |entry: &Entry| {
        if let Entry::Report(Report::Accepted { deployment }) = entry { Some(deployment.to_string()) } else { None }
    };
    let deployment = run.entries.iter().find_map(accepted).unwrap_or_else(|| run.header.plan.name.clone());
    let spans = Spans::of(run);
    let trace = Trace { id: trace_id(&deployment, go), deployment, file: Some(run.header.file.clone()), go };
    let all: Vec<Value> = spans.all.values().map(|span| trace.span(span, &spans)).collect();
    all.chunks(SPANS_MAX).map(|spans| trace.line(spans)).collect()
}

/// The parts that all spans of a trace have in common.
#[derive(Debug)]
struct Trace {
    id: String,
    deployment: String,
    /// The file of the spec, if it is known.
    file: Option<String>,
    /// The time since 1970 from which the times of the spans are counted.
    go: Duration,
}

impl Trace {
    /// Returns the request that contains these spans.
    fn line(&self, spans: &[Value]) -> String {
        let mut attributes = vec![text("service.name", &self.deployment)];
        attributes.extend(self.file.as_ref().map(|file| text("dca.spec", file)));
        let resource = json!({ "attributes": attributes });
        let scope = json!({ "name": "dca", "version": env!("CARGO_PKG_VERSION") });
        let of_scope = json!([{ "scope": scope, "spans": spans }]);
        json!({ "resourceSpans": [{ "resource": resource, "scopeSpans": of_scope }] }).to_string()
    }

    fn span(&self, span: &Span, spans: &Spans) -> Value {
        let is_mission = span.place == 0;
        let name = if is_mission { &self.deployment } else { span.path.rsplit('/').next().unwrap_or(&span.path) };
        let mut attributes = vec![text("dca.path", &span.path)];
        attributes.extend(span.host.as_ref().map(|host| text("dca.host", host)));
        attributes.extend(span.outcome.as_ref().map(|outcome| text("dca.outcome", &outcome.text)));
        if span.end.is_none() {
            attributes.push(json!({ "key": "dca.unfinished", "value": { "boolValue": true } }));
        }
        let event = |(at, text): &(Duration, String)| json!({ "timeUnixNano": self.time(*at), "name": text });
        let mut shown = json!({
            "traceId": self.id,
            "spanId": span_id(span.place),
            "name": name,
            "kind": INTERNAL,
            "startTimeUnixNano": self.time(span.begin),
            "endTimeUnixNano": self.time(span.end.unwrap_or(spans.now)),
            "attributes": attributes,
            "events": span.events.iter().map(event).collect::<Vec<_>>(),
            "droppedEventsCount": span.events_dropped,
            "links": self.links(span, spans),
            "status": status(span.outcome.as_ref()),
        });
        if let Some(parent) = span.parent {
            shown["parentSpanId"] = span_id(parent).into();
        }
        shown
    }

    /// Links a failure to the activation where it began.
    fn links(&self, span: &Span, spans: &Spans) -> Vec<Value> {
        let origin = span.outcome.as_ref().and_then(|outcome| outcome.origin.as_deref());
        let origin = origin.and_then(|path| spans.latest.get(path)).filter(|origin| **origin != span.place);
        let link = |origin: &usize| {
            let attributes = [text("dca.link", "origin of the failure")];
            json!({ "traceId": self.id, "spanId": span_id(*origin), "attributes": attributes })
        };
        origin.map(link).into_iter().collect()
    }

    /// Converts a time since GO to nanoseconds since 1970. In JSON, 64-bit numbers are texts.
    fn time(&self, at: Duration) -> String {
        self.go.saturating_add(at).as_nanos().to_string()
    }
}

fn status(outcome: Option<&SpanEnd>) -> Value {
    match outcome {
        None => json!({}),
        Some(SpanEnd { is_failure: false, .. }) => json!({ "code": STATUS_OK }),
        Some(outcome) => json!({ "code": STATUS_ERROR, "message": outcome.text }),
    }
}

fn text(key: &str, value: &str) -> Value {
    json!({ "key": key, "value": { "stringValue": value } })
}

/// Returns the host of each process.
fn hosts(plan: &Plan) -> BTreeMap<&str, &str> {
    let leaves = plan.leaves.iter().map(|leaf| (leaf.path.as_str(), leaf.host));
    let all = leaves.chain(plan.groups.iter().map(|group| (group.path.as_str(), group.host)));
    all.filter_map(|(path, host)| Some((path, plan.hosts.get(host as usize)?.as_str()))).collect()
}

/// Returns the id of a trace. Two runs have different ids, because their times of GO or their names differ.
fn trace_id(deployment: &str, go: Duration) -> String {
    let mut hasher = blake3::Hasher::new_derive_key("dca trace id 1");
    hasher.update(&go.as_nanos().to_le_bytes()).update(deployment.as_bytes());
    hasher.finalize().to_hex()[..32].to_owned()
}

/// Returns the id of a span. The id 0 is not allowed.
fn span_id(place: usize) -> String {
    format!("{:016x}", place + 1)
}

#[cfg(test)]
mod tests;
