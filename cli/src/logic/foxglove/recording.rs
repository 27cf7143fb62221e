//! A record that is played to clients: its topics, its messages, and the clock that all clients share.

use super::catalog::{Catalog, Target};
use super::player::Player;
use super::protocol::{self, Control, Span};
use crate::logic::record::Timeline;
use comms::logic::time::Time;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::time::Duration;

/// The service that plays the record, for clients without controls of their own.
pub(super) const SERVICE: &str = "/replay";

/// A message of the record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Message<'a> {
    /// When it was recorded, since 1970.
    pub(super) at: Duration,
    pub(super) data: &'a [u8],
}

/// The state of a record, after a client has asked for something.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct StateAnswer {
    /// For this client: it has the name of the request.
    pub(super) asker: Vec<u8>,
    pub(super) others: Vec<u8>,
}

/// The messages for clients after the clock has moved.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Played {
    /// The places of messages in the record.
    pub(super) messages: Vec<usize>,
    /// The time of the record, and its state.
    pub(super) frames: Vec<Vec<u8>>,
    pub(super) answer: Option<StateAnswer>,
    /// Whether values that still wait are not wanted any more.
    pub(super) has_jumped: bool,
}

/// The messages of one channel.
#[derive(Debug)]
struct Track {
    channel: u32,
    /// Their places in the record.
    places: Vec<usize>,
}

/// A record that is played.
#[derive(Debug)]
pub(super) struct Recording {
    timeline: Timeline,
    player: Player,
    /// By the place of the topic in the record.
    tracks: BTreeMap<usize, Track>,
    /// The place of the next message.
    next: usize,
    /// Whether it has been played. It begins with the first subscription.
    has_begun: bool,
}

impl Recording {
    /// Returns a record that is paused at its begin, and offers its topics to clients.
    pub(super) fn new(timeline: Timeline, catalog: &mut Catalog) -> Self {
        let offered = timeline.topics.iter().enumerate();
        let offered = offered.filter_map(|(place, topic)| Some((place, catalog.add_recorded(place, topic)?)));
        let mut tracks: BTreeMap<usize, Track> =
            offered.map(|(place, channel)| (place, Track { channel, places: Vec::new() })).collect();
        for (place, message) in timeline.messages.iter().enumerate() {
            if let Some(track) = tracks.get_mut(&message.topic) {
                track.places.push(place);
            }
        }
        let [request, response] = schemas();
        catalog.add_service(SERVICE, request.to_string(), response.to_string(), Target::Replay);
        let (begin, end) = timeline.span();
        Self { timeline, player: Player::new(begin, end), tracks, next: 0, has_begun: false }
    }

    pub(super) fn span(&self) -> Span {
        let (begin, end) = self.timeline.span();
        Span { begin, end }
    }

    /// Returns the messages that tell a new client the time of the record, and whether it is being played.
    pub(super) fn greeting(&self) -> [Vec<u8>; 2] {
        let state = protocol::playback_state(&self.player.state(false, ""));
        [protocol::time(self.player.position()), state]
    }

    /// Returns whether the record has never been played.
    pub(super) fn is_new(&self) -> bool {
        !self.has_begun
    }

    pub(super) fn deadline(&self) -> Option<Time> {
        self.player.deadline()
    }

    /// Returns a message and its channel.
    pub(super) fn message(&self, place: usize) -> Option<(u32, Message<'_>)> {
        let message = self.timeline.messages.get(place)?;
        let channel = self.tracks.get(&message.topic)?.channel;
        Some((channel, Message { at: message.at, data: &message.data }))
    }

