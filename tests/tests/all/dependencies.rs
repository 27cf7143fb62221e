//! The README's commands for newcomers, and the wheel of Python, build each crate once.

use serde_json::Value;
use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::Path;
use std::process::Command;

/// Returns the units that a command of cargo compiles: their names and their keys. A key covers all dependencies of its
/// unit.
fn units(arguments: &[&str]) -> BTreeMap<u64, String> {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut command = Command::new(cargo);
    command.args(arguments).args(["--locked", "--offline", "--unit-graph", "-Zunstable-options"]);
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the tests have a folder of their own");
    // A stable cargo refuses the option unless this variable is set.
    let asked = command.env("RUSTC_BOOTSTRAP", "1").current_dir(folder).output().expect("cargo has started this test");
    assert!(asked.status.success(), "{}", String::from_utf8_lossy(&asked.stderr));
    let graph: Value = serde_json::from_slice(&asked.stdout).expect("cargo prints JSON");
    let units = graph["units"].as_array().expect("a graph has units");
    let mut known = BTreeMap::new();
    (0..units.len()).map(|unit| (key(units, unit, &mut known), name(&units[unit]))).collect()
}

fn name(unit: &Value) -> String {
    format!("{} {} {} {}", unit["pkg_id"], unit["target"]["name"], unit["mode"], unit["features"])
}

/// Returns the key of a unit. Equal units have equal names, profiles and dependencies.
fn key(units: &[Value], at: usize, known: &mut BTreeMap<usize, u64>) -> u64 {
    if let Some(found) = known.get(&at) {
        return *found;
    }
    let unit = &units[at];
    let index = |dependency: &Value| dependency["index"].as_u64().and_then(|index| usize::try_from(index).ok());
    let dependencies: Vec<usize> = unit["dependencies"].as_array().into_iter().flatten().filter_map(index).collect();
    let mut below: Vec<u64> = dependencies.into_iter().map(|dependency| key(units, dependency, known)).collect();
    below.sort_unstable();
    let (mut hasher, mut profile) = (DefaultHasher::new(), unit["profile"].clone());
    // The profile of tests is the development profile under another name.
    profile["name"].take();
    (name(unit), unit["target"]["crate_types"].to_string(), profile.to_string(), below).hash(&mut hasher);
    known.insert(at, hasher.finish());
    hasher.finish()
}

#[test]
fn tests_programs_and_the_wheel_build_each_crate_once() {
    let tests = units(&["test", "--workspace"]);
    let again = |arguments: &[&str]| -> Vec<String> {
        units(arguments).into_iter().filter(|(key, _)| !tests.contains_key(key)).map(|(_, name)| name).collect()
    };
    let programs = again(&["build"]);
    assert_eq!(programs, Vec::<String>::new(), "tests want other features: name these in the workspace");
    let wheel = again(&["rustc", "--package", "dca-python", "--lib"]);
    let is_own = |name: &String| name.contains("dca-python");
    assert!(
        wheel.len() == 1 && wheel.iter().all(is_own),
        "name the features of these in `python/Cargo.toml`: {wheel:#?}"
    );
}
