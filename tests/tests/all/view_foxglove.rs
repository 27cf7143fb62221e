//! `dca view --foxglove`: topics, parameters and services of a running mission for Foxglove, and malicious clients.
//!
//! The client in these tests writes its frames itself, so it shares no code with the server. A long test uses Foxglove's own client.

mod client;

use client::{Client, Message, handshake, open};
use dca_tests::cluster::{Cluster, Host, Program, SOON, Stream, executable, pass, wait_until};
use dca_tests::made_team::MadeTeam;
use rustix::process::Signal;
use serde_json::{Value, json};
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

/// A source of 100 values each second, a monitor with signals, wheels with a procedure, and a guard with a parameter.
const SPEC: &str = "
process main() {
    host { c1 }
    instantiated_processes {
        beat instof RateSource(c1);
        monitor instof RateMonitor(c1);
        wheels instof Wheels(c1);
        guard instof SpeedGuard(c1, limit = 0.5 m/s);
    }
    internal_connections { guard, Below -> wheels, Drive; }
    internal_connections(beat, on) { beat, Out -> monitor, In; }
    internal_event_actions { beat, monitor, wheels, guard }
}
";

/// A view, and the address where it listens.
struct View {
    view: Program,
    address: String,
}

impl View {
    fn open(here: &Host) -> Self {
        Self::of(here.dca(&["view", "--foxglove", "127.0.0.1:0"]))
    }

    /// Returns a view from a command that serves clients.
    fn of(view: Program) -> Self {
        view.wait_for(Stream::Out, "\n", SOON);
        view.wait_for(Stream::Err, "Ctrl-C", SOON);
        let link = view.text(Stream::Out);
        let port = link.trim().strip_prefix("ws://localhost:").expect("it is an address").to_owned();
        Self { view, address: format!("127.0.0.1:{port}") }
    }
}

fn deployed(cluster: &Cluster) -> (Host, [Program; 2]) {
    let here = cluster.here();
    let node = idle(&here);
    let mission = deploy(cluster, &here);
    (here, [node, mission])
}

/// Starts a node.
fn idle(here: &Host) -> Program {
    let [controller, examples] = programs();
    here.node("c1", &["--controllers", &controller, "--controllers", &examples])
}

fn deploy(cluster: &Cluster, here: &Host) -> Program {
    let ([controller, examples], file) = (programs(), cluster.file("door.dca", SPEC));
    let deploy = here.dca(&["deploy", "--no-record", "--controllers", &controller, "--controllers", &examples, &file]);
    deploy.wait_for(Stream::Err, "▸", SOON);
    deploy
}

fn programs() -> [String; 2] {
    ["dca-controller", "dca-examples"].map(|name| executable(name).display().to_string())
}

/// The session to programs is open by then, so programs describe themselves at once.
#[test]
fn a_client_after_one_that_left_while_nothing_ran_gets_the_ports() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = idle(&here);
    let view = View::open(&here);
    let mut first = Client::connect(&view.address);
    first.channel("/events");
    drop(first);
    let _mission = deploy(&cluster, &here);
    let mut next = Client::connect(&view.address);
    next.channel("/ports/main/beat/Out");
}

