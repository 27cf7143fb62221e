//! Imports launch files of ROS 2 in XML and YAML: makes a spec whose main process starts the same programs.
//!
//! Substitutions are replaced when the file is imported. If an argument is the value of a parameter, it becomes a parameter
//! of `main`; at any other place the argument has a fixed value in the spec. `walk` executes the actions in their order,
//! like `ros2 launch`, and collects the `Program`s; `spec` writes these.

mod component;
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
    /// Values of arguments, which `ros2 launch` accepts behind the file name.
    pub arguments: BTreeMap<String, String>,
    /// The ROS 2 setup file that each program needs.
    pub setup: Option<String>,
}

/// Access to the files that a launch file names.
pub struct Files<'a> {
    /// Returns the text of a file by its path. The error is a sentence that explains why it cannot be read.
    pub read: &'a dyn Fn(&str) -> Result<Source, String>,
    /// Returns the share folder of an installed ROS 2 package.
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
