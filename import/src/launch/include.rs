//! Included launch files. XML and YAML files are read; Python files are started with `ros2 launch`.

use super::entity::Entity;
use super::node;
use super::substitution::{self, Names, folder};
use super::value::Value;
use super::walk::{Importer, Skipped, Step};
use super::{is_yaml, yaml};
use crate::name;
use crate::xml::{self, ImportError};
use language::Source;

/// The deepest nesting of files.
const DEPTH_MAX: usize = 16;
/// The most files that are read. A file is counted each time that it is included.
const FILES_MAX: usize = 100;
/// The endings of files that `ros2 launch` finds in a package.
const LAUNCH_FILES: [&str; 3] = ["launch.py", "launch.xml", "launch.yaml"];

/// The names of a file, without the packages that are installed.
struct Elsewhere<'a>(&'a dyn Names);

impl Names for Elsewhere<'_> {
    fn variable(&self, name: &str) -> Option<Value> {
        self.0.variable(name)
    }

    fn share(&self, _: &str) -> Option<String> {
        None
    }

    fn file(&self) -> &str {
        self.0.file()
    }
}

/// Carries out the actions of another file.
pub(super) fn include(
    importer: &mut Importer<'_>,
    entity: &Entity,
    steps: &mut Vec<Step>,
) -> Result<Result<(), Skipped>, ImportError> {
    importer.count(entity, entity.children.len())?;
    importer.unread(entity, &["file"]);
    let mut arguments = Vec::new();
    for part in entity.children.iter().filter(|part| matches!(part.kind.as_str(), "arg" | "let")) {
        if importer.is_on(part)
            && let Ok(name) = importer.needed(part, "name")
        {
            arguments.push((name, importer.value(part.get("value").unwrap_or_default())));
        }
    }
    let written = entity.get("file").unwrap_or_default();
    let (found, elsewhere) = (importer.value(written), substitution::replace(written, &Elsewhere(importer)));
    if let Some((package, file)) = in_package(&elsewhere.text)
        && (found.open.is_some() || file.ends_with(".py"))
    {
        // The package and the file are known, although the folder is unknown.
        importer.fixed(Value { open: None, ..elsewhere }).unwrap_or_default();
        let program = node::launch_file(importer, entity, [&package, &file], arguments);
        return Ok(program.map(|program| importer.start(program, steps)));
    }
    let path = match importer.fixed(found) {
        Ok(path) if path.ends_with(".py") => {
            let why =
                format!("`{path}` is Python: start it unchanged, with its package: `ros \"package file.launch.py\";`");
            return Ok(Err(importer.missing(entity, &why)));
        }
        Ok(path) if is_from_start(importer, &path) => joined(".", &path),
        Ok(path) => joined(folder(importer.file()), &path),
        Err(why) => return Ok(Err(importer.missing(entity, &format!("`include` is left out: {why}")))),
    };
    if let Some(place) = importer.open.iter().position(|open| joined(".", open) == path) {
        let circle: Vec<String> =
            importer.open[place..].iter().chain([&path]).map(|file| format!("`{}`", name::plain(file))).collect();
        return Err(importer.error(entity.place, format!("a file includes itself: {}", circle.join(" includes "))));
    }
    importer.work.includes += 1;
    if importer.open.len() > DEPTH_MAX || importer.work.includes > FILES_MAX {
        let why = format!("at most {FILES_MAX} files are included, and at most {DEPTH_MAX} in each other");
        return Err(importer.error(entity.place, why));
    }
    match (importer.files.read)(&path) {
        Err(why) => Ok(Err(importer.missing(entity, &format!("`include` is left out: {why}")))),
        Ok(source) => {
            importer.measure(source.text.len());
            let root = read(&source)?;
            arguments.into_iter().for_each(|(name, value)| {
                importer.scopes.top().variables.insert(name, value);
            });
            importer.open.push(path);
            importer.actions(&root.children, steps)?;
            importer.open.pop();
            Ok(Ok(()))
        }
    }
}

/// Whether a path begins with the folder of a file that is read, as `$(dirname)` makes it.
fn is_from_start(importer: &Importer<'_>, path: &str) -> bool {
    let is_in = |file: &String| {
        let folder = folder(file);
        folder != "." && path.strip_prefix(folder).is_some_and(|rest| rest.starts_with('/'))
    };
    importer.open.iter().any(is_in)
}

/// Reads a launch file.
fn read(source: &Source) -> Result<Entity, ImportError> {
    if is_yaml(source) {
        return yaml::read(source);
    }
    let document = xml::parse(source)?;
    let root = document.root_element();
    if xml::tag(root) != "launch" {
        let why = format!("<{}> is not a launch file, which is a <launch>", xml::tag(root));
        return Err(ImportError::at(&source.name, root, why));
    }
    Ok(Entity::of_xml(root))
}

/// Returns the package and the name of a launch file in it.
fn in_package(path: &str) -> Option<(String, String)> {
    let (package, rest) = path.strip_prefix("$(find-pkg-share ")?.split_once(')')?;
    let (_, file) = rest.rsplit_once('/')?;
    let is_file = LAUNCH_FILES.iter().any(|ending| file.ends_with(ending)) && !rest.contains("$(");
    (is_file && node::is_package(package) && node::is_package(file)).then(|| (package.to_owned(), file.to_owned()))
}

/// Returns the path of a file that is named from a folder, without `.` and `..` where these can be left out.
pub(super) fn joined(folder: &str, path: &str) -> String {
    let whole = if path.starts_with('/') { path.to_owned() } else { format!("{folder}/{path}") };
    let mut words: Vec<&str> = Vec::new();
    for word in whole.split('/') {
        match word {
            "" | "." => {}
            ".." if words.last().is_some_and(|last| *last != "..") => {
                words.pop();
            }
            ".." if whole.starts_with('/') => {}
            word => words.push(word),
        }
    }
    format!("{}{}", if whole.starts_with('/') { "/" } else { "" }, words.join("/"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_those_of_the_folder_of_the_file() {
        for (folder, path, expected) in [
            (".", "a.launch.xml", "a.launch.xml"),
            ("x/y", "../a.xml", "x/a.xml"),
            ("..", "../a.xml", "../../a.xml"),
            ("/opt", "../../a", "/a"),
            ("x", "/b//c/./d", "/b/c/d"),
        ] {
            assert_eq!(joined(folder, path), expected);
        }
    }

    #[test]
    fn a_launch_file_of_a_package_is_known_by_its_package() {
        let found = in_package("$(find-pkg-share nav2)/launch/up.launch.py");
        assert_eq!(found, Some(("nav2".to_owned(), "up.launch.py".to_owned())));
        for path in ["nav2/up.launch.py", "$(find-pkg-share nav2)/up.txt", "$(find-pkg-share a b)/x.launch.py"] {
            assert_eq!(in_package(path), None, "{path}");
        }
    }
}