#[test]
fn a_mission_is_seen_changed_and_stopped_by_a_client() {
    let cluster = Cluster::new();
    let (here, [_node, mission]) = deployed(&cluster);
    let view = View::open(&here);
    let mut client = Client::connect(&view.address);
    let info = client.word("serverInfo");
    assert_eq!(info["capabilities"], json!(["parameters", "parametersSubscribe", "services"]));
    // Values have the fields of their schema. If the program does not declare the type of a value, the value comes as its bytes.
    let beat = client.channel("/ports/main/beat/Out");
    assert_eq!((&beat["encoding"], &beat["schemaName"]), (&json!("json"), &json!("dca.Encoded")));
    client.subscribe(1, &beat);
    let value = client.value(1);
    assert!(value["size"].is_number() && value["bytes"].is_string(), "{value}");
    let signals = client.channel("/signals/main/monitor");
    let schema: Value = serde_json::from_str(signals["schema"].as_str().expect("it is text")).expect("it is JSON");
    client.subscribe(4, &signals);
    let value = client.value(4);
    let fields = value.as_object().expect("it has fields");
    let is_typed = |field: &String| schema["properties"][field]["type"] == "number" && value[field].is_number();
    assert!(fields.len() > 1 && fields.keys().all(is_typed), "{value} {schema}");
    // The states of all processes, at once.
    let mission_topic = client.channel("/mission");
    client.subscribe(2, &mission_topic);
    let state = client.value(2);
    let paths: Vec<&str> =
        state["processes"].as_array().into_iter().flatten().filter_map(|one| one["path"].as_str()).collect();
    assert!(
        paths.contains(&"main/wheels") && state["deployment"].as_str().is_some_and(|name| name.starts_with("door@")),
        "{state}"
    );
    let events = client.channel("/events");
    client.subscribe(3, &events);
    assert!(client.value(3)["text"].is_string());
    // Parameters are read, set in the database, and refused with a reason.
    let limit = "door:main/guard.limit";
    client.send(&json!({ "op": "getParameters", "parameterNames": [limit], "id": "read" }));
    let read = client.word("parameterValues");
    assert_eq!((&read["id"], &read["parameters"][0]["value"]), (&json!("read"), &json!(0.5)), "{read}");
    client.send(&json!({ "op": "setParameters", "parameters": [{ "name": limit, "value": 0.25 }], "id": "set" }));
    let set = client.word("parameterValues");
    assert_eq!((&set["id"], &set["parameters"][0]["value"]), (&json!("set"), &json!(0.25)), "{set}");
    assert_eq!(here.ask(&["param", "get", "guard", "limit"]).out, "0.25\n");
    client.send(&json!({ "op": "setParameters", "parameters": [{ "name": limit, "value": "far" }], "id": "bad" }));
    let kept = client.word("parameterValues");
    assert_eq!(kept["parameters"][0]["value"], json!(0.25), "{kept}");
    let status = client.word("status");
    assert!(status["message"].as_str().is_some_and(|text| text.contains("was not set: expected")), "{status}");
    client.send(&json!({ "op": "setParameters", "parameters": [{ "name": limit }], "id": "unset" }));
    let unset = client.word("parameterValues");
    assert_eq!(unset["parameters"][0]["value"], json!(0.5), "{unset}");
    // A procedure is called with JSON, and an error has its own sentence.
    let drive = client.service("/calls/main/wheels/Drive");
    let Message::Response(driven) = client.call(drive, 1, &json!({ "speed": 0.25 })) else { panic!("it drives") };
    assert_eq!(driven["speed"], json!(0.25), "{driven}");
    let Message::Word(refused) = client.call(drive, 2, &json!({ "speed": "fast" })) else { panic!("it is refused") };
    assert_eq!((&refused["op"], &refused["callId"]), (&json!("serviceCallFailure"), &json!(2)), "{refused}");
    let Message::Word(refused) = client.call(drive, 3, &json!({ "speed": 20 })) else { panic!("it is refused") };
    assert!(refused["message"].as_str().is_some_and(|text| text.contains("not a speed of these wheels")), "{refused}");
    // A stop names the hosts that have not confirmed it. Then the topics of the programs disappear.
    let stop = client.service("/dca/stop");
    let Message::Response(stopped) = client.call(stop, 4, &json!({ "deployment": "door" })) else { panic!("it stops") };
    assert_eq!((&stopped["confirmed"], &stopped["unconfirmed"]), (&json!(true), &json!([])), "{stopped}");
    assert!(wait_until(SOON, || here.pids().is_empty()).is_some());
    client.gone(&beat);
    let Message::Word(again) = client.call(stop, 5, &json!({ "deployment": "door" })) else { panic!("it is stopped") };
    assert_eq!(again["op"], "serviceCallFailure", "{again}");
    drop(mission);
    view.view.signal(Signal::INT);
    assert_eq!(view.view.ended(SOON).code, Some(0));
    client.ended();
}

#[test]
fn an_estop_from_a_client_is_confirmed_by_each_host() {
    let cluster = Cluster::new();
    let (here, _running) = deployed(&cluster);
    let view = View::open(&here);
    let mut client = Client::connect(&view.address);
    let estop = client.service("/dca/estop");
    let Message::Response(stopped) = client.call(estop, 1, &json!({ "reason": "a person" })) else {
        panic!("it stops")
    };
    assert_eq!(stopped["confirmed"], json!(true), "{stopped}");
    assert_eq!(stopped["hosts"], json!([{ "host": "c1", "stopped": true, "unended": [], "unwritten": null }]));
    assert!(wait_until(SOON, || here.pids().is_empty()).is_some());
    let Message::Response(released) = client.call(estop, 2, &json!({ "release": true })) else { panic!("it releases") };
    assert_eq!((&released["confirmed"], &released["hosts"][0]["released"]), (&json!(true), &json!(true)), "{released}");
}

