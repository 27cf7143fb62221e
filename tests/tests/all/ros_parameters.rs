//! `dca param` with a node of ROS 2. The test answers the services of the node. So it decides which parameters the node has, which values
//! it refuses, and whether it answers at all.

use super::ros_calls::reply;
use super::ros_nodes::{Installation, SLEEPER};
use super::ros_topics::{Ros, run};
use controllers::ros::rcl_interfaces::{
    DescribeParametersRequest, DescribeParametersResponse, FloatingPointRange, GetParametersRequest,
    GetParametersResponse, ListParametersResponse, ListParametersResult, ParameterDescriptor, ParameterType,
    ParameterValue, SetParametersRequest, SetParametersResponse, SetParametersResult,
};
use controllers::ros::{AtMost, Message};
use dca_tests::cluster::{Cluster, Ended, Program, SOON, Stream, wait_until};
use rustix::process::Signal;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use zenoh::Wait;
use zenoh::query::{Query, Queryable};

/// The parameters of a node, by name.
type Values = Arc<Mutex<BTreeMap<String, ParameterValue>>>;

/// The part of a node that others see.
struct Node {
    values: Values,
    services: Vec<Queryable<()>>,
}

fn double(value: f64) -> ParameterValue {
    ParameterValue { r#type: ParameterType::PARAMETER_DOUBLE, double_value: value, ..ParameterValue::default() }
}

fn read<M: Message>(query: &Query) -> M {
    M::from_cdr(&query.payload().expect("it has one").to_bytes()).expect("it is of its type")
}

fn answer<M: Message>(query: &Query, response: &M) {
    reply(query, &response.to_cdr().expect("it is short"));
}

impl Node {
    fn new(ros: &Ros) -> Self {
        let texts = vec!["a".to_owned(), "b".to_owned()];
        let texts = ParameterValue {
            r#type: ParameterType::PARAMETER_STRING_ARRAY,
            string_array_value: texts,
            ..ParameterValue::default()
        };
        let values = [("speed", double(0.5)), ("limit", double(2.0)), ("plugins", texts)];
        let values: Values = Arc::new(Mutex::new(values.map(|(name, value)| (name.to_owned(), value)).into()));
        let services = ["list", "get", "describe", "set"].map(|service| {
            let values = Arc::clone(&values);
            // The last two words are the type and the hash of the type.
            let key = format!("7/robot1/nav/{service}_parameters/*/*");
            let hear = move |query: Query| serve(service, &query, &values);
            ros.session.declare_queryable(key).complete(true).callback(hear).wait().expect("a peer")
        });
        Self { values, services: services.into() }
    }

    fn value(&self, name: &str) -> f64 {
        self.values.lock().expect("no test panics here")[name].double_value
    }
}

fn serve(service: &str, query: &Query, values: &Values) {
    let mut values = values.lock().expect("no test panics here");
    match service {
        "list" => {
            let names = values.keys().cloned().collect();
            answer(query, &ListParametersResponse { result: ListParametersResult { names, prefixes: Vec::new() } });
        }
        "get" => {
            let names = read::<GetParametersRequest>(query).names;
            // As with a real node, one unknown name leaves out all values.
            let values = names.iter().map(|name| values.get(name).cloned()).collect::<Option<Vec<_>>>();
            answer(query, &GetParametersResponse { values: values.unwrap_or_default() });
        }
        "describe" => {
            let one = |name: String| {
                let range = FloatingPointRange { from_value: 0.0, to_value: 2.0, step: 0.0 };
                let mut descriptor =
                    ParameterDescriptor { r#type: values[&name].r#type, ..ParameterDescriptor::default() };
                descriptor.read_only = name == "limit";
                if name == "speed" {
                    descriptor.floating_point_range = AtMost::new(vec![range]).expect("one is allowed");
                }
                descriptor.name = name;
                descriptor
            };
            let names = read::<DescribeParametersRequest>(query).names;
            answer(query, &DescribeParametersResponse { descriptors: names.into_iter().map(one).collect() });
        }
        _ => {
            let mut one = |parameter: controllers::ros::rcl_interfaces::Parameter| {
                if parameter.name == "limit" {
                    return SetParametersResult { successful: false, reason: "the limit is read-only".to_owned() };
                }
                values.insert(parameter.name, parameter.value);
                SetParametersResult { successful: true, reason: String::new() }
            };
            let results = read::<SetParametersRequest>(query).parameters.into_iter().map(&mut one).collect();
            answer(query, &SetParametersResponse { results });
        }
    }
}

#[track_caller]
fn check(ended: &Ended, code: i32, parts: &[&str]) {
    let text = format!("{}{}", ended.out, ended.err);
    assert!(ended.code == Some(code) && parts.iter().all(|part| text.contains(part)), "{parts:?}: {ended}");
}

/// Starts the node's program. The name of the node is known.
fn running(cluster: &Cluster, ros: &Ros) -> Program {
    let ros2 = Installation::new(cluster, &[("lib/demo/nav", SLEEPER)]);
    let mission = run(cluster, ros, &ros2.spec("ros \"demo nav\"; node \"/robot1/nav\"; service;"));
    ros2.started(1, &mission);
    let is_shown = || cluster.here().ask(&["param", "list"]).err.contains("main/nav");
    assert!(wait_until(SOON, is_shown).is_some(), "{}", mission.text(Stream::Err));
    mission
}

#[test]
fn a_node_of_ros_has_its_parameters_itself() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let node = Node::new(&ros);
    let mission = running(&cluster, &ros);
    let ask = |words: &[&str]| cluster.here().ask(&[&["param"], words].concat());
    let list = ask(&["list", "nav"]);
    check(&list, 0, &["a number in 0.0..2.0", "a number, read only", "[\"a\",\"b\"]", "0.5"]);
    check(&ask(&["list", "nav", "--json"]), 0, &["\"parameter\":\"speed\"", "\"value\":0.5", "\"takes\":\"texts\""]);
    check(&ask(&["list"]), 0, &["nodes of ROS 2 are asked one at a time", "main/nav"]);
    check(&ask(&["get", "nav", "speed"]), 0, &["0.5"]);
    check(&ask(&["set", "nav", "speed", "1"]), 0, &["speed = 1.0", "the node has taken the value"]);
    assert!((node.value("speed") - 1.0).abs() < 1e-9);
    check(&ask(&["get", "main/nav", "speed", "--json"]), 0, &["1.0"]);
    check(&ask(&["set", "nav", "limit", "3"]), 1, &["the node refuses `3`: the limit is read-only"]);
    check(&ask(&["set", "nav", "speed", "fast"]), 1, &["`speed` cannot be `fast`: expected a number"]);
    check(&ask(&["set", "nav", "plugins", "[\"c\"]"]), 0, &["plugins = [\"c\"]"]);
    check(&ask(&["get", "nav", "sped"]), 1, &["has no value of `sped`; did you mean `speed`?"]);
    assert!((node.value("limit") - 2.0).abs() < 1e-9);
    // A node that has gone has not refused.
    drop(node);
    check(&ask(&["get", "nav", "speed"]), 3, &["of ROS 2"]);
    check(&ask(&["set", "nav", "speed", "2"]), 3, &["of ROS 2"]);
    mission.signal(Signal::INT);
    mission.ended(SOON);
    cluster.expect_nothing_left(Duration::from_secs(5));
}

#[test]
#[ignore = "long: a node has 5 s to answer"]
fn a_silent_node_is_out_of_reach() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let mut node = Node::new(&ros);
    let held = Arc::new(Mutex::new(Vec::new()));
    let own = Arc::clone(&held);
    node.services.remove(1).undeclare().wait().expect("a peer");
    let hold = move |query: Query| own.lock().expect("no test panics here").push(query);
    let silent = ros.session.declare_queryable("7/robot1/nav/get_parameters/*/*").complete(true).callback(hold).wait();
    let _silent = silent.expect("a peer");
    let mission = running(&cluster, &ros);
    check(&cluster.here().ask(&["param", "get", "nav", "speed"]), 3, &["no answer within 5 s"]);
    assert!(!held.lock().expect("no test panics here").is_empty(), "the node was asked");
    mission.signal(Signal::INT);
    mission.ended(SOON);
    cluster.expect_nothing_left(Duration::from_secs(5));
}
