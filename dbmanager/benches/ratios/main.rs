//! The cost of the database, compared with the cost of the same work without it: `cargo bench -p dbmanager`.
//!
//! Disk and memory are measured in alternating rounds of the same run. Links are simulated under the real replicas, in
//! virtual time, so their limit is known exactly. To run a single part: `cargo bench -p dbmanager -- commit`, or `group`,
//! `read`, `link`, `reopen`, `engines`. All files are made in the folder for temporary files; `TMPDIR` chooses the disk.

mod commit;
mod engines;
mod etcd;
mod group;
mod link;
mod read;
mod reopen;
mod robot;
mod table;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use table::Table;

/// A part of the benchmark.
type Part = fn(&Path, &mut Table) -> Result<(), Failure>;
/// Why the benchmark has ended early.
type Failure = Box<dyn std::error::Error>;

const PARTS: [(&str, Part); 6] = [
    ("commit", commit::measure),
    ("group", group::measure),
    ("read", read::measure),
    ("link", link::measure),
    ("reopen", reopen::measure),
    ("engines", engines::measure),
];

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let result = match words[..] {
        ["opens", engine, dir] => reopen::opens(engine, Path::new(dir)),
        _ if words.contains(&"--bench") => bench(words.iter().copied().find(|word| !word.starts_with('-'))),
        _ => say("this measures only when it is started by `cargo bench`"),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            writeln!(std::io::stderr(), "the benchmark failed: {error}").unwrap_or_default();
            ExitCode::FAILURE
        }
    }
}

/// Measures all parts, or only one.
fn bench(only: Option<&str>) -> Result<(), Failure> {
    let folder = Folder::new()?;
    let mut table = Table::default();
    for (name, measure) in PARTS.iter().filter(|(name, _)| only.is_none_or(|only| only == *name)) {
        say(&format!("{name} …"))?;
        let folder = folder.0.join(name);
        std::fs::create_dir(&folder)?;
        measure(&folder, &mut table)?;
    }
    say(&table.text())
}

fn say(text: &str) -> Result<(), Failure> {
    Ok(writeln!(std::io::stdout(), "{text}")?)
}

/// A folder for stores, removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Result<Self, Failure> {
        let path = std::env::temp_dir().join(format!("dca-db-bench-{}", std::process::id()));
        std::fs::create_dir(&path)?;
        Ok(Self(path))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        if let Err(error) = std::fs::remove_dir_all(&self.0) {
            writeln!(std::io::stderr(), "{} stays behind: {error}", self.0.display()).unwrap_or_default();
        }
    }
}
