//! The data of the page.

use super::*;
use comms::logic::time::Time;
use language::plan::Plan;
use language::{Options, Source, compile};
use node::logic::protocol::{
    Change, Deployment, DeploymentStatus, Ending, Event, Failure, FailureCause, LostValues, Report,
};
use node::logic::protocol::{Containment, Network, NodeStatus, ProcessStatus};
use std::time::Duration;
use view::{Fleet, Input, Position, RobotId};

#[test]
fn nothing_runs_within_the_page() {
    let page = page("a\"b");
    assert!(page.contains("content=\"a&quot;b\""));
    for file in ["missions", "parts", "page"] {
        assert!(page.contains(&format!("<script src=\"/{file}.js\" defer></script>")), "{file}");
    }
    assert_eq!(page.matches("<script").count(), 3);
    let within = ["style=", "onclick", "onload", "javascript:", "http:", "https:"];
    assert!(within.iter().all(|word| !page.contains(word)), "{page}");
    // Texts of robots become text nodes.
    let markup = ["innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval("];
    assert!(markup.iter().all(|word| [SCRIPT, MISSIONS, PARTS].iter().all(|script| !script.contains(word))));
}

#[test]
fn changes_are_data_and_what_robots_say_stays_text() {
    let mut model = Model::new(1);
    let (now, time) = (Time::from_nanos(5_000_000_000), Duration::from_secs(1_800_000_000));
    let (deployment, reasons) =
        (Deployment { name: "door".into(), epoch: 1 }, vec!["<img src=x onerror=alert(1)>".into()]);
    let report = Report::Refused { reasons };
    let event = Event { deployment, number: 0, host: "r1".into(), ago: Duration::ZERO, report, time };
    let robot = RobotId { host: "r1".into(), fleet: Fleet::Standing };
    model.apply(now, Input::Event { home: robot.clone(), event: Box::new(event) });
    model.apply(now, Input::Silent { robot, why: "it sleeps".into() });
    let json = changes(&model, &model.since(Position::default()), now);
    assert_eq!(json["whole"], true);
    assert_eq!(json["events"][0]["text"], "refused: <img src=x onerror=alert(1)>");
    assert_eq!(
        (&json["robots"][0]["presence"], &json["robots"][0]["why"]),
        (&json!("does not answer"), &json!("it sleeps"))
    );
    assert_eq!(json["ages"], json!({ "all": null, "robots": { "r1": null }, "limit": 3 }));
    let line = json.to_string();
    assert!(!line.contains('\n'), "an event of a stream is one line");
}

