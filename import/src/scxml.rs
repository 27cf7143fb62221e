//! Imports SCXML state charts as activities.
//!
//! An event from outside becomes a message, with a port for each event name. An event that the chart raises becomes a
//! signal. Data become finite variables with integers, truth values or names. A state that invokes something runs a
//! process.

mod action;
mod event;
mod expression;
mod model;
mod state;
mod timer;
mod transition;

use crate::Imported;
use crate::name::{Names, duration, pascal, plain};
use crate::remark::{Remark, RemarkKind};
use crate::xml::{ImportError, Node};
use model::{Kind, Model};
use timer::Clock;

/// A chart while its text is written.
#[derive(Debug)]
pub(super) struct Writer<'a> {
    model: Model<'a>,
    remarks: Vec<Remark>,
    /// The instances that states run, with their modules.
    runs: Vec<Run>,
    module_names: Names,
    instance_names: Names,
    /// The ports for events that leave the chart, by target.
    outputs: Vec<(String, String)>,
    output_names: Names,
}

/// An instance that a state runs.
#[derive(Clone, Debug)]
struct Run {
    instance: String,
    module: String,
    description: String,
}

impl Writer<'_> {
    /// Notes that a part means something else, or is missing, and returns the comment.
    fn remark(&mut self, node: Node<'_>, kind: RemarkKind, text: impl AsRef<str>) -> String {
        let remark = Remark::new(self.model.file, node, kind, text);
        let comment = remark.comment();
        self.remarks.push(remark);
        comment
    }

    /// The port of events to a target.
    fn output(&mut self, target: &str) -> String {
        if let Some((_, port)) = self.outputs.iter().find(|(known, _)| known == target) {
            return port.clone();
        }
        let port = self.output_names.take(&crate::name::snake(target.trim_start_matches(['#', '_'])));
        self.outputs.push((target.into(), port.clone()));
        port
    }
}

/// Makes a spec of a chart.
pub(crate) fn import(file: &language::Source, root: Node<'_>) -> Result<Imported, ImportError> {
    let model = Model::read(&file.name, root)?;
    let mut writer = Writer {
        model,
        remarks: Vec::new(),
        runs: Vec::new(),
        module_names: Names::default(),
        instance_names: Names::default(),
        outputs: Vec::new(),
        output_names: Names::default(),
    };
    let title = writer.module_names.take(&pascal(root.attribute("name").unwrap_or("Chart")));
    let head = top(&mut writer, root);
    let states = state::inside(&mut writer, root)?;
    let states = with_clocks(&mut writer, states) + &event::dummies(&writer.model);
    let declared = declarations(&mut writer, root);
    let (modules, instances) = runs(&writer);
    let description = plain(root.attribute("name").unwrap_or(&file.name));
    let instance = Names::default().take(&crate::name::snake(&title));
    let text = format!(
        "{head}{modules}\n/// The chart `{description}`.\nactivity {title}(robot: Host){{ host{{robot}}\n{declared}{instances}\
         {states}}}\n\nprocess main(robot: Host = c1){{ host{{robot}} instantiated_processes{{ {instance} instof \
         {title}(robot); }} internal_event_actions{{ {instance} }} }}\n"
    );
    let names = writer.model.states.iter().map(|(id, state)| ((*id).to_owned(), state.name.clone())).collect();
    let events = writer.model.events.iter();
    let ports = events.filter_map(|(event, known)| Some((event.clone(), known.port.clone()?))).collect();
    Ok(Imported { text, remarks: writer.remarks, states: names, ports })
}

