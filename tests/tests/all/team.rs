//! `dca team` and `dca audit`: ceremonies on one machine, and their files on the disk.

use dca_tests::cluster::{Cluster, executable};
use std::fs::{self, Permissions};
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

const PASSPHRASE: &str = "correct horse battery";

/// A folder with keys, and a user of commands.
struct Desk {
    cluster: Cluster,
    keys: PathBuf,
}

impl Desk {
    fn new() -> Self {
        let cluster = Cluster::new();
        let here = cluster.file("here", "");
        let keys = Path::new(&here).parent().expect("a file is in a folder").join("keys");
        Self { cluster, keys }
    }

    /// Runs a command with a passphrase on standard input. Returns the exit code, the results and the other output.
    fn ask_with(&self, passphrase: &str, arguments: &[&str]) -> (Option<i32>, String, String) {
        let mut command = Command::new(executable("dca"));
        command.args(arguments).arg("--keys").arg(&self.keys);
        command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().expect("dca is there");
        let mut stdin = child.stdin.take().expect("it is piped");
        // A command that needs no passphrase may end without reading it.
        drop(stdin.write_all(format!("{passphrase}\n").as_bytes()));
        drop(stdin);
        let output = child.wait_with_output().expect("dca ends");
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        (output.status.code(), text(&output.stdout), text(&output.stderr))
    }

    #[track_caller]
    fn done(&self, arguments: &[&str]) -> String {
        let (code, out, err) = self.ask_with(PASSPHRASE, arguments);
        assert_eq!(code, Some(0), "{arguments:?}\n{out}{err}");
        out
    }

    #[track_caller]
    fn refused(&self, arguments: &[&str], part: &str) {
        let (code, out, err) = self.ask_with(PASSPHRASE, arguments);
        assert_eq!((code, out.as_str()), (Some(1), ""), "{arguments:?}\n{err}");
        assert!(err.contains(part), "{arguments:?}\n{err}");
    }

    fn files(&self) -> Vec<(PathBuf, u32)> {
        let mut found = Vec::new();
        let mut folders = vec![self.keys.clone()];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(&folder).expect("a folder of ours") {
                let path = entry.expect("a folder of ours").path();
                let mode = fs::metadata(&path).expect("it is there").permissions().mode() & 0o777;
                if path.is_dir() {
                    folders.push(path.clone());
                }
                found.push((path, mode));
            }
        }
        found.sort();
        found
    }
}

#[test]
fn a_team_has_users_and_loses_them() {
    let desk = Desk::new();
    let begun = desk.done(&["team", "init", "acme"]);
    assert!(begun.starts_with("team acme: ") && begun.contains("  admin  "), "its maker is its admin: {begun}");
    let words = begun.lines().next().unwrap_or_default().trim_start_matches("team acme: ").split(' ').count();
    assert_eq!(words, 6, "{begun}");
    let key = desk.done(&["team", "key"]);
    assert_eq!(desk.done(&["team", "key"]), key, "a key is made once");
    let add = ["team", "user", "add", "dan", "--role", "deployer", "--key", key.trim()];
    assert!(desk.done(&add).starts_with("dan is deployer until 20"));
    desk.done(&["team", "user", "add", "dan", "--role", "operator", "--key", key.trim()]);
    let listed = desk.done(&["team"]);
    assert!(listed.contains("operator") && !listed.contains("deployer") && !listed.contains('!'), "{listed}");
    let exported = desk.done(&["team", "export"]);
    assert_eq!(exported.lines().count(), 4, "{exported}");
    let half = desk.cluster.file("half.team", exported.rsplit_once("\ncertificate").expect("there is one").0);
    desk.refused(
        &["team", "import", &half],
        "its last line does not fit the other lines: a part was lost or changed; export the team again",
    );
    assert_eq!(desk.done(&["team", "user", "remove", "dan"]), "dan is revoked: number 1\n");
    let listed = desk.done(&["team"]);
    assert!(listed.contains("revocations: number 1, keys 1") && listed.contains("! revoked"), "{listed}");
    desk.refused(&["team", "user", "remove", "dan"], "`dan` is revoked already");
    desk.refused(&["team", "user", "remove", "eve"], "the team has no user `eve`");
    desk.refused(&add, "this key is revoked, for ever");
    desk.refused(&["team", "init", "acme"], "there is a team `acme`");
}

