//! The questions that programs ask the database of their node: which keys programs may use, and the form of questions and answers.
//!
//! A program reads every key except those below `sys/`. It writes below `team/`, below `robot/ROBOT/` of its own robot,
//! and below `local/`. Some of these keys steer programs and nodes: parameters, settings, records of deployments, and
//! schemas. They are reserved for users. In a team with keys, a program writes only the keys with which its spec
//! connects it, because a user has signed the spec.

use super::question::{AckLevel, Commit, Question, Reply};
use comms::logic::control::KeyPort;
use comms::logic::database::{
    Change, DatabaseAnswer, DatabaseRefusal, Entry, Expected, KeyWrite, REQUESTS_MAX, Requirement, Stored,
    TRANSACTION_SIZE_MAX, Transaction, TxnId, VALUE_SIZE_MAX, WATCHES_MAX,
};
use dbmanager::logic::key::{Key, Namespace};
use dbmanager::logic::state::{Version, differ};
use dbmanager::logic::txn::{Condition, Encoding, Require, Value, Write};
use dbmanager::logic::version_vector::{Dot, ReplicaId};
use dbmanager::logic::view::past::Keys;
use dbmanager::logic::view::schema::SCHEMA;
use dbmanager::logic::view::value::Datum;
use dbmanager::logic::view::watch::{Event, Notification};
use std::time::Duration;

/// The keys below `robot/ROBOT/` that are reserved for users and for the node itself.
const FOR_PEOPLE: [&str; 3] = ["params", "node", "deployments"];
/// A commit waits only for the local disk, and for nothing else.
const WITHIN: Duration = Duration::ZERO;

/// The keys that the programs of a node may use.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Access {
    /// Name of the robot.
    pub robot: String,
    /// Whether the node is in a team with keys.
    pub is_team: bool,
}

impl Access {
    /// Returns the question for the value of a key.
    ///
    /// # Errors
    /// The text is not a key, or programs may not read the key.
    pub fn get(&self, key: String) -> Result<Question, DatabaseRefusal> {
        let key = readable(key)?;
        Ok(Question::Get { key })
    }

    /// Returns the question for a key, or for the keys below a prefix that ends in `/`.
    ///
    /// # Errors
    /// The text is not a key or a prefix, or programs may not read it.
    pub fn follow(&self, prefix: &str) -> Result<Question, DatabaseRefusal> {
        let key = readable(prefix.strip_suffix('/').unwrap_or(prefix).to_owned())?;
        let keys = if prefix.ends_with('/') { Keys::Below(prefix.to_owned()) } else { Keys::Only(key) };
        Ok(Question::Follow { keys })
    }

    /// Returns the question for a transaction of a program with these ports.
    ///
    /// # Errors
    /// A part of the transaction is not a key, is too long, or is not permitted to programs.
    pub fn transact(&self, transaction: Transaction, ports: &[KeyPort]) -> Result<Question, DatabaseRefusal> {
        check_sizes(&transaction)?;
        let Transaction { reason, requires, writes } = transaction;
        let requires: Result<_, _> = requires.into_iter().map(required).collect();
        let writes: Result<_, _> = writes.into_iter().map(|write| self.written(write, ports)).collect();
        let (requires, writes) = (requires?, writes?);
        Ok(Question::Commit(Commit { reason, requires, writes, level: AckLevel::Local, within: WITHIN }))
    }

    fn written(&self, write: KeyWrite, ports: &[KeyPort]) -> Result<Write, DatabaseRefusal> {
        let key = readable(write.key)?;
        if let Some(why) = self.forbids(&key, ports) {
            return Err(DatabaseRefusal::NotAllowed { key: key.to_string(), why });
        }
        let value = write.value.map(|Stored { tag, bytes }| Value { encoding: Encoding(tag), bytes: bytes.0.into() });
        Ok(Write { key, value })
    }

