//! The index of all names of a spec: the declaration of each, and every place where it is used.
//!
//! Declarations come from the checker's result. References come from a walk over the trees, which uses this result. So
//! each name, also a lenient one, has the same meaning here as at run time.

mod walk;

use crate::check::spec::{Expr, ExprKind, Param, Process, Spec, Target};
use crate::source::{Origin, Span};
use crate::syntax::ast::{Name, Node};
use std::collections::BTreeMap;

/// The kind of a declaration, with its place in the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Process(usize),
    Module(usize),
    Constant,
    /// A named type.
    Type(usize),
    /// A field of a record.
    Field,
    /// A parameter, with its type and its index.
    Param(Target, usize),
    /// An instance, with its process and its slot. An array has the slot of its first instance.
    Instance(usize, usize),
    /// An external port, with its process and its index.
    Export(usize, usize),
    /// A port of a module, with its module and its index.
    Port(usize, usize),
    /// A connection set, with its process and its index.
    Label(usize, usize),
    /// The variable of `all i in 0..4`.
    Variable,
    /// The name of a result: `find : p => goto with p`.
    Result,
    /// A resource that `using` takes, with its process and its index.
    Resource(usize, usize),
    /// A tag that a process can end with. The same word is always the same outcome, even if
    /// different processes declare it, because a `match` does not distinguish them.
    Outcome,
}

/// A declared name.
#[derive(Clone, Debug)]
pub(super) struct Symbol {
    pub(super) kind: Kind,
    /// The name at its declaration.
    pub(super) name: String,
    pub(super) declaration: Span,
}

/// All names of a spec, of its files and of the interfaces.
#[derive(Debug, Default)]
pub(super) struct Index {
    pub(super) symbols: Vec<Symbol>,
    /// The symbol at each span. Declarations are included.
    places: BTreeMap<Span, usize>,
}

/// Tables for looking names up, by the symbol that they belong to and their text.
#[derive(Debug, Default)]
struct Tables {
    /// The symbol that is declared at each span.
    declared: BTreeMap<Span, usize>,
    consts: BTreeMap<String, usize>,
    /// The instances of each process, by their exact names.
    instances: BTreeMap<(usize, String), usize>,
    /// The connection sets of an instance, by label.
    labels: BTreeMap<(usize, String), usize>,
    outcomes: BTreeMap<String, usize>,
    /// The symbols of resources, by process and name.
    resources: BTreeMap<(usize, String), usize>,
    /// The instances that event actions run, by the place of the action.
    runs: BTreeMap<Span, usize>,
}

