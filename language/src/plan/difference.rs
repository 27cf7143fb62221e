//! The changes from a running plan to a new one, and the plan that the nodes go on with.
//!
//! A running supervisor holds the state of its event actions, and every message names leaves, groups and wires by number. So
//! the next plan keeps the numbers of the one that runs: groups and leaves have theirs, wires that stay have theirs, new wires
//! get the next ones. A wire that no connection set has any more keeps its number and is never opened ([`Plan::live_wires`]).
//! Only what leaves every supervisor's state valid can be changed in this way: programs, their arguments and policies, and what
//! the connection sets connect. Everything else is an obstacle, told in a sentence.

use super::{
    Argument, Claim, Constant, DEADLINE, Expression, Group, Leaf, LeafPort, MemberKind, Plan, Policy, Retention,
    Transfer, Wire,
};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;

/// How a running deployment gets from its plan to another.
#[derive(Clone, Debug, PartialEq)]
pub struct Difference {
    /// The new plan, with the numbers of the one that runs.
    pub plan: Plan,
    /// The changes, programs first, in the order of the plan.
    pub changes: Vec<PlanChange>,
}

/// One change of a running deployment.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum PlanChange {
    /// A program is ended, and another one takes its place.
    Replace {
        /// Index into [`Plan::leaves`].
        leaf: u32,
        /// Absolute path of the instance.
        path: String,
        /// The differences, as sentences for a person.
        why: Vec<String>,
    },
    /// The policies for the program's death or stop change; the program goes on meanwhile.
    Settle {
        /// Index into [`Plan::leaves`].
        leaf: u32,
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
            Self::Replace { path, why, .. } => write!(f, "replace    {path}: {}", why.join(", ")),
            Self::Settle { path, why, .. } => write!(f, "settle     {path}: {}", why.join(", ")),
            Self::Connect { text, .. } => write!(f, "connect    {text}"),
            Self::Disconnect { text, .. } => write!(f, "disconnect {text}"),
        }
    }
}

/// Compares the plan that runs with the one that is wanted.
///
/// # Errors
/// Every obstacle, as a sentence: what cannot change while it runs.
pub fn difference(running: &Plan, wanted: &Plan) -> Result<Difference, Vec<String>> {
    let mut obstacles = Vec::new();
    if running.name != wanted.name {
        obstacles.push(format!("its name is `{}`, not `{}`", wanted.name, running.name));
    }
    let groups = matched("group", running.groups.iter().map(|g| &g.path), wanted.groups.iter().map(|g| &g.path));
    let leaves = matched("process", running.leaves.iter().map(|l| &l.path), wanted.leaves.iter().map(|l| &l.path));
    let (groups, leaves) = match (groups, leaves) {
        (Ok(groups), Ok(leaves)) => (groups, leaves),
        (groups, leaves) => {
            obstacles.extend(groups.err().into_iter().chain(leaves.err()).flatten());
            return Err(obstacles);
        }
    };
    let after_leaf = by_running(&leaves, &wanted.leaves);
    let after_group = by_running(&groups, &wanted.groups);
    let numbers = Numbers { groups, leaves };
    let mut plan = running.clone();
    let mut changes = Vec::new();
    let claim = |claim: &Claim| Some(Claim { leaf: numbers.leaf(claim.leaf)?, ..claim.clone() });
    plan.claims = wanted.claims.iter().filter_map(claim).collect();
    for (number, before) in (0_u32..).zip(&running.leaves) {
        let Some(after) = after_leaf.get(&number).copied() else { continue };
        obstacles.extend(moved(&before.path, host(running, before.host), host(wanted, after.host)));
        let claims_differ = running.claims_of(number) != plan.claims_of(number);
        changes.extend(change_of_leaf(number, before, after, claims_differ));
        if let Some(leaf) = plan.leaves.get_mut(number as usize) {
            *leaf = Leaf { host: before.host, ..after.clone() };
        }
    }
    let live = running.live_wires();
    let mut wires = Wires { known: BTreeMap::new(), changes: Vec::new() };
    for (number, wire) in (0_u32..).zip(&running.wires).filter(|(number, _)| live.contains(number)) {
        wires.known.entry(key(wire)).or_default().push(number);
    }
    for (number, before) in (0_u32..).zip(&running.groups) {
        let Some(after) = after_group.get(&number).copied() else { continue };
        obstacles.extend(moved(&before.path, host(running, before.host), host(wanted, after.host)));
        obstacles.extend(obstacle_of_group(before, after, &numbers));
        if before.sets.len() == after.sets.len() {
            for (index, set) in after.sets.iter().enumerate() {
                let here = set.wires.iter().filter_map(|wire| wanted.wires.get(*wire as usize));
                let kept: Vec<u32> = here.filter_map(|wire| wires.place(&mut plan, &numbers, wire)).collect();
                if let Some(set) = plan.groups.get_mut(number as usize).and_then(|group| group.sets.get_mut(index)) {
                    set.wires = kept;
                }
            }
        }
    }
    if !obstacles.is_empty() {
        return Err(obstacles);
    }
    let still = plan.live_wires();
    for number in live.difference(&still).copied() {
        changes.push(PlanChange::Disconnect { wire: number, text: text(&plan, number) });
    }
    changes.extend(wires.changes);
    Ok(Difference { plan, changes })
}

