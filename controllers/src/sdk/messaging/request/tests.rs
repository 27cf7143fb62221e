use super::*;
use crate::sdk::calls::{AnyCalls, CallOrder};
use crate::sdk::export::{Activity, Exports, RawReply};
use proptest::prelude::*;
use std::collections::BTreeSet;
use std::sync::mpsc::{Receiver, sync_channel};

#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
struct Number(u64);
impl Message for Number {
    const TYPE: &'static str = "Number";
}

const CLIENTS: usize = 3;
const STEP: u64 = 10;

fn path(client: usize) -> String {
    format!("main/client_{client}")
}

fn at(ms: u64) -> Time {
    Time::ZERO + Duration::from_millis(ms)
}

/// Doubles the numbers that it is asked, one question per calculation, and records the senders.
struct Server {
    questions: Queue<Number>,
    replier: Replier<Number>,
    taken: Vec<(String, u64, u64)>,
    calls: Calls<QueueMessage, Receipt>,
}

impl Server {
    fn new(capacity: usize) -> Self {
        let (questions, replier) = (Queue::new(capacity, Full::Reject), Replier::new("main/server").unwrap());
        Self { questions, replier, taken: Vec::new(), calls: Calls::default() }
    }

    fn exports() -> Exports<Self> {
        let mut exports = Exports::default();
        exports.procedure("Questions", "", |server: &mut Self, message| Ok(server.questions.receive(message)));
        exports
    }

    fn calculate(&mut self, now: Time) {
        self.replier.work(now, &mut self.calls);
        while self.replier.end_of().is_some() {}
        if let Some(Taken { header, data, .. }) = self.questions.take(now) {
            let sent = self.replier.reply(now, &header, &Number(2 * data.0), Duration::from_millis(400));
            sent.unwrap_or_default();
            self.taken.push((header.sender, header.marker, data.0));
        }
    }
}

struct Client {
    asks: Requester<Number, Number>,
    calls: Calls<QueueMessage, Receipt>,
}

impl Client {
    fn exports() -> Exports<Self> {
        let mut exports = Exports::default();
        exports.procedure("Answers", "", |client: &mut Self, message| Ok(client.asks.receive(message)));
        exports
    }
}

/// The fate of a call in transit.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Line {
    Good,
    /// The call arrives, and its receipt is lost.
    LosesReceipts,
    /// The call does not arrive.
    Cut,
}

/// Serves one call at once; returns its answer as the caller gets it.
fn carry<C: 'static>(
    exports: &Exports<C>,
    at: &mut C,
    (name, argument): (&str, &[u8]),
    line: Line,
) -> Result<Vec<u8>, ObjectError> {
    if line == Line::Cut {
        return Err(ObjectError::Gone);
    }
    let (answer_tx, answer): (_, Receiver<Result<Vec<u8>, ObjectError>>) = sync_channel(1);
    let reply = RawReply::new(move |result| answer_tx.send(result).unwrap_or_default(), || true);
    exports.serve(at, name, argument, Activity::Running, reply);
    let answered = answer.try_recv().unwrap();
    if line == Line::LosesReceipts { Err(ObjectError::Gone) } else { answered }
}

/// One step: the client, whether it asks, and the lines in both directions.
type Step = (usize, bool, u8, u8);

fn line(number: u8) -> Line {
    match number {
        0 => Line::LosesReceipts,
        1 | 2 => Line::Cut,
        _ => Line::Good,
    }
}

fn turn(server: &mut Server, clients: &mut [Client], (now, there, back): (Time, Line, Line)) {
    server.calculate(now);
    for client in &mut *clients {
        client.asks.work(now, &mut client.calls);
        for order in client.calls.take() {
            let CallOrder::Make { number, argument, to, .. } = order else { continue };
            assert_eq!(to, None);
            let answer = carry(&Server::exports(), server, ("Questions", &argument), there);
            client.calls.deliver(number, answer);
        }
    }
    for order in server.calls.take() {
        let CallOrder::Make { number, argument, to: Some(to), .. } = order else { continue };
        let meant = (0..clients.len()).find(|client| path(*client) == to);
        let answer = match meant {
            Some(client) => carry(&Client::exports(), &mut clients[client], ("Answers", &argument), back),
            None => Err(ObjectError::NotConnected { name: "Answers".into() }),
        };
        server.calls.deliver(number, answer);
    }
}

fn clients() -> Vec<Client> {
    (0..CLIENTS).map(|one| Client { asks: Requester::new(&path(one)).unwrap(), calls: Calls::default() }).collect()
}

