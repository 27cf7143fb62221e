//! The record of a run: all reports and signals in one MCAP file.
//!
//! Each message is JSON, so that any MCAP viewer shows it. Only messages of ROS 2 are CDR, with their definitions.
//! Reports are on `/events`. The samples of a program are on `/signals/<path>`, each as one object of numbers. The
//! output of programs is on `/log`. Values that are not in the record are counted on `/missing`. Times are since 1970.
//! The spec and its plan are attachments. This module converts entries to messages, and the bytes of a file back to a
//! [`Run`]; `io::recorder` has the file and the thread.
//!
//! Viewers need more than the format requires. A schema is an object whose properties have types, without `$ref`. Two
//! schemas never have the same name, and a topic has only one schema. A name that a viewer plots contains only letters,
//! digits and `_`.
//! Sources: the MCAP format specification, <https://mcap.dev/spec>, and its registry of profiles and encodings.

mod lines;
mod message;
mod missing;
mod parts;
mod ports;
mod read;
mod row;
mod schema;
mod timeline;
mod value;

pub use lines::Lines;
pub use message::Messages;
pub(crate) use message::{decode as decoded, messages};
pub(crate) use missing::Missing;
pub use missing::{MissingValues, WireName};
pub(crate) use ports::output_message;
pub use ports::{Port, ports};

pub(crate) use message::{names as field_names, schema as message_schema};
pub use read::ReadError;
pub use row::{EVENTS, Form, LOG, MISSING, PORTS, Row, Rows, SIGNALS, Topic};
pub(crate) use row::{base64, kind as report_kind};
pub(crate) use schema::{event as event_schema, free_name, log as log_schema, plain_name, plain_path};
#[cfg(test)]
pub(crate) use timeline::RecordedMessage;
pub(crate) use timeline::{RecordedTopic, Timeline};
pub use value::{RecordedValue, ValueForm};

use crate::logic::mission::Mission;
use comms::logic::layout::Message;
use comms::logic::signals::Signals;
use language::plan::Plan;
use node::logic::protocol::{Deployment, Report};
use node::logic::table::counted;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

/// Version of the layout of a record.
pub const VERSION: u16 = 1;
/// Name of the attachment with the plan.
pub const PLAN: &str = "plan.json";
/// Name of the attachment with the spec's text.
pub const SPEC: &str = "spec.dca";
/// Name of the attachment with the facts known at the start.
pub const ABOUT: &str = "about.json";

/// The header of a record: the facts known when a run starts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Header {
    /// The spec's file name.
    pub file: String,
    /// The spec as it was read.
    pub text: String,
    /// The plan of the spec.
    pub plan: Plan,
    /// Wall-clock time since 1970, if it is known.
    pub started: Option<Duration>,
}

/// The small part of a header, in its own attachment. The text and the plan are in other attachments.
#[derive(Debug, Serialize, Deserialize)]
struct About {
    version: u16,
    name: String,
    file: String,
    #[serde(default, with = "comms::logic::human::seconds_if_known")]
    started: Option<Duration>,
}

/// One thing to record.
#[derive(Clone, Debug, PartialEq)]
pub enum Entry {
    /// A report of the deployment.
    Report(Report),
    /// A sample of a program's signals.
    Signals {
        /// Absolute path of the program.
        path: String,
        /// When it came, since GO.
        at: Duration,
        /// The sample.
        sample: Signals,
    },
    /// A line of a program's output.
    Output {
        /// Absolute path of the program.
        path: String,
        /// When the entry came, since GO. Zero if it came before GO.
        at: Duration,
        /// Whole lines, without the last line feed.
        text: String,
    },
    /// A value that was sent over a wire. When a record is read, the value becomes a [`RecordedValue`], and only a replay reads it.
    Port {
        /// Path of the producer and its output: `main/force/Out`.
        from: String,
        /// Path of the consumer and its input.
        to: String,
        /// When it came, since GO.
        at: Duration,
        /// The encoded value.
        bytes: Vec<u8>,
        /// The type of the value, if the interface of the producer declares it.
        message: Option<Arc<Message>>,
    },
    /// Values of a wire that are not in the record, since the previous entry of this kind.
    Missing {
        /// The wire.
        wire: WireName,
        /// When the count was made, since GO.
        at: Duration,
        /// The count.
        count: MissingValues,
    },
}