impl Plan {
    /// Returns the devices that a leaf claims, and whether it is alone with each.
    pub fn claims_of(&self, leaf: u32) -> BTreeSet<(&str, bool)> {
        let claims = self.claims.iter().filter(|claim| claim.leaf == leaf);
        claims.map(|claim| (claim.device.as_str(), claim.is_write)).collect()
    }

    /// Returns the wires that some connection set has: those of a plan that was changed while it ran may have gone.
    pub fn live_wires(&self) -> BTreeSet<u32> {
        self.groups.iter().flat_map(|group| &group.sets).flat_map(|set| set.wires.iter().copied()).collect()
    }
}

/// The numbers that run, by the numbers of the plan that is wanted.
struct Numbers {
    groups: BTreeMap<u32, u32>,
    leaves: BTreeMap<u32, u32>,
}

impl Numbers {
    fn leaf(&self, wanted: u32) -> Option<u32> {
        self.leaves.get(&wanted).copied()
    }

    fn member(&self, wanted: MemberKind) -> Option<MemberKind> {
        match wanted {
            MemberKind::Leaf(leaf) => self.leaf(leaf).map(MemberKind::Leaf),
            MemberKind::Group(group) => self.groups.get(&group).copied().map(MemberKind::Group),
        }
    }
}

/// The identity of a wire: its ends, and how data moves on it.
type Key = (u32, String, u32, String, Transfer, super::Quality);

fn key(wire: &Wire) -> Key {
    (wire.from.leaf, wire.from.port.clone(), wire.to.leaf, wire.to.port.clone(), wire.transfer, wire.quality)
}

struct Wires {
    /// The wires that run; several sets may have wires of their own between the same ports.
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

/// Pairs the numbers of what has the same path in both; what only one of them has is an obstacle.
fn matched<'a>(
    what: &str,
    running: impl Iterator<Item = &'a String>,
    wanted: impl Iterator<Item = &'a String>,
) -> Result<BTreeMap<u32, u32>, Vec<String>> {
    let mut running: BTreeMap<&String, u32> = running.zip(0..).collect();
    let (mut pairs, mut obstacles) = (BTreeMap::new(), Vec::new());
    for (path, number) in wanted.zip(0..) {
        match running.remove(path) {
            Some(old) => drop(pairs.insert(number, old)),
            None => obstacles.push(format!("the {what} `{path}` is new")),
        }
    }
    obstacles.extend(running.keys().map(|path| format!("the {what} `{path}` is not in it any more")));
    if obstacles.is_empty() { Ok(pairs) } else { Err(obstacles) }
}

/// Returns what is wanted by the numbers that run.
fn by_running<'a, T>(pairs: &BTreeMap<u32, u32>, wanted: &'a [T]) -> BTreeMap<u32, &'a T> {
    pairs.iter().filter_map(|(new, old)| Some((*old, wanted.get(*new as usize)?))).collect()
}

fn host(plan: &Plan, host: u32) -> &str {
    plan.hosts.get(host as usize).map_or("?", String::as_str)
}

fn moved(path: &str, from: &str, to: &str) -> Option<String> {
    (from != to).then(|| format!("`{path}` moves from `{from}` to `{to}`"))
}

fn change_of_leaf(leaf: u32, before: &Leaf, after: &Leaf, claims_differ: bool) -> Option<PlanChange> {
    // Every field by its name, so that one that is added is not forgotten here.
    let Leaf { path, module, host: _, arguments: given, exec, kind, stop_within, outcomes, policy } = before;
    let Policy { restart, agent_loss, link_loss, usage, watchdog, ready_within } = policy;
    let mut why = Vec::new();
    let mut differs = |is_different: bool, words: &str| why.extend(is_different.then(|| words.to_owned()));
    differs(*module != after.module, &format!("its type is `{}`, was `{module}`", after.module));
    differs(*exec != after.exec, "its executable");
    differs(claims_differ, "its claims");
    differs(*kind != after.kind, "whether it speaks the control protocol");
    differs(*outcomes != after.outcomes, "its outcomes");
    differs(*agent_loss != after.policy.agent_loss, "`on_agent_loss`");
    differs(*usage != after.policy.usage, "its limits");
    differs(*watchdog != after.policy.watchdog, "`watchdog`");
    differs(*ready_within != after.policy.ready_within, "`ready within`");
    why.extend(arguments(given, &after.arguments));
    let is_replaced = !why.is_empty();
    let mut differs = |is_different: bool, words: &str| why.extend(is_different.then(|| words.to_owned()));
    differs(*restart != after.policy.restart, "`restart`");
    differs(*link_loss != after.policy.link_loss, "`on_link_loss`");
    differs(*stop_within != after.stop_within, "`stop within`");
    let path = path.clone();
    match (is_replaced, why.is_empty()) {
        (_, true) => None,
        (true, false) => Some(PlanChange::Replace { leaf, path, why }),
        (false, false) => Some(PlanChange::Settle { leaf, path, why }),
    }
}

