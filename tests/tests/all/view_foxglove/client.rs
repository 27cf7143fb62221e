//! A small client of the protocol. It writes frames as in RFC 6455, and reads those of a server.

use dca_tests::cluster::SOON;
use serde_json::{Value, json};
use std::collections::{BTreeMap, VecDeque};
use std::io::{ErrorKind, Read as _, Write as _};
use std::net::TcpStream;
use std::time::Duration;

/// A message of the server.
#[derive(Debug)]
pub(super) enum Message {
    /// A message in text.
    Word(Value),
    Value {
        subscription: u32,
        value: Value,
    },
    /// The result of a call.
    Response(Value),
    /// The time of a playing record.
    Time,
    /// The state of a playing record.
    Playback(Playback),
}

/// The state of a playing record.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Playback {
    /// 0 while the record is playing, 1 while it is paused, 3 at its end.
    pub(super) status: u8,
    pub(super) at: Duration,
    pub(super) has_jumped: bool,
    pub(super) request: String,
}

/// A client.
pub(super) struct Client {
    stream: TcpStream,
    bytes: Vec<u8>,
    /// The messages read while the client waited for others.
    waiting: VecDeque<Message>,
    channels: BTreeMap<String, Value>,
    services: BTreeMap<String, u32>,
}

/// Asks for a WebSocket, and returns the beginning of the answer.
pub(super) fn handshake(address: &str, host: &str, fields: &str) -> String {
    let mut stream = asked(address, host, fields);
    let mut answer = vec![0; 1024];
    let count = stream.read(&mut answer).expect("it answers");
    String::from_utf8_lossy(&answer[..count]).into_owned()
}

fn asked(address: &str, host: &str, fields: &str) -> TcpStream {
    let mut stream = TcpStream::connect(address).expect("it listens");
    stream.set_read_timeout(Some(SOON)).expect("it is a time");
    let request = format!(
        "GET / HTTP/1.1\r\nHost: {host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Protocol: foxglove.sdk.v1\r\n{fields}\r\n"
    );
    stream.write_all(request.as_bytes()).expect("it reads");
    stream
}

/// Opens a WebSocket.
pub(super) fn open(address: &str) -> TcpStream {
    let mut stream = asked(address, address, "");
    let (mut answer, mut byte) = (Vec::new(), [0]);
    while !answer.ends_with(b"\r\n\r\n") {
        stream.read_exact(&mut byte).expect("it answers");
        answer.push(byte[0]);
    }
    let answer = String::from_utf8_lossy(&answer);
    assert!(
        answer.starts_with("HTTP/1.1 101") && answer.contains("Sec-WebSocket-Protocol: foxglove.sdk.v1"),
        "{answer}"
    );
    stream
}

impl Client {
    pub(super) fn connect(address: &str) -> Self {
        let (channels, services) = (BTreeMap::new(), BTreeMap::new());
        Self { stream: open(address), bytes: Vec::new(), waiting: VecDeque::new(), channels, services }
    }

    fn frame(&mut self, first: u8, payload: &[u8]) {
        let mask = [7, 11, 13, 17];
        let length = payload.len();
        let mut frame = vec![first];
        match u16::try_from(length) {
            Ok(short @ 0..126) => frame.push(0x80 | u8::try_from(short).unwrap_or_default()),
            Ok(middle) => frame.extend([&[0xfe][..], &middle.to_be_bytes()].concat()),
            Err(_) => frame.extend([&[0xff][..], &u64::try_from(length).unwrap_or_default().to_be_bytes()].concat()),
        }
        frame.extend(mask);
        frame.extend(payload.iter().zip(mask.iter().cycle()).map(|(byte, mask)| byte ^ mask));
        self.stream.write_all(&frame).expect("it reads");
    }

    pub(super) fn send(&mut self, request: &Value) {
        self.frame(0x81, request.to_string().as_bytes());
    }