    /// Returns the last message of a channel up to the present time of the record.
    pub(super) fn last(&self, channel: u32) -> Option<Message<'_>> {
        let track = self.tracks.values().find(|track| track.channel == channel)?;
        Some(self.message(self.last_place(track)?)?.1)
    }

    fn last_place(&self, track: &Track) -> Option<usize> {
        let passed = track.places.partition_point(|place| *place < self.next);
        track.places.get(passed.checked_sub(1)?).copied()
    }

    /// Plays it up to now.
    pub(super) fn advance(&mut self, now: Time) -> Played {
        let before = self.player.position();
        let is_over = self.player.advance(now);
        let position = self.player.position();
        let begin = self.next;
        self.next += self.timeline.messages[begin..].partition_point(|message| message.at <= position);
        let mut frames = Vec::new();
        if position != before {
            frames.push(protocol::time(position));
        }
        if is_over {
            frames.push(protocol::playback_state(&self.player.state(false, "")));
        }
        Played { messages: (begin..self.next).collect(), frames, ..Played::default() }
    }

    /// Carries out the request of a client. After a jump, clients get the last message of each channel.
    pub(super) fn control(&mut self, now: Time, control: &Control) -> Played {
        self.has_begun = true;
        let mut played = self.advance(now);
        played.has_jumped = self.player.control(now, control);
        if played.has_jumped {
            let position = self.player.position();
            self.next = self.timeline.messages.partition_point(|message| message.at <= position);
            played.messages = self.tracks.values().filter_map(|track| self.last_place(track)).collect();
            played.messages.sort_unstable();
            played.frames = vec![protocol::time(position)];
        }
        let state = |request: &str| protocol::playback_state(&self.player.state(played.has_jumped, request));
        played.answer = Some(StateAnswer { asker: state(&control.request), others: state("") });
        played
    }

    /// Reads a call of the service that plays it.
    ///
    /// # Errors
    /// One sentence about the mistake.
    pub(super) fn read(&self, payload: &[u8]) -> Result<Control, String> {
        let given = super::order::value(payload)?;
        let fields = given.as_object().ok_or("expected fields, such as `{\"play\": true}`")?;
        let mut control = Control::default();
        for (name, value) in fields {
            let wrong = |expected: &str| format!("`{name}` is {value}, and not {expected}");
            match name.as_str() {
                "play" => control.plays = Some(value.as_bool().ok_or_else(|| wrong("true or false"))?),
                "speed" => {
                    let speed = value.as_f64().filter(|speed| *speed > 0.0);
                    control.speed = Some(speed.ok_or_else(|| wrong("a number above 0"))?);
                }
                "seconds" => {
                    let seconds = value.as_f64().filter(|seconds| *seconds >= 0.0);
                    control.seek = Some(self.player.at(seconds.ok_or_else(|| wrong("a time since the begin"))?));
                }
                _ => return Err(format!("`{name}` is not one of `play`, `speed` and `seconds`")),
            }
        }
        Ok(control)
    }

    /// Returns its state, for the result of a call.
    pub(super) fn in_json(&self) -> Value {
        let (seconds, length) = self.player.seconds();
        let is_playing = self.deadline().is_some();
        json!({ "playing": is_playing, "speed": self.player.state(false, "").speed, "seconds": seconds, "length": length })
    }
}

