//! A part of a change of a plan that runs: one program more, one process less, or the programs of one host.

use super::{Claim, ConnectionSet, Expression, Leaf, Member, MemberKind, Plan, Wire, difference};
use std::collections::BTreeMap;

/// Whether a group continues when a program that was added to it has failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failing {
    /// It is a process of the group like any other.
    Counts,
    /// The group continues without it: `name?`.
    IsIgnored,
}

impl Plan {
    /// Adds a program of another plan to a group of this plan, and returns the new plan. The
    /// program is `main/name` of the other plan. It keeps its connections to programs that have the
    /// same names in the group.
    ///
    /// # Errors
    /// A sentence for a person: no such group or program, or a name that is taken.
    pub fn with_program(&self, piece: &Self, name: &str, group: &str, failing: Failing) -> Result<Self, String> {
        let live = self.live_groups();
        let is_it = |(number, one): &(u32, &super::Group)| one.path == group && live.contains(number);
        let found = (0_u32..).zip(&self.groups).find(is_it).map(|(number, _)| number);
        let number = found.ok_or_else(|| format!("`{}` has no group `{group}`", self.name))?;
        let mut plan = self.clone();
        let leaf = plan.add_leaf(piece, name, group)?;
        let slot = plan.groups[number as usize].members.len();
        if plan.groups[number as usize].members.iter().any(|member| member.name == name) {
            return Err(format!("`{group}/{name}` runs already"));
        }
        let own = piece.main_leaf(name).ok_or_else(|| format!("the process `{name}` is not a program"))?;
        let wires = (0_u32..).zip(&piece.wires).filter(|(_, wire)| [wire.from.leaf, wire.to.leaf].contains(&own));
        let mut added = Vec::new();
        for (_, wire) in wires {
            let end = |end: &super::LeafPort| {
                let leaf = if end.leaf == own { Some(leaf) } else { plan.stands_for(piece, end.leaf, group) };
                Some(super::LeafPort { leaf: leaf?, port: end.port.clone() })
            };
            let ends = end(&wire.from).zip(end(&wire.to));
            let (from, to) =
                ends.ok_or_else(|| format!("a connection of `{name}` leads to no program of `{group}`"))?;
            added.push(u32::try_from(plan.wires.len()).map_err(|_large| "there are too many connections".to_owned())?);
            plan.wires.push(Wire { from, to, ..wire.clone() });
        }
        let service = piece.groups[0].members.iter().any(|member| member.name == name && member.service);
        let slot = u32::try_from(slot).map_err(|_large| "there are too many processes".to_owned())?;
        let into = &mut plan.groups[number as usize];
        let set = u32::try_from(into.sets.len()).map_err(|_large| "there are too many connections".to_owned())?;
        into.members.push(Member { name: name.to_owned(), kind: MemberKind::Leaf(leaf), service });
        into.sets.push(ConnectionSet { owner: Some(slot), label: Some("added".to_owned()), wires: added });
        let run = Expression::Run { member: slot, sets: vec![set] };
        let run = match failing {
            Failing::Counts => run,
            Failing::IsIgnored => Expression::Otherwise(Box::new(run), Box::new(Expression::Skip)),
        };
        let before = std::mem::replace(&mut into.expression, Expression::Skip);
        into.expression = if before == Expression::Skip {
            run
        } else if let Expression::Concurrent(mut of) = before {
            of.push(run);
            Expression::Concurrent(of)
        } else {
            Expression::Concurrent(vec![before, run])
        };
        Ok(plan)
    }

    /// Returns the plan without a process, its connections, and its place in the event actions of its group.
    ///
    /// # Errors
    /// A sentence for a person: no such process, or nothing sensible would be left of the event actions.
    pub fn without_process(&self, path: &str) -> Result<Self, String> {
        let mut plan = self.clone();
        let live = self.live_groups();
        let place = (0_usize..)
            .zip(&self.groups)
            .filter(|(number, _)| u32::try_from(*number).is_ok_and(|number| live.contains(&number)));
        let found = place.into_iter().find_map(|(number, group)| {
            let name = path.strip_prefix(&group.path)?.strip_prefix('/')?;
            let slot = group.members.iter().position(|member| member.name == name && !name.is_empty())?;
            Some((number, slot))
        });
        let (number, slot) = found.ok_or_else(|| format!("`{}` has no process `{path}`", self.name))?;
        let gone = self.leaves_below(self.groups[number].members[slot].kind);
        let group = &mut plan.groups[number];
        let member = u32::try_from(slot).map_err(|_large| "there are too many processes".to_owned())?;
        let left = without(&group.expression, member).map_err(|()| {
            format!("the event actions of `{}` need `{path}`; change the spec and deploy it", group.path)
        })?;
        group.expression = left.ok_or_else(|| format!("nothing would be left of `{}`", group.path))?;
        group.members[slot].name.clear();
        let is_gone = |wire: &u32| {
            let wire = self.wires.get(*wire as usize);
            wire.is_none_or(|wire| gone.contains(&wire.from.leaf) || gone.contains(&wire.to.leaf))
        };
        for set in plan.groups.iter_mut().flat_map(|group| &mut group.sets) {
            set.wires.retain(|wire| !is_gone(wire));
        }
        plan.claims.retain(|claim| !gone.contains(&claim.leaf));
        Ok(plan)
    }

