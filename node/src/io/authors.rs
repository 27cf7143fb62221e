//! Checks that messages of other nodes come from their claimed sender. In a team, each message is signed with the key
//! of a certificate. A node may only use the name in its certificate. Outside a team, every sender is believed.

use crate::logic::link::Frame;
use crate::logic::protocol::{Body, Refusal, Relay};
use comms::io::session::{Authenticator, Author, Session, relayed};
use comms::logic::proof::Proof;
use comms::logic::{codec, key};
use std::sync::Arc;
use team::member::Member;

/// Lets through the messages that come from their claimed sender.
#[derive(Clone, Debug)]
pub(crate) struct Authors {
    member: Option<Arc<Member>>,
    session: Arc<Session>,
    host: String,
}

impl Authors {
    pub(crate) fn new(member: Option<Arc<Member>>, session: &Arc<Session>, host: &str) -> Self {
        Self { member, session: Arc::clone(session), host: host.to_owned() }
    }

    /// Returns whether a message is from `claimed`. If it is not, writes this to the audit log and informs the sender.
    pub(crate) fn admits(&self, author: &Author, claimed: &str) -> bool {
        let Some((member, why)) = self.member.as_ref().zip(author.problem(claimed)) else { return true };
        // This node does not know the sender's key yet. The sender repeats the message.
        if *author == Author::Stranger {
            tracing::debug!(claimed, "dropping a message of a sender that is not known yet");
        } else if member.refuse_message(&format!("speak as `{claimed}`"), &why)
            && let Author::Member(name) = author
        {
            self.tell(name, why);
        }
        false
    }

    fn tell(&self, name: &str, why: String) {
        let refusal = Refusal { by: self.host.clone(), why };
        let sent = codec::encode(&refusal).map_err(anyhow::Error::from);
        let sent = sent.and_then(|bytes| Ok(self.session.put(&key::refused(name), bytes)?));
        if let Err(error) = sent {
            tracing::debug!(host = name, error = format!("{error:#}"), "cannot tell a node that it was refused");
        }
    }

    /// Signs a message of this node that the receiver of the frame passes on to another node.
    pub(crate) fn sign_relay(&self, frame: &mut Frame) {
        let Some((member, relay)) = self.member.as_ref().zip(relay(frame)) else { return };
        if relay.from == self.host {
            let proof = digest(relay).and_then(|digest| Authenticator::sign(&**member, &digest, false));
            relay.proof = proof.and_then(|proof| codec::encode(&proof).ok()).unwrap_or_default();
        }
    }

    /// Removes a relayed message for this node from a frame, unless its author has signed it. The frame itself is still
    /// accepted: its sender would otherwise repeat it for ever.
    pub(crate) fn check_relay(&self, frame: &mut Frame) {
        let Some((member, relay)) = self.member.as_ref().zip(relay(frame)) else { return };
        if relay.to != self.host {
            return;
        }
        let proof = codec::decode::<Proof>(&relay.proof).ok().zip(digest(relay));
        let author = proof.map(|(proof, digest)| Authenticator::check(&**member, &proof, &digest));
        let author = author.unwrap_or_else(|| Author::Nobody("it is not signed".to_owned()));
        let from = relay.from.clone();
        if !self.admits(&author, &from)
            && let Some((_, message)) = &mut frame.message
        {
            message.body = Body::Tombstone;
        }
    }

    /// Logs that another node has refused a message of this node.
    pub(crate) fn hear_refusal(&self, author: &Author, bytes: &[u8]) {
        let Ok(Refusal { by, why }) = codec::decode(bytes) else { return };
        if self.admits(author, &by) {
            tracing::warn!(host = by, why, "another node has refused a message of this node");
        }
    }
}

fn relay(frame: &mut Frame) -> Option<&mut Relay> {
    let (_, message) = frame.message.as_mut()?;
    if let Body::Relay(relay) = &mut message.body { Some(relay) } else { None }
}

fn digest(relay: &Relay) -> Option<[u8; 32]> {
    let what = postcard::to_stdvec(&relay.what).ok()?;
    Some(relayed(&relay.from, &relay.to, &what))
}
