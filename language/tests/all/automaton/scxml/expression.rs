//! Expressions of ECMAScript that are expressions of numbers.

use language::automaton::{Formula, Relation};

type Names<'a> = &'a dyn Fn(&str) -> Option<usize>;

/// Returns the formula that an expression means, if there is one.
pub(super) fn parse(text: &str, variable: Names<'_>, state: Names<'_>) -> Option<Formula> {
    let mut parser = Parser { tokens: tokens(text)?, next: 0, variable, state };
    let formula = parser.binary(0)?;
    (parser.next == parser.tokens.len()).then_some(formula)
}

struct Parser<'a> {
    tokens: Vec<String>,
    next: usize,
    variable: Names<'a>,
    state: Names<'a>,
}

const LEVELS: [&[&str]; 6] =
    [&["||"], &["&&"], &["===", "==", "!==", "!="], &["<=", ">=", "<", ">"], &["+", "-"], &["*"]];

impl Parser<'_> {
    fn take(&mut self) -> Option<String> {
        self.next += 1;
        self.tokens.get(self.next - 1).cloned()
    }

    fn binary(&mut self, level: usize) -> Option<Formula> {
        let Some(operators) = LEVELS.get(level) else { return self.unary() };
        let mut left = self.binary(level + 1)?;
        while let Some(operator) =
            self.tokens.get(self.next).filter(|token| operators.contains(&token.as_str())).cloned()
        {
            self.next += 1;
            let (a, b) = (Box::new(left), Box::new(self.binary(level + 1)?));
            left = match operator.as_str() {
                "||" => Formula::Or(a, b),
                "&&" => Formula::And(a, b),
                "===" | "==" => Formula::Compare(Relation::Equal, a, b),
                "!==" | "!=" => Formula::Not(Box::new(Formula::Compare(Relation::Equal, a, b))),
                "<" => Formula::Compare(Relation::Less, a, b),
                "<=" => Formula::Compare(Relation::AtMost, a, b),
                ">" => Formula::Compare(Relation::Less, b, a),
                ">=" => Formula::Compare(Relation::AtMost, b, a),
                "+" => Formula::Add(a, b),
                "-" => Formula::Subtract(a, b),
                _ => Formula::Multiply(a, b),
            };
        }
        Some(left)
    }

    fn unary(&mut self) -> Option<Formula> {
        let token = self.take()?;
        match token.as_str() {
            "!" => Some(Formula::Not(Box::new(self.unary()?))),
            "-" => Some(Formula::Subtract(Box::new(Formula::Number(0)), Box::new(self.unary()?))),
            "(" => {
                let inner = self.binary(0)?;
                (self.take()? == ")").then_some(inner)
            }
            "true" => Some(Formula::Number(1)),
            "false" => Some(Formula::Number(0)),
            "In" => {
                let (open, name, close) = (self.take()?, self.take()?, self.take()?);
                let name = name.strip_prefix('\'')?;
                if open == "(" && close == ")" { (self.state)(name).map(Formula::In) } else { None }
            }
            _ => match token.parse() {
                Ok(number) => Some(Formula::Number(number)),
                Err(_) => (self.variable)(&token).map(Formula::Variable),
            },
        }
    }
}

/// The tokens; a text in quotes begins with a quote.
fn tokens(text: &str) -> Option<Vec<String>> {
    let mut tokens = vec![];
    let mut rest = text.trim_start();
    while let Some(first) = rest.chars().next() {
        let length = if first.is_ascii_alphanumeric() || first == '_' {
            rest.find(|c: char| !c.is_ascii_alphanumeric() && c != '_').unwrap_or(rest.len())
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
