//! The checked spec, between tree and plan: declarations, names resolved inside each group, every span.

mod expr;
mod kind;

use super::range::Range;
use super::ros_name::NameText;
use crate::plan::{Backoff, Constant, Environment, LeafKind, OnBoot, Policy, Quality, Supervision, Transfer};
use crate::source::Span;
use crate::syntax::ast::Name;
use crate::unit::Dimension;
use ros::logic::qos::Qos;
use ros::logic::route::Way;
use std::collections::BTreeMap;
use std::time::Duration;

pub(crate) use expr::{
    Arm, CatchArm, ChartModel, Expr, ExprKind, Path, Readable, ReadableValue, ScriptModel, StartValue, are_parallel,
};
pub(crate) use kind::{FIELDS_MAX, Kind, NamedType, Shape, TypeMatch};

/// Everything that is declared in a spec and in the interfaces.
#[derive(Debug, Default)]
pub(crate) struct Spec {
    pub(crate) processes: Vec<Process>,
    pub(crate) modules: Vec<Module>,
    pub(crate) process_names: BTreeMap<String, usize>,
    /// The process of an instance, by process and slot, where the arguments decide how its text is read.
    pub(crate) specializations: BTreeMap<(usize, usize), usize>,
    pub(crate) module_names: BTreeMap<String, usize>,
    pub(crate) consts: Consts,
    pub(crate) types: Vec<NamedType>,
    /// The indices of the sound types, by name: each text may have one.
    pub(crate) type_names: BTreeMap<String, Vec<usize>>,
    /// The declaration of the field that each name in a record means, by the spans of both; known after `types`.
    pub(crate) field_uses: Vec<(Span, Span)>,
}

/// The named constants of a file and of the files it uses.
pub(crate) type Consts = BTreeMap<String, Const>;

/// A named constant.
#[derive(Clone, Debug)]
pub(crate) struct Const {
    pub(crate) name: Name,
    /// One value, or the elements of a list.
    pub(crate) values: Vec<Value>,
    pub(crate) is_list: bool,
    /// Whether it is a parameter of a group. Its value is the value of the argument.
    pub(crate) is_param: bool,
}

impl Const {
    /// Whether it could not be read.
    pub(crate) fn is_broken(&self) -> bool {
        self.values.iter().any(|value| matches!(value.kind, ValueKind::Broken))
    }
}

/// The meanings of a name in the place of a value.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scope<'a> {
    /// The parameters of the enclosing process.
    pub(crate) params: &'a [Param],
    pub(crate) consts: &'a Consts,
    pub(crate) indices: &'a [Binding],
}

/// An index variable and its value.
pub(crate) type Binding = (String, usize);

/// A process group.
// Wide: its fields are the statements of a `process` block.
#[derive(Debug)]
pub(crate) struct Process {
    pub(crate) name: Name,
    /// The text of its doc comments.
    pub(crate) doc: String,
    pub(crate) params: Vec<Param>,
    pub(crate) host: Option<Value>,
    pub(crate) instances: Vec<Instance>,
    pub(crate) exports: Vec<Export>,
    pub(crate) sets: Vec<Set>,
    /// Its connections with the database and with ROS 2.
    pub(crate) outside: Outside,
    /// The resources that `using` may take.
    pub(crate) resources: Vec<Name>,
    /// The strategy for its programs when one of them dies; none if it is not given.
    pub(crate) supervision: Option<Supervision>,
    /// How long its programs without their own back-off stay away.
    pub(crate) backoff: Option<Backoff>,
    /// The effect of a reboot, and the place of the statement.
    pub(crate) on_boot: Option<(OnBoot, Span)>,
    /// Nothing if there is no such section, or if the section is empty.
    pub(crate) actions: Option<Expr>,
    pub(crate) damage: Damage,
    /// Whether no fault-free run of it ends; known after `flow`.
    pub(crate) is_service: bool,
    /// Its shape parameters without a value: the group is never instantiated, and they have no default.
    pub(crate) open: Vec<Name>,
}

impl Spec {
    /// The normal ends with names of each module and activity.
    pub(crate) fn outcomes(&self) -> impl Iterator<Item = (&Name, &[Outcome])> {
        let modules = self.modules.iter().map(|module| (&module.name, module.outcomes.as_slice()));
        let charts = self.processes.iter().filter_map(|process| Some((&process.name, process.chart()?)));
        modules.chain(charts.map(|(name, chart)| (name, chart.outcomes.as_slice())))
    }

    /// The normal ends with names of the type of an instance.
    pub(crate) fn outcomes_of(&self, target: Target) -> &[Outcome] {
        match target {
            Target::Module(module) => &self.modules[module].outcomes,
            Target::Process(process) => self.processes[process].chart().map_or(&[], |chart| &chart.outcomes),
            Target::Unknown => &[],
        }
    }
}

