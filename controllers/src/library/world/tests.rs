//! The hardware level in virtual time: whose commands are obeyed, which commands are refused, and when the wheels stop.

use super::super::registry;
use super::server::LOCK;
use crate::message::{BaseCommand, BaseStatus, BaseVelocity};
use crate::sdk::messaging::{Header, LockAnswer, LockRequest, MessageId, QueueMessage, Receipt, Refusal, Rejected};
use crate::sdk::{Activity, CallOrder, Message, Module, ObjectError, Progress, RawReply, Stopping};
use comms::logic::time::Time;
use serde::de::DeserializeOwned;
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;

const PERIOD: Duration = Duration::from_millis(4);
const WATCHDOG: f64 = 0.1;

type Answer = Result<Vec<u8>, ObjectError>;

/// The plant, called in the same way as programs call it.
struct Bench {
    world: Box<dyn Module>,
    now: Time,
}

impl Bench {
    /// Returns a world that already grants locks.
    fn new(commands: &str) -> Self {
        let mut world = registry().create("DoorWorld", &[&format!("commands={commands}")]).unwrap();
        let now = Time::ZERO + Duration::from_secs(7);
        world.init(&[], now).unwrap();
        let mut bench = Self { world, now };
        bench.pass(LOCK.lease + PERIOD);
        bench
    }

    fn step(&mut self) {
        self.now = self.now + PERIOD;
        assert_eq!(self.world.calculate(self.now), Progress::Continue);
        self.world.drain(&mut |_, _| ());
    }

    fn pass(&mut self, span: Duration) {
        let until = self.now + span;
        while self.now < until {
            self.step();
        }
    }

    fn serve(&mut self, name: &str, argument: &[u8]) -> Receiver<Answer> {
        let (answer_tx, answer) = sync_channel(1);
        let reply = RawReply::new(move |result| answer_tx.send(result).unwrap(), || true);
        self.world.serve(name, argument, Activity::Running, reply);
        answer
    }

    fn call<R: DeserializeOwned>(&mut self, name: &str, argument: &impl Message) -> R {
        let answer = self.serve(name, &postcard::to_stdvec(argument).unwrap());
        self.step();
        postcard::from_bytes(&answer.try_recv().expect("it is answered").unwrap()).unwrap()
    }

    fn base(&mut self) -> BaseStatus {
        let answer = self.serve("base", &[]);
        postcard::from_bytes(&answer.try_recv().unwrap().unwrap()).unwrap()
    }

    fn acquire(&mut self, client: u64, priority: u8) -> LockAnswer {
        let name = format!("client {client}");
        self.call("LockBase", &LockRequest::Acquire { client, name, request: 1, priority })
    }

    /// Takes the lock, which is free.
    fn granted(&mut self, client: u64) -> u64 {
        let answer = self.acquire(client, 0);
        let LockAnswer::Granted { fence, .. } = answer else { panic!("{answer:?}") };
        fence
    }

    fn release(&mut self, client: u64) {
        let released: LockAnswer = self.call("LockBase", &LockRequest::Release { client, request: 1 });
        assert_eq!(released, LockAnswer::Released { request: 1 });
    }

    /// Commands the wheels over the port of the device, once.
    fn drive(&mut self, fence: Option<u64>) {
        let command = BaseCommand { owner: "test".to_owned(), velocity: Some([0.3, 0.0, 0.0]), fence };
        self.world.deliver("base/cmd", &postcard::to_stdvec(&command).unwrap(), self.now).unwrap();
        self.step();
    }

    /// Commands the wheels over the queue.
    fn queue(&mut self, number: u64, fence: Option<u64>) -> Receipt {
        let id = MessageId { life: 3, number };
        let (category, sender) = ("go".to_owned(), "test".to_owned());
        let header = Header { category, id, sender, recipient: String::new(), priority: 0, marker: 0 };
        let data = postcard::to_stdvec(&BaseVelocity { rates: [0.3, 0.0, 0.0] }).unwrap();
        let message = QueueMessage { header, type_name: BaseVelocity::TYPE.to_owned(), fence, data };
        self.call("BaseCommands", &message)
    }
}

/// Compares counts and times.
fn is(value: f64, expected: f64) -> bool {
    (value - expected).abs() < 1e-9
}

/// Over the port and over the queue, nothing moves without the lock, with a number that was never granted, or with the
/// number of a grant that has ended.
#[test]
fn only_who_holds_the_base_is_obeyed() {
    let mut bench = Bench::new("holder");
    let rejected = |refusal| Receipt::Rejected(Rejected::Fenced(refusal));
    bench.drive(None);
    assert_eq!(bench.queue(1, None), rejected(Refusal::NoLock));
    let fence = bench.granted(1);
    bench.drive(Some(fence + 1));
    assert_eq!(bench.queue(2, Some(fence + 1)), rejected(Refusal::Unknown { number: fence + 1 }));
    let base = bench.base();
    assert!(is(base.refused, 4.0) && is(base.commanded, 0.0) && base.holder == "client 1", "{base:?}");
    assert!(base.velocity.iter().all(|speed| speed.abs() <= 0.0), "{:?}", base.velocity);
    bench.drive(Some(fence));
    assert_eq!(bench.queue(3, Some(fence)), Receipt::Accepted);
    bench.step();
    let base = bench.base();
    assert!(base.velocity[0] > 0.0 && is(base.refused, 4.0) && base.commanded > 7.0, "{base:?}");
    bench.release(1);
    bench.drive(Some(fence));
    assert_eq!(bench.queue(4, Some(fence)), rejected(Refusal::Over { number: fence, floor: fence + 1 }));
    assert!(is(bench.base().refused, 6.0));
}

