//! Checks `using`: processes that wait for themselves, and processes that may wait for each other.
//!
//! Nested `using`s can form a circle, in which each waits for a resource that the next one holds. They wait for ever only if all of them
//! can run at the same time. So each pair must run in parallel and have no held resource in common.

use super::service::is_service;
use crate::check::diagnostics::Diagnostics;
use crate::check::names::listed;
use crate::check::spec::{Expr, ExprKind, Path, Process, are_parallel};
use crate::diagnostic::{Code, Diagnostic};
use crate::source::Span;
use std::collections::BTreeMap;
use std::rc::Rc;

/// The longest search for circles, in steps. An expanded expression may have very many.
const STEPS_MAX: usize = 200_000;
/// The largest number of pairs of a held resource and a wanted resource that are checked.
const NESTED_MAX: usize = 10_000;

/// The largest number of `using`s of one group that are compared with each other.
const TAKEN_MAX: usize = 1000;

/// A `using` inside another one.
struct Nested {
    /// A resource that an outer `using` holds.
    holds: usize,
    wants: usize,
    /// All resources that are held at this place.
    held: Rc<[usize]>,
    span: Span,
    path: Path,
}

impl Nested {
    /// Returns whether both parts can wait at the same time.
    fn is_beside(&self, other: &Self) -> bool {
        are_parallel(&self.path, &other.path) == Some(true) && self.held.iter().all(|held| !other.held.contains(held))
    }
}

/// Reports a `using` that can never start, and circles of `using`s that may wait for each other.
pub(super) fn check(process: &Process, actions: &Expr, diagnostics: &mut Diagnostics) {
    let mut walk = Walk { process, path: Vec::new(), held: Vec::new(), nested: Vec::new(), diagnostics };
    walk.collect(actions);
    let nested = walk.nested;
    let mut search = Search { nested: &nested, steps: 0 };
    let mut reported = vec![false; nested.len()];
    // Of two circles through one place, the shorter circle explains the problem better.
    for length in 2..=process.resources.len().min(nested.len()) {
        for first in 0..nested.len() {
            let mut circle = vec![first];
            if search.steps > STEPS_MAX {
                return;
            }
            if !reported[first] && search.close(&mut circle, length) {
                circle.iter().for_each(|&part| reported[part] = true);
                let circle: Vec<&Nested> = circle.iter().map(|&part| &nested[part]).collect();
                diagnostics.extend(report(process, &circle));
            }
        }
    }
}

/// The resources that an operand takes, and whether this operand ends by itself.
struct Acquisition<'a> {
    resources: &'a [usize],
    is_service: bool,
    span: Span,
    path: Path,
}

/// Reports processes that wait for a resource which a parallel service never releases.
pub(super) fn kept(process: &Process, members: &[bool], actions: &Expr, diagnostics: &mut Diagnostics) {
    let mut all = Vec::new();
    taken(actions, members, &mut Vec::new(), &mut all);
    // Each `using` is compared with every other `using`.
    all.truncate(TAKEN_MAX);
    for service in all.iter().filter(|taken| taken.is_service) {
        let shared =
            |other: &Acquisition<'_>| other.resources.iter().find(|it| service.resources.contains(it)).copied();
        let is_beside = |other: &&Acquisition<'_>| are_parallel(&service.path, &other.path) == Some(true);
        let waiting = all.iter().filter(is_beside).find_map(|other| Some((other, shared(other)?)));
        let Some((other, resource)) = waiting else { continue };
        let name = &process.resources[resource].text;
        let message = format!("this part never ends by itself, so it keeps `{name}` for ever");
        let diagnostic = Diagnostic::new(Code::W0413, service.span, message);
        diagnostics.push(diagnostic.reason(other.span, "waits for the same resource"));
    }
}

fn taken<'a>(expr: &'a Expr, members: &[bool], path: &mut Path, all: &mut Vec<Acquisition<'a>>) {
    if let ExprKind::Using(resources, inner) = &expr.kind {
        let is_service = is_service(inner, members);
        all.push(Acquisition { resources, is_service, span: expr.span, path: path.clone() });
    }
    for (index, part) in expr.parts().into_iter().enumerate() {
        let length = path.len();
        path.extend(expr.way_to(index));
        taken(part, members, path, all);
        path.truncate(length);
    }
}

