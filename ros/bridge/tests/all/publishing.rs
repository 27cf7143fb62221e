//! Wires to topics: what a node of ROS 2 hears and sees.

use super::peer::{Bridge, Router, SOON, STRING, attachment, hear, string, tokens, value};
use ros::logic::attachment::Gid;
use std::sync::mpsc::Receiver;
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Session, Wait};
use zenoh_ext::{AdvancedSubscriber, AdvancedSubscriberBuilderExt, HistoryConfig, RecoveryConfig};

const ROUTE: &str = ">/robot1/chatter std_msgs/msg/String ::,10:,:,:,,";

/// Sends until a message is heard: then the bridge knows the subscription. Returns how many messages that took.
fn until_heard(bridge: &mut Bridge, messages: &Receiver<Sample>) -> i64 {
    for count in 1..1000 {
        assert!(bridge.deliver("robot1.chatter", &value(&string("begin"))));
        if messages.recv_timeout(SOON / 1000).is_ok() {
            return count;
        }
    }
    panic!("nothing is heard");
}

/// Returns the next message after those of [`until_heard`].
fn next(messages: &Receiver<Sample>) -> Sample {
    loop {
        let sample = messages.recv_timeout(SOON).expect("a message comes");
        if sample.payload().to_bytes() != string("begin") {
            return sample;
        }
    }
}

#[test]
fn a_message_has_its_key_its_attachment_and_its_token() {
    let router = Router::new();
    let node = router.node();
    let (_tokens, shown) = tokens(&node, "@ros2_lv/7/**");
    let (_heard, messages) = hear(&node, &format!("7/robot1/chatter/{STRING}"));
    let mut bridge = Bridge::new(ROUTE, &router);
    let mut keys = [0; 2].map(|_| shown.recv_timeout(SOON).unwrap());
    keys.sort_by_key(|(_, key)| key.len());
    let zid = keys[0].1.split('/').nth(2).unwrap().to_owned();
    let publisher = format!("@ros2_lv/7/{zid}/0/1/MP/%/%/dca_door_main_ros/%robot1%chatter/{STRING}/::,10:,:,:,,");
    let expected = [format!("@ros2_lv/7/{zid}/0/0/NN/%/%/dca_door_main_ros"), publisher.clone()];
    assert_eq!(keys, expected.map(|key| (SampleKind::Put, key)));

    let begun = until_heard(&mut bridge, &messages);
    for (sequence, text) in (begun + 1..).zip(["hello", "world"]) {
        assert!(bridge.deliver("robot1.chatter", &value(&string(text))));
        let sample = next(&messages);
        assert_eq!(sample.payload().to_bytes(), string(text));
        let told = sample.attachment().unwrap().to_bytes().into_owned();
        let mut rule = attachment(sequence, 0);
        rule[8..16].copy_from_slice(&told[8..16]);
        rule[17..].copy_from_slice(&Gid::of(&publisher).0);
        assert_eq!(told, rule);
        let nanos = i64::from_le_bytes(told[8..16].try_into().unwrap());
        assert!(nanos > 1_700_000_000_000_000_000, "{nanos}");
    }

    bridge.stop();
    let mut gone = [0; 2].map(|_| shown.recv_timeout(SOON).unwrap());
    gone.sort_by_key(|(_, key)| key.len());
    assert_eq!(gone.map(|(kind, _)| kind), [SampleKind::Delete; 2]);
}

/// A subscriber of ROS 2 counts what is lost behind the bridge, by the numbers of the messages.
#[test]
fn values_that_a_wire_has_lost_are_counted() {
    let router = Router::new();
    let mut bridge = Bridge::new(ROUTE, &router);
    bridge.lose("robot1.chatter", 3);
    assert!(bridge.deliver("robot1.chatter", &value(&string("after"))));
    bridge.lose("robot1.chatter", 2);
    bridge.expect_signal("/robot1/chatter lost", 5.0);
    bridge.expect_signal("/robot1/chatter received", 1.0);
}

/// Subscribes to `/map` as a node of ROS 2 does that wants the last messages.
fn subscribe_late(node: &Session) -> (AdvancedSubscriber<()>, Receiver<Sample>) {
    let (tx, heard) = std::sync::mpsc::sync_channel(8);
    let subscriber =
        node.declare_subscriber(format!("7/map/{STRING}")).callback(move |sample| drop(tx.try_send(sample)));
    let history = HistoryConfig::default().detect_late_publishers().max_samples(2);
    let late = subscriber.advanced().history(history).recovery(RecoveryConfig::default().heartbeat()).wait();
    (late.expect("a peer of a test"), heard)
}

#[test]
fn a_late_subscriber_gets_what_was_published() {
    let router = Router::new();
    let route = ">/map std_msgs/msg/String :1:,2:,:,:,,";
    let mut bridge = Bridge::new(route, &router);
    for text in ["one", "two", "three"] {
        assert!(bridge.deliver("map", &value(&string(text))));
    }
    let node = router.node();
    let (late, heard) = subscribe_late(&node);
    // On a busy machine the first one may still be on its way when the subscriber comes.
    let mut texts = Vec::new();
    while texts.last() != Some(&string("three")) {
        texts.push(heard.recv_timeout(SOON).unwrap().payload().to_bytes().into_owned());
    }
    assert!(texts.ends_with(&[string("two"), string("three")]), "{texts:?}");
    drop(late);
}

/// The wire of such a topic keeps the last value for a bridge that does not run yet, or not any more.
#[test]
fn a_value_from_before_its_start_is_published() {
    let router = Router::new();
    let node = router.node();
    let (_early, first) = subscribe_late(&node);
    let mut bridge = Bridge::idle(">/map std_msgs/msg/String :1:,2:,:,:,,", &router.setting());
    for text in ["old", "new"] {
        assert!(bridge.deliver("map", &value(&string(text))));
    }
    bridge.start().unwrap();
    let (_late, second) = subscribe_late(&node);
    for messages in [first, second] {
        assert_eq!(messages.recv_timeout(SOON).unwrap().payload().to_bytes(), string("new"));
    }
    bridge.expect_signal("/map received", 2.0);
}

#[test]
fn a_value_that_is_no_message_does_not_reach_ros() {
    let router = Router::new();
    let node = router.node();
    let (_heard, messages) = hear(&node, "7/robot1/chatter/**");
    let mut bridge = Bridge::new(ROUTE, &router);
    let whole = value(&string("hello"));
    for nonsense in [&[][..], &whole[..5], &whole[1..], &[5, 0, 1, 0, 0, 9], &[200; 20]] {
        assert!(!bridge.deliver("robot1.chatter", nonsense), "{nonsense:?}");
    }
    assert!(!bridge.deliver("other", &whole));
    bridge.expect_signal("/robot1/chatter refused", 5.0);
    until_heard(&mut bridge, &messages);
    assert!(bridge.deliver("robot1.chatter", &whole));
    assert_eq!(next(&messages).payload().to_bytes(), string("hello"));
}

#[test]
fn a_router_that_is_not_there_is_named() {
    let locator = Router::new().locator();
    let mut bridge = Bridge::idle(ROUTE, &format!("connect/endpoints=[\"{locator}\"]"));
    let why = bridge.start().unwrap_err();
    assert!(why.contains(&locator) && why.contains("rmw_zenohd"), "{why}");
    let mut bridge = Bridge::idle(ROUTE, "no/such/setting=1");
    assert!(bridge.start().unwrap_err().contains("no/such/setting"));
}
