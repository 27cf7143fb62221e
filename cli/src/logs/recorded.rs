//! The output of a process that does not run any more, from the record of its run.

use super::Arguments;
use super::form::Writer;
use crate::follow::RUNS;
use crate::io::recorder;
use crate::logic::record::{Entry, Run};
use anyhow::anyhow;
use node::console::{self, Failure};
use node::io::folder;
use std::path::{Path, PathBuf};

/// The most records that are searched.
const RECORDS_MAX: usize = 20;
/// The most other runs that are listed if no record is of the named run.
const RUNS_TOLD: usize = 8;

/// Prints the output of a process from the latest record that has it. If a run is named, only its record counts.
/// Returns nothing if no record has such a process.
pub(super) fn print(arguments: &Arguments) -> Option<Result<(), Failure>> {
    if let Err(why) = folder::check(&arguments.runs, RUNS) {
        return Some(Err(anyhow!(why).into()));
    }
    let mut others = Vec::new();
    for folder in records(&arguments.runs)?.iter().take(RECORDS_MAX) {
        let run = match recorder::read(&folder.join(recorder::FILE)) {
            Ok(run) => run,
            Err(error) => {
                console::note(&format!("warning: a record is left out: {error}"));
                continue;
            }
        };
        let name = arguments.name();
        let deployment = run.deployment();
        let found = meant(&run, |path| name.is_process(&deployment, path));
        match found[..] {
            [] => {
                let has_process = !meant(&run, |path| name.of_any_run().is_process(&deployment, path)).is_empty();
                others.extend(has_process.then(|| format!("`{deployment}`")));
            }
            [path] => return Some(pass(&run, path, folder, arguments)),
            [..] => {
                let paths = found.join("`, `");
                return Some(Err(anyhow!("`{name}` may be any of `{paths}`; give more of the path").into()));
            }
        }
    }
    if others.is_empty() {
        return None;
    }
    let more = if others.len() > RUNS_TOLD { " and others" } else { "" };
    others.truncate(RUNS_TOLD);
    Some(Err(anyhow!(
        "no node has the output of `{}`, and no record in `{}` is of this run; the records there are of {}{more}",
        arguments.name(),
        arguments.runs.display(),
        others.join(", ")
    )
    .into()))
}

/// Returns the folders with records, the latest first.
fn records(runs: &Path) -> Option<Vec<PathBuf>> {
    let mut records: Vec<PathBuf> = std::fs::read_dir(runs).ok()?.flatten().map(|entry| entry.path()).collect();
    let begun =
        |folder: &PathBuf| std::fs::metadata(folder.join(recorder::FILE)).and_then(|record| record.modified()).ok();
    records.retain(|folder| begun(folder).is_some());
    records.sort_by_key(|folder| std::cmp::Reverse(begun(folder)));
    Some(records)
}

/// Returns the paths of the matching processes of a run.
fn meant(run: &Run, is_meant: impl Fn(&str) -> bool) -> Vec<&str> {
    run.header.plan.leaves.iter().map(|leaf| leaf.path.as_str()).filter(|path| is_meant(path)).collect()
}

fn pass(run: &Run, path: &str, folder: &Path, arguments: &Arguments) -> Result<(), Failure> {
    let (why, deployment) = (if arguments.recorded { "" } else { "no node runs it; " }, run.deployment());
    let folder = folder.display();
    console::note(&format!("note: {why}this is the output of `{path}` by the record in `{folder}`, of `{deployment}`"));
    let mut form = arguments.form(Writer { host: host(run, path), process: path.to_owned() });
    let mut is_read = true;
    for entry in &run.entries {
        if let Entry::Output { path: of, at, text } = entry
            && of == path
            && is_read
        {
            form.date(run.go.map(|go| go + *at));
            is_read = form.print(format!("{text}\n").as_bytes())?;
        }
    }
    form.finish()?;
    match run.lacks() {
        Some(damage) => {
            Err(anyhow!("the record in `{folder}` is not whole: {damage}; it may have written more than this").into())
        }
        None => Ok(()),
    }
}

/// Returns the host of a process, by the plan of its run.
fn host(run: &Run, path: &str) -> Option<String> {
    let plan = &run.header.plan;
    let leaf = plan.leaves.iter().find(|leaf| leaf.path == path)?;
    plan.hosts.get(leaf.host as usize).cloned()
}
