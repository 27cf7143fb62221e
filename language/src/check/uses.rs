//! Files that are used but are not there.

use crate::diagnostic::{Code, Diagnostic};
use crate::gather::{normal, resolve, uses};
use crate::source::{Role, Source};
use crate::syntax::ast::Node;

/// Reports each `use` of a file that could not be read.
pub(super) fn check(file: &Node, source: &Source, spec: &Source, others: &[Source], diagnostics: &mut Vec<Diagnostic>) {
    for used in uses(file) {
        let path = resolve(&source.name, &used.text);
        let found = others.iter().find(|other| other.name == path && other.role != Role::Whole);
        let why = match found.map(|found| &found.role) {
            Some(Role::Missing(why)) => why.as_str(),
            Some(Role::Part | Role::Whole) => continue,
            None if normal(&spec.name) == path => continue,
            None => "nobody has read it",
        };
        let message = format!("cannot read `{}`: {why}", used.text);
        let diagnostic = Diagnostic::new(Code::E0010, used.span, message);
        diagnostics.push(diagnostic.help(format!("a path is relative to the file that it is written in: `{path}`")));
    }
}
