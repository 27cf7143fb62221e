use super::*;
use crate::sdk::calls::{AnyCalls, CallOrder};
use crate::sdk::export::{Activity, Exports, RawReply};
use crate::sdk::messaging::{Full, Header, MessageId};
use proptest::prelude::*;
use std::sync::mpsc::{Receiver, sync_channel};

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Speed(f64);
impl Message for Speed {
    const TYPE: &'static str = "Speed";
}

#[derive(Debug, Serialize, Deserialize)]
struct Wrench;
impl Message for Wrench {
    const TYPE: &'static str = "Wrench";
}

/// Receives the answer to a call.
type Answer = Receiver<Result<Vec<u8>, ObjectError>>;

/// The program with the router.
struct Desk {
    news: Router<Speed>,
}

/// A subscriber, and the one call that it has open.
struct Reader<T> {
    user: RouterUser,
    calls: Calls<Subscription, Delivery>,
    queue: Queue<T>,
    open: Option<(u64, Answer)>,
    taken: Vec<u64>,
}

/// The fate of the call and of the answer in one turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fate {
    Good,
    CallLost,
    AnswerLost,
}

impl<T: Message> Reader<T> {
    fn new(name: &str, category: Option<&str>, capacity: usize) -> Self {
        let filters = category.map(|category| Filter { category: Some(category.into()), ..Filter::default() });
        let user = RouterUser::new(name, filters.into_iter().collect()).unwrap();
        let (calls, queue) = (Calls::default(), Queue::new(capacity, Full::Reject));
        Self { user, calls, queue, open: None, taken: Vec::new() }
    }

    fn turn(&mut self, desk: &mut Desk, now: Time, fate: Fate) {
        if let Some((number, answer)) = self.open.take() {
            match answer.try_recv() {
                Ok(_) if fate == Fate::AnswerLost => self.calls.deliver(number, Err(ObjectError::Gone)),
                Ok(result) => self.calls.deliver(number, result),
                Err(_) => self.open = Some((number, answer)),
            }
        }
        self.user.work(now, &mut self.calls, &mut self.queue);
        for order in self.calls.take() {
            let CallOrder::Make { number, argument, .. } = order else { continue };
            if fate == Fate::CallLost {
                self.calls.deliver(number, Err(ObjectError::Gone));
                continue;
            }
            let (answer_tx, answer) = sync_channel(1);
            let reply = RawReply::new(move |result| answer_tx.send(result).unwrap_or_default(), || true);
            let mut exports = Exports::default();
            exports.procedure_later("News", "", |desk: &mut Desk, subscription, reply| {
                desk.news.ask(subscription, reply);
            });
            exports.serve(desk, "News", &argument, Activity::Running, reply);
            self.open = Some((number, answer));
        }
    }

    fn take(&mut self, now: Time) {
        self.taken.extend(self.queue.take(now).map(|taken| taken.header.id.number));
    }
}

fn at(ms: u64) -> Time {
    Time::ZERO + Duration::from_millis(ms)
}

fn desk() -> Desk {
    Desk { news: Router::new("desk", 1000).unwrap() }
}

proptest! {
    /// With any lost calls and answers, and any full queues: each subscriber takes the messages that its filters
    /// accept, once and in order.
    #[test]
    fn each_message_is_taken_once_by_all_that_want_it(
        steps in prop::collection::vec((0_u8..6, 0_usize..3), 0..150),
    ) {
        let mut desk = desk();
        let mut readers: Vec<Reader<Speed>> =
            [Some("a"), Some("b"), None].map(|category| Reader::new("reader", category, 2)).into();
        let mut ms = 0;
        for _ in 0..3 {
            ms += 20;
            readers.iter_mut().for_each(|reader| reader.turn(&mut desk, at(ms), Fate::Good));
            desk.news.work(at(ms));
        }
        prop_assert!(readers.iter().all(|reader| *reader.user.state() == Subscribed::Yes));
        let mut expected = vec![Vec::new(); 3];
        for (step, of) in steps {
            ms += 20;
            match step {
                0 | 1 => {
                    let category = if step == 0 { "a" } else { "b" };
                    let number = desk.news.send(at(ms), Label { category, priority: 0, marker: 0 }, &Speed(1.0)).unwrap();
                    expected[usize::from(step)].push(number);
                    expected[2].push(number);
                }
                2 => readers[of].turn(&mut desk, at(ms), Fate::Good),
                3 => readers[of].turn(&mut desk, at(ms), Fate::CallLost),
                4 => readers[of].turn(&mut desk, at(ms), Fate::AnswerLost),
                _ => readers[of].take(at(ms)),
            }
            desk.news.work(at(ms));
        }
        // At most 150 messages, each with the pause of a full queue.
        for _ in 0..2000 {
            ms += 20;
            for reader in &mut readers {
                reader.turn(&mut desk, at(ms), Fate::Good);
                reader.take(at(ms));
            }
            desk.news.work(at(ms));
        }
        let taken: Vec<Vec<u64>> = readers.iter().map(|reader| reader.taken.clone()).collect();
        prop_assert_eq!(taken, expected);
        let status = desk.news.status();
        prop_assert_eq!((desk.news.dropped(), status.subscribers.len()), (None, 3));
        for one in status.subscribers {
            prop_assert_eq!((one.queue.as_str(), one.lost, one.waiting, one.refused), ("reader", 0, 0, 0));
            prop_assert_eq!(one.matched, one.delivered);
        }
    }
}

