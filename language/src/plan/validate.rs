//! Checks the invariants of a plan. Plans also arrive over a network.

use super::{
    Arm, CatchArm, DEPTH_MAX, Expression, Given, Group, KEYS_MAX, LEAVES_MAX, MemberKind, Plan, RESTARTS_MAX, Transfer,
};
use crate::algebra::TAG_MAX;
use crate::automaton::Failure;
use std::collections::BTreeSet;
use std::rc::Rc;

/// The invariant that a plan breaks, and where.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PlanError {
    /// There is no group at all.
    #[error("the plan has no groups")]
    Empty,
    /// More groups, leaves or wires than a plan may have.
    #[error("the plan has {count} {what}; the limit is {limit}")]
    TooLarge {
        /// The kind of things of which there are too many.
        what: &'static str,
        /// How many there are.
        count: usize,
        /// How many there may be.
        limit: usize,
    },
    /// An index points nowhere.
    #[error("`{place}` points to {what} {index}, which does not exist")]
    Index {
        /// Path of the group or leaf, or the wire.
        place: String,
        /// The kind of thing that the index should point to.
        what: &'static str,
        /// The index.
        index: u32,
    },
    /// A process starts with a result that has no name around it.
    #[error("`{group}` starts a process with `{name}`, but no result has this name there")]
    Result {
        /// Path of the group.
        group: String,
        /// The name.
        name: String,
    },
    /// A name occurs twice where it has to be unique, or is empty.
    #[error("{what} `{name}` is empty or not unique")]
    Name {
        /// The kind of thing that carries the name.
        what: &'static str,
        /// The name.
        name: String,
    },
    /// The name of the deployment would do something to a terminal, or is too long.
    #[error(
        "the name of the deployment has control characters, or more than {DEPLOYMENT_MAX} bytes: rename the file of the spec"
    )]
    Deployment,
    /// A group or a leaf is a member of several groups, or twice of one.
    #[error("`{path}` is not a member of exactly one group below `main`")]
    Membership {
        /// Its path.
        path: String,
    },
    /// Groups are nested too deeply.
    #[error("groups are nested deeper than {DEPTH_MAX} levels at `{path}`")]
    GroupTooDeep {
        /// Path of the group.
        path: String,
    },
    /// An expression is nested too deeply.
    #[error("the event actions of `{group}` are nested deeper than {DEPTH_MAX} levels")]
    ExpressionTooDeep {
        /// Path of the group.
        group: String,
    },
    /// A tag is longer than an outcome's may be.
    #[error("the tag `{tag}` is longer than {TAG_MAX} bytes")]
    Tag {
        /// The tag.
        tag: String,
    },
    /// A back-off that would start a program without a pause, or after a pause that is too long.
    #[error("the back-off of `{path}` is not from 10 ms to 1 h")]
    Backoff {
        /// Path of the leaf.
        path: String,
    },
    /// Variables or a folder that no program can have.
    #[error("the environment of `{path}` is not possible: {problem}")]
    Environment {
        /// Path of the leaf.
        path: String,
        /// The first thing that is wrong with it.
        problem: String,
    },
    /// A process of another deployment that belongs to this one, or does not exist.
    #[error("`{path}` stands for no process of another deployment")]
    External {
        /// Path of the leaf.
        path: String,
    },
    /// A wire that a process of another deployment cannot have.
    #[error("only calls reach a process of another deployment: `{wire}`")]
    ExternalData {
        /// The ends of the wire.
        wire: String,
    },
    /// An operator without operands, or a count that its operands cannot reach.
    #[error("the event actions of `{group}` have an operator with a wrong number of operands")]
    Operands {
        /// Path of the group.
        group: String,
    },
    /// States that are not an automaton.
    #[error("the states of `{group}` are not an automaton: {why}")]
    Chart {
        /// Path of the group.
        group: String,
        /// The first thing that is wrong with the states.
        why: String,
    },
}

/// The longest name of a deployment, in bytes, as for a file.
const DEPLOYMENT_MAX: usize = 255;
/// The largest number of wires, ten for each leaf that there may be.
const WIRES_MAX: usize = 10 * LEAVES_MAX;

