//! Ports that the spec connects with keys of the database: `db("team/flat/claim/**") -> robot, Claims;`
//!
//! An input of [`KeyNews`] gets the present values and then each change, like [`Database::watch`]. The values of an
//! output of [`KeyPut`] are written to the database, and an input of [`KeyAnswer`] gets the results. All of these are
//! delivered directly before a calculation. No more are requested before that calculation has seen them, so an
//! [`Every`](super::Every) loses none.

use super::database::{Database, DatabaseError, DatabaseOrder, Transaction, Unknown, WatchEvent};
use super::port::Message;
use super::port_interface::{Direction, PortInterface};
use comms::logic::control::KeyPort;
use comms::logic::database::{DatabaseAnswer, DatabaseRefusal, Expected, TxnId, Value};
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;

/// Marks the numbers of requests that ports make. Requests of the controller's own database field do not have this
/// mark.
const OF_PORTS: u64 = 1 << 63;

/// The news for an input about the keys with which it is connected.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyNews {
    /// The keys as in the plan: a key, or a prefix that ends in `/`.
    pub keys: String,
    /// The event.
    pub event: WatchEvent,
}

impl Message for KeyNews {
    const TYPE: &'static str = "KeyNews";
}

/// A value to be written to a key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KeyPut {
    /// The number of the put, which its answer repeats.
    pub number: u64,
    /// The key. The output must be connected with it.
    pub key: String,
    /// The value; none deletes the key.
    pub value: Option<comms::logic::database::Stored>,
    /// The expected state of the key, if it matters.
    pub expected: Option<Expected>,
    /// The time limit of the answer.
    pub within: Duration,
}

impl KeyPut {
    /// Returns the request that writes a value to a key.
    pub fn new(number: u64, key: impl Into<String>, value: impl Into<Value>, within: Duration) -> Self {
        let value = Some((&value.into()).into());
        Self { number, key: key.into(), value, expected: None, within }
    }

    /// Sets the expected state of the key.
    #[must_use]
    pub fn expecting(self, expected: Expected) -> Self {
        Self { expected: Some(expected), ..self }
    }
}

impl Message for KeyPut {
    const TYPE: &'static str = "KeyPut";
}

/// The result of a [`KeyPut`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct KeyAnswer {
    /// The number of the put.
    pub number: u64,
    /// Only [`KeyResult::Committed`] is success.
    pub result: KeyResult,
}

/// The result of a [`KeyPut`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum KeyResult {
    /// The write is on the disk of this robot, and goes to all others.
    Committed(TxnId),
    /// Nothing was done.
    Refused(DatabaseRefusal),
    /// It is unknown whether the write was committed; the reason is for a person.
    Unknown(String),
}

impl Message for KeyAnswer {
    const TYPE: &'static str = "KeyAnswer";
}

impl From<Result<TxnId, DatabaseError>> for KeyResult {
    fn from(result: Result<TxnId, DatabaseError>) -> Self {
        match result {
            Ok(version) => Self::Committed(version),
            Err(DatabaseError::Refused(why)) => Self::Refused(why),
            Err(DatabaseError::Unknown(why)) => Self::Unknown(why.to_string()),
        }
    }
}

/// The ports of a controller that are connected with keys, for one activation at a time.
#[derive(Debug, Default)]
pub struct KeyPorts {
    ports: Vec<KeyPort>,
    database: Database,
    /// The input and the keys of each watch.
    watches: BTreeMap<u64, (String, String)>,
    /// By the number of the request, the number that the output gave to its put.
    puts: BTreeMap<u64, u64>,
    /// Answers to puts that were refused at once.
    refused: Vec<KeyAnswer>,
    /// The inputs that get the results of puts.
    hears_answers: Vec<String>,
}

impl KeyPorts {
    /// Takes the connections of the spec.
    pub fn connect(&mut self, ports: Vec<KeyPort>) {
        self.ports = ports;
    }