    /// Returns the plan with the wanted programs of one host, and no other change.
    ///
    /// # Errors
    /// Every obstacle, as in [`difference`], or the message that nothing differs.
    pub fn changed_on(&self, wanted: &Self, host: &str) -> Result<Self, Vec<String>> {
        let next = difference(self, wanted)?.plan;
        let still = next.live_leaves();
        // A program that overlaps with the previous one has another number.
        let still = still.iter().filter_map(|number| next.leaves.get(*number as usize));
        let still: BTreeMap<&str, &Leaf> = still.map(|leaf| (leaf.path.as_str(), leaf)).collect();
        let is_there = |leaf: &Leaf| self.hosts.get(leaf.host as usize).is_some_and(|name| name == host);
        let (mut plan, mut theirs) = (self.clone(), Vec::new());
        for number in self.live_leaves() {
            let Some(leaf) = plan.leaves.get_mut(number as usize).filter(|leaf| is_there(leaf)) else { continue };
            if let Some(next) = still.get(leaf.path.as_str()) {
                *leaf = (*next).clone();
                theirs.push(number);
            }
        }
        plan.claims.retain(|claim| !theirs.contains(&claim.leaf));
        plan.claims.extend(next.claims.into_iter().filter(|claim| theirs.contains(&claim.leaf)));
        if difference(self, &plan)?.changes.is_empty() {
            return Err(vec![format!("this spec changes no program of `{}` on `{host}`", self.name)]);
        }
        Ok(plan)
    }

    fn add_leaf(&mut self, piece: &Self, name: &str, group: &str) -> Result<u32, String> {
        let own = piece.main_leaf(name).ok_or_else(|| format!("the process `{name}` is not a program"))?;
        let leaf = &piece.leaves[own as usize];
        let host = piece.hosts.get(leaf.host as usize).map_or("", String::as_str);
        let known = self.hosts.iter().position(|other| other == host);
        if known.is_none() {
            self.hosts.push(host.to_owned());
        }
        let host = u32::try_from(known.unwrap_or(self.hosts.len() - 1))
            .map_err(|_large| "there are too many hosts".to_owned())?;
        let number = u32::try_from(self.leaves.len()).map_err(|_large| "there are too many programs".to_owned())?;
        self.leaves.push(Leaf { path: format!("{group}/{name}"), host, ..leaf.clone() });
        let claims = piece.claims.iter().filter(|claim| claim.leaf == own);
        self.claims.extend(claims.map(|claim| Claim { leaf: number, ..claim.clone() }));
        Ok(number)
    }

    fn main_leaf(&self, name: &str) -> Option<u32> {
        let member = self.groups.first()?.members.iter().find(|member| member.name == name)?;
        if let MemberKind::Leaf(leaf) = member.kind { Some(leaf) } else { None }
    }

    /// Returns the program that a leaf of a piece represents, by its name in the group.
    fn stands_for(&self, piece: &Self, leaf: u32, group: &str) -> Option<u32> {
        let name = piece.leaves.get(leaf as usize)?.path.rsplit('/').next()?;
        let (path, live) = (format!("{group}/{name}"), self.live_leaves());
        (0_u32..)
            .zip(&self.leaves)
            .find(|(number, leaf)| leaf.path == path && live.contains(number))
            .map(|(number, _)| number)
    }

    fn leaves_below(&self, kind: MemberKind) -> Vec<u32> {
        match kind {
            MemberKind::Leaf(leaf) => vec![leaf],
            MemberKind::Group(group) => {
                let members = self.groups.get(group as usize).map_or(&[][..], |group| &group.members);
                members.iter().flat_map(|member| self.leaves_below(member.kind)).collect()
            }
        }
    }
}

