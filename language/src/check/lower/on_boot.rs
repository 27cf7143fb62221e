//! Checks the statement `on_boot`. It is allowed only in the process where a deployment begins.

use crate::check::spec::Spec;
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{Claim, OnBoot};

/// Reports `on_boot` in another process, and a device that moves by itself when the power returns.
pub(super) fn check(spec: &Spec, root: usize, claims: &[Claim]) -> Vec<Diagnostic> {
    let others = spec.processes.iter().enumerate().filter(|(at, _)| *at != root);
    let found = others.filter_map(|(_, process)| {
        let (_, span) = process.on_boot?;
        let message = format!("`{}` is not where a deployment begins", process.name.text);
        let help = format!("write it in `{}`: a deployment begins again as a whole", spec.processes[root].name.text);
        Some(Diagnostic::new(Code::E0114, span, message).help(help))
    });
    let mut found: Vec<Diagnostic> = found.collect();
    let resumed = spec.processes[root].on_boot.filter(|(on_boot, _)| *on_boot == OnBoot::Resume);
    if let (Some((_, span)), Some(claim)) = (resumed, claims.iter().find(|claim| claim.is_write)) {
        let message = format!("after a power failure `{}` is moved without anybody being asked", claim.device);
        let diagnostic = Diagnostic::new(Code::W0124, span, message);
        found.push(diagnostic.help("`on_boot{none}` waits until it is deployed again"));
    }
    found
}
