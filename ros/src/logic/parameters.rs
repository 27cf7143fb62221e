//! Files with parameters of nodes: the parameters of a node are below its name and `ros__parameters`.
//!
//! ```yaml
//! /**:
//!   ros__parameters:
//!     use_sim_time: true
//! /robot1/rectify:
//!   ros__parameters:
//!     queue: { size: 5 }
//! ```
//!
//! A file is read as by `launch` for a component. Source: `launch_ros`, `to_parameters_list.py`.

use super::key::GraphName;
use super::yaml::{Scalar, YamlValue};
use saphyr_parser::{Event, Parser, ScalarStyle};
use std::collections::BTreeMap;
use thiserror::Error;

/// The longest file, in bytes, the greatest depth of its values, and the largest number of them.
const TEXT_MAX: usize = 1 << 20;
const DEPTH_MAX: usize = 48;
const VALUES_MAX: usize = 10_000;
/// The key above the parameters of a node.
const PARAMETERS: &str = "ros__parameters";
/// The name that stands for all nodes.
const ALL: &str = "**";

/// Why a file of parameters cannot be read.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ParametersError {
    /// It is not YAML.
    #[error("line {line}: {why}")]
    Yaml {
        /// The line, from 1.
        line: usize,
        /// The reason.
        why: String,
    },
    /// It is too large, or uses a part of YAML that is not read.
    #[error("{0}")]
    Limit(String),
    /// No part of it is about a node.
    #[error("it has no `ros__parameters`: write the name of the node, this key, and below it the parameters")]
    NoNode,
    /// A parameter has a value that no parameter of ROS 2 can have.
    #[error(
        "parameter `{0}` has a value that ROS 2 does not accept, such as nothing, a date, an empty list, or a list of several types"
    )]
    Value(String),
}

/// A part of a file.
#[derive(Debug)]
enum Part {
    Scalar(String, ScalarStyle),
    List(Vec<Self>),
    Map(Vec<(String, Self)>),
}

/// A list or a map that is not complete.
#[derive(Debug)]
struct Open {
    part: Part,
    /// The key whose value comes next.
    key: Option<String>,
}

/// Returns the parameters of a node in a file: those of all nodes, replaced by those of the node itself.
///
/// # Errors
/// If the file is not one of parameters, or a parameter has no value that ROS 2 accepts.
pub fn of_node(text: &str, node: &GraphName) -> Result<BTreeMap<String, YamlValue>, ParametersError> {
    let mut nodes = BTreeMap::new();
    let root = read(text)?;
    find("", &root, &mut nodes);
    if nodes.is_empty() && !matches!(&root, Part::Map(entries) if entries.is_empty()) {
        return Err(ParametersError::NoNode);
    }
    let mut all = BTreeMap::new();
    for parameters in [ALL, node.words()].into_iter().filter_map(|name| nodes.get(name)) {
        flatten("", parameters, &mut all)?;
    }
    Ok(all)
}

/// Finds the parameters of each node. Names of nodes may be written in parts, each below its namespace.
fn find<'a>(name: &str, part: &'a Part, nodes: &mut BTreeMap<String, &'a Part>) {
    let Part::Map(entries) = part else { return };
    for (key, part) in entries {
        if key == PARAMETERS {
            nodes.insert(name.to_owned(), part);
        } else {
            let key = key.trim_start_matches('/');
            let below = if name.is_empty() { key.to_owned() } else { format!("{name}/{key}") };
            find(&below, part, nodes);
        }
    }
}

/// Adds the parameters below a part. Names of parts are joined by dots.
fn flatten(name: &str, part: &Part, all: &mut BTreeMap<String, YamlValue>) -> Result<(), ParametersError> {
    let wrong = || ParametersError::Value(name.to_owned());
    let value = match part {
        Part::Map(entries) => {
            return entries.iter().try_for_each(|(key, part)| {
                let below = if name.is_empty() { key.clone() } else { format!("{name}.{key}") };
                flatten(&below, part, all)
            });
        }
        Part::Scalar(..) => YamlValue::One(scalar(part).ok_or_else(wrong)?),
        Part::List(items) => {
            let items = items.iter().map(scalar).collect::<Option<Vec<_>>>();
            items.filter(|items| !items.is_empty()).and_then(YamlValue::list).ok_or_else(wrong)?
        }
    };
    all.insert(name.to_owned(), value);
    Ok(())
}

fn scalar(part: &Part) -> Option<Scalar> {
    match part {
        // Without a text, the value is nothing.
        Part::Scalar(text, ScalarStyle::Plain) => Scalar::of(text).filter(|_| !text.is_empty()),
        Part::Scalar(text, _) => Some(Scalar::Text(text.clone())),
        Part::List(_) | Part::Map(_) => None,
    }
}

