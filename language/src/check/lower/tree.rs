//! Makes the groups and leaves of the plan: paths, hosts, arguments.

use super::data::{Data, data, filled, flatten};
use super::ros_arguments::RosArguments;
use crate::check::declare::ros_action::is_action;
use crate::check::declare::ros_node::{Refused, form, named, restarting};
use crate::check::diagnostics::{Diagnostics, key};
use crate::check::interface::parameters_of;
use crate::check::spec::{Arg, ExprKind, Instance, Module, Process, Spec, Target, Value};
use crate::check::types::without_host;
use crate::diagnostic::{Code, Diagnostic};
use crate::host::host_name_problem;
use crate::plan::{
    Argument, Claim, Constant, Expression, External, Group, Leaf, LeafKind, Member, MemberKind, Parameter, Policy,
    Restart,
};
use crate::source::Span;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// The host of everything, if the spec names no host at all.
const HOST_DEFAULT: &str = "local";
/// How long a leaf without an interface may take to stop.
const STOP_WITHIN: Duration = Duration::from_secs(2);

/// All groups and leaves of a plan, with their sources in the spec.
pub(super) struct Tree {
    pub(super) hosts: Vec<String>,
    pub(super) groups: Vec<Group>,
    pub(super) leaves: Vec<Leaf>,
    /// The process of each group.
    pub(super) process_of: Vec<usize>,
    /// The values of the parameters of each group.
    pub(super) values_of: Vec<Vec<Data>>,
    /// The group and slot of each leaf.
    pub(super) place_of: Vec<(usize, usize)>,
}

/// A host during the construction of the tree. The host of the root may become known only at the end.
#[derive(Clone, PartialEq, Eq)]
enum Place {
    Named(String),
    Root,
}

/// The group around a leaf.
#[derive(Clone, Copy)]
struct Outer<'a> {
    /// The values of the group's parameters.
    values: &'a [Data],
    place: &'a Place,
    /// The index of the group in the plan.
    group: usize,
    /// The slot of the leaf in the group.
    slot: usize,
}

pub(super) struct Builder<'a> {
    pub(super) spec: &'a Spec,
    diagnostics: &'a mut Diagnostics,
    /// The diagnostics that were already reported. One text can have many instances.
    reported: BTreeSet<(Span, Code, String)>,
    tree: Tree,
    group_places: Vec<Place>,
    leaf_places: Vec<Place>,
    /// Hosts in the order of their first use.
    hosts: BTreeMap<String, u32>,
    /// The groups that were reported because they have no host.
    hostless: BTreeSet<usize>,
    /// The places that were reported because their value is not a host.
    hostless_spans: BTreeSet<Span>,
    /// The names that were reported because no node can have them.
    refused_hosts: BTreeSet<String>,
}

impl Tree {
    /// Makes a group or leaf of the plan for each instance below the root.
    pub(super) fn new(spec: &Spec, root: usize, diagnostics: &mut Diagnostics) -> Self {
        let tree = Self {
            hosts: Vec::new(),
            groups: Vec::new(),
            leaves: Vec::new(),
            process_of: Vec::new(),
            values_of: Vec::new(),
            place_of: Vec::new(),
        };
        let (group_places, leaf_places) = (Vec::new(), Vec::new());
        let (hostless, hostless_spans) = (BTreeSet::new(), BTreeSet::new());
        let mut builder = Builder {
            spec,
            diagnostics,
            reported: BTreeSet::new(),
            tree,
            group_places,
            leaf_places,
            hosts: BTreeMap::new(),
            hostless,
            hostless_spans,
            refused_hosts: BTreeSet::new(),
        };
        // If the root is not `main`, its parameters may have no values. Such a parameter stands for its own name.
        let values = bind(spec, &spec.processes[root], &[], &[]);
        builder.group(root, "main".to_owned(), &values, Place::Root);
        builder.finish()
    }

    /// Returns the texts that the parameters of a group have, by name.
    pub(super) fn texts(&self, spec: &Spec, group: usize) -> impl Fn(&str) -> Option<String> {
        let params = &spec.processes[self.process_of[group]].params;
        move |name| {
            let index = params.iter().position(|param| param.name.text == name)?;
            text_of(self.values_of[group].get(index)?)
        }
    }

    /// Returns the claims of the leaves, in the order of the leaves.
    pub(super) fn claims(&self, spec: &Spec) -> Vec<Claim> {
        let mut claims = Vec::new();
        for (leaf, &(group, slot)) in (0..).zip(&self.place_of) {
            let instance = &spec.processes[self.process_of[group]].instances[slot];
            let Target::Module(module) = instance.target else { continue };
            if instance.policies.runs_in.is_some() {
                continue;
            }
            claims.extend(spec.modules[module].claims.iter().map(|claim| Claim {
                leaf,
                device: claim.name.text.clone(),
                is_write: claim.is_write,
            }));
        }
        claims
    }
}