const SPEC: &str = "
    module Work(host) { exec \"sleep 1\"; plain; done; in Set: Pose; out Now: Pose; }
    activity Patrol(here: Host) {
        host { here }
        look instof Work(here);
        initial state looking { run look; on done -> resting; }
        state resting { on after 1 s -> looking; }
    }
    process main() {
        host { r1 }
        instantiated_processes { patrol instof Patrol(r1); a instof Work(r1); b instof Work(r1); }
        internal_connections { a, Now -> b, Set; }
        internal_event_actions { patrol, a, b }
    }";

fn plan() -> Plan {
    let compiled = compile(&Source::new("door.dca", SPEC), &[], &Options::named("door"));
    compiled.plan.unwrap_or_else(|| panic!("{:?}", compiled.diagnostics))
}

fn at(seconds: u64) -> Time {
    Time::ZERO + Duration::from_secs(seconds)
}

fn mission() -> MissionId {
    let deployment = Deployment { name: "door".into(), epoch: 1 };
    MissionId { deployment, home: "r1".into(), fleet: Fleet::Standing }
}

fn status(states: &[(&str, &str)]) -> Input {
    let process = |(path, state): &(&str, &str)| ProcessStatus {
        path: (*path).to_owned(),
        kind: "Work".into(),
        state: (*state).to_owned(),
        pid: None,
        activity: None,
    };
    let part = DeploymentStatus {
        deployment: mission().deployment,
        home: "r1".into(),
        phase: "running".into(),
        processes: states.iter().map(process).collect(),
        lost: vec![LostValues { wire: "main/a, Now -> main/b, Set".into(), count: 3 }],
        refused: Vec::new(),
        undelivered: Vec::new(),
    };
    let status = NodeStatus {
        host: "r1".into(),
        pid: 7,
        version: "1".into(),
        up: Duration::ZERO,
        peers: Vec::new(),
        deployments: vec![part],
        containment: Containment::ControlGroup,
        network: Network::Insecure,
        estop: None,
        policy: None,
        missing: Vec::new(),
        waiting: Vec::new(),
    };
    Input::Status { fleet: Fleet::Standing, status: Box::new(status) }
}

fn event(number: u64, report: Report) -> Input {
    let (ago, time) = (Duration::ZERO, Duration::from_secs(1_800_000_000));
    let event = Event { deployment: mission().deployment, number, host: "r1".into(), ago, report, time };
    Input::Event { home: mission().robot("r1"), event: Box::new(event) }
}

fn changed(number: u64, path: &str, change: Change) -> Input {
    event(number, Report::Process { path: path.into(), change, at: Duration::ZERO })
}

/// A mission whose `a` has crashed, with its plan.
fn crashed() -> Model {
    let mut model = Model::new(1);
    model.apply(at(1), status(&[("main", "running"), ("main/a", "running"), ("main/b", "idle")]));
    model.apply(at(1), event(0, Report::Go { took: Duration::ZERO, signals: Vec::new() }));
    model.apply(at(1), Input::Plan { mission: mission(), plan: Box::new(plan()) });
    model.apply(at(2), changed(1, "main/a", Change::Activated));
    let states = vec!["<script>alert(1)</script>\u{0}".to_owned()];
    model.apply(at(3), changed(2, "main/patrol", Change::Entered { states }));
    let cause = FailureCause::Reported("<img src=x>".repeat(10_000));
    let failure = Failure { origin: "main/a".into(), cause, at: Duration::ZERO };
    model.apply(at(11), changed(3, "main/a", Change::Ended(Ending::Aborted(failure))));
    model.apply(at(11), status(&[("main", "running"), ("main/a", "idle"), ("main/b", "idle")]));
    model
}

#[test]
fn a_mission_has_a_picture_and_each_activity_has_one() {
    let model = crashed();
    let json = changes(&model, &model.since(Position::default()), at(12));
    let number = json["deployments"][0]["plan"].to_string();
    let draw = |text: &str| {
        let asked: Asked = text.parse().expect("it is a number");
        picture(asked, asked.find(&model).map(|(_, plan)| plan).as_deref())
    };
    let drawn = draw(&number);
    let svg = drawn["svg"].as_str().expect("it is drawn");
    for path in ["main", "main/patrol", "main/patrol/look", "main/a", "main/b"] {
        assert!(svg.contains(&format!("data-key=\"{path}\"")), "{path}: {svg}");
    }
    assert!(svg.contains("data-wires=\"0\""), "{svg}");
    assert_eq!(drawn["wires"], json!(["main/a, Now -> main/b, Set"]));
    assert_eq!(drawn["activities"][0]["path"], "main/patrol");
    let group = drawn["activities"][0]["group"].to_string();
    let states = draw(&format!("{number}-{group}"));
    let svg = states["svg"].as_str().expect("it is drawn");
    assert!(["looking", "resting"].iter().all(|state| svg.contains(&format!("data-key=\"{state}\""))), "{svg}");
    assert_eq!(draw(&format!("{number}-0"))["why"], "there is no such activity");
    assert!(draw("99999")["why"].as_str().is_some_and(|why| why.contains("no longer shown")));
    for wrong in ["", "-", "1-", "-1", "x", "1-2-3", "99999999999999999999"] {
        assert_eq!(wrong.parse::<Asked>(), Err(()), "{wrong}");
    }
}

#[test]
fn a_process_keeps_the_mark_of_its_last_end() {
    let mut model = crashed();
    let shown = |model: &Model| {
        let json = changes(model, &model.since(Position::default()), at(12));
        let processes = json["processes"].as_array().expect("it is a list").clone();
        let a = processes.iter().find(|one| one["path"] == "main/a").cloned().unwrap_or_default();
        (json["deployments"][0]["ends"].clone(), a["mark"].clone(), json["wires"][0]["lost"].clone())
    };
    assert_eq!(shown(&model), (json!({}), json!("failed"), json!(3)));
    let report = Report::Finished { ending: Ending::Done(Vec::new()), at: Duration::ZERO, unconfirmed: Vec::new() };
    model.apply(at(12), changed(4, "main/b", Change::Ended(Ending::Done(Vec::new()))));
    model.apply(at(12), event(5, report));
    model.apply(at(12), status(&[]));
    let (ends, gone, _) = shown(&model);
    assert_eq!(
        (&ends["main/a"]["mark"], &ends["main/b"]),
        (&json!("failed"), &json!({ "mark": "done", "text": "done" }))
    );
    assert_eq!(gone, Value::Null, "the process has left with its mission");
}

#[test]
fn a_timeline_has_the_lanes_of_a_report_and_no_markup_of_others() {
    let model = crashed();
    let json = changes(&model, &model.since(Position::default()), at(12));
    let number = json["deployments"][0]["plan"].to_string();
    let draw = |text: &str, now: u64| {
        let asked: Asked = text.parse().expect("it is a number");
        timeline(Past::new(asked, &model, at(now)).as_ref())
    };
    let drawn = draw(&number, 21);
    assert_eq!(drawn["note"], "seconds since GO");
    let svg = drawn["svg"].as_str().expect("it is drawn");
    // GO was at 1 s by the clock of the view.
    assert!(svg.contains("<title>a running, 1.0 s to 10.0 s</title>"), "{svg}");
    assert!(svg.contains("a aborted: main ← a: &lt;img src=x&gt;") && svg.contains("class=\"mark bad\""), "{svg}");
    assert!(!svg.contains("<img") && !svg.contains("<script") && !svg.contains('\0') && svg.len() < 20_000, "{svg}");
    let last = draw(&format!("{number}-5"), 21);
    let svg = last["svg"].as_str().expect("it is drawn");
    assert!(!svg.contains("a running") && svg.contains("a idle, 10.0 s to 20.0 s"), "{svg}");
    assert!(draw("7777", 21)["why"].is_string());
    for wrong in ["", "1-", "1-x", "1--5", "1-99999999999"] {
        assert!(wrong.parse::<Asked>().is_err(), "{wrong}");
    }
}