/// Returns which arguments are different, for a person.
fn arguments(before: &[Argument], after: &[Argument]) -> Vec<String> {
    let named = |arguments: &[Argument]| -> BTreeMap<String, Constant> {
        let name = |(place, argument): (usize, &Argument)| {
            let name = argument.name.clone().unwrap_or_else(|| format!("argument {}", place + 1));
            (name, argument.value.clone())
        };
        arguments.iter().enumerate().map(name).collect()
    };
    let (before, after) = (named(before), named(after));
    let names: BTreeSet<&String> = before.keys().chain(after.keys()).collect();
    let words = |name: &&String| match (before.get(*name), after.get(*name)) {
        (Some(before), Some(after)) if before == after => None,
        (Some(before), Some(after)) => Some(format!("`{name}` is {}, was {}", spelled(after), spelled(before))),
        (None, Some(after)) => Some(format!("`{name}` is {}, was not given", spelled(after))),
        (Some(before), None) => Some(format!("`{name}` is not given, was {}", spelled(before))),
        (None, None) => None,
    };
    names.iter().filter_map(words).collect()
}

fn spelled(constant: &Constant) -> String {
    match constant {
        Constant::Text(text) => format!("{text:?}"),
        Constant::Number(number) => number.to_string(),
        Constant::Truth(truth) => truth.to_string(),
    }
}

/// Returns what of a group cannot change while its supervisor holds the state of its event actions.
fn obstacle_of_group(before: &Group, after: &Group, numbers: &Numbers) -> Option<String> {
    let path = &before.path;
    let members = after.members.iter().map(|member| (&member.name, numbers.member(member.kind), member.service));
    if !before.members.iter().map(|member| (&member.name, Some(member.kind), member.service)).eq(members) {
        return Some(format!("the processes of `{path}` stand in another order, or one is a service now"));
    }
    if before.supervision != after.supervision {
        return Some(format!("the supervision of `{path}` differs"));
    }
    let sets = |group: &Group| group.sets.iter().map(|set| (set.owner, set.label.clone())).collect::<Vec<_>>();
    if sets(before) != sets(after) || before.sets_always != after.sets_always {
        return Some(format!("the connection sets of `{path}` have other owners or labels"));
    }
    (!same(&before.expression, &after.expression)).then(|| format!("the event actions of `{path}` differ"))
}

/// Whether two expressions mean the same: the line in which a deadline stands does not count.
fn same(before: &Expression, after: &Expression) -> bool {
    before == after || without_lines(before.clone()) == without_lines(after.clone())
}

fn without_lines(mut expression: Expression) -> Expression {
    match &mut expression {
        Expression::Fail(why) if why.starts_with(DEADLINE) => {
            if let Some(line) = why.rfind(" in line ") {
                why.truncate(line);
            }
        }
        Expression::Run { .. } | Expression::Skip | Expression::Never | Expression::Fail(_) | Expression::Wait(_) => {}
        Expression::Concurrent(of)
        | Expression::FailFast(of)
        | Expression::Disable(of)
        | Expression::AnyOf { of, .. } => of.iter_mut().for_each(forget_lines),
        Expression::Sequence(p, q)
        | Expression::Conditional(p, q)
        | Expression::Recurrent(p, q)
        | Expression::Otherwise(p, q)
        | Expression::Finally(p, q) => [p, q].into_iter().for_each(|of| forget_lines(of)),
        Expression::Match(arms) => arms.iter_mut().for_each(|arm| forget_lines(&mut arm.body)),
        Expression::Shield { of, .. } | Expression::Using { of, .. } | Expression::Tagged { of, .. } => {
            forget_lines(of);
        }
        Expression::Asynchronous { source, pool } => {
            forget_lines(source);
            pool.iter_mut().for_each(forget_lines);
        }
    }
    expression
}

fn forget_lines(expression: &mut Expression) {
    *expression = without_lines(std::mem::replace(expression, Expression::Skip));
}

