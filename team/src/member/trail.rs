//! Counts the refusals of a member, so that repeated attempts do not fill the log: one line per minute for each
//! reason.

use super::Member;
use crate::audit::AuditEntry;
use std::collections::BTreeSet;
use std::net::{IpAddr, SocketAddr};
use std::sync::{MutexGuard, PoisonError};
use trust::audit::Decision;
use trust::team::TrustError;

/// The most addresses and reasons that are distinguished in a minute. Further refusals are only counted.
const LINKS_MAX: usize = 256;
/// How many reasons against members of the team are remembered.
const OF_MEMBERS_MAX: usize = 256;
/// The number of reasons for which refusals of messages are recorded in a minute.
const REASONS_MAX: usize = 32;

/// The refusals of this minute.
#[derive(Debug, Default)]
pub(super) struct Refusals {
    /// The minute, and the addresses and reasons of refused links.
    links: (u64, BTreeSet<(IpAddr, String)>),
    /// The minute, and the reasons of refused messages.
    messages: (u64, BTreeSet<String>),
    /// The reasons against holders of a certificate of the team.
    of_members: BTreeSet<String>,
}

impl Member {
    /// Notes that a link was refused.
    pub(super) fn refuse_link(&self, from: SocketAddr, why: &str) {
        // A client that connects repeatedly, like a revoked robot, must not fill the log.
        if !self.is_news(from.ip(), why) {
            return;
        }
        let (who, what) = (from.to_string(), "link".to_owned());
        let entry = AuditEntry { decision: Decision::Refused, who, what, reason: why.to_owned() };
        let is_member = self.refusals().of_members.contains(why);
        let is_line = match &self.audit {
            Some(audit) if !is_member => audit.record_stranger(entry),
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
        self.refusals.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns whether this is the first refusal at this address for this reason in this minute.
    fn is_news(&self, from: IpAddr, why: &str) -> bool {
        let minute = crate::now().0 / 60;
        let told = &mut self.refusals().links;
        if told.0 != minute {
            *told = (minute, BTreeSet::new());
        }
        told.1.len() >= LINKS_MAX || told.1.insert((from, why.to_owned()))
    }

    /// Notes that a message was refused: the action that it requested, and the reason. Returns whether the refusal
    /// should be recorded. Only one line per minute is recorded for each reason, and only a few reasons, so that
    /// repeated attempts do not fill the disk.
    pub fn refuse_message(&self, what: &str, why: &str) -> bool {
        let mut refusals = self.refusals();
        let (told, minute) = (&mut refusals.messages, crate::now().0 / 60);
        if told.0 != minute {
            *told = (minute, BTreeSet::new());
        }
        let is_news = told.1.len() < REASONS_MAX && told.1.insert(format!("{what}: {why}"));
        drop(refusals);
        if is_news {
            tracing::warn!(what, why, "a message was refused");
            let (who, what) = ("a member".to_owned(), what.to_owned());
            self.record(AuditEntry { decision: Decision::Refused, who, what, reason: why.to_owned() });
        }
        is_news
    }
}
