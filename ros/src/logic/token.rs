//! Liveliness tokens: they show that nodes, publishers, subscribers, servers and clients exist.
//!
//! Source: `rmw_zenoh`, `docs/design.md` and `rmw_zenoh_cpp/src/detail/liveliness_utils.cpp`.

use super::key::{GraphName, Topic};
use super::name::TypeName;
use super::qos::Qos;

/// The first part of every token.
const SPACE: &str = "@ros2_lv";
/// The length of the longest token that is read.
const LENGTH_MAX: usize = 2048;
/// The sign that replaces a slash in a name, and an empty name.
const SLASH: &str = "%";
/// The kind of a token of a node.
const NODE: &str = "NN";

/// A token.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Token {
    /// The domain.
    pub domain: u32,
    /// The id of the Zenoh session, as Zenoh writes it.
    pub session: String,
    /// The node, or the node to which the endpoint belongs.
    pub node: Node,
    /// The publisher, subscriber, server or client; none in the token of the node itself.
    pub endpoint: Option<Endpoint>,
}

/// A node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Node {
    /// The number of the node within the session.
    pub id: u64,
    /// The namespace, from the root; none for the root.
    pub namespace: Option<GraphName>,
    /// The name: a single word.
    pub name: String,
}

/// A publisher, a subscriber, a server or a client.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Endpoint {
    /// The number of the endpoint within the session.
    pub id: u64,
    /// The role.
    pub role: Role,
    /// The topic or service.
    pub topic: Topic,
    /// The quality of service.
    pub qos: Qos,
    /// Whether a subscriber takes buffers, see [`Topic::buffer_key`].
    pub takes_buffers: bool,
}

/// The role of an endpoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// The endpoint sends messages.
    Publisher,
    /// The endpoint receives messages.
    Subscriber,
    /// The endpoint answers calls of a service.
    Server,
    /// The endpoint calls a service.
    Client,
}

impl Role {
    const ALL: [Self; 4] = [Self::Publisher, Self::Subscriber, Self::Server, Self::Client];

    fn as_str(self) -> &'static str {
        match self {
            Self::Publisher => "MP",
            Self::Subscriber => "MS",
            Self::Server => "SS",
            Self::Client => "SC",
        }
    }
}

impl Token {
    /// Returns the key expression for all tokens of a domain.
    pub fn all(domain: u32) -> String {
        format!("{SPACE}/{domain}/**")
    }

    /// Returns the key of the token.
    pub fn key(&self) -> String {
        let Self { domain, session, node, endpoint } = self;
        let namespace = node.namespace.as_ref().map_or_else(|| SLASH.to_owned(), |name| mangled(name.as_str()));
        let of_node = |id: u64, kind: &str| {
            format!("{SPACE}/{domain}/{session}/{}/{id}/{kind}/{SLASH}/{namespace}/{}", node.id, node.name)
        };
        let Some(endpoint) = endpoint else { return of_node(node.id, NODE) };
        let Endpoint { id, role, topic, qos, takes_buffers } = endpoint;
        let buffers = if *takes_buffers { "/backends:cpu:" } else { "" };
        let (name, of, hash) = (mangled(topic.name.as_str()), topic.of.dds(), &topic.hash);
        format!("{}/{name}/{of}/{hash}/{qos}{buffers}", of_node(*id, role.as_str()))
    }

    /// Reads the key of a token. Returns none for another key, and for a type whose name ROS 2 does not allow.
    pub fn parse(key: &str) -> Option<Self> {
        if key.len() > LENGTH_MAX {
            return None;
        }
        let mut parts = key.split('/');
        let mut next = || parts.next();
        (next()? == SPACE).then_some(())?;
        let domain = next()?.parse().ok()?;
        let session = next().filter(|id| !id.is_empty() && id.bytes().all(|byte| byte.is_ascii_hexdigit()))?.to_owned();
        let (node_id, id, kind) = (next()?.parse().ok()?, next()?.parse().ok()?, next()?);
        // The enclave says which keys a process has. It is not needed here.
        next()?;
        let namespace = match next()? {
            SLASH => None,
            mangled => Some(GraphName::parse(&plain(mangled))?),
        };
        let name = GraphName::parse(next()?)?.words().to_owned();
        let node = Node { id: node_id, namespace, name };
        let role = Role::ALL.into_iter().find(|role| role.as_str() == kind);
        let endpoint = match role {
            None if kind == NODE => None,
            None => return None,
            Some(role) => {
                let (name, of, hash) = (GraphName::parse(&plain(next()?))?, TypeName::parse_dds(next()?)?, next()?);
                let topic = Topic { name, of, hash: hash.to_owned() };
                let qos = Qos::parse(next()?)?;
                let takes_buffers = next().is_some_and(|backends| backends.split(':').any(|backend| backend == "cpu"));
                Some(Endpoint { id, role, topic, qos, takes_buffers })
            }
        };
        // Later versions may append parts.
        Some(Self { domain, session, node, endpoint })
    }
}

