//! `dca report`: makes an HTML page from the record of a run.

use crate::io::{named_file, recorder, whole_file};
use crate::logic::page::page;
use anyhow::{Context as _, anyhow};
use node::console::{self, Failure};
use std::path::{Path, PathBuf};

/// The name of a report, in the folder of its record.
pub const FILE: &str = "report.html";

/// The arguments of `dca report`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The record, or the folder it is in
    record: PathBuf,
    /// The place of the page [default: report.html beside the record]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let record = recorder::file(&arguments.record);
    let file = arguments.output.clone().unwrap_or_else(|| record.with_file_name(FILE));
    named_file::not_over(&file, [record.as_path()])?;
    let damage = write(&record, &file)?;
    console::say(&file.display().to_string());
    // The page shows only the undamaged part.
    damage.map_or(Ok(()), |_told| Err(anyhow!("the page in `{}` is not of the whole run", file.display()).into()))
}

/// Writes the page of a record. If a part of the record is missing, returns this part. The user has already been told.
///
/// # Errors
/// The record cannot be read, or the page cannot be written.
pub fn write(record: &Path, file: &Path) -> anyhow::Result<Option<String>> {
    let run = recorder::read(record)?;
    let lacks = run.lacks();
    if let Some(damage) = &lacks {
        console::note(&format!("warning: the record `{}` is not whole: {damage}", record.display()));
    }
    for sentence in run.missing() {
        console::note(&format!("warning: {sentence}"));
    }
    whole_file::put(file, page(&run).as_bytes()).context("writing the report")?;
    Ok(lacks)
}
