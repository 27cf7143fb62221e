//! Converts the bytes of a record back to a run.

use crate::logic::record::parts::{self, Next, Part};
use crate::logic::record::row::{Form, PATH, PORTS, TO, Unit};
use crate::logic::record::schema::STAMP;
use crate::logic::record::{
    ABOUT, About, EVENTS, Entry, Header, LOG, MISSING, MissingValues, PLAN, RecordedValue, Run, SIGNALS, SPEC, VERSION,
    ValueForm, WireName,
};
use comms::logic::signals::{Signal, Signals};
use comms::logic::time::Time;
use language::plan::Plan;
use mcap::records::Record;
use node::logic::protocol::Report;
use serde_json::{Map, Value};
use std::collections::BTreeMap;
use std::ops::Range;
use std::time::Duration;

/// The reason why bytes are not a record.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The bytes are something else.
    #[error("not the record of a run: {0}")]
    Foreign(String),
    /// The bytes are the beginning of a record, or a damaged record, and do not name their run.
    #[error("the record does not name its spec: {0}")]
    Damaged(String),
    /// A later version of DCA wrote the record.
    #[error("the record has version {0}; this program reads up to version {VERSION}")]
    Newer(u16),
}

/// The sentence for a record from which the time of GO cannot be found.
const NO_GO: &str = "the time of GO is not known, so no entry has a time";
/// How many cases of damage are described. Further cases are only counted.
const NAMED_MAX: usize = 3;

impl Run {
    /// Returns the run whose record is in `bytes`. If the record is damaged, or ends early because the recorder was
    /// killed, all intact parts are read.
    ///
    /// # Errors
    /// The bytes do not name their run: they are not a record, or this part of it is lost.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, ReadError> {
        Self::read(RecordReader { bytes, ..RecordReader::default() })
    }

    /// Does the same as [`Run::from_bytes`], and also reads the values of wires.
    ///
    /// # Errors
    /// The same as for [`Run::from_bytes`].
    pub fn with_values(bytes: &[u8]) -> Result<Self, ReadError> {
        Self::read(RecordReader { bytes, keeps_values: true, ..RecordReader::default() })
    }

    fn read(mut reading: RecordReader<'_>) -> Result<Self, ReadError> {
        let bytes = reading.bytes;
        let is_record = bytes.starts_with(mcap::MAGIC) || mcap::MAGIC.starts_with(bytes);
        if bytes.starts_with(mcap::MAGIC) {
            reading.all();
        } else {
            reading.tell("it does not begin like a record".to_owned());
        }
        reading.date();
        let damage = reading.damage();
        let foreign = || {
            let why = damage.clone().unwrap_or_else(|| "it does not contain its spec".to_owned());
            if is_record { ReadError::Damaged(why) } else { ReadError::Foreign(why) }
        };
        let about = reading.about.as_ref().ok_or_else(foreign)?;
        if about.version > VERSION {
            return Err(ReadError::Newer(about.version));
        }
        let plan = reading.plan.take().ok_or_else(foreign)?;
        let text = reading.text.take().ok_or_else(foreign)?;
        let header = Header { file: about.file.clone(), text, plan, started: about.started };
        Ok(Self { header, go: reading.go.or(reading.go_min), entries: reading.entries, values: reading.values, damage })
    }
}

#[derive(Default)]
struct RecordReader<'a> {
    bytes: &'a [u8],
    about: Option<About>,
    plan: Option<Plan>,
    text: Option<String>,
    channels: BTreeMap<u16, Channel>,
    entries: Vec<Entry>,
    keeps_values: bool,
    values: Vec<RecordedValue>,
    /// When GO was given, since 1970.
    go: Option<Duration>,
    /// The earliest possible time of GO, from the later entries.
    go_min: Option<Duration>,
    /// The damage, in the order of the file: the first cases, and the number of further cases.
    damage: Vec<String>,
    damage_more: u64,
}

