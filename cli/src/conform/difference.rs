//! The first difference between the plan of a record and the plan of a spec, in words.
//!
//! The whole plan is compared, except the name of the deployment: hosts, programs, arguments, policies and connections.
//! Processes are found by their paths, so their order in the plan does not matter.

use language::plan::{
    Argument, Backoff, Claim, Constant, DEADLINE, Expression, Given, Group, Leaf, LeafKind, LinkLoss, MemberKind, Plan,
    Policy, Replacement, Restart, Strategy, Supervision, Wire,
};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;
use verify::seconds;

/// Returns the first difference, if there is one.
pub(super) fn difference(recorded: &Plan, spec: &Plan) -> Option<String> {
    processes(recorded, spec)
        .or_else(|| groups(recorded, spec))
        .or_else(|| leaves(recorded, spec))
        .or_else(|| wires(recorded, spec))
        .or_else(|| claims(recorded, spec))
}

/// A difference of one process or connection. The values are given only if they are short.
struct Differs {
    what: &'static str,
    values: Option<(String, String)>,
}

/// Compares properties whose values fit into a word or two.
fn said<T: PartialEq>(what: &'static str, pair: (&T, &T), words: impl Fn(&T) -> String) -> Option<Differs> {
    (pair.0 != pair.1).then(|| Differs { what, values: Some((words(pair.0), words(pair.1))) })
}

/// Compares properties whose values are too long for a sentence.
fn differs<T: PartialEq>(what: &'static str, pair: (&T, &T)) -> Option<Differs> {
    (pair.0 != pair.1).then_some(Differs { what, values: None })
}

impl Differs {
    fn of(self, who: &str) -> String {
        let Self { what, values } = self;
        match values {
            Some((recorded, spec)) => {
                format!("`{who}` differs in its {what}: {recorded} in the record, {spec} in the spec")
            }
            None => format!("`{who}` differs in its {what}"),
        }
    }
}

/// Compares the lists of processes.
fn processes(recorded: &Plan, spec: &Plan) -> Option<String> {
    let all = |plan: &Plan| -> BTreeMap<String, &'static str> {
        let groups = plan.groups.iter().map(|group| (group.path.clone(), "group"));
        groups.chain(plan.leaves.iter().map(|leaf| (leaf.path.clone(), "program"))).collect()
    };
    let who = |path: &String| format!("`{path}`");
    first(&all(recorded), &all(spec), who, |kind| format!("is a {kind} only in the record"))
}

/// Returns the first entry that differs, or that only one side has. `differs` describes a difference, given the
/// entry of the record.
fn first<T: PartialEq>(
    recorded: &BTreeMap<String, T>,
    spec: &BTreeMap<String, T>,
    who: impl Fn(&String) -> String,
    differs: impl Fn(&T) -> String,
) -> Option<String> {
    let missing = recorded.keys().find(|name| !spec.contains_key(*name));
    let added = spec.keys().find(|name| !recorded.contains_key(*name));
    let other = recorded.iter().find(|(name, one)| spec.get(*name).is_some_and(|other| other != *one));
    missing
        .map(|name| format!("{} is in the record and not in the spec", who(name)))
        .or_else(|| added.map(|name| format!("{} is in the spec and not in the record", who(name))))
        .or_else(|| other.map(|(name, one)| format!("{} {}", who(name), differs(one))))
}

fn host(plan: &Plan, host: u32) -> String {
    plan.hosts.get(host as usize).map_or_else(|| "none".to_owned(), |name| format!("`{name}`"))
}

fn groups(recorded: &Plan, spec: &Plan) -> Option<String> {
    recorded.groups.iter().find_map(|one| {
        let other = spec.groups.iter().find(|other| other.path == one.path)?;
        let hosts = (&host(recorded, one.host), &host(spec, other.host));
        let are_same = is_same(one, &one.expression, other, &other.expression);
        let found = said("host", hosts, String::clone)
            .or_else(|| differs("instances", (&members(one), &members(other))))
            .or_else(|| differs("event actions", (&true, &are_same)))
            .or_else(|| differs("connections", (&sets(recorded, one), &sets(spec, other))))
            .or_else(|| said("supervision", (&one.supervision, &other.supervision), supervision));
        found.map(|found| found.of(&one.path))
    })
}

