//! The types in a text, and their shapes.
//!
//! Messages are compared by the names of their types, because programs that were built separately agree on nothing
//! else. Their contents are compared only if both ends declare them. A record without a name is compared by its fields.
//! Values are compared with the
//! shape of the type.
//!
//! A name means the type of that name in its own text, otherwise in the spec, because programs do not know each other's
//! types.

use super::{Param, Process, Spec, Value, ValueKind};
use crate::plan::Constant;
use crate::source::{Origin, Span};
use crate::syntax::ast::Name;
use std::fmt;

/// The largest number of fields of a record, together with the fields of its inner records.
pub(crate) const FIELDS_MAX: usize = 1000;

/// A type in a text.
#[derive(Clone, Debug)]
pub(crate) struct Kind {
    /// The text without white space: `Wrench`, `Force[3]`, `{force:Force}`.
    pub(crate) text: String,
    pub(crate) span: Span,
    /// The fields, if the type is a record without a name.
    pub(crate) fields: Option<Vec<Param>>,
}

/// The declaration `type Grasp = { force: Force };`.
#[derive(Debug)]
pub(crate) struct NamedType {
    pub(crate) name: Name,
    /// The text of the doc comments of the type.
    pub(crate) doc: String,
    pub(crate) kind: Kind,
    /// Whether the spec or one of its files declares the type. It is `false` for types of programs.
    pub(crate) is_own: bool,
}

/// The result of comparing two types.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum TypeMatch {
    Same,
    Different,
    /// These two named types have the same name, but are different types.
    OnlyByName(usize, usize),
}

/// The structure of a type. Declarations replace the names in it.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Shape<'a> {
    Record(&'a [Param]),
    /// The type of the elements, and their number. Without a number, the list may have any length.
    List(&'a str, Option<usize>),
    /// A type of the language, or a message type of programs.
    Plain(&'a str),
}

impl Param {
    /// Returns an element of a list, in the form of a parameter. `self` is the list.
    pub(crate) fn element(&self, kind: &str) -> Self {
        let kind = self.kind.as_ref().map(|list| Kind { text: kind.to_owned(), span: list.span, fields: None });
        Self { kind, range: self.range.clone(), default: None, name: self.name.clone() }
    }
}

impl Kind {
    /// Returns the name in a type: `Force` of `Force[3]`. A record without a name has none.
    pub(crate) fn name(&self) -> Option<&str> {
        self.fields.is_none().then(|| self.text.split('[').next().unwrap_or_default())
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(fields) = &self.fields else { return f.write_str(&self.text) };
        let fields: Vec<String> = fields.iter().map(Param::to_string).collect();
        write!(f, "{{ {} }}", fields.join(", "))
    }
}

/// Writes `name: Type in range = value`.
impl fmt::Display for Param {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name.text)?;
        if let Some(kind) = &self.kind {
            write!(f, ": {kind}")?;
        }
        if let Some(range) = &self.range {
            write!(f, " in {range}")?;
        }
        if let Some(default) = &self.default {
            write!(f, " = {default}")?;
        }
        Ok(())
    }
}

/// Writes the value in SI units. A record has the form that a spec writes.
impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.kind {
            ValueKind::Constant(Constant::Text(text)) => write!(f, "\"{text}\""),
            ValueKind::Constant(Constant::Number(number)) => write!(f, "{number}"),
            ValueKind::Constant(Constant::Truth(truth)) => write!(f, "{truth}"),
            ValueKind::Constant(Constant::Secret(key)) => write!(f, "secret({key:?})"),
            ValueKind::Record(fields) => {
                let fields: Vec<String> =
                    fields.iter().map(|(name, value)| format!("{} = {value}", name.text)).collect();
                write!(f, "{{ {} }}", fields.join(", "))
            }
            ValueKind::List(values) => {
                let values: Vec<String> = values.iter().map(Self::to_string).collect();
                write!(f, "[{}]", values.join(", "))
            }
            ValueKind::Param(_) | ValueKind::Broken => f.write_str("?"),
        }
    }
}

impl Spec {
    /// Returns the named type that a name means in this text.
    pub(crate) fn named(&self, name: &str, user: Origin) -> Option<usize> {
        let all = self.type_names.get(name)?;
        let find = |fits: &dyn Fn(&NamedType) -> bool| all.iter().copied().find(|&named| fits(&self.types[named]));
        let own = find(&|named| named.name.span.origin == user).or_else(|| find(&|named| named.is_own));
        own.or_else(|| all.first().copied())
    }