/// Returns the schemas of the argument and of the result of the service.
fn schemas() -> [Value; 2] {
    let number = |what: &str| json!({ "type": "number", "description": what });
    let truth = |what: &str| json!({ "type": "boolean", "description": what });
    let object = |properties: Value| json!({ "type": "object", "properties": properties });
    let request = object(json!({
        "play": truth("play it, or pause it"),
        "speed": number("how much faster than recorded, from 0.01 to 100"),
        "seconds": number("jump to this time since the begin"),
    }));
    let response = object(json!({
        "playing": truth("whether it is being played"),
        "speed": number("how much faster than recorded"),
        "seconds": number("the time since the begin"),
        "length": number("the time from the begin to the end"),
    }));
    [request, response]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::foxglove::Arrival;
    use crate::logic::foxglove::hub::Hub;
    use crate::logic::foxglove::outbox::Frame;
    use crate::logic::record::{RecordedMessage, RecordedTopic};

    const BEGIN: Duration = Duration::from_secs(1_800_000_000);

    fn at(millis: u64) -> Arrival {
        Arrival { time: Time::ZERO + Duration::from_millis(millis), since_1970: BEGIN }
    }

    /// A record of 10 s: `/a` each second, and `/b` once, after 2.5 s.
    fn timeline() -> Timeline {
        let topic = |name: &str| RecordedTopic {
            name: name.to_owned(),
            encoding: "json".to_owned(),
            ..RecordedTopic::default()
        };
        let message = |millis: u64, topic| {
            let data = format!("{millis}").into_bytes();
            RecordedMessage { at: BEGIN + Duration::from_millis(millis), topic, data }
        };
        let mut messages: Vec<RecordedMessage> = (0..=10).map(|second| message(second * 1000, 0)).collect();
        messages.insert(3, message(2500, 1));
        Timeline { topics: vec![topic("/a"), topic("/b")], messages, is_damaged: false }
    }

    /// The messages that a client has got.
    #[derive(Debug, Default, PartialEq)]
    struct Received {
        words: Vec<Value>,
        values: Vec<(u32, String)>,
        /// Status, seconds since the begin, and whether it has jumped.
        states: Vec<(u8, f64, bool)>,
        times: usize,
    }

    struct Bench {
        hub: Hub,
        client: u64,
    }

    impl Bench {
        fn new() -> Self {
            let mut hub = Hub::of_record(7, timeline());
            let client = hub.enter().expect("there is room");
            Self { hub, client }
        }

        fn give(&mut self, millis: u64, request: &Value) {
            self.hub.take(self.client, &Frame::Text(request.to_string()), at(millis));
        }

        fn subscribe(&mut self, millis: u64, id: u32, channel: u32) {
            self.give(millis, &json!({ "op": "subscribe", "subscriptions": [{ "id": id, "channelId": channel }] }));
        }

        fn control(&mut self, millis: u64, command: u8, seek: Option<u64>) {
            let time =
                seek.map_or(0, |millis| u64::try_from((BEGIN + Duration::from_millis(millis)).as_nanos()).unwrap());
            let bytes = [
                &[3, command][..],
                &1_f32.to_le_bytes(),
                &[u8::from(seek.is_some())],
                &time.to_le_bytes(),
                &[1, 0, 0, 0, b'r'],
            ];
            self.hub.take(self.client, &Frame::Binary(bytes.concat()), at(millis));
        }

        /// Plays in steps up to a moment, and returns what the client has got.
        fn play(&mut self, from: u64, to: u64) -> Received {
            (from..=to).step_by(20).for_each(|millis| self.hub.play(at(millis).time));
            self.got()
        }

        fn got(&mut self) -> Received {
            let mut got = Received::default();
            while let Some(frame) = self.hub.next(self.client, Time::ZERO) {
                match frame {
                    Frame::Text(text) => got.words.push(serde_json::from_str(&text).unwrap()),
                    Frame::Binary(bytes) if bytes[0] == 1 => {
                        let id = u32::from_le_bytes(*bytes[1..].first_chunk().unwrap());
                        got.values.push((id, String::from_utf8_lossy(&bytes[13..]).into_owned()));
                    }
                    Frame::Binary(bytes) if bytes[0] == 2 => got.times += 1,
                    Frame::Binary(bytes) => {
                        assert_eq!(bytes[0], 5);
                        let time = Duration::from_nanos(u64::from_le_bytes(*bytes[2..].first_chunk().unwrap()));
                        got.states.push((bytes[1], time.saturating_sub(BEGIN).as_secs_f64(), bytes[14] == 1));
                    }
                }
            }
            got
        }
    }

    fn values(all: &[(u32, &str)]) -> Vec<(u32, String)> {
        all.iter().map(|(id, text)| (*id, (*text).to_owned())).collect()
    }

    #[test]
    fn a_record_is_offered_with_its_span_and_is_played_once_a_client_subscribes() {
        let mut bench = Bench::new();
        let got = bench.got();
        assert_eq!(got.words[0]["capabilities"], json!(["time", "playbackControl", "services"]));
        assert_eq!(got.words[0]["dataEndTime"], json!({ "sec": 1_800_000_010, "nsec": 0 }));
        assert_eq!(got.words[1]["channels"].as_array().map(Vec::len), Some(2));
        assert_eq!((got.states, got.times), (vec![(1, 0.0, false)], 1), "it stands at its begin");
        assert_eq!(bench.play(0, 5000), Received::default());
        bench.subscribe(5000, 9, 1);
        let got = bench.play(5020, 7000);
        assert_eq!(got.values, values(&[(9, "0"), (9, "1000"), (9, "2000")]));
        assert_eq!((got.states, got.times), (vec![(0, 0.0, false)], 1), "only the last time waits");
        // After a pause of this program, the clock moves by half a second.
        bench.subscribe(7600, 8, 2);
        assert_eq!(bench.play(7600, 7600).values, values(&[(8, "2500")]));
        // A later subscription begins with the last message.
        bench.give(7600, &json!({ "op": "unsubscribe", "subscriptionIds": [8] }));
        bench.subscribe(7600, 6, 2);
        assert_eq!(bench.got().values, values(&[(6, "2500")]));
    }

    #[test]
    fn a_jump_drops_what_waits_and_gives_the_last_message_of_each_channel() {
        let mut bench = Bench::new();
        bench.subscribe(0, 9, 1);
        bench.subscribe(0, 8, 2);
        (0..=1000).step_by(20).for_each(|millis| bench.hub.play(at(millis).time));
        bench.control(1000, 0, Some(6500));
        let got = bench.got();
        assert_eq!(got.values, values(&[(8, "2500"), (9, "6000")]));
        assert_eq!(got.states.last(), Some(&(0, 6.5, true)));
        bench.control(1000, 1, Some(500));
        let got = bench.got();
        assert_eq!((got.values, got.states), (values(&[(9, "0")]), vec![(1, 0.5, true)]));
        assert_eq!(bench.play(1020, 9000).values, values(&[]), "it is paused");
        bench.control(9000, 0, Some(9900));
        bench.got();
        let got = bench.play(9020, 9200);
        assert_eq!((got.values, got.states), (values(&[(9, "10000")]), vec![(3, 10.0, false)]));
    }

    #[test]
    fn a_client_without_controls_calls_a_service() {
        let mut bench = Bench::new();
        bench.subscribe(0, 9, 1);
        let service = bench.got().words[2]["services"][0]["id"].as_u64().and_then(|id| u32::try_from(id).ok()).unwrap();
        let mut call = |service: u32, payload: &str| {
            let numbers = [service, 3, 4].into_iter().flat_map(u32::to_le_bytes);
            let bytes = [2].into_iter().chain(numbers).chain(*b"json").chain(payload.bytes()).collect();
            bench.hub.take(bench.client, &Frame::Binary(bytes), at(0));
            let mut last = Value::Null;
            while let Some(frame) = bench.hub.next(bench.client, Time::ZERO) {
                match frame {
                    Frame::Text(text) => last = serde_json::from_str(&text).unwrap(),
                    Frame::Binary(bytes) if bytes[0] == 3 => last = serde_json::from_slice(&bytes[17..]).unwrap(),
                    Frame::Binary(_) => {}
                }
            }
            last
        };
        let paused = call(service, r#"{"play": false, "speed": 2, "seconds": 4}"#);
        assert_eq!(paused, json!({ "playing": false, "speed": 2.0, "seconds": 4.0, "length": 10.0 }));
        assert_eq!(call(service, "")["playing"], json!(false));
        for (payload, why) in [
            (r#"{"play": 1}"#, "true or false"),
            (r#"{"speed": 0}"#, "above 0"),
            (r#"{"seconds": -1}"#, "since the begin"),
            (r#"{"second": 1}"#, "is not one of"),
            ("[]", "expected fields"),
            ("{", "is not JSON"),
        ] {
            let failure = call(service, payload);
            assert!(failure["message"].as_str().is_some_and(|text| text.contains(why)), "{payload}: {failure}");
        }
        assert!(call(99, "{}")["message"].as_str().is_some_and(|text| text.contains("does not exist")));
        bench.give(0, &json!({ "op": "getParameters", "parameterNames": [] }));
        assert_eq!((bench.got().words[0]["op"].as_str(), bench.hub.orders().len()), (Some("status"), 0));
    }
}
