//! Actions as tasks, against a server on plain Zenoh.

#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

use super::peer::{Bridge, Router, SOON, attachment, reply, serve, value, value_of};
use controllers::sdk::{Progress, Stopping};
use std::sync::mpsc::Receiver;
use std::time::Duration;
use zenoh::query::{Query, Queryable};
use zenoh::{Session, Wait};

/// The parts of the action's keys after its name.
const SEND: &str = "send_goal/example_interfaces::action::dds_::Fibonacci_SendGoal_/RIHS01_d1a57fb2a4afe8c21e34fb10db206f16ce6729b28531141472df92277c55b557";
const RESULT: &str = "get_result/example_interfaces::action::dds_::Fibonacci_GetResult_/RIHS01_1b0de0d5d29dc955d92f546706568428632771db13ec84c15ec1c1a59f424a57";
const CANCEL: &str = "cancel_goal/action_msgs::srv::dds_::CancelGoal_/RIHS01_573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a";
const FEEDBACK: &str = "feedback/example_interfaces::action::dds_::Fibonacci_FeedbackMessage_/RIHS01_c1de71afd52e49a89c53d8262366884185bc0a02f78ce051c4e46b0a7fe59bb2";
/// The CDR of the goal: the order is 5.
const GOAL: [u8; 8] = [0, 1, 0, 0, 5, 0, 0, 0];

fn key(part: &str) -> String {
    format!("7/arm/fib/_action/{part}")
}

/// Returns the CDR of a sequence of two numbers, after the bytes `front`.
fn sequence(front: &[u8]) -> Vec<u8> {
    [&[0, 1, 0, 0], front, &[2, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0]].concat()
}

/// Returns the answer to the request for the result: its status, then the sequence.
fn result(status: u8) -> Vec<u8> {
    sequence(&[status, 0, 0, 0])
}

/// Returns the answer to a goal: whether it is accepted, and the time.
fn taken(is_taken: bool) -> Vec<u8> {
    [&[0, 1, 0, 0, u8::from(is_taken), 0, 0, 0][..], &[0; 8]].concat()
}

