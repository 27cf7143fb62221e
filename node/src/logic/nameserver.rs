//! Who is there: the nodes this one can reach, and since when one is missing.
//!
//! A node that vanishes is only missing; it is lost after [`LOST_AFTER`], because a short cut, or a node that was
//! suspended, must not end a mission. Never acts on a wall clock.

use comms::logic::time::Time;
use std::collections::BTreeMap;
use std::time::Duration;

/// How long a node may be missing before its part of a deployment counts as lost.
pub const LOST_AFTER: Duration = Duration::from_secs(5);

/// One other node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Peer {
    boot: u64,
    missing_since: Option<Time>,
}

/// The table of other nodes.
#[derive(Debug, Default)]
pub struct NameServer {
    peers: BTreeMap<String, Peer>,
}

impl NameServer {
    /// Notes that a node is there, booted as `boot`. Returns whether this is another boot than the last one known.
    pub fn appeared(&mut self, host: &str, boot: u64) -> bool {
        let before = self.peers.insert(host.to_owned(), Peer { boot, missing_since: None });
        before.is_none_or(|peer| peer.boot != boot)
    }

    /// Notes that a node is missing; returns whether that is news. A vanished token of an older boot says nothing about the
    /// newer one.
    pub fn vanished(&mut self, now: Time, host: &str, boot: u64) -> bool {
        let there = self.peers.get_mut(host).filter(|peer| peer.boot == boot && peer.missing_since.is_none());
        there.is_some_and(|peer| peer.missing_since.replace(now).is_none())
    }

    /// Returns whether a node was seen and is not lost.
    pub fn knows(&self, host: &str) -> bool {
        self.peers.contains_key(host)
    }

    /// Forgets a node that counts as lost.
    pub fn lose(&mut self, host: &str) {
        self.peers.remove(host);
    }

    /// Returns whether a node can be reached right now.
    pub fn reaches(&self, host: &str) -> bool {
        self.peers.get(host).is_some_and(|peer| peer.missing_since.is_none())
    }

    /// Returns the nodes that can be reached right now, in order of name.
    pub fn present(&self) -> impl Iterator<Item = &str> {
        self.peers.iter().filter(|(_, peer)| peer.missing_since.is_none()).map(|(host, _)| host.as_str())
    }

    /// Removes and returns the nodes that have been missing for too long.
    pub fn take_lost(&mut self, now: Time) -> Vec<String> {
        let lost = |peer: &Peer| peer.missing_since.is_some_and(|since| since + LOST_AFTER <= now);
        let hosts: Vec<String> =
            self.peers.iter().filter(|(_, peer)| lost(peer)).map(|(host, _)| host.clone()).collect();
        self.peers.retain(|_, peer| !lost(peer));
        hosts
    }

    /// Returns when [`NameServer::take_lost`] wants to be called.
    pub fn deadline(&self) -> Option<Time> {
        self.peers.values().filter_map(|peer| peer.missing_since).min().map(|since| since + LOST_AFTER)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_short_absence_is_no_loss() {
        let mut names = NameServer::default();
        let at = |seconds| Time::ZERO + Duration::from_secs(seconds);
        assert!(names.appeared("c2", 7));
        assert!(names.vanished(at(1), "c2", 7) && !names.vanished(at(2), "c2", 7));
        assert!(!names.reaches("c2"));
        assert!(!names.appeared("c2", 7), "the same boot is back");
        assert_eq!(names.take_lost(at(100)), Vec::<String>::new());
        assert!(!names.vanished(at(101), "c2", 6));
        assert!(names.reaches("c2"), "an old boot's token says nothing");
        assert!(names.vanished(at(101), "c2", 7));
        assert_eq!(names.deadline(), Some(at(106)));
        assert_eq!(names.take_lost(at(106)), ["c2"]);
        assert!(!names.knows("c2"));
    }
}