/// `main/a, Out -> main/b, In latch`
fn text(plan: &Plan, wire: u32) -> String {
    let Some(wire) = plan.wires.get(wire as usize) else { return String::new() };
    let end = |end: &LeafPort| {
        let path = plan.leaves.get(end.leaf as usize).map_or("?", |leaf| leaf.path.as_str());
        format!("{path}, {}", end.port)
    };
    let mut text = format!("{} -> {}", end(&wire.from), end(&wire.to));
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Options, Source, compile};

    const SPEC: &str = r#"
module Source(host, rate: Number = 1) { out Out: Number; service; }
module Sink(host) { in In: Number; in Other: Number; done; }
process Pair(here) {
    host { here }
    instantiated_processes { a instof Source(here); b instof Sink("c2"); }
    internal_connections(a, feed) { a, Out -> b, In; }
    internal_event_actions { a[feed] , b within 5 s }
}
process main() {
    host { "c1" }
    instantiated_processes { pair instof Pair("c1"); c instof Sink("c2"); }
    internal_event_actions { pair ; c }
}
"#;

    fn plan(text: &str) -> Plan {
        let compiled = compile(&Source::new("spec", text), &[], &Options::named("spec"));
        compiled.plan.unwrap_or_else(|| panic!("{:#?}", compiled.diagnostics))
    }

    fn changes(running: &Plan, text: &str) -> Result<Vec<String>, Vec<String>> {
        let found = difference(running, &plan(text))?;
        found.plan.validate().unwrap();
        Ok(found.changes.iter().map(ToString::to_string).collect())
    }

    #[test]
    fn the_same_text_changes_nothing_whatever_its_lines_and_order_of_types() {
        let running = plan(SPEC);
        assert_eq!(changes(&running, SPEC), Ok(vec![]));
        assert_eq!(changes(&running, &format!("// one more line\n{SPEC}")), Ok(vec![]));
        let (modules, processes) = SPEC.split_at(SPEC.find("process Pair").unwrap());
        assert_eq!(changes(&running, &format!("{processes}{modules}")), Ok(vec![]));
    }

    #[test]
    fn programs_and_policies_can_change_while_it_runs() {
        let running = plan(&SPEC.replace("Source(here);", "Source(here, 1);"));
        let replaced = changes(&running, &SPEC.replace("Source(here);", "Source(here, 2);"));
        assert_eq!(replaced, Ok(vec!["replace    main/pair/a: `argument 1` is 2, was 1".to_owned()]));
        let running = plan(SPEC);
        let permanent = SPEC.replace("Source(here);", "Source(here) { restart permanent; };");
        assert_eq!(changes(&running, &permanent), Ok(vec!["settle     main/pair/a: `restart`".to_owned()]));
    }

    #[test]
    fn a_claim_that_changes_replaces_its_program() {
        let running = plan(&SPEC.replace("done; }", "done; claims leg; }"));
        let other = SPEC.replace("done; }", "done; claims leg(read); }");
        let lines = ["b", "c"].map(|leaf| match leaf {
            "b" => "replace    main/pair/b: its claims".to_owned(),
            _ => "replace    main/c: its claims".to_owned(),
        });
        assert_eq!(changes(&running, &other), Ok(lines.to_vec()));
    }

    #[test]
    fn wires_that_stay_keep_their_numbers_and_new_ones_get_the_next() {
        let running = plan(SPEC);
        let text = SPEC.replace("{ a, Out -> b, In; }", "{ a, Out -> b, Other; a, Out -> b, In queue 4; }");
        let next = difference(&running, &plan(&text)).unwrap();
        let lines: Vec<String> = next.changes.iter().map(ToString::to_string).collect();
        let expected = [
            "disconnect main/pair/a, Out -> main/pair/b, In",
            "connect    main/pair/a, Out -> main/pair/b, Other",
            "connect    main/pair/a, Out -> main/pair/b, In queue 4",
        ];
        assert_eq!(lines, expected);
        assert_eq!((next.plan.wires.len(), next.plan.live_wires()), (3, BTreeSet::from([1, 2])));
        // What has gone is not taken for what is wanted again.
        let back = difference(&next.plan, &plan(SPEC)).unwrap();
        assert_eq!((back.changes.len(), back.plan.live_wires()), (3, BTreeSet::from([3])));
    }

    #[test]
    fn what_a_supervisor_cannot_take_is_told_and_all_of_it() {
        let running = plan(SPEC);
        let other = SPEC.replace("pair ; c", "pair , c").replace("b instof Sink(\"c2\")", "b instof Sink(\"c3\")");
        let expected = ["`main/pair/b` moves from `c2` to `c3`", "the event actions of `main` differ"];
        assert_eq!(changes(&running, &other), Err(expected.map(str::to_owned).to_vec()));
        let renamed = SPEC.replace("c instof", "d instof").replace("pair ; c", "pair ; d");
        let expected = ["the process `main/d` is new", "the process `main/c` is not in it any more"];
        assert_eq!(changes(&running, &renamed), Err(expected.map(str::to_owned).to_vec()));
    }
}
