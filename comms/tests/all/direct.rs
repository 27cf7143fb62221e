//! Wires between programs of one host: direct paths, each program in this process.

#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

use comms::io::clock::now;
use comms::io::data::{DataSession, Priority, Publisher};
use comms::io::direct::{DirectPath, Guard, Inlet, Memory, Outlet, Parcel, Value, WireSecrets};
use comms::logic::direct::Place;
use comms::logic::object::TypeForm;
use comms::logic::switch::{Arrival, Boundary, Sequence};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use zeroize::Zeroizing;

const LONG: Duration = Duration::from_secs(20);
/// More small values than a socket has room for.
const MANY: u32 = 5000;

type Arrived = (Arrival<Vec<u8>>, Sequence);

/// A program that has a direct path.
struct Program {
    path: DirectPath,
    file: PathBuf,
}

impl Program {
    fn new() -> Self {
        Self::with(None)
    }

    /// Returns a program of a team.
    fn with(guard: Option<Guard>) -> Self {
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let name = format!("dca-direct-{}-{}.wire", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
        let file = std::env::temp_dir().join(name);
        Self { path: DirectPath::open(&file, guard).unwrap(), file }
    }

    fn outlet(&self, key: &str, memory: &Memory) -> (Outlet, Publisher) {
        let session = DataSession::open_observer(None).unwrap();
        let publisher = session.publisher(key, Priority::Wire).unwrap();
        (self.path.outlet(key, memory, &publisher), publisher)
    }

    fn place(&self) -> Place {
        Place::of(&self.path.locator()).unwrap()
    }

    fn hear(&self, of: &Self, key: &str, replaced: Option<Inlet>) -> (Inlet, Receiver<Arrived>) {
        let (came_tx, came) = sync_channel(100_000);
        let inlet = self.hear_with(of, key, replaced, move |arrival, sequence| {
            came_tx.try_send((arrival, sequence)).unwrap_or_default();
        });
        (inlet, came)
    }

    fn hear_with(
        &self,
        of: &Self,
        key: &str,
        replaced: Option<Inlet>,
        mut on_arrival: impl FnMut(Arrival<Vec<u8>>, Sequence) + Send + 'static,
    ) -> Inlet {
        self.hear_values(of, key, replaced, move |arrival, sequence| match arrival {
            Arrival::Value(value) => on_arrival(Arrival::Value(value.into_vec()), sequence),
            Arrival::Boundary(boundary) => on_arrival(Arrival::Boundary(boundary), sequence),
        })
    }

    fn hear_values(
        &self,
        of: &Self,
        key: &str,
        replaced: Option<Inlet>,
        on_arrival: impl FnMut(Arrival<Value>, Sequence) + Send + 'static,
    ) -> Inlet {
        self.path.inlet(&of.place(), LONG, key, form(), replaced, on_arrival).unwrap()
    }

    /// Connects with a producer that refuses the consumer, or that the consumer refuses.
    fn hear_in_vain(&self, of: &Self, key: &str) -> std::io::Error {
        self.path.inlet(&of.place(), LONG, key, form(), None, |_, _| ()).unwrap_err()
    }

    /// Waits like a loop, until `count` values have come.
    fn wait_for(&self, came: &Receiver<Arrived>, count: usize) -> Vec<Arrived> {
        let (mut all, until): (Vec<Arrived>, _) = (came.try_iter().collect(), now() + LONG);
        while all.len() < count {
            assert!(now() < until, "{} of {count} have come", all.len());
            if !self.path.inlets().wait(Some(now() + LONG / 100)) {
                // Waking up also reads values that had to wait for an earlier value.
                self.path.inlets().read();
            }
            all.extend(came.try_iter());
        }
        all
    }
}

fn form() -> TypeForm {
    TypeForm { name: "W".into(), fields: String::new() }
}

fn wait_connected(outlet: &Outlet) {
    wait_until(|| outlet.is_connected());
}

fn wait_until(mut is_so: impl FnMut() -> bool) {
    let until = now() + LONG;
    while !is_so() {
        assert!(now() < until, "it does not come about");
        std::thread::yield_now();
    }
}

fn send(outlet: &Outlet, bytes: &[u8], number: u32) {
    assert!(outlet.send(&mut Parcel::new(bytes), number), "the consumer is gone");
}

/// Blocks the reader of values until it is opened.
#[derive(Clone, Default)]
struct Gate(Arc<Mutex<()>>);

impl Gate {
    fn shut(&self) -> MutexGuard<'_, ()> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[test]
fn values_and_words_come_in_order_with_their_numbers() {
    let (producer, consumer) = (Program::new(), Program::new());
    // The consumer may connect before the wire is made.
    let (_inlet, came) = consumer.hear(&producer, "k", None);
    let (outlet, _) = producer.outlet("k", &Memory::default());
    wait_connected(&outlet);
    assert_eq!(outlet.form(), Some(form()));
    let opened = Boundary::Opened { generation: 1, after: vec![3] };
    let sizes = [0, 1, 1000, 16 << 10, 100_000, 3_000_000, 5];
    assert!(outlet.mark(&opened, 0));
    for (number, size) in (1..).zip(sizes) {
        send(&outlet, &vec![u8::try_from(number).unwrap(); size], number);
    }
    let all = consumer.wait_for(&came, 1 + sizes.len());
    let publisher = all[0].1.publisher;
    assert_eq!(all[0], (Arrival::Boundary(opened), Sequence { publisher, number: 0 }));
    for ((number, size), arrived) in (1_u32..).zip(sizes).zip(&all[1..]) {
        let value = vec![u8::try_from(number).unwrap(); size];
        assert!(*arrived == (Arrival::Value(value), Sequence { publisher, number }), "value {number}");
    }
}

#[test]
fn who_is_not_wired_is_not_taken() {
    let (producer, stranger) = (Program::new(), Program::new());
    let (outlet, _) = producer.outlet("k", &Memory::default());
    let place = Place { token: "guessed".into(), ..producer.place() };
    let refused = stranger.path.inlet(&place, LONG, "k", form(), None, |_, _| ());
    assert!(refused.is_err() && !outlet.is_connected());
    let file = producer.file.clone();
    drop((outlet, producer));
    assert!(!file.exists());
    let gone = Place { path: file.display().to_string(), token: String::new() };
    assert!(stranger.path.inlet(&gone, LONG, "k", form(), None, |_, _| ()).is_err());
}

/// Values sent while a loop is busy do not fill the socket: the server's thread reads them.
#[test]
fn a_busy_loop_loses_nothing() {
    let (producer, consumer) = (Program::new(), Program::new());
    let (outlet, _) = producer.outlet("k", &Memory::default());
    let (_inlet, came) = consumer.hear(&producer, "k", None);
    wait_connected(&outlet);
    let mut all = Vec::new();
    for number in 1..=MANY {
        send(&outlet, b"value", number);
        if number % 100 == 0 {
            wait_until(|| {
                all.extend(came.try_iter());
                all.len() + 100 > number as usize
            });
        }
    }
    all.extend(consumer.wait_for(&came, MANY as usize - all.len()));
    assert!(all.iter().map(|(_, sequence)| sequence.number).eq(1..=MANY));
}

/// A consumer that reads nothing delays neither the producer nor another consumer. Its values are lost, but boundaries
/// still arrive.
#[test]
fn a_consumer_that_does_not_read_delays_nobody() {
    let (producer, stuck, quick) = (Program::new(), Program::new(), Program::new());
    let memory = Memory::default();
    let outlets = ["stuck", "quick"].map(|key| producer.outlet(key, &memory).0);
    let gate = Gate::default();
    let shut = gate.shut();
    let (came_tx, came): (SyncSender<Arrived>, _) = sync_channel(100_000);
    let own = gate.clone();
    let _stuck = stuck.hear_with(&producer, "stuck", None, move |arrival, sequence| {
        drop(own.shut());
        came_tx.try_send((arrival, sequence)).unwrap_or_default();
    });
    let (_quick, of_quick) = quick.hear(&producer, "quick", None);
    outlets.iter().for_each(wait_connected);
    let long = vec![7; 1 << 20];
    for number in 1..=100 {
        let mut parcel = Parcel::new(&long);
        assert!(outlets.iter().all(|outlet| outlet.send(&mut parcel, number)));
        quick.wait_for(&of_quick, 1);
    }
    for number in 101..=MANY {
        send(&outlets[0], b"short", number);
    }
    let closed = Boundary::Closed { generation: 1, sent: MANY.into() };
    assert!(outlets[0].mark(&closed, MANY));
    drop(shut);
    let (mut values, mut last, until) = (0, 0, now() + LONG);
    loop {
        assert!(now() < until, "the word does not come");
        stuck.path.inlets().wait(Some(now() + LONG / 100));
        let mut all = came.try_iter();
        let is_closed = all.any(|(arrival, sequence)| {
            assert!(sequence.number > last || arrival == Arrival::Boundary(closed.clone()), "{sequence:?}");
            (last, values) = (sequence.number, values + 1);
            arrival == Arrival::Boundary(closed.clone())
        });
        if is_closed {
            break;
        }
    }
    assert!(last == MANY && values < MANY && values > 1, "{values} have come");
}

/// A value that was not taken yet keeps its bytes, even when more values are sent, and when its producer uses the
/// memory again.
#[test]
fn a_value_in_shared_memory_stays_as_it_was_sent() {
    let (producer, consumer) = (Program::new(), Program::new());
    let memory = Memory::default();
    let (outlet, other) = (producer.outlet("k", &memory).0, producer.outlet("other", &memory).0);
    let (came_tx, came) = sync_channel(100);
    let _inlet = consumer.hear_values(&producer, "k", None, move |arrival, _| {
        if let Arrival::Value(value) = arrival {
            came_tx.try_send(value).unwrap_or_default();
        }
    });
    let (_of_other, came_over_other) = consumer.hear(&producer, "other", None);
    [&outlet, &other].into_iter().for_each(wait_connected);
    let next = || {
        wait_until(|| consumer.path.inlets().wait(Some(now())));
        came.try_recv()
    };
    let long = |number: u32| vec![u8::try_from(number).unwrap(); 100_000];
    let mut kept = Vec::new();
    for number in 1..=40 {
        send(&outlet, &long(number), number);
        let value = std::iter::repeat_with(next).find_map(Result::ok).unwrap();
        assert!(matches!(value, Value::Loaned(_)));
        // Some values are dropped unread.
        kept.extend((number % 3 != 0).then_some((number, value)));
    }
    drop(outlet);
    for number in 1..=20 {
        send(&other, &long(100), number);
        consumer.wait_for(&came_over_other, 1);
    }
    assert!(kept.into_iter().all(|(number, value)| value.into_vec() == long(number)));
}

/// Two consumers share a value that is encoded once, and the producer can read it back for others.
#[test]
fn a_long_value_is_encoded_right_into_the_memory_of_its_output() {
    let (producer, consumer) = (Program::new(), Program::new());
    let memory = Memory::default();
    let outlets = ["a", "b"].map(|key| producer.outlet(key, &memory).0);
    let heard = ["a", "b"].map(|key| consumer.hear(&producer, key, None));
    outlets.iter().for_each(wait_connected);
    assert!(Parcel::filled(&memory, |_| true).is_none(), "the last one was short");
    memory.note(100_000);
    assert!(Parcel::filled(&memory, |filler| filler.put(&vec![0; 1 << 20])).is_none(), "there is no room");
    let (rest, value) = (vec![9; 100_000], [&[7][..], &[9; 100_000]].concat());
    for number in 1..=50 {
        let mut parcel = Parcel::filled(&memory, |filler| filler.put(&[7]) && filler.put(&rest)).unwrap();
        assert!(outlets.iter().all(|outlet| outlet.send(&mut parcel, number)));
        assert!(parcel.to_vec(&memory) == value);
        for (_, came) in &heard {
            let (arrival, sequence) = consumer.wait_for(came, 1).remove(0);
            assert!(arrival == Arrival::Value(value.clone()) && sequence.number == number);
        }
    }
}

/// Values over several wires of a producer arrive in the order of sending, even while all of them wait in their
/// sockets.
#[test]
fn wires_of_one_producer_keep_their_order_among_each_other() {
    let (producer, consumer) = (Program::new(), Program::new());
    let outlets = ["a", "b", "c"].map(|key| producer.outlet(key, &Memory::default()).0);
    let (came_tx, came): (SyncSender<Arrived>, _) = sync_channel(100_000);
    let gate = Gate::default();
    let inlets = ["a", "b", "c"].map(|key| {
        let (came_tx, own) = (came_tx.clone(), gate.clone());
        consumer.hear_with(&producer, key, None, move |arrival, sequence| {
            drop(own.shut());
            came_tx.try_send((arrival, sequence)).unwrap_or_default();
        })
    });
    outlets.iter().for_each(wait_connected);
    let mut sent = 0;
    for _ in 0..50 {
        // First all values wait. Then they are read while more values are sent.
        let shut = gate.shut();
        for _ in 0..5 {
            for (outlet, count) in outlets.iter().zip([7, 1, 3]) {
                for _ in 0..count {
                    sent += 1;
                    send(outlet, &vec![0; if sent % 50 == 0 { 20_000 } else { 5 }], sent);
                }
            }
        }
        drop(shut);
        let numbers = consumer.wait_for(&came, 55).into_iter().map(|(_, sequence)| sequence.number);
        assert!(numbers.eq(sent - 54..=sent));
    }
    drop(inlets);
}

/// A restarted producer: the values of its predecessor come first, and the numbers begin again.
#[test]
fn another_producer_takes_the_place_of_one_that_is_gone() {
    let (before, consumer) = (Program::new(), Program::new());
    let (outlet, publisher) = before.outlet("k", &Memory::default());
    let (inlet, came) = consumer.hear(&before, "k", None);
    wait_connected(&outlet);
    (1..=3).for_each(|number| send(&outlet, b"old", number));
    assert!(publisher.is_heard() && publisher.wait_heard(LONG));
    drop((outlet, before));
    assert!(!publisher.is_heard());
    let after = Program::new();
    let (outlet, _) = after.outlet("k", &Memory::default());
    let (inlet, came_after) = consumer.hear(&after, "k", Some(inlet));
    assert_eq!(came.try_iter().count(), 3);
    wait_connected(&outlet);
    send(&outlet, b"new", 1);
    let all = consumer.wait_for(&came_after, 1);
    assert_eq!(all[0].0, Arrival::Value(b"new".to_vec()));
    drop(inlet);
    wait_until(|| !outlet.is_connected());
    assert!(!outlet.send(&mut Parcel::new(b"nobody"), 2));
}

/// After its answer, a restarted consumer gets the last value, which its producer sends only once.
#[test]
fn the_first_value_after_the_answer_arrives() {
    let guarded = || (member(1, 2).0, member(2, 1).0);
    for (producer, consumer) in [(Program::new(), Program::new()), guarded()] {
        let (outlet, _) = producer.outlet("k", &Memory::default());
        let mut before = None;
        for number in 1..=200 {
            let (inlet, came) = consumer.hear(&producer, "k", None);
            send(&outlet, &vec![1; if number % 2 == 0 { 5 } else { 100_000 }], number);
            assert_eq!(consumer.wait_for(&came, 1)[0].1.number, number);
            // Some consumers are still there when the next one comes.
            before = (number % 3 == 0).then_some(inlet);
        }
        drop(before);
    }
}

/// A consumer that is gone while a value is sent to all consumers takes the value from no other one.
#[test]
fn the_end_of_one_consumer_loses_no_value_of_another() {
    let (producer, [gone, other]) = (Program::new(), [(); 2].map(|()| Program::new()));
    let memory = Memory::default();
    let outlets = ["gone", "other"].map(|key| producer.outlet(key, &memory).0);
    let (_other, came) = other.hear(&producer, "other", None);
    memory.note(100_000);
    for number in 1..=40 {
        let (inlet, _) = gone.hear(&producer, "gone", None);
        outlets.iter().for_each(wait_connected);
        let bytes = vec![u8::try_from(number).unwrap(); 100_000];
        let filled = Parcel::filled(&memory, |filler| filler.put(&bytes)).unwrap();
        let mut parcel = if number % 2 == 0 { filled } else { Parcel::new(&bytes) };
        assert!(outlets[0].send(&mut parcel, number));
        drop(inlet);
        wait_until(|| !outlets[0].is_connected());
        assert!(outlets[1].send(&mut parcel, number) && parcel.to_vec(&memory) == bytes);
        assert!(other.wait_for(&came, 1)[0].0 == Arrival::Value(bytes));
    }
}

/// A wait ends with a call of another thread or at its deadline, as without direct paths.
#[test]
fn a_wait_ends_with_a_call_or_at_its_deadline() {
    let program = Program::new();
    let inlets = Arc::clone(program.path.inlets());
    let until = now() + Duration::from_millis(2);
    assert!(inlets.wait(Some(until)) && now() >= until);
    inlets.wake();
    assert!(!inlets.wait(None));
    let other = Arc::clone(&inlets);
    let caller = std::thread::spawn(move || other.wake());
    assert!(!inlets.wait(None));
    caller.join().unwrap();
}

/// Makes a guard that proves one secret and expects another one, on every wire while `is_known` is true. Also returns
/// the receiver of its refusals.
fn guard(shown: u8, expected: u8, is_known: &Arc<AtomicBool>) -> (Guard, Receiver<String>) {
    let (refused_tx, refused) = sync_channel(16);
    let is_known = Arc::clone(is_known);
    let secret = |byte| Zeroizing::new([byte; 32]);
    let secrets = move |_: &str| {
        let secrets = WireSecrets { shown: secret(shown), expected: secret(expected) };
        is_known.load(Ordering::SeqCst).then_some(secrets)
    };
    (Guard::new(secrets, move |who| refused_tx.try_send(who).unwrap_or_default()), refused)
}

/// Returns a program of a team, and the receiver of its refusals.
fn member(shown: u8, expected: u8) -> (Program, Receiver<String>) {
    let (guard, refused) = guard(shown, expected, &Arc::new(AtomicBool::new(true)));
    (Program::with(Some(guard)), refused)
}

/// Each end proves that it has the secret of its direction; no other program can join the wire, or replace its
/// producer.
#[test]
fn in_a_team_a_wire_is_for_its_two_ends_alone() {
    let ((producer, refused), (consumer, _)) = (member(1, 2), member(2, 1));
    let (outlet, _) = producer.outlet("k", &Memory::default());
    // Three programs are refused: one of the same user that has the token but no keys, another program of the team, and
    // one that proves the producer's secret.
    let who = format!("process {} of user {} on this machine", std::process::id(), rustix::process::getuid().as_raw());
    for stranger in [Program::new(), member(3, 1).0, member(1, 1).0] {
        stranger.hear_in_vain(&producer, "k");
        assert!(!outlet.is_connected());
    }
    assert_eq!([(); 2].map(|()| refused.recv_timeout(LONG).unwrap()), [who.as_str(), &who]);
    // An impostor listens in place of the producer, and accepts every consumer.
    let (impostor, _) = member(3, 2);
    let _impostor = impostor.outlet("k", &Memory::default());
    assert_eq!(consumer.hear_in_vain(&impostor, "k").kind(), std::io::ErrorKind::PermissionDenied);
    consumer.hear_in_vain(&Program::new(), "k");
    let guessed = Place { token: "guessed".into(), ..producer.place() };
    assert!(consumer.path.inlet(&guessed, LONG, "k", form(), None, |_, _| ()).is_err());
    assert_eq!(refused.recv_timeout(LONG).unwrap(), who);
    let (_inlet, came) = consumer.hear(&producer, "k", None);
    wait_connected(&outlet);
    for (number, size) in [(1, 5), (2, 100_000)] {
        send(&outlet, &vec![7; size], number);
        assert!(consumer.wait_for(&came, 1)[0].0 == Arrival::Value(vec![7; size]));
    }
    assert!(refused.try_recv().is_err());
}

/// The node tells the two ends of each other, but not at the same moment.
#[test]
fn a_consumer_waits_until_its_producer_has_heard_of_it() {
    let is_known = Arc::new(AtomicBool::new(false));
    let (of_producer, refused) = guard(1, 2, &is_known);
    let (producer, (consumer, _)) = (Program::with(Some(of_producer)), member(2, 1));
    let (outlet, _) = producer.outlet("k", &Memory::default());
    // It is treated like a consumer that comes too early, so it is not reported.
    consumer.hear_in_vain(&producer, "k");
    std::thread::scope(|scope| {
        let connecting = scope.spawn(|| consumer.hear(&producer, "k", None));
        is_known.store(true, Ordering::SeqCst);
        producer.path.keys_changed();
        let (_inlet, _) = connecting.join().unwrap();
        wait_connected(&outlet);
    });
    assert!(refused.try_recv().is_err());
}
