//! `dca graph`: draws a spec.

use crate::io::{named_file, whole_file};
use crate::{Controllers, Values, check};
use anyhow::{Context as _, anyhow};
use language::{Severity, render};
use node::console::{self, Failure};
use std::path::PathBuf;

/// The arguments of `dca graph`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The spec
    file: PathBuf,
    /// Where the picture goes [default: standard output]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Draw the states of this activity: its type, or its path or the end of it
    #[arg(long, value_name = "ACTIVITY")]
    states: Option<String>,
    /// Print it for Graphviz instead of SVG
    #[arg(long)]
    dot: bool,
    #[command(flatten)]
    controllers: Controllers,
    #[command(flatten)]
    values: Values,
}

/// Runs the verb. Of the diagnostics of the spec, only errors are printed.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    if let Some(output) = &arguments.output {
        named_file::not_over(output, [arguments.file.as_path()])?;
    }
    let spec = check::read_with(&arguments.file, &arguments.values)?;
    let interfaces = check::others(&spec, &arguments.controllers)?;
    let options = check::options(&arguments.file, false);
    let (graph, mut diagnostics) = match &arguments.states {
        Some(activity) => language::graph_states(&spec, &interfaces, &options, activity),
        None => language::graph(&spec, &interfaces, &options),
    };
    let Some(graph) = graph else {
        let is_wrong = diagnostics.iter().any(|found| found.severity == Severity::Error);
        if let Some(activity) = arguments.states.as_ref().filter(|_| !is_wrong) {
            return Err(Failure::Usage(anyhow!("the spec has no activity `{activity}`")));
        }
        diagnostics.retain(|found| found.severity == Severity::Error);
        console::note(&render(&diagnostics, &spec, &interfaces, check::style()));
        return Err(Failure::Reported);
    };
    let picture = if arguments.dot { graph.dot() } else { graph.svg() };
    match &arguments.output {
        None => console::say(&picture),
        Some(file) => {
            whole_file::put(file, picture.as_bytes()).context("writing the picture")?;
        }
    }
    Ok(())
}
