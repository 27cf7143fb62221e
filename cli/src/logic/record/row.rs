//! Turns an entry of a record into messages.

use crate::logic::record::{Entry, MissingValues, WireName, message, schema};
use crate::logic::ros;
use ::ros::logic::cdr;
use ::ros::logic::schema::Schema;
use comms::logic::layout::{Layout, Message};
use comms::logic::signals::Signals;
use node::logic::protocol::{Change, Ending, Report};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use view::sentence::report_text;

/// The topic for reports.
pub const EVENTS: &str = "/events";
/// The topic for the output of programs.
pub const LOG: &str = "/log";
/// The topic for counts of values that are not in the record.
pub const MISSING: &str = "/missing";
/// The beginning of a topic for the signals of a program. The path of the program follows, in plain names.
pub const SIGNALS: &str = "/signals/";
/// The beginning of a topic for the values of a wire. The path of the output follows, in plain names.
pub const PORTS: &str = "/ports/";
/// The metadata key for the exact path of the program, or of the output of a wire.
pub(super) const PATH: &str = "dca.path";
/// The metadata key for the path of the input of a wire.
pub(super) const TO: &str = "dca.to";

/// A channel of the record.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Topic {
    /// `/events`, `/log`, `/missing`, `/signals/<path>` or `/ports/<path>/<port>`.
    pub name: String,
    /// The form of the messages.
    pub form: Form,
    /// The name of the schema. Each schema has its own name.
    pub schema_name: String,
    /// The schema of the messages.
    pub schema: Vec<u8>,
    /// The metadata of the channel: the path of the program; name, unit and headline of each signal.
    pub metadata: BTreeMap<String, String>,
}

/// The form of the messages of a channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Form {
    /// JSON, with a JSON schema.
    Json,
    /// CDR, with the definitions of ROS 2.
    Ros,
}

impl Form {
    /// Returns the encoding of the messages and the encoding of their schema, with their names in the registry of MCAP.
    pub fn encodings(self) -> (&'static str, &'static str) {
        match self {
            Self::Json => ("json", "jsonschema"),
            Self::Ros => ("cdr", "ros2msg"),
        }
    }
}

/// The output and the input of a wire, each with the path of its program.
#[derive(Clone, Copy, Debug)]
struct Ends<'a> {
    from: &'a str,
    to: &'a str,
}

/// The schema of the messages of a topic.
#[derive(Debug)]
struct Described {
    form: Form,
    /// The name of the schema.
    name: String,
    text: Vec<u8>,
}

impl Described {
    fn json(name: &str, schema: &Value) -> Self {
        Self { form: Form::Json, name: name.to_owned(), text: json(schema) }
    }

    fn ros(schema: &Schema) -> Self {
        Self { form: Form::Ros, name: schema.name().to_string(), text: schema.text().into_bytes() }
    }
}

/// A message of the record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Row {
    /// Index into [`Rows::topics`].
    pub topic: usize,
    /// The time since 1970.
    pub at: Duration,
    /// The data, in the form of its topic.
    pub data: Vec<u8>,
}

/// A report in the form for other tools.
#[derive(Debug, Serialize)]
struct Event {
    since_go: f64,
    kind: &'static str,
    process: String,
    host: String,
    text: String,
    output: String,
    report: String,
}

/// The metadata of a channel about one signal.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Unit {
    /// The position of the signal in the sample. A JSON object does not keep the order.
    pub(super) place: usize,
    pub(super) unit: String,
    pub(super) headline: bool,
    /// The name of the signal. The name of its field contains only letters, digits and `_`.
    pub(super) name: String,
}

/// Makes rows, and remembers the topics that they use.
#[derive(Debug, Default)]
pub struct Rows {
    topics: Vec<Topic>,
    /// The topics of each program. A program has several if it changes its signals.
    of: BTreeMap<String, Vec<usize>>,
    /// The schemas of the ROS 2 types that were used so far. A type outside the standard library has no schema.
    ros: BTreeMap<String, Option<Arc<Schema>>>,
    /// When GO was given, since 1970; nothing before GO.
    go: Option<Duration>,
    now: Duration,
}

impl Rows {
    /// Returns all topics that were used so far. A topic never changes.
    pub fn topics(&self) -> &[Topic] {
        &self.topics
    }

