//! Services: calls of a mission that a node of ROS 2 answers, and calls of nodes of ROS 2 that a procedure answers.

#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

use super::peer::{Bridge, Router, SOON, attachment, expect_reader, reply, serve, tokens, value};
use comms::logic::object::ObjectError;
use ros::logic::attachment::Gid;
use std::sync::mpsc::{Receiver, sync_channel};
use zenoh::query::{Query, QueryTarget};
use zenoh::{Session, Wait};

const CALL: &str = "?/robot1/reset std_srvs/srv/Trigger ::,10:,:,:,,";
const SERVE: &str = "!/robot1/reset std_srvs/srv/Trigger ::,10:,:,:,,";
/// The part of the service's key after its name.
const TRIGGER: &str =
    "std_srvs::srv::dds_::Trigger_/RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f";
/// A request without fields is one byte.
const REQUEST: [u8; 5] = [0, 1, 0, 0, 0];

fn key() -> String {
    format!("7/robot1/reset/{TRIGGER}")
}

/// Returns a response with success and a text.
fn response(text: &str) -> Vec<u8> {
    let mut bytes = vec![0, 1, 0, 0, 1, 0, 0, 0];
    bytes.extend((u32::try_from(text.len()).unwrap() + 1).to_le_bytes());
    bytes.extend(text.as_bytes());
    bytes.push(0);
    bytes
}

/// Calls until the bridge knows the server. Earlier calls are over then, and count as lost.
fn call_known(bridge: &mut Bridge, queries: &Receiver<Query>) -> (Query, Receiver<Result<Vec<u8>, ObjectError>>) {
    let until = comms::io::clock::now() + SOON;
    let mut answer = bridge.call("robot1.reset", &value(&REQUEST));
    while comms::io::clock::now() < until {
        if let Ok(query) = queries.recv_timeout(SOON / 1000) {
            return (query, answer);
        }
        if answer.try_recv().is_ok() {
            answer = bridge.call("robot1.reset", &value(&REQUEST));
        }
    }
    panic!("no call comes");
}

#[test]
fn a_call_has_the_answer_of_a_server() {
    let router = Router::new();
    let node = router.node();
    let (_tokens, shown) = tokens(&node, "@ros2_lv/7/*/*/*/SC/**");
    let (_server, queries) = serve(&node, key());
    let mut bridge = Bridge::new(CALL, &router);
    let (_, token) = shown.recv_timeout(SOON).unwrap();
    let zid = token.split('/').nth(2).unwrap();
    assert_eq!(token, format!("@ros2_lv/7/{zid}/0/1/SC/%/%/dca_door_main_ros/%robot1%reset/{TRIGGER}/::,10:,:,:,,"));
    let (query, answer) = call_known(&mut bridge, &queries);
    assert_eq!(query.payload().unwrap().to_bytes(), &REQUEST[..]);
    let told = query.attachment().unwrap().to_bytes().into_owned();
    let sequence = i64::from_le_bytes(told[..8].try_into().unwrap());
    let mut rule = attachment(sequence, 0);
    rule[8..16].copy_from_slice(&told[8..16]);
    rule[17..].copy_from_slice(&Gid::of(&token).0);
    assert_eq!(told, rule);
    reply(&query, &response("done"));
    assert_eq!(answer.recv_timeout(SOON).unwrap(), Ok(value(&response("done"))));
    // Several calls wait at the same time, and get their answers in any order.
    let answers = ["a", "b"].map(|_| bridge.call("robot1.reset", &value(&REQUEST)));
    let queries = [0; 2].map(|_| queries.recv_timeout(SOON).unwrap());
    let number = |query: &Query| query.attachment().unwrap().to_bytes()[0];
    assert_eq!(number(&queries[1]), number(&queries[0]) + 1);
    reply(&queries[1], &response("b"));
    reply(&queries[0], &response("a"));
    for (answer, text) in answers.iter().zip(["a", "b"]) {
        assert_eq!(answer.recv_timeout(SOON).unwrap(), Ok(value(&response(text))));
    }
    bridge.expect_signal("/robot1/reset received", 3.0);
}

