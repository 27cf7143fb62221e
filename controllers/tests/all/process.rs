//! Real controller programs, with the test in the place of their node.

#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

mod program;

use comms::io::data::{DataSession, Priority, Publisher, Subscription};
use comms::io::session::Reach;
use comms::logic::control::{Device, Dial, Incoming, Location, Notice, Order, Outgoing, Shape};
use comms::logic::signals::Signals;
use comms::logic::{codec, key};
use program::Program;
use std::path::PathBuf;
use std::process::Command;
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;

const PROGRAM: &str = env!("CARGO_BIN_EXE_dca-controller");

fn world() -> Program {
    let mut world = Program::start(&["DoorWorld"]);
    world.connect(&[], &[], &[]);
    world.expect(&Notice::Connected);
    world
}

#[test]
fn three_programs_measure_a_force() {
    let mut world = world();
    let mut sensor = Program::start(&["ForceTorque"]);
    let mut threshold = Program::start(&["ForceThreshold", "threshold=1"]);
    let Notice::Hello { owns, needs, instance, .. } = &sensor.hello else { panic!("{:?}", sensor.hello) };
    assert_eq!((owns.len(), needs.as_slice()), (0, &["ft".to_owned()][..]));
    assert_eq!(instance, "main/ForceTorque");
    assert_eq!(sensor.location().remote, Vec::<String>::new());
    let Notice::Hello { owns, .. } = &world.hello else { panic!("{:?}", world.hello) };
    assert!(owns.contains(&"ft".to_owned()));

    // A producer is connected once its consumer is.
    sensor.connect(&[], &["Out"], &[("ft", &world)]);
    threshold.connect(&[("In", &sensor)], &[], &[]);
    threshold.expect(&Notice::Connected);
    sensor.expect(&Notice::Connected);

    world.activate(1);
    sensor.activate(1);
    for generation in 1..=3_u32 {
        let echo = u64::from(generation);
        sensor.order(&Order::Open { wires: vec![0], generation: echo });
        sensor.expect(&Notice::Switched { generation: echo });
        threshold.activate(generation);
        threshold.expect(&Notice::Stopping { activation: generation });
        let ended = std::iter::from_fn(|| threshold.next()).find(|next| !matches!(next, Notice::Losses { .. }));
        let Some(Notice::Done { activation, value }) = ended else { panic!("no force was measured: {ended:?}") };
        assert_eq!((activation, value.is_empty()), (generation, false));
        sensor.order(&Order::Close { wires: vec![0], generation: echo });
        sensor.expect(&Notice::Switched { generation: echo });
    }
    for mut program in [threshold, sensor, world] {
        program.order(&Order::Exit);
        assert_eq!(program.leave(), (Some(0), String::new()));
    }
}

#[test]
fn an_activation_ends_once() {
    let mut world = world();
    for activation in [1, 2] {
        world.activate(activation);
        // An order for an activation that is over, and the same order twice.
        world.order(&Order::Stop { activation: activation - 1 });
        world.order(&Order::Stop { activation });
        world.order(&Order::Stop { activation });
        world.expect(&Notice::Stopped { activation });
        world.order(&Order::Stop { activation });
    }
    world.order(&Order::Exit);
    assert_eq!(world.next(), None);
    assert_eq!(world.leave(), (Some(0), String::new()));
}

#[test]
fn links_that_cannot_be_made_are_told() {
    let mut sensor = Program::start(&["ForceTorque"]);
    let owner = Dial { session: "nobody".to_owned(), locators: vec!["unixsock-stream//no/such/socket".to_owned()] };
    let devices = vec![Device { device: "ft".to_owned(), owner, deployment: "test".to_owned() }];
    sensor.order(&Order::Connect { robot: "test".to_owned(), incoming: vec![], outgoing: vec![], devices });
    let Some(Notice::ConnectFailed { reason }) = sensor.next() else { panic!("it connected") };
    assert!(reason.starts_with("device `ft`: cannot reach session nobody"), "{reason}");
    sensor.order(&Order::Exit);
    assert_eq!(sensor.leave().0, Some(0));
}

#[test]
fn a_signal_ends_the_program() {
    let mut killed = world();
    killed.activate(1);
    assert!(Command::new("kill").arg(killed.child.id().to_string()).status().unwrap().success());
    killed.expect(&Notice::Stopped { activation: 1 });
    assert_eq!(killed.leave(), (Some(143), String::new()));
}

/// The other end of a program's wires, in the test itself.
struct End {
    session: DataSession,
    dir: PathBuf,
    subscriptions: Vec<Subscription>,
}

/// How long something has that is under way.
const SOON: Duration = Duration::from_secs(30);

