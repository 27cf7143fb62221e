//! Reads the components of a container of ROS 2: `components{ rectify "image_proc image_proc::RectifyNode"; }`

use super::ros_node::{Mistake, Told, WITHIN, Words, fault, files, node_name, remaps};
use crate::check::names::twice;
use crate::check::ros_name;
use crate::check::spec::Module;
use crate::check::value::Reader;
use crate::plan::words;
use crate::source::Span;
use crate::syntax::SyntaxKind::{Constant, Flag, Lifecycle, RosComponent, RosComponents, RosName, Text};
use crate::syntax::ast::{Name, Node};
use std::collections::BTreeMap;

/// The most components of one container.
const COMPONENTS_MAX: usize = 100;

/// Reads the components of a module. Returns the words behind the own words of its `exec`; none if it has no components.
pub(super) fn read(
    module: &mut Module,
    node: &Node,
    reader: &mut Reader<'_>,
    exec: &mut Words,
) -> Result<Vec<String>, Mistake> {
    let mut all = node.children_of(RosComponents);
    let Some(item) = all.next() else { return Ok(Vec::new()) };
    if let Some(second) = all.next() {
        let message = "`components` is written twice".to_owned();
        return Err(fault(second.span(), message, "write all components in one `components{ ... }`"));
    }
    let container = check_module(module, node, &item)?;
    let within = item.child(Constant).map(|node| reader.duration(&node));
    // A wrong time was already reported.
    let within = within.flatten().unwrap_or(WITHIN);
    if within.is_zero() {
        let message = "the time limit of `components` is zero".to_owned();
        return Err(fault(item.span(), message, "write how long the start may take: `components within 30 s{ ... }`"));
    }
    let (mut names, mut nodes) = (BTreeMap::new(), BTreeMap::from([(container.clone(), item.span())]));
    let mut written = Vec::new();
    for part in item.children_of(RosComponent) {
        let Some(name) = part.names().next().filter(|_| part.token(Text).is_some()) else { continue };
        if let Some(first) = names.insert(name.text.clone(), name.span) {
            reader.diagnostics.push(twice("component", &name.text, name.span, first));
            continue;
        }
        let component = Component::read(&part, &name, &container)?;
        if nodes.insert(component.node.clone(), name.span).is_some() {
            let message = format!("two nodes of this container have the name `{}`", component.node);
            return Err(fault(name.span, message, "give the component another name: `node \"/other\";`"));
        }
        written.extend(component.words());
    }
    if names.is_empty() || names.len() > COMPONENTS_MAX {
        let message = format!("a container has 1 to {COMPONENTS_MAX} components, and this one has {}", names.len());
        let help = "write each with its package and class: `rectify \"image_proc image_proc::RectifyNode\";`";
        return Err(fault(item.span(), message, help));
    }
    module.is_service = true;
    exec.add("components_ms", &within.as_millis().to_string(), item.span())?;
    exec.add("component_words", &written.len().to_string(), item.span())?;
    Ok(written)
}

/// Checks that the module can be a container. Returns the name of its node.
fn check_module(module: &Module, node: &Node, item: &Node) -> Result<String, Mistake> {
    if node.child(Lifecycle).is_some() {
        let message = "a container of components has no lifecycle".to_owned();
        return Err(fault(item.span(), message, "remove `lifecycle`"));
    }
    if module.has_end {
        let message = "a container of components cannot have `done`: it runs until it is stopped".to_owned();
        return Err(fault(item.span(), message, "remove `done`"));
    }
    let name = node.child(RosName).map(|item| node_name(&item)).transpose()?.flatten();
    name.ok_or_else(|| {
        let message = "`components` needs the name of the node, because services with this name load the components";
        fault(item.span(), message.to_owned(), "add the name: `node \"/container\";`")
    })
}

/// A component as the text has it.
struct Component {
    name: String,
    package: String,
    class: String,
    node: String,
    remaps: Vec<String>,
    files: Vec<String>,
    is_intra_process: bool,
}

impl Component {
    fn read(part: &Node, name: &Name, container: &str) -> Result<Self, Mistake> {
        let Told { text, span } = Told::of(part);
        let [package, class] = class_of(&text, span)?;
        let node = match part.child(RosName).map(|item| node_name(&item)).transpose()?.flatten() {
            Some(node) => node,
            None if name.text.chars().all(ros_name::is_part) => {
                let namespace = container.rsplit_once('/').map_or("", |(namespace, _)| namespace);
                format!("{namespace}/{}", name.text)
            }
            None => {
                let message = format!("`{}` is not the name of a node of ROS 2", name.text);
                return Err(fault(name.span, message, "give the node another name: `node \"/robot1/rectify\";`"));
            }
        };
        let is_intra_process = part.child(Flag).is_some();
        let (remaps, files) = (remaps(part)?, files(part)?);
        Ok(Self { name: name.text.clone(), package, class, node, remaps, files, is_intra_process })
    }

    /// Returns the words of the `exec` for this component.
    fn words(self) -> Vec<String> {
        let mut words = vec![
            format!("component={}", self.name),
            format!("package={}", self.package),
            format!("class={}", self.class),
            format!("node={}", self.node),
        ];
        words.extend(self.remaps.iter().map(|remap| format!("remap={remap}")));
        words.extend(self.files.iter().map(|file| format!("file={file}")));
        words.extend(self.is_intra_process.then(|| "intra_process=true".to_owned()));
        words
    }
}

/// Returns the package and the class of a component.
fn class_of(text: &str, span: Span) -> Result<[String; 2], Mistake> {
    let help = "write the package and the class: `rectify \"image_proc image_proc::RectifyNode\";`";
    let all = words(text).map_err(|why| fault(span, format!("this names no component: {why}"), help))?;
    let [package, class] = <[String; 2]>::try_from(all)
        .map_err(|_words| fault(span, "a component needs the names of a package and of a class".to_owned(), help))?;
    let is_fit = |text: &str, more: &str| text.chars().all(|c| c.is_ascii_alphanumeric() || more.contains(c));
    if package.starts_with('.') || !is_fit(&package, "_-.") || !is_fit(&class, "_-.:/<>") {
        return Err(fault(span, format!("{text:?} is not a package and a class of a component"), help));
    }
    Ok([package, class])
}