impl Builder<'_> {
    fn group(&mut self, process: usize, path: String, values: &[Data], outer: Place) -> u32 {
        let spec = self.spec;
        let source = &spec.processes[process];
        let place = self.group_place(process, values, outer, &path);
        let index = self.tree.groups.len();
        self.tree.groups.push(Group {
            path: path.clone(),
            process: source.name.text.clone(),
            host: 0,
            members: Vec::new(),
            sets: Vec::new(),
            sets_always: Vec::new(),
            expression: Expression::Skip,
            supervision: source.supervision.unwrap_or_default(),
        });
        self.tree.process_of.push(process);
        self.tree.values_of.push(values.to_vec());
        self.group_places.push(place.clone());
        if let Some(actions) = &source.actions {
            self.check_starts(source, actions, values);
        }
        let mut members = Vec::with_capacity(source.instances.len());
        for (slot, instance) in source.instances.iter().enumerate() {
            let name = instance.name.text.clone();
            let path = format!("{path}/{name}");
            let outer = Outer { values, place: &place, group: index, slot };
            let (kind, service) = match instance.target {
                Target::Process(target) => {
                    self.check_ranges(
                        &spec.processes[target].params,
                        &instance.args.iter().collect::<Vec<_>>(),
                        values,
                    );
                    let values = bind(spec, &spec.processes[target], &instance.args, values);
                    let group = self.group(target, path, &values, place.clone());
                    (MemberKind::Group(group), spec.processes[target].is_service)
                }
                Target::Module(module) => {
                    let module = &spec.modules[module];
                    (self.leaf(instance, Some(module), path, outer), module.is_service)
                }
                Target::Unknown => (self.leaf(instance, None, path, outer), false),
            };
            members.push(Member { name, kind, service });
        }
        self.tree.groups[index].members = members;
        number(index)
    }

    fn group_place(&mut self, process: usize, values: &[Data], outer: Place, path: &str) -> Place {
        let source = &self.spec.processes[process];
        match &source.host {
            Some(host) => self.named(host, values, path).unwrap_or(outer),
            None => {
                let is_activity = source.actions.as_ref().is_some_and(|it| matches!(it.kind, ExprKind::Chart(_)));
                if !self.tree.groups.is_empty() && !is_activity && self.hostless.insert(process) {
                    let message =
                        format!("`{}` names no host, so it runs on the host of the group around it", source.name.text);
                    self.diagnostics.push(Diagnostic::new(Code::W0105, source.name.span, message));
                }
                outer
            }
        }
    }

    /// Returns the place that a value names. Reports a value that is not a possible name of a host.
    fn named(&mut self, value: &Value, values: &[Data], path: &str) -> Option<Place> {
        match data(value, values)? {
            Data::Plain(Constant::Text(host), _) if host_name_problem(&host).is_none() => {
                let next = number(self.hosts.len());
                self.hosts.entry(host.clone()).or_insert_with(|| {
                    self.tree.hosts.push(host.clone());
                    next
                });
                Some(Place::Named(host))
            }
            other @ (Data::Plain(..) | Data::Record(_)) => {
                let is_new = match &other {
                    // A name is reported only at its first place.
                    Data::Plain(Constant::Text(host), _) => self.refused_hosts.insert(host.clone()),
                    Data::Plain(..) | Data::Record(_) => true,
                };
                if self.hostless_spans.insert(value.span) && is_new {
                    self.diagnostics.push(not_a_host(value.span, path, &other));
                }
                None
            }
        }
    }

    fn leaf(&mut self, instance: &Instance, module: Option<&Module>, path: String, outer: Outer<'_>) -> MemberKind {
        let Outer { values, place: outer, group, slot } = outer;
        let rest = without_host(&instance.args);
        let by_name = rest.iter().find(|arg| arg.name.as_ref().is_some_and(|name| name.text == "host"));
        let host = if rest.len() < instance.args.len() { instance.args.first() } else { by_name };
        let place = host.and_then(|arg| self.named(&arg.value, values, &path)).unwrap_or_else(|| outer.clone());
        let rest = rest.iter().filter(|arg| arg.name.as_ref().is_none_or(|name| name.text != "host"));
        let (rest, params) = (rest.collect::<Vec<_>>(), module.and_then(|module| module.params.as_deref()));
        self.check_ranges(params.unwrap_or_default(), &rest, values);
        let given = self.given(module, &rest, values);
        let exec = self.exec(instance, module, &given);
        let arguments = self.arguments(module, given);
        let leaf = number(self.tree.leaves.len());
        let outcomes = module.iter().flat_map(|module| &module.outcomes).map(|outcome| outcome.name.text.clone());
        let policy = policy(instance, module, &self.spec.processes[self.tree.process_of[group]]);
        let is_started_again = policy.restart != Restart::Temporary;
        self.tree.leaves.push(Leaf {
            path,
            module: module.map_or_else(|| kind_of(instance), |module| module.name.text.clone()),
            host: 0,
            arguments,
            exec: exec.map(|exec| if is_started_again { restarting(&exec) } else { exec }),
            parameters: module.and_then(|module| self.parameters(module)),
            environment: module.map(|module| module.environment.clone()).unwrap_or_default(),
            kind: module.map_or(LeafKind::Controller, |module| module.kind),
            stop_within: module.map_or(STOP_WITHIN, |module| module.times.stop_within),
            outcomes: outcomes.collect(),
            policy,
            keys: Vec::new(),
            external: instance.policies.runs_in.as_ref().map(|runs_in| External {
                deployment: runs_in.deployment.clone(),
                path: runs_in.path.clone().unwrap_or_else(|| format!("main/{}", instance.name.text)),
            }),
        });
        self.tree.place_of.push((group, slot));
        self.leaf_places.push(place);
        MemberKind::Leaf(leaf)
    }

    /// Returns the parameters of a controller whose program the spec starts with `exec`, because its node does not know them. For a program
    /// of ROS 2, there are none, because its parameters are not parameters of its controller.
    fn parameters(&self, module: &Module) -> Option<Vec<Parameter>> {
        let is_started =
            module.kind == LeafKind::Controller && module.exec.as_deref().is_some_and(|exec| form(exec).is_none());
        if module.exec.as_deref().is_some_and(is_action) {
            return Some(Vec::new());
        }
        module.params.as_deref().filter(|_| is_started).and_then(|params| parameters_of(self.spec, params))
    }

    /// Returns the command line of a module, with the values of the parameters in names of ROS 2.
    fn exec(
        &mut self,
        instance: &Instance,
        module: Option<&Module>,
        given: &[(Option<String>, Data)],
    ) -> Option<String> {
        let module = module?;
        let exec = module.exec.as_deref()?;
        let value =
            |name: &str| given.iter().find(|(own, _)| own.as_deref() == Some(name)).and_then(|(_, data)| text_of(data));
        match named(exec, value) {
            Ok(exec) => Some(exec),
            Err(Refused { name, help }) => {
                let message = format!("`{}` cannot have the name {name:?} of ROS 2", instance.name.text);
                self.report_once(Diagnostic::new(Code::E0309, instance.name.span, message).help(help));
                Some(exec.to_owned())
            }
        }
    }

    /// Returns the values for a leaf after its host: first the given values in their order, then the defaults of the other parameters.
    /// Each value has a name, even if it was given by position. It has none only if the parameters are unknown.
    fn given(&mut self, module: Option<&Module>, args: &[&Arg], values: &[Data]) -> Vec<(Option<String>, Data)> {
        let params = module.and_then(|module| module.params.as_deref());
        let form = module.and_then(|module| module.exec.as_deref()).and_then(form);
        let mut places = params.unwrap_or_default().iter();
        let mut given: Vec<(Option<String>, Data)> = Vec::new();
        for arg in args {
            let Some(value) = data(&arg.value, values) else { continue };
            let name = arg.name.as_ref().map(|name| name.text.as_str());
            let param = match name {
                Some(name) => params.and_then(|params| params.iter().find(|param| param.name.text == name)),
                None => places.next(),
            };
            let name = name.or(param.map(|param| param.name.text.as_str()));
            // A program of ROS 2 knows its parameters only by name.
            if name.is_none() && (form.is_some() || matches!(value, Data::Record(_))) {
                self.report_once(nameless(arg.value.span));
            }
            let value = match param {
                Some(param) => filled(self.spec, param, Some(value)),
                None => Some(value),
            };
            given.extend(value.map(|value| (name.map(str::to_owned), value)));
        }
        for param in params.unwrap_or_default() {
            let name = Some(param.name.text.clone());
            if given.iter().all(|(other, _)| *other != name) {
                given.extend(filled(self.spec, param, None).map(|value| (name, value)));
            }
        }
        given
    }

    /// Returns the arguments of a leaf for these values. The parameters of an action of ROS 2 are only parts of its name.
    fn arguments(&self, module: Option<&Module>, given: Vec<(Option<String>, Data)>) -> Vec<Argument> {
        let params = module.and_then(|module| module.params.as_deref());
        let exec = module.and_then(|module| module.exec.as_deref());
        if exec.is_some_and(is_action) {
            return Vec::new();
        }
        let form = exec.and_then(form);
        let mut arguments = Vec::with_capacity(given.len());
        for (name, value) in given {
            match (form, name) {
                (Some(form), Some(name)) => {
                    let param = params.unwrap_or_default().iter().find(|param| param.name.text == name);
                    let written = RosArguments { spec: self.spec, form };
                    written.add(name, param, value, &mut arguments);
                }
                (None, name) | (Some(_), name @ None) => flatten(name, value, &mut arguments),
            }
        }
        arguments
    }

    /// Reports a mistake once, even if its text stands for several leaves.
    pub(super) fn report_once(&mut self, diagnostic: Diagnostic) {
        if self.reported.insert(key(&diagnostic)) {
            self.diagnostics.push(diagnostic);
        }
    }

    /// Numbers the hosts. If the root has no host, it gets the first host that is named anywhere.
    fn finish(mut self) -> Tree {
        if self.tree.hosts.is_empty() {
            self.tree.hosts.push(HOST_DEFAULT.to_owned());
        }
        let hosts = &self.hosts;
        let host = |place: &Place| match place {
            Place::Named(name) => hosts.get(name).copied().unwrap_or(0),
            Place::Root => 0,
        };
        for (group, place) in self.tree.groups.iter_mut().zip(&self.group_places) {
            group.host = host(place);
        }
        for (leaf, place) in self.tree.leaves.iter_mut().zip(&self.leaf_places) {
            leaf.host = host(place);
        }
        self.tree
    }
}

