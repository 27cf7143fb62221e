//! Calls that a node answers at once as a member of its team.

use crate::logic::protocol::{Answer, TeamOfNode};
use team::member::Member;
use trust::revocation::RevokedSet;

/// Adds revocations that a client on this machine, or another node, reports.
pub(super) fn revoke(member: Option<&Member>, set: &[u8]) -> Answer {
    let Some(member) = member else { return Answer::Refused("this node is in no team".to_owned()) };
    let read = RevokedSet::from_bytes(set).map_err(anyhow::Error::from);
    match read.and_then(|set| member.revoke(set)) {
        Ok(is_new) => Answer::Revoked { is_new },
        Err(error) => Answer::Refused(format!("{error:#}")),
    }
}

/// Adds sets of revocations. Returns all sets that this node has.
pub(super) fn revocations(member: Option<&Member>, told: &[Vec<u8>]) -> Answer {
    let Some(member) = member else { return Answer::Refused("this node is in no team".to_owned()) };
    match member.tell_revoked(told) {
        Ok(held) => Answer::Revocations(held),
        Err(error) => Answer::Refused(format!("{error:#}")),
    }
}

/// Renews the certificate of a user, if this node has the right to do this.
pub(super) fn renew_user(member: Option<&Member>, ask: &[u8]) -> Answer {
    let Some(member) = member else { return Answer::Refused("this node is in no team".to_owned()) };
    match member.renew_user(ask) {
        Ok(credential) => Answer::Credentials(vec![credential]),
        Err(error) => Answer::Refused(format!("{error:#}")),
    }
}

/// Returns the team of this node, for users.
pub(super) fn team(member: &Member) -> TeamOfNode {
    let (id, name) = (member.team().id().0, member.team().name().to_string());
    TeamOfNode { id, name, node: member.name().to_string() }
}