/// In a team, every user can stop everything without a key. A release needs a key, and the answer says that it was refused.
#[test]
fn in_a_team_orders_have_the_rights_of_the_user() {
    let (cluster, team) = (Cluster::new(), MadeTeam::default());
    let here = cluster.here();
    team.admit(&here, "c1");
    let _node = here.node("c1", &[]);
    let view = View::open(&here);
    let mut client = Client::connect(&view.address);
    let estop = client.service("/dca/estop");
    let Message::Response(stopped) = client.call(estop, 1, &json!({})) else { panic!("it stops") };
    assert_eq!(stopped["confirmed"], json!(true), "{stopped}");
    let Message::Response(refused) = client.call(estop, 2, &json!({ "release": true })) else {
        panic!("it is refused")
    };
    assert_eq!(refused["confirmed"], json!(false), "{refused}");
    assert!(refused["hosts"][0]["refused"].as_str().is_some_and(|why| why.contains("you have no key")), "{refused}");
    let status = here.ask(&["status"]);
    assert!(status.out.contains("everything was stopped by "), "{status}");
}

/// Returns the panels of one type in a layout, with their settings.
fn panels(layout: &Value, kind: &str) -> Vec<Value> {
    let all = layout["configById"].as_object().expect("a layout has panels");
    all.iter().filter(|(id, _)| id.starts_with(kind)).map(|(_, panel)| panel.clone()).collect()
}

fn read_layout(file: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(file).expect("it was written")).expect("it is JSON")
}

/// A client plays the record of a run, pauses it, and jumps in it. A layout has panels for the record's topics.
#[test]
fn a_record_is_played_and_searched_by_a_client() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let programs = ["dca-controller", "dca-examples"].map(|name| executable(name).display().to_string());
    let [controller, examples] = &programs;
    let ending = "internal_event_actions { (beat, monitor, wheels, guard) # wait(1 s) }";
    let file =
        cluster.file("door.dca", &SPEC.replace("internal_event_actions { beat, monitor, wheels, guard }", ending));
    let arguments = ["run", "--record", "all", "--controllers", controller, "--controllers", examples, &file];
    let ended = here.dca(&arguments).ended(SOON);
    assert_eq!(ended.code, Some(0), "{ended}");
    let view = View::of(here.dca(&["replay", "runs/door-1", "--foxglove", "127.0.0.1:0"]));
    let mut client = Client::connect(&view.address);
    let info = client.word("serverInfo");
    assert_eq!(info["capabilities"], json!(["time", "playbackControl", "services"]), "{info}");
    let time = |name: &str| {
        let part = |part: &str| info[name][part].as_u64().expect("it is a number");
        Duration::from_secs(part("sec")) + Duration::from_nanos(part("nsec"))
    };
    let (begin, end) = (time("dataStartTime"), time("dataEndTime"));
    assert!(end >= begin + Duration::from_secs(1), "{info}");
    assert_eq!(client.playback(1).at, begin, "it waits for a subscription");
    let monitor = client.channel("/signals/main/monitor");
    client.subscribe(1, &monitor);
    assert_eq!(client.playback(0).at, begin);
    assert!(client.value(1)["stamp"].is_number());
    client.control(false, 1.0, None, "pause");
    assert_eq!(client.playback(1).request, "pause");
    // After a jump, a client receives the last value of each channel. Here it is the last event of the run.
    let events = client.channel("/events");
    client.control(false, 1.0, Some(end), "end");
    let jumped = client.playback(1);
    assert_eq!((jumped.at, jumped.has_jumped, jumped.request.as_str()), (end, true, "end"));
    client.subscribe(2, &events);
    assert_eq!(client.value(2)["kind"], "finished");
    // A record that is played from its end begins again. Another client also receives it.
    client.control(true, 100.0, None, "again");
    let again = client.playback(0);
    assert_eq!((again.at, again.has_jumped), (begin, true));
    assert_eq!(client.playback(3).at, end);
    let mut other = Client::connect(&view.address);
    assert_eq!(other.playback(3).at, end);
    let replay = other.service("/replay");
    let Message::Response(state) = other.call(replay, 1, &json!({ "play": false, "seconds": 0 })) else {
        panic!("it is paused")
    };
    assert_eq!((&state["playing"], &state["seconds"]), (&json!(false), &json!(0.0)), "{state}");
    assert_eq!(client.playback(1).at, begin);
    view.view.signal(Signal::INT);
    assert_eq!(view.view.ended(SOON).code, Some(0));
    let written = here.ask(&["replay", "runs/door-1", "--layout", "layout.json"]);
    assert_eq!((written.code, written.out.as_str()), (Some(0), "layout.json\n"), "{written}");
    let layout = read_layout(&cluster.folder().join("layout.json"));
    assert!(
        panels(&layout, "Plot!").iter().any(|plot| plot.to_string().contains("/signals/main/monitor.")),
        "{layout}"
    );
    let states = panels(&layout, "StateTransitions!");
    assert!(states[0].to_string().contains("/events{process==\\\"main/wheels\\\"}.kind"), "{layout}");
}

