//! ECMAScript expressions, as conditions or numbers of an activity.

use super::model::{Kind, Model};
use crate::xml::tag;

/// The sort of an expression.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Sort {
    Truth,
    Number,
    /// A value of the variable with this id.
    Value(String),
    /// A text. If it is compared with a variable, it means a value of this variable.
    Text(String),
}

/// An expression in the language.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Formula {
    pub(super) text: String,
    pub(super) sort: Sort,
}

/// The deepest nesting of an expression.
const DEPTH_MAX: usize = 24;

const LEVELS: [&[&str]; 6] =
    [&["||"], &["&&"], &["===", "==", "!==", "!="], &["<=", ">=", "<", ">"], &["+", "-"], &["*"]];

/// Returns the content of a text in quotes.
pub(super) fn text_of(expression: &str) -> Option<&str> {
    let quote = expression.chars().next().filter(|first| ['\'', '"'].contains(first))?;
    let inner = expression.strip_prefix(quote)?.strip_suffix(quote)?;
    Some(inner).filter(|inner| !inner.contains(['\'', '"', '\\']))
}

/// Returns the variables of an expression that are compared with a text, each with the text.
pub(super) fn compared(expression: &str) -> Vec<(String, String)> {
    let tokens = tokens(expression).unwrap_or_default();
    let pairs = tokens.windows(3).filter_map(|three| match three {
        [left, sign, right] if ["===", "==", "!==", "!="].contains(&sign.as_str()) => {
            match (left.strip_prefix('\''), right.strip_prefix('\'')) {
                (Some(text), None) => Some((right.clone(), text.to_owned())),
                (None, Some(text)) => Some((left.clone(), text.to_owned())),
                (Some(_), Some(_)) | (None, None) => None,
            }
        }
        [..] => None,
    });
    pairs.collect()
}

/// Returns the condition that an expression means, if there is one.
pub(super) fn condition(expression: &str, model: &Model<'_>) -> Option<String> {
    let formula = parse(expression, model)?;
    match formula.sort {
        Sort::Truth => Some(formula.text),
        Sort::Number => Some(format!("{} != 0", formula.text)),
        Sort::Value(_) | Sort::Text(_) => None,
    }
}

/// Returns the formula that an expression means, if there is one.
pub(super) fn parse(expression: &str, model: &Model<'_>) -> Option<Formula> {
    let mut parser = Parser { tokens: tokens(expression)?, next: 0, depth: 0, model };
    let formula = parser.binary(0)?;
    (parser.next == parser.tokens.len()).then_some(formula)
}

struct Parser<'m, 'a> {
    tokens: Vec<String>,
    next: usize,
    depth: usize,
    model: &'m Model<'a>,
}

impl Parser<'_, '_> {
    fn take(&mut self) -> Option<String> {
        self.next += 1;
        self.tokens.get(self.next - 1).cloned()
    }

    fn binary(&mut self, level: usize) -> Option<Formula> {
        let Some(operators) = LEVELS.get(level) else { return self.unary() };
        let mut left = self.binary(level + 1)?;
        let mut is_single = true;
        while let Some(operator) =
            self.tokens.get(self.next).filter(|token| operators.contains(&token.as_str())).cloned()
        {
            self.next += 1;
            let right = self.binary(level + 1)?;
            if !is_single {
                left.text = format!("({})", left.text);
            }
            left = self.joined(&operator, left, right)?;
            is_single = false;
        }
        if !is_single && level > 0 {
            left.text = format!("({})", left.text);
        }
        Some(left)
    }

    fn joined(&self, operator: &str, left: Formula, right: Formula) -> Option<Formula> {
        let (operator, sort) = match operator {
            "||" | "&&" => (operator, Sort::Truth),
            "===" | "==" => ("==", Sort::Truth),
            "!==" | "!=" => ("!=", Sort::Truth),
            "<=" | ">=" | "<" | ">" => (operator, Sort::Truth),
            _ => (operator, Sort::Number),
        };
        let (left, right) = match (&left.sort, &right.sort) {
            (Sort::Value(variable), Sort::Text(text)) => (left.clone(), self.value(variable, text)?),
            (Sort::Text(text), Sort::Value(variable)) => (self.value(variable, text)?, right.clone()),
            _ => (left, right),
        };
        let wanted = match operator {
            "||" | "&&" => Sort::Truth,
            "==" | "!=" => left.sort.clone(),
            _ => Sort::Number,
        };
        if left.sort != wanted || right.sort != wanted || matches!(wanted, Sort::Text(_)) {
            return None;
        }
        Some(Formula { text: format!("{} {operator} {}", left.text, right.text), sort })
    }