impl Plan {
    /// Checks every invariant of a plan.
    ///
    /// # Errors
    /// Returns the first invariant that does not hold.
    pub fn validate(&self) -> Result<(), PlanError> {
        self.check_sizes()?;
        self.check_tree()?;
        self.check_names()?;
        for leaf in &self.leaves {
            in_range(leaf.host, self.hosts.len(), "host", &leaf.path)?;
            if leaf.policy.backoff.is_some_and(|backoff| !backoff.is_valid()) {
                return Err(PlanError::Backoff { path: leaf.path.clone() });
            }
            if let Some(problem) = leaf.environment.problem() {
                return Err(PlanError::Environment { path: leaf.path.clone(), problem });
            }
            if leaf
                .external
                .as_ref()
                .is_some_and(|external| external.deployment == self.name || external.path.is_empty())
            {
                return Err(PlanError::External { path: leaf.path.clone() });
            }
            if leaf.keys.len() > KEYS_MAX {
                return Err(PlanError::TooLarge {
                    what: "keys of one process",
                    count: leaf.keys.len(),
                    limit: KEYS_MAX,
                });
            }
        }
        for wire in &self.wires {
            for end in [&wire.from, &wire.to] {
                in_range(end.leaf, self.leaves.len(), "leaf", &format!("wire at port {}", end.port))?;
            }
            let is_called = wire.transfer == Transfer::Call && self.external(wire.from.leaf).is_none();
            if !is_called && [&wire.from, &wire.to].iter().any(|end| self.external(end.leaf).is_some()) {
                return Err(PlanError::ExternalData { wire: self.ends(wire) });
            }
        }
        for claim in &self.claims {
            in_range(claim.leaf, self.leaves.len(), "leaf", &format!("claim of {}", claim.device))?;
        }
        self.groups.iter().try_for_each(|group| self.check_group(group))
    }

    fn check_sizes(&self) -> Result<(), PlanError> {
        let counts = [
            ("groups", self.groups.len(), LEAVES_MAX),
            ("leaves", self.leaves.len(), LEAVES_MAX),
            ("wires", self.wires.len(), WIRES_MAX),
            ("claims", self.claims.len(), WIRES_MAX),
        ];
        match counts.into_iter().find(|(_, count, limit)| count > limit) {
            Some((what, count, limit)) => Err(PlanError::TooLarge { what, count, limit }),
            None if self.groups.is_empty() => Err(PlanError::Empty),
            None => Ok(()),
        }
    }

    fn check_names(&self) -> Result<(), PlanError> {
        if self.name.len() > DEPLOYMENT_MAX || self.name.chars().any(char::is_control) {
            return Err(PlanError::Deployment);
        }
        let (live, live_groups) = (self.live_leaves(), self.live_groups());
        let groups = (0_u32..).zip(&self.groups).filter(|(number, _)| live_groups.contains(number));
        let leaves = (0_u32..).zip(&self.leaves).filter(|(number, _)| live.contains(number));
        unique("host", self.hosts.iter())?;
        unique("path", groups.map(|(_, group)| &group.path).chain(leaves.map(|(_, leaf)| &leaf.path)))
    }

    /// No group and no leaf is reached twice from `main`. Unreached ones were taken away.
    fn check_tree(&self) -> Result<(), PlanError> {
        let mut group_seen = vec![false; self.groups.len()];
        let mut leaf_seen = vec![false; self.leaves.len()];
        group_seen[0] = true;
        let mut waiting = vec![(&self.groups[0], 1)];
        while let Some((group, depth)) = waiting.pop() {
            if depth > DEPTH_MAX {
                return Err(PlanError::GroupTooDeep { path: group.path.clone() });
            }
            for member in &group.members {
                let (seen, index, what) = match member.kind {
                    MemberKind::Leaf(leaf) => (leaf_seen.get_mut(leaf as usize), leaf, "leaf"),
                    MemberKind::Group(inner) => (group_seen.get_mut(inner as usize), inner, "group"),
                };
                let place = || format!("{}/{}", group.path, member.name);
                let seen = seen.ok_or_else(|| PlanError::Index { place: place(), what, index })?;
                if member.name.is_empty() {
                    continue;
                }
                if std::mem::replace(seen, true) {
                    return Err(PlanError::Membership { path: place() });
                }
                if let MemberKind::Group(inner) = member.kind {
                    waiting.push((&self.groups[inner as usize], depth + 1));
                }
            }
        }
        Ok(())
    }

    /// Returns the leaves that are a member of a group, at any depth below `main`. Others were taken away while it ran: nothing of
    /// them is started, and they keep their numbers.
    pub fn live_leaves(&self) -> BTreeSet<u32> {
        self.live().0
    }

    /// Returns `main` and the groups that are a member of a group, at any depth below it.
    pub fn live_groups(&self) -> BTreeSet<u32> {
        self.live().1
    }

