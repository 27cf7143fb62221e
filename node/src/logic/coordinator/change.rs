//! A change of a deployment while it runs, at its home.
//!
//! ```text
//! Examining ─all could─▶ Applying ─all programs are up─▶ Linking ─all links stand─▶ Probing ─all are healthy─▶ changed
//!     └─ one could not ─▶ refused    └────── a failure, a lost host, too late ──────────────┘
//!                                                         ▼
//!                                       the same with the plan of before ─▶ taken back
//! ```
//! Whether it was made or taken back, the hosts get `Settle` at its end: only then they free what its programs do not claim any more.
//!
//! One change at a time, and each names the revision that it was made for: of two people the first one wins, and the other is
//! told who that was.

use super::{Coordinator, Phase};
use crate::logic::effect::{Effect, Out};
use crate::logic::instance::watchdog::{probation, ready_within};
use crate::logic::protocol::{
    Answer, ChangeOrder, ChangeReply, ChangeRequest, ChangeStage, ChangeUnderway, LeafFacts, Report, Revision, Signed,
    ToParticipant, unreached,
};
use comms::logic::time::Time;
use language::plan::{Leaf, Plan, PlanChange, difference_with};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

/// How long hosts have to say whether they could take a plan on.
const EXAMINE_WITHIN: Duration = Duration::from_secs(6);
/// How long new programs have to be up, beyond the time that the programs before may take to stop, and they for their start and
/// for their `Init`: they make their links.
const APPLY_WITHIN: Duration = Duration::from_secs(45);
/// How long new links have to stand.
const LINK_WITHIN: Duration = Duration::from_secs(48);
/// How much longer than `Init` and their probation hosts have to say that all is well.
const HEALTHY_WITHIN: Duration = Duration::from_secs(10);
/// The longest probation.
const PROBATION_MAX: Duration = Duration::from_secs(600);

/// A change that is being made.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Changing {
    number: u32,
    step: Step,
    plan: Arc<Plan>,
    before: Arc<Plan>,
    /// The plan as it is asked for.
    wanted: Arc<Plan>,
    again: Vec<u32>,
    probation: Duration,
    by: String,
    /// The request, if a user has signed it; that of the plan before when it is taken back.
    signed: Option<Arc<Signed>>,
    call: u64,
    deadline: Time,
    waiting: BTreeSet<String>,
    /// The differences, one line each, for people.
    lines: Vec<String>,
    /// Why it is taken back.
    reasons: Vec<String>,
    /// Where programs are that were added.
    facts: Vec<LeafFacts>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Step {
    Examining,
    Applying,
    Linking,
    Probing,
}

impl Changing {
    /// Returns when the present step is too late.
    pub(super) fn deadline(&self) -> Time {
        self.deadline
    }

    /// Takes note that its node was gone: nobody could answer it meanwhile.
    pub(super) fn adopted(&mut self, away: Duration) {
        self.deadline = self.deadline + away;
    }

    /// Returns how long new programs have to say that they are healthy.
    fn healthy_within(&self) -> Duration {
        // One that is idle may be activated at the end of its probation.
        let span = |leaf: &Leaf| ready_within(&leaf.policy) + 2 * probation(leaf.kind, &leaf.policy, self.probation);
        self.plan.leaves.iter().map(span).max().unwrap_or_default() + HEALTHY_WITHIN
    }

    fn is_undoing(&self) -> bool {
        !self.reasons.is_empty()
    }
}

impl Coordinator {
    /// Returns what runs, for somebody who wants to change it.
    pub fn revision(&self) -> Revision {
        let change = self.change.as_ref().map(|change| {
            let stage = match change.step {
                Step::Examining => ChangeStage::Examined,
                _ if change.is_undoing() => ChangeStage::TakenBack,
                Step::Applying | Step::Linking => ChangeStage::Applied,
                Step::Probing => ChangeStage::Probation,
            };
            ChangeUnderway { revision: self.revision.0 + 1, by: change.by.clone(), stage }
        });
        Revision { epoch: self.deployment.epoch, revision: self.revision.0, plan: (*self.plan).clone(), change }
    }

