//! Parameters of running controllers: values from the database take effect, and meaningless values are refused.

use controllers::sdk::Quantity;
use dca_tests::cluster::{Cluster, Host, Program, SOON, Stream, Trace, pass, spec, wait_until};
use dca_tests::hit_detector;
use language::plan::Accepts;
use node::logic::protocol::Change;
use rustix::process::Signal;
use std::time::Duration;

/// The documented key. It contains the names of the deployment and of the instance.
const KEY: &str = "robot/c3/params/door_opening/hit/force/threshold";

/// A visitor pushes the hand repeatedly with up to 60 N, until the push is noticed.
const SPEC: &str = concat!(
    "\n",
    hit_detector!("2 N"),
    r#"
process main(){
    host{c3}
    instantiated_processes{
        world instof DoorWorld(c3, push_at = 0 s, push = 60 N);
        hit instof HitDetector(c3);
    }
    internal_event_actions{
        ((world # wait(4 s)) ;; skip) # hit
    }
}
"#
);

/// Starts a node `c3` with the mission on it.
fn deploy(cluster: &Cluster) -> (Host, Program, Program) {
    deploy_with(cluster, "150.0")
}

/// Starts them like [`deploy`], with another threshold in the database.
fn deploy_with(cluster: &Cluster, threshold: &str) -> (Host, Program, Program) {
    let here = cluster.here();
    let node = here.node("c3", &[]);
    let file = cluster.file("door_opening.dca", SPEC);
    // Before the program runs, it is unknown whether such a parameter exists. The value takes effect anyway.
    let early = here.ask(&["db", "put", KEY, threshold]);
    assert_eq!(early.code, Some(0), "{early}");
    assert!(early.err.contains("note: `door_opening` does not run on `c3` now"), "{early}");
    // A value that no program uses is refused as soon as this is known.
    let misspelt = KEY.replace("threshold", "treshold");
    let early = here.ask(&["db", "put", &misspelt, "5.0"]);
    assert_eq!(early.code, Some(0), "{early}");
    let refused = here.ask(&["deploy", "--no-record", &file]);
    assert_eq!(refused.code, Some(1), "{refused}");
    let why =
        ["has no parameter `treshold` to change; did you mean `threshold`?", &format!("`dca db delete {misspelt}`")];
    assert!(why.iter().all(|why| refused.err.contains(why)), "{refused}");
    assert_eq!(here.ask(&["db", "delete", &misspelt]).code, Some(0));
    let mission = here.dca(&["deploy", "--no-record", &file]);
    let runs = || here.processes(&[]).iter().any(|(_, one)| one.path == "main/hit/force" && one.state == "running");
    assert!(wait_until(SOON, runs).is_some(), "{}", mission.text(Stream::Err));
    (here, node, mission)
}

#[test]
fn the_documented_parameter_changes_what_a_controller_does_while_it_runs() {
    let cluster = Cluster::new();
    let (here, _node, mission) = deploy(&cluster);
    let value = || here.ask(&["param", "get", "hit/force", "threshold"]);
    assert_eq!(value().out, "150.0\n");
    let told =
        format!("`{KEY}` is 150.0 N in the database, the spec says 0 N; `dca param unset door_opening:hit/force");
    assert!(mission.text(Stream::Err).contains(&told), "{}", mission.text(Stream::Err));
    // Another terminal shows the same.
    let attached = here.dca(&["attach", "door_opening"]);
    attached.wait_for(Stream::Err, "▸", SOON);
    // This takes a whole push, and the next one. The threshold of 150 N is never exceeded.
    pass(Duration::from_secs(6));
    assert!(mission.is_running(), "{}{}", mission.text(Stream::Out), mission.text(Stream::Err));
    let changed = here.ask(&["db", "put", KEY, "5.0", "-m", "it has to feel a push"]);
    assert!(changed.code == Some(0) && !changed.err.contains("does not run"), "{changed}");
    for watching in [mission, attached] {
        let ended = watching.ended(Duration::from_secs(60));
        assert_eq!(ended.code, Some(0), "{ended}");
        assert!(ended.out.contains("hit/force was told that `threshold` is 5.0"), "{ended}");
    }
    // A change remains, and can be taken back while nothing runs.
    for (name, code, why) in [
        ("hit/forse", 1, "no program `hit/forse` runs"),
        ("door_opening/hit/force", 0, "is deleted"),
        ("hit/force", 1, "no program `hit/force` runs"),
    ] {
        let unset = here.ask(&["param", "unset", name, "threshold"]);
        assert!(unset.code == Some(code) && unset.err.contains(why), "{unset}");
    }
}

#[test]
fn what_no_controller_takes_is_refused() {
    let cluster = Cluster::new();
    let (here, _node, mission) = deploy(&cluster);
    let check = |arguments: &[&str], code: i32, why: &str| {
        let ended = here.ask(arguments);
        assert_eq!(ended.code, Some(code), "{arguments:?}: {ended}");
        assert!(ended.err.contains(why) || ended.out.contains(why), "{arguments:?}: {ended}");
    };
    let base = "robot/c3/params/door_opening";
    check(&["db", "put", KEY, "500.0"], 1, "`threshold` cannot be `500.0`: expected a Force from 0 to 200 N");
    check(&["db", "put", KEY, "\"much\""], 1, "`threshold` cannot be `much`");
    check(&["db", "put", &format!("{base}/hit/force/treshold"), "5.0"], 1, "did you mean `threshold`?");
    check(&["db", "put", &format!("{base}/hit/forse/threshold"), "5.0"], 1, "has no program `hit/forse` on `c3`");
    check(&["db", "put", &format!("{base}/threshold"), "5.0"], 1, "`robot/HOST/params/DEPLOYMENT/INSTANCE/PARAMETER`");
    let file = cluster.file("tx", &format!("put {base}/world/radius 9.0\n"));
    check(&["db", "tx", &file], 1, "expected a Length from 0.5 to 1.2 m");
    check(&["param", "set", "hit/force", "threshold", "500"], 1, "expected a Force from 0 to 200 N");
    check(&["param", "set", "hit/force", "treshold", "5"], 1, "did you mean `threshold`?");
    check(&["param", "set", "hit/forse", "threshold", "5"], 1, "did you mean `hit/force`?");
    check(&["param", "get", "world", "radios"], 1, "did you mean `radius`?");
    check(&["param", "get", "world", "radius"], 0, "0.82");
    for name in ["door_opening:main/hit/force", "door_opening@1:force", "door_opening/hit/force", "main/hit/force"] {
        check(&["param", "get", name, "zero"], 0, "\"keep\"");
    }
    check(&["param", "list", "nobody"], 1, "no program `nobody` runs");
    let list = here.ask(&["param", "list", "hit/force"]);
    let rows: Vec<Vec<&str>> =
        list.out.lines().map(|line| line.split("  ").filter(|cell| !cell.is_empty()).collect()).collect();
    let cells = |row: usize| rows[row].iter().map(|cell| cell.trim()).collect::<Vec<_>>();
    assert_eq!(cells(1), ["door_opening:main/hit/force", "zero", "\"keep\"", "\"keep\"", "keep | zero"], "{list}");
    assert_eq!(
        cells(2),
        ["door_opening:main/hit/force", "threshold", "150.0 N", "0.0 N", "Force in 0 N..200 N"],
        "{list}"
    );
    // This changes the existing key, and does not make another one with a different precedence.
    check(&["param", "set", "hit/force", "threshold", "140"], 0, KEY);
    check(&["db", "get", KEY], 0, "140.0");
    check(&["param", "unset", "hit/threshold", "threshold"], 1, "was not changed");
    check(&["param", "unset", "hit/force", "threshold"], 0, KEY);
    // Without a threshold, the push is noticed.
    let ended = mission.ended(Duration::from_secs(60));
    assert_eq!(ended.code, Some(0), "{ended}");
}

/// The real door has the documented parameter. An argument out of the parameter's range makes the spec invalid.
#[test]
fn arguments_are_compared_with_the_interfaces() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let door = std::fs::read_to_string(spec("door_opening")).unwrap();
    for (from, to, why) in [
        (
            "ForceTorque(host1, \"zero\")",
            "ForceTorque(host1, \"zero\", threshold = 500 N)",
            "`threshold` is 500 N: expected a value from 0 N to 200 N",
        ),
        (
            "GripperControl(host3, \"open\")",
            "GripperControl(host3, \"ajar\")",
            "`goal` is \"ajar\": expected one of \"open\", \"close\"",
        ),
        ("DoorWorld(\"c3\")", "DoorWorld(\"c3\", radios = 1)", "has no parameter `radios`"),
    ] {
        assert!(door.contains(from), "{from}");
        let file = cluster.file("door.dca", &door.replace(from, to));
        let refused = here.ask(&["check", &file]);
        assert_eq!(refused.code, Some(1), "{refused}");
        assert!(refused.err.contains(why), "{why}: {refused}");
    }
    let file = cluster.file(
        "door.dca",
        &door.replace("ForceTorque(host1, \"zero\")", "ForceTorque(host1, \"zero\", threshold = 3 N)"),
    );
    assert_eq!(here.ask(&["check", &file]).code, Some(0));
}

/// A length is not a force, wherever it is written. A force arrives in newtons.
#[test]
fn a_quantity_of_another_kind_is_refused_everywhere() {
    let cluster = Cluster::new();
    let here = cluster.here();
    for (threshold, why) in [
        ("20 m", "`threshold` is of type Force: expected a quantity such as `20 N`"),
        ("20 m", "= help: write it in `N` or `kN`"),
        ("20", "= help: in SI units it is `20 N`"),
    ] {
        let file = cluster.file("door.dca", &SPEC.replace("2 N", threshold));
        let refused = here.ask(&["check", &file]);
        assert!(refused.code == Some(1) && refused.err.contains(why), "{why}: {refused}");
    }
    // The value is stored with a unit before its parameter is known. The program receives newtons.
    let (here, _node, mission) = deploy_with(&cluster, "0.15 kN");
    let why = "`threshold` cannot be `20 m`: expected a Force from 0 to 200 N, not a Length; write it in `N` or `kN`";
    let tx = cluster.file("tx", &format!("put {KEY} 20 m\n"));
    let below = KEY.rsplit_once('/').unwrap().0;
    let import = cluster
        .file("import.toml", &format!("format = 1\nbelow = \"{below}/\"\n[values]\n\"{KEY}\" = \"20 m\"\n# end\n"));
    for arguments in [
        &["db", "put", KEY, "20 m"][..],
        &["db", "put", KEY, "\"20 m\""],
        &["db", "put", "--text", KEY, "20 m"],
        &["db", "tx", &tx],
        &["db", "import", &import],
        &["param", "set", "hit/force", "threshold", "20 m"],
    ] {
        let refused = here.ask(arguments);
        assert!(refused.code == Some(1) && refused.err.contains(why), "{arguments:?}: {refused}");
    }
    let value = || here.ask(&["param", "get", "hit/force", "threshold"]).out;
    assert_eq!(value(), "150.0\n");
    // The value takes effect: no push of 60 N is noticed.
    pass(Duration::from_secs(6));
    assert!(mission.is_running(), "{}{}", mission.text(Stream::Out), mission.text(Stream::Err));
    let set = here.ask(&["param", "set", "hit/force", "threshold", "0.14 kN"]);
    assert_eq!((set.code, here.ask(&["db", "get", KEY]).out.contains("140.0")), (Some(0), true), "{set}");
    let put = here.ask(&["db", "put", KEY, "5 N"]);
    assert_eq!(put.code, Some(0), "{put}");
    let ended = mission.ended(Duration::from_secs(60));
    assert_eq!(ended.code, Some(0), "{ended}");
    assert!(ended.out.contains("hit/force was told that `threshold` is 5"), "{ended}");
}

/// The SDK has the quantities of the language, with the same names and units.
#[test]
fn the_quantities_of_the_sdk_are_those_of_the_language() {
    for quantity in Quantity::ALL {
        let text = format!("module A(host: Host, a: {} in 1 {}..) {{ done; }}", quantity.name(), quantity.unit());
        let declared = language::parameters(&[language::Source::new("a", text)]);
        let [parameter] = declared["A"].as_deref().unwrap() else { panic!("one parameter: {declared:?}") };
        let expected = Accepts::Quantity { of: quantity.name().to_owned(), low: Some(1.0), high: None };
        assert_eq!((&parameter.accepts, parameter.accepts.unit().as_deref()), (&expected, Some(quantity.unit())));
    }
    let declared = language::parameters(&[language::Source::new("a", "module A(host: Host, a: Number) { done; }")]);
    assert_eq!(declared["A"].as_deref().unwrap()[0].accepts, Accepts::Number, "an older interface means what it did");
}

/// A key is not a path in a file system. A key with `..` is an error.
#[test]
fn a_key_that_walks_is_refused() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let file = cluster.file("tx", "put team/../a 1.0\n");
    for (arguments, why) in [
        (&["db", "put", "team/../a", "1.0"][..], "the key `team/../a` has a segment `..`"),
        (&["db", "put", "team/.", "1.0"], "the key `team/.` has a segment `.`"),
        (&["db", "put", "..", "1.0"], "the key `..` has a segment `..`"),
        (&["db", "get", "team/../a"], "the key `team/../a` has a segment `..`"),
        (&["db", "get", "team/../"], "the key `team/..` has a segment `..`"),
        (&["db", "get", "team//"], "the key `team/` has an empty segment"),
        (&["db", "watch", "team/./a"], "the key `team/./a` has a segment `.`"),
        (&["db", "history", "team/../a"], "the key `team/../a` has a segment `..`"),
        (&["db", "tx", &file], "the key `team/../a` has a segment `..`"),
        (&["db", "put", "team//a", "1.0"], "the key `team//a` has an empty segment"),
        (&["db", "put", "team/\u{7}", "1.0"], "has a forbidden character: '\\u{7}'"),
    ] {
        let refused = here.ask(arguments);
        assert!(refused.code == Some(1) && refused.err.contains(why), "{arguments:?}: {refused}");
    }
    for good in ["team/...", "team/a..b", "team/.a"] {
        assert_eq!(here.ask(&["db", "put", good, "1.0"]).code, Some(0), "{good}");
    }
}

