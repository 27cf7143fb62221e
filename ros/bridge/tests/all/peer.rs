//! A router of ROS 2, a node on it, and a bridge without a mission.
//!
//! The node has its own keys, tokens and attachments. They are written down from the rules, and not made by the code under test.

use comms::logic::object::ObjectError;
use comms::logic::time::Time;
use controllers::sdk::{Activity, CallOrder, Module, Outlets, Progress, RawReply, Stopping, Waker};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;
use zenoh::query::{Query, Queryable};
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Config, Session, Wait};

/// The time limit of any step on a busy machine.
pub(crate) const SOON: Duration = Duration::from_secs(30);
/// The part of a string topic's key after its name.
pub(crate) const STRING: &str =
    "std_msgs::msg::dds_::String_/RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";

/// A router with its own port.
pub(crate) struct Router {
    session: Session,
}

impl Router {
    pub(crate) fn new() -> Self {
        Self::at("tcp/127.0.0.1:0")
    }

    pub(crate) fn at(locator: &str) -> Self {
        let listen = format!("[\"{locator}\"]");
        Self { session: open(&[("mode", "\"router\""), ("listen/endpoints", &listen), ("connect/endpoints", "[]")]) }
    }

    pub(crate) fn locator(&self) -> String {
        let all = self.session.info().locators().wait();
        all.iter().map(ToString::to_string).find(|one| one.starts_with("tcp/127.0.0.1:")).expect("the router listens")
    }

    /// Returns the setting that makes a session connect to this router.
    pub(crate) fn setting(&self) -> String {
        format!("connect/endpoints=[\"{}\"]", self.locator())
    }

    /// Returns the session of a node that is connected to this router.
    pub(crate) fn node(&self) -> Session {
        let connect = format!("[\"{}\"]", self.locator());
        open(&[("mode", "\"client\""), ("connect/endpoints", &connect), ("timestamping/enabled", "true")])
    }
}

#[expect(clippy::disallowed_methods, reason = "the other side of the bridge is not DCA's")]
fn open(settings: &[(&str, &str)]) -> Session {
    let mut config = Config::default();
    let quiet = [("scouting/multicast/enabled", "false"), ("scouting/gossip/enabled", "false")];
    for (key, value) in quiet.iter().chain(settings) {
        config.insert_json5(key, value).expect("a peer of a test");
    }
    zenoh::open(config).wait().expect("a peer of a test")
}

/// Returns the attachment of a message.
pub(crate) fn attachment(sequence: i64, sender: u8) -> Vec<u8> {
    let mut bytes = sequence.to_le_bytes().to_vec();
    bytes.extend(1_700_000_000_000_000_000_i64.to_le_bytes());
    bytes.push(16);
    bytes.extend([sender; 16]);
    bytes
}

/// Returns the CDR of a string.
pub(crate) fn string(text: &str) -> Vec<u8> {
    let mut bytes = vec![0, 1, 0, 0];
    bytes.extend((u32::try_from(text.len()).expect("a peer of a test") + 1).to_le_bytes());
    bytes.extend(text.as_bytes());
    bytes.push(0);
    bytes
}

/// Returns the value of a wire for CDR shorter than 128 bytes.
pub(crate) fn value(message: &[u8]) -> Vec<u8> {
    [&[u8::try_from(message.len()).expect("a peer of a test")], message].concat()
}

/// Returns the value of a wire for any CDR.
pub(crate) fn value_of(message: &[u8]) -> Vec<u8> {
    [&postcard::to_stdvec(&message.len()).expect("a peer of a test")[..], message].concat()
}

/// Waits until there is a reader for messages of a node on a key.
pub(crate) fn expect_reader(node: &Session, key: &str) {
    let publisher = node.declare_publisher(key.to_owned()).wait().expect("a peer of a test");
    let (until, pause) = (comms::io::clock::now() + SOON, comms::io::clock::Wakeup::default());
    while !publisher.matching_status().wait().expect("a peer of a test").matching() {
        assert!(comms::io::clock::now() < until, "nobody reads `{key}`");
        pause.wait(Some(comms::io::clock::now() + Duration::from_millis(5)));
    }
}

/// Serves a key, and hands over the queries.
pub(crate) fn serve(node: &Session, key: String) -> (Queryable<()>, Receiver<Query>) {
    let (tx, rx) = sync_channel(100);
    let hear = move |query| drop(tx.try_send(query));
    (node.declare_queryable(key).complete(true).callback(hear).wait().expect("a peer of a test"), rx)
}

/// Answers a query, with the attachment of the query.
pub(crate) fn reply(query: &Query, response: &[u8]) {
    let told = query.attachment().expect("a peer of a test").clone();
    query.reply(query.key_expr().clone(), response).attachment(told).wait().expect("a peer of a test");
}

