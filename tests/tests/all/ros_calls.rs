//! Missions with services and actions of ROS 2. A peer on plain Zenoh answers and calls through the bridge.

use super::ros_topics::{Ros, attachment, run};
use dca_tests::cluster::{Cluster, SOON, Stream, wait_until};
use rustix::process::Signal;
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;
use zenoh::Wait;
use zenoh::query::{Query, QueryTarget, Queryable};

const SERVICES: &str = "
process main() {
    host { c1 }
    instantiated_processes { task instof Resetter(c1); }
    internal_connections {
        task.Reset -> service(\"/reset\");
        service(\"/told\") -> task.Told;
    }
    internal_event_actions { task }
}
";
const ACTION: &str = "
module Count(host) { action \"/fib\": ros.example.Fibonacci; }
process main() {
    host { c1 }
    instantiated_processes { order instof Order(c1); count instof Count(c1); }
    internal_event_actions { order : count }
}
";
/// The part of a service's key after its name.
const TRIGGER: &str =
    "std_srvs::srv::dds_::Trigger_/RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f";
pub(super) const SEND: &str = "7/fib/_action/send_goal/example_interfaces::action::dds_::Fibonacci_SendGoal_/RIHS01_d1a57fb2a4afe8c21e34fb10db206f16ce6729b28531141472df92277c55b557";
pub(super) const RESULT: &str = "7/fib/_action/get_result/example_interfaces::action::dds_::Fibonacci_GetResult_/RIHS01_1b0de0d5d29dc955d92f546706568428632771db13ec84c15ec1c1a59f424a57";
pub(super) const CANCEL: &str = "7/fib/_action/cancel_goal/action_msgs::srv::dds_::CancelGoal_/RIHS01_573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a";

pub(super) fn serve(ros: &Ros, key: &str) -> (Queryable<()>, Receiver<Query>) {
    let (tx, queries) = sync_channel(64);
    let hear = move |query| drop(tx.try_send(query));
    (ros.session.declare_queryable(key.to_owned()).complete(true).callback(hear).wait().expect("a peer"), queries)
}

pub(super) fn reply(query: &Query, response: &[u8]) {
    let told = query.attachment().expect("each request has one").clone();
    query.reply(query.key_expr().clone(), response).attachment(told).wait().expect("a peer");
}

/// Success, and `hello`.
const HELLO: [u8; 18] = [0, 1, 0, 0, 1, 0, 0, 0, 6, 0, 0, 0, b'h', b'e', b'l', b'l', b'o', 0];

#[test]
fn services_are_called_both_ways() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let (_reset, queries) = serve(&ros, &format!("7/reset/{TRIGGER}"));
    let mission = run(&cluster, &ros, SERVICES);
    let query = queries.recv_timeout(SOON).unwrap_or_else(|_| panic!("{}", mission.text(Stream::Err)));
    assert_eq!(query.payload().expect("it has one").to_bytes(), &[0, 1, 0, 0, 0][..]);
    reply(&query, &HELLO);
    let mut told = None;
    let answered = wait_until(SOON, || {
        let (tx, replies) = sync_channel(1);
        let get = ros.session.get(format!("7/told/{TRIGGER}")).payload(&[0, 1, 0, 0, 0][..]).attachment(attachment(1));
        let get = get.target(QueryTarget::AllComplete).callback(move |reply| drop(tx.try_send(reply)));
        get.wait().expect("a peer");
        let reply = replies.recv_timeout(SOON).ok();
        let sample = reply.and_then(|reply| reply.into_result().ok());
        told = sample.map(|sample| sample.payload().to_bytes().into_owned());
        told.is_some()
    });
    assert!(answered.is_some(), "{}", mission.text(Stream::Err));
    assert_eq!(told.as_deref(), Some(&HELLO[..]));
    mission.signal(Signal::INT);
    mission.ended(SOON);
    cluster.expect_nothing_left(Duration::from_secs(5));
}

#[test]
fn an_action_is_a_task_that_ends_or_is_stopped() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let servers = [SEND, RESULT, CANCEL].map(|key| serve(&ros, key));
    let [sent, asked, canceled] = &servers.each_ref().map(|(_, queries)| queries);
    for is_stopped in [false, true] {
        let mission = run(&cluster, &ros, ACTION);
        let goal = sent.recv_timeout(SOON).unwrap_or_else(|_| panic!("{}", mission.text(Stream::Err)));
        let request = goal.payload().expect("it has one").to_bytes().into_owned();
        assert_eq!((request.len(), &request[20..]), (24, &[5, 0, 0, 0][..]), "the goal of the process before it");
        reply(&goal, &[0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
        let question = asked.recv_timeout(SOON).expect("it asks for the result");
        let status = if is_stopped {
            mission.signal(Signal::INT);
            let cancel = canceled.recv_timeout(SOON).expect("a stop cancels the goal");
            assert_eq!(cancel.payload().expect("it has one").to_bytes()[..20], request[..20]);
            reply(&cancel, &[0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
            5
        } else {
            4
        };
        reply(&question, &[0, 1, 0, 0, status, 0, 0, 0, 1, 0, 0, 0, 7, 0, 0, 0]);
        let ended = mission.ended(SOON);
        assert_eq!(ended.code == Some(0), !is_stopped, "{ended}");
        cluster.expect_nothing_left(Duration::from_secs(5));
    }
}

/// A server that does not cancel the goal. Neither the stop nor the mission claims that nothing is left.
#[test]
fn a_stop_says_that_a_goal_may_go_on() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let servers = [SEND, RESULT, CANCEL].map(|key| serve(&ros, key));
    let [sent, _, canceled] = &servers.each_ref().map(|(_, queries)| queries);
    let mission = run(&cluster, &ros, &ACTION.replace("Fibonacci;", "Fibonacci; stop within 500 ms;"));
    let goal = sent.recv_timeout(SOON).unwrap_or_else(|_| panic!("{}", mission.text(Stream::Err)));
    reply(&goal, &[0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
    let stop = cluster.here().dca(&["stop", "echo"]);
    let cancel = canceled.recv_timeout(SOON).expect("a stop cancels the goal");
    reply(&cancel, &[0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0]);
    let stopped = stop.ended(SOON);
    assert_eq!(stopped.code, Some(1), "{stopped}");
    let goes_on = "the goal of action `/fib` may go on in ROS 2";
    assert!(stopped.err.contains(goes_on) && !stopped.out.contains("nothing of it is left"), "{stopped}");
    let ended = mission.ended(SOON);
    assert!(ended.code == Some(1) && format!("{}{}", ended.out, ended.err).contains(goes_on), "{ended}");
    cluster.expect_nothing_left(Duration::from_secs(5));
}
