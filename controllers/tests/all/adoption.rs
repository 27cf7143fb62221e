//! Controllers that lose their node and find another one in its place, with the test as both nodes.

#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

mod program;

use comms::io::clock::now;
use comms::io::data::DataSession;
use comms::io::session::Reach;
use comms::logic::codec::WIRE_VERSION;
use comms::logic::control::{Dial, Notice, Order, Outgoing};
use comms::logic::frame::{self, Decoder};
use comms::logic::random::Random;
use comms::logic::{codec, key};
use program::{Channel, Program, folder, open, order_frame};
use std::io::{Read, Write};
use std::net::Shutdown;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;

const PROGRAM: &str = env!("CARGO_BIN_EXE_dca-controller");
/// How long something has that is under way.
const SOON: Duration = Duration::from_secs(30);
/// From one beat of the source to the next.
const PERIOD: Duration = Duration::from_millis(10);

/// The subscriber to the beats of a source.
struct Ear {
    session: DataSession,
    beats: Receiver<u64>,
    dir: PathBuf,
}

impl Ear {
    /// Links the source to it, and lets it run. The source has taken three orders then, and made four notices.
    fn new(channel: &mut Channel, hello: &Notice) -> Self {
        let Notice::Hello { location: Some(location), .. } = hello else { panic!("{hello:?}") };
        let source = Dial { session: location.session.clone(), locators: location.local.clone() };
        let dir = folder();
        let session = DataSession::open(&dir.join("s"), Reach::Host).unwrap();
        session.dial(&source, SOON).unwrap();
        let (heard_tx, beats) = sync_channel(100_000);
        let on_beat = move |bytes: std::borrow::Cow<'_, [u8]>| {
            let (number, _) = postcard::from_bytes::<(u64, Vec<u8>)>(&bytes).unwrap();
            heard_tx.try_send(number).unwrap_or_default();
        };
        let wire = key::wire("test", 1, 0);
        let hearing = session.on_sample(&wire, on_beat).unwrap();
        let outgoing = vec![Outgoing { wire: 0, port: "Out".to_owned(), key: wire, pull: false }];
        let (robot, incoming, devices) = ("test".to_owned(), vec![], vec![]);
        channel.order(&Order::Connect { robot, incoming, outgoing, devices });
        channel.expect(&Notice::Connected);
        channel.activate(1);
        channel.order(&Order::Open { wires: vec![0], generation: 1 });
        channel.expect(&Notice::Switched { generation: 1 });
        // It hears as long as its session exists.
        std::mem::forget(hearing);
        Self { session, beats, dir }
    }

    /// Hears so many beats: none is missing since the last one, and they come at their rate. Returns the number of the
    /// last.
    #[track_caller]
    fn hear(&self, last: Option<u64>, count: u32) -> u64 {
        let begin = now();
        let mut last = last;
        for _ in 0..count {
            let number = self.beats.recv_timeout(SOON).unwrap();
            assert_eq!(number, last.map_or(number, |last| last + 1), "calculations were left out");
            last = Some(number);
        }
        let (took, ideal) = (now() - begin, PERIOD * count);
        assert!(took < 4 * ideal + Duration::from_secs(1), "{took:?} for {count} beats");
        last.unwrap()
    }

    fn close(self) {
        self.session.close();
        std::fs::remove_dir_all(&self.dir).unwrap();
    }
}

/// The node is killed with an order on its way, and another one comes after a while; the controller calculates all
/// along.
#[test]
fn a_controller_goes_on_without_its_node() {
    let (program, listener, mut channel, hello) = Program::start(&[]);
    let ear = Ear::new(&mut channel, &hello);
    let last = ear.hear(None, 20);
    channel.order(&open(2));
    program.kill_node(listener, channel);
    let last = ear.hear(Some(last), 100);

    let listener = program.listener();
    let mut channel = Channel::resumed(&listener, 4);
    // Parameters and the answer itself are not counted.
    channel.order(&Order::Resumed { notices: 2 });
    channel.order(&Order::Configure { parameters: vec![] });
    channel.expect(&Notice::Running { activation: 1 });
    channel.expect(&Notice::Switched { generation: 1 });
    channel.expect(&Notice::Switched { generation: 2 });
    channel.switch(3);
    let last = ear.hear(Some(last), 20);

    // A node that has everything gets nothing twice.
    program.kill_node(listener, channel);
    let listener = program.listener();
    let mut channel = Channel::resumed(&listener, 5);
    assert_eq!(channel.made, 6);
    channel.order(&Order::Resumed { notices: 6 });
    channel.switch(4);
    ear.hear(Some(last), 20);
    channel.order(&Order::Stop { activation: 1 });
    channel.expect(&Notice::Stopped { activation: 1 });
    channel.order(&Order::Exit);
    assert_eq!(channel.next(), None);
    ear.close();
    assert_eq!(program.leave(), (Some(0), String::new()));
}

