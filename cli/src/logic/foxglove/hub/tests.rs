//! Tests of the hub on virtual time.

use super::super::lasting::KEPT_MAX;
use super::super::outbox::{VALUES_SIZE_MAX, WORDS_MAX};
use super::super::viewer::SUBSCRIPTIONS_MAX;
use super::*;
use comms::logic::object::{Access, ExportKind, Exported, Signature, TypeForm};
use comms::logic::signals::Signal;
use comms::logic::tap::OutputType;
use node::logic::protocol::{
    Change, Containment, Deployment, DeploymentStatus, Ending, Network, NodeStatus, ProcessStatus, Report,
};
use serde_json::json;
use view::{Fleet, Input};

const SINCE_1970: Duration = Duration::from_secs(1_800_000_000);
const NOW: Arrival = Arrival { time: Time::ZERO, since_1970: SINCE_1970 };

fn at(millis: u64) -> Time {
    Time::ZERO + Duration::from_secs(1000) + Duration::from_millis(millis)
}

fn deployment(name: &str, epoch: u64) -> Deployment {
    Deployment { name: name.to_owned(), epoch }
}

fn door() -> Deployment {
    deployment("door", 1)
}

fn mission(deployment: Deployment) -> MissionId {
    MissionId { deployment, home: "r1".to_owned(), fleet: Fleet::Standing }
}

fn program(path: &str) -> ProgramName {
    ProgramName { mission: mission(door()), path: path.to_owned() }
}

fn output(path: &str, output: &str) -> Source {
    Source::Output { program: program(path), output: output.to_owned() }
}

/// The status of a node with these processes of each deployment.
fn status(parts: &[(Deployment, &[(&str, &str)])]) -> Input {
    let part = |(deployment, processes): &(Deployment, &[(&str, &str)])| {
        let process = |(path, state): &(&str, &str)| ProcessStatus {
            path: (*path).to_owned(),
            kind: "Any".to_owned(),
            state: (*state).to_owned(),
            pid: Some(7),
            activity: None,
        };
        DeploymentStatus {
            deployment: deployment.clone(),
            home: "r1".to_owned(),
            phase: "running".to_owned(),
            processes: processes.iter().map(process).collect(),
            lost: Vec::new(),
            refused: Vec::new(),
            undelivered: Vec::new(),
        }
    };
    let status = NodeStatus {
        host: "r1".to_owned(),
        pid: 1,
        version: "1".to_owned(),
        up: Duration::from_secs(60),
        peers: Vec::new(),
        deployments: parts.iter().map(part).collect(),
        containment: Containment::default(),
        network: Network::default(),
        estop: None,
        policy: None,
        missing: Vec::new(),
        waiting: Vec::new(),
    };
    Input::Status { fleet: Fleet::Standing, status: Box::new(status) }
}

fn outputs(all: &[(&str, &str, &str)]) -> Outputs {
    let one = |(name, type_name, fields): &(&str, &str, &str)| OutputType {
        name: (*name).to_owned(),
        type_name: (*type_name).to_owned(),
        fields: (*fields).to_owned(),
    };
    Outputs { outputs: all.iter().map(one).collect(), inner: Vec::new() }
}

fn exports(names: &[&str]) -> Exports {
    let exported = |name: &&str| Exported {
        name: (*name).to_owned(),
        kind: ExportKind::Procedure,
        signature: Signature { argument: TypeForm::new("Push", "force: Force"), result: TypeForm::default() },
        doc: String::new(),
        is_answered_idle: false,
        access: Access::Operate,
    };
    Exports { exports: names.iter().map(exported).collect() }
}

fn tapped(number: u64, bytes: Vec<u8>) -> Tapped {
    Tapped { number, stamp: Time::ZERO, bytes }
}

/// A hub with its model and one client.
struct Bench {
    hub: Hub,
    model: Model,
    client: u64,
    millis: u64,
}

impl Bench {
    fn new() -> Self {
        let mut hub = Hub::new(7);
        let client = hub.enter().expect("there is room");
        Self { hub, model: Model::new(1), client, millis: 0 }
    }