    /// Returns the message for an entry that arrived at `arrived`, since 1970. Its topic may be a new one.
    pub fn row(&mut self, entry: &Entry, arrived: Duration) -> Row {
        match entry {
            Entry::Report(report) => self.report(report, arrived),
            Entry::Signals { path, at, sample } => {
                let at = self.since_1970(*at, arrived);
                let topic = self.topic(path, sample);
                let data = json(&Value::Object(fields(&self.topics[topic], sample)));
                Row { topic, at, data }
            }
            Entry::Port { from, to, at, bytes, message } => {
                let at = self.since_1970(*at, arrived);
                let (ends, message) = (Ends { from, to }, message.as_deref());
                if let Some(row) = message.and_then(|message| self.ros_row(ends, at, message, bytes)) {
                    return row;
                }
                let read = message.and_then(|known| Some((known, message::decode(known, bytes)?)));
                let topic = match &read {
                    None => self.port(ends, "bytes", |_| Described::json("dca.Encoded", &schema::port())),
                    Some((known, _)) => self.port(ends, &known.name, |topics| schema_of(topics, known)),
                };
                let raw = || json!({ "size": bytes.len(), "bytes": base64(bytes) });
                Row { topic, at, data: json(&read.map_or_else(raw, |(_, value)| value)) }
            }
            Entry::Output { path, at, text } => {
                let at = self.since_1970(*at, arrived);
                let topic = self.single(LOG, "foxglove.Log", schema::log);
                let timestamp = json!({ "sec": at.as_secs(), "nsec": at.subsec_nanos() });
                let log = json!({
                    "timestamp": timestamp, "level": 0, "message": text, "name": path, "file": "", "line": 0,
                });
                Row { topic, at, data: json(&log) }
            }
            Entry::Missing { wire: WireName { from, to }, at, count: MissingValues { early, lost, breaks } } => {
                let at = self.since_1970(*at, arrived);
                let topic = self.single(MISSING, "dca.Missing", schema::missing);
                let missing = json!({ "output": from, "input": to, "early": early, "lost": lost, "breaks": breaks });
                Row { topic, at, data: json(&missing) }
            }
        }
    }

    /// Returns the topic for an output with messages of this type, before the output has sent any value. `from` is the
    /// path of the output.
    pub(crate) fn declare(&mut self, from: &str, message: Option<&Message>) -> usize {
        let ends = Ends { from, to: "" };
        match message {
            None => self.port(ends, "bytes", |_| Described::json("dca.Encoded", &schema::port())),
            Some(known) => match self.ros_topic(ends, known) {
                Some(topic) => topic,
                None => self.port(ends, &known.name, |topics| schema_of(topics, known)),
            },
        }
    }

    /// Returns whether a topic for this sample of the program exists.
    pub(crate) fn knows(&self, path: &str, sample: &Signals) -> bool {
        self.topic_of(path, sample).is_some()
    }

    /// Returns the topic for messages of ROS 2; nothing for other messages.
    fn ros_topic(&mut self, ends: Ends<'_>, message: &Message) -> Option<usize> {
        let Layout::Piece { of } = &message.layout else { return None };
        let schema = self.ros_schema(of)?;
        Some(self.port(ends, of, |_| Described::ros(&schema)))
    }

    /// Returns the schema of a standard type of ROS 2: `ros.sensor.LaserScan`.
    fn ros_schema(&mut self, of: &str) -> Option<Arc<Schema>> {
        if !self.ros.contains_key(of) {
            self.ros.insert(of.to_owned(), ros::schema(of).map(Arc::new));
        }
        self.ros.get(of)?.clone()
    }

    /// Returns the row for a message of ROS 2; nothing for other messages, or if the bytes are damaged.
    fn ros_row(&mut self, ends: Ends<'_>, at: Duration, message: &Message, bytes: &[u8]) -> Option<Row> {
        let (of, data) = message::cdr(message, bytes)?;
        let schema = self.ros_schema(of)?;
        cdr::read(&schema, data).ok()?;
        let topic = self.port(ends, of, |_| Described::ros(&schema));
        Some(Row { topic, at, data: data.to_vec() })
    }

    /// Converts a time since GO to a time since 1970.
    fn since_1970(&mut self, at: Duration, arrived: Duration) -> Duration {
        self.now = self.now.max(at);
        self.go.map_or(arrived, |go| go + at)
    }

    fn report(&mut self, report: &Report, arrived: Duration) -> Row {
        let since_go = match report {
            Report::Process { at, .. } | Report::Stepped { at, .. } | Report::Finished { at, .. } => *at,
            Report::Go { .. } => {
                self.go = Some(arrived);
                Duration::ZERO
            }
            Report::Accepted { .. }
            | Report::Prepared { .. }
            | Report::Connected { .. }
            | Report::Programs { .. }
            | Report::Changed { .. }
            | Report::Unchanged { .. }
            | Report::Replanned { .. }
            | Report::Aligned { .. }
            | Report::BeganLate { .. }
            | Report::Omitted { .. }
            | Report::Refused { .. } => self.now,
        };
        let at = self.since_1970(since_go, arrived);
        let topic = self.single(EVENTS, "dca.Event", schema::event);
        let (process, host) = match report {
            Report::Process { path, .. } | Report::Stepped { path, .. } => (path.as_str(), ""),
            Report::Prepared { host, .. } | Report::Connected { host } | Report::BeganLate { host, .. } => {
                ("", host.as_str())
            }
            Report::Accepted { .. }
            | Report::Go { .. }
            | Report::Refused { .. }
            | Report::Finished { .. }
            | Report::Programs { .. }
            | Report::Changed { .. }
            | Report::Unchanged { .. }
            | Report::Replanned { .. }
            | Report::Aligned { .. }
            | Report::Omitted { .. } => ("", ""),
        };
        let event = Event {
            since_go: since_go.as_secs_f64(),
            kind: kind(report),
            process: process.to_owned(),
            host: host.to_owned(),
            text: report_text(report),
            output: output(report).join("\n"),
            report: String::from_utf8_lossy(&json(report)).into_owned(),
        };
        Row { topic, at, data: json(&event) }
    }