    /// Begins an activation: the inputs begin to watch.
    pub fn begin(&mut self, interfaces: &[PortInterface], now: Time) {
        *self = Self { ports: std::mem::take(&mut self.ports), ..Self::default() };
        self.database.begin(now);
        for port in self.ports.iter().filter(|port| !port.is_write) {
            let is_it = |declared: &&PortInterface| declared.name == port.port && declared.direction == Direction::In;
            match interfaces.iter().find(is_it).map(|declared| declared.type_name) {
                Some(KeyNews::TYPE) => {
                    let watch = self.database.watch(port.keys.clone());
                    self.watches.insert(watch, (port.port.clone(), port.keys.clone()));
                }
                Some(KeyAnswer::TYPE) if !self.hears_answers.contains(&port.port) => {
                    self.hears_answers.push(port.port.clone());
                }
                Some(_) | None => {}
            }
        }
    }

    /// Returns whether an output writes keys.
    pub fn writes(&self, output: &str) -> bool {
        self.ports.iter().any(|port| port.is_write && port.port == output)
    }

    /// Takes a value that an output has sent, if the output is connected.
    pub fn sent(&mut self, output: &str, bytes: &[u8]) {
        let mut own = self.ports.iter().filter(|port| port.is_write && port.port == output).peekable();
        if own.peek().is_none() {
            return;
        }
        let Ok(put) = postcard::from_bytes::<KeyPut>(bytes) else { return };
        if !own.any(|port| port.covers(&put.key)) {
            let why = format!("`{}` is not among the keys that `{output}` is connected with", put.key);
            let refusal = DatabaseRefusal::NotAllowed { key: put.key, why };
            return self.refused.push(KeyAnswer { number: put.number, result: KeyResult::Refused(refusal) });
        }
        let transaction = Transaction::of_one(put.key, put.value, put.expected);
        let request = self.database.transact(transaction, put.within);
        self.puts.insert(request, put.number);
    }

    /// Returns the values to deliver to inputs before a calculation, in order: port and encoded value.
    pub fn news(&mut self, now: Time) -> Vec<(String, Vec<u8>)> {
        self.database.begin(now);
        let mut told = Vec::new();
        while let Some((watch, event)) = self.database.event() {
            if let Some((port, keys)) = self.watches.get(&watch) {
                let news = KeyNews { keys: keys.clone(), event };
                told.push((port.clone(), encoded(&news)));
            }
        }
        let mut answers = std::mem::take(&mut self.refused);
        while let Some((request, result)) = self.database.committed() {
            let number = self.puts.remove(&request);
            answers.extend(number.map(|number| KeyAnswer { number, result: result.into() }));
        }
        for answer in answers {
            let bytes = encoded(&answer);
            told.extend(self.hears_answers.iter().map(|port| (port.clone(), bytes.clone())));
        }
        told
    }

    /// Takes the waiting orders, in order.
    pub fn orders(&mut self) -> Vec<DatabaseOrder> {
        let marked = |order| match order {
            DatabaseOrder::Ask { number, request } => DatabaseOrder::Ask { number: number | OF_PORTS, request },
            DatabaseOrder::Taken { number } => DatabaseOrder::Taken { number: number | OF_PORTS },
            DatabaseOrder::Cancel { number } => DatabaseOrder::Cancel { number: number | OF_PORTS },
        };
        self.database.take().into_iter().map(marked).collect()
    }

    /// Takes an answer, if it belongs to a port.
    ///
    /// # Errors
    /// Returns the answer again if it does not belong to a port.
    pub fn deliver(
        &mut self,
        number: u64,
        answer: Result<DatabaseAnswer, Unknown>,
    ) -> Result<(), Result<DatabaseAnswer, Unknown>> {
        if number & OF_PORTS == 0 {
            return Err(answer);
        }
        self.database.deliver(number & !OF_PORTS, answer);
        Ok(())
    }

    /// Returns whether an input is connected with keys.
    pub fn feeds(&self, input: &str) -> bool {
        self.ports.iter().any(|port| !port.is_write && port.port == input)
    }
}