/// A record that was read back.
#[derive(Clone, Debug, PartialEq)]
pub struct Run {
    /// The header.
    pub header: Header,
    /// When GO was given, since 1970. If the record has no GO, later reports give an estimate.
    pub go: Option<Duration>,
    /// Everything else, in the order in which it was recorded.
    pub entries: Vec<Entry>,
    /// The values of wires, if the reader asked for them.
    pub values: Vec<RecordedValue>,
    /// The damage, if the record is incomplete: the recorder was killed, or the file was changed.
    pub damage: Option<String>,
}

impl Run {
    /// Returns the state of the mission at the end of the run.
    pub fn mission(&self) -> Mission {
        let mut mission = Mission::new(&self.header.plan);
        for entry in &self.entries {
            match entry {
                Entry::Report(report) => mission.report(report),
                Entry::Signals { path, at, sample } => mission.signals(path, *at, sample),
                Entry::Output { path, text, .. } => mission.wrote(path, text),
                Entry::Port { .. } | Entry::Missing { .. } => {}
            }
        }
        mission
    }

    /// Returns the deployment that ran. Its epoch is 0 if the record does not have the report that the deployment was accepted.
    pub fn deployment(&self) -> Deployment {
        let accepted = self.entries.iter().find_map(|entry| match entry {
            Entry::Report(Report::Accepted { deployment }) => Some(deployment.clone()),
            Entry::Report(_)
            | Entry::Signals { .. }
            | Entry::Output { .. }
            | Entry::Port { .. }
            | Entry::Missing { .. } => None,
        });
        accepted.unwrap_or_else(|| Deployment { name: self.header.plan.name.clone(), epoch: 0 })
    }

    /// If the record may be incomplete, returns why: it is damaged, or it has no report of the deployment's end.
    pub fn lacks(&self) -> Option<String> {
        let is_last = |entry: &Entry| matches!(entry, Entry::Report(Report::Finished { .. } | Report::Refused { .. }));
        let cut = || {
            "it stops before the deployment ended: its recorder lost the mission or was ended, or its disk was full"
                .to_owned()
        };
        let omitted = |entry: &Entry| if let Entry::Report(Report::Omitted { count }) = entry { *count } else { 0 };
        let missed: u64 = self.entries.iter().map(omitted).sum();
        let gap = || format!("it lacks {}, which came while its recorder was cut off", counted(missed, "report"));
        let is_over = self.entries.iter().any(is_last);
        self.damage.clone().or_else(|| (missed > 0).then(gap)).or_else(|| (!is_over).then(cut))
    }

    /// Returns a sentence for each wire some of whose values are not in the record.
    pub fn missing(&self) -> Vec<String> {
        let mut counts: BTreeMap<&WireName, MissingValues> = BTreeMap::new();
        for entry in &self.entries {
            if let Entry::Missing { wire, count, .. } = entry {
                *counts.entry(wire).or_default() += *count;
            }
        }
        missing::sentences(counts.into_iter())
    }

    /// Returns the output of each program, in the order of their paths.
    pub fn outputs(&self) -> BTreeMap<&str, Vec<&str>> {
        let mut outputs: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
        for entry in &self.entries {
            if let Entry::Output { path, text, .. } = entry {
                outputs.entry(path).or_default().push(text);
            }
        }
        outputs
    }
}

impl Header {
    /// Returns the attachments that a record begins with: name, media type, content.
    pub fn attachments(&self) -> Vec<(&'static str, &'static str, Vec<u8>)> {
        let Self { file, text, plan, started } = self;
        let about = About { version: VERSION, name: plan.name.clone(), file: file.clone(), started: *started };
        vec![
            (ABOUT, "application/json", row::json(&about)),
            (SPEC, "text/plain", text.clone().into_bytes()),
            (PLAN, "application/json", row::json(plan)),
        ]
    }
}
