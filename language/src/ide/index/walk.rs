//! Finds the references to each name in the trees.
//!
//! The meaning of a node's names follows from the kind of the node and the order of the names. Other kinds of nodes
//! have only parts and no names.

mod activity;

use super::{Index, Kind, Symbol, Tables};
use crate::check::spec::{Param, Spec, Target};
use crate::check::{Word, is_sentence_word, words_of};
use crate::syntax::SyntaxKind::{self, DotDot, Equals, Number};
use crate::syntax::ast::{Name, Node, catches};
use std::collections::BTreeMap;

/// Adds every reference in the trees.
pub(super) fn walk(index: &mut Index, tables: &Tables, spec: &Spec, trees: &[Node]) {
    let types = spec.processes.iter().flat_map(|process| &process.instances);
    let types = types.filter_map(|instance| {
        let name = match instance.target {
            Target::Process(process) => &spec.processes[process].name,
            Target::Module(module) => &spec.modules[module].name,
            Target::Unknown => return None,
        };
        Some((instance.kind.as_ref()?.span, *tables.declared.get(&name.span)?))
    });
    let types: BTreeMap<_, _> = types.collect();
    for tree in trees {
        for item in tree.children() {
            let enclosing = item.title().and_then(|title| tables.declared.get(&title.span));
            let mut process = match enclosing.map(|&symbol| index.symbols[symbol].kind) {
                Some(Kind::Process(process)) => Some(process),
                Some(_) | None => None,
            };
            if let Some(title) = item.title().filter(|_| item.kind() == SyntaxKind::Verify) {
                process = spec.processes.iter().position(|process| process.name.text == title.text);
                let declared = process.map(|process| tables.declared[&spec.processes[process].name.span]);
                declared.map(|symbol| index.places.entry(title.span).or_insert(symbol));
            }
            let mut walk = Walk { index, tables, spec, types: &types, process, variables: Vec::new() };
            walk.declare_activity(&item);
            walk.node(&item);
        }
    }
}

struct Walk<'a> {
    index: &'a mut Index,
    tables: &'a Tables,
    spec: &'a Spec,
    /// The symbols of the types of instances, by their spans.
    types: &'a BTreeMap<crate::Span, usize>,
    /// The process around the node.
    process: Option<usize>,
    /// The variables of the `all` and `race` around the node, and the names of results.
    variables: Vec<(String, usize)>,
}