    fn with_mission(processes: &[(&str, &str)]) -> Self {
        let mut bench = Self::new();
        bench.look(&[(door(), processes)]);
        bench
    }

    fn look(&mut self, parts: &[(Deployment, &[(&str, &str)])]) {
        self.model.apply(at(self.millis), status(parts));
        self.hub.look(&self.model, at(self.millis), SINCE_1970);
    }

    fn give(&mut self, request: &Value) {
        self.hub.take(self.client, &Frame::Text(request.to_string()), NOW);
    }

    fn call(&mut self, service: u32, number: u32, payload: &str) {
        let numbers = [service, number, 4].into_iter().flat_map(u32::to_le_bytes);
        let bytes = [2].into_iter().chain(numbers).chain(*b"json").chain(payload.bytes());
        self.hub.take(self.client, &Frame::Binary(bytes.collect()), NOW);
    }

    /// Returns all messages that wait: those in text, and the values with their subscriptions.
    fn received(&mut self) -> (Vec<Value>, Vec<(u32, Vec<u8>)>) {
        let (mut words, mut values) = (Vec::new(), Vec::new());
        while let Some(frame) = self.hub.next(self.client, at(self.millis)) {
            match frame {
                Frame::Text(text) => words.push(serde_json::from_str(&text).unwrap()),
                Frame::Binary(bytes) => {
                    values.push((u32::from_le_bytes(bytes[1..5].try_into().unwrap()), bytes[13..].to_vec()));
                }
            }
        }
        (words, values)
    }

    /// Returns the numbers of the channels by topic, of all that were advertised and are there.
    fn channels(&self) -> BTreeMap<String, u32> {
        self.hub.catalog.channels.values().map(|channel| (channel.topic.to_string(), channel.id)).collect()
    }

    fn services(&self) -> BTreeMap<String, u32> {
        self.hub.catalog.services.values().map(|service| (service.name.clone(), service.id)).collect()
    }

    fn subscribe(&mut self, id: u32, topic: &str) {
        let channel = self.channels()[topic];
        self.give(&json!({ "op": "subscribe", "subscriptions": [{ "id": id, "channelId": channel }] }));
    }
}

fn ops(words: &[Value]) -> Vec<&str> {
    words.iter().map(|word| word["op"].as_str().unwrap()).collect()
}

#[test]
fn a_client_hears_first_what_there_is() {
    let mut bench = Bench::new();
    let (words, values) = bench.received();
    assert_eq!((ops(&words), values.len()), (vec!["serverInfo", "advertise", "advertiseServices"], 0));
    assert_eq!(words[0]["sessionId"], "7");
    let topics: Vec<&str> =
        words[1]["channels"].as_array().unwrap().iter().map(|channel| channel["topic"].as_str().unwrap()).collect();
    assert_eq!(topics, ["/events", "/log"]);
    assert_eq!(words[1]["channels"][1]["schemaName"], "foxglove.Log");
    for channel in words[1]["channels"].as_array().unwrap() {
        let schema: Value = serde_json::from_str(channel["schema"].as_str().unwrap()).unwrap();
        assert_eq!((&channel["encoding"], &schema["type"]), (&json!("json"), &json!("object")));
    }
    let services: Vec<&str> =
        words[2]["services"].as_array().unwrap().iter().map(|service| service["name"].as_str().unwrap()).collect();
    assert_eq!(services, ["/dca/stop", "/dca/estop"]);
}

