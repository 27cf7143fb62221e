//! Reports operands that have no effect, and limits that are too short.

use super::ends::Members;
use crate::check::diagnostics::Diagnostics;
use crate::check::spec::{Expr, ExprKind};
use crate::diagnostic::{Code, Diagnostic};
use std::time::Duration;

/// Reports the parts of an expression that never start because of earlier parts, and limits that are too short.
pub(super) fn check(members: &Members, expr: &Expr, diagnostics: &mut Diagnostics) {
    if let ExprKind::Otherwise(parts) = &expr.kind {
        let cannot_fail = parts.iter().position(|part| !members.ends_of(part).aborted);
        let dead = cannot_fail.and_then(|index| Some((&parts[index], parts.get(index + 1)?)));
        diagnostics.extend(dead.map(|(part, next)| never_needed(part, next)));
    }
    if let ExprKind::Catch(first, arms) = &expr.kind
        && !members.ends_of(first).aborted
    {
        diagnostics.extend(arms.first().map(|arm| never_needed(first, &arm.body)));
    }
    if let ExprKind::Retry(1.., _, part) = &expr.kind
        && !members.ends_of(part).aborted
    {
        let message = "`retry` has no effect: the operand after it cannot fail";
        diagnostics.push(Diagnostic::new(Code::W0406, part.span, message).label("cannot fail"));
    }
    if let ExprKind::Disable(parts) = &expr.kind {
        let at_once = parts.iter().position(is_over_at_once);
        diagnostics.extend(at_once.and_then(|index| disabled_at_once(parts, index)));
    }
    if let ExprKind::Within(limit, part) = &expr.kind {
        diagnostics.extend(too_short(*limit, members.ends_of(part).done, expr, part));
    }
    expr.parts().into_iter().for_each(|part| check(members, part, diagnostics));
}

/// Makes the diagnostic for `part else next`, and for `part?`, in which `next` is the `?`.
fn never_needed(part: &Expr, next: &Expr) -> Diagnostic {
    let is_question = matches!(next.kind, ExprKind::Skip) && next.span.end == next.span.start + 1;
    let (message, label) = match is_question {
        true => ("`?` makes no difference: the operand before it cannot fail", "has no effect"),
        false => ("the operand after `else` never starts: the operand before it cannot fail", "never starts"),
    };
    let diagnostic = Diagnostic::new(Code::W0406, next.span, message).label(label);
    diagnostic.reason(part.span, "cannot fail")
}

/// Returns whether an expression always ends at the moment of its start.
fn is_over_at_once(expr: &Expr) -> bool {
    match &expr.kind {
        ExprKind::Skip | ExprKind::Fail(_) => true,
        ExprKind::Sequence(parts) | ExprKind::Conditional(parts) | ExprKind::Otherwise(parts) => {
            parts.iter().all(is_over_at_once)
        }
        ExprKind::Concurrent(parts) | ExprKind::FailFast(parts) => parts.iter().all(is_over_at_once),
        ExprKind::Disable(parts) => parts.iter().any(is_over_at_once),
        ExprKind::Run(..)
        | ExprKind::Never
        | ExprKind::Wait(_)
        | ExprKind::AnyOf(..)
        | ExprKind::AtLeast(..)
        | ExprKind::Recurrent(..)
        | ExprKind::Retry(..)
        | ExprKind::Repeat(..)
        | ExprKind::Catch(..)
        | ExprKind::Within(..)
        | ExprKind::Match(_)
        | ExprKind::Shield(..)
        | ExprKind::Using(..)
        | ExprKind::Asynchronous(..)
        | ExprKind::Finally(..)
        | ExprKind::Tagged(..)
        | ExprKind::With(..)
        | ExprKind::Named(..)
        | ExprKind::Chart(_)
        | ExprKind::Broken => false,
    }
}

/// Makes the diagnostic for `skip # P`, in which P never starts, and for `P # skip`, in which P is stopped right after
/// its start.
fn disabled_at_once(parts: &[Expr], index: usize) -> Option<Diagnostic> {
    let (other, message, label) = match parts.get(index + 1) {
        Some(next) => (next, "this operand never starts: the operand before it ends at once", "never starts"),
        None => {
            let before = parts.get(index.checked_sub(1)?)?;
            (before, "this is stopped right after its start", "stopped at once")
        }
    };
    let diagnostic = Diagnostic::new(Code::W0406, other.span, message).label(label);
    Some(diagnostic.reason(parts[index].span, "ends at once"))
}

fn too_short(limit: Duration, earliest: Option<Duration>, whole: &Expr, part: &Expr) -> Option<Diagnostic> {
    let (whole, part) = (whole.span, part.span);
    if limit.is_zero() {
        let message = "the limit is zero: this operand is stopped right after its start";
        let diagnostic = Diagnostic::new(Code::W0407, whole, message).label("always fails");
        return Some(diagnostic.help("set a limit that the operand can meet, such as `within 5 s`"));
    }
    let earliest = earliest.filter(|earliest| *earliest > limit)?;
    let message = format!("this takes at least {}, so it is never done within {}", time(earliest), time(limit));
    let diagnostic = Diagnostic::new(Code::W0407, whole, message);
    Some(diagnostic.reason(part, format!("takes at least {}", time(earliest))))
}

/// Writes a time for people: `1.5 s`, `20 ms`.
fn time(time: Duration) -> String {
    match time.as_secs_f64() {
        seconds if seconds < 1.0 => format!("{} ms", seconds * 1e3),
        seconds => format!("{seconds} s"),
    }
}
