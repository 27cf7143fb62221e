//! Real controller programs, with the test in the place of their node.

#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

use comms::logic::codec;
use comms::logic::control::{Device, Dial, Incoming, Location, Notice, Order, Outgoing};
use comms::logic::frame::{self, Decoder};
use std::io::{Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};

const PROGRAM: &str = env!("CARGO_BIN_EXE_dca-controller");

/// A program that has said hello.
struct Program {
    dir: PathBuf,
    child: Child,
    stream: UnixStream,
    decoder: Decoder,
    hello: Notice,
}

impl Program {
    fn start(arguments: &[&str]) -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let dir = std::env::temp_dir().join(format!("dca-process-{}-{number}", std::process::id()));
        std::fs::create_dir_all(&dir).unwrap();
        let listener = UnixListener::bind(dir.join("control.sock")).unwrap();
        listener.set_nonblocking(true).unwrap();
        let mut child = Command::new(PROGRAM)
            .args(arguments)
            .env_clear()
            .env("DCA_CONTROL", dir.join("control.sock"))
            .env("DCA_INSTANCE", format!("main/{}", arguments[0]))
            .env("DCA_DATA_SOCKET", dir.join("data.sock"))
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let stream = loop {
            match listener.accept() {
                Ok((stream, _)) => break stream,
                Err(_) => assert_eq!(child.try_wait().unwrap(), None, "it left before it said hello"),
            }
            std::thread::yield_now();
        };
        let mut program = Self { dir, child, stream, decoder: Decoder::new(1 << 20), hello: Notice::Connected };
        program.hello = program.next().unwrap();
        program
    }

    fn order(&mut self, order: &Order) {
        let bytes = frame::encode(&codec::encode(order).unwrap(), 1 << 20).unwrap();
        self.stream.write_all(&bytes).unwrap();
    }

    fn next(&mut self) -> Option<Notice> {
        loop {
            if let Some(body) = self.decoder.next_frame().unwrap() {
                return Some(codec::decode(&body).unwrap());
            }
            let mut bytes = [0; 4096];
            match self.stream.read(&mut bytes) {
                Ok(0) | Err(_) => return None,
                Ok(size) => self.decoder.push(&bytes[..size]),
            }
        }
    }

    #[track_caller]
    fn expect(&mut self, notice: &Notice) {
        assert_eq!(self.next().as_ref(), Some(notice));
    }

    fn location(&self) -> &Location {
        let Notice::Hello { location, .. } = &self.hello else { panic!("{:?}", self.hello) };
        location.as_ref().unwrap()
    }

    fn dial(&self) -> Dial {
        Dial { session: self.location().session.clone(), locators: self.location().local.clone() }
    }

    /// Orders every link; all wires of a test are one, from an output `Out` to the input named.
    fn connect(&mut self, incoming: &[(&str, &Self)], outgoing: &[&str], devices: &[(&str, &Self)]) {
        let key = || "dca/d/test/1/w/0".to_owned();
        let incoming = incoming.iter().map(|(port, producer)| {
            let producer = producer.dial();
            Incoming { wire: 0, port: (*port).to_owned(), key: key(), producer, pull: false }
        });
        let outgoing = outgoing.iter().map(|port| {
            let port = (*port).to_owned();
            Outgoing { wire: 0, port, key: key(), pull: false }
        });
        let devices =
            devices.iter().map(|(device, owner)| Device { device: (*device).to_owned(), owner: owner.dial() });
        let (incoming, outgoing, devices) = (incoming.collect(), outgoing.collect(), devices.collect());
        self.order(&Order::Connect { robot: "test".to_owned(), incoming, outgoing, devices });
    }

    fn activate(&mut self, activation: u32) {
        self.order(&Order::Activate { activation, value: Vec::new() });
        self.expect(&Notice::Running { activation });
    }

    /// Waits for the end of the program; returns its exit code, and what it said on standard error.
    fn leave(mut self) -> (Option<i32>, String) {
        let mut said = String::new();
        self.child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        let code = self.child.wait().unwrap().code();
        std::fs::remove_dir_all(&self.dir).unwrap();
        (code, said)
    }
}

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
        let Some(Notice::Done { activation, value }) = threshold.next() else { panic!("no force was measured") };
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
    let devices = vec![Device { device: "ft".to_owned(), owner }];
    sensor.order(&Order::Connect { robot: "test".to_owned(), incoming: vec![], outgoing: vec![], devices });
    let Some(Notice::ConnectFailed { reason }) = sensor.next() else { panic!("it connected") };
    assert!(reason.starts_with("device `ft`: cannot reach session nobody"), "{reason}");
    sensor.order(&Order::Exit);
    assert_eq!(sensor.leave().0, Some(0));
}

#[test]
fn a_lost_node_and_a_signal_end_the_program() {
    let mut lost = world();
    lost.activate(1);
    lost.stream.shutdown(std::net::Shutdown::Both).unwrap();
    assert_eq!(lost.leave(), (Some(1), "the node is gone\n".to_owned()));

    let mut killed = world();
    killed.activate(1);
    assert!(Command::new("kill").arg(killed.child.id().to_string()).status().unwrap().success());
    killed.expect(&Notice::Stopped { activation: 1 });
    assert_eq!(killed.leave(), (Some(143), String::new()));
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
    let wrong = "`ForceThreshold`: parameter `threshold` is `much`, which is not a number from 1 to 200";
    check(&["ForceThreshold", "much"], wrong);
}
