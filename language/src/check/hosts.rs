//! Reports instances without a host, if their modules declare that they need one.

use super::diagnostics::Diagnostics;
use super::spec::{Instance, Spec, Target};
use super::types::without_host;
use crate::diagnostic::{Code, Diagnostic};

/// Checks the instances. If the whole spec names no host, everything runs on one host, and nothing is reported.
pub(super) fn check(spec: &Spec, diagnostics: &mut Diagnostics) {
    let instances = || spec.processes.iter().flat_map(|process| &process.instances);
    if !spec.processes.iter().any(|process| process.host.is_some()) && !instances().any(is_placed) {
        return;
    }
    for process in spec.processes.iter().filter(|process| !process.damage.instances) {
        let hostless = process.instances.iter().filter(|instance| !is_placed(instance));
        for instance in hostless.filter(|instance| instance.policies.runs_in.is_none()) {
            let Target::Module(module) = instance.target else { continue };
            let Some(host) = spec.modules[module].host else { continue };
            let (name, kind) = (&instance.name.text, &spec.modules[module].name.text);
            let message = format!("`{name}` names no host, so it runs on the host of `{}`", process.name.text);
            let found = Diagnostic::new(Code::W0105, instance.name.span, message)
                .reason(host, format!("`{kind}` needs a host"));
            diagnostics
                .push(found.help(format!("write `{name} instof {kind}(c1)`, with any other arguments after the host")));
        }
    }
}

/// Returns whether an instance of a module names its host.
fn is_placed(instance: &Instance) -> bool {
    let is_host = |name: &str| name == "host";
    let is_named = instance.args.iter().filter_map(|arg| arg.name.as_ref()).any(|name| is_host(&name.text));
    matches!(instance.target, Target::Module(_))
        && (is_named || without_host(&instance.args).len() < instance.args.len())
}
