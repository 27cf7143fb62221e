//! Checks the types of instances, their arguments, and which groups contain which other groups.

mod kept;
mod kinds;
mod records;
mod recursion;
mod resolve;
mod result;
mod start;

use super::diagnostics::{Diagnostics, Rounds, key};
use super::names::listed;
use super::range::Range;
use super::spec::{Arg, CallRole, Instance, Module, Param, Port, Process, Spec, Target, ValueKind};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{Constant, LeafKind, Restart};
use crate::source::{Origin, Span};
use crate::syntax::ast::Name;
use kinds::TypeChecker;
use std::collections::BTreeSet;

pub(super) use kept::{check as check_kept, event_kind};
pub(super) use recursion::is_finite;
pub(super) use result::check as check_results;
pub(super) use start::{check as check_starts, declared, takers};

/// Resolves every type, and checks the arguments against the parameters.
pub(super) fn check(spec: &mut Spec, diagnostics: &mut Diagnostics) {
    records::check(spec, diagnostics);
    resolve::resolve(spec, diagnostics);
    let mut uses = Vec::new();
    check_defaults(spec, &mut uses, diagnostics);
    let mut elsewhere = BTreeSet::new();
    for process in &spec.processes {
        check_actions(process, diagnostics);
        check_policies(spec, process, diagnostics);
        let mut text: Option<(Span, Rounds)> = None;
        for instance in process.instances.iter().filter(|_| !process.damage.instances) {
            let Some(call) = Call::of(spec, instance) else { continue };
            let before = diagnostics.count();
            // All instances of an array have the same text, so their mistakes are reported once.
            let known = text.take().filter(|(span, _)| *span == call.span);
            let mut rounds = known.map_or_else(|| diagnostics.rounds(), |(_, rounds)| rounds);
            diagnostics.begin_round(&mut rounds);
            call.check(spec, diagnostics);
            let mut kinds = TypeChecker { spec, outer: &process.params, uses: &mut uses, diagnostics };
            kinds.arguments(call.params, call.args);
            // A named constant may be given at several places.
            let is_here = |found: &Diagnostic| call.span.contains(found.primary.span);
            diagnostics.retain_since(before, |found| is_here(found) || elsewhere.insert(key(found)));
            diagnostics.end_round(&mut rounds);
            text = Some((call.span, rounds));
        }
    }
    spec.field_uses = uses;
}

/// Checks the defaults and ranges of parameters and fields.
fn check_defaults(spec: &Spec, uses: &mut Vec<(Span, Span)>, diagnostics: &mut Diagnostics) {
    let processes = spec.processes.iter().filter(|process| !process.damage.header).map(|process| &process.params);
    let modules = spec.modules.iter().flat_map(Module::declared);
    let mut kinds = TypeChecker { spec, outer: &[], uses, diagnostics };
    for param in processes.flatten().chain(modules).chain(spec.fields()) {
        let bounds = param.range.iter().flat_map(Range::written);
        bounds.for_each(|bound| kinds.bound(param, bound));
        if let Some(default) = &param.default {
            kinds.value(param, default);
        }
    }
}

/// Checks policies. They belong to programs, and some programs cannot have some policies.
fn check_policies(spec: &Spec, process: &Process, diagnostics: &mut Diagnostics) {
    if process.damage.instances {
        return;
    }
    let mut last = None;
    for instance in &process.instances {
        let Some(span) = instance.policies.span else { continue };
        // All instances of an array have the same text.
        if last.replace(span) == Some(span) {
            continue;
        }
        match instance.target {
            Target::Process(_) => {
                let message = format!("`{}` is a group: policies belong to programs", instance.name.text);
                let diagnostic = Diagnostic::new(Code::E0111, span, message);
                diagnostics.push(diagnostic.help("write them at the instances inside the group"));
            }
            Target::Module(module) => {
                let module = &spec.modules[module];
                let forgets = check_restart(module, instance);
                let pauses = || check_backoff(Some(module), process, instance);
                diagnostics.extend(forgets.or_else(pauses));
                diagnostics.extend(check_overlap(module, instance));
            }
            Target::Unknown => diagnostics.extend(check_backoff(None, process, instance)),
        }
    }
}

