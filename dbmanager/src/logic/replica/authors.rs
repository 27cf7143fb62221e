//! Decides which transactions are accepted, in a team whose robots have keys. [`notary`](crate::logic::notary) has the rule. Without
//! keys, every replica is trusted.

use super::Replica;
use super::contents::Contents;
use super::interface::Effect;
use super::ledger::Ledger;
use crate::logic::clock::{DATE_MAX_MS, Timestamp};
use crate::logic::notary::{self, Claim, Doubt, Holder, Notary};
use crate::logic::state::State;
use crate::logic::txn::{CodecError, EncodedTxn, Txn};
use crate::logic::version_vector::{Dot, ReplicaId};
use comms::logic::time::Time;
use std::collections::BTreeMap;
use std::sync::Arc;

/// How far the dates of a robot may be ahead of the dates that others know. The robot may have written many local keys, which never
/// leave it.
const TICKS_MAX_MS: u64 = 1000;

/// How many epochs of dates a transaction may skip. A robot that is admitted again may have begun some epochs on its own.
const EPOCHS_MAX: u16 = 100;

/// The authors of transactions.
#[derive(Debug, Default)]
pub(super) struct Authors {
    notary: Option<Arc<dyn Notary>>,
    /// The owners of origins, as derived from the state.
    known: BTreeMap<ReplicaId, Holder>,
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

    /// Returns the owner of an origin.
    pub(super) fn holder(&self, origin: ReplicaId, contents: &Contents) -> Option<Holder> {
        let notary = self.notary()?;
        let known = self.known.get(&origin).cloned();
        known.or_else(|| notary::holder(notary, origin, contents.state()))
    }

    /// Returns whether a state assigns an origin to this robot, with the robot's present keys. Always true in a team without keys.
    pub(super) fn is_own(&self, origin: ReplicaId, state: &State) -> bool {
        let own = |notary: &dyn Notary| notary.holder(&notary.credential()).ok();
        self.notary()
            .is_none_or(|notary| own(notary).is_some_and(|own| notary::holder(notary, origin, state) == Some(own)))
    }

    /// Returns whether an origin has a key. Always true in a team without keys.
    pub(super) fn is_claimed(&self, origin: ReplicaId, contents: &Contents) -> bool {
        self.notary.is_none() || self.holder(origin, contents).is_some()
    }

    /// Returns the claim that proves to a sponsor that these origins belong to this robot.
    pub(super) fn claim(&self, origin: ReplicaId, replaces: &[ReplicaId]) -> Option<Vec<u8>> {
        self.notary().map(|notary| Claim::make(notary, origin, replaces).to_bytes())
    }

    /// Checks that a transaction was signed by the owner of its origin.
    pub(super) fn check_signature(
        &mut self,
        txn: &Txn,
        encoded: &EncodedTxn,
        contents: &Contents,
    ) -> Result<(), Doubt> {
        let Some(notary) = self.notary.clone() else { return Ok(()) };
        let origin = txn.stamp.origin;
        let holder = self.holder(origin, contents).ok_or(Doubt::Unknown)?;
        let is_signed = encoded.signature().is_some_and(|(digest, by)| notary.is_signed(&holder, &digest, by));
        if !is_signed {
            return Err(Doubt::Forged(format!("`{}` has not signed a transaction in its name", holder.robot)));
        }
        self.known.insert(origin, holder);
        Ok(())
    }

    /// Checks that the next transaction of an origin does nothing that it may not do.
    pub(super) fn check_rules(&self, txn: &Txn, contents: &Contents) -> Result<(), Doubt> {
        let Some(author) = self.notary().and_then(|_| self.holder(txn.stamp.origin, contents)) else { return Ok(()) };
        check_dates(txn, contents.log().last_stamp())
            .map_err(|why| Doubt::Forged(format!("`{}` {why}", author.robot)))?;
        self.check_records(txn, &author, contents).map_err(Doubt::Forged)
    }

    /// Returns whether this robot may retire an origin.
    pub(super) fn may_retire(&self, origin: ReplicaId, contents: &Contents) -> bool {
        let Some(notary) = self.notary() else { return true };
        let own = notary.holder(&notary.credential());
        own.is_ok_and(|own| notary::may_retire(notary, &own, self.holder(origin, contents).as_ref()))
    }

    /// Checks that others will accept an own transaction. If they refused it, they would also refuse all later ones.
    pub(super) fn check_own(&self, txn: &Txn, contents: &Contents) -> Result<(), String> {
        let Some(notary) = self.notary() else { return Ok(()) };
        let author = notary.holder(&notary.credential())?;
        self.check_records(txn, &author, contents)
    }

    fn check_records(&self, txn: &Txn, author: &Holder, contents: &Contents) -> Result<(), String> {
        let Some(notary) = self.notary() else { return Ok(()) };
        notary::check_records(notary, txn, author, |origin| self.holder(origin, contents))
    }
}

/// Checks that a transaction does not use up the dates. `known` is the last date of a log with all transactions that it has seen. A
/// replica that follows the clock's rule is never refused.
fn check_dates(txn: &Txn, known: Timestamp) -> Result<(), &'static str> {
    let is_ahead = |stamp: Timestamp, most: Timestamp| stamp.millis() > DATE_MAX_MS.max(most.millis() + TICKS_MAX_MS);
    let before = if txn.stamp.epoch > known.epoch { Timestamp::default() } else { known };
    if txn.stamp.epoch > known.epoch.saturating_add(EPOCHS_MAX) {
        return Err("leaves out epochs of dates");
    }
    if is_ahead(txn.stamp, before) || is_ahead(txn.written(), txn.stamp) {
        return Err("dates what it writes at the end of time");
    }
    Ok(())
}

impl Replica {
    /// Makes the replica sign its writes, and accept only signed transactions of others. An origin from before this robot had these
    /// keys is given up.
    #[must_use]
    pub fn signed_by(mut self, notary: Arc<dyn Notary>) -> Self {
        self.ledger.sign_with(notary);
        if self.is_member() {
            let is_own = self.ledger.authors.is_own(self.origin(), self.state());
            let has_strays = self.ledger.has_strays();
            if !is_own || has_strays {
                // The caller requested this, so no alarm is raised.
                self.rejoin(Time::ZERO, has_strays, &mut Vec::new());
            }
        }
        self
    }

    /// Returns whether the keys of the team permit this robot to retire an origin: the origin is its own, or the key of
    /// the origin is revoked.
    pub fn may_retire(&self, origin: ReplicaId) -> bool {
        self.ledger.authors.may_retire(origin, self.ledger.contents())
    }
}

impl Ledger {
    /// Returns whether the log has a transaction that no member accepts, because its origin was never admitted: a disk has lost the
    /// record of this origin.
    pub(super) fn has_strays(&self) -> bool {
        let is_stray = |(dot, encoded): &(Dot, &EncodedTxn)| {
            encoded.signature().is_some() && !self.authors.is_claimed(dot.origin, self.contents())
        };
        self.authors.notary().is_some() && self.log().in_order().iter().any(is_stray)
    }

    /// Retires the origins of robots whose keys the team has revoked. The member with the smallest id does this, so that it is done
    /// once.
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
