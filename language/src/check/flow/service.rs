//! Services, which are processes without a normal end. Modules declare this, and it is inferred for groups.

use super::ends::Members;
use super::group_of;
use crate::check::diagnostics::Diagnostics;
use crate::check::names::listed;
use crate::check::spec::{Expr, ExprKind, Process, Spec, Target};
use crate::diagnostic::{Code, Diagnostic};

/// Infers which groups are services. Inner groups come first.
pub(super) fn infer(spec: &mut Spec) {
    let mut known: Vec<Option<bool>> = vec![None; spec.processes.len()];
    for process in 0..spec.processes.len() {
        infer_process(spec, process, &mut known);
    }
    for (process, known) in spec.processes.iter_mut().zip(known) {
        process.is_service = known.unwrap_or(false);
    }
}

fn infer_process(spec: &Spec, process: usize, known: &mut Vec<Option<bool>>) -> bool {
    if let Some(known) = known[process] {
        return known;
    }
    let process_ref = &spec.processes[process];
    let members: Vec<bool> = process_ref
        .instances
        .iter()
        .map(|instance| match instance.target {
            Target::Process(target) => infer_process(spec, target, known),
            Target::Module(module) => spec.modules[module].is_service,
            Target::Unknown => false,
        })
        .collect();
    let is_service = process_ref.actions.as_ref().is_some_and(|actions| is_service(actions, &members));
    known[process] = Some(is_service);
    is_service
}

/// Returns whether no run of the expression ends without a fault. `members` says which members are services.
pub(super) fn is_service(expr: &Expr, members: &[bool]) -> bool {
    let rest = |part: &Expr| is_service(part, members);
    match &expr.kind {
        ExprKind::Run(slot, _) => members[*slot],
        ExprKind::Never | ExprKind::Recurrent(..) | ExprKind::Asynchronous(..) => true,
        ExprKind::Skip | ExprKind::Fail(_) | ExprKind::Wait(_) | ExprKind::Within(..) | ExprKind::Broken => false,
        ExprKind::Concurrent(parts) | ExprKind::Disable(parts) => parts.iter().all(rest),
        // `&` waits for every operand, so one service among them is enough.
        ExprKind::Finally(first, second) => rest(first) || rest(second),
        ExprKind::FailFast(parts)
        | ExprKind::AtLeast(_, parts)
        | ExprKind::Sequence(parts)
        | ExprKind::Conditional(parts) => parts.iter().any(rest),
        ExprKind::AnyOf(count, parts) => parts.iter().filter(|part| !rest(part)).count() < *count as usize,
        ExprKind::Otherwise(parts) => parts.first().is_some_and(rest),
        ExprKind::Catch(first, _) => rest(first),
        ExprKind::Retry(_, _, part)
        | ExprKind::Repeat(_, part)
        | ExprKind::Shield(_, part)
        | ExprKind::Using(_, part)
        | ExprKind::Tagged(_, part)
        | ExprKind::With(_, part)
        | ExprKind::Named(_, part) => rest(part),
        ExprKind::Match(arms) => arms.iter().all(|arm| rest(&arm.body)),
        ExprKind::Chart(model) => model.chart.is_service(),
    }
}

/// Returns for each instance of a group whether it is a service. This is known after `infer`.
pub(super) fn members(spec: &Spec, process: &Process) -> Vec<bool> {
    let is_service = |target| match target {
        Target::Process(target) => spec.processes[target].is_service,
        Target::Module(module) => spec.modules[module].is_service,
        Target::Unknown => false,
    };
    process.instances.iter().map(|instance| is_service(instance.target)).collect()
}

/// Reports the members that never start or never end because of a service, and the members that may never end because no service is
/// declared.
pub(super) struct Order<'a> {
    spec: &'a Spec,
    process: &'a Process,
    members: &'a Members,
    /// The members without tolerance: a group that is a service is never done, even if it tolerates failures.
    intolerant: Members,
    diagnostics: &'a mut Diagnostics,
}

impl<'a> Order<'a> {
    pub(super) fn new(
        spec: &'a Spec,
        process: &'a Process,
        members: &'a Members,
        diagnostics: &'a mut Diagnostics,
    ) -> Self {
        Self { spec, process, members, intolerant: members.without_tolerance(), diagnostics }
    }

    pub(super) fn walk(&mut self, expr: &Expr) {
        match &expr.kind {
            ExprKind::Sequence(parts) | ExprKind::Conditional(parts) => self.check(&parts.iter().collect::<Vec<_>>()),
            ExprKind::Recurrent(first, second) => self.check(&[first, second]),
            ExprKind::Asynchronous(source, pool) => {
                self.check(&std::iter::once(&**source).chain(pool.first()).collect::<Vec<_>>());
            }
            ExprKind::Shield(None, part) if self.is_service(part) => {
                let message = "a stop would wait for ever: the shielded operand has no normal end";
                let diagnostic = Diagnostic::new(Code::E0411, part.span, message).label("has no normal end");
                self.diagnostics.push(diagnostic.help("give the shield a bound: `shield(10 s) process`"));
            }
            ExprKind::Finally(_, part) if self.is_service(part) => {
                let message = "a stop would wait for ever: the operand after `finally` has no normal end";
                let diagnostic = Diagnostic::new(Code::E0411, part.span, message).label("has no normal end");
                self.diagnostics.push(diagnostic.help("set a limit: `finally (process within 10 s)`"));
            }
            ExprKind::Disable(parts) => {
                for (index, part) in parts.iter().enumerate() {
                    let others = parts.iter().enumerate().filter(|(other, _)| *other != index).map(|(_, it)| it);
                    let found = self.may_never_end(part, others);
                    self.diagnostics.extend(found);
                }
            }
            ExprKind::Run(..)
            | ExprKind::Skip
            | ExprKind::Never
            | ExprKind::Fail(_)
            | ExprKind::Wait(_)
            | ExprKind::Concurrent(_)
            | ExprKind::FailFast(_)
            | ExprKind::AnyOf(..)
            | ExprKind::AtLeast(..)
            | ExprKind::Otherwise(_)
            | ExprKind::Catch(..)
            | ExprKind::Retry(..)
            | ExprKind::Repeat(..)
            | ExprKind::Within(..)
            | ExprKind::Match(_)
            | ExprKind::Shield(..)
            | ExprKind::Using(..)
            | ExprKind::Finally(..)
            | ExprKind::Tagged(..)
            | ExprKind::With(..)
            | ExprKind::Named(..)
            | ExprKind::Chart(_)
            | ExprKind::Broken => {}
        }
        expr.parts().into_iter().for_each(|part| self.walk(part));
    }

