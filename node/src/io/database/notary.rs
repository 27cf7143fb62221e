//! Signs and checks for the database with the keys of a node in a team.

use super::Worker;
use crate::logic::database::question::Envelope;
use comms::io::session::Author;
use dbmanager::logic::notary::{Holder, Notary};
use dbmanager::logic::replica::Replica;
use std::sync::Arc;
use team::member::Member;
use trust::identity::{KeyId, PublicKeys};

/// Signs with the keys of a member.
#[derive(Debug)]
struct MemberNotary(Arc<Member>);

/// Returns the replica; if the node is in a team, the replica signs with the node's keys.
pub(super) fn signed(replica: Replica, member: Option<&Arc<Member>>) -> Replica {
    match member {
        Some(member) => replica.signed_by(Arc::new(MemberNotary(Arc::clone(member)))),
        None => replica,
    }
}

fn keys(holder: &Holder) -> Option<PublicKeys> {
    PublicKeys::from_bytes(&holder.keys).ok()
}

impl Notary for MemberNotary {
    fn sign(&self, digest: &[u8; 32]) -> Vec<u8> {
        self.0.state(digest).to_vec()
    }

    fn credential(&self) -> Vec<u8> {
        self.0.shown()
    }

    fn holder(&self, credential: &[u8]) -> Result<Holder, String> {
        let (robot, keys) = self.0.node_of(credential)?;
        Ok(Holder { robot, keys: keys.to_bytes() })
    }

    fn is_signed(&self, holder: &Holder, digest: &[u8; 32], signature: &[u8]) -> bool {
        keys(holder).is_some_and(|keys| trust::statement::is_signed(digest, &keys, signature))
    }

    fn is_revoked(&self, holder: &Holder) -> bool {
        let id: Option<KeyId> = keys(holder).map(|keys| keys.id());
        id.is_some_and(|id| self.0.with_judge(|judge| judge.revoked.has(&id)))
    }
}

impl Worker {
    /// Returns whether a message comes from its claimed sender. If it does not, writes this to the audit log.
    pub(super) fn is_from(&self, envelope: &Envelope, author: &Author) -> bool {
        let Some(member) = &self.member else { return true };
        let refused = match author {
            Author::Anybody => Ok(()),
            Author::Member(name) => self.machine.check_author(envelope, name),
            Author::Nobody(why) => Err(("another replica".to_owned(), why.clone())),
            // This node does not know the sender's key yet. The sender repeats the message.
            Author::Stranger => return false,
        };
        if let Err((claimed, why)) = &refused {
            member.refuse_message(&format!("speak as `{claimed}`"), why);
        }
        refused.is_ok()
    }
}
