use super::super::header::sample;
use super::super::queue::{Full, MessageQueue, QueueSettings};
use super::*;
use crate::logic::random::Random;
use proptest::prelude::*;
use std::num::NonZeroUsize;

fn settings(outbox_max: usize) -> RouterSettings {
    RouterSettings { type_name: "Speed".into(), outbox_max, gone_after: GONE_AFTER }
}

fn subscribe(queue: &str, filters: Vec<Filter>) -> RouterInput {
    RouterInput::Request(RouterRequest::Subscribe { queue: queue.into(), type_name: "Speed".into(), filters })
}

fn handle(router: &mut Router, now: Time, input: RouterInput) -> Vec<RouterEffect> {
    let mut effects = Vec::new();
    router.handle(now, input, &mut effects);
    effects
}

fn at(ms: u64) -> Time {
    Time::ZERO + Duration::from_millis(ms)
}

#[test]
fn a_filter_takes_what_matches_in_every_part() {
    let header = sample(1, 1, 5).header;
    let filter = |change: fn(&mut Filter)| {
        let mut filter = Filter::default();
        change(&mut filter);
        (filter.takes(&header), filter.to_string())
    };
    for (checked, takes, text) in [
        (filter(|_| ()), true, "everything"),
        (filter(|one| one.category = Some("motion".into())), true, "category motion"),
        (filter(|one| one.category = Some("mot".into())), false, "category mot"),
        (filter(|one| one.category = Some("mot*".into())), true, "category mot*"),
        (filter(|one| one.sender = Some("main/*".into())), true, "sender main/*"),
        (filter(|one| one.priority_min = Some(5)), true, "priority 5"),
        (filter(|one| one.priority_min = Some(6)), false, "priority 6"),
        (filter(|one| one.marker = Some(1)), false, "marker 1"),
    ] {
        assert_eq!(checked, (takes, text.to_owned()));
    }
    let both = Filter { category: Some("motion".into()), priority_min: Some(6), ..Filter::default() };
    assert!(!both.takes(&header));
}

#[test]
fn what_cannot_subscribe_is_told_why() {
    let mut router = Router::new(settings(4));
    let mut refused = |request| match handle(&mut router, Time::ZERO, RouterInput::Request(request)).remove(0) {
        RouterEffect::Answer(RouterAnswer::Refused(refusal)) => refusal.to_string(),
        other @ (RouterEffect::Answer(_) | RouterEffect::Deliver { .. } | RouterEffect::Dropped { .. }) => {
            format!("{other:?}")
        }
    };
    let (queue, filters) = (|| "q".to_owned(), Vec::new);
    let wrong = RouterRequest::Subscribe { queue: queue(), type_name: "Wrench".into(), filters: filters() };
    assert_eq!(refused(wrong), "the router sends `Speed`, and the queue takes `Wrench`");
    let many = vec![Filter::default(); 17];
    let many = RouterRequest::Subscribe { queue: queue(), type_name: "Speed".into(), filters: many };
    assert_eq!(refused(many), "a subscription has 16 filters at most, each with 255 bytes of text");
    for number in 0..SUBSCRIBERS_MAX {
        let (queue, type_name) = (number.to_string(), "Speed".to_owned());
        refused(RouterRequest::Subscribe { queue, type_name, filters: filters() });
    }
    let one_more = RouterRequest::Subscribe { queue: queue(), type_name: "Speed".into(), filters: filters() };
    assert_eq!(refused(one_more), "the router has 256 subscribers, and no more are allowed");
}

#[test]
fn a_slow_subscriber_fills_its_own_outbox_and_delays_nobody() {
    let mut router = Router::new(settings(3));
    handle(&mut router, at(0), subscribe("fast", vec![]));
    handle(&mut router, at(0), subscribe("slow", vec![]));
    for number in 1..=10 {
        let effects = handle(&mut router, at(number), RouterInput::Publish(sample(1, number, 0)));
        let Some(RouterEffect::Deliver { queue, delivery, message, .. }) = effects.first() else {
            panic!("{effects:?}")
        };
        assert_eq!((queue.as_str(), message.header.recipient.as_str()), ("fast", "fast"));
        assert_eq!((message.header.id.number, effects.len()), (number, if number == 1 { 2 } else { 1 }));
        let end = DeliveryEnd::Receipt(Receipt::Accepted);
        let delivered = RouterInput::Delivered { queue: "fast".into(), delivery: *delivery, end };
        assert_eq!(handle(&mut router, at(number), delivered), []);
    }
    let status = router.status(String::new());
    let of = |at: usize| {
        let one = &status.subscribers[at];
        (one.queue.as_str(), one.matched, one.delivered, one.lost, one.waiting)
    };
    assert_eq!((of(0), of(1)), (("fast", 10, 10, 0, 0), ("slow", 10, 0, 6, 4)));
    assert_eq!(status.counters.published, 10);
}

