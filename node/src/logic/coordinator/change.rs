//! A change of a deployment while it runs, at its home.
//!
//! ```text
//! Examining ─all could─▶ Applying ─all programs are up─▶ Linking ─all links stand─▶ Probing ─all are healthy─▶ changed
//!     └─ one could not ─▶ refused    └────── a failure, a failed host, too late ────────────┘
//!                                                         ▼
//!                                       the same with the previous plan ─▶ taken back
//! ```
//! At the end of a change, whether it was made or taken back, the hosts get `Settle`. Only then do they free the claims
//! of removed programs.
//!
//! Only one change is made at a time. Each request names the revision of the plan that it was written for. If two users
//! ask at once, the first request is carried out, and the other user is told who made it.

use super::mission::Mission;
use super::stop::StopBy;
use crate::logic::effect::{Effect, Out};
use crate::logic::instance::watchdog::{probation, ready_within};
use crate::logic::protocol::{
    Answer, ChangeOrder, ChangeReply, ChangeRequest, ChangeStage, ChangeUnderway, LeafFacts, Report, Revision, Signed,
    ToParticipant,
};
use comms::logic::time::Time;
use language::plan::{Leaf, Plan, PlanChange, difference_with};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

/// How long hosts have to say whether they could adopt a plan.
const EXAMINE_WITHIN: Duration = Duration::from_secs(6);
/// How long hosts have to replace programs. The stop of previous programs and the time for start and `Init` are added to this.
const APPLY_WITHIN: Duration = Duration::from_secs(45);
/// How long hosts have to make new links.
const LINK_WITHIN: Duration = Duration::from_secs(48);
/// How long hosts have to report that all new programs are healthy, in addition to `Init` and the probation.
const HEALTHY_WITHIN: Duration = Duration::from_secs(10);
/// The longest probation.
const PROBATION_MAX: Duration = Duration::from_secs(600);

/// The changes of a deployment.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Changes {
    /// How often the plan was changed since the deployment began.
    revision: u32,
    /// The user who made the last change.
    by: String,
    /// The number of the last change that was applied.
    number: u32,
    current: Option<Change>,
}

/// A change that is being made.
#[derive(Debug, Serialize, Deserialize)]
struct Change {
    number: u32,
    step: Step,
    until: Time,
    /// The hosts that have not finished the step.
    awaited: BTreeSet<String>,
    asked: Asked,
    next: Next,
    before: Arc<Plan>,
    /// Why the change is refused or taken back. Empty if the change continues.
    reasons: Vec<String>,
    /// The locations of added programs.
    facts: Vec<LeafFacts>,
}

/// The request for a change.
#[derive(Debug, Serialize, Deserialize)]
struct Asked {
    call: u64,
    by: String,
    wanted: Arc<Plan>,
    probation: Duration,
    /// The differences, one line each, for users.
    lines: Vec<String>,
}

/// The plan that the hosts adopt: the new plan, or the previous one if the change is taken back.
#[derive(Debug, Serialize, Deserialize)]
struct Next {
    plan: Arc<Plan>,
    /// The programs that are started again although their plan is the same.
    again: Vec<u32>,
    /// The request for this plan, if a user signed it.
    signed: Option<Arc<Signed>>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
enum Step {
    Examining,
    Applying,
    Linking,
    Probing,
}

impl Change {
    /// Returns how long new programs have to say that they are healthy.
    fn healthy_within(&self) -> Duration {
        // An idle program may be activated at the end of its probation, which then begins again.
        let span =
            |leaf: &Leaf| ready_within(&leaf.policy) + 2 * probation(leaf.kind, &leaf.policy, self.asked.probation);
        self.next.plan.leaves.iter().map(span).max().unwrap_or_default() + HEALTHY_WITHIN
    }

    fn is_undoing(&self) -> bool {
        !self.reasons.is_empty()
    }

    fn stage(&self) -> ChangeStage {
        match self.step {
            Step::Examining => ChangeStage::Examined,
            _ if self.is_undoing() => ChangeStage::TakenBack,
            Step::Applying | Step::Linking => ChangeStage::Applied,
            Step::Probing => ChangeStage::Probation,
        }
    }