/// The answer to a request to cancel: accepted, with an empty list.
const CANCELING: [u8; 12] = [0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
/// Answers to the same request: refused, and the goal is unknown.
const REFUSING: [u8; 12] = [0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0];
const UNKNOWN: [u8; 12] = [0, 1, 0, 0, 2, 0, 0, 0, 0, 0, 0, 0];

/// A server that hands over its queries.
struct Server {
    node: Session,
    _services: [Queryable<()>; 3],
    sent: Receiver<Query>,
    asked: Receiver<Query>,
    canceled: Receiver<Query>,
}

impl Server {
    fn new(router: &Router) -> Self {
        let node = router.node();
        let [(a, sent), (b, asked), (c, canceled)] = [SEND, RESULT, CANCEL].map(|part| serve(&node, key(part)));
        Self { node, _services: [a, b, c], sent, asked, canceled }
    }
}

/// Returns an action with a goal.
fn started(router: &Router) -> Bridge {
    let mut action = idle(router);
    action.start_with(&value(&GOAL)).unwrap();
    action
}

fn idle(router: &Router) -> Bridge {
    let arguments = ["action=/arm/fib", "type=example_interfaces/action/Fibonacci", "stop_ms=60000"];
    Bridge::of("main/nav", "RosAction", &arguments.map(str::to_owned), &router.setting())
}

/// Waits for the goal and accepts it; returns its id.
fn take(action: &mut Bridge, server: &Server) -> [u8; 16] {
    let query = action.until(|| server.sent.try_recv().ok());
    let request = query.payload().unwrap().to_bytes().into_owned();
    assert_eq!((&request[..4], &request[20..]), (&GOAL[..4], &GOAL[4..]));
    reply(&query, &taken(true));
    request[4..20].try_into().unwrap()
}

#[test]
fn a_goal_has_feedback_and_a_result() {
    let router = Router::new();
    let server = Server::new(&router);
    let mut action = started(&router);
    let id = take(&mut action, &server);
    let query = action.until(|| server.asked.try_recv().ok());
    assert_eq!(query.payload().unwrap().to_bytes(), [&[0, 1, 0, 0], &id[..]].concat());
    super::peer::expect_reader(&server.node, &key(FEEDBACK));
    for (sequence_number, goal) in [(1, [9; 16]), (2, id)] {
        let put = server.node.put(key(FEEDBACK), sequence(&goal)).attachment(attachment(sequence_number, 1));
        put.wait().unwrap();
    }
    let sent = action.sent(1);
    assert_eq!(sent.values, [("Feedback", value_of(&sequence(&[])))], "that of another goal is left out");
    action.expect_signal("server", 1.0);
    reply(&query, &result(4));
    assert_eq!(action.ended(), Progress::Done(value(&sequence(&[]))));
    assert_eq!(action.stop_once(), Stopping::Finished);
    assert!(server.canceled.try_recv().is_err());
    // The next goal has another id.
    action.start_with(&value(&GOAL)).unwrap();
    assert_ne!(take(&mut action, &server), id);
}

#[test]
fn a_stop_cancels_the_goal() {
    let router = Router::new();
    let server = Server::new(&router);
    let mut action = started(&router);
    let id = take(&mut action, &server);
    let query = action.until(|| server.asked.try_recv().ok());
    assert_eq!(action.stop_once(), Stopping::Again);
    let cancel = server.canceled.recv_timeout(SOON).unwrap();
    assert_eq!(cancel.payload().unwrap().to_bytes(), [&[0, 1, 0, 0], &id[..], &[0; 8]].concat());
    reply(&cancel, &CANCELING);
    assert_eq!(action.stop_once(), Stopping::Again, "its end has not come");
    reply(&query, &result(5));
    action.stopped();
    assert_eq!(action.unconfirmed(), None);
    assert!(server.canceled.try_recv().is_err(), "it is canceled once");
}

/// Otherwise the server could begin the goal after the mission was reported as stopped.
#[test]
fn a_stop_cancels_a_goal_that_is_not_accepted_yet() {
    let router = Router::new();
    let server = Server::new(&router);
    let mut action = started(&router);
    let goal = action.until(|| server.sent.try_recv().ok());
    let id = goal.payload().unwrap().to_bytes()[4..20].to_vec();
    let cancel = action.stopping_until(|| server.canceled.try_recv().ok());
    assert_eq!(cancel.payload().unwrap().to_bytes(), [&[0, 1, 0, 0], &id[..], &[0; 8]].concat());
    reply(&cancel, &UNKNOWN);
    drop(cancel);
    reply(&goal, &taken(true));
    let again = action.stopping_until(|| server.canceled.try_recv().ok());
    reply(&again, &CANCELING);
    let query = action.stopping_until(|| server.asked.try_recv().ok());
    reply(&query, &result(5));
    action.stopped();
    assert_eq!(action.unconfirmed(), None);
}

#[test]
fn a_goal_that_may_go_on_is_told() {
    let router = Router::new();
    let server = Server::new(&router);
    for (answer, why) in [
        (None, "the request to cancel the goal has no answer"),
        (Some(&REFUSING), "its server refuses to cancel the goal"),
        (Some(&CANCELING), "its server is canceling the goal, and has not ended it"),
    ] {
        let mut action = started(&router);
        take(&mut action, &server);
        let _question = action.until(|| server.asked.try_recv().ok());
        let cancel = action.stopping_until(|| server.canceled.try_recv().ok());
        if let Some(answer) = answer {
            action.woken_by(|| reply(&cancel, answer));
            action.stop_once();
        }
        let expected = format!("the goal of action `/arm/fib` may go on in ROS 2: {why}");
        assert_eq!(action.unconfirmed(), Some(expected));
        assert_eq!((action.stop_once(), action.unconfirmed()), (Stopping::Finished, None));
    }
}

/// The process ends, and its goal is canceled.
#[test]
fn a_result_that_is_not_the_end_of_a_goal_cancels_it() {
    let router = Router::new();
    let server = Server::new(&router);
    for (answer, why) in [
        (Some(result(2)), "its server has answered with status 2, which is not the end of a goal"),
        (Some(vec![0, 1, 0, 0, 4]), "its result cannot be read"),
        (None, "its result cannot be read: the service answers: no"),
    ] {
        let mut action = started(&router);
        take(&mut action, &server);
        let query = action.until(|| server.asked.try_recv().ok());
        match answer {
            Some(answer) => reply(&query, &answer),
            None => query.reply_err("no").wait().unwrap(),
        }
        let Progress::Aborted(told) = action.ended() else { panic!("it has not failed") };
        assert!(told.starts_with(&format!("action `/arm/fib`: {why}")), "{told}");
        let cancel = action.stopping_until(|| server.canceled.try_recv().ok());
        reply(&cancel, &CANCELING);
        let again = action.stopping_until(|| server.asked.try_recv().ok());
        reply(&again, &result(5));
        action.stopped();
        assert_eq!(action.unconfirmed(), None);
    }
}

/// Both servers of one action get the requests, and only one of them has the goal.
#[test]
fn a_server_that_does_not_know_the_goal_does_not_end_it() {
    let router = Router::new();
    let (server, other) = (Server::new(&router), Server::new(&router));
    let mut action = started(&router);
    reply(&action.until(|| other.sent.try_recv().ok()), &taken(true));
    take(&mut action, &server);
    let query = action.until(|| other.asked.try_recv().ok());
    reply(&query, &result(0));
    drop(query);
    let query = action.until(|| server.asked.try_recv().ok());
    reply(&query, &result(4));
    drop(query);
    assert_eq!(action.ended(), Progress::Done(value(&sequence(&[]))));
    // None of the servers knows the goal.
    action.start_with(&value(&GOAL)).unwrap();
    reply(&action.until(|| other.sent.try_recv().ok()), &taken(true));
    take(&mut action, &server);
    for one in [&server, &other] {
        let query = action.until(|| one.asked.try_recv().ok());
        reply(&query, &result(0));
    }
    let why = "action `/arm/fib`: its server does not know the goal any more".to_owned();
    assert_eq!(action.ended(), Progress::Aborted(why));
}

#[test]
fn ends_of_goals_are_told() {
    let router = Router::new();
    let server = Server::new(&router);
    let mut action = started(&router);
    let query = action.until(|| server.sent.try_recv().ok());
    reply(&query, &taken(false));
    assert_eq!(action.ended(), Progress::Aborted("the server of `/arm/fib` has rejected the goal".to_owned()));
    for (answer, why) in [
        (result(6), "its server has aborted the goal"),
        (result(5), "another client has canceled the goal"),
        (vec![0, 1, 0, 0, 4], "its result cannot be read"),
    ] {
        action.start_with(&value(&GOAL)).unwrap();
        take(&mut action, &server);
        let query = action.until(|| server.asked.try_recv().ok());
        reply(&query, &answer);
        let Progress::Aborted(told) = action.ended() else { panic!("it has not failed") };
        assert!(told.starts_with(&format!("action `/arm/fib`: {why}")), "{told}");
    }
}

#[test]
fn a_result_is_asked_for_again_and_late_answers_are_nothing() {
    let router = Router::new();
    let server = Server::new(&router);
    let mut action = started(&router);
    take(&mut action, &server);
    drop(action.until(|| server.asked.try_recv().ok()));
    let late = action.until(|| server.asked.try_recv().ok());
    assert_eq!(action.calculate_after(Duration::ZERO), Progress::Continue);
    // The process is stopped, and the server answers after the end of the process.
    assert_eq!(action.stop_once(), Stopping::Again);
    action.start_with(&value(&GOAL)).unwrap();
    late.reply(late.key_expr().clone(), result(6)).wait().unwrap();
    take(&mut action, &server);
    let query = action.until(|| server.asked.try_recv().ok());
    reply(&query, &result(4));
    assert_eq!(action.ended(), Progress::Done(value(&sequence(&[]))));
}

#[test]
fn a_server_that_is_not_there_is_named() {
    let router = Router::new();
    let mut action = started(&router);
    assert_eq!(action.calculate_after(Duration::ZERO), Progress::Continue);
    let why = "action `/arm/fib`: no node of ROS 2 serves it within 5 s".to_owned();
    assert_eq!(action.calculate_after(Duration::from_secs(6)), Progress::Aborted(why));
    let server = Server::new(&router);
    action.start_with(&value(&GOAL)).unwrap();
    take(&mut action, &server);
    action.until(|| server.asked.try_recv().ok());
    drop(server);
    let told = (1..10_000).find_map(|count| {
        let progress = action.calculate_after(Duration::from_secs(6) * count);
        if let Progress::Aborted(why) = progress { Some(why) } else { None }
    });
    let told = told.expect("it ends");
    assert_eq!(told, "action `/arm/fib`: its server has been away for 5 s");
}

#[test]
fn a_start_value_that_is_no_goal_is_refused() {
    let router = Router::new();
    let mut action = idle(&router);
    for nonsense in [&[][..], &[8, 0, 1, 0], &value(&GOAL[..7])] {
        let why = action.start_with(nonsense).unwrap_err();
        assert!(why.starts_with("its start value is not a `ros.example.Fibonacci_Goal`"), "{why}");
    }
}
