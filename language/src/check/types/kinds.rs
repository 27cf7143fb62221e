//! Checks values against declared types.

use crate::check::diagnostics::Diagnostics;
use crate::check::names::listed;
use crate::check::quantity;
use crate::check::range;
use crate::check::spec::{Arg, Kind, Param, Shape, Spec, Value, ValueKind};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::Constant;
use crate::similar::Near;
use crate::source::Span;
use crate::syntax::ast::Name;
use crate::unit;

/// The largest number of fields of one record that a message shows.
const SHOWN_MAX: usize = 8;

/// Compares the values in one scope with types.
pub(super) struct TypeChecker<'a> {
    pub(super) spec: &'a Spec,
    /// The parameters that a value may name.
    pub(super) outer: &'a [Param],
    /// The field that each name in a record refers to.
    pub(super) uses: &'a mut Vec<(Span, Span)>,
    pub(super) diagnostics: &'a mut Diagnostics,
}

impl TypeChecker<'_> {
    /// Compares arguments with their parameters.
    pub(super) fn arguments(&mut self, params: &[Param], args: &[Arg]) {
        let mut places = params.iter();
        for arg in args {
            let param = match &arg.name {
                Some(name) => params.iter().find(|param| param.name.text == name.text),
                None => places.next(),
            };
            if let Some(param) = param {
                self.value(param, &arg.value);
            }
        }
    }

    /// Compares an end of a range with its parameter or field. If this is a list, the end is compared with its
    /// elements.
    pub(super) fn bound(&mut self, param: &Param, value: &Value) {
        let element = match param.kind.as_ref().map(|kind| self.spec.shape(kind)) {
            Some(Shape::List(element, _)) => param.element(element),
            Some(Shape::Record(_) | Shape::Plain(_)) | None => param.clone(),
        };
        self.value(&Param { range: None, ..element }, value);
    }

    /// Compares a value with its parameter or field.
    pub(super) fn value(&mut self, param: &Param, value: &Value) {
        let before = self.diagnostics.count();
        self.kind(param, value);
        let is_fit = self.diagnostics.count() == before;
        if let (true, Some(range), ValueKind::Constant(constant)) = (is_fit, &param.range, &value.kind)
            && range::is_plain(self.spec, param)
            && !range.has(constant)
        {
            self.diagnostics.push(range::outside(param, range, constant, value.span));
        }
    }

    fn kind(&mut self, param: &Param, value: &Value) {
        let Some(kind) = &param.kind else { return };
        match (self.spec.shape(kind), &value.kind) {
            (_, ValueKind::Broken) => {}
            (Shape::Record(fields), ValueKind::Record(given)) => self.record(kind, fields, given, value.span),
            (_, ValueKind::Param(index)) => self.handed_on(param, kind, *index, value.span),
            (Shape::List(element, count), ValueKind::List(given)) => {
                self.list(param, element, count, given, value.span);
            }
            (Shape::Record(_), _) => self.other(param, kind, "a record", value.span),
            (Shape::List(..), _) => self.other(param, kind, "a list", value.span),
            (Shape::Plain(name), _) => self.plain(param, name, value),
        }
    }

    fn other(&mut self, param: &Param, kind: &Kind, what: &str, span: Span) {
        let (name, example) = (&param.name.text, self.example(kind));
        self.wrong(param, span, format!("`{name}` is of type {kind}: expected {what} such as `{example}`"));
    }

    /// Checks the values of a list: their number, and the type of each.
    fn list(&mut self, param: &Param, element: &str, count: Option<usize>, given: &[Value], span: Span) {
        if let Some(count) = count.filter(|&count| count != given.len()) {
            let message = format!("`{}` has {count} values of type {element}, not {}", param.name.text, given.len());
            self.wrong(param, span, message);
            return;
        }
        let element = param.element(element);
        given.iter().for_each(|value| self.value(&element, value));
    }

    /// Checks a value of a type of the language. An unknown type accepts any value.
    fn plain(&mut self, param: &Param, kind: &str, value: &Value) {
        let name = &param.name.text;
        if unit::of_type(kind).is_some() {
            if let Some(diagnostic) = quantity::misfit(param, kind, value) {
                self.diagnostics.push(diagnostic);
            }
            return;
        }
        let refused: &[&str] = match &value.kind {
            ValueKind::Constant(Constant::Text(_)) => &["Number", "Truth", unit::SECRET],
            ValueKind::Constant(Constant::Number(_)) => &["Text", "Truth", "Host", unit::RESOURCE, unit::SECRET],
            ValueKind::Constant(Constant::Truth(_)) => &["Text", "Number", "Host", unit::RESOURCE, unit::SECRET],
            ValueKind::Constant(Constant::Secret(_)) => &["Host", "Text", "Number", "Truth", unit::RESOURCE],
            ValueKind::Record(_) | ValueKind::List(_) => &unit::PLAIN,
            ValueKind::Param(_) | ValueKind::Broken => &[],
        };
        if refused.contains(&kind) && matches!(value.kind, ValueKind::Constant(Constant::Secret(_))) {
            self.wrong(
                param,
                value.span,
                format!("`{name}` has to be a {kind}: a secret needs a parameter of type Secret, or without a type"),
            );
        } else if refused.contains(&kind) && kind == unit::SECRET {
            self.wrong(
                param,
                value.span,
                format!("`{name}` has to be a {kind}, such as `secret(\"team/camera/password\")`"),
            );
        } else if refused.contains(&kind) {
            self.wrong(param, value.span, format!("`{name}` has to be a {kind}"));
        }
    }

    /// Checks a parameter of the surrounding group that is passed on.
    fn handed_on(&mut self, param: &Param, kind: &Kind, index: usize, span: Span) {
        let Some(outer) = self.outer.get(index) else { return };
        let Some(given) = &outer.kind else { return };
        let is_fit = match (self.spec.shape(kind), self.spec.shape(given)) {
            (Shape::Record(one), Shape::Record(other)) => self.fits(one, other),
            (Shape::Plain(one), Shape::Plain(other)) => match (unit::of_type(one), unit::of_type(other)) {
                (Some((one, _)), Some((other, _))) => one == other,
                (_, _) => true,
            },
            (Shape::List(..), Shape::List(..)) => self.spec.is_same(kind, given),
            (Shape::Record(_), Shape::List(..)) | (Shape::List(..), Shape::Record(_)) => false,
            // An unknown type may be a type of a program.
            (Shape::Record(_) | Shape::List(..), Shape::Plain(name))
            | (Shape::Plain(name), Shape::Record(_) | Shape::List(..)) => !unit::is_type(name),
        };
        if !is_fit {
            let name = &param.name.text;
            self.wrong(
                param,
                span,
                format!("`{name}` is of type {kind}, but `{}` is of type {given}", outer.name.text),
            );
        }
    }

    /// Returns whether two record types have the same fields, in any order.
    fn fits(&self, one: &[Param], other: &[Param]) -> bool {
        let has = |field: &Param| other.iter().any(|other| self.spec.is_same_field(field, other));
        one.len() == other.len() && one.iter().all(has)
    }

    /// Checks the values of a record: every field occurs once, with a value of its type.
    fn record(&mut self, kind: &Kind, fields: &[Param], given: &[(Name, Value)], span: Span) {
        let mut is_known = true;
        for (name, value) in given {
            if let Some(field) = fields.iter().find(|field| field.name.text == name.text) {
                self.uses.push((name.span, field.name.span));
                self.value(field, value);
            } else {
                is_known = false;
                self.report_unknown_field(kind, fields, name);
            }
        }
        let is_missing = |field: &&Param| {
            given.iter().all(|(name, _)| name.text != field.name.text) && !self.spec.is_optional(field)
        };
        let missing: Vec<&Param> = fields.iter().filter(is_missing).collect();
        // A misspelt field already explains a missing field.
        let (Some(first), true) = (missing.first(), is_known) else { return };
        let message =
            format!("{kind} lacks {}", listed(missing.iter().take(SHOWN_MAX).map(|field| field.name.text.as_str())));
        let examples: Vec<String> = missing.iter().take(SHOWN_MAX).map(|field| self.field_example(field)).collect();
        let diagnostic = Diagnostic::new(Code::E0215, span, message).reason(first.name.span, "declared here");
        self.diagnostics.push(diagnostic.help(format!("add `{}`", examples.join(", "))));
    }

    fn wrong(&mut self, param: &Param, span: Span, message: String) {
        let diagnostic = Diagnostic::new(Code::E0213, span, message);
        self.diagnostics.push(diagnostic.reason(param.name.span, "declared here"));
    }

    /// Returns an example of a value of this type, as text.
    fn example(&self, kind: &Kind) -> String {
        match self.spec.shape(kind) {
            Shape::Record(fields) => {
                let needed = fields.iter().filter(|field| !self.spec.is_optional(field));
                let needed: Vec<String> = needed.take(SHOWN_MAX).map(|field| self.field_example(field)).collect();
                if needed.is_empty() { "{}".to_owned() } else { format!("{{ {} }}", needed.join(", ")) }
            }
            Shape::List(element, count) => {
                let element = Kind { text: element.to_owned(), span: kind.span, fields: None };
                let count = count.unwrap_or(2).min(SHOWN_MAX);
                format!("[{}]", vec![self.example(&element); count].join(", "))
            }
            Shape::Plain("Number") => "1".to_owned(),
            Shape::Plain("Truth") => "true".to_owned(),
            Shape::Plain("Host") => "c1".to_owned(),
            Shape::Plain(unit::RESOURCE) => "arm".to_owned(),
            Shape::Plain("Text") => "\"text\"".to_owned(),
            Shape::Plain(unit::SECRET) => "secret(\"team/key\")".to_owned(),
            Shape::Plain(name) => unit::of_type(name).map_or("...", |(_, example)| example).to_owned(),
        }
    }

    fn field_example(&self, field: &Param) -> String {
        let value = field.kind.as_ref().map_or_else(|| "...".to_owned(), |kind| self.example(kind));
        format!("{} = {value}", field.name.text)
    }

    fn report_unknown_field(&mut self, kind: &Kind, fields: &[Param], name: &Name) {
        let diagnostic = Diagnostic::new(Code::E0214, name.span, format!("{kind} has no field `{}`", name.text));
        let near = self.diagnostics.near(&name.text, fields.iter().map(|field| field.name.text.as_str()));
        let field = |near: &Near<'_>| fields.iter().find(|field| field.name.text == near.name);
        let diagnostic = match near.as_ref().and_then(|near| Some((near, field(near)?))) {
            Some((near, field)) => {
                diagnostic.reason(field.name.span, "a field with a similar name").rename(name.span, near)
            }
            None => {
                let known = listed(fields.iter().take(SHOWN_MAX).map(|field| field.name.text.as_str()));
                diagnostic.help(format!("its fields are {known}"))
            }
        };
        self.diagnostics.push(diagnostic);
    }
}
