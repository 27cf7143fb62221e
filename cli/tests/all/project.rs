//! The project file, the environment, and completion in a real shell.

#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A folder that is removed with everything in it.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("dca-project-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        Self(folder)
    }

    fn file(&self, name: &str, text: &str) -> PathBuf {
        let path = self.0.join(name);
        std::fs::write(&path, text).unwrap();
        path
    }

    fn dca(&self, arguments: &[&str], variables: &[(&str, &Path)]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_dca"));
        command.args(arguments).current_dir(std::env::temp_dir());
        for variable in ["DCA_RUN_DIR", "DCA_CONTROLLERS", "DCA_PASSPHRASE_FILE"] {
            command.env_remove(variable);
        }
        command.envs(variables.iter().copied()).output().unwrap()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.0).unwrap_or_default();
    }
}

fn texts(output: &Output) -> (Option<i32>, String, String) {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code(), text(&output.stdout), text(&output.stderr))
}

const SPEC: &str = "module Step(host: Host) { done; }
process main(robot: Host = c1) {
    host { robot }
    instantiated_processes { step instof Step(robot); }
    internal_event_actions { step }
}
";

#[test]
fn a_team_begins_with_the_passphrase_of_the_environment_and_only_once() {
    let folder = Folder::new("team");
    let passphrase = folder.file("passphrase", "a long enough secret\n");
    std::fs::set_permissions(&passphrase, std::fs::Permissions::from_mode(0o600)).unwrap();
    let keys = folder.0.join("keys").display().to_string();
    let init = ["team", "init", "acme", "--keys", &keys];
    let (code, out, err) = texts(&folder.dca(&init, &[("DCA_PASSPHRASE_FILE", &passphrase)]));
    assert!(code == Some(0) && out.starts_with("team acme: "), "{out}{err}");
    // The name is looked at before a passphrase is asked for.
    let (code, out, err) = texts(&folder.dca(&init, &[]));
    assert!(code == Some(1) && out.is_empty() && err.contains("there is a team `acme`"), "{out}{err}");
}

#[test]
fn the_file_beside_a_spec_gives_values_and_hosts() {
    let folder = Folder::new("values");
    let spec = folder.file("robot.dca", SPEC).display().to_string();
    let (code, out, err) = texts(&folder.dca(&["check", &spec], &[]));
    assert!(code == Some(0) && out.contains("on c1: no errors"), "{out}{err}");
    folder.file("dca.toml", "hosts = [\"r7\", \"c2\"]\n[set]\nrobot = \"r7\"\n");
    let (code, out, err) = texts(&folder.dca(&["check", &spec], &[]));
    assert!(code == Some(0) && out.contains("on r7: no errors") && err.is_empty(), "{out}{err}");
    let (code, out, err) = texts(&folder.dca(&["check", &spec, "--set", "robot=r8"], &[]));
    let warned = err.contains("warning: `r8` is not one of the hosts in `dca.toml`");
    assert!(code == Some(0) && out.contains("on r8") && warned, "{out}{err}");
    folder.file("dca.toml", "contollers = []\n");
    let (code, out, err) = texts(&folder.dca(&["check", &spec], &[]));
    let told = err.contains("cannot read the project file") && err.contains("unknown field `contollers`");
    assert!(code == Some(1) && out.is_empty() && told, "{out}{err}");
}

#[test]
fn the_environment_names_the_folder_of_the_nodes() {
    let folder = Folder::new("run");
    let own = folder.0.join("nodes");
    let (code, _, err) = texts(&folder.dca(&["status"], &[("DCA_RUN_DIR", &own)]));
    assert!(code == Some(3) && err.contains("no node runs on this machine"), "{err}");
    let (code, _, err) = texts(&folder.dca(&["doctor", "--run-dir", "/proc/none"], &[("DCA_RUN_DIR", &own)]));
    assert!(code == Some(1) && !err.contains("nodes"), "the command line counts first: {err}");
}

/// A shell reads its script, and asks `dca` for words.
#[test]
fn bash_completes_verbs_options_and_values() {
    let folder = Folder::new("bash");
    let program = Path::new(env!("CARGO_BIN_EXE_dca"));
    let path = format!("{}:{}", program.parent().unwrap().display(), std::env::var("PATH").unwrap());
    let script = "source <(dca completions bash)
        for words in 'dca gra' 'dca check --fo' 'dca check --format s' 'dca stop x'; do
            COMP_WORDS=($words); COMP_CWORD=$((${#COMP_WORDS[@]} - 1)); COMP_TYPE=9; COMPREPLY=()
            _clap_complete_dca dca \"${COMP_WORDS[-1]}\" \"${COMP_WORDS[-2]}\"; echo \"${COMPREPLY[@]}\"
        done";
    let mut bash = Command::new("bash");
    bash.args(["--norc", "-c", script]).env("PATH", path).env("DCA_RUN_DIR", folder.0.join("none"));
    let Ok(output) = bash.current_dir(&folder.0).output() else { return };
    let (_, out, err) = texts(&output);
    assert_eq!(out, "graph\n--format\nsarif\n\n", "{err}");
}
