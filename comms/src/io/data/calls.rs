//! Calls in a team: the server carries out calls that are sealed by an allowed program, or signed by a visitor.

use super::seal::Sealed;
use super::{Opener, Sealer};
use crate::io::session::{Digest, question};
use crate::logic::codec::{self, CodecError};
use crate::logic::object::ObjectCall;
use crate::logic::proof::Proof;
use crate::logic::seal::{Content, Refusal, Seal};
use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};
use zenoh::bytes::ZBytes;

/// A program that may call, as the server knows it.
#[derive(Clone, Debug)]
pub struct Caller {
    /// Its session.
    pub session: String,
    /// Opens the seals of the other end.
    pub opener: Arc<Opener>,
    /// Seals the answers.
    pub sealer: Arc<Sealer>,
}

/// Decides about a visitor's signature of a digest: returns the reason why it is refused, or none if the visitor is
/// permitted.
type Visits = Box<dyn Fn(&Proof, &Digest) -> Option<String> + Send + Sync>;

/// The programs and visitors that may call a server in a team.
pub struct CallGate {
    /// The key of the map is the id of the key that seals the calls.
    callers: Mutex<BTreeMap<u32, Caller>>,
    visits: Visits,
    refused: Box<dyn Fn(Refusal, Option<String>) + Send + Sync>,
}

/// The sender of a call, or of its cancellation.
#[derive(Debug)]
pub(super) enum Sender {
    /// The program with this session, the sealer of the answer, and the number of the call.
    Caller(String, Arc<Sealer>, u64),
    /// A client that looks at running programs, through a node of the team.
    Visitor,
}

/// How calls go to a server.
#[derive(Clone)]
pub enum CallWay {
    /// Messages are sent without a seal or signature: outside of a team.
    Open,
    /// Messages are sealed for the server, which also seals its answers.
    Sealed {
        /// Seals the calls.
        call: Arc<Sealer>,
        /// Seals the cancellation.
        cancel: Arc<Sealer>,
        /// Opens the answers.
        answer: Arc<Opener>,
    },
    /// Messages are signed by a visitor, and sent only to the server.
    Signed(Visitor),
}

/// Signs a visitor's messages; returns none if it cannot sign.
#[derive(Clone)]
pub struct Visitor(pub Arc<Signs>);

/// Signs a digest; returns none if it cannot sign.
pub type Signs = dyn Fn(&Digest) -> Option<Proof> + Send + Sync;

/// Returns the digest that a user signs for a call on a key. It covers the whole call except the warrant.
///
/// # Errors
/// If the call is too long.
pub fn call_digest(key: &str, call: &ObjectCall) -> Result<Digest, CodecError> {
    debug_assert!(call.warrant.is_none(), "a warrant does not cover itself");
    Ok(question(key, &[], &codec::encode(call)?))
}

/// A message to a server, with its attachment.
pub(super) struct Outgoing {
    pub(super) bytes: ZBytes,
    pub(super) beside: Option<Vec<u8>>,
    /// The number of the call. Its answer is sealed with the same number.
    pub(super) number: u64,
}

impl CallWay {
    /// Prepares a message; returns the reason, for a person, if it cannot be sent.
    pub(super) fn prepare(&self, key: &str, content: Content, bytes: Vec<u8>) -> Result<Outgoing, String> {
        match self {
            Self::Open => Ok(Outgoing { bytes: bytes.into(), beside: None, number: 0 }),
            Self::Sealed { call, cancel, .. } => {
                let sealer = if content == Content::Cancel { cancel } else { call };
                let sealed = sealer.seal(content, 0, &bytes.into());
                let Sealed { bytes, seal, number } = sealed.ok_or("the server has shown no key")?;
                Ok(Outgoing { bytes, beside: Some(seal), number })
            }
            Self::Signed(Visitor(sign)) => {
                let proof = sign(&question(key, &[], &bytes)).ok_or("no node signs for this program")?;
                let beside = Some(codec::encode(&proof).map_err(|error| error.to_string())?);
                Ok(Outgoing { bytes: bytes.into(), beside, number: 0 })
            }
        }
    }
}

impl fmt::Debug for Visitor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Visitor(..)")
    }
}

impl fmt::Debug for CallWay {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Open => "Open",
            Self::Sealed { .. } => "Sealed",
            Self::Signed(_) => "Signed",
        })
    }
}