    /// Begins a change; `call` gets its outcome.
    pub fn change(&mut self, call: u64, request: ChangeRequest, signed: Option<Arc<Signed>>, out: &mut Out<'_>) {
        let by = request.by.clone();
        match self.examine(call, request, signed, out) {
            Ok(change) => self.change = change,
            Err(reasons) => answer(call, Report::Unchanged { by, reasons }, out),
        }
    }

    fn examine(
        &self,
        call: u64,
        request: ChangeRequest,
        signed: Option<Arc<Signed>>,
        out: &mut Out<'_>,
    ) -> Result<Option<Changing>, Vec<String>> {
        let ChangeRequest { name: _, epoch, revision, plan, again, probation, by } = request;
        let name = &self.deployment.name;
        if self.phase != Phase::Running || self.deployment.epoch != epoch {
            return Err(vec![format!("`{name}@{epoch}` does not run")]);
        }
        if let Some(change) = &self.change {
            return Err(vec![format!("{} is changing `{name}` at this moment", change.by)]);
        }
        if self.revision.0 != revision {
            return Err(vec![format!(
                "{} has changed `{name}` meanwhile; `dca plan` shows what it is now",
                self.revision.1
            )]);
        }
        if let Some(lost) = self.lost.first() {
            return Err(vec![if self.rejoins.is_asked(lost) {
                format!("host `{lost}` is just about to take part again: try again once it does")
            } else {
                format!("host `{lost}` is lost, so nothing can be changed on it")
            }]);
        }
        if let Err(why) = plan.validate() {
            return Err(vec![format!("the plan is not sound: {why}")]);
        }
        let again = again.iter().map(|path| self.leaf(path)).collect::<Result<Vec<u32>, String>>();
        let mut again = again.map_err(|why| vec![why])?;
        again.sort_unstable();
        again.dedup();
        let found = difference_with(&self.plan, &plan, &again.iter().copied().collect())?;
        let mut lines: Vec<String> = found.changes.iter().map(ToString::to_string).collect();
        let is_named = |leaf: &u32| {
            found
                .changes
                .iter()
                .any(|change| matches!(change, PlanChange::Replace { leaf: other, .. } if other == leaf))
        };
        let paths = again.iter().filter(|leaf| !is_named(leaf)).filter_map(|leaf| self.plan.leaves.get(*leaf as usize));
        lines.extend(paths.map(|leaf| format!("replace    {}: started anew", leaf.path)));
        // Those that overlap are leaves of their own.
        let next = found.plan.live_leaves();
        again.retain(|leaf| next.contains(leaf));
        if lines.is_empty() {
            let (revision, changes) = (self.revision.0, Vec::new());
            answer(call, Report::Changed { revision, by, changes }, out);
            return Ok(None);
        }
        let number = self.changes + 1;
        for host in &self.hosts {
            let order = ToParticipant::Change(ChangeOrder::Examine { number, plan: found.plan.clone() });
            out.send(host, self.deployment.to_participant(order.signed(signed.as_deref())));
        }
        Ok(Some(Changing {
            number,
            step: Step::Examining,
            plan: Arc::new(found.plan),
            before: Arc::clone(&self.plan),
            wanted: Arc::new(plan),
            again,
            probation: probation.min(PROBATION_MAX),
            by,
            signed,
            call,
            deadline: out.now + EXAMINE_WITHIN,
            waiting: self.hosts.iter().cloned().collect(),
            lines,
            reasons: Vec::new(),
            facts: Vec::new(),
        }))
    }

    fn leaf(&self, path: &str) -> Result<u32, String> {
        let live = self.plan.live_leaves();
        let found = (0_u32..).zip(&self.plan.leaves).find(|(number, leaf)| leaf.path == path && live.contains(number));
        found.map(|(number, _)| number).ok_or_else(|| format!("`{}` has no program `{path}`", self.deployment.name))
    }

