//! Key expressions: the only place where they are built and read.
//!
//! ```text
//! dca/n/<host>/rpc/<verb>            a call to a node
//! <any key that is called>/s!/<session>  the same, to one of those that serve it
//! dca/n/<host>/in                    messages from node to node
//! dca/n/<host>/ping                  a node asks who is there
//! dca/n/<host>/asked                 another node asks whether this one is there
//! dca/n/<host>/pong                  answers to both
//! dca/n/<host>/beat                  others let this node hear of them, all the time
//! dca/n/<host>/namesake              what nodes of one name say to each other
//! dca/n/<host>/revoked               a node has heard of keys that its team has revoked
//! dca/n/<host>/audit                 where the audit log of a node has come to
//! dca/n/<host>/countersigned         the same, signed by others
//! dca/n/<host>/renew                 a node wants its certificate renewed
//! dca/n/<host>/renewed               its certificate, renewed by others
//! dca/n/<host>/refused               others have refused what a node has said
//! dca/live/<host>/<boot>             a node is up
//! dca/d/<deployment>/<epoch>/w/<wire>  samples of one wire
//! dca/d/<deployment>/<epoch>/w/<wire>/type  what its consumer takes
//! dca/d/<deployment>/<epoch>/w/<wire>/seen  its values, for people, in a team
//! dca/db/<team>/news/<origin>        what a replica of the database tells everybody
//! dca/db/<team>/to|ask/<origin>      what one is told, and asked
//! dca/<robot>/hw/<device>/state|cmd  a device; `<robot>` starts with `_` if it is one of the words above
//! dca/<robot>/signals/<instance path>  what a program shows to people
//! dca/<robot>/outputs/<instance path>  which outputs a program has
//! dca/<robot>/tap/<output>/<instance path>  the values of an output, for people
//! dca/<robot>/call/<instance path>     calls of what a program exports
//! dca/<robot>/cancel/<instance path>   whose callers wait no more
//! dca/<robot>/exports/<instance path>  what a program exports
//! ```
//!
//! Users choose names, and in a key expression `/ * $ # ? @` have a meaning. So every name is escaped.
//! Letters, digits, `_`, `-` and `.` are unchanged. Any other byte becomes `%` and two hex digits. An
//! empty name becomes `%`. Escaping is one-to-one: different names never share a key, and no name can match
//! the key of another name.

use std::fmt;
use thiserror::Error;

/// The longest host name. Source: RFC 1123, the length of one label.
pub const HOST_NAME_SIZE_MAX: usize = 63;
/// Separates a key from the id of a session that serves it. No name can contain it.
const SESSION: &str = "/s!/";
/// First words that a robot's name must not take.
const RESERVED: [&str; 4] = ["n", "live", "d", "db"];

/// The name of a host: letters, digits, `_`, `-` and `.`; it starts with a letter or digit.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct HostName(String);

/// Why a text is not a host name.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("`{text}` is not a host name: {problem}")]
pub struct HostNameError {
    text: String,
    problem: &'static str,
}

/// The side of a device that a key belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Channel {
    /// The owner speaks.
    State,
    /// The owner listens.
    Command,
}

impl HostName {
    /// Reads a host name.
    ///
    /// # Errors
    /// The first mistake in the name.
    pub fn parse(text: &str) -> Result<Self, HostNameError> {
        let first = |c: char| c.is_ascii_alphanumeric();
        let problem = if text.is_empty() {
            "it is empty"
        } else if text.len() > HOST_NAME_SIZE_MAX {
            "it is longer than 63 characters"
        } else if !text.starts_with(first) {
            "it must start with a letter or digit"
        } else if !text.bytes().all(is_plain) {
            "only letters, digits, `_`, `-` and `.` are allowed"
        } else {
            return Ok(Self(text.to_owned()));
        };
        Err(HostNameError { text: text.to_owned(), problem })
    }

    /// Returns the name.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for HostName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl Channel {
    fn word(self) -> &'static str {
        match self {
            Self::State => "state",
            Self::Command => "cmd",
        }
    }
}

/// Returns the key of calls to a node.
pub fn rpc(host: &str, verb: &str) -> String {
    format!("dca/n/{}/rpc/{}", escape(host), escape(verb))
}

/// Returns the key expression of calls to a node, for all verbs.
pub fn rpc_any(host: &str) -> String {
    format!("dca/n/{}/rpc/*", escape(host))
}

/// Returns the host and the verb of a call's key.
pub fn parse_rpc(key: &str) -> Option<(String, String)> {
    let (host, verb) = key.strip_prefix("dca/n/")?.split_once("/rpc/")?;
    Some((unescape(host)?, unescape(verb)?))
}