/// The layout of a running mission contains its states, its signals and a stop. Without a mission, a layout would be empty.
#[test]
fn a_layout_has_panels_for_the_missions_that_run() {
    let cluster = Cluster::new();
    let (here, [_node, mission]) = deployed(&cluster);
    let file = cluster.folder().join("layout.json");
    let written = here.ask(&["view", "--layout", &file.display().to_string()]);
    assert_eq!(written.code, Some(0), "{written}");
    let layout = read_layout(&file);
    let states = panels(&layout, "StateTransitions!");
    assert!(states[0].to_string().contains("/mission.processes[:]{path==\\\"main/wheels\\\"}.state"), "{layout}");
    assert_eq!(panels(&layout, "RosOut!")[0]["topicToRender"], "/log");
    assert_eq!((panels(&layout, "Parameters!").len(), panels(&layout, "CallService!stop").len()), (1, 1));
    let stop = &panels(&layout, "CallService!stop")[0];
    assert_eq!(
        (&stop["serviceName"], &stop["requestPayload"]),
        (&json!("/dca/stop"), &json!("{\"deployment\":\"door\"}"))
    );
    assert_eq!(here.ask(&["stop", "door"]).code, Some(0));
    drop(mission);
    let refused = here.ask(&["view", "--layout", &file.display().to_string()]);
    assert!(refused.code == Some(1) && refused.err.contains("no mission runs"), "{refused}");
    assert_eq!(read_layout(&file), layout, "the file is as it was");
}

#[test]
fn a_file_that_is_no_record_is_not_served() {
    let cluster = Cluster::new();
    let here = cluster.here();
    for (name, text, why) in [
        ("text", "process main() {}", "it does not begin like a record"),
        ("empty", "", "it does not begin like a record"),
        ("cut", "\u{89}", "it does not begin like a record"),
    ] {
        let file = cluster.file(name, text);
        let refused = here.ask(&["replay", &file, "--foxglove", "127.0.0.1:0"]);
        assert!(refused.code == Some(1) && refused.err.contains(why), "{refused}");
    }
    let refused = here.ask(&["replay", "away.mcap", "--foxglove", "127.0.0.1:0"]);
    assert!(refused.code == Some(1) && refused.err.contains("away.mcap"), "{refused}");
    for (arguments, why) in [
        (&["replay", "a.mcap", "b.dca", "--foxglove"][..], "cannot be used with"),
        (&["replay", "a.mcap"], "required"),
        (&["replay", "a.mcap", "--foxglove", "0.0.0.0:0"], "open to the network"),
        (&["view", "--layout", "a", "--page"], "cannot be used with"),
    ] {
        let refused = here.ask(arguments);
        assert!(refused.code == Some(2) && refused.err.contains(why), "{refused}");
    }
}

/// A suspended host confirms nothing, and the answer says so.
#[test]
#[ignore = "long: waits for a host that does not answer"]
fn an_estop_that_no_host_confirms_is_not_said_to_be_confirmed() {
    let cluster = Cluster::new();
    let (here, [node, _mission]) = deployed(&cluster);
    let view = View::open(&here);
    let mut client = Client::connect(&view.address);
    let estop = client.service("/dca/estop");
    node.signal(Signal::STOP);
    let answer = client.call_within(estop, 3, &json!({}), Duration::from_secs(120));
    node.signal(Signal::CONT);
    if let Message::Response(unknown) = answer {
        assert_eq!(unknown["confirmed"], json!(false), "{unknown}");
    } else if let Message::Word(failure) = answer {
        assert_eq!(failure["op"], "serviceCallFailure", "{failure}");
    } else {
        panic!("no topic was subscribed to: {answer:?}");
    }
}