/// Reports a program that would be started again, although it would lose what its type remembers.
fn check_restart(module: &Module, instance: &Instance) -> Option<Diagnostic> {
    let span = instance.policies.restart?;
    if !module.remembers || instance.policies.policy.restart == Restart::Temporary {
        return None;
    }
    let (name, kind) = (&instance.name.text, &module.name.text);
    let message = format!("a restart of `{name}` would lose the state that `{kind}` remembers");
    let found = Diagnostic::new(Code::E0112, span, message).label("the new program would begin without this state");
    let help = format!(
        "remove `restart`: when `{name}` dies, the expression that runs it aborts, and `retry(2) (...)` restarts the expression as a whole"
    );
    Some(found.help(help).choose(span, "temporary"))
}

/// Reports two overlapping programs of one process that would both end it, use its devices, or answer its calls.
fn check_overlap(module: &Module, instance: &Instance) -> Option<Diagnostic> {
    let span = instance.policies.overlap?;
    let is_called = |port: &&Port| port.call.as_ref().is_some_and(|call| call.role != CallRole::Caller);
    let why = if module.kind == LeafKind::Plain {
        "it is a plain program, which has no connections to take over".to_owned()
    } else if !module.is_service {
        format!("`{}` is not a service, and both programs could end the process", module.name.text)
    } else if let Some(claim) = module.claims.first() {
        format!("`{}` claims `{}`, and both programs would use this device", module.name.text, claim.name.text)
    } else if let Some(port) = module.ports.iter().find(is_called) {
        format!("other processes call its `{}`, and both programs would answer", port.name.text)
    } else {
        return None;
    };
    Some(no_overlap(span, &instance.name.text, &why))
}

/// Makes the diagnostic for an instance whose old and new program cannot run at the same time.
pub(super) fn no_overlap(span: Span, name: &str, why: &str) -> Diagnostic {
    let message = format!("two programs of `{name}` cannot overlap: {why}");
    let found = Diagnostic::new(Code::E0115, span, message);
    found
        .help("without `replace overlap`, the old program is ended before the new program is started")
        .choose(span, "break_before_make")
}

/// Reports a back-off for a program that is never started again.
fn check_backoff(module: Option<&Module>, group: &Process, instance: &Instance) -> Option<Diagnostic> {
    let (span, policies) = (instance.policies.backoff?, &instance.policies);
    let remembers = module.is_some_and(|module| module.remembers);
    let is_restarted = match policies.restart {
        Some(_) => policies.policy.restart != Restart::Temporary,
        None => group.supervision.is_some() && !remembers,
    };
    if is_restarted {
        return None;
    }
    let message = format!("`{}` is never restarted, so it cannot have a `backoff`", instance.name.text);
    let found = Diagnostic::new(Code::E0113, span, message);
    Some(match (policies.restart, remembers) {
        (Some(_), _) => found.help("remove `backoff`, or write `restart transient` or `restart permanent`"),
        (None, true) => found.help("its type `remembers`, so the program may not be restarted alone: remove `backoff`"),
        (None, false) => found.help("add `restart transient`"),
    })
}

/// Returns the arguments of a module after its host. The host is the first argument, if it is a name or a text, or is
/// named `host`.
pub(super) fn without_host(args: &[Arg]) -> &[Arg] {
    match args.first() {
        Some(Arg { name: None, value }) => match value.kind {
            ValueKind::Constant(Constant::Text(_)) | ValueKind::Param(_) | ValueKind::Broken => &args[1..],
            ValueKind::Constant(Constant::Number(_) | Constant::Truth(_) | Constant::Secret(_))
            | ValueKind::Record(_)
            | ValueKind::List(_) => args,
        },
        Some(Arg { name: Some(name), .. }) if name.text == "host" => &args[1..],
        Some(_) | None => args,
    }
}

/// The arguments of an instance, and the parameters of its type.
struct Call<'a> {
    kind: &'a str,
    params: &'a [Param],
    /// The arguments. For a module, the host is left out.
    args: &'a [Arg],
    is_module: bool,
    /// Whether the number of arguments would be right if the host were a parameter.
    is_one_short_for_its_host: bool,
    span: Span,
}

