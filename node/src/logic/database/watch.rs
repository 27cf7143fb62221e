//! The watchers of a database. Each gets every change once, and a slow one delays nobody.

use super::question::Reply;
use super::{Database, Effect};
use dbmanager::logic::version_vector::VersionVector;
use dbmanager::logic::view::as_of::AsOfError;
use dbmanager::logic::view::past::{Keys, Past};
use dbmanager::logic::view::watch::Watch;

/// How many watch at a time. The one that has watched for longest gives way: it can go on from where it was, and a command
/// that was killed says nothing.
const WATCHERS_MAX: usize = 256;
/// How much one watcher is told in one turn.
const ROOM: usize = 64;

impl Database {
    /// Begins to watch; returns from where.
    pub(super) fn watch(
        &mut self,
        call: u64,
        keys: Keys,
        from: Option<VersionVector>,
    ) -> Result<VersionVector, AsOfError> {
        let log = self.replica.log();
        let from = from.unwrap_or_else(|| log.vector().clone());
        let watch = Watch::new(keys, from.clone(), log)?;
        self.watchers.insert(call, watch);
        Ok(from)
    }

    /// Tells each watcher what comes next for it.
    pub(super) fn tell_watchers(&mut self, effects: &mut Vec<Effect>) {
        while self.watchers.len() > WATCHERS_MAX {
            let oldest = self.watchers.pop_first();
            effects.extend(oldest.map(|(call, _)| Effect::End(call)));
        }
        let past = Past { log: self.replica.log(), state: self.replica.state() };
        self.more = false;
        for (call, watch) in &mut self.watchers {
            let news = watch.next(&past, ROOM);
            self.more |= news.more;
            effects.extend(news.list.into_iter().map(|told| Effect::AnswerCaller(*call, Reply::Notification(told))));
        }
    }
}
