//! Data sessions over dialled Unix sockets: in one process, in two, and through a link that is cut.

#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

use comms::io::data::{DataSession, Priority, Publisher};
use comms::io::session::Reach;
use comms::logic::control::Dial;
use std::io::{BufRead, BufReader, Write};
use std::net::Shutdown;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

const LONG: Duration = Duration::from_secs(20);

/// A separate directory for each test, removed afterwards.
struct Dir(PathBuf);

impl Dir {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("dca-data-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }
    fn socket(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }
    fn open(&self, name: &str) -> DataSession {
        DataSession::open(&self.socket(name), Reach::Host).unwrap()
    }
}

impl Drop for Dir {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.0).unwrap();
    }
}

fn dial_of(session: &DataSession) -> Dial {
    let location = session.location();
    assert_eq!(location.remote, Vec::<String>::new());
    Dial { session: location.session, locators: location.local }
}

fn hear(session: &DataSession, key: &str) -> (comms::io::data::Subscription, Receiver<Vec<u8>>) {
    let (tx, rx) = sync_channel(1000);
    let hearing = session.on_sample(key, move |bytes| tx.send(bytes.to_vec()).unwrap_or_default()).unwrap();
    (hearing, rx)
}

fn publisher(session: &DataSession, key: &str) -> Publisher {
    session.publisher(key, Priority::Wire).unwrap()
}

#[test]
fn samples_and_fetches_over_one_link() {
    let dir = Dir::new("one");
    let (producer, consumer) = (dir.open("p.sock"), dir.open("c.sock"));
    let wire = publisher(&producer, "dca/d/t/1/w/0");
    let (_hearing, heard) = hear(&consumer, "dca/d/t/1/w/0");
    assert!(!wire.is_heard());
    consumer.dial(&dial_of(&consumer), LONG).unwrap();
    assert_eq!(consumer.fetch("dca/d/t/1/w/1", LONG).unwrap(), None);

    consumer.dial(&dial_of(&producer), LONG).unwrap();
    assert!(wire.wait_heard(LONG));
    for size in [0, 1, 64, 200_000] {
        wire.put(vec![7; size]).unwrap();
        assert_eq!(heard.recv_timeout(LONG).unwrap(), vec![7; size]);
    }

    let _answering = producer.answer("dca/d/t/1/w/1", || Some(b"now".to_vec())).unwrap();
    let _silent = producer.answer("dca/d/t/1/w/2", || None).unwrap();
    // The declaration travels on the same link as this sample, before it.
    wire.put(Vec::new()).unwrap();
    heard.recv_timeout(LONG).unwrap();
    assert_eq!(consumer.fetch("dca/d/t/1/w/1", LONG).unwrap(), Some(b"now".to_vec()));
    assert_eq!(consumer.fetch("dca/d/t/1/w/2", LONG).unwrap(), None);
    assert_eq!(consumer.fetch("dca/d/t/1/w/3", LONG).unwrap(), None);
    consumer.close();
    producer.close();
}

#[test]
fn nobody_there_is_said_so_in_time() {
    let dir = Dir::new("nobody");
    let consumer = dir.open("c.sock");
    let nowhere = format!("unixsock-stream/{}", dir.socket("absent.sock").display());
    let dial = Dial { session: "a1".to_owned(), locators: vec![nowhere] };
    let error = consumer.dial(&dial, Duration::from_millis(300)).unwrap_err().to_string();
    assert!(error.contains("nothing answers at unixsock-stream/"), "{error}");
    let dial = Dial { session: "a1".to_owned(), locators: vec![] };
    assert!(consumer.dial(&dial, LONG).unwrap_err().to_string().contains("does not listen on an address"));
    let dial = Dial { session: "not hex".to_owned(), locators: vec!["x/y".to_owned()] };
    assert!(consumer.dial(&dial, LONG).unwrap_err().to_string().contains("is not a session"));
    consumer.close();
}