    /// Returns why programs may not write a key. Nothing if they may write it.
    fn forbids(&self, key: &Key, ports: &[KeyPort]) -> Option<String> {
        let is_connected = || ports.iter().any(|port| port.is_write && port.covers(key.as_str()));
        if self.is_team && !is_connected() {
            return Some(format!(
                "`{key}` is not written by this program: in a team its spec says which keys it writes, such as `robot, database -> \
                 db(\"team/flat/**\");`"
            ));
        }
        let for_people = match key.namespace() {
            Namespace::Robot(robot) => {
                let below = key.as_str().split('/').nth(2).unwrap_or_default();
                robot == self.robot && FOR_PEOPLE.contains(&below)
            }
            Namespace::Team => key.as_str().starts_with(SCHEMA),
            Namespace::Local | Namespace::System => false,
        };
        for_people.then(|| format!("`{key}` cannot be written by programs: it holds orders for nodes and programs"))
    }
}

fn readable(key: String) -> Result<Key, DatabaseRefusal> {
    let key = Key::new(key).map_err(|why| DatabaseRefusal::Database { why: why.to_string() })?;
    if key.namespace() == Namespace::System {
        let why = format!("`{key}` is reserved for the database itself");
        return Err(DatabaseRefusal::NotAllowed { key: key.to_string(), why });
    }
    Ok(key)
}

fn check_sizes(transaction: &Transaction) -> Result<(), DatabaseRefusal> {
    let too_large = |size: usize, size_max: usize| {
        let number = |size: usize| u64::try_from(size).unwrap_or(u64::MAX);
        Err(DatabaseRefusal::TooLarge { size: number(size), size_max: number(size_max) })
    };
    let value = |write: &KeyWrite| write.value.as_ref().map_or(0, |value| value.bytes.0.len());
    if let Some(size) = transaction.writes.iter().map(value).find(|size| *size > VALUE_SIZE_MAX) {
        return too_large(size, VALUE_SIZE_MAX);
    }
    let writes: usize = transaction.writes.iter().map(|write| write.key.len() + value(write)).sum();
    let size = writes + transaction.requires.iter().map(|require| require.key.len()).sum::<usize>();
    if size > TRANSACTION_SIZE_MAX { too_large(size, TRANSACTION_SIZE_MAX) } else { Ok(()) }
}

fn required(Requirement { key, expected }: Requirement) -> Result<Require, DatabaseRefusal> {
    let condition = match expected {
        Expected::Absent => Condition::Absent,
        Expected::Exists => Condition::Exists,
        Expected::Version(TxnId { origin, seq }) => Condition::Is(Dot { origin: ReplicaId::new(origin), seq }),
    };
    Ok(Require { key: readable(key)?, condition })
}

/// Returns the refusal of a request if the limit of unanswered requests is reached.
pub fn busy() -> DatabaseRefusal {
    DatabaseRefusal::Busy { waiting: u32::try_from(REQUESTS_MAX).unwrap_or(u32::MAX) }
}

/// Returns the refusal of a watch if the limit of watches is reached.
pub fn watches_enough() -> DatabaseRefusal {
    DatabaseRefusal::Database { why: format!("a program watches {WATCHES_MAX} keys or prefixes at a time at most") }
}

/// Returns the answer to a `Get` or a `Transact`; nothing if the reply is just a note.
pub fn answer(reply: Reply) -> Option<DatabaseAnswer> {
    if matches!(reply, Reply::Note(_)) {
        return None;
    }
    if let Reply::Entries(entries) = reply {
        return Some(DatabaseAnswer::Value(present(entries).pop()));
    }
    if let Reply::Committed(dot) = reply {
        return Some(DatabaseAnswer::Committed(id(dot)));
    }
    if let Reply::Unknown(why) = reply {
        return Some(DatabaseAnswer::Unknown { why });
    }
    Some(DatabaseAnswer::Refused(refusal(reply)))
}

