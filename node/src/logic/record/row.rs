//! From an entry to the messages that stand for it.

use crate::logic::instance::{RESTARTS_MAX, WINDOW};
use crate::logic::protocol::{Change, Ending, FailureCause, Report};
use crate::logic::record::Entry;
use crate::logic::table::counted;
use comms::logic::signals::Signals;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::time::Duration;

/// The topic of reports.
pub const EVENTS: &str = "/events";
/// What the topic of a program's signals begins with; its path follows.
pub const SIGNALS: &str = "/signals/";

/// A channel of the record.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Topic {
    /// `/events` or `/signals/<path>`.
    pub name: String,
    /// The schema's name.
    pub schema_name: &'static str,
    /// A JSON schema of the messages.
    pub schema: Vec<u8>,
    /// For the channel: unit and headline of each signal.
    pub metadata: BTreeMap<String, String>,
}

/// A message of the record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Row {
    /// Index into [`Rows::topics`].
    pub topic: usize,
    /// Since GO.
    pub at: Duration,
    /// On the publisher's own clock; `at` for a report.
    pub stamp: u64,
    /// JSON.
    pub data: Vec<u8>,
}

/// A report with a line for people who look at the file with another tool.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Event {
    text: String,
    pub(super) report: Report,
}

/// What the metadata of a channel says of one signal.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Unit {
    /// Its place in the sample, which an object of JSON does not keep.
    pub(super) place: usize,
    pub(super) unit: String,
    pub(super) headline: bool,
}

/// Makes rows, and remembers the topics that were needed.
#[derive(Debug, Default)]
pub struct Rows {
    topics: Vec<Topic>,
    /// The topics of a program: more than one when it changes what it publishes.
    of: BTreeMap<String, Vec<usize>>,
    now: Duration,
}

impl Rows {
    /// Returns every topic so far; a topic never changes.
    pub fn topics(&self) -> &[Topic] {
        &self.topics
    }

    /// Returns the message for an entry; its topic may be a new one.
    pub fn row(&mut self, entry: &Entry) -> Row {
        match entry {
            Entry::Report(report) => self.report(report),
            Entry::Signals { path, at, sample } => {
                self.now = self.now.max(*at);
                let topic = self.topic(path, sample);
                let values = sample.values.iter().map(|signal| (signal.name.clone(), json!(signal.value)));
                let data = json(&Value::Object(values.collect()));
                Row { topic, at: *at, stamp: sample.stamp.nanos(), data }
            }
        }
    }

    fn report(&mut self, report: &Report) -> Row {
        let at = match report {
            Report::Process { at, .. } | Report::Finished { at, .. } => *at,
            Report::Accepted { .. }
            | Report::Prepared { .. }
            | Report::Connected { .. }
            | Report::Go { .. }
            | Report::Refused { .. } => self.now,
        };
        self.now = self.now.max(at);
        let topic = self.find(EVENTS, |_| true).unwrap_or_else(|| {
            let properties = json!({ "text": { "type": "string" }, "report": {} });
            let schema = json(&json!({ "type": "object", "properties": properties }));
            self.add(Topic { name: EVENTS.to_owned(), schema_name: "event", schema, metadata: BTreeMap::new() })
        });
        let data = json(&Event { text: text(report), report: report.clone() });
        Row { topic, at, stamp: u64::try_from(at.as_nanos()).unwrap_or(u64::MAX), data }
    }

    fn topic(&mut self, path: &str, sample: &Signals) -> usize {
        let name = format!("{SIGNALS}{path}");
        let fits = |topic: &Topic| {
            topic.metadata.len() == sample.values.len()
                && sample.values.iter().all(|signal| topic.metadata.contains_key(&signal.name))
        };
        self.find(&name, fits).unwrap_or_else(|| {
            let (mut properties, mut metadata) = (Map::new(), BTreeMap::new());
            for (place, signal) in sample.values.iter().enumerate() {
                let unit = Unit { place, unit: signal.unit.clone(), headline: signal.headline };
                properties.insert(signal.name.clone(), json!({ "type": "number", "description": unit.unit }));
                metadata.insert(signal.name.clone(), String::from_utf8_lossy(&json(&unit)).into_owned());
            }
            let schema = json(&json!({ "type": "object", "properties": properties }));
            self.add(Topic { name, schema_name: "signals", schema, metadata })
        })
    }

    fn find(&self, name: &str, fits: impl Fn(&Topic) -> bool) -> Option<usize> {
        self.of.get(name)?.iter().rev().copied().find(|index| fits(&self.topics[*index]))
    }

    fn add(&mut self, topic: Topic) -> usize {
        self.of.entry(topic.name.clone()).or_default().push(self.topics.len());
        self.topics.push(topic);
        self.topics.len() - 1
    }
}

/// Returns a value as JSON.
pub(super) fn json(value: &impl Serialize) -> Vec<u8> {
    serde_json::to_vec(value).expect("every type of a record has string keys and no failing serialiser")
}

/// Returns what a report says, in a line.
pub(crate) fn text(report: &Report) -> String {
    match report {
        Report::Accepted { deployment } => format!("accepted as {deployment}"),
        Report::Prepared { host, leaves } => format!("{host}: {} up", counted(*leaves, "program")),
        Report::Connected { host } => format!("{host}: linked"),
        Report::Go { took, .. } => format!("GO after {:.1} s", took.as_secs_f64()),
        Report::Process { path, change, .. } => format!("{path} {}", change_text(change)),
        Report::Refused { reasons } => format!("refused: {}", reasons.join("; ")),
        Report::Finished { ending, .. } => format!("finished: {}", ending_text(ending)),
    }
}

/// Returns what happened to a process, after its name.
pub(crate) fn change_text(change: &Change) -> String {
    match change {
        Change::Activated => "activated".to_owned(),
        Change::Stopping => "asked to stop".to_owned(),
        Change::Ended(ending) => ending_text(ending),
        Change::Died(cause) => format!("died: {cause}"),
        Change::Started { pid } => format!("started as process {pid}"),
        Change::Restarting { cause, count } => restarting_text(cause, *count),
        Change::Resumed => "activated again".to_owned(),
    }
}

/// Returns that a program is started again, in words.
pub(crate) fn restarting_text(cause: &FailureCause, count: u32) -> String {
    format!("died and is started again ({count} of {RESTARTS_MAX} in {} s): {cause}", WINDOW.as_secs())
}

/// Returns an ending in words.
pub(crate) fn ending_text(ending: &Ending) -> String {
    match ending {
        Ending::Done(_) => "done".to_owned(),
        Ending::Aborted(failure) => format!("aborted: {failure}"),
        Ending::Stopped => "stopped".to_owned(),
        Ending::Unconfirmed => "nobody could confirm that it stopped".to_owned(),
    }
}
