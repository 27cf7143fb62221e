//! Sends beats to hosts that this node depends on, and ends links to lost hosts.
//!
//! If no data is sent over a link, a cut of it goes unnoticed, and idle nodes rarely send data. So a node sends a beat
//! every 250 ms to the hosts that something here depends on. A beat has no content. The session notices when beats are
//! missing, see `comms/src/io/session/patience.rs`.

use comms::io::session::Session;
use comms::logic::key;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::MissedTickBehavior;

/// The period of the beats. With the patience of a new link, a cut is noticed after 1.9 s.
const BEAT_EVERY: Duration = Duration::from_millis(250);
/// The most sessions of other nodes that are remembered.
const SESSIONS_MAX: usize = 1024;

/// Sends beats to the present `hosts`, until their sender is gone.
pub(super) async fn beat(session: Arc<Session>, mut hosts: watch::Receiver<BTreeSet<String>>) {
    let mut keys = keys(&mut hosts);
    let mut every = tokio::time::interval(BEAT_EVERY);
    every.set_missed_tick_behavior(MissedTickBehavior::Skip);
    loop {
        tokio::select! {
            changed = hosts.changed() => match changed {
                Ok(()) => keys = self::keys(&mut hosts),
                Err(_closed) => return,
            },
            _ = every.tick(), if !keys.is_empty() => {
                for key in &keys {
                    if let Err(error) = session.beat(key) {
                        tracing::debug!(%error, "a beat was not sent");
                    }
                }
            }
        }
    }
}

fn keys(hosts: &mut watch::Receiver<BTreeSet<String>>) -> Vec<String> {
    hosts.borrow_and_update().iter().map(|host| key::beat(host)).collect()
}

/// The session of each boot of another node, according to its answers.
#[derive(Debug, Default)]
pub(super) struct Sessions(Mutex<BTreeMap<(String, u64), String>>);

impl Sessions {
    pub(super) fn note(&self, host: &str, boot: u64, session: &str) {
        let mut sessions = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let boot = (host.to_owned(), boot);
        if sessions.len() < SESSIONS_MAX || sessions.contains_key(&boot) {
            sessions.insert(boot, session.to_owned());
        }
    }

    /// Removes all entries except the entries of these boots.
    pub(super) fn keep(&self, holders: &BTreeMap<String, u64>) {
        let mut sessions = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        sessions.retain(|(host, boot), _| holders.get(host) == Some(boot));
    }

    pub(super) fn take(&self, host: &str, boot: u64) -> Option<String> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).remove(&(host.to_owned(), boot))
    }
}
