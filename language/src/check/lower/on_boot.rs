//! Checks the statement `on_boot`. It is allowed only in the process where a deployment begins.

use crate::check::spec::Spec;
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{Claim, OnBoot};

/// Reports `on_boot` in another process, and a device that moves by itself when the power returns.
pub(super) fn check(spec: &Spec, root: usize, claims: &[Claim]) -> Vec<Diagnostic> {
    let others = spec.processes.iter().enumerate().filter(|(at, _)| *at != root);
    let found = others.filter_map(|(_, process)| {
        let (_, span) = process.on_boot?;
        let message = format!("`on_boot` cannot be in `{}`, because no deployment begins there", process.name.text);
        let help = format!("write `on_boot` in `{}`: a deployment restarts as a whole", spec.processes[root].name.text);
        Some(Diagnostic::new(Code::E0114, span, message).help(help))
    });
    let mut found: Vec<Diagnostic> = found.collect();
    let resumed = spec.processes[root].on_boot.filter(|(on_boot, _)| *on_boot == OnBoot::Resume);
    if let (Some((_, span)), Some(claim)) = (resumed, claims.iter().find(|claim| claim.is_write)) {
        let message = format!("after a power failure, `{}` moves without a command of a user", claim.device);
        let diagnostic = Diagnostic::new(Code::W0124, span, message);
        found.push(diagnostic.help("with `on_boot{none}`, the deployment waits until a user deploys it again"));
    }
    found
}
