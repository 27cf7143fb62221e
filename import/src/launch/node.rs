//! The programs for nodes, for launch files in Python, and for other commands.

use super::component;
use super::entity::Entity;
use super::parameter::{Literal, is_name};
use super::program::{Container, Ends, Parameter, Program};
use super::scope::inside;
use super::settings::Settings;
use super::value::Value;
use super::walk::{Importer, Skipped};
use super::words;
use crate::name::{is_hidden, pascal, quoted, snake};
use crate::remark::RemarkKind;
use language::plan::{value_problem, variable_problem};
use std::collections::BTreeMap;

/// How long a program has after SIGINT in launch, and in a spec unless it says otherwise.
const STOP_MS: u64 = 5_000;
/// The pauses before a restart that a spec takes.
const PAUSE_MS: std::ops::RangeInclusive<u64> = 10..=3_600_000;
/// Attributes of a node and of a command.
const ATTRIBUTES: [&str; 13] = [
    "pkg",
    "exec",
    "name",
    "node_name",
    "namespace",
    "args",
    "ros_args",
    "respawn",
    "respawn_delay",
    "sigterm_timeout",
    "cwd",
    "cmd",
    "shell",
];

/// Whether a text can be the name of a package, an executable or a launch file in a spec.
pub(super) fn is_package(text: &str) -> bool {
    let is_part = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
    !text.is_empty() && !text.starts_with('.') && text.chars().all(is_part)
}

/// Returns a time in milliseconds from a number of seconds.
pub(super) fn milliseconds(text: &str) -> Option<u64> {
    let seconds = text.trim().parse::<f64>().ok().filter(|seconds| (0.0..=1e6).contains(seconds))?;
    u64::try_from(std::time::Duration::from_secs_f64(seconds).as_millis()).ok()
}

/// Returns the program of a node of ROS 2, or of a container of components.
pub(super) fn node(importer: &mut Importer<'_>, entity: &Entity) -> Result<Program, Skipped> {
    let from = importer.remarks.len();
    let [package, executable] = [importer.needed(entity, "pkg")?, importer.needed(entity, "exec")?];
    if !is_package(&package) || !is_package(&executable) {
        return Err(
            importer.missing(entity, &format!("`{package}` `{executable}` are not a package and an executable"))
        );
    }
    let name = importer.text(entity, "name").ok().flatten().filter(|name| !name.is_empty());
    let namespace = importer.text(entity, "namespace").ok().flatten().unwrap_or_default();
    let namespace = inside(importer.scopes.namespace(), &namespace);
    let mut settings = Settings::default();
    let mut items = Vec::new();
    let whole = name.as_ref().map(|name| format!("{}/{name}", namespace.trim_end_matches('/')));
    let whole = whole.filter(|whole| is_graph_name(whole));
    match &whole {
        Some(whole) => items.push(format!("node {};", quoted(whole))),
        None if name.is_some() => {
            importer.missing(
                entity,
                &format!("the name of the node is left out: `{namespace}`, `{}`", name.as_deref().unwrap_or("")),
            );
        }
        None if namespace == "/" => {}
        None if is_graph_name(&namespace) => settings.words.extend(["-r".into(), format!("__ns:={namespace}")]),
        None => drop(importer.missing(entity, &format!("the namespace is left out: `{namespace}`"))),
    }
    let has_name = !items.is_empty();
    settings.read(importer, entity);
    let line = command_line(importer, entity, [&package, &executable], settings.words)?;
    items.insert(0, format!("ros {};", quoted(&line)));
    items.splice(1..1, setup(importer));
    let ends = lifecycle(importer, entity, has_name, &mut items);
    items.extend(settings.remaps.iter().map(|[from, to]| format!("remap {} -> {};", quoted(from), quoted(to))));
    items.extend(settings.files.iter().map(|file| format!("params {};", quoted(file))));
    let wanted = name.as_deref().unwrap_or(&executable);
    let description = format!("`{executable}` of `{package}`.");
    let mut program = program(importer, [wanted, &description], items);
    program.parameters = settings.parameters;
    program.ends = ends;
    program.container = whole.filter(|_| ends == Ends::Done).map(Container::new);
    component::of_container(importer, entity, &mut program);
    common(importer, entity, &mut program);
    let parts = ["param", "remap", "env", "composable_node"];
    unread_parts(importer, entity, &parts);
    program.remarks = from..importer.remarks.len();
    Ok(program)
}