#[test]
fn pages_of_other_sites_and_clients_that_mean_no_good_get_nothing() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let view = View::open(&here);
    let address = view.address.as_str();
    for (fields, status) in [
        ("Origin: https://evil.example\r\n", "403"),
        ("Origin: null\r\n", "403"),
        ("Origin: https://app.foxglove.dev.evil.example\r\n", "403"),
        ("Origin: https://app.foxglove.dev\r\n", "101"),
        ("Origin: https://lichtblick-suite.github.io\r\n", "101"),
        ("Origin: file://\r\n", "101"),
        ("", "101"),
    ] {
        let answer = handshake(address, "localhost:8765", fields);
        assert!(answer.starts_with(&format!("HTTP/1.1 {status}")), "{fields}: {answer}");
    }
    let rebound = handshake(address, "evil.example:8765", "");
    assert!(rebound.starts_with("HTTP/1.1 403"), "{rebound}");
    view.view.wait_for(Stream::Err, "the option `--origin https://evil.example` allows it", SOON);
    // Half handshakes, idle connections and garbage leave the other clients unaffected.
    let mut idle: Vec<TcpStream> = (0..200).map(|_| TcpStream::connect(address).expect("it listens")).collect();
    for stream in &mut idle {
        // A connection may have given way to others, and so may have gone.
        stream.write_all(b"GET / HTTP/1.1\r\nHost: local").unwrap_or_default();
    }
    for garbage in [&[0xff; 5000][..], b"\r\n\r\n", b"GET / HTTP/1.1\r\n\r\n", &[0; 100_000]] {
        let mut stream = TcpStream::connect(address).expect("it listens");
        stream.write_all(garbage).unwrap_or_default();
    }
    for frames in [
        // The frames are wrong: not masked, with a reserved bit, with a length of 2^63, with a fragment that never ends, with text
        // that is not UTF-8.
        vec![0x81, 0x01, b'a'],
        vec![0xf1, 0x80, 0, 0, 0, 0],
        vec![0x82, 0xff, 0x7f, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0, 0, 0, 0],
        [0x02, 0xfe, 0xff, 0xff, 0, 0, 0, 0].into_iter().chain([0; 65_535]).collect::<Vec<u8>>().repeat(40),
        vec![0x81, 0x81, 0, 0, 0, 0, 0xff],
    ] {
        let mut stream = open(address);
        stream.write_all(&frames).unwrap_or_default();
        // The client is cut off, with or without a reason.
        let mut rest = Vec::new();
        stream.read_to_end(&mut rest).unwrap_or_default();
    }
    let mut client = Client::connect(address);
    client.word("serverInfo");
    client.send(&json!({ "op": "advertise", "channels": [] }));
    assert!(client.word("status")["message"].as_str().is_some_and(|text| text.contains("was ignored")));
    let many: Vec<Value> = (0..10_000).map(|id| json!({ "id": id, "channelId": 1_000_000 + id })).collect();
    client.send(&json!({ "op": "subscribe", "subscriptions": many }));
    let told = client.word("status");
    assert!(
        told["message"].as_str().is_some_and(|text| text.contains("10000 of 10000 subscriptions refused")),
        "{told}"
    );
    // There is room for some clients, and it is free again after they have left.
    let clients: Vec<TcpStream> = (0..7).map(|_| open(address)).collect();
    let full = handshake(address, "localhost", "");
    assert!(full.starts_with("HTTP/1.1 503"), "{full}");
    drop(clients);
    assert!(wait_until(SOON, || handshake(address, "localhost", "").starts_with("HTTP/1.1 101")).is_some());
    drop(idle);
}

#[test]
fn the_server_stays_on_its_machine() {
    let cluster = Cluster::new();
    for arguments in [&["--foxglove", "0.0.0.0:0"][..], &["--page", "--foxglove", "[::]:8765"]] {
        let refused = cluster.here().ask(&[&["view"], arguments].concat());
        assert!(refused.code == Some(2) && refused.err.contains("open to the network"), "{refused}");
    }
    for (arguments, why) in [
        (&["view"][..], "--page"),
        (&["view", "--page", "--origin", "https://a.example"], "--foxglove"),
        (&["view", "--foxglove", "--origin", "a.example"], "is not an origin"),
    ] {
        let refused = cluster.here().ask(arguments);
        assert!(refused.code == Some(2) && refused.err.contains(why), "{refused}");
    }
}