    pub(super) fn subscribe(&mut self, id: u32, channel: &Value) {
        self.send(&json!({ "op": "subscribe", "subscriptions": [{ "id": id, "channelId": channel["id"] }] }));
    }

    /// Asks for a call of a service.
    pub(super) fn order(&mut self, service: u32, number: u32, argument: &Value) {
        let numbers = [service, number, 4].into_iter().flat_map(u32::to_le_bytes);
        let bytes = [2].into_iter().chain(numbers).chain(*b"json").chain(argument.to_string().into_bytes());
        self.frame(0x82, &bytes.collect::<Vec<u8>>());
    }

    /// Calls a service. Returns its result, or the text of its failure.
    pub(super) fn call(&mut self, service: u32, number: u32, argument: &Value) -> Message {
        self.order(service, number, argument);
        self.until(|message| match message {
            Message::Response(_) => true,
            Message::Word(word) => word["op"] == "serviceCallFailure",
            Message::Value { .. } | Message::Time | Message::Playback(_) => false,
        })
    }

    /// Asks to play or pause a record, and possibly to jump.
    pub(super) fn control(&mut self, plays: bool, speed: f32, seek: Option<Duration>, request: &str) {
        let nanos = seek.map_or(0, |seek| u64::try_from(seek.as_nanos()).unwrap_or(u64::MAX));
        let length = u32::try_from(request.len()).unwrap_or_default().to_le_bytes();
        let head =
            [&[3, u8::from(!plays)][..], &speed.to_le_bytes(), &[u8::from(seek.is_some())], &nanos.to_le_bytes()];
        self.frame(0x82, &[&head.concat()[..], &length, request.as_bytes()].concat());
    }

    /// Returns the next state of the record with this status.
    pub(super) fn playback(&mut self, wanted: u8) -> Playback {
        let is_it = |message: &Message| matches!(message, Message::Playback(state) if state.status == wanted);
        let Message::Playback(state) = self.until(is_it) else { unreachable!("only states are waited for") };
        state
    }

    /// Calls a service like [`Client::call`], with more time for the result.
    pub(super) fn call_within(&mut self, service: u32, number: u32, argument: &Value, within: Duration) -> Message {
        self.stream.set_read_timeout(Some(within)).expect("it is a time");
        self.call(service, number, argument)
    }

    /// Returns the next text message of a kind.
    pub(super) fn word(&mut self, op: &str) -> Value {
        let is_it = |message: &Message| matches!(message, Message::Word(word) if word["op"] == op);
        let Message::Word(word) = self.until(is_it) else { unreachable!("only words are waited for") };
        word
    }

    /// Returns the next value of a subscription.
    pub(super) fn value(&mut self, id: u32) -> Value {
        let is_it = |message: &Message| matches!(message, Message::Value { subscription, .. } if *subscription == id);
        let Message::Value { value, .. } = self.until(is_it) else { unreachable!("only values are waited for") };
        value
    }

    /// Waits for a channel.
    pub(super) fn channel(&mut self, topic: &str) -> Value {
        loop {
            if let Some(channel) = self.channels.get(topic) {
                return channel.clone();
            }
            let message = self.next();
            self.waiting.push_back(message);
        }
    }

    /// Waits until a channel has gone.
    pub(super) fn gone(&mut self, channel: &Value) {
        while self.channels.values().any(|known| known["id"] == channel["id"]) {
            let message = self.next();
            self.waiting.push_back(message);
        }
    }

    /// Waits for a service.
    pub(super) fn service(&mut self, name: &str) -> u32 {
        loop {
            if let Some(service) = self.services.get(name) {
                return *service;
            }
            let message = self.next();
            self.waiting.push_back(message);
        }
    }

    /// Waits until the server has closed the connection.
    pub(super) fn ended(&mut self) {
        while let Some((opcode, _)) = self.read() {
            if opcode == 8 {
                return;
            }
        }
    }

