//! Types as they are written, and what they come to.
//!
//! Messages are compared by name, since programs that were built apart agree on nothing else; a record that is written
//! out has no name, and is compared as it is written. What a value is compared with is its shape.

use super::{Param, Spec, Value, ValueKind};
use crate::plan::Constant;
use crate::source::Span;
use crate::syntax::ast::Name;
use std::fmt;

/// The most fields of a record, with those of the records in it.
pub(crate) const FIELDS_MAX: usize = 1000;

/// A type as it is written.
#[derive(Clone, Debug)]
pub(crate) struct Kind {
    /// Without white space: `Wrench`, `Force[3]`, `{force:Force}`.
    pub(crate) text: String,
    pub(crate) span: Span,
    /// The fields of a record that is written out.
    pub(crate) fields: Option<Vec<Param>>,
}

/// `type Grasp = { force: Force };`
#[derive(Debug)]
pub(crate) struct NamedType {
    pub(crate) name: Name,
    /// What its doc comments say.
    pub(crate) doc: String,
    pub(crate) kind: Kind,
}

/// What a type comes to when names are followed.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Shape<'a> {
    Record(&'a [Param]),
    /// A type of the language, a message of programs, or a list.
    Plain(&'a str),
}

impl Kind {
    /// The name in a type: `Force` of `Force[3]`. Nothing for a record that is written out.
    pub(crate) fn name(&self) -> Option<&str> {
        self.fields.is_none().then(|| self.text.split('[').next().unwrap_or_default())
    }

    /// Whether two texts say the same of a type: values and comments aside, which do not change what is sent.
    pub(crate) fn agrees(&self, other: &Self) -> bool {
        match (&self.fields, &other.fields) {
            (Some(one), Some(other)) => {
                let same = |(a, b): (&Param, &Param)| {
                    let kinds = (a.kind.as_ref(), b.kind.as_ref());
                    a.name.text == b.name.text && matches!(kinds, (Some(a), Some(b)) if a.agrees(b))
                };
                one.len() == other.len() && std::iter::zip(one, other).all(same)
            }
            (None, None) => self.text == other.text,
            (Some(_), None) | (None, Some(_)) => false,
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(fields) = &self.fields else { return f.write_str(&self.text) };
        let fields: Vec<String> = fields.iter().map(Param::to_string).collect();
        write!(f, "{{ {} }}", fields.join(", "))
    }
}

/// `name: Type = value`
impl fmt::Display for Param {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name.text)?;
        if let Some(kind) = &self.kind {
            write!(f, ": {kind}")?;
        }
        if let Some(default) = &self.default {
            write!(f, " = {default}")?;
        }
        Ok(())
    }
}

/// In SI units; a record as it is written.
impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.kind {
            ValueKind::Constant(Constant::Text(text)) => write!(f, "\"{text}\""),
            ValueKind::Constant(Constant::Number(number)) => write!(f, "{number}"),
            ValueKind::Constant(Constant::Truth(truth)) => write!(f, "{truth}"),
            ValueKind::Record(fields) => {
                let fields: Vec<String> =
                    fields.iter().map(|(name, value)| format!("{} = {value}", name.text)).collect();
                write!(f, "{{ {} }}", fields.join(", "))
            }
            ValueKind::Param(_) | ValueKind::Broken => f.write_str("?"),
        }
    }
}

impl Spec {
    /// Follows the names of a type to what does not stand for another one.
    fn last<'a>(&'a self, kind: &'a Kind) -> &'a Kind {
        let mut kind = kind;
        // No way is longer than there are names; one that goes round is reported.
        for _ in 0..self.types.len() {
            match self.type_names.get(&kind.text).map(|&named| &self.types[named].kind) {
                Some(next) if next.fields.is_none() => kind = next,
                Some(_) | None => break,
            }
        }
        kind
    }

    /// What values of a type look like.
    pub(crate) fn shape<'a>(&'a self, kind: &'a Kind) -> Shape<'a> {
        let kind = self.last(kind);
        let named = self.type_names.get(&kind.text).map(|&named| &self.types[named].kind);
        match kind.fields.as_ref().or_else(|| named?.fields.as_ref()) {
            Some(fields) => Shape::Record(fields),
            None => Shape::Plain(&kind.text),
        }
    }

    /// Whether two ends of a connection have the same type.
    pub(crate) fn is_same(&self, one: &Kind, other: &Kind) -> bool {
        self.last(one).text == self.last(other).text
    }

    /// Whether a parameter or field may be left out: it has a default, or all of its fields have one.
    pub(crate) fn is_optional(&self, param: &Param) -> bool {
        let shape = param.kind.as_ref().map(|kind| self.shape(kind));
        let has_all =
            |shape| matches!(shape, Shape::Record(fields) if fields.iter().all(|field| self.is_optional(field)));
        param.default.is_some() || shape.is_some_and(has_all)
    }

    /// Every type that is written somewhere.
    pub(crate) fn kinds(&self) -> Vec<&Kind> {
        fn of_params(params: &[Param]) -> impl Iterator<Item = &Kind> {
            params.iter().filter_map(|param| param.kind.as_ref())
        }
        let modules = self.modules.iter().flat_map(|module| {
            let ports = module.ports.iter().filter_map(|port| port.kind.as_ref());
            let outcomes = module.outcomes.iter().filter_map(|outcome| outcome.kind.as_ref());
            let params = of_params(module.params.as_deref().unwrap_or_default());
            params.chain(ports).chain(outcomes)
        });
        let processes = self.processes.iter().flat_map(|process| of_params(&process.params));
        let mut kinds: Vec<&Kind> =
            self.types.iter().map(|named| &named.kind).chain(processes).chain(modules).collect();
        let mut next = 0;
        while let Some(kind) = kinds.get(next) {
            kinds.extend(of_params(kind.fields.as_deref().unwrap_or_default()));
            next += 1;
        }
        kinds
    }

    /// Every field of every record type.
    pub(crate) fn fields(&self) -> impl Iterator<Item = &Param> {
        self.kinds().into_iter().flat_map(|kind| kind.fields.as_deref().unwrap_or_default())
    }
}
