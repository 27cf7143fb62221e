//! Substitutions: `$(var speed)`, `$(env HOME /root)`, `$(eval …)`.
//!
//! Source: the grammar of `launch`, and its classes with `expose_substitution`.

use super::expression;
use super::value::Value;

/// The deepest nesting of substitutions.
const DEPTH_MAX: usize = 16;
/// The longest text that substitutions make, in bytes.
pub(super) const VALUE_MAX: usize = 16 * 1024;

/// The things that substitutions name.
pub(super) trait Names {
    /// Returns the value of an argument or a variable of the launch file.
    fn variable(&self, name: &str) -> Option<Value>;
    /// Returns the folder of shared files of an installed package.
    fn share(&self, package: &str) -> Option<String>;
    /// Returns the path of the file that is read.
    fn file(&self) -> &str;
}

/// Replaces the substitutions in a text.
pub(super) fn replace(text: &str, names: &dyn Names) -> Value {
    if !text.contains(['$', '\\']) {
        return limited(Value::plain(text));
    }
    let mut cursor = Cursor { text, at: 0, names };
    limited(cursor.text(0, |_| false))
}

fn limited(value: Value) -> Value {
    if value.text.len() <= VALUE_MAX {
        return value;
    }
    let why = format!("the text is longer than {VALUE_MAX} bytes");
    let cut = (0..=VALUE_MAX).rev().find(|end| value.text.is_char_boundary(*end)).unwrap_or(0);
    Value { text: value.text[..cut].to_owned(), open: Some(why), ..value }
}

struct Cursor<'a> {
    text: &'a str,
    at: usize,
    names: &'a dyn Names,
}

impl<'a> Cursor<'a> {
    fn rest(&self) -> &'a str {
        &self.text[self.at..]
    }

    fn next(&mut self) -> Option<char> {
        let found = self.rest().chars().next()?;
        self.at += found.len_utf8();
        Some(found)
    }

    /// Reads a text up to a character that ends it.
    fn text(&mut self, depth: usize, is_end: impl Fn(char) -> bool) -> Value {
        let (mut value, mut plain) = (Value::default(), String::new());
        while let Some(found) = self.rest().chars().next().filter(|found| !is_end(*found)) {
            if self.rest().starts_with("$(") && depth < DEPTH_MAX {
                value.push(Value::plain(std::mem::take(&mut plain)));
                value.push(self.substitution(depth + 1));
            } else {
                self.next();
                // A backslash takes the meaning from the characters of substitutions only.
                let escaped = (found == '\\').then(|| self.rest().chars().next()).flatten();
                match escaped.filter(|next| matches!(next, '$' | '\\' | '"' | '\'')) {
                    Some(next) => {
                        self.next();
                        plain.push(next);
                    }
                    None => plain.push(found),
                }
            }
            if value.text.len() + plain.len() > VALUE_MAX {
                self.at = self.text.len();
            }
        }
        value.push(Value::plain(plain));
        value
    }

    /// Reads a substitution behind `$(`, and returns its value.
    fn substitution(&mut self, depth: usize) -> Value {
        let begin = self.at;
        self.at += 2;
        let end = self.rest().find(|found: char| found.is_whitespace() || found == ')').unwrap_or(self.rest().len());
        let name = &self.rest()[..end];
        self.at += end;
        let mut arguments = Vec::new();
        loop {
            let blanks = self.rest().len() - self.rest().trim_start().len();
            self.at += blanks;
            match self.rest().chars().next() {
                None => return open(&self.text[begin..], &arguments, "it is not closed".to_owned()),
                Some(')') => break,
                Some(quote @ ('"' | '\'')) => {
                    self.next();
                    arguments.push(self.text(depth, |found| found == quote));
                    self.next();
                }
                Some(_) => arguments.push(self.text(depth, |found| found == ')' || found.is_whitespace())),
            }
        }
        self.next();
        self.value_of(name, &arguments).unwrap_or_else(|why| open(&self.text[begin..self.at], &arguments, why))
    }

    fn value_of(&self, name: &str, arguments: &[Value]) -> Result<Value, String> {
        if let Some(why) = arguments.iter().find_map(|argument| argument.open.clone()) {
            return Err(why);
        }
        let mut all = Value::default();
        arguments.iter().for_each(|argument| all.push(Value { is_argument: false, ..argument.clone() }));
        let first = || arguments.first().map(|first| first.text.as_str()).ok_or("an argument is missing".to_owned());
        match (name, arguments) {
            ("var" | "arg", [_, ..]) => self.variable(first()?, arguments.get(1)),
            ("env" | "optenv", [_, default]) => Ok(default.clone().into_other(default.text.as_str())),
            ("env" | "optenv", [_]) => Err(format!("the environment of the start has `{}`", first()?)),
            ("find-pkg-share", [package]) => {
                let package = package.text.as_str();
                let share = self.names.share(package);
                Ok(share.map_or_else(|| absent(package, &all), |share| all.clone().into_other(share)))
            }
            ("find-exec", [_]) => Ok(arguments[0].clone()),
            ("dirname", []) => Ok(Value::plain(folder(self.names.file()))),
            ("filename", []) => Ok(Value::plain(self.names.file())),
            ("anon", [_]) => Ok(arguments[0].clone()),
            ("equals", [one, other]) => Ok(all.into_other(text_of(same(&one.text, &other.text)))),
            ("not-equals", [one, other]) => Ok(all.into_other(text_of(!same(&one.text, &other.text)))),
            ("not", [_]) | ("and" | "or", [_, _]) | ("any" | "all", [_, ..]) => truths(name, arguments, all),
            ("if", [condition, yes, rest @ ..]) => {
                let is_true = condition.truth().ok_or("its condition is not a truth value")?;
                let other = rest.first().cloned().unwrap_or_default();
                Ok(all.into_other(if is_true { yes.text.clone() } else { other.text }))
            }
            ("eval", [_, ..]) => expression::evaluate(first()?).map(|text| all.into_other(text)),
            _ => Err(format!("`$({name} …)` has no counterpart")),
        }
    }

    fn variable(&self, name: &str, default: Option<&Value>) -> Result<Value, String> {
        let found = self.names.variable(name).or_else(|| default.cloned());
        found.ok_or_else(|| format!("`{name}` has no value; give it one: `--set {name}=VALUE`"))
    }
}