#[test]
fn topics_come_and_go_with_their_processes() {
    let mut bench = Bench::with_mission(&[("main/a", "running"), ("main/b", "idle")]);
    let forms = outputs(&[("Out", "Wrench", "force: Force"), ("Raw", "Odd", ""), ("Scan", "ros.sensor.LaserScan", "")]);
    bench.hub.described(&program("main/a"), &forms, exports(&["Push"]));
    let (words, _) = bench.received();
    let advertised = words.iter().filter(|word| word["op"] == "advertise").flat_map(|word| word["channels"].as_array());
    let kinds: Vec<(&str, &str, &str)> = advertised
        .flatten()
        .map(|one| ["topic", "encoding", "schemaName"].map(|field| one[field].as_str().unwrap()).into())
        .collect();
    let expected = [
        ("/events", "json", "dca.Event"),
        ("/log", "json", "foxglove.Log"),
        ("/mission", "json", "dca.Mission"),
        ("/ports/main/a/Out", "json", "dca.types.Wrench"),
        ("/ports/main/a/Raw", "json", "dca.Encoded"),
        ("/ports/main/a/Scan", "cdr", "sensor_msgs/msg/LaserScan"),
    ];
    assert_eq!(kinds, expected);
    assert!(bench.services().contains_key("/calls/main/a/Push"));
    bench.subscribe(1, "/ports/main/a/Out");
    let before = bench.channels();
    // The same again changes nothing.
    bench.hub.described(&program("main/a"), &forms, exports(&["Push"]));
    assert_eq!((bench.channels(), bench.received().0), (before.clone(), vec![]));
    // The process leaves, and its program.
    bench.look(&[(door(), &[("main/b", "idle")])]);
    let (words, _) = bench.received();
    assert_eq!(ops(&words), ["unadvertise", "unadvertiseServices"]);
    let gone = ["/ports/main/a/Out", "/ports/main/a/Raw", "/ports/main/a/Scan"].map(|topic| before[topic]);
    assert_eq!(words[0]["channelIds"], json!(gone));
    assert!(bench.hub.wanted().is_empty());
    // It comes back with numbers that no client knows.
    bench.look(&[(door(), &[("main/a", "running")])]);
    bench.hub.described(&program("main/a"), &forms, exports(&["Push"]));
    assert!(!before.values().any(|id| *id == bench.channels()["/ports/main/a/Out"]));
}