/// Returns the program of a launch file of a package. The names of the package and the file.
pub(super) fn launch_file(
    importer: &mut Importer<'_>,
    entity: &Entity,
    [package, file]: [&str; 2],
    arguments: Vec<(String, Value)>,
) -> Result<Program, Skipped> {
    let from = importer.remarks.len();
    importer.remark(
        entity,
        RemarkKind::Differs,
        &format!("`{file}` of `{package}` is one process here, started with `ros2 launch`; its nodes are not known"),
    );
    if importer.scopes.namespace() != "/" || !importer.scopes.settings().is_empty() {
        let why = format!("the namespace, parameters and other names of the group do not reach the nodes of `{file}`");
        importer.missing(entity, &why);
    }
    let (mut parameters, mut words) = (BTreeMap::new(), Vec::new());
    for (name, value) in arguments {
        let link = importer.link(&value).filter(|(_, literal)| literal.is_text());
        if let Some((given, value)) = link.filter(|_| is_name(&name)) {
            let given = Some(importer.given(given, value.clone()));
            parameters.insert(name.clone(), Parameter { name, value, given });
            continue;
        }
        let found = importer.fixed(value).and_then(|text| {
            let literal = Literal::text(&text).ok_or_else(|| format!("a spec cannot have the value of `{name}`"))?;
            Ok((text, literal))
        });
        match found {
            Ok((_, value)) if is_name(&name) => {
                parameters.insert(name.clone(), Parameter { name, value, given: None });
            }
            Ok((text, _)) => words.push(format!("{name}:={text}")),
            Err(why) => drop(importer.missing(entity, &format!("argument `{name}` is left out: {why}"))),
        }
    }
    let line = joined_words(importer, entity, [package, file].map(str::to_owned).into_iter().chain(words))?;
    let mut items = vec![format!("ros {};", quoted(&line))];
    items.extend(setup(importer));
    let wanted = file.split('.').next().unwrap_or(file).to_owned();
    let description = format!("The launch file `{file}` of `{package}`.");
    let mut program = program(importer, [&wanted, &description], items);
    program.parameters = parameters.into_values().collect();
    environment(importer, entity, &mut program);
    program.remarks = from..importer.remarks.len();
    Ok(program)
}

/// Returns the program of a command.
pub(super) fn executable(importer: &mut Importer<'_>, entity: &Entity) -> Result<Program, Skipped> {
    let from = importer.remarks.len();
    let line = importer.needed(entity, "cmd")?;
    let is_shell = importer.text(entity, "shell")?.and_then(|text| Value::plain(text).truth()).unwrap_or(false);
    let split = words::split(&line);
    let split = split.map_err(|why| importer.missing(entity, &format!("`{line}` is left out: {why}")))?;
    let Some(first) = split.first().filter(|first| !first.is_empty()).cloned() else {
        return Err(importer.missing(entity, "`executable` is left out: its `cmd` is empty"));
    };
    let words = if is_shell { ["sh", "-c", &line].map(str::to_owned).to_vec() } else { split };
    let line = joined_words(importer, entity, words.into_iter())?;
    let name = importer.text(entity, "name").ok().flatten();
    let file = first.rsplit('/').next().unwrap_or(&first).to_owned();
    let wanted = name.as_deref().filter(|name| !name.is_empty()).unwrap_or(&file);
    let items = vec![format!("exec {};", quoted(&line)), "plain;".into()];
    let mut program = program(importer, [wanted, &format!("The command `{first}`.")], items);
    common(importer, entity, &mut program);
    unread_parts(importer, entity, &["env"]);
    program.remarks = from..importer.remarks.len();
    Ok(program)
}

/// Returns a program with names of its own. The texts are the wish for its name, and a sentence.
fn program(importer: &mut Importer<'_>, [wanted, description]: [&str; 2], items: Vec<String>) -> Program {
    let module = importer.module_names.take(&pascal(wanted));
    let instance = importer.names.take(&snake(wanted));
    let description = crate::name::plain(description);
    Program {
        module,
        instance,
        description,
        items,
        parameters: Vec::new(),
        ends: Ends::Done,
        policies: Vec::new(),
        container: None,
        remarks: 0..0,
    }
}

fn setup(importer: &Importer<'_>) -> Option<String> {
    importer.settings.setup.as_ref().map(|file| format!("setup {};", quoted(file)))
}

/// Returns the parts of the command line: package, executable, arguments, and arguments of ROS 2.
fn command_line(
    importer: &mut Importer<'_>,
    entity: &Entity,
    program: [&str; 2],
    ros: Vec<String>,
) -> Result<String, Skipped> {
    let split = |importer: &mut Importer<'_>, name: &str| {
        let text = importer.text(entity, name).ok().flatten().unwrap_or_default();
        words::split(&text).unwrap_or_else(|why| {
            importer.missing(entity, &format!("`{name}` is left out: {why}"));
            Vec::new()
        })
    };
    let (own, mut more) = (split(importer, "args"), split(importer, "ros_args"));
    more.extend(ros);
    let flag = (!more.is_empty()).then(|| "--ros-args".to_owned());
    let words = program.map(str::to_owned).into_iter().chain(own).chain(flag).chain(more);
    joined_words(importer, entity, words)
}

