//! `dca export`: converts a record to a format of other programs.

use crate::io::{named_file, recorder, whole_file};
use crate::logic::record::Run;
use crate::logic::trace;
use anyhow::{Context as _, anyhow};
use node::console::{self, Failure};
use std::path::PathBuf;

/// The name of a trace, in the folder of its record.
const FILE: &str = "trace.jsonl";

/// The arguments of `dca export`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    form: Form,
}

#[derive(Debug, clap::Subcommand)]
enum Form {
    /// Write a trace for OpenTelemetry: the mission and each activation of a process are spans
    Otlp {
        /// The record, or the folder it is in
        record: PathBuf,
        /// The place of the trace [default: trace.jsonl beside the record]
        #[arg(short, long, value_name = "FILE")]
        output: Option<PathBuf>,
    },
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let Form::Otlp { record, output } = &arguments.form;
    let record = recorder::file(record);
    let file = output.clone().unwrap_or_else(|| record.with_file_name(FILE));
    named_file::not_over(&file, [record.as_path()])?;
    let run = recorder::read(&record).map_err(anyhow::Error::from)?;
    let lacks = run.lacks();
    let go = run.go.ok_or_else(|| without_go(&run))?;
    let text = trace::lines(&run, go).join("\n") + "\n";
    whole_file::put(&file, text.as_bytes()).context("writing the trace")?;
    console::say(&file.display().to_string());
    match lacks {
        Some(damage) => {
            console::note(&format!("warning: the record `{}` is not whole: {damage}", record.display()));
            Err(anyhow!("the trace in `{}` is not of the whole run", file.display()).into())
        }
        None => Ok(()),
    }
}

/// Explains why a record has no trace.
fn without_go(run: &Run) -> anyhow::Error {
    anyhow!("cannot write a trace of `{}`: nothing has run, since the record has no GO", run.header.file)
}
