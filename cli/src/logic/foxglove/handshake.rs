//! The handshake of a WebSocket, and the rules for clients that may connect.
//!
//! A browser lets every page of every site open a WebSocket to this machine. The browser names the
//! page in `Origin`, so only pages of a list may connect. A name of another site that is pointed at
//! this machine has another `Host`. The system reports the user id of each program on this machine.
//! A program with another user id may connect only with the key of the link. Source: RFC 6455,
//! sections 4.2 and 10.2.

use super::protocol::PROTOCOLS;
use crate::logic::http::{self, Head, Status, is_equal};
use crate::logic::record::base64;

/// The pages that may connect unless the command says otherwise: Foxglove and Lichtblick as web applications, and as desktop
/// applications, whose page is a file. A page in a file has been opened by the user.
const ORIGINS: [&str; 4] =
    ["https://app.foxglove.dev", "https://studio.foxglove.dev", "https://lichtblick-suite.github.io", "file://"];
/// The names of this machine for itself.
const NAMES: [&str; 3] = ["localhost", "127.0.0.1", "[::1]"];
/// The text that a server adds to the key of a client. Source: RFC 6455, section 1.3.
const GUID: &str = "258EAFA5-E914-47DA-95CA-C5AB0DC85B11";
/// The only version of WebSocket.
const VERSION: &str = "13";

/// The user at the other end of a connection, as the system tells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Peer {
    /// The user of this command, or root.
    Own,
    /// Another user, or a user that the system does not report.
    Other,
}

/// The rules for clients that may connect.
#[derive(Clone, Debug)]
pub(crate) struct Entrance {
    /// The secret that lets another user in.
    pub(crate) key: String,
    /// Further pages that may connect.
    pub(crate) origins: Vec<String>,
}

/// Why a client may not connect.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Refusal {
    pub(crate) status: Status,
    /// For the person at the client.
    pub(crate) why: String,
    /// The page that is not on the list, if this is the reason.
    pub(crate) origin: Option<String>,
}

impl Entrance {
    /// Returns the answer that accepts a client.
    ///
    /// # Errors
    /// When it may not connect.
    pub(crate) fn check(&self, head: &Head, peer: Peer) -> Result<Vec<u8>, Refusal> {
        let refuse = |status, why: &str| Err(Refusal { status, why: why.to_owned(), origin: None });
        if !is_here(&head.host) {
            return refuse(Status::Forbidden, "connect to `localhost`: this server has no other name");
        }
        if let Some(origin) = head.origin.as_ref().filter(|origin| !self.is_allowed(origin)) {
            // A person may copy the words, so they never have a command that a stranger has written.
            let how = format!("; the option `--origin {origin}` allows it");
            let how = if self::origin(origin).is_ok() { how } else { String::new() };
            let why = format!("the page `{origin}` may not connect{how}");
            return Err(Refusal { status: Status::Forbidden, why, origin: Some(origin.clone()) });
        }
        let key = head.query.strip_prefix("key=").unwrap_or_default();
        if peer == Peer::Other && !is_equal(key, &self.key) {
            return refuse(
                Status::Forbidden,
                "this server is for another user of this machine; that user sees the link that lets you in",
            );
        }
        let upgrade = &head.upgrade;
        let has = |field: &str, word: &str| field.split(',').any(|one| one.trim().eq_ignore_ascii_case(word));
        let is_upgrade = !head.is_post && has(&upgrade.to, "websocket") && has(&upgrade.connection, "upgrade");
        if !is_upgrade || upgrade.version != VERSION || upgrade.key.len() != 24 {
            return refuse(
                Status::BadRequest,
                "this address is for Foxglove and Lichtblick: open a WebSocket connection to it there",
            );
        }
        let mut offered = upgrade.protocols.split(',').map(str::trim);
        let Some(protocol) = offered.find(|one| PROTOCOLS.contains(one)) else {
            let why = format!("this server speaks `{}` only", PROTOCOLS.join("` and `"));
            return refuse(Status::BadRequest, &why);
        };
        Ok(http::switch(&accept(&upgrade.key), protocol))
    }

    fn is_allowed(&self, origin: &str) -> bool {
        let own = ["http://", "https://"].into_iter().find_map(|scheme| origin.strip_prefix(scheme));
        own.is_some_and(is_here) || ORIGINS.contains(&origin) || self.origins.iter().any(|one| one == origin)
    }
}

/// Returns whether a host is this machine by a name that always means this machine, with a port or
/// without. With a forwarded port, it differs from the port of the server.
fn is_here(host: &str) -> bool {
    NAMES.into_iter().any(|name| {
        host.strip_prefix(name).is_some_and(|port| {
            port.is_empty() || port.strip_prefix(':').is_some_and(|port| port.parse::<u16>().is_ok())
        })
    })
}

/// Returns the proof that the key of a client was read.
fn accept(key: &str) -> String {
    let text = format!("{key}{GUID}");
    base64(ring::digest::digest(&ring::digest::SHA1_FOR_LEGACY_USE_ONLY, text.as_bytes()).as_ref())
}

