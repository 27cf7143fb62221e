//! Reads the variables and the folder of a module's program.

use crate::check::names::twice;
use crate::check::value::Reader;
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{Environment, VARIABLES_MAX, directory_problem, pattern_problem, value_problem, variable_problem};
use crate::source::Span;
use crate::syntax::SyntaxKind::{Inherited, Star, Text, Variable};
use crate::syntax::ast::Node;
use std::collections::BTreeMap;

/// Reads `env { NAME = "value"; }`.
pub(super) fn variables(environment: &mut Environment, item: &Node, reader: &mut Reader<'_>) {
    let mut first: BTreeMap<String, Span> = BTreeMap::new();
    for variable in item.children_of(Variable) {
        let (Some(name), Some(value)) = (variable.names().next(), variable.token(Text)) else { continue };
        let text = value.content();
        let problem = variable_problem(&name.text).map(|why| (name.span, why));
        let problem = problem.or_else(|| Some((value.span(), format!("`{}` {}", name.text, value_problem(&text)?))));
        if let Some((span, why)) = problem {
            reader.diagnostics.push(Diagnostic::new(Code::E0011, span, why));
        } else if let Some(before) = first.insert(name.text.clone(), name.span) {
            reader.diagnostics.push(twice("variable", &name.text, name.span, before));
        } else if environment.variables.len() >= VARIABLES_MAX {
            reader.diagnostics.push(too_many(name.span));
        } else {
            environment.variables.insert(name.text, text);
        }
    }
}

/// Reads `inherit LC_ALL, ROS_*;`.
pub(super) fn inherited(environment: &mut Environment, item: &Node, reader: &mut Reader<'_>) {
    for inherited in item.children_of(Inherited) {
        let Some(name) = inherited.names().next() else { continue };
        let star = if inherited.token(Star).is_some() { "*" } else { "" };
        let pattern = format!("{}{star}", name.text);
        if let Some(why) = pattern_problem(&pattern) {
            reader.diagnostics.push(Diagnostic::new(Code::E0011, name.span, why));
        } else if environment.inherited.len() >= VARIABLES_MAX {
            reader.diagnostics.push(too_many(name.span));
        } else {
            environment.inherited.insert(pattern);
        }
    }
}

/// Reads `directory "/opt/robot";`.
pub(super) fn directory(environment: &mut Environment, item: &Node, reader: &mut Reader<'_>) {
    let Some(token) = item.token(Text) else { return };
    let path = token.content();
    match directory_problem(&path) {
        Some(why) => reader.diagnostics.push(Diagnostic::new(Code::E0011, token.span(), why)),
        None => environment.directory = Some(path),
    }
}

fn too_many(span: Span) -> Diagnostic {
    Diagnostic::new(Code::E0011, span, format!("a module has at most {VARIABLES_MAX} variables"))
}
