//! The output and exit codes of `dca` on specs.

use dca_tests::cluster::{Cluster, Ended, SOON, Stream, executable, spec, wait_until};
use rustix::process::Signal;
use std::fs;
use std::io::{ErrorKind, Write};
use std::path::Path;
use std::process::{Command, Stdio};

fn check(file: &str) -> Ended {
    let path = format!("{}/../language/tests/corpus/{file}.dca", env!("CARGO_MANIFEST_DIR"));
    Cluster::new().here().ask(&["check", &path])
}

/// The listings of the paper are accepted as they were printed, with warnings and fixes and without errors.
#[test]
fn the_papers_listings_are_accepted() {
    for (file, programs) in [("paper_appendix_a", "19 programs"), ("paper_compliant_motion", "4 programs")] {
        let ended = check(file);
        assert_eq!(ended.code, Some(0), "{ended}");
        assert!(ended.out.contains(programs) && ended.out.contains("no errors"), "{ended}");
        assert!(ended.err.contains("warning[") && !ended.err.contains("error["), "{ended}");
    }
    assert!(check("paper_appendix_a").err.contains("= fix: replace with `motionctrl`"));
}

/// After all fixes of a listing, nothing is left to fix. With `--deny lenient-names`, every remaining lenient name is an error.
#[test]
fn fixes_make_the_listing_exact() {
    let cluster = Cluster::new();
    let listing = include_str!("../../../language/tests/corpus/paper_appendix_a.dca");
    let file = cluster.file("listing.dca", listing);
    let denied = cluster.here().ask(&["check", "--deny", "lenient-names", &file]);
    assert_eq!(denied.code, Some(1), "{denied}");
    let fixed = cluster.here().ask(&["check", "--fix", &file]);
    assert_eq!(fixed.code, Some(0), "{fixed}");
    let exact = cluster.here().ask(&["check", "--deny", "lenient-names", &file]);
    assert_eq!(exact.code, Some(0), "{exact}");
}

/// A misspelt instance, an unknown label and a recursive group are errors. Each comes with a suggestion.
#[test]
fn mistakes_are_errors_with_a_suggestion() {
    let cases = [
        ("E0201_unknown_process", "error[E0201]: unknown process `forcedato`", "did you mean `forcedata`?"),
        ("E0301_unknown_label", "error[E0301]: `forcedata` has no connection set `lbl1`", "replace with `lb11`"),
        ("E0102_recursive_group", "error[E0102]: `Search` contains itself: Search -> Retry -> Search", "run `p ;; p`"),
    ];
    for (file, error, suggestion) in cases {
        let ended = check(file);
        assert_eq!(ended.code, Some(1), "{ended}");
        assert!(ended.err.contains(error) && ended.err.contains(suggestion), "{ended}");
        assert!(ended.out.is_empty(), "{ended}");
    }
}

/// A root whose host and argument differ between robots.
const PATROL: &str = r#"
module Say(host: Host, word: Text) { exec "true"; plain; done; }
process main(robot: Host = c1, word: Text = "old") {
    host{robot}
    instantiated_processes { say instof Say(robot, word); }
    internal_event_actions { say }
}
"#;

/// `--set` gives parameters of `main` other values for a check, a proof and a run. The record of the run contains
/// them.
#[test]
fn parameters_of_the_root_are_set_for_one_robot() {
    let cluster = Cluster::new();
    let (here, file) = (cluster.here(), cluster.file("patrol.dca", PATROL));
    let runs = Path::new(&file).with_file_name("runs").display().to_string();
    let checked = here.ask(&["check", "--set", "robot=robot-2.local", &file]);
    assert!(checked.code == Some(0) && checked.out.contains("on robot-2.local: no errors"), "{checked}");
    let ran = here.ask(&["run", "--runs", &runs, "--set", "robot=r7", "--set", "word=now", &file]);
    assert_eq!(ran.code, Some(0), "{ran}");
    let record = fs::read_dir(&runs).expect("a record was kept").next().expect("it is there").expect("it can be read");
    let recorded = fs::read(record.path().join("run.mcap")).expect("the record can be read");
    let recorded = String::from_utf8_lossy(&recorded);
    assert!(recorded.contains("main(robot: Host = r7, word: Text = now)"), "the record has the spec that ran");
    let record = record.path().display().to_string();
    let conforms = here.ask(&["conform", "--set", "robot=r7", "--set", "word=now", &record, &file]);
    assert_eq!(conforms.code, Some(0), "{conforms}");
    let other = here.ask(&["conform", &record, &file]);
    assert!(other.code == Some(1) && other.err.contains("another version of the spec"), "{other}");
    let mistakes = [
        (["check", "--set", "robt=r7"], 1, "cannot set `robt`: `main` has no such parameter; did you mean `robot`?"),
        (["check", "--set", "robot"], 2, "write a name, `=` and a value"),
        (["check", "--fix", "--set=robot=r7"], 2, "cannot be used with"),
    ];
    for (arguments, code, why) in mistakes {
        let ended = here.ask(&[arguments.as_slice(), &[&file]].concat());
        assert!(ended.code == Some(code) && ended.err.contains(why), "{ended}");
    }
}

