//! Conditions on messages: `where text == "stop" && priority >= 5`.

use super::ActivityReader;
use super::formula::{Infix, infixes, text};
use crate::automaton::Relation;
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::Filter;
use crate::syntax::SyntaxKind::{self, Bang, Constant, Number, Text};
use crate::syntax::ast::Node;

const HELP: &str = "write for example `where text == \"stop\"`, or `where priority >= 5`";

impl ActivityReader<'_, '_> {
    /// Reads a filter and returns its number.
    pub(super) fn filter(&mut self, node: &Node, kind: &str) -> Option<usize> {
        let filter = self.part(node, false, kind)?;
        let known = self.heard.filters.iter().position(|other| *other == filter);
        Some(known.unwrap_or_else(|| {
            self.heard.filters.push(filter);
            self.heard.filters.len() - 1
        }))
    }

    fn part(&mut self, node: &Node, is_negated: bool, kind: &str) -> Option<Filter> {
        let operands: Vec<Node> = node.children_of(SyntaxKind::Formula).collect();
        let operators = infixes(node);
        match (operators.as_slice(), operands.as_slice()) {
            ([], [inner]) => {
                let is_not = node.token(Bang).is_some() || node.names().next().is_some_and(|word| word.text == "not");
                self.part(inner, is_negated != is_not, kind)
            }
            ([Infix::And | Infix::Or, ..], [_, _, ..]) => {
                let parts = operands.iter().map(|operand| Some(Box::new(self.part(operand, is_negated, kind)?)));
                let parts = parts.collect::<Option<Vec<_>>>()?;
                let is_all = (operators[0] == Infix::And) != is_negated;
                Some(if is_all { Filter::All(parts) } else { Filter::Any(parts) })
            }
            ([operator], [left, right]) => match left.compact_text().as_str() {
                "text" => self.about_text(*operator, right, is_negated, kind),
                "priority" => self.about_priority(*operator, right, is_negated),
                _ => self.refuse_filter(left, Code::E0903),
            },
            (_, _) => self.refuse_filter(node, Code::E0904),
        }
    }

    fn about_text(&mut self, operator: Infix, right: &Node, is_negated: bool, kind: &str) -> Option<Filter> {
        let literal = right.child(Constant).and_then(|constant| constant.token(Text));
        let is_equal = operator == Infix::Equal;
        match literal {
            Some(_) if kind != "Text" => {
                let message = format!("the messages of this port are of type `{kind}`, which has no `text`");
                self.report(Diagnostic::new(Code::E0904, right.span(), message));
                None
            }
            Some(literal) if is_equal || operator == Infix::Differs => {
                Some(Filter::Text { text: literal.content(), is_equal: is_equal != is_negated })
            }
            Some(_) | None => self.refuse_filter(right, Code::E0904),
        }
    }

    fn about_priority(&mut self, operator: Infix, right: &Node, is_negated: bool) -> Option<Filter> {
        let constant = right.child(Constant).filter(|constant| constant.token(Number).is_some());
        let Some(constant) = constant else { return self.refuse_filter(right, Code::E0904) };
        let Ok(number) = u8::try_from(self.whole(&constant)?) else {
            let message = format!("`{}` is not a priority, from 0 to 255", text(right));
            self.report(Diagnostic::new(Code::E0904, right.span(), message));
            return None;
        };
        // `p >= n` is the negation of `p < n`, and `p > n` is the negation of `p <= n`.
        let (relation, turned) = match operator {
            Infix::Equal => (Relation::Equal, false),
            Infix::Differs => (Relation::Equal, true),
            Infix::Less => (Relation::Less, false),
            Infix::AtLeast => (Relation::Less, true),
            Infix::AtMost => (Relation::AtMost, false),
            Infix::Greater => (Relation::AtMost, true),
            Infix::Or | Infix::And | Infix::Plus | Infix::Minus | Infix::Times => {
                return self.refuse_filter(right, Code::E0904);
            }
        };
        Some(Filter::Priority { relation, number, is_negated: turned != is_negated })
    }

    fn refuse_filter(&mut self, node: &Node, code: Code) -> Option<Filter> {
        let message = format!("`{}` is not a condition on a message", text(node));
        self.report(Diagnostic::new(code, node.span(), message).help(HELP));
        None
    }
}