/// Returns the values of a group's parameters. Mistakes in the arguments are already reported.
fn bind(spec: &Spec, process: &Process, args: &[Arg], outer: &[Data]) -> Vec<Data> {
    let mut positional = args.iter().filter(|arg| arg.name.is_none());
    let values = process.params.iter().map(|param| {
        let is_named = |arg: &&Arg| arg.name.as_ref().is_some_and(|name| name.text == param.name.text);
        let given = positional.next().or_else(|| args.iter().find(is_named));
        let given = given.and_then(|arg| data(&arg.value, outer));
        filled(spec, param, given).unwrap_or_else(|| Data::Plain(Constant::Text(param.name.text.clone()), None))
    });
    values.collect()
}

/// Returns the policy of a leaf. In a group with supervision, a program is started again, unless its policy differs or it would lose what
/// its type remembers. A program that may be started again has its own back-off, or else the back-off of the group.
fn policy(instance: &Instance, module: Option<&Module>, group: &Process) -> Policy {
    let mut policy = instance.policies.policy.clone();
    let is_said = instance.policies.restart.is_some() || module.is_some_and(|module| module.remembers);
    if group.supervision.is_some() && !is_said {
        policy.restart = Restart::Transient;
    }
    if policy.restart != Restart::Temporary {
        policy.backoff = policy.backoff.or(group.backoff);
    }
    policy.ready_within = policy.ready_within.or(module.and_then(|module| module.times.ready_within));
    policy
}

