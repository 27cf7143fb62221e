//! Adds the names inside an activity: states, variables, ports and signals.

use super::super::{Kind, Symbol};
use super::Walk;
use crate::check::is_activity;
use crate::syntax::SyntaxKind;
use crate::syntax::ast::{Name, Node, Token};
use crate::syntax::lex;

impl Walk<'_> {
    /// Declares the states, variables, ports and signals of an activity. From here on, the names have these meanings.
    pub(super) fn declare_activity(&mut self, item: &Node) {
        if is_activity(item) {
            self.declare_in(item);
        }
    }

    fn declare_in(&mut self, node: &Node) {
        for part in node.children() {
            let mut names: Vec<Name> = part.names().collect();
            let declared = match part.kind() {
                SyntaxKind::State => names.pop(),
                SyntaxKind::StateVariable | SyntaxKind::Port => names.drain(..).nth(1),
                SyntaxKind::Trigger if names.first().is_some_and(|word| word.text == "signal") => {
                    names.drain(..).nth(1)
                }
                _ => None,
            };
            let is_new = |name: &Name| self.variables.iter().all(|(known, _)| *known != name.text);
            if let Some(name) = declared.filter(is_new) {
                // The ports are already declared, because other groups name them.
                let symbol = self.tables.declared.get(&name.span).copied().unwrap_or_else(|| {
                    let (symbol, declaration) = (self.index.symbols.len(), name.span);
                    self.index.symbols.push(Symbol { kind: Kind::Variable, name: name.text.clone(), declaration });
                    self.add(&name, symbol);
                    symbol
                });
                self.variables.push((name.text, symbol));
            }
            if [SyntaxKind::State, SyntaxKind::Transition].contains(&part.kind()) {
                self.declare_in(&part);
            }
        }
    }

    /// Adds the names in `look.done`, `parameter look.speed changed` and `message orders`.
    fn trigger(&mut self, node: &Node, names: &[Name]) {
        match names {
            [child, _] if node.token(SyntaxKind::Dot).is_some() => {
                self.instance_name(Some(child));
            }
            [_, child, _, _] if node.token(SyntaxKind::Dot).is_some() => {
                self.instance_name(Some(child));
            }
            _ => self.variable(names.get(1)),
        }
    }

    /// Adds the names of one part of an activity.
    pub(super) fn activity_names(&mut self, node: &Node, names: &[Name]) {
        match node.kind() {
            SyntaxKind::Target if names.first().is_some_and(|word| word.text == "done") => {
                // A name without anything after it is the outcome, or a value.
                let alone = node.child(SyntaxKind::Formula).and_then(|formula| formula.names().next());
                self.outcome(names.get(1).or(alone.as_ref()));
            }
            SyntaxKind::Target | SyntaxKind::Formula | SyntaxKind::Statement => {
                names.iter().for_each(|name| self.variable(Some(name)));
                if let Some(script) = node.token(SyntaxKind::Script) {
                    words(&script).iter().for_each(|name| self.variable(Some(name)));
                }
            }
            SyntaxKind::Trigger => self.trigger(node, names),
            SyntaxKind::Pattern => self.outcome(names.first()),
            _ => {}
        }
    }
}

/// Returns the words of a script that may name variables: neither the field of a record nor a part of a text.
fn words(script: &Token) -> Vec<Name> {
    let text = script.text();
    let tokens: Vec<_> = lex(text).into_iter().filter(|token| !token.kind.is_trivia()).collect();
    let kind = |place: usize| tokens.get(place).map(|token| token.kind);
    let is_field = |place: usize| {
        place.checked_sub(1).and_then(kind) == Some(SyntaxKind::Dot) || kind(place + 1) == Some(SyntaxKind::Colon)
    };
    let names = tokens.iter().enumerate().filter(|(place, token)| token.kind == SyntaxKind::Ident && !is_field(*place));
    let name = |(_, token): (usize, &crate::syntax::Token)| {
        let (start, span) = (script.span().start, script.span());
        let place = crate::source::Span { start: start + token.start, end: start + token.end, ..span };
        Name { text: text[token.start as usize..token.end as usize].to_owned(), span: place }
    };
    names.map(name).collect()
}
