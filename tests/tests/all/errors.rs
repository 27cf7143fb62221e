//! Every mistake is reported in one clear sentence with the right exit code. It leaves nothing behind.

use dca_tests::cluster::{Cluster, Ended, Program, SOON, Stream, executable, spec};
use rustix::fs::{CWD, FileType, Gid, Mode, Uid, mknodat};
use rustix::process::{Signal, getuid};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

/// One plain program on host `c1`.
const IDLE: &str = "
module Idle(host) { exec \"sleep 3600\"; plain; }
process main() { host { c1 } instantiated_processes { idle instof Idle(c1); } internal_event_actions { idle } }
";

/// Checks the end of a command: its exit code, and the presence of a sentence in one line of its output.
#[track_caller]
fn check(cluster: &Cluster, ended: &Ended, code: i32, sentence: &[&str]) {
    assert_eq!(ended.code, Some(code), "{ended}");
    let mut lines = ended.err.lines().chain(ended.out.lines());
    assert!(lines.any(|line| sentence.iter().all(|part| line.contains(part))), "expected {sentence:?}\n{ended}");
    // Signs that a cause is printed twice, or in a programmer's form.
    for noise in ["(os error 2): No such", "panicked", "Error {", "RUST_BACKTRACE"] {
        assert!(!ended.err.contains(noise), "{ended}");
    }
    cluster.expect_nothing_left(Duration::from_secs(2));
}

#[track_caller]
fn check_run(file: &dyn Fn(&Cluster) -> String, code: i32, sentence: &[&str]) {
    let cluster = Cluster::new();
    let ended = cluster.here().ask(&["run", &file(&cluster)]);
    check(&cluster, &ended, code, sentence);
}

fn end(node: Program) {
    node.signal(Signal::TERM);
    let ended = node.ended(SOON);
    assert_eq!(ended.code, Some(0), "{ended}");
}

/// If a folder is expected, a file is refused by its name, together with the option for another folder.
#[test]
fn a_file_where_a_folder_is_expected() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let (idle, file) = (cluster.file("idle.dca", IDLE), cluster.file("file", ""));
    let below = format!("{file}/x");
    for folder in [&file, &below] {
        let is_file = format!("`{file}` is a file, where a folder is expected; choose another folder with `--");
        for option in ["runs", "state"] {
            let refused = here.ask(&["run", &format!("--{option}"), folder, &idle]);
            check(&cluster, &refused, 1, &[&format!("{is_file}{option}`")]);
        }
        let elsewhere = here.clone().with_run_dir(folder);
        for arguments in [&["run", &idle][..], &["deploy", &idle], &["nodes"], &["status"], &["stop", "idle"]] {
            check(&cluster, &elsewhere.ask(arguments), 1, &[&format!("{is_file}run-dir`")]);
        }
        check(&cluster, &elsewhere.start_node("c1", &[]).ended(SOON), 1, &[&format!("{is_file}run-dir`")]);
    }
    // Even root cannot make a folder there.
    for option in ["runs", "state"] {
        let refused = here.ask(&["run", &format!("--{option}"), "/proc/x", &idle]);
        let another = format!("choose another folder with `--{option}`");
        check(&cluster, &refused, 1, &["cannot make the folder `/proc/x", &another]);
    }
    let refused = here.clone().with_run_dir("/proc/x").ask(&["run", &idle]);
    check(&cluster, &refused, 1, &["cannot use the folder `/proc/x", "choose another folder with `--run-dir`"]);
}