fn mangled(name: &str) -> String {
    name.replace('/', SLASH)
}

fn plain(name: &str) -> String {
    name.replace(SLASH, "/")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const STRING: &str = "std_msgs::msg::dds_::String_/RIHS01_df668c74";

    fn node() -> Token {
        let node = Node { id: 3, namespace: None, name: "talker".to_owned() };
        Token { domain: 2, session: "aac3178e146ba6f1fc6e6a4085e77f21".to_owned(), node, endpoint: None }
    }

    fn endpoint(role: Role, takes_buffers: bool) -> Token {
        let (name, of) = (GraphName::parse("/robot1/chatter").unwrap(), TypeName::parse("std_msgs/String").unwrap());
        let topic = Topic { name, of, hash: "RIHS01_df668c74".to_owned() };
        let qos = Qos { depth: 7, ..Qos::default() };
        Token { endpoint: Some(Endpoint { id: 10, role, topic, qos, takes_buffers }), ..node() }
    }

    #[track_caller]
    fn check(token: &Token, key: &str) {
        assert_eq!(token.key(), key);
        assert_eq!(Token::parse(key).as_ref(), Some(token));
    }

    #[test]
    fn tokens_of_nodes_and_of_endpoints() {
        let id = "aac3178e146ba6f1fc6e6a4085e77f21";
        check(&node(), &format!("@ros2_lv/2/{id}/3/3/NN/%/%/talker"));
        let mut inner = node();
        inner.node.namespace = GraphName::parse("/a/b");
        check(&inner, &format!("@ros2_lv/2/{id}/3/3/NN/%/%a%b/talker"));
        for (role, kind) in [(Role::Publisher, "MP"), (Role::Server, "SS"), (Role::Client, "SC")] {
            let key = format!("@ros2_lv/2/{id}/3/10/{kind}/%/%/talker/%robot1%chatter/{STRING}/::,7:,:,:,,");
            check(&endpoint(role, false), &key);
        }
        let key = format!("@ros2_lv/2/{id}/3/10/MS/%/%/talker/%robot1%chatter/{STRING}/::,7:,:,:,,/backends:cpu:");
        check(&endpoint(Role::Subscriber, true), &key);
        let other = key.replace("/%/%/talker", "/%enclave/%/talker");
        assert_eq!(Token::parse(&other), Some(endpoint(Role::Subscriber, true)));
        assert_eq!(Token::parse(&format!("{key}/more")), Some(endpoint(Role::Subscriber, true)));
    }

    #[test]
    fn other_keys_are_refused() {
        let whole = endpoint(Role::Publisher, false).key();
        let last = whole.rfind('/').unwrap();
        for end in (0..last).filter(|end| whole.is_char_boundary(*end)) {
            // This prefix may be a valid token of a node, but then it is of another kind.
            assert_eq!(Token::parse(&whole[..end]), None, "{}", &whole[..end]);
        }
        for (from, to) in [
            ("@ros2_lv", "@ros2"),
            ("/2/", "/-2/"),
            ("aac3", "**"),
            ("MP", "MX"),
            ("talker", "ta lker"),
            ("::,7", "::,x"),
            ("dds_", "dds"),
        ] {
            assert_eq!(Token::parse(&whole.replacen(from, to, 1)), None, "{to}");
        }
        assert_eq!(Token::parse(&whole.replace("chatter", &"c".repeat(4096))), None);
    }

    proptest! {
        #[test]
        fn any_text_is_read_or_refused(text in "(@ros2_lv/[0-9]{1,3}/[a-f0-9]{1,4}/[0-9]/[0-9]/(NN|MP|SS)/[%a]{0,3}/[%a/]{0,5}){0,1}.{0,40}") {
            if let Some(token) = Token::parse(&text) {
                prop_assert_eq!(Token::parse(&token.key()), Some(token));
            }
        }
    }
}
