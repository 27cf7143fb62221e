//! Parameters that decide the shape of a group, for example the number of instances of an array, or a time. They are
//! called shape parameters.
//!
//! A group with shape parameters is read once for each choice of their values in its instances, as if the parameters
//! were constants. The rest of the checker sees only groups without shape parameters. If a group passes a parameter on
//! to a shape parameter, this parameter is a shape parameter as well.

use super::{ItemCollector, params, process};
use crate::check::diagnostics::{Diagnostics, Rounds};
use crate::check::spec::{Const, Consts, Instance, Kind, Param, Process, Scope, Value, ValueKind};
use crate::check::value::Reader;
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{Constant, LEAVES_MAX};
use crate::source::Span;
use crate::syntax::SyntaxKind::{self, Equals, Number, Text};
use crate::syntax::ast::{Name, Node};
use crate::unit;
use std::collections::{BTreeMap, BTreeSet};

/// The groups with shape parameters, by name.
#[derive(Default)]
pub(in crate::check) struct Templates {
    all: BTreeMap<String, Template>,
}

struct Template {
    node: Node,
    damage: Vec<Span>,
    params: Vec<Param>,
    /// The names of the shape parameters.
    fixed: BTreeSet<String>,
}

/// The values of the shape parameters in one reading of a group.
type ShapeArgs = BTreeMap<String, Value>;

impl Templates {
    /// Finds these groups among the items of all texts. Each item comes with the places where its text is damaged.
    pub(in crate::check) fn new(items: Vec<(Node, Vec<Span>)>, consts: &Consts) -> Self {
        let mut all: BTreeMap<String, Template> = BTreeMap::new();
        for (node, damage) in items.into_iter().filter(|(node, _)| node.kind() == SyntaxKind::Process) {
            let Some(name) = node.title() else { continue };
            // Mistakes in the parameters are reported when the group is read.
            let mut silent = Diagnostics::default();
            let scope = Scope { params: &[], consts, indices: &[] };
            let mut reader = Reader { scope, diagnostics: &mut silent };
            let params = node.child(SyntaxKind::Params).map(|node| params(&node, "", &mut reader));
            let params = params.unwrap_or_default();
            let mut used = BTreeSet::new();
            collect(&node, &mut used);
            let fixed = params.iter().map(|param| param.name.text.clone()).filter(|name| used.contains(name)).collect();
            all.entry(name.text).or_insert(Template { node, damage, params, fixed });
        }
        spread(&mut all);
        all.retain(|_, template| !template.fixed.is_empty());
        Self { all }
    }

    /// Returns whether this item is a group with shape parameters.
    pub(in crate::check) fn contains(&self, item: &Node) -> bool {
        let template = item.title().and_then(|name| self.all.get(&name.text));
        template.is_some_and(|template| template.node.span() == item.span())
    }

    /// Reads each of these groups with the values of its instances. A group without instances is read with its
    /// defaults.
    pub(in crate::check) fn expand(&self, declare: &mut ItemCollector<'_>) {
        let mut reading = Specializer {
            declare,
            fixed: BTreeMap::new(),
            known: BTreeMap::new(),
            rounds: BTreeMap::new(),
            looked_at: 0,
        };
        reading.instances(self);
        for (name, template) in &self.all {
            if !reading.rounds.contains_key(name) {
                let open = template.params.iter().filter(|param| template.fixed.contains(&param.name.text));
                let open: Vec<Name> =
                    open.filter(|param| param.default.is_none()).map(|param| param.name.clone()).collect();
                let values = template.fixed.iter().map(|name| (name.clone(), template.default_or_broken(name)));
                if let Some(process) = reading.read(name, template, values.collect()) {
                    reading.declare.spec.processes[process].open = open;
                }
                reading.instances(self);
            }
        }
    }
}

/// A parameter of a group: the name of the group, and the name of the parameter.
type Place = (String, String);

/// Marks the parameters that are passed on to a shape parameter as shape parameters.
fn spread(all: &mut BTreeMap<String, Template>) {
    let mut sources: BTreeMap<Place, Vec<Place>> = BTreeMap::new();
    for (name, template) in &*all {
        for (own, target) in template.handed_on(all) {
            sources.entry(target).or_default().push((name.clone(), own));
        }
    }
    let fixed =
        all.iter().flat_map(|(name, template)| template.fixed.iter().map(|param| (name.clone(), param.clone())));
    let mut open: Vec<Place> = fixed.collect();
    while let Some(target) = open.pop() {
        for (name, param) in sources.remove(&target).unwrap_or_default() {
            if let Some(template) = all.get_mut(&name)
                && template.fixed.insert(param.clone())
            {
                open.push((name, param));
            }
        }
    }
}