struct Channel {
    topic: String,
    /// The path of the program, or of the output of a wire.
    path: String,
    /// The path of the input of a wire.
    to: String,
    form: ValueForm,
    units: BTreeMap<String, Unit>,
}

/// A message on `/events`. The report is a text with JSON.
#[derive(serde::Deserialize)]
struct Event {
    report: String,
}

#[derive(serde::Deserialize)]
struct Log {
    name: String,
    message: String,
}

#[derive(serde::Deserialize)]
struct MissingCount {
    output: String,
    input: String,
    early: u64,
    lost: u64,
    breaks: u64,
}

impl RecordReader<'_> {
    /// Reads all intact parts up to the end of the data.
    fn all(&mut self) {
        parts::each(self.bytes, |next| {
            match next {
            Next::Whole(part) => self.part(&part),
            Next::Damaged(Range { start, end }) => {
                self.tell(match start {
                    0 => format!("a byte before byte {end} is damaged, but it is not a part of the record"),
                    _ => format!("bytes {start} to {end} are damaged and left out"),
                });
            }
            Next::Cut(at) => self.tell(format!("the record breaks off at byte {at}: its end was never written")),
            Next::EndLost(at) => self.tell(format!(
                "all entries are intact, but the end of the file after byte {at} is missing or damaged, so other programs may refuse the \
                 file"
            )),
            Next::End => {}
        }
        });
    }

    fn part(&mut self, part: &Part<'_>) {
        let record = mcap::parse_record(part.opcode, part.body).map_err(|error| error.to_string());
        if let Err(why) = record.and_then(|record| self.record(record)) {
            self.tell(why);
        }
    }

    fn tell(&mut self, why: String) {
        if self.damage.contains(&why) {
            return;
        }
        if self.damage.len() < NAMED_MAX {
            self.damage.push(why);
        } else {
            self.damage_more += 1;
        }
    }

    /// Returns a sentence about the damage.
    fn damage(&self) -> Option<String> {
        let more = match self.damage_more {
            0 => String::new(),
            more => format!("; and {more} more"),
        };
        (!self.damage.is_empty()).then(|| self.damage.join("; ") + &more)
    }

    /// Sets the time since GO of each entry. This needs all entries, because only later entries may show when GO was.
    fn date(&mut self) {
        let go = self.go.or(self.go_min);
        if go.is_none() && !self.damage.is_empty() {
            self.damage.insert(0, NO_GO.to_owned());
        }
        for entry in &mut self.entries {
            match entry {
                Entry::Signals { at, .. }
                | Entry::Output { at, .. }
                | Entry::Port { at, .. }
                | Entry::Missing { at, .. } => {
                    *at = go.map_or(Duration::ZERO, |go| at.saturating_sub(go));
                }
                Entry::Report(_) => {}
            }
        }
        for value in &mut self.values {
            value.at = go.map_or(Duration::ZERO, |go| value.at.saturating_sub(go));
        }
    }

    fn record(&mut self, record: Record<'_>) -> Result<(), String> {
        match record {
            Record::Channel(channel) => {
                self.channels.insert(channel.id, Channel::new(channel)?);
            }
            Record::Attachment { header, data, .. } if header.name == ABOUT => self.about = Some(parse(&data)?),
            Record::Attachment { header, data, .. } if header.name == PLAN => self.plan = Some(parse(&data)?),
            Record::Attachment { header, data, .. } if header.name == SPEC => {
                self.text = Some(String::from_utf8_lossy(&data).into_owned());
            }
            Record::Message { header, data } => {
                let logged = Duration::from_nanos(header.log_time);
                let keeps_values = self.keeps_values;
                let channel = self.channel(header.channel_id)?;
                if keeps_values && channel.topic.starts_with(PORTS) {
                    let value = channel.value(logged, data.into_owned());
                    self.values.push(value);
                    return Ok(());
                }
                let entry = channel.entry(logged, &data)?;
                if let Some(Entry::Report(Report::Go { .. })) = &entry {
                    self.go = Some(logged);
                }
                if let Some(Entry::Report(Report::Process { at, .. } | Report::Finished { at, .. })) = &entry {
                    self.go_min = self.go_min.max(logged.checked_sub(*at));
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

    /// Returns a channel. If the announcement of the channel is damaged, looks in the summary, which exists if the record was ended.
    fn channel(&mut self, id: u16) -> Result<&Channel, String> {
        if !self.channels.contains_key(&id) {
            let summary = mcap::read::Summary::read(self.bytes).ok().flatten();
            let known = summary.as_ref().and_then(|summary| summary.channels.get(&id));
            let none = || "a message is on a channel that was never announced".to_owned();
            let known = known.ok_or_else(none)?;
            let (topic, message_encoding) = (known.topic.clone(), known.message_encoding.clone());
            let metadata = known.metadata.clone();
            let channel = mcap::records::Channel { id, schema_id: 0, topic, message_encoding, metadata };
            self.channels.insert(id, Channel::new(channel)?);
        }
        Ok(&self.channels[&id])
    }
}

impl Channel {
    fn new(announced: mcap::records::Channel) -> Result<Self, String> {
        let mcap::records::Channel { topic, message_encoding, metadata, .. } = announced;
        let (of_ros, _) = Form::Ros.encodings();
        let form = if message_encoding == of_ros { ValueForm::Cdr } else { ValueForm::Json };
        let to = metadata.get(TO).cloned().unwrap_or_default();
        let path = metadata.get(PATH).map(String::as_str).or(topic.strip_prefix(SIGNALS));
        let path = path.unwrap_or_default().to_owned();
        let units = metadata.iter().filter(|(name, _)| topic.starts_with(SIGNALS) && *name != PATH);
        let units = units.map(|(name, unit)| Ok((name.clone(), parse(unit.as_bytes())?)));
        let units = units.collect::<Result<_, String>>()?;
        Ok(Self { topic, path, to, form, units })
    }

    /// Returns a value of a wire. `at` is its time since 1970.
    fn value(&self, at: Duration, data: Vec<u8>) -> RecordedValue {
        RecordedValue { from: self.path.clone(), to: self.to.clone(), at, form: self.form, data }
    }

    /// Returns an entry if a report uses it. `at` is its time since 1970.
    fn entry(&self, at: Duration, data: &[u8]) -> Result<Option<Entry>, String> {
        if self.topic == EVENTS {
            let Event { report } = parse(data)?;
            return Ok(Some(Entry::Report(parse(report.as_bytes())?)));
        }
        if self.topic == LOG {
            let Log { name, message } = parse(data)?;
            return Ok(Some(Entry::Output { path: name, at, text: message }));
        }
        if self.topic == MISSING {
            let MissingCount { output, input, early, lost, breaks } = parse(data)?;
            let (wire, count) = (WireName { from: output, to: input }, MissingValues { early, lost, breaks });
            return Ok(Some(Entry::Missing { wire, at, count }));
        }
        if !self.topic.starts_with(SIGNALS) {
            return Ok(None);
        }
        let object: Map<String, Value> = parse(data)?;
        let values = self.units.iter().filter_map(|(field, unit)| {
            // JSON cannot hold NaN, so such a value is missing.
            let value = object.get(field)?.as_f64()?;
            let Unit { place, unit, headline, name } = unit.clone();
            Some((place, Signal { name, unit, value, headline }))
        });
        let mut values: Vec<_> = values.collect();
        values.sort_by_key(|(place, _)| *place);
        let stamp = object.get(STAMP).and_then(Value::as_f64);
        let stamp = stamp.and_then(|stamp| Duration::try_from_secs_f64(stamp).ok()).ok_or("a sample has no stamp")?;
        let stamp = Time::from_nanos(u64::try_from(stamp.as_nanos()).unwrap_or(u64::MAX));
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