fn kind_of(instance: &Instance) -> String {
    instance.kind.as_ref().map(|kind| kind.text.clone()).unwrap_or_default()
}

fn nameless(span: Span) -> Diagnostic {
    let diagnostic = Diagnostic::new(Code::E0216, span, "the name of the parameter for this value is not known");
    diagnostic.help(
        "give the value by name: `name = 5`; the fields of `name = { ... }` become arguments such as `name.field`",
    )
}

/// Returns a value that is a text.
fn text_of(value: &Data) -> Option<String> {
    match value {
        Data::Plain(Constant::Text(text), _) => Some(text.clone()),
        Data::Plain(Constant::Number(_) | Constant::Truth(_) | Constant::Secret(_), _) | Data::Record(_) => None,
    }
}

fn not_a_host(span: Span, path: &str, found: &Data) -> Diagnostic {
    let problem = match found {
        Data::Plain(Constant::Text(host), _) => host_name_problem(host).filter(|_| !host.is_empty()),
        Data::Plain(..) | Data::Record(_) => None,
    };
    let message = match problem {
        Some(problem) => format!("the host of `{path}` has a name that no node can have: {problem}"),
        None => format!("the host of `{path}` is not a name"),
    };
    Diagnostic::new(Code::E0107, span, message).help("write a name or a string: `c1`, `\"c1.example\"`")
}

fn number(index: usize) -> u32 {
    u32::try_from(index).expect("a plan has at most LEAVES_MAX groups and leaves")
}
