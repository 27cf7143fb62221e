//! The configuration of zenoh sessions. Figures were measured on zenoh 1.10.2.

use super::OpenError;
use std::path::Path;
use zenoh::Config;

/// How long a session may be silent before its peer gives it up. Over a new link, a peer receives
/// nothing for a round trip, which takes up to 3 s. The lease is longer. A cut is noticed earlier,
/// see `patience`.
const LEASE_MS: u32 = 5000;
/// The same for nodes. Each node is linked to every other one, and the links are mostly idle. Over IPv6, a keep-alive
/// takes 175 bytes on the cable of each link, including the answers of TCP.
const NODE_LEASE_MS: u32 = 15_000;
/// How often an idle session sends a keep-alive, so that the system soon notices that nothing arrives.
const WORD_EVERY_MS: u32 = 250;
/// The same for nodes. A node that watches another one asks it for more frequent beats, see
/// [`Session::beat`](super::Session::beat).
const NODE_WORD_EVERY_MS: u32 = 7500;
/// The longest path of a Unix socket. Source: unix(7), `sun_path` without its final zero.
const SOCKET_PATH_SIZE_MAX: usize = 107;

/// How many connections of unknown peers may be open, each for up to 7 s. Zenoh's own limit of 100 is reached in a moment.
const ACCEPT_PENDING_MAX: &str = "28672";

/// A zenoh configuration under construction.
pub(crate) struct Settings(Config);

impl Settings {
    fn new(mode: &str, [lease_ms, word_every_ms]: [u32; 2]) -> Self {
        Self(Config::default())
            .text("mode", mode)
            .set("scouting/gossip/enabled", "false")
            .set("listen/endpoints", "[]")
            // Known peers are dialled in the background, with retries. Opening the session does not wait for them.
            .set("connect/timeout_ms", "-1")
            .set("connect/exit_on_failure", "false")
            .set("connect/retry", "{ period_init_ms: 100, period_max_ms: 500, period_increase_factor: 1.5 }")
            .set("open/return_conditions/connect_scouted", "false")
            // `nearby` finds the nodes. Zenoh itself knows only IPv4, and only the interfaces that existed when it
            // started.
            .set("scouting/delay", "0")
            .set("scouting/multicast/enabled", "false")
            .set("transport/link/tx/lease", &lease_ms.to_string())
            .set("transport/link/tx/keep_alive", &(lease_ms / word_every_ms).to_string())
            // Connections that send nothing must not prevent the next connection.
            .set("transport/unicast/accept_pending", ACCEPT_PENDING_MAX)
            // Three round trips of 3 s, and two for the accepting side. An address that does not answer is not dialled,
            // see `reach`.
            .set("transport/unicast/open_timeout", "10000")
            .set("transport/unicast/accept_timeout", "7000")
    }

    /// A node: a peer in the clique, in which all nodes are linked to each other.
    pub(super) fn node() -> Self {
        // On a radio of 50 kbit/s, the longest message of a node still arrives within a lease. This matters because a
        // partial message is not a sign of life.
        Self::new("peer", [NODE_LEASE_MS, NODE_WORD_EVERY_MS])
            .set("transport/link/tx/batch_size", "16384")
            // A message is sent at once if possible. Otherwise it shares a batch with the next messages.
            .set("transport/link/tx/queue/batching/time_limit", "0")
            // 256 KiB of answers: everything that is in transit to a few command lines. So a relay does not wait.
            .set("transport/link/tx/queue/size/data_low", "16")
    }

    /// A controller's data session: it discovers no session, and no session discovers it.
    pub(crate) fn data() -> Self {
        // Programs on one host notice a crash by the closed socket. The lease is for suspended peers.
        Self::new("peer", [LEASE_MS, WORD_EVERY_MS])
            // As for nodes.
            .set("transport/link/tx/queue/batching/time_limit", "0")
    }

    /// A command line, through the node at `locator`.
    pub(super) fn client(locator: &str) -> Self {
        Self::new("client", [1000, WORD_EVERY_MS])
            .set("connect/timeout_ms", "0")
            .set("connect/exit_on_failure", "true")
            .set("connect/endpoints", &list(&[locator.to_owned()]))
    }

    pub(crate) fn listen(self, locators: &[String]) -> Self {
        self.set("listen/endpoints", &list(locators)).set("listen/exit_on_failure", "true")
    }

    pub(super) fn connect(self, locators: &[String]) -> Self {
        self.set("connect/endpoints", &list(locators))
    }

    fn text(self, key: &str, value: &str) -> Self {
        let value = quote(value);
        self.set(key, &value)
    }

    fn set(mut self, key: &str, value: &str) -> Self {
        self.0.insert_json5(key, value).expect("every key and value in this file is one that zenoh 1.10.2 knows");
        self
    }

    pub(super) fn into_config(self) -> Config {
        self.0
    }
}

/// Returns the locator of a Unix socket.
pub(crate) fn unix_locator(path: &Path) -> Result<String, OpenError> {
    let bad = |problem| OpenError::SocketPath { path: path.to_owned(), problem };
    let text = path.to_str().ok_or_else(|| bad("it is not UTF-8"))?;
    if text.len() > SOCKET_PATH_SIZE_MAX {
        return Err(bad("it is longer than the 107 bytes that Linux allows"));
    }
    if !path.is_absolute() {
        return Err(bad("it is not absolute"));
    }
    if text.contains(['?', '#', ';']) {
        return Err(bad("zenoh cannot take `?`, `#` and `;` in it"));
    }
    Ok(format!("unixsock-stream/{text}"))
}

fn list(texts: &[String]) -> String {
    let quoted: Vec<String> = texts.iter().map(|text| quote(text)).collect();
    format!("[{}]", quoted.join(","))
}

fn quote(text: &str) -> String {
    let mut quoted = String::from("\"");
    for c in text.chars() {
        if c == '"' || c == '\\' || c.is_control() {
            quoted.push_str(&format!("\\u{:04x}", u32::from(c)));
        } else {
            quoted.push(c);
        }
    }
    quoted.push('"');
    quoted
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_setting_is_known_to_zenoh() {
        let locators = ["unixsock-stream//run/a \"quoted\" \\ path".to_owned()];
        let settings = Settings::node().listen(&locators).connect(&locators);
        assert!(settings.into_config().to_string().contains("a \\\"quoted\\\" \\\\ path"));
        Settings::client("unixsock-stream//run/x");
        Settings::data();
    }

    #[test]
    fn socket_paths() {
        let check = |path: &str| unix_locator(Path::new(path)).map_err(|error| error.to_string());
        assert_eq!(check("/run/x.sock").unwrap(), "unixsock-stream//run/x.sock");
        assert_eq!(check("x.sock").unwrap_err(), "the socket path `x.sock` cannot be used: it is not absolute");
        assert!(check("/run/x?y").is_err() && check(&format!("/{}", "x".repeat(107))).is_err());
    }
}