/// Receives samples on a key.
pub(crate) fn hear(session: &Session, key: &str) -> (zenoh::pubsub::Subscriber<()>, Receiver<Sample>) {
    let (tx, rx) = sync_channel(4096);
    let subscriber = session.declare_subscriber(key.to_owned()).callback(move |sample| drop(tx.try_send(sample)));
    (subscriber.wait().expect("a peer of a test"), rx)
}

/// Receives the tokens that appear and vanish, including the existing ones.
pub(crate) fn tokens(session: &Session, key: &str) -> (zenoh::pubsub::Subscriber<()>, Receiver<(SampleKind, String)>) {
    let (tx, rx) = sync_channel(4096);
    let told = move |sample: Sample| drop(tx.try_send((sample.kind(), sample.key_expr().to_string())));
    let subscriber = session.liveliness().declare_subscriber(key.to_owned()).history(true).callback(told);
    (subscriber.wait().expect("a peer of a test"), rx)
}

/// A bridge without a mission.
pub(crate) struct Bridge {
    module: Box<dyn Module>,
    woken: Receiver<()>,
    /// Whether the callers no longer wait.
    given_up: Arc<AtomicBool>,
}

/// The values for wires, and the number of skipped values.
#[derive(Debug, Default, PartialEq, Eq)]
pub(crate) struct Sent {
    pub(crate) values: Vec<(&'static str, Vec<u8>)>,
    pub(crate) skipped: u32,
}

impl Outlets for Sent {
    fn send(&mut self, port: &'static str, bytes: Vec<u8>) {
        self.values.push((port, bytes));
    }

    fn skip(&mut self, _: &'static str, count: u32) {
        self.skipped += count;
    }

    fn send_filled(&mut self, _: &'static str, _: &mut dyn FnMut(&mut comms::io::direct::Filler<'_>) -> bool) -> bool {
        false
    }
}

impl Bridge {
    /// Returns a bridge that does not run.
    pub(crate) fn idle(routes: &str, settings: &str) -> Self {
        Self::of("main/ros", "RosBridge", &[format!("routes={routes}")], settings)
    }

    /// Returns another program of this crate that does not run.
    pub(crate) fn of(path: &str, kind: &str, arguments: &[String], settings: &str) -> Self {
        let shared = [format!("settings={settings}"), "domain=7".to_owned()];
        let arguments = [arguments, &shared].concat();
        let mut module = bridge::registry().create_at("door", path, kind, &arguments).expect("a peer of a test");
        let (tx, woken) = sync_channel(1);
        module.take_waker(Waker::new(move || tx.try_send(()).unwrap_or_default()));
        Self { module, woken, given_up: Arc::default() }
    }

    /// Returns a bridge that runs.
    pub(crate) fn new(routes: &str, router: &Router) -> Self {
        let mut bridge = Self::idle(routes, &router.setting());
        bridge.start().expect("a peer of a test");
        bridge
    }

    pub(crate) fn start(&mut self) -> Result<(), String> {
        self.module.init(&[], Time::ZERO)
    }

    pub(crate) fn stop(&mut self) {
        self.stop_once();
    }

    /// Asks the bridge once to stop, like its loop.
    pub(crate) fn stop_once(&mut self) -> Stopping {
        self.module.stop(comms::io::clock::now())
    }

    /// Returns what may go on after the stop, like the loop when the stop is over.
    pub(crate) fn unconfirmed(&mut self) -> Option<String> {
        self.module.unconfirmed()
    }

    /// Waits until `act` has woken the loop of the bridge.
    pub(crate) fn woken_by(&mut self, act: impl FnOnce()) {
        while self.woken.try_recv().is_ok() {}
        act();
        self.woken.recv_timeout(SOON).expect("it is heard");
    }

    /// Asks the bridge to stop until it has finished.
    pub(crate) fn stopped(&mut self) {
        let until = comms::io::clock::now() + SOON;
        while self.stop_once() == Stopping::Again {
            self.woken.recv_timeout(Duration::from_millis(20)).unwrap_or_default();
            assert!(comms::io::clock::now() < until, "it does not stop");
        }
    }

    /// Asks the bridge to stop until `look` finds something.
    pub(crate) fn stopping_until<T>(&mut self, mut look: impl FnMut() -> Option<T>) -> T {
        let until = comms::io::clock::now() + SOON;
        loop {
            assert_eq!(self.stop_once(), Stopping::Again);
            if let Some(found) = look() {
                return found;
            }
            self.woken.recv_timeout(Duration::from_millis(20)).unwrap_or_default();
            assert!(comms::io::clock::now() < until, "nothing comes");
        }
    }

