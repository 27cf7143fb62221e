//! The changes from a running plan to a new one, and the plan with which the nodes continue.
//!
//! A running supervisor holds the state of its event actions, and every message names leaves, groups and wires by
//! number. So the next plan keeps the numbers of the running one, and the slots of members; new ones get the next
//! numbers. A wire that no connection set has any more keeps its number and is never opened ([`Plan::live_wires`]). A
//! process that is taken away keeps its number and its slot, whose name is empty ([`Plan::live_leaves`]). If the same
//! process returns, it gets the same numbers. The supervisor of a running group decides whether its event actions can
//! change ([`carry`](crate::algebra::carry)). A change that is not possible at all is an obstacle, reported in a
//! sentence.

mod actions;
mod leaf;
mod overlap;
mod pairing;
#[cfg(test)]
mod tests;

use super::{
    Argument, Arm, Claim, ConnectionSet, Constant, DEADLINE, Expression, Group, Leaf, LeafPort, Member, MemberKind,
    Plan, Policy, Replacement, Retention, Strategy, Transfer, Wire,
};
use actions::{GroupNumbers, same};
use pairing::Pairing;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

/// How a running deployment gets from its plan to another.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// The new plan, with the numbers of the running one.
    pub plan: Plan,
    /// The changes, programs first, in the order of the plan.
    pub changes: Vec<PlanChange>,
}

/// One change of a running deployment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PlanChange {
    /// Another program takes the place of one.
    Replace {
        /// Index into [`Plan::leaves`] of the plan that runs.
        leaf: u32,
        /// Absolute path of the instance.
        path: String,
        /// The differences, as sentences for a person.
        why: Vec<String>,
        /// Whether the one before is ended first.
        replacement: Replacement,
    },
    /// The policies for the program's death or stop change; the program keeps running.
    Settle {
        /// Index into [`Plan::leaves`].
        leaf: u32,
        /// Absolute path of the instance.
        path: String,
        /// The differences, as sentences for a person.
        why: Vec<String>,
    },
    /// A program is added. The event actions of its group define when it runs.
    Add {
        /// Index into [`Plan::leaves`] of the new plan.
        leaf: u32,
        /// Absolute path of the instance.
        path: String,
        /// Its type and its host, for a person.
        what: String,
    },
    /// A program is taken away.
    Remove {
        /// Index into [`Plan::leaves`].
        leaf: u32,
        /// Absolute path of the instance.
        path: String,
    },
    /// A group continues with other event actions, or another supervision.
    Act {
        /// Index into [`Plan::groups`].
        group: u32,
        /// Absolute path of the instance.
        path: String,
        /// The differences, as sentences for a person.
        why: Vec<String>,
    },
    /// A wire is added.
    Connect {
        /// Index into [`Plan::wires`] of the new plan.
        wire: u32,
        /// `a, Out -> b, In` with absolute paths.
        text: String,
    },
    /// A wire is taken away.
    Disconnect {
        /// Index into [`Plan::wires`].
        wire: u32,
        /// `a, Out -> b, In` with absolute paths.
        text: String,
    },
}

impl fmt::Display for PlanChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Replace { path, why, replacement, .. } => {
                let beside = if *replacement == Replacement::Overlap { "; the two overlap" } else { "" };
                write!(f, "replace    {path}: {}{beside}", why.join(", "))
            }
            Self::Settle { path, why, .. } => write!(f, "settle     {path}: {}", why.join(", ")),
            Self::Add { path, what, .. } => write!(f, "add        {path}: {what}"),
            Self::Remove { path, .. } => write!(f, "remove     {path}"),
            Self::Act { path, why, .. } => write!(f, "act        {path}: {}", why.join(", ")),
            Self::Connect { text, .. } => write!(f, "connect    {text}"),
            Self::Disconnect { text, .. } => write!(f, "disconnect {text}"),
        }
    }
}

/// Stands for the slot of a process that was taken away, and for its sets.
const TAKEN_AWAY: u32 = u32::MAX;

/// Compares the running plan with the wanted one.
///
/// # Errors
/// Every obstacle, as a sentence: a change that is impossible during the run.
pub fn difference(running: &Plan, wanted: &Plan) -> Result<Difference, Vec<String>> {
    difference_with(running, wanted, &BTreeSet::new())
}