    /// Takes the answer of a host.
    pub(super) fn change_reply(&mut self, reply: ChangeReply, from: &str, out: &mut Out<'_>) {
        let number = match &reply {
            ChangeReply::Examined { number, .. }
            | ChangeReply::Applied { number }
            | ChangeReply::Joined { number, .. }
            | ChangeReply::Linked { number }
            | ChangeReply::Healthy { number }
            | ChangeReply::Failed { number, .. } => *number,
        };
        let Some(change) = self.change.as_mut().filter(|change| change.number == number) else { return };
        let expected = match (reply, change.step) {
            (ChangeReply::Examined { reasons, .. }, Step::Examining) => {
                change.reasons.extend(reasons);
                true
            }
            (ChangeReply::Failed { reason, .. }, _) => return self.take_back(reason, out),
            (ChangeReply::Applied { .. }, step) => step == Step::Applying,
            (ChangeReply::Joined { facts, .. }, Step::Applying) => {
                self.registrations.facts.extend(facts.iter().map(|facts| (facts.leaf, facts.clone())));
                change.facts.extend(facts);
                true
            }
            (ChangeReply::Linked { .. }, step) => step == Step::Linking,
            (ChangeReply::Healthy { .. }, step) => step == Step::Probing,
            (ChangeReply::Examined { .. } | ChangeReply::Joined { .. }, _) => false,
        };
        if expected && change.waiting.remove(from) && change.waiting.is_empty() {
            self.next_step(out);
        }
    }

    fn next_step(&mut self, out: &mut Out<'_>) {
        let Some(change) = &mut self.change else { return };
        match change.step {
            Step::Examining if change.is_undoing() => {
                if let Some(change) = self.change.take() {
                    answer(change.call, Report::Unchanged { by: change.by, reasons: change.reasons }, out);
                }
            }
            Step::Examining => self.apply(out),
            Step::Applying => {
                let (number, until) = (change.number, out.now + LINK_WITHIN);
                let order = match std::mem::take(&mut change.facts) {
                    facts if facts.is_empty() => ChangeOrder::Link { number },
                    facts => ChangeOrder::LinkAlso { number, facts },
                };
                self.step((Step::Linking, until), &order, out);
            }
            Step::Linking => {
                let (number, until) = (change.number, out.now + change.healthy_within());
                let is_another = change.is_undoing() || change.plan.groups != change.before.groups;
                self.step((Step::Probing, until), &ChangeOrder::Adopt { number }, out);
                if is_another {
                    // Before anybody says what happens by it.
                    self.report(Report::Replanned { plan: Box::new((*self.plan).clone()) }, out);
                }
            }
            Step::Probing => self.changed(out),
        }
    }

    /// Has the hosts take the next plan on.
    fn apply(&mut self, out: &mut Out<'_>) {
        let Some(change) = &mut self.change else { return };
        self.changes = change.number;
        self.plan = Arc::clone(&change.plan);
        let slowest = change.before.leaves.iter().map(|leaf| leaf.stop_within).max().unwrap_or_default();
        let (number, plan) = (change.number, (*change.plan).clone());
        let (again, probation) = (change.again.clone(), change.probation);
        let ready = change.plan.leaves.iter().map(|leaf| ready_within(&leaf.policy)).max().unwrap_or_default();
        let until = out.now + slowest + APPLY_WITHIN + 2 * ready;
        self.step((Step::Applying, until), &ChangeOrder::Apply { number, plan, again, probation }, out);
    }

    /// Has all hosts that can be reached take a step.
    fn step(&mut self, (step, until): (Step, Time), order: &ChangeOrder, out: &mut Out<'_>) {
        let Some(change) = &mut self.change else { return };
        (change.step, change.deadline) = (step, until);
        change.waiting = self.hosts.iter().filter(|host| !self.lost.contains(*host)).cloned().collect();
        for host in &change.waiting {
            let order = ToParticipant::Change(order.clone()).signed(change.signed.as_deref());
            out.send(host, self.deployment.to_participant(order));
        }
    }