/// The exit code of `dca verify` shows whether everything holds, something fails, or a limit came first.
#[test]
fn proofs_have_their_exit_codes() {
    let corpus = |file: &str| format!("{}/../verify/tests/corpus/{file}.dca", env!("CARGO_MANIFEST_DIR"));
    let cluster = Cluster::new();
    let (good, bad) = (corpus("good/tidy_up"), corpus("bad/lock_cycle"));
    let cases = [
        (&["verify", &good][..], 0, "proved: every stop ends"),
        (&["verify", &bad], 1, "  3  `right_fetch` is done"),
        (&["verify", "--states", "5", &good], 4, "NOT DECIDED"),
        (&["fmea", &good], 0, "find_a"),
        (&["fmea", "--csv", &good], 0, "\"program\",\"fault\",\"while\""),
        (&["fmea", "--html", &good], 0, "<table>"),
        (&["fmea", "--markdown", &good], 0, "| program | fault | while |"),
        (&["fmea", "--json", &good], 0, "\"mission\":"),
        (&["fmea", "--faults", "2", &good], 0, "no worse than one of the two faults alone"),
        (&["fmea", "--faults", "2", "--states", "5", &good], 4, "looked at in"),
        (&["verify", "--json", "--threads", "2", &good], 0, "\"verdict\":\"proved\""),
        (&["verify", "--json", &bad], 1, "\"code\":\"E0811\""),
        (&["verify", "--export", "aut", &good], 0, "des (0, "),
        (&["verify", "--export", "dot", &good], 0, "digraph {"),
        (&["verify", "--export", "jani", &good], 0, "\"jani-version\": 1"),
        (&["verify", "--export", "mcrl2", &good], 0, "proc Plan("),
    ];
    for (arguments, code, text) in cases {
        let ended = cluster.here().ask(arguments);
        assert_eq!(ended.code, Some(code), "{ended}");
        assert!(ended.out.contains(text), "{ended}");
    }
    let picture = cluster.folder().join("story.svg");
    let drawn = cluster.here().ask(&["verify", "--svg", &picture.to_string_lossy(), &bad]);
    let picture = fs::read_to_string(&picture).expect("a picture was drawn");
    assert!(drawn.code == Some(1) && picture.ends_with("</svg>\n"), "{drawn}");
    let (file, script) = (cluster.file("own.dca", &fs::read_to_string(&good).unwrap()), cluster.file("script", ""));
    let over = [
        vec!["verify", "--svg", &file, &file],
        vec!["graph", &file, "-o", &file],
        vec!["sim", &file, "--seed", "1", "--chart", &file],
        vec!["sim", &file, "--script", &script, "--chart", &script],
        vec!["report", &file, "-o", &file],
    ];
    for words in over {
        let refused = cluster.here().ask(&words);
        assert!(refused.code == Some(2) && refused.err.contains("this command reads `"), "{refused}");
    }
    assert_eq!(fs::read(&file).unwrap(), fs::read(&good).unwrap());
    let nothing = cluster.here().ask(&["verify", "--svg", "nothing.svg", &good]);
    assert!(nothing.code == Some(0) && nothing.err.contains("no picture is written"), "{nothing}");
    let wrong = cluster.here().ask(&["fmea", "--csv", "--html", &good]);
    assert_eq!(wrong.code, Some(2), "{wrong}");
}

