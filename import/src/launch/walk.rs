//! Executes the actions of a launch file in their order.

use super::entity::{Entity, Place};
use super::parameter::Literal;
use super::program::Program;
use super::scope::{Scopes, Setting, inside};
use super::substitution::{self, Names};
use super::value::Value;
use super::{Files, LaunchSettings, component, include, node, spec};
use crate::Imported;
use crate::name;
use crate::remark::{Remark, RemarkKind};
use crate::xml::ImportError;
use std::cell::Cell;
use std::collections::BTreeSet;

/// The most actions of all files, with their parts.
const ACTIONS_MAX: usize = 20_000;
/// The most programs. A spec has more, but no person reads so many modules.
const PROGRAMS_MAX: usize = 500;
/// The most text that all substitutions make, in bytes.
const TEXT_MAX: usize = 8 * 1024 * 1024;
/// The most settings that each node of a group has.
const SETTINGS_MAX: usize = 200;
/// Attributes that say where the output goes: here it goes to `dca logs`.
const OUTPUT: [&str; 8] =
    ["output", "output_format", "log_cmd", "emulate_tty", "cached_output", "exec_name", "if", "unless"];

/// An argument of the launch file.
#[derive(Clone, Debug)]
pub(super) struct Argument {
    pub(super) name: String,
    pub(super) value: Value,
    pub(super) description: String,
    place: Place,
    file: String,
    /// Whether its value also decides something that is fixed in the spec.
    is_settled: bool,
    /// The parameter of `main`, once it has one.
    pub(super) parameter: Option<(String, Literal)>,
}

/// A step of the start.
#[derive(Clone, Debug)]
pub(super) enum Step {
    /// The program of this number.
    Run(usize),
    After {
        milliseconds: u64,
        steps: Vec<Self>,
    },
}

/// A part of the file cannot be had in a spec; a remark says why.
#[derive(Clone, Copy, Debug)]
pub(super) struct Skipped;

/// The import of a launch file.
#[derive(Debug)]
pub(super) struct Importer<'a> {
    pub(super) settings: &'a LaunchSettings,
    pub(super) files: &'a Files<'a>,
    pub(super) scopes: Scopes,
    pub(super) arguments: Vec<Argument>,
    pub(super) programs: Vec<Program>,
    pub(super) remarks: Vec<Remark>,
    /// The remarks about arguments that have one value in the spec.
    pub(super) settled: Vec<Remark>,
    /// The names of instances and of parameters of `main`.
    pub(super) names: name::Names,
    pub(super) module_names: name::Names,
    /// The files that are read now, each included by the previous one.
    pub(super) open: Vec<String>,
    pub(super) work: Work,
    /// The names of all arguments that the files declare.
    declared: BTreeSet<String>,
}

/// The work that was done, which is limited.
#[derive(Debug, Default)]
pub(super) struct Work {
    pub(super) includes: usize,
    actions: usize,
    /// The bytes of all texts.
    text: Cell<usize>,
}

/// Makes a spec of the actions of a file.
pub(super) fn import(
    file: &str,
    root: &Entity,
    settings: &LaunchSettings,
    files: &Files<'_>,
) -> Result<Imported, ImportError> {
    let mut importer = Importer {
        settings,
        files,
        scopes: Scopes::new(),
        arguments: Vec::new(),
        programs: Vec::new(),
        remarks: Vec::new(),
        settled: Vec::new(),
        names: name::Names::default(),
        module_names: name::Names::default(),
        open: vec![file.to_owned()],
        work: Work::default(),
        declared: BTreeSet::new(),
    };
    importer.names.take("robot");
    importer.module_names.take("Host");
    let mut steps = Vec::new();
    // `--set` gives a value to a variable that no action declares as well, as `ros2 launch` does.
    for (name, value) in &settings.arguments {
        importer.scopes.top().variables.insert(name.clone(), Value::plain(value.clone()));
    }
    importer.actions(&root.children, &mut steps)?;
    if let Some(name) = settings.arguments.keys().find(|name| !importer.declared.contains(*name)) {
        let declared: Vec<String> = importer.declared.iter().map(|name| format!("`{name}`")).collect();
        let why = format!("the file has no argument `{name}`; its arguments are: {}", declared.join(", "));
        return Err(importer.error(root.place, why));
    }
    if importer.programs.is_empty() {
        importer.remark(root, RemarkKind::Missing, "the file starts no program that a spec can start");
    } else {
        let why = "in launch, the other programs continue when a program fails; here, the failure ends all programs. `name?` lets the other programs continue";
        importer.remark(root, RemarkKind::Differs, why);
    }
    Ok(spec::imported(importer, file, &steps))
}

