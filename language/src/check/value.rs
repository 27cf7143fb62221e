//! Evaluates constants, quantities and times.

use super::diagnostics::Diagnostics;
use super::spec::{FIELDS_MAX, Scope, Value, ValueKind};
use super::{count, index};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::Constant;
use crate::source::Span;
use crate::syntax::SyntaxKind::{self, Ident, Minus, Number, Text};
use crate::syntax::ast::{Name, Node};
use crate::unit::{self, Dimension};
use std::time::Duration;

/// The longest time that a spec can name: a hundred years.
const SECONDS_MAX: f64 = 100.0 * 366.0 * 86_400.0;

/// The longest key of the database, in bytes.
const KEY_SIZE_MAX: usize = 512;

/// Reads values and lists of values. The names in them belong to a scope.
pub(super) struct Reader<'a> {
    pub(super) scope: Scope<'a>,
    pub(super) diagnostics: &'a mut Diagnostics,
}

impl Reader<'_> {
    /// Reads a constant. A name may be a parameter or a constant. Otherwise the name itself is the value.
    pub(super) fn value(&mut self, node: &Node) -> Value {
        let span = node.span();
        if let Some(text) = node.token(Text) {
            return Value { span, kind: ValueKind::Constant(Constant::Text(text.content())), dimension: None };
        }
        if node.token(Number).is_some() {
            let (kind, dimension) = match quantity(node, self.diagnostics) {
                Some((number, dimension)) => (ValueKind::Constant(Constant::Number(number)), dimension),
                None => (ValueKind::Broken, None),
            };
            return Value { span, kind, dimension };
        }
        if let Some(record) = node.child(SyntaxKind::Record) {
            let kind = self.record(&record);
            return self.limited(Value { span, kind, dimension: None });
        }
        if let Some(secret) = node.child(SyntaxKind::Secret) {
            return Value { span, kind: self.secret(&secret), dimension: None };
        }
        if let Some(list) = node.child(SyntaxKind::List) {
            let values = list.children_of(SyntaxKind::Constant).map(|node| self.value(&node)).collect();
            return self.limited(Value { span, kind: ValueKind::List(values), dimension: None });
        }
        let Some(name) = node.names().next() else { return Value { span, kind: ValueKind::Broken, dimension: None } };
        match node.child(SyntaxKind::Index) {
            Some(index) => self.picked(&name, &index),
            None => Value { span, ..self.symbol(&name) },
        }
    }

    /// Reads `secret("team/camera/password")`.
    fn secret(&mut self, node: &Node) -> ValueKind {
        let Some(text) = node.token(Text) else { return ValueKind::Broken };
        let key = text.content();
        if is_key(&key) {
            return ValueKind::Constant(Constant::Secret(key));
        }
        let diagnostic = Diagnostic::new(Code::E0213, text.span(), format!("{key:?} is not a key of the database"));
        self.diagnostics.push(diagnostic.help("a key is a path of words: `secret(\"team/camera/password\")`"));
        ValueKind::Broken
    }

    /// Reads `{ x = 1 m, y = 2 m }`.
    fn record(&mut self, node: &Node) -> ValueKind {
        let mut fields: Vec<(Name, Value)> = Vec::new();
        for field in node.children_of(SyntaxKind::Field) {
            let (Some(name), Some(node)) = (field.names().next(), field.child(SyntaxKind::Constant)) else {
                return ValueKind::Broken;
            };
            if let Some((first, _)) = fields.iter().find(|(first, _)| first.text == name.text) {
                let message = format!("field `{}` is given twice", name.text);
                self.diagnostics
                    .push(Diagnostic::new(Code::E0212, name.span, message).reason(first.span, "first given here"));
                continue;
            }
            let value = self.value(&node);
            fields.push((name, value));
        }
        ValueKind::Record(fields)
    }

    /// Checks that a record or a list is not too large, because named constants in named constants grow fast. Also checks that no list is
    /// inside another list.
    fn limited(&mut self, value: Value) -> Value {
        let inner = if let ValueKind::List(values) = &value.kind { values.as_slice() } else { &[] };
        let nested = inner.iter().find(|value| matches!(value.kind, ValueKind::List(_)));
        let diagnostic = match nested {
            Some(nested) => Diagnostic::new(Code::E0006, nested.span, "a list cannot contain a list"),
            None if value.fields() > FIELDS_MAX => {
                let message = format!("more than {FIELDS_MAX} values, including the values of the records in it");
                Diagnostic::new(Code::E0702, value.span, message)
            }
            None => return value,
        };
        self.diagnostics.push(diagnostic);
        Value { kind: ValueKind::Broken, ..value }
    }

    /// Reads `hosts[i]`, which is one value of a list.
    fn picked(&mut self, name: &Name, index: &Node) -> Value {
        let span = Span { end: index.span().end, ..name.span };
        let broken = Value { span, kind: ValueKind::Broken, dimension: None };
        let list = self.scope.consts.get(&name.text).filter(|named| named.is_list);
        let Some(list) = list else {
            let message = format!("`{}` is not a list", name.text);
            self.diagnostics.push(
                Diagnostic::new(Code::E0203, name.span, message).help("declare a list: `const hosts = [c1, c2];`"),
            );
            return broken;
        };
        let Some(place) = index::known(index, self.scope.indices, self.diagnostics).filter(|_| !list.is_broken())
        else {
            return broken;
        };
        match list.values.get(place) {
            Some(value) => Value { span, ..value.clone() },
            None => {
                let message =
                    format!("`{}` has {} values, and no value with the index {place}", name.text, list.values.len());
                let diagnostic = Diagnostic::new(Code::E0203, span, message).reason(list.name.span, "declared here");
                self.diagnostics.push(diagnostic.help("the first index is 0"));
                broken
            }
        }
    }

    /// Returns the value of a name. The name may be `true` or `false`, a parameter or a named constant. Otherwise the
    /// name itself is the value.
    pub(super) fn symbol(&mut self, name: &Name) -> Value {
        let scope = self.scope;
        let value = |kind| Value { span: name.span, kind, dimension: None };
        if let "true" | "false" = name.text.as_str() {
            return value(ValueKind::Constant(Constant::Truth(name.text == "true")));
        }
        if let Some((_, index)) = scope.indices.iter().rev().find(|(known, _)| *known == name.text) {
            return value(ValueKind::Constant(Constant::Number(index::number(*index))));
        }
        if let Some(index) = scope.params.iter().position(|param| param.name.text == name.text) {
            return value(ValueKind::Param(index));
        }
        if let Some(named) = scope.consts.get(&name.text) {
            return match named.values.first().filter(|_| !named.is_list || named.is_broken()) {
                Some(one) => Value { span: name.span, ..one.clone() },
                None => self.limited(value(ValueKind::List(named.values.clone()))),
            };
        }
        let params = scope.params.iter().map(|param| param.name.text.as_str());
        let consts = scope.consts.keys().map(String::as_str);
        if let Some(near) = self.diagnostics.near(&name.text, params.chain(consts)) {
            let message = format!("`{}` is not a parameter, so the name itself is the value", name.text);
            let diagnostic =
                Diagnostic::new(Code::W0106, name.span, message).label(format!("did you mean `{}`?", near.name));
            self.diagnostics.push(diagnostic.help(format!("if a text is meant, write `\"{}\"`", name.text)));
        }
        value(ValueKind::Constant(Constant::Text(name.text.clone())))
    }

    /// Reads a time, or the name of a time. Reports any other value.
    pub(super) fn duration(&mut self, node: &Node) -> Option<Duration> {
        let span: Span = node.span();
        let named = node.names().next().filter(|_| node.token(Number).is_none());
        let named = named.and_then(|name| self.scope.consts.get(&name.text));
        let (seconds, dimension) = if let Some(named) = named {
            match named.values.as_slice() {
                [_] if named.is_broken() => return None,
                [Value { kind: ValueKind::Constant(Constant::Number(number)), dimension, .. }] => (*number, *dimension),
                [..] => (0.0, None),
            }
        } else if node.kind() == SyntaxKind::Constant && node.token(Number).is_some() {
            quantity(node, self.diagnostics)?
        } else {
            self.diagnostics.push(Diagnostic::new(Code::E0009, span, "expected a time, such as `5 s`"));
            return None;
        };
        if dimension != Some(Dimension::TIME) || !(0.0..=SECONDS_MAX).contains(&seconds) {
            let is_long = dimension == Some(Dimension::TIME) && seconds > SECONDS_MAX;
            let why = if is_long { "is too long for a time" } else { "is not a time" };
            let help = match is_long {
                true => format!("the longest time is {SECONDS_MAX} s"),
                false => "a time has a unit, and is not negative: `5 s`, `20 ms`".to_owned(),
            };
            let diagnostic = count::wrong(span, named, format!("`{}` {why}", node.compact_text()));
            self.diagnostics.push(diagnostic.help(help));
            return None;
        }
        Duration::try_from_secs_f64(seconds).ok()
    }
}

