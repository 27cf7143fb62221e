use super::*;
use crate::sdk::calls::{AnyCalls, CallOrder, Calls};
use crate::sdk::export::{Activity, Exports, RawReply, Reply};
use comms::logic::object::ObjectError;
use comms::logic::time::Time;
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;

#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
struct Speed(f64);
impl Message for Speed {
    const TYPE: &'static str = "Speed";
}

#[derive(Debug, serde::Serialize, serde::Deserialize)]
struct Wrench;
impl Message for Wrench {
    const TYPE: &'static str = "Wrench";
}

/// A base with a command queue behind a lock, and a request queue to which any client may send.
struct Base {
    commands: Queue<Speed>,
    requests: Queue<Speed>,
    wheels: Lock,
    driven: Vec<f64>,
}

impl Base {
    fn new() -> Self {
        let (lease, preempt_after) = (Duration::from_millis(200), Some(Duration::from_millis(50)));
        let wheels = Lock::new(LockSettings { lease, preempt_after, waiting_max: 8 });
        let (commands, requests) = (Queue::new(8, Full::DropOldest), Queue::new(2, Full::Reject));
        Self { commands, requests, wheels, driven: Vec::new() }
    }

    fn exports() -> Exports<Self> {
        let mut exports = Exports::default();
        exports
            .procedure("Commands", "", |base: &mut Self, message| {
                Ok(base.commands.receive_under(&mut base.wheels, message))
            })
            .procedure("Requests", "", |base: &mut Self, message| Ok(base.requests.receive(message)))
            .procedure_later("wheels", "", |base: &mut Self, request, reply: Reply<LockAnswer>| {
                base.wheels.ask(request, reply);
            })
            .state("commands", "", |base| base.commands.status());
        exports
    }

    fn calculate(&mut self, now: Time) {
        self.wheels.work(now);
        while let Some(command) = self.commands.take_under(&mut self.wheels, now) {
            self.driven.push(command.data.0);
        }
    }
}

/// Calls of one port that wait for their answers.
#[derive(Default)]
struct Way(Vec<(u64, Answer)>);

type Answer = Receiver<Result<Vec<u8>, ObjectError>>;

impl Way {
    /// Carries the calls of a port to a procedure; if `is_cut`, they are lost.
    fn carry(&mut self, base: &mut Base, name: &str, calls: &mut dyn AnyCalls, is_cut: bool) {
        for order in calls.take() {
            let CallOrder::Make { number, argument, .. } = order else { continue };
            if is_cut {
                calls.deliver(number, Err(ObjectError::Gone));
                continue;
            }
            let (answer_tx, answer) = sync_channel(1);
            let reply = RawReply::new(move |result| answer_tx.send(result).unwrap_or_default(), || true);
            Base::exports().serve(base, name, &argument, Activity::Running, reply);
            self.0.push((number, answer));
        }
    }

    fn answer(&mut self, calls: &mut dyn AnyCalls) {
        self.0.retain(|(number, answer)| match answer.try_recv() {
            Ok(result) => {
                calls.deliver(*number, result);
                false
            }
            Err(_) => true,
        });
    }
}

/// A program that drives while it holds the lock of the wheels.
struct Driver {
    user: LockUser,
    asks: Calls<LockRequest, LockAnswer>,
    ask_way: Way,
    client: QueueClient<Speed>,
    sends: Calls<QueueMessage, Receipt>,
    send_way: Way,
}

impl Driver {
    fn new(name: &str) -> Self {
        let (user, client) = (LockUser::new(name).unwrap(), QueueClient::new(name).unwrap());
        let (asks, sends) = (Calls::default(), Calls::default());
        Self { user, asks, ask_way: Way::default(), client, sends, send_way: Way::default() }
    }

    fn turn(&mut self, base: &mut Base, now: Time, is_cut: bool) {
        self.ask_way.answer(&mut self.asks);
        self.send_way.answer(&mut self.sends);
        self.user.work(now, &mut self.asks);
        self.client.work(now, &mut self.sends);
        self.ask_way.carry(base, "wheels", &mut self.asks, is_cut);
        self.send_way.carry(base, "Commands", &mut self.sends, is_cut);
    }

    fn send(&mut self, now: Time, speed: f64, fence: Option<u64>) {
        self.client
            .send(
                now,
                Label { category: "motion", priority: 0, marker: 0 },
                &Speed(speed),
                fence,
                Duration::from_secs(1),
            )
            .unwrap();
    }

    fn ends(&mut self) -> Vec<SendEnd> {
        std::iter::from_fn(|| self.client.end_of()).map(|(_, end)| end).collect()
    }
}

fn at(ms: u64) -> Time {
    Time::ZERO + Duration::from_millis(ms)
}

/// The base and the drivers have turns, every 10 ms from `from` to `to`.
fn run(base: &mut Base, drivers: &mut [&mut Driver], (from, to): (u64, u64)) {
    for ms in (from..to).step_by(10) {
        base.calculate(at(ms));
        drivers.iter_mut().for_each(|driver| driver.turn(base, at(ms), false));
    }
}