/// Checks that a text is an origin as browsers write it: `https://example.org` or `http://robot:8080`.
///
/// # Errors
/// One sentence about the mistake.
pub(crate) fn origin(text: &str) -> Result<String, String> {
    let (scheme, host) = text.split_once("://").unwrap_or_default();
    let is_sign = |sign: char| sign.is_ascii_lowercase() || sign.is_ascii_digit() || "-.".contains(sign);
    let is_valid = scheme.chars().all(is_sign) && host.chars().all(|sign| is_sign(sign) || ":[]".contains(sign));
    if scheme.is_empty() || host.is_empty() || !is_valid {
        return Err(format!("`{text}` is not an origin; write for example `https://example.org`, without a path"));
    }
    Ok(text.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = "GET / HTTP/1.1\nHost: localhost:8765\nUpgrade: websocket\nConnection: keep-alive, Upgrade\n\
                        Sec-WebSocket-Version: 13\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\n\
                        Sec-WebSocket-Protocol: other, foxglove.sdk.v1, foxglove.websocket.v1\n";

    fn entrance() -> Entrance {
        Entrance { key: "k1".to_owned(), origins: vec!["https://viewer.example".to_owned()] }
    }

    fn checked(text: &str, peer: Peer) -> Result<String, Status> {
        let bytes = format!("{text}\n").replace('\n', "\r\n");
        let (head, _) = http::head(bytes.as_bytes())?.expect("it is whole");
        let answer = entrance().check(&head, peer).map_err(|refusal| refusal.status)?;
        Ok(String::from_utf8(answer).unwrap())
    }

    #[test]
    fn a_client_is_accepted_as_the_rfc_says() {
        let answer = checked(GOOD, Peer::Own).unwrap();
        assert!(answer.starts_with("HTTP/1.1 101 "), "{answer}");
        // The example of RFC 6455, section 1.3.
        assert!(answer.contains("Sec-WebSocket-Accept: s3pPLMBiTxaQ9kYGzzhZRbK+xOo=\r\n"), "{answer}");
        assert!(answer.contains("Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n") && answer.ends_with("\r\n\r\n"));
        let old = checked(&GOOD.replace("other, foxglove.sdk.v1, ", ""), Peer::Own).unwrap();
        assert!(old.contains("Sec-WebSocket-Protocol: foxglove.websocket.v1\r\n"), "{old}");
    }

    #[test]
    fn pages_of_other_sites_may_not_connect() {
        let check = |origin: &str, is_allowed: bool| {
            let result = checked(&format!("{GOOD}Origin: {origin}\n"), Peer::Own);
            assert_eq!(result.is_ok(), is_allowed, "{origin}");
            assert!(is_allowed || result == Err(Status::Forbidden), "{origin}");
        };
        for good in [
            "https://app.foxglove.dev",
            "https://lichtblick-suite.github.io",
            "https://viewer.example",
            "http://localhost:8080",
            "http://127.0.0.1",
            "https://[::1]:3000",
            "file://",
        ] {
            check(good, true);
        }
        for bad in [
            "https://evil.example",
            "https://app.foxglove.dev.evil.example",
            "https://evil.example/https://app.foxglove.dev",
            "http://app.foxglove.dev",
            "https://app.foxglove.dev:444",
            "http://localhost.evil.example",
            "http://localhost:8080.evil.example",
            "http://localhost:evil.example",
            "http://127.0.0.1.evil.example",
            "null",
            "",
            "ftp://localhost",
        ] {
            check(bad, false);
        }
    }

    #[test]
    fn a_name_of_another_site_that_points_here_may_not_connect() {
        for host in ["evil.example:8765", "localhost.evil.example", "127.0.0.1.evil.example:8765", "127.0.0.2:8765", ""]
        {
            let text = GOOD.replace("localhost:8765", host);
            assert_eq!(checked(&text, Peer::Own), Err(Status::Forbidden), "{host}");
        }
        for host in ["localhost", "127.0.0.1:9000", "[::1]:8765"] {
            assert!(checked(&GOOD.replace("localhost:8765", host), Peer::Own).is_ok(), "{host}");
        }
    }

    #[test]
    fn another_user_needs_the_key() {
        assert_eq!(checked(GOOD, Peer::Other), Err(Status::Forbidden));
        assert_eq!(checked(&GOOD.replace("GET /", "GET /?key=k2"), Peer::Other), Err(Status::Forbidden));
        assert!(checked(&GOOD.replace("GET /", "GET /?key=k1"), Peer::Other).is_ok());
        let elsewhere = GOOD.replace("GET /", "GET /?key=k1");
        assert_eq!(checked(&format!("{elsewhere}Origin: https://evil.example\n"), Peer::Other), Err(Status::Forbidden));
    }

    #[test]
    fn half_a_handshake_is_none() {
        for (part, other) in [
            ("Upgrade: websocket\n", ""),
            ("keep-alive, Upgrade", "keep-alive"),
            ("Version: 13", "Version: 12"),
            ("Key: dGhlIHNhbXBsZSBub25jZQ==", "Key: short"),
            ("foxglove.sdk.v1, foxglove.websocket.v1", "graphql-ws"),
            ("GET", "POST"),
        ] {
            assert_eq!(checked(&GOOD.replace(part, other), Peer::Own), Err(Status::BadRequest), "{part}");
        }
    }

    #[test]
    fn origins_are_written_as_browsers_write_them() {
        for good in ["https://viewer.example:8443", "http://[fd00::1]:80", "app://viewer"] {
            assert_eq!(origin(good), Ok(good.to_owned()));
        }
        for wrong in
            ["", "viewer.example", "https://", "https://viewer.example/", "https://a b", "null", "*", "https://a;b"]
        {
            assert!(origin(wrong).is_err(), "{wrong}");
        }
    }
}
