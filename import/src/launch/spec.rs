//! The text of the spec.

use super::program::{Component, Ends, Program, Record};
use super::walk::{Importer, Step};
use crate::Imported;
use crate::name::{duration, plain};
use crate::remark::Remark;
use std::collections::BTreeMap;

/// Returns the spec of the programs that were found.
pub(super) fn imported(importer: Importer<'_>, file: &str, steps: &[Step]) -> Imported {
    let comment = |remark: &Remark| match remark.file == file {
        true => remark.comment(),
        false => format!("// import: `{}`, line {}: {}\n", plain(&remark.file), remark.line, remark.text),
    };
    let mut text = String::new();
    for (number, remark) in importer.remarks.iter().enumerate() {
        let is_of_program = importer.programs.iter().any(|program| program.remarks.contains(&number));
        if !is_of_program {
            text += &comment(remark);
        }
    }
    text += &importer.settled.iter().map(comment).collect::<String>();
    for program in &importer.programs {
        let comments: String = importer.remarks[program.remarks.clone()].iter().map(comment).collect();
        text += &format!("\n{comments}{}", module(program));
    }
    text += &main(&importer, file, steps);
    let remarks = importer.remarks.into_iter().chain(importer.settled).collect();
    Imported { text, remarks, states: BTreeMap::new(), ports: BTreeMap::new() }
}

fn module(program: &Program) -> String {
    let Program { module, description, items, parameters, ends, .. } = program;
    let declared = parameters.iter().map(|parameter| parameter.value.declared(&parameter.name));
    let declared = declared.chain(records(program).map(|record| record.declared.clone()));
    let parameters: String = declared.map(|declared| format!(", {declared}")).collect();
    let components: Vec<&str> = components(program).map(|component| component.text.as_str()).collect();
    let end = match ends {
        _ if !components.is_empty() => &format!("components{{\n{}\n}}\n", components.join("\n")),
        Ends::Done => "done;\n",
        Ends::Service => "service;\n",
        Ends::Lifecycle => "",
    };
    format!("/// {description}\nmodule {module}(host: Host{parameters}) {{\n{}\n{end}}}\n", items.join("\n"))
}

/// Returns the components of a program.
fn components(program: &Program) -> impl Iterator<Item = &Component> {
    program.container.iter().flat_map(|container| &container.components)
}

/// Returns the parameters of the components of a program.
fn records(program: &Program) -> impl Iterator<Item = &Record> {
    components(program).filter_map(|component| component.record.as_ref())
}

fn main(importer: &Importer<'_>, file: &str, steps: &[Step]) -> String {
    let mut text = format!("\n/// The launch file `{}`.\n", plain(file));
    let mut parameters = String::new();
    for argument in &importer.arguments {
        let Some((name, literal)) = &argument.parameter else { continue };
        parameters += &format!(", {}", literal.declared(name));
        if !argument.description.is_empty() {
            text += &format!("///\n/// `{name}`: {}\n", argument.description);
        }
    }
    text += &format!("process main(robot: Host = c1{parameters}){{ host{{robot}}\n");
    if !importer.programs.is_empty() {
        text += "instantiated_processes{\n";
        for program in &importer.programs {
            let Program { module, instance, parameters, policies, .. } = program;
            let given = parameters.iter().filter_map(|parameter| {
                parameter.given.as_ref().map(|given| format!(", {} = {given}", parameter.name))
            });
            let given =
                given.chain(records(program).filter_map(|record| Some(format!(", {}", record.given.as_ref()?))));
            let policies = if policies.is_empty() { ";".into() } else { format!("{{ {} }}", policies.join(" ")) };
            text += &format!("{instance} instof {module}(robot{}){policies}\n", given.collect::<String>());
        }
        text += "}\n";
    }
    format!("{text}internal_event_actions{{ {} }} }}\n", expression(importer, steps))
}

/// All of it starts at once, except what waits.
fn expression(importer: &Importer<'_>, steps: &[Step]) -> String {
    let one = |step: &Step| match step {
        Step::Run(number) => importer.programs[*number].instance.clone(),
        Step::After { milliseconds, steps } => {
            format!("(wait({}) ; ({}))", duration(*milliseconds), expression(importer, steps))
        }
    };
    if steps.is_empty() { "skip".into() } else { steps.iter().map(one).collect::<Vec<_>>().join(", ") }
}
