//! Finds the possible ends of an expression when any process may fail at any time. The check of services cannot find
//! them, because it considers only runs without faults.

use super::service;
use crate::check::spec::{Expr, ExprKind, Process, Spec, Target};
use std::time::Duration;

/// The possible ends of an expression or an instance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Ends {
    /// The earliest time after the start at which it can be done. There is none if it is never done.
    pub(super) done: Option<Duration>,
    /// Whether it can abort.
    pub(super) aborted: bool,
}

impl Ends {
    /// The ends of a process that ends. It may also abort, because any program can fail, and the host of a group can
    /// fail as well.
    const TASK: Self = Self { done: Some(Duration::ZERO), aborted: true };
    /// The ends of a module that never ends. Its normal end also counts as a failure.
    const SERVICE: Self = Self { done: None, aborted: true };
    /// The ends of `skip`.
    const SKIP: Self = Self { done: Some(Duration::ZERO), aborted: false };
}

/// The instances of one group.
pub(super) struct Members {
    /// The possible ends of each instance.
    pub(super) ends: Vec<Ends>,
    /// Whether each instance is a service, which never ends without a fault.
    pub(super) services: Vec<bool>,
}

/// Returns the instances of every group of the spec. At this point, no group contains itself, and services are
/// inferred.
pub(super) fn members(spec: &Spec) -> Vec<Members> {
    let mut known = vec![None; spec.processes.len()];
    spec.processes.iter().map(|process| members_of(spec, process, &mut known)).collect()
}

fn members_of(spec: &Spec, process: &Process, known: &mut Vec<Option<Ends>>) -> Members {
    let ends = process.instances.iter().map(|instance| match instance.target {
        Target::Process(group) => of_group(spec, group, known),
        Target::Module(module) if spec.modules[module].is_service => Ends::SERVICE,
        Target::Module(_) | Target::Unknown => Ends::TASK,
    });
    Members { ends: ends.collect(), services: service::members(spec, process) }
}

fn of_group(spec: &Spec, group: usize, known: &mut Vec<Option<Ends>>) -> Ends {
    if let Some(found) = known[group] {
        return found;
    }
    let process = &spec.processes[group];
    let members = members_of(spec, process, known);
    let found = match &process.actions {
        Some(_) | None if process.damage.actions => Ends::TASK,
        Some(actions) => Ends { aborted: true, ..members.ends_of(actions) },
        None => Ends::TASK,
    };
    known[group] = Some(found);
    found
}

impl Members {
    /// Returns the same instances, but with one difference: a group that is a service is never done, even if it
    /// tolerates failures.
    pub(super) fn without_tolerance(&self) -> Self {
        let ends = self.ends.iter().zip(&self.services);
        let ends = ends.map(|(ends, is_service)| if *is_service { Ends::SERVICE } else { *ends });
        Self { ends: ends.collect(), services: self.services.clone() }
    }

    /// Returns the possible ends of an expression.
    pub(super) fn ends_of(&self, expr: &Expr) -> Ends {
        let parts: Vec<Ends> = expr.parts().into_iter().map(|part| self.ends_of(part)).collect();
        let any_aborted = parts.iter().any(|part| part.aborted);
        match &expr.kind {
            ExprKind::Run(slot, _) => self.ends[*slot],
            ExprKind::Broken => Ends::TASK,
            ExprKind::Skip => Ends::SKIP,
            ExprKind::Chart(_) if service::is_service(expr, &self.services) => Ends::SERVICE,
            ExprKind::Chart(_) => Ends::TASK,
            ExprKind::Never => Ends { done: None, aborted: false },
            ExprKind::Fail(_) => Ends { done: None, aborted: true },
            ExprKind::Wait(time) => Ends { done: Some(*time), aborted: false },
            ExprKind::Sequence(_) | ExprKind::Conditional(_) => in_turn(&parts),
            ExprKind::Finally(..) => Ends { aborted: any_aborted, ..in_turn(&parts) },
            ExprKind::Recurrent(..) => Ends { done: None, ..in_turn(&parts) },
            ExprKind::Asynchronous(..) => Ends { done: None, aborted: any_aborted },
            ExprKind::Otherwise(_) => {
                let tried = parts.iter().take_while(|part| part.aborted).count();
                let done = parts.iter().take(tried + 1).filter_map(|part| part.done).min();
                Ends { done, aborted: tried == parts.len() }
            }
            ExprKind::Catch(first, arms) => {
                let (first, parts) = (self.ends_of(first), &parts[1..]);
                let caught = parts.iter().filter(|_| first.aborted);
                let done = first.done.into_iter().chain(caught.filter_map(|part| part.done)).min();
                // Without an `else` arm, it is possible that no arm takes the failure.
                let is_total = arms.iter().any(|arm| arm.failure.is_none());
                Ends { done, aborted: first.aborted && (!is_total || parts.iter().any(|part| part.aborted)) }
            }
            ExprKind::Concurrent(of) => {
                let is_service = service::is_service(expr, &self.services);
                let is_task = |part: &Expr| is_service || !service::is_service(part, &self.services);
                let tasks = of.iter().zip(&parts).filter(|(part, _)| is_task(part)).map(|(_, ends)| ends.done);
                Ends { done: all(tasks), aborted: any_aborted }
            }
            ExprKind::FailFast(_) => Ends { done: all(parts.iter().map(|part| part.done)), aborted: any_aborted },
            ExprKind::AnyOf(count, _) => {
                let mut done: Vec<Duration> = parts.iter().filter_map(|part| part.done).collect();
                done.sort_unstable();
                Ends { done: done.get((*count as usize).saturating_sub(1)).copied(), aborted: any_aborted }
            }
            ExprKind::AtLeast(count, _) => {
                let mut done: Vec<Duration> = parts.iter().filter_map(|part| part.done).collect();
                done.sort_unstable();
                let enough = done.get((*count as usize).saturating_sub(1)).copied();
                // A part that cannot fail must be done.
                let others = all(parts.iter().filter(|part| !part.aborted).map(|part| part.done));
                let failed = parts.iter().filter(|part| part.aborted).count();
                let done = enough.zip(others).map(|(enough, others)| enough.max(others));
                Ends { done, aborted: failed + *count as usize > parts.len() }
            }
            ExprKind::Disable(_) => {
                Ends { done: parts.iter().filter_map(|part| part.done).min(), aborted: any_aborted }
            }
            // An outcome may have a tag that no arm has.
            ExprKind::Match(_) => Ends { done: parts.iter().filter_map(|part| part.done).min(), aborted: true },
            ExprKind::Within(limit, _) => {
                Ends { done: parts[0].done.filter(|earliest| earliest <= limit), aborted: true }
            }
            ExprKind::Retry(..)
            | ExprKind::Repeat(..)
            | ExprKind::Shield(..)
            | ExprKind::Using(..)
            | ExprKind::Tagged(..)
            | ExprKind::With(..)
            | ExprKind::Named(..) => parts[0],
        }
    }
}

/// Returns the ends of a sequence. Each part starts after the previous part is done.
fn in_turn(parts: &[Ends]) -> Ends {
    let done = parts.iter().map(|part| part.done).try_fold(Duration::ZERO, |sum, done| Some(sum.saturating_add(done?)));
    let reached = parts.iter().take_while(|part| part.done.is_some()).count();
    Ends { done, aborted: parts.iter().take(reached + 1).any(|part| part.aborted) }
}

/// Returns the earliest time at which all parts can be done.
fn all(done: impl Iterator<Item = Option<Duration>>) -> Option<Duration> {
    done.collect::<Option<Vec<_>>>().map(|done| done.into_iter().max().unwrap_or_default())
}