#[test]
fn a_value_goes_to_those_who_have_subscribed_with_its_losses() {
    let mut bench = Bench::with_mission(&[("main/a", "running")]);
    bench.hub.described(&program("main/a"), &outputs(&[("Out", "Wrench", "force: Force")]), Exports::default());
    let other = bench.hub.enter().unwrap();
    bench.received();
    let source = output("main/a", "Out");
    assert!(bench.hub.wanted().is_empty());
    bench.subscribe(5, "/ports/main/a/Out");
    assert_eq!(bench.hub.wanted(), [source.clone()].into());
    let force = |newton: f64| newton.to_le_bytes().to_vec();
    bench.hub.value(&source, tapped(1, force(2.5)), NOW);
    bench.hub.value(&source, tapped(4, force(f64::NAN)), NOW);
    let (words, values) = bench.received();
    let text = |value: &(u32, Vec<u8>)| (value.0, String::from_utf8(value.1.clone()).unwrap());
    assert_eq!(values.iter().map(text).collect::<Vec<_>>(), [(5, r#"{"force":2.5}"#.into()), (5, "{}".into())]);
    assert_eq!(ops(&words), ["status"]);
    assert!(words[0]["message"].as_str().unwrap().contains("2 of `/ports/main/a/Out`"), "{words:?}");
    // The other has not subscribed.
    let mut of_other = Vec::new();
    while let Some(frame) = bench.hub.next(other, at(0)) {
        of_other.push(frame);
    }
    assert!(of_other.iter().all(|frame| matches!(frame, Frame::Text(text) if !text.contains("\"op\":\"status\""))));
    bench.give(&json!({ "op": "unsubscribe", "subscriptionIds": [5, 99] }));
    bench.hub.value(&source, tapped(5, force(1.0)), NOW);
    assert_eq!((bench.received(), bench.hub.wanted().len()), ((vec![], vec![]), 0));
    // Values that leave the output while no client wants them are not lost.
    bench.millis = 5000;
    bench.subscribe(6, "/ports/main/a/Out");
    bench.hub.hears(&source);
    bench.hub.value(&source, tapped(100, force(1.0)), NOW);
    let (words, values) = bench.received();
    assert_eq!((words.len(), values.len()), (0, 1), "{words:?}");
}

#[test]
fn a_slow_client_loses_values_and_disturbs_no_other() {
    let mut bench = Bench::with_mission(&[("main/a", "running")]);
    bench.hub.described(&program("main/a"), &outputs(&[("Out", "Odd", "")]), Exports::default());
    bench.subscribe(1, "/ports/main/a/Out");
    bench.received();
    let slow = std::mem::replace(&mut bench.client, bench.hub.enter().unwrap());
    bench.subscribe(2, "/ports/main/a/Out");
    bench.received();
    let size = 100_000;
    let count = VALUES_SIZE_MAX / size * 2;
    for number in 1..=count {
        bench.hub.value(&output("main/a", "Out"), tapped(number.try_into().unwrap(), vec![0; size]), NOW);
        assert_eq!(bench.received().1.len(), 1, "the other gets each value");
    }
    bench.client = slow;
    let (words, values) = bench.received();
    let told = words.iter().find(|word| word["op"] == "status").unwrap()["message"].as_str().unwrap();
    let lost: usize = told.split(' ').next().unwrap().parse().unwrap();
    assert!(lost > 0 && lost + values.len() == count, "{told}, {} of {count}", values.len());
    assert!(!bench.hub.is_overrun(slow));
}

#[test]
fn subscriptions_have_limits_and_mistakes_are_told_in_one_sentence() {
    let mut bench = Bench::with_mission(&[("main/a", "running")]);
    let names: Vec<String> = (0..1200).map(|number| format!("Out{number}")).collect();
    let all: Vec<(&str, &str, &str)> = names.iter().map(|name| (name.as_str(), "Odd", "")).collect();
    bench.hub.described(&program("main/a"), &outputs(&all), Exports::default());
    bench.received();
    let channels: Vec<u32> = bench.channels().into_values().collect();
    let subscriptions: Vec<Value> =
        (0..10_000_u32).map(|id| json!({ "id": id, "channelId": channels[id as usize % channels.len()] })).collect();
    bench.give(&json!({ "op": "subscribe", "subscriptions": subscriptions }));
    assert_eq!(bench.hub.wanted().len(), SUBSCRIPTIONS_MAX);
    let (words, _) = bench.received();
    assert_eq!(ops(&words), ["status"]);
    let told = words[0]["message"].as_str().unwrap();
    assert!(told.contains(&format!("{} of 10000 subscriptions refused", 10_000 - SUBSCRIPTIONS_MAX)), "{told}");
    let mut bench = Bench::new();
    bench.received();
    for (id, channel, why) in [
        (1, 1, ""),
        (1, 2, "already exists"),
        (2, 1, "the channel 1 already has"),
        (3, 99, "the channel 99 does not exist"),
    ] {
        bench.give(&json!({ "op": "subscribe", "subscriptions": [{ "id": id, "channelId": channel }] }));
        let (words, _) = bench.received();
        let told = words.first().map_or("", |word| word["message"].as_str().unwrap());
        assert!(told.contains(why) && why.is_empty() == told.is_empty(), "{told}");
    }
}

#[test]
fn a_client_that_sends_nonsense_and_reads_nothing_is_cut_off() {
    let mut bench = Bench::new();
    for _ in 0..2 * WORDS_MAX {
        bench.hub.take(bench.client, &Frame::Text("{".to_owned()), NOW);
    }
    assert!(bench.hub.is_overrun(bench.client));
    let other = bench.hub.enter().unwrap();
    assert!(!bench.hub.is_overrun(other));
    bench.hub.leave(bench.client);
    assert!(bench.hub.is_overrun(bench.client), "a client that is gone gets nothing");
    let entered = std::iter::from_fn(|| bench.hub.enter()).take(100).count();
    assert_eq!(entered, VIEWERS_MAX - 1);
}

#[test]
fn a_client_that_comes_late_gets_the_state_and_the_last_events() {
    let mut bench = Bench::with_mission(&[("main/a", "running")]);
    let report = |change| Report::Process { path: "main/a".to_owned(), change, at: Duration::from_secs(1) };
    let event = |number, report| Event {
        deployment: door(),
        number,
        host: "r1".into(),
        ago: Duration::ZERO,
        report,
        time: SINCE_1970,
    };
    bench.hub.event(&event(0, report(Change::Activated)));
    bench.hub.event(&event(1, report(Change::Ended(Ending::Stopped))));
    bench.hub.event(&event(2, Report::Programs { at: Vec::new() }));
    bench.hub.wrote(&program("main/a"), "hello\nworld".to_owned(), SINCE_1970);
    bench.received();
    bench.subscribe(1, "/mission");
    bench.subscribe(2, "/events");
    bench.subscribe(3, "/log");
    let (_, values) = bench.received();
    let values: Vec<(u32, Value)> =
        values.into_iter().map(|(id, bytes)| (id, serde_json::from_slice(&bytes).unwrap())).collect();
    let [(1, state), (2, first), (2, second), (3, log)] = &values[..] else { panic!("{values:?}") };
    assert_eq!((&state["deployment"], &state["processes"][0]["state"]), (&json!("door@1"), &json!("running")));
    assert_eq!(
        (&first["kind"], &second["kind"], &first["deployment"]),
        (&json!("activated"), &json!("stopped"), &json!("door@1"))
    );
    assert_eq!((&log["name"], &log["message"]), (&json!("door:main/a"), &json!("hello\nworld")));
    // A state is told when it changes, and not otherwise.
    bench.millis = 1000;
    bench.look(&[(door(), &[("main/a", "running")])]);
    assert_eq!(bench.received().1, []);
    bench.look(&[(door(), &[("main/a", "dead: SIGSEGV")])]);
    let (_, values) = bench.received();
    let [(1, state)] = &values[..] else { panic!("{values:?}") };
    let state: Value = serde_json::from_slice(state).unwrap();
    assert_eq!(
        (&state["processes"][0]["health"], &state["processes"][0]["since"]),
        (&json!("failed"), &json!(1_800_001_001.0))
    );
    for _ in 0..2 * KEPT_MAX {
        bench.hub.event(&event(3, report(Change::Activated)));
    }
    assert_eq!(bench.hub.events.kept.len(), KEPT_MAX);
}

#[test]
fn the_signals_of_a_program_have_one_topic_until_it_names_others() {
    let mut bench = Bench::with_mission(&[("main/a", "running")]);
    let sample = |name: &str| Signals {
        stamp: Time::ZERO,
        values: vec![Signal { name: name.to_owned(), unit: "N".to_owned(), value: 1.5, headline: false }],
    };
    let a = program("main/a");
    bench.hub.described(&a, &Outputs::default(), Exports::default());
    assert!(bench.hub.lacks_signals(&a));
    bench.hub.signals(&a, vec![sample("force")], 0, NOW);
    assert!(!bench.hub.lacks_signals(&a));
    bench.subscribe(1, "/signals/main/a");
    bench.received();
    bench.hub.signals(&a, vec![sample("force")], 0, NOW);
    assert_eq!(bench.received().1, [(1, br#"{"force":1.5,"stamp":0.0}"#.to_vec())]);
    for number in 0..1000 {
        bench.hub.signals(&a, vec![sample(&format!("s{number}"))], 0, NOW);
    }
    let topics = bench.channels().into_keys().filter(|topic| topic.starts_with("/signals/"));
    assert_eq!(topics.count(), 16, "a program that names its signals differently all the time");
    bench.look(&[(door(), &[])]);
    bench.hub.signals(&a, vec![sample("force")], 0, NOW);
    assert!(!bench.channels().keys().any(|topic| topic.starts_with("/signals/")), "the sample is late");
}

#[test]
fn the_topics_of_a_mission_stay_after_its_end_until_the_next() {
    let mut bench = Bench::with_mission(&[("main/a", "running")]);
    bench.hub.described(&program("main/a"), &outputs(&[("Out", "Odd", "")]), exports(&["Push"]));
    // Another deployment at the same time has names of its own.
    bench.look(&[(door(), &[("main/a", "running")]), (deployment("gate", 1), &[("main/a", "running")])]);
    assert!(bench.channels().contains_key("/gate/mission"));
    bench.look(&[(deployment("gate", 1), &[("main/a", "running")])]);
    let topics: Vec<String> = bench.channels().into_keys().collect();
    assert_eq!(topics, ["/events", "/gate/mission", "/log", "/mission"], "the state of the end can be read");
    bench.look(&[(deployment("gate", 1), &[]), (deployment("door", 2), &[("main/a", "idle")])]);
    let topics: Vec<String> = bench.channels().into_keys().collect();
    assert_eq!(topics, ["/events", "/gate/mission", "/log", "/mission"]);
    let Some(Source::State(of)) =
        bench.hub.catalog.channels.values().find(|one| &*one.topic == "/mission").map(|one| one.source.clone())
    else {
        panic!("it is a state")
    };
    assert_eq!(of, mission(deployment("door", 2)));
    // The model still has the first run. That takes nothing from the second.
    bench.look(&[(deployment("gate", 1), &[])]);
    bench.look(&[(deployment("gate", 1), &[])]);
    let topics: Vec<String> = bench.channels().into_keys().collect();
    assert_eq!(topics, ["/events", "/gate/mission", "/log", "/mission"]);
}

#[test]
fn calls_become_orders_and_mistakes_are_answered() {
    let mut bench = Bench::with_mission(&[("main/a", "running")]);
    bench.hub.described(&program("main/a"), &Outputs::default(), exports(&["Push"]));
    bench.received();
    let service = bench.services()["/calls/main/a/Push"];
    bench.call(service, 1, r#"{"force": 20}"#);
    let orders = bench.hub.orders();
    let [Given { order: Order::Call(call), ticket, viewer }] = &orders[..] else { panic!("{orders:?}") };
    assert_eq!((call.argument.as_slice(), call.program.path.as_str()), (&20_f64.to_le_bytes()[..], "main/a"));
    bench.hub.answer(*viewer, ticket, &Answer::Done(json!({ "x": 1 })));
    let Some(Frame::Binary(response)) = bench.hub.next(bench.client, at(0)) else { panic!("a result is binary") };
    assert_eq!(response, protocol::call_response(service, 1, &json!({ "x": 1 })));
    for (service, payload, why) in [
        (service, "{}", "expected Push { force: Force }"),
        (service, "{", "is not JSON"),
        (999, "{}", "the service 999 does not exist"),
        (bench.services()["/dca/stop"], "{}", "the deployment is missing"),
    ] {
        bench.call(service, 7, payload);
        let (words, _) = bench.received();
        let [failure] = &words[..] else { panic!("{words:?}") };
        assert_eq!((&failure["op"], &failure["callId"]), (&json!("serviceCallFailure"), &json!(7)));
        assert!(failure["message"].as_str().unwrap().contains(why), "{failure}");
    }
    assert!(bench.hub.orders().is_empty());
    // A client may have some orders at once. A stop is never refused for other orders.
    (0..100).for_each(|number| bench.call(service, number, r#"{"force": 1}"#));
    assert_eq!(bench.hub.orders().len(), ORDERS_MAX);
    let (words, _) = bench.received();
    assert_eq!(words.len(), 100 - ORDERS_MAX);
    bench.hub.take(bench.client, &Frame::Binary([&[3, 0][..], &[0; 17]].concat()), NOW);
    let (words, _) = bench.received();
    assert!(words[0]["message"].as_str().is_some_and(|text| text.contains("plays no record")), "{words:?}");
    bench.call(bench.services()["/dca/estop"], 5, "");
    let orders = bench.hub.orders();
    assert!(matches!(&orders[..], [Given { order: Order::Estop { .. }, .. }]), "{orders:?}");
}

#[test]
fn parameters_are_told_to_those_who_follow_them() {
    let mut bench = Bench::new();
    bench.received();
    bench.give(&json!({ "op": "getParameters", "parameterNames": [], "id": "r1" }));
    let orders = bench.hub.orders();
    let [Given { viewer, ticket, order: Order::Parameters { .. } }] = &orders[..] else { panic!("{orders:?}") };
    let value = |name: &str, value| ParameterValue { name: name.to_owned(), value };
    let (values, problems) = (vec![value("a", json!(1.0))], vec!["`b` was not set".to_owned()]);
    bench.hub.answer(*viewer, ticket, &Answer::Values { values, problems });
    let (words, _) = bench.received();
    assert_eq!(ops(&words), ["parameterValues", "status"]);
    assert_eq!((&words[0]["id"], &words[0]["parameters"][0]["value"]), (&json!("r1"), &json!(1.0)));
    let problems: Vec<String> = (0..1000).map(|number| format!("`{number}` was not set")).collect();
    bench.hub.answer(*viewer, ticket, &Answer::Values { values: vec![], problems });
    let (words, _) = bench.received();
    let told = words[1]["message"].as_str().unwrap();
    assert!(words.len() == 2 && told.ends_with("`4` was not set; and 995 other problems"), "{words:?}");
    let all = |a: f64, b: bool| vec![value("a", json!(a)), value("b", json!(b))];
    bench.hub.parameters(all(1.0, true));
    assert!(!bench.hub.follows_parameters() && bench.received().0.is_empty());
    bench.give(&json!({ "op": "subscribeParameterUpdates", "parameterNames": ["a"] }));
    assert!(bench.hub.follows_parameters());
    bench.hub.parameters(all(1.0, false));
    assert!(bench.received().0.is_empty(), "`b` is not followed");
    bench.hub.parameters(all(2.0, false));
    let (words, _) = bench.received();
    assert_eq!(words[0]["parameters"], json!([{ "name": "a", "value": 2.0, "type": "float64" }]));
    bench.give(&json!({ "op": "unsubscribeParameterUpdates", "parameterNames": [] }));
    assert!(!bench.hub.follows_parameters());
}

#[test]
fn a_new_subscription_begins_with_new_values_and_without_old_losses() {
    let mut bench = Bench::with_mission(&[("main/a", "running")]);
    bench.hub.described(&program("main/a"), &outputs(&[("Out", "Odd", "")]), exports(&[]));
    let source = output("main/a", "Out");
    let (first, topic) = (bench.client, "/ports/main/a/Out");
    let arrival = |millis| Arrival { time: at(millis), since_1970: SINCE_1970 };
    let channel = bench.channels()[topic];
    let subscribe = |bench: &mut Bench, millis| {
        let request = json!({ "op": "subscribe", "subscriptions": [{ "id": 1, "channelId": channel }] });
        bench.hub.take(bench.client, &Frame::Text(request.to_string()), arrival(millis));
    };
    subscribe(&mut bench, 0);
    bench.hub.value(&source, tapped(1, vec![1]), arrival(10));
    bench.client = bench.hub.enter().unwrap();
    let second = bench.client;
    subscribe(&mut bench, 100);
    // These arrived before the second client has subscribed, and waited.
    bench.hub.value(&source, tapped(2, vec![2]), arrival(20));
    bench.hub.value(&source, tapped(9, vec![3]), arrival(99));
    bench.hub.value(&source, tapped(12, vec![4]), arrival(101));
    bench.hub.value(&source, tapped(14, vec![5]), arrival(102));
    let mut received = |client| {
        bench.client = client;
        let (words, values) = bench.received();
        let told = words.iter().filter(|word| word["op"] == "status").map(|word| word["message"].to_string());
        (told.collect::<String>(), values.len())
    };
    let (told, count) = received(first);
    assert!(told.contains("9 values did not get here") && count == 5, "{told} {count}");
    let (told, count) = received(second);
    assert!(told.contains("1 value did not get here") && count == 2, "{told} {count}");
}

#[test]
fn a_value_that_no_client_wants_is_not_encoded() {
    let mut bench = Bench::with_mission(&[("main/a", "running")]);
    bench.hub.described(&program("main/a"), &outputs(&[("Out", "Wrench", "force: Force")]), exports(&[]));
    // A value that cannot be read has a topic of its own once it was encoded.
    bench.hub.value(&output("main/a", "Out"), tapped(1, vec![1]), NOW);
    assert!(!bench.channels().contains_key("/ports/main/a/Out_2"));
    bench.subscribe(1, "/ports/main/a/Out");
    bench.hub.value(&output("main/a", "Out"), tapped(2, vec![1]), NOW);
    assert!(bench.channels().contains_key("/ports/main/a/Out_2"));
}