/// The holder becomes silent: the wheels stop by themselves, and after the lease the next client gets them.
#[test]
fn the_wheels_stop_when_the_holder_is_gone_and_the_next_one_has_them() {
    let mut bench = Bench::new("holder");
    let fence = bench.granted(1);
    // Within the lease, which is not renewed.
    for _ in 0..60 {
        bench.drive(Some(fence));
    }
    let driven = bench.base();
    assert!(driven.velocity[0] > 0.1 && is(driven.stopped, 0.0), "{driven:?}");
    assert!(matches!(bench.acquire(2, 0), LockAnswer::Waiting { holder, .. } if holder == "client 1"));
    bench.pass(Duration::from_millis(150));
    let stopped = bench.base();
    let after = stopped.stopped - driven.commanded;
    assert!(after > WATCHDOG && after <= WATCHDOG + PERIOD.as_secs_f64(), "{after}");
    assert!(matches!(bench.acquire(2, 0), LockAnswer::Waiting { .. }), "the lease goes on");
    bench.pass(LOCK.lease);
    let LockAnswer::Granted { fence: next, .. } = bench.acquire(2, 0) else { panic!("it is free") };
    assert!(next > fence);
    // The first holder wakes up.
    let refused = bench.base().refused;
    bench.drive(Some(fence));
    let base = bench.base();
    assert!(
        is(base.refused, refused + 1.0) && base.velocity[0] < stopped.velocity[0] / 2.0 && base.holder == "client 2",
        "{base:?}"
    );
}

#[test]
fn a_greater_priority_has_the_base_after_300_ms() {
    let mut bench = Bench::new("holder");
    let fence = bench.granted(1);
    let began = bench.now;
    assert!(matches!(bench.acquire(2, 5), LockAnswer::Waiting { .. }));
    let renewed: LockAnswer = bench.call("LockBase", &LockRequest::Renew { client: 1, request: 1 });
    assert!(matches!(renewed, LockAnswer::Granted { is_wanted: true, .. }), "{renewed:?}");
    bench.drive(Some(fence));
    assert!(is(bench.base().refused, 0.0), "it may come to rest");
    while matches!(bench.acquire(2, 5), LockAnswer::Waiting { .. }) {}
    let took = bench.now.since(began);
    assert!(took >= Duration::from_millis(300) && took < Duration::from_millis(330), "{took:?}");
    bench.drive(Some(fence));
    assert!(is(bench.base().refused, 1.0));
}

/// If a spec connects no lock, one sender at a time is obeyed, unless a client holds the device.
#[test]
fn without_a_lock_anyone_is_obeyed_as_long_as_nobody_holds_the_base() {
    let mut bench = Bench::new("anyone");
    bench.drive(None);
    bench.drive(None);
    assert!(bench.base().velocity[0] > 0.0);
    let fence = bench.granted(1);
    bench.drive(None);
    assert!(is(bench.base().refused, 1.0));
    bench.drive(Some(fence));
    assert!(is(bench.base().refused, 1.0));
}

#[test]
fn the_world_is_put_back_when_nobody_holds_it() {
    let mut bench = Bench::new("holder");
    let fence = bench.granted(1);
    bench.drive(Some(fence));
    bench.drive(Some(fence));
    let answer = bench.serve("Reset", &[]);
    assert_eq!(answer.try_recv().unwrap().unwrap_err().to_string(), "the base is held by `client 1`");
    bench.release(1);
    assert!(bench.base().velocity[0] > 0.0);
    bench.serve("Reset", &[]).try_recv().unwrap().unwrap();
    bench.step();
    assert!(bench.base().velocity[0].abs() <= 0.0);
}

/// A controller of the base. Its calls and commands go to the plant, and the answers come back.
struct Driver {
    module: Box<dyn Module>,
    open: Vec<(u64, Receiver<Answer>)>,
}

impl Driver {
    fn new(deployment: &str, priority: u8, now: Time) -> Self {
        let given = [format!("priority={priority}")];
        let mut module = registry().create_at(deployment, "main/xr4000", "XR4000Ctrl", &given).unwrap();
        module.connect_calls(&["Lock"]);
        module.init(&[], now).unwrap();
        Self { module, open: Vec::new() }
    }