/// Collects the names at places that decide the shape of a group.
fn collect(node: &Node, used: &mut BTreeSet<String>) {
    let kind = node.kind();
    let durations = [
        SyntaxKind::Suffixed,
        SyntaxKind::Wait,
        SyntaxKind::Shield,
        SyntaxKind::Retry,
        SyntaxKind::Trigger,
        SyntaxKind::Asking,
    ];
    if durations.contains(&kind) {
        used.extend(node.children_of(SyntaxKind::Constant).filter_map(|node| bare_name(&node)));
    } else if kind == SyntaxKind::AllOf {
        // `all i in 0..n`
        used.extend(node.names().skip(3).map(|name| name.text));
    } else if kind == SyntaxKind::Count {
        used.extend(node.names().map(|name| name.text));
    }
    node.children().for_each(|part| collect(&part, used));
}

/// Returns the name if a constant is only a name.
fn bare_name(node: &Node) -> Option<String> {
    let is_bare = node.token(Number).is_none() && node.token(Text).is_none() && node.children().next().is_none();
    node.names().next().filter(|_| is_bare).map(|name| name.text)
}

impl Template {
    fn default(&self, name: &str) -> Option<Value> {
        self.params.iter().find(|param| param.name.text == name)?.default.clone()
    }

    fn default_or_broken(&self, name: &str) -> Value {
        let broken = || Value { span: self.node.span(), kind: ValueKind::Broken, dimension: None };
        self.default(name).unwrap_or_else(broken)
    }

    /// Returns the parameters of this group that its instances get as arguments, each with the parameter of the
    /// instance.
    fn handed_on(&self, all: &BTreeMap<String, Self>) -> Vec<(String, Place)> {
        let own: BTreeSet<&str> = self.params.iter().map(|param| param.name.text.as_str()).collect();
        let mut found = Vec::new();
        let sections = self.node.children_of(SyntaxKind::Instances);
        let instances = sections.flat_map(|section| section.children_of(SyntaxKind::Instance).collect::<Vec<_>>());
        for instance in instances.filter(|_| !own.is_empty()) {
            let Some(kind) = instance.child(SyntaxKind::Type).map(|kind| kind.compact_text()) else { continue };
            let Some(target) = all.get(&kind) else { continue };
            let args = instance.child(SyntaxKind::Args);
            let args = args.iter().flat_map(|args| args.children_of(SyntaxKind::Arg).collect::<Vec<_>>());
            for (place, arg) in args.enumerate() {
                let named = arg.token(Equals).and_then(|_| arg.names().next()).map(|name| name.text);
                let param = named.or_else(|| target.params.get(place).map(|param| param.name.text.clone()));
                let value = arg.child(SyntaxKind::Constant).and_then(|value| bare_name(&value));
                if let (Some(param), Some(value)) = (param, value.filter(|value| own.contains(value.as_str()))) {
                    found.push((value, (kind.clone(), param)));
                }
            }
        }
        found
    }

    /// Returns the values that an instance gives to the shape parameters. A missing value without a default is reported
    /// with the arguments.
    fn values(&self, instance: &Instance, outer: (&[Param], Option<&ShapeArgs>)) -> ShapeArgs {
        let positional: Vec<&Value> =
            instance.args.iter().filter(|arg| arg.name.is_none()).map(|arg| &arg.value).collect();
        let value = |name: &String| {
            let place = self.params.iter().position(|param| param.name.text == *name)?;
            let is_named = |arg: &&crate::check::spec::Arg| arg.name.as_ref().is_some_and(|it| it.text == *name);
            let named = instance.args.iter().find(is_named).map(|arg| &arg.value);
            let given = positional.get(place).copied().or(named)?;
            match given.kind {
                ValueKind::Param(index) => outer.1?.get(&outer.0.get(index)?.name.text).cloned(),
                ValueKind::Constant(_) | ValueKind::Record(_) | ValueKind::List(_) | ValueKind::Broken => {
                    Some(given.clone())
                }
            }
        };
        let value = |name: &String| value(name).unwrap_or_else(|| self.default_or_broken(name));
        self.fixed.iter().map(|name| (name.clone(), value(name))).collect()
    }
}