/// An unreadable part of a spec may contain a type, so nothing is printed.
#[test]
fn types_are_those_of_a_text_that_can_be_read() {
    let cluster = Cluster::new();
    for (text, code) in [
        ("type R = { a: Length };\nprocess main() { internal_event_actions { wait(1 s) } }", 0),
        ("type R = { a: Length };\nprocess main( {{{{ garbage", 1),
        ("type R = { a: Length };\ntype Q = { a: Length ", 1),
    ] {
        let file = cluster.file("types.dca", text);
        let printed = cluster.here().ask(&["types", "--python", &file]);
        assert!(printed.code == Some(code) && printed.out.contains("class R") == (code == 0), "{printed}");
    }
}

/// A wrong command results in its usage, and exit code 2.
#[test]
fn wrong_usage_has_its_own_code() {
    let cluster = Cluster::new();
    for arguments in [&["open", "door"][..], &["run"], &["check", "a.dca", "--quickly"]] {
        let ended = cluster.here().ask(arguments);
        assert_eq!(ended.code, Some(2), "{ended}");
        assert!(ended.err.contains("Usage: dca"), "{ended}");
    }
    for (arguments, why) in [
        (&["sim", "a.dca", "--seed", "1", "--faults", "101"][..], "101 is not in 0..=100"),
        (&["db", "history", "-n", "0"], "0 is not in 1.."),
    ] {
        let ended = cluster.here().ask(arguments);
        assert!(ended.code == Some(2) && ended.err.contains(why), "{ended}");
    }
}

/// Each program prints its version and its help on standard output.
#[test]
fn every_program_has_a_version_and_a_help() {
    for program in ["dca", "dca-node", "dca-shim", "dca-controller"] {
        for (argument, text) in [("--version", env!("CARGO_PKG_VERSION")), ("--help", "sage")] {
            let output = Command::new(executable(program)).arg(argument).output().expect("it can be executed");
            let said = String::from_utf8_lossy(&output.stdout);
            assert!(output.status.success() && said.contains(text), "{program} {argument}: {output:?}");
            assert!(argument == "--help" || said.starts_with(program), "{said}");
            assert!(output.stderr.is_empty(), "{output:?}");
            let says_origin = said.contains("(commit ") && said.contains(std::env::consts::ARCH);
            assert!(argument == "--help" || says_origin || !["dca", "dca-node"].contains(&program), "{said}");
        }
    }
}

/// An import succeeds, has missing parts or is refused. It never overwrites a file.
#[test]
fn imports_have_their_exit_codes_and_write_over_nothing() {
    let cluster = Cluster::new();
    let tree = |inside: &str| format!("<root BTCPP_format=\"4\"><BehaviorTree ID=\"T\">{inside}</BehaviorTree></root>");
    let whole = cluster.file("whole.xml", &tree("<Sequence><Action ID=\"Open\"/><Action ID=\"Drive\"/></Sequence>"));
    let spec = Path::new(&whole).with_file_name("whole.dca").display().to_string();
    let ended = cluster.here().ask(&["import", &whole, "-o", &spec]);
    assert!(ended.code == Some(0) && ended.err.is_empty(), "{ended}");
    assert_eq!(cluster.here().ask(&["check", &spec]).code, Some(0));
    let again = cluster.here().ask(&["import", &whole, "-o", &spec]);
    assert!(again.code == Some(2) && again.err.contains("give the spec another name"), "{again}");
    let part = cluster.file("part.xml", &tree("<Script code=\"a := 1\"/>"));
    let ended = cluster.here().ask(&["import", &part]);
    assert!(ended.code == Some(1) && ended.out.contains("// import: line 1"), "{ended}");
    assert!(ended.err.contains("part.xml:1:45: `Script` is a program that you have to write"), "{ended}");
    let wrong = cluster.file("wrong.xml", "<root><a></root>");
    let ended = cluster.here().ask(&["import", &wrong]);
    assert!(ended.code == Some(1) && ended.out.is_empty() && ended.err.contains("line 1, column 10"), "{ended}");
}

