//! The messages of the protocol between a server and Foxglove: `foxglove.sdk.v1`, which older clients call `foxglove.websocket.v1`.
//!
//! Text messages are JSON objects with a field `op`. Binary messages begin with one byte for their kind; numbers in them are
//! little-endian. Source: <https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md>.

use super::catalog::{Channel, Encodings, Service};
use serde::Deserialize;
use serde_json::{Value, json};
use std::time::Duration;

/// The names of the protocol, the preferred name first.
pub(crate) const PROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
/// The encoding of calls and their results.
pub(super) const ENCODING: &str = "json";

/// The kinds of binary messages of a server.
const DATA: u8 = 1;
const TIME: u8 = 2;
const CALL_RESPONSE: u8 = 3;
const PLAYBACK_STATE: u8 = 5;
/// The kinds of binary messages of a client that are taken.
const CALL_REQUEST: u8 = 2;
const PLAYBACK_CONTROL: u8 = 3;
/// The longest name of a request to play a record.
const REQUEST_MAX: usize = 256;

/// A message of a client.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Request {
    Subscribe(Vec<Subscription>),
    Unsubscribe(Vec<u32>),
    Parameters {
        /// An empty list means all parameters.
        names: Vec<String>,
        id: Option<String>,
    },
    SetParameters {
        values: Vec<GivenValue>,
        id: Option<String>,
    },
    /// The client gets the changes. An empty list means all parameters.
    FollowParameters(Vec<String>),
    UnfollowParameters(Vec<String>),
    Call(Call),
    Control(Control),
}

/// A request to play a record, to pause it, or to jump. Absent fields change nothing.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Control {
    pub(super) plays: Option<bool>,
    pub(super) speed: Option<f64>,
    /// The time to jump to, since 1970.
    pub(super) seek: Option<Duration>,
    /// The name that the client has given to it.
    pub(super) request: String,
}

/// Whether a record is being played.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PlaybackStatus {
    Playing,
    Paused,
    Ended,
}

/// The state of a record that is played.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Playback {
    pub(super) status: PlaybackStatus,
    /// The time of the record, since 1970.
    pub(super) position: Duration,
    pub(super) speed: f64,
    pub(super) has_jumped: bool,
    /// The name of the answered request. None if the message answers no request.
    pub(super) request: String,
}

/// The begin and the end of a record, since 1970.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Span {
    pub(super) begin: Duration,
    pub(super) end: Duration,
}

/// A subscription, with the number that its client has chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub(super) struct Subscription {
    pub(super) id: u32,
    #[serde(rename = "channelId")]
    pub(super) channel: u32,
}

/// A new value of a parameter. Without a value the change is taken back.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub(crate) struct GivenValue {
    pub(crate) name: String,
    #[serde(default)]
    pub(crate) value: Option<Value>,
}

/// A call of a service.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Call {
    pub(super) service: u32,
    /// The number that the client has chosen.
    pub(super) number: u32,
    pub(super) encoding: String,
    pub(super) payload: Vec<u8>,
}

/// The present value of a parameter.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ParameterValue {
    pub(crate) name: String,
    pub(crate) value: Value,
}

/// How much a message to the person matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Level {
    Warning,
    Error,
}

/// A message of a client in text.
#[derive(Deserialize)]
#[serde(tag = "op", rename_all = "camelCase", rename_all_fields = "camelCase")]
enum Operation {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    GetParameters {
        #[serde(default)]
        parameter_names: Vec<String>,
        #[serde(default)]
        id: Option<String>,
    },
    SetParameters {
        parameters: Vec<GivenValue>,
        #[serde(default)]
        id: Option<String>,
    },
    SubscribeParameterUpdates {
        #[serde(default)]
        parameter_names: Vec<String>,
    },
    UnsubscribeParameterUpdates {
        #[serde(default)]
        parameter_names: Vec<String>,
    },
    #[serde(other)]
    Other,
}

/// Reads a message in text.
///
/// # Errors
/// One sentence about the mistake.
pub(super) fn read_text(text: &str) -> Result<Request, String> {
    let operation: Operation =
        serde_json::from_str(text).map_err(|why| format!("a message cannot be read as a request: {why}"))?;
    Ok(match operation {
        Operation::Subscribe { subscriptions } => Request::Subscribe(subscriptions),
        Operation::Unsubscribe { subscription_ids } => Request::Unsubscribe(subscription_ids),
        Operation::GetParameters { parameter_names, id } => Request::Parameters { names: parameter_names, id },
        Operation::SetParameters { parameters, id } => Request::SetParameters { values: parameters, id },
        Operation::SubscribeParameterUpdates { parameter_names } => Request::FollowParameters(parameter_names),
        Operation::UnsubscribeParameterUpdates { parameter_names } => Request::UnfollowParameters(parameter_names),
        Operation::Other => {
            return Err("a request was ignored: this server takes subscriptions, parameters and calls only".to_owned());
        }
    })
}

