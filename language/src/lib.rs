//! The `.dca` language: from text to plan, and the meaning of a plan. The crate is pure: it has no clock, no files and no network.
//!
//! A spec defines which processes run on which hosts, how their ports are connected, and in which order they run.
//! [`compile`] reads it, together with the interfaces that controller programs print. It returns a [`plan::Plan`] and all diagnostics of
//! the text. Each [`Diagnostic`] has a stable [`Code`], places, a reason, and a fix if one is likely. The plan is missing exactly when
//! there is an error. [`render`] makes the text with carets that a person reads, and [`apply_fixes`] makes the corrected spec.
//!
//! ```
//! use language::{Options, Source, Style, apply_fixes, compile, render};
//!
//! let spec = Source::new("blink.dca", "process main() {
//!     host{c1}
//!     instantiated_processes { lamp instof Lamp(c1); switch instof Switch(c1); }
//!     internal_connections(switch, on) { switch, Out -> lamp, In; }
//!     internal_event_actions { Lamp, switch[on] }
//! }");
//! let interfaces = [
//!     Source::new("lamp", "module Lamp { in In: Truth; service; }"),
//!     Source::new("switch", "module Switch { out Out: Truth; done; }"),
//! ];
//! let compiled = compile(&spec, &interfaces, &Options::named("blink"));
//! assert_eq!(compiled.plan.unwrap().wires.len(), 1);
//! // `Lamp` is the type: the instance is called `lamp`. A warning says so, and has the fix.
//! let text = render(&compiled.diagnostics, &spec, &interfaces, Style::Plain);
//! assert!(text.contains("W0201"));
//! assert!(apply_fixes(&spec.text, &compiled.diagnostics).contains("{ lamp, switch[on] }"));
//! ```
//!
//! A text is processed in three steps. [`syntax`] makes a lossless tree from any text. `check` resolves names, types, ports and hosts, and
//! lowers the result to a flat [`plan`]. [`algebra`] defines the behaviour of a plan, event by event.

pub mod algebra;
mod assignment;
pub mod automaton;
mod check;
mod diagnostic;
mod fix;
mod format;
mod gather;
mod graph;
mod host;
pub mod ide;
mod message;
pub mod plan;
pub mod script;
mod similar;
mod simulate;
pub mod sites;
mod source;
pub mod syntax;
mod unit;

pub use assignment::{Assignment, AssignmentError, assign};
pub use diagnostic::{Code, Diagnostic, Edit, Fix, Label, Severity, Style, apply_fix, apply_fixes, render};
pub use fix::fix;
pub use format::format;
pub use gather::{Content, gather, without_groups};
pub use graph::{Graph, NoPicture, activities_of_plan, graph, graph_of_activity, graph_of_plan, graph_states};
pub use host::host_name_problem;
pub use message::{AskedModule, FieldType, Layout, Message, RecordType};
pub use similar::nearest;
pub use simulate::{
    Ending, ProgramFault, RandomRun, ReplayError, Simulation, SimulationError, SimulationEvent, TraceError, TraceEvent,
    Transition,
};
pub use source::{Lines, Origin, Position, Role, SOURCE_MAX, Source, Span, Texts};

/// The options of a compilation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Options {
    /// The name of the deployment: the stem of the file's name, unless the user gave another name.
    pub name: String,
    /// Whether names that are not written exactly are errors.
    pub deny_lenient_names: bool,
}

impl Options {
    /// Returns the usual options for a deployment of that name.
    pub fn named(name: impl Into<String>) -> Self {
        Self { name: name.into(), deny_lenient_names: false }
    }
}

/// The result of a compilation.
#[derive(Clone, Debug, PartialEq)]
pub struct Compiled {
    /// The plan. It is missing exactly when there is an error.
    pub plan: Option<plan::Plan>,
    /// The diagnostics in the order of the text, at most 10,000. If there are more, warnings are left out before errors.
    pub diagnostics: Vec<Diagnostic>,
    /// The number of diagnostics that were left out.
    pub omitted: usize,
}

/// Returns the parameters of each module that interfaces declare, in the form for its program. Each field of a record is a parameter, such
/// as `grasp.force`. A module has none if this form is impossible, for example because of a list of any length.
pub fn parameters(interfaces: &[Source]) -> std::collections::BTreeMap<String, Option<Vec<plan::Parameter>>> {
    check::parameters(interfaces)
}

/// Returns whether a text is a number with a unit of the language: `20 N`, `0.2 m/s`.
pub fn is_quantity(text: &str) -> bool {
    matches!(unit::read(text), Ok((_, Some(_))))
}

/// Returns a value in SI units. The value is written as in a spec, `20 N` or `20`. Returns none if it is not of this type of quantities.
///
/// ```
/// assert_eq!(language::quantity("2 kN", "Force"), Some(2000.0));
/// assert_eq!(language::quantity("2 m", "Force"), None);
/// ```
pub fn quantity(text: &str, type_name: &str) -> Option<f64> {
    let (number, dimension) = unit::read(text).ok()?;
    let (of_type, _) = unit::of_type(type_name)?;
    dimension.is_none_or(|dimension| dimension == of_type).then_some(number)
}

/// Returns the modules of these texts that have Python programs and leave the interface to the program.
pub fn asked(sources: &[Source]) -> Vec<AskedModule> {
    check::asked(sources)
}

/// Returns the record types that these texts declare, in their order.
pub fn record_types(sources: &[Source]) -> Vec<RecordType> {
    check::record_types(sources)
}

/// Returns the message of each output of each module, if an interface declares it: by module, then by output.
pub fn messages(
    interfaces: &[Source],
) -> std::collections::BTreeMap<String, std::collections::BTreeMap<String, Message>> {
    check::messages(interfaces)
}

/// Returns the type of each port of each module as interfaces write it: by module, then by port.
pub fn port_types(
    interfaces: &[Source],
) -> std::collections::BTreeMap<String, std::collections::BTreeMap<String, String>> {
    check::port_types(interfaces)
}

/// Returns the procedures and states of each module, each with the types of its argument and result,
/// `proc Drive(Speed) -> Place`: by module, then by name.
pub fn exports(
    interfaces: &[Source],
) -> std::collections::BTreeMap<String, std::collections::BTreeMap<String, String>> {
    check::exports(interfaces)
}

/// Compiles a spec for a verifier. In addition to the result of [`compile`], returns the place of each part in the text, and the properties
/// to prove. The sites are missing exactly when the plan is missing.
pub fn compile_with_sites(spec: &Source, interfaces: &[Source], options: &Options) -> (Compiled, Option<sites::Sites>) {
    check::compile_with_sites(spec, interfaces, options)
}

/// Compiles a spec. `interfaces` are texts with `module` blocks, as controller programs print them.
pub fn compile(spec: &Source, interfaces: &[Source], options: &Options) -> Compiled {
    let (compiled, _, _) = check::compile_with_model(spec, interfaces, options);
    compiled
}
