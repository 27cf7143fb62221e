//! The time at which a certificate's renewal is requested, and the members that renew it: those with the right to,
//! without the operator.
//!
//! A node asks by itself, and proves its identity with each message. A user asks with a command, and signs the request,
//! so that no other client extends its certificate.
//!
//! A node asks when a third of a life is left, and goes on asking until it is renewed, even in its grace period. A
//! renewal is refused before half of a life, to limit the work of renewers. The life is that of the certificate.

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
    /// A node asks in one way, and a user in another.
    #[error("certificates of this kind are not renewed in this way")]
    Kind,
    /// The user's request has an invalid form.
    #[error("the request for renewal cannot be read: {0}")]
    Form(FormError),
    /// The user has not signed that it asks.
    #[error("the request for renewal is not signed by the key of the certificate")]
    Signature,
    /// The request is from another time.
    #[error("the request for renewal is of another time: is a clock wrong?")]
    Time,
    /// A node may not renew itself.
    #[error("a member may not renew its own certificate")]
    Own,
    /// More than half of its life is left.
    #[error("the certificate is still valid for a long time")]
    Early,
    /// Its validity has ended for good, or the time in which it can be renewed.
    #[error("the certificate can be renewed only while it is valid; ask the operator for a new certificate")]
    Last,
    /// The offered renewal does not last longer, or is for another certificate.
    #[error("the renewal is not for this certificate, or does not end later than the certificate")]
    Useless,
}

const ASK: &str = "dca renewal 1";
/// The most bytes with which a user asks.
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

/// Reads a user's request; returns the credential, of which only one thing is checked: that its holder asks now.
///
/// # Errors
/// It is not signed by the holder, or of another time.
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

/// Returns how long a certificate was made for, in seconds.
const fn life(claims: &Claims) -> u64 {
    claims.not_after.since(claims.not_before)
}

/// Returns the end of the credential's validity, without the grace; the certificate's own end if it is no longer
/// trusted.
#[must_use]
pub fn end(credential: &Credential, judge: &Judge<'_>) -> UnixTime {
    let lenient = Judge { grace: RENEWABLE_MAX, ..*judge };
    match credential.check(&lenient) {
        Ok(Standing::Valid(end)) => end,
        Ok(Standing::Grace(last)) => UnixTime(last.0.saturating_sub(RENEWABLE_MAX + SKEW)),
        Err(_) => credential.certificate().claims().not_after,
    }
}

/// Returns the time from which a node asks to be renewed; none if a renewal is no longer possible.
#[must_use]
pub fn due(credential: &Credential, judge: &Judge<'_>) -> Option<UnixTime> {
    let (claims, end) = (credential.certificate().claims(), end(credential, judge));
    (end < claims.renewable_until).then(|| UnixTime(end.0.saturating_sub(life(claims) / 3)))
}

/// Renews the certificate of a node or a user, as the member with these keys.
///
/// # Errors
/// It is not renewed, with the reason.
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

/// Checks that the offered credential is this one, valid for longer.
///
/// # Errors
/// It is not.
pub fn accept(own: &Credential, offered: &Credential, judge: &Judge<'_>) -> Result<(), RenewalError> {
    offered.check(judge).map_err(RenewalError::Trust)?;
    let is_better = offered.chain == own.chain && end(offered, judge) > end(own, judge);
    let ends_later = end(offered, judge).plus(SKEW) >= judge.now;
    if is_better && ends_later { Ok(()) } else { Err(RenewalError::Useless) }
}
