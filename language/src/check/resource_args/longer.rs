//! Reports members that hold a resource for longer than they use it. The group holds the resource for the whole run of the member, so other
//! members wait for longer than necessary. A supervisor cannot ask another supervisor in the middle of its expression.

use super::Held;
use crate::check::spec::{Expr, ExprKind, Path, Spec, Target, are_parallel};
use crate::diagnostic::{Code, Diagnostic};
use crate::source::Span;
use std::collections::BTreeSet;

/// The largest number of runs of one group that are compared with each other.
const RUNS_MAX: usize = 1000;

/// A run of a member that gets a resource.
struct Run {
    slot: usize,
    span: Span,
    path: Path,
}

/// Reports each group type that keeps a resource for longer than it uses it while others wait. `holds` has the resources of each instance
/// of each group.
pub(super) fn check(spec: &Spec, holds: &[Vec<Vec<Held>>]) -> Vec<Diagnostic> {
    let (mut said, mut found) = (BTreeSet::new(), Vec::new());
    for (process, holds_here) in std::iter::zip(&spec.processes, holds) {
        let Some(actions) = process.actions.as_ref().filter(|_| !process.damage.actions) else { continue };
        let mut runs = Vec::new();
        collect(actions, holds_here, &mut Vec::new(), &mut runs);
        // Each run is compared with every other run.
        runs.truncate(RUNS_MAX);
        for run in &runs {
            let Target::Process(target) = process.instances[run.slot].target else { continue };
            for held in &holds_here[run.slot] {
                let waits = |other: &&Run| {
                    are_parallel(&run.path, &other.path) == Some(true)
                        && holds_here[other.slot].iter().any(|theirs| theirs.resource == held.resource)
                };
                let Some(other) = runs.iter().find(waits) else { continue };
                if uses(spec, holds, target, &held.inside) || !said.insert((target, held.inside.clone())) {
                    continue;
                }
                let (name, inside) = (&process.resources[held.resource].text, &held.inside);
                let (member, kind) = (&process.instances[run.slot].name.text, &spec.processes[target].name.text);
                let message =
                    format!("`{member}` holds `{name}` as long as it runs, even while it does not use the resource");
                let diagnostic = Diagnostic::new(Code::W0414, run.span, message);
                found.push(diagnostic.reason(other.span, "waits for the end of the whole group").help(format!(
                    "give `{name}` to a group that has only its users, or write `using({inside})` around the whole body of `{kind}`"
                )));
            }
        }
    }
    found
}

fn collect(expr: &Expr, holds: &[Vec<Held>], path: &mut Path, runs: &mut Vec<Run>) {
    if let ExprKind::Run(slot, _) = expr.kind
        && holds.get(slot).is_some_and(|held| !held.is_empty())
    {
        runs.push(Run { slot, span: expr.span, path: path.clone() });
    }
    for (index, part) in expr.parts().into_iter().enumerate() {
        let length = path.len();
        path.extend(expr.way_to(index));
        collect(part, holds, path, runs);
        path.truncate(length);
    }
}

/// Returns whether a group uses the resource of this name as long as it runs. The answer is also yes if the group could not be read
/// completely.
fn uses(spec: &Spec, holds: &[Vec<Vec<Held>>], process: usize, name: &str) -> bool {
    let group = &spec.processes[process];
    let Some(resource) = group.resources.iter().position(|known| known.text == name) else { return true };
    let is_damaged = group.damage.actions || group.damage.names;
    group.actions.as_ref().is_none_or(|actions| is_damaged || throughout(actions, &holds[process], resource))
}

fn throughout(expr: &Expr, holds: &[Vec<Held>], resource: usize) -> bool {
    match &expr.kind {
        ExprKind::Using(taken, part) => taken.contains(&resource) || throughout(part, holds, resource),
        // The member that gets the resource uses it. If the member holds the resource for too long, this is reported there.
        ExprKind::Run(slot, _) => {
            holds.get(*slot).is_some_and(|held| held.iter().any(|held| held.resource == resource))
        }
        // These end at once.
        ExprKind::Skip | ExprKind::Fail(_) | ExprKind::Broken => true,
        ExprKind::Never | ExprKind::Wait(_) => false,
        ExprKind::Concurrent(_)
        | ExprKind::FailFast(_)
        | ExprKind::AnyOf(..)
        | ExprKind::AtLeast(..)
        | ExprKind::Disable(_)
        | ExprKind::Sequence(_)
        | ExprKind::Conditional(_)
        | ExprKind::Otherwise(_)
        | ExprKind::Recurrent(..)
        | ExprKind::Finally(..)
        | ExprKind::Asynchronous(..)
        | ExprKind::Retry(..)
        | ExprKind::Repeat(..)
        | ExprKind::Catch(..)
        | ExprKind::Within(..)
        | ExprKind::Shield(..)
        | ExprKind::Tagged(..)
        | ExprKind::With(..)
        | ExprKind::Named(..)
        | ExprKind::Chart(_)
        | ExprKind::Match(_) => expr.parts().into_iter().all(|part| throughout(part, holds, resource)),
    }
}
