//! Values that a user gives to the parameters of the root. So one spec fits many robots: `dca deploy --set speed=0.3`.

use crate::similar;
use crate::source::{Origin, Source};
use crate::syntax::SyntaxKind::{ConstItem, Constant, Param, Params, Process, Type};
use crate::syntax::ast::Node;
use crate::syntax::{is_name, parse};
use std::ops::Range;

/// A value for a parameter of the root.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Assignment {
    /// The name of the parameter.
    pub name: String,
    /// The value, as a spec writes it. A text needs no quotes.
    pub value: String,
}

/// The reason why a parameter cannot get a value.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum AssignmentError {
    /// The file has no process that is clearly the root.
    #[error("cannot set `{name}`: `{file}` itself has no process `main`; values go to the parameters of `main`")]
    NoRoot {
        /// The name of the parameter.
        name: String,
        /// The file of the spec.
        file: String,
    },
    /// The root has no parameter of that name.
    #[error("cannot set `{name}`: `{root}` has no such parameter; {hint}")]
    Unknown {
        /// The name of the parameter.
        name: String,
        /// The name of the root.
        root: String,
        /// The advice, as a clause.
        hint: String,
    },
    /// The value has no form that a spec allows.
    #[error(
        "cannot set `{name}`: `{value}` is not a value; write for example `{name}=0.3`, `{name}=\"0.3 m/s\"` or `{name}=c1`"
    )]
    NotAValue {
        /// The name of the parameter.
        name: String,
        /// The text that is not a value.
        value: String,
    },
    /// A parameter gets two values.
    #[error("cannot set `{0}` twice")]
    Twice(String),
}

/// Returns the spec with these values as the defaults of the root's parameters. So each diagnostic, each proof and each record of the spec
/// shows them.
///
/// ```
/// use language::{Assignment, Source, assign};
///
/// let spec = Source::new("a.dca", "process main(robot: Host = c1, speed: Speed) { }");
/// let values = [("robot", "r7"), ("speed", "0.3 m/s")];
/// let values = values.map(|(name, value)| Assignment { name: name.into(), value: value.into() });
/// assert_eq!(assign(&spec, &values).unwrap().text, "process main(robot: Host = r7, speed: Speed = 0.3 m/s) { }");
/// ```
///
/// # Errors
/// If the root has no such parameter, or if a text is not a value.
pub fn assign(spec: &Source, values: &[Assignment]) -> Result<Source, AssignmentError> {
    let Some(first) = values.first() else { return Ok(spec.clone()) };
    let tree = Node::new(parse(spec, Origin::Spec).root, Origin::Spec);
    let no_root = || AssignmentError::NoRoot { name: first.name.clone(), file: spec.name.clone() };
    let (root, params) = root(&tree).ok_or_else(no_root)?;
    let mut edits = Vec::new();
    for (place, Assignment { name, value }) in values.iter().enumerate() {
        if values[..place].iter().any(|other| other.name == *name) {
            return Err(AssignmentError::Twice(name.clone()));
        }
        let is_meant = |param: &&Node| param.names().next().is_some_and(|other| other.text == *name);
        let param = params.iter().find(is_meant).ok_or_else(|| unknown(name, &root, &params))?;
        let written = if is_text(param) { text(value) } else { written(value) };
        let value = written.ok_or_else(|| AssignmentError::NotAValue { name: name.clone(), value: value.clone() })?;
        edits.push(match param.child(Constant) {
            Some(default) => (place_of(&default), value),
            None => (place_of(param).end..place_of(param).end, format!(" = {value}")),
        });
    }
    edits.sort_by_key(|(place, _)| std::cmp::Reverse(place.start));
    let mut text = spec.text.clone();
    edits.into_iter().for_each(|(place, value)| text.replace_range(place, &value));
    Ok(Source { text, ..spec.clone() })
}

/// Returns the root's name and its parameters. The root is a process of this file.
fn root(tree: &Node) -> Option<(String, Vec<Node>)> {
    let processes: Vec<(String, Node)> =
        tree.children_of(Process).filter_map(|process| Some((process.title()?.text, process))).collect();
    let main = processes.iter().find(|(name, _)| name == "main");
    let (name, process) = main.or_else(|| processes.first().filter(|_| processes.len() == 1))?;
    let params = process.child(Params).map(|params| params.children_of(Param).collect()).unwrap_or_default();
    Some((name.clone(), params))
}

fn unknown(name: &str, root: &str, params: &[Node]) -> AssignmentError {
    let names: Vec<String> = params.iter().filter_map(|param| Some(param.names().next()?.text)).collect();
    let hint = match similar::nearest(name, names.iter().map(String::as_str)) {
        Some(other) => format!("did you mean `{other}`?"),
        None if names.is_empty() => format!("`process {root}({name}: Type = value)` declares this parameter"),
        None => format!("it has `{}`", names.join("`, `")),
    };
    AssignmentError::Unknown { name: name.into(), root: root.into(), hint }
}

/// Returns whether a parameter has the type `Text`.
fn is_text(param: &Node) -> bool {
    param.child(Type).is_some_and(|kind| kind.compact_text() == "Text")
}