impl<'a> Call<'a> {
    /// Returns the call, or none if the parameters are not known.
    fn of(spec: &'a Spec, instance: &'a Instance) -> Option<Self> {
        let (params, args) = match instance.target {
            Target::Process(target) if spec.processes[target].damage.header => return None,
            Target::Process(target) => (spec.processes[target].params.as_slice(), instance.args.as_slice()),
            // The deployment that starts the program decides its arguments.
            Target::Module(_) if instance.policies.runs_in.is_some() => return None,
            Target::Module(target) => (spec.modules[target].params.as_deref()?, without_host(&instance.args)),
            Target::Unknown => return None,
        };
        let is_module = matches!(instance.target, Target::Module(_));
        let is_untyped = params.first().is_some_and(|first| first.kind.is_none());
        let is_one_short_for_its_host =
            is_untyped && args.len() < instance.args.len() && params.len() == instance.args.len();
        let kind = &instance.kind.as_ref()?.text;
        Some(Self { kind, params, args, is_module, is_one_short_for_its_host, span: instance.args_span })
    }

    /// Checks that each parameter gets exactly one value.
    fn check(&self, spec: &Spec, diagnostics: &mut Diagnostics) {
        let (kind, params) = (self.kind, self.params);
        let positional = self.args.iter().filter(|arg| arg.name.is_none()).count();
        let mut given: Vec<bool> = (0..params.len()).map(|index| index < positional).collect();
        let mut is_known = true;
        // The host of a module may be given by name. For a group, `host` is a name like any other.
        let is_host = |name: &&Name| self.is_module && name.text == "host";
        for name in self.args.iter().filter_map(|arg| arg.name.as_ref()).filter(|name| !is_host(name)) {
            match params.iter().position(|param| param.name.text == name.text) {
                Some(index) if given[index] => {
                    let message = format!("argument `{}` of `{kind}` is given twice", name.text);
                    diagnostics.push(Diagnostic::new(Code::E0212, name.span, message));
                }
                Some(index) => given[index] = true,
                None => {
                    is_known = false;
                    let message = format!("`{kind}` has no parameter `{}`", name.text);
                    let diagnostic = Diagnostic::new(Code::E0211, name.span, message);
                    // A parameter that another argument names cannot be the intended one.
                    let is_named = |param: &&Param| {
                        let mut names = self.args.iter().filter_map(|arg| arg.name.as_ref());
                        names.any(|other| other.text == param.name.text)
                    };
                    let open = params.iter().skip(positional).filter(|param| !is_named(param));
                    let near = diagnostics.near(&name.text, open.map(|param| param.name.text.as_str()));
                    diagnostics.push(match near {
                        Some(near) => diagnostic.rename(name.span, &near),
                        None => diagnostic,
                    });
                }
            }
        }
        let is_missing = |(param, given): &(&Param, &bool)| !**given && !spec.is_optional(param);
        let mut missing = std::iter::zip(params, &given).filter(is_missing).map(|(param, _)| param.name.text.as_str());
        let missing = missing.next().map(|first| listed(std::iter::once(first).chain(missing)));
        if positional <= params.len() && (missing.is_none() || !is_known) {
            return;
        }
        let message = match missing {
            None => format!("`{kind}` takes {}, not {positional}", count(params.len())),
            Some(missing) => format!("`{kind}` needs a value for {missing}"),
        };
        let mut diagnostic = Diagnostic::new(Code::E0210, self.span, message);
        if let (Some(first), Some(last)) = (params.first(), params.last()) {
            let span = Span { end: last.name.span.end, ..first.name.span };
            diagnostic = diagnostic.reason(span, "its parameters");
        }
        if self.is_one_short_for_its_host {
            diagnostic = diagnostic.help(format!(
                "the first argument of a module is its host; it is the value of the first parameter only if this parameter is `{}: Host`",
                params[0].name.text
            ));
        }
        diagnostics.push(diagnostic);
    }
}

fn count(params: usize) -> String {
    match params {
        0 => "no arguments".to_owned(),
        1 => "one argument".to_owned(),
        _ => format!("{params} arguments"),
    }
}

