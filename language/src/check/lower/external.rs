//! Checks instances whose program another deployment runs. Some features are not allowed for such processes.

use super::tree::Tree;
use crate::check::diagnostics::Diagnostics;
use crate::check::spec::{Instance, RunsIn, Spec, Target};
use crate::check::types::without_host;
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{Leaf, Transfer, Wire};
use std::collections::BTreeSet;

/// Reports each instance with `runs_in` that cannot refer to a process of another deployment. `name` is the name of
/// this deployment.
pub(super) fn check(spec: &Spec, tree: &Tree, name: &str, wires: &[Wire], diagnostics: &mut Diagnostics) {
    let mut told = BTreeSet::new();
    for (number, leaf) in (0_u32..).zip(&tree.leaves) {
        let (group, slot) = tree.place_of[number as usize];
        let instance = &spec.processes[tree.process_of[group]].instances[slot];
        let Some(runs_in) = &instance.policies.runs_in else { continue };
        let found = own(spec, instance, runs_in, name).or_else(|| connected(wires, number, leaf));
        let Some((why, help)) = found else { continue };
        // Several leaves may have the same text.
        if told.insert(runs_in.span) {
            let message = format!("`{}` cannot run in `{}`: {why}", instance.name.text, runs_in.deployment);
            diagnostics.push(Diagnostic::new(Code::E0116, runs_in.span, message).help(help));
        }
    }
}

/// Returns the mistake in the instance itself, with advice.
fn own(spec: &Spec, instance: &Instance, runs_in: &RunsIn, name: &str) -> Option<(String, &'static str)> {
    if runs_in.deployment == name {
        return Some((
            "this is the name of the own deployment".to_owned(),
            "remove `runs_in`: this deployment starts the program",
        ));
    }
    if !runs_in.is_alone {
        let help = "write the other policies in the spec of that deployment";
        return Some(("only that deployment can set its other policies".to_owned(), help));
    }
    let is_host = |name: &str| name == "host";
    let rest = without_host(&instance.args);
    if rest.iter().any(|arg| arg.name.as_ref().is_none_or(|name| !is_host(&name.text))) {
        return Some(("only that deployment can set its arguments".to_owned(), "write only its host as an argument"));
    }
    let Target::Module(module) = instance.target else {
        let help = "declare its `module`, or deploy with the program that has it";
        return Some(("no interface of its type is known".to_owned(), help));
    };
    let module = &spec.modules[module];
    (!module.is_service).then(|| {
        let why = format!("`{}` is not a service, so the process ends there by itself", module.name.text);
        (why, "only a service can be used by several missions")
    })
}

/// Returns the mistake in the connections of the instance, with advice.
fn connected(wires: &[Wire], number: u32, leaf: &Leaf) -> Option<(String, &'static str)> {
    if let Some(keys) = leaf.keys.first() {
        let why = format!("its `{}` is connected with keys of the database", keys.port);
        return Some((why, "connect these keys in the spec of that deployment"));
    }
    let help = "only its procedures and states can be connected: `task, Drive -> base, Drive;`";
    wires.iter().find_map(|wire| {
        if wire.from.leaf == number {
            return Some((
                format!(
                    "its `{}` is connected as a source, but it sends and calls only for its own deployment",
                    wire.from.port
                ),
                help,
            ));
        }
        let is_data = wire.to.leaf == number && wire.transfer != Transfer::Call;
        is_data.then(|| {
            (
                format!("its `{}` is connected as a target, but it takes no data from other deployments", wire.to.port),
                help,
            )
        })
    })
}
