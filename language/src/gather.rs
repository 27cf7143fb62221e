//! Reads the files that a spec uses: `use "arm.dca";`, and folders of files: `use "arms";`.

use crate::source::{Origin, Role, SOURCE_MAX, Source};
use crate::syntax::SyntaxKind::{Process, Text, Use, Verify};
use crate::syntax::ast::{Name, Node};
use crate::syntax::parse;
use std::collections::BTreeSet;

/// The largest number of files of one spec.
pub(crate) const FILES_MAX: usize = 1000;
/// The largest number of bytes of all files of one spec together.
const TEXTS_MAX: usize = 4 * SOURCE_MAX;

/// The content of a path.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Content {
    /// A file, with its text.
    File(String),
    /// A folder, with the names of its entries, in any order.
    Folder(Vec<String>),
}

/// Returns the files that a spec uses, directly and through other files. Each is returned once, so files may use each other. They are
/// compiled with the spec as if they were interfaces. Of a folder, all `.dca` files are read in the order of their names, but no files in
/// folders below it.
///
/// `read` is called for each path. The path is relative to the file that uses it, and without `..` where possible. If `read` fails, the
/// compiler reports the reason.
///
/// ```
/// use language::{Content, Options, Source, compile, gather};
///
/// let spec = Source::new("robots/door.dca", "use \"../arms\"; process main() {
///     instantiated_processes { arm instof Arm(c1); } internal_event_actions { arm }
/// }");
/// let read = |path: &str| match path {
///     "arms" => Ok(Content::Folder(vec!["arm.dca".to_owned(), "README.md".to_owned()])),
///     "arms/arm.dca" => Ok(Content::File("module Arm(host) { done; }".to_owned())),
///     _ => Err("no such file".to_owned()),
/// };
/// let parts = gather(&spec, &read);
/// assert!(compile(&spec, &parts, &Options::named("door")).diagnostics.is_empty());
/// ```
pub fn gather(spec: &Source, read: &dyn Fn(&str) -> Result<Content, String>) -> Vec<Source> {
    let known = BTreeSet::from([normal(&spec.name)]);
    let mut files = UsedFiles { known, parts: Vec::new(), length: 0, read };
    let mut next = 0;
    let mut user = Some(spec.clone());
    while let Some(source) = user {
        for used in may_use(&source).then(|| tree(&source)).iter().flat_map(uses) {
            files.add(resolve(&source.name, &used.text));
        }
        user = files.parts.get(next).cloned();
        next += 1;
    }
    files.parts
}

/// Returns a spec without its process groups and properties, so with the types, constants and files that another spec may use. The
/// remaining text keeps its position.
pub fn without_groups(spec: &Source) -> Source {
    let mut text = spec.text.clone();
    for item in tree(spec).children() {
        if matches!(item.kind(), Process | Verify) {
            let place = item.span().start as usize..item.span().end as usize;
            let blank = text[place.clone()].bytes().map(|byte| if byte == b'\n' { '\n' } else { ' ' });
            let blank: String = blank.collect();
            text.replace_range(place, &blank);
        }
    }
    Source { text, ..spec.clone() }
}

/// Reads the files that a spec uses.
struct UsedFiles<'a> {
    /// The paths that were already read, with or without success.
    known: BTreeSet<String>,
    parts: Vec<Source>,
    /// The number of bytes of all texts.
    length: usize,
    read: &'a dyn Fn(&str) -> Result<Content, String>,
}

