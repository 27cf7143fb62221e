//! The links of a session, as zenoh's events say, and where each is dialled again.

use super::patience;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use zenoh::config::Locator;

/// Links by session id.
#[derive(Default)]
pub(super) struct Links {
    /// Those that stand, as zenoh's events say. It is also asked itself before dialling, but for a moment after a loss
    /// it still answers that there is a link.
    pub(super) standing: BTreeSet<String>,
    /// Those that are dialled again when they are lost.
    pub(super) kept: BTreeMap<String, Place>,
    /// Those that the keeper dials right now.
    pub(super) dialling: BTreeSet<String>,
    /// The two ends of each TCP link of a session, and how long it may be silent, where that was said. Two that dial each other have
    /// two.
    pub(super) ends: BTreeMap<String, Vec<(patience::Ends, Duration)>>,
    /// Names of sessions that have said them.
    pub(super) names: BTreeMap<String, String>,
    /// Why there is no link, for a person.
    pub(super) troubles: BTreeMap<String, String>,
}

/// Where to dial a session again.
#[derive(Clone)]
pub(super) struct Place {
    pub(super) locators: Vec<Locator>,
    /// For how long; none for as long as this session lives.
    pub(super) within: Option<Duration>,
}

impl Links {
    /// Forgets a link; returns the other ones of the session.
    pub(super) fn lose(&mut self, session: &str, both: patience::Ends) -> Vec<patience::Ends> {
        let Some(ends) = self.ends.get_mut(session) else { return Vec::new() };
        ends.retain(|(other, _)| *other != both);
        let left: Vec<patience::Ends> = ends.iter().map(|(other, _)| *other).collect();
        if left.is_empty() {
            self.ends.remove(session);
        }
        left
    }
}

/// Returns the links; nobody holds them for long.
pub(super) fn lock(links: &Mutex<Links>) -> MutexGuard<'_, Links> {
    // Maps of plain values are valid whatever happened to the thread that held them.
    links.lock().unwrap_or_else(PoisonError::into_inner)
}
