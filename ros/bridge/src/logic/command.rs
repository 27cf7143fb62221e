//! The command line of a program of ROS 2, as a spec declares it.
//!
//! Source: `rcl_parse_arguments` (`--ros-args`, `-r`, `-p`, `--params-file`). Values of parameters are YAML, as in the plan.

use super::component::Component;
use ros::logic::key::GraphName;

/// A program of ROS 2.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Declared {
    pub(crate) package: String,
    pub(crate) what: What,
    pub(crate) node: Option<GraphName>,
    /// Renamings, each as `from:=to`.
    pub(crate) remaps: Vec<String>,
    /// Files with parameters.
    pub(crate) files: Vec<String>,
    /// The components that a container loads.
    pub(crate) components: Vec<Component>,
    /// The arguments in the text after `ros`.
    pub(crate) words: Vec<String>,
    /// The arguments of the process, each as `name=value`: parameters of an executable as YAML, or arguments of a launch file.
    pub(crate) given: Vec<String>,
}

/// The part of a package to start.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum What {
    Executable(String),
    LaunchFile(String),
}

impl Declared {
    /// Returns the arguments of the program: of the executable, or those after `ros2`.
    pub(crate) fn arguments(&self) -> Vec<String> {
        match &self.what {
            What::Executable(_) => self.of_executable(),
            What::LaunchFile(file) => {
                let launch = ["launch", "--noninteractive", &self.package, file].map(str::to_owned);
                let given = self.given().map(|(name, value)| format!("{name}:={value}"));
                launch.into_iter().chain(self.words.iter().cloned()).chain(given).collect()
            }
        }
    }

    fn of_executable(&self) -> Vec<String> {
        let mut ros = Vec::new();
        let mut add = |option: &str, value: String| ros.extend([option.to_owned(), value]);
        if let Some((namespace, name)) = self.node.as_ref().and_then(|node| node.as_str().rsplit_once('/')) {
            add("-r", format!("__ns:={}", if namespace.is_empty() { "/" } else { namespace }));
            add("-r", format!("__node:={name}"));
        }
        self.remaps.iter().for_each(|remap| add("-r", remap.clone()));
        self.files.iter().for_each(|file| add("--params-file", file.clone()));
        for (name, value) in self.given() {
            add("-p", format!("{name}:={value}"));
        }
        let mut all = self.words.clone();
        if !ros.is_empty() {
            all.push("--ros-args".to_owned());
            all.append(&mut ros);
        }
        all
    }

    /// Returns the arguments of the process that are not parameters of a component.
    fn given(&self) -> impl Iterator<Item = (&str, &str)> {
        let is_own = |given: &&String| self.components.iter().all(|component| component.own(given).is_none());
        self.given.iter().filter(is_own).filter_map(|given| given.split_once('='))
    }
}

/// Returns the variables in the output of `env -0`.
pub(crate) fn variables(output: &[u8]) -> Vec<(String, String)> {
    let entries = output.split(|byte| *byte == 0);
    let entries = entries.filter_map(|entry| std::str::from_utf8(entry).ok()?.split_once('='));
    entries.map(|(name, value)| (name.to_owned(), value.to_owned())).collect()
}

#[cfg(test)]
impl Declared {
    /// Returns a declaration of a part of the package `demo`, without options.
    pub(crate) fn demo(what: What) -> Self {
        Self {
            package: "demo".to_owned(),
            what,
            node: None,
            remaps: Vec::new(),
            files: Vec::new(),
            components: Vec::new(),
            words: Vec::new(),
            given: Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn strings(all: &[&str]) -> Vec<String> {
        all.iter().map(|one| (*one).to_owned()).collect()
    }

    fn declared() -> Declared {
        Declared::demo(What::Executable("talker".to_owned()))
    }

    #[test]
    fn arguments_of_ros_follow_the_own_ones() {
        assert_eq!(declared().arguments(), Vec::<String>::new());
        let all = Declared {
            node: GraphName::parse("/robot1/arm/talker"),
            remaps: strings(&["/a:=/b"]),
            files: strings(&["nav 2.yaml"]),
            words: strings(&["--fast", ""]),
            given: strings(&["speed=2.0", "label=\"7 = x\"", "names=[\"on\", \"x y\"]"]),
            ..declared()
        };
        let expected = [
            "--fast",
            "",
            "--ros-args",
            "-r",
            "__ns:=/robot1/arm",
            "-r",
            "__node:=talker",
            "-r",
            "/a:=/b",
            "--params-file",
            "nav 2.yaml",
            "-p",
            "speed:=2.0",
            "-p",
            "label:=\"7 = x\"",
            "-p",
            "names:=[\"on\", \"x y\"]",
        ];
        assert_eq!(all.arguments(), strings(&expected));
        let root = Declared { node: GraphName::parse("/talker"), ..declared() };
        assert_eq!(root.arguments(), strings(&["--ros-args", "-r", "__ns:=/", "-r", "__node:=talker"]));
    }

    #[test]
    fn a_launch_file_has_arguments_of_its_own() {
        let launch = Declared {
            what: What::LaunchFile("up.launch.py".to_owned()),
            words: strings(&["slam:=true"]),
            given: strings(&["map=/maps/a b.yaml", "rate=2"]),
            ..declared()
        };
        let expected =
            ["launch", "--noninteractive", "demo", "up.launch.py", "slam:=true", "map:=/maps/a b.yaml", "rate:=2"];
        assert_eq!(launch.arguments(), strings(&expected));
    }

    #[test]
    fn variables_may_have_any_text() {
        let found = variables(b"A=1\0B=x=y\nz\0C=\0BASH_FUNC_f%%=() { :; }\0broken\0\xff=1\0");
        let expected = [("A", "1"), ("B", "x=y\nz"), ("C", ""), ("BASH_FUNC_f%%", "() { :; }")];
        assert_eq!(found, expected.map(|(name, value)| (name.to_owned(), value.to_owned())));
        assert!(variables(b"").is_empty());
    }
}
