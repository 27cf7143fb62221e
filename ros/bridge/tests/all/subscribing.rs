//! Topics to wires: what wires get of a node of ROS 2.

use super::peer::{Bridge, Router, STRING, attachment, expect_reader, string, value};
use zenoh::Wait;
use zenoh_ext::{AdvancedPublisherBuilderExt, CacheConfig, MissDetectionConfig};

const ROUTE: &str = "</chatter std_msgs/msg/String ::,10:,:,:,,";

#[test]
fn messages_go_to_wires_and_missing_ones_are_counted() {
    let router = Router::new();
    let mut bridge = Bridge::new(ROUTE, &router);
    let node = router.node();
    let key = format!("7/chatter/{STRING}");
    expect_reader(&node, &key);
    for (sequence, text) in [(1, "a"), (2, "b"), (5, "c")] {
        node.put(&key, string(text)).attachment(attachment(sequence, 1)).wait().unwrap();
    }
    let sent = bridge.sent(3);
    assert_eq!(sent.values, ["a", "b", "c"].map(|text| ("chatter", value(&string(text)))));
    assert_eq!(sent.skipped, 2);
    bridge.expect_signal("/chatter received", 3.0);
    bridge.expect_signal("/chatter lost", 2.0);
    bridge.expect_signal("router", 1.0);
}

/// In its keys is a word in the place of the hash of a type.
#[test]
fn nodes_of_humble_are_heard() {
    let router = Router::new();
    let arguments = [format!("routes={ROUTE}"), "distribution=humble".to_owned()];
    let mut bridge = Bridge::of("main/ros", "RosBridge", &arguments, &router.setting());
    bridge.start().unwrap();
    let node = router.node();
    let key = "7/chatter/std_msgs::msg::dds_::String_/TypeHashNotSupported";
    expect_reader(&node, key);
    node.put(key, string("a")).attachment(attachment(1, 1)).wait().unwrap();
    assert_eq!(bridge.sent(1).values, [("chatter", value(&string("a")))]);
}

#[test]
fn a_late_bridge_gets_what_was_published() {
    let router = Router::new();
    let node = router.node();
    let publisher = node.declare_publisher(format!("7/map/{STRING}")).advanced();
    let detection = MissDetectionConfig::default().sporadic_heartbeat(std::time::Duration::from_millis(500));
    let publisher = publisher.cache(CacheConfig::default().max_samples(1)).publisher_detection();
    let publisher = publisher.sample_miss_detection(detection).wait().unwrap();
    publisher.put(string("old")).attachment(attachment(1, 1)).wait().unwrap();
    publisher.put(string("new")).attachment(attachment(2, 1)).wait().unwrap();

    let mut bridge = Bridge::new("</map std_msgs/msg/String :1:,1:,:,:,,", &router);
    assert_eq!(bridge.sent(1).values, [("map", value(&string("new")))]);
    // The next life of the bridge is as late as the first.
    bridge.stop();
    bridge.start().unwrap();
    assert_eq!(bridge.sent(1).values, [("map", value(&string("new")))]);
    publisher.put(string("newest")).attachment(attachment(3, 1)).wait().unwrap();
    assert_eq!(bridge.sent(1).values, [("map", value(&string("newest")))]);
}

#[test]
fn a_router_that_comes_back_is_found() {
    let router = Router::new();
    let locator = router.locator();
    let mut bridge = Bridge::new(ROUTE, &router);
    bridge.expect_signal("router", 1.0);
    drop(router);
    bridge.expect_signal("router", 0.0);
    let router = Router::at(&locator);
    bridge.expect_signal("router", 1.0);
    let node = router.node();
    let key = format!("7/chatter/{STRING}");
    expect_reader(&node, &key);
    node.put(key, string("a")).attachment(attachment(1, 1)).wait().unwrap();
    assert_eq!(bridge.sent(1).values, [("chatter", value(&string("a")))]);
}
