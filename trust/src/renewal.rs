//! When a certificate's renewal is requested, and which members renew it: members with the right to renew, without the
//! operator.
//!
//! A node requests its renewal by itself; each of its messages proves its identity. A user requests it with a command,
//! and signs the request, so that no other client can extend the user's certificate.
//!
//! A node requests the renewal when a third of the certificate's life is left. It continues until it is renewed, even
//! in its grace period. A renewal is refused during the first half of the life, to limit the work of renewers.

use crate::certificate::{Claims, RENEWABLE_MAX, Renewal};
use crate::identity::{KeyId, SIGNATURE_LEN, SecretKeys};
use crate::name::UnixTime;
use crate::role::{Action, Kind};
use crate::team::{CREDENTIAL_MAX, Credential, Judge, SKEW, Standing, TrustError};
use crate::wire::{FormError, Reader, Writer};
use thiserror::Error;

/// Why a certificate is not renewed.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum RenewalError {
    /// The client is not trusted, or the renewer has no right to renew.
    #[error("{0}")]
    Trust(TrustError),
    /// Nodes and users request renewals in different ways, and this is the wrong one.
    #[error("certificates of this kind are not renewed in this way")]
    Kind,
    /// The user's request is malformed.
    #[error("the request for renewal cannot be read: {0}")]
    Form(FormError),
    /// The user has not signed the request.
    #[error("the request for renewal is not signed by the key of the certificate")]
    Signature,
    /// The request was made at another time.
    #[error("the request for renewal is of another time: is a clock wrong?")]
    Time,
    /// A node may not renew itself.
    #[error("a member may not renew its own certificate")]
    Own,
    /// More than half of the certificate's life is left.
    #[error("the certificate is still valid for a long time")]
    Early,
    /// The certificate has ended for good, or cannot be renewed any longer.
    #[error("the certificate can be renewed only while it is valid; ask the operator for a new certificate")]
    Last,
    /// The offered renewal does not last longer, or belongs to another certificate.
    #[error("the renewal is not for this certificate, or does not end later than the certificate")]
    Useless,
}

const ASK: &str = "dca renewal 1";
/// The longest request of a user, in bytes.
pub const ASK_MAX: usize = 256 + CREDENTIAL_MAX;

/// Returns a user's request to renew the certificate.
#[must_use]
pub fn ask(credential: &Credential, keys: &SecretKeys, now: UnixTime) -> Vec<u8> {
    let mut bytes = form(&keys.public().id(), now);
    bytes.extend_from_slice(&keys.sign(&bytes));
    bytes.extend(credential.to_bytes());
    bytes
}

fn form(subject: &KeyId, at: UnixTime) -> Vec<u8> {
    let mut writer = Writer::new(ASK);
    writer.fixed(&subject.0);
    writer.u64(at.0);
    writer.finish()
}

/// Reads a user's request; returns the user's credential. Only one fact is checked: that its holder makes the request
/// now.
///
/// # Errors
/// If the request is not signed by the holder, or was made at another time.
pub fn asked(bytes: &[u8], now: UnixTime) -> Result<Credential, RenewalError> {
    let mut reader = Reader::new(bytes, ASK, ASK_MAX).map_err(RenewalError::Form)?;
    let read = || -> Result<_, FormError> {
        let (subject, at) = (KeyId(reader.fixed()?), UnixTime(reader.u64()?));
        let signature: [u8; SIGNATURE_LEN] = reader.fixed()?;
        Ok((subject, at, signature, Credential::from_bytes(reader.rest())?))
    };
    let (subject, at, signature, credential) = read().map_err(RenewalError::Form)?;
    let holder = &credential.certificate().claims().keys;
    if holder.id() != subject || !holder.has_signed(&form(&subject, at), &signature) {
        return Err(RenewalError::Signature);
    }
    if at.since(now).max(now.since(at)) > SKEW {
        return Err(RenewalError::Time);
    }
    Ok(credential)
}

/// Returns the original life of a certificate, in seconds.
const fn life(claims: &Claims) -> u64 {
    claims.not_after.since(claims.not_before)
}

/// Returns the end of the credential's validity, without the grace period; the certificate's own end if the credential
/// is not trusted.
#[must_use]
pub fn end(credential: &Credential, judge: &Judge<'_>) -> UnixTime {
    let lenient = Judge { grace: RENEWABLE_MAX, ..*judge };
    match credential.check(&lenient) {
        Ok(Standing::Valid(end)) => end,
        Ok(Standing::Grace(last)) => UnixTime(last.0.saturating_sub(RENEWABLE_MAX + SKEW)),
        Err(_) => credential.certificate().claims().not_after,
    }
}

/// Returns the time from which a node requests its renewal; none if a renewal is no longer possible.
#[must_use]
pub fn due(credential: &Credential, judge: &Judge<'_>) -> Option<UnixTime> {
    let (claims, end) = (credential.certificate().claims(), end(credential, judge));
    (end < claims.renewable_until).then(|| UnixTime(end.0.saturating_sub(life(claims) / 3)))
}

/// Renews the certificate of a node or a user, as the member with these keys.
///
/// # Errors
/// The reason, if the certificate is not renewed.
pub fn renew(
    kind: Kind,
    asker: &Credential,
    keys: &SecretKeys,
    own: &Credential,
    judge: &Judge<'_>,
) -> Result<Credential, RenewalError> {
    own.require(Action::Renew, judge).map_err(RenewalError::Trust)?;
    asker.check(judge).map_err(RenewalError::Trust)?;
    let claims = asker.certificate().claims();
    if asker.certificate().kind() != kind || kind == Kind::Program {
        return Err(RenewalError::Kind);
    }
    if asker.certificate().subject() == own.certificate().subject() {
        return Err(RenewalError::Own);
    }
    let before = end(asker, judge);
    if before.since(judge.now) > life(claims) / 2 {
        return Err(RenewalError::Early);
    }
    let until = own.certificate().claims().renewable_until;
    let seconds = life(claims).min(until.since(judge.now));
    let renewal = Renewal::issue(asker.certificate(), judge.now, seconds, keys);
    if renewal.not_after() <= before {
        return Err(RenewalError::Last);
    }
    Ok(Credential { renewal: Some((renewal, own.chain.clone())), ..asker.clone() })
}

/// Checks that the offered credential is the same as `own`, but valid for longer.
///
/// # Errors
/// If it is not.
pub fn accept(own: &Credential, offered: &Credential, judge: &Judge<'_>) -> Result<(), RenewalError> {
    offered.check(judge).map_err(RenewalError::Trust)?;
    let is_better = offered.chain == own.chain && end(offered, judge) > end(own, judge);
    let ends_later = end(offered, judge).plus(SKEW) >= judge.now;
    if is_better && ends_later { Ok(()) } else { Err(RenewalError::Useless) }
}