/// Reads a binary message.
///
/// # Errors
/// One sentence about the mistake.
pub(super) fn read_binary(bytes: &[u8]) -> Result<Request, String> {
    let cut = || "a binary request is cut off".to_owned();
    let (kind, rest) = bytes.split_first().ok_or_else(cut)?;
    if *kind == PLAYBACK_CONTROL {
        return read_control(rest).ok_or_else(cut).map(Request::Control);
    }
    if *kind != CALL_REQUEST {
        return Err(format!("a binary request of kind {kind} was ignored: this server takes calls of services only"));
    }
    let number = |at: usize| Some(u32::from_le_bytes(*rest.get(at..)?.first_chunk()?));
    let (service, call) = (number(0).ok_or_else(cut)?, number(4).ok_or_else(cut)?);
    let length = usize::try_from(number(8).ok_or_else(cut)?).map_err(|_too_long| cut())?;
    let rest = &rest[12..];
    let (encoding, payload) = rest.split_at_checked(length).ok_or_else(cut)?;
    let encoding = String::from_utf8_lossy(encoding).into_owned();
    Ok(Request::Call(Call { service, number: call, encoding, payload: payload.to_vec() }))
}

/// Reads a request to play a record. None if it is cut off.
/// Source: `foxglove` 0.25, protocol/common/client/playback_control_request.rs.
fn read_control(bytes: &[u8]) -> Option<Control> {
    let (command, rest) = bytes.split_first()?;
    let (speed, rest) = rest.split_first_chunk()?;
    let (has_seek, rest) = rest.split_first()?;
    let (seek, rest) = rest.split_first_chunk()?;
    let (length, rest) = rest.split_first_chunk()?;
    let request = rest.get(..usize::try_from(u32::from_le_bytes(*length)).ok()?)?;
    Some(Control {
        plays: Some(*command == 0),
        speed: Some(f64::from(f32::from_le_bytes(*speed))),
        seek: (*has_seek != 0).then(|| Duration::from_nanos(u64::from_le_bytes(*seek))),
        request: String::from_utf8_lossy(request.get(..REQUEST_MAX).unwrap_or(request)).into_owned(),
    })
}

/// Returns the first message to each client of a record.
pub(super) fn record_info(session: &str, span: Span) -> String {
    let time = |at: Duration| json!({ "sec": at.as_secs(), "nsec": at.subsec_nanos() });
    json!({
        "op": "serverInfo",
        "name": "dca replay",
        "capabilities": ["time", "playbackControl", "services"],
        "supportedEncodings": [ENCODING],
        "metadata": {},
        "sessionId": session,
        "dataStartTime": time(span.begin),
        "dataEndTime": time(span.end),
    })
    .to_string()
}

/// Returns the state of a record that is played.
/// Source: `foxglove` 0.25, protocol/common/server/playback_state.rs.
pub(super) fn playback_state(state: &Playback) -> Vec<u8> {
    let status = match state.status {
        PlaybackStatus::Playing => 0,
        PlaybackStatus::Paused => 1,
        PlaybackStatus::Ended => 3,
    };
    #[expect(clippy::cast_possible_truncation, reason = "the protocol has this width, and a speed is from 0.01 to 100")]
    let speed = state.speed as f32;
    let length = u32::try_from(state.request.len()).unwrap_or_default();
    let mut bytes = vec![PLAYBACK_STATE, status];
    bytes.extend(nanos(state.position).to_le_bytes());
    bytes.extend(speed.to_le_bytes());
    bytes.push(u8::from(state.has_jumped));
    bytes.extend(length.to_le_bytes());
    bytes.extend(state.request.bytes());
    bytes
}

/// Returns the time of a record that is played.
pub(super) fn time(at: Duration) -> Vec<u8> {
    [TIME].into_iter().chain(nanos(at).to_le_bytes()).collect()
}

/// Returns the first message to each client.
pub(super) fn server_info(session: &str) -> String {
    json!({
        "op": "serverInfo",
        "name": "dca view",
        "capabilities": ["parameters", "parametersSubscribe", "services"],
        "supportedEncodings": [ENCODING],
        "metadata": {},
        "sessionId": session,
    })
    .to_string()
}