/// The states, beside a region for each delayed event that is not a timer of one state.
fn with_clocks(writer: &mut Writer<'_>, states: String) -> String {
    if writer.model.clocks.is_empty() {
        return states;
    }
    let (names, clocks) = (&mut writer.model.state_names, &writer.model.clocks);
    let (whole, chart) = (names.take("chart_and_timers"), names.take("chart"));
    let mut text = format!("initial parallel state {whole} {{\nstate {chart} {{\n{states}on complete -> done;\n}}\n");
    for (key, Clock { start, cancel }) in clocks {
        let around = names.take(start);
        let (idle, wait) = (names.take(&format!("{start}_idle")), names.take(&format!("{start}_wait")));
        let signal = writer.model.events.get(&key.event).and_then(|known| known.signal.clone()).unwrap_or_default();
        let begin = format!("on always when {start} -> {wait} {{ {start} = false; }}\n");
        let forgotten = cancel
            .as_ref()
            .map_or_else(String::new, |cancel| format!("on always when {cancel} {{ {cancel} = false; }}\n"));
        let cancelled = cancel
            .as_ref()
            .map_or_else(String::new, |cancel| format!("on always when {cancel} -> {idle} {{ {cancel} = false; }}\n"));
        text += &format!(
            "state {around} {{\ninitial state {idle} {{ {begin}{forgotten} }}\nstate {wait} {{\n\
             on after {} -> {idle} {{ raise {signal}; }}\n{begin}{cancelled}}}\n}}\n",
            duration(key.time)
        );
    }
    text + "}\n"
}

/// Remarks on the whole chart.
fn top(writer: &mut Writer<'_>, root: Node<'_>) -> String {
    let mut text = String::new();
    let comments = root.document().root().children().filter(roxmltree::Node::is_comment);
    for comment in comments.collect::<Vec<_>>() {
        text += &state::comment(comment);
    }
    if root.attribute("binding") == Some("late") {
        text += &writer.remark(
            root,
            RemarkKind::Differs,
            "data get their first values at the start, not at the entry of their state",
        );
    }
    text
}

/// A remark that longer names of events have no ports of their own.
fn longer_names(writer: &mut Writer<'_>, root: Node<'_>) -> String {
    let first = writer.model.events.iter().find_map(|(event, known)| {
        let port = known.port.clone().filter(|_| event != "*")?;
        Some((plain(event), port))
    });
    let Some((event, port)) = first else { return String::new() };
    let why = format!(
        "a transition for `{event}` also takes longer names, such as `{event}.x`; here, send such an event to the port `{port}`"
    );
    writer.remark(root, RemarkKind::Differs, why)
}

/// The ports and the variables.
fn declarations(writer: &mut Writer<'_>, root: Node<'_>) -> String {
    let mut text = longer_names(writer, root);
    for (event, known) in &writer.model.events {
        if let Some(port) = &known.port {
            let origin = match event.as_str() {
                "*" => " // any other event".to_owned(),
                _ if port == event => String::new(),
                _ => format!(" // the event `{}`", plain(event)),
            };
            text += &format!("in {port}: Text;{origin}\n");
        }
    }
    for Clock { start, cancel } in writer.model.clocks.values() {
        for variable in std::iter::once(start).chain(cancel) {
            text += &format!("var {variable}: bool = false;\n");
        }
    }
    for variable in writer.model.told.values() {
        text += &format!("var {variable}: bool = false;\n");
    }
    for (_, port) in &writer.outputs {
        text += &format!("out {port}: Text;\n");
    }
    let variables: Vec<_> = writer.model.variables.iter().map(|(id, variable)| (*id, variable.clone())).collect();
    for (id, variable) in variables {
        let name = &variable.name;
        match &variable.kind {
            Kind::Number(first) => {
                let why = format!("`{name}` needs a range here; make it as narrow as the chart needs");
                text += &writer.remark(variable.node, RemarkKind::Differs, why);
                text += &format!("var {name}: -1_000_000..1_000_000 = {first};\n");
            }
            Kind::Truth(first) => {
                text += &format!("var {name}: bool = {first};\n");
            }
            Kind::Named { values, first } => {
                let names: Vec<&str> = values.iter().map(|(_, name)| name.as_str()).collect();
                let first = values.iter().find(|(value, _)| value == first).map_or("", |(_, name)| name);
                text += &format!("var {name}: {} = {first};\n", names.join(" | "));
            }
            Kind::Unknown => {
                let why = format!("`{}` is left out: its value is not an integer, a truth value or a name", plain(id));
                text += &writer.remark(variable.node, RemarkKind::Missing, why);
            }
        }
    }
    text
}

/// The modules that states run, and their instances.
fn runs(writer: &Writer<'_>) -> (String, String) {
    let (mut modules, mut instances) = (String::new(), String::new());
    for Run { instance, module, description } in &writer.runs {
        modules += &format!("\n/// {description}\nmodule {module}(host: Host) {{ done; }}\n");
        instances += &format!("{instance} instof {module}(robot);\n");
    }
    (modules, instances)
}
