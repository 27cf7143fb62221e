//! Reads a module that is a program of ROS 2: `ros "nav2_controller controller_server";`
//!
//! The bridge's program starts this program, and the node of the host starts the bridge's program. The last words of the `exec` are the
//! number of arguments in the text after `ros`, and these arguments. The node of the host adds the arguments of the instance.

use super::python::word;
use super::ros_components;
use crate::check::ros_name::{self, NameText};
use crate::check::spec::Module;
use crate::check::value::Reader;
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{BRIDGE_PROGRAM, LeafKind, ROS_NODE, ROS_VARIABLES, words};
use crate::source::Span;
use crate::syntax::SyntaxKind::{
    Constant, Exec, Lifecycle, Python, RosAction, RosComponent, RosComponents, RosName, RosParams, RosProgram,
    RosRemap, RosSetup, StopWithin, Text,
};
use crate::syntax::ast::Node;
use std::collections::BTreeSet;
use std::time::Duration;

/// How long the program has to end after SIGINT, unless the module declares another time.
const STOP_WITHIN: Duration = Duration::from_secs(5);
/// The additional time for SIGTERM and SIGKILL.
const FORCE_WITHIN: Duration = Duration::from_secs(3);
/// How long a node may take to be configured or activated, and a container to load its components, unless the module declares another
/// time.
pub(super) const WITHIN: Duration = Duration::from_secs(10);
/// How long the setup file and the router may take before a node is configured or a container is started.
const PREPARE_WITHIN: Duration = Duration::from_secs(20);
/// The endings of launch files that `ros2 launch` adds to a name.
const LAUNCH_FILES: [&str; 3] = ["launch.py", "launch.xml", "launch.yaml"];

/// A mistake, with its place and a hint.
pub(super) struct Mistake {
    code: Code,
    span: Span,
    message: String,
    help: &'static str,
}

/// Reads the program of ROS 2 in a module, after the rest of the module is read.
pub(super) fn read(module: &mut Module, node: &Node, reader: &mut Reader<'_>) {
    let read = match node.child(RosProgram) {
        Some(item) => item.token(Text).map_or(Ok(()), |_| program(module, node, &item, reader)),
        None => without_program(node),
    };
    if let Err(Mistake { code, span, message, help }) = read {
        reader.diagnostics.push(Diagnostic::new(code, span, message).help(help));
    }
    check_names(module, node, reader);
}

/// Reports parameters in names that the module does not have.
fn check_names(module: &Module, node: &Node, reader: &mut Reader<'_>) {
    let Some(params) = &module.params else { return };
    let components =
        node.children_of(RosComponents).flat_map(|item| item.children_of(RosComponent).collect::<Vec<_>>());
    for part in std::iter::once(node.clone()).chain(components) {
        let items = part.children().filter(|item| [RosName, RosRemap, RosAction].contains(&item.kind()));
        let texts = items.flat_map(|item| item.tokens().filter(|token| token.kind() == Text).collect::<Vec<_>>());
        let misfits = texts.filter_map(|text| NameText::of(&text).misfit(params, &module.name.text));
        reader.diagnostics.extend(misfits);
    }
}

/// A name that ROS 2 refuses.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::check) struct Refused {
    pub(in crate::check) name: String,
    /// The reason, for example the values of its parameters.
    pub(in crate::check) help: String,
}

/// Returns the `exec` of a module with the values of the parameters in its names.
///
/// # Errors
/// A name with these values is not a name of ROS 2, or two nodes have the same name.
pub(in crate::check) fn named(exec: &str, value: impl Fn(&str) -> Option<String>) -> Result<String, Refused> {
    let is_of_ros = exec.strip_prefix(BRIDGE_PROGRAM).is_some_and(|rest| rest.starts_with(' '));
    if !is_of_ros || !exec.contains('{') {
        return Ok(exec.to_owned());
    }
    // The words were written by this room, so they can be read.
    let words = words(exec).unwrap_or_default();
    let own = words.iter().position(|word| word == "--").map_or(0..0, |dashes| {
        let count = words.get(dashes + 1).and_then(|count| count.parse().ok()).unwrap_or(0);
        dashes..dashes + 2 + count
    });
    let (mut written, mut nodes) = (Words::default(), BTreeSet::new());
    for (place, word) in words.into_iter().enumerate() {
        let kind = word.split_once('=').filter(|_| !own.contains(&place)).map_or("", |(kind, _)| kind);
        let is_fit: fn(&str) -> bool = match kind {
            "node" | "action" => ros_name::is_node,
            "remap" | "remaps" => |rules| rules.split(' ').flat_map(|rule| rule.split(":=")).all(ros_name::is_remapped),
            _ => {
                written.put(&word);
                continue;
            }
        };
        let name = &word[kind.len() + 1..];
        let params = ros_name::params(name);
        let is_value = |name: &&str| value(name).is_some_and(|text| text.chars().all(ros_name::is_part));
        let text = ros_name::filled(name, &value);
        let is_new = kind != "node" || nodes.insert(text.clone());
        if !params.iter().all(is_value) || !is_fit(&text) || !is_new {
            let twice = "two nodes of this container have this name; give the component another name";
            let help = if is_new { ros_name::values_of(&params, value) } else { twice.to_owned() };
            return Err(Refused { name: text, help });
        }
        written.put(&format!("{kind}={text}"));
    }
    Ok(written.text)
}