impl Index {
    /// Makes the index. `text` returns the text of a span.
    pub(super) fn new<'t>(model: &Spec, trees: &[Node], text: &dyn Fn(Span) -> &'t str) -> Self {
        let mut index = Self::default();
        let mut tables = Tables::default();
        for (number, process) in model.processes.iter().enumerate() {
            index.add(&mut tables, Kind::Process(number), &process.name);
            index.add_params(&mut tables, Target::Process(number), process.params.iter());
            index.add_process(&mut tables, number, process, text);
            if let Some(chart) = process.chart() {
                for port in &chart.ports {
                    index.add(&mut tables, Kind::Variable, &port.name);
                }
                for outcome in &chart.outcomes {
                    index.add_outcome(&mut tables, &outcome.name);
                }
            }
        }
        for (number, module) in model.modules.iter().enumerate() {
            index.add(&mut tables, Kind::Module(number), &module.name);
            index.add_params(&mut tables, Target::Module(number), module.declared());
            for (port, declared) in module.ports.iter().enumerate() {
                index.add(&mut tables, Kind::Port(number, port), &declared.name);
            }
            for outcome in &module.outcomes {
                index.add_outcome(&mut tables, &outcome.name);
            }
        }
        for (name, constant) in &model.consts {
            let symbol = index.add(&mut tables, Kind::Constant, &constant.name);
            tables.consts.insert(name.clone(), symbol);
        }
        for (number, named) in model.types.iter().enumerate() {
            index.add(&mut tables, Kind::Type(number), &named.name);
        }
        for field in model.fields() {
            index.add(&mut tables, Kind::Field, &field.name);
        }
        for (used, declared) in &model.field_uses {
            if let Some(&field) = tables.declared.get(declared) {
                index.places.insert(*used, field);
            }
        }
        walk::walk(&mut index, &tables, model, trees);
        index
    }

    /// Returns the symbol at a byte offset of the spec. The offset may be directly after the last character of the
    /// name.
    pub(super) fn at(&self, offset: usize) -> Option<usize> {
        self.place_at(offset).map(|(_, symbol)| symbol)
    }

    /// Returns the symbol at a byte offset of the spec, with the span of the name.
    pub(super) fn place_at(&self, offset: usize) -> Option<(Span, usize)> {
        let offset = u32::try_from(offset).ok()?;
        let last = Span { origin: Origin::Spec, start: offset, end: u32::MAX };
        let mut before = self.places.range(..=last).rev();
        let found = before.next().filter(|(span, _)| span.origin == Origin::Spec && span.end >= offset);
        found.map(|(&span, &symbol)| (span, symbol))
    }

    /// Returns the symbol with exactly this span.
    pub(super) fn of(&self, span: Span) -> Option<&Symbol> {
        self.places.get(&span).map(|&symbol| &self.symbols[symbol])
    }

    /// Returns all names and their meanings, in the order of the text.
    pub(super) fn all(&self) -> impl Iterator<Item = (Span, usize)> + '_ {
        self.places.iter().map(|(&span, &symbol)| (span, symbol))
    }

    /// Returns the places of a symbol.
    pub(super) fn places(&self, symbol: usize) -> impl Iterator<Item = Span> + '_ {
        self.all().filter(move |(_, other)| *other == symbol).map(|(span, _)| span)
    }

    /// Adds a declaration, unless it exists. All instances of an array are declared in one place.
    fn add(&mut self, tables: &mut Tables, kind: Kind, name: &Name) -> usize {
        if let Some(&known) = tables.declared.get(&name.span) {
            return known;
        }
        let symbol = self.symbols.len();
        self.symbols.push(Symbol { kind, name: name.text.clone(), declaration: name.span });
        tables.declared.insert(name.span, symbol);
        self.places.insert(name.span, symbol);
        symbol
    }

    fn add_outcome(&mut self, tables: &mut Tables, name: &Name) {
        match tables.outcomes.get(&name.text) {
            Some(&known) => {
                self.places.insert(name.span, known);
            }
            None => {
                let symbol = self.add(tables, Kind::Outcome, name);
                tables.outcomes.insert(name.text.clone(), symbol);
            }
        }
    }

    fn add_params<'p>(&mut self, tables: &mut Tables, owner: Target, params: impl Iterator<Item = &'p Param>) {
        for (place, param) in params.enumerate() {
            self.add(tables, Kind::Param(owner, place), &param.name);
        }
    }

    fn add_process<'t>(
        &mut self,
        tables: &mut Tables,
        number: usize,
        process: &Process,
        text: &dyn Fn(Span) -> &'t str,
    ) {
        let mut of_slot = Vec::with_capacity(process.instances.len());
        for (slot, instance) in process.instances.iter().enumerate() {
            let written = text(instance.name.span).to_owned();
            let symbol = self.add(
                tables,
                Kind::Instance(number, slot),
                &Name { text: written.clone(), span: instance.name.span },
            );
            of_slot.push(symbol);
            tables.instances.entry((number, written)).or_insert(symbol);
            tables.instances.entry((number, instance.name.text.clone())).or_insert(symbol);
        }
        for (place, export) in process.exports.iter().enumerate() {
            self.add(tables, Kind::Export(number, place), &export.name);
        }
        for (place, resource) in process.resources.iter().enumerate() {
            let symbol = self.add(tables, Kind::Resource(number, place), resource);
            tables.resources.insert((number, resource.text.clone()), symbol);
        }
        for (place, set) in process.sets.iter().enumerate() {
            let (Some(label), Some(owner)) = (&set.label, set.owner) else { continue };
            let symbol = self.add(tables, Kind::Label(number, place), label);
            tables.labels.entry((of_slot[owner], label.text.clone())).or_insert(symbol);
        }
        if let Some(actions) = &process.actions {
            collect_runs(actions, &of_slot, tables);
        }
    }
}

fn collect_runs(expr: &Expr, of_slot: &[usize], tables: &mut Tables) {
    if let ExprKind::Run(slot, _) = &expr.kind {
        tables.runs.entry(expr.span).or_insert(of_slot[*slot]);
    }
    expr.parts().into_iter().for_each(|part| collect_runs(part, of_slot, tables));
}