struct Search<'a> {
    nested: &'a [Nested],
    steps: usize,
}

impl Search<'_> {
    /// Extends a circle to this length. A circle starts with the part that is first in the text.
    fn close(&mut self, circle: &mut Vec<usize>, length: usize) -> bool {
        let (Some(&first), Some(&last)) = (circle.first(), circle.last()) else { return false };
        let wants = self.nested[last].wants;
        if circle.len() == length {
            return wants == self.nested[first].holds;
        }
        for next in first + 1..self.nested.len() {
            self.steps += 1;
            if self.steps > STEPS_MAX {
                return false;
            }
            let part = &self.nested[next];
            if part.holds == wants && circle.iter().all(|&other| self.nested[other].is_beside(part)) {
                circle.push(next);
                if self.close(circle, length) {
                    return true;
                }
                circle.pop();
            }
        }
        false
    }
}

fn report(process: &Process, circle: &[&Nested]) -> Option<Diagnostic> {
    let name = |index: usize| process.resources[index].text.as_str();
    let label = |part: &Nested| format!("waits for `{}` and holds `{}`", name(part.wants), name(part.holds));
    let (last, others) = circle.split_last()?;
    let message = match others {
        [one] => {
            let (holds, wants) = (name(one.holds), name(one.wants));
            format!("`{holds}` and `{wants}` are taken in both orders: two parts may wait for each other for ever")
        }
        _ => {
            let names = listed(circle.iter().map(|part| name(part.holds)));
            format!("{names} are taken in a circle: each part may wait for the next part for ever")
        }
    };
    let mut diagnostic = Diagnostic::new(Code::W0413, last.span, message).label(label(last));
    for other in others {
        diagnostic = diagnostic.reason(other.span, label(other));
    }
    let all: Vec<&str> = circle.iter().map(|part| name(part.holds)).collect();
    let all_at_once = if others.len() == 1 { "both" } else { "all" };
    Some(diagnostic.help(format!("take {all_at_once} resources at once: `using({})`", all.join(", "))))
}

/// Finds nested `using`s.
struct Walk<'a> {
    process: &'a Process,
    path: Path,
    /// The resources that the enclosing `using`s take, with their places.
    held: Vec<(usize, Span)>,
    nested: Vec<Nested>,
    diagnostics: &'a mut Diagnostics,
}

impl Walk<'_> {
    fn collect(&mut self, expr: &Expr) {
        let before = self.held.len();
        if let ExprKind::Using(taken, inner) = &expr.kind {
            let is_handed = inner.span == expr.span;
            self.take(taken, expr.span, is_handed);
        }
        for (index, part) in expr.parts().into_iter().enumerate() {
            let length = self.path.len();
            self.path.extend(expr.way_to(index));
            self.collect(part);
            self.path.truncate(length);
        }
        self.held.truncate(before);
    }

    fn take(&mut self, taken: &[usize], span: Span, is_handed: bool) {
        let held: Rc<[usize]> = self.held.iter().map(|(held, _)| *held).collect();
        let places: BTreeMap<usize, Span> = self.held.iter().rev().copied().collect();
        for &wants in taken {
            if let Some(outer) = places.get(&wants) {
                let name = &self.process.resources[wants].text;
                let message = format!("`{name}` is never free here: the part around this one already holds it");
                let diagnostic = Diagnostic::new(Code::E0413, span, message);
                let help = match is_handed {
                    true => {
                        "take the resource only once: a group that gets a resource holds it as long as the group runs"
                    }
                    false => "take the resource only once",
                };
                self.diagnostics.push(diagnostic.reason(*outer, "taken here").help(help));
            }
            for &holds in held.iter().filter(|&&holds| holds != wants) {
                if self.nested.len() < NESTED_MAX {
                    let (held, path) = (Rc::clone(&held), self.path.clone());
                    self.nested.push(Nested { holds, wants, held, span, path });
                }
            }
        }
        self.held.extend(taken.iter().map(|&taken| (taken, span)));
    }
}
