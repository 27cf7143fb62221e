//! The authors of messages: sessions of a team sign their messages, and check the messages that they receive.
//!
//! A tunnel proves which host is at its other end. But zenoh does not report over which link a message has come, and a member may
//! relay messages of others. So each message to nodes, and each of their answers, carries a [`Proof`] over its key and its bytes.
//! The signature of an answer also covers its question.

use crate::logic::codec;
use crate::logic::proof::Proof;
use std::fmt;
use std::sync::Arc;
use zenoh::bytes::ZBytes;

/// A digest of the signed bytes.
pub type Digest = [u8; 32];

/// Signs for this process, and checks signatures of others. Many tasks use it at once, and it must not wait.
pub trait Authenticator: fmt::Debug + Send + Sync {
    /// Signs a digest; none if this process does not act for a node. If `shows`, the proof includes the credential, for receivers
    /// that may not know the key.
    fn sign(&self, digest: &Digest, shows: bool) -> Option<Proof>;

    /// Returns the signer of a digest.
    fn check(&self, proof: &Proof, digest: &Digest) -> Author;

    /// Notes that a message was refused that claims to be from `claimed`, and the reason.
    fn forged(&self, claimed: &str, why: &str);
}

/// The author of a message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Author {
    /// This session is in no team, and trusts every sender.
    Anybody,
    /// The member with this name in its certificate.
    Member(String),
    /// No member has proved to be the author; the text is the reason.
    Nobody(String),
    /// A sender whose key is not known here yet.
    Stranger,
}

impl Author {
    /// Returns, for people, why this is not a message of the member `claimed`. None if it is such a message.
    pub fn problem(&self, claimed: &str) -> Option<String> {
        match self {
            Self::Anybody => None,
            Self::Member(name) if name == claimed => None,
            Self::Member(name) => Some(format!("`{name}` uses the name of `{claimed}`")),
            Self::Nobody(why) => Some(format!("another program uses the name of `{claimed}`: {why}")),
            Self::Stranger => Some(format!("another program uses the name of `{claimed}`: its key is not known here")),
        }
    }
}

/// Returns the digest of a message on a key.
pub(crate) fn put(key: &str, payload: &[u8]) -> Digest {
    digest("dca put 1", &[key.as_bytes(), payload])
}

/// Returns the digest of a question with one answer. The answer contains it.
pub(crate) fn question(key: &str, nonce: &[u8], payload: &[u8]) -> Digest {
    digest("dca question 1", &[key.as_bytes(), nonce, payload])
}

/// Returns the digest of an answer to a question.
pub(crate) fn answer(question: &Digest, payload: &[u8]) -> Digest {
    digest("dca answer 1", &[question, payload])
}

/// Returns the digest of a message that one node sends to another through a third.
pub fn relayed(from: &str, to: &str, what: &[u8]) -> Digest {
    digest("dca relay 1", &[from.as_bytes(), to.as_bytes(), what])
}

/// Two different lists of fields never give the same input of the hash: each field is preceded by its length.
fn digest(context: &'static str, fields: &[&[u8]]) -> Digest {
    let mut hasher = blake3::Hasher::new_derive_key(context);
    for field in fields {
        hasher.update(&(field.len() as u64).to_le_bytes()).update(field);
    }
    hasher.finalize().into()
}

/// Reads the proof of a message, and returns its signer.
pub(super) fn author(
    authenticator: Option<&Arc<dyn Authenticator>>,
    proof: Option<&ZBytes>,
    digest: impl FnOnce() -> Digest,
) -> Author {
    let Some(authenticator) = authenticator else { return Author::Anybody };
    let Some(proof) = proof else { return Author::Nobody("it is not signed".to_owned()) };
    match codec::decode::<Proof>(&proof.to_bytes()) {
        Ok(proof) => authenticator.check(&proof, &digest()),
        Err(error) => Author::Nobody(format!("its signature cannot be read: {error}")),
    }
}

/// Returns the proof to attach to a message, if this session signs.
pub(super) fn beside(
    authenticator: Option<&Arc<dyn Authenticator>>,
    digest: impl FnOnce() -> Digest,
    shows: bool,
) -> Option<Vec<u8>> {
    let proof = authenticator?.sign(&digest(), shows)?;
    codec::encode(&proof).inspect_err(|error| tracing::warn!(%error, "a signature cannot be written")).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_messages_have_one_digest() {
        let all = [
            put("ab", b"c"),
            put("a", b"bc"),
            put("", b"abc"),
            question("a", b"b", b"c"),
            question("a", b"", b"bc"),
            answer(&[0; 32], b"c"),
            answer(&[1; 32], b"c"),
            relayed("a", "b", b"c"),
            relayed("b", "a", b"c"),
        ];
        let different: std::collections::BTreeSet<&Digest> = all.iter().collect();
        assert_eq!(different.len(), all.len());
    }

    #[test]
    fn who_speaks_as_another_is_named() {
        let c3 = Author::Member("c3".to_owned());
        assert_eq!(c3.problem("c3"), None);
        assert_eq!(c3.problem("c2").unwrap(), "`c3` uses the name of `c2`");
        assert_eq!(Author::Anybody.problem("c2"), None);
        let nobody = Author::Nobody("it is not signed".to_owned());
        assert_eq!(nobody.problem("c2").unwrap(), "another program uses the name of `c2`: it is not signed");
    }
}