impl End {
    fn open(name: &str) -> Self {
        let dir = std::env::temp_dir().join(format!("dca-end-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&dir).unwrap();
        let session = DataSession::open(&dir.join("s"), Reach::Host).unwrap();
        Self { session, dir, subscriptions: Vec::new() }
    }

    fn dial(&self) -> Dial {
        let Location { session, local, .. } = self.session.location();
        Dial { session, locators: local }
    }

    fn hear(&mut self, key: &str) -> Receiver<Vec<u8>> {
        let (heard_tx, heard) = sync_channel(10_000);
        let on_sample =
            move |bytes: std::borrow::Cow<'_, [u8]>| heard_tx.try_send(bytes.into_owned()).unwrap_or_default();
        self.subscriptions.push(self.session.on_sample(key, on_sample).unwrap());
        heard
    }

    /// Publishes on a key that has a subscriber.
    fn publisher(&self, key: &str) -> Publisher {
        let publisher = self.session.publisher(key, Priority::Wire).unwrap();
        assert!(publisher.wait_heard(SOON), "nobody hears `{key}`");
        publisher
    }

    fn close(self) {
        drop(self.subscriptions);
        self.session.close();
        std::fs::remove_dir_all(&self.dir).unwrap();
    }
}

/// Returns the number of a beat of a `RateSource`.
fn beat(bytes: &[u8]) -> u64 {
    postcard::from_bytes::<(u64, Vec<u8>)>(bytes).unwrap().0
}

/// Waits until a `RateMonitor` has heard of so many beats, those included that were lost; returns how many arrived.
/// After each look in vain it does something else.
fn heard_of(signals: &Receiver<Vec<u8>>, count: f64, mut in_vain: impl FnMut()) -> f64 {
    // It publishes ten times in a second.
    for _ in 0..10 * SOON.as_secs() {
        let bytes = signals.recv_timeout(SOON).unwrap_or_else(|_| panic!("it says nothing"));
        let signals: Signals = codec::decode(&bytes).unwrap();
        let value = |name| signals.values.iter().find(|signal| signal.name == name).unwrap().value;
        // A record has one schema for all samples.
        assert!(value("lost values") + value("refused values") >= 0.0);
        if value("received") + value("lost") >= count {
            return value("received");
        }
        in_vain();
    }
    panic!("it never heard of {count} beats")
}

fn wire_key(number: u32) -> String {
    key::wire("test", 1, number)
}

fn outgoing(numbers: &[u32]) -> Vec<Outgoing> {
    let one = |&wire: &u32| Outgoing { wire, port: "Out".to_owned(), key: wire_key(wire), pull: false };
    numbers.iter().map(one).collect()
}

fn incoming(wire: u32, producer: Dial) -> Vec<Incoming> {
    vec![Incoming { wire, port: "In".to_owned(), key: wire_key(wire), producer, pull: false }]
}

fn connect(incoming: Vec<Incoming>, outgoing: Vec<Outgoing>) -> Order {
    Order::Connect { robot: "test".to_owned(), incoming, outgoing, devices: vec![] }
}

/// One source with three wires: an ordinary one, a latched one, and one with one value an hour. The first shows when to
/// check the others.
#[test]
fn a_producer_keeps_to_what_its_wires_say() {
    let mut source = Program::start(&["RateSource"]);
    let mut end = End::open("producer");
    end.session.dial(&source.dial(), SOON).unwrap();
    let [plain, latched, rare] = [0, 1, 2].map(|wire| end.hear(&wire_key(wire)));
    let latch = Shape { wire: 1, latch: true, ..Shape::default() };
    let hourly = Shape { wire: 2, period_min: Some(Duration::from_secs(3600)), ..Shape::default() };
    source.order(&Order::Shape { wires: vec![latch, hourly] });
    source.order(&connect(vec![], outgoing(&[0, 1, 2])));
    source.expect(&Notice::Connected);
    source.activate(1);
    source.order(&Order::Open { wires: vec![0, 2], generation: 1 });
    source.expect(&Notice::Switched { generation: 1 });
    let beats: Vec<u64> = (0..20).map(|_| beat(&plain.recv_timeout(SOON).unwrap())).collect();
    assert!(beats.is_sorted(), "{beats:?}");
    source.order(&Order::Stop { activation: 1 });
    source.expect(&Notice::Stopped { activation: 1 });
    // Once the latched value has arrived, everything sent earlier has arrived: there is one link and one priority.
    source.order(&Order::Open { wires: vec![1], generation: 2 });
    source.expect(&Notice::Switched { generation: 2 });
    let last = beat(&latched.recv_timeout(SOON).unwrap());
    assert!(last >= beats[19] && latched.try_recv().is_err());
    assert_eq!(rare.try_iter().count(), 1);
    source.order(&Order::Exit);
    end.close();
    assert_eq!(source.leave(), (Some(0), String::new()));
}

/// Wires come and go while others carry every value.
#[test]
fn links_are_made_and_dropped_while_data_flows() {
    let mut source = Program::start(&["RateSource"]);
    let mut end = End::open("added");
    end.session.dial(&source.dial(), SOON).unwrap();
    let [first, second] = [0, 1].map(|wire| end.hear(&wire_key(wire)));
    source.order(&connect(vec![], outgoing(&[0])));
    source.expect(&Notice::Connected);
    source.activate(1);
    source.order(&Order::Open { wires: vec![0], generation: 1 });
    source.expect(&Notice::Switched { generation: 1 });
    let mut beats: Vec<u64> = (0..20).map(|_| beat(&first.recv_timeout(SOON).unwrap())).collect();
    source.order(&connect(vec![], outgoing(&[0, 1])));
    source.expect(&Notice::Connected);
    assert_eq!(second.try_iter().count(), 0, "a new wire is closed");
    source.order(&Order::Open { wires: vec![1], generation: 2 });
    source.expect(&Notice::Switched { generation: 2 });
    let mut others = vec![beat(&second.recv_timeout(SOON).unwrap())];
    while beats.last() < others.last() {
        beats.push(beat(&first.recv_timeout(SOON).unwrap()));
    }
    source.order(&connect(vec![], outgoing(&[1])));
    source.expect(&Notice::Connected);
    others.extend((0..20).map(|_| beat(&second.recv_timeout(SOON).unwrap())));
    // All values in transit have arrived before the first value after the switch.
    beats.extend(first.try_iter().map(|bytes| beat(&bytes)));
    let last = *beats.last().unwrap();
    others.extend((0..20).map(|_| beat(&second.recv_timeout(SOON).unwrap())));
    assert_eq!(first.try_iter().count(), 0, "the wire is gone after {last}");
    for beats in [&beats, &others] {
        assert!(beats.windows(2).all(|pair| pair[1] == pair[0] + 1), "a value is missing: {beats:?}");
    }
    source.order(&Order::Exit);
    end.close();
    assert_eq!(source.leave(), (Some(0), String::new()));
}

/// A robot that is to stop does not wait for a program that cannot be reached.
#[test]
fn a_stop_does_not_wait_for_links() {
    let end = End::open("stop");
    let mut monitor = Program::start(&["RateMonitor"]);
    monitor.order(&connect(incoming(0, end.dial()), vec![]));
    monitor.expect(&Notice::Connected);
    monitor.activate(1);
    let nobody = Dial { session: "1234abcd".to_owned(), locators: vec!["unixsock-stream//no/such/socket".to_owned()] };
    monitor.order(&connect([incoming(0, end.dial()), incoming(1, nobody)].concat(), vec![]));
    monitor.order(&Order::Stop { activation: 1 });
    monitor.expect(&Notice::Stopped { activation: 1 });
    monitor.order(&Order::Exit);
    end.close();
    assert_eq!(monitor.leave().0, Some(0));
}

/// A value over a latched wire waits for the activation; of a short queue, it is the newest that stays.
#[test]
fn a_consumer_keeps_to_what_its_wires_say() {
    for shape in [Shape { latch: true, ..Shape::default() }, Shape { queue: Some(1), ..Shape::default() }] {
        let mut end = End::open(if shape.latch { "latch" } else { "queue" });
        let mut monitor = Program::start(&["RateMonitor"]);
        monitor.order(&Order::Shape { wires: vec![shape] });
        monitor.order(&connect(incoming(0, end.dial()), vec![]));
        monitor.expect(&Notice::Connected);
        let signals = end.hear(&key::signals("test", "main/RateMonitor"));
        let beats = end.publisher(&wire_key(0));
        let send = |number: u64| beats.put(postcard::to_allocvec(&(number, Vec::<u8>::new())).unwrap()).unwrap();
        if shape.latch {
            send(1);
            monitor.activate(1);
            heard_of(&signals, 1.0, || {});
        } else {
            monitor.activate(1);
            let mut number = 0;
            let mut send_next = || {
                number += 1;
                send(number);
            };
            // The first one is where its count begins. On a congested link samples are dropped, even the last.
            send_next();
            heard_of(&signals, 1.0, &mut send_next);
            (0..200).for_each(|_| send_next());
            let received = heard_of(&signals, 200.0, send_next);
            println!("{received} of 200 beats were taken");
        }
        monitor.order(&Order::Exit);
        drop(beats);
        end.close();
        monitor.expect(&Notice::Stopped { activation: 1 });
        assert_eq!(monitor.leave(), (Some(0), String::new()));
    }
}

/// A controller without signals shows its losses, also at the end of an activation.
#[test]
fn a_controller_without_signals_shows_its_losses() {
    let mut end = End::open("losses");
    let mut config = Program::start(&["ConfigCtrl"]);
    let Notice::Hello { signals: true, .. } = config.hello else { panic!("{:?}", config.hello) };
    config.order(&connect(incoming(0, end.dial()), vec![]));
    config.expect(&Notice::Connected);
    let signals = end.hear(&key::signals("test", "main/ConfigCtrl"));
    let joints = end.publisher(&wire_key(0));
    config.activate(1);
    let next = || {
        let bytes = signals.recv_timeout(SOON).unwrap_or_else(|_| panic!("it says nothing"));
        let signals: Signals = codec::decode(&bytes).unwrap();
        let value = |name: &str| signals.values.iter().find(|signal| signal.name == name).unwrap().value;
        (signals.values.len(), value("lost values"), value("refused values"))
    };
    // Nine values are missing between these two.
    for number in [1, 11] {
        joints.put_numbered(vec![], number).unwrap();
    }
    while next().1 < 9.0 {}
    config.order(&Order::Stop { activation: 1 });
    config.expect(&Notice::Stopped { activation: 1 });
    assert_eq!(next(), (4, 9.0, 0.0));
    config.order(&Order::Exit);
    drop(joints);
    end.close();
    assert_eq!(config.leave().0, Some(0));
}

/// A source is killed and restarted. It does not wait long for an absent consumer, and a consumer that is told its new
/// address keeps receiving.
#[test]
fn a_program_that_was_started_again_is_found() {
    let mut monitor = Program::start(&["RateMonitor"]);
    let mut source = Program::start(&["RateSource"]);
    let mut end = End::open("again");
    monitor.order(&connect(incoming(0, source.dial()), vec![]));
    source.order(&connect(vec![], outgoing(&[0])));
    monitor.expect(&Notice::Connected);
    source.expect(&Notice::Connected);
    end.session.dial(&monitor.dial(), SOON).unwrap();
    let signals = end.hear(&key::signals("test", "main/RateMonitor"));
    monitor.activate(1);
    source.activate(1);
    source.order(&Order::Open { wires: vec![0], generation: 1 });
    source.expect(&Notice::Switched { generation: 1 });
    heard_of(&signals, 5.0, || {});

    let lost = source.location().session.clone();
    source.child.kill().unwrap();
    source.leave();
    let mut source = Program::start(&["RateSource"]);
    // The consumer is told while the source waits for it; another consumer is gone.
    source.order(&Order::Rejoin);
    source.order(&connect(vec![], outgoing(&[0, 1])));
    monitor.order(&Order::Relink { lost, found: source.dial() });
    source.expect(&Notice::Connected);
    source.order(&Order::Open { wires: vec![0], generation: 2 });
    source.expect(&Notice::Switched { generation: 2 });
    let before = heard_of(&signals, 0.0, || {});
    source.activate(1);
    heard_of(&signals, before + 20.0, || {});
    // A restarted consumer whose producer is gone is ready as well.
    let nowhere = Dial { session: "1".to_owned(), locators: vec!["unixsock-stream//no/such/socket".to_owned()] };
    let mut other = Program::start(&["RateMonitor"]);
    other.order(&Order::Rejoin);
    other.order(&connect(incoming(1, nowhere), vec![]));
    other.expect(&Notice::Connected);
    other.activate(1);
    end.close();
    for mut program in [monitor, source, other] {
        program.order(&Order::Exit);
        program.expect(&Notice::Stopped { activation: 1 });
        assert_eq!(program.leave(), (Some(0), String::new()));
    }
}

#[test]
fn wrong_usage_is_one_sentence() {
    let check = |arguments: &[&str], said: &str| {
        let output = Command::new(PROGRAM).args(arguments).env_clear().output().unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!((output.status.code(), stderr.lines().next().unwrap()), (Some(2), said));
    };
    check(&[], "usage: PROGRAM TYPE [[NAME=]VALUE]...   started by a node");
    check(&["DoorWorld"], "a controller is started by `dca-node` or `dca run`, not by hand: DCA_CONTROL is not set");
    let wrong =
        "`ForceThreshold`: parameter `threshold` is `much`, which is not a number from 1 to 200, the Force in N";
    check(&["ForceThreshold", "much"], wrong);
}