    /// Orders all reachable hosts to take a step.
    fn step(&mut self, mission: &Mission, step: Step, within: Duration, order: &ChangeOrder, out: &mut Out<'_>) {
        (self.step, self.until) = (step, out.now + within);
        self.awaited = mission.reachable().cloned().collect();
        for host in &self.awaited {
            let order = ToParticipant::Change(order.clone()).signed(self.next.signed.as_deref());
            out.send(host, mission.deployment.to_participant(order));
        }
    }

    /// Orders the hosts to adopt the next plan.
    fn apply(&mut self, mission: &mut Mission, out: &mut Out<'_>) {
        mission.plan = Arc::clone(&self.next.plan);
        let slowest = self.before.leaves.iter().map(|leaf| leaf.stop_within).max().unwrap_or_default();
        let ready = mission.plan.leaves.iter().map(|leaf| ready_within(&leaf.policy)).max().unwrap_or_default();
        let order = ChangeOrder::Apply {
            number: self.number,
            plan: (*self.next.plan).clone(),
            again: self.next.again.clone(),
            probation: self.asked.probation,
        };
        self.step(mission, Step::Applying, slowest + APPLY_WITHIN + 2 * ready, &order, out);
    }
}

impl Changes {
    /// Returns whether a change is being made.
    pub(super) fn is_busy(&self) -> bool {
        self.current.is_some()
    }

    /// Returns when the time limit of the present step ends.
    pub(super) fn deadline(&self) -> Option<Time> {
        self.current.as_ref().map(|change| change.until)
    }

    /// Notes that the home's node was gone and could not receive any answer.
    pub(super) fn adopted(&mut self, away: Duration) {
        self.current.iter_mut().for_each(|change| change.until = change.until + away);
    }

    /// Returns the plan that runs, and the change that is being made, for a user who wants to change the plan.
    pub(super) fn revision(&self, mission: &Mission) -> Revision {
        let underway = |change: &Change| {
            let (revision, by) = (self.revision + 1, change.asked.by.clone());
            ChangeUnderway { revision, by, stage: change.stage() }
        };
        Revision {
            epoch: mission.deployment.epoch,
            revision: self.revision,
            plan: (*mission.plan).clone(),
            change: self.current.as_ref().map(underway),
        }
    }

    /// Begins a change of a deployment that runs; `call` gets its outcome.
    pub(super) fn ask(
        &mut self,
        mission: &Mission,
        call: u64,
        request: ChangeRequest,
        signed: Option<Arc<Signed>>,
        out: &mut Out<'_>,
    ) {
        let by = request.by.clone();
        let again = self.check(mission, &request);
        let asked = again.and_then(|again| self.examine(mission, call, request, again, signed, out));
        if let Err(reasons) = asked {
            out.answer_last(call, Answer::Report(Report::Unchanged { by, reasons }));
        }
    }

    /// Returns the numbers of the programs that are to be started again, or why nothing can be changed now.
    fn check(&self, mission: &Mission, request: &ChangeRequest) -> Result<Vec<u32>, Vec<String>> {
        let name = &mission.deployment.name;
        if let Some(change) = &self.current {
            return Err(vec![format!("{} is changing `{name}` at this moment", change.asked.by)]);
        }
        if self.revision != request.revision {
            let by = &self.by;
            return Err(vec![format!(
                "in the meantime, {by} has changed `{name}`; `dca plan` shows its present state"
            )]);
        }
        if let Some((host, part)) = mission.hosts.iter().find(|(_, part)| !part.takes_part()) {
            return Err(vec![if part.comes_back() {
                format!("host `{host}` is about to take part again; try again later")
            } else {
                format!("host `{host}` is lost, so nothing can be changed on it")
            }]);
        }
        if let Err(why) = request.plan.validate() {
            return Err(vec![format!("the plan is not sound: {why}")]);
        }
        let live = mission.plan.live_leaves();
        let number = |path: &String| {
            let leaves = (0_u32..).zip(&mission.plan.leaves);
            let mut found = leaves.filter(|(number, leaf)| leaf.path == *path && live.contains(number));
            let number = found.next().map(|(number, _)| number);
            number.ok_or_else(|| vec![format!("`{name}` has no program `{path}`")])
        };
        let mut again = request.again.iter().map(number).collect::<Result<Vec<u32>, _>>()?;
        again.sort_unstable();
        again.dedup();
        Ok(again)
    }