    fn is_service(&self, expr: &Expr) -> bool {
        is_service(expr, &self.members.services)
    }

    /// Checks a sequence. In `P ; Q`, a `P` that is never done keeps `Q` from starting. If the last part is a group that turns out to be a
    /// service, the sequence never ends. If the sequence itself tolerates the failure of a service, as in `lidar? ; alarm`, a failover is
    /// meant, and nothing is reported.
    fn check(&mut self, parts: &[&Expr]) {
        let Some((last, before)) = parts.split_last() else { return };
        let is_open = |part: &&&Expr| self.intolerant.ends_of(part).done.is_none();
        let is_done = |part: &Expr| self.members.ends_of(part).done.is_some();
        let found = if let Some(index) = before.iter().position(|part| is_open(&part)) {
            self.never_started(before[index], parts[index + 1], is_done(before[index]))
        } else {
            let group = group_of(self.spec, self.process, last).filter(|group| group.is_service && !is_done(last));
            let Some(group) = group else { return };
            let message = format!("the sequence never finishes: `{}` has no normal end", group.name.text);
            let diagnostic = Diagnostic::new(Code::W0403, last.span, message);
            let reason = group.actions.as_ref().map_or(group.name.span, |actions| actions.span);
            let diagnostic = diagnostic.reason(reason, "nothing that runs here ends");
            diagnostic.help("give one of its processes an end, or disable it with `# task`")
        };
        self.diagnostics.push(found);
    }

    /// Makes the diagnostic for `next`, which follows `part`. `part` is done only after a fault, or never.
    fn never_started(&self, part: &Expr, next: &Expr, is_after_fault: bool) -> Diagnostic {
        if !self.is_service(part) {
            let message = "this operand never starts: the operand before it is never done";
            let diagnostic = Diagnostic::new(Code::W0405, next.span, message).label("never starts");
            return diagnostic.reason(part.span, "fails or is stopped, but is never done");
        }
        if is_after_fault {
            let message = "the operand after a service starts only when a part of the service has failed";
            let diagnostic = Diagnostic::new(Code::W0403, next.span, message).label("starts only after a failure");
            let diagnostic = diagnostic.reason(part.span, "has no normal end, but tolerates failures");
            return diagnostic.help("if this is a failover, tolerate the failure in this sequence: `sensor? ; rest`");
        }
        let message = "the operand after a service never starts";
        let diagnostic = Diagnostic::new(Code::W0403, next.span, message).label("never starts");
        let diagnostic = diagnostic.reason(part.span, "has no normal end");
        diagnostic.help("run both operands together with `,`, or end the service with `# task`")
    }

    /// Reports a group `sensor, threshold` in `group # arm` if it is unknown whether the sensor ends. If the sensor does not end and is not
    /// declared as a service, `,` waits for it, and the arm is never stopped.
    fn may_never_end<'e>(&self, operand: &Expr, others: impl Iterator<Item = &'e Expr>) -> Option<Diagnostic> {
        let group = group_of(self.spec, self.process, operand).filter(|group| !group.damage.actions)?;
        let ExprKind::Concurrent(parts) = &group.actions.as_ref()?.kind else { return None };
        let runs = parts.iter().filter_map(|part| Some((part, &group.instances[run_of(part)?])));
        let (part, instance) = runs.into_iter().find(|(_, instance)| is_open(self.spec, instance.target))?;
        let kind = &instance.kind.as_ref()?.text;
        let stopped = others.filter_map(|other| Some(self.process.instances[run_of(other)?].name.text.as_str()));
        let stopped = listed(stopped);
        let purpose = if stopped.is_empty() { "others" } else { &stopped };
        let message = format!("`{}` may never end, but it is used to stop {purpose}", group.name.text);
        let label = format!("`,` waits for `{}`, and {kind} has no declared end", instance.name.text);
        let diagnostic =
            Diagnostic::new(Code::W0402, part.span, message).label(label).reason(operand.span, "used here");
        let help = format!(
            "if {kind} runs for ever, declare this: `module {kind} {{ service; }}`; then `,` does not wait for it"
        );
        Some(diagnostic.help(help).help(format!("if it ends by itself, declare this: `module {kind} {{ done; }}`")))
    }
}

/// Returns whether it is unknown if a leaf ends.
fn is_open(spec: &Spec, target: Target) -> bool {
    match target {
        Target::Module(module) => !spec.modules[module].is_service && !spec.modules[module].has_end,
        Target::Unknown => true,
        Target::Process(_) => false,
    }
}

/// Returns the instance, if the expression only runs one.
fn run_of(expr: &Expr) -> Option<usize> {
    if let ExprKind::Run(slot, _) = &expr.kind { Some(*slot) } else { None }
}
