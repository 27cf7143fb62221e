//! The arguments of a program of ROS 2: a parameter of a node is YAML, and an argument of a launch file is a plain text.
//!
//! A list becomes one argument, and a record becomes one for each field. Source: `rcl_yaml_param_parser`; YAML 1.1, 5.7.

use super::data::Data;
use crate::check::declare::ros_node::Form;
use crate::check::spec::{Param, Shape, Spec};
use crate::plan::{Argument, Constant};
use crate::unit;

/// The least whole number that is too large for an integer of 64 bits.
const INTEGER_END: f64 = 9_223_372_036_854_775_808.0;
/// Characters that must be escaped in double quotes: line ends, and characters that YAML does not allow.
const ESCAPED: [char; 5] = ['\u{2028}', '\u{2029}', '\u{feff}', '\u{fffe}', '\u{ffff}'];

/// Writes the arguments of one program.
#[derive(Clone, Copy)]
pub(super) struct RosArguments<'a> {
    pub(super) spec: &'a Spec,
    pub(super) form: Form,
}

impl RosArguments<'_> {
    /// Adds the arguments that carry the value of a parameter or field. `param` is its declaration.
    pub(super) fn add(self, name: String, param: Option<&Param>, data: Data, arguments: &mut Vec<Argument>) {
        let parts = match data {
            Data::Plain(value @ Constant::Secret(_), _) => {
                return arguments.push(Argument { name: Some(name), value });
            }
            Data::Plain(value, dimension) => {
                let is_float = dimension.is_some() || self.is_number(param);
                let text = match self.form {
                    Form::Parameters => yaml(&value, is_float),
                    Form::LaunchArguments => value.bare(),
                };
                return arguments.push(Argument { name: Some(name), value: Constant::Text(text) });
            }
            Data::Record(parts) => parts,
        };
        let shape = param.and_then(|param| param.kind.as_ref()).map(|kind| self.spec.shape(kind));
        let element = match (param, shape) {
            (Some(param), Some(Shape::List(element, _))) => Some(param.element(element)),
            (_, Some(Shape::List(..) | Shape::Record(_) | Shape::Plain(_)) | None) => None,
        };
        if let Some(list) = self.list(element.as_ref(), &parts) {
            return arguments.push(Argument { name: Some(name), value: Constant::Text(list) });
        }
        for (part, data) in parts {
            let field = match shape {
                Some(Shape::Record(fields)) => fields.iter().find(|field| field.name.text == part),
                Some(Shape::List(..) | Shape::Plain(_)) | None => element.as_ref(),
            };
            self.add(format!("{name}.{part}"), field, data, arguments);
        }
    }

    /// Returns a list of plain values as YAML, or none if the data is no such list. ROS 2 rejects a list that mixes integers and other
    /// numbers.
    fn list(self, element: Option<&Param>, parts: &[(String, Data)]) -> Option<String> {
        let values = (0..).zip(parts).map(|(index, (name, data)): (usize, _)| match data {
            Data::Plain(Constant::Secret(_), _) | Data::Record(_) => None,
            Data::Plain(value, dimension) => (*name == index.to_string()).then_some((value, dimension.is_some())),
        });
        let values = values.collect::<Option<Vec<_>>>().filter(|values| !values.is_empty())?;
        let has_fraction = |value: &Constant| matches!(value, Constant::Number(number) if number.fract() != 0.0);
        let is_float =
            self.is_number(element) || values.iter().any(|(value, has_unit)| *has_unit || has_fraction(value));
        let texts: Vec<String> = values.into_iter().map(|(value, _)| yaml(value, is_float)).collect();
        Some(format!("[{}]", texts.join(", ")))
    }

    /// Returns whether the type of this parameter is a number or a quantity.
    fn is_number(self, param: Option<&Param>) -> bool {
        match param.and_then(|param| param.kind.as_ref()).map(|kind| self.spec.shape(kind)) {
            Some(Shape::Plain(kind)) => kind == "Number" || unit::of_type(kind).is_some(),
            Some(Shape::Record(_) | Shape::List(..)) | None => false,
        }
    }
}

/// Returns a value as a YAML scalar. ROS 2 rejects an integer for a floating-point parameter.
fn yaml(value: &Constant, is_float: bool) -> String {
    match value {
        Constant::Number(number) if number.fract() == 0.0 && (is_float || number.abs() >= INTEGER_END) => {
            format!("{number}.0")
        }
        Constant::Text(text) => quoted(text),
        Constant::Number(_) | Constant::Truth(_) | Constant::Secret(_) => value.bare(),
    }
}

