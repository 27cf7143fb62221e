//! Reports loops that could repeat without end and without any time passing.

use crate::check::diagnostics::Diagnostics;
use crate::check::spec::{Expr, ExprKind, Process, Spec, Target};
use crate::diagnostic::{Code, Diagnostic};

/// The possible ends of an expression that runs no program and waits for nothing.
#[derive(Clone, Copy, Default)]
struct InstantEnds {
    done: bool,
    aborted: bool,
}

/// Reports the loops of every group.
pub(super) fn check(spec: &Spec, diagnostics: &mut Diagnostics) {
    let mut known = vec![None; spec.processes.len()];
    for (index, process) in spec.processes.iter().enumerate() {
        of_group(spec, index, &mut known);
        if let Some(actions) = process.actions.as_ref().filter(|_| !process.damage.actions) {
            walk(actions, &members(spec, process, &mut known), diagnostics);
        }
    }
}

/// Returns how a group can end at once. `known` has the results for groups that were already visited. At this point, no
/// group contains itself.
fn of_group(spec: &Spec, group: usize, known: &mut Vec<Option<InstantEnds>>) -> InstantEnds {
    if let Some(found) = known[group] {
        return found;
    }
    let process = &spec.processes[group];
    let members = members(spec, process, known);
    let found = match &process.actions {
        _ if process.damage.actions => InstantEnds::default(),
        Some(actions) => at_once(actions, &members),
        None => InstantEnds { done: true, aborted: false },
    };
    known[group] = Some(found);
    found
}

/// Returns how each instance of a group can end at once. A program cannot.
fn members(spec: &Spec, process: &Process, known: &mut Vec<Option<InstantEnds>>) -> Vec<InstantEnds> {
    let of_instance = |target| match target {
        Target::Process(group) => of_group(spec, group, known),
        Target::Module(_) | Target::Unknown => InstantEnds::default(),
    };
    process.instances.iter().map(|instance| instance.target).map(of_instance).collect()
}

fn walk(expr: &Expr, members: &[InstantEnds], diagnostics: &mut Diagnostics) {
    let is_done = |part: &Expr| at_once(part, members).done;
    let is_endless = if let ExprKind::Recurrent(first, second) = &expr.kind {
        is_done(first) && is_done(second)
    } else if let ExprKind::Asynchronous(source, pool) = &expr.kind {
        is_done(source) && pool.iter().any(is_done)
    } else if let ExprKind::Repeat(_, part) = &expr.kind {
        is_done(part)
    } else {
        false
    };
    if is_endless {
        let diagnostic =
            Diagnostic::new(Code::E0410, expr.span, "the repeated expression ends at the instant it starts");
        diagnostics.push(diagnostic.help("put a process or a `wait` on each way through it"));
    }
    for part in expr.parts() {
        walk(part, members, diagnostics);
    }
}

fn at_once(expr: &Expr, members: &[InstantEnds]) -> InstantEnds {
    let parts: Vec<InstantEnds> = expr.parts().into_iter().map(|part| at_once(part, members)).collect();
    let done = |parts: &[InstantEnds]| parts.iter().filter(|part| part.done).count();
    let any_aborted = parts.iter().any(|part| part.aborted);
    match &expr.kind {
        ExprKind::Run(slot, _) => members[*slot],
        ExprKind::Wait(time) => InstantEnds { done: time.is_zero(), aborted: false },
        ExprKind::Never | ExprKind::Chart(_) | ExprKind::Broken => InstantEnds::default(),
        ExprKind::Skip => InstantEnds { done: true, aborted: false },
        ExprKind::Fail(_) => InstantEnds { done: false, aborted: true },
        ExprKind::Concurrent(_) | ExprKind::FailFast(_) => {
            InstantEnds { done: done(&parts) == parts.len(), aborted: any_aborted }
        }
        ExprKind::AnyOf(count, _) => InstantEnds { done: done(&parts) >= *count as usize, aborted: any_aborted },
        ExprKind::AtLeast(count, _) => {
            let are_over = parts.iter().all(|part| part.done || part.aborted);
            let failed = parts.iter().filter(|part| part.aborted).count();
            let is_done = are_over && done(&parts) >= *count as usize;
            InstantEnds { done: is_done, aborted: are_over && failed + *count as usize > parts.len() }
        }
        ExprKind::Disable(_) | ExprKind::Within(..) => InstantEnds { done: done(&parts) > 0, aborted: any_aborted },
        ExprKind::Finally(..) => InstantEnds { done: done(&parts) == parts.len(), aborted: any_aborted },
        ExprKind::Sequence(_) | ExprKind::Conditional(_) => {
            let reached = parts.iter().take_while(|part| part.done).count();
            let aborted = parts.iter().take(reached + 1).any(|part| part.aborted);
            InstantEnds { done: reached == parts.len(), aborted }
        }
        ExprKind::Otherwise(_) | ExprKind::Retry(..) => {
            let failed = parts.iter().take_while(|part| part.aborted && !part.done).count();
            InstantEnds { done: parts.iter().take(failed + 1).any(|part| part.done), aborted: failed == parts.len() }
        }
        ExprKind::Catch(_, arms) => {
            let (first, caught) = (parts[0], &parts[1..]);
            let is_total = arms.iter().any(|arm| arm.failure.is_none());
            let aborted = first.aborted && (!is_total || caught.iter().any(|part| part.aborted));
            InstantEnds { done: first.done || first.aborted && caught.iter().any(|part| part.done), aborted }
        }
        ExprKind::Recurrent(..) | ExprKind::Asynchronous(..) => InstantEnds { done: false, aborted: any_aborted },
        ExprKind::Match(_)
        | ExprKind::Repeat(..)
        | ExprKind::Shield(..)
        | ExprKind::Using(..)
        | ExprKind::Tagged(..)
        | ExprKind::With(..)
        | ExprKind::Named(..) => InstantEnds { done: done(&parts) > 0, aborted: any_aborted },
    }
}