/// The holder is suspended for longer than its lease. When it wakes up, it still has a command to send, which the
/// wheels refuse.
#[test]
fn a_holder_that_was_suspended_is_refused_at_the_resource() {
    let (mut base, mut first, mut second) = (Base::new(), Driver::new("first"), Driver::new("second"));
    first.user.want(0);
    run(&mut base, &mut [&mut first], (1000, 1300));
    let fence = first.user.held(at(1290));
    assert!(fence.is_some());
    first.send(at(1300), 1.0, fence);
    run(&mut base, &mut [&mut first], (1300, 1350));
    assert_eq!((first.ends(), base.driven.clone()), (vec![SendEnd::Accepted], vec![1.0]));
    // The first driver has checked that it holds the lock, and is then suspended.
    let in_hand = first.user.held(at(1340));
    assert_eq!(in_hand, fence);
    second.user.want(0);
    run(&mut base, &mut [&mut second], (1350, 1700));
    let newer = second.user.held(at(1690));
    assert!(newer > fence);
    second.send(at(1700), 2.0, newer);
    first.send(at(1700), 9.0, in_hand);
    run(&mut base, &mut [&mut first, &mut second], (1700, 1760));
    let over = Refusal::Over { number: fence.unwrap(), floor: newer.unwrap() };
    assert_eq!(
        (first.ends(), second.ends()),
        (vec![SendEnd::Rejected(Rejected::Fenced(over))], vec![SendEnd::Accepted])
    );
    assert_eq!((base.driven, first.user.lost()), (vec![1.0, 2.0], Some(Denied::Expired)));
}

#[test]
fn a_greater_priority_takes_the_wheels_and_a_command_without_the_lock_is_refused() {
    let (mut base, mut low, mut high) = (Base::new(), Driver::new("low"), Driver::new("high"));
    low.user.want(1);
    run(&mut base, &mut [&mut low], (1000, 1300));
    high.send(at(1300), 5.0, None);
    high.user.want(9);
    run(&mut base, &mut [&mut low, &mut high], (1300, 1500));
    assert_eq!(high.ends(), [SendEnd::Rejected(Rejected::Fenced(Refusal::NoLock))]);
    assert_eq!((low.user.held(at(1490)), low.user.lost()), (None, Some(Denied::Preempted)));
    assert!(high.user.held(at(1490)).is_some());
    high.user.let_go();
    run(&mut base, &mut [&mut high], (1500, 1530));
    assert_eq!((base.wheels.held(at(1530)), base.wheels.status().counters.preempted), (None, 1));
}

/// While a client is cut off, it does not get the lock. Messages that it sends in this time are repeated, and taken
/// once.
#[test]
fn a_message_is_sent_again_until_it_is_received_and_taken_once() {
    let (mut base, mut driver) = (Base::new(), Driver::new("driver"));
    driver.user.want(0);
    run(&mut base, &mut [&mut driver], (1000, 1300));
    driver.send(at(1300), 3.0, driver.user.held(at(1290)));
    for ms in (1300..1400).step_by(10) {
        base.calculate(at(ms));
        driver.turn(&mut base, at(ms), true);
    }
    assert_eq!((driver.ends(), base.driven.len()), (vec![], 0));
    run(&mut base, &mut [&mut driver], (1400, 1500));
    assert_eq!((driver.ends(), base.driven.clone()), (vec![SendEnd::Accepted], vec![3.0]));
    // The driver is cut off for longer than a lease. It does not hold the lock any more, and is told so.
    for ms in (1500..1800).step_by(10) {
        driver.turn(&mut base, at(ms), true);
    }
    assert_eq!((driver.user.held(at(1790)), driver.user.lost()), (None, Some(Denied::Expired)));
    driver.send(at(1800), 4.0, Some(1));
    for ms in (1800..2900).step_by(10) {
        driver.turn(&mut base, at(ms), true);
    }
    assert_eq!(driver.ends(), [SendEnd::Gone], "the last word was that its program is gone");
}

#[test]
fn what_a_queue_does_not_take_is_told() {
    let mut base = Base::new();
    let message = |number, data: Vec<u8>, type_name: &str| QueueMessage {
        header: Header {
            category: String::new(),
            id: MessageId { life: 1, number },
            sender: String::new(),
            recipient: String::new(),
            priority: u8::try_from(number).unwrap(),
            marker: 0,
        },
        type_name: type_name.to_owned(),
        fence: None,
        data,
    };
    let speed = postcard::to_stdvec(&Speed(1.0)).unwrap();
    let mut put = |number, data, type_name| base.requests.receive(message(number, data, type_name));
    let wrong = |found: &str| Receipt::Rejected(Rejected::WrongType { expected: "Speed".into(), found: found.into() });
    assert_eq!(put(1, speed.clone(), Wrench::TYPE), wrong("Wrench"));
    assert_eq!(put(1, vec![1], "Speed"), wrong("Speed of other fields"));
    assert_eq!(
        (put(1, speed.clone(), "Speed"), put(2, speed.clone(), "Speed")),
        (Receipt::Accepted, Receipt::Accepted)
    );
    assert_eq!(put(3, speed, "Speed"), Receipt::Rejected(Rejected::Full { capacity: 2 }));
    let taken: Vec<u64> =
        std::iter::from_fn(|| base.requests.take(at(0))).map(|taken| taken.header.id.number).collect();
    assert_eq!((taken, base.requests.status().counters.rejected), (vec![2, 1], 3));
    let mut client = QueueClient::<Vec<u8>>::new("a").unwrap();
    let too_long = client.send(
        at(0),
        Label { category: "", priority: 0, marker: 0 },
        &vec![0; 2 << 20],
        None,
        Duration::from_secs(1),
    );
    assert!(too_long.unwrap_err().contains("and 1048576 are allowed"));
}

impl Message for Vec<u8> {
    const TYPE: &'static str = "Bytes";
}
