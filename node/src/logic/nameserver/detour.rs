//! Nodes that do not answer directly, but that other nodes reach.
//!
//! A link may be cut in one direction or in both, while all other nodes reach both of its ends. So before a silent node
//! counts as missing, it is asked through other nodes. An answer that comes this way counts as its answer. As long as
//! the node answers this way, messages take the same way. A lost node is not asked through others: it has to answer
//! directly.

use super::{Boot, Change, NameServer, Reach, SILENCE_MAX};
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::cmp::Reverse;
use std::collections::BTreeSet;
use std::time::Duration;

/// How long a node may be silent before it is asked through other nodes. Its usual time to answer is added.
const SUSPECT_AFTER: Duration = Duration::from_millis(1500);
/// The most other nodes through which a node is asked.
const THROUGH_MAX: usize = 3;

/// A round of questions to other nodes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Round {
    /// The number of the round.
    pub number: u64,
    /// The names of the nodes that are asked; nothing for all nodes.
    pub only: Option<BTreeSet<String>>,
    /// Whether this node introduces itself, because some nodes may not know it yet.
    pub shows: bool,
    /// The questions that go through other nodes: the helper, and the silent node.
    pub through: Vec<(String, String)>,
}

/// An answer that another node has passed on.
#[derive(Clone, Copy, Debug)]
pub struct RelayedPong<'a> {
    /// Name of the node that answers.
    pub from: &'a str,
    /// Its boot number.
    pub boot: u64,
    /// Boot number of the node that asked.
    pub to_boot: u64,
    /// The number of the question.
    pub round: u64,
    /// The boot that holds the asking node's name there, if any.
    pub holder: Option<u64>,
    /// Name of the node that has passed the answer on.
    pub via: &'a str,
}

/// The way to a node that does not answer directly.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Detour {
    via: String,
    /// When the last answer came this way.
    pub(super) heard: Time,
}

impl NameServer {
    /// Notes an answer that another node has passed on.
    pub fn answered_through(&mut self, now: Time, pong: RelayedPong<'_>) {
        let is_asked = self.asked.rounds.iter().any(|(round, _)| *round == pong.round) && pong.to_boot == self.boot;
        // The answering node may have lost this node, or may communicate with another node of its name. Then it takes
        // no messages of this node.
        if !is_asked || pong.holder != Some(self.boot) || pong.from == self.host || !self.reaches_directly(pong.via) {
            return;
        }
        if self.holder(pong.from) != Some(pong.boot) {
            return;
        }
        let Some(life) = self.life_mut(pong.from, pong.boot) else { return };
        if life.is_lost() || pong.round < life.proof || !life.is_suspect(now) {
            return;
        }
        let before = life.detour.take();
        let is_same = before.as_ref().is_some_and(|detour| detour.via == pong.via);
        if let Some(detour) = before.filter(|detour| !is_same && detour.heard + SUSPECT_AFTER > now) {
            life.detour = Some(detour);
            return;
        }
        (life.doubted, life.reach) = (None, Reach::There);
        life.detour = Some(Detour { via: pong.via.to_owned(), heard: now });
        if !is_same {
            let (host, via) = (pong.from.to_owned(), pong.via.to_owned());
            self.changes.push(Change::Detour { host, boot: pong.boot, via });
        }
    }

    /// If messages to a node do not go directly, returns the node that passes them on.
    pub fn detour(&self, host: &str) -> Option<&str> {
        let via = self.held(host)?.detour.as_ref()?.via.as_str();
        self.reaches_directly(via).then_some(via)
    }

    /// Returns whether a node answers directly.
    pub fn reaches_directly(&self, host: &str) -> bool {
        self.held(host).is_some_and(|life| life.is_there() && life.detour.is_none())
    }

    /// Returns which nodes are asked through which helpers.
    pub(super) fn asked_through(&self, now: Time) -> Vec<(String, String)> {
        let is_asked = |host: &&String| {
            **host != self.host && self.held(host).is_some_and(|life| !life.is_lost() && life.is_suspect(now))
        };
        let helps =
            |via: &&String| self.reaches_directly(via) && self.held(via).is_some_and(|life| !life.is_suspect(now));
        let silent: Vec<&String> = self.peers.keys().filter(is_asked).collect();
        if silent.is_empty() {
            return Vec::new();
        }
        let helpers: Vec<&String> = self.peers.keys().filter(helps).collect();
        let mut through = Vec::new();
        for host in silent {
            // The present helper comes first, so that it is kept. Then comes the node with the latest answer: it is the
            // most certain to be present.
            let present = self.detour(host);
            let mut via: Vec<&String> = helpers.clone();
            via.sort_by_key(|via| (Some(via.as_str()) != present, Reverse(self.heard(via))));
            through.extend(via.into_iter().take(THROUGH_MAX).map(|via| (via.clone(), host.clone())));
        }
        through
    }
}

impl Boot {
    /// Returns whether the boot may be gone or does not answer directly.
    fn is_suspect(&self, now: Time) -> bool {
        self.doubted.is_some()
            || !self.is_there()
            || self.detour.is_some()
            || self.owes.is_some_and(|since| since + SUSPECT_AFTER + 2 * self.last.took <= now)
    }

    /// Returns when the last answer of the boot came, directly or through another node.
    pub(super) fn last_heard(&self) -> Time {
        self.detour.as_ref().map_or(self.last.heard, |detour| self.last.heard.max(detour.heard))
    }

    /// Returns the time from which its silence is measured, and the time until which it may last. Returns nothing while
    /// no answer is expected.
    pub(super) fn silent_at(&self) -> Option<(Time, Time)> {
        let owes = self.owes?;
        let since = self.detour.as_ref().map_or(owes, |detour| owes.max(detour.heard));
        Some((since, since + SILENCE_MAX + 2 * self.last.took))
    }
}

impl Detour {
    /// Returns the node that passes messages on.
    pub(super) fn via(&self) -> &str {
        &self.via
    }
}