/// Returns the folder of a package that is not installed here.
fn absent(package: &str, all: &Value) -> Value {
    let why = format!("package `{package}` is not installed here, or its setup file was not sourced");
    Value { open: Some(why), ..all.clone().into_other(format!("$(find-pkg-share {package})")) }
}

/// Returns a substitution as it was written, with the reason why it stays.
fn open(written: &str, arguments: &[Value], why: String) -> Value {
    let arguments = arguments.iter().flat_map(|argument| argument.arguments.iter().copied()).collect();
    Value { text: written.into(), arguments, is_argument: false, open: Some(why) }
}

fn truths(name: &str, arguments: &[Value], all: Value) -> Result<Value, String> {
    let truths = arguments.iter().map(Value::truth).collect::<Option<Vec<_>>>();
    let truths = truths.ok_or_else(|| format!("`$({name} …)` needs `true` or `false`"))?;
    let result = match name {
        "not" => !truths[0],
        "and" | "all" => truths.iter().all(|truth| *truth),
        _ => truths.iter().any(|truth| *truth),
    };
    Ok(all.into_other(text_of(result)))
}

fn text_of(truth: bool) -> &'static str {
    if truth { "true" } else { "false" }
}

/// Whether two texts are the same, as truths, as numbers or as texts.
fn same(one: &str, other: &str) -> bool {
    match (one.trim().parse::<f64>(), other.trim().parse::<f64>()) {
        (Ok(one), Ok(other)) => (one - other).abs() == 0.0,
        (Ok(_) | Err(_), Ok(_) | Err(_)) => {
            one == other || Value::plain(one).truth().is_some_and(|truth| Value::plain(other).truth() == Some(truth))
        }
    }
}

/// Returns the folder of a file.
pub(super) fn folder(path: &str) -> &str {
    match path.rsplit_once('/') {
        Some(("", _)) => "/",
        Some((folder, _)) => folder,
        None => ".",
    }
}