    fn live(&self) -> (BTreeSet<u32>, BTreeSet<u32>) {
        let (mut leaves, mut groups, mut waiting) = (BTreeSet::new(), BTreeSet::from([0]), vec![0]);
        while let Some(number) = waiting.pop() {
            let members = self.groups.get(number as usize).map_or(&[][..], |group| &group.members);
            for member in members.iter().filter(|member| !member.name.is_empty()) {
                match member.kind {
                    MemberKind::Leaf(leaf) => drop(leaves.insert(leaf)),
                    // A plan from elsewhere may be wrong: a circle of groups would never end.
                    MemberKind::Group(inner) if groups.insert(inner) => waiting.push(inner),
                    MemberKind::Group(_) => {}
                }
            }
        }
        (leaves, groups)
    }

    fn check_group(&self, group: &Group) -> Result<(), PlanError> {
        in_range(group.host, self.hosts.len(), "host", &group.path)?;
        unique("member", group.members.iter().map(|member| &member.name).filter(|name| !name.is_empty()))?;
        for set in &group.sets {
            if let Some(owner) = set.owner {
                in_range(owner, group.members.len(), "member", &group.path)?;
            }
            for &wire in &set.wires {
                in_range(wire, self.wires.len(), "wire", &group.path)?;
            }
        }
        for &set in &group.sets_always {
            in_range(set, group.sets.len(), "connection set", &group.path)?;
        }
        let restarts = group.supervision.intensity.map_or(0, |intensity| intensity.restarts);
        if restarts > RESTARTS_MAX {
            let (count, limit) = (restarts as usize, RESTARTS_MAX as usize);
            return Err(PlanError::TooLarge { what: "restarts", count, limit });
        }
        check_expression(group, &group.expression)
    }
}

/// Walks without recursion: the depth of a received plan is not known.
fn check_expression(group: &Group, root: &Expression) -> Result<(), PlanError> {
    let mut waiting = vec![(root, 1, Rc::new(Vec::new()))];
    while let Some((expression, depth, mut names)) = waiting.pop() {
        if depth > DEPTH_MAX {
            return Err(PlanError::ExpressionTooDeep { group: group.path.clone() });
        }
        if depth > 1 && matches!(expression, Expression::Chart(_)) {
            let why = "an activity stands inside an expression".to_owned();
            return Err(PlanError::Chart { group: group.path.clone(), why });
        }
        check_operator(group, expression)?;
        check_names(group, expression, &mut names)?;
        waiting.extend(expression.operands().into_iter().map(|operand| (operand, depth + 1, Rc::clone(&names))));
    }
    Ok(())
}

/// Checks that a `with` uses a result that has a name around it, and that no two of these results have the same name.
fn check_names<'e>(group: &Group, expression: &'e Expression, names: &mut Rc<Vec<&'e str>>) -> Result<(), PlanError> {
    if let Expression::Named { name, .. } = expression {
        unique("result", names.iter().copied().chain([name.as_str()]))?;
        *names = Rc::new(names.iter().copied().chain([name.as_str()]).collect());
    }
    if let Expression::With { given: Given::Result(name), .. } = expression
        && !names.contains(&name.as_str())
    {
        return Err(PlanError::Result { group: group.path.clone(), name: name.clone() });
    }
    Ok(())
}

/// Everything but the operands.
fn check_operator(group: &Group, expression: &Expression) -> Result<(), PlanError> {
    match expression {
        Expression::Run { member, sets } => {
            in_range(*member, group.members.len(), "member", &group.path)?;
            sets.iter().try_for_each(|set| in_range(*set, group.sets.len(), "connection set", &group.path))
        }
        Expression::Concurrent(of) | Expression::FailFast(of) | Expression::Disable(of) => has_operands(group, 1, of),
        Expression::AnyOf { count, of } | Expression::AtLeast { count, of } => {
            has_operands(group, (*count).max(1) as usize, of)
        }
        Expression::Match(arms) => check_arms(group, arms),
        Expression::Catch { arms, .. } => check_catch(group, arms),
        Expression::Repeat { until, .. } => {
            has_operands(group, 1, until)?;
            check_tags(until.iter())
        }
        Expression::Tagged { tag, .. } => check_tags(std::iter::once(tag)),
        Expression::With { given, .. } => given.check(),
        Expression::Using { resources, .. } => unique("resource", resources.iter()),
        Expression::Asynchronous { pool, .. } => has_operands(group, 1, pool),
        Expression::Chart(chart) => chart.check(&group.path),
        Expression::Skip
        | Expression::Never
        | Expression::Fail(_)
        | Expression::Wait(_)
        | Expression::Sequence(..)
        | Expression::Conditional(..)
        | Expression::Recurrent(..)
        | Expression::Otherwise(..)
        | Expression::Finally(..)
        | Expression::Named { .. }
        | Expression::Shield { .. } => Ok(()),
    }
}

