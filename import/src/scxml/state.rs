//! Writes the states with everything inside them, in the order of the chart.

use super::model::{inner_states, is_state};
use super::{Run, Writer, action, transition};
use crate::name::{pascal, plain, snake};
use crate::remark::RemarkKind;
use crate::xml::{ImportError, Node, elements, tag};

/// Returns a comment of the chart as a comment of the spec.
pub(super) fn comment(node: Node<'_>) -> String {
    let lines = node.text().unwrap_or_default().lines().map(plain).filter(|line| !line.is_empty());
    // A comment must not look like a remark of the import.
    lines.map(|line| format!("// {}\n", line.trim_start_matches(['/', ' ']))).collect()
}

/// Returns the content of a state, or of the chart.
///
/// # Errors
/// A transition leads to a state that the chart does not have.
pub(super) fn inside(writer: &mut Writer<'_>, node: Node<'_>) -> Result<String, ImportError> {
    let mut text = begin(writer, node)?;
    let (mut border, mut runs) = (String::new(), Vec::new());
    for child in node.children() {
        if child.is_comment() {
            text += &comment(child);
        }
        if !child.is_element() {
            continue;
        }
        match tag(child) {
            _ if is_state(child) => text += &state(writer, child)?,
            "transition" if tag(node) == "history" => {}
            "transition" => text += &transition::transition(writer, child, node)?,
            "onentry" => border += &format!("on entry {{\n{}}}\n", action::actions(writer, child)),
            "onexit" => border += &format!("on exit {{\n{}}}\n", action::actions(writer, child)),
            "invoke" => runs.push(invoke(writer, child, &mut border)),
            "initial" | "datamodel" => {}
            other => {
                let why = format!("<{other}> has no counterpart");
                border += &writer.remark(child, RemarkKind::Missing, why);
            }
        }
    }
    text += &transition::completion(writer, node);
    let run = match runs.is_empty() {
        true => String::new(),
        false => format!("run ({});\n", runs.join(", ")),
    };
    Ok(format!("{run}{border}{text}"))
}

/// The state that leads to the first states, if no state inside can be marked as `initial`.
fn begin(writer: &mut Writer<'_>, node: Node<'_>) -> Result<String, ImportError> {
    let initial = elements(node).find(|child| tag(*child) == "initial");
    let entry = initial.and_then(|initial| elements(initial).find(|child| tag(*child) == "transition"));
    let ids = entry.and_then(|entry| entry.attribute("target")).or(node.attribute("initial"));
    let (Some(ids), false) = (ids, tag(node) == "parallel" || inner_states(node).next().is_none()) else {
        return Ok(String::new());
    };
    let named = writer.model.named(node, ids)?;
    let has_actions = entry.is_some_and(|entry| elements(entry).next().is_some());
    let is_direct =
        matches!(named.as_slice(), [only] if only.node.parent() == Some(node) && tag(only.node) != "history");
    if is_direct && !has_actions {
        return Ok(String::new());
    }
    let targets: Vec<String> = named.iter().map(|state| state.name.clone()).collect();
    let mut remark = String::new();
    if node.ancestors().any(|around| tag(around) == "parallel") {
        let why =
            format!("the states inside `{}` are entered after those of the regions beside it", writer.model.name(node));
        remark = writer.remark(node, RemarkKind::Differs, why);
    }
    let around = if tag(node) == "scxml" { "chart" } else { writer.model.name(node) };
    let name = writer.model.state_names.take(&format!("{around}_begins"));
    let actions = match entry {
        Some(entry) if has_actions => format!(" {{\n{}}}", action::actions(writer, entry)),
        Some(_) | None => ";".into(),
    };
    Ok(format!("{remark}initial state {name} {{ on always -> {}{actions} }}\n", targets.join(", ")))
}

/// Whether the state around a state begins in this state.
fn is_first(node: Node<'_>) -> bool {
    let Some(around) = node.parent().filter(|around| tag(*around) != "parallel") else { return false };
    let initial = elements(around).find(|child| tag(*child) == "initial");
    let entry = initial.and_then(|initial| elements(initial).find(|child| tag(*child) == "transition"));
    let has_actions = entry.is_some_and(|entry| elements(entry).next().is_some());
    match entry.and_then(|entry| entry.attribute("target")).or(around.attribute("initial")) {
        None => inner_states(around).next() == Some(node),
        Some(ids) => {
            let mut ids = ids.split_whitespace();
            !has_actions && ids.next() == node.attribute("id") && ids.next().is_none()
        }
    }
}

