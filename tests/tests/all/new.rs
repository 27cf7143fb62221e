//! The output of `dca new` runs at once.

use dca_tests::cluster::{Cluster, SOON, executable};
use std::path::Path;
use std::process::Command;
use std::time::Duration;

/// The time for a mission. It includes waiting for a busy machine.
const MISSION: Duration = Duration::from_secs(120);

#[test]
fn a_new_spec_runs_with_nothing_else() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let made = here.ask(&["new", "door"]);
    assert_eq!((made.code, made.out.as_str()), (Some(0), "cd door && dca run door.dca\n"), "{made}");
    let ran = here.dca(&["run", "--no-record", "door/door.dca"]).ended(MISSION);
    assert_eq!(ran.code, Some(0), "{ran}");
    assert!(ran.out.contains("door: done"), "{ran}");
    let again = here.ask(&["new", "door"]);
    assert_eq!(again.code, Some(1), "{again}");
    assert!(again.err.contains("`door` is there already"), "{again}");
}

/// The program has the same text as one of this workspace. So this test only checks its folder. Another test below
/// builds it as a separate crate.
#[test]
fn a_new_program_runs() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let made = here.ask(&["new", "--sdk", "robot"]);
    assert_eq!(made.code, Some(0), "{made}");
    let folder = cluster.folder().join("robot");
    let read = |file: &str| std::fs::read_to_string(folder.join(file)).unwrap_or_else(|why| panic!("{file}: {why}"));
    assert_eq!(read("src/main.rs"), include_str!("../../../cli/templates/sdk/main.rs"));
    let path = read("Cargo.toml").lines().find_map(|line| Some(line.split_once("path = \"")?.1.to_owned())).unwrap();
    let path = Path::new(path.trim_end_matches("\" }"));
    assert!(path.is_absolute() && path.join("src/sdk.rs").is_file(), "{path:?}");
    // The crate has the versions that are tested here, and the settings for building zenoh.
    let clone = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    for shared in ["Cargo.lock", ".cargo/config.toml"] {
        assert_eq!(read(shared), std::fs::read_to_string(clone.join(shared)).unwrap(), "{shared}");
    }
    let starter = executable("dca-starter").display().to_string();
    let ran = here.dca(&["run", "--no-record", "--controllers", &starter, "robot/robot.dca"]).ended(MISSION);
    assert_eq!(ran.code, Some(0), "{ran}");
    assert!(ran.out.contains("robot: done"), "{ran}");
}

/// The new program is a crate outside of this workspace. Cargo builds it with the versions and settings that came with
/// it.
#[test]
#[ignore = "builds a hundred crates, which takes many minutes the first time: run it with `--ignored`"]
fn a_new_program_is_a_crate_that_builds_on_its_own() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let made = here.ask(&["new", "--sdk", "robot"]);
    assert_eq!(made.code, Some(0), "{made}");
    let folder = cluster.folder().join("robot");
    // The build is kept for the next time. No other folder contains a program with this name.
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).join("new-sdk");
    let cargo = |verb: &str| {
        let mut cargo = Command::new(env!("CARGO"));
        cargo.args([verb, "--offline", "--target-dir"]).arg(&target).current_dir(&folder);
        // The variables that cargo sets for the tests of this workspace are not for another build.
        for (name, _) in std::env::vars_os().filter(|(name, _)| name.to_string_lossy().starts_with("CARGO_PKG_")) {
            cargo.env_remove(name);
        }
        let ended = cargo.env_remove("CARGO_MANIFEST_DIR").output().expect("cargo runs these tests");
        assert!(ended.status.success(), "cargo {verb}: {}", String::from_utf8_lossy(&ended.stderr));
    };
    cargo("build");
    // The crate's own test runs the controllers on virtual time.
    cargo("test");
    let program = target.join("debug/robot").display().to_string();
    let ran = here.dca(&["run", "--no-record", "--controllers", &program, "robot/robot.dca"]).ended(MISSION);
    assert_eq!(ran.code, Some(0), "{ran}");
    assert!(ran.out.contains("robot: done"), "{ran}");
}

/// An installed `dca` finds the sources beside its folder, and uses the Python package of the machine.
#[test]
fn an_installed_command_uses_the_installed_sources() {
    let cluster = Cluster::new();
    let kit = cluster.folder().join("usr/share/dca/sdk/controllers");
    std::fs::create_dir_all(&kit).expect("a test can write in its own folder");
    std::fs::write(kit.join("Cargo.toml"), "name = \"controllers\"\n").expect("a test can write in its own folder");
    let dca = cluster.folder().join("usr/bin/dca");
    std::fs::create_dir(cluster.folder().join("usr/bin")).expect("a test can write in its own folder");
    std::fs::copy(executable("dca"), &dca).expect("the program is there");
    for (form, file, says) in [
        ("--sdk", "Cargo.toml", format!("controllers = {{ path = {kit:?} }}")),
        ("--python", "two.dca", "    python \"controllers.py\";\n}".to_owned()),
    ] {
        let folder = cluster.folder().join(form);
        std::fs::create_dir(&folder).expect("a test can write in its own folder");
        let made =
            Command::new(&dca).args(["new", form, "two"]).current_dir(&folder).output().expect("it can be executed");
        assert!(made.status.success(), "{made:?}");
        let text = std::fs::read_to_string(folder.join("two").join(file)).expect("it is made");
        assert!(text.contains(&says), "{text}");
    }
}

/// The programs of `packaging/` are valid, and refuse an unknown option before they build or write anything.
#[test]
fn a_program_of_packaging_refuses_an_unknown_option() {
    let packaging = Path::new(env!("CARGO_MANIFEST_DIR")).join("../packaging");
    for program in ["deb", "apt", "tarball", "try"] {
        let path = packaging.join(program);
        let checked = Command::new("bash").arg("-n").arg(&path).output().expect("bash is there");
        assert!(checked.status.success(), "{program}: {checked:?}");
        let refused = Command::new(&path).arg("--quickly").output().expect("it can be executed");
        let why = String::from_utf8_lossy(&refused.stderr);
        assert!(refused.status.code() == Some(1) && why.contains("`--quickly` is no"), "{program}: {refused:?}");
    }
}

#[test]
fn a_wrong_path_is_refused_before_a_folder_is_made() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let file = cluster.file("file", "");
    for (arguments, why) in [
        (&["new", "--sdk=/nowhere", "robot"][..], "looking for DCA at `/nowhere`"),
        (&["new", "--sdk=.", "robot"], "`.` is not a clone of DCA"),
        (&["new", "--sdk", "match"], "a program cannot be called `match`"),
        (&["new", "two words"], "`two words` cannot be the name of a program"),
        (&["new", &format!("{file}/robot")], "making the folder"),
    ] {
        let refused = here.dca(arguments).ended(SOON);
        assert_eq!(refused.code, Some(1), "{arguments:?}: {refused}");
        assert!(refused.err.contains(why), "{arguments:?}: {refused}");
    }
    let left = std::fs::read_dir(cluster.folder()).unwrap().map(|entry| entry.unwrap().file_name());
    assert_eq!(left.collect::<Vec<_>>(), ["file"]);
}
