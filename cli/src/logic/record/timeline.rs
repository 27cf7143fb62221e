//! The messages of a record in the order of their times, with their topics. A viewer plays them in this order.

use crate::logic::record::ReadError;
use crate::logic::record::parts::{self, Next, Part};
use mcap::records::Record;
use std::collections::BTreeMap;
use std::time::Duration;

/// A topic of a record.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct RecordedTopic {
    pub(crate) name: String,
    pub(crate) encoding: String,
    pub(crate) schema_name: String,
    pub(crate) schema_encoding: String,
    pub(crate) schema: String,
}

/// A message of a record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct RecordedMessage {
    /// When it was recorded, since 1970.
    pub(crate) at: Duration,
    /// Index into [`Timeline::topics`].
    pub(crate) topic: usize,
    pub(crate) data: Vec<u8>,
}

/// All messages of a record.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Timeline {
    pub(crate) topics: Vec<RecordedTopic>,
    /// In the order of their times.
    pub(crate) messages: Vec<RecordedMessage>,
    /// Whether a part of the file is damaged or missing.
    pub(crate) is_damaged: bool,
}

impl Timeline {
    /// Reads the messages of a record. Damaged parts are left out.
    ///
    /// # Errors
    /// The bytes are not a record, or they contain no intact message.
    pub(crate) fn from_bytes(bytes: &[u8]) -> Result<Self, ReadError> {
        if !bytes.starts_with(mcap::MAGIC) {
            return Err(ReadError::Foreign("it does not begin like a record".to_owned()));
        }
        let mut reading = Reading::default();
        parts::each(bytes, |next| match next {
            Next::Whole(part) => reading.part(&part),
            Next::Damaged(_) | Next::Cut(_) | Next::EndLost(_) => reading.timeline.is_damaged = true,
            Next::End => {}
        });
        let mut timeline = reading.timeline;
        if timeline.messages.is_empty() {
            return Err(ReadError::Damaged("it has no whole message".to_owned()));
        }
        timeline.messages.sort_by_key(|message| message.at);
        Ok(timeline)
    }

    /// Returns the times of the first message and of the last one, since 1970.
    pub(crate) fn span(&self) -> (Duration, Duration) {
        let at = |message: Option<&RecordedMessage>| message.map_or(Duration::ZERO, |message| message.at);
        (at(self.messages.first()), at(self.messages.last()))
    }
}

/// The schema of a topic.
#[derive(Debug, Default)]
struct Described {
    name: String,
    encoding: String,
    text: String,
}

#[derive(Debug, Default)]
struct Reading {
    timeline: Timeline,
    schemas: BTreeMap<u16, Described>,
    /// The topic of each channel.
    topics: BTreeMap<u16, usize>,
}

impl Reading {
    fn part(&mut self, part: &Part<'_>) {
        match mcap::parse_record(part.opcode, part.body) {
            Ok(Record::Schema { header, data }) => {
                let text = String::from_utf8_lossy(&data).into_owned();
                self.schemas.insert(header.id, Described { name: header.name, encoding: header.encoding, text });
            }
            Ok(Record::Channel(channel)) => {
                let described = self.schemas.get(&channel.schema_id);
                let text = |field: fn(&Described) -> &String| described.map(field).cloned().unwrap_or_default();
                let topic = RecordedTopic {
                    name: channel.topic,
                    encoding: channel.message_encoding,
                    schema_name: text(|one| &one.name),
                    schema_encoding: text(|one| &one.encoding),
                    schema: text(|one| &one.text),
                };
                // Each chunk may announce the same topic again.
                let known = self.timeline.topics.iter().position(|one| *one == topic);
                let index = known.unwrap_or(self.timeline.topics.len());
                if known.is_none() {
                    self.timeline.topics.push(topic);
                }
                self.topics.insert(channel.id, index);
            }
            Ok(Record::Message { header, data }) => match self.topics.get(&header.channel_id) {
                Some(topic) => {
                    let (at, topic, data) = (Duration::from_nanos(header.log_time), *topic, data.into_owned());
                    self.timeline.messages.push(RecordedMessage { at, topic, data });
                }
                // The part of the file with the topic is damaged.
                None => self.timeline.is_damaged = true,
            },
            Ok(_) => {}
            Err(_) => self.timeline.is_damaged = true,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    fn record() -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        let options = mcap::WriteOptions::new().compression(None).chunk_size(Some(64));
        let mut writer = options.create(&mut bytes).unwrap();
        let schema = writer.add_schema("S", "jsonschema", b"{}").unwrap();
        let channels = ["/a", "/b"].map(|topic| writer.add_channel(schema, topic, "json", &BTreeMap::new()).unwrap());
        for (index, log_time) in [30_u64, 10, 20, 40].into_iter().enumerate() {
            let channel_id = channels[index % 2];
            let header = mcap::records::MessageHeader { channel_id, sequence: 0, log_time, publish_time: log_time };
            writer.write_to_known_channel(&header, format!("{log_time}").as_bytes()).unwrap();
        }
        writer.finish().unwrap();
        drop(writer);
        bytes.into_inner()
    }

    #[test]
    fn messages_are_in_the_order_of_their_times() {
        let timeline = Timeline::from_bytes(&record()).unwrap();
        let shown: Vec<_> = timeline
            .messages
            .iter()
            .map(|one| (timeline.topics[one.topic].name.as_str(), String::from_utf8_lossy(&one.data).into_owned()))
            .collect();
        let expected = [("/b", "10"), ("/a", "20"), ("/a", "30"), ("/b", "40")];
        assert_eq!(shown, expected.map(|(topic, data)| (topic, data.to_owned())));
        assert_eq!(timeline.span(), (Duration::from_nanos(10), Duration::from_nanos(40)));
        assert!(!timeline.is_damaged && timeline.topics.iter().all(|topic| topic.schema_name == "S"));
    }

    /// A cut or changed record is read as far as possible, or refused. It never causes a panic.
    #[test]
    fn damaged_records_are_read_as_far_as_they_go() {
        let whole = record();
        for end in 0..whole.len() {
            let read = Timeline::from_bytes(&whole[..end]);
            assert!(read.is_err() || read.is_ok_and(|timeline| timeline.is_damaged), "{end}");
        }
        for place in 0..whole.len() {
            let mut bytes = whole.clone();
            bytes[place] ^= 0x55;
            drop(Timeline::from_bytes(&bytes));
        }
    }
}
