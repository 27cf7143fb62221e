//! Messages of ROS 2 through a bridge, a controller and the bridge again, beside a program on plain Zenoh that sends
//! them back; and the time without messages after a kill of the bridge.
//!
//! A router, the mission, and the program on plain Zenoh are processes of their own. The messages are images, which
//! neither the controller nor the program looks into.

use crate::figures::{Round, Subject, Table, cell};
use crate::node::{HOST, Node};
use anyhow::{Context, ensure};
use comms::io::clock::{Wakeup, now};
use comms::logic::decode::Source;
use comms::logic::signals::Signal;
use comms::logic::time::Time;
use controllers::sdk::{
    About, Arguments, Configured, Delivery, DeliveryError, Direction, Interface, Module, PortInterface, Progress,
    Registry, Stopping,
};
use node::logic::protocol::{Change, Report};
use rustix::process::{Pid, kill_process};
use std::collections::VecDeque;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;
use zenoh::pubsub::{Publisher, Subscriber};
use zenoh::sample::Sample;
use zenoh::{Config, Session, Wait};
use zenoh_ext::{AdvancedSubscriberBuilderExt, HistoryConfig, RecoveryConfig};

/// How often everything is measured, in turn.
const ROUNDS: u32 = 5;
/// The messages: bytes of an image, how many in a round, one each period, and how many are on their way at full speed.
const LOADS: [Load; 2] = [
    Load { name: "1 kHz of 64 B", size: 64, count: 3000, period: Duration::from_millis(1), window: 32 },
    Load { name: "30 Hz of 4 MB", size: 4_000_000, count: 60, period: Duration::from_millis(33), window: 2 },
];
/// The greatest allowed cost of a bridge, as a multiple of plain Zenoh.
const TARGET: f64 = 1.3;
/// How often the bridge of one mission is killed. It may be started again five times within 60 s.
const KILLS: usize = 4;
/// How long a message may take before it counts as lost.
const LOST_AFTER: Duration = Duration::from_secs(2);
/// How long a mission and its bridge may take to start.
const READY_WITHIN: Duration = Duration::from_secs(30);
/// The key of a topic of images behind its name.
const IMAGE: &str =
    "sensor_msgs::msg::dds_::Image_/RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47";
/// The first bytes of an image: the header of CDR.
const CDR: [u8; 4] = [0, 1, 0, 0];

struct Load {
    name: &'static str,
    size: usize,
    count: u32,
    period: Duration,
    window: u32,
}

/// Measures, and adds its lines.
pub(crate) async fn measure(dir: &Path, table: &mut Table) -> anyhow::Result<()> {
    let dir = dir.join("ros");
    std::fs::create_dir(&dir)?;
    let router = Side::start(&["router"])?;
    let mut plain = Side::start(&["echo", &router.said])?;
    let settings = format!("connect/endpoints=[\"{}\"]", router.said);
    let mut node = Node::start_with(&dir, &[("ROS_DOMAIN_ID", "7"), ("ZENOH_CONFIG_OVERRIDE", &settings)]).await?;
    let mut deployment = node.deploy(&spec("reliable(100)"))?;
    deployment.go().await?;
    let session = client(&router.said)?;
    let (mut through, mut direct) = (Line::new(&session, "")?, Line::new(&session, "_plain")?);
    through.wait_until_open()?;
    direct.wait_until_open()?;
    for load in LOADS {
        let mut subjects: [Subject; 4] = Default::default();
        let mut lost = [0; 4];
        for _ in 0..ROUNDS {
            for (at, line) in [(0, &mut through), (1, &mut direct)] {
                let (paced, fast) = (line.paced(&load)?, line.full_speed(&load)?);
                subjects[at].push(paced.round);
                subjects[at + 2].push(fast.round);
                lost[at] += paced.lost;
                lost[at + 2] += fast.lost;
            }
        }
        let [ours, plain, ours_fast, plain_fast] = &subjects;
        let of = |lost: u32| format!("{lost} of {} lost", load.count * ROUNDS);
        table.heading(&format!("ROS 2, {}, there and back", load.name), "of zenoh", "");
        table.line("bridge, controller, bridge", ours, [cell(ours.ratio(plain), Some(TARGET)), of(lost[0])]);
        table.line("plain zenoh", plain, ["1".into(), of(lost[1])]);
        table.heading(&format!("the same, {} on their way: time for each", load.window), "of zenoh", "");
        let ratio = cell(ours_fast.ratio(plain_fast), Some(TARGET));
        table.line("bridge, controller, bridge", ours_fast, [ratio, of(lost[2])]);
        table.line("plain zenoh", plain_fast, ["1".into(), of(lost[3])]);
    }
    node.stop(deployment).await?;
    plain.end()?;
    let (silent, late) = kill_bridge(&mut node, &session, &router).await?;
    table.heading("ROS 2, a bridge is killed", "", "");
    table.line("to the next message there and back", &silent, Default::default());
    table.line("to the last message at a late subscriber", &late, Default::default());
    node.end().await
}

