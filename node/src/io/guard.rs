//! The gate of a node in a team, with its clock, its ledger on the disk, and its audit log.
//!
//! `STATE/r1/team/accepted` is the ledger. An accepted request is on the disk before it is carried out.

mod ledger_file;

use crate::logic::gate::{Attempt, Gate, Outcome, Passed, Refused};
use crate::logic::protocol::{CallRequest, Deployment, Request, Signed, ToParticipant};
use anyhow::bail;
use ledger_file::LedgerFile;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use team::audit::{self, AuditEntry};
use team::member::Member;
use trust::audit::Decision;

/// The name of the file.
const FILE: &str = "accepted";

/// The gate of a node, and the state on which its decisions depend.
#[derive(Clone, Debug)]
pub(crate) struct Guard(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    member: Arc<Member>,
    gate: Mutex<Gate>,
    /// Held while the file is written, so that an older state never overwrites a newer one.
    ledger: Mutex<LedgerFile>,
}

impl Guard {
    /// Opens the gate of a member, with the requests that it has accepted before.
    ///
    /// # Errors
    /// The ledger cannot be read. Or it is missing although the node has accepted requests, so it is not known which.
    pub(crate) fn open(member: &Arc<Member>) -> anyhow::Result<Self> {
        let path = member.folder().join(FILE);
        let is_missed = || path.is_symlink() || audit::mentions(member.folder(), member.id(), "accepted\t");
        if !path.exists() && is_missed() {
            bail!(
                "`{}` is missing, but the audit log says that this node has accepted requests: it is not known which requests were used before; \
                 take this node into its team again",
                path.display()
            );
        }
        let (file, ledger) = member.with_judge(|judge| LedgerFile::open(path, judge.revoked))?;
        let gate = Mutex::new(Gate::new(member.id(), member.name().clone(), ledger));
        Ok(Self(Arc::new(Inner { member: Arc::clone(member), gate, ledger: Mutex::new(file) })))
    }

    /// Decides about a call. `epoch_of` returns the epoch of a deployment that runs here.
    ///
    /// # Errors
    /// The call is refused. The reason is for a person, and is also in the audit log.
    pub(crate) fn call(&self, request: Request, epoch_of: impl Fn(&str) -> u64) -> Result<Passed, String> {
        let passed = self.0.member.with_judge(|judge| self.gate().call(request, judge, epoch_of));
        passed.map_err(|refused| self.refused(refused))
    }

    /// Decides whether a user may call a program of this node.
    ///
    /// # Errors
    /// The same as for [`Guard::call`].
    pub(crate) fn procedure(&self, asked: CallRequest, signed: &Signed) -> Result<Attempt, String> {
        let passed = self.0.member.with_judge(|judge| self.gate().procedure(asked, signed, judge));
        passed.map_err(|refused| self.refused(refused))
    }

    /// Decides about an order of another node.
    ///
    /// # Errors
    /// The same as for [`Guard::call`].
    pub(crate) fn order(&self, deployment: &Deployment, from: &str, order: &ToParticipant) -> Result<Attempt, String> {
        let passed = self.0.member.with_judge(|judge| self.gate().order(deployment, from, order, judge));
        passed.map_err(|refused| self.refused(refused))
    }

    /// Decides whether a deployment of this home may begin again after a reboot. Writes the decision to the audit log.
    ///
    /// # Errors
    /// The same as for [`Guard::call`].
    pub(crate) fn resumed(&self, deployment: &Deployment, signed: Option<&Signed>) -> Result<(), String> {
        let passed = self.0.member.with_judge(|judge| self.gate().resumed(deployment, signed, judge));
        passed.map(|attempt| self.note(&attempt)).map_err(|refused| self.refused(refused))
    }

    /// Writes an accepted request to the ledger. Blocks.
    ///
    /// # Errors
    /// The disk refuses. The reason is for a person, and is also in the audit log.
    pub(crate) fn keep(&self, attempt: &Attempt) -> Result<(), String> {
        let mut ledger = self.0.ledger.lock().unwrap_or_else(PoisonError::into_inner);
        let written = ledger.keep(&self.0.gate);
        drop(ledger);
        let why = written.err().map(|error| format!("the accepted request cannot be written down: {error:#}"));
        match why {
            None => {
                self.record(attempt, Decision::Accepted, "");
                Ok(())
            }
            Some(why) => {
                self.record(attempt, Decision::Refused, &why);
                Err(why)
            }
        }
    }

    /// Writes an unsigned action to the audit log.
    pub(crate) fn note(&self, attempt: &Attempt) {
        self.record(attempt, Decision::Done, "");
    }

    /// Writes the outcome of an accepted request to the audit log; nothing if no answer contained the outcome.
    pub(crate) fn ended(&self, attempt: &Attempt, outcome: Option<&Outcome>) {
        match outcome {
            Some(Ok(())) => self.record(attempt, Decision::Done, ""),
            Some(Err(why)) => self.record(attempt, Decision::Failed, why),
            None => self.record(attempt, Decision::Unknown, "its end was not awaited"),
        }
    }

    fn gate(&self) -> MutexGuard<'_, Gate> {
        // The gate changes only after everything was checked, so a panic leaves it valid.
        self.0.gate.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn refused(&self, Refused { attempt, why }: Refused) -> String {
        let why = why.to_string();
        tracing::warn!(who = attempt.who, what = attempt.what, why, "a request was refused");
        self.record(&attempt, Decision::Refused, &why);
        why
    }

    fn record(&self, Attempt { who, what }: &Attempt, decision: Decision, why: &str) {
        let (who, what, reason) = (who.clone(), what.clone(), why.to_owned());
        self.0.member.record(AuditEntry { decision, who, what, reason });
    }
}