/// Does as [`difference`], where the programs of some leaves that run are started `again` although
/// nothing of them differs. For programs that overlap with the next program, this changes the plan,
/// and is treated as a change.
///
/// # Errors
/// As [`difference`].
pub fn difference_with(running: &Plan, wanted: &Plan, again: &BTreeSet<u32>) -> Result<Difference, Vec<String>> {
    let mut pairing = Pairing::new(running, wanted, again);
    if running.name != wanted.name {
        pairing.obstacles.push(format!("its name is `{}`, not `{}`", wanted.name, running.name));
    }
    pairing.pair_group(0, 0);
    let Pairing { mut plan, numbers, mut changes, mut obstacles, .. } = pairing;
    let claim = |claim: &Claim| Some(Claim { leaf: numbers.leaf(claim.leaf)?, ..claim.clone() });
    plan.claims = wanted.claims.iter().filter_map(claim).collect();
    plan.on_boot = wanted.on_boot;
    for (new, number) in &numbers.leaves {
        let (Some(before), Some(after)) = (running.leaves.get(*number as usize), wanted.leaves.get(*new as usize))
        else {
            continue;
        };
        obstacles.extend(moved(&before.path, host(running, before.host), host(wanted, after.host)));
        obstacles.extend(elsewhere(before, after, numbers.added.contains(number)));
        if numbers.added.contains(number) {
            continue;
        }
        let claims_differ = running.claims_of(*number) != plan.claims_of(*number);
        changes.extend(leaf::change_of_leaf(*number, before, after, claims_differ));
        if let Some(leaf) = plan.leaves.get_mut(*number as usize) {
            *leaf = Leaf { host: before.host, ..after.clone() };
        }
    }
    let live = running.live_wires();
    let mut wires = Wires { known: BTreeMap::new(), changes: Vec::new() };
    for (number, wire) in (0_u32..).zip(&running.wires).filter(|(number, _)| live.contains(number)) {
        wires.known.entry(key(wire)).or_default().push(number);
    }
    for (new, number) in &numbers.groups {
        let Some(after) = wanted.groups.get(*new as usize) else { continue };
        if let Some(before) = running.groups.get(*number as usize) {
            obstacles.extend(moved(&before.path, host(running, before.host), host(wanted, after.host)));
            obstacles.extend(obstacle_of_order(running, before, after));
        }
        wire_group(running, &mut plan, &numbers, wanted, after, *number, &mut wires);
        changes.extend(change_of_group(running, &plan, *number));
    }
    if !obstacles.is_empty() {
        return Err(obstacles);
    }
    let still = plan.live_wires();
    for number in live.difference(&still).copied() {
        changes.push(PlanChange::Disconnect { wire: number, text: text(&plan, number) });
    }
    changes.extend(wires.changes);
    overlap::forget_same_wires(&mut changes, running, &plan, &numbers);
    Ok(Difference { plan, changes })
}

/// Returns why a process cannot become one of another deployment, or be one no more: its node looks for it while everything is prepared.
fn elsewhere(before: &Leaf, after: &Leaf, is_added: bool) -> Option<String> {
    let (before, after, path) = (&before.external, &after.external, &before.path);
    if !is_added && before == after || is_added && after.is_none() {
        return None;
    }
    let name = after.as_ref().or(before.as_ref())?;
    Some(format!(
        "`{path}` is {name}: DCA looks for processes of another deployment only while it prepares this deployment, and not during a change"
    ))
}

/// Gives a group the sets, the event actions and the supervision that are wanted.
fn wire_group(
    running: &Plan,
    plan: &mut Plan,
    numbers: &Numbers,
    wanted: &Plan,
    after: &Group,
    number: u32,
    wires: &mut Wires,
) {
    let before = running.groups.get(number as usize);
    let slots = numbers.slots.get(&number).cloned().unwrap_or_default();
    let mut own = GroupNumbers { slots, sets: Vec::new() };
    let mut sets: Vec<ConnectionSet> = before.map_or_else(Vec::new, |before| before.sets.clone());
    sets.iter_mut().for_each(|set| set.wires.clear());
    for set in &after.sets {
        let owner = set.owner.map(|owner| own.slot(owner));
        if owner == Some(TAKEN_AWAY) {
            // The set no longer has a user, and only keeps the numbers of later sets unchanged.
            own.sets.push(TAKEN_AWAY);
            continue;
        }
        let is_its = |(at, other): &(u32, &ConnectionSet)| {
            (other.owner, &other.label) == (owner, &set.label) && !own.sets.contains(at)
        };
        let known = (0_u32..).zip(&sets).find(is_its).map(|(at, _)| at);
        let at = known.unwrap_or(u32::try_from(sets.len()).unwrap_or(u32::MAX));
        if known.is_none() {
            sets.push(ConnectionSet { owner, label: set.label.clone(), wires: Vec::new() });
        }
        own.sets.push(at);
        let here = set.wires.iter().filter_map(|wire| wanted.wires.get(*wire as usize));
        let kept = here.filter_map(|wire| wires.place(plan, numbers, wire)).collect();
        if let Some(set) = sets.get_mut(at as usize) {
            set.wires = kept;
        }
    }
    let Some(group) = plan.groups.get_mut(number as usize) else { return };
    group.sets = sets;
    group.sets_always = after.sets_always.iter().map(|set| own.set(*set)).collect();
    group.supervision = after.supervision;
    let expression = own.expression(&after.expression);
    if before.is_none_or(|before| !same(&before.expression, &expression)) {
        group.expression = expression;
    }
}

