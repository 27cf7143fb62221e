//! Messages from and to activities, through the programs that have their ports.

use super::losses::cut;
use super::world::World;
use comms::logic::control::{MessageFate, Notice, PortMessage};
use language::plan::{PORTS, text_value};
use node::logic::effect::ProcessId;
use node::logic::protocol::{ActivityInput, Answer, Change, Delivery, Ending, Report, Request, Taken, TellRequest};
use shim::protocol::ShimReport;
use std::time::Duration;

/// An activity on another host than the home, which waits for words and repeats them.
const MISSION: &str = r#"
activity Echo(there: Host) {
    host { there }
    in orders: Text queue 2;
    out say: Text;
    move instof Long(there);
    var heard: 0..1000 = 0;
    initial state waiting {
        on message orders where text == "move" -> moving;
        on message orders where text == "end" -> done;
        on message orders { heard += 1; say.send("heard " + heard); }
    }
    state moving { run shield move; on message orders -> waiting { say.send("late"); } }
}
process main() {
    host { "c1" }
    instantiated_processes { echo instof Echo("c2"); mic instof Mic("c1"); speaker instof Speaker("c1"); }
    internal_connections { mic.Heard -> echo.orders; echo.say -> speaker.Words; }
    internal_event_actions { (echo ; echo) # mic # speaker }
}
"#;

struct Ports {
    world: World,
    call: u64,
    process: ProcessId,
    handed: u64,
}

impl Ports {
    fn new() -> Self {
        let mut world = World::new(&["c1", "c2"]);
        let call = world.deploy("c1", MISSION);
        world.run_for(Duration::from_secs(1));
        Self::of(world, call)
    }

    fn of(world: World, call: u64) -> Self {
        let process = world.modules.iter().find(|(_, module)| *module == PORTS).map(|(process, _)| process.clone());
        Self { call, process: process.expect("the activity has ports"), world, handed: 0 }
    }

    /// Hands a message over; returns its number.
    fn hand(&mut self, text: &str, has_receipt: bool) -> u64 {
        self.handed += 1;
        let (number, port, value) = (self.handed, "orders".to_owned(), text_value(text).bytes().to_vec());
        let message = PortMessage { number, port, value, priority: 0, has_receipt, lost: 0 };
        self.world.notice(0, "c2", &self.process, Notice::Message(message));
        self.world.run_for(Duration::from_millis(50));
        number
    }

    fn fate(&self, number: u64) -> Option<MessageFate> {
        self.world.fates.iter().find(|(other, _)| *other == number).map(|(_, fate)| *fate)
    }

    fn said(&self) -> Vec<String> {
        let text = |answer: &Answer| match answer {
            Answer::Report(Report::Process { change: Change::Says { text, .. }, .. }) => Some(text.clone()),
            _ => None,
        };
        self.world.answers.get(&self.call).into_iter().flatten().filter_map(text).collect()
    }

    fn sent(&self) -> Vec<String> {
        let text = |(port, value): &(String, Vec<u8>)| {
            format!("{port}: {}", String::from_utf8_lossy(value.get(1..).unwrap_or_default()))
        };
        self.world.sent.iter().map(text).collect()
    }
}

/// An activity whose program continues on a robot that is cut off still hears the robot's own sensors.
#[test]
fn an_activity_that_continues_alone_keeps_its_ports() {
    let mut world = World::new(&["c1", "c2"]);
    let mission = MISSION.replace("Long(there);", "Long(there) { on_link_loss keep; }");
    let call = world.deploy("c1", &mission);
    world.run_for(Duration::from_secs(1));
    let mut ports = Ports::of(world, call);
    ports.hand("move", true);
    cut(&mut ports.world, "c2");
    ports.world.run_for(Duration::from_secs(30));
    let number = ports.hand("hello", true);
    assert_eq!(ports.fate(number), Some(MessageFate::Taken));
}

/// While the home is away, the host of an activity gives it the orders of the person beside the robot.
#[test]
fn an_activity_that_continues_alone_takes_orders_on_its_host() {
    let mut world = World::new(&["c1", "c2"]);
    world.deploy("c1", &MISSION.replace("Long(there);", "Long(there) { on_link_loss keep; }"));
    world.run_for(Duration::from_secs(1));
    let taken = Delivery::Taken { path: "main/echo".into(), taken: Taken::Reacted };
    let why = Delivery::Refused("`c1`, the home of `test`, gives orders".into());
    assert_eq!(tell(&mut world, "c2", "echo", "hello"), why);
    assert_eq!(tell(&mut world, "c1", "echo", "move"), taken);
    cut(&mut world, "c2");
    world.run_for(Duration::from_secs(30));
    assert_eq!(tell(&mut world, "c2", "echo", "hello"), taken);
    assert_eq!(tell(&mut world, "c2", "other", "hello"), Delivery::Refused("`test` has no activity `other`".into()));
}

/// Gives a message to an activity as a person on a host does.
fn tell(world: &mut World, host: &str, process: &str, text: &str) -> Delivery {
    let order = ActivityInput::Message { port: "orders".into(), text: text.into(), priority: 0 };
    let request = TellRequest { name: "test".into(), process: process.into(), order, by: "ann".into() };
    let call = world.ask(host, Request::Tell(Box::new(request)));
    world.run_for(Duration::from_millis(100));
    let [Answer::Delivered(delivery)] = &world.answers[&call][..] else { panic!("{:?}", world.answers[&call]) };
    delivery.clone()
}

#[test]
fn a_message_comes_in_and_an_answer_goes_out() {
    let mut ports = Ports::new();
    let numbers = [ports.hand("hello", false), ports.hand("hello", true)];
    assert_eq!(numbers.map(|number| ports.fate(number)), [Some(MessageFate::Taken); 2]);
    assert_eq!(ports.sent(), ["say: heard 1", "say: heard 2"]);
}

/// While a transition waits for a stop, two messages wait. A sender with a receipt is told of no room, and a value is lost in
/// sight of people.
#[test]
fn a_full_queue_says_so() {
    let mut ports = Ports::new();
    ports.hand("move", false);
    ports.hand("wait", false);
    for _ in 0..2 {
        let number = ports.hand("hello", true);
        assert_eq!(ports.fate(number), Some(MessageFate::Taken));
    }
    let (refused, lost) = (ports.hand("hello", true), ports.hand("hello", false));
    assert_eq!((ports.fate(refused), ports.fate(lost)), (Some(MessageFate::Full), Some(MessageFate::Taken)));
    let said = ports.said();
    assert!(said.iter().any(|said| said == "loses a message at `orders`: too many wait"), "{said:?}");
    ports.world.run_for(Duration::from_secs(20));
    assert_eq!(ports.sent(), ["say: late", "say: heard 1", "say: heard 2"]);
}

/// A message before the activity runs, between two runs of it, or after its end is not an event. Its sender is told so.
#[test]
fn a_message_is_for_an_activity_that_runs() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", &MISSION.replace("(echo ; echo)", "(wait(5 s) ; echo ; wait(5 s) ; echo)"));
    world.run_for(Duration::from_secs(1));
    let mut ports = Ports::of(world, call);
    let mut check = |fate: MessageFate, text: &str, sent: usize| {
        let number = ports.hand(text, true);
        assert_eq!((ports.fate(number), ports.sent().len()), (Some(fate), sent), "{text}");
        ports.world.run_for(Duration::from_secs(5));
    };
    check(MessageFate::Idle, "early", 0);
    check(MessageFate::Taken, "hello", 1);
    check(MessageFate::Taken, "end", 1);
    check(MessageFate::Taken, "hello again", 2);
    let end = ports.hand("end", true);
    assert_eq!(ports.fate(end), Some(MessageFate::Taken));
    ports.world.run_for(Duration::from_secs(1));
    assert_eq!(ports.world.ending(ports.call), &Ending::Done(Vec::new()));
    assert!(ports.world.running.is_empty() && ports.world.alive.is_empty());
}

