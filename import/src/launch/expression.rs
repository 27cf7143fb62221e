//! Python expressions in `$(eval …)`: comparisons of texts, numbers and lists. Other expressions are not evaluated.

/// The longest expression, in bytes.
const TEXT_MAX: usize = 4_096;
/// The deepest nesting of parentheses and lists.
const DEPTH_MAX: usize = 32;

#[derive(Clone, Debug, PartialEq)]
enum Data {
    Truth(bool),
    Number(f64),
    Text(String),
    List(Vec<Self>),
}

impl Data {
    fn is_true(&self) -> bool {
        match self {
            Self::Truth(truth) => *truth,
            Self::Number(number) => number.abs() > 0.0,
            Self::Text(text) => !text.is_empty(),
            Self::List(list) => !list.is_empty(),
        }
    }
}

/// Returns the value of an expression as a text.
///
/// # Errors
/// The expression has parts that are not known here.
pub(super) fn evaluate(text: &str) -> Result<String, String> {
    let mut reader = Reader { tokens: tokens(text).ok_or_else(|| unknown(text))?, at: 0, depth: 0 };
    let value = reader.any().filter(|_| reader.at == reader.tokens.len()).ok_or_else(|| unknown(text))?;
    match value {
        Data::Truth(truth) => Ok(if truth { "true" } else { "false" }.into()),
        Data::Number(number) => Ok(number.to_string()),
        Data::Text(text) => Ok(text),
        Data::List(_) => Err(unknown(text)),
    }
}

fn unknown(text: &str) -> String {
    format!("`{}` is a Python expression, so its value is not known", crate::name::plain(text))
}

#[derive(Clone, Debug, PartialEq)]
enum Token {
    Value(Data),
    Word(String),
    Sign(&'static str),
}

const SIGNS: [&str; 11] = ["==", "!=", "<=", ">=", "<", ">", "(", ")", "[", "]", ","];

fn tokens(text: &str) -> Option<Vec<Token>> {
    if text.len() > TEXT_MAX {
        return None;
    }
    let (mut rest, mut tokens) = (text.trim_start(), Vec::new());
    while let Some(first) = rest.chars().next() {
        let length;
        if let Some(sign) = SIGNS.iter().find(|sign| rest.starts_with(**sign)) {
            tokens.push(Token::Sign(sign));
            length = sign.len();
        } else if first == '\'' || first == '"' {
            let inside = rest[1..].find(first)?;
            if rest[1..=inside].contains('\\') {
                return None;
            }
            tokens.push(Token::Value(Data::Text(rest[1..=inside].to_owned())));
            length = inside + 2;
        } else {
            let is_part = |c: char| c.is_alphanumeric() || matches!(c, '_' | '.' | '-' | '+');
            length = rest.find(|c| !is_part(c)).unwrap_or(rest.len());
            let word = &rest[..length];
            tokens.push(match (word, word.parse::<f64>()) {
                ("", _) => return None,
                ("True" | "true", _) => Token::Value(Data::Truth(true)),
                ("False" | "false", _) => Token::Value(Data::Truth(false)),
                (_, Ok(number)) if number.is_finite() => Token::Value(Data::Number(number)),
                (_, Ok(_) | Err(_)) => Token::Word(word.to_owned()),
            });
        }
        rest = rest[length..].trim_start();
    }
    Some(tokens)
}

/// Each function reads one level of the grammar, the loosest first.
struct Reader {
    tokens: Vec<Token>,
    at: usize,
    depth: usize,
}

impl Reader {
    fn takes(&mut self, token: &Token) -> bool {
        let is_next = self.tokens.get(self.at) == Some(token);
        self.at += usize::from(is_next);
        is_next
    }

    fn word(&mut self, word: &str) -> bool {
        self.takes(&Token::Word(word.to_owned()))
    }

    fn any(&mut self) -> Option<Data> {
        let mut value = self.all()?;
        while self.word("or") {
            let other = self.all()?;
            value = if value.is_true() { value } else { other };
        }
        Some(value)
    }

    fn all(&mut self) -> Option<Data> {
        let mut value = self.not()?;
        while self.word("and") {
            let other = self.not()?;
            value = if value.is_true() { other } else { value };
        }
        Some(value)
    }