#[test]
fn a_file_that_cannot_be_read() {
    check_run(&|_| "nowhere.dca".to_owned(), 1, &["cannot read the spec `nowhere.dca`: No such file"]);
    check_run(&|_| ".".to_owned(), 1, &["cannot read the spec `.`: Is a directory"]);
    let binary = |cluster: &Cluster| {
        std::fs::write(cluster.folder().join("binary.dca"), [0xff, 0xfe]).expect("a test can write in its own folder");
        "binary.dca".to_owned()
    };
    check_run(&binary, 1, &["cannot read the spec `binary.dca`", "UTF-8"]);
    if getuid().is_root() {
        return; // Root can read everything.
    }
    let secret = |cluster: &Cluster| {
        let path = cluster.file("secret.dca", IDLE);
        std::fs::set_permissions(&path, PermissionsExt::from_mode(0o000)).expect("the file is the test's own");
        path
    };
    check_run(&secret, 1, &["cannot read the spec", "Permission denied"]);
}

/// No command waits for such a file, and none reads it endlessly.
#[test]
fn a_name_that_belongs_to_no_regular_file() {
    let cluster = Cluster::new();
    let pipe = cluster.folder().join("pipe.dca").display().to_string();
    mknodat(CWD, pipe.as_str(), FileType::Fifo, Mode::RUSR | Mode::WUSR, 0)
        .expect("a test can write in its own folder");
    let idle = cluster.file("idle.dca", IDLE);
    let device = cluster.file("device.dca", "use \"/dev/zero\";\nuse \"pipe.dca\";\n");
    let why = "it is a pipe; only regular files are read";
    for verb in [&["check", &pipe][..], &["fmt", &pipe], &["fix", &pipe], &["graph", &pipe], &["run", &pipe]] {
        check(&cluster, &cluster.here().ask(verb), 1, &["cannot read the spec", why]);
    }
    check(&cluster, &cluster.here().ask(&["sim", &idle, "--script", &pipe]), 1, &["reading the script", why]);
    check(&cluster, &cluster.here().ask(&["report", &pipe]), 1, &["reading the record", why]);
    check(&cluster, &cluster.here().ask(&["db", "tx", &pipe]), 1, &["reading", why]);
    check(&cluster, &cluster.here().ask(&["db", "import", &pipe]), 1, &["reading", why]);
    let used = cluster.here().ask(&["check", &device]);
    check(&cluster, &used, 1, &["cannot read `pipe.dca`", why]);
    check(&cluster, &used, 1, &["cannot read `/dev/zero`: it is a device"]);
}

