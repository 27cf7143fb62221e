//! The thread that answers fetches.
//!
//! This thread may wait for room on a link. Zenoh's own threads must not wait, because they also learn from the
//! system that a link has room again. If two of them waited for each other's link, all links of the process would be
//! silent until zenoh gives one up, after 5 s.

use super::{DataError, Responder, session_error};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, OnceLock};
use zenoh::Wait as _;
use zenoh::query::Query;

/// How many queries wait at most. Further queries get no answer; their callers ask again.
const WAITING_MAX: usize = 1024;

/// An answer to be given.
type Answer = Box<dyn FnOnce() + Send>;

/// The queue to the thread, which starts with the first answering key and ends with the last one.
#[derive(Debug, Default)]
pub(super) struct Answers(OnceLock<SyncSender<Answer>>);

impl Answers {
    /// Answers queries for a key, on the thread for answers.
    pub(super) fn serve(
        &self,
        session: &zenoh::Session,
        key: &str,
        on_query: impl Fn(&Query) + Send + Sync + 'static,
    ) -> Result<Responder, DataError> {
        let (later, on_query) = (self.later(), Arc::new(on_query));
        let on_query = move |query: Query| {
            let on_query = Arc::clone(&on_query);
            later(Box::new(move || on_query(&query)));
        };
        let queryable = session.declare_queryable(key).complete(true).callback(on_query).wait();
        queryable.map(|queryable| Responder { _queryable: queryable }).map_err(|cause| session_error(key, &cause))
    }

    /// Returns a function that hands an answer to the thread, without waiting.
    fn later(&self) -> impl Fn(Answer) + Send + Sync + use<> {
        let sender = self.0.get_or_init(|| {
            let (sender, waiting) = sync_channel(WAITING_MAX);
            if let Err(error) = std::thread::Builder::new().name("answers".to_owned()).spawn(move || give(&waiting)) {
                tracing::warn!(%error, "the thread for answers cannot be started: a caller that fetches a value gets no answer");
            }
            sender
        });
        let sender = sender.clone();
        move |answer| {
            if let Err(TrySendError::Full(_)) = sender.try_send(answer) {
                tracing::debug!("too many callers fetch values at once: one caller gets no answer");
            }
        }
    }
}

fn give(waiting: &Receiver<Answer>) {
    waiting.iter().for_each(|answer| answer());
}
