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
    let Gaps { is_damaged, missing } = write(&record, &file)?;
    for sentence in missing {
        console::note(&format!("warning: {sentence}"));
    }
    console::say(&file.display().to_string());
    // The page shows only the undamaged part.
    if is_damaged { Err(anyhow!("the page in `{}` is not of the whole run", file.display()).into()) } else { Ok(()) }
}

/// The parts of a run that its record does not contain.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Gaps {
    /// Whether a part of the file is damaged or absent. The user has already been told.
    pub is_damaged: bool,
    /// A sentence for each wire some of whose values are missing.
    pub missing: Vec<String>,
}

/// Writes the page of a record. Returns the parts of the run that the record does not contain.
///
/// # Errors
/// The record cannot be read, or the page cannot be written.
pub fn write(record: &Path, file: &Path) -> anyhow::Result<Gaps> {
    let run = recorder::read(record)?;
    let lacks = run.lacks();
    if let Some(damage) = &lacks {
        console::note(&format!("warning: the record `{}` is not whole: {damage}", record.display()));
    }
    whole_file::put(file, page(&run).as_bytes()).context("writing the report")?;
    Ok(Gaps { is_damaged: lacks.is_some(), missing: run.missing() })
}