    /// Asks all hosts whether they could adopt the plan, unless nothing differs.
    fn examine(
        &mut self,
        mission: &Mission,
        call: u64,
        request: ChangeRequest,
        mut again: Vec<u32>,
        signed: Option<Arc<Signed>>,
        out: &mut Out<'_>,
    ) -> Result<(), Vec<String>> {
        let found = difference_with(&mission.plan, &request.plan, &again.iter().copied().collect())?;
        let mut lines: Vec<String> = found.changes.iter().map(ToString::to_string).collect();
        let replaces =
            |change: &PlanChange, leaf| matches!(change, PlanChange::Replace { leaf: other, .. } if *other == leaf);
        let is_named = |leaf: u32| found.changes.iter().any(|change| replaces(change, leaf));
        let unnamed = again.iter().filter(|leaf| !is_named(**leaf));
        let paths = unnamed.filter_map(|leaf| mission.plan.leaves.get(*leaf as usize));
        lines.extend(paths.map(|leaf| format!("replace    {}: started again", leaf.path)));
        // A program and its replacement that overlap are two leaves, and only the replacement is live.
        let live = found.plan.live_leaves();
        again.retain(|leaf| live.contains(leaf));
        let ChangeRequest { plan: wanted, probation, by, .. } = request;
        if lines.is_empty() {
            out.answer_last(call, Answer::Report(Report::Changed { revision: self.revision, by, changes: Vec::new() }));
            return Ok(());
        }
        let plan = Arc::new(found.plan);
        let mut change = Change {
            number: self.number + 1,
            step: Step::Examining,
            until: out.now,
            awaited: BTreeSet::new(),
            asked: Asked { call, by, wanted: Arc::new(wanted), probation: probation.min(PROBATION_MAX), lines },
            next: Next { plan: Arc::clone(&plan), again, signed },
            before: Arc::clone(&mission.plan),
            reasons: Vec::new(),
            facts: Vec::new(),
        };
        let order = ChangeOrder::Examine { number: change.number, plan: (*plan).clone() };
        change.step(mission, Step::Examining, EXAMINE_WITHIN, &order, out);
        self.current = Some(change);
        Ok(())
    }

    /// Takes the answer of a host.
    pub(super) fn reply(&mut self, mission: &mut Mission, reply: ChangeReply, from: &str, out: &mut Out<'_>) {
        let number = match &reply {
            ChangeReply::Examined { number, .. }
            | ChangeReply::Applied { number }
            | ChangeReply::Joined { number, .. }
            | ChangeReply::Linked { number }
            | ChangeReply::Healthy { number }
            | ChangeReply::Failed { number, .. } => *number,
        };
        let Some(change) = self.current.as_mut().filter(|change| change.number == number) else { return };
        let is_expected = match (reply, change.step) {
            (ChangeReply::Examined { reasons, .. }, Step::Examining) => {
                change.reasons.extend(reasons);
                true
            }
            (ChangeReply::Failed { reason, .. }, _) => return self.take_back(mission, reason, out),
            (ChangeReply::Applied { .. }, step) => step == Step::Applying,
            (ChangeReply::Joined { facts, .. }, Step::Applying) => {
                mission.registrations.facts.extend(facts.iter().map(|facts| (facts.leaf, facts.clone())));
                change.facts.extend(facts);
                true
            }
            (ChangeReply::Linked { .. }, step) => step == Step::Linking,
            (ChangeReply::Healthy { .. }, step) => step == Step::Probing,
            (ChangeReply::Examined { .. } | ChangeReply::Joined { .. }, _) => false,
        };
        if is_expected && change.awaited.remove(from) && change.awaited.is_empty() {
            self.next_step(mission, out);
        }
    }

    fn next_step(&mut self, mission: &mut Mission, out: &mut Out<'_>) {
        let Some(change) = &mut self.current else { return };
        let number = change.number;
        match change.step {
            Step::Examining if change.is_undoing() => self.refuse(out),
            Step::Examining => {
                self.number = number;
                change.apply(mission, out);
            }
            Step::Applying => {
                let order = match std::mem::take(&mut change.facts) {
                    facts if facts.is_empty() => ChangeOrder::Link { number },
                    facts => ChangeOrder::LinkAlso { number, facts },
                };
                change.step(mission, Step::Linking, LINK_WITHIN, &order, out);
            }
            Step::Linking => {
                let is_another = change.is_undoing() || change.next.plan.groups != change.before.groups;
                change.step(mission, Step::Probing, change.healthy_within(), &ChangeOrder::Adopt { number }, out);
                if is_another {
                    // The plan is reported before all events that refer to it.
                    mission.report(Report::Replanned { plan: Box::new((*mission.plan).clone()) }, out);
                }
            }
            Step::Probing => self.changed(mission, out),
        }
    }