/// Sends until the link is ready. Earlier values are lost, as intended.
fn send_until_heard(wire: &Publisher, heard: &Receiver<Vec<u8>>, number: u8) {
    for _ in 0..1000 {
        wire.put(vec![number]).unwrap();
        if heard.recv_timeout(Duration::from_millis(20)).is_ok_and(|got| got == [number]) {
            return;
        }
    }
    panic!("{number} was never heard");
}

/// A relay between two sessions that can cut their connection.
#[derive(Default)]
struct Proxy {
    streams: Arc<Mutex<Vec<UnixStream>>>,
}

impl Proxy {
    /// Relays every link, for as long as the test lasts.
    fn start(at: &Path, to: PathBuf) -> Self {
        let (listener, proxy) = (UnixListener::bind(at).unwrap(), Self::default());
        let streams = Arc::clone(&proxy.streams);
        std::thread::spawn(move || {
            for near in listener.incoming() {
                let (near, far) = (near.unwrap(), UnixStream::connect(&to).unwrap());
                for (from, to) in [(&near, &far), (&far, &near)] {
                    let (mut from, mut to) = (from.try_clone().unwrap(), to.try_clone().unwrap());
                    std::thread::spawn(move || std::io::copy(&mut from, &mut to));
                }
                streams.lock().unwrap().extend([near, far]);
            }
        });
        proxy
    }

    fn cut(&self) {
        for stream in self.streams.lock().unwrap().drain(..) {
            stream.shutdown(Shutdown::Both).unwrap_or_default();
        }
    }
}

#[test]
fn a_cut_link_is_dialled_again() {
    let dir = Dir::new("cut");
    let (producer, consumer) = (dir.open("p.sock"), dir.open("c.sock"));
    let proxy = Proxy::start(&dir.socket("x.sock"), dir.socket("p.sock"));
    let wire = publisher(&producer, "dca/d/t/1/w/0");
    let (_hearing, heard) = hear(&consumer, "dca/d/t/1/w/0");
    let through = format!("unixsock-stream/{}", dir.socket("x.sock").display());
    let dial = Dial { session: dial_of(&producer).session, locators: vec![through] };
    consumer.dial(&dial, LONG).unwrap();
    for cut in 0..5 {
        send_until_heard(&wire, &heard, cut);
        proxy.cut();
    }
    send_until_heard(&wire, &heard, 5);
    consumer.close();
    producer.close();
}

/// The other process of `two_processes_exchange`: it echoes samples until its input ends. As a test it does nothing.
#[test]
fn echo_process() {
    let Some(socket) = std::env::var_os("DCA_TEST_SOCKET") else { return };
    let session = DataSession::open(Path::new(&socket), Reach::Host).unwrap();
    let back = publisher(&session, "dca/d/t/1/w/1");
    let _hearing = session.on_sample("dca/d/t/1/w/0", move |bytes| back.put(bytes.to_vec()).unwrap()).unwrap();
    println!("location {}", session.location().session);
    std::io::stdout().flush().unwrap();
    std::io::stdin().lines().for_each(drop);
    session.close();
}

#[test]
fn two_processes_exchange() {
    let dir = Dir::new("two");
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "data::echo_process", "--nocapture"])
        .env("DCA_TEST_SOCKET", dir.socket("p.sock"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let session = lines.find_map(|line| Some(line.unwrap().split_once("location ")?.1.to_owned())).unwrap();

    let consumer = dir.open("c.sock");
    let (_hearing, heard) = hear(&consumer, "dca/d/t/1/w/1");
    let wire = publisher(&consumer, "dca/d/t/1/w/0");
    let locators = vec![format!("unixsock-stream/{}", dir.socket("p.sock").display())];
    consumer.dial(&Dial { session, locators }, LONG).unwrap();
    assert!(wire.wait_heard(LONG));
    // The publisher of the echo process learns of this subscriber a moment later.
    send_until_heard(&wire, &heard, 0);
    for number in 1..=100_u8 {
        wire.put(vec![number]).unwrap();
        while heard.recv_timeout(LONG).unwrap() != [number] {}
    }
    drop(child.stdin.take());
    assert!(child.wait().unwrap().success());
    consumer.close();
}
