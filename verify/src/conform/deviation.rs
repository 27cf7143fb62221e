//! Finds the first step of a supervisor that differs from its program.

use crate::finding::{Finding, diagnostic, help};
use crate::model::{Model, walk};
use crate::story::{Step, Story, seconds, timer_of};
use language::algebra::{Cause, Command, Event, Outcome, Program, Reason, State, StepRecord, step};
use language::automaton::Scripts;
use language::plan::{Expression, Group, TimerKind};
use language::script::ScriptErrorKind;
use language::{Code, Span};

/// How many steps before the deviation the story has at most.
const TOLD_MAX: usize = 12;

/// Returns the first deviation of a supervisor, as a story.
pub(super) fn deviation(model: &Model<'_>, group: u32, steps: &[StepRecord]) -> Option<Finding> {
    let source = model.plan.groups.get(group as usize)?;
    let teller = Teller { model, group, source };
    let mut program = Program::compile(source);
    let mut state = State::new(&program);
    let mut are_values_known = true;
    for (index, seen) in steps.iter().enumerate() {
        // If a value was cut off in the record, its results are unknown as well.
        if seen.is_cut && are_values_known {
            are_values_known = false;
            program = program.with_scripts(Scripts::Assumed);
        }
        // A script without its values may have failed.
        let failures =
            ScriptErrorKind::ALL.map(Some).into_iter().filter(|_| !are_values_known && program.has_scripts());
        let found = std::iter::once(None).chain(failures).map(|failure| {
            let mut next = state.clone();
            failure.into_iter().for_each(|failure| next.fail_script(failure));
            let expected = reaction(&program, &mut next, seen);
            (is_same(&expected, seen, are_values_known), expected, next)
        });
        let mut found: Vec<(bool, StepRecord, State)> = found.collect();
        let place = found.iter().position(|(is_same, ..)| *is_same);
        let (_, expected, next) = found.swap_remove(place.unwrap_or(0));
        if place.is_none() {
            return Some(teller.finding(&steps[..=index], &expected));
        }
        state = next;
    }
    None
}

/// Returns the step of the program for the event of a step in the record.
fn reaction(program: &Program, state: &mut State, seen: &StepRecord) -> StepRecord {
    let mut commands = Vec::new();
    let outcome = step(program, state, seen.event.clone(), &mut commands);
    StepRecord::new(seen.event.clone(), commands, outcome)
}

/// Returns whether two steps have the same commands and the same outcome.
fn is_same(expected: &StepRecord, seen: &StepRecord, are_values_known: bool) -> bool {
    if are_values_known {
        return (&expected.commands, &expected.outcome) == (&seen.commands, &seen.outcome);
    }
    let (expected, seen) = (expected.clone().without_values(), seen.clone().without_values());
    let script = |step: &StepRecord| match &step.outcome {
        Some(Outcome::Aborted(Reason { cause: Cause::Script(error), .. })) => Some(error.kind),
        Some(Outcome::Aborted(_) | Outcome::Done(_) | Outcome::Stopped) | None => None,
    };
    let has_same_end = match (script(&expected), script(&seen)) {
        (None, None) => expected.outcome == seen.outcome,
        (one, other) => one == other,
    };
    has_same_end && expected.commands == seen.commands
}

struct Teller<'t, 'a> {
    model: &'t Model<'a>,
    group: u32,
    source: &'t Group,
}

impl Teller<'_, '_> {
    fn finding(&self, steps: &[StepRecord], expected: &StepRecord) -> Finding {
        let (last, before) = steps.split_last().expect("a deviation is a step");
        let (cause, name) = (self.cause(&last.event), self.model.group_name(self.group));
        let message =
            format!("in step {} the supervisor of `{name}` did something else than the spec says", steps.len());
        let mut found = diagnostic(Code::E0819, self.place(last, expected), message);
        found = help(found, format!("{cause}: expected: {}", sentence(&self.effects(expected))));
        found = help(found, format!("{cause}: seen: {}", sentence(&self.effects(last))));
        let begin = before.iter().rposition(|step| matches!(step.event, Event::Start(_))).unwrap_or(0);
        let told = &steps[begin.max(steps.len().saturating_sub(TOLD_MAX))..];
        let tell = |step: &StepRecord| {
            let (cause, effects) = (self.cause(&step.event), self.effects(step));
            Step { cause, effects, events: Vec::new(), moves: Vec::new() }
        };
        let story = Story { steps: told.iter().map(tell).collect(), ..Story::default() };
        Finding::fails(found, Some(story))
    }

