//! Launch files of ROS 2 in XML and YAML, as a spec whose main process starts the same programs.
//!
//! Substitutions are replaced when the file is imported. An argument that is the value of a parameter becomes a parameter of
//! `main`; at any other place an argument has one value in the spec. `walk` carries out the actions in their order, as
//! `ros2 launch` does, and makes `Program`s of them; `spec` writes these.

mod entity;
mod expression;
mod include;
mod node;
mod parameter;
mod program;
mod scope;
mod settings;
mod spec;
mod substitution;
mod value;
mod walk;
mod words;
mod yaml;

use crate::Imported;
use crate::xml::{ImportError, Node};
use entity::Entity;
use language::Source;
use std::collections::BTreeMap;
use std::fmt;

pub(crate) use entity::Place;

/// The settings of an import of a launch file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LaunchSettings {
    /// Values of arguments, as `ros2 launch` takes them behind the file.
    pub arguments: BTreeMap<String, String>,
    /// The setup file of ROS 2 that each program needs.
    pub setup: Option<String>,
}

/// The files that a launch file names.
pub struct Files<'a> {
    /// Returns a text by its path, or a sentence why it cannot be read.
    pub read: &'a dyn Fn(&str) -> Result<Source, String>,
    /// Returns the folder of shared files of an installed package of ROS 2.
    pub share: &'a dyn Fn(&str) -> Option<String>,
}

impl fmt::Debug for Files<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Files").finish_non_exhaustive()
    }
}

/// Whether a file is a launch file in YAML, by its name.
pub(crate) fn is_yaml(file: &Source) -> bool {
    file.name.ends_with(".yaml") || file.name.ends_with(".yml")
}

/// Makes a spec of a launch file in XML.
pub(crate) fn import_xml(
    file: &Source,
    root: Node<'_>,
    settings: &LaunchSettings,
    files: &Files<'_>,
) -> Result<Imported, ImportError> {
    walk::import(&file.name, &Entity::of_xml(root), settings, files)
}

/// Makes a spec of a launch file in YAML.
pub(crate) fn import_yaml(
    file: &Source,
    settings: &LaunchSettings,
    files: &Files<'_>,
) -> Result<Imported, ImportError> {
    walk::import(&file.name, &yaml::read(file)?, settings, files)
}
