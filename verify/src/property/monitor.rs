//! Checks sentences in a recorded run, instead of in every order of events.
//!
//! The order of the events of one supervisor is known. The order of the events of two supervisors is not known. So a run can decide a
//! sentence only if the sentence names members of one group and forbids something, or is a formula that can be
//! violated at some position.

use super::formula::{Breaks, Followed};
use super::watch::{Forbidden, Goal, Watch};
use crate::conform::{Follower, Steps};
use crate::explore::Observer;
use crate::finding::{Finding, diagnostic};
use crate::model::Model;
use crate::story::tell;
use crate::system::{Change, Frame, Label, Mode, System};
use language::Code;
use language::algebra::Event;
use language::sites::{Consequence, ProcessRef, Property, Sentence};

/// How many steps of a story are shown: the last ones.
const TOLD_MAX: usize = 12;

/// Returns for each sentence whether it held; `records` has the steps of each group.
pub(crate) fn check(model: &Model<'_>, records: &[Vec<Steps>]) -> Vec<Finding> {
    let is_said = |property: &&Property| !matches!(property.sentence, Sentence::Assume(..));
    model.sites.properties.iter().filter(is_said).map(|property| monitor(model, property, records)).collect()
}

fn monitor(model: &Model<'_>, property: &Property, records: &[Vec<Steps>]) -> Finding {
    let said = format!("{}: {}", model.group_name(property.group), property.text);
    let Some((wanted, whom)) = wanted(&property.sentence) else {
        return Finding::open(format!("{said}: a single run cannot show that an event may or must happen"));
    };
    if whom.iter().any(|who| who.group != property.group) {
        return Finding::open(format!("{said}: it is about events of several supervisors"));
    }
    if records.get(property.group as usize).is_none_or(Vec::is_empty) {
        return Finding::open(format!("{said}: the record has no step of its supervisor"));
    }
    let mut system = System::new(model, property.group as usize, &|_| false);
    system.mode = Mode { aborts: true, stops: true, ..Mode::default() };
    system.notes = if let Wanted::Never(goal) = &wanted { goal.notes() } else { 1 };
    let mut eye = match &wanted {
        Wanted::Never(goal) => Eye::Watch(Watch::new(&system, goal)),
        Wanted::Unbroken(breaks) => Eye::Formula(breaks.follow(&system)),
    };
    let (mut follower, mut stepper) = (Follower::new(&system), system.stepper());
    let (mut frame, mut changes, mut way) = (system.initial(), Vec::new(), Vec::<Label>::new());
    let mut is_lost = false;
    let lives = records.get(property.group as usize).into_iter().flatten();
    for (place, step) in lives.flat_map(|steps| steps.iter().enumerate()) {
        if place == 0 {
            follower.begins_anew();
        }
        if matches!(step.event, Event::Start(_)) {
            way.clear();
            eye.begins();
        }
        match follower.label(&mut frame, step) {
            Ok(None) => {}
            Err(_) => is_lost = true,
            Ok(Some(label)) => {
                stepper.apply(&mut frame, label, Some(&mut changes));
                way.push(label);
                if !eye.sees(&system, &changes, &mut frame) {
                    let message = format!(
                        "did not hold in this run of `{}`: {}",
                        model.group_name(property.group),
                        property.text
                    );
                    let mut story = tell(&system, &way);
                    story.steps.drain(..story.steps.len().saturating_sub(TOLD_MAX));
                    return Finding::fails(diagnostic(Code::E0817, property.span, message), Some(story));
                }
            }
        }
    }
    match is_lost {
        true => Finding::open(format!("{said}: the run has an event that verification does not cover")),
        false if matches!(&wanted, Wanted::Unbroken(breaks) if breaks.is_partial) => Finding::open(format!(
            "{said}: a part of it says that an event must happen, and a single run cannot show this"
        )),
        false => Finding::proved(said),
    }
}

/// A sentence that a run can violate.
enum Wanted {
    Never(Goal),
    Unbroken(Breaks),
}

/// The state of such a sentence while the steps of a run are followed.
enum Eye<'w> {
    Watch(Watch<'w>),
    Formula(Followed<'w>),
}

impl Eye<'_> {
    /// Notes that the group is started.
    fn begins(&mut self) {
        if let Self::Formula(followed) = self {
            followed.begins();
        }
    }

    /// Returns whether the events so far violate nothing.
    fn sees(&mut self, system: &System<'_>, changes: &[Change], frame: &mut Frame) -> bool {
        match self {
            Self::Watch(watch) => watch.sees(system, false, changes, frame),
            Self::Formula(followed) => followed.sees(system, changes, frame),
        }
    }
}

/// Returns the violation to look for, and the named processes; none for a sentence that a single run cannot violate.
fn wanted(sentence: &Sentence) -> Option<(Wanted, Vec<ProcessRef>)> {
    if let Sentence::Holds(formula) = sentence {
        let breaks = Breaks::of(formula);
        let whom = breaks.processes();
        return (!whom.is_empty()).then_some((Wanted::Unbroken(breaks), whom));
    }
    let (goal, whom) = goal(sentence)?;
    Some((Wanted::Never(goal), whom))
}

/// Returns the goal that must never be reached, and the named processes; none for a sentence that a single run cannot
/// violate.
fn goal(sentence: &Sentence) -> Option<(Goal, Vec<ProcessRef>)> {
    Some(match sentence {
        Sentence::NeverTogether(all) => (Goal::Never(None, Forbidden::Together(all.clone())), all.clone()),
        Sentence::Implies(a, b) => (Goal::Never(None, Forbidden::Without(*a, *b)), vec![*a, *b]),
        Sentence::Once(first, sentence) => {
            let (Goal::Never(_, forbidden), mut whom) = goal(sentence)? else { return None };
            whom.push(*first);
            (Goal::Never(Some(*first), forbidden), whom)
        }
        Sentence::OnlyAfter(who, event) => (Goal::Before(*who, event.clone()), vec![*who, event.who]),
        Sentence::AtMost(who, times) => (Goal::Often(*who, *times), vec![*who]),
        Sentence::After(moment, Consequence::Stopped(who, _)) => {
            (Goal::StillRuns(Some(moment.clone()), *who), vec![moment.event.who, *who])
        }
        Sentence::After(moment, Consequence::Never(other)) => {
            (Goal::Then(Some(moment.clone()), other.clone()), vec![moment.event.who, other.who])
        }
        Sentence::After(_, Consequence::Eventually(_))
        | Sentence::On(..)
        | Sentence::Eventually(_)
        | Sentence::CanFinish
        | Sentence::FinishesWithin(_)
        | Sentence::StopsWithin(_)
        | Sentence::Holds(_)
        | Sentence::Assume(..) => return None,
    })
}