#[test]
fn who_is_gone_is_dropped_from_the_register_and_counted() {
    let mut router = Router::new(settings(3));
    for (name, end, why) in
        [("a", DeliveryEnd::Unknown, Gone::Unknown), ("b", DeliveryEnd::Receipt(wrong_type()), Gone::WrongType)]
    {
        handle(&mut router, at(0), subscribe(name, vec![]));
        let effects = handle(&mut router, at(0), RouterInput::Publish(sample(1, 1, 0)));
        let Some(RouterEffect::Deliver { delivery, .. }) = effects.first() else { panic!("{effects:?}") };
        let ended = RouterInput::Delivered { queue: name.into(), delivery: *delivery, end };
        let lost = u64::from(why == Gone::Unknown);
        let dropped = RouterEffect::Dropped { queue: name.into(), why, lost };
        assert_eq!(handle(&mut router, at(1), ended), [dropped]);
    }
    // Subscriber `c` sends nothing any more, and no message is sent to it either.
    handle(&mut router, at(0), subscribe("c", vec![]));
    handle(&mut router, at(3000), subscribe("c", vec![]));
    assert_eq!(router.deadline(), Some(at(8000)));
    assert_eq!(handle(&mut router, at(7999), RouterInput::Tick), []);
    let dropped = RouterEffect::Dropped { queue: "c".into(), why: Gone::Silent, lost: 0 };
    assert_eq!(handle(&mut router, at(8000), RouterInput::Tick), [dropped]);
    assert_eq!((router.deadline(), router.status(String::new()).counters.dropped_subscribers), (None, 3));
}

fn wrong_type() -> Receipt {
    Receipt::Rejected(Rejected::WrongType { expected: "A".into(), found: "B".into() })
}

/// A network in which deliveries and receipts are lost, late and duplicated. The queues at the other end are real; some
/// of them are slow.
struct Net {
    random: Random,
    router: Router,
    queues: Vec<(MessageQueue, Vec<u64>)>,
    /// The messages in transit: deliveries to a queue, and receipts.
    flying: Vec<(Time, RouterEffect)>,
    receipts: Vec<(Time, RouterInput)>,
    /// The numbers that each subscriber's filter accepted.
    expected: Vec<Vec<u64>>,
    cut: Option<usize>,
    is_calm: bool,
}

const READERS: usize = 4;

fn filter_of(reader: usize) -> Vec<Filter> {
    let least = u8::try_from(reader).unwrap();
    if reader == 0 { vec![] } else { vec![Filter { priority_min: Some(least), ..Filter::default() }] }
}

impl Net {
    fn new(seed: u64) -> Self {
        let mut random = Random::new(seed);
        let queue = |capacity| {
            let capacity = NonZeroUsize::new(capacity).unwrap();
            let settings = QueueSettings { type_name: "Speed".into(), capacity, full: Full::Reject, data_size_max: 8 };
            (MessageQueue::new(settings), Vec::new())
        };
        let queues = (0..READERS).map(|_| queue(1 + usize::try_from(random.below(4)).unwrap())).collect();
        let outbox_max = 2 + usize::try_from(random.below(40)).unwrap();
        let router = Router::new(RouterSettings { gone_after: Duration::from_secs(3600), ..settings(outbox_max) });
        let expected = vec![Vec::new(); READERS];
        Self { random, router, queues, flying: vec![], receipts: vec![], expected, cut: None, is_calm: false }
    }

    fn delay(&mut self, now: Time) -> Time {
        let longest = if self.chance(10) { 1500 } else { 4 };
        now + Duration::from_millis(self.random.below(longest))
    }

    /// Returns true once in `of` calls on average, and never in the calm period at the end.
    fn chance(&mut self, of: u64) -> bool {
        !self.is_calm && self.random.below(of) == 0
    }