impl Walk<'_> {
    fn node(&mut self, node: &Node) {
        let names: Vec<Name> = node.names().collect();
        match node.kind() {
            SyntaxKind::Host => self.value(names.get(1)),
            SyntaxKind::Type => self.type_name(node),
            SyntaxKind::Constant if node.token(Number).is_none() => self.value(names.first()),
            SyntaxKind::Count => self.number(names.first()),
            SyntaxKind::Index => self.variable(names.first()),
            SyntaxKind::Instance => return self.instance(node),
            SyntaxKind::Owner => {
                self.instance_name(names.first());
            }
            SyntaxKind::Endpoint => self.endpoint(&names),
            // The arms of `else match` are causes of failures.
            SyntaxKind::Match if catches(node) => {
                let arms = node.children_of(SyntaxKind::Arm);
                let bodies: Vec<Node> = arms.flat_map(|arm| arm.children().collect::<Vec<_>>()).collect();
                return bodies.iter().for_each(|body| self.node(body));
            }
            SyntaxKind::Arm => {
                self.outcome(names.first());
                return self.inside_of(names.get(1), Kind::Result, node);
            }
            SyntaxKind::Named => return self.inside_of(names.first(), Kind::Result, node),
            SyntaxKind::Until => names.iter().skip(1).for_each(|name| self.outcome(Some(name))),
            SyntaxKind::Using => self.resources(node),
            SyntaxKind::Run => return self.run(node, names.first()),
            SyntaxKind::AllOf => return self.all_of(node),
            SyntaxKind::Sentence => self.sentence(node),
            _ => self.activity_names(node, &names),
        }
        for part in node.children() {
            self.node(&part);
        }
    }

    /// Adds the processes that a sentence names, also with the processes around them: `hit.force`.
    fn sentence(&mut self, node: &Node) {
        let own = self.process;
        let mut before: Option<Word> = None;
        for word in words_of(node) {
            let is_behind_dot = before.as_ref().is_some_and(|before| before.text == ".");
            if word.is_name && !is_behind_dot {
                self.process = own;
            }
            let name = Name { text: word.text.clone(), span: word.span };
            let is_free = is_behind_dot || word.is_formula || !is_sentence_word(&word.text);
            if let Some(symbol) =
                Some(&name).filter(|_| word.is_name && is_free).and_then(|name| self.instance_name(Some(name)))
            {
                self.process = match self.target(symbol) {
                    Target::Process(process) => Some(process),
                    Target::Module(_) | Target::Unknown => None,
                };
            }
            before = Some(word);
        }
        self.process = own;
    }

    fn add(&mut self, name: &Name, symbol: usize) {
        self.index.places.entry(name.span).or_insert(symbol);
    }

    /// Adds a name in the position of a value. It may be a variable, a parameter, a named constant, or a literal.
    fn value(&mut self, name: Option<&Name>) {
        let Some(name) = name else { return };
        if self.variables.iter().any(|(known, _)| *known == name.text) {
            return self.variable(Some(name));
        }
        if self.param(name) {
            return;
        }
        self.constant(Some(name));
        // The name may be a resource that is handed to a member.
        let resource = self.process.and_then(|process| self.tables.resources.get(&(process, name.text.clone())));
        if let Some(&symbol) = resource {
            self.add(name, symbol);
        }
    }

    /// Adds a name in the position of a whole number: a parameter, or a named constant.
    fn number(&mut self, name: Option<&Name>) {
        if name.is_some_and(|name| !self.param(name)) {
            self.constant(name);
        }
    }

    /// Adds a parameter of the process around the node. Returns whether the name is such a parameter.
    fn param(&mut self, name: &Name) -> bool {
        let params: &[Param] = self.process.map_or(&[], |process| &self.spec.processes[process].params);
        let declared = params.iter().find(|param| param.name.text == name.text);
        declared.inspect(|param| self.add(name, self.tables.declared[&param.name.span])).is_some()
    }

    fn constant(&mut self, name: Option<&Name>) {
        if let Some((name, &symbol)) = name.and_then(|name| Some((name, self.tables.consts.get(&name.text)?))) {
            self.add(name, symbol);
        }
    }

    fn variable(&mut self, name: Option<&Name>) {
        let Some(name) = name else { return };
        if let Some(&(_, symbol)) = self.variables.iter().rev().find(|(known, _)| *known == name.text) {
            self.add(name, symbol);
        }
    }

    /// Adds the tag of an arm of `match`.
    fn outcome(&mut self, name: Option<&Name>) {
        if let Some((name, &symbol)) = name.and_then(|name| Some((name, self.tables.outcomes.get(&name.text)?))) {
            self.add(name, symbol);
        }
    }

    /// Adds the names in `using(arm, gripper)`.
    fn resources(&mut self, node: &Node) {
        let Some(process) = self.process else { return };
        for name in node.children_of(SyntaxKind::Resources).flat_map(|list| list.names().collect::<Vec<_>>()) {
            if let Some(&symbol) = self.tables.resources.get(&(process, name.text.clone())) {
                self.add(&name, symbol);
            }
        }
    }

    fn type_name(&mut self, node: &Node) {
        let Some(name) = node.names().next() else { return };
        // Types of instances have a separate table.
        let is_kind = node.syntax().parent().is_none_or(|parent| parent.kind() != SyntaxKind::Instance);
        let named = self.spec.named(&name.text, name.span.origin).filter(|_| is_kind);
        let named = named.and_then(|named| self.tables.declared.get(&self.spec.types[named].name.span));
        if let Some(&symbol) = self.types.get(&node.span()).or(named) {
            self.add(&name, symbol);
        }
    }

    /// Adds an instance by its exact name.
    fn instance_name(&mut self, name: Option<&Name>) -> Option<usize> {
        let (name, process) = (name?, self.process?);
        let symbol = *self.tables.instances.get(&(process, name.text.clone()))?;
        self.add(name, symbol);
        Some(symbol)
    }

    /// Returns the type of an instance symbol.
    fn target(&self, symbol: usize) -> Target {
        match self.index.symbols[symbol].kind {
            Kind::Instance(process, slot) => self.spec.processes[process].instances[slot].target,
            _ => Target::Unknown,
        }
    }

    /// Adds the names in `name instof Type(param = value)`.
    fn instance(&mut self, node: &Node) {
        let declared = node.names().find_map(|name| self.tables.declared.get(&name.span).copied());
        let target = declared.map_or(Target::Unknown, |symbol| self.target(symbol));
        let params = match target {
            Target::Process(process) => self.spec.processes[process].params.as_slice(),
            Target::Module(module) => self.spec.modules[module].params.as_deref().unwrap_or_default(),
            Target::Unknown => &[],
        };
        for arg in node.children_of(SyntaxKind::Args).flat_map(|args| args.children().collect::<Vec<_>>()) {
            let name = arg.token(Equals).and_then(|_| arg.names().next());
            let param = |name: &Name| params.iter().find(|param| param.name.text == name.text);
            if let Some((name, param)) = name.and_then(|name| param(&name).map(|param| (name, param))) {
                self.add(&name, self.tables.declared[&param.name.span]);
            }
        }
        for part in node.children() {
            self.node(&part);
        }
    }

    /// Adds the names in `instance, Port`.
    fn endpoint(&mut self, names: &[Name]) {
        let symbol = self.instance_name(names.first());
        let (Some(symbol), Some(port)) = (symbol, names.get(1)) else { return };
        let spec = self.spec;
        let declared = match self.target(symbol) {
            Target::Process(process) => {
                let process = &spec.processes[process];
                let ports = process.chart().into_iter().flat_map(|chart| &chart.ports).map(|port| &port.name);
                let mut names = process.exports.iter().map(|export| &export.name).chain(ports);
                names.find(|name| name.text == port.text)
            }
            Target::Module(module) => {
                let ports = &spec.modules[module].ports;
                ports.iter().map(|port| &port.name).find(|name| name.text == port.text)
            }
            Target::Unknown => None,
        };
        if let Some(declared) = declared {
            self.add(port, self.tables.declared[&declared.span]);
        }
    }

    /// Adds the names in `name[labels]` or `name[index][labels]`.
    fn run(&mut self, node: &Node, name: Option<&Name>) {
        let lenient = self.tables.runs.get(&node.span()).copied();
        let symbol = match (self.instance_name(name), lenient, name) {
            (Some(symbol), _, _) => symbol,
            (None, Some(symbol), Some(name)) => {
                self.add(name, symbol);
                symbol
            }
            (None, _, _) => return,
        };
        let is_array = self.is_array(symbol, name);
        for (place, brackets) in node.children_of(SyntaxKind::Labels).enumerate() {
            for label in brackets.names() {
                if place == 0 && is_array {
                    self.variable(Some(&label));
                } else if let Some(&set) = self.tables.labels.get(&(symbol, label.text.clone())) {
                    self.add(&label, set);
                }
            }
        }
    }

    /// Returns whether the name means all instances of an array.
    fn is_array(&self, symbol: usize, name: Option<&Name>) -> bool {
        let Kind::Instance(process, slot) = self.index.symbols[symbol].kind else { return false };
        let Symbol { name: declared, .. } = &self.index.symbols[symbol];
        let element = &self.spec.processes[process].instances[slot].name.text;
        element != declared && name.is_some_and(|name| name.text == *declared)
    }

    /// Adds the names in `all i in 0..4 (p[i])`.
    fn all_of(&mut self, node: &Node) {
        let names: Vec<Name> = node.names().collect();
        let dots = node.token(DotDot).map(|token| token.span().start);
        let is_bound = |name: &&Name| name.text != "in" && dots.is_some();
        for bound in names.iter().skip(2).filter(is_bound) {
            self.number(Some(bound));
        }
        self.inside_of(names.get(1), Kind::Variable, node);
    }

    /// Visits the parts of a node, in which `name` is known.
    fn inside_of(&mut self, name: Option<&Name>, kind: Kind, node: &Node) {
        if let Some(name) = name {
            let symbol = self.index.symbols.len();
            self.index.symbols.push(Symbol { kind, name: name.text.clone(), declaration: name.span });
            self.add(name, symbol);
            self.variables.push((name.text.clone(), symbol));
        }
        for part in node.children() {
            self.node(&part);
        }
        if name.is_some() {
            self.variables.pop();
        }
    }
}