    /// Returns the topic that has all signals of a sample.
    fn topic_of(&self, path: &str, sample: &Signals) -> Option<usize> {
        let fits = |index: &&usize| {
            let known = fields_of(&self.topics[**index]);
            // A sample of a peak has only one signal.
            sample.values.iter().all(|signal| known.contains_key(&signal.name))
        };
        self.of.get(path).and_then(|topics| topics.iter().rev().find(fits)).copied()
    }

    fn topic(&mut self, path: &str, sample: &Signals) -> usize {
        if let Some(known) = self.topic_of(path, sample) {
            return known;
        }
        let is_taken = |name: &str| self.topics.iter().any(|topic| topic.name == name);
        let name = schema::free_name(format!("{SIGNALS}{}", schema::plain_path(path)), is_taken);
        let mut metadata = BTreeMap::from([(PATH.to_owned(), path.to_owned())]);
        for (place, signal) in sample.values.iter().enumerate() {
            let is_taken = |field: &str| field == schema::STAMP || metadata.contains_key(field);
            let field = schema::free_name(schema::plain_name(&signal.name), is_taken);
            let (name, unit) = (signal.name.clone(), signal.unit.clone());
            let unit = Unit { place, unit, headline: signal.headline, name };
            metadata.insert(field, String::from_utf8_lossy(&json(&unit)).into_owned());
        }
        let schema_name = format!("dca.{}", name.trim_start_matches('/').replace('/', "."));
        let units = sample.values.iter().map(|signal| (signal.name.as_str(), signal.unit.as_str()));
        let units: BTreeMap<&str, &str> = units.collect();
        let topic = Topic { name, form: Form::Json, schema_name, schema: Vec::new(), metadata };
        let fields = fields_of(&topic);
        let fields = fields.iter().map(|(name, field)| (*field, units.get(name.as_str()).copied().unwrap_or("")));
        let schema = json(&schema::signals(&topic.schema_name, fields));
        let index = self.topics.len();
        self.of.entry(path.to_owned()).or_default().push(index);
        self.topics.push(Topic { schema, ..topic });
        index
    }

    /// Returns the topic of a wire for messages of a type. If the topic is new, `schema` describes its messages.
    fn port(&mut self, ends: Ends<'_>, of: &str, schema: impl FnOnce(&[Topic]) -> Described) -> usize {
        let Ends { from, to } = ends;
        let wire = format!("{from} -> {to}: {of}");
        if let Some([known]) = self.of.get(&wire).map(Vec::as_slice) {
            return *known;
        }
        let is_taken = |name: &str| self.topics.iter().any(|topic| topic.name == name);
        let name = schema::free_name(format!("{PORTS}{}", schema::plain_path(from)), is_taken);
        let metadata = BTreeMap::from([(PATH.to_owned(), from.to_owned()), (TO.to_owned(), to.to_owned())]);
        let Described { form, name: schema_name, text: schema } = schema(&self.topics);
        self.of.insert(wire, vec![self.topics.len()]);
        self.topics.push(Topic { name, form, schema_name, schema, metadata });
        self.topics.len() - 1
    }

    /// Returns the topic of this name, of which there is only one.
    fn single(&mut self, name: &str, schema_name: &str, schema: impl Fn() -> Value) -> usize {
        self.topics.iter().position(|topic| topic.name == name).unwrap_or_else(|| {
            let (name, schema_name) = (name.to_owned(), schema_name.to_owned());
            let (form, schema) = (Form::Json, json(&schema()));
            self.topics.push(Topic { name, form, schema_name, schema, metadata: BTreeMap::new() });
            self.topics.len() - 1
        })
    }
}

/// Returns the schema of a message. If two different messages have the same name, their schemas get different names.
fn schema_of(topics: &[Topic], message: &Message) -> Described {
    let name = format!("dca.types.{}", schema::plain_name(&message.name));
    let schema_as = |name: &str| json(&message::schema(name, message));
    let is_another =
        |name: &str| topics.iter().any(|topic| topic.schema_name == name && topic.schema != schema_as(name));
    let name = schema::free_name(name, is_another);
    let text = schema_as(&name);
    Described { form: Form::Json, name, text }
}