/// Returns whether a value is a number of the parameter's type. Only numbers can be values of shape parameters.
fn is_fit(param: &Param, value: &Value) -> bool {
    let number = match &value.kind {
        ValueKind::Constant(Constant::Number(_)) => Some(value.dimension),
        ValueKind::Constant(Constant::Text(_) | Constant::Truth(_) | Constant::Secret(_))
        | ValueKind::Param(_)
        | ValueKind::Record(_)
        | ValueKind::List(_)
        | ValueKind::Broken => None,
    };
    let kind = param.kind.as_ref().and_then(Kind::name);
    match kind.and_then(unit::of_type) {
        Some((dimension, _)) => number == Some(Some(dimension)),
        None => kind != Some("Number") || number.is_some(),
    }
}

struct Specializer<'a, 'b> {
    declare: &'a mut ItemCollector<'b>,
    /// The values of the shape parameters that each process was read with.
    fixed: BTreeMap<usize, ShapeArgs>,
    /// The index of each process that was read, by its name and its arguments as text.
    known: BTreeMap<(String, String), usize>,
    /// The diagnostics of each group. Equal diagnostics of several readings are reported once.
    rounds: BTreeMap<String, Rounds>,
    /// The number of processes whose instances were already read.
    looked_at: usize,
}

impl Specializer<'_, '_> {
    /// Reads the groups of the instances of all processes. These readings may add processes, which are included.
    fn instances(&mut self, templates: &Templates) {
        while self.looked_at < self.declare.spec.processes.len() {
            let index = self.looked_at;
            self.looked_at += 1;
            for slot in 0..self.declare.spec.processes[index].instances.len() {
                let process = &self.declare.spec.processes[index];
                let instance = &process.instances[slot];
                let Some(name) = instance.kind.as_ref().map(|kind| kind.text.clone()) else { continue };
                let Some(template) = templates.all.get(&name) else { continue };
                let values = template.values(instance, (&process.params, self.fixed.get(&index)));
                if let Some(target) = self.read(&name, template, values) {
                    self.declare.spec.specializations.insert((index, slot), target);
                }
            }
        }
    }

    /// Reads a group with these values, unless it was already read with them.
    fn read(&mut self, name: &str, template: &Template, values: ShapeArgs) -> Option<usize> {
        let shown: Vec<String> = values.iter().map(|(name, value)| format!("{name}={:?}", value.kind)).collect();
        let key = (name.to_owned(), shown.join(","));
        if let Some(&known) = self.known.get(&key) {
            return Some(known);
        }
        if self.known.len() >= LEAVES_MAX {
            if self.known.len() == LEAVES_MAX {
                self.declare.diagnostics.push(too_many(template));
                self.known.insert(key, self.looked_at);
            }
            return None;
        }
        let is_first = !self.rounds.contains_key(name);
        let mut rounds = self.rounds.remove(name).unwrap_or_else(|| self.declare.diagnostics.rounds());
        self.declare.diagnostics.begin_round(&mut rounds);
        let process = self.process(template, &values);
        self.declare.diagnostics.end_round(&mut rounds);
        self.rounds.insert(name.to_owned(), rounds);
        let index = self.declare.spec.processes.len();
        if is_first {
            self.declare.add_process(process?);
        } else {
            self.declare.spec.processes.push(process?);
        }
        if self.declare.spec.processes.len() == index {
            return None;
        }
        self.known.insert(key, index);
        self.fixed.insert(index, values);
        Some(index)
    }

    /// Reads a group with its shape parameters as constants.
    fn process(&mut self, template: &Template, values: &ShapeArgs) -> Option<Process> {
        let ItemCollector { spec, diagnostics } = &mut *self.declare;
        let mut hidden = Vec::new();
        for param in template.params.iter().filter(|param| values.contains_key(&param.name.text)) {
            let value = values[&param.name.text].clone();
            // A value of another type than the type of the parameter is reported with the arguments.
            let kind = if is_fit(param, &value) { value.kind } else { ValueKind::Broken };
            let values = vec![Value { kind, ..value }];
            let named = Const { name: param.name.clone(), values, is_list: false, is_param: true };
            hidden.push((param.name.text.clone(), spec.consts.insert(param.name.text.clone(), named)));
        }
        let process = process::process(&template.node, &template.damage, &spec.consts, diagnostics);
        for (name, constant) in hidden {
            match constant {
                Some(constant) => drop(spec.consts.insert(name, constant)),
                None => drop(spec.consts.remove(&name)),
            }
        }
        process
    }
}

fn too_many(template: &Template) -> Diagnostic {
    let span = template.node.title().map_or(template.node.span(), |name| name.span);
    let message = format!("the groups of the spec are instantiated in more than {LEAVES_MAX} different shapes");
    Diagnostic::new(Code::E0701, span, message)
}
