//! Wires of a team: their messages are sealed, and incoming messages without a seal are dropped.

use super::seal::Sealed;
use super::{
    DataError, DataSession, Opener, PendingFetch, Publisher, Responder, Sealer, Subscription, sequence, session_error,
};
use crate::logic::codec;
use crate::logic::seal::Content;
use crate::logic::switch::{Arrival, Sequence};
use std::borrow::Cow;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::sync_channel;
use std::time::Duration;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::query::{ConsolidationMode, Query, QueryTarget, Reply};
use zenoh::sample::Sample;

/// Numbers the queries of this process, so that an answer fits only one query.
static QUESTIONS: AtomicU64 = AtomicU64::new(1);

impl Publisher {
    /// Seals all numbered values from now on.
    #[must_use]
    pub fn sealed(mut self, sealer: Arc<Sealer>) -> Self {
        self.sealer = Some(sealer);
        self
    }

    /// Sends a sealed message. Without a key it sends nothing.
    pub(super) fn put_sealed(
        &self,
        sealer: &Sealer,
        content: Content,
        bytes: &ZBytes,
        number: u32,
    ) -> Result<(), DataError> {
        let Some(Sealed { bytes, seal, .. }) = sealer.seal(content, number.into(), bytes) else { return Ok(()) };
        let put = self.publisher.put(bytes).attachment(seal).source_info(self.source_info(number)).wait();
        put.map_err(|cause| session_error(self.publisher.key_expr().as_str(), &cause))
    }
}

impl DataSession {
    /// Receives a wire like [`DataSession::on_wire`], and drops messages without a valid seal.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn on_sealed_wire(
        &self,
        key: &str,
        opener: Arc<Opener>,
        mut on_arrival: impl FnMut(Arrival<Cow<'_, [u8]>>, Option<Sequence>) + Send + Sync + 'static,
    ) -> Result<Subscription, DataError> {
        let on_sample = move |sample: Sample| {
            let number = sample.source_info().map_or(0, |source| source.source_sn().into());
            let from = || sample.source_info().map(|source| source.source_id().zid().to_string());
            match opener.open(sample.attachment(), number, sample.payload(), from) {
                Some((Content::Value, bytes)) => on_arrival(Arrival::Value(bytes.into()), sequence(&sample)),
                Some((Content::Boundary, word)) => match codec::decode(&word) {
                    Ok(boundary) => on_arrival(Arrival::Boundary(boundary), sequence(&sample)),
                    Err(error) => tracing::warn!(key = sample.key_expr().as_str(), %error, "a word is ignored"),
                },
                Some((Content::Answer | Content::Call | Content::Cancel | Content::Device, _)) | None => {}
            }
        };
        self.on_samples(key, on_sample)
    }

    /// Answers fetches of `key` like [`DataSession::answer`]. Only the other end of the wire can read the answers.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn answer_sealed(
        &self,
        key: &str,
        sealer: Arc<Sealer>,
        answer: impl Fn() -> Option<Vec<u8>> + Send + Sync + 'static,
    ) -> Result<Responder, DataError> {
        let on_query = move |query: &Query| {
            let question = query.payload().and_then(|question| <[u8; 8]>::try_from(&*question.to_bytes()).ok());
            let sealed = question.map(u64::from_le_bytes).zip(answer());
            let sealed = sealed.and_then(|(about, bytes)| sealer.seal(Content::Answer, about, &bytes.into()));
            let Some(Sealed { bytes, seal, .. }) = sealed else { return };
            if let Err(error) = query.reply(query.key_expr().clone(), bytes).attachment(seal).wait() {
                tracing::debug!(key = query.key_expr().as_str(), %error, "an answer was not sent");
            }
        };
        self.answers.serve(&self.opened.session, key, on_query)
    }

    /// Asks like [`DataSession::ask`], but accepts only an answer of the other end of the wire.
    ///
    /// # Errors
    /// If the session is closed.
    pub fn ask_sealed(&self, key: &str, opener: Arc<Opener>, within: Duration) -> Result<PendingFetch, DataError> {
        let (reply_tx, reply) = sync_channel(1);
        let question = QUESTIONS.fetch_add(1, Ordering::Relaxed);
        let on_reply = move |reply: Reply| {
            // An error has no seal, and may come from any session.
            let Ok(sample) = reply.result() else { return };
            let from = || sample.source_info().map(|source| source.source_id().zid().to_string());
            let opened = opener.open(sample.attachment(), question, sample.payload(), from);
            if let Some((Content::Answer, bytes)) = opened {
                // The queue is full if the producer has answered twice.
                drop(reply_tx.try_send(Ok(bytes)));
            }
        };
        let asked = self
            .opened
            .session
            .get(key)
            .target(QueryTarget::All)
            .consolidation(ConsolidationMode::None)
            .payload(question.to_le_bytes().to_vec())
            .timeout(within)
            .callback(on_reply);
        asked.wait().map_err(|cause| session_error(key, &cause))?;
        Ok(PendingFetch { key: key.to_owned(), within, reply })
    }
}
