//! The components of a container: how a spec declares them, and the requests that load them.
//!
//! Source: `composition_interfaces`, and `rclcpp_components/src/component_manager.cpp`. A component does not get the arguments of its
//! container, so its request has all of its names and parameters.

use controllers::ros::composition_interfaces::LoadNodeRequest;
use controllers::ros::rcl_interfaces::{Parameter, ParameterType, ParameterValue};
use ros::logic::key::GraphName;
use ros::logic::yaml::{Scalar, YamlValue};
use std::collections::BTreeMap;

/// The argument of a component that shares messages with other components of its container without copies.
const INTRA_PROCESS: &str = "use_intra_process_comms";

/// A component, as a spec declares it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Component {
    /// The name in the spec.
    pub(crate) name: String,
    pub(crate) package: String,
    pub(crate) class: String,
    pub(crate) node: GraphName,
    /// Renamings, each as `from:=to`.
    pub(crate) remaps: Vec<String>,
    /// Files with parameters.
    pub(crate) files: Vec<String>,
    pub(crate) is_intra_process: bool,
}

impl Component {
    /// Reads the components in the words of a command line.
    ///
    /// # Errors
    /// The error is a sentence for a person.
    pub(crate) fn list(words: &[String]) -> Result<Vec<Self>, String> {
        let mut all: Vec<Self> = Vec::new();
        for word in words {
            let (key, value) = word.split_once('=').ok_or_else(|| format!("`{word}` is not a part of a component"))?;
            if key == "component" {
                all.push(Self::new(value));
                continue;
            }
            let own = all.last_mut().ok_or_else(|| format!("`{word}` belongs to no component"))?;
            match key {
                "package" => value.clone_into(&mut own.package),
                "class" => value.clone_into(&mut own.class),
                "node" => {
                    own.node = GraphName::parse(value).ok_or_else(|| format!("`{value}` is not a name of a node"))?;
                }
                "remap" => own.remaps.push(value.to_owned()),
                "file" => own.files.push(value.to_owned()),
                "intra_process" => own.is_intra_process = value == "true",
                _ => return Err(format!("`{word}` is not a part of a component")),
            }
        }
        Ok(all)
    }

    fn new(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            package: String::new(),
            class: String::new(),
            node: GraphName::parse("unnamed").expect("it is one word"),
            remaps: Vec::new(),
            files: Vec::new(),
            is_intra_process: false,
        }
    }

    /// Returns the name of the parameter and the value if an argument of the process is a parameter of this component: a field of the
    /// argument with the name of the component.
    pub(crate) fn own<'a>(&self, given: &'a str) -> Option<(&'a str, &'a str)> {
        given.strip_prefix(self.name.as_str())?.strip_prefix('.')?.split_once('=')
    }

    /// Returns the component, for a person.
    pub(crate) fn shown(&self) -> String {
        format!("component `{}` (`{}` of `{}`)", self.name, self.class, self.package)
    }

    /// Returns the request that loads the component. `in_files` are the parameters in its files, and `given` the arguments of the process.
    ///
    /// # Errors
    /// The error is a sentence for a person.
    pub(crate) fn request(
        &self,
        in_files: BTreeMap<String, YamlValue>,
        given: &[String],
    ) -> Result<LoadNodeRequest, String> {
        let mut parameters = in_files;
        for (name, value) in given.iter().filter_map(|given| self.own(given)) {
            let value = YamlValue::of(value).ok_or_else(|| {
                format!("{}: `{value}` is not a value that its parameter `{name}` can have", self.shown())
            })?;
            parameters.insert(name.to_owned(), value);
        }
        let (namespace, name) = self.node.as_str().rsplit_once('/').unwrap_or_default();
        let parameter = |(name, value): (String, YamlValue)| Parameter { name, value: parameter_value(value) };
        let intra_process = self.is_intra_process.then(|| {
            let value = YamlValue::One(Scalar::Truth(true));
            Parameter { name: INTRA_PROCESS.to_owned(), value: parameter_value(value) }
        });
        Ok(LoadNodeRequest {
            package_name: self.package.clone(),
            plugin_name: self.class.clone(),
            node_name: name.to_owned(),
            node_namespace: if namespace.is_empty() { "/" } else { namespace }.to_owned(),
            log_level: 0,
            remap_rules: self.remaps.clone(),
            parameters: parameters.into_iter().map(parameter).collect(),
            extra_arguments: intra_process.into_iter().collect(),
        })
    }
}