#[test]
fn a_call_without_an_answer_ends() {
    let router = Router::new();
    let node = router.node();
    let mut bridge = Bridge::new(CALL, &router);
    let why = loop {
        match bridge.call("robot1.reset", &value(&REQUEST)).recv_timeout(SOON).unwrap() {
            // Until the bridge knows the servers, there may have been one.
            Err(ObjectError::Unanswered { .. }) => {}
            Err(why) => break why.to_string(),
            Ok(answer) => panic!("nothing answers: {answer:?}"),
        }
    };
    assert_eq!(why, "no node of ROS 2 answers the service `/robot1/reset`");
    let (server, queries) = serve(&node, key());
    let (query, answer) = call_known(&mut bridge, &queries);
    drop(query);
    let why = answer.recv_timeout(SOON).unwrap().unwrap_err();
    assert!(why.may_have_happened());
    assert_eq!(
        why.to_string(),
        "the service `/robot1/reset` of ROS 2 was called, but its server has ended or has dropped the call; the call may have been \
         carried out"
    );
    let (_query, answer) = call_known(&mut bridge, &queries);
    bridge.stop();
    assert!(!answer.recv_timeout(SOON).is_ok_and(|answer| answer.is_ok()), "the caller hears of it");
    let late = bridge.call("robot1.reset", &value(&REQUEST)).recv_timeout(SOON).unwrap().unwrap_err();
    assert!(late.to_string().contains("does not run"), "{late}");
    drop(server);
}

#[test]
fn what_is_no_response_is_refused() {
    let router = Router::new();
    let node = router.node();
    let (_server, queries) = serve(&node, key());
    let mut bridge = Bridge::new(CALL, &router);
    let whole = response("done");
    for nonsense in [&[][..], &whole[..whole.len() - 1], &[9; 40]] {
        let (query, answer) = call_known(&mut bridge, &queries);
        reply(&query, nonsense);
        let why = answer.recv_timeout(SOON).unwrap().unwrap_err().to_string();
        assert!(why.starts_with("the service was called, and its response is refused"), "{why}");
    }
    // An answer contains the number of its request and the name of the client.
    for (attachment, end) in [
        (None, "it has no attachment, or the attachment has another form"),
        (Some(vec![0; 32]), "it has no attachment, or the attachment has another form"),
        (Some(attachment(1_000, 1)), "its attachment belongs to another request"),
    ] {
        let (query, answer) = call_known(&mut bridge, &queries);
        let reply = query.reply(query.key_expr().clone(), &whole[..]);
        match attachment {
            Some(attachment) => reply.attachment(attachment).wait().unwrap(),
            None => reply.wait().unwrap(),
        }
        let why = answer.recv_timeout(SOON).unwrap().unwrap_err().to_string();
        assert_eq!(why, format!("the service was called, and its response is refused: {end}"));
    }
    let (query, answer) = call_known(&mut bridge, &queries);
    query.reply_err("not\nnow").wait().unwrap();
    let why = answer.recv_timeout(SOON).unwrap().unwrap_err().to_string();
    assert_eq!(why, "the service answers: not now");
    let why = bridge.call("robot1.reset", &[3, 0, 1, 0]).recv_timeout(SOON).unwrap().unwrap_err().to_string();
    assert_eq!(why, "its argument is not a `std_srvs/srv/Trigger_Request`");
    bridge.expect_signal("/robot1/reset refused", 8.0);
    let unknown = bridge.call("other", &value(&REQUEST)).recv_timeout(SOON).unwrap();
    assert!(matches!(unknown, Err(ObjectError::NoSuchProcedure { .. })), "{unknown:?}");
}

#[test]
fn an_answer_that_is_not_waited_for_is_dropped() {
    let router = Router::new();
    let node = router.node();
    let (_server, queries) = serve(&node, key());
    let mut bridge = Bridge::new(CALL, &router);
    let (first, _) = call_known(&mut bridge, &queries);
    let before = bridge.signal("/robot1/reset lost");
    bridge.give_up();
    bridge.expect_signal("/robot1/reset lost", before + 1.0);
    reply(&first, &response("late"));
    let (second, answer) = call_known(&mut bridge, &queries);
    reply(&second, &response("second"));
    assert_eq!(answer.recv_timeout(SOON).unwrap(), Ok(value(&response("second"))));
}

/// Calls like a client of ROS 2; the replies arrive one after the other.
fn ask(node: &Session, request: &[u8], attachment: Option<Vec<u8>>) -> Receiver<zenoh::query::Reply> {
    let (tx, rx) = sync_channel(8);
    let get = node.get(key()).payload(request.to_vec()).target(QueryTarget::AllComplete);
    let get = attachment.into_iter().fold(get, |get, attachment| get.attachment(attachment));
    get.callback(move |reply| drop(tx.try_send(reply))).wait().unwrap();
    rx
}

/// Waits until there is a server for the calls of the client.
fn expect_server(node: &Session) {
    let querier = node.declare_querier(key()).target(QueryTarget::AllComplete).wait().unwrap();
    let (until, pause) = (comms::io::clock::now() + SOON, comms::io::clock::Wakeup::default());
    while !querier.matching_status().wait().unwrap().matching() {
        assert!(comms::io::clock::now() < until, "there is no server");
        pause.wait(Some(comms::io::clock::now() + std::time::Duration::from_millis(5)));
    }
}

