//! How sessions are configured. Measured on zenoh 1.10.2.

use super::OpenError;
use std::path::Path;
use zenoh::Config;

/// The multicast group on which nodes find each other: DCA's own, so that other zenoh programs stay apart.
const MULTICAST_GROUP: &str = "224.0.0.231:7999";
/// The longest path of a Unix socket. Source: unix(7), `sun_path` less its final zero.
const SOCKET_PATH_SIZE_MAX: usize = 107;

/// How many connections may be open that have not said who they are; zenoh's own 100 are gone in a moment.
const ACCEPT_PENDING_MAX: &str = "4096";

/// A zenoh configuration under construction.
pub(crate) struct Settings(Config);

/// What a session does about others that it has not been told of.
pub(super) enum Scouting {
    Off,
    /// Answers and asks.
    On,
    /// Asks only.
    Ask,
}

impl Settings {
    fn new(mode: &str, lease_ms: u32) -> Self {
        Self(Config::default())
            .text("mode", mode)
            .set("scouting/gossip/enabled", "false")
            .set("listen/endpoints", "[]")
            // Known peers are dialled in the background, again and again; nobody waits for them.
            .set("connect/timeout_ms", "-1")
            .set("connect/exit_on_failure", "false")
            .set("connect/retry", "{ period_init_ms: 100, period_max_ms: 500, period_increase_factor: 1.5 }")
            .set("open/return_conditions/connect_scouted", "false")
            .set("transport/link/tx/lease", &lease_ms.to_string())
            .set("transport/link/tx/keep_alive", "4")
            // Who connects and says nothing must not keep out who comes next.
            .set("transport/unicast/accept_pending", ACCEPT_PENDING_MAX)
            // A machine that starts many programs at once is slow to answer; a radio that is gone never answers.
            .set("transport/unicast/open_timeout", "1000")
            .set("transport/unicast/accept_timeout", "1000")
    }

    /// A node: a peer in the clique of all nodes.
    pub(super) fn node(scouting: Scouting) -> Self {
        Self::new("peer", 1000).scouting(scouting)
    }

    /// A controller's data session: it finds nobody and is found by nobody.
    pub(crate) fn data() -> Self {
        // Programs of one host notice a crash by the closed socket; the lease is for cut links, and is not so short that
        // a busy machine looks like one.
        Self::new("peer", 2000).scouting(Scouting::Off)
    }

    /// A command line, through the node at `locator`.
    pub(super) fn client(locator: &str) -> Self {
        Self::new("client", 1000)
            .scouting(Scouting::Off)
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

    /// Waits in `open` for the first peers that scouting finds, or for this long.
    pub(super) fn await_peers(self, millis: u32) -> Self {
        self.set("open/return_conditions/connect_scouted", "true").set("scouting/delay", &millis.to_string())
    }

    fn scouting(self, scouting: Scouting) -> Self {
        let (enabled, listen) = match scouting {
            Scouting::Off => ("false", "false"),
            Scouting::On => ("true", "true"),
            Scouting::Ask => ("true", "false"),
        };
        self.set("scouting/delay", "0")
            .set("scouting/multicast/enabled", enabled)
            .set("scouting/multicast/listen", listen)
            .text("scouting/multicast/address", MULTICAST_GROUP)
            // Both sides dial what they find. With `greater-zid` a newcomer with a smaller id would have to wait until
            // the others ask again, which is up to 8 s.
            .set("scouting/multicast/autoconnect", "{ peer: [\"peer\"] }")
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
        let settings = Settings::node(Scouting::On).listen(&locators).connect(&locators);
        assert!(settings.into_config().to_string().contains("a \\\"quoted\\\" \\\\ path"));
        Settings::node(Scouting::Ask).await_peers(300);
        Settings::client("unixsock-stream//run/x");
        Settings::data();
    }

    #[test]
    fn socket_paths() {
        let check = |path: &str| unix_locator(Path::new(path)).map_err(|error| error.to_string());
        assert_eq!(check("/run/x.sock").unwrap(), "unixsock-stream//run/x.sock");
        assert_eq!(check("x.sock").unwrap_err(), "the socket path \"x.sock\" cannot be used: it is not absolute");
        assert!(check("/run/x?y").is_err() && check(&format!("/{}", "x".repeat(107))).is_err());
    }
}
