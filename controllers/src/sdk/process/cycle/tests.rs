//! The loop of a controller, with the test in the place of its node.

use super::super::inbox::Hold;
use super::*;
use crate::sdk::controller::{About, Configured};
use crate::sdk::interface::Interface;
use comms::io::control::{self, OrderReceiver};
use comms::logic::codec;
use comms::logic::frame::Decoder;
use comms::logic::signals::Signal;
use std::cell::Cell;
use std::io::Read;
use std::os::unix::net::{UnixListener, UnixStream};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

const STOP_WITHIN: Duration = Duration::from_millis(20);

/// Panics once, in the call with this name. With `fail` a stop fails, with `again` no stop finishes.
struct Fragile {
    interface: Interface,
    breaks_in: Cell<&'static str>,
    stops: SyncSender<Time>,
}

impl Fragile {
    fn at(&self, call: &'static str) {
        if self.breaks_in.get() == call {
            self.breaks_in.set("");
            panic!("in {call}");
        }
    }
}

impl Module for Fragile {
    fn interface(&self) -> &Interface {
        &self.interface
    }
    fn deliver(&mut self, _: &str, _: &[u8], _: Time) -> Result<Delivery, DeliveryError> {
        self.at("deliver");
        Ok(Delivery::Stored)
    }
    fn init(&mut self, _: &[u8], _: Time) -> Result<(), String> {
        self.at("init");
        Ok(())
    }
    fn configure(&mut self, _: Arguments, _: bool) -> Result<Configured, String> {
        Ok(Configured::Now)
    }
    fn calculate(&mut self, _: Time) -> Progress {
        self.at("calculate");
        Progress::Continue
    }
    fn stop(&mut self, time: Time) -> Stopping {
        self.at("stop");
        self.stops.try_send(time).unwrap_or_default();
        match self.breaks_in.get() {
            "again" => Stopping::Again,
            "fail" => {
                self.breaks_in.set("");
                Stopping::Failed("it presses".to_owned())
            }
            _ => Stopping::Finished,
        }
    }
    fn drain(&mut self, _: &mut dyn FnMut(&'static str, Vec<u8>)) {
        self.at("drain");
    }
    fn signals(&self) -> Vec<Signal> {
        self.at("signals");
        Vec::new()
    }
}

/// A running loop, and the socket of its node.
struct Running {
    inbox: Arc<Inbox>,
    running: std::thread::JoinHandle<()>,
    /// The receiver keeps the connection open.
    _orders: OrderReceiver,
    stream: UnixStream,
    decoder: Decoder,
}

impl Running {
    fn order(&self, command: Command) {
        assert!(self.inbox.command(command));
    }

    fn next(&mut self) -> Notice {
        loop {
            if let Some(body) = self.decoder.next_frame().unwrap() {
                return codec::decode(&body).unwrap();
            }
            let mut bytes = [0; 256];
            let size = self.stream.read(&mut bytes).unwrap();
            assert_ne!(size, 0, "the loop is gone");
            self.decoder.push(&bytes[..size]);
        }
    }
}

/// Starts the loop of a controller that breaks in `call`. Also returns the times of its stops.
fn start(call: &'static str) -> (Running, Receiver<Time>) {
    let path = std::env::temp_dir().join(format!("dca-cycle-{}-{call}", std::process::id()));
    let listener = UnixListener::bind(&path).unwrap();
    let (notices, orders) = control::connect(&path, Duration::from_secs(30)).unwrap();
    let (stream, decoder) = (listener.accept().unwrap().0, Decoder::new(1 << 16));
    std::fs::remove_file(&path).unwrap();
    let period = Duration::from_millis(1);
    let about = About::service("Panics once.").every(period).signals_every(period).stop_within(STOP_WITHIN);
    let interface = Interface {
        type_name: "Fragile",
        about,
        ports: Vec::new(),
        exports: Vec::new(),
        calls: Vec::new(),
        inner: Vec::new(),
    };
    let (stops_tx, stops) = sync_channel(1);
    let module = Box::new(Fragile { interface, breaks_in: Cell::new(call), stops: stops_tx });
    let inbox = Arc::new(Inbox::default());
    let cycle = Cycle::new(module, Arc::clone(&inbox), Arc::default(), NoticeLog::new(notices));
    let running = std::thread::spawn(move || cycle.run());
    (Running { inbox, running, _orders: orders, stream, decoder }, stops)
}

/// Runs a controller that breaks in `call`, and then activates it once more.
fn check(call: &'static str, expected: &[Notice]) {
    let (mut program, _stops) = start(call);
    let activate = |activation| Command::Activate { activation, value: Vec::new(), since: now() };
    program.order(activate(1));
    for notice in expected {
        assert_eq!(program.next(), *notice, "{call}");
        match call {
            "deliver" => program.inbox.sample("In", Vec::new(), Hold::default()),
            "stop" | "fail" => program.order(Command::Stop { activation: 1 }),
            _ => {}
        }
    }
    program.order(activate(2));
    assert_eq!(program.next(), Notice::Running { activation: 2 }, "{call}");
    program.order(Command::Stop { activation: 2 });
    assert_eq!(program.next(), Notice::Stopped { activation: 2 }, "{call}");
    program.order(Command::Leave);
    program.running.join().unwrap();
}

#[test]
fn a_panic_anywhere_ends_the_activation_and_not_the_loop() {
    let activation = 1;
    let [running, stopping] = [Notice::Running { activation }, Notice::Stopping { activation }];
    let aborted = |reason: String| Notice::Aborted { activation, reason };
    let panicked = |call: &str| aborted(format!("the controller panicked: in {call}"));
    check("init", &[stopping.clone(), panicked("init")]);
    for call in ["deliver", "calculate", "signals"] {
        check(call, &[running.clone(), stopping.clone(), panicked(call)]);
    }
    check("drain", &[stopping, running.clone(), panicked("drain")]);
    check("stop", &[running.clone(), aborted("its stop failed: the controller panicked: in stop".to_owned())]);
    check("fail", &[running, aborted("its stop failed: it presses".to_owned())]);
}

/// A stop that takes too long is not a clean end. It goes on until the program is told to leave.
#[test]
fn a_stop_that_does_not_finish_has_no_end_before_the_program_leaves() {
    let (mut program, stops) = start("again");
    program.order(Command::Activate { activation: 1, value: Vec::new(), since: now() });
    assert_eq!(program.next(), Notice::Running { activation: 1 });
    program.order(Command::Stop { activation: 1 });
    let first = stops.recv().unwrap();
    while stops.recv().unwrap().since(first) < 2 * STOP_WITHIN {}
    program.order(Command::Leave);
    assert_eq!(program.next(), Notice::Stopped { activation: 1 });
    drop(stops);
    program.running.join().unwrap();
}
