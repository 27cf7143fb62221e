//! Delegations: a node vouches for the key of a program that it has started, which it names, or for the key of
//! visitors from its machine. So neither of them needs the node's own key.

use crate::certificate::DAY;
use crate::identity::{KeyId, SIGNATURE_LEN, SecretKeys};
use crate::name::UnixTime;
use crate::role::Kind;
use crate::statement;
use crate::team::{CREDENTIAL_MAX, Credential, Judge, TrustError};
use crate::wire::{FormError, Reader, Writer};
use thiserror::Error;

/// The longest name of a program, in bytes.
pub const PROGRAM_MAX: usize = 255;
/// The most bytes of a delegation.
pub const DELEGATION_MAX: usize = 512 + CREDENTIAL_MAX;
/// For how long a node can vouch for a program, in seconds. Usually the node's own certificate ends earlier.
pub const DELEGATION_LIFE: u64 = 366 * DAY;

const DELEGATION: &str = "dca delegation 2";

/// A key, signed by the node that vouches for its owner.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Delegation {
    /// The public Ed25519 key.
    key: [u8; 32],
    /// The program with this key; empty for visitors.
    program: String,
    not_after: UnixTime,
    signature: [u8; SIGNATURE_LEN],
    /// The credential of the node.
    node: Credential,
}

/// Why a program is not trusted.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum DelegationError {
    /// Only nodes may vouch for programs.
    #[error("the certificate behind this signature does not belong to a node")]
    Kind,
    /// The delegation is not signed by the node.
    #[error("its node has not signed for it")]
    Signature,
    /// The delegation has ended.
    #[error("its node no longer vouches for it")]
    Expired,
    /// The node is not trusted.
    #[error("its node is not trusted: {0}")]
    Node(TrustError),
}

impl Delegation {
    /// Vouches for a key, as the node with these keys and this credential. `program` is the name of the program with
    /// the key, empty for visitors. A name that is too long is cut.
    pub fn sign(key: [u8; 32], program: &str, now: UnixTime, node: &SecretKeys, credential: Credential) -> Self {
        let not_after = now.plus(DELEGATION_LIFE);
        let program = program[..program.floor_char_boundary(PROGRAM_MAX)].to_owned();
        let signature = node.sign(&form(&key, &program, not_after, &node.public().id()));
        Self { key, program, not_after, signature, node: credential }
    }

    /// Returns the key.
    pub const fn key(&self) -> &[u8; 32] {
        &self.key
    }

    /// Returns the name of the program; none for the key of visitors.
    pub fn program(&self) -> Option<&str> {
        Some(self.program.as_str()).filter(|program| !program.is_empty())
    }

    /// Returns the delegation with a newer credential of its node; none if the credential belongs to another node.
    #[must_use]
    pub fn renewed(&self, node: Credential) -> Option<Self> {
        let is_same = node.certificate().subject() == self.node.certificate().subject();
        is_same.then(|| Self { node, ..self.clone() })
    }

    /// Returns the credential of the node, unchecked.
    pub const fn node(&self) -> &Credential {
        &self.node
    }

    /// Returns whether the owner of the key has signed the digest of a message.
    pub fn has_signed(&self, digest: &[u8; 32], signature: &[u8]) -> bool {
        statement::is_signed_by(digest, &self.key, signature)
    }

    /// Checks that a node of the team vouches for the key now.
    ///
    /// # Errors
    /// The reason, if no node of the team vouches for the key.
    pub fn check(&self, judge: &Judge<'_>) -> Result<(), DelegationError> {
        self.node.check(judge).map_err(DelegationError::Node)?;
        let certificate = self.node.certificate();
        if certificate.kind() != Kind::Node {
            return Err(DelegationError::Kind);
        }
        if !certificate
            .claims()
            .keys
            .has_signed(&form(&self.key, &self.program, self.not_after, &certificate.subject()), &self.signature)
        {
            return Err(DelegationError::Signature);
        }
        if judge.now > self.not_after { Err(DelegationError::Expired) } else { Ok(()) }
    }