/// Returns a text as a YAML scalar in double quotes, so that `7` or `yes` stays a text.
fn quoted(text: &str) -> String {
    let mut quoted = String::from("\"");
    for character in text.chars() {
        match character {
            '"' | '\\' => quoted.extend(['\\', character]),
            other if other.is_control() || ESCAPED.contains(&other) => {
                quoted.push_str(&format!("\\u{:04X}", u32::from(other)));
            }
            other => quoted.push(other),
        }
    }
    quoted.push('"');
    quoted
}

#[cfg(test)]
mod tests {
    use crate::source::Source;
    use crate::{Options, compile};

    #[track_caller]
    fn check(program: &str, params: &str, given: &str, expected: &[&str]) {
        let text = format!(
            "type Rate = Number; type Grasp = {{ force: Force = 2 N, names: Text[] }};
             module Nav(host: Host, {params}) {{ ros \"demo {program}\"; service; }}
             process main(){{ host{{c1}} instantiated_processes{{ nav instof Nav(c1, {given}); }}
             internal_event_actions{{ nav }} }}"
        );
        let compiled = compile(&Source::new("a.dca", text), &[], &Options::named("a"));
        let told: Vec<String> = compiled.diagnostics.iter().map(|found| found.message.clone()).collect();
        let plan = compiled.plan.unwrap_or_else(|| panic!("{told:?}"));
        let arguments = plan.leaves[0].arguments.iter();
        let written: Vec<String> =
            arguments.map(|one| format!("{}={}", one.name.as_deref().unwrap_or_default(), one.value.bare())).collect();
        assert_eq!(written, expected, "{params}; {given}");
    }

    #[test]
    fn a_parameter_of_a_node_keeps_its_type() {
        let node = |params: &str, given: &str, expected: &[&str]| check("nav", params, given, expected);
        node("a: Text", "a = \"true\"", &["a=\"true\""]);
        node("a: Text", "a = \"\"", &["a=\"\""]);
        node("a: Text", "a = \"7 = 'x'\\\\\u{2028}\"", &["a=\"7 = 'x'\\\\\\u2028\""]);
        node("a: Number, b: Force, c: Rate", "a = 2, b = 3 N, c = 1", &["a=2.0", "b=3.0", "c=1.0"]);
        node("a: Number, b: Truth", "a = -0.5, b = true", &["a=-0.5", "b=true"]);
        // A value without a declared type is written as in the spec.
        node(
            "a, b, c, d",
            "a = \"true\", b = \"007\", c = 5, d = false",
            &["a=\"true\"", "b=\"007\"", "c=5", "d=false"],
        );
        node("a, b, c", "a = 2 m, b = 2.5, c = 1e19", &["a=2.0", "b=2.5", "c=10000000000000000000.0"]);
    }

    #[test]
    fn a_list_is_one_parameter_and_a_record_one_for_each_field() {
        let node = |params: &str, given: &str, expected: &[&str]| check("nav", params, given, expected);
        node("a: Text[]", "a = [\"1\", \"true\", \"x y\", \"\"]", &["a=[\"1\", \"true\", \"x y\", \"\"]"]);
        node("a: Number[], b: Rate[2]", "a = [1, 2], b = [3, 4]", &["a=[1.0, 2.0]", "b=[3.0, 4.0]"]);
        node("a: Truth[]", "a = [true, false]", &["a=[true, false]"]);
        node("a, b, c", "a = [1, 2], b = [1, 2.5], c = [\"1\"]", &["a=[1, 2]", "b=[1.0, 2.5]", "c=[\"1\"]"]);
        // ROS 2 rejects an empty list, because its type is unknown.
        node("a: Text[]", "a = []", &[]);
        node("g: Grasp", "g = { names = [\"on\"] }", &["g.force=2.0", "g.names=[\"on\"]"]);
        node("g: Grasp[]", "g = [{ names = [\"1\"] }]", &["g.0.force=2.0", "g.0.names=[\"1\"]"]);
    }

    #[test]
    fn a_value_without_a_name_is_a_mistake() {
        let text = "module Nav { ros \"demo nav\"; service; }
             process main(){ host{c1} instantiated_processes{ nav instof Nav(c1, 5, a = 6); }
             internal_event_actions{ nav } }";
        let compiled = compile(&Source::new("a.dca", text), &[], &Options::named("a"));
        let told: Vec<&str> = compiled.diagnostics.iter().map(|found| found.message.as_str()).collect();
        assert_eq!(told, ["the name of the parameter for this value is not known"]);
    }

    #[test]
    fn an_argument_of_a_launch_file_is_a_plain_text() {
        let launch = |params: &str, given: &str, expected: &[&str]| check("up.launch.py", params, given, expected);
        launch("a: Text, b: Number, c", "a = \"x y\", b = 2, c = true", &["a=x y", "b=2", "c=true"]);
        launch("a: Text[]", "a = [\"1\", \"x y\"]", &["a=[\"1\", \"x y\"]"]);
    }
}
