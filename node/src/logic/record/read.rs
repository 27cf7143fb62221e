//! From the bytes of a record back to the run.

use crate::logic::protocol::Report;
use crate::logic::record::row::{PATH, Unit};
use crate::logic::record::schema::STAMP;
use crate::logic::record::{ABOUT, About, EVENTS, Entry, Header, LOG, PLAN, Run, SIGNALS, SPEC, VERSION};
use comms::logic::signals::{Signal, Signals};
use comms::logic::time::Time;
use language::plan::Plan;
use mcap::read::{ChunkFlattener, Options};
use mcap::records::Record;
use serde_json::{Map, Value};
use std::collections::BTreeMap;
use std::time::Duration;

/// Why bytes are no record.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// They are something else, or end before they say what was run.
    #[error("not the record of a run: {0}")]
    Foreign(String),
    /// A later version of DCA wrote them.
    #[error("the record has version {0}; this program reads up to version {VERSION}")]
    Newer(u16),
}

impl Run {
    /// Returns the run that `bytes` are the record of. A record that ends early, because the recorder was killed, is read
    /// as far as it goes.
    ///
    /// # Errors
    /// When it does not even say what was run.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, ReadError> {
        let mut reading = Reading::default();
        let damage = reading.all(bytes).err();
        let foreign = || ReadError::Foreign(damage.clone().unwrap_or_else(|| "its spec is not in it".to_owned()));
        let about = reading.about.as_ref().ok_or_else(foreign)?;
        if about.version > VERSION {
            return Err(ReadError::Newer(about.version));
        }
        let plan = reading.plan.take().ok_or_else(foreign)?;
        let text = reading.text.take().ok_or_else(foreign)?;
        let header = Header { file: about.file.clone(), text, plan, started: about.started };
        Ok(Self { header, entries: reading.entries, damage })
    }
}

#[derive(Default)]
struct Reading {
    about: Option<About>,
    plan: Option<Plan>,
    text: Option<String>,
    channels: BTreeMap<u16, Channel>,
    entries: Vec<Entry>,
    /// When GO was, since 1970; records of version 1 have times since GO.
    go: Option<Duration>,
}

struct Channel {
    topic: String,
    /// The program's path, for its signals.
    path: String,
    units: BTreeMap<String, Unit>,
}

/// What came on `/events`. In records of version 1 the report is JSON in JSON.
#[derive(serde::Deserialize)]
struct Event {
    report: Value,
}

#[derive(serde::Deserialize)]
struct Log {
    name: String,
    message: String,
}

impl Reading {
    /// Reads to the end of the data, or returns why that was not possible.
    fn all(&mut self, bytes: &[u8]) -> Result<(), String> {
        let options = Options::IgnoreEndMagic | Options::ValidateChunkCrcs;
        let records = ChunkFlattener::new_with_options(bytes, options).map_err(|error| error.to_string())?;
        for record in records {
            let record = record.map_err(|error| error.to_string())?;
            if matches!(record, Record::DataEnd(_)) {
                return Ok(());
            }
            self.record(record)?;
        }
        Err("it ends before its end was written".to_owned())
    }

    fn record(&mut self, record: Record<'_>) -> Result<(), String> {
        match record {
            Record::Channel(channel) => {
                let path = channel.metadata.get(PATH).map(String::as_str).or(channel.topic.strip_prefix(SIGNALS));
                let path = path.unwrap_or_default().to_owned();
                let units = channel.metadata.iter().filter(|(name, _)| *name != PATH);
                let units = units.map(|(name, unit)| Ok((name.clone(), parse(unit.as_bytes())?)));
                let units = units.collect::<Result<_, String>>()?;
                self.channels.insert(channel.id, Channel { topic: channel.topic, path, units });
            }
            Record::Attachment { header, data, .. } if header.name == ABOUT => self.about = Some(parse(&data)?),
            Record::Attachment { header, data, .. } if header.name == PLAN => self.plan = Some(parse(&data)?),
            Record::Attachment { header, data, .. } if header.name == SPEC => {
                self.text = Some(String::from_utf8_lossy(&data).into_owned());
            }
            Record::Message { header, data } => {
                let logged = Duration::from_nanos(header.log_time);
                let stamp = Time::from_nanos(header.publish_time);
                let Some(channel) = self.channels.get(&header.channel_id) else {
                    return Err("a message is on a channel that was never announced".to_owned());
                };
                let begin = if self.is_since_go() { Some(Duration::ZERO) } else { self.go };
                let at = begin.map_or(Duration::ZERO, |go| logged.saturating_sub(go));
                let entry = channel.entry(at, stamp, &data)?;
                if matches!(entry, Some(Entry::Report(Report::Go { .. }))) {
                    self.go = Some(logged);
                }
                self.entries.extend(entry);
            }
            Record::Attachment { .. }
            | Record::Header(_)
            | Record::Footer(_)
            | Record::Schema { .. }
            | Record::Chunk { .. }
            | Record::MessageIndex(_)
            | Record::ChunkIndex(_)
            | Record::AttachmentIndex(_)
            | Record::Statistics(_)
            | Record::Metadata(_)
            | Record::MetadataIndex(_)
            | Record::SummaryOffset(_)
            | Record::DataEnd(_)
            | Record::Unknown { .. } => {}
        }
        Ok(())
    }

    /// Whether the times of the messages are since GO.
    fn is_since_go(&self) -> bool {
        self.about.as_ref().is_some_and(|about| about.version < 2)
    }
}

impl Channel {
    fn entry(&self, at: Duration, stamp_of_v1: Time, data: &[u8]) -> Result<Option<Entry>, String> {
        if self.topic == EVENTS {
            let report = parse::<Event>(data)?.report;
            let report = match report.as_str() {
                Some(text) => parse(text.as_bytes())?,
                None => serde_json::from_value(report).map_err(|error| damaged(&error))?,
            };
            return Ok(Some(Entry::Report(report)));
        }
        if self.topic == LOG {
            let Log { name, message } = parse(data)?;
            return Ok(Some(Entry::Output { path: name, at, text: message }));
        }
        if !self.topic.starts_with(SIGNALS) {
            return Ok(None);
        }
        let object: Map<String, Value> = parse(data)?;
        let values = self.units.iter().filter_map(|(field, unit)| {
            // JSON has no NaN: such a value is left out. In version 1 it was null.
            let value = object.get(field)?.as_f64().unwrap_or(f64::NAN);
            let name = unit.name.clone().unwrap_or_else(|| field.clone());
            Some((unit.place, Signal { name, unit: unit.unit.clone(), value, headline: unit.headline }))
        });
        let mut values: Vec<_> = values.collect();
        values.sort_by_key(|(place, _)| *place);
        let stamp = object.get(STAMP).filter(|_| !self.units.contains_key(STAMP)).and_then(Value::as_f64);
        let stamp = stamp
            .and_then(|stamp| Duration::try_from_secs_f64(stamp).ok())
            .map_or(stamp_of_v1, |stamp| Time::from_nanos(u64::try_from(stamp.as_nanos()).unwrap_or(u64::MAX)));
        let sample = Signals { stamp, values: values.into_iter().map(|(_, signal)| signal).collect() };
        Ok(Some(Entry::Signals { path: self.path.clone(), at, sample }))
    }
}

fn parse<'a, T: serde::Deserialize<'a>>(bytes: &'a [u8]) -> Result<T, String> {
    serde_json::from_slice(bytes).map_err(|error| damaged(&error))
}

fn damaged(error: &serde_json::Error) -> String {
    format!("a message is damaged: {error}")
}