/// Returns the differences in the event actions of a running group.
fn change_of_group(running: &Plan, plan: &Plan, number: u32) -> Option<PlanChange> {
    let (before, after) = (running.groups.get(number as usize)?, plan.groups.get(number as usize)?);
    let mut why = Vec::new();
    let mut differs = |is_different: bool, words: &str| why.extend(is_different.then(|| words.to_owned()));
    differs(before.expression != after.expression, "its event actions");
    differs(before.sets_always != after.sets_always, "the connections that are always open");
    differs(before.supervision != after.supervision, "its supervision");
    differs(number == 0 && running.on_boot != plan.on_boot, "`on_boot`");
    (!why.is_empty()).then(|| PlanChange::Act { group: number, path: before.path.clone(), why })
}

/// If the order of processes matters, it has to stay the same.
fn obstacle_of_order(running: &Plan, before: &Group, after: &Group) -> Option<String> {
    let counts = [before, after].iter().any(|group| group.supervision.strategy == Strategy::RestForOne);
    let names = |group: &Group| group.members.iter().map(|member| member.name.clone()).collect::<Vec<_>>();
    let (old, new) = (names(before), names(after));
    let kept: Vec<&String> = old.iter().filter(|name| new.contains(name)).collect();
    let is_same = new.iter().filter(|name| old.contains(name)).eq(kept.iter().copied())
        && new.iter().take(kept.len()).eq(kept.iter().copied());
    let home = running.name.as_str();
    (counts && !is_same).then(|| {
        format!("the processes of `{}` have another order, which `rest_for_one` uses; stop `{home}` first", before.path)
    })
}

impl Plan {
    /// Returns the devices that a leaf claims, and whether it is alone with each.
    pub fn claims_of(&self, leaf: u32) -> BTreeSet<(&str, bool)> {
        let claims = self.claims.iter().filter(|claim| claim.leaf == leaf);
        claims.map(|claim| (claim.device.as_str(), claim.is_write)).collect()
    }

    /// Returns the wires that some connection set has: a plan that was changed during its run may also have removed
    /// ones.
    pub fn live_wires(&self) -> BTreeSet<u32> {
        self.groups.iter().flat_map(|group| &group.sets).flat_map(|set| set.wires.iter().copied()).collect()
    }
}

/// The numbers that run, by the numbers of the plan that is wanted.
struct Numbers {
    groups: BTreeMap<u32, u32>,
    leaves: BTreeMap<u32, u32>,
    /// Leaves that are added, by the number that runs.
    added: BTreeSet<u32>,
    /// Leaves whose programs overlap with the previous one, with its number.
    overlapping: BTreeMap<u32, u32>,
    /// For each group that runs, its slots by the slots that are wanted.
    slots: BTreeMap<u32, Vec<u32>>,
}

impl Numbers {
    fn leaf(&self, wanted: u32) -> Option<u32> {
        self.leaves.get(&wanted).copied()
    }
}

/// The identity of a wire: its ends, and how data moves on it.
type Key = (u32, String, u32, String, Transfer, super::Quality);

fn key(wire: &Wire) -> Key {
    (wire.from.leaf, wire.from.port.clone(), wire.to.leaf, wire.to.port.clone(), wire.transfer, wire.quality)
}

struct Wires {
    /// The running wires; several sets may have separate wires between the same ports.
    known: BTreeMap<Key, Vec<u32>>,
    changes: Vec<PlanChange>,
}

impl Wires {
    /// Returns the number of a wanted wire in the next plan, where it may be new.
    fn place(&mut self, plan: &mut Plan, numbers: &Numbers, wanted: &Wire) -> Option<u32> {
        let end = |end: &LeafPort| Some(LeafPort { leaf: numbers.leaf(end.leaf)?, port: end.port.clone() });
        let wire = Wire { from: end(&wanted.from)?, to: end(&wanted.to)?, ..wanted.clone() };
        if let Some(numbers) = self.known.get_mut(&key(&wire)).filter(|numbers| !numbers.is_empty()) {
            return Some(numbers.remove(0));
        }
        let number = u32::try_from(plan.wires.len()).ok()?;
        plan.wires.push(wire);
        self.changes.push(PlanChange::Connect { wire: number, text: text(plan, number) });
        Some(number)
    }
}

fn host(plan: &Plan, host: u32) -> &str {
    plan.hosts.get(host as usize).map_or("?", String::as_str)
}

fn moved(path: &str, from: &str, to: &str) -> Option<String> {
    (from != to).then(|| format!("`{path}` moves from `{from}` to `{to}`"))
}

/// `main/a, Out -> main/b, In latch`
fn text(plan: &Plan, wire: u32) -> String {
    let Some(wire) = plan.wires.get(wire as usize) else { return String::new() };
    let mut text = plan.ends(wire);
    if wire.transfer == Transfer::Pull {
        text.push_str(" pull");
    }
    if wire.quality.retention == Retention::Latch {
        text.push_str(" latch");
    }
    if let Some(queue) = wire.quality.queue {
        text.push_str(&format!(" queue {queue}"));
    }
    if let Some(period) = wire.quality.period_min {
        text.push_str(&format!(" every {} s", period.as_secs_f64()));
    }
    text
}