/// Returns whether a text can be a key of the database: words joined by `/`, of which none is empty.
pub(super) fn is_key(text: &str) -> bool {
    let is_word = |word: &str| !word.is_empty() && word != "." && word != "..";
    let has_meaning = |c: char| c.is_control() || matches!(c, '*' | '$' | '?' | '#');
    text.len() <= KEY_SIZE_MAX && text.split('/').all(is_word) && !text.contains(has_meaning)
}

/// Reads a number with an optional unit. Returns it in SI units.
pub(super) fn quantity(node: &Node, diagnostics: &mut Diagnostics) -> Option<(f64, Option<Dimension>)> {
    let number = node.token(Number)?;
    let Some(mut value) = number.number() else {
        diagnostics.push(Diagnostic::new(Code::E0009, number.span(), "the number is too large"));
        return None;
    };
    warn_of_lost_digits(&number.text().replace('_', ""), value, number.span(), diagnostics);
    if node.token(Minus).is_some() {
        value = -value;
    }
    let units: Vec<Name> = node.tokens().filter(|token| token.kind() == Ident).map(|token| token.name()).collect();
    let Some(first) = units.first() else { return Some((value, None)) };
    let per = units.get(1);
    let Some((factor, dimension)) = unit::unit(&first.text, per.map(|name| name.text.as_str())) else {
        report_unknown_unit(first, per, diagnostics);
        return None;
    };
    Some((value * factor, Some(dimension)))
}