impl Process {
    /// Its states, if it is an activity.
    pub(crate) fn chart(&self) -> Option<&ChartModel> {
        if let ExprKind::Chart(model) = &self.actions.as_ref()?.kind { Some(model) } else { None }
    }

    /// Its port for messages of this name, if it is an activity.
    pub(crate) fn message_port(&self, name: &str) -> Option<&Port> {
        self.chart()?.ports.iter().find(|port| port.name.text == name)
    }
}

/// The parts of a process that could not be read whole. Errors that follow from them are not reported.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Damage {
    pub(crate) header: bool,
    pub(crate) instances: bool,
    pub(crate) external: bool,
    pub(crate) connections: bool,
    pub(crate) actions: bool,
    /// An event action names a process that does not exist.
    pub(crate) names: bool,
}

/// A parameter of a process or of a module, or a field of a record.
#[derive(Clone, Debug)]
pub(crate) struct Param {
    pub(crate) name: Name,
    pub(crate) kind: Option<Kind>,
    /// The range of its values; for a list, of its elements.
    pub(crate) range: Option<Range>,
    /// Names no parameter.
    pub(crate) default: Option<Value>,
}

/// The policies of an instance, and their places.
#[derive(Clone, Debug, Default)]
pub(crate) struct Policies {
    pub(crate) policy: Policy,
    /// All of them, with their braces.
    pub(crate) span: Option<Span>,
    /// The word behind `restart`.
    pub(crate) restart: Option<Span>,
    /// The word `overlap` behind `replace`.
    pub(crate) overlap: Option<Span>,
    /// The statement of its back-off.
    pub(crate) backoff: Option<Span>,
    /// The deployment that it belongs to, where that is another one.
    pub(crate) runs_in: Option<RunsIn>,
}

/// The deployment that an instance belongs to.
#[derive(Clone, Debug)]
pub(crate) struct RunsIn {
    pub(crate) deployment: String,
    /// The absolute path of the process there. The default is the process with the same name in `main`.
    pub(crate) path: Option<String>,
    pub(crate) span: Span,
    /// Whether it has no other policies.
    pub(crate) is_alone: bool,
}

/// An instance in a group.
#[derive(Clone, Debug)]
pub(crate) struct Instance {
    pub(crate) name: Name,
    /// The type as written; nothing when it could not be read.
    pub(crate) kind: Option<Name>,
    /// The declaration of its type; known after `types`.
    pub(crate) target: Target,
    pub(crate) args: Vec<Arg>,
    pub(crate) args_span: Span,
    /// Its limits, and the policies for its failures.
    pub(crate) policies: Policies,
    /// Whether an event action runs it.
    pub(crate) is_run: bool,
}

/// The type of an instance.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Target {
    /// Index into [`Spec::processes`].
    Process(usize),
    /// Index into [`Spec::modules`].
    Module(usize),
    /// A module type without an interface.
    Unknown,
}

#[derive(Clone, Debug)]
pub(crate) struct Arg {
    pub(crate) name: Option<Name>,
    pub(crate) value: Value,
}

#[derive(Clone, Debug)]
pub(crate) struct Value {
    pub(crate) span: Span,
    pub(crate) kind: ValueKind,
    /// The dimension of its values, when it has a unit.
    pub(crate) dimension: Option<Dimension>,
}

impl Value {
    /// The number of fields and elements, including the fields of the records inside.
    pub(crate) fn fields(&self) -> usize {
        match &self.kind {
            ValueKind::Record(fields) => fields.iter().map(|(_, value)| 1 + value.fields()).sum(),
            ValueKind::List(values) => values.iter().map(|value| 1 + value.fields()).sum(),
            ValueKind::Constant(_) | ValueKind::Param(_) | ValueKind::Broken => 0,
        }
    }
}

#[derive(Clone, Debug)]
pub(crate) enum ValueKind {
    Constant(Constant),
    /// Each field once.
    Record(Vec<(Name, Value)>),
    /// No lists in it.
    List(Vec<Value>),
    /// Index into the parameters of the enclosing process.
    Param(usize),
    /// Could not be read.
    Broken,
}

/// An external port of a group.
#[derive(Debug)]
pub(crate) struct Export {
    pub(crate) name: Name,
    pub(crate) endpoint: Endpoint,
}

/// A port of an instance of the group.
#[derive(Clone, Debug)]
pub(crate) struct Endpoint {
    pub(crate) slot: usize,
    pub(crate) port: Name,
}