/// A node that is killed has lost nothing that it has confirmed, and takes nothing twice.
#[test]
fn a_killed_node_takes_each_message_once() {
    let mut ports = Ports::new();
    for round in 0..20 {
        ports.hand("hello", true);
        ports.world.crash("c2");
        ports.world.run_for(Duration::from_millis(100));
        ports.hand("hello", true);
        ports.world.adopt("c2");
        ports.world.run_for(Duration::from_millis(300));
        let last = ports.handed;
        assert_eq!(
            (ports.fate(last), ports.fate(last - 1)),
            (Some(MessageFate::Taken), Some(MessageFate::Taken)),
            "{round}"
        );
    }
    let expected: Vec<String> = (1..=40).map(|number| format!("say: heard {number}")).collect();
    assert_eq!(ports.sent(), expected);
}

/// Values on their way to a program that dies are counted, and the next program takes those that come later.
#[test]
fn the_death_of_the_ports_is_told() {
    let mut ports = Ports::new();
    let process = ports.process.clone();
    ports.world.die("c2", &process, ShimReport::Signalled { signal: 9 });
    ports.world.run_for(Duration::from_secs(3));
    let number = ports.hand("hello", true);
    assert_eq!((ports.fate(number), ports.sent()), (Some(MessageFate::Taken), vec!["say: heard 1".to_owned()]));
}

/// An activity that runs is connected by a change, and goes on.
#[test]
fn a_change_connects_an_activity_that_runs() {
    let mut world = World::new(&["c1", "c2"]);
    let apart = MISSION.replace("mic.Heard -> echo.orders; echo.say -> speaker.Words;", "");
    let call = world.deploy("c1", &apart);
    world.run_for(Duration::from_secs(1));
    assert!(world.modules.values().all(|module| module != PORTS));
    world.change("c1", MISSION, (1, 0), &[]);
    world.run_for(Duration::from_secs(3));
    let mut ports = Ports::of(world, call);
    let number = ports.hand("hello", true);
    assert_eq!((ports.fate(number), ports.sent()), (Some(MessageFate::Taken), vec!["say: heard 1".to_owned()]));
}