/// The person has given up an order that a suspended view has not yet read.
#[test]
#[ignore = "long: suspends the view for 6 s"]
fn an_order_from_before_a_suspension_is_not_carried_out() {
    let cluster = Cluster::new();
    let (here, _running) = deployed(&cluster);
    let view = View::open(&here);
    let mut client = Client::connect(&view.address);
    let estop = client.service("/dca/estop");
    view.view.signal(Signal::STOP);
    pass(Duration::from_secs(1));
    client.order(estop, 1, &json!({}));
    pass(Duration::from_secs(6));
    view.view.signal(Signal::CONT);
    client.ended();
    assert!(here.pids().contains_key("main/wheels"), "nothing was stopped");
    Client::connect(&view.address).word("serverInfo");
}

/// A client that reads nothing for a while withholds no value from another client.
#[test]
fn a_client_that_does_not_read_disturbs_no_other() {
    let cluster = Cluster::new();
    let (here, _running) = deployed(&cluster);
    let view = View::open(&here);
    let mut slow = Client::connect(&view.address);
    let beat = slow.channel("/ports/main/beat/Out");
    slow.subscribe(1, &beat);
    let mut other = Client::connect(&view.address);
    let beat = other.channel("/ports/main/beat/Out");
    other.subscribe(1, &beat);
    for _ in 0..200 {
        other.value(1);
    }
    slow.value(1);
}

/// Foxglove's own client sees a mission, sets a parameter and calls a service.
#[test]
#[ignore = "long: installs Foxglove's client with npm"]
fn the_client_of_foxglove_works() {
    let cluster = Cluster::new();
    let folder = cluster.folder().join("npm");
    std::fs::create_dir_all(&folder).expect("the folder is its own");
    let packages = ["@foxglove/ws-protocol@0.8.0", "ws@8"];
    let mut npm = Command::new("npm");
    npm.args(["install", "--silent", "--no-audit", "--no-fund"]).args(packages).current_dir(&folder);
    let installed = npm.stdin(Stdio::null()).stdout(Stdio::null()).status();
    if !installed.is_ok_and(|status| status.success()) {
        println!("skipped: needs npm, and its registry for {}", packages.join(" and "));
        return;
    }
    let here = cluster.here();
    let programs = ["dca-controller", "dca-examples"].map(|name| executable(name).display().to_string());
    let [controller, examples] = &programs;
    let _node = here.node("c1", &["--controllers", controller, "--controllers", examples]);
    let file = cluster.file("door.dca", &many_outputs());
    let mission = here.dca(&["deploy", "--no-record", "--controllers", controller, "--controllers", examples, &file]);
    mission.wait_for(Stream::Err, "▸", SOON);
    let view = View::open(&here);
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/all/view_foxglove/client.cjs");
    let mut node = Command::new("node");
    node.arg(script).arg(format!("ws://{}", view.address)).env("NODE_PATH", folder.join("node_modules"));
    let ended = node.stdin(Stdio::null()).output().expect("npm comes with node");
    let (out, err) = (String::from_utf8_lossy(&ended.stdout), String::from_utf8_lossy(&ended.stderr));
    assert!(ended.status.success() && out.trim().ends_with("done"), "{out}{err}");
    view.view.signal(Signal::TERM);
    assert_eq!(view.view.ended(Duration::from_secs(30)).code, Some(0));
}

/// The mission with many outputs.
fn many_outputs() -> String {
    let beats: Vec<String> = (0..17).map(|number| format!("beat{number}")).collect();
    let declared: String = beats.iter().map(|beat| format!("{beat} instof RateSource(c1);\n")).collect();
    let monitors: String = beats.iter().map(|beat| format!("m{beat} instof RateMonitor(c1);\n")).collect();
    let wires: String = beats
        .iter()
        .map(|beat| format!("internal_connections({beat}, on) {{ {beat}, Out -> m{beat}, In; }}\n"))
        .collect();
    let all: String = beats.iter().map(|beat| format!(", {beat}, m{beat}")).collect();
    SPEC.replace(
        "    }\n    internal_connections {",
        &format!("{declared}{monitors}    }}\n    internal_connections {{"),
    )
    .replace("    internal_event_actions { beat", &format!("{wires}    internal_event_actions {{ beat"))
    .replace("wheels, guard }", &format!("wheels, guard{all} }}"))
}