/// Returns the key of calls to the server of `key` in the session with this id.
pub fn of_session(key: &str, session: &str) -> String {
    format!("{key}{SESSION}{session}")
}

/// Returns the called key, without the session if it names one.
pub fn without_session(key: &str) -> &str {
    key.split_once(SESSION).map_or(key, |(key, _)| key)
}

/// Returns the key of messages to a node from other nodes.
pub fn inbox(host: &str) -> String {
    format!("dca/n/{}/in", escape(host))
}

/// Returns the key on which a node sends the revoked keys to the other nodes of its team.
pub fn revoked(host: &str) -> String {
    format!("dca/n/{}/revoked", escape(host))
}

/// Returns the key on which a node learns that others have refused its messages.
pub fn refused(host: &str) -> String {
    format!("dca/n/{}/refused", escape(host))
}

/// Returns the key on which a node publishes the position of its audit log to its team.
pub fn audit(host: &str) -> String {
    format!("dca/n/{}/audit", escape(host))
}

/// Returns the expression of all keys on which nodes publish the positions of their audit logs.
pub fn audit_any() -> String {
    "dca/n/*/audit".to_owned()
}

/// Returns the key on which a node receives the signatures of others on the head of its audit log.
pub fn countersigned(host: &str) -> String {
    format!("dca/n/{}/countersigned", escape(host))
}

/// Returns the key on which a node asks the other nodes of its team to renew its certificate.
pub fn renew(host: &str) -> String {
    format!("dca/n/{}/renew", escape(host))
}

/// Returns the expression of all keys on which nodes ask for a renewal.
pub fn renew_any() -> String {
    "dca/n/*/renew".to_owned()
}

/// Returns the key on which a node receives its renewed certificate.
pub fn renewed(host: &str) -> String {
    format!("dca/n/{}/renewed", escape(host))
}

/// Returns the expression of all keys on which nodes send revoked keys.
pub fn revoked_any() -> String {
    "dca/n/*/revoked".to_owned()
}

/// Returns the key on which a node asks which nodes are running.
pub fn ping(host: &str) -> String {
    format!("dca/n/{}/ping", escape(host))
}

/// Returns the expression of all keys on which nodes ask which nodes are running.
pub fn ping_any() -> String {
    "dca/n/*/ping".to_owned()
}

/// Returns the key on which a node is asked whether it is running.
pub fn asked(host: &str) -> String {
    format!("dca/n/{}/asked", escape(host))
}

/// Returns the key on which a node receives the answers to its questions for running nodes.
pub fn pong(host: &str) -> String {
    format!("dca/n/{}/pong", escape(host))
}

/// Returns the key on which others send their beats to a node.
pub fn beat(host: &str) -> String {
    format!("dca/n/{}/beat", escape(host))
}

/// Returns the key on which nodes of the same name send messages to each other.
pub fn namesake(host: &str) -> String {
    format!("dca/n/{}/namesake", escape(host))
}

/// Returns the key that announces that a node is running.
pub fn live(host: &str, boot: u64) -> String {
    format!("dca/live/{}/{boot:016x}", escape(host))
}

/// Returns the expression of the keys that announce running nodes.
pub fn live_any() -> String {
    "dca/live/*/*".to_owned()
}

/// Returns the host and the boot number of a [`live`] key.
pub fn parse_live(key: &str) -> Option<(String, u64)> {
    let (host, boot) = key.strip_prefix("dca/live/")?.split_once('/')?;
    if boot.len() != 16 {
        return None;
    }
    Some((unescape(host)?, u64::from_str_radix(boot, 16).ok()?))
}

/// Returns the key of the samples of one wire of a deployment.
pub fn wire(deployment: &str, epoch: u64, wire: u32) -> String {
    format!("dca/d/{}/{epoch}/w/{wire}", escape(deployment))
}

/// Returns the number of the wire with this key; none if the key does not belong to a wire.
pub fn parse_wire(key: &str) -> Option<u32> {
    let mut parts = key.strip_prefix("dca/d/")?.split('/').skip(2);
    let (kind, number) = (parts.next()?, parts.next()?);
    let wire: u32 = number.parse().ok()?;
    (kind == "w" && parts.next().is_none() && number == wire.to_string()).then_some(wire)
}

/// Returns the key on which the consumer of a wire answers with the type of the values that it accepts.
pub fn wire_type(wire: &str) -> String {
    format!("{wire}/type")
}

/// Returns the key of a wire's values for people, if the values themselves are sealed for the consumer.
pub fn wire_seen(wire: &str) -> String {
    format!("{wire}/seen")
}