/// Returns the members of a group by name, with two facts: whether the member is a group, and whether it is a service.
fn members(group: &Group) -> BTreeMap<&str, (bool, bool)> {
    let member = |member: &language::plan::Member| (matches!(member.kind, MemberKind::Group(_)), member.service);
    group.members.iter().map(|one| (one.name.as_str(), member(one))).collect()
}

/// Returns whether the event actions of two groups are the same. Members and connection sets are compared by name, not by number.
fn is_same(one: &Group, p: &Expression, other: &Group, q: &Expression) -> bool {
    let name = |group: &Group, member: u32| group.members.get(member as usize).map(|member| member.name.clone());
    let label =
        |group: &Group, set: u32| group.sets.get(set as usize).map(|set| (set.label.clone(), owner(group, set.owner)));
    let labels = |group: &Group, sets: &[u32]| sets.iter().map(|set| label(group, *set)).collect::<Vec<_>>();
    let is_alike = match (p, q) {
        (Expression::Run { member, sets }, Expression::Run { member: theirs, sets: others }) => {
            name(one, *member) == name(other, *theirs) && labels(one, sets) == labels(other, others)
        }
        (Expression::Wait(time), Expression::Wait(theirs)) => time == theirs,
        (Expression::Fail(why), Expression::Fail(theirs)) => {
            // The reason of a deadline quotes its text and its line, so it is not compared. The time of the deadline is
            // in the `wait` before it.
            why == theirs || why.starts_with(DEADLINE) && theirs.starts_with(DEADLINE)
        }
        (Expression::AnyOf { count, .. }, Expression::AnyOf { count: theirs, .. })
        | (Expression::AtLeast { count, .. }, Expression::AtLeast { count: theirs, .. }) => count == theirs,
        (Expression::Match(arms), Expression::Match(theirs)) => {
            arms.iter().map(|arm| &arm.tag).eq(theirs.iter().map(|arm| &arm.tag))
        }
        (Expression::Shield { bound, .. }, Expression::Shield { bound: theirs, .. }) => bound == theirs,
        (Expression::Using { resources, .. }, Expression::Using { resources: theirs, .. }) => resources == theirs,
        (Expression::Chart(chart), Expression::Chart(theirs)) => {
            chart.chart == theirs.chart && chart.runs.len() == theirs.runs.len()
        }
        (Expression::Tagged { tag, .. }, Expression::Tagged { tag: theirs, .. }) => tag == theirs,
        (Expression::Catch { arms, .. }, Expression::Catch { arms: theirs, .. }) => {
            arms.iter().map(|arm| &arm.failure).eq(theirs.iter().map(|arm| &arm.failure))
        }
        (Expression::Repeat { until, .. }, Expression::Repeat { until: theirs, .. }) => until == theirs,
        (Expression::With { given, .. }, Expression::With { given: theirs, .. }) => match (given, theirs) {
            (Given::Known { value, .. }, Given::Known { value: other, .. }) => value == other,
            (Given::Result(name), Given::Result(other)) => name == other,
            (Given::Known { .. }, Given::Result(_)) | (Given::Result(_), Given::Known { .. }) => false,
        },
        (_, _) => std::mem::discriminant(p) == std::mem::discriminant(q),
    };
    let (operands, others) = (p.operands(), q.operands());
    let mut pairs = operands.iter().zip(&others);
    is_alike && operands.len() == others.len() && pairs.all(|(p, q)| is_same(one, p, other, q))
}

fn owner(group: &Group, owner: Option<u32>) -> Option<String> {
    group.members.get(owner? as usize).map(|member| member.name.clone())
}

/// A connection set: the owner, the label, whether it is always open, and its connections.
type Set = (Option<String>, Option<String>, bool, Vec<String>);

