//! The watchers of a database. Each watcher gets every change once, and a slow watcher does not delay the others.

use super::look;
use super::question::Reply;
use super::refuse::LOCAL;
use super::{Database, Effect};
use dbmanager::logic::version_vector::VersionVector;
use dbmanager::logic::view::as_of::AsOfError;
use dbmanager::logic::view::past::{Keys, Past};
use dbmanager::logic::view::watch::Watch;

/// How many watchers are served at a time. If more come, the oldest is dropped: it can continue from its position, or
/// is a killed command that did not sign off.
const WATCHERS_MAX: usize = 256;
/// The refusal of a watcher of local keys.
const NO_NEWS: &str = "what is below `local/` can be read and written, not watched";
/// How many changes one watcher is told in one turn.
const ROOM: usize = 64;

impl Database {
    /// Begins to watch; returns the position from which the watcher is told changes.
    pub(super) fn watch(
        &mut self,
        call: u64,
        keys: Keys,
        from: Option<VersionVector>,
    ) -> Result<VersionVector, AsOfError> {
        let log = self.replica.log();
        let from = from.unwrap_or_else(|| log.vector().clone());
        let watch = Watch::new(keys, from.clone(), log)?;
        self.calls.watchers.insert(call, watch);
        Ok(from)
    }

    /// Answers with the present values of keys and their position, and begins to watch from there.
    pub(super) fn follow(&mut self, call: u64, keys: Keys, effects: &mut Vec<Effect>) {
        let mut say = |reply| effects.push(Effect::AnswerCaller(call, reply));
        let first = match &keys {
            Keys::Below(prefix) => prefix,
            Keys::Only(key) => key.as_str(),
        };
        if first.starts_with(LOCAL) {
            say(Reply::Refused(NO_NEWS.to_owned()));
            return effects.push(Effect::End(call));
        }
        match &keys {
            Keys::Below(prefix) => look::list(self.replica.state(), prefix, &mut say),
            Keys::Only(key) => {
                let versions = self.replica.state().versions(key).to_vec();
                say(Reply::Entries(if versions.is_empty() { Vec::new() } else { vec![(key.clone(), versions)] }));
            }
        }
        match self.watch(call, keys, None) {
            Ok(version) => say(Reply::Version(version)),
            Err(why) => {
                say(Reply::Refused(why.to_string()));
                effects.push(Effect::End(call));
            }
        }
    }

    /// Sends each watcher its next changes.
    pub(super) fn tell_watchers(&mut self, effects: &mut Vec<Effect>) {
        while self.calls.watchers.len() > WATCHERS_MAX {
            let oldest = self.calls.watchers.pop_first();
            effects.extend(oldest.map(|(call, _)| Effect::End(call)));
        }
        let past = Past { log: self.replica.log(), state: self.replica.state() };
        self.calls.more = false;
        for (call, watch) in &mut self.calls.watchers {
            let news = watch.next(&past, ROOM);
            self.calls.more |= news.more;
            effects.extend(news.list.into_iter().map(|told| Effect::AnswerCaller(*call, Reply::Notification(told))));
        }
    }
}