/// If the name of a node's file belongs to something else, the node refuses at once. It names the path, and the option
/// for another folder.
#[test]
fn what_is_no_file_in_the_folders_of_a_node() {
    let cluster = Cluster::new();
    let here = cluster.here();
    end(here.node("c1", &[]));
    let (run, state) = (here.run_dir().join("c1"), here.state().join("c1"));
    let folder = |path: &Path| std::fs::create_dir_all(path.join("x"));
    let pipe = |path: &Path| Ok(mknodat(CWD, path, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0)?);
    let socket = |path: &Path| std::os::unix::net::UnixListener::bind(path).map(drop);
    let nowhere = |path: &Path| std::os::unix::fs::symlink("/nowhere/at/all", path);
    let device = |path: &Path| std::os::unix::fs::symlink("/dev/full", path);
    type Make<'a> = &'a dyn Fn(&Path) -> std::io::Result<()>;
    let traps: [(&Path, &str, Make<'_>, &str); 16] = [
        (&run, "node.sock.lock", &pipe, "it is a pipe"),
        (&run, "node.sock.lock", &folder, "Is a directory"),
        (&run, "node.sock.lock", &nowhere, "it is a link that leads nowhere"),
        (&run, "node.sock.lock", &device, "it is a device"),
        (&run, "lock", &pipe, "it is a pipe"),
        (&run, "lock", &nowhere, "it is a link that leads nowhere"),
        (&run, "lock", &socket, "it is a socket"),
        (&run, "team", &folder, "Is a directory"),
        (&run, "state", &folder, "Is a directory"),
        (&run, "proof", &folder, "Is a directory"),
        (&run, "node.sock", &folder, "Is a directory"),
        (&state, "journal", &folder, "Is a directory"),
        (&state, "db.witness", &folder, "Is a directory"),
        (&state, "db/records.redb", &pipe, "it is a pipe"),
        (&state, "db/records.redb", &nowhere, "it is a link that leads nowhere"),
        (&state, "db/other", &socket, "it is a socket"),
    ];
    for (base, name, make, what) in traps {
        let (path, aside) = (base.join(name), cluster.folder().join("aside"));
        let is_kept = std::fs::rename(&path, &aside).is_ok();
        make(&path).unwrap_or_else(|error| panic!("{name}: {error}"));
        let option = if base == run { "run-dir" } else { "state" };
        let refused = here.start_node("c1", &[]).ended(SOON);
        check(&cluster, &refused, 1, &["cannot use", &format!("`{}`", path.display()), what, option]);
        let removed = std::fs::remove_file(&path).or_else(|_folder| std::fs::remove_dir_all(&path));
        removed.unwrap_or_else(|error| panic!("{name}: {error}"));
        if is_kept {
            std::fs::rename(&aside, &path).unwrap_or_else(|error| panic!("{name}: {error}"));
        }
    }
    end(here.node("c1", &[]));
}

#[test]
fn a_host_that_nobody_answers_for() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let none = here.ask(&["deploy", &spec("door_opening")]);
    check(&cluster, &none, 3, &["no node runs on this machine; start one with `dca-node --name NAME`"]);
    for verb in [&["nodes"][..], &["status"], &["stop", "door_opening"], &["logs", "hit"]] {
        check(&cluster, &here.ask(verb), 3, &["no node runs on this machine"]);
    }
    let c3 = here.node("c3", &[]);
    let ended = here.ask(&["deploy", &spec("door_opening")]);
    let sentence = [
        "no node answers for the host `c1`, `c2`",
        "nodes seen: c3",
        "start `dca-node --name c1` on it, in the same team or with `--insecure-lan`",
    ];
    assert_eq!(cluster.left().len(), 1, "only the node: {:?}", cluster.left());
    end(c3);
    check(&cluster, &ended, 3, &sentence);
}

#[test]
fn a_controller_type_that_nobody_offers() {
    let unknown = |cluster: &Cluster| cluster.file("unknown.dca", &IDLE.replace("Idle(c1)", "Lidar(c1)"));
    check_run(&unknown, 1, &["host `c1`", "no program here offers the controller type `Lidar`"]);
}

#[test]
fn a_program_that_does_not_exist() {
    let missing = |cluster: &Cluster| cluster.file("missing.dca", &IDLE.replace("sleep 3600", "/nowhere/beep aloud"));
    check_run(&missing, 1, &["`main/idle` cannot take part", "`/nowhere/beep`"]);
    let no_program = |cluster: &Cluster| {
        let file = cluster.file("data", "no program");
        cluster.file("data.dca", &IDLE.replace("sleep 3600", &file))
    };
    check_run(&no_program, 1, &["`main/idle` cannot take part", "/data`"]);
    let words = format!("sh -c {}", "x".repeat(200_000));
    let too_long = |cluster: &Cluster| cluster.file("long.dca", &IDLE.replace("sleep 3600", &words));
    check_run(&too_long, 1, &["its arguments and environment are longer than the system takes"]);
}