    fn input(&mut self, now: Time, input: RouterInput) {
        for effect in handle(&mut self.router, now, input) {
            let RouterEffect::Deliver { queue, delivery, .. } = &effect else { continue };
            let reader: usize = queue.parse().unwrap();
            if self.cut == Some(reader) || self.chance(8) {
                let lost =
                    RouterInput::Delivered { queue: queue.clone(), delivery: *delivery, end: DeliveryEnd::Unreachable };
                if self.random.below(2) == 0 {
                    self.receipts.push((now + DELIVER_WITHIN, lost));
                }
                continue;
            }
            for _ in 0..=u64::from(self.chance(6)) {
                let due = self.delay(now);
                self.flying.push((due, effect.clone()));
            }
        }
    }

    fn arrive(&mut self, now: Time) {
        let (due, flying) = self.flying.drain(..).partition(|(at, _)| *at <= now);
        self.flying = flying;
        let due: Vec<(Time, RouterEffect)> = due;
        for (_, effect) in due {
            let RouterEffect::Deliver { queue, delivery, message, .. } = effect else { continue };
            let reader: usize = queue.parse().unwrap();
            let receipt = self.queues[reader].0.receive(now, message);
            if !self.chance(8) {
                let end = DeliveryEnd::Receipt(receipt);
                let due = self.delay(now);
                self.receipts.push((due, RouterInput::Delivered { queue, delivery, end }));
            }
        }
        let (due, receipts) = self.receipts.drain(..).partition(|(at, _)| *at <= now);
        self.receipts = receipts;
        let due: Vec<(Time, RouterInput)> = due;
        for (_, input) in due {
            self.input(now, input);
        }
    }

    fn read(&mut self, chance: u64) {
        for (queue, read) in &mut self.queues {
            if self.random.below(chance) == 0 {
                read.extend(queue.take().map(|message| message.header.id.number));
            }
        }
    }

    /// Publishes messages for some seconds, then runs until everything has settled.
    fn run(mut self) -> Result<(), TestCaseError> {
        for reader in 0..READERS {
            self.input(Time::ZERO, subscribe(&reader.to_string(), filter_of(reader)));
        }
        let mut number = 0;
        for ms in 0..20_000 {
            let now = at(ms);
            if ms < 4000 {
                if self.random.below(12) == 0 {
                    number += 1;
                    let priority = u8::try_from(self.random.below(5)).unwrap();
                    let message = sample(1, number, priority);
                    for (reader, expected) in self.expected.iter_mut().enumerate() {
                        if usize::from(priority) >= reader {
                            expected.push(number);
                        }
                    }
                    self.input(now, RouterInput::Publish(message));
                }
                if self.random.below(400) == 0 {
                    self.cut = usize::try_from(self.random.below(5)).ok().filter(|&reader| reader < READERS);
                }
            } else {
                (self.cut, self.is_calm) = (None, true);
            }
            self.arrive(now);
            self.read(if ms < 4000 { 30 } else { 2 });
            if self.router.deadline().is_some_and(|due| due <= now) {
                self.input(now, RouterInput::Tick);
            }
        }
        self.check()
    }

    fn check(self) -> Result<(), TestCaseError> {
        let status = self.router.status(String::new());
        for (reader, (queue, read)) in self.queues.iter().enumerate() {
            let (one, expected) = (&status.subscribers[reader], &self.expected[reader]);
            prop_assert_eq!(one.matched, expected.len() as u64);
            prop_assert_eq!((one.waiting, queue.counters().depth, one.refused), (0, 0, 0));
            // Each message was read at most once, and none outside the filter. Missing messages are counted.
            let mut sorted = read.clone();
            sorted.sort_unstable();
            sorted.dedup();
            prop_assert_eq!(sorted.len(), read.len());
            prop_assert!(read.iter().all(|number| expected.contains(number)));
            let missing = expected.len() as u64 - read.len() as u64;
            // If the receipt of a message is lost, the queue may have taken the message while the router counts it as
            // lost. The reverse never happens.
            prop_assert!(missing <= one.lost, "{} missing, {} counted", missing, one.lost);
            prop_assert_eq!(one.delivered + one.lost, one.matched);
        }
        Ok(())
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn nothing_is_doubled_and_what_is_lost_is_counted(seed: u64) {
        Net::new(seed).run()?;
    }
}