fn joined_words(
    importer: &mut Importer<'_>,
    entity: &Entity,
    all: impl Iterator<Item = String>,
) -> Result<String, Skipped> {
    let written = all.map(|word| words::written(&word)).collect::<Result<Vec<_>, _>>();
    written
        .map(|words| words.join(" "))
        .map_err(|why| importer.missing(entity, &format!("`{}` is left out: {why}", entity.kind)))
}

/// Whether a node has a lifecycle, and how it ends.
fn lifecycle(importer: &mut Importer<'_>, entity: &Entity, has_name: bool, items: &mut Vec<String>) -> Ends {
    if entity.kind != "lifecycle_node" {
        return Ends::Done;
    }
    if !has_name {
        importer.missing(entity, "the lifecycle is left out: the node has no name");
        return Ends::Done;
    }
    if importer.truth(entity, "autostart") != Some(true) {
        importer.remark(entity, RemarkKind::Differs, "the node is configured and activated here");
    }
    items.push("lifecycle;".into());
    Ends::Lifecycle
}

/// The parts that nodes and commands share.
fn common(importer: &mut Importer<'_>, entity: &Entity, program: &mut Program) {
    let mut read = ATTRIBUTES.to_vec();
    if entity.kind == "lifecycle_node" {
        read.push("autostart");
    }
    importer.unread(entity, &read);
    environment(importer, entity, program);
    if let Ok(Some(folder)) = importer.text(entity, "cwd") {
        match folder.is_empty() || folder.chars().any(is_hidden) {
            true => drop(importer.missing(entity, &format!("`{folder}` is not a folder"))),
            false => program.items.push(format!("directory {};", quoted(&folder))),
        }
    }
    let time = |importer: &mut Importer<'_>, name: &str| {
        let text = importer.text(entity, name).ok().flatten()?;
        let found = milliseconds(&text);
        if found.is_none() {
            importer.missing(entity, &format!("`{text}` is not a number of seconds"));
        }
        found
    };
    if let Some(wait) = time(importer, "sigterm_timeout").filter(|wait| *wait != STOP_MS) {
        program.items.push(format!("stop within {};", crate::name::duration(wait.max(1))));
    } else if entity.kind == "executable" {
        program.items.push(format!("stop within {};", crate::name::duration(STOP_MS)));
    }
    let respawns = importer.truth(entity, "respawn");
    let pause = time(importer, "respawn_delay");
    if respawns != Some(true) {
        return;
    }
    importer.remark(
        entity,
        RemarkKind::Differs,
        "this node is restarted at most five times within 60 s, and then it aborts",
    );
    if program.ends == Ends::Done {
        program.ends = Ends::Service;
    }
    program.policies.push("restart transient;".into());
    if entity.kind == "executable" {
        program.policies[0] = "restart permanent;".into();
    }
    if let Some(pause) = pause.filter(|pause| *pause > 0) {
        let pause = crate::name::duration(pause.clamp(*PAUSE_MS.start(), *PAUSE_MS.end()));
        program.policies.push(format!("backoff {pause} to {pause};"));
    }
}

/// The variables of the environment.
fn environment(importer: &mut Importer<'_>, entity: &Entity, program: &mut Program) {
    let mut variables = importer.scopes.environment();
    for part in entity.parts("env") {
        if importer.is_on(part)
            && let (Ok(name), Ok(value)) = (importer.needed(part, "name"), importer.needed(part, "value"))
        {
            variables.insert(name, value);
        }
    }
    let mut text = String::new();
    for (name, value) in variables {
        let problem = variable_problem(&name).or_else(|| value_problem(&value));
        match problem.or_else(|| value.chars().any(is_hidden).then(|| "has hidden characters".to_owned())) {
            Some(why) => drop(importer.missing(entity, &format!("variable `{name}` is left out: {why}"))),
            None => text += &format!("{name} = {};\n", quoted(&value)),
        }
    }
    if !text.is_empty() {
        program.items.push(format!("env{{\n{text}}}"));
    }
}

/// Notes the parts of an action that are not read.
fn unread_parts(importer: &mut Importer<'_>, entity: &Entity, read: &[&str]) {
    for part in entity.children.iter().filter(|part| !read.contains(&part.kind.as_str())) {
        importer.missing(part, &format!("`{}` in `{}` has no counterpart", part.kind, entity.kind));
    }
}

/// Whether a text is the full name of a node or a namespace. Source: the names of ROS 2.
pub(super) fn is_graph_name(text: &str) -> bool {
    let is_part = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let is_word =
        |word: &str| word.starts_with(|c: char| c.is_ascii_alphabetic() || c == '_') && word.chars().all(is_part);
    text.len() <= 200 && text.strip_prefix('/').is_some_and(|rest| rest.split('/').all(is_word))
}
