//! Takes note of what a member refuses, so that who goes on and on fills no log: a line a minute for each reason.

use super::Member;
use crate::audit::AuditEntry;
use std::collections::BTreeSet;
use std::net::{IpAddr, SocketAddr};
use std::sync::PoisonError;
use trust::audit::Decision;

/// So many addresses and reasons are told apart in a minute; beyond that each refusal is a line, up to the limit of the log.
const LINKS_MAX: usize = 256;
/// For so many reasons messages are refused aloud in a minute.
const REASONS_MAX: usize = 32;

impl Member {
    /// Takes note that a link was refused.
    pub(super) fn refuse_link(&self, from: SocketAddr, why: &str) {
        // Who comes again and again, as a revoked robot does, fills no log.
        if !self.is_news(from.ip(), why) {
            return;
        }
        tracing::warn!(%from, why, "somebody was refused");
        let (who, what) = (from.to_string(), "link".to_owned());
        self.record(AuditEntry { decision: Decision::Refused, who, what, reason: why.to_owned() });
    }

    /// Returns whether nobody was refused at this address for this reason in this minute.
    fn is_news(&self, from: IpAddr, why: &str) -> bool {
        let minute = crate::now().0 / 60;
        let mut told = self.told.lock().unwrap_or_else(PoisonError::into_inner);
        if told.0 != minute {
            *told = (minute, BTreeSet::new());
        }
        told.1.len() >= LINKS_MAX || told.1.insert((from, why.to_owned()))
    }

    /// Takes note that a message was refused: what it was to do, and why it may not. Says whether that is worth a word: who goes on
    /// and on fills no disk, with a line a minute for each reason, and no more than a few.
    pub fn refuse_message(&self, what: &str, why: &str) -> bool {
        let mut told = self.forged.lock().unwrap_or_else(PoisonError::into_inner);
        let minute = crate::now().0 / 60;
        if told.0 != minute {
            *told = (minute, BTreeSet::new());
        }
        let is_news = told.1.len() < REASONS_MAX && told.1.insert(format!("{what}: {why}"));
        drop(told);
        if is_news {
            tracing::warn!(what, why, "a message was refused");
            let (who, what) = ("a member".to_owned(), what.to_owned());
            self.record(AuditEntry { decision: Decision::Refused, who, what, reason: why.to_owned() });
        }
        is_news
    }
}
