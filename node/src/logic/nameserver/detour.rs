//! Nodes that do not answer directly, and that other nodes reach.
//!
//! A link may be cut, in one direction or in both, while all other nodes reach both its ends. So a silent node is asked
//! through others before it is missing, and an answer on that way counts as its answer. As long as it answers, messages
//! take the same way. A lost node is not asked through others: it has to answer directly.

use super::{Boot, Change, NameServer, Reach, SILENCE_MAX};
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::cmp::Reverse;
use std::collections::BTreeSet;
use std::time::Duration;

/// How long a node may be silent, in addition to its usual time to answer, before it is asked through other nodes.
const SUSPECT_AFTER: Duration = Duration::from_millis(1500);
/// Through how many other nodes it is asked at most.
const THROUGH_MAX: usize = 3;

/// A round of questions to other nodes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Round {
    /// Its number.
    pub number: u64,
    /// The names of the nodes asked; none for all.
    pub only: Option<BTreeSet<String>>,
    /// Whether some may not know yet who asks.
    pub shows: bool,
    /// The questions that go through others: the helper, and the silent node.
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
    /// The question's number.
    pub round: u64,
    /// The boot that has the asker's name there, if any has.
    pub holder: Option<u64>,
    /// Name of the node that has passed it on.
    pub via: &'a str,
}

/// The way to a node that does not answer itself.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Detour {
    via: String,
    /// When its last answer came that way.
    pub(super) heard: Time,
}

impl NameServer {
    /// Takes an answer that another node has passed on.
    pub fn answered_through(&mut self, now: Time, pong: RelayedPong<'_>) {
        let is_asked = self.asked.rounds.iter().any(|(round, _)| *round == pong.round) && pong.to_boot == self.boot;
        // A node that has lost this node, or deals with another node of its name, does not take its messages.
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

    /// Returns the node through which messages to another node go, if they do not go directly.
    pub fn detour(&self, host: &str) -> Option<&str> {
        let via = self.held(host)?.detour.as_ref()?.via.as_str();
        self.reaches_directly(via).then_some(via)
    }

    /// Returns whether a node answers itself.
    pub fn reaches_directly(&self, host: &str) -> bool {
        self.held(host).is_some_and(|life| life.is_there() && life.detour.is_none())
    }

    /// Returns which nodes are asked through which other nodes.
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
            // The present way comes first, so that it is kept; then the node that has answered last, which is certainly
            // there.
            let present = self.detour(host);
            let mut via: Vec<&String> = helpers.clone();
            via.sort_by_key(|via| (Some(via.as_str()) != present, Reverse(self.heard(via))));
            through.extend(via.into_iter().take(THROUGH_MAX).map(|via| (via.clone(), host.clone())));
        }
        through
    }
}

impl Boot {
    /// Returns whether something speaks against it, or it does not answer itself.
    fn is_suspect(&self, now: Time) -> bool {
        self.doubted.is_some()
            || !self.is_there()
            || self.detour.is_some()
            || self.owes.is_some_and(|since| since + SUSPECT_AFTER + 2 * self.last.took <= now)
    }

    /// Returns when its last answer came, whichever way.
    pub(super) fn last_heard(&self) -> Time {
        self.detour.as_ref().map_or(self.last.heard, |detour| self.last.heard.max(detour.heard))
    }

    /// Returns from when its silence counts, and until when it may last; none while no answer is expected.
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