/// A failed program explains itself. Its last lines are part of the abort, and all of its lines are in the report and
/// in the record. `dca logs` finds them there after the nodes have gone.
#[test]
fn a_program_that_fails() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let lines = "for line in $(seq 30); do echo line $line; done";
    let script = cluster.file("fails.sh", &format!("{lines}\necho the lens is dirty >&2\nexit 7\n"));
    let file = cluster.file("fails.dca", &IDLE.replace("sleep 3600", &format!("sh {script}")));
    let ended = here.ask(&["run", &file]);
    check(&cluster, &ended, 1, &["main ← idle: left with exit code 7 before it was done at "]);
    assert!(ended.out.contains("    | the lens is dirty\n") && ended.out.contains("    | line 12\n"), "{ended}");
    assert!(!ended.out.contains("| line 11\n"), "twenty lines: {ended}");
    let report = std::fs::read_to_string(cluster.folder().join("runs/fails-1/report.html")).expect("there is a report");
    assert!(report.contains("what main/idle wrote, 31 lines") && report.contains("line 1\nline 2\n"), "{report}");
    let logs = here.ask(&["logs", "idle"]);
    assert_eq!(logs.code, Some(0), "{logs}");
    assert!(logs.out.starts_with("line 1\n") && logs.out.ends_with("line 30\nthe lens is dirty\n"), "{logs}");
    assert!(logs.err.contains("by the record in `runs/fails-1`"), "{logs}");
}

/// Only the output of a program that took too long explains why it did.
#[test]
fn a_program_that_a_deadline_ends() {
    let cluster = Cluster::new();
    let script = cluster.file("hangs.sh", "echo waiting for the lens >&2\nexec sleep 3600\n");
    let text = IDLE.replace("sleep 3600", &format!("sh {script}")).replace("{ idle }", "{ idle within 1 s }");
    let file = cluster.file("hangs.dca", &text);
    for record in [&[][..], &["--no-record"]] {
        let ended = cluster.here().ask(&[&["run", &file], record].concat());
        check(&cluster, &ended, 1, &["main: the deadline `idle within 1 s` in line 3 has passed at "]);
        assert!(ended.out.contains("  the end of the output of `idle`:\n    | waiting for the lens\n"), "{ended}");
    }
}

/// The node keeps a program's output after the end of the deployment.
#[test]
fn the_output_of_a_program_that_has_failed_on_a_node() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let script = cluster.file("fails.sh", "echo the lens is dirty >&2\nexit 7\n");
    let file = cluster.file("fails.dca", &IDLE.replace("sleep 3600", &format!("sh {script}")));
    let node = here.node("c1", &[]);
    let ended = here.ask(&["deploy", "--no-record", &file]);
    let logs = here.ask(&["logs", "idle"]);
    end(node);
    assert_eq!((logs.code, logs.out.as_str()), (Some(0), "the lens is dirty\n"), "{logs}");
    check(&cluster, &ended, 1, &["    | the lens is dirty"]);
}

/// A deployment is run several times. The record of each run knows the number of the run.
#[test]
fn the_output_of_a_run_is_read_from_its_own_record() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let text = "module Say(host: Host, word: Text) { exec \"sh -c 'echo $0; echo end'\"; plain; done; }
        process main(word: Text = none) {
            host { c1 }
            instantiated_processes { say instof Say(c1, word); }
            internal_event_actions { say }
        }";
    let file = cluster.file("say.dca", text);
    let node = here.node("c1", &[]);
    for word in ["AAA", "BBB"] {
        let ended = here.ask(&["deploy", "--set", &format!("word={word}"), &file]);
        assert_eq!(ended.code, Some(0), "{ended}");
    }
    let missing = here.ask(&["logs", "say@99:"]);
    assert!(missing.code == Some(1) && missing.err.contains("no deployment `say@99` is running"), "{missing}");
    end(node);
    for (name, word) in [("say@1:say", "AAA"), ("say@2:main/say", "BBB"), ("say:say", "BBB"), ("say/main/say", "BBB")] {
        for recorded in [&[][..], &["--recorded"]] {
            let logs = here.ask(&[&["logs", name], recorded].concat());
            assert_eq!((logs.code, logs.out), (Some(0), format!("word={word}\nend\n")), "{name}: {}", logs.err);
        }
    }
    let missing = here.ask(&["logs", "say@99:say", "--recorded"]);
    let why = "no record in `runs` is of this run; the records there are of `say@2`, `say@1`";
    assert!(missing.code == Some(1) && missing.out.is_empty() && missing.err.contains(why), "{missing}");
    let json = here.ask(&["logs", "say@1:say", "--json"]);
    let lines: Vec<serde_json::Value> =
        json.out.lines().map(|line| serde_json::from_str(line).unwrap_or_else(|why| panic!("{why}: {json}"))).collect();
    let texts: Vec<&str> = lines.iter().filter_map(|line| line["text"].as_str()).collect();
    assert_eq!(texts, ["word=AAA", "end"], "{json}");
    assert!(lines.iter().all(|line| line["process"] == "main/say" && line["host"] == "c1" && line["time"].is_f64()));
}