impl UsedFiles<'_> {
    /// Adds a file, or a folder and its specs, unless it is known or there are too many files.
    fn add(&mut self, path: String) {
        if self.parts.len() >= FILES_MAX || !self.known.insert(path.clone()) {
            return;
        }
        match (self.read)(&path) {
            Ok(Content::Folder(names)) => self.add_folder(&path, names),
            Ok(Content::File(text)) => self.add_file(path, text),
            Err(why) => self.parts.push(missing(path, why)),
        }
    }

    fn add_folder(&mut self, folder: &str, mut names: Vec<String>) {
        names.retain(|name| name.ends_with(".dca") && !name.starts_with('.'));
        names.sort_unstable();
        if names.is_empty() {
            return self.parts.push(missing(folder.to_owned(), "the folder has no `.dca` files".to_owned()));
        }
        if self.parts.len() + names.len() >= FILES_MAX {
            let more = names.len();
            let why = format!("a spec uses at most {FILES_MAX} files, and there are {more} more in the folder");
            return self.parts.push(missing(folder.to_owned(), why));
        }
        let paths: Vec<String> = names.iter().map(|name| normal(&format!("{folder}/{name}"))).collect();
        self.parts.push(Source { name: folder.to_owned(), text: String::new(), role: Role::Folder(paths.clone()) });
        for path in paths {
            if !self.known.insert(path.clone()) {
                continue;
            }
            match (self.read)(&path) {
                Ok(Content::File(text)) => self.add_file(path, text),
                Ok(Content::Folder(_)) => self.parts.push(missing(path, "it is a folder".to_owned())),
                Err(why) => self.parts.push(missing(path, why)),
            }
        }
    }

    /// Adds a file, unless the texts would become too long.
    fn add_file(&mut self, name: String, text: String) {
        if self.length + text.len() > TEXTS_MAX {
            let why = format!("the files of a spec have at most {} MiB together", TEXTS_MAX >> 20);
            return self.parts.push(missing(name, why));
        }
        self.length += text.len();
        self.parts.push(Source { name, text, role: Role::Part });
    }
}

fn missing(name: String, why: String) -> Source {
    Source { name, text: String::new(), role: Role::Missing(why) }
}

fn tree(source: &Source) -> Node {
    Node::new(parse(source, Origin::Spec).root, Origin::Spec)
}

/// Returns whether a text may use files. Most texts use none, and an editor asks at each keystroke, so this check is cheap.
fn may_use(source: &Source) -> bool {
    // There may be a comment before the path.
    source.text.split("use").skip(1).any(|rest| rest.trim_start().starts_with(['"', '/']))
}

/// Returns the paths in the `use` items of a file, as the file writes them.
pub(crate) fn uses(file: &Node) -> Vec<Name> {
    let items = file.children_of(Use);
    items.filter_map(|item| item.token(Text).map(|path| Name { text: path.content(), span: path.span() })).collect()
}

/// Returns the path of a file that another file uses.
pub(crate) fn resolve(user: &str, path: &str) -> String {
    match user.rsplit_once('/') {
        Some((folder, _)) if !path.starts_with('/') => normal(&format!("{folder}/{path}")),
        Some(_) | None => normal(path),
    }
}

