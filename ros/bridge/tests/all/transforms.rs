//! Transforms: the names of frames on both ways, and static transforms of several publishers for late subscribers.

use super::peer::{Bridge, Router, SOON, attachment, expect_reader, hear, value_of};
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;
use zenoh::sample::Sample;
use zenoh::{Session, Wait};
use zenoh_ext::{
    AdvancedPublisher, AdvancedPublisherBuilderExt, AdvancedSubscriber, AdvancedSubscriberBuilderExt, CacheConfig,
    HistoryConfig, MissDetectionConfig, RecoveryConfig,
};

/// The key of a topic of transforms behind its name.
const TRANSFORMS: &str =
    "tf2_msgs::msg::dds_::TFMessage_/RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087";
const BOTH: &str = ">/tf tf2_msgs/msg/TFMessage ::,100:,:,:,, r1/;</tf tf2_msgs/msg/TFMessage ::,100:,:,:,, r1/";

/// A transform from a frame to another one.
type Transform<'a> = [&'a str; 2];

/// Returns the CDR of transforms, by the rules of its alignment.
fn transforms(all: &[Transform<'_>]) -> Vec<u8> {
    fn align(body: &mut Vec<u8>, to: usize) {
        body.resize(body.len().next_multiple_of(to), 0);
    }
    fn number(body: &mut Vec<u8>, number: usize) {
        align(body, 4);
        body.extend(u32::try_from(number).expect("a peer of a test").to_le_bytes());
    }
    let mut body = Vec::new();
    number(&mut body, all.len());
    for frames in all {
        number(&mut body, 1_700_000_000);
        number(&mut body, 5);
        for frame in frames {
            number(&mut body, frame.len() + 1);
            body.extend(frame.as_bytes());
            body.push(0);
        }
        align(&mut body, 8);
        for value in [0.5, -1.0, 2.0, 0.0, 0.0, 0.0, 1.0] {
            body.extend(f64::to_le_bytes(value));
        }
    }
    [&[0, 1, 0, 0][..], &body].concat()
}

/// Publishes a message as a node of ROS 2 does that has static transforms.
fn latched(node: &Session, sender: u8, message: &[u8]) -> AdvancedPublisher<'static> {
    let publisher = node.declare_publisher(format!("7/tf_static/{TRANSFORMS}")).advanced();
    let detection = MissDetectionConfig::default().sporadic_heartbeat(Duration::from_millis(500));
    let publisher = publisher.cache(CacheConfig::default().max_samples(1)).publisher_detection();
    let publisher = publisher.sample_miss_detection(detection).wait().expect("a peer of a test");
    publisher.put(message).attachment(attachment(1, sender)).wait().expect("a peer of a test");
    publisher
}

/// Subscribes to static transforms as a node of ROS 2 does.
fn subscribe_late(node: &Session) -> (AdvancedSubscriber<()>, Receiver<Sample>) {
    let (tx, heard) = sync_channel(64);
    let subscriber = node.declare_subscriber(format!("7/tf_static/{TRANSFORMS}"));
    let subscriber = subscriber.callback(move |sample| drop(tx.try_send(sample))).advanced();
    let history = HistoryConfig::default().detect_late_publishers().max_samples(100);
    let late = subscriber.history(history).recovery(RecoveryConfig::default().heartbeat()).wait();
    (late.expect("a peer of a test"), heard)
}

/// Waits until a message is heard; earlier ones may be heard before.
fn expect_heard(heard: &Receiver<Sample>, message: &[u8]) {
    while heard.recv_timeout(SOON).expect("the message comes").payload().to_bytes() != message {}
}

/// Waits until a value has gone to the wires of a port; earlier ones may have gone before.
fn expect_sent(bridge: &mut Bridge, port: &str, message: &[u8]) {
    let expected = value_of(message);
    while bridge.sent(1).values.iter().all(|(to, value)| *to != port || *value != expected) {}
}