/// Returns the message that these channels are there.
pub(super) fn advertise<'a>(channels: impl Iterator<Item = &'a Channel>) -> String {
    let channels: Vec<Value> = channels
        .map(|channel| {
            let Encodings { messages: encoding, schema: schema_encoding } = &channel.encodings;
            json!({
                "id": channel.id, "topic": channel.topic, "encoding": encoding, "schemaName": channel.schema_name,
                "schema": channel.schema, "schemaEncoding": schema_encoding,
            })
        })
        .collect();
    json!({ "op": "advertise", "channels": channels }).to_string()
}

/// Returns the message that these channels have gone.
pub(super) fn unadvertise(channels: &[u32]) -> String {
    json!({ "op": "unadvertise", "channelIds": channels }).to_string()
}

/// Returns the message that these services are there.
pub(super) fn advertise_services<'a>(services: impl Iterator<Item = &'a Service>) -> String {
    let form = |name: &str, schema: &str| json!({ "encoding": ENCODING, "schemaName": name, "schemaEncoding": "jsonschema", "schema": schema });
    let services: Vec<Value> = services
        .map(|service| {
            let kind = &service.kind;
            json!({
                "id": service.id, "name": service.name, "type": kind,
                "request": form(&format!("{kind}_Request"), &service.request),
                "response": form(&format!("{kind}_Response"), &service.response),
            })
        })
        .collect();
    json!({ "op": "advertiseServices", "services": services }).to_string()
}

/// Returns the message that these services have gone.
pub(super) fn unadvertise_services(services: &[u32]) -> String {
    json!({ "op": "unadvertiseServices", "serviceIds": services }).to_string()
}

/// Returns the message with values of parameters. A number keeps its type when a person types a whole one.
pub(super) fn parameter_values<'a>(values: impl Iterator<Item = &'a ParameterValue>, id: Option<&str>) -> String {
    let values: Vec<Value> = values
        .map(|ParameterValue { name, value }| {
            let mut one = json!({ "name": name, "value": value });
            if value.is_f64() {
                one["type"] = json!("float64");
            }
            one
        })
        .collect();
    let mut message = json!({ "op": "parameterValues", "parameters": values });
    if let Some(id) = id {
        message["id"] = json!(id);
    }
    message.to_string()
}

/// Returns a message for the person at the client.
pub(super) fn status(level: Level, text: &str) -> String {
    let level = match level {
        Level::Warning => 1,
        Level::Error => 2,
    };
    json!({ "op": "status", "level": level, "message": text }).to_string()
}

/// Returns the answer to a call that has no result.
pub(super) fn call_failure(service: u32, call: u32, why: &str) -> String {
    json!({ "op": "serviceCallFailure", "serviceId": service, "callId": call, "message": why }).to_string()
}

/// Returns the answer to a call.
pub(super) fn call_response(service: u32, call: u32, result: &Value) -> Vec<u8> {
    let payload = result.to_string();
    let length = u32::try_from(ENCODING.len()).unwrap_or_default();
    let numbers = [service, call, length].into_iter().flat_map(u32::to_le_bytes);
    [CALL_RESPONSE].into_iter().chain(numbers).chain(ENCODING.bytes()).chain(payload.into_bytes()).collect()
}

/// Returns a value of a subscription; `at` is when it came here, since 1970.
pub(super) fn data(subscription: u32, at: Duration, payload: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(13 + payload.len());
    bytes.push(DATA);
    bytes.extend(subscription.to_le_bytes());
    bytes.extend(nanos(at).to_le_bytes());
    bytes.extend(payload);
    bytes
}

