//! Compares the processes that a spec uses of another deployment with the spec of that deployment.

use language::Source;
use language::plan::{Leaf, Plan, Transfer};
use std::collections::BTreeMap;

/// Returns a sentence for each process of `other` that `plan` uses, if it does not exist or is not as `plan` declares
/// it. Each plan comes with the texts that contain its interfaces.
pub(crate) fn against(plan: &Plan, own: &[Source], other: &Plan, theirs: &[Source]) -> Vec<String> {
    let (own, theirs) = (language::exports(own), language::exports(theirs));
    let live = other.live_leaves();
    let mut problems = Vec::new();
    for (number, leaf) in (0_u32..).zip(&plan.leaves) {
        let Some(external) = leaf.external.as_ref().filter(|external| external.deployment == other.name) else {
            continue;
        };
        let mut add = |why: String| problems.push(format!("`{}` runs in another deployment: {why}", leaf.path));
        let is_meant = |it: &&Leaf| it.path == external.path;
        let Some(found) = live.iter().filter_map(|number| other.leaves.get(*number as usize)).find(is_meant) else {
            add(format!("`{}` runs no `{}`", other.name, external.path));
            continue;
        };
        let (here, there) = (host(plan, leaf), host(other, found));
        if here != there {
            add(format!("{external} is on `{there}`, not on `{here}`"));
        }
        if found.external.is_some() {
            add(format!("{external} itself stands for a process of another deployment"));
        }
        if found.module != leaf.module {
            add(format!("{external} is a `{}`, not a `{}`", found.module, leaf.module));
            continue;
        }
        let called = plan.wires.iter().filter(|wire| wire.to.leaf == number && wire.transfer == Transfer::Call);
        let signature = |all: &BTreeMap<String, BTreeMap<String, String>>, name: &str| {
            all.get(&leaf.module).and_then(|exports| exports.get(name)).cloned()
        };
        for wire in called {
            let name = &wire.to.port;
            match (signature(&own, name), signature(&theirs, name)) {
                (Some(own), Some(theirs)) if own != theirs => add(format!("{external} has `{theirs}`, not `{own}`")),
                (Some(own), None) => add(format!("{external} has no `{own}`")),
                (Some(_) | None, _) => {}
            }
        }
    }
    problems.sort();
    problems.dedup();
    problems
}

fn host<'a>(plan: &'a Plan, leaf: &Leaf) -> &'a str {
    plan.hosts.get(leaf.host as usize).map_or("?", String::as_str)
}

#[cfg(test)]
mod tests {
    use super::*;
    use language::{Options, compile};

    #[test]
    fn a_mission_is_compared_with_its_hardware() {
        let hardware = |drive: &str, name: &str, kind: &str, host: &str| {
            format!(
                "module Base(host) {{ {drive} service; }} module Eye(host) {{ state seen: Number; service; }}
                 process main() {{ host{{c1}} instantiated_processes {{ {name} instof {kind}({host}); }}
                 internal_event_actions {{ {name} }} }}"
            )
        };
        let drive = "proc Drive(Number) -> Truth;";
        let mission = "module Base(host) { proc Drive(Number) -> Truth; service; }
            module Task(host) { calls Drive(Number) -> Truth; done; }
            process main() { host{c1}
                instantiated_processes { base instof Base(c1){ runs_in hardware; } task instof Task(c1); }
                internal_connections { task, Drive -> base, Drive; } internal_event_actions { base, task } }";
        let plan = |name: &str, text: &str| {
            let source = Source::new(name, text);
            let compiled = compile(&source, &[], &Options::named(name));
            (compiled.plan.unwrap_or_else(|| panic!("{:#?}", compiled.diagnostics)), vec![source])
        };
        let (mission, own) = plan("mission", mission);
        let check = |hardware: String, expected: &[&str]| {
            let (other, theirs) = plan("hardware", &hardware);
            let expected: Vec<String> =
                expected.iter().map(|why| format!("`main/base` runs in another deployment: {why}")).collect();
            assert_eq!(against(&mission, &own, &other, &theirs), expected);
        };
        check(hardware(drive, "base", "Base", "c1"), &[]);
        check(hardware(drive, "legs", "Base", "c1"), &["`hardware` runs no `main/base`"]);
        check(hardware(drive, "base", "Base", "c2"), &["`main/base` of `hardware` is on `c2`, not on `c1`"]);
        check(hardware(drive, "base", "Eye", "c1"), &["`main/base` of `hardware` is a `Eye`, not a `Base`"]);
        let other = "`main/base` of `hardware` has `proc Drive(Truth) -> Truth`, not `proc Drive(Number) -> Truth`";
        check(hardware("proc Drive(Truth) -> Truth;", "base", "Base", "c1"), &[other]);
        check(hardware("", "base", "Base", "c1"), &["`main/base` of `hardware` has no `proc Drive(Number) -> Truth`"]);
    }
}