/// Reports instances that no event action runs.
fn check_actions(process: &Process, diagnostics: &mut Diagnostics) {
    if process.damage.actions || process.damage.instances {
        return;
    }
    if process.actions.is_none() {
        let message = format!("`{}` has no event actions and ends as soon as it starts", process.name.text);
        diagnostics.push(Diagnostic::new(Code::W0121, process.name.span, message));
        return;
    }
    if process.damage.names {
        return;
    }
    // `runs_in` only names a process of another deployment, so an instance with it need not be run.
    let idle = process.instances.iter().filter(|instance| !instance.is_run && instance.policies.runs_in.is_none());
    for instance in idle {
        let message = format!("`{}` is never run", instance.name.text);
        diagnostics.push(Diagnostic::new(Code::W0120, instance.name.span, message));
    }
}

/// Returns the process that a deployment starts. This is `main`, otherwise the only process that no other process
/// instantiates.
pub(super) fn root(spec: &Spec, diagnostics: &mut Diagnostics) -> Option<usize> {
    let used = spec.processes.iter().flat_map(|process| &process.instances).map(|instance| instance.target);
    let used: BTreeSet<usize> = used
        .filter_map(|target| match target {
            Target::Process(process) => Some(process),
            Target::Module(_) | Target::Unknown => None,
        })
        .collect();
    let unused: Vec<usize> = (0..spec.processes.len()).filter(|process| !used.contains(process)).collect();
    if let Some(&main) = spec.process_names.get("main") {
        // A file that several specs use may have more processes than this spec needs.
        let own = |process: &&usize| spec.processes[**process].name.span.origin == Origin::Spec;
        for &process in unused.iter().filter(|&&process| process != main).filter(own) {
            let name = &spec.processes[process].name;
            let message = format!("process `{}` is never instantiated", name.text);
            diagnostics.push(Diagnostic::new(Code::W0122, name.span, message));
        }
        diagnostics.extend(open(&spec.processes[main]));
        return Some(main);
    }
    match unused.as_slice() {
        &[root] => {
            let process = &spec.processes[root];
            diagnostics.extend(open(process));
            let message = format!("no process `main`: `{}` is taken as the root", process.name.text);
            let mut diagnostic = Diagnostic::new(Code::W0101, process.name.span, message);
            let is_open = |param: &&Param| param.default.is_none() && !process.open.contains(&param.name);
            let open = process.params.iter().filter(is_open);
            let open: Vec<String> = open.map(|param| format!("`{}`", param.name.text)).collect();
            if !open.is_empty() {
                let verb = if open.len() == 1 {
                    "has no value, so its name is the value"
                } else {
                    "have no values, so their names are the values"
                };
                diagnostic = diagnostic.help(format!("{} {verb}", open.join(", ")));
            }
            diagnostics.push(diagnostic);
            Some(root)
        }
        _ => {
            diagnostics.extend(no_root(spec, &unused));
            None
        }
    }
}

/// Makes the diagnostic for a root whose shape parameter has no value.
fn open(process: &Process) -> Option<Diagnostic> {
    let (first, name) = (process.open.first()?, &process.name.text);
    let names = listed(process.open.iter().map(|param| param.text.as_str()));
    let message = format!("`{name}` is the root, so no group gives a value to {names}");
    let diagnostic = Diagnostic::new(Code::E0210, first.span, message).label("decides the shape of the group");
    let help = format!("give each parameter a default: `{} = ...`", first.text);
    Some(diagnostic.help(help))
}

fn no_root(spec: &Spec, unused: &[usize]) -> Option<Diagnostic> {
    let help = "add `process main() { instantiated_processes { ... } internal_event_actions { ... } }`";
    let Some(&last) = unused.last().or_else(|| spec.processes.len().checked_sub(1).as_ref().map(|_| &0)) else {
        let start = Span { origin: Origin::Spec, start: 0, end: 0 };
        return Some(Diagnostic::new(Code::E0101, start, "the spec has no process to run").help(help));
    };
    if unused.is_empty() {
        // Every process is part of another process. The recursion is reported elsewhere.
        return None;
    }
    let names: Vec<String> = unused.iter().map(|&process| format!("`{}`", spec.processes[process].name.text)).collect();
    let message = format!("no process `main`, and {} could be the root", names.join(", "));
    Some(Diagnostic::new(Code::E0101, spec.processes[last].name.span, message).help(help))
}
