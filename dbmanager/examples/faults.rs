//! Shows that the simulation finds each injected fault: `cargo run -p dbmanager --example faults -- <first> <count> [<fault>…]`.
//!
//! It copies the sources with the faults of `faults/patches.txt` to the target folder, and compiles the copy once. For each
//! fault it runs the seeds, and then some named cases, until one of them finds the fault.

#[path = "../faults/patch.rs"]
mod patch;

use std::io;
use std::path::Path;
use std::process::{Command, ExitCode};

fn main() -> io::Result<ExitCode> {
    let mut arguments: Vec<String> = std::env::args().skip(1).collect();
    let defaults = ["1", "10000"].into_iter().map(str::to_owned).skip(arguments.len());
    arguments.extend(defaults.collect::<Vec<_>>());
    if arguments.len() == 2 {
        arguments.extend(patch::all().into_iter().map(|fault| fault.name.to_owned()));
    }
    let target = Path::new(env!("CARGO_MANIFEST_DIR")).parent().map(|house| house.join("target")).unwrap_or_default();
    let copy = target.join("faults");
    patch::write_copy(&copy)?;
    let mut cargo = Command::new("cargo");
    cargo.args(["run", "--quiet", "--offline", "--package", "dbmanager", "--example", "planted"]);
    cargo.args(if cfg!(debug_assertions) { None } else { Some("--release") });
    cargo.arg("--").args(arguments).current_dir(&copy).env("CARGO_TARGET_DIR", target);
    Ok(if cargo.status()?.success() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}
