//! Calls between programs over dialled Unix sockets: in one process, and to a process that is killed or suspended.

#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

use comms::io::clock::now;
use comms::io::data::{AnswerWay, CallWay, DataSession, ObjectEvent, ObjectServer};
use comms::io::session::Reach;
use comms::logic::bytes::Bytes;
use comms::logic::control::Dial;
use comms::logic::key;
use comms::logic::object::{CallId, ObjectCall, ObjectError, PAYLOAD_SIZE_MAX, Signature};
use rustix::process::{Pid, Signal, kill_process};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Mutex;
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;

const LONG: Duration = Duration::from_secs(30);

/// A separate directory for each test, removed afterwards.
struct Dir(PathBuf);

impl Dir {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("dca-object-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn open(&self, name: &str) -> DataSession {
        DataSession::open(&self.0.join(name), Reach::Host).unwrap()
    }
}

impl Drop for Dir {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.0).unwrap();
    }
}

fn dial_of(session: &DataSession) -> Dial {
    let location = session.location();
    Dial { session: location.session, locators: location.local }
}

fn call(session: &DataSession, number: u64, name: &str, argument: Vec<u8>, within: Duration) -> ObjectCall {
    ObjectCall {
        id: CallId { session: session.id(), number },
        caller: "test".to_owned(),
        name: name.to_owned(),
        signature: Signature::default(),
        within,
        argument: Bytes(argument),
        warrant: None,
    }
}

fn keys() -> key::ObjectKeys {
    key::object("t", "main/a")
}

fn ask(session: &DataSession, call: &ObjectCall) -> Result<Vec<u8>, ObjectError> {
    let keys = keys();
    session.call_and_wait(&keys, &CallWay::Open, call)
}

/// Serves `echo`, keeps `wait` without an answer, and drops `drop`. Reports the events.
fn serve(session: &DataSession) -> (ObjectServer, Receiver<String>) {
    let (told_tx, told) = sync_channel(1000);
    let kept: Mutex<Vec<AnswerWay>> = Mutex::default();
    let keys = keys();
    let serve = move |event| {
        let tell = |text: String| told_tx.try_send(text).unwrap_or_default();
        match event {
            ObjectEvent::Called(incoming) => {
                match incoming.call.name.as_str() {
                    "echo" => incoming.way.answer(Ok(incoming.call.argument.0)),
                    "wait" => kept.lock().unwrap().push(incoming.way),
                    "drop" => drop(incoming.way),
                    name => {
                        let error = ObjectError::NoSuchProcedure { name: name.to_owned(), known: vec!["echo".into()] };
                        incoming.way.answer(Err(error));
                    }
                }
                tell(format!("called {}", incoming.call.id.number));
            }
            ObjectEvent::Cancelled(id) => tell(format!("cancelled {}", id.number)),
        }
    };
    (session.serve_calls(&keys, None, serve).unwrap(), told)
}

#[test]
fn calls_are_answered_or_say_why_not() {
    let dir = Dir::new("one");
    let (server, client) = (dir.open("s.sock"), dir.open("c.sock"));
    let (_serving, told) = serve(&server);
    // The server was not started yet.
    assert_eq!(ask(&client, &call(&client, 0, "echo", vec![], LONG)), Err(ObjectError::Gone));
    client.dial(&dial_of(&server), LONG).unwrap();
    for size in [0, 1, 64, 300_000, PAYLOAD_SIZE_MAX] {
        assert_eq!(ask(&client, &call(&client, 1, "echo", vec![7; size], LONG)), Ok(vec![7; size]));
        assert_eq!(told.recv_timeout(LONG).unwrap(), "called 1");
    }
    let large = call(&client, 2, "echo", vec![7; PAYLOAD_SIZE_MAX + 1], LONG);
    assert!(matches!(ask(&client, &large), Err(ObjectError::TooLarge { .. })));
    let unknown = ask(&client, &call(&client, 3, "nope", vec![], LONG));
    assert_eq!(unknown, Err(ObjectError::NoSuchProcedure { name: "nope".into(), known: vec!["echo".into()] }));
    assert_eq!(told.recv_timeout(LONG).unwrap(), "called 3");
    assert_eq!(ask(&client, &call(&client, 4, "drop", vec![], LONG)), Err(ObjectError::Gone));
    assert_eq!(told.recv_timeout(LONG).unwrap(), "called 4");
    let within = Duration::from_millis(200);
    assert_eq!(ask(&client, &call(&client, 5, "wait", vec![], within)), Err(ObjectError::Deadline { within }));
    assert_eq!(told.recv_timeout(LONG).unwrap(), "called 5");
    client.close();
    server.close();
}