/// Returns an expression without a member; an error if its place decides the behaviour of others.
fn without(expression: &Expression, member: u32) -> Result<Option<Expression>, ()> {
    let boxed = |p, q: fn(Box<Expression>, Box<Expression>) -> Expression, r| q(Box::new(p), Box::new(r));
    let all = |of: &[Expression]| -> Result<Vec<Expression>, ()> {
        Ok(of.iter().map(|of| without(of, member)).collect::<Result<Vec<_>, ()>>()?.into_iter().flatten().collect())
    };
    let joined = |mut of: Vec<Expression>, join: fn(Vec<Expression>) -> Expression| match of.len() {
        0 | 1 => of.pop(),
        _ => Some(join(of)),
    };
    let whole = |of: &Expression| match without(of, member)? {
        Some(left) if left == *of => Ok(Some(())),
        Some(_) => Err(()),
        None => Ok(None),
    };
    Ok(match expression {
        Expression::Run { member: other, .. } if *other == member => None,
        Expression::Run { .. } | Expression::Skip | Expression::Never | Expression::Fail(_) | Expression::Wait(_) => {
            Some(expression.clone())
        }
        Expression::Concurrent(of) => joined(all(of)?, Expression::Concurrent),
        Expression::FailFast(of) => joined(all(of)?, Expression::FailFast),
        Expression::Disable(of) => {
            let left = all(of)?;
            let is_limit = left.len() < of.len() && left.iter().all(is_limit);
            if is_limit { None } else { joined(left, Expression::Disable) }
        }
        Expression::Sequence(p, q) => match (without(p, member)?, without(q, member)?) {
            (Some(p), Some(q)) => Some(boxed(p, Expression::Sequence, q)),
            (left, other) => left.or(other),
        },
        Expression::Otherwise(p, q) => match (without(p, member)?, without(q, member)?) {
            (Some(p), Some(q)) => Some(boxed(p, Expression::Otherwise, q)),
            (Some(left), None) => Some(left),
            (None, other) => other.filter(|other| *other != Expression::Skip),
        },
        Expression::Finally(p, q) => match (without(p, member)?, without(q, member)?) {
            (Some(p), Some(q)) => Some(boxed(p, Expression::Finally, q)),
            (left, other) => left.or(other),
        },
        Expression::Shield { bound, of } => {
            without(of, member)?.map(|of| Expression::Shield { bound: *bound, of: Box::new(of) })
        }
        Expression::Using { resources, of } => {
            without(of, member)?.map(|of| Expression::Using { resources: resources.clone(), of: Box::new(of) })
        }
        // At this place a value is passed on, or the operand is counted. So the author has to
        // decide how the expression works without this operand.
        Expression::Conditional(..)
        | Expression::Recurrent(..)
        | Expression::AnyOf { .. }
        | Expression::AtLeast { .. }
        | Expression::Match(_)
        | Expression::Asynchronous { .. }
        | Expression::Tagged { .. }
        | Expression::With { .. }
        | Expression::Named { .. }
        | Expression::Repeat { .. }
        | Expression::Catch { .. }
        | Expression::Chart(_) => {
            let stays = expression.operands().into_iter().map(whole).collect::<Result<Vec<_>, ()>>()?;
            if stays.iter().all(Option::is_none) {
                None
            } else if stays.iter().all(Option::is_some) {
                Some(expression.clone())
            } else {
                return Err(());
            }
        }
    })
}

