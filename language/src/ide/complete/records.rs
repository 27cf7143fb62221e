//! Completes named types and the fields of records.

use super::place::Cursor;
use super::{Completion, CompletionKind};
use crate::check::spec::{Kind, Module, Param, Shape};
use crate::ide::Analysis;
use crate::syntax::SyntaxKind;
use crate::syntax::ast::Node;
use std::collections::BTreeSet;

impl Analysis {
    /// Returns the declared types.
    pub(super) fn named_types(&self) -> Vec<Completion> {
        let types = self.model.types.iter();
        let offer = |name: &str, detail: String| Completion::new(CompletionKind::Type, name).detail(detail);
        types.map(|named| offer(&named.name.text, named.kind.to_string()).documentation(&named.doc)).collect()
    }

    /// Returns the fields that the record around the cursor lacks: `force = `.
    pub(super) fn fields(&self, at: &Cursor) -> Vec<Completion> {
        let (Some(record), Some(param)) = (at.inside(SyntaxKind::Record), self.expected(at)) else { return Vec::new() };
        let given: BTreeSet<String> =
            record.children().filter_map(|field| field.names().next()).map(|name| name.text).collect();
        let Some(fields) = param.kind.as_ref().and_then(|kind| self.fields_of(kind)) else { return Vec::new() };
        let open = fields.iter().filter(|field| !given.contains(&field.name.text));
        let offer = |field: &Param| {
            Completion::new(CompletionKind::Parameter, format!("{} = ", field.name.text)).detail(field.to_string())
        };
        open.map(offer).collect()
    }

    /// Returns the parameter or field whose value is at the cursor.
    pub(super) fn expected(&self, at: &Cursor) -> Option<&Param> {
        let is_border = |node: &&Node| ![SyntaxKind::Arg, SyntaxKind::Param].contains(&node.kind());
        // The name of a field that is still being written does not lead into a record.
        let own = at.parent.kind() == SyntaxKind::Field;
        let around = at.around.iter().skip(usize::from(own)).take_while(is_border);
        let mut path: Vec<String> = around
            .filter(|node| node.kind() == SyntaxKind::Field)
            .filter_map(|node| node.names().next())
            .map(|name| name.text)
            .collect();
        path.reverse();
        let start = self.param_at(at).or_else(|| self.declared_at(at))?;
        path.iter().try_fold(start, |param, name| {
            self.fields_of(param.kind.as_ref()?)?.iter().find(|field| field.name.text == *name)
        })
    }

    /// Returns the fields of a record, or of the records in a list.
    fn fields_of<'a>(&'a self, kind: &'a Kind) -> Option<&'a [Param]> {
        match self.model.shape(kind) {
            Shape::Record(fields) => Some(fields),
            Shape::List(element, _) => {
                let named = self.model.named(element, kind.span.origin)?;
                self.model.types[named].kind.fields.as_deref()
            }
            Shape::Plain(_) => None,
        }
    }

    /// Returns the parameter or field that is declared around the cursor.
    fn declared_at(&self, at: &Cursor) -> Option<&Param> {
        let span = at.inside(SyntaxKind::Param)?.names().next()?.span;
        let processes = self.model.processes.iter().flat_map(|process| &process.params);
        let modules = self.model.modules.iter().flat_map(Module::declared);
        processes.chain(modules).chain(self.model.fields()).find(|param| param.name.span == span)
    }
}
