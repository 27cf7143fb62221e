//! `dca add` and `dca remove`: add a program to a running deployment, or remove a process from it.
//!
//! The new instance is written as in a spec, and checked as a separate spec. This spec also has stand-ins for the
//! programs that the new instance is connected to. So the usual rules check ports, types and arguments.

use crate::change::{Probation, change, meant, revision};
use crate::client::Clients;
use crate::complete;
use crate::io::named_file;
use crate::logic::process_name::{DeploymentName, ProcessName};
use crate::stop::{Located, locate};
use crate::{ConnectArgs, Controllers, check};
use anyhow::anyhow;
use clap_complete::ArgValueCompleter;
use language::plan::{Constant, Failing, Leaf, Plan, difference};
use language::{Code, Options, Source, compile, render, without_groups};
use node::console::{self, Failure, block_on};
use node::logic::protocol::{Deployment, Revision};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The arguments of `dca add`.
#[derive(Debug, clap::Args)]
pub struct AddArguments {
    /// The deployment: NAME, or NAME@NUMBER for one run of it
    #[arg(value_parser = DeploymentName::parse, add = ArgValueCompleter::new(complete::deployments))]
    name: DeploymentName,
    /// The new program as in a spec: `logger instof Logger("c1", period = 1 s)`
    instance: String,
    /// A connection between it and a program of its group, as in a spec: `sensor, Out -> logger, In`; may be given more than once
    #[arg(long = "connect", value_name = "CONNECTION")]
    connections: Vec<String>,
    /// The group that the new process joins
    #[arg(long = "in", value_name = "GROUP", default_value = "main")]
    group: String,
    /// Let the group continue when the new process fails
    #[arg(long)]
    optional: bool,
    /// The spec that the deployment was made from, or another file, whose types and constants the new program can use
    #[arg(long, value_name = "FILE")]
    spec: Option<PathBuf>,
    #[command(flatten)]
    probation: Probation,
    #[command(flatten)]
    controllers: Controllers,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// The arguments of `dca remove`.
#[derive(Debug, clap::Args)]
pub struct RemoveArguments {
    /// The deployment: NAME, or NAME@NUMBER for one run of it
    #[arg(value_parser = DeploymentName::parse, add = ArgValueCompleter::new(complete::deployments))]
    name: DeploymentName,
    /// The process that is taken away, with all that is below it: its path, or the end of it
    #[arg(value_parser = ProcessName::parse_one, add = ArgValueCompleter::new(complete::processes))]
    process: ProcessName,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// Runs `dca add`.
pub(crate) fn add(arguments: &AddArguments) -> Result<(), Failure> {
    changed(&arguments.name, &arguments.connect, arguments.probation, |_, running| {
        let name = name_of(&arguments.instance);
        let piece = piece(arguments, name, running)?;
        let failing = if arguments.optional { Failing::IsIgnored } else { Failing::Counts };
        running.with_program(&piece, name, &arguments.group, failing).map_err(|why| anyhow!(why).into())
    })
}

/// Runs `dca remove`.
pub(crate) fn remove(arguments: &RemoveArguments) -> Result<(), Failure> {
    changed(&arguments.name, &arguments.connect, Probation::none(), |deployment, running| {
        let live = running.live_groups();
        let groups = live.iter().filter_map(|number| running.groups.get(*number as usize)).map(|group| &group.path);
        let path = meant(running, groups, deployment, &arguments.process).map_err(|why| anyhow!(why))?;
        running.without_process(&path).map_err(|why| anyhow!(why).into())
    })
}

/// Changes the running deployment to a changed plan.
fn changed(
    name: &DeploymentName,
    connect: &ConnectArgs,
    probation: Probation,
    wanted: impl Fn(&Deployment, &Plan) -> Result<Plan, Failure>,
) -> Result<(), Failure> {
    block_on(async {
        let clients = Clients::open(connect).await?;
        let work = async {
            let Located { client, deployment, home } = locate(clients.statuses().await?, name).await?;
            let found: Option<Revision> = revision(client, &home, &deployment.name).await?;
            let running = found.ok_or_else(|| anyhow!("`{}` does not run any more", deployment.name))?;
            let plan = wanted(&deployment, &running.plan)?;
            let found = difference(&running.plan, &plan).map_err(|obstacles| anyhow!(obstacles.join("; ")))?;
            found.changes.iter().for_each(|change| console::note(&change.to_string()));
            change(client, &home, running, plan, Vec::new(), probation).await
        };
        let done = work.await;
        clients.close().await;
        done
    })
}

/// Compiles the spec of the new program, and reports mistakes in it.
fn piece(arguments: &AddArguments, name: &str, running: &Plan) -> Result<Plan, Failure> {
    // The arguments of stand-ins matter only if their types have no defaults.
    let (bare, with_arguments) = (text(arguments, name, running, false), text(arguments, name, running, true));
    // The path of the deployment's spec means the running spec: its types are used, and not the types of the present file.
    let is_spec = |path: &str| arguments.spec.as_ref().is_some_and(|spec| named_file::are_same(spec, Path::new(path)));
    let types_of = |path: &str, text| if is_spec(path) { without_groups(&Source::new(path, text)).text } else { text };
    let others = check::others_with(&Source::new("<dca add>", bare.as_str()), &arguments.controllers, &types_of)?;
    // The change is made to a running mission. So names must be exact, and the compiler guesses nothing.
    let options = Options { deny_lenient_names: true, ..Options::named(running.name.as_str()) };
    let compiled = |text: &str| compile(&Source::new("<dca add>", text), &others, &options);
    let first = compiled(&bare);
    let (shown, compiled) =
        if first.plan.is_some() { (bare, first) } else { (with_arguments.clone(), compiled(&with_arguments)) };
    let hint = if arguments.spec.is_none() { "; `--spec FILE` adds the types that a spec declares" } else { "" };
    let Some(plan) = compiled.plan else {
        let source = Source::new("<dca add>", shown.as_str());
        console::note(&render(&compiled.diagnostics, &source, &others, check::style()));
        console::note(&format!("the added program or connection is wrong{hint}"));
        return Err(Failure::Reported);
    };
    let own = plan.leaves.iter().find(|leaf| leaf.path == format!("main/{name}"));
    let mut unknown = compiled.diagnostics.iter().filter(|found| found.code == Code::W0205);
    let is_own = |message: &str| own.is_some_and(|leaf| message.contains(&format!("`{}`", leaf.module)));
    if let Some(found) = unknown.find(|found| is_own(&found.message)) {
        console::note(&format!("warning: {}{hint}", found.message));
    }
    Ok(plan)
}

/// Returns the spec of the new program and its connections.
fn text(arguments: &AddArguments, name: &str, running: &Plan, has_arguments: bool) -> String {
    let live = running.live_leaves();
    let leaves = live.iter().filter_map(|number| running.leaves.get(*number as usize));
    let of_group = |leaf: &Leaf| Some(leaf.path.strip_prefix(&arguments.group)?.strip_prefix('/')?.to_owned());
    let ends: BTreeSet<&str> = arguments.connections.iter().flat_map(|one| one.split("->")).map(name_of).collect();
    let stands = leaves
        .filter_map(|leaf| Some((of_group(leaf)?, leaf)))
        .filter(|(other, _)| other != name && ends.contains(other.as_str()));
    let (mut instances, mut actions) = (arguments.instance.trim().trim_end_matches(';').to_owned(), String::new());
    for (stand_in, leaf) in stands {
        let host = running.hosts.get(leaf.host as usize).map_or("", String::as_str);
        let given = leaf.arguments.iter().filter(|_| has_arguments).map(|argument| {
            let name = argument.name.as_ref().map(|name| format!("{name} = ")).unwrap_or_default();
            format!(", {name}{}", spelled(&argument.value))
        });
        let given: String = given.collect();
        instances.push_str(&format!(";\n        {stand_in} instof {}({}{given})", leaf.module, quoted(host)));
        actions.push_str(&format!(" , {stand_in}"));
    }
    let connections: Vec<&str> = arguments.connections.iter().map(|one| one.trim().trim_end_matches(';')).collect();
    let (section, label) = if connections.is_empty() {
        (String::new(), String::new())
    } else {
        (format!("    internal_connections({name}, added) {{ {}; }}\n", connections.join("; ")), "[added]".to_owned())
    };
    let home = quoted(running.home().unwrap_or_default());
    let uses = arguments.spec.as_ref().map(|spec| format!("use {};\n", quoted(&spec.display().to_string())));
    let uses = uses.unwrap_or_default();
    format!(
        "{uses}process main() {{\n    host {{ {home} }}\n    instantiated_processes {{\n        {instances};\n    }}\n{section}    \
         internal_event_actions {{ {name}{label}{actions} }}\n}}\n"
    )
}

/// Returns the name at the beginning of a text.
fn name_of(text: &str) -> &str {
    let text = text.trim_start();
    let end = text.find(|letter: char| !letter.is_alphanumeric() && letter != '_').unwrap_or(text.len());
    &text[..end]
}

/// Returns a text as a string of the language.
fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""))
}