/// Returns the value of a text as a spec writes it: `7` and `true` get quotes, and a name may be the name of a constant.
fn text(value: &str) -> Option<String> {
    let value = value.trim();
    let is_name = is_name(value) && !matches!(value, "true" | "false");
    if is_name || value.starts_with('"') { written(value) } else { quoted(value) }
}

/// Returns the value as a spec writes it: a text gets quotes.
fn written(value: &str) -> Option<String> {
    let value = value.trim();
    if is_constant(value) { Some(value.into()) } else { quoted(value).filter(|_| !value.is_empty()) }
}

/// Returns a text with quotes, if they make it one constant.
fn quoted(value: &str) -> Option<String> {
    let quoted = format!("\"{value}\"");
    let is_plain = !value.contains(|c: char| c == '"' || c == '\\' || c.is_control());
    (is_plain && is_constant(&quoted)).then_some(quoted)
}

/// Returns whether the text is one constant and nothing else.
fn is_constant(text: &str) -> bool {
    let start = "const value = ";
    let source = Source::new("value", format!("{start}{text};"));
    let parsed = parse(&source, Origin::Spec);
    let tree = Node::new(parsed.root, Origin::Spec);
    let mut items = tree.children();
    let constant = items.next().filter(|item| item.kind() == ConstItem).and_then(|item| item.child(Constant));
    let is_whole = constant.is_some_and(|constant| place_of(&constant) == (start.len()..start.len() + text.len()));
    parsed.diagnostics.is_empty() && is_whole && items.next().is_none()
}

/// Returns the position of a node in its text.
fn place_of(node: &Node) -> Range<usize> {
    node.span().start as usize..node.span().end as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROOT: &str = "process main(robot: Host = c1, load: Mass in 0 kg..5 kg = 1 kg, count: Number) { }";

    #[track_caller]
    fn check(text: &str, values: &[(&str, &str)], expected: &str) {
        let values = values.iter().map(|(name, value)| Assignment { name: (*name).into(), value: (*value).into() });
        let result = assign(&Source::new("a.dca", text), &values.collect::<Vec<_>>());
        assert_eq!(result.map_or_else(|error| error.to_string(), |source| source.text), expected);
    }

    #[test]
    fn values_replace_defaults_or_are_added() {
        check(ROOT, &[], ROOT);
        let given = [("count", "3"), ("load", "200 g"), ("robot", "r7")];
        check(ROOT, &given, "process main(robot: Host = r7, load: Mass in 0 kg..5 kg = 200 g, count: Number = 3) { }");
        check(
            "process Other() { } process main(a) { }",
            &[("a", "[1, 2]")],
            "process Other() { } process main(a = [1, 2]) { }",
        );
        check("process Only(a) { }", &[("a", "{ x = 1 m }")], "process Only(a = { x = 1 m }) { }");
        // The name of a host or of a file with a dot is a text.
        check("process main(a) { }", &[("a", " robot-2.local ")], "process main(a = \"robot-2.local\") { }");
    }

    #[test]
    fn a_text_needs_no_quotes() {
        let spec = "process main(robot: Text = \"r1\", b) { }";
        for (given, written) in [
            ("r7", "r7"),
            ("7", "\"7\""),
            ("7a", "\"7a\""),
            ("true", "\"true\""),
            ("", "\"\""),
            ("r 7", "\"r 7\""),
            ("\"7\"", "\"7\""),
            ("[1]", "\"[1]\""),
        ] {
            check(spec, &[("robot", given)], &format!("process main(robot: Text = {written}, b) {{ }}"));
        }
        check("process main(robot: Text, b) { }", &[("robot", "7")], "process main(robot: Text = \"7\", b) { }");
    }

    #[test]
    fn each_mistake_has_its_sentence() {
        check(ROOT, &[("lod", "1 kg")], "cannot set `lod`: `main` has no such parameter; did you mean `load`?");
        check(ROOT, &[("z", "1")], "cannot set `z`: `main` has no such parameter; it has `robot`, `load`, `count`");
        let none =
            "cannot set `a`: `main` has no such parameter; `process main(a: Type = value)` declares this parameter";
        check("process main() { }", &[("a", "1")], none);
        let nowhere = "cannot set `a`: `a.dca` itself has no process `main`; values go to the parameters of `main`";
        check("process A(a) { } process B(a) { }", &[("a", "1")], nowhere);
        check(ROOT, &[("count", "1"), ("count", "2")], "cannot set `count` twice");
        for value in ["", "\"", "a\nb", "1\") { } process Extra(\"a"] {
            let values = [Assignment { name: "count".into(), value: value.into() }];
            let error = assign(&Source::new("a.dca", ROOT), &values).unwrap_err();
            assert_eq!(error, AssignmentError::NotAValue { name: "count".into(), value: value.into() });
        }
    }

    #[test]
    fn no_value_leaves_its_place() {
        for value in ["1, other = 2", "1) { } process Extra(", "1 // x", "1; const a = 2", "[1", "a b c"] {
            let values = [Assignment { name: "count".into(), value: value.into() }];
            let text = assign(&Source::new("a.dca", ROOT), &values).map(|source| source.text);
            let quoted = ROOT.replace("count: Number", &format!("count: Number = \"{value}\""));
            assert_eq!(text, Ok(quoted), "{value}");
        }
    }
}