/// Returns the key on which a replica sends to all replicas of a team's database.
pub fn db_news(team: &str, origin: u64) -> String {
    format!("dca/db/{}/news/{origin:016x}", escape(team))
}

/// Returns the expression of the keys on which replicas send to all others.
pub fn db_news_any(team: &str) -> String {
    format!("dca/db/{}/news/*", escape(team))
}

/// Returns the key of messages to one replica.
pub fn db_inbox(team: &str, origin: u64) -> String {
    format!("dca/db/{}/to/{origin:016x}", escape(team))
}

/// Returns the key of questions to one replica.
pub fn db_ask(team: &str, origin: u64) -> String {
    format!("dca/db/{}/ask/{origin:016x}", escape(team))
}

/// Returns the key of one side of a device.
pub fn hardware(robot: &str, device: &str, channel: Channel) -> String {
    format!("dca/{}/hw/{}/{}", robot_name(robot), escape(device), channel.word())
}

/// Returns the key of the signals of one program; `instance` is its path, such as `main/arm/force`.
pub fn signals(robot: &str, instance: &str) -> String {
    format!("dca/{}/signals/{}", robot_name(robot), escape_path(instance))
}

/// Returns the key on which a program answers with the list of its outputs.
pub fn outputs(robot: &str, instance: &str) -> String {
    format!("dca/{}/outputs/{}", robot_name(robot), escape_path(instance))
}

/// Returns the key of the values of one output of a program, for people.
pub fn tap(robot: &str, instance: &str, output: &str) -> String {
    format!("dca/{}/tap/{}/{}", robot_name(robot), escape(output), escape_path(instance))
}

/// The two keys of a program with exports.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ObjectKeys {
    /// The key on which the program is called.
    pub call: String,
    /// The key on which the program receives cancellations of calls.
    pub cancel: String,
}

/// Returns the keys of a program with exports.
pub fn object(robot: &str, instance: &str) -> ObjectKeys {
    let key = |word| format!("dca/{}/{word}/{}", robot_name(robot), escape_path(instance));
    ObjectKeys { call: key("call"), cancel: key("cancel") }
}

/// Returns the key on which a program lists its exports.
pub fn exports(robot: &str, instance: &str) -> String {
    format!("dca/{}/exports/{}", robot_name(robot), escape_path(instance))
}

fn escape_path(instance: &str) -> String {
    instance.split('/').map(escape).collect::<Vec<_>>().join("/")
}

/// Returns the instance path of a [`signals`] key.
pub fn parse_signals(key: &str) -> Option<String> {
    let (_, path) = key.strip_prefix("dca/")?.split_once("/signals/")?;
    let path: Option<Vec<String>> = path.split('/').map(unescape).collect();
    path.map(|path| path.join("/"))
}

/// Returns the key's part for a robot. A reserved word gets `_` in front; the result is still unique.
fn robot_name(robot: &str) -> String {
    let bare = robot.trim_start_matches('_');
    let prefix = if RESERVED.contains(&bare) { "_" } else { "" };
    format!("{prefix}{}", escape(robot))
}

fn is_plain(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b'-' | b'.')
}

fn escape(name: &str) -> String {
    if name.is_empty() {
        return "%".to_owned();
    }
    let mut escaped = String::with_capacity(name.len());
    for byte in name.bytes() {
        if is_plain(byte) {
            escaped.push(char::from(byte));
        } else {
            const HEX: &[u8; 16] = b"0123456789abcdef";
            escaped.push('%');
            escaped.push(char::from(HEX[usize::from(byte >> 4)]));
            escaped.push(char::from(HEX[usize::from(byte & 15)]));
        }
    }
    escaped
}

fn unescape(escaped: &str) -> Option<String> {
    if escaped == "%" {
        return Some(String::new());
    }
    let mut bytes = Vec::with_capacity(escaped.len());
    let mut rest = escaped.bytes();
    while let Some(byte) = rest.next() {
        bytes.push(match byte {
            b'%' => {
                let mut digit = || rest.next().and_then(|digit| char::from(digit).to_digit(16));
                u8::try_from(digit()? * 16 + digit()?).ok()?
            }
            plain if is_plain(plain) => plain,
            _ => return None,
        });
    }
    let name = String::from_utf8(bytes).ok()?;
    // Only the form that `escape` writes is accepted, so each name has one key.
    (escape(&name) == escaped).then_some(name)
}

