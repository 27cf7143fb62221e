//! The forms in which `dca logs` prints the output of a process.

use node::console;
use node::logic::printable::Printable;
use serde_json::{Map, Value};
use std::time::Duration;

/// The longest line in JSON, in bytes. A longer line is split.
const LINE_MAX: usize = 64 << 10;

/// The process that has written the output.
#[derive(Debug)]
pub(super) struct Writer {
    /// Its host, if it is known.
    pub(super) host: Option<String>,
    pub(super) process: String,
}

/// A form of the output.
#[derive(Debug)]
pub(super) enum Form {
    /// The bytes, unchanged.
    Raw,
    /// The bytes, with control characters as text.
    Text(Printable),
    /// An object for each line.
    Json(JsonLines),
}

/// Makes an object of each line.
#[derive(Debug)]
pub(super) struct JsonLines {
    writer: Writer,
    /// The time of the output since 1970, if it is known.
    at: Option<Duration>,
    /// The line that has not ended yet.
    begun: Vec<u8>,
}

impl Form {
    pub(super) fn text() -> Self {
        Self::Text(Printable::default())
    }

    pub(super) fn json(writer: Writer) -> Self {
        Self::Json(JsonLines { writer, at: None, begun: Vec::new() })
    }

    /// Sets the time of the output that follows, since 1970.
    pub(super) fn date(&mut self, time: Option<Duration>) {
        if let Self::Json(lines) = self {
            lines.at = time;
        }
    }

    /// Prints a piece of the output. Returns whether the output still has a reader.
    pub(super) fn print(&mut self, bytes: &[u8]) -> anyhow::Result<bool> {
        match self {
            Self::Raw => console::pass(bytes),
            Self::Text(printable) => console::pass(printable.push(bytes).as_bytes()),
            Self::Json(lines) => console::pass(lines.push(bytes).as_bytes()),
        }
    }

    /// Prints the rest of a line that has no end.
    pub(super) fn finish(self) -> anyhow::Result<bool> {
        match self {
            Self::Raw => Ok(true),
            Self::Text(mut printable) => console::pass(printable.finish().as_bytes()),
            Self::Json(lines) => console::pass(lines.finish().as_bytes()),
        }
    }
}

impl JsonLines {
    /// Adds bytes. Returns an object for each line that they complete.
    fn push(&mut self, bytes: &[u8]) -> String {
        let mut objects = String::new();
        for piece in bytes.split_inclusive(|byte| *byte == b'\n') {
            self.begun.extend(piece);
            if piece.ends_with(b"\n") || self.begun.len() >= LINE_MAX {
                let line = std::mem::take(&mut self.begun);
                objects.push_str(&self.object(&line));
            }
        }
        objects
    }

    fn finish(mut self) -> String {
        let line = std::mem::take(&mut self.begun);
        if line.is_empty() { String::new() } else { self.object(&line) }
    }

    fn object(&self, line: &[u8]) -> String {
        let text = String::from_utf8_lossy(line.strip_suffix(b"\n").unwrap_or(line));
        let Writer { host, process } = &self.writer;
        let time = self.at.map(|at| ("time", Value::from(at.as_secs_f64())));
        let host = host.as_ref().map(|host| ("host", Value::from(host.as_str())));
        let always = [("process", Value::from(process.as_str())), ("text", Value::from(text))];
        let fields = time.into_iter().chain(host).chain(always);
        let object: Map<String, Value> = fields.map(|(name, value)| (name.to_owned(), value)).collect();
        format!("{}\n", Value::Object(object))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_line_is_an_object() {
        let writer = Writer { host: Some("c1".into()), process: "main/say".into() };
        let Form::Json(mut lines) = Form::json(writer) else { panic!("it is JSON") };
        assert_eq!(lines.push(b"on"), "");
        let texts = |objects: &str| {
            let objects = objects.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
            objects.map(|object| object["text"].as_str().unwrap().to_owned()).collect::<Vec<_>>()
        };
        let first = lines.push(b"e\n");
        let expected = serde_json::json!({ "host": "c1", "process": "main/say", "text": "one" });
        assert_eq!(serde_json::from_str::<Value>(&first).unwrap(), expected);
        assert_eq!(texts(&lines.push(b"\"\x1b[2J\n\nrest")), ["\"\u{1b}[2J", ""]);
        lines.at = Some(Duration::from_millis(1500));
        let last: Value = serde_json::from_str(&lines.finish()).unwrap();
        assert_eq!((last["time"].as_f64(), last["text"].as_str()), (Some(1.5), Some("rest")));
    }

    #[test]
    fn a_line_without_end_is_split() {
        let mut lines = JsonLines { writer: Writer { host: None, process: "a".into() }, at: None, begun: Vec::new() };
        let objects = lines.push(&vec![b'x'; LINE_MAX]);
        assert_eq!((objects.lines().count(), lines.begun.len()), (1, 0));
    }
}