#[test]
fn a_program_that_offers_no_controllers() {
    let cluster = Cluster::new();
    let (here, file) = (cluster.here(), cluster.file("idle.dca", IDLE));
    let silent = here.ask(&["run", "--controllers", "/bin/false", &file]);
    check(&cluster, &silent, 1, &["`/bin/false` did not print its interface"]);
    let missing = here.ask(&["run", "--controllers", "/nowhere/controllers", &file]);
    check(&cluster, &missing, 1, &["cannot run `/nowhere/controllers`: No such file"]);
    let node = here.start_node("c1", &["--controllers", "/bin/false"]).ended(SOON);
    check(&cluster, &node, 1, &["`/bin/false` did not print its interface"]);
    let node = here.start_node("c1", &["--controllers", "/bin/true"]).ended(SOON);
    check(&cluster, &node, 1, &["`/bin/true` offers no controller type"]);
}

#[test]
fn a_folder_that_cannot_be_used() {
    let cluster = Cluster::new();
    // A file in the place of the folder stops even root.
    let file = cluster.file("file", "");
    let node = cluster.here().with_run_dir(format!("{file}/n")).start_node("c1", &[]);
    check_node(&cluster, node, &["/file` is a file, where a folder is expected", "`--run-dir`"]);
    let deep = cluster.folder().join("d".repeat(60));
    let node = cluster.here().with_run_dir(&deep).start_node("c1", &[]);
    check_node(&cluster, node, &["is too deep for sockets", "may have 43 bytes", "a shorter path with `--run-dir`"]);
    assert!(!deep.exists(), "a start that is refused leaves nothing");
    let runs = cluster.here().ask(&["run", "--runs", &format!("{file}/runs"), &cluster.file("idle.dca", IDLE)]);
    check(&cluster, &runs, 1, &["/file` is a file, where a folder is expected", "`--runs`"]);
    if !getuid().is_root() {
        return; // Only root can give a folder away.
    }
    let theirs = cluster.folder().join("theirs");
    std::fs::create_dir(&theirs).expect("a test can write in its own folder");
    rustix::fs::chown(&theirs, Some(Uid::from_raw(65534)), Some(Gid::from_raw(65534))).expect("root gives it away");
    let node = cluster.here().with_run_dir(theirs).start_node("c1", &[]);
    check_node(&cluster, node, &["belongs to user 65534, whose nodes may run there; act as that user"]);
}

#[track_caller]
fn check_node(cluster: &Cluster, node: Program, sentence: &[&str]) {
    check(cluster, &node.ended(SOON), 1, sentence);
}

/// A relative path is not an error.
#[test]
fn a_folder_with_a_relative_path() {
    let cluster = Cluster::new();
    let here = cluster.here().with_run_dir("relative");
    let node = here.node("c1", &[]);
    let nodes = here.ask(&["nodes"]);
    assert!(nodes.code == Some(0) && nodes.out.contains("\nc1 "), "{nodes}");
    end(node);
    cluster.expect_nothing_left(Duration::from_secs(2));
}

#[test]
fn two_nodes_of_one_name() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let first = here.node("c1", &[]);
    let second = here.start_node("c1", &[]).ended(SOON);
    assert!(first.is_running());
    end(first);
    check(&cluster, &second, 1, &["a node named `c1` is already running on this machine"]);
    let strange = here.start_node("c 1", &[]).ended(SOON);
    check(&cluster, &strange, 2, &["`c 1` is not a host name"]);
}

