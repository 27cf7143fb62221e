//! Finds the step without a limit if the duration of a whole is not limited.

use super::Times;
use crate::system::is_restarted;
use language::plan::{Expression, MemberKind};

/// A step that nothing limits in time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Culprit {
    /// The group of the step.
    group: u32,
    /// The slot of the step; none for the expression itself, which repeats or never ends.
    slot: Option<u32>,
}

impl Times<'_, '_> {
    /// Returns the first step of a group, in the order of the text, that is not limited; none if the whole has a limit.
    pub(crate) fn culprit(&self, group: u32) -> Option<Culprit> {
        self.culprit_of(group, &self.model.plan.groups[group as usize].expression)
    }

    /// Returns a text that names the step without a limit, and the ways to give it one.
    pub(crate) fn without_limit(&self, group: u32) -> String {
        let Some(Culprit { group, slot }) = self.culprit(group) else {
            return "nothing limits how long it takes".to_owned();
        };
        let around = self.model.group_name(group);
        let Some(slot) = slot else {
            return format!(
                "nothing limits how long `{around}` takes: a part of it repeats, or never ends; write `P within 30 s`"
            );
        };
        let (step, member) =
            (self.model.name(group, slot), &self.model.plan.groups[group as usize].members[slot as usize]);
        let name = &member.name;
        if let MemberKind::Leaf(leaf) = member.kind
            && is_restarted(self.model, leaf)
        {
            return format!(
                "nothing limits how long `{step}` takes, which is started again as often as it dies: write `{name} within 30 s`"
            );
        }
        let module = match member.kind {
            MemberKind::Leaf(leaf) => Some(&self.model.plan.leaves[leaf as usize].module),
            MemberKind::Group(_) => None,
        };
        let declared = module.map_or(String::new(), |module| format!(", declare `duration 1 s .. 5 s;` in `{module}`"));
        format!(
            "nothing limits how long `{step}` takes: write `{name} within 30 s`{declared}, or `assume {name} takes 1 s .. 5 s`"
        )
    }

    fn culprit_of(&self, group: u32, expression: &Expression) -> Option<Culprit> {
        let source = &self.model.plan.groups[group as usize];
        let span = self.of(group, source, expression);
        if span.end.is_some() {
            return None;
        }
        if let Expression::Run { member, .. } = expression {
            let below = match source.members[*member as usize].kind {
                MemberKind::Group(inner) => self.culprit(inner),
                MemberKind::Leaf(_) => None,
            };
            return below.or(Some(Culprit { group, slot: Some(*member) }));
        }
        let mut operands = expression.operands().into_iter();
        let below = operands.find_map(|operand| self.culprit_of(group, operand));
        Some(below.unwrap_or(Culprit { group, slot: None }))
    }
}