/// Included files are read, an installed package is found, and the user's arguments apply.
#[test]
fn a_launch_file_is_imported_with_the_files_that_it_includes() {
    let cluster = Cluster::new();
    let more = cluster.file("more.launch.yaml", "launch:\n- arg: {name: rate, default: '5'}\n- node: {pkg: cam, exec: cam, param: [{name: rate, value: $(var rate)}]}\n");
    let prefix = Path::new(&more).with_file_name("ros");
    fs::create_dir_all(prefix.join("share/ament_index/resource_index/packages")).expect("the folder is ours");
    fs::write(prefix.join("share/ament_index/resource_index/packages/nav"), "").expect("the folder is ours");
    let inside = "<include file=\"$(dirname)/more.launch.yaml\"/><node pkg=\"nav\" exec=\"nav\"><param from=\"$(find-pkg-share nav)/nav.yaml\"/></node>";
    let robot = cluster.file("robot.launch.xml", &format!("<launch>{inside}</launch>"));
    let spec = Path::new(&robot).with_file_name("robot.dca").display().to_string();
    let sourced = cluster.here().with_variable("AMENT_PREFIX_PATH", &prefix.display().to_string());
    let ended = sourced.ask(&["import", &robot, "--set", "rate=9", "--setup", "/opt/setup.bash", "-o", &spec]);
    assert!(ended.code == Some(0), "{ended}");
    let text = fs::read_to_string(&spec).expect("it was written");
    for part in ["main(robot: Host = c1, rate = 9)", "ros/share/nav/nav.yaml\"", "setup \"/opt/setup.bash\";"] {
        assert!(text.contains(part), "no {part:?} in\n{text}");
    }
    assert_eq!(cluster.here().ask(&["check", &spec]).code, Some(0));
    let ended = cluster.here().ask(&["import", &robot]);
    assert!(ended.code == Some(1) && ended.err.contains("package `nav` is not installed here"), "{ended}");
    let ended = cluster.here().ask(&["import", &robot, "--set", "speed=9"]);
    assert!(ended.code == Some(1) && ended.err.contains("has no argument `speed`"), "{ended}");
    let python = cluster.file("robot.launch.py", "pass");
    let ended = cluster.here().ask(&["import", &python]);
    assert!(ended.code == Some(1) && ended.err.contains("in XML and YAML"), "{ended}");
}

/// Programs that were copied without their companions name the missing companion.
#[test]
fn a_missing_companion_is_named() {
    let cluster = Cluster::new();
    let copy = |name: &str| {
        let to = cluster.folder().join(name);
        fs::copy(executable(name), &to).expect("there is room for a copy");
        to
    };
    let (dca, node) = (copy("dca"), copy("dca-node"));
    let spec = cluster.file(
        "lonely.dca",
        "process main(){ host{c1} instantiated_processes{ a instof Unknown(c1); } internal_event_actions{ a } }",
    );
    let ask = |program: &Path, arguments: &[&str]| {
        let output = Command::new(program).args(arguments).output().expect("it runs");
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let (code, err) = ask(&dca, &["check", &spec]);
    let missing = cluster.folder().join("dca-controller").display().to_string();
    assert!(code == Some(0) && err.contains(&format!("note: `{missing}`")), "{err}");
    let missing = cluster.folder().join("dca-shim").display().to_string();
    let place = cluster.folder().join("n").display().to_string();
    for (program, arguments) in
        [(&node, &["--name", "c1", "--run-dir", &place][..]), (&dca, &["run", "--no-record", &spec])]
    {
        let (code, err) = ask(program, arguments);
        assert!(code == Some(1) && err.contains(&format!("no program starts without `{missing}`")), "{err}");
    }
}

/// Runs `dca` with a text as its standard input.
fn piped(arguments: &[&str], text: &str) -> (Option<i32>, String, String) {
    let mut command = Command::new(executable("dca"));
    command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().expect("it can be executed");
    let written = child.stdin.take().expect("it is piped").write_all(text.as_bytes());
    // A command may refuse before it reads its input.
    assert!(written.is_ok() || written.is_err_and(|error| error.kind() == ErrorKind::BrokenPipe), "it takes its input");
    let output = child.wait_with_output().expect("it ends");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code(), text(&output.stdout), text(&output.stderr))
}