fn encoded(message: &impl Message) -> Vec<u8> {
    postcard::to_stdvec(message).expect("a message is plain data, which postcard always encodes")
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::logic::database::DatabaseRequest;

    const WITHIN: Duration = Duration::from_secs(1);

    fn connected() -> KeyPorts {
        let port = |port: &str, keys: &str, is_write| KeyPort { port: port.into(), keys: keys.into(), is_write };
        let mut ports = KeyPorts::default();
        ports.connect(vec![
            port("Claims", "team/claim/", false),
            port("Done", "team/claim/", false),
            port("Claim", "team/claim/", true),
        ]);
        let interfaces = [
            PortInterface::wire("Claims", Direction::In, KeyNews::TYPE),
            PortInterface::wire("Done", Direction::In, KeyAnswer::TYPE),
            PortInterface::wire("Claim", Direction::Out, KeyPut::TYPE),
        ];
        ports.begin(&interfaces, Time::ZERO);
        ports
    }

    fn asked(ports: &mut KeyPorts) -> Vec<(u64, DatabaseRequest)> {
        let ask =
            |order| if let DatabaseOrder::Ask { number, request } = order { Some((number, request)) } else { None };
        ports.orders().into_iter().filter_map(ask).collect()
    }

    #[test]
    fn an_input_watches_and_is_told() {
        let mut ports = connected();
        let [(watch, DatabaseRequest::Watch { prefix })] = &asked(&mut ports)[..] else { panic!("one watch") };
        assert_eq!(prefix, "team/claim/");
        assert_eq!(ports.deliver(*watch, Ok(DatabaseAnswer::Begin)), Ok(()));
        let (port, bytes) = ports.news(Time::ZERO).remove(0);
        let news = KeyNews { keys: "team/claim/".into(), event: WatchEvent::Begin };
        assert_eq!((port.as_str(), postcard::from_bytes(&bytes)), ("Claims", Ok(news)));
        assert_eq!(ports.orders(), [DatabaseOrder::Taken { number: *watch }]);
        // Requests of the controller itself do not belong to ports.
        assert_eq!(ports.deliver(1, Ok(DatabaseAnswer::Begin)), Err(Ok(DatabaseAnswer::Begin)));
    }

    #[test]
    fn what_an_output_puts_is_answered_with_its_number() {
        let mut ports = connected();
        asked(&mut ports);
        let sent = |put: &KeyPut| postcard::to_stdvec(put).unwrap();
        let put = KeyPut::new(7, "team/claim/cup", "r1", WITHIN).expecting(Expected::Absent);
        ports.sent("Claim", &sent(&put));
        ports.sent("Claim", &sent(&KeyPut::new(8, "team/other", "r1", WITHIN)));
        ports.sent("Other", &sent(&put));
        let [(request, DatabaseRequest::Transact(transaction))] = &asked(&mut ports)[..] else { panic!("one put") };
        assert_eq!((transaction.requires.len(), transaction.writes.len()), (1, 1));
        let version = TxnId { origin: 1, seq: 2 };
        assert_eq!(ports.deliver(*request, Ok(DatabaseAnswer::Committed(version))), Ok(()));
        let answers: Vec<KeyAnswer> =
            ports.news(Time::ZERO).iter().map(|(_, bytes)| postcard::from_bytes(bytes).unwrap()).collect();
        assert!(matches!(&answers[0], KeyAnswer { number: 8, result: KeyResult::Refused(_) }), "{answers:?}");
        assert_eq!(answers[1], KeyAnswer { number: 7, result: KeyResult::Committed(version) });
        ports.sent("Claim", &sent(&put));
        let late = ports.news(Time::ZERO + WITHIN).remove(0);
        assert!(matches!(postcard::from_bytes(&late.1), Ok(KeyAnswer { number: 7, result: KeyResult::Unknown(_) })));
        assert!(ports.feeds("Claims") && !ports.feeds("Claim"));
    }
}