impl CallGate {
    /// Returns a gate that lets in only visitors that `visits` permits. `refused` gets the reason of each drop; it
    /// must only note the reason.
    pub fn new(
        visits: impl Fn(&Proof, &Digest) -> Option<String> + Send + Sync + 'static,
        refused: impl Fn(Refusal, Option<String>) + Send + Sync + 'static,
    ) -> Self {
        Self { callers: Mutex::default(), visits: Box::new(visits), refused: Box::new(refused) }
    }

    /// Sets the programs that may call; they replace the previous programs.
    pub fn set(&self, callers: impl IntoIterator<Item = (u32, Caller)>) {
        *self.callers.lock().unwrap_or_else(PoisonError::into_inner) = callers.into_iter().collect();
    }

    /// Returns whether a sender may give this session as its own. A visitor may not give the session of a program.
    pub(super) fn may_be(&self, sender: &Sender, session: &str) -> bool {
        let callers = self.callers.lock().unwrap_or_else(PoisonError::into_inner);
        match sender {
            Sender::Caller(own, _, _) => own == session,
            Sender::Visitor => callers.values().all(|caller| caller.session != session),
        }
    }

    /// Returns the sender and the content of a message; none if it is to be dropped.
    pub(super) fn open(
        &self,
        wanted: Content,
        beside: Option<&ZBytes>,
        bytes: &ZBytes,
        key: &str,
    ) -> Option<(Sender, Vec<u8>)> {
        let Some(beside) = beside else {
            (self.refused)(Refusal::Unsealed, None);
            return None;
        };
        if let Ok(seal) = codec::decode::<Seal>(&beside.to_bytes()) {
            let callers = self.callers.lock().unwrap_or_else(PoisonError::into_inner);
            let Some(caller) = callers.get(&seal.key).cloned() else {
                drop(callers);
                (self.refused)(Refusal::OtherKey, None);
                return None;
            };
            drop(callers);
            let (content, opened) = caller.opener.open(Some(beside), 0, bytes, || Some(caller.session.clone()))?;
            return (content == wanted).then_some((Sender::Caller(caller.session, caller.sealer, seal.number), opened));
        }
        let bytes = bytes.to_bytes().into_owned();
        let proof = codec::decode::<Proof>(&beside.to_bytes()).map_err(|_other| Refusal::Unsealed);
        let judged = proof.and_then(|proof| match (self.visits)(&proof, &question(key, &[], &bytes)) {
            None => Ok(()),
            Some(why) => {
                tracing::debug!(why, "the caller is not a visitor");
                Err(Refusal::Stranger)
            }
        });
        judged.map(|()| (Sender::Visitor, bytes)).map_err(|why| (self.refused)(why, None)).ok()
    }
}

impl fmt::Debug for CallGate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("CallGate").field("callers", &self.callers).finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::super::SealCounter;
    use super::*;
    use crate::logic::bytes::Bytes;
    use crate::logic::object::{CallId, Signature};
    use std::time::Duration;

    #[test]
    fn nobody_speaks_for_a_program_that_calls() {
        let gate = CallGate::new(|_, _| None, |_, _| ());
        let (opener, sealer) = (Arc::new(Opener::new(|_, _| ())), Arc::new(Sealer::new(&SealCounter::default())));
        gate.set([(7, Caller { session: "task".to_owned(), opener, sealer: Arc::clone(&sealer) })]);
        let program = |session: &str| gate.may_be(&Sender::Caller("task".to_owned(), Arc::clone(&sealer), 1), session);
        assert!(program("task") && !program("dca"));
        assert!(gate.may_be(&Sender::Visitor, "dca") && !gate.may_be(&Sender::Visitor, "task"));
    }

    #[test]
    fn what_a_user_signs_is_one_call() {
        let call = ObjectCall {
            id: CallId { session: "a1".to_owned(), number: 1 },
            caller: "dca".to_owned(),
            name: "Grip".to_owned(),
            signature: Signature::default(),
            within: Duration::from_secs(1),
            argument: Bytes(vec![7]),
            warrant: None,
        };
        let digest = |key, call| call_digest(key, call).unwrap();
        let others = [
            ObjectCall { id: CallId { session: "a1".to_owned(), number: 2 }, ..call.clone() },
            ObjectCall { id: CallId { session: "a2".to_owned(), number: 1 }, ..call.clone() },
            ObjectCall { argument: Bytes(vec![8]), ..call.clone() },
            ObjectCall { name: "Open".to_owned(), ..call.clone() },
        ];
        assert!(others.iter().all(|other| digest("hand", other) != digest("hand", &call)));
        assert_ne!(digest("hand", &call), digest("arm", &call));
    }
}
