//! JSON-RPC messages on a stream of bytes. A header gives the length of each.
//!
//! Reading continues after any input. Lines that are not a header are skipped, and a body that cannot be read is reported as malformed.

use lsp_types::json_rpc::Id;
use serde::Deserialize;
use serde_json::Value;
use std::io::{self, BufRead, Read, Write as _};

/// The longest body that is read, in bytes. It may contain a whole document as a JSON string.
const BODY_MAX: u64 = 64 << 20;
/// The longest part of a header line that is read at once.
const HEADER_MAX: u64 = 4096;

/// A message of an editor.
#[derive(Debug)]
pub(super) enum Message {
    /// A request, which needs an answer.
    Request {
        /// Its number.
        id: Id,
        /// The method of the request.
        method: String,
        /// The parameters of the request.
        params: Value,
    },
    /// A notification, which needs no answer.
    Notification {
        /// The method of the notification.
        method: String,
        /// The parameters of the notification.
        params: Value,
    },
    /// An answer of the editor to a request of the server.
    Response,
    /// A malformed message, and the reason.
    Malformed(String),
}

#[derive(Deserialize)]
struct Body {
    id: Option<Id>,
    method: Option<String>,
    #[serde(default)]
    params: Value,
}

/// Reads one message; nothing at the end of the stream.
///
/// # Errors
/// Reading the stream has failed.
pub(super) fn read(input: &mut impl BufRead) -> io::Result<Option<Message>> {
    let mut length = None;
    loop {
        let mut line = Vec::new();
        if input.by_ref().take(HEADER_MAX).read_until(b'\n', &mut line)? == 0 {
            return Ok(None);
        }
        let line = line.trim_ascii();
        if let (true, Some(length)) = (line.is_empty(), length) {
            return body(input, length).map(Some);
        }
        length = content_length(line).or(length);
    }
}

fn content_length(line: &[u8]) -> Option<u64> {
    let (name, value) = std::str::from_utf8(line).ok()?.split_once(':')?;
    name.trim().eq_ignore_ascii_case("content-length").then(|| value.trim().parse().ok())?
}

fn body(input: &mut impl BufRead, length: u64) -> io::Result<Message> {
    if length > BODY_MAX {
        io::copy(&mut input.by_ref().take(length), &mut io::sink())?;
        return Ok(Message::Malformed(format!("a message of {length} bytes is longer than {} MiB", BODY_MAX >> 20)));
    }
    let mut bytes = Vec::new();
    input.by_ref().take(length).read_to_end(&mut bytes)?;
    Ok(match serde_json::from_slice(&bytes) {
        Ok(Body { id: Some(id), method: Some(method), params }) => Message::Request { id, method, params },
        Ok(Body { id: None, method: Some(method), params }) => Message::Notification { method, params },
        Ok(Body { id: Some(_), method: None, .. }) => Message::Response,
        Ok(Body { id: None, method: None, .. }) => Message::Malformed("a message without a method".to_owned()),
        Err(error) => Message::Malformed(format!("a malformed message: {error}")),
    })
}

/// Returns a message with its header.
pub(super) fn frame(message: &Value) -> Vec<u8> {
    let body = message.to_string();
    let mut bytes = Vec::with_capacity(body.len() + 40);
    // Writing to memory cannot fail.
    let written = write!(bytes, "Content-Length: {}\r\n\r\n{body}", body.len());
    debug_assert!(written.is_ok());
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(bytes: &[u8]) -> Vec<String> {
        let mut input = bytes;
        let mut found = Vec::new();
        while let Ok(Some(message)) = read(&mut input) {
            found.push(match message {
                Message::Request { id, method, .. } => format!("{method} {id:?}"),
                Message::Notification { method, .. } => method,
                Message::Response => "response".to_owned(),
                Message::Malformed(why) => why,
            });
        }
        found
    }

    fn framed(body: &str) -> Vec<u8> {
        format!("Content-Length: {}\r\n\r\n{body}", body.len()).into_bytes()
    }

    #[test]
    fn whatever_arrives_reading_goes_on() {
        let mut bytes = framed(r#"{"jsonrpc":"2.0","id":1,"method":"a"}"#);
        bytes.extend(b"nonsense\r\n\r\nContent-Length: many\r\n\r\n");
        bytes.extend(framed("{\"id\":"));
        bytes.extend(framed("[1]"));
        bytes.extend(framed("{}"));
        bytes.extend(b"content-length: 2\nContent-Type: x\n\n\xff\xfe");
        bytes.extend(framed(r#"{"id":"x","result":null}"#));
        bytes.extend(framed(r#"{"method":"b","params":[1]}"#));
        let found = all(&bytes);
        assert_eq!(found.len(), 7, "{found:?}");
        assert_eq!((found[0].as_str(), found[5].as_str(), found[6].as_str()), ("a Number(1)", "response", "b"));
        assert!(
            found[1..5].iter().all(|why| why.starts_with("a message ") || why.starts_with("a malformed message")),
            "{found:?}"
        );
        let nested = format!("{}{}", "[".repeat(100_000), "]".repeat(100_000));
        assert_eq!(all(&framed(&nested)).len(), 1);
    }

    #[test]
    fn a_message_that_is_too_long_is_passed_over() {
        let mut bytes = format!("Content-Length: {}\r\n\r\n", BODY_MAX + 1).into_bytes();
        bytes.resize(bytes.len() + usize::try_from(BODY_MAX).unwrap() + 1, b' ');
        bytes.extend(framed(r#"{"method":"b"}"#));
        let found = all(&bytes);
        assert_eq!((found[0].contains("longer than 64 MiB"), found[1].as_str()), (true, "b"));
    }
}
