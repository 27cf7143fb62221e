//! Requests of a browser to the page, and the answers: a small part of HTTP/1.1, one request for each connection.
//!
//! Source: RFC 9112 for messages, RFC 6265 for cookies, the Fetch standard for `Sec-Fetch-Site`, RFC 6455 for WebSocket.

use std::fmt::Write as _;

/// The longest head of a request, in bytes.
const HEAD_MAX: usize = 16 << 10;
/// The longest body of a request, in bytes.
pub(crate) const BODY_MAX: usize = 8 << 10;
/// The most header fields.
const FIELDS_MAX: usize = 64;
/// The begin of the name of the cookie that shows that a browser has opened the link of this view. The port follows: a
/// browser sends the cookies of all ports of a host to each of them.
const COOKIE: &str = "dca-view-";
/// The policy for the browser: it loads only this page, its style and its script, and runs no script within the page.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self'; \
                      base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// The status of an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Status {
    Ok,
    /// The link was good: go to the page.
    SeeOther,
    BadRequest,
    Forbidden,
    NotFound,
    NotAllowed,
    TooLarge,
    Busy,
}

impl Status {
    /// Returns its number and its words.
    pub(crate) fn line(self) -> &'static str {
        match self {
            Self::Ok => "200 OK",
            Self::SeeOther => "303 See Other",
            Self::BadRequest => "400 Bad Request",
            Self::Forbidden => "403 Forbidden",
            Self::NotFound => "404 Not Found",
            Self::NotAllowed => "405 Method Not Allowed",
            Self::TooLarge => "413 Content Too Large",
            Self::Busy => "503 Service Unavailable",
        }
    }
}

/// The head of a request.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Head {
    pub(crate) is_post: bool,
    pub(crate) path: String,
    pub(crate) query: String,
    pub(crate) host: String,
    pub(crate) origin: Option<String>,
    site: Option<String>,
    cookie: String,
    token: String,
    /// The position of a viewer that resumes.
    pub(crate) last_event_id: String,
    /// How many bytes follow.
    pub(crate) length: usize,
    /// Whether the client wants to speak another protocol from here on.
    pub(crate) upgrade: Upgrade,
}

/// The fields of a request for a WebSocket.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Upgrade {
    /// The protocols that the client wants to change to.
    pub(crate) to: String,
    /// The fields that are about this connection alone.
    pub(crate) connection: String,
    pub(crate) version: String,
    pub(crate) key: String,
    /// The protocols within a WebSocket that the client speaks.
    pub(crate) protocols: String,
}

/// Reads the head of a request: nothing while its end has not come, else the head and its length.
pub(crate) fn head(bytes: &[u8]) -> Result<Option<(Head, usize)>, Status> {
    let mut fields = [httparse::EMPTY_HEADER; FIELDS_MAX];
    let mut request = httparse::Request::new(&mut fields);
    let size = match request.parse(bytes) {
        Ok(httparse::Status::Complete(size)) => size,
        Ok(httparse::Status::Partial) if bytes.len() < HEAD_MAX => return Ok(None),
        Ok(httparse::Status::Partial) => return Err(Status::TooLarge),
        Err(_) => return Err(Status::BadRequest),
    };
    let is_post = match request.method {
        Some("GET") => false,
        Some("POST") => true,
        _ => return Err(Status::NotAllowed),
    };
    let target = request.path.unwrap_or_default();
    let (path, query) = target.split_once('?').unwrap_or((target, ""));
    let mut head = Head { is_post, path: path.to_owned(), query: query.to_owned(), ..Head::default() };
    for field in request.headers.iter() {
        let text = std::str::from_utf8(field.value).map_err(|_not_text| Status::BadRequest)?;
        let text = || text.to_owned();
        match field.name.to_ascii_lowercase().as_str() {
            "host" if head.host.is_empty() => head.host = text(),
            "host" | "transfer-encoding" => return Err(Status::BadRequest),
            "origin" => head.origin = Some(text()),
            "sec-fetch-site" => head.site = Some(text()),
            "cookie" => head.cookie = text(),
            "x-dca-token" => head.token = text(),
            "upgrade" => head.upgrade.to = text(),
            "connection" => head.upgrade.connection = text(),
            "sec-websocket-version" => head.upgrade.version = text(),
            "sec-websocket-key" => head.upgrade.key = text(),
            "sec-websocket-protocol" => head.upgrade.protocols = format!("{},{}", head.upgrade.protocols, text()),
            "last-event-id" => head.last_event_id = text(),
            "content-length" => head.length = text().parse().map_err(|_not_a_number| Status::BadRequest)?,
            _ => {}
        }
    }
    if head.length > BODY_MAX {
        return Err(Status::TooLarge);
    }
    Ok(Some((head, size)))
}