/// Returns the `exec` for a program that its node starts again after a failure. With it, the bridge's program ends when its program ends.
pub(in crate::check) fn restarting(exec: &str) -> String {
    let start = format!("{BRIDGE_PROGRAM} {ROS_NODE} ");
    exec.strip_prefix(&start).map_or_else(|| exec.to_owned(), |rest| format!("{start}restarts=true {rest}"))
}

/// The form in which a program of ROS 2 gets the arguments of its process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::check) enum Form {
    /// Parameters of a node, whose values are YAML.
    Parameters,
    /// Arguments of a launch file, whose values are plain texts.
    LaunchArguments,
}

/// Returns the form of the arguments for the `exec` of a module. Returns none if it does not start a program of ROS 2.
pub(in crate::check) fn form(exec: &str) -> Option<Form> {
    let rest = exec.strip_prefix(&format!("{BRIDGE_PROGRAM} {ROS_NODE} package="))?;
    let is_launch = rest.split(' ').nth(1).is_some_and(|word| word.starts_with("launch="));
    Some(if is_launch { Form::LaunchArguments } else { Form::Parameters })
}

/// Reports items that have a meaning only for a program of ROS 2.
fn without_program(node: &Node) -> Result<(), Mistake> {
    let kinds = [(RosSetup, "setup"), (RosName, "node"), (RosRemap, "remap"), (RosParams, "params")];
    let of_nodes = [(Lifecycle, "lifecycle"), (RosComponents, "components")];
    let found = kinds.into_iter().chain(of_nodes).find_map(|(kind, word)| {
        let item = node.child(kind)?;
        Some((item.span(), word))
    });
    found.map_or(Ok(()), |(span, word)| {
        let message = format!("`{word}` needs a program of ROS 2, and this module has no such program");
        Err(fault(span, message, "name the program: `ros \"package executable\";`"))
    })
}

fn program(module: &mut Module, node: &Node, item: &Node, reader: &mut Reader<'_>) -> Result<(), Mistake> {
    check_module(module, node, item)?;
    let text = Told::of(item);
    let help = "write the package and the executable, as for `ros2 run`: `ros \"demo_nodes_cpp talker\";`";
    let all = words(&text.text).map_err(|why| fault(text.span, format!("this starts nothing: {why}"), help))?;
    let [package, executable, rest @ ..] = all.as_slice() else {
        return Err(fault(
            text.span,
            "a program of ROS 2 needs the names of a package and of an executable".to_owned(),
            help,
        ));
    };
    for name in [package, executable] {
        let is_fit = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
        if !name.chars().all(is_fit) || name.starts_with('.') {
            return Err(fault(text.span, format!("{name:?} is not a name of a package or an executable"), help));
        }
    }
    let mut exec = Words::default();
    exec.add("package", package, text.span)?;
    let is_launch = LAUNCH_FILES.iter().any(|ending| executable.ends_with(ending));
    exec.add(if is_launch { "launch" } else { "executable" }, executable, text.span)?;
    if is_launch {
        check_launch(node)?;
    } else {
        if let Some(name) = node.child(RosName).map(|item| node_name(&item)).transpose()?.flatten() {
            exec.add("node", &name, text.span)?;
        }
        // Files are separated by `:`, as in `PATH`.
        for (name, all) in [("remaps", remaps(node)?.join(" ")), ("files", files(node)?.join(":"))] {
            if !all.is_empty() {
                exec.add(name, &all, node.span())?;
            }
        }
    }
    if let Some(setup) = node.child(RosSetup).filter(|item| item.token(Text).is_some()) {
        let Told { text, span } = Told::of(&setup);
        check_path(&text, span)?;
        exec.add("setup", &text, span)?;
    }
    let wait = if node.child(StopWithin).is_some() { module.times.stop_within } else { STOP_WITHIN };
    exec.add("stop_ms", &wait.as_millis().to_string(), text.span)?;
    lifecycle(module, node, reader, &mut exec)?;
    let components = ros_components::read(module, node, reader, &mut exec)?;
    if !components.is_empty() {
        module.times.ready_within = Some(PREPARE_WITHIN);
    }
    if module.has_end && !module.is_service {
        exec.add("ends", "true", text.span)?;
    }
    exec.text.push_str(&format!(" -- {}", rest.len()));
    for one in rest.iter().chain(&components) {
        exec.push(one, text.span)?;
    }
    module.times.stop_within = wait.saturating_add(FORCE_WITHIN);
    module.exec = Some(format!("{BRIDGE_PROGRAM} {ROS_NODE}{}", exec.text));
    module.environment.inherited.extend(ROS_VARIABLES.map(str::to_owned));
    Ok(())
}

