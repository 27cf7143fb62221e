//! When a node asks for its certificate to be renewed, and who renews it: members that may, without the operator.
//!
//! A node asks when a third of a life is left, and goes on asking until somebody has renewed it, in its grace, too. Nobody renews
//! earlier than at half of a life, so that nobody is kept busy. The life is that of the certificate.

use crate::certificate::{Claims, RENEWABLE_MAX, Renewal};
use crate::identity::SecretKeys;
use crate::name::UnixTime;
use crate::role::{Action, Kind};
use crate::team::{Credential, Judge, SKEW, Standing, TrustError};
use thiserror::Error;

/// Why a certificate is not renewed.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum RenewalError {
    /// Who asks is not trusted, or who is asked may not renew.
    #[error("{0}")]
    Trust(TrustError),
    /// Users are renewed by an admin.
    #[error("only certificates of nodes are renewed in this way")]
    Kind,
    /// Nobody renews itself.
    #[error("nobody renews its own certificate")]
    Own,
    /// More than half of its life is left.
    #[error("it is valid for long enough")]
    Early,
    /// It ends for good, or the right to renew it does.
    #[error("it can be renewed no longer than it is valid; take the node into its team again")]
    Last,
    /// What was offered is no better, or is for another certificate.
    #[error("the renewal is not for this certificate, or ends no later than that")]
    Useless,
}

/// Returns how long a certificate was made for, in seconds.
const fn life(claims: &Claims) -> u64 {
    claims.not_after.since(claims.not_before)
}

/// Returns until when somebody is valid, without the grace; the certificate's own end for who is not trusted any more.
#[must_use]
pub fn end(credential: &Credential, judge: &Judge<'_>) -> UnixTime {
    let lenient = Judge { grace: RENEWABLE_MAX, ..*judge };
    match credential.check(&lenient) {
        Ok(Standing::Valid(end)) => end,
        Ok(Standing::Grace(last)) => UnixTime(last.0.saturating_sub(RENEWABLE_MAX + SKEW)),
        Err(_) => credential.certificate().claims().not_after,
    }
}

/// Returns from when on a node asks to be renewed; nothing if that is of no use any more.
#[must_use]
pub fn due(credential: &Credential, judge: &Judge<'_>) -> Option<UnixTime> {
    let (claims, end) = (credential.certificate().claims(), end(credential, judge));
    (end < claims.renewable_until).then(|| UnixTime(end.0.saturating_sub(life(claims) / 3)))
}

/// Renews the certificate of a node, as the member with these keys.
///
/// # Errors
/// It is not renewed, with the reason.
pub fn renew(
    asker: &Credential,
    (keys, own): (&SecretKeys, &Credential),
    judge: &Judge<'_>,
) -> Result<Credential, RenewalError> {
    own.require(Action::Renew, judge).map_err(RenewalError::Trust)?;
    asker.check(judge).map_err(RenewalError::Trust)?;
    let claims = asker.certificate().claims();
    if asker.certificate().kind() != Kind::Node {
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

/// Checks that what somebody has offered is this credential, valid for longer.
///
/// # Errors
/// It is not.
pub fn accept(own: &Credential, offered: &Credential, judge: &Judge<'_>) -> Result<(), RenewalError> {
    offered.check(judge).map_err(RenewalError::Trust)?;
    let is_better = offered.chain == own.chain && end(offered, judge) > end(own, judge);
    let ends_later = end(offered, judge).plus(SKEW) >= judge.now;
    if is_better && ends_later { Ok(()) } else { Err(RenewalError::Useless) }
}