    fn until(&mut self, is_it: impl Fn(&Message) -> bool) -> Message {
        if let Some(place) = self.waiting.iter().position(&is_it) {
            return self.waiting.remove(place).expect("it is there");
        }
        loop {
            let message = self.next();
            if is_it(&message) {
                return message;
            }
            // Values come without an end.
            if !matches!(message, Message::Value { .. } | Message::Time) {
                self.waiting.push_back(message);
            }
        }
    }

    fn next(&mut self) -> Message {
        loop {
            let (opcode, payload) = self.read().expect("the connection stands");
            match opcode {
                1 => {
                    let word: Value = serde_json::from_slice(&payload).expect("text is JSON");
                    self.note(&word);
                    return Message::Word(word);
                }
                2 => return binary(&payload),
                9 => self.frame(0x8a, &payload),
                8 => panic!("it has closed: {}", String::from_utf8_lossy(&payload)),
                other => panic!("a frame of kind {other}"),
            }
        }
    }

    fn note(&mut self, word: &Value) {
        let list = |name: &str| word[name].as_array().cloned().unwrap_or_default();
        for channel in list("channels") {
            self.channels.insert(channel["topic"].as_str().unwrap_or_default().to_owned(), channel);
        }
        for id in list("channelIds") {
            self.channels.retain(|_, channel| channel["id"] != id);
        }
        for service in list("services") {
            let id = service["id"].as_u64().and_then(|id| u32::try_from(id).ok()).expect("a service has a number");
            self.services.insert(service["name"].as_str().unwrap_or_default().to_owned(), id);
        }
    }

    /// Reads a frame: its kind and its bytes, or none at the end of the connection. The server in these tests does not
    /// split messages.
    fn read(&mut self) -> Option<(u8, Vec<u8>)> {
        loop {
            if let Some((opcode, payload, size)) = frame(&self.bytes) {
                self.bytes.drain(..size);
                return Some((opcode, payload));
            }
            let mut chunk = [0; 16 << 10];
            match self.stream.read(&mut chunk) {
                Ok(0) => return None,
                Ok(count) => self.bytes.extend(&chunk[..count]),
                Err(error) if error.kind() == ErrorKind::ConnectionReset => return None,
                Err(error) => panic!("nothing came: {error}"),
            }
        }
    }
}

/// Returns the first frame in these bytes if it is complete: its kind, its payload and its size.
fn frame(bytes: &[u8]) -> Option<(u8, Vec<u8>, usize)> {
    let (first, second) = (bytes.first()?, bytes.get(1)?);
    assert!(first & 0xf0 == 0x80 && second & 0x80 == 0, "a server sends whole messages without a mask");
    let (length, begin) = match second {
        126 => (usize::from(u16::from_be_bytes(*bytes.get(2..)?.first_chunk()?)), 4),
        127 => (usize::try_from(u64::from_be_bytes(*bytes.get(2..)?.first_chunk()?)).ok()?, 10),
        short => (usize::from(*short), 2),
    };
    Some((first & 0xf, bytes.get(begin..begin + length)?.to_vec(), begin + length))
}

fn nanos(payload: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(*payload[at..].first_chunk().expect("a message is whole"))
}

fn binary(payload: &[u8]) -> Message {
    let number = |at: usize| u32::from_le_bytes(*payload[at..].first_chunk().expect("a message is whole"));
    let json = |bytes: &[u8]| serde_json::from_slice(bytes).unwrap_or_else(|why| panic!("{why}"));
    match payload.first() {
        Some(2) => Message::Time,
        Some(5) => Message::Playback(Playback {
            status: payload[1],
            at: Duration::from_nanos(nanos(payload, 2)),
            has_jumped: payload[14] != 0,
            request: String::from_utf8_lossy(&payload[19..]).into_owned(),
        }),
        Some(1) => Message::Value { subscription: number(1), value: json(&payload[13..]) },
        Some(3) => {
            assert_eq!(&payload[13..17], b"json");
            Message::Response(json(&payload[17..]))
        }
        other => panic!("a binary message of kind {other:?}"),
    }
}