fn refusal(reply: Reply) -> DatabaseRefusal {
    if let Reply::Unmet { key, why } = reply {
        return DatabaseRefusal::Unmet { key: key.to_string(), why };
    }
    if let Reply::NotOwner { owner } = reply {
        return DatabaseRefusal::NotOwner { robot: owner };
    }
    let why = if let Reply::Refused(why) = reply { why } else { "it answered something that was not asked".to_owned() };
    DatabaseRefusal::Database { why }
}

/// Returns the next part of a watch; nothing if the watch has to begin again.
pub fn part(reply: Reply) -> Option<DatabaseAnswer> {
    if let Reply::Entries(entries) = reply {
        return Some(DatabaseAnswer::Present(present(entries)));
    }
    if let Reply::Version(_) = reply {
        return Some(DatabaseAnswer::Complete);
    }
    let Reply::Notification(Notification::Event(event)) = reply else { return None };
    let Event { entry, conflicts } = *event;
    let version = id(entry.dot);
    let changed = |(key, datum): (Key, Option<_>)| Entry {
        is_conflict: conflicts.contains(&key),
        key: key.to_string(),
        // A stored value can always be encoded again.
        value: datum.and_then(|datum: Datum| datum.encode().ok()).map(stored),
        version,
    };
    let entries = entry.changes.into_iter().map(changed).collect();
    Some(DatabaseAnswer::Changed(Change { version, by: entry.by, reason: entry.reason, entries }))
}

/// Returns the readable values of keys, without the deleted keys.
fn present(entries: Vec<(Key, Vec<Version>)>) -> Vec<Entry> {
    let shown = |(key, versions): (Key, Vec<Version>)| {
        let is_conflict = differ(&versions);
        let Version { dot, value, .. } = versions.into_iter().next_back()?;
        Some(Entry { key: key.to_string(), value: Some(stored(value?)), version: id(dot), is_conflict })
    };
    entries.into_iter().filter_map(shown).collect()
}

fn stored(value: Value) -> Stored {
    Stored { tag: value.encoding.0, bytes: value.bytes.to_vec().into() }
}