/// Kills bridges. Returns how long it took until a message passed again, and until a late subscriber had the last one.
async fn kill_bridge(node: &mut Node, session: &Session, router: &Side) -> anyhow::Result<(Subject, Subject)> {
    let (mut silent, mut late) = (Subject::default(), Subject::default());
    let mut deployment = node.deploy(&spec("transient_local(1)"))?;
    let (mut line, load) = (Line::new(session, "")?, &LOADS[0]);
    let mut samples: [Vec<Duration>; 2] = Default::default();
    for round in 0..=KILLS {
        let pid = loop {
            let report = deployment.next().await?.context("it ended by itself")?;
            if let Report::Process { path, change: Change::Started { pid }, .. } = report
                && path == "main/ros"
            {
                break pid;
            }
        };
        if round == 0 {
            deployment.go().await?;
            line.wait_until_open()?;
        }
        if round == KILLS {
            break;
        }
        let at = now();
        kill_process(
            Pid::from_raw(i32::try_from(pid)?).context("no process has the id 0")?,
            rustix::process::Signal::KILL,
        )?;
        let number = line.number;
        line.say_until(load, |heard| heard > number + 1)?;
        samples[0].push(now().since(at));
        // A session of its own is as late as a new node of ROS 2.
        let node = client(&router.said)?;
        let (_subscriber, last) = hear_late(&node)?;
        last.recv_timeout(LOST_AFTER).context("a late subscriber gets nothing")?;
        samples[1].push(now().since(at));
    }
    let [silences, lates] = samples;
    silent.push(Round::of(silences).context("nothing was killed")?);
    late.push(Round::of(lates).context("nothing was killed")?);
    node.stop(deployment).await?;
    Ok((silent, late))
}