    fn changed(&mut self, out: &mut Out<'_>) {
        let Some(change) = self.change.take() else { return };
        self.tell_where_new_ones_are(&change, out);
        let live = self.plan.live_leaves();
        self.registrations.facts.retain(|leaf, _| live.contains(leaf));
        for host in self.hosts.iter().filter(|host| !self.lost.contains(*host)) {
            let order = ChangeOrder::Settle { number: change.number };
            out.send(host, self.deployment.to_participant(ToParticipant::Change(order)));
        }
        let report = if change.is_undoing() {
            Report::Unchanged { by: change.by, reasons: change.reasons }
        } else {
            self.revision = (self.revision.0 + 1, change.by.clone());
            (self.signed, self.wanted) = (change.signed, change.wanted);
            out.effects.extend(self.kept().map(|kept| Effect::Keep(Box::new(kept))));
            Report::Changed { revision: self.revision.0, by: change.by, changes: change.lines }
        };
        self.report(report.clone(), out);
        answer(change.call, report, out);
    }

    /// Tells the people who watch where programs are that were added.
    fn tell_where_new_ones_are(&mut self, change: &Changing, out: &mut Out<'_>) {
        let (before, live) = (change.before.live_leaves(), self.plan.live_leaves());
        self.tell_where(live.difference(&before).copied(), out);
    }

    /// Goes back to the plan of before, or gives up when that has failed, too.
    fn take_back(&mut self, reason: String, out: &mut Out<'_>) {
        let Some(change) = &mut self.change else { return };
        let was_undoing = change.is_undoing();
        change.reasons.push(reason);
        match change.step {
            Step::Examining => {
                change.waiting.clear();
                self.next_step(out);
            }
            // What can still be had of it is waited for.
            Step::Applying | Step::Linking | Step::Probing if was_undoing => {}
            Step::Applying | Step::Linking | Step::Probing => {
                // The numbers of new wires and programs stay taken.
                let back = change.plan.back_to(&change.before);
                change.number += 1;
                (change.plan, change.again) = (Arc::new(back), Vec::new());
                change.signed.clone_from(&self.signed);
                self.apply(out);
            }
        }
    }

    /// A host that takes part in a change is lost.
    pub(super) fn change_without(&mut self, host: &str, out: &mut Out<'_>) {
        let Some(change) = &mut self.change else { return };
        let was_waited_for = change.waiting.remove(host);
        if change.is_undoing() && change.step != Step::Examining {
            if was_waited_for && change.waiting.is_empty() {
                self.next_step(out);
            }
        } else {
            self.take_back(unreached(host), out);
        }
    }

    /// Does what is due of a change.
    pub(super) fn tick_change(&mut self, out: &mut Out<'_>) {
        let Some(change) = self.change.as_mut().filter(|change| change.deadline <= out.now) else { return };
        let late = change.waiting.iter().map(|host| format!("host `{host}` did not answer in time"));
        let reason = late.collect::<Vec<_>>().join("; ");
        if change.is_undoing() && change.step != Step::Examining {
            change.reasons.push(format!("{reason}, so it is not known whether all of it was taken back"));
            change.waiting.clear();
            return self.changed(out);
        }
        self.take_back(reason, out);
    }

    /// The deployment ends in the middle of a change.
    pub(super) fn abandon_change(&mut self, out: &mut Out<'_>) {
        if let Some(mut change) = self.change.take() {
            change.reasons.push("the deployment ended before every host had confirmed the change".to_owned());
            answer(change.call, Report::Unchanged { by: change.by, reasons: change.reasons }, out);
        }
    }
}

fn answer(call: u64, report: Report, out: &mut Out<'_>) {
    out.effects.push(Effect::Answer { call, answer: Box::new(Answer::Report(report)) });
    out.effects.push(Effect::EndAnswers { call });
}
