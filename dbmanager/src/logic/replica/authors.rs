//! Whose transactions are taken over, in a team whose robots have keys: [`notary`](crate::logic::notary) has the rule. Without
//! keys everybody is believed.

use super::contents::Contents;
use super::interface::Effect;
use super::ledger::Ledger;
use crate::logic::clock::{Clock, Wall};
use crate::logic::notary::{self, AHEAD_MAX, Claim, Doubt, EPOCH_EVERY, Holder, Notary};
use crate::logic::txn::{CodecError, EncodedTxn, Txn};
use crate::logic::version_vector::ReplicaId;
use comms::logic::human::span;
use comms::logic::time::Time;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Who has written what.
#[derive(Debug, Default)]
pub(super) struct Authors {
    notary: Option<Arc<dyn Notary>>,
    /// Whose origins are, as they were worked out from the state.
    known: BTreeMap<ReplicaId, Holder>,
    /// When the epoch has risen last because of another.
    risen: Option<Time>,
}

/// Why a transaction is not applied.
#[derive(Debug)]
pub(super) enum NotTaken {
    Codec(CodecError),
    Doubt(Doubt),
}

impl From<CodecError> for NotTaken {
    fn from(error: CodecError) -> Self {
        Self::Codec(error)
    }
}

impl Authors {
    pub(super) fn check_with(&mut self, notary: Arc<dyn Notary>) {
        self.notary = Some(notary);
    }

    pub(super) fn notary(&self) -> Option<&dyn Notary> {
        self.notary.as_deref()
    }

    /// The state was replaced.
    pub(super) fn forget(&mut self) {
        self.known.clear();
    }

    /// Returns whose an origin is.
    pub(super) fn holder(&self, origin: ReplicaId, contents: &Contents) -> Option<Holder> {
        let notary = self.notary()?;
        let known = self.known.get(&origin).cloned();
        known.or_else(|| notary::holder(notary, origin, contents.state()))
    }

    /// Returns whether an origin has a key, where robots have some.
    pub(super) fn is_claimed(&self, origin: ReplicaId, contents: &Contents) -> bool {
        self.notary.is_none() || self.holder(origin, contents).is_some()
    }

    /// Returns what shows a sponsor that these origins are this robot's.
    pub(super) fn claim(&self, origin: ReplicaId, replaces: &[ReplicaId]) -> Option<Vec<u8>> {
        self.notary().map(|notary| Claim::make(notary, origin, replaces).to_bytes())
    }

    /// Checks that a transaction is of its origin.
    pub(super) fn check_signature(
        &mut self,
        (txn, encoded): (&Txn, &EncodedTxn),
        contents: &Contents,
    ) -> Result<(), Doubt> {
        let Some(notary) = self.notary.clone() else { return Ok(()) };
        let origin = txn.stamp.origin;
        let holder = self.holder(origin, contents).ok_or(Doubt::Unknown)?;
        let is_signed = encoded.signature().is_some_and(|(digest, by)| notary.is_signed(&holder, &digest, by));
        if !is_signed {
            return Err(Doubt::Forged(format!("`{}` has not signed what is said to be of it", holder.robot)));
        }
        self.known.insert(origin, holder);
        Ok(())
    }

    /// Checks what a transaction that is next may do.
    pub(super) fn check_rules(
        &mut self,
        (now, wall): (Time, Wall),
        txn: &Txn,
        contents: &Contents,
    ) -> Result<(), Doubt> {
        let Some(author) = self.notary().and_then(|_| self.holder(txn.stamp.origin, contents)) else { return Ok(()) };
        let ahead = |stamp| Clock::suspects(stamp, wall).filter(|ahead| *ahead > AHEAD_MAX);
        if let Some(ahead) = ahead(txn.stamp).or_else(|| ahead(txn.written())) {
            let why = format!("`{}` dates what it writes {} ahead of the clock here", author.robot, span(ahead));
            return Err(Doubt::Forged(why));
        }
        let known = contents.log().last_stamp().epoch;
        let rises = txn.stamp.epoch.max(txn.written().epoch).saturating_sub(known);
        let is_soon = self.risen.is_some_and(|at| now.since(at) < EPOCH_EVERY);
        if rises > 1 || rises == 1 && is_soon {
            return Err(Doubt::Forged(format!("`{}` begins new epochs of dates, one after the other", author.robot)));
        }
        self.check_records((txn, &author), contents).map_err(Doubt::Forged)?;
        if rises == 1 {
            self.risen = Some(now);
        }
        Ok(())
    }

    /// Checks that others will take over an own transaction: they would take none after it either.
    pub(super) fn check_own(&self, txn: &Txn, contents: &Contents) -> Result<(), String> {
        let Some(notary) = self.notary() else { return Ok(()) };
        let author = notary.holder(&notary.credential())?;
        self.check_records((txn, &author), contents)
    }

    fn check_records(&self, by: (&Txn, &Holder), contents: &Contents) -> Result<(), String> {
        let Some(notary) = self.notary() else { return Ok(()) };
        notary::check_records(notary, by, |origin| self.holder(origin, contents))
    }
}

impl Ledger {
    /// Retires the origins of robots whose keys the team has revoked. The smallest member does, so that it is done once.
    pub(super) fn retire_revoked(&mut self, now: Time, effects: &mut Vec<Effect>) {
        let Some(notary) = self.authors.notary().filter(|_| self.is_member()) else { return };
        let holder = |origin: &ReplicaId| self.authors.holder(*origin, self.contents());
        let is_revoked = |origin: &ReplicaId| holder(origin).is_some_and(|holder| notary.is_revoked(&holder));
        let members = self.contents().members().active().map(|(origin, _)| origin);
        let (gone, left): (Vec<ReplicaId>, Vec<ReplicaId>) = members.partition(is_revoked);
        if left.first() == Some(&self.identity.origin()) {
            gone.into_iter().for_each(|origin| self.retire(now, origin, effects));
        }
    }
}
