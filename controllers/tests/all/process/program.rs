//! A controller program, and the socket of its node, which the test holds.

use super::PROGRAM;
use comms::io::clock::now;
use comms::logic::codec;
use comms::logic::control::{Device, Dial, Incoming, Location, Notice, Order, Outgoing};
use comms::logic::frame::{self, Decoder};
use std::io::{Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};

/// A program that has sent its hello.
pub(super) struct Program {
    dir: PathBuf,
    pub(super) child: Child,
    stream: UnixStream,
    decoder: Decoder,
    pub(super) hello: Notice,
}

impl Program {
    pub(super) fn start(arguments: &[&str]) -> Self {
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

    pub(super) fn order(&mut self, order: &Order) {
        let bytes = frame::encode(&codec::encode(order).unwrap(), 1 << 20).unwrap();
        self.stream.write_all(&bytes).unwrap();
    }

    pub(super) fn next(&mut self) -> Option<Notice> {
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

    /// The next notice has to be this one; losses of wires are reported at any time, and do not count.
    #[track_caller]
    pub(super) fn expect(&mut self, notice: &Notice) {
        let next = std::iter::from_fn(|| self.next()).find(|next| !matches!(next, Notice::Losses { .. }));
        assert_eq!(next.as_ref(), Some(notice));
    }

    pub(super) fn location(&self) -> &Location {
        let Notice::Hello { location, .. } = &self.hello else { panic!("{:?}", self.hello) };
        location.as_ref().unwrap()
    }

    pub(super) fn dial(&self) -> Dial {
        Dial { session: self.location().session.clone(), locators: self.location().local.clone() }
    }

    /// Orders every link; all wires of a test are one, from an output `Out` to the input named.
    pub(super) fn connect(&mut self, incoming: &[(&str, &Self)], outgoing: &[&str], devices: &[(&str, &Self)]) {
        let key = || "dca/d/test/1/w/0".to_owned();
        let incoming = incoming.iter().map(|(port, producer)| {
            let producer = producer.dial();
            Incoming { wire: 0, port: (*port).to_owned(), key: key(), producer, pull: false }
        });
        let outgoing = outgoing.iter().map(|port| {
            let port = (*port).to_owned();
            Outgoing { wire: 0, port, key: key(), pull: false }
        });
        let devices = devices.iter().map(|(device, owner)| {
            let (device, deployment) = ((*device).to_owned(), "test".to_owned());
            Device { device, owner: owner.dial(), deployment }
        });
        let (incoming, outgoing, devices) = (incoming.collect(), outgoing.collect(), devices.collect());
        self.order(&Order::Connect { robot: "test".to_owned(), incoming, outgoing, devices });
    }

    pub(super) fn activate(&mut self, activation: u32) {
        self.order(&Order::Activate { activation, value: Vec::new(), since: now() });
        self.expect(&Notice::Running { activation });
    }

    /// Waits for the end of the program. Returns its exit code and its standard error.
    pub(super) fn leave(mut self) -> (Option<i32>, String) {
        let mut said = String::new();
        self.child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        let code = self.child.wait().unwrap().code();
        std::fs::remove_dir_all(&self.dir).unwrap();
        (code, said)
    }
}