    fn not(&mut self) -> Option<Data> {
        let mut count = 0;
        while self.word("not") {
            count += 1;
        }
        let value = self.comparison()?;
        Some(if count == 0 { value } else { Data::Truth(value.is_true() == (count % 2 == 0)) })
    }

    fn comparison(&mut self) -> Option<Data> {
        let value = self.primary()?;
        let is_not = self.word("not");
        if self.word("in") {
            let holds = match (&value, &self.primary()?) {
                (one, Data::List(list)) => list.contains(one),
                (Data::Text(part), Data::Text(text)) => text.contains(part.as_str()),
                (_, Data::Truth(_) | Data::Number(_) | Data::Text(_)) => return None,
            };
            return Some(Data::Truth(holds != is_not));
        }
        if is_not {
            return None;
        }
        let Some(sign) = SIGNS[..6].iter().find(|sign| self.takes(&Token::Sign(sign))) else { return Some(value) };
        let other = self.primary()?;
        let order = match (&value, &other) {
            (Data::Number(one), Data::Number(other)) => one.partial_cmp(other)?,
            (Data::Text(one), Data::Text(other)) => one.cmp(other),
            _ if *sign == "==" => return Some(Data::Truth(value == other)),
            _ if *sign == "!=" => return Some(Data::Truth(value != other)),
            _ => return None,
        };
        Some(Data::Truth(match *sign {
            "==" => order.is_eq(),
            "!=" => order.is_ne(),
            "<=" => order.is_le(),
            ">=" => order.is_ge(),
            "<" => order.is_lt(),
            _ => order.is_gt(),
        }))
    }

    fn primary(&mut self) -> Option<Data> {
        let token = self.tokens.get(self.at)?.clone();
        self.at += 1;
        match token {
            Token::Value(data) => Some(data),
            Token::Sign("(") => self.inside(")", false)?.pop(),
            Token::Sign("[") => Some(Data::List(self.inside("]", true)?)),
            Token::Word(word) if word == "len" && self.takes(&Token::Sign("(")) => {
                #[expect(clippy::cast_precision_loss, reason = "an expression has a few thousand parts at most")]
                match self.inside(")", false)?.pop()? {
                    Data::List(list) => Some(Data::Number(list.len() as f64)),
                    Data::Text(text) => Some(Data::Number(text.chars().count() as f64)),
                    Data::Truth(_) | Data::Number(_) => None,
                }
            }
            Token::Word(_) | Token::Sign(_) => None,
        }
    }

    /// Reads one value, or a list of values, up to a sign.
    fn inside(&mut self, end: &'static str, is_list: bool) -> Option<Vec<Data>> {
        self.depth += 1;
        if self.depth > DEPTH_MAX {
            return None;
        }
        let mut list = Vec::new();
        while !self.takes(&Token::Sign(end)) {
            list.push(self.any()?);
            if !self.takes(&Token::Sign(",")) {
                self.takes(&Token::Sign(end)).then_some(())?;
                break;
            }
        }
        self.depth -= 1;
        (is_list || list.len() == 1).then_some(list)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn comparisons_are_those_of_python() {
        for (text, expected) in [
            ("'a' == 'a'", "true"),
            ("'model_16'=='model_64'", "false"),
            ("'3'>='2' and 2 < 10", "true"),
            ("len(['a','b'])> 1", "true"),
            ("'ndt' in ['yabloc', 'ndt']", "true"),
            ("'ndt' not in ['yabloc']", "true"),
            ("not (True or False)", "false"),
            ("not not 'a' in 'cat'", "true"),
            ("False or 'x'", "x"),
            ("1.5", "1.5"),
            ("'' and 'x'", ""),
        ] {
            assert_eq!(evaluate(text).as_deref(), Ok(expected), "{text}");
        }
    }

    #[test]
    fn other_expressions_are_not_evaluated() {
        let deep = format!("{}1{}", "(".repeat(1_000), ")".repeat(1_000));
        for text in ["", "a", "1 +", "'a", "'a' < 1", "[1]", "open('x')", "1 == 1 == 1", "'\\''", "(1, 2)", "()", &deep]
        {
            assert!(evaluate(text).is_err(), "{text}");
        }
    }
}