#[test]
fn a_deployment_that_is_already_there() {
    let cluster = Cluster::new();
    let (here, file) = (cluster.here(), cluster.file("idle.dca", IDLE));
    let node = here.node("c1", &[]);
    let first = here.dca(&["deploy", &file]);
    first.wait_for(Stream::Err, "▸", SOON);
    let same = here.ask(&["deploy", &file]);
    assert!(same.code == Some(0) && same.out.contains("nothing changes"), "{same}");
    let other = cluster.file("idle.dca", &IDLE.replace("{ idle }", "{ never }"));
    let second = here.ask(&["deploy", &other]);
    assert!(first.is_running(), "the first goes on");
    let stop = here.ask(&["stop", "idle"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    assert_eq!(first.ended(SOON).code, Some(1));
    let again = here.ask(&["stop", "idle"]);
    let logs = here.ask(&["logs", "nothing"]);
    end(node);
    check(
        &cluster,
        &second,
        1,
        &[
            "`idle@1` is not changed",
            "`main/idle` runs, and the new event actions have another expression in its place",
            "or stop the deployment",
        ],
    );
    check(&cluster, &again, 1, &["no deployment `idle` is running"]);
    check(&cluster, &logs, 1, &["no process `nothing`"]);
}

/// A spec with an error is refused before anything starts.
#[test]
fn a_spec_with_errors() {
    let misspelt = |cluster: &Cluster| cluster.file("misspelt.dca", &IDLE.replace("{ idle }", "{ idel, idel }"));
    check_run(&misspelt, 1, &["error[E0201]: unknown process `idel`"]);
}

/// The errors of all verbs print a name on one line, whatever its characters.
#[test]
fn a_name_with_a_line_break() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let name = "no\nsu\tch";
    let node = here.node("c1", &[]);
    let spec = cluster.file("idle.dca", IDLE);
    let verbs: [&[&str]; 16] = [
        &["stop", name],
        &["attach", name],
        &["status", name],
        &["events", name],
        &["logs", name],
        &["replace", name, name],
        &["remove", name, name],
        &["switch", name, name, name],
        &["call", "idle:no\nsu\tch.Grip"],
        &["get", "no\nsu\tch:idle.state"],
        &["list", name],
        &["echo", "no\nsu\tch.Out"],
        &["param", "list", name],
        &["audit", name],
        &["check", &spec, "--no\nsu\tch"],
        &[name],
    ];
    for verb in verbs {
        let ended = here.ask(verb);
        let all = format!("{}{}", ended.err, ended.out);
        assert!(!all.contains("no\nsu") && !all.contains("su\tch"), "{verb:?}: {ended}");
    }
    end(node);
}

/// A process with a limited stack does not die from this limit.
#[test]
fn a_small_stack() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let spec = cluster.file("one.dca", &IDLE.replace("sleep 3600", "true").replace("plain;", "plain; done;"));
    let run_dir = here.run_dir().display().to_string();
    // The node starts by asking the controllers' programs for their interfaces.
    let node = here.node_under(&["prlimit", "--stack=65536"], "c1");
    for size in [16384, 65536] {
        for verb in [&["--help"][..], &["status", "--run-dir", &run_dir], &["check", &spec]] {
            let mut limited = Command::new("prlimit");
            limited.arg(format!("--stack={size}")).arg(executable("dca")).args(verb);
            // The environment also lies on the stack, and can be large.
            let limited = limited.env_clear().output().expect("util-linux is there");
            assert_eq!(limited.status.code(), Some(0), "{verb:?} with {size} B: {limited:?}");
        }
    }
    let done = here.ask(&["deploy", "--no-record", &spec]);
    assert_eq!(done.code, Some(0), "{done}");
    end(node);
}
