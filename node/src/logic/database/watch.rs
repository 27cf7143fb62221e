//! The watchers of a database. Each watcher gets every change once, and a slow watcher does not delay other watchers.

use super::Effect;
use super::question::Reply;
use dbmanager::logic::log::Log;
use dbmanager::logic::version_vector::VersionVector;
use dbmanager::logic::view::as_of::AsOfError;
use dbmanager::logic::view::past::{Keys, Past};
use dbmanager::logic::view::watch::Watch;
use std::collections::BTreeMap;

/// How many watchers are served at a time. If more come, the oldest is dropped: it can continue from its position, or
/// is a killed command that did not sign off.
const WATCHERS_MAX: usize = 256;
/// How much data one watcher gets in one turn.
const ROOM: usize = 64;

/// The watchers, by number of the call.
#[derive(Debug, Default)]
pub(super) struct Watchers {
    all: BTreeMap<u64, Watch>,
    /// Whether there may be more for a watcher.
    has_more: bool,
}

impl Watchers {
    /// Begins to watch from a position.
    pub(super) fn watch(&mut self, call: u64, keys: Keys, from: VersionVector, log: &Log) -> Result<(), AsOfError> {
        self.all.insert(call, Watch::new(keys, from, log)?);
        Ok(())
    }

    /// Forgets a watcher that takes no more answers.
    pub(super) fn forget(&mut self, call: u64) {
        self.all.remove(&call);
    }

    /// Takes all watchers, because the disk has failed.
    pub(super) fn take(&mut self) -> impl Iterator<Item = u64> + use<> {
        std::mem::take(&mut self.all).into_keys()
    }

    /// Takes note that the state was replaced by another one.
    pub(super) fn replaced(&mut self) {
        self.all.values_mut().for_each(Watch::replaced);
    }

    /// Returns whether there may be more for a watcher.
    pub(super) const fn has_more(&self) -> bool {
        self.has_more
    }

    /// Gives each watcher its next changes.
    pub(super) fn tell(&mut self, past: &Past<'_>, effects: &mut Vec<Effect>) {
        while self.all.len() > WATCHERS_MAX {
            let oldest = self.all.pop_first();
            effects.extend(oldest.map(|(call, _)| Effect::End(call)));
        }
        self.has_more = false;
        for (call, watch) in &mut self.all {
            let news = watch.next(past, ROOM);
            self.has_more |= news.more;
            effects.extend(news.list.into_iter().map(|told| Effect::AnswerCaller(*call, Reply::Notification(told))));
        }
    }
}