    /// Tells the caller why the change is refused or given up.
    fn refuse(&mut self, out: &mut Out<'_>) {
        if let Some(Change { asked, reasons, .. }) = self.current.take() {
            out.answer_last(asked.call, Answer::Report(Report::Unchanged { by: asked.by, reasons }));
        }
    }

    /// Completes a change that was made or taken back.
    fn changed(&mut self, mission: &mut Mission, out: &mut Out<'_>) {
        let Some(change) = self.current.take() else { return };
        let live = mission.plan.live_leaves();
        mission.tell_where(live.difference(&change.before.live_leaves()).copied(), out);
        mission.registrations.facts.retain(|leaf, _| live.contains(leaf));
        for host in mission.reachable() {
            mission.tell(host, ToParticipant::Change(ChangeOrder::Settle { number: change.number }), out);
        }
        let is_undoing = change.is_undoing();
        let Asked { call, by, wanted, lines, .. } = change.asked;
        let report = if is_undoing {
            Report::Unchanged { by, reasons: change.reasons }
        } else {
            (self.revision, self.by) = (self.revision + 1, by.clone());
            (mission.request.signed, mission.request.wanted) = (change.next.signed, wanted);
            if mission.stop.by != StopBy::User {
                out.effects.push(Effect::Keep(Box::new(mission.kept(false))));
            }
            Report::Changed { revision: self.revision, by, changes: lines }
        };
        mission.report(report.clone(), out);
        out.answer_last(call, Answer::Report(report));
    }

    /// Returns to the previous plan, or refuses a change that is still examined. During a return, only the reason is noted.
    fn take_back(&mut self, mission: &mut Mission, reason: String, out: &mut Out<'_>) {
        let Some(change) = &mut self.current else { return };
        let was_undoing = change.is_undoing();
        change.reasons.push(reason);
        match change.step {
            Step::Examining => self.refuse(out),
            // The other hosts still have to return to the previous plan.
            Step::Applying | Step::Linking | Step::Probing if was_undoing => {}
            Step::Applying | Step::Linking | Step::Probing => {
                // The numbers of the new wires and programs are not used again.
                let plan = Arc::new(change.next.plan.back_to(&change.before));
                change.next = Next { plan, again: Vec::new(), signed: mission.request.signed.clone() };
                change.number += 1;
                self.number = change.number;
                change.apply(mission, out);
            }
        }
    }

    /// Takes back a change because a host failed or left. If the change is already being taken back, the others continue.
    pub(super) fn without(&mut self, mission: &mut Mission, host: &str, why: String, out: &mut Out<'_>) {
        let Some(change) = &mut self.current else { return };
        let was_awaited = change.awaited.remove(host);
        if change.is_undoing() && change.step != Step::Examining {
            if was_awaited && change.awaited.is_empty() {
                self.next_step(mission, out);
            }
        } else {
            self.take_back(mission, why, out);
        }
    }

    /// Takes back a change whose step is late. A change that is already being taken back is over then.
    pub(super) fn tick(&mut self, mission: &mut Mission, out: &mut Out<'_>) {
        let Some(change) = self.current.as_mut().filter(|change| change.until <= out.now) else { return };
        let late = change.awaited.iter().map(|host| format!("host `{host}` did not answer in time"));
        let reason = late.collect::<Vec<_>>().join("; ");
        if change.is_undoing() && change.step != Step::Examining {
            change.reasons.push(format!("{reason}, so it is not known whether the change was completely taken back"));
            return self.changed(mission, out);
        }
        self.take_back(mission, reason, out);
    }

    /// Gives up the change because the deployment ends.
    pub(super) fn abandon(&mut self, out: &mut Out<'_>) {
        if let Some(change) = &mut self.current {
            change.reasons.push("the deployment ended before every host had confirmed the change".to_owned());
            self.refuse(out);
        }
    }
}