    /// A value of a variable with names.
    fn value(&self, variable: &str, text: &str) -> Option<Formula> {
        let name = value_name(self.model, variable, text)?;
        Some(Formula { text: name, sort: Sort::Value(variable.into()) })
    }

    fn unary(&mut self) -> Option<Formula> {
        self.depth += 1;
        let formula = if self.depth > DEPTH_MAX { None } else { self.atom() };
        self.depth -= 1;
        formula
    }

    fn atom(&mut self) -> Option<Formula> {
        let token = self.take()?;
        let truth = |text: String| Some(Formula { text, sort: Sort::Truth });
        match token.as_str() {
            "!" => {
                let inner = self.unary().filter(|inner| inner.sort == Sort::Truth)?;
                truth(if inner.text.contains(' ') { format!("!({})", inner.text) } else { format!("!{}", inner.text) })
            }
            "-" => {
                let inner = self.unary().filter(|inner| inner.sort == Sort::Number)?;
                Some(Formula { text: format!("(0 - {})", inner.text), sort: Sort::Number })
            }
            "(" => {
                let inner = self.binary(0)?;
                let closed = self.take()? == ")";
                let text = if inner.text.contains(' ') { format!("({})", inner.text) } else { inner.text };
                closed.then_some(Formula { text, sort: inner.sort })
            }
            "true" | "false" => truth(token),
            "In" => {
                let (open, name, close) = (self.take()?, self.take()?, self.take()?);
                let state = self.model.states.get(name.strip_prefix('\'')?)?;
                let is_call = open == "(" && close == ")" && tag(state.node) != "history";
                if is_call { truth(format!("in({})", state.name)) } else { None }
            }
            _ => match (token.strip_prefix('\''), token.parse::<i32>()) {
                (Some(text), _) => Some(Formula { text: String::new(), sort: Sort::Text(text.into()) }),
                (None, Ok(number)) => Some(Formula { text: number.to_string(), sort: Sort::Number }),
                (None, Err(_)) => self.variable(&token),
            },
        }
    }

    fn variable(&self, id: &str) -> Option<Formula> {
        let variable = self.model.variables.get(id)?;
        let sort = match variable.kind {
            Kind::Number(_) => Sort::Number,
            Kind::Truth(_) => Sort::Truth,
            Kind::Named { .. } => Sort::Value(id.into()),
            Kind::Unknown => return None,
        };
        Some(Formula { text: variable.name.clone(), sort })
    }
}

/// Returns the name of a value of a variable.
pub(super) fn value_name(model: &Model<'_>, variable: &str, text: &str) -> Option<String> {
    match &model.variables.get(variable)?.kind {
        Kind::Named { values, .. } => values.iter().find(|(value, _)| value == text).map(|(_, name)| name.clone()),
        Kind::Number(_) | Kind::Truth(_) | Kind::Unknown => None,
    }
}

/// The tokens; a text in quotes begins with a quote.
fn tokens(text: &str) -> Option<Vec<String>> {
    let mut tokens = vec![];
    let mut rest = text.trim_start();
    while let Some(first) = rest.chars().next() {
        let length = if first.is_alphanumeric() || first == '_' || first == '$' {
            rest.find(|c: char| !c.is_alphanumeric() && c != '_' && c != '$').unwrap_or(rest.len())
        } else if first == '\'' || first == '"' {
            let length = rest[1..].find(first)?;
            tokens.push(format!("'{}", &rest[1..=length]));
            rest = rest[length + 2..].trim_start();
            continue;
        } else {
            let operators = ["===", "!==", "||", "&&", "==", "!=", "<=", ">=", "<", ">", "+", "-", "*", "!", "(", ")"];
            operators.iter().find(|operator| rest.starts_with(**operator))?.len()
        };
        tokens.push(rest[..length].to_owned());
        rest = rest[length..].trim_start();
    }
    Some(tokens)
}