/// Its node was killed before the program could send its hello.
#[test]
fn a_program_that_begins_without_its_node_waits_for_it() {
    let mut program = Program::begin(folder(), &[]);
    let until = now() + Duration::from_millis(500);
    while now() < until {
        assert!(program.child.try_wait().unwrap().is_none(), "it has left");
        std::thread::yield_now();
    }
    let listener = program.listener();
    let mut channel = Channel::accept(&listener);
    assert!(matches!(channel.next(), Some(Notice::Hello { .. })));
    program.terminate();
    assert_eq!(program.leave().0, Some(143));
}

#[test]
fn a_channel_breaks_in_the_middle_of_a_frame() {
    let (program, listener, mut channel, _) = Program::start(&[]);
    channel.activate(1);
    // Half an order was never given.
    let frame = order_frame(&open(1));
    channel.stream.write_all(&frame[..frame.len() / 2]).unwrap();
    drop(channel);
    let mut channel = Channel::resumed(&listener, 1);
    channel.order(&Order::Resumed { notices: 2 });
    channel.switch(1);
    // Half a notice was never heard.
    channel.order(&open(2));
    channel.stream.read_exact(&mut [0; 7]).unwrap();
    drop(channel);
    let mut channel = Channel::resumed(&listener, 3);
    // Half an answer is none.
    let frame = order_frame(&Order::Resumed { notices: 3 });
    channel.stream.write_all(&frame[..frame.len() - 1]).unwrap();
    drop(channel);
    let mut channel = Channel::resumed(&listener, 3);
    channel.order(&Order::Resumed { notices: 3 });
    channel.expect(&Notice::Switched { generation: 2 });
    channel.order(&Order::Exit);
    channel.expect(&Notice::Stopped { activation: 1 });
    assert_eq!(program.leave(), (Some(0), String::new()));
}

/// The memory of a node that survives its own death: the orders to give, how many of them were sent, and the notices
/// received.
struct Machine {
    script: Vec<Order>,
    said: usize,
    heard: Vec<Notice>,
}

impl Machine {
    /// Each order of the script has one notice for an answer.
    fn new(length: u32) -> Self {
        let order = |index| {
            let (activation, generation) = (index / 4 + 1, u64::from(index / 2 + 1));
            match index % 4 {
                0 => Order::Activate { activation, value: Vec::new(), since: now() },
                2 => Order::Stop { activation },
                1 => open(generation),
                _ => Order::Close { wires: vec![], generation },
            }
        };
        Self { script: (0..length).map(order).collect(), said: 0, heard: Vec::new() }
    }

    /// Returns the next order if it may be given already.
    fn next(&self) -> Option<&Order> {
        let next = self.script.get(self.said)?;
        let waiting = self.waiting();
        let may = if matches!(next, Order::Activate { .. }) { waiting == 0 } else { waiting < 10 };
        may.then_some(next)
    }

    /// Returns how many notices are to come.
    fn waiting(&self) -> usize {
        // The first notice is not an answer.
        self.said + 1 - self.heard.len()
    }

    /// Takes one of the possible steps.
    fn step(&mut self, channel: &mut Channel, random: &mut Random) {
        match self.next() {
            Some(order) if self.waiting() == 0 || random.below(2) == 0 => {
                channel.order(order);
                self.said += 1;
            }
            _ if self.waiting() > 0 => self.heard.push(channel.next().unwrap()),
            _ => {}
        }
    }

    /// Breaks the channel in one of many ways.
    fn break_off(&self, mut channel: Channel, random: &mut Random) {
        match random.below(4) {
            // A part of an order, perhaps nothing of it.
            0 if self.next().is_some() => {
                let frame = order_frame(self.next().unwrap());
                let part = usize::try_from(random.below(frame.len() as u64)).unwrap();
                channel.stream.write_all(&frame[..part]).unwrap();
            }
            // A part of a notice.
            1 if self.waiting() > 0 && channel.decoder.is_between_frames() => {
                assert_ne!(channel.stream.read(&mut [0; 9]).unwrap(), 0);
            }
            2 => channel.stream.shutdown(Shutdown::Write).unwrap(),
            _ => {}
        }
    }

    /// Resumes the channel to the program; none if this node dies during it as well.
    fn resume(&self, listener: &UnixListener, random: &mut Random) -> Option<Channel> {
        // Every order that was written completely has arrived.
        let mut channel = Channel::resumed(listener, self.said as u64);
        if random.below(5) == 0 {
            return None;
        }
        assert!(channel.made >= self.heard.len() as u64, "it has made what was heard");
        channel.order(&Order::Resumed { notices: self.heard.len() as u64 });
        Some(channel)
    }
}

