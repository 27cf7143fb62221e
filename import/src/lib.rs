//! Makes a spec from a state chart in SCXML, a behavior tree of BehaviorTree.CPP, or a launch file of ROS 2.
//!
//! The crate is pure: it uses no clock, file or network. The caller of [`import_with`] reads the files that a launch file
//! includes.
//!
//! [`import`] returns the formatted text of the spec. It also returns a [`Remark`] for each part that has another meaning in
//! DCA or has no counterpart. The text has the same remarks as comments, `// import: …`. `dca check` accepts the text.
//!
//! ```
//! use import::import;
//! use language::Source;
//!
//! let tree = Source::new("take.xml", r#"<root BTCPP_format="4"><BehaviorTree ID="Take">
//!   <Sequence><Action ID="OpenGrip"/><Timeout msec="5000"><Action ID="Approach"/></Timeout></Sequence>
//! </BehaviorTree></root>"#);
//! let imported = import(&tree, &[]).unwrap();
//! assert!(imported.text.contains("open_grip ; approach within 5 s"));
//! assert!(imported.remarks.is_empty());
//! ```
//!
//! The modules: `xml` reads a file within limits. `scxml` makes an activity from a chart. `tree` makes a group from each tree
//! and a module from each action. `launch` makes a module from each program. `name` turns foreign names into names of the
//! language.

mod launch;
mod name;
mod remark;
mod scxml;
mod tree;
mod xml;

use language::{Options, Severity, Source};
use std::collections::BTreeMap;

pub use launch::{Files, LaunchSettings};
pub use remark::{Remark, RemarkKind};
pub use xml::ImportError;

/// A spec that was made from another file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Imported {
    /// The spec.
    pub text: String,
    /// The parts that have another meaning, or no counterpart, in the order of the imported text.
    pub remarks: Vec<Remark>,
    /// The new name of each state of a chart, by its id; empty for a tree.
    pub states: BTreeMap<String, String>,
    /// The port for each event that comes to a chart from outside, by the event's name. `*` is the port for all other events.
    pub ports: BTreeMap<String, String>,
}

/// Returns the spec for a file. `others` are files with further trees, or with the ports of actions.
///
/// # Errors
/// If the file is not XML, has too many or too deep elements, or is neither a chart nor a tree. Also if it contradicts itself,
/// for example by a transition to a state that the chart does not have.
pub fn import(file: &Source, others: &[Source]) -> Result<Imported, ImportError> {
    let read = |path: &str| Err(format!("`{path}` is not a format that `dca import` reads"));
    let files = Files { read: &read, share: &|_| None };
    import_with(file, others, &LaunchSettings::default(), &files)
}

/// Returns the spec for a file, like [`import`]; `settings` and `files` are for launch files.
///
/// # Errors
/// The errors of [`import`]. Also if a setting is for another kind of file, or a launch file includes itself.
pub fn import_with(
    file: &Source,
    others: &[Source],
    settings: &LaunchSettings,
    files: &Files<'_>,
) -> Result<Imported, ImportError> {
    let refused = |why: &str| ImportError { file: file.name.clone(), line: 1, column: 1, why: why.into() };
    if file.name.ends_with(".py") {
        let why = "a launch file in Python is a program; `dca import` reads launch files only in XML and YAML. \
                   A spec starts it unchanged: `ros \"package file.launch.py\";`";
        return Err(refused(why));
    }
    let with_others = "other files are for behavior trees; a launch file names the files that it includes";
    if launch::is_yaml(file) {
        if !others.is_empty() {
            return Err(refused(with_others));
        }
        let imported = launch::import_yaml(file, settings, files)?;
        return complete(imported, refused);
    }
    let document = xml::parse(file)?;
    let root = document.root_element();
    let name = root.tag_name().name();
    let wrong = |why: &str| ImportError::at(&file.name, root, why);
    if name != "launch" && *settings != LaunchSettings::default() {
        return Err(wrong("arguments and a setup file are for launch files of ROS 2"));
    }
    let imported = match name {
        "scxml" => scxml::import(file, root)?,
        "launch" if !others.is_empty() => return Err(wrong(with_others)),
        "launch" => launch::import_xml(file, root, settings, files)?,
        "root" => {
            let parsed = others.iter().map(xml::parse).collect::<Result<Vec<_>, _>>()?;
            let roots = parsed.iter().map(|document| document.root_element());
            let files: Vec<xml::File<'_>> = std::iter::once(xml::File { name: &file.name, root })
                .chain(others.iter().zip(roots).map(|(source, root)| xml::File { name: &source.name, root }))
                .collect();
            tree::import(&files)?
        }
        other => {
            let why = format!(
                "<{other}> is neither a chart (<scxml>), a behavior tree (<root>) nor a launch file (<launch>)"
            );
            return Err(wrong(&why));
        }
    };
    complete(imported, wrong)
}

/// Returns a spec in its last form. `wrong` makes an error about the whole file.
fn complete(mut imported: Imported, wrong: impl Fn(&str) -> ImportError) -> Result<Imported, ImportError> {
    imported.text = checked(&imported.text, wrong)?;
    imported.remarks.sort();
    imported.remarks.dedup();
    Ok(imported)
}

/// The formatted text, if `dca check` accepts it: a file can ask for more than the limits of a spec.
fn checked(text: &str, wrong: impl Fn(&str) -> ImportError) -> Result<String, ImportError> {
    let source = Source::new("imported.dca", text);
    let refused = |message: &str| {
        wrong(&format!("the resulting spec is refused: {message}; make the file smaller, or import a part of it"))
    };
    let first = |found: &[language::Diagnostic]| {
        let error = found.iter().find(|found| found.severity == Severity::Error);
        error.map_or_else(String::new, |error| error.message.clone())
    };
    let formatted = language::format(&source).map_err(|found| refused(&first(&found)))?;
    let compiled =
        language::compile(&Source::new("imported.dca", formatted.as_str()), &[], &Options::named("imported"));
    match compiled.plan {
        Some(_) => Ok(formatted),
        None => Err(refused(&first(&compiled.diagnostics))),
    }
}