/// A caller that cancels sends a message; a caller that is killed loses its link. A caller that has its answer sends
/// nothing.
#[test]
fn the_other_end_learns_that_nobody_waits() {
    let dir = Dir::new("cancel");
    let (server, client) = (dir.open("s.sock"), dir.open("c.sock"));
    let (_serving, told) = serve(&server);
    client.dial(&dial_of(&server), LONG).unwrap();
    let keys = keys();
    let pending =
        client.call(&keys, &CallWay::Open, &call(&client, 1, "wait", vec![], LONG), |_| panic!("no answer")).unwrap();
    assert_eq!(told.recv_timeout(LONG).unwrap(), "called 1");
    drop(pending);
    assert_eq!(told.recv_timeout(LONG).unwrap(), "cancelled 1");
    let (done_tx, done) = sync_channel(1);
    let take = move |result| done_tx.send(result).unwrap_or_default();
    let pending = client.call(&keys, &CallWay::Open, &call(&client, 2, "echo", vec![1], LONG), take).unwrap();
    assert_eq!(done.recv_timeout(LONG).unwrap(), Ok(vec![1]));
    drop(pending);
    assert_eq!(told.recv_timeout(LONG).unwrap(), "called 2");
    let id = client.id();
    assert!(server.is_linked(&id) && server.is_linked(&server.id()));
    client.close();
    // All earlier messages have arrived, and none of them is a cancellation.
    let other = dir.open("o.sock");
    other.dial(&dial_of(&server), LONG).unwrap();
    assert_eq!(ask(&other, &call(&other, 3, "echo", vec![2], LONG)), Ok(vec![2]));
    assert_eq!(told.recv_timeout(LONG).unwrap(), "called 3");
    let until = now() + LONG;
    while server.is_linked(&id) {
        assert!(now() < until, "the link of a session that was closed is gone");
        std::thread::yield_now();
    }
    other.close();
    server.close();
}

#[test]
fn a_hundred_callers_have_their_own_answers() {
    let dir = Dir::new("many");
    let (server, client) = (dir.open("s.sock"), dir.open("c.sock"));
    let (_serving, _told) = serve(&server);
    client.dial(&dial_of(&server), LONG).unwrap();
    std::thread::scope(|scope| {
        for caller in 0..100_u8 {
            let client = &client;
            scope.spawn(move || {
                for number in 0..5_u8 {
                    let argument = vec![caller, number];
                    let asked =
                        call(client, u64::from(caller) * 100 + u64::from(number), "echo", argument.clone(), LONG);
                    assert_eq!(ask(client, &asked), Ok(argument));
                }
            });
        }
    });
    client.close();
    server.close();
}

/// A server in a separate process: this test program, started again.
struct Other {
    child: Child,
    dial: Dial,
}

impl Other {
    fn start(socket: &Path) -> Self {
        let mut child = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "object::serves_in_a_process_of_its_own", "--nocapture"])
            .env("DCA_TEST_SOCKET", socket)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let session = lines.find_map(|line| Some(line.unwrap().split_once("session ")?.1.to_owned())).unwrap();
        let locators = vec![format!("unixsock-stream/{}", socket.display())];
        Self { child, dial: Dial { session, locators } }
    }

    fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child), signal).unwrap();
    }
}

/// Not a test by itself: the other process of the tests below.
#[test]
fn serves_in_a_process_of_its_own() {
    let Some(socket) = std::env::var_os("DCA_TEST_SOCKET") else { return };
    let session = DataSession::open(Path::new(&socket), Reach::Host).unwrap();
    let (_serving, told) = serve(&session);
    println!("session {}", session.id());
    while told.recv().is_ok() {}
}

#[test]
fn a_server_that_is_killed_in_a_call_is_gone_at_once() {
    let dir = Dir::new("killed");
    let client = dir.open("c.sock");
    let mut other = Other::start(&dir.0.join("s.sock"));
    client.dial(&other.dial, LONG).unwrap();
    assert_eq!(ask(&client, &call(&client, 1, "echo", vec![5], LONG)), Ok(vec![5]));
    let keys = keys();
    let (done_tx, done) = sync_channel(1);
    let take = move |result| done_tx.send(result).unwrap_or_default();
    let hour = Duration::from_secs(3600);
    let _pending = client.call(&keys, &CallWay::Open, &call(&client, 2, "wait", vec![], hour), take).unwrap();
    // The cancelled call has arrived once the next one is answered.
    assert_eq!(ask(&client, &call(&client, 3, "echo", vec![6], LONG)), Ok(vec![6]));
    other.signal(Signal::KILL);
    assert_eq!(done.recv_timeout(LONG).unwrap(), Err(ObjectError::Gone));
    other.child.wait().unwrap();
    client.close();
}

#[test]
fn a_suspended_server_costs_its_callers_their_time_and_no_more() {
    let dir = Dir::new("suspended");
    let client = dir.open("c.sock");
    let mut other = Other::start(&dir.0.join("s.sock"));
    client.dial(&other.dial, LONG).unwrap();
    assert_eq!(ask(&client, &call(&client, 1, "echo", vec![5], LONG)), Ok(vec![5]));
    other.signal(Signal::STOP);
    let within = Duration::from_millis(300);
    assert_eq!(ask(&client, &call(&client, 2, "echo", vec![6], within)), Err(ObjectError::Deadline { within }));
    other.signal(Signal::CONT);
    assert_eq!(ask(&client, &call(&client, 3, "echo", vec![7], LONG)), Ok(vec![7]));
    other.signal(Signal::KILL);
    other.child.wait().unwrap();
    client.close();
}