/// Returns the fields of a topic, by the names of their signals.
fn fields_of(topic: &Topic) -> BTreeMap<String, &str> {
    let units = topic.metadata.iter().filter_map(|(field, unit)| {
        let unit: Unit = serde_json::from_str(unit).ok()?;
        Some((unit.name, field.as_str()))
    });
    units.collect()
}

/// Returns a sample as an object of numbers. Numbers that JSON cannot hold are left out.
fn fields(topic: &Topic, sample: &Signals) -> Map<String, Value> {
    let of = fields_of(topic);
    let finite = sample.values.iter().filter(|signal| signal.value.is_finite());
    let values = finite.filter_map(|signal| Some(((*of.get(&signal.name)?).to_owned(), json!(signal.value))));
    #[expect(clippy::cast_precision_loss, reason = "exact for 104 days of a machine")]
    let stamp = sample.stamp.nanos() as f64 / 1e9;
    values.chain([(schema::STAMP.to_owned(), json!(stamp))]).collect()
}

/// Returns the kind of a report, in one word.
pub(crate) fn kind(report: &Report) -> &'static str {
    let ending = |ending: &Ending| match ending {
        Ending::Done(_) => "done",
        Ending::Aborted(_) => "aborted",
        Ending::Stopped => "stopped",
        Ending::Unconfirmed => "unconfirmed",
    };
    match report {
        Report::Accepted { .. } => "accepted",
        Report::Prepared { .. } => "prepared",
        Report::Connected { .. } => "connected",
        Report::Go { .. } => "go",
        Report::Programs { .. } => "programs",
        Report::Refused { .. } => "refused",
        Report::Finished { .. } => "finished",
        Report::Changed { .. } => "changed",
        Report::Unchanged { .. } => "unchanged",
        Report::Omitted { .. } => "omitted",
        Report::Replanned { .. } => "plan",
        Report::Aligned { .. } => "aligned",
        Report::BeganLate { .. } => "began_late",
        Report::Stepped { .. } => "step",
        Report::Process { change, .. } => match change {
            Change::Activated => "activated",
            Change::Stopping => "stopping",
            Change::Ended(how) => ending(how),
            Change::Died(_) => "died",
            Change::Started { .. } => "started",
            Change::Restarting { .. } => "restarting",
            Change::Resumed => "resumed",
            Change::Held { .. } | Change::HeldBy { .. } => "held",
            Change::EndedLate => "ended_late",
            Change::Switched(_) => "switched",
            Change::Configured { .. } => "configured",
            Change::Says { .. } => "says",
            Change::Entered { .. } => "entered",
            Change::Replacing => "replacing",
            Change::Reverting { .. } => "reverting",
            Change::Renewing { .. } => "renewing",
        },
    }
}

/// Returns the last lines of the program whose failure is reported.
fn output(report: &Report) -> &[String] {
    match report {
        Report::Process { change: Change::Ended(Ending::Aborted(failure)), .. }
        | Report::Finished { ending: Ending::Aborted(failure), .. } => failure.cause.output(),
        Report::Process {
            change: Change::Died(cause) | Change::Restarting { cause, .. } | Change::Reverting { cause },
            ..
        } => cause.output(),
        Report::Process { .. }
        | Report::Finished { .. }
        | Report::Accepted { .. }
        | Report::Prepared { .. }
        | Report::Connected { .. }
        | Report::Go { .. }
        | Report::Refused { .. }
        | Report::Programs { .. }
        | Report::Changed { .. }
        | Report::Stepped { .. }
        | Report::Unchanged { .. }
        | Report::Replanned { .. }
        | Report::Aligned { .. }
        | Report::BeganLate { .. }
        | Report::Omitted { .. } => &[],
    }
}

/// Returns bytes as text. Source: RFC 4648, section 4.
pub(crate) fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let byte = |index: usize| u32::from(three.get(index).copied().unwrap_or(0));
        let bits = byte(0) << 16 | byte(1) << 8 | byte(2);
        for digit in 0..4 {
            let index = (bits >> (18 - 6 * digit) & 63) as usize;
            text.push(if digit <= three.len() { char::from(DIGITS[index]) } else { '=' });
        }
    }
    text
}

/// Returns a value as JSON.
pub(super) fn json(value: &impl Serialize) -> Vec<u8> {
    serde_json::to_vec(value).expect("every type of a record has string keys and no failing serialiser")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_text_as_the_rfc_has_it() {
        for (bytes, text) in
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foob", "Zm9vYg=="), ("\u{ff}", "w78=")]
        {
            assert_eq!(base64(bytes.as_bytes()), text);
        }
    }
}
