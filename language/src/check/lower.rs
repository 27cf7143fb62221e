//! Makes the plan: every group and every leaf with its absolute path, and every wire from leaf to leaf.

mod data;
pub(crate) mod exclusivity;
mod expression;
mod external;
mod messages;
mod on_boot;
mod overlap;
mod places;
pub(crate) mod quote;
mod ranges;
mod ros_arguments;
mod start;
pub(super) mod topics;
mod tree;
mod wires;

use super::diagnostics::Diagnostics;
use super::names::listed;
use super::spec::{Direction, Expr, ExprKind, Port, Process, Spec, Target};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{Plan, PlanError, Wire};
pub(super) use places::places;
use quote::Quotes;
use std::collections::{BTreeMap, BTreeSet};

/// The largest number of operators and operands in the expanded event actions of one group.
pub(super) const EXPRESSION_MAX: u64 = 100_000;

/// Makes the plan of a spec without errors. Reports the mistakes that can only be found here.
pub(super) fn lower(
    spec: &Spec,
    root: usize,
    name: &str,
    quotes: &Quotes<'_>,
    diagnostics: &mut Diagnostics,
) -> Option<Plan> {
    if let Some(diagnostic) = spec.processes.iter().find_map(too_large) {
        diagnostics.push(diagnostic);
        return None;
    }
    let mut tree = tree::Tree::new(spec, root, diagnostics);
    let mut wires = wires::Wires::default();
    let messages = messages::Messages::new(&tree, spec);
    let mut topics = topics::Topics::new(&tree, messages.count());
    let mut misfits = Vec::new();
    for group in 0..tree.groups.len() {
        let process = &spec.processes[tree.process_of[group]];
        let sets = wires.sets(&tree, spec, &messages, group);
        wires::connect_keys(&mut tree, spec, group);
        topics.connect(&tree, spec, group, &mut wires);
        let always = (0_u32..).zip(&process.sets).filter(|(_, set)| set.owner.is_none()).map(|(index, _)| index);
        tree.groups[group].sets_always = always.collect();
        tree.groups[group].sets = sets;
        if let Some(actions) = &process.actions {
            let starts = start::Starts::new(spec, process, &tree.values_of[group]);
            let lowering = expression::Lowering { resources: &process.resources, quotes, starts: &starts };
            tree.groups[group].expression = lowering.lower(actions);
            misfits.extend(starts.found());
        }
    }
    diagnostics.extend(misfits);
    let read: BTreeSet<usize> = tree.process_of.iter().copied().collect();
    let actions = read.iter().filter_map(|&process| spec.processes[process].actions.as_ref());
    diagnostics.extend(actions.filter_map(not_understood));
    check_inputs(spec, &tree, &wires.all, diagnostics);
    exclusivity::check(spec, &tree, diagnostics);
    overlap::check(spec, &tree, &wires.all, diagnostics);
    external::check(spec, &tree, name, &wires.all, diagnostics);
    let claims = tree.claims(spec);
    let tree::Tree { hosts, groups, leaves, process_of, .. } = tree;
    let on_boot = spec.processes[root].on_boot.map(|(on_boot, _)| on_boot).unwrap_or_default();
    diagnostics.extend(on_boot::check(spec, root, &claims));
    let mut plan = Plan { name: name.to_owned(), hosts, groups, leaves, wires: wires.all, claims, on_boot };
    messages.add(&mut plan, spec, &process_of);
    diagnostics.extend(topics.bridge(&mut plan));
    match plan.validate() {
        Ok(()) => Some(plan),
        Err(error) => {
            diagnostics.push(refused(spec, &process_of, root, &plan, error));
            None
        }
    }
}

/// Reports event actions that would be too large. Nested `retry` multiplies copies, so an expression is measured before
/// it is expanded.
fn too_large(process: &Process) -> Option<Diagnostic> {
    let actions = process.actions.as_ref().filter(|actions| expression::size(actions) > EXPRESSION_MAX)?;
    let message = format!(
        "the event actions of `{}` have more than {EXPRESSION_MAX} operators when all tries of each `retry` are written out",
        process.name.text
    );
    Some(Diagnostic::new(Code::E0701, actions.span, message).help("use smaller numbers in `retry`"))
}

