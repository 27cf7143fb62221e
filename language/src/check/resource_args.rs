//! Resources that a group hands to its members: `search instof Search(c2, arm)`. While such a member runs, the group holds the resource for
//! it.
//!
//! So one supervisor, at the declaration of the resource, grants it to users on all hosts. After this pass, running the
//! member is `using(arm) search`. Inside, the member divides its resource among its own parts.

mod longer;

use super::diagnostics::Diagnostics;
use super::spec::{Arg, Expr, ExprKind, Instance, Module, Param, Process, Spec, Target, ValueKind};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::Constant;
use crate::similar::Near;
use crate::syntax::ast::Name;
use crate::unit::RESOURCE;
use std::collections::{BTreeMap, BTreeSet};

/// A resource that is handed to an instance.
#[derive(Clone, Debug)]
struct Held {
    /// The index of the resource in the group.
    resource: usize,
    /// The name of the resource inside the instance's own group.
    inside: String,
}

impl Param {
    /// Returns whether the parameter is a resource.
    pub(super) fn is_resource(&self) -> bool {
        self.kind.as_ref().is_some_and(|kind| kind.text == RESOURCE)
    }
}

/// Returns the resources that are handed to a group.
pub(super) fn known(params: &[Param]) -> Vec<Name> {
    params.iter().filter(|param| param.is_resource()).map(|param| param.name.clone()).collect()
}

/// Returns the resources that the arguments of instances name.
pub(super) fn given<'a>(
    instances: &'a [Instance],
    resources: &'a Places<'a>,
    params: &'a [Param],
) -> impl Iterator<Item = usize> + 'a {
    let args = instances.iter().flat_map(|instance| &instance.args);
    args.filter_map(move |arg| place(arg, resources, params))
}

/// The place of each resource in its group.
pub(super) type Places<'a> = BTreeMap<&'a str, usize>;

/// Returns the places of resources.
pub(super) fn places(resources: &[Name]) -> Places<'_> {
    resources.iter().enumerate().map(|(place, name)| (name.text.as_str(), place)).collect()
}

/// Returns the index of the resource that an argument names.
fn place(arg: &Arg, resources: &Places<'_>, params: &[Param]) -> Option<usize> {
    let name = match &arg.value.kind {
        ValueKind::Constant(Constant::Text(name)) => name,
        ValueKind::Param(param) => &params.get(*param)?.name.text,
        ValueKind::Constant(_) | ValueKind::Record(_) | ValueKind::List(_) | ValueKind::Broken => return None,
    };
    resources.get(name.as_str()).copied()
}

/// Makes each group hold the resources that it hands to a member, while that member runs.
pub(super) fn take(spec: &mut Spec, diagnostics: &mut Diagnostics) {
    diagnostics.extend(misplaced(spec));
    let mut all: Vec<Vec<Vec<Held>>> = Vec::new();
    for process in &spec.processes {
        let mut holds: Vec<Vec<Held>> = Vec::new();
        if process.damage.header || process.damage.instances {
            all.push(holds);
            continue;
        }
        let resource_args = ResourceArgs { spec, process, resources: places(&process.resources) };
        let mut text = None;
        for instance in &process.instances {
            let before = diagnostics.count();
            holds.push(resource_args.held(instance, diagnostics));
            // All instances of an array have the same text.
            let is_again = text.replace(instance.args_span) == Some(instance.args_span);
            diagnostics.retain_since(before, |_| !is_again);
        }
        all.push(holds);
    }
    diagnostics.extend(longer::check(spec, &all));
    for (process, holds) in std::iter::zip(&mut spec.processes, &all) {
        if let Some(actions) = process.actions.as_mut().filter(|_| holds.iter().any(|held| !held.is_empty())) {
            guard(actions, holds);
        }
    }
}

/// A group that hands resources to its members.
struct ResourceArgs<'a> {
    spec: &'a Spec,
    process: &'a Process,
    resources: Places<'a>,
}

