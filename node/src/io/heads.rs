//! Members of a team sign the positions of each other's audit logs. A node sends the position of
//! its own log to all other nodes. Each of them signs the position, stores it, and returns it.
//! `team::member::heads` defines the signed bytes and the conditions.
//!
//! ```text
//! r1 ──AuditHead, signed by r1──▶ r2: compares it with what it has signed before, signs it, keeps it
//!    ◀─AuditHead, signed by r2───
//! ```

use super::authors::Authors;
use super::peers::Speaking;
use crate::logic::protocol::AuditHead;
use anyhow::Context as _;
use comms::io::clock;
use comms::io::session::{Session, Subscription};
use comms::logic::port::Policy;
use comms::logic::time::Time;
use comms::logic::{codec, key};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;
use team::audit::AuditEntry;
use team::member::Member;
use tokio::sync::broadcast::error::RecvError::Lagged;
use tokio::sync::{broadcast, watch};
use tokio::task::JoinSet;
use trust::audit::{Decision, Head, Position};
use trust::heads::HeadError;
use trust::name::Name;

/// How long after a record the position is published, unless one was published less than [`TELL_EVERY`] ago.
const TELL_AFTER: Duration = Duration::from_secs(1);
/// How often the position of a growing log is published.
const TELL_EVERY: Duration = Duration::from_secs(60);
/// The most messages of others that wait. Others repeat their messages.
const HEADS_MAX: usize = 64;
/// The most nodes for which an error in their logs is remembered.
const WRONG_MAX: usize = 1024;

/// The state of this task.
struct Countersigning {
    member: Arc<Member>,
    session: Arc<Session>,
    authors: Authors,
    host: String,
    /// The last error in each node's log, so that it is logged only once.
    wrong: BTreeMap<String, String>,
}

/// Begins to publish the position of this node's log, and to sign the positions of others. The position is published
/// when the log has grown, and when `appeared` reports a new node.
///
/// # Errors
/// The session is closed.
pub(super) fn spawn(member: &Arc<Member>, speaking: &Speaking, tasks: &mut JoinSet<()>) -> anyhow::Result<()> {
    let policy = || Policy::reject(HEADS_MAX);
    let (session, host) = (Arc::clone(&speaking.session), speaking.own.host.clone());
    let others = session.subscribe(&key::audit_any(), policy())?;
    let signed = session.subscribe(&key::countersigned(&host), policy())?;
    let (member, authors) = (Arc::clone(member), speaking.authors.clone());
    let signing = Countersigning { member, session, authors, host, wrong: BTreeMap::new() };
    tasks.spawn(signing.run([others, signed], speaking.own.appeared.subscribe()));
    Ok(())
}

impl Countersigning {
    async fn run(mut self, [mut others, mut signed]: [Subscription; 2], mut appeared: broadcast::Receiver<()>) {
        let mut position = self.member.audit_position();
        let (mut told_at, mut due): (Option<Time>, Option<Time>) = (None, Some(clock::now() + TELL_AFTER));
        loop {
            tokio::select! {
                told = others.next_signed() => match told {
                    Some((key, bytes, author)) => {
                        let Ok(AuditHead { from, head }) = codec::decode(&bytes) else { continue };
                        if from != self.host && key == key::audit(&from) && self.authors.admits(&author, &from) {
                            self.countersign(from, head).await;
                        }
                    }
                    None => return,
                },
                told = signed.next_signed() => match told {
                    Some((_, bytes, author)) => {
                        let Ok(AuditHead { from, head }) = codec::decode(&bytes) else { continue };
                        if self.authors.admits(&author, &from) {
                            self.keep(&from, head).await;
                        }
                    }
                    None => return,
                },
                () = changed(&mut position) => {
                    let soon = clock::now() + TELL_AFTER;
                    due = due.or(Some(told_at.map_or(soon, |at| soon.max(at + TELL_EVERY))));
                }
                // If some reports were missed, a node has come as well.
                Ok(()) | Err(Lagged(_)) = appeared.recv() => due = Some(clock::now() + TELL_AFTER),
                () = super::driver::until(due) => {
                    (due, told_at) = (None, Some(clock::now()));
                    let last = position.as_ref().and_then(|position| *position.borrow());
                    last.into_iter().for_each(|last| self.tell(last));
                }
            }
        }
    }

    fn tell(&self, position: Position) {
        let head = self.member.sign_position(position).to_bytes();
        self.put(&key::audit(&self.host), head);
    }

    fn put(&self, key: &str, head: Vec<u8>) {
        let sent = codec::encode(&AuditHead { from: self.host.clone(), head }).map_err(anyhow::Error::from);
        if let Err(error) = sent.and_then(|bytes| Ok(self.session.put_shown(key, bytes)?)) {
            tracing::debug!(error = format!("{error:#}"), "the position of an audit log was not sent");
        }
    }

    /// Signs the position of another node's log. If this node has signed a position that contradicts it, records this instead.
    async fn countersign(&mut self, from: String, head: Vec<u8>) {
        let (member, name) = (Arc::clone(&self.member), from.parse::<Name>());
        let signed = blocking(move || {
            let head = Head::from_bytes(&head).context("it is not a head of an audit log")?;
            member.countersign(&head, &name.context("its name is not valid")?)
        });
        match signed.await {
            Ok(head) => {
                self.wrong.remove(&from);
                self.put(&key::countersigned(&from), head.to_bytes());
            }
            // Any node on the way may have sent the message again.
            Err(error) if error.downcast_ref() == Some(&HeadError::Old) => {
                tracing::debug!(host = from, "an old head of an audit log was received again");
            }
            Err(error) => {
                let why = format!("{error:#}");
                if self.wrong.get(&from) == Some(&why) || self.wrong.len() >= WRONG_MAX {
                    return;
                }
                tracing::error!(host = from, why, "the audit log of a node is not signed");
                let what = format!("sign the audit log of `{from}`");
                let entry = AuditEntry { decision: Decision::Refused, who: from.clone(), what, reason: why.clone() };
                self.member.record(entry);
                self.wrong.insert(from, why);
            }
        }
    }

    async fn keep(&self, from: &str, head: Vec<u8>) {
        let (member, name) = (Arc::clone(&self.member), from.parse::<Name>());
        let kept = blocking(move || {
            let head = Head::from_bytes(&head).context("it is not a head of an audit log")?;
            member.keep_head(head, &name.context("its name is not valid")?)
        });
        if let Err(error) = kept.await {
            tracing::warn!(host = from, error = format!("{error:#}"), "cannot store a signed head of the audit log");
        }
    }
}

async fn blocking<T: Send + 'static>(work: impl FnOnce() -> anyhow::Result<T> + Send + 'static) -> anyhow::Result<T> {
    tokio::task::spawn_blocking(work).await?
}

/// Waits until the log has grown. Waits for ever without a log.
///
/// # Cancellation
/// Safe.
async fn changed(position: &mut Option<watch::Receiver<Option<Position>>>) {
    let is_there = match position {
        Some(position) => position.changed().await.is_ok(),
        None => false,
    };
    if !is_there {
        std::future::pending::<()>().await;
    }
}
