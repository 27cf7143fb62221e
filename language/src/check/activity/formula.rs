//! Conditions, and formulas of assigned values.

use super::ActivityReader;
use super::domain::Domain;
use crate::automaton::{Formula, Relation};
use crate::diagnostic::{Code, Diagnostic};
use crate::syntax::SyntaxKind::{
    self, Ampersand, Bang, Bar, Constant, Equals, Greater, Ident, Less, Minus, Number, Plus, Star,
};
use crate::syntax::ast::{Name, Node, Token};

/// The sort of a formula.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sort {
    Truth,
    Number,
}

impl Sort {
    fn describe(self) -> &'static str {
        match self {
            Self::Truth => "a condition",
            Self::Number => "a number",
        }
    }
}

/// An operand of an operator.
struct Operand {
    formula: Formula,
    sort: Sort,
    node: Node,
}

/// An operator between two operands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Infix {
    Or,
    And,
    Equal,
    Differs,
    Less,
    AtMost,
    Greater,
    AtLeast,
    Plus,
    Minus,
    Times,
}

/// Returns the operators between the operands of a formula, from left to right. Operators in its operands are not
/// included.
pub(super) fn infixes(node: &Node) -> Vec<Infix> {
    let tokens: Vec<Token> = node.tokens().collect();
    let mut found = Vec::new();
    let mut index = 0;
    while let Some(token) = tokens.get(index) {
        let pairs = tokens.get(index + 1).is_some_and(|next| next.span().start == token.span().end);
        let next = tokens.get(index + 1).filter(|_| pairs).map(Token::kind);
        let infix = operator(token, next);
        index += 1;
        if let Some((infix, length)) = infix {
            index += length - 1;
            found.push(infix);
        }
    }
    found
}

fn operator(token: &Token, next: Option<SyntaxKind>) -> Option<(Infix, usize)> {
    let kind = token.kind();
    let is_pair = next == Some(Equals);
    if kind == Ident {
        return match token.text() {
            "or" => Some((Infix::Or, 1)),
            "and" => Some((Infix::And, 1)),
            _ => None,
        };
    }
    let pairs = [
        (Bar, Infix::Or),
        (Ampersand, Infix::And),
        (Equals, Infix::Equal),
        (Bang, Infix::Differs),
        (Less, Infix::AtMost),
        (Greater, Infix::AtLeast),
    ];
    let is_double = next == Some(kind) && [Bar, Ampersand, Equals].contains(&kind);
    if is_double || is_pair && [Bang, Less, Greater].contains(&kind) {
        return pairs.into_iter().find(|(first, _)| *first == kind).map(|(_, infix)| (infix, 2));
    }
    let singles = [
        (Less, Infix::Less),
        (Greater, Infix::Greater),
        (Plus, Infix::Plus),
        (Minus, Infix::Minus),
        (Star, Infix::Times),
    ];
    singles.into_iter().find(|(sign, _)| *sign == kind).map(|(_, infix)| (infix, 1))
}

impl ActivityReader<'_, '_> {
    /// Reads a condition.
    pub(super) fn condition(&mut self, node: &Node) -> Option<Formula> {
        self.of_sort(node, Sort::Truth)
    }

    /// Reads a formula for a variable of this domain.
    pub(super) fn value_for(&mut self, node: &Node, domain: &Domain) -> Option<Formula> {
        let sort = if *domain == Domain::Truth { Sort::Truth } else { Sort::Number };
        self.of_sort(node, sort)
    }

    fn of_sort(&mut self, node: &Node, wanted: Sort) -> Option<Formula> {
        let (formula, sort) = self.formula(node)?;
        if sort != wanted {
            let message =
                format!("`{}` is {}, and this place needs {}", text(node), sort.describe(), wanted.describe());
            self.report(Diagnostic::new(Code::E0904, node.span(), message));
            return None;
        }
        Some(formula)
    }

    /// Reads any formula. Returns it with its sort.
    pub(super) fn formula(&mut self, node: &Node) -> Option<(Formula, Sort)> {
        let operands: Vec<Node> = node.children_of(SyntaxKind::Formula).collect();
        let operators = infixes(node);
        if operators.is_empty() {
            return self.operand(node, &operands);
        }
        if let [infix @ (Infix::Or | Infix::And), rest @ ..] = operators.as_slice()
            && rest.iter().all(|other| other == infix)
        {
            return self.joined_all(*infix, operands, node);
        }
        let mut operands = operands.into_iter();
        let first = operands.next()?;
        let (formula, sort) = self.formula(&first)?;
        let mut left = Operand { formula, sort, node: first };
        for (operator, right) in operators.into_iter().zip(operands) {
            let (formula, sort) = self.formula(&right)?;
            let right = Operand { formula, sort, node: right };
            let (formula, sort) = self.joined(operator, left, right)?;
            left = Operand { formula, sort, node: node.clone() };
        }
        Some((left.formula, left.sort))
    }

    /// Joins conditions with one operator between them. The result is a tree of the least height.
    fn joined_all(&mut self, infix: Infix, nodes: Vec<Node>, whole: &Node) -> Option<(Formula, Sort)> {
        let mut level = Vec::new();
        for node in nodes {
            let (formula, sort) = self.formula(&node)?;
            level.push(Operand { formula, sort, node });
        }
        while level.len() > 1 {
            let mut operands = std::mem::take(&mut level).into_iter();
            while let Some(left) = operands.next() {
                let Some(right) = operands.next() else {
                    level.push(left);
                    break;
                };
                let (formula, sort) = self.joined(infix, left, right)?;
                level.push(Operand { formula, sort, node: whole.clone() });
            }
        }
        level.pop().map(|operand| (operand.formula, operand.sort))
    }