#[test]
fn who_is_silent_is_dropped_and_who_takes_another_type_is_refused() {
    let mut desk = desk();
    let (mut gone, mut wrong) = (Reader::<Speed>::new("gone", None, 2), Reader::<Wrench>::new("wrong", None, 2));
    for ms in [20, 40, 60] {
        gone.turn(&mut desk, at(ms), Fate::Good);
        wrong.turn(&mut desk, at(ms), Fate::Good);
        desk.news.work(at(ms));
    }
    let refusal = RouterRefusal::WrongType { sent: "Speed".into(), taken: "Wrench".into() };
    assert_eq!((gone.user.state(), wrong.user.state()), (&Subscribed::Yes, &Subscribed::Refused(refusal)));
    for _ in 0..3 {
        desk.news.send(at(80), Label { category: "a", priority: 0, marker: 0 }, &Speed(1.0)).unwrap();
    }
    (100..6000).step_by(20).for_each(|ms| desk.news.work(at(ms)));
    let dropped = Dropped { name: "gone".into(), why: Gone::Silent, lost: 3 };
    assert_eq!((desk.news.dropped(), desk.news.dropped()), (Some(dropped), None));
    assert_eq!(desk.news.status().subscribers, []);
    // The subscriber is back, and in the register again. No messages were kept for it.
    for ms in (6000..8000).step_by(20) {
        gone.turn(&mut desk, at(ms), Fate::Good);
        desk.news.work(at(ms));
    }
    assert_eq!((gone.user.state(), desk.news.status().subscribers.len()), (&Subscribed::Yes, 1));
    let too_long = Router::<Vec<u8>>::new("desk", 1).unwrap().send(
        at(0),
        Label { category: "", priority: 0, marker: 0 },
        &vec![0; 2 << 20],
    );
    assert!(too_long.unwrap_err().contains("and 1048576 are allowed"));
}

/// Bytes that programs of other versions rely on.
#[test]
fn golden() {
    let hex = |bytes: Vec<u8>| bytes.iter().map(|byte| format!("{byte:02x}")).collect::<String>();
    let (name, type_name, last) = ("n".to_owned(), "T".to_owned(), Some((7, Receipt::Accepted)));
    let subscription = Subscription { name, life: 300, type_name, filters: vec![], last };
    assert_eq!(hex(postcard::to_stdvec(&subscription).unwrap()), "016eac02015400010700");
    let header = Header {
        category: "m".into(),
        id: MessageId { life: 300, number: 2 },
        sender: "s".into(),
        recipient: "r".into(),
        priority: 5,
        marker: 9,
    };
    let message = QueueMessage { header, type_name: "T".into(), fence: Some(4), data: vec![1, 2] };
    for (delivery, golden) in [
        (Delivery::Nothing, "00"),
        (Delivery::Message { number: 5, message }, "0105016dac020201730172050901540104020102"),
        (Delivery::Refused(RouterRefusal::Full { max: 1 }), "020001"),
    ] {
        assert_eq!(hex(postcard::to_stdvec(&delivery).unwrap()), golden);
    }
}

/// A name is limited as the error says, whatever the router adds to it.
#[test]
fn a_name_has_255_bytes_at_most() {
    for (size, is_taken) in [(255, true), (256, false)] {
        let (mut desk, mut reader) = (desk(), Reader::<Speed>::new(&"n".repeat(size), None, 2));
        for ms in [20, 40] {
            reader.turn(&mut desk, at(ms), Fate::Good);
            desk.news.work(at(ms));
        }
        reader.turn(&mut desk, at(60), Fate::Good);
        match reader.user.state() {
            Subscribed::Yes => assert!(is_taken),
            Subscribed::Refused(refusal) => {
                assert!(!is_taken);
                assert_eq!(*refusal, RouterRefusal::Filters { max: 16, size_max: 255 });
            }
            state @ (Subscribed::Asking | Subscribed::Unknown(_)) => panic!("{size}: {state:?}"),
        }
    }
}