/// The secrets of a view, and the address under which it is opened.
#[derive(Clone, Debug)]
pub(crate) struct Door {
    /// The address at which it listens, and its port.
    pub(crate) address: String,
    pub(crate) port: u16,
    /// The secret in the link that is printed.
    pub(crate) key: String,
    /// The secret in the page, which each order repeats.
    pub(crate) token: String,
}

/// The right of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Entry {
    /// The link was opened: the browser gets the cookie.
    Link,
    /// A page, a stream or an order.
    Granted,
}

impl Door {
    /// Checks whether a request comes from a browser that has opened the link, and an order from the page itself.
    pub(crate) fn check(&self, head: &Head) -> Result<Entry, Status> {
        // A page of another site that has its name point here has another host.
        if head.host != self.address && head.host != format!("localhost:{}", self.port) {
            return Err(Status::Forbidden);
        }
        let key = head.query.strip_prefix("key=").unwrap_or_default();
        if !head.is_post && head.path == "/" && is_equal(key, &self.key) {
            return Ok(Entry::Link);
        }
        let cookie = head.cookie.split(';').filter_map(|one| one.trim().split_once('='));
        let is_known = cookie.into_iter().any(|(name, value)| name == self.cookie() && is_equal(value, &self.key));
        if !is_known {
            return Err(Status::Forbidden);
        }
        let is_own = |origin: &String| *origin == format!("http://{}", head.host);
        let is_from_page =
            head.origin.as_ref().is_none_or(is_own) && head.site.as_ref().is_none_or(|site| site == "same-origin");
        if head.is_post && !(is_from_page && is_equal(&head.token, &self.token)) {
            return Err(Status::Forbidden);
        }
        Ok(Entry::Granted)
    }

    /// Returns the name of its cookie.
    fn cookie(&self) -> String {
        format!("{COOKIE}{}", self.port)
    }

    /// Returns the answer to the link.
    pub(crate) fn welcome(&self) -> Vec<u8> {
        let (name, key) = (self.cookie(), &self.key);
        let cookie = format!("Set-Cookie: {name}={key}; HttpOnly; SameSite=Strict; Path=/\r\nLocation: /\r\n");
        answer(Status::SeeOther, "text/plain; charset=utf-8", &cookie, b"")
    }
}

/// Returns whether two secrets are the same, in a time that does not depend on where they differ.
pub(crate) fn is_equal(one: &str, other: &str) -> bool {
    let differs = one.bytes().zip(other.bytes()).fold(0, |differs, (a, b)| differs | (a ^ b));
    one.len() == other.len() && !other.is_empty() && differs == 0
}

/// Returns a whole answer.
pub(crate) fn answer(status: Status, kind: &str, fields: &str, body: &[u8]) -> Vec<u8> {
    let mut head = begin(status, kind);
    write!(head, "{fields}Content-Length: {}\r\n\r\n", body.len()).unwrap_or_default();
    [head.as_bytes(), body].concat()
}

/// Returns the answer that a WebSocket begins with.
pub(crate) fn switch(accept: &str, protocol: &str) -> Vec<u8> {
    let begin = "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n";
    format!("{begin}Sec-WebSocket-Accept: {accept}\r\nSec-WebSocket-Protocol: {protocol}\r\n\r\n").into_bytes()
}

/// Returns the head of a stream of events.
pub(crate) fn stream() -> Vec<u8> {
    (begin(Status::Ok, "text/event-stream") + "\r\n").into_bytes()
}

fn begin(status: Status, kind: &str) -> String {
    format!(
        "HTTP/1.1 {}\r\nContent-Type: {kind}\r\nContent-Security-Policy: {POLICY}\r\nX-Content-Type-Options: nosniff\r\n\
         Referrer-Policy: no-referrer\r\nCross-Origin-Opener-Policy: same-origin\r\nCross-Origin-Resource-Policy: same-origin\r\n\
         Cache-Control: no-store\r\nConnection: close\r\n",
        status.line()
    )
}

