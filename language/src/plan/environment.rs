//! The variables and the folder of a program, in addition to the variables of every program.

use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// How many variables a module may set, and how many it may inherit.
pub const VARIABLES_MAX: usize = 256;
/// The longest value of a variable, in bytes. The system takes 128 kB.
pub const VARIABLE_SIZE_MAX: usize = 32 << 10;
/// How the names of variables begin that a node sets itself.
const OF_NODE: [&str; 3] = ["DCA_", "NOTIFY_SOCKET", "WATCHDOG_"];

/// The environment of a program as its module describes it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Environment {
    /// The variables that it sets.
    pub variables: BTreeMap<String, String>,
    /// The variables that the program inherits from its node: names, or beginnings of names with `*` at the end.
    pub inherited: BTreeSet<String>,
    /// The working folder of the program, absolute or relative to the folder in which its node was started. The default
    /// is the folder in which the node was started.
    pub directory: Option<String>,
}

impl Environment {
    /// Returns whether it has a variable of its node.
    pub fn inherits(&self, name: &str) -> bool {
        self.inherited.iter().any(|pattern| is_matched(name, pattern))
    }

    /// Returns the mistake in it, if there is one: a plan may come from elsewhere.
    pub fn problem(&self) -> Option<String> {
        let names = self.variables.keys().map(|name| variable_problem(name));
        let values =
            self.variables.iter().map(|(name, value)| value_problem(value).map(|why| format!("`{name}` {why}")));
        let patterns = self.inherited.iter().map(|pattern| pattern_problem(pattern));
        let directory = self.directory.as_deref().map(directory_problem);
        let is_large = self.variables.len() > VARIABLES_MAX || self.inherited.len() > VARIABLES_MAX;
        let large = is_large.then(|| format!("there are more than {VARIABLES_MAX} variables"));
        names.chain(values).chain(patterns).chain(directory).chain([large]).flatten().next()
    }
}

/// Returns whether a pattern means this name. The pattern is a name, or the beginning of names: `ROS_*`.
pub fn is_matched(name: &str, pattern: &str) -> bool {
    pattern.strip_suffix('*').map_or(name == pattern, |begin| name.starts_with(begin))
}

/// Says why a module cannot set a variable of that name.
pub fn variable_problem(name: &str) -> Option<String> {
    if !is_name(name) {
        return Some(format!("`{name}` is not the name of a variable"));
    }
    let begin = OF_NODE.iter().find(|begin| name.starts_with(**begin))?;
    Some(format!("`{name}` is set by the node, as every variable that begins with `{begin}`"))
}

/// Says why a variable cannot have a value.
pub fn value_problem(value: &str) -> Option<String> {
    if value.contains('\0') {
        return Some("has a zero byte in its value".to_owned());
    }
    (value.len() > VARIABLE_SIZE_MAX).then(|| format!("has a value of more than {VARIABLE_SIZE_MAX} bytes"))
}

/// Returns the reason why a module cannot inherit the variables of a pattern.
pub fn pattern_problem(pattern: &str) -> Option<String> {
    let begin = pattern.strip_suffix('*').unwrap_or(pattern);
    (!is_name(begin))
        .then(|| format!("`{pattern}` is neither the name of a variable nor a beginning of names, such as `ROS_*`"))
}

/// Says why a program cannot run in a folder.
pub fn directory_problem(path: &str) -> Option<String> {
    (path.is_empty() || path.contains('\0')).then(|| "the path of the folder is empty, or has a zero byte".to_owned())
}

fn is_name(name: &str) -> bool {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '_';
    name.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_') && name.chars().all(is_plain)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_patterns_are_told_from_other_texts() {
        for (name, is_good) in
            [("LC_ALL", true), ("_x1", true), ("", false), ("1A", false), ("A-B", false), ("ä", false)]
        {
            assert_eq!(variable_problem(name).is_none(), is_good, "{name}");
            assert_eq!(pattern_problem(name).is_none(), is_good, "{name}");
        }
        assert!(variable_problem("DCA_DIR").unwrap().contains("set by the node"));
        assert_eq!(pattern_problem("ROS_*"), None);
        assert!(pattern_problem("*").is_some() && pattern_problem("R*S").is_some());
    }

    #[test]
    fn a_pattern_means_the_names_that_begin_so() {
        let inherited = ["LC_ALL", "ROS_*"].map(str::to_owned).into();
        let environment = Environment { inherited, ..Environment::default() };
        let names = ["LC_ALL", "LC_ALL2", "ROS_DOMAIN_ID", "ROS_", "ROS", "XROS_"];
        assert_eq!(names.map(|name| environment.inherits(name)), [true, false, true, true, false, false]);
        assert_eq!(environment.problem(), None);
        let directory = Some(String::new());
        assert!(Environment { directory, ..Environment::default() }.problem().is_some());
    }
}