/// Checks that the module is started in one way only, and that it has no ports.
fn check_module(module: &Module, node: &Node, item: &Node) -> Result<(), Mistake> {
    let others = [Exec, Python, RosAction].into_iter().any(|kind| node.child(kind).is_some());
    if others || module.kind == LeafKind::Plain {
        let message = "a module that is a program of ROS 2 cannot also be started in another way".to_owned();
        let help = "remove `exec`, `python`, `action` and `plain`";
        return Err(Mistake { code: Code::E0011, span: item.span(), message, help });
    }
    if !module.ports.is_empty() || !module.outcomes.is_empty() || module.start.is_some() {
        let message = "a program of ROS 2 cannot have ports, a start value or outcomes".to_owned();
        let help =
            "connect the ports of other processes with its topics and services: `topic(\"/scan\") -> avoid.Scan;`";
        return Err(fault(item.span(), message, help));
    }
    Ok(())
}

/// Checks that a module with a launch file has no items about single nodes, because the launch file describes its nodes itself.
fn check_launch(node: &Node) -> Result<(), Mistake> {
    let kinds = [(RosName, "node"), (RosRemap, "remap"), (RosParams, "params"), (Lifecycle, "lifecycle")];
    let found = kinds
        .into_iter()
        .chain([(RosComponents, "components")])
        .find_map(|(kind, word)| Some((node.child(kind)?.span(), word)));
    found.map_or(Ok(()), |(span, word)| {
        let message = format!("a launch file starts nodes of its own, so `{word}` has no meaning for it");
        Err(fault(
            span,
            message,
            "pass an argument to the launch file: each parameter of the module is such an argument",
        ))
    })
}

/// Returns the name of a node. None if the text is damaged, which was reported.
pub(super) fn node_name(item: &Node) -> Result<Option<String>, Mistake> {
    if item.token(Text).is_none() {
        return Ok(None);
    }
    let Told { text, span } = Told::of(item);
    if !(NameText { text: text.clone(), span }).can_be(ros_name::is_node) {
        let message = format!("{text:?} is not the name of a node of ROS 2");
        let help = "a name begins with `/` and its namespace: `/robot1/controller_server`; its words have letters, digits and `_`";
        return Err(fault(span, message, help));
    }
    Ok(Some(text))
}

/// Returns the other names of topics, each as `from:=to`.
pub(super) fn remaps(node: &Node) -> Result<Vec<String>, Mistake> {
    let mut remaps = Vec::new();
    for item in node.children_of(RosRemap) {
        let texts: Vec<_> = item.tokens().filter(|token| token.kind() == Text).collect();
        let [from, to] = texts.as_slice() else { continue };
        for token in [from, to] {
            let name = NameText::of(token);
            if !name.can_be(ros_name::is_remapped) {
                let text = name.text;
                let message = format!("{text:?} is not a name of a topic or a service of ROS 2");
                let help = "write a name such as `/cmd_vel`, `cmd_vel` or `~/cmd_vel`; `node` renames the node itself";
                return Err(fault(token.span(), message, help));
            }
        }
        remaps.push(format!("{}:={}", from.content(), to.content()));
    }
    Ok(remaps)
}