/// If a parameter is changed while a mission runs, the change is in the record, and a viewer shows it.
#[test]
fn a_change_of_a_parameter_is_in_the_record() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c3", &[]);
    let spec = SPEC.replace("ForceTorque(host1)", "ForceTorque(host1, threshold = 150 N)");
    let file = cluster.file("door_opening.dca", &spec);
    let mission = here.dca(&["deploy", &file]);
    let runs = || here.processes(&[]).iter().any(|(_, one)| one.path == "main/hit/force" && one.state == "running");
    assert!(wait_until(SOON, runs).is_some(), "{}", mission.text(Stream::Err));
    let set = here.ask(&["param", "set", "hit/force", "threshold", "140"]);
    assert_eq!(set.code, Some(0), "{set}");
    let folder = cluster.folder().join("runs/door_opening-1");
    let is_told = || {
        let trace = Trace::so_far(&folder);
        trace.changes("main/hit/force").iter().any(|change| matches!(change, Change::Configured { .. }))
    };
    wait_until(SOON, is_told).unwrap_or_else(|| panic!("{}", mission.text(Stream::Err)));
    let stop = here.ask(&["stop", "door_opening"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    let ended = mission.ended(SOON);
    let bytes = std::fs::read(folder.join("run.mcap")).expect("there is a record");
    let rows = mcap::MessageStream::new(&bytes).expect("it is a record").map(|message| message.expect("it is whole"));
    let rows = rows.filter(|message| message.channel.topic == "/events");
    let rows: Vec<serde_json::Value> =
        rows.map(|message| serde_json::from_slice(&message.data).expect("it is JSON")).collect();
    let configured: Vec<_> = rows.iter().filter(|row| row["kind"] == "configured").collect();
    let [row] = configured[..] else { panic!("one row: {rows:#?}\n{ended}") };
    assert_eq!(row["process"], "main/hit/force", "{row}");
    assert!(row["text"].as_str().is_some_and(|text| text.contains("`threshold` is 140")), "{row}");
    assert!(ended.out.contains("hit/force was told that `threshold` is 140"), "{ended}");
}

/// It is unknown whether a program runs on a host that does not answer, so the answer does not deny it.
#[test]
fn a_program_on_a_host_that_does_not_answer_is_not_denied() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let nodes = ["c1", "c3"].map(|name| here.node(name, &[]));
    let text = SPEC.replace("process main(){\n    host{c3}", "process main(){\n    host{c1}").replace("2 N", "150 N");
    let _mission = here.dca(&["deploy", "--no-record", &cluster.file("door_opening.dca", &text)]);
    let list = || here.ask(&["param", "list"]);
    assert!(wait_until(SOON, || list().out.contains("hit/threshold")).is_some(), "{}", list());
    nodes[1].signal(Signal::STOP);
    let is_told = || list().err.contains("warning: `c3` ");
    assert!(wait_until(SOON, is_told).is_some(), "{}", list());
    for arguments in [&["set", "hit/threshold", "threshold", "20 N"][..], &["get", "hit/threshold", "threshold"]] {
        let asked = here.ask(&[&["param"], arguments].concat());
        assert!(asked.code == Some(3) && asked.err.contains("`c3` does not answer, and it may run there"), "{asked}");
    }
    nodes[1].signal(Signal::CONT);
}