    /// Returns the bytes of the delegation in their canonical form.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = form(&self.key, &self.program, self.not_after, &self.node.certificate().subject());
        bytes.extend_from_slice(&self.signature);
        bytes.extend(self.node.to_bytes());
        bytes
    }

    /// Reads the bytes of a delegation. The signature is not checked here.
    ///
    /// # Errors
    /// If the bytes are not a delegation.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, FormError> {
        let mut reader = Reader::new(bytes, DELEGATION, DELEGATION_MAX)?;
        let (key, program) = (reader.fixed()?, String::from_utf8(reader.short()?.to_vec()));
        let program = program.map_err(|_no_text| FormError::Field("program"))?;
        let not_after = UnixTime(reader.u64()?);
        let node = KeyId(reader.fixed()?);
        let signature = reader.fixed()?;
        let credential = Credential::from_bytes(reader.rest())?;
        if credential.certificate().subject() != node {
            return Err(FormError::Field("node"));
        }
        Ok(Self { key, program, not_after, signature, node: credential })
    }
}

fn form(key: &[u8; 32], program: &str, not_after: UnixTime, node: &KeyId) -> Vec<u8> {
    let mut writer = Writer::new(DELEGATION);
    writer.fixed(key);
    writer.short(program.as_bytes());
    writer.u64(not_after.0);
    writer.fixed(&node.0);
    writer.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::certificate::{Certificate, Claims, LIFE_MAX};
    use crate::identity::Entropy;
    use crate::revocation::{Revocations, RevokedSet};
    use crate::role::Role;
    use crate::team::Team;

    const NOW: UnixTime = UnixTime(1_800_000_000);

    fn credential(team: &Team, root: &SecretKeys, keys: &SecretKeys, role: Role) -> Credential {
        let claims = Claims {
            team: team.id(),
            name: "r1".parse().unwrap(),
            role,
            keys: *keys.public(),
            not_before: NOW,
            not_after: NOW.plus(LIFE_MAX),
            renewable_until: NOW.plus(LIFE_MAX),
            serial: [1; 16],
        };
        Credential::new(Certificate::issue(claims, root).unwrap(), None)
    }

    #[test]
    fn only_a_trusted_node_vouches() {
        let keys = |seed| SecretKeys::generate(&mut Entropy::new(&[seed; 32]));
        let (root, node, other) = (keys(1), keys(2), keys(3));
        let team = Team::found("acme".parse().unwrap(), &root);
        let revoked = Revocations::default();
        let judge = Judge { team: &team, revoked: &revoked, now: NOW, grace: 0 };
        let sign = |by: &SecretKeys, role| {
            let credential = credential(&team, &root, &node, role);
            Delegation::sign([7; 32], "`main/a` of `d@1`", NOW, by, credential)
        };
        let good = sign(&node, Role::Member);
        assert_eq!(good.program(), Some("`main/a` of `d@1`"));
        assert_eq!(good.renewed(credential(&team, &root, &other, Role::Member)), None);
        assert_eq!(good.check(&judge), Ok(()));
        assert_eq!(Delegation::from_bytes(&good.to_bytes()), Ok(good.clone()));
        let of_user = sign(&node, Role::Admin);
        assert_eq!(of_user.check(&judge), Err(DelegationError::Kind));
        let forged = sign(&other, Role::Member);
        assert_eq!(forged.check(&judge), Err(DelegationError::Signature));
        let mut moved = good.clone();
        moved.key = [8; 32];
        assert_eq!(moved.check(&judge), Err(DelegationError::Signature));
        let mut visitor = good.clone();
        visitor.program.clear();
        assert_eq!(visitor.check(&judge), Err(DelegationError::Signature), "no program becomes somebody who looks");
        let long = "é".repeat(PROGRAM_MAX);
        let long = Delegation::sign([7; 32], &long, NOW, &node, credential(&team, &root, &node, Role::Member));
        assert_eq!((long.program.len(), Delegation::from_bytes(&long.to_bytes())), (PROGRAM_MAX - 1, Ok(long.clone())));
        let late = Judge { now: NOW.plus(LIFE_MAX + 10_000), ..judge };
        assert!(matches!(good.check(&late), Err(DelegationError::Node(TrustError::Expired(_)))));
        let set = RevokedSet::sign(&team, 1, [(node.public().id(), NOW)].into(), &root, None).unwrap();
        let mut revoked = Revocations::default();
        revoked.receive(set, &judge).unwrap();
        let judge = Judge { revoked: &revoked, ..judge };
        assert!(matches!(good.check(&judge), Err(DelegationError::Node(TrustError::Revoked(_)))));
    }
}