/// Returns a path without `.`, without `..` after a name, and without a `/` at its end.
pub(crate) fn normal(path: &str) -> String {
    let mut parts: Vec<&str> = Vec::new();
    for part in path.split('/') {
        match (part, parts.last()) {
            (".", _) | ("", Some(_)) => {}
            ("..", Some(&last)) if last != ".." && !last.is_empty() => {
                parts.pop();
            }
            (_, _) => parts.push(part),
        }
    }
    match parts.as_slice() {
        [] => ".".to_owned(),
        [""] => "/".to_owned(),
        [..] => parts.join("/"),
    }
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
        assert_eq!(resolve("/a/door.dca", "arms/"), "/a/arms");
        assert_eq!(resolve("/a/door.dca", ".."), "/");
        assert_eq!((resolve("specs/door.dca", ".."), resolve("door.dca", ".")), (".".to_owned(), ".".to_owned()));
    }

    #[test]
    fn types_stay_where_they_stood_without_groups() {
        let text =
            "const n = 1;\nprocess é() {\n}\nmodule P(host) { done; }\nprocess main() { verify { never a with b; } }";
        let left = without_groups(&Source::new("spec.dca", text)).text;
        assert_eq!(left.trim_end(), "const n = 1;\n              \n \nmodule P(host) { done; }");
        assert_eq!(left.len(), text.len());
    }

    #[test]
    fn files_that_use_each_other_are_read_once() {
        let read = |path: &str| match path {
            "a.dca" => Ok(Content::File("use \"b.dca\"; use \"spec.dca\";".to_owned())),
            "b.dca" => Ok(Content::File("use \"a.dca\"; use \"c.dca\";".to_owned())),
            _ => Err("no such file".to_owned()),
        };
        let parts = gather(&Source::new("spec.dca", "use \"a.dca\"; use \"a.dca\";"), &read);
        let found: Vec<(&str, bool)> = parts.iter().map(|part| (part.name.as_str(), part.role == Role::Part)).collect();
        assert_eq!(found, [("a.dca", true), ("b.dca", true), ("c.dca", false)]);
    }

    /// Returns the role of each file, when these folders exist and every file uses its own folder.
    fn roles(spec: &str, folders: &[(&str, &[&str])]) -> Vec<String> {
        let read = |path: &str| match folders.iter().find(|(folder, _)| *folder == path) {
            Some((_, names)) => Ok(Content::Folder(names.iter().map(|name| (*name).to_owned()).collect())),
            None if path.ends_with("lost.dca") => Err("no such file".to_owned()),
            None => Ok(Content::File("use \".\";".to_owned())),
        };
        let parts = gather(&Source::new("home/spec.dca", spec), &read);
        parts
            .into_iter()
            .map(|part| match part.role {
                Role::Part | Role::Whole | Role::Python => part.name,
                Role::Folder(paths) => format!("{}: {}", part.name, paths.join(" ")),
                Role::Missing(why) => format!("{}! {why}", part.name),
            })
            .collect()
    }

    #[test]
    fn the_files_of_a_spec_have_a_limit_together() {
        let read = |path: &str| match path {
            "parts" => Ok(Content::Folder((0..6).map(|number| format!("{number}.dca")).collect())),
            _ => Ok(Content::File(" ".repeat(SOURCE_MAX))),
        };
        let parts = gather(&Source::new("spec.dca", "use \"parts\";"), &read);
        let read: Vec<bool> = parts.iter().skip(1).map(|part| part.role == Role::Part).collect();
        assert_eq!(read, [true, true, true, true, false, false]);
        let why = Role::Missing("the files of a spec have at most 64 MiB together".to_owned());
        assert_eq!((&parts[5].role, parts[6].text.len()), (&why, 0));
    }

    #[test]
    fn folders_are_taken_in_the_order_of_names() {
        let arms: (&str, &[&str]) = ("home/arms", &["b.dca", "README.md", ".#a.dca", "a.dca", "lost.dca"]);
        assert_eq!(
            roles("use \"arms/\"; use \"arms/b.dca\";", &[arms]),
            [
                "home/arms: home/arms/a.dca home/arms/b.dca home/arms/lost.dca",
                "home/arms/a.dca",
                "home/arms/b.dca",
                "home/arms/lost.dca! no such file"
            ]
        );
        // A spec that uses its own folder is not added again.
        assert_eq!(
            roles("use \".\";", &[("home", &["spec.dca", "inner.dca"]), ("home/inner.dca", &[])]),
            ["home: home/inner.dca home/spec.dca", "home/inner.dca! it is a folder"]
        );
        assert_eq!(roles("use \"arms\";", &[("home/arms", &["a.txt"])]), ["home/arms! the folder has no `.dca` files"]);
        let many: Vec<String> = (0..FILES_MAX).map(|number| format!("{number}.dca")).collect();
        let many: Vec<&str> = many.iter().map(String::as_str).collect();
        let why = "home/arms! a spec uses at most 1000 files, and there are 1000 more in the folder";
        assert_eq!(roles("use \"arms\";", &[("home/arms", &many)]), [why]);
    }
}