/// A connection of a port with keys of the database.
#[derive(Clone, Debug)]
pub(crate) struct KeyConnection {
    pub(crate) endpoint: Endpoint,
    /// A key, or a prefix that ends in `/`.
    pub(crate) keys: String,
    /// Whether the process writes them.
    pub(crate) is_write: bool,
    pub(crate) span: Span,
}

/// The connections of a process with the database and with ROS 2.
#[derive(Clone, Debug, Default)]
pub(crate) struct Outside {
    /// With keys of the database.
    pub(crate) keys: Vec<KeyConnection>,
    /// With topics of ROS 2.
    pub(crate) topics: Vec<TopicConnection>,
}

/// A connection of a port with a topic of ROS 2.
#[derive(Clone, Debug)]
pub(crate) struct TopicConnection {
    pub(crate) endpoint: Endpoint,
    pub(crate) name: NameText,
    pub(crate) qos: Qos,
    /// The prefix of the frames of the robot in ROS 2.
    pub(crate) frames: Option<NameText>,
    pub(crate) way: Way,
    pub(crate) span: Span,
}

/// A connection set: one label of one owner.
#[derive(Debug)]
pub(crate) struct Set {
    pub(crate) owner: Option<usize>,
    pub(crate) label: Option<Name>,
    pub(crate) connections: Vec<Connection>,
}

#[derive(Clone, Debug)]
pub(crate) struct Connection {
    pub(crate) from: Endpoint,
    pub(crate) to: Endpoint,
    pub(crate) transfer: Transfer,
    pub(crate) quality: Quality,
    pub(crate) span: Span,
}

/// The interface of a controller module.
// Wide: its fields are the statements of a `module` block.
#[derive(Debug)]
pub(crate) struct Module {
    pub(crate) name: Name,
    /// The text of its doc comments.
    pub(crate) doc: String,
    /// The place of its host parameter.
    pub(crate) host: Option<Span>,
    /// The parameters after the host; none when the interface does not list them.
    pub(crate) params: Option<Vec<Param>>,
    /// The value that it starts with.
    pub(crate) start: Option<Param>,
    pub(crate) ports: Vec<Port>,
    pub(crate) is_service: bool,
    /// Whether it declares a normal end.
    pub(crate) has_end: bool,
    /// Whether it keeps state from one calculation to the next, which a restarted program would lack.
    pub(crate) remembers: bool,
    /// Its normal ends, when it has several.
    pub(crate) outcomes: Vec<Outcome>,
    pub(crate) exec: Option<String>,
    /// Whether its interface comes from its program, which is in Python.
    pub(crate) is_asked: bool,
    pub(crate) environment: Environment,
    pub(crate) kind: LeafKind,
    pub(crate) times: Times,
    pub(crate) claims: Vec<Claim>,
    /// Whether its text could not be read whole, so that a missing port proves nothing.
    pub(crate) is_damaged: bool,
}

/// The times of a module.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Times {
    /// How long it may take to stop.
    pub(crate) stop_within: Duration,
    /// The shortest and the longest time from its start to its end, if declared.
    pub(crate) takes: Option<(Duration, Duration)>,
    /// How long its program may take until it can run, if that follows from the module.
    pub(crate) ready_within: Option<Duration>,
}

impl Module {
    /// Its parameters, then the value that it starts with.
    pub(crate) fn declared(&self) -> impl Iterator<Item = &Param> {
        self.params.iter().flatten().chain(&self.start)
    }
}

/// Something that only one process can write to at a time: a device of the host that the module runs on.
#[derive(Debug)]
pub(crate) struct Claim {
    pub(crate) name: Name,
    pub(crate) is_write: bool,
}

/// A normal end of a module.
#[derive(Debug)]
pub(crate) struct Outcome {
    pub(crate) name: Name,
    /// The type of the value that comes with it.
    pub(crate) kind: Option<Kind>,
}

#[derive(Debug)]
pub(crate) struct Port {
    pub(crate) name: Name,
    pub(crate) direction: Direction,
    /// The type of its values; for a procedure or state, the type of its result.
    pub(crate) kind: Option<Kind>,
    /// Whether the module works without it being connected.
    pub(crate) is_optional: bool,
    /// The type of its argument, if it is not a port of data.
    pub(crate) call: Option<Call>,
}

/// A procedure or a state, which comes in, or a call of one, which goes out.
#[derive(Debug)]
pub(crate) struct Call {
    pub(crate) role: CallRole,
    /// The type of the argument; nothing where there is none.
    pub(crate) argument: Option<Kind>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CallRole {
    /// `proc`
    Procedure,
    /// `state`
    State,
    /// `calls`
    Caller,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Direction {
    In,
    Out,
}
