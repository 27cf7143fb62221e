//! Compares types and values with `rosbags` from PyPI, which is independent of DCA and of ROS 2.

use super::text;
use ros::logic::hash::rihs01;
use ros::logic::library;
use ros::logic::name::TypeName;
use ros::logic::schema::Schema;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The number of values of each type.
const VALUES: usize = 200;

/// Returns the interpreter of a new virtual environment with `package`, or why there is none.
fn python(folder: &Path, package: &str) -> Result<PathBuf, String> {
    let run = |program: &Path, arguments: &[&str]| {
        let output = Command::new(program).args(arguments).output().map_err(|why| why.to_string())?;
        let errors = String::from_utf8_lossy(&output.stderr);
        if output.status.success() { Ok(()) } else { Err(errors.lines().last().unwrap_or_default().to_owned()) }
    };
    let target = folder.to_str().ok_or("the folder has no name in UTF-8")?;
    run(Path::new("python3"), &["-m", "venv", target])?;
    let python = folder.join("bin/python");
    run(&python, &["-m", "pip", "install", "-q", "--disable-pip-version-check", package])?;
    Ok(python)
}

#[test]
#[ignore = "long: 65,000 values, and PyPI"]
fn all_types_of_jazzy_and_of_the_newest_distribution_are_those_of_rosbags() {
    let folder = std::env::temp_dir().join(format!("dca-ros-rosbags-{}", std::process::id()));
    let python = match python(&folder, "rosbags==0.11.9") {
        Ok(python) => python,
        Err(why) => return println!("skipped: rosbags cannot be had from PyPI: {why}"),
    };
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/generate/values.py");
    let mut command = Command::new(python);
    command.args([script, "ros2_jazzy", "latest", &VALUES.to_string()]).stdout(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let (mut types, mut values, mut schema) = (0, 0, None::<Schema>);
    for line in BufReader::new(child.stdout.take().unwrap()).lines() {
        let line = line.unwrap();
        let (kind, rest) = line.split_once(' ').unwrap();
        if kind == "T" {
            let [name, hash, definition]: [String; 3] = serde_json::from_str(rest).unwrap();
            let name = TypeName::parse(&name).unwrap();
            let found = Schema::parse(&name, &definition).unwrap();
            assert_eq!(rihs01(&found), hash, "{name}");
            assert_eq!(Schema::parse(&name, &found.text()).as_ref(), Ok(&found), "{name}");
            if let Ok(standard) = library::schema(&name) {
                assert_eq!(rihs01(&standard), hash, "{name}");
            }
            schema = Some(found);
            types += 1;
        } else {
            text::check(schema.as_ref().unwrap(), rest);
            values += 1;
        }
    }
    assert!(child.wait().unwrap().success());
    std::fs::remove_dir_all(&folder).unwrap();
    assert!(types > 300 && values == VALUES * types, "{types} types, {values} values");
}