/// The connection sets of a group.
fn sets(plan: &Plan, group: &Group) -> BTreeSet<Set> {
    let set = |(number, set): (u32, &language::plan::ConnectionSet)| {
        let wires = set.wires.iter().filter_map(|wire| plan.wires.get(*wire as usize));
        let mut wires: Vec<String> = wires.map(|wire| plan.ends(wire)).collect();
        wires.sort_unstable();
        (owner(group, set.owner), set.label.clone(), group.sets_always.contains(&number), wires)
    };
    (0_u32..).zip(&group.sets).map(set).collect()
}

fn supervision(supervision: &Supervision) -> String {
    let strategy = match supervision.strategy {
        Strategy::OneForOne => "one for one",
        Strategy::OneForAll => "one for all",
        Strategy::RestForOne => "rest for one",
    };
    match supervision.intensity {
        Some(borne) => format!("{strategy}, {} restarts within {}", borne.restarts, seconds(borne.within)),
        None => strategy.to_owned(),
    }
}

fn leaves(recorded: &Plan, spec: &Plan) -> Option<String> {
    recorded.leaves.iter().find_map(|one| {
        let other = spec.leaves.iter().find(|other| other.path == one.path)?;
        let hosts = (&host(recorded, one.host), &host(spec, other.host));
        let found = said("host", hosts, String::clone)
            .or_else(|| said("module", (&one.module, &other.module), |module| format!("`{module}`")))
            .or_else(|| said("exec", (&one.exec, &other.exec), |exec| quoted(exec.as_deref())))
            .or_else(|| arguments(&one.arguments, &other.arguments))
            .or_else(|| said("kind", (&one.kind, &other.kind), |kind| kind_of(*kind).to_owned()))
            .or_else(|| said("limit to stop", (&one.stop_within, &other.stop_within), |time| seconds(*time)))
            .or_else(|| outcomes(one, other))
            .or_else(|| policy(&one.policy, &other.policy));
        found.map(|found| found.of(&one.path))
    })
}

fn quoted(text: Option<&str>) -> String {
    text.map_or_else(|| "none".to_owned(), |text| format!("`{text}`"))
}

fn kind_of(kind: LeafKind) -> &'static str {
    match kind {
        LeafKind::Controller => "a controller",
        LeafKind::Plain => "a plain program",
    }
}

fn arguments(recorded: &[Argument], spec: &[Argument]) -> Option<Differs> {
    let most = recorded.len().max(spec.len());
    let at = (0..most).find(|at| recorded.get(*at) != spec.get(*at))?;
    let words = |argument: Option<&Argument>| {
        let Some(Argument { name, value }) = argument else { return "none".to_owned() };
        let value = match value {
            Constant::Text(text) => format!("\"{text}\""),
            Constant::Number(number) => number.to_string(),
            Constant::Truth(truth) => truth.to_string(),
            Constant::Secret(key) => format!("secret(\"{key}\")"),
        };
        name.as_ref().map_or_else(|| format!("`{value}`"), |name| format!("`{name} = {value}`"))
    };
    Some(Differs { what: "arguments", values: Some((words(recorded.get(at)), words(spec.get(at)))) })
}

fn outcomes(one: &Leaf, other: &Leaf) -> Option<Differs> {
    let words = |outcomes: &Vec<String>| match outcomes.as_slice() {
        [] => "`done`".to_owned(),
        tags => format!("`done({})`", tags.join(" | ")),
    };
    said("outcomes", (&one.outcomes, &other.outcomes), words)
}

