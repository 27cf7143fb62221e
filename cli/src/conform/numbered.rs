//! Brings a record and a spec with the same meaning to one form. The numbers of groups, members and connection sets
//! follow the order of the text, and the reason of a deadline quotes the text.

use language::algebra::{Command, Event, Outcome, StepRecord};
use language::plan::{DEADLINE, Expression, Group, Plan};
use verify::Steps;

/// Renumbers the steps of a record as in the spec. `lives` has the steps for each group of the recorded plan; the
/// result has them for each group of the spec.
pub(super) fn numbered(lives: &[Vec<Steps>], recorded: &Plan, spec: &Plan) -> Vec<Vec<Steps>> {
    let of_group = |group: &Group| {
        let found = recorded.groups.iter().zip(lives).find(|(other, _)| other.path == group.path);
        let Some((other, lives)) = found else { return Vec::new() };
        let numbers = Numbers { recorded: other, spec: group };
        let of_life = |steps: &Steps| steps.iter().map(|step| numbers.step(step)).collect();
        lives.iter().map(of_life).collect()
    };
    spec.groups.iter().map(of_group).collect()
}

/// Replaces the reasons of the spec's deadlines by the reasons in the record: recorded steps contain them.
pub(super) fn with_reasons(mut spec: Plan, recorded: &Plan) -> Plan {
    for group in &mut spec.groups {
        if let Some(other) = recorded.groups.iter().find(|other| other.path == group.path) {
            let mut reasons = Vec::new();
            add_reasons(&other.expression, &mut reasons);
            let mut reasons = reasons.into_iter();
            replace_reasons(&mut group.expression, &mut reasons);
        }
    }
    spec
}

/// The numbers of one group in the record, and in the spec.
struct Numbers<'a> {
    recorded: &'a Group,
    spec: &'a Group,
}

impl Numbers<'_> {
    fn member(&self, member: u32) -> u32 {
        let name = self.recorded.members.get(member as usize).map(|member| &member.name);
        let found = (0..).zip(&self.spec.members).find(|(_, member)| Some(&member.name) == name);
        found.map_or(member, |(number, _)| number)
    }

    fn set(&self, set: u32) -> u32 {
        let owner = |group: &Group, owner: Option<u32>| Some(group.members.get(owner? as usize)?.name.clone());
        let Some(known) = self.recorded.sets.get(set as usize) else { return set };
        let (label, of) = (&known.label, owner(self.recorded, known.owner));
        let is_it = |group: &Group, other: &language::plan::ConnectionSet| {
            other.label == *label && owner(group, other.owner) == of
        };
        // Several sets may have no label and no owner. Their order tells them apart.
        let before = self.recorded.sets.iter().take(set as usize).filter(|other| is_it(self.recorded, other)).count();
        let mut same = (0..).zip(&self.spec.sets).filter(|(_, other)| is_it(self.spec, other));
        same.nth(before).map_or(set, |(number, _)| number)
    }

    fn step(&self, step: &StepRecord) -> StepRecord {
        let mut step = step.clone();
        match &mut step.event {
            Event::Done { member, .. }
            | Event::Aborted { member, .. }
            | Event::Stopped { member, .. }
            | Event::StopUnconfirmed { member, .. } => *member = self.member(*member),
            Event::Start(_) | Event::Stop | Event::Elapsed { .. } | Event::Message { .. } | Event::Notice(_) => {}
        }
        for command in &mut step.commands {
            match command {
                Command::Connect { set } | Command::Disconnect { set } => *set = self.set(*set),
                Command::Activate { member, .. } | Command::Stop { member, .. } => *member = self.member(*member),
                Command::Arm { .. }
                | Command::Cancel { .. }
                | Command::Send { .. }
                | Command::Log { .. }
                | Command::Lost { .. } => {}
            }
        }
        if let Some(Outcome::Aborted(reason)) = &mut step.outcome {
            reason.member = reason.member.map(|member| self.member(member));
        }
        step
    }
}

fn add_reasons(expression: &Expression, reasons: &mut Vec<String>) {
    if let Expression::Fail(why) = expression {
        reasons.extend(Some(why.clone()).filter(|why| why.starts_with(DEADLINE)));
    }
    expression.operands().into_iter().for_each(|operand| add_reasons(operand, reasons));
}

fn replace_reasons(expression: &mut Expression, reasons: &mut impl Iterator<Item = String>) {
    if let Expression::Fail(why) = expression
        && why.starts_with(DEADLINE)
        && let Some(reason) = reasons.next()
    {
        *why = reason;
    }
    expression.operands_mut().into_iter().for_each(|operand| replace_reasons(operand, reasons));
}
