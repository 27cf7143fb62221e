//! The node that has to answer a call in a team. Answers of another server of the same key are ignored.

use super::proof::{self, Authenticator, Author, Digest};
use crate::logic::proof::Proof;
use crate::logic::{codec, key};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use zenoh::bytes::Encoding;
use zenoh::query::{Reply, ReplyError};
use zenoh::sample::Sample;

/// Decides which answers of one call are accepted.
#[derive(Debug)]
pub(super) struct Expect {
    authenticator: Arc<dyn Authenticator>,
    /// The called host, if the call names one.
    host: Option<String>,
    question: Digest,
    seen: Mutex<Seen>,
}

#[derive(Debug, Default)]
struct Seen {
    /// The key of the first accepted answer's signer: all later answers must have the same signer.
    key: Option<[u8; 32]>,
    author: Option<Author>,
    /// Why answers were ignored.
    forged: Option<String>,
    /// A refusal without a signature.
    refused: Option<String>,
}

impl Expect {
    pub(super) fn new(authenticator: &Arc<dyn Authenticator>, called: &str, nonce: &[u8], payload: &[u8]) -> Arc<Self> {
        let called = key::without_session(called);
        let host = key::parse_rpc(called).map(|(host, _)| host);
        let question = proof::question(called, nonce, payload);
        Arc::new(Self { authenticator: Arc::clone(authenticator), host, question, seen: Mutex::default() })
    }

    /// Returns the digest by which the answers name the question.
    pub(super) const fn question(&self) -> &Digest {
        &self.question
    }

    /// Returns whether an answer is accepted. Zenoh calls this.
    pub(super) fn takes(&self, reply: &Reply) -> bool {
        match reply.result() {
            Ok(sample) => self.is_theirs(sample),
            Err(error) => self.is_own(error),
        }
    }

    fn is_theirs(&self, sample: &Sample) -> bool {
        let proof = sample.attachment().and_then(|proof| codec::decode::<Proof>(&proof.to_bytes()).ok());
        let digest = || proof::answer(&self.question, &sample.payload().to_bytes());
        let author = match &proof {
            Some(proof) => self.authenticator.check(proof, &digest()),
            None => Author::Nobody("it is not signed".to_owned()),
        };
        let mut seen = self.seen();
        let problem = match (&self.host, &author) {
            (Some(host), author) => author.problem(host),
            (None, Author::Nobody(why)) => Some(why.clone()),
            (None, Author::Stranger) => Some("its key is not known here".to_owned()),
            (None, Author::Anybody | Author::Member(_)) => None,
        };
        if let Some(problem) = problem {
            if seen.forged.is_none() {
                self.authenticator.forged(self.host.as_deref().unwrap_or("another replica"), &problem);
            }
            seen.forged = Some(problem);
            return false;
        }
        let key = proof.map(|proof| proof.key);
        if seen.key.is_some() && seen.key != key {
            return false;
        }
        (seen.key, seen.author) = (key, Some(author));
        true
    }

    /// Returns whether an error comes from this end. Unsigned are only zenoh's errors, and a refusal before the first
    /// answer.
    fn is_own(&self, error: &ReplyError) -> bool {
        if *error.encoding() == Encoding::from(super::serve::REFUSED) {
            let text = String::from_utf8_lossy(&error.payload().to_bytes()).into_owned();
            self.seen().refused = Some(text);
            return false;
        }
        true
    }

    /// Returns the author of the answers.
    pub(super) fn author(&self) -> Author {
        self.seen().author.clone().unwrap_or(Author::Anybody)
    }

    /// Returns why no answer was accepted, if there were answers: whether one was a refusal, and the reason.
    pub(super) fn why_not(&self) -> Option<(bool, String)> {
        let seen = self.seen();
        let forged = seen.forged.clone().map(|why| (false, why));
        forged.or_else(|| seen.refused.clone().map(|why| (true, why)))
    }

    fn seen(&self) -> MutexGuard<'_, Seen> {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