fn policy(one: &Policy, other: &Policy) -> Option<Differs> {
    let restart = |restart: &Restart| {
        let word = match restart {
            Restart::Temporary => "temporary",
            Restart::Transient => "transient",
            Restart::Permanent => "permanent",
        };
        format!("`{word}`")
    };
    let link_loss = |link_loss: &LinkLoss| match link_loss {
        LinkLoss::Leave => "none".to_owned(),
        LinkLoss::Keep => "`keep`".to_owned(),
        LinkLoss::SafeStopAfter(time) => format!("`safe_stop_after {}`", seconds(*time)),
        LinkLoss::Hold => "`hold`".to_owned(),
    };
    let replacement = |replacement: &Replacement| match replacement {
        Replacement::BreakBeforeMake => "`break_before_make`".to_owned(),
        Replacement::Overlap => "`overlap`".to_owned(),
    };
    let time = |time: &Option<Duration>| time.map_or_else(|| "none".to_owned(), seconds);
    let pauses = |backoff: &Option<Backoff>| match backoff {
        Some(pauses) => format!("{} to {}", seconds(pauses.first), seconds(pauses.longest)),
        None => "none".to_owned(),
    };
    said("restart", (&one.restart, &other.restart), restart)
        .or_else(|| said("backoff", (&one.backoff, &other.backoff), pauses))
        .or_else(|| said("replace", (&one.replacement, &other.replacement), replacement))
        .or_else(|| said("on_link_loss", (&one.link_loss, &other.link_loss), link_loss))
        .or_else(|| said("on_agent_loss", (&one.agent_loss, &other.agent_loss), time))
        .or_else(|| said("limit to be ready", (&one.ready_within, &other.ready_within), time))
        .or_else(|| differs("watchdog", (&one.watchdog, &other.watchdog)))
        .or_else(|| differs("limits", (&one.usage, &other.usage)))
}

fn wires(recorded: &Plan, spec: &Plan) -> Option<String> {
    let all = |plan: &Plan| -> BTreeMap<String, Vec<Wire>> {
        let mut all = BTreeMap::new();
        for wire in &plan.wires {
            let same = Wire { from: unnamed(), to: unnamed(), ..wire.clone() };
            all.entry(plan.ends(wire)).or_insert_with(Vec::new).push(same);
        }
        all.values_mut().for_each(|wires| wires.sort_unstable_by_key(|wire| (wire.transfer, wire.quality)));
        all
    };
    let who = |ends: &String| format!("the connection `{ends}`");
    first(&all(recorded), &all(spec), who, |_| "differs in its quality".to_owned())
}

fn unnamed() -> language::plan::LeafPort {
    language::plan::LeafPort { leaf: 0, port: String::new() }
}