    /// Returns the place in the spec of the first command that differs.
    fn place(&self, seen: &StepRecord, expected: &StepRecord) -> Span {
        let sites = &self.model.sites.groups[self.group as usize];
        let count = seen.commands.len().max(expected.commands.len());
        let differing = (0..count).find(|&index| seen.commands.get(index) != expected.commands.get(index));
        let command = differing.and_then(|index| expected.commands.get(index).or(seen.commands.get(index)));
        let place = match command {
            Some(Command::Activate { member, .. } | Command::Stop { member, .. }) => self.place_of(*member),
            Some(Command::Connect { set } | Command::Disconnect { set }) => sites.sets.get(*set as usize).copied(),
            Some(
                Command::Arm { .. }
                | Command::Cancel { .. }
                | Command::Send { .. }
                | Command::Log { .. }
                | Command::Lost { .. },
            )
            | None => None,
        };
        place.or_else(|| sites.nodes.first().copied()).unwrap_or(sites.name)
    }

    fn place_of(&self, member: u32) -> Option<Span> {
        let (mut number, mut found) = (0, None);
        walk(&self.source.expression, &mut |expression| {
            if matches!(expression, Expression::Run { member: other, .. } if *other == member) {
                found = found.or(Some(number));
            }
            number += 1;
        });
        self.model.sites.groups[self.group as usize].nodes.get(found?).copied()
    }

    fn name(&self, member: u32) -> String {
        match self.source.members.get(member as usize) {
            Some(_) => format!("`{}`", self.model.name(self.group, member)),
            None => format!("a member that does not exist ({member})"),
        }
    }

    fn cause(&self, event: &Event) -> String {
        let group = self.model.group_name(self.group);
        match event {
            Event::Start(_) => format!("`{group}` starts"),
            Event::Stop => format!("`{group}` is asked to stop"),
            Event::Done { member, value, .. } => match value.tag().filter(|_| self.has_outcomes(*member)) {
                Some(tag) => format!("{} is done: {tag}", self.name(*member)),
                None => format!("{} is done", self.name(*member)),
            },
            Event::Aborted { member, .. } => format!("{} fails", self.name(*member)),
            Event::Stopped { member, .. } => format!("{} has stopped", self.name(*member)),
            Event::StopUnconfirmed { member, .. } => {
                format!("the stop of {} cannot be confirmed", self.name(*member))
            }
            Event::Message { .. } => format!("`{group}` gets a message"),
            Event::Notice(_) => format!("`{group}` gets a message"),
            Event::Elapsed { timer, .. } => {
                let time = timer_of(&self.source.expression, *timer as usize);
                let time = time.map_or_else(|| "some seconds".to_owned(), seconds);
                if self.is_limit(*timer) {
                    format!("the limit of {time} has passed")
                } else {
                    format!("{time} have passed")
                }
            }
        }
    }

    /// Returns whether a timer belongs to a `within`.
    fn is_limit(&self, timer: u32) -> bool {
        self.source.expression.timers().get(timer as usize) == Some(&TimerKind::Limit)
    }

    /// Returns whether the bytes of a member's value begin with a tag.
    fn has_outcomes(&self, member: u32) -> bool {
        let leaf = match self.source.members.get(member as usize).map(|member| member.kind) {
            Some(language::plan::MemberKind::Leaf(leaf)) => self.model.plan.leaves.get(leaf as usize),
            Some(language::plan::MemberKind::Group(_)) | None => None,
        };
        leaf.is_some_and(|leaf| !leaf.outcomes.is_empty())
    }

    fn effects(&self, step: &StepRecord) -> Vec<String> {
        let command = |command: &Command| match command {
            Command::Connect { set } => format!("opens {}", self.set(*set)),
            Command::Disconnect { set } => format!("closes {}", self.set(*set)),
            Command::Activate { member, .. } => format!("starts {}", self.name(*member)),
            Command::Stop { member, .. } => format!("stops {}", self.name(*member)),
            Command::Arm { timer, after, .. } if self.is_limit(*timer) => {
                format!("sets a limit of {}", seconds(*after))
            }
            Command::Cancel { timer, .. } if self.is_limit(*timer) => "drops the limit".to_owned(),
            Command::Arm { after, .. } => format!("waits for {}", seconds(*after)),
            Command::Cancel { .. } => "waits no longer".to_owned(),
            Command::Send { .. } => "sends a value".to_owned(),
            Command::Log { .. } => "writes a line".to_owned(),
            Command::Lost { .. } => "loses a message".to_owned(),
        };
        let group = self.model.group_name(self.group);
        let outcome = step.outcome.as_ref().map(|outcome| match outcome {
            Outcome::Done(_) => format!("`{group}` is done"),
            Outcome::Aborted(_) => format!("`{group}` fails"),
            Outcome::Stopped => format!("`{group}` has stopped"),
        });
        step.commands.iter().map(command).chain(outcome).collect()
    }

    fn set(&self, set: u32) -> String {
        let label = self.source.sets.get(set as usize).and_then(|set| set.label.as_deref());
        label.map_or_else(|| "connections without a label".to_owned(), |label| format!("the connections `{label}`"))
    }
}

fn sentence(effects: &[String]) -> String {
    if effects.is_empty() { "nothing follows".to_owned() } else { effects.join("; ") }
}
