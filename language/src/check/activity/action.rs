//! The actions of transitions: assignments, values that are kept and sent, signals, and lines that people read.

use super::domain::Domain;
use super::formula::{Infix, infixes};
use super::{ActivityReader, script};
use crate::automaton::{Action, Formula, Fragment, ValueSource};
use crate::diagnostic::{Code, Diagnostic};
use crate::syntax::SyntaxKind::{self, Constant, Dot, Equals, LeftParen, Minus, Number, Plus, Text};
use crate::syntax::ast::{Name, Node};

impl ActivityReader<'_, '_> {
    /// Reads the actions of a transition. `event` is the name of the value of the event.
    pub(super) fn actions(&mut self, node: &Node, event: Option<&str>) -> Vec<Action> {
        let blocks: Vec<Node> = node.children_of(SyntaxKind::Block).collect();
        let statements: Vec<Node> =
            blocks.iter().flat_map(|block| block.children_of(SyntaxKind::Statement).collect::<Vec<_>>()).collect();
        statements.iter().filter_map(|statement| self.statement(statement, event)).collect()
    }

    fn statement(&mut self, node: &Node, event: Option<&str>) -> Option<Action> {
        let names: Vec<Name> = node.names().collect();
        let first = names.first()?;
        let formula = node.child(SyntaxKind::Formula);
        if node.token(Dot).is_some() {
            let Some(output) = self.interface.outputs.iter().position(|port| port.name.text == first.text) else {
                self.report_unknown_port(first, "output");
                return None;
            };
            let value = self.sent(&formula?, output, event)?;
            return Some(Action::Send { output, value });
        }
        if node.token(LeftParen).is_some() {
            return Some(Action::Log(self.fragments(&formula?)?));
        }
        if node.token(Equals).is_none() {
            let name = names.get(1)?;
            return self.raised(name);
        }
        if let Some(script) = node.token(SyntaxKind::Script) {
            return script::read(self, first, &script, node);
        }
        if let Some(slot) = self.kept(&first.text) {
            return Some(Action::Keep { slot, value: self.value_of(&formula?, event)? });
        }
        let Some((variable, domain)) = self.variables.get(&first.text).cloned() else {
            self.report_unknown(first, "a variable");
            return None;
        };
        let formula = self.value_for(&formula?, &domain)?;
        let own = || Box::new(Formula::Variable(variable));
        let formula = if node.token(Plus).is_some() {
            Formula::Add(own(), Box::new(formula))
        } else if node.token(Minus).is_some() {
            Formula::Subtract(own(), Box::new(formula))
        } else {
            formula
        };
        Some(Action::Assign { variable, formula })
    }

    /// Reads a value that is sent: a kept value, the value of the event, a text of several parts, or a number.
    fn sent(&mut self, node: &Node, output: usize, event: Option<&str>) -> Option<ValueSource> {
        let name = node.names().next().filter(|_| node.children().next().is_none());
        let is_handed_on =
            name.is_some_and(|name| event == Some(name.text.as_str()) || !self.variables.contains_key(&name.text));
        let is_computed = !infixes(node).is_empty() || !is_handed_on && node.child(Constant).is_none();
        let kind = self.interface.outputs[output].kind.as_ref().map(|kind| kind.text.as_str());
        match kind {
            Some("Number") if is_computed || node.child(Constant).is_some_and(|it| it.token(Number).is_some()) => {
                Some(ValueSource::Number(self.formula(node)?.0))
            }
            Some("Text") if is_computed => Some(ValueSource::Text(self.fragments(node)?)),
            _ => self.value_of(node, event),
        }
    }

    /// Returns the names of the values of a variable, if the formula is only this variable.
    fn names_of(&self, node: &Node) -> Option<Vec<String>> {
        let (_, domain) = self.variables.get(&node.compact_text())?;
        match domain {
            Domain::Truth => Some(["false", "true"].map(str::to_owned).to_vec()),
            Domain::Names(names) => Some(names.clone()),
            Domain::Range(..) | Domain::Opaque => None,
        }
    }

    /// Reads `raise found;`.
    fn raised(&mut self, name: &Name) -> Option<Action> {
        let Some(signal) = self.heard.signals.iter().position(|(known, _)| known.text == name.text) else {
            let message = format!("no transition waits for the signal `{}`", name.text);
            let help = format!("write `on signal {} -> STATE;`", name.text);
            self.report(Diagnostic::new(Code::E0903, name.span, message).help(help));
            return None;
        };
        self.heard.signals[signal].1 = true;
        Some(Action::Raise(signal))
    }

    /// Reads the parts of `"now " + tries`.
    fn fragments(&mut self, node: &Node) -> Option<Vec<Fragment>> {
        let operators = infixes(node);
        let is_text = |node: &Node| node.child(Constant).is_some_and(|constant| constant.token(Text).is_some());
        let parts: Vec<Node> = node.children_of(SyntaxKind::Formula).collect();
        let is_joined = operators.iter().all(|operator| *operator == Infix::Plus) && parts.iter().any(is_text);
        let parts = if is_joined { parts } else { vec![node.clone()] };
        let fragment = |part: &Node| {
            if is_text(part) {
                let text = part.child(Constant)?.token(Text)?.content();
                return Some(Fragment::Text(text));
            }
            let formula = self.formula(part)?.0;
            Some(match self.names_of(part) {
                Some(names) => Fragment::Name(formula, names),
                None => Fragment::Number(formula),
            })
        };
        parts.iter().map(fragment).collect()
    }
}
