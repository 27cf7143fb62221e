//! The exports of running programs: `dca call` and `dca get`, from another program and from the command line.

use dca_tests::cluster::{Cluster, Host, Network, Program, SOON, Stream, executable, wait_until};
use rustix::process::Signal;
use serde_json::Value;

/// Wheels, a guard on top of them, and an endless trip. The guard waits for the wheels, so a call of the guard lasts as
/// long as the wheels are suspended.
const LEVELS: &str = "
process main() {
    host { c1 }
    instantiated_processes {
        wheels instof Wheels(c1);
        guard instof SpeedGuard(c1, limit = 0.5 m/s);
        trip instof Trip(c1, distance = 10000 m, speed = 2 m/s);
        idle instof Wheels(c1);
    }
    internal_connections { guard, Below -> wheels, Drive; trip, Drive -> guard, Drive; trip, Place -> wheels, place; }
    internal_event_actions { wheels, guard, (trip ; idle) }
}
";

/// Wheels, and nothing else.
const WHEELS: &str = "process main() { host { c1 } instantiated_processes { wheels instof Wheels(c1); }
    internal_event_actions { wheels } }";

fn deployed(cluster: &Cluster) -> (Host, [Program; 2]) {
    deployed_spec(cluster, "levels", LEVELS)
}

fn deployed_spec(cluster: &Cluster, name: &str, text: &str) -> (Host, [Program; 2]) {
    let here = cluster.here();
    let program = executable("dca-examples").display().to_string();
    let node = here.node("c1", &["--controllers", &program]);
    let file = cluster.file(&format!("{name}.dca"), text);
    let deploy = here.dca(&["deploy", "--no-record", "--controllers", &program, &file]);
    deploy.wait_for(Stream::Err, "▸", SOON);
    (here, [node, deploy])
}

/// Procedures are called with values in the form of a spec, and states are read. A program drives another one through a
/// third.
#[test]
fn what_is_exported_is_called_and_read() {
    let cluster = Cluster::new();
    let (here, _running) = deployed(&cluster);
    let driven = here.ask(&["call", "wheels.Drive", "speed=0.25 m/s", "--json", "--within", "60"]);
    assert_eq!(driven.code, Some(0), "{driven}");
    let value: Value = serde_json::from_str(driven.out.trim()).unwrap_or_else(|why| panic!("{why}: {driven}"));
    assert_eq!(value["name"], "levels:main/wheels.Drive", "{driven}");
    assert_eq!((&value["type"], &value["value"]["speed"]), (&"Place".into(), &0.25.into()), "{driven}");
    let listed = here.ask(&["list", "levels:"]);
    let cells: Vec<Vec<&str>> = listed.out.lines().map(|line| line.split_whitespace().take(3).collect()).collect();
    for row in [["levels:main/wheels", "Drive", "proc"], ["levels:main/wheels", "place", "state"]] {
        assert!(cells.contains(&row.to_vec()), "{listed}");
    }
    assert!(listed.out.contains("Go { speed: Speed } -> Place { travelled: Length, speed: Speed }"), "{listed}");
    // The trip asks for 2 m/s, and the guard allows half a metre each second.
    let moves = |_: &Value| true;
    let read = || {
        let got = here.ask(&["get", "levels:main/wheels.place", "--within", "60"]);
        assert_eq!(got.code, Some(0), "{got}");
        serde_json::from_str::<Value>(got.out.trim()).unwrap_or_else(|why| panic!("{why}: {got}"))
    };
    let first = read()["travelled"].as_f64().unwrap();
    let later = (0..200).map(|_| read()).find(|place| moves(place) && place["travelled"].as_f64().unwrap() > first);
    assert!(later.is_some_and(|place| place["speed"].as_f64().unwrap() <= 0.5), "it does not move");
}

