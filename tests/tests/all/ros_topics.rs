//! A mission with topics of ROS 2. The node starts a bridge, and a peer on plain Zenoh talks to a controller through it.

use controllers::ros::Message as _;
use controllers::ros::{geometry_msgs::TransformStamped, tf2_msgs::TFMessage};
use dca_tests::cluster::{Cluster, Program, SOON, Stream, executable, wait_until};
use rustix::process::Signal;
use std::path::Path;
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Config, Session, Wait};
use zenoh_ext::{
    AdvancedPublisherBuilderExt, AdvancedSubscriber, AdvancedSubscriberBuilderExt, CacheConfig, HistoryConfig,
    MissDetectionConfig, RecoveryConfig,
};

const ECHO: &str = "
process main() {
    host { c1 }
    instantiated_processes { echo instof Echo(c1); }
    internal_connections {
        topic(\"/there\", qos = transient_local(1)) -> echo.In;
        echo.Out -> topic(\"/back\", qos = transient_local(1));
    }
    internal_event_actions { echo }
}
";
/// The part of a string topic's key after its name.
const STRING: &str =
    "std_msgs::msg::dds_::String_/RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";

/// A router and a ROS 2 node in one session.
pub(super) struct Ros {
    pub(super) session: Session,
}

impl Ros {
    pub(super) fn new() -> Self {
        Self { session: open("router", &["tcp/127.0.0.1:0"], &[]) }
    }

    /// Returns another session at the router.
    fn client(&self) -> Session {
        open("client", &[], &[&self.locator()])
    }

    fn locator(&self) -> String {
        let all = self.session.info().locators().wait();
        all.iter().map(ToString::to_string).find(|one| one.starts_with("tcp/127.0.0.1:")).expect("a peer of a test")
    }

    fn setting(&self) -> String {
        format!("connect/endpoints=[\"{}\"]", self.locator())
    }

    fn hear(&self) -> (zenoh::pubsub::Subscriber<()>, Receiver<Sample>) {
        let (tx, rx) = sync_channel(64);
        let heard = move |sample| drop(tx.try_send(sample));
        (
            self.session
                .declare_subscriber(format!("7/back/{STRING}"))
                .callback(heard)
                .wait()
                .expect("a peer of a test"),
            rx,
        )
    }

    /// Also receives earlier messages, like a ROS 2 node that wants the last message.
    fn hear_late(&self) -> (AdvancedSubscriber<()>, Receiver<Sample>) {
        self.hear_late_on(&format!("7/back/{STRING}"))
    }

    fn hear_late_on(&self, key: &str) -> (AdvancedSubscriber<()>, Receiver<Sample>) {
        let (tx, rx) = sync_channel(64);
        let heard = move |sample| drop(tx.try_send(sample));
        let subscriber = self.session.declare_subscriber(key.to_owned()).callback(heard).advanced();
        let subscriber = subscriber.history(HistoryConfig::default().detect_late_publishers().max_samples(1));
        (subscriber.recovery(RecoveryConfig::default().heartbeat()).wait().expect("a peer of a test"), rx)
    }

    fn say(&self, sequence: i64, text: &str) {
        let put = self.session.put(format!("7/there/{STRING}"), message(text));
        put.attachment(attachment(sequence)).wait().expect("a peer of a test");
    }

    /// Receives a notice about each subscription that comes or goes from now on.
    fn hear_subscriptions(&self) -> (zenoh::pubsub::Subscriber<()>, Receiver<SampleKind>) {
        let (tx, rx) = sync_channel(64);
        let heard = move |token: Sample| tx.try_send(token.kind()).unwrap_or_default();
        let tokens = self.session.liveliness().declare_subscriber("@ros2_lv/7/*/*/*/MS/**").callback(heard);
        (tokens.wait().expect("a peer of a test"), rx)
    }

    /// Returns whether the bridge has subscribed to the topic.
    fn is_subscribed(&self) -> bool {
        let tokens = self.session.liveliness().get("@ros2_lv/7/*/*/*/MS/**").wait().expect("a peer of a test");
        tokens.into_iter().next().is_some()
    }
}

fn open(mode: &str, listen: &[&str], connect: &[&str]) -> Session {
    let mut config = Config::default();
    for (key, value) in [
        ("mode", format!("{mode:?}")),
        ("listen/endpoints", format!("{listen:?}")),
        ("connect/endpoints", format!("{connect:?}")),
        ("scouting/multicast/enabled", "false".to_owned()),
        ("scouting/gossip/enabled", "false".to_owned()),
        ("timestamping/enabled", "true".to_owned()),
    ] {
        config.insert_json5(key, &value).expect("a peer of a test");
    }
    #[expect(clippy::disallowed_methods, reason = "the other side of the bridge is not DCA's")]
    let opened = zenoh::open(config).wait();
    opened.expect("a peer of a test")
}

pub(super) fn attachment(sequence: i64) -> Vec<u8> {
    let mut bytes = sequence.to_le_bytes().to_vec();
    bytes.extend([0; 8]);
    bytes.push(16);
    bytes.extend([9; 16]);
    bytes
}

fn message(text: &str) -> Vec<u8> {
    let mut bytes = vec![0, 1, 0, 0];
    bytes.extend((u32::try_from(text.len()).expect("a peer of a test") + 1).to_le_bytes());
    bytes.extend(text.as_bytes());
    bytes.push(0);
    bytes
}

pub(super) fn run(cluster: &Cluster, ros: &Ros, spec: &str) -> Program {
    run_with(cluster, ros, spec, &[])
}

fn run_with(cluster: &Cluster, ros: &Ros, spec: &str, options: &[&str]) -> Program {
    let here =
        cluster.here().with_variable("ROS_DOMAIN_ID", "7").with_variable("ZENOH_CONFIG_OVERRIDE", &ros.setting());
    let file = cluster.file("echo.dca", spec);
    let controllers = executable("dca-counting").display().to_string();
    here.dca(&[&["run", "--controllers", &controllers, &file], options].concat())
}

/// Sends a text until the controller has sent it back, since the wires of a mission open one after the other.
#[track_caller]
fn expect_echo(ros: &Ros, heard: &Receiver<Sample>, first: i64, text: &str) {
    let mut sequence = first;
    let answered = wait_until(SOON, || {
        ros.say(sequence, text);
        sequence += 1;
        let answer = heard.recv_timeout(Duration::from_millis(100));
        answer.is_ok_and(|sample| sample.payload().to_bytes() == message(text))
    });
    assert!(answered.is_some(), "no echo of {text:?}");
}

/// Each robot gives the parameter another value when the same spec is deployed.
#[test]
fn a_topic_has_the_name_that_a_parameter_gives_it() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let (_subscriber, heard) = ros.hear();
    let spec = ECHO.replace("main()", "main(way: Text = \"away\", back: Text = \"home\")");
    let spec = spec.replace("/there", "/{way}").replace("\"/back", "\"{back}");
    let mission = run_with(&cluster, &ros, &spec, &["--set", "way=there", "--set", "back=/back"]);
    expect_echo(&ros, &heard, 1, "one");
    mission.signal(Signal::INT);
    mission.ended(SOON);
    let ended = run_with(&cluster, &ros, &spec, &["--set", "way=there and back"]).ended(SOON);
    let [why, value] = ["is not the name of a topic of ROS 2", "`way` is `there and back`"];
    assert!(ended.code != Some(0) && ended.err.contains(why) && ended.err.contains(value), "{ended}");
}

#[test]
fn a_killed_bridge_is_back_and_the_mission_goes_on() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let (_subscriber, heard) = ros.hear();
    let mission = run(&cluster, &ros, ECHO);
    assert!(wait_until(SOON, || ros.is_subscribed()).is_some(), "{}", mission.text(Stream::Err));
    expect_echo(&ros, &heard, 1, "one");
    let bridge = cluster.expect_leaf("main/ros");
    let (_tokens, subscriptions) = ros.hear_subscriptions();
    bridge.signal(Signal::KILL);
    let (mut has_gone, mut is_back) = (false, false);
    while !(has_gone && is_back) {
        match subscriptions.recv_timeout(SOON).expect("the bridge is started again") {
            SampleKind::Delete => has_gone = true,
            SampleKind::Put => is_back = true,
        }
    }
    let (_late, last) = ros.hear_late();
    let sample = last.recv_timeout(SOON).expect("the next bridge has the last message for a late subscriber");
    assert_eq!(sample.payload().to_bytes(), message("one"));
    expect_echo(&ros, &heard, 1000, "two");
    assert!(mission.is_running());
    mission.signal(Signal::INT);
    let ended = mission.ended(SOON);
    assert!(ended.err.contains("ros"), "{ended}");
    cluster.expect_nothing_left(Duration::from_secs(5));
}