impl Importer<'_> {
    /// Returns the name of the file that is read now.
    pub(super) fn file(&self) -> &str {
        self.open.last().map_or("", String::as_str)
    }

    pub(super) fn error(&self, place: Place, why: impl Into<String>) -> ImportError {
        ImportError { file: self.file().into(), line: place.line, column: place.column, why: why.into() }
    }

    /// Notes that an action means something else, or is missing.
    pub(super) fn remark(&mut self, entity: &Entity, kind: RemarkKind, text: &str) {
        let remark = Remark::about(self.file(), entity.place, kind, text);
        self.remarks.push(remark);
    }

    pub(super) fn missing(&mut self, entity: &Entity, text: &str) -> Skipped {
        self.remark(entity, RemarkKind::Missing, text);
        Skipped
    }

    /// Returns a text with its substitutions replaced.
    pub(super) fn value(&self, text: &str) -> Value {
        let value = substitution::replace(text, self);
        self.measure(text.len() + value.text.len() + 8 * value.arguments.len());
        value
    }

    /// Counts a text.
    pub(super) fn measure(&self, size: usize) {
        self.work.text.set(self.work.text.get().saturating_add(size));
    }

    /// Returns the text of a value that is fixed in the spec.
    pub(super) fn fixed(&mut self, value: Value) -> Result<String, String> {
        if let Some(why) = value.open {
            return Err(format!("{why}: `{}`", value.text));
        }
        for number in value.arguments {
            let Some(argument) = self.arguments.get_mut(number) else { continue };
            if !std::mem::replace(&mut argument.is_settled, true) {
                let Argument { name, value, file, place, .. } = &*argument;
                let text = format!(
                    "argument `{name}` decides more than values of parameters: there, its value is fixed to `{}`; import with `--set {name}=VALUE` for another value",
                    name::plain(&value.text)
                );
                self.settled.push(Remark::about(file, *place, RemarkKind::Differs, &text));
            }
        }
        Ok(value.text)
    }

    /// Returns an attribute that is fixed in the spec. None if the attribute is missing.
    pub(super) fn text(&mut self, entity: &Entity, name: &str) -> Result<Option<String>, Skipped> {
        let Some(written) = entity.get(name) else { return Ok(None) };
        let value = self.value(written);
        match self.fixed(value) {
            Ok(text) => Ok(Some(text)),
            Err(why) => Err(self.missing(entity, &format!("`{name}` of `{}` is left out: {why}", entity.kind))),
        }
    }

    /// Returns an attribute that is true or false; none if it is not there, or is something else.
    pub(super) fn truth(&mut self, entity: &Entity, name: &str) -> Option<bool> {
        let text = self.text(entity, name).ok().flatten()?;
        Value::plain(text).truth()
    }

    /// Returns an attribute without which the action means nothing.
    pub(super) fn needed(&mut self, entity: &Entity, name: &str) -> Result<String, Skipped> {
        let found = self.text(entity, name)?;
        found.ok_or_else(|| self.missing(entity, &format!("`{}` is left out: it has no `{name}`", entity.kind)))
    }

    /// Notes the attributes of an action that are not read.
    pub(super) fn unread(&mut self, entity: &Entity, read: &[&str]) {
        let is_read = |name: &str| read.contains(&name) || OUTPUT.contains(&name);
        let unread: Vec<&str> =
            entity.attributes.iter().map(|found| found.name.as_str()).filter(|name| !is_read(name)).collect();
        for name in unread {
            self.missing(entity, &format!("`{name}` of `{}` has no counterpart", entity.kind));
        }
    }

    /// Returns whether the conditions of an action hold.
    pub(super) fn is_on(&mut self, entity: &Entity) -> bool {
        let holds = |importer: &mut Self, name: &str, expected: bool| {
            let Some(written) = entity.get(name) else { return true };
            let value = importer.value(written);
            match (value.truth(), importer.fixed(value)) {
                (Some(truth), Ok(_)) => truth == expected,
                (None, Ok(text)) => {
                    importer.missing(entity, &format!("`{name}` is neither true nor false, and is ignored: `{text}`"));
                    true
                }
                (Some(_) | None, Err(why)) => {
                    importer.missing(entity, &format!("`{name}` is left out: {why}"));
                    true
                }
            }
        };
        holds(self, "if", true) && holds(self, "unless", false)
    }

    /// Carries out actions, and adds the processes that they start to `steps`.
    pub(super) fn actions(&mut self, entities: &[Entity], steps: &mut Vec<Step>) -> Result<(), ImportError> {
        for entity in entities {
            self.count(entity, 1)?;
            if self.is_on(entity) {
                // A part that is skipped has its remark.
                self.action(entity, steps)?.unwrap_or_default();
            }
        }
        Ok(())
    }

    /// Counts the work for an action.
    pub(super) fn count(&mut self, entity: &Entity, actions: usize) -> Result<(), ImportError> {
        self.work.actions = self.work.actions.saturating_add(actions);
        if self.work.actions > ACTIONS_MAX {
            return Err(self.error(entity.place, format!("all files together have more than {ACTIONS_MAX} actions")));
        }
        if self.work.text.get() > TEXT_MAX {
            return Err(self.error(entity.place, format!("the substitutions make more than {TEXT_MAX} bytes of text")));
        }
        if self.programs.len() > PROGRAMS_MAX {
            return Err(self.error(entity.place, format!("all files together start more than {PROGRAMS_MAX} programs")));
        }
        Ok(())
    }

    fn action(&mut self, entity: &Entity, steps: &mut Vec<Step>) -> Result<Result<(), Skipped>, ImportError> {
        match entity.kind.as_str() {
            "group" => self.group(entity, steps).map(Ok),
            "timer" | "ros_timer" => self.timer(entity, steps),
            "include" => include::include(self, entity, steps),
            "node" | "lifecycle_node" | "node_container" | "executable" => {
                self.count(entity, entity.children.len())?;
                let program =
                    if entity.kind == "executable" { node::executable(self, entity) } else { node::node(self, entity) };
                Ok(program.map(|program| self.start(program, steps)))
            }
            "set_parameter" | "set_parameters_from_file" | "set_remap" | "set_use_sim_time" => self.setting(entity),
            _ => Ok(self.variable_action(entity)),
        }
    }

    /// Adds a program.
    pub(super) fn start(&mut self, program: Program, steps: &mut Vec<Step>) {
        self.programs.push(program);
        steps.push(Step::Run(self.programs.len() - 1));
    }

    /// Actions that change what later ones see.
    fn variable_action(&mut self, entity: &Entity) -> Result<(), Skipped> {
        match entity.kind.as_str() {
            "arg" => self.declare(entity),
            "let" => {
                let (name, value) = (self.needed(entity, "name")?, self.value(entity.get("value").unwrap_or_default()));
                self.scopes.top().variables.insert(name, value);
                Ok(())
            }
            "push_ros_namespace" => {
                let pushed = self.needed(entity, "namespace")?;
                let namespace = inside(self.scopes.namespace(), &pushed);
                self.scopes.top().namespace = Some(namespace);
                Ok(())
            }
            "set_env" | "unset_env" => {
                let name = self.needed(entity, "name")?;
                let value = if entity.kind == "set_env" { Some(self.needed(entity, "value")?) } else { None };
                if value.is_none() {
                    let why = format!(
                        "`{name}` is not set here, but its node can still pass it on: a spec cannot remove a variable"
                    );
                    self.missing(entity, &why);
                }
                self.scopes.top().environment.insert(name, value);
                Ok(())
            }
            "load_composable_node" => {
                let target = self.needed(entity, "target")?;
                component::into_target(self, entity, &target);
                Ok(())
            }
            other => Err(self.missing(entity, &format!("`{other}` has no counterpart"))),
        }
    }

    /// An argument has the value that it was given, or its default.
    fn declare(&mut self, entity: &Entity) -> Result<(), Skipped> {
        let name = self.needed(entity, "name")?;
        self.declared.insert(name.clone());
        let given = self.settings.arguments.get(&name).cloned();
        let known = self.scopes.variable(&name).cloned();
        let value = match (given, known, entity.get("default")) {
            // A value of an include stays.
            (_, Some(known), _) if !known.arguments.is_empty() || known.open.is_some() => return Ok(()),
            (Some(given), Some(known), _) if known.text == given => Value::plain(given),
            (_, Some(_), _) => return Ok(()),
            (Some(given), None, _) => Value::plain(given),
            (None, None, Some(default)) => self.value(default),
            // Its first use says that it has no value.
            (None, None, None) => return Ok(()),
        };
        let number = self.arguments.len();
        let argument = Argument {
            name: name.clone(),
            value: value.clone(),
            description: name::plain(entity.get("description").unwrap_or_default()),
            place: entity.place,
            file: self.file().to_owned(),
            is_settled: false,
            parameter: None,
        };
        self.arguments.push(argument);
        let is_plain = value.open.is_none() && value.arguments.is_empty();
        let mut value = Value { is_argument: is_plain, ..value };
        value.arguments.insert(number);
        self.scopes.top().variables.insert(name, value);
        Ok(())
    }

    fn group(&mut self, entity: &Entity, steps: &mut Vec<Step>) -> Result<(), ImportError> {
        let [is_scoped, is_forwarding] = ["scoped", "forwarding"].map(|name| self.truth(entity, name).unwrap_or(true));
        self.unread(entity, &["scoped", "forwarding"]);
        if is_scoped {
            self.scopes.enter(!is_forwarding);
        }
        self.actions(&entity.children, steps)?;
        if is_scoped {
            self.scopes.leave();
        }
        Ok(())
    }

    fn timer(&mut self, entity: &Entity, steps: &mut Vec<Step>) -> Result<Result<(), Skipped>, ImportError> {
        let period = match self.needed(entity, "period") {
            Ok(period) => period,
            Err(skipped) => return Ok(Err(skipped)),
        };
        let Some(milliseconds) = node::milliseconds(&period) else {
            return Ok(Err(self.missing(entity, &format!("`{period}` is not a number of seconds"))));
        };
        self.unread(entity, &["period"]);
        let mut inside = Vec::new();
        self.actions(&entity.children, &mut inside)?;
        match milliseconds {
            0 => steps.append(&mut inside),
            _ if inside.is_empty() => {}
            _ => steps.push(Step::After { milliseconds: milliseconds.max(10), steps: inside }),
        }
        Ok(Ok(()))
    }

    /// A setting of all later nodes of the group.
    fn setting(&mut self, entity: &Entity) -> Result<Result<(), Skipped>, ImportError> {
        let setting = match entity.kind.as_str() {
            "set_parameters_from_file" => self.needed(entity, "filename").map(Setting::File),
            "set_remap" => match (self.needed(entity, "from"), self.needed(entity, "to")) {
                (Ok(from), Ok(to)) => Ok(Setting::Remap { from, to }),
                (Err(skipped), _) | (_, Err(skipped)) => Err(skipped),
            },
            kind => {
                let name =
                    if kind == "set_parameter" { self.needed(entity, "name") } else { Ok("use_sim_time".into()) };
                let value = self.value(entity.get("value").unwrap_or_default());
                name.map(|name| Setting::Parameter { name, value, kind: None })
            }
        };
        let frame = self.scopes.top();
        if frame.settings.len() >= SETTINGS_MAX {
            return Err(self.error(entity.place, format!("a group has more than {SETTINGS_MAX} settings of all nodes")));
        }
        Ok(setting.map(|setting| self.scopes.top().settings.push(setting)))
    }
}

impl Names for Importer<'_> {
    fn variable(&self, name: &str) -> Option<Value> {
        self.scopes.variable(name).cloned()
    }

    fn share(&self, package: &str) -> Option<String> {
        (self.files.share)(package)
    }

    fn file(&self) -> &str {
        Importer::file(self)
    }
}