    fn joined(&mut self, operator: Infix, left: Operand, right: Operand) -> Option<(Formula, Sort)> {
        let wanted = match operator {
            Infix::Or | Infix::And => Sort::Truth,
            Infix::Equal | Infix::Differs => left.sort,
            Infix::Less
            | Infix::AtMost
            | Infix::Greater
            | Infix::AtLeast
            | Infix::Plus
            | Infix::Minus
            | Infix::Times => Sort::Number,
        };
        if let Some(Operand { sort, node, .. }) = [&left, &right].into_iter().find(|operand| operand.sort != wanted) {
            let (is, wanted) = (sort.describe(), wanted.describe());
            let message = format!("`{}` is {is}, and this place needs {wanted}", text(node));
            self.report(Diagnostic::new(Code::E0904, node.span(), message));
            return None;
        }
        let (left, right) = (Box::new(left.formula), Box::new(right.formula));
        let truth = |formula: Formula| Some((formula, Sort::Truth));
        let number = |formula: Formula| Some((formula, Sort::Number));
        match operator {
            Infix::Or => truth(Formula::Or(left, right)),
            Infix::And => truth(Formula::And(left, right)),
            Infix::Equal => truth(Formula::Compare(Relation::Equal, left, right)),
            Infix::Differs => truth(Formula::Not(Box::new(Formula::Compare(Relation::Equal, left, right)))),
            Infix::Less => truth(Formula::Compare(Relation::Less, left, right)),
            Infix::AtMost => truth(Formula::Compare(Relation::AtMost, left, right)),
            Infix::Greater => truth(Formula::Compare(Relation::Less, right, left)),
            Infix::AtLeast => truth(Formula::Compare(Relation::AtMost, right, left)),
            Infix::Plus => number(Formula::Add(left, right)),
            Infix::Minus => number(Formula::Subtract(left, right)),
            Infix::Times => number(Formula::Multiply(left, right)),
        }
    }

    /// Reads a formula that has no operator between operands.
    fn operand(&mut self, node: &Node, operands: &[Node]) -> Option<(Formula, Sort)> {
        if let Some(constant) = node.child(Constant) {
            if constant.token(Number).is_some() {
                return Some((Formula::Number(i64::from(self.whole(&constant)?)), Sort::Number));
            }
            let message = format!("`{}` is neither a number nor a condition", constant.compact_text());
            self.report(Diagnostic::new(Code::E0904, constant.span(), message));
            return None;
        }
        let names: Vec<Name> = node.names().collect();
        let is_not = node.token(Bang).is_some() || names.first().is_some_and(|name| name.text == "not");
        if let [inner] = operands {
            let (formula, sort) = self.formula(inner)?;
            if !is_not {
                return Some((formula, sort));
            }
            if sort == Sort::Truth {
                return Some((Formula::Not(Box::new(formula)), Sort::Truth));
            }
            let message = format!("`{}` is a number, and only a condition can be negated", text(inner));
            self.report(Diagnostic::new(Code::E0904, inner.span(), message));
            return None;
        }
        match names.as_slice() {
            [word, state] if word.text == "in" => Some((Formula::In(self.state_named(state)?), Sort::Truth)),
            [name, ..] => self.named(name),
            [] => None,
        }
    }

    /// Reads the name of a variable, or of a named value.
    fn named(&mut self, name: &Name) -> Option<(Formula, Sort)> {
        if let Some((variable, domain)) = self.variables.get(&name.text) {
            let sort = if *domain == Domain::Truth { Sort::Truth } else { Sort::Number };
            return Some((Formula::Variable(*variable), sort));
        }
        if let Some(&number) = self.values.get(&name.text) {
            let is_truth = matches!(name.text.as_str(), "true" | "false");
            return Some((Formula::Number(number), if is_truth { Sort::Truth } else { Sort::Number }));
        }
        if self.kept(&name.text).is_some() || self.interface.inputs.iter().any(|port| port.name.text == name.text) {
            let message = format!("the content of `{}` cannot be read here", name.text);
            let help = "only a variable with a range, of type `bool` or with names can be read";
            self.report(Diagnostic::new(Code::E0904, name.span, message).help(help));
            return None;
        }
        self.report_unknown(name, "a variable");
        None
    }

    /// Reports an unknown name, with a similar name.
    pub(super) fn report_unknown(&mut self, name: &Name, what: &str) {
        let known: Vec<String> = self.group.kept.variables.keys().chain(self.values.keys()).cloned().collect();
        let message = format!("`{}` is not {what} of this activity", name.text);
        let diagnostic = Diagnostic::new(Code::E0903, name.span, message);
        let near = self.group.diagnostics().near(&name.text, known.iter().map(String::as_str));
        let diagnostic = match &near {
            Some(near) => diagnostic.rename(name.span, near),
            None => diagnostic,
        };
        self.report(diagnostic);
    }
}

/// Returns the text of a node in one line.
pub(super) fn text(node: &Node) -> String {
    node.syntax().text().to_string().split_whitespace().collect::<Vec<_>>().join(" ")
}
