//! Reports a `use` of a file or folder that cannot be read.

use super::diagnostics::Diagnostics;
use crate::diagnostic::{Code, Diagnostic};
use crate::gather::{FILES_MAX, normal, resolve, uses};
use crate::source::{Role, Source};
use crate::syntax::ast::{Name, Node};
use std::collections::BTreeMap;

/// The files and folders that were read, by their paths.
pub(super) struct Files<'a> {
    spec: String,
    roles: BTreeMap<&'a str, &'a Role>,
}

impl<'a> Files<'a> {
    pub(super) fn new(spec: &Source, others: &'a [Source]) -> Self {
        let files = others.iter().filter(|other| !matches!(other.role, Role::Whole | Role::Python));
        let roles = files.map(|file| (file.name.as_str(), &file.role)).collect();
        Self { spec: normal(&spec.name), roles }
    }

    /// Reports each `use` of a file or folder that could not be read.
    pub(super) fn check(&self, file: &Node, user: &str, diagnostics: &mut Diagnostics) {
        for used in uses(file) {
            let path = resolve(user, &used.text);
            match self.roles.get(path.as_str()) {
                Some(Role::Part | Role::Whole | Role::Python) => {}
                Some(Role::Missing(why)) => {
                    let help = format!("a path is relative to the file that it is written in: `{path}`");
                    diagnostics.push(unreadable(&used, &used.text, why).help(help));
                }
                Some(Role::Folder(inner)) => {
                    for path in inner {
                        if let Some(Role::Missing(why)) = self.roles.get(path.as_str()) {
                            diagnostics.push(unreadable(&used, path, why).label("it is in this folder"));
                        }
                    }
                }
                None if self.spec == path => {}
                None if self.roles.len() >= FILES_MAX => {
                    diagnostics.push(unreadable(&used, &used.text, &format!("a spec uses at most {FILES_MAX} files")));
                }
                None => diagnostics.push(unreadable(&used, &used.text, "it was not read")),
            }
        }
    }
}

fn unreadable(used: &Name, path: &str, why: &str) -> Diagnostic {
    Diagnostic::new(Code::E0010, used.span, format!("cannot read `{path}`: {why}"))
}