#[test]
fn what_is_on_the_disk_is_private_and_says_nothing() {
    let desk = Desk::new();
    desk.done(&["team", "init", "acme"]);
    desk.done(&["team", "key"]);
    let files = desk.files();
    assert_eq!(files.len(), 4, "{files:?}");
    for (path, mode) in &files {
        assert_eq!(*mode, if path.is_dir() { 0o700 } else { 0o600 }, "{}", path.display());
        let bytes = if path.is_dir() { Vec::new() } else { fs::read(path).expect("a file of ours") };
        assert!(!bytes.windows(PASSPHRASE.len()).any(|part| part == PASSPHRASE.as_bytes()), "{}", path.display());
    }
    let key = desk.done(&["team", "key"]);
    let add = ["team", "user", "add", "dan", "--role", "viewer", "--key", key.trim()];
    let (code, out, err) = desk.ask_with("another passphrase", &add);
    assert_eq!((code, out.as_str()), (Some(1), ""), "{err}");
    assert!(err.contains("the passphrase is wrong"), "{err}");
    // A key that others may read is not used, and neither is such a passphrase.
    let root = desk.keys.join("acme/root.key");
    fs::set_permissions(&root, Permissions::from_mode(0o640)).expect("a file of ours");
    desk.refused(&add, "other users can read or write");
    fs::set_permissions(&root, Permissions::from_mode(0o600)).expect("a file of ours");
    let file = desk.cluster.file("passphrase", PASSPHRASE);
    let with_file = [&add[..], &["--passphrase", &file]].concat();
    fs::set_permissions(&file, Permissions::from_mode(0o644)).expect("a file of ours");
    desk.refused(&with_file, "other users can read or write");
    fs::set_permissions(&file, Permissions::from_mode(0o600)).expect("a file of ours");
    desk.done(&with_file);
}

#[test]
fn a_short_passphrase_and_a_changed_file_are_refused() {
    let desk = Desk::new();
    let (code, _, err) = desk.ask_with("short", &["team", "init", "acme"]);
    assert_eq!(code, Some(1));
    assert!(err.contains("8 characters") && !desk.keys.exists(), "{err}");
    desk.refused(&["team"], "has no team");
    desk.done(&["team", "init", "acme"]);
    desk.done(&["team", "init", "other"]);
    desk.refused(&["team"], "choose one with `--team`");
    desk.done(&["team", "--team", "acme"]);
    // One file belongs to another team, and one file was modified.
    let [own, other] = ["acme", "other"].map(|name| desk.keys.join(name).join("team"));
    let good = fs::read(&own).expect("a file of ours");
    fs::copy(&other, &own).expect("files of ours");
    desk.refused(&["team", "--team", "acme"], "is of the team `other`");
    let mut changed = good;
    let at = changed.len() - 20;
    changed[at] = if changed[at] == b'0' { b'1' } else { b'0' };
    fs::write(&own, changed).expect("a file of ours");
    desk.refused(&["team", "--team", "acme"], "its last line does not fit the other lines");
}

#[test]
fn wrong_usage_of_keys_has_its_own_code() {
    let desk = Desk::new();
    for arguments in [
        &["team", "init", "two words"][..],
        &["team", "user", "add", "dan", "--role", "king", "--key", "dca-key1-0"],
        &["team", "user", "add", "dan", "--role", "member", "--key", "dca-key1-0"],
        &["team", "user", "add", "dan", "--role", "viewer", "--key", "dca-key1-0"],
        &["audit"],
    ] {
        let mut command = Command::new(executable("dca"));
        let ended = command.args(arguments).stdin(Stdio::null()).output().expect("dca is there");
        assert_eq!(ended.status.code(), Some(2), "{arguments:?}");
    }
    assert!(!desk.keys.exists());
}

