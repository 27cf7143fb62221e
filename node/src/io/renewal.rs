//! Nodes of a team renew each other's certificates, according to the rules in `team::member::renewal` and `trust::renewal`.
//!
//! ```text
//! r1 ──Renewing, with r1's credential, when a third of its life is left──▶ every node that hears it
//!    ◀─Renewing, with the renewed credential── those whose role lets them
//! ```

use super::authors::Authors;
use super::peers::Speaking;
use crate::logic::protocol::Renewing;
use comms::io::clock;
use comms::io::session::{Session, Subscription};
use comms::logic::port::Policy;
use comms::logic::time::Time;
use comms::logic::{codec, key};
use std::sync::Arc;
use std::time::Duration;
use team::member::Member;
use tokio::sync::broadcast;
use tokio::sync::broadcast::error::RecvError::Lagged;
use tokio::task::JoinSet;

/// How often a node asks again for a renewal.
const ASK_EVERY: Duration = Duration::from_secs(60);
/// The longest wait before the node reads the calendar clock again, which may have been set in the meantime.
const LOOK_EVERY: Duration = Duration::from_secs(3600);
/// How soon the node asks after another node has come.
const ASK_AFTER: Duration = Duration::from_secs(1);
/// The most messages of others that wait. Others repeat their messages.
const WAITING_MAX: usize = 64;

/// The state of this task.
struct Renewals {
    member: Arc<Member>,
    session: Arc<Session>,
    authors: Authors,
    host: String,
}

/// Begins to ask others to renew the certificate of this node, and to renew the certificates of others. The node asks
/// when the renewal is due, and also when `appeared` reports a new node.
///
/// # Errors
/// The session is closed.
pub(super) fn spawn(member: &Arc<Member>, speaking: &Speaking, tasks: &mut JoinSet<()>) -> anyhow::Result<()> {
    let policy = || Policy::reject(WAITING_MAX);
    let (session, host) = (Arc::clone(&speaking.session), speaking.own.host.clone());
    let wanted = session.subscribe(&key::renew_any(), policy())?;
    let renewed = session.subscribe(&key::renewed(&host), policy())?;
    let (member, authors) = (Arc::clone(member), speaking.authors.clone());
    let appeared = speaking.own.appeared.subscribe();
    tasks.spawn(Renewals { member, session, authors, host }.run([wanted, renewed], appeared));
    Ok(())
}

impl Renewals {
    async fn run(self, [mut wanted, mut renewed]: [Subscription; 2], mut appeared: broadcast::Receiver<()>) {
        let mut next = self.next();
        loop {
            tokio::select! {
                told = wanted.next_signed() => match told {
                    Some((key, bytes, author)) => {
                        let Ok(Renewing { from, credential }) = codec::decode(&bytes) else { continue };
                        let is_other = from != self.host && key == key::renew(&from);
                        if is_other && self.member.may_renew() && self.authors.admits(&author, &from) {
                            self.renew(&from, &credential);
                        }
                    }
                    None => return,
                },
                told = renewed.next_signed() => match told {
                    Some((_, bytes, author)) => {
                        let Ok(Renewing { from, credential }) = codec::decode(&bytes) else { continue };
                        if self.authors.admits(&author, &from) {
                            self.take(from, credential).await;
                            next = self.next();
                        }
                    }
                    None => return,
                },
                Ok(()) | Err(Lagged(_)) = appeared.recv() => {
                    let soon = clock::now() + ASK_AFTER;
                    next = if self.is_due() { next.min(soon) } else { next };
                }
                () = clock::sleep_until(next) => {
                    if self.is_due() {
                        tracing::debug!("this node's certificate is to be renewed");
                        self.put(&key::renew(&self.host), self.member.shown());
                        next = clock::now() + ASK_EVERY;
                    } else {
                        next = self.next();
                    }
                }
            }
        }
    }

    fn is_due(&self) -> bool {
        self.member.validity().1.is_some_and(|due| team::now() >= due)
    }

    /// Returns when to check next whether the renewal is due.
    fn next(&self) -> Time {
        let left = self.member.validity().1.map_or(LOOK_EVERY, |due| Duration::from_secs(due.since(team::now())));
        clock::now() + left.min(LOOK_EVERY)
    }

    fn renew(&self, from: &str, credential: &[u8]) {
        match self.member.renew(credential) {
            Ok(credential) => self.put(&key::renewed(from), credential),
            Err(error) => tracing::debug!(host = from, error = format!("{error:#}"), "a certificate is not renewed"),
        }
    }

    async fn take(&self, from: String, credential: Vec<u8>) {
        let (member, by) = (Arc::clone(&self.member), from.clone());
        let taken = tokio::task::spawn_blocking(move || member.take_renewal(&credential, &by)).await;
        match taken.map_err(anyhow::Error::from).flatten() {
            Ok(true) => tracing::info!(by = from, until = self.member.validity().0.0, "the certificate was renewed"),
            Ok(false) => {}
            Err(error) => {
                tracing::debug!(by = from, error = format!("{error:#}"), "a renewed certificate is not accepted");
            }
        }
    }

    fn put(&self, key: &str, credential: Vec<u8>) {
        let sent = codec::encode(&Renewing { from: self.host.clone(), credential }).map_err(anyhow::Error::from);
        if let Err(error) = sent.and_then(|bytes| Ok(self.session.put_shown(key, bytes)?)) {
            tracing::debug!(error = format!("{error:#}"), "a message about a certificate was not sent");
        }
    }
}