proptest! {
    /// Compared with a list of all requests: each request ends once, at the latest one turn after its deadline. An
    /// answer belongs to its own question and goes to its caller. A refused request was not carried out, and nothing is
    /// carried out twice, with any losses of the lines.
    #[test]
    fn each_request_has_its_own_answer_or_one_reason(
        steps in prop::collection::vec((0..CLIENTS, any::<bool>(), 0_u8..8, 0_u8..8), 1..120),
        within in 30_u64..400,
        capacity in 1_usize..5,
    ) {
        let (mut server, mut all_clients) = (Server::new(capacity), clients());
        // By client and marker: the question, its deadline, and whether it has ended.
        let mut all: BTreeMap<(usize, u64), (u64, Time, bool)> = BTreeMap::new();
        let (mut rejected, mut asked) = (BTreeSet::new(), 0);
        let rest: Vec<Step> = vec![(0, false, 7, 7); 60];
        for (now, (who, asks, there, back)) in (100_u64..).step_by(usize::try_from(STEP).unwrap()).zip(steps.into_iter().chain(rest)) {
            let now = at(now);
            if asks {
                asked += 1;
                let question = Number(asked);
                let begun = all_clients[who].asks.ask(now, "sum", 0, &question, Duration::from_millis(within));
                match begun {
                    Ok(marker) => prop_assert!(all.insert((who, marker), (asked, now + Duration::from_millis(within), false)).is_none()),
                    Err(why) => prop_assert!(matches!(why, RequestFailure::NotSent(_))),
                }
            }
            turn(&mut server, &mut all_clients, (now, line(there), line(back)));
            for (one, client) in all_clients.iter_mut().enumerate() {
                while let Some((marker, end)) = client.asks.end_of() {
                    let (question, until, is_over) = all.get_mut(&(one, marker)).unwrap();
                    prop_assert!(!std::mem::replace(is_over, true), "it has ended twice");
                    match end {
                        Ok(answer) => {
                            prop_assert_eq!((answer.data, answer.header.marker), (Number(2 * *question), marker));
                            prop_assert!(now < *until);
                        }
                        Err(RequestFailure::Rejected(why)) => {
                            prop_assert_eq!(why, Rejected::Full { capacity: u64::try_from(capacity).unwrap() });
                            rejected.insert((path(one), marker));
                        }
                        Err(RequestFailure::Deadline) => prop_assert!(now >= *until),
                        Err(RequestFailure::Gone) => prop_assert!(now >= *until),
                        Err(other) => prop_assert!(false, "{:?}", other),
                    }
                }
            }
            let late = all.values().any(|(_, until, is_over)| !is_over && *until + Duration::from_millis(STEP) < now);
            prop_assert!(!late, "it goes on after its deadline");
        }
        prop_assert!(all.values().all(|(.., is_over)| *is_over));
        let once: BTreeSet<_> = server.taken.iter().map(|(sender, marker, _)| (sender.clone(), *marker)).collect();
        prop_assert_eq!(once.len(), server.taken.len(), "it was carried out twice");
        prop_assert!(once.is_disjoint(&rejected), "what was turned away was carried out");
    }
}

/// Each reason for a missing answer, and the party that gets it.
#[test]
fn the_reasons_are_told_apart() {
    let within = Duration::from_millis(100);
    let first = |line: Line, capacity: usize, more: usize| {
        let (mut server, mut clients) = (Server::new(capacity), clients());
        let client = &mut clients[0].asks;
        let markers: Vec<u64> = (0..=more).map(|_| client.ask(at(100), "", 0, &Number(1), within).unwrap()).collect();
        let mut ends = BTreeMap::new();
        for ms in (100..300).step_by(10) {
            turn(&mut server, &mut clients, (at(ms), line, Line::Good));
            ends.extend(std::iter::from_fn(|| clients[0].asks.end_of()));
        }
        markers.last().and_then(|marker| ends.remove(marker)).unwrap()
    };
    assert_eq!(first(Line::Good, 4, 0).unwrap().data, Number(2));
    assert_eq!(first(Line::Cut, 4, 0), Err(RequestFailure::Gone));
    assert_eq!(first(Line::Good, 1, 1), Err(RequestFailure::Rejected(Rejected::Full { capacity: 1 })));
    // The server does not take the questions.
    let (mut server, mut clients) = (Server::new(1), clients());
    let client = &mut clients[0];
    client.asks.ask(at(100), "", 0, &Number(1), within).unwrap();
    client.asks.work(at(100), &mut client.calls);
    for order in client.calls.take() {
        let CallOrder::Make { number, argument, .. } = order else { panic!("{order:?}") };
        let answer = carry(&Server::exports(), &mut server, ("Questions", &argument), Line::Good);
        client.calls.deliver(number, answer);
    }
    client.asks.work(at(250), &mut client.calls);
    assert_eq!(client.asks.end_of().unwrap().1, Err(RequestFailure::Deadline));
    // Too many requests at a time, and one that is too long.
    let mut many = Requester::<Vec<u8>, Number>::new("main/many").unwrap();
    let refused = many.ask(at(0), "", 0, &vec![0; 2 << 20], within);
    assert!(matches!(refused, Err(RequestFailure::NotSent(_))), "{refused:?}");
    many.work(at(1000), &mut Calls::default());
    assert_eq!(many.end_of(), None, "what has not begun does not end");
}