#[test]
fn frames_have_the_prefix_of_their_robot_in_ros() {
    let router = Router::new();
    let node = router.node();
    let mut bridge = Bridge::new(BOTH, &router);
    let key = format!("7/tf/{TRANSFORMS}");
    expect_reader(&node, &key);
    let (_heard, messages) = hear(&node, &key);
    let (inside, outside) = (
        [["/map", "odom"], ["odom", "base_link"], ["/map", "/r2/odom"], ["", "laser"]],
        [["map", "r1/odom"], ["r1/odom", "r1/base_link"], ["map", "r2/odom"], ["", "r1/laser"]],
    );
    // The subscription of the node reaches the bridge some time.
    loop {
        assert!(bridge.deliver("tf-out", &value_of(&transforms(&inside))));
        if let Ok(sample) = messages.recv_timeout(SOON / 1000) {
            assert_eq!(sample.payload().to_bytes(), transforms(&outside));
            break;
        }
    }
    // The mission hears what it publishes, as every subscriber.
    expect_sent(&mut bridge, "tf", &transforms(&inside));
    let others = [["map", "r2/odom"], ["odom", "base_link"], ["r1/base_link", "r1/camera"], ["/r1/a", "/b"]];
    node.put(&key, transforms(&others)).attachment(attachment(1, 1)).wait().unwrap();
    let heard = [["/map", "/r2/odom"], ["/odom", "/base_link"], ["base_link", "camera"], ["a", "/b"]];
    expect_sent(&mut bridge, "tf", &transforms(&heard));
    bridge.expect_signal("/tf refused", 0.0);
    bridge.expect_signal("/tf-out refused", 0.0);
}

/// The wire keeps one message, so that has the transforms of all publishers.
#[test]
fn static_transforms_of_several_nodes_are_one_message() {
    let router = Router::new();
    let node = router.node();
    let publishers = [(1, ["base_link", "laser"]), (2, ["base_link", "camera"]), (3, ["laser", "beam"])];
    let publishers = publishers.map(|(sender, transform)| latched(&node, sender, &transforms(&[transform])));
    let mut bridge = Bridge::new("</tf_static tf2_msgs/msg/TFMessage :1:,1:,:,:,,", &router);
    let all = transforms(&[["laser", "beam"], ["base_link", "camera"], ["base_link", "laser"]]);
    expect_sent(&mut bridge, "tf_static", &all);
    bridge.expect_signal("/tf_static lost", 0.0);
    // The next session gets them again.
    bridge.stop();
    bridge.start().unwrap();
    expect_sent(&mut bridge, "tf_static", &all);
    let moved = transforms(&[["base_link", "beam"]]);
    publishers[2].put(moved).attachment(attachment(2, 3)).wait().unwrap();
    expect_sent(
        &mut bridge,
        "tf_static",
        &transforms(&[["base_link", "beam"], ["base_link", "camera"], ["base_link", "laser"]]),
    );
}

#[test]
fn a_late_node_gets_the_static_transforms_of_all_processes() {
    let router = Router::new();
    let node = router.node();
    let mut bridge = Bridge::idle(">/tf_static tf2_msgs/msg/TFMessage :1:,1:,:,:,, r1/", &router.setting());
    // The wires of two processes may keep values from before the start of the bridge.
    for transform in [["base_link", "laser"], ["base_link", "camera"]] {
        assert!(bridge.deliver("tf_static-out", &value_of(&transforms(&[transform]))));
    }
    bridge.start().unwrap();
    let both = [["r1/base_link", "r1/camera"], ["r1/base_link", "r1/laser"]];
    let (_late, heard) = subscribe_late(&node);
    expect_heard(&heard, &transforms(&both));
    assert!(bridge.deliver("tf_static-out", &value_of(&transforms(&[["/world", "base_link"]]))));
    let (_later, heard) = subscribe_late(&node);
    expect_heard(&heard, &transforms(&[["world", "r1/base_link"], both[0], both[1]]));
}

#[test]
fn a_hostile_static_transform_harms_no_other() {
    let router = Router::new();
    let node = router.node();
    let mut bridge = Bridge::new("</tf_static tf2_msgs/msg/TFMessage :1:,1:,:,:,, r1/", &router);
    let key = format!("7/tf_static/{TRANSFORMS}");
    expect_reader(&node, &key);
    let mut nan = transforms(&[["r1/base_link", "r1/nan"]]);
    let end = nan.len();
    nan[end - 8..].copy_from_slice(&f64::NAN.to_le_bytes());
    let many: Vec<String> = (0..10_001).map(|number| format!("r1/f{number}")).collect();
    let many: Vec<Transform<'_>> = many.iter().map(|child| ["r1/base_link", child.as_str()]).collect();
    let cut = transforms(&[["r1/base_link", "r1/cut"]]);
    for (sequence, message) in (1..).zip([nan, transforms(&many), cut[..cut.len() - 1].to_vec()]) {
        node.put(&key, message).attachment(attachment(sequence, 1)).wait().unwrap();
    }
    let good = transforms(&[["r1/base_link", "r1/laser"]]);
    node.put(&key, good).attachment(attachment(4, 1)).wait().unwrap();
    expect_sent(&mut bridge, "tf_static", &transforms(&[["base_link", "laser"]]));
    bridge.expect_signal("/tf_static refused", 3.0);
}