/// A failed call gives the reason in one sentence, with the exit code of its cause.
#[test]
fn what_cannot_be_called_says_why() {
    let cluster = Cluster::new();
    let (here, _running) = deployed(&cluster);
    for (arguments, code, why) in [
        (&["call", "nobody.Drive"][..], 1, "no process `nobody` is running"),
        (&["call", "other:wheels.Drive"], 1, "no process `other:wheels` is running"),
        (&["call", "wheels.Fly"], 1, "it exports no `Fly`; its exports are `Drive`, `place`"),
        (&["call", "trip.Drive"], 1, "it exports no `Drive`; it exports nothing"),
        (&["call", "wheels.Drive"], 1, "its argument is missing; expected Go { speed: Speed }"),
        (&["call", "wheels.Drive", "speed=1 N"], 1, "expected Go { speed: Speed }"),
        (&["call", "wheels.Drive", "speed=20 m/s"], 1, "20 m/s is not a speed of these wheels"),
        (&["call", "idle.Drive", "speed=1 m/s"], 1, "`Drive` cannot answer now: its process does not run"),
        (&["get", "wheels.Drive"], 1, "`Drive` is a procedure; call it with `dca call wheels.Drive`"),
        (&["call", "wheels.place"], 1, "`place` is a state; read it with `dca get wheels.place`"),
        (&["call", "Drive"], 2, "names nothing to call"),
        (&["call", "wheels.Drive", "speed=1 m/s", "--within", "no"], 2, "expected a number of seconds"),
    ] {
        let asked = here.ask(arguments);
        assert!(asked.code == Some(code) && asked.err.contains(why), "{arguments:?}: {asked}");
    }
    // The states of an inactive program can still be read.
    let idle = here.ask(&["get", "idle.place", "--within", "60"]);
    assert!(idle.code == Some(0) && idle.out.contains("\"speed\":0.0"), "{idle}");
}

/// The result of a call is unknown if its program is suspended. The command reports this, and does not claim that
/// nothing happened.
#[test]
fn a_program_that_is_suspended_in_a_call() {
    let cluster = Cluster::new();
    // Other programs do not call the wheels. A trip gives up after a second, and then everything is stopped.
    let (here, _running) = deployed_spec(&cluster, "wheels", WHEELS);
    let wheels = cluster.expect_leaf("main/wheels");
    let first = here.ask(&["call", "wheels.Drive", "speed=0.1 m/s", "--within", "60"]);
    assert_eq!(first.code, Some(0), "{first}");
    wheels.signal(Signal::STOP);
    let late = here.ask(&["call", "wheels.Drive", "speed=0.1 m/s", "--within", "1"]);
    let told = "no answer within 1 s; the call may have been carried out";
    // A suspended program may also accept no new link.
    assert!(late.code == Some(3) && (late.err.contains(told) || late.err.contains("cannot reach")), "{late}");
    wheels.signal(Signal::CONT);
    let again = here.ask(&["call", "wheels.Drive", "speed=0.1 m/s", "--within", "60"]);
    assert_eq!(again.code, Some(0), "{again}");
}

/// A dead program is not dialled while its mission continues.
#[test]
fn a_program_that_is_dead() {
    let cluster = Cluster::new();
    let (here, _running) = deployed(&cluster);
    cluster.expect_leaf("main/idle").signal(Signal::KILL);
    // The node of the program may not have noticed yet.
    let call = || here.ask(&["call", "idle.Drive", "speed=0.1 m/s", "--within", "3600"]);
    wait_until(SOON, || call().err.contains("does not run"));
    let called = call();
    assert!(called.code == Some(1) && called.err.contains("`main/idle` does not run: dead: SIGKILL"), "{called}");
    let listed = here.ask(&["list"]);
    assert!(listed.code == Some(0) && listed.out.contains("levels:main/wheels"), "{listed}");
}

/// A program that has only just started is not reported as having no exports. A caller that has time waits for it.
#[test]
fn a_program_that_has_not_begun_yet() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let program = executable("dca-examples").display().to_string();
    let _node = here.node("c1", &["--controllers", &program]);
    let file = cluster.file("wheels.dca", WHEELS);
    let _deploy = here.dca(&["deploy", "--no-record", "--controllers", &program, &file]);
    let wheels = cluster.expect_leaf("main/wheels");
    wheels.signal(Signal::STOP);
    let early = here.ask(&["call", "wheels.Drive", "speed=0.1 m/s", "--within", "1"]);
    let told = ["`main/wheels` cannot be asked yet: it was", "cannot reach", "no answer within"];
    assert!(early.code == Some(3) && told.iter().any(|told| early.err.contains(told)), "{early}");
    wheels.signal(Signal::CONT);
    let later = here.ask(&["call", "wheels.Drive", "speed=0.1 m/s", "--within", "60"]);
    assert_eq!(later.code, Some(0), "{later}");
}