#[test]
fn an_audit_log_is_verified() {
    let desk = Desk::new();
    let golden = include_str!("../../../trust/tests/golden/texts.txt");
    let lines: Vec<&str> = golden.lines().filter(|line| line.starts_with("dca-audit") || line.contains('\t')).collect();
    let log = desk.cluster.file("r1.audit", &format!("{}\n", lines.join("\n")));
    let head = golden.lines().find(|line| line.starts_with("dca-head1-")).expect("a head");
    let heads = desk.cluster.file("heads", &format!("{head}\n"));
    let verify = |arguments: &[&str]| desk.cluster.here().ask(&[&["audit", "--verify"], arguments].concat());
    let fits = verify(&[&log, "--heads", &heads]);
    assert_eq!(fits.code, Some(0), "{fits}");
    assert!(fits.out.contains("complete up to record 1") && fits.out.contains("1 signed head fits"), "{fits}");
    // The same head in two files counts once. A line with another system's line end is not the line that was written.
    let twice = verify(&[&log, "--heads", &heads, "--heads", &heads]);
    assert!(twice.code == Some(0) && twice.out.contains("1 signed head fits"), "{twice}");
    for text in [format!("{}\n", lines.join("\r\n")), format!("{}\r\n", lines.join("\n"))] {
        let refused = verify(&[&desk.cluster.file("crlf.audit", &text)]);
        assert!(refused.code == Some(1) && refused.err.contains("was changed after it was written"), "{refused}");
    }
    let cut = desk.cluster.file("cut.audit", &format!("{}\n", lines[0]));
    let missing = verify(&[&cut, "--heads", &heads]);
    assert_eq!(missing.code, Some(1), "{missing}");
    assert!(missing.err.contains("ends with nothing") && missing.err.contains("has signed record 1"), "{missing}");
    assert!(verify(&[&cut]).out.contains("records may be missing"));
    let changed = desk.cluster.file("changed.audit", &lines.join("\n").replace("deploy", "delete"));
    let changed = verify(&[&changed]);
    assert_eq!(changed.code, Some(1), "{changed}");
    assert!(changed.err.contains("line 2, record 1, does not fit"), "{changed}");
    assert_eq!(verify(&["/nowhere"]).code, Some(1));
}

/// Overlapping commands change the team one after the other. No member is forgotten, and no revoked member returns.
#[test]
fn changes_at_the_same_time_are_all_kept() {
    let desk = Desk::new();
    desk.done(&["team", "init", "acme"]);
    let names = ["ann", "ben", "cat", "dan"];
    let keys = names.map(|_| {
        let out = Desk::new().done(&["team", "key"]);
        out.lines().find(|line| line.starts_with("dca-key1-")).expect("the key is a line").to_owned()
    });
    std::thread::scope(|scope| {
        for (name, key) in names.iter().zip(&keys) {
            let desk = &desk;
            scope.spawn(move || desk.done(&["team", "user", "add", name, "--role", "deployer", "--key", key]));
        }
    });
    let listed = desk.done(&["team"]);
    assert!(names.iter().all(|name| listed.contains(&format!("\n{name} "))), "{listed}");
    std::thread::scope(|scope| {
        for name in names {
            let desk = &desk;
            scope.spawn(move || desk.done(&["team", "user", "remove", name]));
        }
    });
    let listed = desk.done(&["team"]);
    assert!(listed.contains("revocations: number 4, keys 4"), "{listed}");
}

/// Files from an interrupted command, or from a missing disk, are reported. Nothing is made in their place.
#[test]
fn what_is_half_there_is_told() {
    let desk = Desk::new();
    fs::create_dir_all(&desk.keys).expect("a folder of ours");
    std::os::unix::fs::symlink("/nowhere/own.key", desk.keys.join("own.key")).expect("a folder of ours");
    desk.refused(&["team", "key"], "own.key");
    assert!(desk.keys.join("own.key").is_symlink(), "the link stays");
    fs::remove_file(desk.keys.join("own.key")).expect("it is there");
    desk.done(&["team", "key"]);
    let folder = desk.keys.join("acme");
    fs::create_dir(&folder).expect("a folder of ours");
    fs::write(folder.join("root.key"), "half").expect("a folder of ours");
    desk.refused(&["team", "init", "acme"], "was left by an interrupted `dca team init`: remove that folder");
    fs::remove_dir_all(&folder).expect("it is there");
    desk.done(&["team", "init", "acme"]);
    desk.refused(&["team", "init", "acme"], "there is a team `acme`");
    desk.refused(&["team", "rotate", "r1"], "the team has no `r1` whose keys are not revoked");
    let admin = desk.done(&["team"]);
    let name = admin.lines().last().and_then(|line| line.split_whitespace().next()).expect("the admin").to_owned();
    desk.refused(&["team", "rotate", &name], "is a user: `dca team key`");
}