/// Returns the paths of the files of parameters.
pub(super) fn files(node: &Node) -> Result<Vec<String>, Mistake> {
    let mut files = Vec::new();
    for item in node.children_of(RosParams).filter(|item| item.token(Text).is_some()) {
        let Told { text, span } = Told::of(&item);
        check_path(&text, span)?;
        files.push(text);
    }
    Ok(files)
}

fn lifecycle(module: &mut Module, node: &Node, reader: &mut Reader<'_>, exec: &mut Words) -> Result<(), Mistake> {
    let Some(item) = node.child(Lifecycle) else { return Ok(()) };
    if node.child(RosName).is_none() {
        let message = "`lifecycle` needs the name of the node, because services with this name control the lifecycle";
        return Err(fault(item.span(), message.to_owned(), "add the name: `node \"/controller_server\";`"));
    }
    if module.has_end {
        let message = "a node with a lifecycle cannot have `done`: it is active until it is stopped".to_owned();
        return Err(fault(item.span(), message, "remove `done`"));
    }
    let within = item.child(Constant).map(|node| reader.duration(&node));
    // A wrong time was already reported.
    let within = within.flatten().unwrap_or(WITHIN);
    if within.is_zero() {
        let message = "the time limit of `lifecycle` is zero".to_owned();
        return Err(fault(item.span(), message, "write how long the configuration may take: `lifecycle within 30 s;`"));
    }
    module.is_service = true;
    module.times.ready_within = Some(within.saturating_add(PREPARE_WITHIN));
    exec.add("lifecycle_ms", &within.as_millis().to_string(), item.span())
}

fn check_path(text: &str, span: Span) -> Result<(), Mistake> {
    if text.is_empty() || text.contains(':') || text.chars().any(char::is_control) {
        let message = format!("{text:?} is not the path of a file");
        return Err(fault(span, message, "this path cannot contain `:` or control characters"));
    }
    Ok(())
}

pub(super) fn fault(span: Span, message: String, help: &'static str) -> Mistake {
    Mistake { code: Code::E0309, span, message, help }
}

/// The text of an item, and its place.
pub(super) struct Told {
    pub(super) text: String,
    pub(super) span: Span,
}

impl Told {
    pub(super) fn of(item: &Node) -> Self {
        item.token(Text).map_or_else(
            || Self { text: String::new(), span: item.span() },
            |token| Self { text: token.content(), span: token.span() },
        )
    }
}

/// The words of an `exec`.
#[derive(Default)]
pub(super) struct Words {
    text: String,
}

impl Words {
    /// Adds a word that was in an `exec` before.
    fn put(&mut self, text: &str) {
        if !self.text.is_empty() {
            self.text.push(' ');
        }
        self.text.push_str(&quoted(text).unwrap_or_default());
    }

    pub(super) fn add(&mut self, name: &str, value: &str, span: Span) -> Result<(), Mistake> {
        self.push(&format!("{name}={value}"), span)
    }

    fn push(&mut self, text: &str, span: Span) -> Result<(), Mistake> {
        let message = || fault(span, format!("{text:?} has both kinds of quotes"), "use one kind of quotes");
        self.text.push(' ');
        self.text.push_str(&quoted(text).ok_or_else(message)?);
        Ok(())
    }
}

/// Returns a word as an `exec` has it; none if it has both kinds of quotes.
fn quoted(text: &str) -> Option<String> {
    let is_bare = |c: char| c.is_ascii_alphanumeric() || "_-./=:+@%,".contains(c);
    if !text.is_empty() && text.chars().all(is_bare) { Some(text.to_owned()) } else { word(text) }
}

#[cfg(test)]
mod tests {
    use crate::plan::{Leaf, words};
    use crate::source::Source;
    use crate::{Options, compile};

    fn leaf(module: &str, instance: &str, policies: &str) -> Leaf {
        let text = format!(
            "module Nav{module}
             process main(){{ host{{c1}} instantiated_processes{{ nav instof Nav({instance}){policies}; }}
             internal_event_actions{{ nav }} }}"
        );
        let compiled = compile(&Source::new("a.dca", text), &[], &Options::named("a"));
        let told: Vec<String> = compiled.diagnostics.iter().map(|found| found.message.clone()).collect();
        compiled.plan.unwrap_or_else(|| panic!("{told:?}")).leaves.remove(0)
    }

    #[track_caller]
    fn check(module: &str, expected: &[&str]) {
        let leaf = leaf(module, "c1", "");
        assert_eq!(words(leaf.exec.as_deref().unwrap_or_default()).unwrap(), expected);
    }

