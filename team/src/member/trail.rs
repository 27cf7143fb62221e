//! The audit trail of a member. Repeated refusals do not fill the log: it gets one line per minute for each reason.

use crate::audit::{Audit, AuditEntry};
use std::collections::BTreeSet;
use std::net::{IpAddr, SocketAddr};
use std::sync::{Mutex, MutexGuard, PoisonError};
use tokio::sync::watch;
use trust::audit::{Decision, Position};
use trust::team::TrustError;

/// The most addresses and reasons that are distinguished in a minute. Further refusals are only counted.
const LINKS_MAX: usize = 256;
/// How many reasons against members of the team are remembered.
const OF_MEMBERS_MAX: usize = 256;
/// The number of reasons for which refusals of messages are recorded in a minute.
const REASONS_MAX: usize = 32;

/// The audit log of a member, and its latest refusals.
#[derive(Debug)]
pub(super) struct AuditTrail {
    /// None if the disk refuses it.
    log: Option<Audit>,
    refusals: Mutex<Refusals>,
}

/// The refusals of this minute.
#[derive(Debug, Default)]
struct Refusals {
    minute: u64,
    /// The addresses and reasons of refused links.
    links: BTreeSet<(IpAddr, String)>,
    /// The reasons of refused messages.
    messages: BTreeSet<String>,
    /// The reasons against holders of a certificate of the team, from all minutes.
    of_members: BTreeSet<String>,
}

impl AuditTrail {
    pub(super) fn new(log: Option<Audit>) -> Self {
        Self { log, refusals: Mutex::default() }
    }

    /// Returns a receiver of the position of the log; none without a log.
    pub(super) fn position(&self) -> Option<watch::Receiver<Option<Position>>> {
        self.log.as_ref().map(Audit::position)
    }

    pub(super) fn record(&self, entry: AuditEntry) {
        self.log.iter().for_each(|log| log.record(entry.clone()));
    }

    /// Notes that a link was refused.
    pub(super) fn refuse_link(&self, from: SocketAddr, why: &str) {
        let mut refusals = self.refusals();
        // A client that connects repeatedly, like a revoked robot, must not fill the log.
        if !refusals.is_new_link(from.ip(), why) {
            return;
        }
        let is_member = refusals.of_members.contains(why);
        drop(refusals);
        let entry = refused(from.to_string(), "link", why);
        let is_line = match &self.log {
            Some(log) if !is_member => log.record_stranger(entry),
            _ => {
                self.record(entry);
                true
            }
        };
        // The node's own log gets no more lines than the audit log.
        if is_line {
            tracing::warn!(%from, why, "a link was refused");
        }
    }

    /// Notes that a message was refused: the action that it requested, and the reason. Returns whether the refusal was
    /// recorded.
    pub(super) fn refuse_message(&self, what: &str, why: &str) -> bool {
        let is_new = self.refusals().is_new_message(what, why);
        if is_new {
            tracing::warn!(what, why, "a message was refused");
            self.record(refused("a member".to_owned(), what, why));
        }
        is_new
    }

    /// Returns the reason why a credential is not valid, and notes it if the credential belongs to this team.
    pub(super) fn judged(&self, error: &TrustError) -> String {
        let (why, mut refusals) = (error.to_string(), self.refusals());
        let is_stranger = matches!(error, TrustError::OtherTeam(_) | TrustError::Issuer(_) | TrustError::Signature(_));
        if !is_stranger && refusals.of_members.len() < OF_MEMBERS_MAX {
            refusals.of_members.insert(why.clone());
        }
        why
    }

    fn refusals(&self) -> MutexGuard<'_, Refusals> {
        // Sets of plain values are valid even if a thread has panicked while it held the lock.
        let mut refusals = self.refusals.lock().unwrap_or_else(PoisonError::into_inner);
        refusals.begin(crate::now().0 / 60);
        refusals
    }
}

fn refused(who: String, what: &str, why: &str) -> AuditEntry {
    AuditEntry { decision: Decision::Refused, who, what: what.to_owned(), reason: why.to_owned() }
}

impl Refusals {
    /// Forgets the links and messages of an earlier minute.
    fn begin(&mut self, minute: u64) {
        if self.minute != minute {
            let of_members = std::mem::take(&mut self.of_members);
            *self = Self { minute, of_members, ..Self::default() };
        }
    }

    /// Returns whether this is the first refusal at this address for this reason in this minute.
    fn is_new_link(&mut self, from: IpAddr, why: &str) -> bool {
        self.links.len() >= LINKS_MAX || self.links.insert((from, why.to_owned()))
    }

    /// Returns whether this refusal is to be recorded: it is the first one for this reason in this minute, and only a few
    /// reasons were recorded.
    fn is_new_message(&mut self, what: &str, why: &str) -> bool {
        self.messages.len() < REASONS_MAX && self.messages.insert(format!("{what}: {why}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reason_is_new_once_a_minute() {
        let (mut refusals, here, there) = (Refusals::default(), [10, 0, 0, 1].into(), [10, 0, 0, 2].into());
        refusals.begin(7);
        refusals.of_members.insert("it is revoked".to_owned());
        assert!(refusals.is_new_link(here, "it is revoked") && refusals.is_new_link(there, "it is revoked"));
        assert!(refusals.is_new_message("stop", "it is revoked") && refusals.is_new_message("stop", "it has ended"));
        refusals.begin(7);
        assert!(!refusals.is_new_link(here, "it is revoked") && refusals.is_new_link(here, "it has ended"));
        assert!(!refusals.is_new_message("stop", "it is revoked"));
        refusals.begin(8);
        assert!(refusals.is_new_link(here, "it is revoked") && refusals.is_new_message("stop", "it is revoked"));
        assert!(refusals.of_members.contains("it is revoked"), "it is still the reason against a member");
    }

    /// The audit log limits the lines of strangers itself, so links above the limit are left to it.
    #[test]
    fn many_reasons_are_not_distinguished() {
        let (mut refusals, from) = (Refusals::default(), [10, 0, 0, 1].into());
        for number in 0..LINKS_MAX {
            assert!(refusals.is_new_link(from, &number.to_string()));
        }
        assert!(refusals.is_new_link(from, "0") && refusals.links.len() == LINKS_MAX);
        let recorded = (0..1000).filter(|number| refusals.is_new_message("stop", &number.to_string())).count();
        assert_eq!(recorded, REASONS_MAX);
    }
}