    /// Starts the bridge with a value.
    pub(crate) fn start_with(&mut self, value: &[u8]) -> Result<(), String> {
        self.module.init(value, comms::io::clock::now())
    }

    /// Calculates once, at the present time plus `after`.
    pub(crate) fn calculate_after(&mut self, after: Duration) -> Progress {
        self.module.calculate(comms::io::clock::now() + after)
    }

    /// Calculates until the program ends.
    pub(crate) fn ended(&mut self) -> Progress {
        let until = comms::io::clock::now() + SOON;
        loop {
            match self.calculate_after(Duration::ZERO) {
                Progress::Continue => self.woken.recv_timeout(Duration::from_millis(20)).unwrap_or_default(),
                ended @ (Progress::Done(_) | Progress::Aborted(_)) => return ended,
            }
            assert!(comms::io::clock::now() < until, "it does not end");
        }
    }

    /// Calculates until `look` finds something.
    pub(crate) fn until<T>(&mut self, mut look: impl FnMut() -> Option<T>) -> T {
        let until = comms::io::clock::now() + SOON;
        loop {
            assert_eq!(self.calculate_after(Duration::ZERO), Progress::Continue);
            if let Some(found) = look() {
                return found;
            }
            self.woken.recv_timeout(Duration::from_millis(20)).unwrap_or_default();
            assert!(comms::io::clock::now() < until, "nothing comes");
        }
    }

    /// Hands over a value like a wire.
    pub(crate) fn deliver(&mut self, port: &str, bytes: &[u8]) -> bool {
        self.module.deliver_from(port, &mut &*bytes, Time::ZERO).is_ok()
    }

    /// Reports values that a wire has lost.
    pub(crate) fn lose(&mut self, port: &str, count: u64) {
        self.module.lose(port, count);
    }

    /// Calls an export; the caller waits until [`Bridge::give_up`].
    pub(crate) fn call(&mut self, name: &str, argument: &[u8]) -> Receiver<Result<Vec<u8>, ObjectError>> {
        let (tx, answer) = sync_channel(1);
        let given_up = Arc::clone(&self.given_up);
        let reply = RawReply::new(
            move |result| tx.try_send(result).unwrap_or_default(),
            move || !given_up.load(Ordering::Acquire),
        );
        self.module.serve(name, argument, Activity::Running, reply);
        answer
    }

    /// Stops waiting for answers to earlier calls.
    pub(crate) fn give_up(&mut self) {
        self.given_up.store(true, Ordering::Release);
        self.given_up = Arc::default();
        self.module.calculate(Time::ZERO);
    }

    /// Waits until `count` calls of others have arrived: their names, numbers and arguments.
    pub(crate) fn asked(&mut self, count: usize) -> Vec<(&'static str, u64, Vec<u8>)> {
        let mut asked = Vec::new();
        loop {
            self.module.drain_calls(&mut |call, order| {
                let CallOrder::Make { number, argument, .. } = order else { return };
                asked.push((call, number, argument));
            });
            if asked.len() >= count {
                return asked;
            }
            self.woken.recv_timeout(SOON).expect("calls come");
        }
    }

    /// Hands over the answer to a call.
    pub(crate) fn answer(&mut self, call: &str, number: u64, result: Result<Vec<u8>, ObjectError>) {
        self.module.answered(call, number, result);
    }

    /// Waits until `count` values have gone to wires.
    pub(crate) fn sent(&mut self, count: usize) -> Sent {
        self.sent_within(count, SOON)
    }

    /// Waits until `count` values have gone to wires, at most `within` for each of them.
    pub(crate) fn sent_within(&mut self, count: usize, within: Duration) -> Sent {
        let mut sent = Sent::default();
        self.module.drain_to(&mut sent);
        while sent.values.len() < count {
            self.woken.recv_timeout(within).expect("values come");
            self.module.drain_to(&mut sent);
        }
        sent
    }

    /// Returns the value of a signal.
    pub(crate) fn signal(&mut self, name: &str) -> f64 {
        let signals = self.module.signals();
        signals.iter().find(|signal| signal.name == name).expect("there is such a signal").value
    }

    /// Waits until a signal has a value.
    pub(crate) fn expect_signal(&mut self, name: &str, value: f64) {
        let (until, pause) = (comms::io::clock::now() + SOON, comms::io::clock::Wakeup::default());
        loop {
            let found = self.signal(name);
            if (found - value).abs() < 0.5 {
                return;
            }
            assert!(comms::io::clock::now() < until, "`{name}` is {found}");
            pause.wait(Some(comms::io::clock::now() + Duration::from_millis(5)));
        }
    }
}