#[cfg(all(test, feature = "zenoh"))]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use zenoh::key_expr::KeyExpr;

    #[test]
    fn keys_as_written_in_the_tour() {
        assert_eq!(rpc("c1", "deploy"), "dca/n/c1/rpc/deploy");
        assert_eq!(inbox("c1"), "dca/n/c1/in");
        assert_eq!(live("c1", 255), "dca/live/c1/00000000000000ff");
        assert_eq!(wire("door", 2, 17), "dca/d/door/2/w/17");
        assert_eq!(wire_type(&wire("door", 2, 17)), "dca/d/door/2/w/17/type");
        assert_eq!(db_news("dca", 255), "dca/db/dca/news/00000000000000ff");
        assert_eq!(db_ask("dca", 255), "dca/db/dca/ask/00000000000000ff");
        assert_eq!(hardware("door", "arm", Channel::State), "dca/door/hw/arm/state");
        assert_eq!(hardware("live", "arm", Channel::Command), "dca/_live/hw/arm/cmd");
        assert_eq!(signals("door", "main/hit/force"), "dca/door/signals/main/hit/force");
        assert_eq!(signals("door", "main/hold[2]"), "dca/door/signals/main/hold%5b2%5d");
        assert_eq!(outputs("n", "main/hold[2]"), "dca/_n/outputs/main/hold%5b2%5d");
        let keys = object("door", "main/hold[2]");
        assert_eq!(keys.call, "dca/door/call/main/hold%5b2%5d");
        assert_eq!(keys.cancel, "dca/door/cancel/main/hold%5b2%5d");
        assert_eq!(exports("db", "main/a"), "dca/_db/exports/main/a");
        assert_eq!(tap("door", "main/plant", "arm/state"), "dca/door/tap/arm%2fstate/main/plant");
    }

    #[test]
    fn host_names() {
        for name in ["c1", "192.168.0.7", "arm-left_2"] {
            assert_eq!(HostName::parse(name).unwrap().as_str(), name);
        }
        for name in ["", "a/b", "*", "-a", "a@b", "a b", "é", &"a".repeat(64)] {
            assert!(HostName::parse(name).is_err(), "{name}");
        }
    }

    #[test]
    fn foreign_keys_are_not_read() {
        assert_eq!(parse_live("dca/live/c1/ff"), None);
        assert_eq!(parse_live("dca/n/c1/in"), None);
        assert_eq!(parse_rpc("dca/n/c1/in"), None);
        for key in ["dca/d/a/1/w/03", "dca/d/a/1/w/+3", "dca/d/a/1/w/3/type", "dca/d/a/1/x/3", "hop/3"] {
            assert_eq!(parse_wire(key), None, "{key}");
        }
        assert_eq!(parse_rpc("dca/n/%zz/rpc/stop"), None);
        assert_eq!(parse_rpc("dca/n/%63/rpc/stop"), None, "`c` is written `c`, not `%63`");
    }

    proptest! {
        #[test]
        fn every_name_gives_a_plain_key_and_comes_back(a in ".*", b in ".*", boot: u64) {
            for key in [rpc(&a, &b), inbox(&a), ping(&a), asked(&a), pong(&a), beat(&a), live(&a, boot), wire(&a, boot, 3), signals(&a, &b),
                        db_news(&a, boot), db_inbox(&a, boot), db_ask(&a, boot), hardware(&a, &b, Channel::State)] {
                let key = KeyExpr::try_from(key).unwrap();
                prop_assert!(!key.is_wild());
            }
            prop_assert_eq!(parse_rpc(&rpc(&a, &b)), Some((a.clone(), b.clone())));
            let called = rpc(&a, &b);
            let of_session = of_session(&called, "ff");
            prop_assert!(!KeyExpr::try_from(of_session.as_str()).unwrap().is_wild());
            prop_assert_eq!([without_session(&of_session), without_session(&called)], [&called, &called]);
            prop_assert_eq!(parse_live(&live(&a, boot)), Some((a.clone(), boot)));
            prop_assert_eq!(parse_signals(&signals(&a, &b)), Some(b.clone()));
            prop_assert_eq!(parse_wire(&wire(&a, boot, 3)), Some(3));
            prop_assert_eq!(inbox(&a) == inbox(&b), a == b);
            prop_assert_eq!(hardware(&a, "x", Channel::State) == hardware(&b, "x", Channel::State), a == b);
        }

        #[test]
        fn robots_stay_apart_from_our_words(a in "_{0,3}(n|live|db?|door)", b in "_{0,3}(n|live|db?|door)") {
            prop_assert_eq!(signals(&a, "x") == signals(&b, "x"), a == b);
            let first = signals(&a, "x").split('/').nth(1).unwrap().to_owned();
            prop_assert!(!RESERVED.contains(&first.as_str()));
        }
    }
}