/// Returns an event of a stream. The data has no line end.
pub(crate) fn event(id: &str, data: &str) -> Vec<u8> {
    format!("id: {id}\ndata: {data}\n\n").into_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn door() -> Door {
        Door { address: "127.0.0.1:7080".into(), port: 7080, key: "k1".into(), token: "t1".into() }
    }

    fn read(text: &str) -> Result<Head, Status> {
        head(text.replace('\n', "\r\n").as_bytes()).map(|head| head.expect("it is whole").0)
    }

    #[track_caller]
    fn check(text: &str, expected: Result<Entry, Status>) {
        assert_eq!(read(text).and_then(|head| door().check(&head)), expected, "{text}");
    }

    #[test]
    fn only_a_browser_with_the_link_gets_in() {
        check("GET /?key=k1 HTTP/1.1\nHost: 127.0.0.1:7080\n\n", Ok(Entry::Link));
        check("GET /?key=k2 HTTP/1.1\nHost: 127.0.0.1:7080\n\n", Err(Status::Forbidden));
        check("GET / HTTP/1.1\nHost: 127.0.0.1:7080\n\n", Err(Status::Forbidden));
        check("GET /events HTTP/1.1\nHost: localhost:7080\nCookie: a=b; dca-view-7080=k1\n\n", Ok(Entry::Granted));
        check("GET /events HTTP/1.1\nHost: localhost:7080\nCookie: dca-view-7080=\n\n", Err(Status::Forbidden));
        // The views at two ports have the same cookies.
        let both = "Cookie: dca-view-7081=k2; dca-view-7080=k1";
        check(&format!("GET /events HTTP/1.1\nHost: localhost:7080\n{both}\n\n"), Ok(Entry::Granted));
        check("GET /events HTTP/1.1\nHost: localhost:7080\nCookie: dca-view-7081=k1\n\n", Err(Status::Forbidden));
    }

    #[test]
    fn another_site_cannot_give_orders_or_read() {
        let begin = "POST /estop HTTP/1.1\nHost: 127.0.0.1:7080\nCookie: dca-view-7080=k1\n";
        check(&format!("{begin}X-Dca-Token: t1\nOrigin: http://127.0.0.1:7080\n\n"), Ok(Entry::Granted));
        check(&format!("{begin}Origin: http://127.0.0.1:7080\n\n"), Err(Status::Forbidden));
        check(&format!("{begin}X-Dca-Token: t2\n\n"), Err(Status::Forbidden));
        check(&format!("{begin}X-Dca-Token: t1\nOrigin: http://evil.example\n\n"), Err(Status::Forbidden));
        check(&format!("{begin}X-Dca-Token: t1\nSec-Fetch-Site: cross-site\n\n"), Err(Status::Forbidden));
        // A name of another site that was pointed at this machine.
        check("GET /?key=k1 HTTP/1.1\nHost: evil.example:7080\n\n", Err(Status::Forbidden));
        check("GET /?key=k1 HTTP/1.1\n\n", Err(Status::Forbidden));
    }

    #[test]
    fn requests_have_limits() {
        assert_eq!(head(b"GET / HTTP/1.1\r\nHost: a"), Ok(None));
        assert_eq!(head(&[&b"GET / HTTP/1.1\r\nA: "[..], &[b'x'; HEAD_MAX]].concat()), Err(Status::TooLarge));
        assert_eq!(read("PUT / HTTP/1.1\nHost: a\n\n"), Err(Status::NotAllowed));
        assert_eq!(read("POST / HTTP/1.1\nHost: a\nTransfer-Encoding: chunked\n\n"), Err(Status::BadRequest));
        assert_eq!(read("POST / HTTP/1.1\nHost: a\nContent-Length: 9000\n\n"), Err(Status::TooLarge));
        assert_eq!(read("POST / HTTP/1.1\nHost: a\nContent-Length: -1\n\n"), Err(Status::BadRequest));
        assert_eq!(read("GET / HTTP/1.1\nHost: a\nHost: b\n\n"), Err(Status::BadRequest));
        assert_eq!(head(b"\xff\xfe\r\n\r\n"), Err(Status::BadRequest));
    }

    #[test]
    fn every_answer_forbids_scripts_within_the_page() {
        for answer in [answer(Status::NotFound, "text/plain", "", b"no"), stream(), door().welcome()] {
            let text = String::from_utf8(answer).unwrap();
            assert!(
                text.contains("script-src 'self'") && !text.contains("unsafe") && text.contains("nosniff"),
                "{text}"
            );
        }
        assert_eq!(event("1-2", "{}"), b"id: 1-2\ndata: {}\n\n");
    }
}
