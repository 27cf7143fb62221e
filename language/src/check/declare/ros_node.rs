//! Reads a module that is a program of ROS 2: `ros "nav2_controller controller_server";`
//!
//! The bridge's program starts this program, and the node of the host starts the bridge's program. The last words of the `exec` are the
//! number of arguments in the text after `ros`, and these arguments. The node of the host adds the arguments of the instance.

use super::python::word;
use crate::check::spec::Module;
use crate::check::value::Reader;
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{BRIDGE_PROGRAM, LeafKind, ROS_NODE, ROS_VARIABLES, words};
use crate::source::Span;
use crate::syntax::SyntaxKind::{
    Constant, Exec, Lifecycle, Python, RosAction, RosName, RosParams, RosProgram, RosRemap, RosSetup, StopWithin, Text,
};
use crate::syntax::ast::Node;
use ros::logic::key::GraphName;
use std::time::Duration;

/// How long the program has to end after SIGINT, unless the module declares another time.
const STOP_WITHIN: Duration = Duration::from_secs(5);
/// The additional time for SIGTERM and SIGKILL.
const FORCE_WITHIN: Duration = Duration::from_secs(3);
/// How long a node may take to be configured or activated, unless the module declares another time.
const LIFECYCLE_WITHIN: Duration = Duration::from_secs(10);
/// How long the setup file and the router may take before the node is configured.
const PREPARE_WITHIN: Duration = Duration::from_secs(20);
/// The endings of launch files that `ros2 launch` adds to a name.
const LAUNCH_FILES: [&str; 3] = ["launch.py", "launch.xml", "launch.yaml"];

/// A mistake, with its place and a hint.
struct Mistake {
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
    let found = kinds.into_iter().chain([(Lifecycle, "lifecycle")]).find_map(|(kind, word)| {
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
        names(node, &mut exec)?;
        files(node, &mut exec)?;
    }
    if let Some(setup) = node.child(RosSetup).filter(|item| item.token(Text).is_some()) {
        let Told { text, span } = Told::of(&setup);
        check_path(&text, span)?;
        exec.add("setup", &text, span)?;
    }
    let wait = if node.child(StopWithin).is_some() { module.times.stop_within } else { STOP_WITHIN };
    exec.add("stop_ms", &wait.as_millis().to_string(), text.span)?;
    lifecycle(module, node, reader, &mut exec)?;
    if module.has_end && !module.is_service {
        exec.add("ends", "true", text.span)?;
    }
    exec.text.push_str(&format!(" -- {}", rest.len()));
    for one in rest {
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
    let found = kinds.into_iter().find_map(|(kind, word)| Some((node.child(kind)?.span(), word)));
    found.map_or(Ok(()), |(span, word)| {
        let message = format!("a launch file starts nodes of its own, so `{word}` has no meaning for it");
        Err(fault(
            span,
            message,
            "pass an argument to the launch file: each parameter of the module is such an argument",
        ))
    })
}

/// Reads the name of the node, and the other names of its topics.
fn names(node: &Node, exec: &mut Words) -> Result<(), Mistake> {
    if let Some(item) = node.child(RosName).filter(|item| item.token(Text).is_some()) {
        let Told { text, span } = Told::of(&item);
        if !text.starts_with('/') || text.len() > 200 || GraphName::parse(&text).is_none() {
            let message = format!("{text:?} is not the name of a node of ROS 2");
            let help = "a name begins with `/` and its namespace: `/robot1/controller_server`; its words have letters, digits and `_`";
            return Err(fault(span, message, help));
        }
        exec.add("node", &text, span)?;
    }
    let mut remaps = Vec::new();
    for item in node.children_of(RosRemap) {
        let texts: Vec<_> = item.tokens().filter(|token| token.kind() == Text).collect();
        let [from, to] = texts.as_slice() else { continue };
        for token in [from, to] {
            let text = token.content();
            let is_fit = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '/' | '~');
            if text.is_empty() || text.starts_with("__") || !text.chars().all(is_fit) {
                let message = format!("{text:?} is not a name of a topic or a service of ROS 2");
                let help = "write a name such as `/cmd_vel`, `cmd_vel` or `~/cmd_vel`; `node` renames the node itself";
                return Err(fault(token.span(), message, help));
            }
        }
        remaps.push(format!("{}:={}", from.content(), to.content()));
    }
    if remaps.is_empty() { Ok(()) } else { exec.add("remaps", &remaps.join(" "), node.span()) }
}

/// Reads the files of parameters. They are separated by `:` as in `PATH`.
fn files(node: &Node, exec: &mut Words) -> Result<(), Mistake> {
    let mut files = Vec::new();
    for item in node.children_of(RosParams).filter(|item| item.token(Text).is_some()) {
        let Told { text, span } = Told::of(&item);
        check_path(&text, span)?;
        files.push(text);
    }
    if files.is_empty() { Ok(()) } else { exec.add("files", &files.join(":"), node.span()) }
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
    let within = within.flatten().unwrap_or(LIFECYCLE_WITHIN);
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

fn fault(span: Span, message: String, help: &'static str) -> Mistake {
    Mistake { code: Code::E0309, span, message, help }
}

/// The text of an item, and its place.
struct Told {
    text: String,
    span: Span,
}

impl Told {
    fn of(item: &Node) -> Self {
        item.token(Text).map_or_else(
            || Self { text: String::new(), span: item.span() },
            |token| Self { text: token.content(), span: token.span() },
        )
    }
}

/// The words of an `exec`.
#[derive(Default)]
struct Words {
    text: String,
}

impl Words {
    fn add(&mut self, name: &str, value: &str, span: Span) -> Result<(), Mistake> {
        self.push(&format!("{name}={value}"), span)
    }

    fn push(&mut self, text: &str, span: Span) -> Result<(), Mistake> {
        let is_bare = |c: char| c.is_ascii_alphanumeric() || "_-./=:+@%,".contains(c);
        let quoted = if !text.is_empty() && text.chars().all(is_bare) { Some(text.to_owned()) } else { word(text) };
        let message = || fault(span, format!("{text:?} has both kinds of quotes"), "use one kind of quotes");
        self.text.push(' ');
        self.text.push_str(&quoted.ok_or_else(message)?);
        Ok(())
    }
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