/// Reads the only document of a file. Aliases are refused: with them, a short file can have a very large value.
fn read(text: &str) -> Result<Part, ParametersError> {
    let limit = |why: String| Err(ParametersError::Limit(why));
    if text.len() > TEXT_MAX {
        return limit(format!("it has {} bytes, and at most {TEXT_MAX} are read", text.len()));
    }
    let (mut open, mut root, mut count) = (Vec::<Open>::new(), None, 0);
    for event in Parser::new_from_str(text) {
        let failed = |line: usize, why: &str| ParametersError::Yaml { line, why: why.to_owned() };
        let (event, span) = event.map_err(|error| failed(error.marker().line(), error.info()))?;
        count += 1;
        if count > VALUES_MAX || open.len() > DEPTH_MAX {
            return limit(format!(
                "it has more than {VALUES_MAX} values, or they are nested more than {DEPTH_MAX} deep"
            ));
        }
        let complete = match event {
            Event::Nothing | Event::StreamStart | Event::StreamEnd | Event::DocumentEnd => None,
            Event::DocumentStart(_) if root.is_some() => {
                return Err(failed(span.start.line(), "a second document begins here; a file has one"));
            }
            Event::DocumentStart(_) => None,
            Event::Alias(_) => {
                return Err(failed(span.start.line(), "aliases (`*name`) are not supported; write the value again"));
            }
            Event::Scalar(text, style, ..) => Some(Part::Scalar(text.into_owned(), style)),
            Event::SequenceStart(..) => {
                open.push(Open { part: Part::List(Vec::new()), key: None });
                None
            }
            Event::MappingStart(..) => {
                open.push(Open { part: Part::Map(Vec::new()), key: None });
                None
            }
            Event::SequenceEnd | Event::MappingEnd => open.pop().map(|open| open.part),
        };
        match (complete, open.last_mut()) {
            (Some(part), Some(around)) => {
                add(around, part).map_err(|why| failed(span.start.line(), why))?;
            }
            (Some(part), None) => root = Some(part),
            (None, _) => {}
        }
    }
    Ok(root.unwrap_or(Part::Map(Vec::new())))
}

/// Puts a complete part into the list or the map around it.
fn add(around: &mut Open, part: Part) -> Result<(), &'static str> {
    match (&mut around.part, around.key.take(), part) {
        (Part::List(items), _, part) => items.push(part),
        (Part::Map(entries), Some(key), part) => entries.push((key, part)),
        (Part::Map(entries), None, Part::Scalar(key, _)) => {
            if entries.iter().any(|(known, _)| *known == key) {
                return Err("a key occurs twice");
            }
            around.key = Some(key);
        }
        (Part::Map(_), None, Part::List(_) | Part::Map(_)) => return Err("a key must be a text"),
        // A scalar is complete at once, so no part is inside it.
        (Part::Scalar(..), ..) => {}
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(text: &str, node: &str, expected: &[(&str, &str)]) {
        let found = of_node(text, &GraphName::parse(node).unwrap()).unwrap();
        let expected = expected.iter().map(|(name, value)| ((*name).to_owned(), YamlValue::of(value).unwrap()));
        assert_eq!(found, expected.collect());
    }

    const FILE: &str = "
/**:
  ros__parameters:
    use_sim_time: true
    rate: 10
/robot1:
  rectify:
    ros__parameters:
      rate: 20.0   # faster
      queue: { size: 5, names: [a, 'true'] }
rectify:
  ros__parameters: { rate: 30 }
";

    #[test]
    fn a_node_has_its_parameters_and_those_of_all_nodes() {
        let own = [("rate", "20.0"), ("use_sim_time", "true"), ("queue.size", "5"), ("queue.names", "[a, 'true']")];
        check(FILE, "/robot1/rectify", &own);
        check(FILE, "/rectify", &[("rate", "30"), ("use_sim_time", "true")]);
        check(FILE, "/other", &[("rate", "10"), ("use_sim_time", "true")]);
        check("robot1/rectify:\n  ros__parameters:\n    a: '5'\n", "/robot1/rectify", &[("a", "'5'")]);
        check("", "/other", &[]);
    }

    #[test]
    fn other_files_are_refused() {
        let deep = format!("a: {}1{}", "[".repeat(50), "]".repeat(50));
        let long = format!("a: [{}]", "1,".repeat(VALUES_MAX));
        let node = GraphName::parse("/a").unwrap();
        for (text, why) in [
            ("a: 5", "it has no `ros__parameters`"),
            ("- a", "it has no `ros__parameters`"),
            ("a: { ros__parameters: { b: } }", "parameter `b` has a value"),
            ("a: { ros__parameters: { b: [1, 2.0] } }", "parameter `b` has a value"),
            ("a: { ros__parameters: { b: [[1]] } }", "parameter `b` has a value"),
            ("a: { ros__parameters: { b: [] } }", "parameter `b` has a value"),
            ("a: { ros__parameters: { b: &x 5, c: *x } }", "line 1: aliases"),
            ("a: 5\na: 6", "line 2: a key occurs twice"),
            ("a: 5\n--- \nb: 6", "line 2: a second document"),
            ("? [a]\n: 5", "a key must be a text"),
            ("a: [", "line "),
            (&deep, "nested more than 48 deep"),
            (&long, "more than 10000 values"),
        ] {
            let error = of_node(text, &node).unwrap_err().to_string();
            assert!(error.contains(why), "{text:.40}: {error}");
        }
    }
}