#[test]
fn a_client_has_the_answer_of_a_procedure() {
    let router = Router::new();
    let node = router.node();
    let (_tokens, shown) = tokens(&node, "@ros2_lv/7/*/*/*/SS/**");
    let mut bridge = Bridge::new(SERVE, &router);
    let (_, token) = shown.recv_timeout(SOON).unwrap();
    let zid = token.split('/').nth(2).unwrap();
    assert_eq!(token, format!("@ros2_lv/7/{zid}/0/1/SS/%/%/dca_door_main_ros/%robot1%reset/{TRIGGER}/::,10:,:,:,,"));
    expect_server(&node);
    let first = ask(&node, &REQUEST, Some(attachment(41, 5)));
    let second = ask(&node, &REQUEST, Some(attachment(42, 6)));
    let calls = bridge.asked(2);
    assert!(calls.iter().all(|(call, _, argument)| *call == "robot1.reset" && *argument == value(&REQUEST)));
    bridge.answer("robot1.reset", calls[1].1, Ok(value(&response("second"))));
    bridge.answer("robot1.reset", calls[0].1, Ok(value(&response("first"))));
    bridge.answer("robot1.reset", calls[0].1, Ok(value(&response("again"))));
    for (replies, text, told) in [(first, "first", attachment(41, 5)), (second, "second", attachment(42, 6))] {
        let reply = replies.recv_timeout(SOON).unwrap();
        let sample = reply.result().unwrap();
        assert_eq!((sample.key_expr().as_str(), sample.payload().to_bytes().into_owned()), (&*key(), response(text)));
        let own = sample.attachment().unwrap().to_bytes().into_owned();
        assert_eq!((&own[..8], &own[16..], own.len()), (&told[..8], &told[16..], 33), "the caller's number and name");
        assert!(replies.recv_timeout(SOON).is_err(), "there is one reply");
    }
    bridge.expect_signal("/robot1/reset received", 2.0);
}

#[test]
fn a_request_without_an_answer_is_told() {
    let router = Router::new();
    let node = router.node();
    let mut bridge = Bridge::new(SERVE, &router);
    expect_server(&node);
    let told = |replies: Receiver<zenoh::query::Reply>| {
        let reply = replies.recv_timeout(SOON).unwrap();
        reply.result().unwrap_err().payload().try_to_string().unwrap().into_owned()
    };
    for (request, attachment) in [
        (&REQUEST[..], None),
        (&REQUEST[..], Some(attachment(1, 1)[..32].to_vec())),
        (&REQUEST[..4], Some(attachment(1, 1))),
        (&[][..], Some(attachment(1, 1))),
    ] {
        let why = told(ask(&node, request, attachment));
        assert!(why.contains("attachment") || why.contains("its bytes are not"), "{why}");
    }
    bridge.expect_signal("/robot1/reset refused", 4.0);
    let replies = ask(&node, &REQUEST, Some(attachment(2, 1)));
    let number = bridge.asked(1)[0].1;
    bridge.answer("robot1.reset", number, Err(ObjectError::Refused { reason: "the hand is full".to_owned() }));
    assert_eq!(told(replies), "the hand is full");
    let replies = ask(&node, &REQUEST, Some(attachment(3, 1)));
    let number = bridge.asked(1)[0].1;
    bridge.answer("robot1.reset", number, Ok(vec![2, 0, 1]));
    assert_eq!(told(replies), "its result is not the response of the service");
    bridge.expect_signal("/robot1/reset lost", 2.0);
    let mut waiting: Vec<_> = (0..65).map(|number| ask(&node, &REQUEST, Some(attachment(number, 2)))).collect();
    bridge.expect_signal("/robot1/reset refused", 5.0);
    let last = waiting.pop().unwrap();
    assert_eq!(told(last), "64 requests are waiting already");
    bridge.stop();
    for replies in waiting {
        assert!(replies.recv_timeout(SOON).is_err(), "the client hears that the server is gone");
    }
}

/// Topics and services with the same name have different keys.
#[test]
fn topics_and_services_are_carried_together() {
    let router = Router::new();
    let node = router.node();
    let routes = format!("{CALL};!/set std_srvs/srv/SetBool ::,10:,:,:,,;</chatter std_msgs/msg/String ::,10:,:,:,,");
    let (_server, queries) = serve(&node, key());
    let mut bridge = Bridge::new(&routes, &router);
    let (query, answer) = call_known(&mut bridge, &queries);
    reply(&query, &response("done"));
    assert!(answer.recv_timeout(SOON).unwrap().is_ok());
    let key = format!("7/chatter/{}", super::peer::STRING);
    expect_reader(&node, &key);
    node.put(key, super::peer::string("a")).attachment(attachment(1, 1)).wait().unwrap();
    assert_eq!(bridge.sent(1).values, [("chatter", value(&super::peer::string("a")))]);
}