    #[test]
    fn a_program_of_ros_is_started_by_the_bridge() {
        check(
            "(host) { ros \"demo_nodes_cpp talker\"; service; }",
            &["dca-ros", "RosNode", "package=demo_nodes_cpp", "executable=talker", "stop_ms=5000", "--", "0"],
        );
        check(
            "(host, gain: Force = 2 N, label: Text = \"a b\", raw = 3) {
                ros \"nav2_controller controller_server --log-level 'very low'\"; setup \"/opt/my ros/setup.bash\";
                node \"/robot1/controller_server\"; lifecycle within 30 s; stop within 2 s;
                remap \"/cmd_vel\" -> \"/robot1/cmd_vel\"; remap \"~/in\" -> \"scan\";
                params \"nav.yaml\"; params \"/etc/more.yaml\"; }",
            &[
                "dca-ros",
                "RosNode",
                "package=nav2_controller",
                "executable=controller_server",
                "node=/robot1/controller_server",
                "remaps=/cmd_vel:=/robot1/cmd_vel ~/in:=scan",
                "files=nav.yaml:/etc/more.yaml",
                "setup=/opt/my ros/setup.bash",
                "stop_ms=2000",
                "lifecycle_ms=30000",
                "--",
                "2",
                "--log-level",
                "very low",
            ],
        );
        check(
            "(host) { ros \"nav2_bringup bringup.launch.py slam:=true\"; done; }",
            &[
                "dca-ros",
                "RosNode",
                "package=nav2_bringup",
                "launch=bringup.launch.py",
                "stop_ms=5000",
                "ends=true",
                "--",
                "1",
                "slam:=true",
            ],
        );
    }

    #[test]
    fn the_names_of_a_program_have_the_values_of_its_parameters() {
        let module =
            "(host, robot: Text, side: Text = \"left\") { ros \"demo nav 'node={robot}'\"; setup \"{robot}.bash\";
            node \"/{robot}/nav\"; remap \"/a\" -> \"/{robot}/a_{side}\"; remap \"b\" -> \"{side}\"; service; }";
        let exec = leaf(module, "c1, robot = \"r7\"", "").exec.unwrap_or_default();
        let expected = [
            "dca-ros",
            "RosNode",
            "package=demo",
            "executable=nav",
            "node=/r7/nav",
            "remaps=/a:=/r7/a_left b:=left",
            "setup={robot}.bash",
            "stop_ms=5000",
            "--",
            "1",
            "node={robot}",
        ];
        assert_eq!(words(&exec).unwrap(), expected);
    }

    #[test]
    fn components_are_words_behind_the_own_ones() {
        let module = "(host, robot: Text) { ros \"demo box --fast\"; node \"/{robot}/box\"; components within 3 s {
            one \"a a::A\" { remap \"x\" -> \"/{robot}/x\"; params \"my file.yaml\"; intra_process; } two \"b b::B\"; } }";
        let leaf = leaf(module, "c1, robot = \"r7\"", "");
        assert_eq!(leaf.policy.ready_within.map(|it| it.as_secs()), Some(20));
        let expected = [
            "dca-ros",
            "RosNode",
            "package=demo",
            "executable=box",
            "node=/r7/box",
            "stop_ms=5000",
            "components_ms=3000",
            "component_words=11",
            "--",
            "1",
            "--fast",
            "component=one",
            "package=a",
            "class=a::A",
            "node=/r7/one",
            "remap=x:=/r7/x",
            "file=my file.yaml",
            "intra_process=true",
            "component=two",
            "package=b",
            "class=b::B",
            "node=/r7/two",
        ];
        assert_eq!(words(leaf.exec.as_deref().unwrap_or_default()).unwrap(), expected);
    }

    #[test]
    fn its_times_and_its_restart_reach_the_leaf() {
        let module = "(host) { ros \"a b\"; node \"/n\"; lifecycle within 3 s; stop within 1 s; }";
        let plain = leaf(module, "c1", "");
        assert_eq!((plain.stop_within.as_secs(), plain.policy.ready_within.map(|it| it.as_secs())), (4, Some(23)));
        let given = leaf(module, "c1", " { restart transient; ready within 50 s; }");
        assert_eq!(given.policy.ready_within.map(|it| it.as_secs()), Some(50));
        let exec = given.exec.unwrap_or_default();
        assert!(exec.starts_with("dca-ros RosNode restarts=true package=a "), "{exec}");
    }
}
