//! The folder of a record: the first of `runs/NAME-1`, `runs/NAME-2`, … that does not exist yet.

use super::Spec;
use crate::io::recorder::Recorder;
use crate::logic::mission::Files;
use crate::logic::record::Header;
use crate::output::Output;
use crate::report;
use anyhow::{Context, anyhow};
use comms::io::clock;
use node::console::Failure;
use node::io::folder;
use std::fs::DirBuilder;
use std::os::unix::fs::DirBuilderExt as _;
use std::path::{Path, PathBuf};

/// The most folders of earlier runs that are skipped in the search for a free name.
const RUNS_MAX: u32 = 100_000;

/// The option that names the folder of all records.
pub(crate) const RUNS: &str = "--runs";

/// The users who may read a record and its page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Readers {
    /// Only the user of the command. In a team, only users and programs with the right may see values.
    Own,
    /// The users that the user's file mode mask allows.
    Usual,
}

impl Readers {
    /// Returns who may read a record, depending on whether the node is in a team.
    pub(super) fn of(is_in_team: bool) -> Self {
        if is_in_team { Self::Own } else { Self::Usual }
    }

    fn mode(self) -> u32 {
        match self {
            Self::Own => 0o700,
            Self::Usual => 0o777,
        }
    }
}

/// Begins the record of a mission below the folder `runs`.
pub(super) fn start_record(spec: &Spec, runs: &Path, readers: Readers) -> Result<Recorder, Failure> {
    let dir = free_folder(runs, &spec.plan.name, readers)?;
    let file = spec.file.file_name().map_or_else(|| "spec.dca".to_owned(), |name| name.to_string_lossy().into_owned());
    let (text, plan) = (spec.text.clone(), spec.plan.clone());
    let header = Header { file, text, plan, started: Some(clock::unix_time()) };
    Ok(Recorder::create(&dir, &header).with_context(|| format!("beginning a record in `{}`", dir.display()))?)
}

/// Completes a record, and makes its page. If the record is not complete, returns the reason. This
/// is an error, regardless of the result of the mission.
pub(super) fn end_record(recorder: Recorder, output: &mut Output) -> (Files, Result<(), anyhow::Error>) {
    let mut files = Files::default();
    let (record, finished) = (recorder.path().to_owned(), recorder.finish());
    let mut kept = match finished {
        Ok((_, dropped)) => {
            files.dropped = dropped;
            Ok(())
        }
        // The earlier part of the record can be read.
        Err(error) => Err(anyhow!("the record is not complete: {error:#}")),
    };
    let page = record.with_file_name(report::FILE);
    match report::write(&record, &page) {
        Ok(_) => files.report = Some(page.display().to_string()),
        Err(error) => kept = kept.and(Err(anyhow!("no report was made: {error:#}"))),
    }
    if let Err(why) = &kept {
        output.note(&format!("warning: {why:#}"));
    }
    files.record = Some(record.display().to_string());
    (files, kept)
}

/// Makes the first of `runs/NAME-1`, `runs/NAME-2`, … that does not exist yet.
fn free_folder(runs: &Path, name: &str, readers: Readers) -> anyhow::Result<PathBuf> {
    std::fs::create_dir_all(runs).map_err(|cause| folder::refused(runs, cause, RUNS))?;
    for number in 1..RUNS_MAX {
        let dir = runs.join(format!("{name}-{number}"));
        match DirBuilder::new().mode(readers.mode()).create(&dir) {
            Ok(()) => return Ok(dir),
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists => {}
            Err(cause) => return Err(folder::refused(&dir, cause, RUNS).into()),
        }
    }
    Err(anyhow!(
        "`{}` holds too many runs of `{name}`; remove some, or choose another folder with `--runs`",
        runs.display()
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt as _;

    #[test]
    fn in_a_team_only_the_user_reads_a_record() {
        let runs = std::env::temp_dir().join(format!("dca-runs-{}", std::process::id()));
        let mode = |readers| {
            let folder = free_folder(&runs, "door", readers).unwrap();
            (folder.file_name().unwrap().to_owned(), folder.metadata().unwrap().permissions().mode() & 0o777)
        };
        assert_eq!(mode(Readers::of(true)), ("door-1".into(), 0o700));
        let (name, shared) = mode(Readers::of(false));
        assert!(name == "door-2" && shared & 0o700 == 0o700);
        std::fs::remove_dir_all(&runs).unwrap();
    }
}