/// Tags are unique and fit into an outcome; `else` is the last arm.
fn check_arms(group: &Group, arms: &[Arm]) -> Result<(), PlanError> {
    check_tags(arms.iter().filter_map(|arm| arm.tag.as_ref()))?;
    match arms.split_last() {
        Some((_, before)) if before.iter().all(|arm| arm.tag.is_some()) => Ok(()),
        Some(_) | None => Err(PlanError::Operands { group: group.path.clone() }),
    }
}

/// No failure has two arms, and `else` is the last one.
fn check_catch(group: &Group, arms: &[CatchArm]) -> Result<(), PlanError> {
    let words: Vec<String> = arms.iter().filter_map(|arm| arm.failure.as_ref()).map(Failure::to_string).collect();
    unique("failure", words.iter())?;
    match arms.split_last() {
        Some((_, before)) if before.iter().all(|arm| arm.failure.is_some()) => Ok(()),
        Some(_) | None => Err(PlanError::Operands { group: group.path.clone() }),
    }
}

/// No tag is empty, too long, or there twice.
fn check_tags<'a>(tags: impl Iterator<Item = &'a String> + Clone) -> Result<(), PlanError> {
    unique("tag", tags.clone())?;
    match tags.into_iter().find(|tag| tag.len() > TAG_MAX) {
        Some(long) => Err(PlanError::Tag { tag: long.clone() }),
        None => Ok(()),
    }
}

fn has_operands<T>(group: &Group, count_min: usize, parts: &[T]) -> Result<(), PlanError> {
    match parts.len() >= count_min {
        true => Ok(()),
        false => Err(PlanError::Operands { group: group.path.clone() }),
    }
}

fn in_range(index: u32, length: usize, what: &'static str, place: &str) -> Result<(), PlanError> {
    match (index as usize) < length {
        true => Ok(()),
        false => Err(PlanError::Index { place: place.to_owned(), what, index }),
    }
}