fn nanos(at: Duration) -> u64 {
    u64::try_from(at.as_nanos()).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_in_text() {
        let check = |text: &str, expected: Request| assert_eq!(read_text(text), Ok(expected), "{text}");
        let subscription = Subscription { id: 0, channel: 3 };
        check(r#"{"op":"subscribe","subscriptions":[{"id":0,"channelId":3}]}"#, Request::Subscribe(vec![subscription]));
        check(r#"{"op":"unsubscribe","subscriptionIds":[0,1]}"#, Request::Unsubscribe(vec![0, 1]));
        let names = vec!["/a".to_owned()];
        check(
            r#"{"op":"getParameters","parameterNames":["/a"],"id":"r1"}"#,
            Request::Parameters { names: names.clone(), id: Some("r1".to_owned()) },
        );
        check(r#"{"op":"getParameters"}"#, Request::Parameters { names: vec![], id: None });
        let value = |name: &str, value| GivenValue { name: name.to_owned(), value };
        check(
            r#"{"op":"setParameters","parameters":[{"name":"a","value":3,"type":"float64"},{"name":"b"}]}"#,
            Request::SetParameters { values: vec![value("a", Some(json!(3))), value("b", None)], id: None },
        );
        check(
            r#"{"op":"subscribeParameterUpdates","parameterNames":["/a"]}"#,
            Request::FollowParameters(names.clone()),
        );
        check(r#"{"op":"unsubscribeParameterUpdates","parameterNames":["/a"]}"#, Request::UnfollowParameters(names));
        for wrong in [
            "",
            "[]",
            "{}",
            "5",
            r#"{"op":"subscribe"}"#,
            r#"{"op":"subscribe","subscriptions":[{"id":-1,"channelId":0}]}"#,
        ] {
            assert!(read_text(wrong).unwrap_err().contains("cannot be read"), "{wrong}");
        }
        assert!(read_text(r#"{"op":"advertise","channels":[]}"#).unwrap_err().contains("was ignored"));
        let deep = format!("{}{}", "[".repeat(100_000), "]".repeat(100_000));
        assert!(read_text(&format!(r#"{{"op":"subscribe","subscriptions":{deep}}}"#)).is_err());
    }

    #[test]
    fn requests_in_bytes() {
        let call = [&[2, 7, 0, 0, 0, 9, 0, 0, 0, 4, 0, 0, 0][..], b"json{}"].concat();
        let expected = Call { service: 7, number: 9, encoding: "json".to_owned(), payload: b"{}".to_vec() };
        assert_eq!(read_binary(&call), Ok(Request::Call(expected)));
        for end in 0..17 {
            assert!(read_binary(&call[..end]).unwrap_err().contains("cut off"), "{end}");
        }
        let huge = [2, 7, 0, 0, 0, 9, 0, 0, 0, 255, 255, 255, 255, b'j'];
        assert!(read_binary(&huge).unwrap_err().contains("cut off"));
        assert!(read_binary(&[1, 0, 0, 0, 0]).unwrap_err().contains("kind 1"));
    }

    #[test]
    fn a_record_is_played_as_the_protocol_says() {
        let begin = [&[3, 0][..], &1.5_f32.to_le_bytes(), &[1]].concat();
        let request = [&begin[..], &100_500_000_000_u64.to_le_bytes(), &[2, 0, 0, 0], b"id"].concat();
        let (speed, seek) = (Some(1.5), Some(Duration::from_millis(100_500)));
        let expected = Control { plays: Some(true), speed, seek, request: "id".to_owned() };
        assert_eq!(read_binary(&request), Ok(Request::Control(expected)));
        for end in 1..request.len() {
            assert!(read_binary(&request[..end]).unwrap_err().contains("cut off"), "{end}");
        }
        let pause = [&[3, 1, 0, 0, 0, 0, 0][..], &[9; 8], &[0; 4]].concat();
        let Ok(Request::Control(pause)) = read_binary(&pause) else { panic!("it is a request") };
        assert_eq!((pause.plays, pause.seek, pause.request.as_str()), (Some(false), None, ""));
        let (position, request) = (Duration::from_nanos(12_345), "i".to_owned());
        let state = Playback { status: PlaybackStatus::Ended, position, speed: 1.0, has_jumped: true, request };
        let expected = [&[5, 3][..], &12_345_u64.to_le_bytes(), &1_f32.to_le_bytes(), &[1, 1, 0, 0, 0, b'i']].concat();
        assert_eq!(playback_state(&state), expected);
        assert_eq!(time(position), [&[2][..], &12_345_u64.to_le_bytes()].concat());
    }

    #[test]
    fn answers_are_laid_out_as_the_protocol_says() {
        assert_eq!(data(3, Duration::from_nanos(258), b"ab"), [1, 3, 0, 0, 0, 2, 1, 0, 0, 0, 0, 0, 0, b'a', b'b']);
        let response = [&[3, 7, 0, 0, 0, 9, 0, 0, 0, 4, 0, 0, 0][..], b"json{}"].concat();
        assert_eq!(call_response(7, 9, &json!({})), response);
        let values = [("a", json!(2.0)), ("b", json!("x"))];
        let values = values.map(|(name, value)| ParameterValue { name: name.to_owned(), value });
        let expected = json!({
            "op": "parameterValues", "id": "r",
            "parameters": [{ "name": "a", "value": 2.0, "type": "float64" }, { "name": "b", "value": "x" }],
        });
        assert_eq!(parameter_values(values.iter(), Some("r")), expected.to_string());
    }
}
