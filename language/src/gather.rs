//! The files that a spec uses: `use "arm.dca";`.

use crate::source::{Origin, Role, Source};
use crate::syntax::SyntaxKind::{Text, Use};
use crate::syntax::ast::{Name, Node};
use crate::syntax::parse;
use std::collections::BTreeSet;

/// The most files of one spec.
const FILES_MAX: usize = 1000;

/// Returns the files that a spec uses, directly and through others, each once; they are compiled with the spec as if they
/// were interfaces. `read` is asked for each by its path: relative to the file that uses it, and without `..` where that
/// can be. A file that it refuses is reported by the compiler, with the reason.
///
/// ```
/// use language::{Options, Source, compile, gather};
///
/// let spec = Source::new("robots/door.dca", "use \"../arm.dca\"; process main() {
///     instantiated_processes { arm instof Arm(c1); } internal_event_actions { arm }
/// }");
/// let read = |path: &str| match path {
///     "arm.dca" => Ok("module Arm(host) { done; }".to_owned()),
///     _ => Err("no such file".to_owned()),
/// };
/// let parts = gather(&spec, &read);
/// assert!(compile(&spec, &parts, &Options::named("door")).diagnostics.is_empty());
/// ```
pub fn gather(spec: &Source, read: &dyn Fn(&str) -> Result<String, String>) -> Vec<Source> {
    let mut known = BTreeSet::from([normal(&spec.name)]);
    let mut parts: Vec<Source> = Vec::new();
    let mut next = 0;
    let mut user = Some(spec.clone());
    while let Some(source) = user {
        for used in may_use(&source).then(|| tree(&source)).iter().flat_map(uses) {
            let path = resolve(&source.name, &used.text);
            if parts.len() >= FILES_MAX || !known.insert(path.clone()) {
                continue;
            }
            let (text, role) = match read(&path) {
                Ok(text) => (text, Role::Part),
                Err(why) => (String::new(), Role::Missing(why)),
            };
            parts.push(Source { name: path, text, role });
        }
        user = parts.get(next).cloned();
        next += 1;
    }
    parts
}

fn tree(source: &Source) -> Node {
    Node::new(parse(source, Origin::Spec).root, Origin::Spec)
}

/// Whether a text is worth reading for what it uses: most use nothing, and an editor asks at each keystroke.
fn may_use(source: &Source) -> bool {
    // A comment may stand before the path.
    source.text.split("use").skip(1).any(|rest| rest.trim_start().starts_with(['"', '/']))
}

/// The paths in the `use` items of a file, as they are written.
pub(crate) fn uses(file: &Node) -> Vec<Name> {
    let items = file.children_of(Use);
    items.filter_map(|item| item.token(Text).map(|path| Name { text: path.content(), span: path.span() })).collect()
}

/// The path of a file that another one uses.
pub(crate) fn resolve(user: &str, path: &str) -> String {
    match user.rsplit_once('/') {
        Some((folder, _)) if !path.starts_with('/') => normal(&format!("{folder}/{path}")),
        Some(_) | None => normal(path),
    }
}

/// A path without `.`, and without `..` after a name.
pub(crate) fn normal(path: &str) -> String {
    let mut parts: Vec<&str> = Vec::new();
    for part in path.split('/') {
        match (part, parts.last()) {
            (".", _) => {}
            ("..", Some(&last)) if last != ".." && !last.is_empty() => {
                parts.pop();
            }
            (_, _) => parts.push(part),
        }
    }
    parts.join("/")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_relative_to_their_user() {
        assert_eq!(resolve("specs/door.dca", "arm.dca"), "specs/arm.dca");
        assert_eq!(resolve("specs/door.dca", "./lib/../arm.dca"), "specs/arm.dca");
        assert_eq!(resolve("specs/door.dca", "../../arm.dca"), "../arm.dca");
        assert_eq!(resolve("door.dca", "arm.dca"), "arm.dca");
        assert_eq!(resolve("/a/door.dca", "/b/arm.dca"), "/b/arm.dca");
    }

    #[test]
    fn files_that_use_each_other_are_read_once() {
        let read = |path: &str| match path {
            "a.dca" => Ok("use \"b.dca\"; use \"spec.dca\";".to_owned()),
            "b.dca" => Ok("use \"a.dca\"; use \"c.dca\";".to_owned()),
            _ => Err("no such file".to_owned()),
        };
        let parts = gather(&Source::new("spec.dca", "use \"a.dca\"; use \"a.dca\";"), &read);
        let found: Vec<(&str, bool)> = parts.iter().map(|part| (part.name.as_str(), part.role == Role::Part)).collect();
        assert_eq!(found, [("a.dca", true), ("b.dca", true), ("c.dca", false)]);
    }
}
