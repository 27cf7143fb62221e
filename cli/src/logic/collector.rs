//! Requests to a collector of OpenTelemetry, and its answers: OTLP over HTTP with JSON.
//!
//! Source: OpenTelemetry Protocol 1.5, OTLP/HTTP; RFC 9112 for messages.

use node::logic::printable::printable;
use serde_json::Value;
use std::fmt;

/// The port, and the path of traces, of a collector that does not say otherwise.
const PORT: u16 = 4318;
const PATH: &str = "/v1/traces";
/// The most header fields of an answer.
const FIELDS_MAX: usize = 64;
/// The longest answer that is read, in bytes.
pub(crate) const ANSWER_MAX: usize = 64 << 10;
/// The longest text of a collector that is shown.
const WORDS_MAX: usize = 200;

/// The address of a collector.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Collector {
    /// A name or an address, without brackets.
    pub(crate) host: String,
    pub(crate) port: u16,
    path: String,
}

/// `http://localhost:4318/v1/traces`
impl fmt::Display for Collector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "http://{}{}", self.authority(), self.path)
    }
}

impl Collector {
    /// Reads an address such as `http://localhost:4318`.
    ///
    /// # Errors
    /// One sentence about the mistake.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let wrong = || "it is not the address of a collector, such as `http://localhost:4318`".to_owned();
        if text.starts_with("https://") {
            return Err(
                "traces are sent without TLS: send them to a collector on this machine, and let it pass them on"
                    .to_owned(),
            );
        }
        let rest = text.strip_prefix("http://").ok_or_else(wrong)?;
        let (authority, path) = rest.split_at(rest.find('/').unwrap_or(rest.len()));
        // A colon within brackets belongs to an address of IPv6.
        let colon = authority.rfind(':').filter(|place| !authority[*place..].contains(']'));
        let (host, port) = match colon {
            Some(place) => (&authority[..place], authority[place + 1..].parse().map_err(|_not_a_port| wrong())?),
            None => (authority, PORT),
        };
        let host = host.strip_prefix('[').and_then(|host| host.strip_suffix(']')).unwrap_or(host);
        let is_odd = |c: char| !c.is_ascii_graphic() || "[]@?#/\\".contains(c);
        if host.is_empty() || host.contains(is_odd) || path.contains(|c: char| !c.is_ascii_graphic() || c == '#') {
            return Err(wrong());
        }
        let path = if matches!(path, "" | "/") { PATH } else { path };
        Ok(Self { host: host.to_owned(), port, path: path.to_owned() })
    }

    /// Returns the bytes of a request with this body. The version 1.0 keeps the answer in one piece.
    pub(crate) fn request(&self, body: &str) -> Vec<u8> {
        let (path, authority, length) = (&self.path, self.authority(), body.len());
        format!(
            "POST {path} HTTP/1.0\r\nHost: {authority}\r\nContent-Type: application/json\r\nContent-Length: {length}\r\n\r\n{body}"
        )
        .into_bytes()
    }

    fn authority(&self) -> String {
        let Self { host, port, .. } = self;
        if host.contains(':') { format!("[{host}]:{port}") } else { format!("{host}:{port}") }
    }
}

/// The answer of a collector to a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Answer {
    /// It has taken all spans.
    Taken,
    /// It has taken the request, but not these spans, with its reason.
    Partly { refused: usize, why: String },
    /// It never takes this request, for this reason.
    Refused(String),
    /// It may take the request later.
    Later(String),
}

impl Answer {
    /// Reads all that a collector has sent until it closed the connection.
    pub(crate) fn read(bytes: &[u8]) -> Self {
        let mut fields = [httparse::EMPTY_HEADER; FIELDS_MAX];
        let mut response = httparse::Response::new(&mut fields);
        let Ok(httparse::Status::Complete(size)) = response.parse(bytes) else {
            return Self::Later("its answer cannot be read as HTTP".to_owned());
        };
        let (code, body) = (response.code.unwrap_or_default(), &bytes[size..]);
        match code {
            200..=299 => partly(body).unwrap_or(Self::Taken),
            // Source: OTLP/HTTP, "Retryable Response Codes".
            429 | 502 | 503 | 504 => Self::Later(words(code, body)),
            _ => Self::Refused(words(code, body)),
        }
    }
}

/// Returns what a collector did not take of a request that it took.
fn partly(body: &[u8]) -> Option<Answer> {
    let answer: Value = serde_json::from_slice(body).ok()?;
    let partial = answer.get("partialSuccess")?;
    // In JSON, 64-bit numbers are texts; some collectors write numbers.
    let refused = &partial["rejectedSpans"];
    let refused = refused.as_u64().or_else(|| refused.as_str()?.parse().ok()).filter(|count| *count > 0)?;
    let why = shown(partial["errorMessage"].as_str().unwrap_or("no reason"));
    Some(Answer::Partly { refused: usize::try_from(refused).unwrap_or(usize::MAX), why })
}

fn words(code: u16, body: &[u8]) -> String {
    format!("it answers {code}: {}", shown(&String::from_utf8_lossy(body)))
}

/// Returns the begin of a text, in one line that is safe for a terminal.
fn shown(text: &str) -> String {
    let begin: String = text.chars().take(WORDS_MAX).collect();
    printable(&begin.split_whitespace().collect::<Vec<_>>().join(" "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_as_they_are_written() {
        let read = |text: &str| Collector::parse(text).map(|collector| collector.to_string());
        for (text, wanted) in [
            ("http://localhost", "http://localhost:4318/v1/traces"),
            ("http://10.0.0.7:9999/", "http://10.0.0.7:9999/v1/traces"),
            ("http://[fe80::1]:80/otlp/v1/traces", "http://[fe80::1]:80/otlp/v1/traces"),
            ("http://[::1]", "http://[::1]:4318/v1/traces"),
        ] {
            assert_eq!(read(text).as_deref(), Ok(wanted), "{text}");
        }
        for text in [
            "",
            "localhost:4318",
            "http://",
            "http://a:b",
            "http://a:70000",
            "http://a b",
            "http://a/\r\nX: y",
            "http://u@a",
        ] {
            assert!(read(text).is_err(), "{text}");
        }
        assert!(read("https://a").is_err_and(|why| why.contains("TLS")));
    }

    #[test]
    fn answers_say_what_was_taken() {
        let read = |text: &str| Answer::read(text.as_bytes());
        assert_eq!(read("HTTP/1.1 200 OK\r\n\r\n{\"partialSuccess\":{}}"), Answer::Taken);
        assert_eq!(read("HTTP/1.1 204 No Content\r\n\r\n"), Answer::Taken);
        let partly =
            "HTTP/1.0 200 OK\r\n\r\n{\"partialSuccess\":{\"rejectedSpans\":\"3\",\"errorMessage\":\"too\\nold\"}}";
        assert_eq!(read(partly), Answer::Partly { refused: 3, why: "too old".to_owned() });
        assert_eq!(read("HTTP/1.1 503 Busy\r\n\r\nwait"), Answer::Later("it answers 503: wait".to_owned()));
        assert_eq!(read("HTTP/1.1 400 Bad Request\r\n\r\nno"), Answer::Refused("it answers 400: no".to_owned()));
        for text in ["", "HTTP/1.1", "SSH-2.0-x\r\n"] {
            assert!(matches!(read(text), Answer::Later(_)), "{text}");
        }
    }
}