/// A state or a history.
fn state(writer: &mut Writer<'_>, node: Node<'_>) -> Result<String, ImportError> {
    let name = writer.model.name(node).to_owned();
    let head = if is_first(node) { "initial " } else { "" };
    match tag(node) {
        "history" => history(writer, node, &name),
        "final" => {
            let is_region = node.parent().is_some_and(|around| tag(around) == "parallel");
            if is_region {
                let why = "a <final> directly in a <parallel>: put it into a <state>";
                return Err(ImportError::at(writer.model.file, node, why));
            }
            let is_foreign = |child: &Node<'_>| is_state(*child) || ["transition", "invoke"].contains(&tag(*child));
            if let Some(child) = elements(node).find(is_foreign) {
                let why = format!("a <final> cannot contain <{}>", tag(child));
                return Err(ImportError::at(writer.model.file, child, why));
            }
            let inside = inside(writer, node)?;
            Ok(format!("{head}final state {name} {{\n{inside}}}\n"))
        }
        "parallel" if inner_states(node).next().is_some() => {
            let inside = inside(writer, node)?;
            Ok(format!("{head}parallel state {name} {{\n{inside}}}\n"))
        }
        _ => {
            let inside = inside(writer, node)?;
            Ok(format!("{head}state {name} {{\n{inside}}}\n"))
        }
    }
}

/// A history. If it has several targets or actions, it leads to an extra state, which leads to the targets and has the actions.
fn history(writer: &mut Writer<'_>, node: Node<'_>, name: &str) -> Result<String, ImportError> {
    let deep = if node.attribute("type") == Some("deep") { "deep " } else { "" };
    if node.parent().is_none_or(|around| inner_states(around).next().is_none()) {
        let why = "a <history> needs a <state> beside it that it can lead to";
        return Err(ImportError::at(writer.model.file, node, why));
    }
    let entry = elements(node).find(|child| tag(*child) == "transition");
    let Some((entry, ids)) = entry.and_then(|entry| Some((entry, entry.attribute("target")?))) else {
        let why = "a <history> needs a <transition> to its default state";
        return Err(ImportError::at(writer.model.file, node, why));
    };
    let targets: Vec<String> = writer.model.named(entry, ids)?.iter().map(|state| state.name.clone()).collect();
    let actions = action::actions(writer, entry);
    match targets.as_slice() {
        [only] if actions.is_empty() => Ok(format!("{deep}history {name} -> {only};\n")),
        [..] => {
            let first = writer.model.state_names.take(&format!("{name}_begins"));
            let targets = targets.join(", ");
            Ok(format!(
                "{deep}history {name} -> {first};\nstate {first} {{ on always -> {targets} {{\n{actions}}} }}\n"
            ))
        }
    }
}

/// Something that a state invokes: a process of a module that a person has to write.
fn invoke(writer: &mut Writer<'_>, node: Node<'_>, remarks: &mut String) -> String {
    let source = node.attribute("src").or(node.attribute("id")).or(node.attribute("type")).unwrap_or("invoked");
    let stem = source.rsplit('/').next().unwrap_or(source).trim_end_matches(".scxml");
    let instance = writer.instance_names.take(&snake(node.attribute("id").unwrap_or(stem)));
    let module = writer.module_names.take(&pascal(node.attribute("id").unwrap_or(stem)));
    let description = format!("The process that the chart invokes as `{}`.", plain(source));
    writer.runs.push(Run { instance: instance.clone(), module: module.clone(), description });
    let why = format!(
        "<invoke> is the run of `{instance}` here: `{module}` is a program or an activity that you have to write; it gets no data"
    );
    *remarks += &writer.remark(node, RemarkKind::Missing, why);
    if node.attribute("autoforward") == Some("true") {
        let why = format!("`autoforward` has no counterpart: `{instance}` gets no events of the chart");
        *remarks += &writer.remark(node, RemarkKind::Missing, why);
    }
    if let Some(finalize) = elements(node).find(|child| tag(*child) == "finalize") {
        *remarks += &writer.remark(finalize, RemarkKind::Missing, "<finalize> has no counterpart");
    }
    instance
}