const fn id(dot: Dot) -> TxnId {
    TxnId { origin: dot.origin.number(), seq: dot.seq }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::logic::database;

    fn access(is_team: bool) -> Access {
        Access { robot: "r1".into(), is_team }
    }

    /// The ports of a program that may write everything that programs may write.
    fn all() -> [KeyPort; 2] {
        ["team/", "robot/r1/"].map(|keys| KeyPort { port: "database".into(), keys: keys.into(), is_write: true })
    }

    fn put(key: &str, size: usize) -> Transaction {
        let value = Some(Stored { tag: 0, bytes: vec![0; size].into() });
        Transaction { writes: vec![KeyWrite { key: key.into(), value }], ..Transaction::default() }
    }

    #[test]
    fn programs_write_what_is_neither_for_people_nor_for_the_database() {
        for key in ["team/flat/claim/cup", "robot/r1/map", "local/last", "robot/r2/params/x", "robot/r1/parameters"] {
            assert!(access(false).transact(put(key, 1), &[]).is_ok(), "{key}");
            let refused = access(true).transact(put(key, 1), &[]);
            assert!(matches!(&refused, Err(DatabaseRefusal::NotAllowed { .. })), "{key}: {refused:?}");
        }
        for key in [
            "robot/r1/params/a/b/c",
            "robot/r1/node/log",
            "robot/r1/deployments/a/1/begun",
            "team/schema/x",
            "sys/members",
        ] {
            let refused = access(false).transact(put(key, 1), &all());
            assert!(matches!(&refused, Err(DatabaseRefusal::NotAllowed { .. })), "{key}: {refused:?}");
        }
        assert!(matches!(access(false).transact(put("team//x", 1), &[]), Err(DatabaseRefusal::Database { .. })));
    }

    #[test]
    fn in_a_team_a_program_writes_what_its_spec_connects() {
        let port = |keys: &str, is_write| KeyPort { port: "database".into(), keys: keys.into(), is_write };
        let ports = [port("team/flat/claim/", true), port("team/gain", true), port("team/other/", false)];
        for (key, may) in [
            ("team/flat/claim/cup", true),
            ("team/gain", true),
            ("team/gain2", false),
            ("team/flat/claimed", false),
            ("team/other/x", false),
        ] {
            assert_eq!(access(true).transact(put(key, 1), &ports).is_ok(), may, "{key}");
        }
        assert!(access(true).transact(put("robot/r1/params/x", 1), &all()).is_err());
    }

    #[test]
    fn programs_read_all_but_what_is_the_databases_own() {
        assert_eq!(access(true).get("team/a".into()), Ok(Question::Get { key: Key::new("team/a").unwrap() }));
        let below = Question::Follow { keys: Keys::Below("team/".into()) };
        assert_eq!(access(true).follow("team/"), Ok(below));
        let only = Question::Follow { keys: Keys::Only(Key::new("team/a").unwrap()) };
        assert_eq!(access(true).follow("team/a"), Ok(only));
        for prefix in ["sys/", "sys/members", "", "/", "team//", "team/*"] {
            assert!(access(false).follow(prefix).is_err(), "{prefix}");
        }
    }

    #[test]
    fn what_is_too_long_is_refused_with_the_limit() {
        let refused = |transaction| access(false).transact(transaction, &[]).unwrap_err().to_string();
        assert_eq!(
            refused(put("team/a", VALUE_SIZE_MAX + 1)),
            "65537 bytes are more than the 65536 that are allowed; write the parts to separate keys"
        );
        let many = (0..4).flat_map(|number| put(&format!("team/{number}"), VALUE_SIZE_MAX).writes).collect();
        assert!(refused(Transaction { writes: many, ..Transaction::default() }).starts_with("262168 bytes"));
    }

    /// The typed values of programs and those of users have the same bytes.
    #[test]
    fn values_are_those_of_the_database() {
        let table = database::Value::table([("x", 1.5.into()), ("on", true.into())]);
        let values = [
            (true.into(), "true"),
            (database::Value::from(-7), "-7"),
            (1.5.into(), "1.5"),
            ("text".into(), "\"text\""),
            (database::Value::List(vec![1.into(), "a".into(), table]), "[1, \"a\", {on = true, x = 1.5}]"),
        ];
        for (value, text) in values {
            let (theirs, ours) = (Datum::from_toml(text).unwrap().encode().unwrap(), Stored::from(&value));
            assert_eq!(stored(theirs), ours, "{text}");
            assert_eq!(ours.value(), value);
        }
    }

    #[test]
    fn each_reply_has_its_answer_and_only_a_commit_is_one() {
        let dot = Dot { origin: ReplicaId::new(7), seq: 2 };
        assert_eq!(answer(Reply::Note("x".into())), None);
        assert_eq!(answer(Reply::Entries(vec![])), Some(DatabaseAnswer::Value(None)));
        assert_eq!(answer(Reply::Committed(dot)), Some(DatabaseAnswer::Committed(TxnId { origin: 7, seq: 2 })));
        assert_eq!(answer(Reply::Unknown("x".into())), Some(DatabaseAnswer::Unknown { why: "x".into() }));
        let unmet = Reply::Unmet { key: Key::new("team/a").unwrap(), why: "x".into() };
        let refusal = DatabaseRefusal::Unmet { key: "team/a".into(), why: "x".into() };
        assert_eq!(answer(unmet), Some(DatabaseAnswer::Refused(refusal)));
        let refusal = DatabaseRefusal::NotOwner { robot: "r2".into() };
        assert_eq!(answer(Reply::NotOwner { owner: "r2".into() }), Some(DatabaseAnswer::Refused(refusal)));
        let words = DatabaseRefusal::Database { why: "full".into() };
        assert_eq!(answer(Reply::Refused("full".into())), Some(DatabaseAnswer::Refused(words)));
    }
}