fn spec(qos: &str) -> String {
    format!(
        "process main() {{
            host {{ \"{HOST}\" }}
            instantiated_processes {{ echo instof Camera(\"{HOST}\"); }}
            internal_connections {{
                topic(\"/there\", qos = {qos}) -> echo, In;
                echo, Out -> topic(\"/back\", qos = {qos});
            }}
            internal_event_actions {{ echo }}
        }}"
    )
}

/// Adds the controller that sends images back.
pub(crate) fn add(registry: &mut Registry) {
    let port = |name, direction| PortInterface::wire(name, direction, "ros.sensor.Image");
    let ports = vec![port("In", Direction::In), port("Out", Direction::Out)];
    let about = About::service("Sends each image back.").every(LOST_AFTER);
    let (exports, calls, inner) = Default::default();
    let interface = Interface { type_name: "Camera", about, ports, exports, calls, inner };
    registry.add_module(interface, |interface, _| {
        let camera = Camera { interface: interface.clone(), seen: VecDeque::new() };
        Ok(Box::new(camera) as Box<dyn Module>)
    });
}

/// Sends each image back, and looks into none.
#[derive(Debug)]
struct Camera {
    interface: Interface,
    seen: VecDeque<Vec<u8>>,
}

impl Module for Camera {
    fn interface(&self) -> &Interface {
        &self.interface
    }

    fn deliver(&mut self, _: &str, bytes: &[u8], _: Time) -> Result<Delivery, DeliveryError> {
        self.seen.push_back(bytes.to_vec());
        Ok(Delivery::Triggers)
    }

    fn deliver_from(&mut self, _: &str, source: &mut dyn Source, _: Time) -> Result<Delivery, DeliveryError> {
        let mut bytes = Vec::with_capacity(source.left());
        source.append(source.left(), &mut bytes);
        self.seen.push_back(bytes);
        Ok(Delivery::Triggers)
    }

    fn init(&mut self, _: &[u8], _: Time) -> Result<(), String> {
        Ok(())
    }

    fn configure(&mut self, _: Arguments, _: bool) -> Result<Configured, String> {
        Err("it has no parameters".to_owned())
    }

    fn calculate(&mut self, _: Time) -> Progress {
        Progress::Continue
    }

    fn stop(&mut self, _: Time) -> Stopping {
        Stopping::Finished
    }

    fn drain(&mut self, send: &mut dyn FnMut(&'static str, Vec<u8>)) {
        self.seen.drain(..).for_each(|bytes| send("Out", bytes));
    }

    fn signals(&self) -> Vec<Signal> {
        Vec::new()
    }
}

/// Images that are sent, and come back.
struct Line {
    there: Publisher<'static>,
    _back: Subscriber<()>,
    /// The number of each image that comes back, and when it came.
    heard: Receiver<(u32, Time)>,
    /// The number of the last image.
    number: u32,
}

/// The times of one round, and how many images did not come back.
struct Found {
    round: Round,
    lost: u32,
}

impl Line {
    fn new(session: &Session, name: &str) -> anyhow::Result<Self> {
        let there = session.declare_publisher(format!("7/there{name}/{IMAGE}")).wait().map_err(anyhow::Error::msg)?;
        let (tx, heard) = sync_channel(10_000);
        let told = move |sample: Sample| tx.try_send((number_of(&sample), now())).unwrap_or_default();
        let back = session.declare_subscriber(format!("7/back{name}/{IMAGE}")).callback(told).wait();
        Ok(Self { there, _back: back.map_err(anyhow::Error::msg)?, heard, number: 0 })
    }

    /// Sends the next image, and returns its number.
    fn say(&mut self, load: &Load) -> anyhow::Result<u32> {
        self.number += 1;
        let put = self.there.put(image(self.number, load.size)).attachment(attachment(self.number));
        put.wait().map_err(anyhow::Error::msg)?;
        Ok(self.number)
    }

    /// Sends images until one comes back that is meant.
    fn say_until(&mut self, load: &Load, is_meant: impl Fn(u32) -> bool) -> anyhow::Result<()> {
        let until = now() + READY_WITHIN;
        while now() < until {
            self.say(load)?;
            while let Ok((number, _)) = self.heard.recv_timeout(Duration::from_millis(5)) {
                if is_meant(number) {
                    return Ok(());
                }
            }
        }
        anyhow::bail!("nothing comes back")
    }

    fn wait_until_open(&mut self) -> anyhow::Result<()> {
        self.say_until(&LOADS[0], |_| true)?;
        self.forget();
        Ok(())
    }

    /// Waits until no image of earlier times is on its way.
    fn forget(&mut self) {
        while self.heard.recv_timeout(Duration::from_millis(300)).is_ok() {}
    }

    /// Sends one image each period. Returns how long each takes there and back.
    fn paced(&mut self, load: &Load) -> anyhow::Result<Found> {
        let (began, pause) = (now() + load.period, Wakeup::default());
        let (first, mut sent) = (self.number + 1, Vec::new());
        for count in 0..load.count {
            pause.wait(Some(began + load.period * count));
            sent.push(now());
            self.say(load)?;
        }
        let mut took = Vec::new();
        while took.len() < sent.len()
            && let Ok((number, at)) = self.heard.recv_timeout(LOST_AFTER)
        {
            let place = number.checked_sub(first).and_then(|place| sent.get(usize::try_from(place).ok()?));
            took.extend(place.map(|sent| at.since(*sent)));
        }
        let lost = load.count - u32::try_from(took.len())?;
        Ok(Found { round: Round::of(took).context("nothing came back")?, lost })
    }

    /// Sends images as fast as they come back, with some on their way. Returns the time for each.
    fn full_speed(&mut self, load: &Load) -> anyhow::Result<Found> {
        let (began, mut on_their_way, mut sent, mut lost) = (now(), 0, 0, 0);
        let mut waited = Duration::ZERO;
        while sent < load.count || on_their_way > 0 {
            while sent < load.count && on_their_way < load.window {
                self.say(load)?;
                (sent, on_their_way) = (sent + 1, on_their_way + 1);
            }
            if self.heard.recv_timeout(LOST_AFTER).is_ok() {
                on_their_way -= 1;
            } else {
                (lost, on_their_way, waited) = (lost + on_their_way, 0, waited + LOST_AFTER);
            }
        }
        ensure!(lost < load.count, "nothing came back");
        let took = now().since(began).saturating_sub(waited);
        Ok(Found { round: Round::single(took / (load.count - lost)), lost })
    }
}

/// Subscribes as a node of ROS 2 does that wants the last message.
fn hear_late(session: &Session) -> anyhow::Result<(zenoh_ext::AdvancedSubscriber<()>, Receiver<u32>)> {
    let (tx, heard) = sync_channel(64);
    let told = move |sample: Sample| tx.try_send(number_of(&sample)).unwrap_or_default();
    let subscriber = session.declare_subscriber(format!("7/back/{IMAGE}")).callback(told).advanced();
    let subscriber = subscriber.history(HistoryConfig::default().detect_late_publishers().max_samples(1));
    let subscriber = subscriber.recovery(RecoveryConfig::default().heartbeat()).wait();
    Ok((subscriber.map_err(anyhow::Error::msg)?, heard))
}

/// Returns an image with a number in its stamp and bytes of this size.
fn image(number: u32, size: usize) -> Vec<u8> {
    let length = u32::try_from(size).unwrap_or(u32::MAX).to_le_bytes();
    let mut image = Vec::with_capacity(64 + size);
    image.extend(CDR);
    image.extend(number.to_le_bytes());
    // The rest of the stamp, two empty texts with padding, and five numbers around the order of bytes.
    image.extend([0; 4]);
    image.extend([1, 0, 0, 0, 0, 0, 0, 0]);
    image.extend([0; 8]);
    image.extend([1, 0, 0, 0, 0, 0, 0, 0]);
    image.extend([0; 4]);
    image.extend(length);
    image.resize(image.len() + size, 7);
    image
}

fn number_of(sample: &Sample) -> u32 {
    let mut number = [0; 4];
    let mut reader = sample.payload().reader();
    let read = reader.read_exact(&mut number).and_then(|()| reader.read_exact(&mut number));
    if read.is_ok() { u32::from_le_bytes(number) } else { 0 }
}

fn attachment(number: u32) -> Vec<u8> {
    let mut bytes = i64::from(number).to_le_bytes().to_vec();
    bytes.extend([0; 8]);
    bytes.push(16);
    bytes.extend([9; 16]);
    bytes
}

fn client(locator: &str) -> anyhow::Result<Session> {
    open(&[("mode", "\"client\""), ("connect/endpoints", &format!("[{locator:?}]"))])
}

#[expect(clippy::disallowed_methods, reason = "the other side of the bridge is not DCA's")]
fn open(settings: &[(&str, &str)]) -> anyhow::Result<Session> {
    let mut config = Config::default();
    let shared = [
        ("scouting/multicast/enabled", "false"),
        ("scouting/gossip/enabled", "false"),
        ("timestamping/enabled", "true"),
    ];
    for (key, value) in shared.iter().chain(settings) {
        config.insert_json5(key, value).map_err(anyhow::Error::msg)?;
    }
    zenoh::open(config).wait().map_err(anyhow::Error::msg)
}

/// A child process of the benchmark. It ends with its standard input.
#[derive(Debug)]
struct Side {
    process: Child,
    /// Its first line.
    said: String,
}

impl Side {
    fn start(arguments: &[&str]) -> anyhow::Result<Self> {
        let mut command = Command::new(std::env::current_exe()?);
        command.arg("ros").args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped());
        let (mut process, mut said) = (command.spawn()?, String::new());
        BufReader::new(process.stdout.take().context("no pipe")?).read_line(&mut said)?;
        ensure!(!said.is_empty(), "a part of the measurement ended");
        Ok(Self { process, said: said.trim().to_owned() })
    }

    fn end(&mut self) -> anyhow::Result<()> {
        drop(self.process.stdin.take());
        ensure!(self.process.wait()?.success(), "a part of the measurement failed");
        Ok(())
    }
}

impl Drop for Side {
    fn drop(&mut self) {
        self.end().unwrap_or_default();
    }
}

/// Runs the router of ROS 2, or a program that sends images back, in a child process of the benchmark.
pub(crate) fn side(arguments: &[String]) -> anyhow::Result<()> {
    let _open: Box<dyn std::any::Any> = match arguments {
        [side] if side == "router" => {
            let listen = ("listen/endpoints", "[\"tcp/127.0.0.1:0\"]");
            let session = open(&[("mode", "\"router\""), listen, ("connect/endpoints", "[]")])?;
            let all = session.info().locators().wait();
            let locator = all.iter().map(ToString::to_string).find(|one| one.starts_with("tcp/127.0.0.1:"));
            crate::say(&locator.context("the router does not listen")?)?;
            Box::new(session)
        }
        [side, locator] if side == "echo" => {
            let session = client(locator)?;
            let back = session.declare_publisher(format!("7/back_plain/{IMAGE}")).wait().map_err(anyhow::Error::msg)?;
            let echo = move |sample: Sample| {
                let attachment = sample.attachment().cloned().unwrap_or_default();
                back.put(sample.payload().clone()).attachment(attachment).wait().unwrap_or_default();
            };
            let there = session.declare_subscriber(format!("7/there_plain/{IMAGE}")).callback(echo).wait();
            let there = there.map_err(anyhow::Error::msg)?;
            crate::say("ready")?;
            Box::new([(session, there)])
        }
        _ => anyhow::bail!("this part is not known"),
    };
    std::io::stdin().read_to_end(&mut Vec::new())?;
    Ok(())
}
