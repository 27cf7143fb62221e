//! The commands that the README gives to newcomers build each dependency once.

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

/// The crates from elsewhere that a command of cargo builds, with their features.
fn dependencies(arguments: &[&str]) -> BTreeSet<String> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut command = Command::new(cargo);
    command.args(["tree", "--locked", "--offline", "--no-dedupe", "--prefix", "none", "--format", "{p} {f}"]);
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the tests have a folder of their own");
    let asked = command.args(arguments).current_dir(folder).output().expect("cargo has started this test");
    assert!(asked.status.success(), "{}", String::from_utf8_lossy(&asked.stderr));
    let text = String::from_utf8(asked.stdout).expect("names of crates are ASCII");
    // The crates of this repository have their path behind the version.
    text.lines().filter(|line| !line.contains("(/")).map(str::to_owned).collect()
}

#[test]
fn tests_need_no_dependency_with_other_features_than_the_programs() {
    let programs = dependencies(&["--edges", "normal,build"]);
    let tests = dependencies(&["--workspace", "--edges", "normal,build,dev"]);
    let built_again: Vec<&String> = programs.difference(&tests).collect();
    assert_eq!(built_again, Vec::<&String>::new(), "tests want other features: name these in the workspace, too");
    let wheel = dependencies(&["--package", "dca-python", "--edges", "normal,build"]);
    let built_again: Vec<&String> = wheel.difference(&tests).collect();
    assert_eq!(built_again, Vec::<&String>::new(), "the wheel wants other features: name these in `python/Cargo.toml`");
}