/// Returns a value as a message. The items of a list have one type.
fn parameter_value(value: YamlValue) -> ParameterValue {
    let default = ParameterValue::default();
    match value {
        YamlValue::One(Scalar::Truth(truth)) => {
            ParameterValue { r#type: ParameterType::PARAMETER_BOOL, bool_value: truth, ..default }
        }
        YamlValue::One(Scalar::Integer(number)) => {
            ParameterValue { r#type: ParameterType::PARAMETER_INTEGER, integer_value: number, ..default }
        }
        YamlValue::One(Scalar::Float(number)) => {
            ParameterValue { r#type: ParameterType::PARAMETER_DOUBLE, double_value: number, ..default }
        }
        YamlValue::One(Scalar::Text(text)) => {
            ParameterValue { r#type: ParameterType::PARAMETER_STRING, string_value: text, ..default }
        }
        YamlValue::List(items) => {
            let mut value = default;
            for item in items {
                value.r#type = match item {
                    Scalar::Truth(truth) => {
                        value.bool_array_value.push(truth);
                        ParameterType::PARAMETER_BOOL_ARRAY
                    }
                    Scalar::Integer(number) => {
                        value.integer_array_value.push(number);
                        ParameterType::PARAMETER_INTEGER_ARRAY
                    }
                    Scalar::Float(number) => {
                        value.double_array_value.push(number);
                        ParameterType::PARAMETER_DOUBLE_ARRAY
                    }
                    Scalar::Text(text) => {
                        value.string_array_value.push(text);
                        ParameterType::PARAMETER_STRING_ARRAY
                    }
                };
            }
            value
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(all: &[&str]) -> Vec<String> {
        all.iter().map(|one| (*one).to_owned()).collect()
    }

    fn components() -> Vec<Component> {
        let all = [
            "component=rectify",
            "package=image_proc",
            "class=image_proc::RectifyNode",
            "node=/robot1/rectify",
            "remap=image:=/camera/image",
            "file=/etc/a=b.yaml",
            "intra_process=true",
            "component=debayer",
            "package=image_proc",
            "class=image_proc::DebayerNode",
            "node=/debayer",
        ];
        Component::list(&words(&all)).unwrap()
    }

    #[test]
    fn components_are_words() {
        let [rectify, debayer] = &components()[..] else { panic!("two") };
        assert_eq!(rectify.shown(), "component `rectify` (`image_proc::RectifyNode` of `image_proc`)");
        assert_eq!((&rectify.remaps, &rectify.files), (&words(&["image:=/camera/image"]), &words(&["/etc/a=b.yaml"])));
        assert_eq!((rectify.node.as_str(), rectify.is_intra_process), ("/robot1/rectify", true));
        assert_eq!((debayer.node.as_str(), debayer.is_intra_process), ("/debayer", false));
        for wrong in [&["package=a"][..], &["component=a", "node=/1"], &["component=a", "x=1"], &["component"]] {
            assert!(Component::list(&words(wrong)).is_err(), "{wrong:?}");
        }
    }

    #[test]
    fn a_request_has_the_names_and_parameters_of_the_component() {
        let [rectify, debayer] = &components()[..] else { panic!("two") };
        let in_files =
            BTreeMap::from(["size", "rate"].map(|name| (name.to_owned(), YamlValue::One(Scalar::Integer(3)))));
        let given = [
            "rectify.rate=2.0",
            "rectify.camera.frame=\"a \\\"b\\\"\"",
            "rectify.names=[\"x, y\", \"7\"]",
            "rectify.on=true",
            "rectifyx.rate=1",
            "rate=9",
            "debayer.gains=[1.0, 2.5]",
        ];
        let request = rectify.request(in_files, &words(&given)).unwrap();
        assert_eq!((request.node_name.as_str(), request.node_namespace.as_str()), ("rectify", "/robot1"));
        let names: Vec<&str> = request.parameters.iter().map(|one| one.name.as_str()).collect();
        assert_eq!(names, ["camera.frame", "names", "on", "rate", "size"]);
        let values: Vec<&ParameterValue> = request.parameters.iter().map(|one| &one.value).collect();
        assert_eq!(values[0].string_value, "a \"b\"");
        assert_eq!(values[1].string_array_value, ["x, y", "7"]);
        assert_eq!(values.iter().map(|value| value.r#type).collect::<Vec<_>>(), [4, 9, 1, 3, 2]);
        assert_eq!(request.extra_arguments.len(), 1);
        let other = debayer.request(BTreeMap::new(), &words(&given)).unwrap();
        assert_eq!((other.node_namespace.as_str(), other.extra_arguments.len()), ("/", 0));
        assert_eq!(other.parameters[0].value.double_array_value, [1.0, 2.5]);
        let why = rectify.request(BTreeMap::new(), &words(&["rectify.a=~"])).unwrap_err();
        assert!(why.contains("`~` is not a value that its parameter `a` can have"), "{why}");
    }
}
