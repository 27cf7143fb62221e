//! The endpoints of other nodes that have the name of a topic of this bridge, and another type: no message passes between them.

use ros::logic::key::{GraphName, Topic};
use ros::logic::token::{Endpoint, Role, Token};
use std::collections::{BTreeMap, BTreeSet};

/// The most endpoints of other types that are known at one time, and the most that are reported, because a node may start again for ever.
const KNOWN_MAX: usize = 1000;

/// The endpoints of other types.
#[derive(Debug, Default)]
pub(crate) struct Others {
    /// By name and role of their partners, the topics of the bridge.
    expected: BTreeMap<(GraphName, Role), Topic>,
    /// By name and role, the tokens of endpoints with another type.
    known: BTreeMap<(GraphName, Role), BTreeSet<String>>,
    /// How many sentences were reported.
    told: usize,
}

impl Others {
    /// Takes note of a topic, of which endpoints with this role are the partners.
    pub(crate) fn expect(&mut self, topic: Topic, partner: Role) {
        self.expected.insert((topic.name.clone(), partner), topic);
    }

    /// Takes a token that has appeared; returns a sentence for a person if no message passes between its endpoint and the bridge.
    pub(crate) fn appear(&mut self, key: &str) -> Option<String> {
        let Token { node, endpoint, .. } = Token::parse(key)?;
        let Endpoint { role, topic, .. } = endpoint?;
        let place = (topic.name.clone(), role);
        let own = self.expected.get(&place)?;
        if (topic.of == own.of && topic.hash == own.hash) || self.is_full() {
            return None;
        }
        let is_new = self.known.entry(place).or_default().insert(key.to_owned());
        if !is_new || self.told >= KNOWN_MAX {
            return None;
        }
        self.told += 1;
        let does = match role {
            Role::Publisher => "publishes",
            Role::Subscriber => "subscribes to",
            Role::Server => "answers",
            Role::Client => "calls",
        };
        let name = node.namespace.map_or_else(String::new, |namespace| namespace.to_string());
        let (node, name, of) = (format!("{name}/{}", node.name), &topic.name, &topic.of);
        let why = if topic.of == own.of {
            format!("with another definition of `{of}`: {} there, {} here", topic.hash, own.hash)
        } else {
            format!("with type `{of}`, and its type is `{}` here", own.of)
        };
        Some(format!("node `{node}` {does} `{name}` {why}; nothing passes between them"))
    }

    fn is_full(&self) -> bool {
        self.known.values().map(BTreeSet::len).sum::<usize>() >= KNOWN_MAX
    }

    /// Takes note that a token has vanished.
    pub(crate) fn vanish(&mut self, key: &str) {
        for tokens in self.known.values_mut() {
            tokens.remove(key);
        }
    }

    /// Returns how many partners of a topic with this role have another type.
    pub(crate) fn count(&self, name: &GraphName, partner: Role) -> u64 {
        let count = self.known.get(&(name.clone(), partner)).map_or(0, BTreeSet::len);
        u64::try_from(count).unwrap_or(u64::MAX)
    }

    /// Forgets all tokens, but not the number of reported sentences.
    pub(crate) fn forget(&mut self) {
        self.known.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ros::logic::name::TypeName;

    fn others() -> Others {
        let mut others = Others::default();
        let (name, of) = (GraphName::parse("/scan").unwrap(), TypeName::parse("std_msgs/String").unwrap());
        others.expect(Topic { name, of, hash: "RIHS01_aa".to_owned() }, Role::Publisher);
        others
    }

    /// Returns how many publishers of a topic have another type.
    fn count(others: &Others, name: &str) -> u64 {
        others.count(&GraphName::parse(name).unwrap(), Role::Publisher)
    }

    fn token(number: usize, role: &str, topic: &str) -> String {
        format!("@ros2_lv/7/ab/0/{number}/{role}/%/%a/talker/{topic}/::,:,:,:,,")
    }

    #[test]
    fn partners_of_other_types_are_told_once_and_counted() {
        let mut others = others();
        let same = "%scan/std_msgs::msg::dds_::String_/RIHS01_aa";
        let (hash, of) = (same.replace("_aa", "_bb"), same.replace("String", "Bool"));
        for nothing in [same.to_owned(), same.replace("scan", "other")] {
            assert_eq!(others.appear(&token(1, "MP", &nothing)), None);
        }
        assert_eq!(others.appear(&token(1, "MS", &of)), None, "another subscriber");
        let told = others.appear(&token(1, "MP", &hash)).unwrap();
        assert_eq!(
            told,
            "node `/a/talker` publishes `/scan` with another definition of `std_msgs/msg/String`: RIHS01_bb there, RIHS01_aa here; \
             nothing passes between them"
        );
        assert_eq!(others.appear(&token(1, "MP", &hash)), None, "it was told");
        let told = others.appear(&token(2, "MP", &of)).unwrap();
        assert!(told.contains("with type `std_msgs/msg/Bool`, and its type is `std_msgs/msg/String` here"), "{told}");
        assert_eq!((count(&others, "/scan"), count(&others, "/other")), (2, 0));
        others.vanish(&token(2, "MP", &of));
        others.vanish(&token(3, "MP", &of));
        assert_eq!(count(&others, "/scan"), 1);
        others.forget();
        assert_eq!(count(&others, "/scan"), 0);
    }

    /// A mission publishes transforms and hears them.
    #[test]
    fn a_topic_has_partners_on_both_ways() {
        let mut others = others();
        let own = others.expected.values().next().unwrap().clone();
        others.expect(own, Role::Subscriber);
        let of = "%scan/std_msgs::msg::dds_::Bool_/RIHS01_aa";
        assert!(others.appear(&token(1, "MP", of)).unwrap().contains("publishes"));
        assert!(others.appear(&token(2, "MS", of)).unwrap().contains("subscribes to"));
        assert!(others.appear(&token(3, "MS", of)).is_some());
        let name = GraphName::parse("/scan").unwrap();
        assert_eq!((others.count(&name, Role::Publisher), others.count(&name, Role::Subscriber)), (1, 2));
    }

    #[test]
    fn tokens_take_a_limited_memory() {
        let mut others = others();
        let of = "%scan/std_msgs::msg::dds_::Bool_/RIHS01_aa";
        let told = (0..2 * KNOWN_MAX).filter_map(|number| others.appear(&token(number, "MP", of))).count();
        assert_eq!((told, count(&others, "/scan")), (KNOWN_MAX, 1000));
        for nonsense in ["", "@ros2_lv", &token(1, "MP", &"n".repeat(4096)), &token(1, "NN", "")] {
            assert_eq!(others.appear(nonsense), None);
        }
    }

    #[test]
    fn a_node_that_starts_again_and_again_is_told_a_limited_number_of_times() {
        let mut others = others();
        let of = "%scan/std_msgs::msg::dds_::Bool_/RIHS01_aa";
        let mut told = 0;
        for number in 0..2 * KNOWN_MAX {
            let token = token(number, "MP", of);
            told += usize::from(others.appear(&token).is_some());
            assert_eq!(count(&others, "/scan"), 1);
            if number % 2 == 0 { others.vanish(&token) } else { others.forget() }
        }
        assert_eq!(told, KNOWN_MAX);
    }
}
