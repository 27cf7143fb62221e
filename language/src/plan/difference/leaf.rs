//! The differences of one program.

use super::{Argument, Constant, Leaf, PlanChange, Policy, Replacement};
use std::collections::{BTreeMap, BTreeSet};

/// Returns the change from one program to another, if they differ.
pub(super) fn change_of_leaf(leaf: u32, before: &Leaf, after: &Leaf, claims_differ: bool) -> Option<PlanChange> {
    // Every field by its name, so that an added field is not forgotten here.
    let Leaf { path, module, host: _, arguments: given, exec, environment, kind, .. } = before;
    let Leaf { stop_within, outcomes, policy, keys, external: _, .. } = before;
    let Policy { restart, agent_loss, link_loss, usage, watchdog, ready_within, backoff, replacement } = policy;
    let mut why = Vec::new();
    let mut differs = |is_different: bool, words: &str| why.extend(is_different.then(|| words.to_owned()));
    differs(*module != after.module, &format!("its type is `{}`, was `{module}`", after.module));
    differs(*exec != after.exec, "its executable");
    differs(*environment != after.environment, "its environment");
    differs(claims_differ, "its claims");
    differs(*kind != after.kind, "whether it speaks the control protocol");
    differs(*outcomes != after.outcomes, "its outcomes");
    differs(*keys != after.keys, "the keys of the database that it is connected with");
    differs(*agent_loss != after.policy.agent_loss, "`on_agent_loss`");
    differs(*usage != after.policy.usage, "its limits");
    differs(*watchdog != after.policy.watchdog, "`watchdog`");
    differs(*ready_within != after.policy.ready_within, "`ready within`");
    why.extend(arguments(given, &after.arguments));
    let is_replaced = !why.is_empty();
    let mut differs = |is_different: bool, words: &str| why.extend(is_different.then(|| words.to_owned()));
    differs(*restart != after.policy.restart, "`restart`");
    differs(*backoff != after.policy.backoff, "`backoff`");
    differs(*replacement != after.policy.replacement, "`replace`");
    differs(*link_loss != after.policy.link_loss, "`on_link_loss`");
    differs(*stop_within != after.stop_within, "`stop within`");
    let path = path.clone();
    match (is_replaced, why.is_empty()) {
        (_, true) => None,
        (true, false) => Some(PlanChange::Replace { leaf, path, why, replacement: Replacement::BreakBeforeMake }),
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
        Constant::Secret(key) => format!("secret({key:?})"),
    }
}
