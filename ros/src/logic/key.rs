//! Keys of topics and services: `0/cmd_vel/geometry_msgs::msg::dds_::Twist_/RIHS01_…`.
//!
//! Source: `rmw_zenoh`, `docs/design.md`.

use super::name::TypeName;
use std::fmt;

/// The longest name of a topic that ROS 2 allows.
const LENGTH_MAX: usize = 247;

/// The name of a topic, a service or a node, from the root: `/robot1/cmd_vel`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct GraphName(String);

impl GraphName {
    /// Reads a name; the slash in front may be missing. Returns none if a word contains other characters than letters, digits and `_` or
    /// begins with a digit, and if the name is longer than ROS 2 allows.
    pub fn parse(text: &str) -> Option<Self> {
        let words = text.strip_prefix('/').unwrap_or(text);
        let is_fit = words.len() < LENGTH_MAX && words.split('/').all(is_word);
        is_fit.then(|| Self(format!("/{words}")))
    }

    /// Returns the name with its slash.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// Returns the name without its slash, as in keys.
    pub fn words(&self) -> &str {
        self.0.trim_start_matches('/')
    }
}

impl fmt::Display for GraphName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

fn is_word(word: &str) -> bool {
    let is_fit = |character: char| character.is_ascii_alphanumeric() || character == '_';
    word.starts_with(|first: char| first.is_ascii_alphabetic() || first == '_') && word.chars().all(is_fit)
}

/// A topic or a service with its type.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Topic {
    /// The name.
    pub name: GraphName,
    /// The type.
    pub of: TypeName,
    /// The hash of the type: `RIHS01_…`, or `TypeHashNotSupported` for Humble.
    pub hash: String,
}

impl Topic {
    /// Returns the key of the topic's messages in a domain.
    pub fn key(&self, domain: u32) -> String {
        format!("{domain}/{}/{}/{}", self.name.words(), self.of.dds(), self.hash)
    }

    /// Returns the key for newer publishers of images and clouds of points. On it they send to subscribers that declare that they take
    /// buffers.
    pub fn buffer_key(&self, domain: u32) -> String {
        format!("{}/_buf_cpu", self.key(domain))
    }

    /// Reads a key; also returns the domain.
    pub fn parse(key: &str) -> Option<(u32, Self)> {
        let key = key.strip_suffix("/_buf_cpu").unwrap_or(key);
        let (key, hash) = key.rsplit_once('/')?;
        let (key, of) = key.rsplit_once('/')?;
        let (domain, name) = key.split_once('/')?;
        let (name, of) = (GraphName::parse(name)?, TypeName::parse_dds(of)?);
        let topic = Self { name, of, hash: hash.to_owned() };
        is_word(hash).then_some(())?;
        Some((domain.parse().ok()?, topic))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn topic(name: &str) -> Topic {
        Topic {
            name: GraphName::parse(name).unwrap(),
            of: TypeName::parse("std_msgs/msg/String").unwrap(),
            hash: "RIHS01_df668c74".to_owned(),
        }
    }

    #[test]
    fn a_key_has_the_domain_the_name_and_the_type() {
        let topic = topic("/robot1/chatter");
        let key = "0/robot1/chatter/std_msgs::msg::dds_::String_/RIHS01_df668c74";
        assert_eq!(topic.key(0), key);
        assert_eq!(Topic::parse(key), Some((0, topic.clone())));
        assert_eq!(Topic::parse(&topic.buffer_key(42)), Some((42, topic)));
    }

    #[test]
    fn other_keys_are_refused() {
        for key in [
            "",
            "0",
            "0/a",
            "0/std_msgs::msg::dds_::String_/H",
            "x/a/std_msgs::msg::dds_::String_/H",
            "0//std_msgs::msg::dds_::String_/H",
            "0/a/b/String/H",
            "0/a*/std_msgs::msg::dds_::String_/H",
            "0/a/std_msgs::msg::dds_::String_/",
            "0/a/std_msgs::msg::dds_::String_/**",
        ] {
            assert_eq!(Topic::parse(key), None, "{key}");
        }
    }

    #[test]
    fn a_name_has_words_and_a_limit() {
        for name in ["/a", "a", "/a/b_1", "/_a", "/a/_action/status"] {
            assert_eq!(
                GraphName::parse(name).map(|name| name.as_str().trim_start_matches('/').to_owned()).as_deref(),
                Some(name.trim_start_matches('/'))
            );
        }
        let long = "a".repeat(LENGTH_MAX);
        for name in ["", "/", "//a", "/a/", "/a//b", "/1", "/a b", "/a$", "/a*", "/a/**", "/ä", "~/a", &long] {
            assert_eq!(GraphName::parse(name), None, "{name}");
        }
        assert!(GraphName::parse(&long[1..]).is_some());
    }
}