#[test]
fn the_log_of_a_bridge_names_a_node_that_has_another_type() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let token = "@ros2_lv/7/aa/0/1/MP/%/%/talker/%there/std_msgs::msg::dds_::Bool_/RIHS01_aa/::,:,:,:,,";
    let token = ros.session.liveliness().declare_token(token).wait().expect("a peer of a test");
    let mission = run(&cluster, &ros, ECHO);
    let mut log = String::new();
    let is_told = wait_until(SOON, || {
        log = cluster.here().ask(&["logs", "main/ros"]).out;
        log.contains("node `/talker` publishes `/there` with type `std_msgs/msg/Bool`")
    });
    assert!(is_told.is_some(), "{log}\n{}", mission.text(Stream::Err));
    drop(token);
    mission.signal(Signal::INT);
    mission.ended(SOON);
}

/// Returns a message with a transform of each of these frames from `base_link`.
fn transforms(parent: &str, children: &[&str]) -> Vec<u8> {
    let transform = |child: &&str| {
        let mut transform = TransformStamped { child_frame_id: (*child).to_owned(), ..TransformStamped::default() };
        transform.header.frame_id = parent.to_owned();
        transform
    };
    TFMessage { transforms: children.iter().map(transform).collect() }.to_cdr().expect("a peer of a test")
}