fn unique<'a, N: AsRef<str> + ?Sized + 'a>(
    what: &'static str,
    names: impl Iterator<Item = &'a N>,
) -> Result<(), PlanError> {
    let mut seen = BTreeSet::new();
    for name in names.map(AsRef::as_ref) {
        if name.is_empty() || !seen.insert(name) {
            return Err(PlanError::Name { what, name: name.to_owned() });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::Backoff;
    use crate::{Options, Source, compile};

    fn plan() -> Plan {
        let text = "process Arm(h) {
            host{h}
            instantiated_processes { a instof A(h); b instof B(h); }
            internal_connections(a) { a, Out -> b, In; }
            internal_event_actions { a, b }
        }
        process main() {
            instantiated_processes { left instof Arm(c1); right instof Arm(c2); }
            internal_event_actions { left # right }
        }";
        compile(&Source::new("arms.dca", text), &[], &Options::named("arms")).plan.unwrap()
    }

    fn check(damage: impl FnOnce(&mut Plan), expect: &str) {
        let mut plan = plan();
        assert_eq!(plan.validate(), Ok(()));
        damage(&mut plan);
        assert_eq!(plan.validate().map_err(|error| error.to_string()), Err(expect.to_owned()));
    }

    #[test]
    fn the_name_of_a_deployment_does_nothing_to_a_terminal() {
        let name =
            "the name of the deployment has control characters, or more than 255 bytes: rename the file of the spec";
        check(|plan| plan.name.push_str("\x1b[31m"), name);
        check(|plan| plan.name = "n".repeat(256), name);
    }

    #[test]
    fn each_broken_invariant_is_named() {
        check(|plan| plan.groups.clear(), "the plan has no groups");
        check(|plan| plan.hosts.push("c1".to_owned()), "host `c1` is empty or not unique");
        check(|plan| plan.leaves[1].path.clear(), "path `` is empty or not unique");
        let named = |name: &str, of| Expression::Named { name: name.to_owned(), of: Box::new(of) };
        let with =
            |name: &str| Expression::With { given: Given::Result(name.to_owned()), of: Box::new(Expression::Skip) };
        check(
            |plan| plan.groups[0].expression = Expression::Sequence(named("p", with("p")).into(), with("p").into()),
            "`main` starts a process with `p`, but no result has this name there",
        );
        check(
            |plan| plan.groups[0].expression = named("p", named("p", Expression::Skip)),
            "result `p` is empty or not unique",
        );
        let first = std::time::Duration::ZERO;
        check(
            |plan| plan.leaves[0].policy.backoff = Some(Backoff { first, longest: first }),
            "the back-off of `main/left/a` is not from 10 ms to 1 h",
        );
        check(|plan| plan.leaves[0].host = 7, "`main/left/a` points to host 7, which does not exist");
        check(|plan| plan.wires[0].to.leaf = 9, "`wire at port In` points to leaf 9, which does not exist");
        check(|plan| plan.groups[1].sets[0].wires.push(5), "`main/left` points to wire 5, which does not exist");
        check(
            |plan| plan.groups[1].sets_always.push(5),
            "`main/left` points to connection set 5, which does not exist",
        );
        check(
            |plan| plan.groups[0].members[0].kind = MemberKind::Group(8),
            "`main/left` points to group 8, which does not exist",
        );
        check(
            |plan| plan.groups[2].members[0].kind = MemberKind::Leaf(0),
            "`main/left/a` is not a member of exactly one group below `main`",
        );
        check(
            |plan| plan.groups[1].members[0].kind = MemberKind::Group(0),
            "`main/left/a` is not a member of exactly one group below `main`",
        );
        check(|plan| drop(plan.groups[0].members.pop()), "`main` points to member 1, which does not exist");
    }

    #[test]
    fn each_broken_expression_is_named() {
        check(
            |plan| plan.groups[0].expression = Expression::Run { member: 2, sets: vec![] },
            "`main` points to member 2, which does not exist",
        );
        check(
            |plan| plan.groups[0].expression = Expression::AnyOf { count: 2, of: vec![Expression::Skip] },
            "the event actions of `main` have an operator with a wrong number of operands",
        );
        check(
            |plan| plan.groups[0].expression = Expression::AtLeast { count: 2, of: vec![Expression::Skip] },
            "the event actions of `main` have an operator with a wrong number of operands",
        );
        let matching = |tags: &[Option<&str>]| {
            let arm = |tag: &Option<&str>| Arm { tag: tag.map(str::to_owned), body: Expression::Skip };
            Expression::Match(tags.iter().map(arm).collect())
        };
        let operands = "the event actions of `main` have an operator with a wrong number of operands";
        check(|plan| plan.groups[0].expression = matching(&[]), operands);
        check(|plan| plan.groups[0].expression = matching(&[None, Some("found")]), operands);
        let twice = [Some("found"), Some("found")];
        check(|plan| plan.groups[0].expression = matching(&twice), "tag `found` is empty or not unique");
        let long = "t".repeat(TAG_MAX + 1);
        let expect = format!("the tag `{long}` is longer than 64 bytes");
        check(|plan| plan.groups[0].expression = matching(&[Some(&long)]), &expect);
        check(
            |plan| {
                let (resources, of) = (vec!["arm".to_owned(), "arm".to_owned()], Box::new(Expression::Skip));
                plan.groups[0].expression = Expression::Using { resources, of };
            },
            "resource `arm` is empty or not unique",
        );
        let source = Box::new(Expression::Skip);
        check(|plan| plan.groups[0].expression = Expression::Asynchronous { source, pool: vec![] }, operands);
        let of = Box::new(Expression::Skip);
        check(|plan| plan.groups[0].expression = Expression::Repeat { until: vec![], of }, operands);
        let catching = |failures: &[Option<Failure>]| {
            let arm = |failure: &Option<Failure>| CatchArm { failure: failure.clone(), body: Expression::Skip };
            Expression::Catch { of: Box::new(Expression::Skip), arms: failures.iter().map(arm).collect() }
        };
        check(|plan| plan.groups[0].expression = catching(&[]), operands);
        check(|plan| plan.groups[0].expression = catching(&[None, Some(Failure::Busy)]), operands);
        let twice = [Some(Failure::Busy), Some(Failure::Busy)];
        check(|plan| plan.groups[0].expression = catching(&twice), "failure `busy` is empty or not unique");
        let (of, until) = (Box::new(Expression::Skip), vec!["found".to_owned(), "found".to_owned()]);
        check(
            |plan| plan.groups[0].expression = Expression::Repeat { until, of },
            "tag `found` is empty or not unique",
        );
        check(
            |plan| {
                for _ in 0..DEPTH_MAX {
                    let inner = std::mem::replace(&mut plan.groups[0].expression, Expression::Skip);
                    plan.groups[0].expression = Expression::Disable(vec![inner]);
                }
            },
            "the event actions of `main` are nested deeper than 64 levels",
        );
        check(
            |plan| plan.leaves = vec![plan.leaves[0].clone(); LEAVES_MAX + 1],
            "the plan has 10001 leaves; the limit is 10000",
        );
    }
}