fn spelled(constant: &Constant) -> String {
    match constant {
        Constant::Text(text) => quoted(text),
        Constant::Number(number) => number.to_string(),
        Constant::Truth(truth) => truth.to_string(),
        Constant::Secret(key) => format!("secret({})", quoted(key)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        add: AddArguments,
    }

    const SPEC: &str = "
module Source(host, rate: Number) { out Out: Number; service; }
module Sink(host, way: Text = good) { in In: Number; done; }
process Pair(here) {
    instantiated_processes { a instof Source(here, 5); b instof Sink(here); }
    internal_event_actions { a , b }
}
process main() { host { \"c1\" } instantiated_processes { pair instof Pair(\"c1\"); } internal_event_actions { pair } }
";

    #[test]
    fn what_is_added_is_a_spec_with_what_it_is_connected_to() {
        let plan = compile(&Source::new("spec", SPEC), &[], &Options::named("spec")).plan.unwrap();
        let line = [
            "dca",
            "spec",
            "d instof Sink(\"c1\", way = best);",
            "--in",
            "main/pair",
            "--connect",
            "a, Out -> d, In latch",
        ];
        let arguments = Line::try_parse_from(line).unwrap().add;
        let text = text(&arguments, "d", &plan, true);
        let (modules, _) = SPEC.split_at(SPEC.find("process Pair").unwrap());
        let others = [Source::new("modules", modules)];
        let compiled = compile(&Source::new("<dca add>", text.as_str()), &others, &Options::named("spec"));
        let piece = compiled.plan.unwrap_or_else(|| panic!("{text}\n{:#?}", compiled.diagnostics));
        let wanted = plan.with_program(&piece, "d", "main/pair", Failing::Counts).unwrap();
        let changes = difference(&plan, &wanted).unwrap().changes;
        let lines: Vec<String> = changes.iter().map(ToString::to_string).collect();
        let expected = [
            "add        main/pair/d: Sink on `c1`",
            "act        main/pair: its event actions",
            "connect    main/pair/a, Out -> main/pair/d, In latch",
        ];
        assert_eq!(lines, expected);
        assert_eq!(name_of("  hit_2, Out"), "hit_2");
    }
}