/// Returns an error for an operator that the parser accepts and the checker does not support. Text that could not be
/// read is already reported.
fn not_understood(expr: &Expr) -> Option<Diagnostic> {
    let broken = || Diagnostic::new(Code::E0006, expr.span, "this operator is not supported yet");
    let is_broken = matches!(expr.kind, ExprKind::Broken);
    is_broken.then(broken).or_else(|| expr.parts().into_iter().find_map(not_understood))
}

/// Makes the diagnostic for a limit that only the finished plan exceeds.
fn refused(spec: &Spec, process_of: &[usize], root: usize, plan: &Plan, error: PlanError) -> Diagnostic {
    let group = if let PlanError::ExpressionTooDeep { group } = &error {
        plan.groups.iter().position(|other| other.path == *group)
    } else {
        None
    };
    let process = &spec.processes[group.map_or(root, |group| process_of[group])];
    let span = process.actions.as_ref().map_or(process.name.span, |actions| actions.span);
    Diagnostic::new(if group.is_some() { Code::E0004 } else { Code::E0701 }, span, error.to_string())
}

/// Reports inputs that never receive anything, and calls that go nowhere. Each group type gets one line of each kind.
fn check_inputs(spec: &Spec, tree: &tree::Tree, wires: &[Wire], diagnostics: &mut Diagnostics) {
    let [fed, called] = [|wire: &Wire| wire.to.clone(), |wire: &Wire| wire.from.clone()]
        .map(|end| wires.iter().map(end).map(|end| (end.leaf, end.port)).collect::<BTreeSet<(u32, String)>>());
    let told =
        (0_u32..).zip(&tree.leaves).flat_map(|(leaf, it)| it.keys.iter().map(move |keys| (leaf, keys.port.clone())));
    let fed = fed.into_iter().chain(told).collect();
    for (process, inputs) in unused(spec, tree, &fed, |port| port.direction == Direction::In) {
        report_unused(spec, process, &inputs, Code::W0310, diagnostics);
    }
    for (process, calls) in unused(spec, tree, &called, |port| port.direction == Direction::Out && port.call.is_some())
    {
        report_unused(spec, process, &calls, Code::W0312, diagnostics);
    }
}

/// Returns the slots and ports of each group type that need a wire and have none.
fn unused<'s>(
    spec: &'s Spec,
    tree: &tree::Tree,
    wired: &BTreeSet<(u32, String)>,
    is_meant: impl Fn(&Port) -> bool,
) -> BTreeMap<usize, BTreeSet<(usize, &'s str)>> {
    let mut unused: BTreeMap<usize, BTreeSet<(usize, &str)>> = BTreeMap::new();
    for (leaf, &(group, slot)) in (0_u32..).zip(&tree.place_of) {
        let process = tree.process_of[group];
        let instance = &spec.processes[process].instances[slot];
        let Target::Module(module) = instance.target else { continue };
        if instance.policies.runs_in.is_some() {
            continue;
        }
        let ports = spec.modules[module].ports.iter().filter(|port| is_meant(port) && !port.is_optional);
        for port in ports.filter(|port| !wired.contains(&(leaf, port.name.text.clone()))) {
            unused.entry(process).or_default().insert((slot, &port.name.text));
        }
    }
    unused
}

fn report_unused(
    spec: &Spec,
    process: usize,
    ports: &BTreeSet<(usize, &str)>,
    code: Code,
    diagnostics: &mut Diagnostics,
) {
    let source = &spec.processes[process];
    let name = |slot: usize| &source.instances[slot].name;
    let named: Vec<String> = ports.iter().map(|&(slot, port)| format!("{}.{port}", name(slot).text)).collect();
    let is_input = code == Code::W0310;
    let message = match (is_input, named.len()) {
        (true, 1) => "nothing is ever sent to input ",
        (true, _) => "nothing is ever sent to inputs ",
        (false, _) => "nothing answers the calls of ",
    };
    let message = format!("{message}{}", listed(named.iter().map(String::as_str)));
    let slots: BTreeSet<usize> = ports.iter().map(|&(slot, _)| slot).collect();
    let mut diagnostic = Diagnostic::new(code, source.name.span, message);
    for slot in slots {
        let reason = if is_input { "has unconnected inputs" } else { "has calls without a connection" };
        diagnostic = diagnostic.reason(name(slot).span, reason);
    }
    if !is_input {
        diagnostic = diagnostic.help("connect each call to a process that answers: `client, Grip -> server, Grip;`");
    }
    diagnostics.push(diagnostic);
}
