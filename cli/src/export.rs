//! `dca export`: converts a record to a format of other programs.

use crate::io::{named_file, recorder, whole_file};
use crate::logic::record::{Run, SPEC};
use crate::logic::trace;
use anyhow::{Context as _, anyhow};
use node::console::{self, Failure};
use std::path::{Path, PathBuf};

/// The name of a trace, in the folder of its record.
const TRACE: &str = "trace.jsonl";

/// The arguments of `dca export`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    form: Form,
}

#[derive(Debug, clap::Subcommand)]
enum Form {
    /// Write a trace for OpenTelemetry: the mission and each activation of a process are spans
    Otlp(Places),
    /// Write the spec that ran, as it was read
    Spec(Places),
}

#[derive(Debug, clap::Args)]
struct Places {
    /// The record, or the folder it is in
    record: PathBuf,
    /// The place of the result; `-` is standard output [default: trace.jsonl or spec.dca beside the record]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    match &arguments.form {
        Form::Otlp(places) => trace(places),
        Form::Spec(places) => spec(places),
    }
}

fn trace(places: &Places) -> Result<(), Failure> {
    let (run, record, file) = places.open(TRACE)?;
    let go = run.go.ok_or_else(|| without_go(&run))?;
    put(&file, &(trace::lines(&run, go).join("\n") + "\n"))?;
    match run.lacks() {
        Some(damage) => {
            console::note(&format!("warning: the record `{}` is not whole: {damage}", record.display()));
            Err(anyhow!("the trace in `{}` is not of the whole run", file.display()).into())
        }
        None => Ok(()),
    }
}

fn spec(places: &Places) -> Result<(), Failure> {
    let (run, _, file) = places.open(SPEC)?;
    put(&file, &run.header.text)
}

impl Places {
    /// Reads the record. Returns it with its path, and the place of a result that usually has the name `usual`.
    fn open(&self, usual: &str) -> Result<(Run, PathBuf, PathBuf), Failure> {
        let record = recorder::file(&self.record);
        let file = self.output.clone().unwrap_or_else(|| record.with_file_name(usual));
        named_file::not_over(&file, [record.as_path()])?;
        let run = recorder::read(&record).map_err(anyhow::Error::from)?;
        Ok((run, record, file))
    }
}

/// Writes a result, and prints the place of it. `-` is standard output.
fn put(file: &Path, text: &str) -> Result<(), Failure> {
    if file == Path::new("-") {
        console::say(text.trim_end_matches('\n'));
        return Ok(());
    }
    whole_file::put(file, text.as_bytes()).with_context(|| format!("writing `{}`", file.display()))?;
    console::say(&file.display().to_string());
    Ok(())
}

/// Explains why a record has no trace.
fn without_go(run: &Run) -> anyhow::Error {
    anyhow!("cannot write a trace of `{}`: nothing has run, since the record has no GO", run.header.file)
}