    /// Drives forward for one period, or stops.
    fn work(&mut self, bench: &mut Bench, stops: bool) -> Result<Progress, Stopping> {
        for (number, answer) in std::mem::take(&mut self.open) {
            match answer.try_recv() {
                Ok(result) => drop(self.module.answered("Lock", number, result)),
                Err(_) => self.open.push((number, answer)),
            }
        }
        let wanted = postcard::to_stdvec(&BaseVelocity { rates: [0.3, 0.0, 0.0] }).unwrap();
        self.module.deliver("In", &wanted, bench.now).unwrap();
        let done = if stops { Err(self.module.stop(bench.now)) } else { Ok(self.module.calculate(bench.now)) };
        self.module.drain(&mut |port, bytes| {
            bench.world.deliver(port, &bytes, bench.now).unwrap();
        });
        let mut made = Vec::new();
        self.module.drain_calls(&mut |_, order| made.push(order));
        for order in made {
            if let CallOrder::Make { number, argument, .. } = order {
                self.open.push((number, bench.serve("LockBase", &argument)));
            }
        }
        done
    }
}

/// Two missions want the base. The second mission is refused with the name of the holder, and gets the base as soon as
/// the first mission has stopped.
#[test]
fn a_second_mission_is_refused_with_the_name_of_the_first() {
    let mut bench = Bench::new("holder");
    let mut first = Driver::new("door", 0, bench.now);
    for _ in 0..25 {
        assert_eq!(first.work(&mut bench, false), Ok(Progress::Continue));
        bench.step();
    }
    let base = bench.base();
    assert!(base.velocity[0] > 0.0 && base.holder == "door:main/xr4000" && is(base.refused, 0.0), "{base:?}");
    let mut second = Driver::new("other", 0, bench.now);
    let end = (0..1_500).find_map(|_| {
        assert_eq!(first.work(&mut bench, false), Ok(Progress::Continue));
        let end = second.work(&mut bench, false).ok().filter(|progress| *progress != Progress::Continue);
        bench.step();
        end
    });
    assert_eq!(end, Some(Progress::Aborted("the base is held by `door:main/xr4000`".to_owned())));
    assert_eq!(second.work(&mut bench, true), Err(Stopping::Again), "it waits no more, and says so");
    bench.step();
    // The first controller comes to rest, and lets go.
    let mut third = Driver::new("third", 0, bench.now);
    let stopped = (0..400).find(|_| {
        let end = first.work(&mut bench, true);
        assert_eq!(third.work(&mut bench, false), Ok(Progress::Continue));
        bench.step();
        end == Err(Stopping::Finished)
    });
    assert!(stopped.is_some());
    for _ in 0..40 {
        assert_eq!(third.work(&mut bench, false), Ok(Progress::Continue));
        bench.step();
    }
    let base = bench.base();
    assert!(base.holder == "third:main/xr4000" && base.velocity[0] > 0.0 && is(base.refused, 0.0), "{base:?}");
}

#[test]
fn a_mission_with_a_greater_priority_takes_the_base_and_the_first_one_says_so() {
    let mut bench = Bench::new("holder");
    let (mut first, mut second) = (Driver::new("door", 0, bench.now), Driver::new("rescue", 5, bench.now));
    for _ in 0..25 {
        assert_eq!(first.work(&mut bench, false), Ok(Progress::Continue));
        bench.step();
    }
    let lost = (0..200).find_map(|_| {
        assert_eq!(second.work(&mut bench, false), Ok(Progress::Continue));
        let end = first.work(&mut bench, false).ok().filter(|progress| *progress != Progress::Continue);
        bench.step();
        end
    });
    let why = "lost the base: a client with a higher priority has taken the lock";
    assert_eq!(lost, Some(Progress::Aborted(why.to_owned())));
    let mut ends = false;
    for _ in 0..200 {
        ends = ends || first.work(&mut bench, true) == Err(Stopping::Finished);
        assert_eq!(second.work(&mut bench, false), Ok(Progress::Continue));
        bench.step();
    }
    let base = bench.base();
    assert!(ends && base.holder == "rescue:main/xr4000" && base.velocity[0] > 0.0, "{base:?}");
}

/// A controller that was suspended for longer than its lease continues only if no other client has driven the base in
/// that time.
#[test]
fn a_controller_that_wakes_up_goes_on_only_if_nobody_else_has_driven() {
    for has_driven in [false, true] {
        let mut bench = Bench::new("holder");
        let mut first = Driver::new("door", 0, bench.now);
        for _ in 0..25 {
            assert_eq!(first.work(&mut bench, false), Ok(Progress::Continue));
            bench.step();
        }
        bench.pass(LOCK.lease + PERIOD);
        assert!(bench.base().holder.is_empty());
        if has_driven {
            bench.granted(9);
            bench.release(9);
        }
        let end = (0..100).find_map(|_| {
            let end = first.work(&mut bench, false).ok().filter(|progress| *progress != Progress::Continue);
            bench.step();
            end
        });
        let why = "lost the base: another client has had it in the meantime";
        assert_eq!(end, has_driven.then(|| Progress::Aborted(why.to_owned())));
    }
}