#[test]
fn static_transforms_of_several_nodes_are_there_for_late_ones() {
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let key = |name: &str| {
        let hash = "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087";
        format!("7/{name}/tf2_msgs::msg::dds_::TFMessage_/{hash}")
    };
    // Each of two nodes has published its transforms before there is a mission.
    let node = ros.client();
    let nodes = [("r1/laser", 1), ("r1/camera", 2)].map(|(child, sender)| {
        let publisher = node.declare_publisher(key("tf_static")).advanced();
        let publisher = publisher.cache(CacheConfig::default().max_samples(1)).publisher_detection();
        let detection = MissDetectionConfig::default().sporadic_heartbeat(Duration::from_millis(500));
        let publisher = publisher.sample_miss_detection(detection).wait().expect("a peer of a test");
        let mut told = attachment(1);
        told[17..].fill(sender);
        publisher.put(transforms("r1/base_link", &[child])).attachment(told).wait().expect("a peer of a test");
        publisher
    });
    let mission = run(
        &cluster,
        &ros,
        "
        process main() {
            host { c1 }
            instantiated_processes { echo instof TransformEcho(c1); }
            internal_connections {
                topic(\"/tf_static\", qos = transient_local(1), frame_prefix = \"r1/\") -> echo.In;
                echo.Out -> topic(\"/seen\", qos = transient_local(1), frame_prefix = \"r2_\");
            }
            internal_event_actions { echo }
        }
        ",
    );
    // The next bridge gets the transforms from the nodes, and from the wire of the process.
    let both = transforms("r2_base_link", &["r2_camera", "r2_laser"]);
    for is_killed in [false, true] {
        let (_late, heard) = ros.hear_late_on(&key("seen"));
        while heard.recv_timeout(SOON).expect("the transforms come").payload().to_bytes() != both {}
        if !is_killed {
            let (_tokens, subscriptions) = ros.hear_subscriptions();
            cluster.expect_leaf("main/ros").signal(Signal::KILL);
            while subscriptions.recv_timeout(SOON).expect("the bridge is started again") != SampleKind::Put {}
        }
    }
    drop(nodes);
    mission.signal(Signal::INT);
    mission.ended(SOON);
}

/// The numbered texts of a topic in a record, and how many later values the record lacks.
#[derive(Debug, Default)]
struct RecordedTexts {
    /// The number and the size of each text.
    texts: Vec<(u64, usize)>,
    lost: u64,
}

impl RecordedTexts {
    /// Reads the texts of an output. The last part of a record that is being written is left out.
    fn of(record: &Path, output: &str) -> Self {
        let mut found = Self::default();
        let bytes = std::fs::read(record).unwrap_or_default();
        for message in mcap::MessageStream::new(&bytes).into_iter().flatten().map_while(Result::ok) {
            let channel = &message.channel;
            if channel.topic == "/missing" {
                let count: serde_json::Value = serde_json::from_slice(&message.data).expect("it is JSON");
                let lost = count["lost"].as_u64().expect("it is a number");
                found.lost += if count["output"] == output { lost } else { 0 };
            } else if channel.topic == format!("/ports/{output}") {
                let schema = channel.schema.as_ref().expect("each topic has one");
                let forms = (channel.message_encoding.as_str(), schema.encoding.as_str(), schema.name.as_str());
                assert_eq!(forms, ("cdr", "ros2msg", "std_msgs/msg/String"));
                found.texts.push((number(&message.data), message.data.len()));
            }
        }
        found
    }
}

/// Returns the number at the beginning of the text of a message.
fn number(message: &[u8]) -> u64 {
    let digits = message[8..].iter().take_while(|byte| byte.is_ascii_digit());
    digits.fold(0, |number, digit| 10 * number + u64::from(digit - b'0'))
}

/// The record has messages of ROS 2 in the form of ROS 2, large ones as well. The bridge is suspended, and then sends a
/// burst. Each value that the record lacks is counted.
#[test]
fn each_message_of_a_bridge_is_recorded_or_counted() {
    const LARGE: usize = 1_100_000;
    let (cluster, ros) = (Cluster::new(), Ros::new());
    let (_subscriber, heard) = ros.hear();
    let spec = ECHO.replace("topic(\"/there\", qos = transient_local(1))", "topic(\"/there\", qos = reliable(1000))");
    let mission = run_with(&cluster, &ros, &spec, &["--record", "all"]);
    let record = cluster.folder().join("runs/echo-1/run.mcap");
    let read = || RecordedTexts::of(&record, "main/ros/there");
    assert!(wait_until(SOON, || ros.is_subscribed()).is_some(), "{}", mission.text(Stream::Err));
    let mut said = 0_u64;
    let mut say = |size: usize| {
        said += 1;
        let put = ros.session.put(format!("7/there/{STRING}"), message(&format!("{said} {}", "x".repeat(size))));
        let put = put.congestion_control(zenoh::qos::CongestionControl::Block);
        put.attachment(attachment(said.cast_signed())).wait().expect("a peer of a test");
        said
    };
    let pause = || heard.recv_timeout(Duration::from_millis(100)).map_or(0, |echo| number(&echo.payload().to_bytes()));
    // On a busy machine a large value may be lost on the way. Then it is counted.
    for size in [0, LARGE] {
        let is_recorded = wait_until(SOON, || {
            say(size);
            pause();
            read().texts.iter().any(|(_, found)| *found > size)
        });
        assert!(is_recorded.is_some(), "{}", mission.text(Stream::Err));
    }
    let bridge = cluster.expect_leaf("main/ros");
    bridge.signal(Signal::STOP);
    for _ in 0..1000 {
        say(0);
    }
    bridge.signal(Signal::CONT);
    let is_past = wait_until(SOON, || {
        let last = say(0);
        (0..20).any(|_| pause() == last)
    });
    assert!(is_past.is_some(), "{}", mission.text(Stream::Err));
    mission.signal(Signal::INT);
    let ended = mission.ended(SOON);
    let RecordedTexts { texts, lost } = read();
    let first = texts.first().map_or(0, |(number, _)| *number);
    let recorded = u64::try_from(texts.len()).expect("it is small");
    assert_eq!(
        recorded + lost,
        said - first + 1,
        "{recorded} recorded, {lost} counted, from {first} to {said}: {ended}"
    );
    assert!(lost == 0 || ended.out.contains(" of main/ros.there to main/echo.In "), "{ended}");
    cluster.expect_nothing_left(Duration::from_secs(5));
}