impl ResourceArgs<'_> {
    /// Returns the resources that are handed to an instance.
    fn held(&self, instance: &Instance, diagnostics: &mut Diagnostics) -> Vec<Held> {
        let (spec, process) = (self.spec, self.process);
        let Target::Process(target) = instance.target else { return Vec::new() };
        let params = &spec.processes[target].params;
        let mut places = params.iter();
        let (mut held, mut known) = (Vec::new(), BTreeSet::new());
        for arg in &instance.args {
            let param = match &arg.name {
                Some(name) => params.iter().find(|param| param.name.text == name.text),
                None => places.next(),
            };
            let Some(param) = param.filter(|param| param.is_resource()) else { continue };
            match place(arg, &self.resources, &process.params) {
                Some(resource) if !known.insert(resource) => {
                    let name = &process.resources[resource].text;
                    let message = format!("`{name}` is given to `{}` twice, under two names", instance.name.text);
                    let diagnostic = Diagnostic::new(Code::E0213, arg.value.span, message);
                    diagnostics
                        .push(diagnostic.reason(param.name.span, "declared here").help("give the resource only once"));
                }
                Some(resource) => held.push(Held { resource, inside: param.name.text.clone() }),
                None => {
                    let found = self.unknown(arg, param, diagnostics);
                    diagnostics.extend(found);
                }
            }
        }
        held
    }

    fn unknown(&self, arg: &Arg, param: &Param, diagnostics: &mut Diagnostics) -> Option<Diagnostic> {
        let process = self.process;
        let span = arg.value.span;
        match &arg.value.kind {
            ValueKind::Constant(Constant::Text(name)) => {
                let diagnostic = Diagnostic::new(Code::E0204, span, format!("unknown resource `{name}`"));
                let near = diagnostics.near(name, process.resources.iter().map(|known| known.text.as_str()));
                let declared = |near: &Near<'_>| process.resources.iter().find(|known| known.text == near.name);
                Some(match near.as_ref().and_then(|near| Some((near, declared(near)?))) {
                    Some((near, known)) => diagnostic.reason(known.span, "declared here").rename(span, near),
                    None => diagnostic
                        .reason(param.name.span, "a resource is handed to this parameter")
                        .help(format!("declare it in `{}`: `resource {name};`", process.name.text)),
                })
            }
            ValueKind::Param(index) => {
                let outer = process.params.get(*index)?;
                let (name, other) = (&param.name.text, &outer.name.text);
                let message = format!("`{name}` has to be a {RESOURCE}, but `{other}` is not declared as a {RESOURCE}");
                let diagnostic = Diagnostic::new(Code::E0213, span, message).reason(outer.name.span, "declared here");
                Some(
                    diagnostic
                        .help(format!("write `{other}: {RESOURCE}` in the parameters of `{}`", process.name.text)),
                )
            }
            // This is already reported.
            ValueKind::Constant(_) | ValueKind::Record(_) | ValueKind::List(_) | ValueKind::Broken => None,
        }
    }
}

/// Reports resources in places where they would never be granted: programs, fields, defaults.
fn misplaced(spec: &Spec) -> Vec<Diagnostic> {
    let mut found = Vec::new();
    let names = |param: &Param| param.kind.as_ref().is_some_and(|kind| kind.name() == Some(RESOURCE));
    let modules = spec.modules.iter().flat_map(Module::declared);
    for param in modules.chain(spec.fields()).filter(|param| names(param)) {
        let message = format!("`{}` cannot be a {RESOURCE}: only a group can have such a parameter", param.name.text);
        let diagnostic = Diagnostic::new(Code::E0213, param.name.span, message);
        found.push(diagnostic.help("write `using(arm) program` where the program is run"));
    }
    for param in spec.processes.iter().flat_map(|process| &process.params).filter(|param| names(param)) {
        let name = &param.name.text;
        let message = match (&param.default, param.is_resource()) {
            (None, true) => continue,
            (Some(_), true) => {
                format!("`{name}` is a {RESOURCE}, which cannot have a default: each instance is given a resource")
            }
            (_, false) => format!("`{name}` has to be `{name}: {RESOURCE}`: each resource is a parameter of its own"),
        };
        found.push(Diagnostic::new(Code::E0213, param.name.span, message));
    }
    found
}

/// Puts a `using` around each run of a member that gets a resource.
fn guard(expr: &mut Expr, holds: &[Vec<Held>]) {
    let rest = |parts: &mut [Expr]| parts.iter_mut().for_each(|part| guard(part, holds));
    match &mut expr.kind {
        ExprKind::Run(slot, _) => {
            let Some(held) = holds.get(*slot).filter(|held| !held.is_empty()) else { return };
            let taken = held.iter().map(|held| held.resource).collect();
            let run = Expr { span: expr.span, kind: std::mem::replace(&mut expr.kind, ExprKind::Broken) };
            expr.kind = ExprKind::Using(taken, Box::new(run));
        }
        ExprKind::Concurrent(parts)
        | ExprKind::FailFast(parts)
        | ExprKind::AnyOf(_, parts)
        | ExprKind::AtLeast(_, parts)
        | ExprKind::Disable(parts)
        | ExprKind::Sequence(parts)
        | ExprKind::Conditional(parts)
        | ExprKind::Otherwise(parts) => rest(parts),
        ExprKind::Recurrent(first, second) | ExprKind::Finally(first, second) => {
            guard(first, holds);
            guard(second, holds);
        }
        ExprKind::Asynchronous(source, pool) => {
            guard(source, holds);
            rest(pool);
        }
        ExprKind::Retry(_, _, part)
        | ExprKind::Repeat(_, part)
        | ExprKind::Within(_, part)
        | ExprKind::Shield(_, part)
        | ExprKind::Using(_, part)
        | ExprKind::Tagged(_, part)
        | ExprKind::With(_, part)
        | ExprKind::Named(_, part) => guard(part, holds),
        ExprKind::Chart(model) => model.runs.iter_mut().for_each(|(_, run)| guard(run, holds)),
        ExprKind::Catch(first, arms) => {
            guard(first, holds);
            arms.iter_mut().for_each(|arm| guard(&mut arm.body, holds));
        }
        ExprKind::Match(arms) => arms.iter_mut().for_each(|arm| guard(&mut arm.body, holds)),
        ExprKind::Skip | ExprKind::Never | ExprKind::Fail(_) | ExprKind::Wait(_) | ExprKind::Broken => {}
    }
}