#[test]
fn a_spec_comes_over_standard_input() {
    let spec = "process  main() { host { c1 } }";
    let (code, out, err) = piped(&["check", "-"], spec);
    assert_eq!((code, out.as_str()), (Some(0), "<stdin>: 1 group, 0 programs, on c1: no errors\n"), "{err}");
    let (code, out, err) = piped(&["fmt", "-"], spec);
    assert!(code == Some(0) && out.starts_with("process main(){"), "{out}{err}");
    assert_eq!(piped(&["fmt", "-"], &out).1, out, "its own form is its form");
    assert_eq!(piped(&["fmt", "--check", "-"], &out).0, Some(0));
    assert_eq!(piped(&["fmt", "--check", "-"], spec).0, Some(1));
    let (code, _, err) = piped(&["check", "-"], "process main( {");
    assert!(code == Some(1) && err.contains("<stdin>:1:"), "{err}");
    let (code, _, err) = piped(&["fix", "-"], spec);
    assert!(code == Some(1) && err.contains("standard input cannot be rewritten"), "{err}");
}

/// The specs for beginners are correct and have no warnings.
#[test]
fn the_specs_have_no_warnings() {
    for name in ["compliant_motion", "door_locked", "door_opening", "door_recovery", "door_through"] {
        let (code, out, err) = piped(&["check", &spec(name)], "");
        assert!(code == Some(0) && out.ends_with(": no errors\n") && err.is_empty(), "{out}{err}");
    }
}