    /// Follows the names of a type to a type that is not an alias.
    fn last<'a>(&'a self, kind: &'a Kind) -> &'a Kind {
        let mut kind = kind;
        // No path is longer than the number of names. A cycle is reported elsewhere.
        for _ in 0..self.types.len() {
            match self.named(&kind.text, kind.span.origin).map(|named| &self.types[named].kind) {
                Some(next) if next.fields.is_none() => kind = next,
                Some(_) | None => break,
            }
        }
        kind
    }

    /// Returns the structure of the values of a type.
    pub(crate) fn shape<'a>(&'a self, kind: &'a Kind) -> Shape<'a> {
        let kind = self.last(kind);
        let named = self.named(&kind.text, kind.span.origin).map(|named| &self.types[named].kind);
        match kind.fields.as_ref().or_else(|| named?.fields.as_ref()) {
            Some(fields) => Shape::Record(fields),
            None => match kind.text.strip_suffix(']').and_then(|list| list.split_once('[')) {
                Some((element, count)) => Shape::List(element, count.parse().ok()),
                None => Shape::Plain(&kind.text),
            },
        }
    }

    /// Compares the types of two ends of a connection.
    pub(crate) fn compare(&self, one: &Kind, other: &Kind) -> TypeMatch {
        let (one, other) = (self.last(one), self.last(other));
        let named = |kind: &Kind| self.named(kind.name()?, kind.span.origin);
        match (named(one), named(other)) {
            _ if self.is_same(one, other) => TypeMatch::Same,
            (Some(a), Some(b)) if one.text == other.text => TypeMatch::OnlyByName(a, b),
            (_, _) => TypeMatch::Different,
        }
    }

    /// Returns whether values of two types are sent in the same way. Defaults do not matter for this.
    pub(crate) fn is_same(&self, one: &Kind, other: &Kind) -> bool {
        let (one, other) = (self.last(one), self.last(other));
        match (&one.fields, &other.fields) {
            (Some(one), Some(other)) => {
                one.len() == other.len() && std::iter::zip(one, other).all(|(a, b)| self.is_same_field(a, b))
            }
            (None, None) => {
                let named = |kind: &Kind| self.named(kind.name()?, kind.span.origin);
                let is_same = |(a, b): (usize, usize)| a == b || self.is_same(&self.types[a].kind, &self.types[b].kind);
                one.text == other.text && named(one).zip(named(other)).is_none_or(is_same)
            }
            (Some(_), None) | (None, Some(_)) => false,
        }
    }

    /// Returns whether two fields have the same name and the same type.
    pub(crate) fn is_same_field(&self, one: &Param, other: &Param) -> bool {
        let kinds = one.kind.as_ref().zip(other.kind.as_ref());
        one.name.text == other.name.text && kinds.is_some_and(|(one, other)| self.is_same(one, other))
    }

    /// Returns whether a parameter or field may be left out, because it has a default, or because all its fields have a default.
    pub(crate) fn is_optional(&self, param: &Param) -> bool {
        let shape = param.kind.as_ref().map(|kind| self.shape(kind));
        let has_all =
            |shape| matches!(shape, Shape::Record(fields) if fields.iter().all(|field| self.is_optional(field)));
        param.default.is_some() || shape.is_some_and(has_all)
    }

    /// Returns all types that the text contains anywhere.
    pub(crate) fn kinds(&self) -> Vec<&Kind> {
        fn of_params(params: &[Param]) -> impl Iterator<Item = &Kind> {
            params.iter().filter_map(|param| param.kind.as_ref())
        }
        let modules = self.modules.iter().flat_map(|module| {
            let ports = module.ports.iter().filter_map(|port| port.kind.as_ref());
            let outcomes = module.outcomes.iter().filter_map(|outcome| outcome.kind.as_ref());
            let params = module.declared().filter_map(|param| param.kind.as_ref());
            params.chain(ports).chain(outcomes)
        });
        let charts = self.processes.iter().filter_map(Process::chart).flat_map(|chart| {
            let ports = chart.ports.iter().filter_map(|port| port.kind.as_ref());
            ports.chain(chart.outcomes.iter().filter_map(|outcome| outcome.kind.as_ref()))
        });
        let processes = self.processes.iter().flat_map(|process| of_params(&process.params)).chain(charts);
        let mut kinds: Vec<&Kind> =
            self.types.iter().map(|named| &named.kind).chain(processes).chain(modules).collect();
        let mut next = 0;
        while let Some(kind) = kinds.get(next) {
            kinds.extend(of_params(kind.fields.as_deref().unwrap_or_default()));
            next += 1;
        }
        kinds
    }

    /// Returns all fields of all record types.
    pub(crate) fn fields(&self) -> impl Iterator<Item = &Param> {
        self.kinds().into_iter().flat_map(|kind| kind.fields.as_deref().unwrap_or_default())
    }
}