/// Twenty breaks at points of a seed: every notice arrives once and in order, every order is obeyed once.
#[test]
fn nothing_is_lost_and_nothing_done_twice() {
    const LENGTH: u32 = 200;
    for seed in 1..=5 {
        let mut random = Random::new(seed);
        let mut machine = Machine::new(LENGTH);
        let (program, listener, mut channel, hello) = Program::start(&[]);
        machine.heard.push(hello.clone());
        for _ in 0..20 {
            (0..random.below(20)).for_each(|_| machine.step(&mut channel, &mut random));
            machine.break_off(channel, &mut random);
            channel = loop {
                if let Some(channel) = machine.resume(&listener, &mut random) {
                    break channel;
                }
            };
        }
        while machine.heard.len() <= machine.script.len() {
            machine.step(&mut channel, &mut random);
        }
        channel.order(&Order::Exit);
        assert_eq!(channel.next(), None, "seed {seed}");
        assert_eq!(program.leave(), (Some(0), String::new()), "seed {seed}");

        // The listener and the loop of a program each answer in order.
        let of_loop = |notice: &&Notice| matches!(notice, Notice::Running { .. } | Notice::Stopped { .. });
        let (loops, listeners): (Vec<_>, Vec<_>) = machine.heard[1..].iter().partition(of_loop);
        let loops_expected: Vec<Notice> = (1..=LENGTH / 4)
            .flat_map(|activation| [Notice::Running { activation }, Notice::Stopped { activation }])
            .collect();
        let switched: Vec<Notice> =
            (1..=u64::from(LENGTH) / 2).map(|generation| Notice::Switched { generation }).collect();
        assert_eq!(loops, loops_expected.iter().collect::<Vec<_>>(), "seed {seed}");
        assert_eq!(listeners, switched.iter().collect::<Vec<_>>(), "seed {seed}");
    }
}

/// A node accepts the connection and sends nothing: the controller continues, and hears the node that comes after it.
#[test]
fn a_suspended_node_stops_nobody() {
    let (program, listener, mut channel, hello) = Program::start(&[]);
    let ear = Ear::new(&mut channel, &hello);
    let last = ear.hear(None, 5);
    drop(channel);
    let suspended = Channel::resumed(&listener, 3);
    let last = ear.hear(Some(last), 100);
    drop(suspended);
    // A node that does not know the program closes the channel; the program asks the next one.
    for _ in 0..3 {
        drop(Channel::resumed(&listener, 3));
    }
    let mut channel = Channel::resumed(&listener, 3);
    channel.order(&Order::Resumed { notices: 4 });
    channel.switch(2);
    ear.hear(Some(last), 5);
    // It is not to be held up by a node that does not answer, either.
    drop(channel);
    let suspended = Channel::resumed(&listener, 4);
    program.terminate();
    assert_eq!(program.leave(), (Some(143), String::new()));
    drop(suspended);
    ear.close();
}

#[test]
fn a_signal_ends_a_program_without_a_node() {
    let (program, listener, mut channel, hello) = Program::start(&[]);
    let ear = Ear::new(&mut channel, &hello);
    let last = ear.hear(None, 5);
    program.kill_node(listener, channel);
    ear.hear(Some(last), 20);
    program.terminate();
    assert_eq!(program.leave(), (Some(143), String::new()));
    ear.close();
}

/// While its node is there a program needs no parent; without both it leaves, even if a suspended node is there.
#[test]
fn a_program_without_node_and_parent_leaves() {
    // The shell waits for the program, and is killed.
    let orphan = || Program::start(&["/bin/sh", "-c", "\"$@\" & wait", "sh"]);
    let kill_parent = |program: &mut Program| {
        program.child.kill().unwrap();
        program.child.wait().unwrap();
    };
    let (mut program, listener, mut channel, _) = orphan();
    channel.activate(1);
    kill_parent(&mut program);
    channel.switch(1);
    program.kill_node(listener, channel);
    // Its standard error ends with the program.
    assert_eq!(program.leave().1, "the node is gone\n");

    let (mut program, listener, mut channel, _) = orphan();
    channel.activate(1);
    drop(channel);
    let suspended = Channel::resumed(&listener, 1);
    kill_parent(&mut program);
    assert_eq!(program.leave().1, "the node is gone\n");
    drop(suspended);
}

#[test]
fn a_node_that_has_other_notices_is_not_served() {
    let (program, listener, channel, _) = Program::start(&[]);
    drop(channel);
    let mut channel = Channel::resumed(&listener, 0);
    channel.order(&Order::Resumed { notices: 2 });
    let why = "the node has 2 notices of this program, which has made 1 and still has the last 1\n";
    assert_eq!(program.leave(), (Some(1), why.to_owned()));
}
