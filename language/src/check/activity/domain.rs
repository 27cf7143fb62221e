//! The values that a variable of an activity may have.

use super::ActivityReader;
use crate::diagnostic::{Code, Diagnostic};
use crate::syntax::SyntaxKind::{Constant, Minus, Number};
use crate::syntax::ast::Node;

/// The largest number of named values of one variable.
const VALUES_MAX: usize = 1_000;

/// The values that a variable may have.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Domain {
    Truth,
    Range(i32, i32),
    Names(Vec<String>),
    Opaque,
}

impl Domain {
    /// Returns the least and the greatest value.
    pub(super) fn range(&self) -> (i32, i32) {
        match self {
            Self::Truth => (0, 1),
            Self::Range(min, max) => (*min, *max),
            Self::Names(names) => (0, i32::try_from(names.len()).unwrap_or(i32::MAX).saturating_sub(1)),
            Self::Opaque => (0, 0),
        }
    }

    /// Returns the names of the values. The list is empty if the values are numbers.
    pub(super) fn names(&self) -> Vec<String> {
        match self {
            Self::Truth => vec!["false".to_owned(), "true".to_owned()],
            Self::Names(names) => names.clone(),
            Self::Range(..) | Self::Opaque => Vec::new(),
        }
    }
}

impl ActivityReader<'_, '_> {
    /// Reads `bool`, `0..3`, `slow | fast` or `opaque`.
    pub(super) fn domain(&mut self, node: &Node) -> Option<Domain> {
        let numbers: Vec<Node> = node.children_of(Constant).collect();
        if let [min, max] = numbers.as_slice() {
            let (min, max) = (self.whole(min)?, self.whole(max)?);
            if min > max {
                let message = format!("the range {min}..{max} is empty");
                self.report(Diagnostic::new(Code::E0904, node.span(), message));
                return None;
            }
            return Some(Domain::Range(min, max));
        }
        let names: Vec<_> = node.names().collect();
        match names.as_slice() {
            [] => None,
            [one] if one.text == "bool" => Some(Domain::Truth),
            [one] if one.text == "opaque" => Some(Domain::Opaque),
            [one] => {
                let message = format!("`{}` is not a type for a variable of an activity", one.text);
                let help = "write `bool`, a range such as `0..3`, names such as `slow | fast`, or `opaque`";
                self.report(Diagnostic::new(Code::E0904, one.span, message).help(help));
                None
            }
            [..] => {
                let mut all = Vec::new();
                for (number, name) in (0_i64..).zip(&names).take(VALUES_MAX) {
                    let other = self.values.insert(name.text.clone(), number).filter(|other| *other != number);
                    if other.is_some() || all.contains(&name.text) {
                        let message =
                            format!("`{}` is already the name of a value, at another position in a list", name.text);
                        self.report(Diagnostic::new(Code::E0110, name.span, message));
                    }
                    all.push(name.text.clone());
                }
                Some(Domain::Names(all))
            }
        }
    }

    /// Reads a whole number.
    pub(super) fn whole(&mut self, node: &Node) -> Option<i32> {
        let token = node.token(Number)?;
        let number = token.text().replace('_', "").parse::<i32>().ok();
        if number.is_none() {
            let message = format!("`{}` is not a whole number of 32 bits", token.text());
            self.report(Diagnostic::new(Code::E0904, token.span(), message));
        }
        number.map(|number| if node.token(Minus).is_some() { -number } else { number })
    }

    /// Reads the initial value of a variable.
    pub(super) fn start_value(&mut self, node: &Node, domain: &Domain) -> Option<i32> {
        let number = match node.child(Constant).filter(|number| number.token(Number).is_some()) {
            Some(number) => Some(i64::from(self.whole(&number)?)),
            None => node.names().next().and_then(|name| self.values.get(&name.text).copied()),
        };
        let is_name = node.names().next().is_some();
        let fits = match domain {
            Domain::Truth => is_name && matches!(node.compact_text().as_str(), "true" | "false"),
            Domain::Names(names) => names.contains(&node.compact_text()),
            Domain::Range(..) => !is_name,
            Domain::Opaque => false,
        };
        let (min, max) = domain.range();
        let number = number.and_then(|number| i32::try_from(number).ok()).filter(|number| (min..=max).contains(number));
        let value = number.filter(|_| fits);
        if value.is_none() {
            let message = format!("`{}` is not a value of this variable", node.compact_text());
            self.report(Diagnostic::new(Code::E0904, node.span(), message));
        }
        value
    }
}
