//! Names of types: `sensor_msgs/msg/LaserScan` in ROS 2, `ros.sensor.LaserScan` in a spec.

use std::fmt;

/// The length of the longest name of a type.
const LENGTH_MAX: usize = 255;
/// The first word of a name in a spec.
const PREFIX: &str = "ros.";
/// The endings of names of packages that a spec omits.
const ENDINGS: [&str; 2] = ["_msgs", "_interfaces"];

/// The name of a message, a service or an action, or of a part of one, in the form of ROS 2:
/// `sensor_msgs/msg/LaserScan`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct TypeName {
    package: String,
    folder: Folder,
    name: String,
}

/// The kind of definition of a type.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Folder {
    /// A message.
    Msg,
    /// A service, or its request or response.
    Srv,
    /// An action, or a part of one: its goal, its result, its feedback, or a message around them.
    Action,
}

impl Folder {
    /// Returns the word for the folder in a name: `msg`.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Msg => "msg",
            Self::Srv => "srv",
            Self::Action => "action",
        }
    }

    fn of(text: &str) -> Option<Self> {
        [Self::Msg, Self::Srv, Self::Action].into_iter().find(|folder| folder.as_str() == text)
    }
}

impl TypeName {
    /// Returns the name of a type; none if one of the words contains other characters than letters, digits and `_`.
    pub fn new(package: &str, folder: Folder, name: &str) -> Option<Self> {
        let is_fit = is_word(package) && is_word(name) && package.len() + name.len() <= LENGTH_MAX;
        is_fit.then(|| Self { package: package.to_owned(), folder, name: name.to_owned() })
    }

    /// Reads `sensor_msgs/msg/LaserScan`. The short form `sensor_msgs/LaserScan` is a message.
    pub fn parse(text: &str) -> Option<Self> {
        let (package, rest) = text.split_once('/')?;
        match rest.split_once('/') {
            Some((folder, name)) => Self::new(package, Folder::of(folder)?, name),
            None => Self::new(package, Folder::Msg, rest),
        }
    }

    /// Reads the name of a type in the keys of ROS 2: `sensor_msgs::msg::dds_::LaserScan_`.
    pub fn parse_dds(text: &str) -> Option<Self> {
        let mut words = text.split("::");
        let (package, folder) = (words.next()?, words.next()?);
        let (dds, name) = (words.next()?, words.next()?);
        let name = name.strip_suffix('_').filter(|_| dds == "dds_" && words.next().is_none())?;
        Self::new(package, Folder::of(folder)?, name)
    }

    /// Returns the package: `sensor_msgs`.
    pub fn package(&self) -> &str {
        &self.package
    }

    /// Returns the kind of definition.
    pub fn folder(&self) -> Folder {
        self.folder
    }

    /// Returns the name without its package: `LaserScan`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the name in the keys of ROS 2: `sensor_msgs::msg::dds_::LaserScan_`.
    pub fn dds(&self) -> String {
        format!("{}::{}::dds_::{}_", self.package, self.folder.as_str(), self.name)
    }

    /// Returns the name of the schema in a record: `sensor_msgs/LaserScan`.
    pub fn short(&self) -> String {
        format!("{}/{}", self.package, self.name)
    }

    /// Returns the name as a spec writes it: `ros.sensor.LaserScan`.
    pub fn spec(&self) -> String {
        format!("{PREFIX}{}.{}", spec_package(&self.package), self.name)
    }

    /// Returns the request of a service: `std_srvs/srv/Trigger_Request`.
    #[must_use]
    pub fn request(&self) -> Self {
        self.with("_Request")
    }

    /// Returns the response of a service: `std_srvs/srv/Trigger_Response`.
    #[must_use]
    pub fn response(&self) -> Self {
        self.with("_Response")
    }

    /// Returns the type whose name has this ending added: `Trigger_Request`, `Fibonacci_Goal`.
    #[must_use]
    pub fn with(&self, ending: &str) -> Self {
        Self { name: format!("{}{ending}", self.name), ..self.clone() }
    }
}

impl fmt::Display for TypeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}/{}", self.package, self.folder.as_str(), self.name)
    }
}

/// Returns the word for a package in a spec: `sensor` for `sensor_msgs`.
pub fn spec_package(package: &str) -> &str {
    ENDINGS.iter().find_map(|ending| package.strip_suffix(ending)).unwrap_or(package)
}

/// Returns whether a name in a spec is the name of a type of ROS 2.
pub fn is_spec_name(text: &str) -> bool {
    text.starts_with(PREFIX)
}

/// Returns the two words of a name such as `ros.sensor.LaserScan`: the package and the type.
pub(crate) fn spec_words(text: &str) -> Option<(&str, &str)> {
    text.strip_prefix(PREFIX)?.split_once('.')
}

fn is_word(text: &str) -> bool {
    let is_fit = |character: char| character.is_ascii_alphanumeric() || character == '_';
    text.starts_with(|first: char| first.is_ascii_alphabetic()) && text.chars().all(is_fit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_has_four_forms() {
        let name = TypeName::parse("sensor_msgs/msg/LaserScan").unwrap();
        assert_eq!(Some(&name), TypeName::parse("sensor_msgs/LaserScan").as_ref());
        assert_eq!(Some(&name), TypeName::parse_dds(&name.dds()).as_ref());
        assert_eq!(name.to_string(), "sensor_msgs/msg/LaserScan");
        assert_eq!(name.dds(), "sensor_msgs::msg::dds_::LaserScan_");
        assert_eq!((name.short().as_str(), name.spec().as_str()), ("sensor_msgs/LaserScan", "ros.sensor.LaserScan"));
        let service = TypeName::parse("rcl_interfaces/srv/GetParameters").unwrap();
        assert_eq!((service.folder(), service.spec().as_str()), (Folder::Srv, "ros.rcl.GetParameters"));
        assert_eq!(TypeName::parse("std_srvs/srv/Trigger").unwrap().spec(), "ros.std_srvs.Trigger");
    }

    #[test]
    fn other_texts_are_no_names() {
        for text in ["", "a", "a/", "/A", "a/msg/", "a/b/C", "a/msg/C/D", "a b/C", "a/C*", "1/A", "ä/B"] {
            assert_eq!(TypeName::parse(text), None, "{text}");
        }
        for text in ["", "a::msg::dds_::C", "a::msg::C_", "a::msg::dds_::C_::D_", "a::no::dds_::C_", "a::msg::dds_::_"]
        {
            assert_eq!(TypeName::parse_dds(text), None, "{text}");
        }
        assert_eq!(TypeName::parse(&format!("a/{}", "b".repeat(LENGTH_MAX))), None);
    }
}