const IDLE: &str = "
module Idle(host) { exec \"sh -c 'echo here I am; exec sleep 3600'\"; plain; }
process main() { host { c1 } instantiated_processes { idle instof Idle(c1); } internal_event_actions { idle } }
";

/// The other verbs find the processes of `dca run`, just as if a node had them. Two runs at the same time are
/// independent of each other.
#[test]
fn what_runs_in_a_command_is_found_from_elsewhere() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let [one, two] = ["one", "two"].map(|name| {
        let file = cluster.file(&format!("{name}.dca"), IDLE);
        let run = here.dca(&["run", &file]);
        run.wait_for(Stream::Err, "▸", SOON);
        run
    });
    let nodes = here.ask(&["nodes"]);
    assert_eq!((nodes.code, nodes.out.matches("c1 ").count()), (Some(0), 2), "{nodes}");
    let status = here.ask(&["status"]);
    assert!(status.out.contains("one@1") && status.out.contains("two@1"), "{status}");
    let logs = here.ask(&["logs", "two:idle"]);
    assert_eq!((logs.code, logs.out.as_str()), (Some(0), "here I am\n"), "{logs}");
    let either = here.ask(&["logs", "idle"]);
    let told =
        "`idle` may be any of `one:main/idle`, `two:main/idle`; give more of the path, or the deployment before it";
    assert!(either.code == Some(1) && either.err.contains(told), "{either}");
    let forget = here.ask(&["stop", "one", "--forget"]);
    assert!(forget.code == Some(1) && forget.err.contains("`one@1` is running; `dca stop one` ends it"), "{forget}");
    let which = here.ask(&["db", "get", "robot/"]);
    assert!(which.code == Some(1) && which.err.contains("several `dca run` commands are running"), "{which}");
    let stop = here.ask(&["stop", "one"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    assert_eq!(one.ended(SOON).code, Some(1));
    assert!(two.is_running(), "the other goes on");
    // A suspended node exists, and no answer may deny this.
    two.signal(Signal::STOP);
    for verb in [&["nodes"][..], &["status"], &["stop", "two"]] {
        let silent = here.ask(verb);
        assert!(
            silent.code == Some(3) && silent.err.contains("`c1` runs on this machine and does not answer"),
            "{silent}"
        );
    }
    let logs = here.ask(&["logs", "two:idle"]);
    assert!(logs.code == Some(3) && logs.err.contains("does not answer") && logs.out.is_empty(), "{logs}");
    assert!(logs.err.contains("`--recorded` reads the latest record in `runs` instead"), "{logs}");
    let logs = here.ask(&["logs", "two@1:idle", "--recorded"]);
    assert!(logs.err.contains("this is the output of `main/idle` by the record in"), "{logs}");
    two.signal(Signal::CONT);
    let get = here.ask(&["db", "get", "robot/c1/deployments/two/1/begun"]);
    assert!(get.code == Some(0) && get.out.contains("programs"), "{get}");
    two.signal(Signal::INT);
    let ended = two.ended(SOON);
    assert_eq!(ended.code, Some(1), "{ended}");
    assert_eq!(here.ask(&["status"]).code, Some(3));
    cluster.expect_nothing_left(std::time::Duration::from_secs(2));
}

/// A node of this machine and a `dca run` may both have a host `c1` and a run `idle@1`. Both are shown, and each can be
/// chosen by its folder.
#[test]
fn a_run_beside_a_node_is_shown_and_can_be_chosen() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let node = here.node("c1", &[]);
    let file = cluster.file("idle.dca", IDLE);
    let (mission, run) = (here.mission(&file), here.dca(&["run", "--no-record", &file]));
    run.wait_for(Stream::Err, "▸", SOON);
    // The folder from the environment chooses no group of nodes.
    let usual = |arguments: &[&str]| {
        let mut command = Command::new(executable("dca"));
        command.args(arguments).env("DCA_RUN_DIR", here.run_dir()).current_dir(cluster.folder());
        let ended = command.output().expect("it starts");
        let text = |bytes: Vec<u8>| String::from_utf8_lossy(&bytes).into_owned();
        Ended { code: ended.status.code(), signal: None, out: text(ended.stdout), err: text(ended.stderr) }
    };
    let standing = here.run_dir().display().to_string();
    let inside = format!("{standing}/run+{}", run.pid());
    let status = usual(&["status"]);
    assert_eq!((status.code, status.out.matches("idle@1").count()), (Some(0), 2), "{status}");
    assert!(status.out.contains(&format!("nodes in `{standing}`:\nidle@1")), "{status}");
    assert!(status.out.contains(&format!("nodes in `{inside}`, of command {}:\nidle@1", run.pid())), "{status}");
    let choice = format!("choose one: `--run-dir {standing}` or `--run-dir {inside}`");
    for arguments in [
        &["stop", "idle"][..],
        &["stop", "idle@1"],
        &["logs", "idle"],
        &["ctl", "idle", "ask"],
        &["replace", "idle", "idle"],
        &["call", "idle.Grip"],
    ] {
        let several = usual(arguments);
        assert!(several.code == Some(1) && several.err.contains(&choice), "{arguments:?}: {several}");
    }
    let parameters = usual(&["param", "list"]);
    assert!(parameters.err.contains(&format!("others run: `--run-dir {inside}`")), "{parameters}");
    let chosen = usual(&["status", "--run-dir", &standing]);
    assert_eq!((chosen.code, chosen.out.matches("idle@1").count()), (Some(0), 1), "{chosen}");
    let stopped = usual(&["stop", "idle", "--run-dir", &inside]);
    assert_eq!((stopped.code, run.ended(SOON).code), (Some(0), Some(1)), "{stopped}");
    assert!(mission.is_running(), "the mission of the node continues");
    let stopped = usual(&["stop", "idle", "--run-dir", &standing]);
    assert_eq!((stopped.code, mission.ended(SOON).code), (Some(0), Some(1)), "{stopped}");
    node.signal(Signal::TERM);
    node.ended(SOON);
}

/// A member may abort while the others of `a , b` continue. It then looks different from a member that waits for its
/// turn.
#[test]
fn a_member_that_has_aborted_is_not_merely_idle() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let text = "module Fails(host) { exec \"sh -c 'exit 3'\"; plain; }
        module Goes(host) { exec \"sleep 600\"; plain; }
        process main() {
            host { c1 }
            instantiated_processes { a instof Fails(c1); b instof Goes(c1); }
            internal_event_actions { a , b }
        }";
    let _deploying = here.dca(&["deploy", &cluster.file("both.dca", text)]);
    let tells = || here.ask(&["status"]).out.contains("idle, aborted: left with exit code 3");
    assert!(wait_until(SOON, tells).is_some(), "{}", here.ask(&["status"]));
}