/// The caller of a program that is suspended and then killed hears of its end as soon as the program's node knows it.
#[test]
fn a_program_that_is_killed_before_it_answers() {
    let cluster = Cluster::new();
    let (here, [_node, deploy]) = deployed_spec(&cluster, "wheels", WHEELS);
    let wheels = cluster.expect_leaf("main/wheels");
    wheels.signal(Signal::STOP);
    // This command dials the program too, for its signals. The mission continues without it.
    deploy.kill();
    // The list shows a connection that is not yet accepted under the name of the socket.
    let folder = here.run_dir().display().to_string();
    let dialled = || {
        let sockets = std::fs::read_to_string("/proc/net/unix").expect("it can be read");
        sockets.lines().filter(|line| line.contains(&folder) && line.ends_with("/data.sock")).count()
    };
    let before = dialled();
    let call = here.dca(&["call", "wheels.Drive", "speed=0.1 m/s", "--within", "3600"]);
    wait_until(SOON, || dialled() > before).expect("the call has found the program, and dials it");
    wheels.signal(Signal::KILL);
    let ended = call.ended(SOON);
    assert!(ended.code == Some(1) && ended.err.contains("`main/wheels` ended before it could be asked"), "{ended}");
}

/// A program behind a cut link is unreachable. The answer does not claim that nothing happened there.
#[test]
fn a_program_behind_a_cut_link() {
    let cluster = Cluster::new();
    let Some(network) = Network::new(2) else { return };
    let program = executable("dca-examples").display().to_string();
    let hosts = [1, 2].map(|number| cluster.host(&network, number));
    let open = ["--lan", "--controllers", program.as_str()];
    let _nodes = [hosts[0].node("c1", &open), hosts[1].node("c2", &open)];
    let text = "process main() { host { c1 } instantiated_processes { wheels instof Wheels(c2); }
        internal_event_actions { wheels } }";
    let file = cluster.file("far.dca", text);
    let deploy = hosts[0].dca(&["deploy", "--no-record", "--controllers", &program, &file]);
    deploy.wait_for(Stream::Err, "▸", SOON);
    let driven = hosts[0].ask(&["call", "wheels.Drive", "speed=1 m/s", "--within", "60"]);
    assert_eq!(driven.code, Some(0), "{driven}");
    let watch = hosts[0].dca(&["get", "wheels.place", "--watch", "--within", "60"]);
    watch.wait_for(Stream::Out, "travelled", SOON);
    network.cut(2);
    let ended = watch.ended(SOON);
    let told = "the call may have been carried out";
    assert!(ended.code == Some(3) && ended.err.contains(told), "{ended}");
}

/// A command without an end of its own ends when its reader has gone. This holds with and without output, and also if
/// it cannot write.
#[test]
fn what_nobody_reads_ends() {
    let cluster = Cluster::new();
    let (here, _running) = deployed(&cluster);
    let dca = executable("dca").display().to_string();
    let ended = |arguments: &[&str], reader: &str| {
        // The limit of `timeout` matters only for a command that does not end.
        let script = format!("timeout 60 \"$@\" {reader}; exit ${{PIPESTATUS[0]}}");
        let mut command = std::process::Command::new("bash");
        command.args(["-c", &script, "bash", &dca]).args(arguments).arg("--run-dir").arg(here.run_dir());
        let ended = command.output().expect("there is a shell");
        (ended.status.code(), String::from_utf8_lossy(&ended.stderr).into_owned())
    };
    for arguments in [
        &["get", "idle.place", "--watch"][..],
        &["events", "-f"],
        &["status", "--watch"],
        &["logs", "-f", "main/idle"],
        &["db", "watch", "team/nothing"],
    ] {
        for reader in ["| head -n 1", "| true"] {
            if reader == "| true" || matches!(arguments[0], "get" | "events" | "status") {
                let (code, said) = ended(arguments, reader);
                assert_eq!(code, Some(0), "{arguments:?} {reader}: {said}");
            }
        }
    }
    let (code, said) = ended(&["get", "idle.place", "--watch"], "> /dev/full");
    assert!(code == Some(1) && said.contains("standard output: No space left"), "{code:?} {said}");
}
