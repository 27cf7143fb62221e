//! Programs that overlap with the programs that they replace. Each is a separate leaf, and its connections are separate wires.

use super::pairing::Pairing;
use super::{BTreeMap, BTreeSet, Leaf, Numbers, Plan, PlanChange, Replacement, leaf, text};
use crate::plan::{LeafKind, MemberKind};

impl Pairing<'_> {
    /// Gives a member that runs another leaf, if its next program is to overlap with the present one. Returns its number.
    pub(super) fn succeed(&mut self, wanted: u32, number: u32, group: u32, slot: u32) -> Option<u32> {
        let (before, after) = (self.running.leaves.get(number as usize)?, self.wanted.leaves.get(wanted as usize)?);
        let is_service = self.member(group, slot).is_some_and(|member| member.service);
        let may_overlap = after.policy.replacement == Replacement::Overlap
            && before.kind == LeafKind::Controller
            && is_service
            && self.running.claims_of(number).is_empty()
            && self.wanted.claims_of(wanted).is_empty()
            && super::host(self.running, before.host) == super::host(self.wanted, after.host);
        if !may_overlap {
            return None;
        }
        let mut why = match leaf::change_of_leaf(number, before, after, false) {
            Some(PlanChange::Replace { why, .. }) => why,
            Some(_) | None => Vec::new(),
        };
        if why.is_empty() && self.again.contains(&number) {
            why.push("started again".to_owned());
        }
        if why.is_empty() {
            return None;
        }
        let path = before.path.clone();
        let next = self.number(Leaf { host: before.host, path: path.clone(), ..after.clone() })?;
        self.numbers.added.insert(next);
        self.numbers.overlapping.insert(next, number);
        self.changes.push(PlanChange::Replace { leaf: number, path, why, replacement: Replacement::Overlap });
        self.member(group, slot)?.kind = MemberKind::Leaf(next);
        Some(next)
    }
}

/// Drops the changes of wires that exist only because a program and its replacement have separate wires.
pub(super) fn forget_same_wires(changes: &mut Vec<PlanChange>, running: &Plan, plan: &Plan, numbers: &Numbers) {
    let old: BTreeSet<u32> = numbers.overlapping.values().copied().collect();
    let touches = |plan: &Plan, wire: u32, is_meant: &dyn Fn(u32) -> bool| {
        plan.wires.get(wire as usize).is_some_and(|wire| is_meant(wire.from.leaf) || is_meant(wire.to.leaf))
    };
    let mut gone = BTreeMap::<String, u32>::new();
    for change in changes.iter() {
        if let PlanChange::Disconnect { wire, .. } = change
            && touches(running, *wire, &|leaf| old.contains(&leaf))
        {
            *gone.entry(text(running, *wire)).or_default() += 1;
        }
    }
    let mut stays = BTreeMap::<String, u32>::new();
    changes.retain(|change| {
        let PlanChange::Connect { wire, text } = change else { return true };
        let is_same = touches(plan, *wire, &|leaf| numbers.overlapping.contains_key(&leaf)) && take(&mut gone, text);
        if is_same {
            *stays.entry(text.clone()).or_default() += 1;
        }
        !is_same
    });
    changes.retain(|change| {
        let PlanChange::Disconnect { text, .. } = change else { return true };
        !take(&mut stays, text)
    });
}

/// Takes one text of the counted ones, if there is one left.
fn take(counts: &mut BTreeMap<String, u32>, text: &str) -> bool {
    let Some(count) = counts.get_mut(text).filter(|count| **count > 0) else { return false };
    *count -= 1;
    true
}

impl Plan {
    /// Returns the plan of `before`, with the numbers that this one has given out since. It undoes a change that was
    /// made, or half made: an added process keeps its number, and is taken away.
    #[must_use]
    pub fn back_to(&self, before: &Self) -> Self {
        let mut plan = before.clone();
        plan.leaves.extend(self.leaves.iter().skip(before.leaves.len()).cloned());
        plan.wires.extend(self.wires.iter().skip(before.wires.len()).cloned());
        let known = before.groups.len();
        plan.groups.extend(self.groups.iter().skip(known).cloned());
        for (number, (own, theirs)) in plan.groups.iter_mut().zip(&self.groups).enumerate() {
            let (members, sets) = if number < known { (own.members.len(), own.sets.len()) } else { (0, 0) };
            own.members.truncate(members);
            own.members.extend(theirs.members.iter().skip(members).cloned());
            own.members.iter_mut().skip(members).for_each(|member| member.name.clear());
            own.sets.truncate(sets);
            own.sets.extend(theirs.sets.iter().skip(sets).cloned());
            own.sets.iter_mut().skip(sets).for_each(|set| set.wires.clear());
        }
        plan
    }
}