/// Warns if a whole number has more digits than a floating-point number can keep.
fn warn_of_lost_digits(text: &str, value: f64, span: Span, diagnostics: &mut Diagnostics) {
    let is_whole = text.bytes().all(|byte| byte.is_ascii_digit());
    let (digits, kept) = (text.trim_start_matches('0'), format!("{value:.0}"));
    if is_whole && !digits.is_empty() && digits != kept {
        let diagnostic =
            Diagnostic::new(Code::W0012, span, format!("a number cannot keep all these digits; it becomes {kept}"));
        diagnostics.push(diagnostic.help(format!("to keep all digits, write a text: `\"{text}\"`")));
    }
}

fn report_unknown_unit(first: &Name, per: Option<&Name>, diagnostics: &mut Diagnostics) {
    let is_known = |name: &&Name| unit::unit(&name.text, None).is_some();
    let wrong = per.filter(|per| is_known(&first) && !is_known(per)).unwrap_or(first);
    let diagnostic = Diagnostic::new(Code::E0008, wrong.span, format!("unknown unit `{}`", wrong.text));
    let diagnostic = match diagnostics.near(&wrong.text, unit::symbols()) {
        Some(near) => diagnostic.label(format!("did you mean `{}`?", near.name)),
        None => {
            diagnostic.help("the known units are `s`, `m`, `rad`, `Hz`, `N`, `kg`, `A`, `V`, `B` and their multiples")
        }
    };
    diagnostics.push(diagnostic);
}