fn claims(recorded: &Plan, spec: &Plan) -> Option<String> {
    let all = |plan: &Plan| -> BTreeSet<(String, String, bool)> {
        let path =
            |claim: &Claim| plan.leaves.get(claim.leaf as usize).map_or_else(String::new, |leaf| leaf.path.clone());
        plan.claims.iter().map(|claim| (path(claim), claim.device.clone(), claim.is_write)).collect()
    };
    let (ours, theirs) = (all(recorded), all(spec));
    let (path, device, _) = ours.symmetric_difference(&theirs).next()?;
    Some(format!("`{path}` differs in its claims: `{device}`"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use language::{Options, Source, compile};

    const SPEC: &str = r#"
        module Eye(host: Host, gain = 2) { exec "eye --fast"; plain; out Out: Ranges; service; }
        module Arm(host: Host, speed = 1 m/s) { in In: Ranges; done; stop within 2 s; }
        process Cell(there){
            host{there}
            resource table;
            instantiated_processes{
                eye instof Eye(there);
                arm instof Arm(there, speed = 3 m/s) { restart transient; memory 64 MB; on_link_loss hold; }
            }
            internal_connections(eye, lbl){ eye, Out -> arm, In; }
            internal_event_actions{ eye[lbl], arm within 5 s }
        }
        process main(){
            host{c1}
            supervision{ restarts 3 within 10 s; }
            instantiated_processes{ cell instof Cell(c2); home instof Arm(c1); }
            internal_event_actions{ cell ; home }
        }"#;

    fn plan(text: &str) -> Plan {
        let compiled = compile(&Source::new("test.dca", text.to_owned()), &[], &Options::named("test"));
        compiled.plan.unwrap_or_else(|| panic!("{:?}\n{text}", compiled.diagnostics))
    }

    #[test]
    fn the_first_difference_is_said_with_both_sides() {
        let cases = [
            (
                "cell instof Cell(c2)",
                "cell instof Cell(c3)",
                "`main/cell` differs in its host: `c2` in the record, `c3` in the spec",
            ),
            (
                "home instof Arm(c1)",
                "home instof Arm(c4)",
                "`main/home` differs in its host: `c1` in the record, `c4` in the spec",
            ),
            ("eye --fast", "eye", "`main/cell/eye` differs in its exec: `eye --fast` in the record, `eye` in the spec"),
            (
                "speed = 3 m/s",
                "speed = 4 m/s",
                "`main/cell/arm` differs in its arguments: `speed = 3` in the record, `speed = 4` in the spec",
            ),
            (
                "restart transient;",
                "",
                "`main/cell/arm` differs in its restart: `transient` in the record, `temporary` in the spec",
            ),
            ("memory 64 MB", "memory 32 MB", "`main/cell/arm` differs in its limits"),
            (
                "on_link_loss hold",
                "on_link_loss keep",
                "`main/cell/arm` differs in its on_link_loss: `hold` in the record, `keep` in the spec",
            ),
            ("stop within 2 s", "stop within 3 s", "differs in its limit to stop: 2 s in the record, 3 s in the spec"),
            (
                "eye, Out -> arm, In;",
                "eye, Out -> arm, In latch;",
                "the connection `main/cell/eye, Out -> main/cell/arm, In` differs in its quality",
            ),
            (
                "internal_connections(eye, lbl)",
                "internal_connections(eye, other)",
                "`main/cell` differs in its event actions",
            ),
            ("within 5 s", "within 6 s", "`main/cell` differs in its event actions"),
            ("cell ; home", "cell , home", "`main` differs in its event actions"),
            (
                "restarts 3 within",
                "restarts 4 within",
                "`main` differs in its supervision: one for one, 3 restarts within 10 s in the record",
            ),
            ("home", "tidy", "`main/home` is in the record and not in the spec"),
            (
                "plain; out",
                "out",
                "`main/cell/eye` differs in its kind: a plain program in the record, a controller in the spec",
            ),
            (
                "done; stop",
                "done(held | lost); stop",
                "differs in its outcomes: `done` in the record, `done(held | lost)` in the spec",
            ),
        ];
        let (recorded, mut wrong) = (plan(SPEC), Vec::new());
        for (from, to, expected) in cases {
            let text = SPEC
                .replace(from, to)
                .replace("eye[lbl]", if to.contains("other") { "eye[other]" } else { "eye[lbl]" });
            assert_ne!(text, SPEC, "{from}");
            let told = difference(&recorded, &plan(&text));
            if !told.as_ref().is_some_and(|told| told.contains(expected)) {
                wrong.push(format!("{from} -> {to}: {told:?}"));
            }
        }
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    }

    #[test]
    fn a_back_off_is_said_with_both_pauses() {
        let other = plan(&SPEC.replace("restart transient;", "restart transient; backoff 1 s to 30 s;"));
        let told = difference(&plan(SPEC), &other);
        let expected = "`main/cell/arm` differs in its backoff: none in the record, 1 s to 30 s in the spec";
        assert_eq!(told.as_deref(), Some(expected));
    }

    #[test]
    fn the_name_of_the_deployment_and_the_order_of_the_text_are_none() {
        let mut other = plan(
            &SPEC.replace("cell instof Cell(c2); home instof Arm(c1);", "home instof Arm(c1); cell instof Cell(c2);"),
        );
        other.name = "another".to_owned();
        assert_eq!(difference(&plan(SPEC), &other), None);
        assert_eq!(difference(&plan(SPEC), &plan(SPEC)), None);
        // A deadline is quoted in the plan, with its line.
        let moved =
            SPEC.replace("process Cell", "// what the robot does\n\n        process Cell").replace("5 s", "5000 ms");
        assert_eq!(difference(&plan(SPEC), &plan(&moved)), None);
    }
}
