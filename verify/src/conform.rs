//! Compares a recorded run of supervisors with the verified plan.
//!
//! A record lists the event and the commands of each step of a supervisor. The comparison gives the same events to the
//! same program, which has to answer with the same commands. It then follows the steps through the verified states,
//! reports which states the run has reached, and checks the sentences of the spec.

mod coverage;
mod deviation;

use crate::catalogue;
use crate::explore::Limits;
use crate::finding::Finding;
use crate::model::Model;
use crate::property::monitor;
use crate::system::{Frame, Label, System};
pub use coverage::Coverage;
use deviation::deviation;
use language::algebra::{Activity, Event, StepRecord};
use language::automaton::Failure;
use language::plan::Plan;
use language::sites::Sites;

/// The result of comparing a run.
#[derive(Debug)]
pub struct Conformance {
    /// For each group whose supervisor deviated from the spec: the first deviation.
    pub deviations: Vec<Finding>,
    /// The sentences of the `verify` blocks. A sentence is proved if it held in this run, and open if a run cannot show
    /// it.
    pub sentences: Vec<Finding>,
    /// For each group: which part of its verified behaviour occurred in the run.
    pub coverage: Vec<Coverage>,
    /// How many steps were compared.
    pub steps: usize,
}

/// The complete steps of one supervisor of a group, from its first step on.
pub type Steps = Vec<StepRecord>;

/// Compares a run with the verified plan. `records` has, for each group of the plan, the steps of each of its
/// supervisors.
pub fn conform(plan: &Plan, sites: &Sites, records: &[Vec<Steps>], limits: &Limits<'_>) -> Conformance {
    let mut model = Model::of_groups(plan, sites);
    let numbered = || (0_u32..).zip(records).take(plan.groups.len());
    let first = |group, lives: &[Steps]| lives.iter().find_map(|steps| deviation(&model, group, steps));
    let deviations: Vec<Finding> = numbered().filter_map(|(group, lives)| first(group, lives)).collect();
    catalogue::explore_parts(&mut model, limits);
    let coverage = numbered().map(|(group, lives)| Coverage::of(&model, group, lives, limits)).collect();
    let sentences = monitor::check(&model, records);
    Conformance { deviations, sentences, coverage, steps: numbered().flat_map(|(_, lives)| lives).map(Vec::len).sum() }
}

/// Follows the steps of one supervisor through a system that contains only its group.
pub(crate) struct Follower<'s, 'a> {
    system: &'s System<'a>,
    labels: Vec<Label>,
    /// Whether the state of the group is known in the system; otherwise the follower waits for the next start.
    is_known: bool,
}

impl<'s, 'a> Follower<'s, 'a> {
    pub(crate) fn new(system: &'s System<'a>) -> Self {
        Self { system, labels: Vec::new(), is_known: false }
    }

    /// Notes that the next steps are of another supervisor, whose state is unknown.
    pub(crate) fn begins_anew(&mut self) {
        self.is_known = false;
    }

    /// Returns the label of a step in the system, and makes `frame` idle if the step is a start. An event that the
    /// system does not have is an error. An event that changes nothing has no label.
    pub(crate) fn label(&mut self, frame: &mut Frame, step: &StepRecord) -> Result<Option<Label>, Outside> {
        if matches!(step.event, Event::Start(_)) {
            *frame = self.system.initial();
            self.is_known = true;
        }
        if !self.is_known {
            return Ok(None);
        }
        self.system.labels(frame, &mut self.labels);
        let found = self.find(frame, &step.event);
        let is_harmless = step.commands.is_empty() && step.outcome.is_none() && self.is_stale(frame, &step.event);
        match found {
            Some(label) => Ok(Some(label)),
            None if is_harmless => Ok(None),
            None => {
                self.is_known = false;
                Err(Outside)
            }
        }
    }

    fn find(&self, frame: &Frame, event: &Event) -> Option<Label> {
        let is_stopping = |member: u32| frame.states[0].activity(member) == Activity::Stopping;
        let of = |member: u32| move |other: u16| u32::from(other) == member;
        let has = |wanted: &dyn Fn(Label) -> bool| self.labels.iter().copied().find(|label| wanted(*label));
        match event {
            Event::Start(value) => {
                let is_tagged = |number: u8| value.tag().is_some() && self.system.tag(number) == value.tag();
                let with = has(&|label| matches!(label, Label::StartWith(number) if is_tagged(number)));
                with.or_else(|| has(&|label| label == Label::Start))
            }
            Event::Stop => has(&|label| label == Label::Stop),
            Event::Elapsed { timer, .. } => {
                has(&|label| matches!(label, Label::Elapsed(_, other) if of(*timer)(other)))
            }
            // If an end crosses an order to stop, it counts as the answer to the order.
            Event::Done { member, .. } | Event::Aborted { member, .. } | Event::Stopped { member, .. }
                if is_stopping(*member) =>
            {
                has(&|label| matches!(label, Label::Stopped(_, other) if of(*member)(other)))
            }
            Event::Done { member, value, .. } => {
                let tagged = |number: u8| self.system.tag(number).is_some_and(|tag| value.tag() == Some(tag));
                let is_done = |label: Label, is_meant: &dyn Fn(u8) -> bool| {
                    let Label::Done(_, other, number) = label else { return false };
                    of(*member)(other) && is_meant(number)
                };
                has(&|label| is_done(label, &tagged)).or_else(|| has(&|label| is_done(label, &|number| number == 0)))
            }
            Event::Aborted { member, report, .. } => {
                let why = self.system.report(&Failure::of_report(report));
                let is_it = |label: Label, number: u8| matches!(label, Label::Aborted(_, other, why) if of(*member)(other) && why == number);
                has(&|label| is_it(label, why)).or_else(|| has(&|label| is_it(label, 0)))
            }
            Event::Message { .. } | Event::Notice(_) => {
                let number = self.system.message_number(0, event);
                number.and_then(|number| has(&|label| label == Label::Told(0, number)))
            }
            Event::Stopped { .. } | Event::StopUnconfirmed { .. } => None,
        }
    }

    /// Returns whether an event belongs to something that has already ended.
    fn is_stale(&self, frame: &Frame, event: &Event) -> bool {
        match event {
            Event::Start(_) => false,
            Event::Stop | Event::Message { .. } | Event::Notice(_) => true,
            Event::Done { member, .. }
            | Event::Aborted { member, .. }
            | Event::Stopped { member, .. }
            | Event::StopUnconfirmed { member, .. } => frame.states[0].activity(*member) == Activity::Idle,
            Event::Elapsed { timer, .. } => !frame.states[0].is_armed(self.system.program(0), *timer),
        }
    }
}

/// An event has happened that the verification considers impossible.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Outside;