/// Whether an expression is the limit of `within`: nothing but a `wait` and a `fail`.
fn is_limit(expression: &Expression) -> bool {
    matches!(expression, Expression::Sequence(p, q) if matches!((&**p, &**q), (Expression::Wait(_), Expression::Fail(_))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Options, Source, compile};
    use std::collections::BTreeSet;

    const MODULES: &str = "
module Source(host) { out Out: Number; service; }
module Sink(host) { in In: Number; done; claims leg; }
";

    fn plan(actions: &str) -> Plan {
        let text = format!(
            "{MODULES} process main() {{ host {{ \"c1\" }}
            instantiated_processes {{ a instof Source(\"c1\"); b instof Sink(\"c2\"); c instof Sink(\"c1\"); }}
            internal_connections(b, feed) {{ a, Out -> b, In; }}
            internal_event_actions {{ {actions} }} }}"
        );
        let compiled = compile(&Source::new("spec", &*text), &[], &Options::named("spec"));
        compiled.plan.unwrap_or_else(|| panic!("{:#?}", compiled.diagnostics))
    }

    #[test]
    fn a_program_is_added_beside_all_else_and_taken_away_again() {
        let running = plan("a , (b[feed] ; c)");
        let piece = format!(
            "{MODULES} process main() {{ host {{ \"c1\" }}
            instantiated_processes {{ d instof Sink(\"c2\"); a instof Source(\"c1\"); }}
            internal_connections(d, added) {{ a, Out -> d, In; }}
            internal_event_actions {{ d[added] , a }} }}"
        );
        let piece = compile(&Source::new("piece", &*piece), &[], &Options::named("piece")).plan.unwrap();
        let wanted = running.with_program(&piece, "d", "main", Failing::IsIgnored).unwrap();
        let found = difference(&running, &wanted).unwrap();
        found.plan.validate().unwrap();
        let lines: Vec<String> = found.changes.iter().map(ToString::to_string).collect();
        let expected = [
            "add        main/d: Sink on `c2`",
            "act        main: its event actions",
            "connect    main/a, Out -> main/d, In",
        ];
        assert_eq!(lines, expected);
        assert_eq!(found.plan.claims_of(3).len(), 1);
        assert!(found.plan.with_program(&piece, "d", "main", Failing::Counts).unwrap_err().contains("runs already"));
        let back = found.plan.without_process("main/d").unwrap();
        assert_eq!(back.groups[0].expression, running.groups[0].expression);
        let changes = difference(&found.plan, &back).unwrap().changes;
        assert_eq!(changes.len(), 3, "{changes:?}");
    }

    /// A set of a process that was taken away stood in the way of every later change.
    #[test]
    fn what_was_added_comes_and_goes_in_any_order() {
        let piece = |name: &str| {
            let text = format!(
                "{MODULES} process main() {{ host {{ \"c1\" }}
                instantiated_processes {{ {name} instof Sink(\"c2\"); a instof Source(\"c1\"); }}
                internal_connections({name}, added) {{ a, Out -> {name}, In; }}
                internal_event_actions {{ {name}[added] , a }} }}"
            );
            compile(&Source::new("piece", &*text), &[], &Options::named("piece")).plan.unwrap()
        };
        let mut running = plan("a , b[feed] , c");
        let steps = ["+d", "+e", "-d", "-e", "+f", "+d", "-b", "-f", "+e"];
        for step in steps {
            let (sign, name) = step.split_at(1);
            let wanted = match sign {
                "+" => running.with_program(&piece(name), name, "main", Failing::Counts),
                _ => running.without_process(&format!("main/{name}")),
            };
            let next = difference(&running, &wanted.unwrap()).unwrap().plan;
            assert_eq!(next.validate().map_err(|why| why.to_string()), Ok(()), "{step}");
            running = next;
        }
        let live: Vec<&str> = running.live_leaves().iter().map(|leaf| &*running.leaves[*leaf as usize].path).collect();
        assert_eq!(BTreeSet::from_iter(live), BTreeSet::from(["main/a", "main/c", "main/d", "main/e"]));
    }

    #[test]
    fn what_is_left_of_event_actions_is_what_the_others_do() {
        let check = |actions: &str, left: &str| {
            let plan = plan(actions).without_process("main/c");
            let expected = self::plan(left).groups.remove(0).expression;
            assert_eq!(plan.map(|mut plan| plan.groups.remove(0).expression), Ok(expected), "{actions}");
        };
        check("a # (b ; c)", "a # b");
        check("a # b # c?", "a # b");
        check("(c within 5 s) , a # b", "a # b");
        check("a # shield (c ; b)", "a # shield (b)");
        check("(c else skip) ; a # b", "a # b");
        check("(a # b) ; (c finally skip)", "(a # b) ; skip");
        for actions in ["a # (b : c)", "a # (c ;; b)", "any 1 of (b, c) # a"] {
            let why = "the event actions of `main` need `main/c`; change the spec and deploy it";
            assert_eq!(plan(actions).without_process("main/c"), Err(why.to_owned()), "{actions}");
        }
        assert_eq!(plan("c").without_process("main/c"), Err("nothing would be left of `main`".to_owned()));
        assert_eq!(plan("c").without_process("main/d"), Err("`spec` has no process `main/d`".to_owned()));
    }

    #[test]
    fn a_canary_has_what_differs_on_its_host_and_nothing_else() {
        let spec = |source: &str, sink: &str, actions: &str| {
            let text = format!(
                "module Source(host, rate: Number = 1) {{ out Out: Number; service; }}
                module Sink(host, way: Text = good) {{ in In: Number; done; }}
                process main() {{ host {{ \"c1\" }}
                instantiated_processes {{ a instof Source(\"c1\"{source}); b instof Sink(\"c2\"{sink}); }}
                internal_connections(b, feed) {{ a, Out -> b, In; }}
                internal_event_actions {{ {actions} }} }}"
            );
            compile(&Source::new("spec", &*text), &[], &Options::named("spec")).plan.unwrap()
        };
        let (running, wanted) = (spec("", "", "a , b[feed]"), spec(", 2", ", best", "a # b[feed]"));
        let part = running.changed_on(&wanted, "c2").unwrap();
        let lines = |from: &Plan, to: &Plan| {
            difference(from, to).unwrap().changes.iter().map(ToString::to_string).collect::<Vec<_>>()
        };
        assert_eq!(lines(&running, &part), ["replace    main/b: `way` is \"best\", was \"good\""]);
        let rest = ["replace    main/a: `rate` is 2, was 1", "act        main: its event actions"];
        assert_eq!(lines(&part, &wanted), rest);
        let why = "this spec changes no program of `spec` on `c3`";
        assert_eq!(running.changed_on(&wanted, "c3"), Err(vec![why.to_owned()]));
    }
}
