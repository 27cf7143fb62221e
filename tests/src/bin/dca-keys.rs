//! Controllers for tests with the database: one writes keys at 100 Hz, one watches them, one counts at a shared key,
//! one claims keys, and one has a secret. Each writes down the answers it receives.

use controllers::sdk::{
    About, Arguments, Configured, Controller, Database, DatabaseError, DatabaseRefusal, Entry, Every, Expected, Inputs,
    KeyAnswer, KeyNews, KeyPut, KeyResult, Kind, Out, Outputs, Parameter, Progress, Registry, Tick, Transaction, TxnId,
    Value, WatchEvent, process,
};
use std::fs::{File, OpenOptions};
use std::io::Write;
use std::process::ExitCode;
use std::time::Duration;

/// How often the writer writes.
const PERIOD: Duration = Duration::from_millis(10);
/// The longest time for an answer. The disk of a test's machine is sometimes slow.
const WITHIN: Duration = Duration::from_secs(5);

#[derive(Outputs)]
struct Asks {
    #[database]
    database: Database,
}

/// A file of lines. Each line is complete once it was written.
struct Log(File);

impl Log {
    fn open(arguments: &Arguments) -> Result<Self, String> {
        let opened = OpenOptions::new().create(true).append(true).open(arguments.text("file"));
        opened.map(Self).map_err(|error| error.to_string())
    }

    fn add(&mut self, line: &str) {
        self.0.write_all(format!("{line}\n").as_bytes()).expect("the folder is the test's own");
    }
}

const fn text(name: &'static str) -> Parameter {
    Parameter::new(name, Kind::Text(&[]))
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "it is small and positive")]
fn count(arguments: &Arguments, name: &str) -> u64 {
    arguments.number(name) as u64
}

/// Writes the time in nanoseconds to some keys below a prefix, all in one transaction. Its lines are `committed 1234`,
/// `refused WHY` or `unknown WHY`.
struct Writer {
    prefix: String,
    keys: u64,
    log: Log,
}

impl Controller for Writer {
    type Inputs = ();
    type Outputs = Asks;
    const TYPE: &'static str = "Writer";

    fn about() -> About {
        const PARAMETERS: &[Parameter] =
            &[text("prefix"), Parameter::new("keys", Kind::Number(1.0, 1000.0)), text("file")];
        About::service("Writes keys at 100 Hz.").every(PERIOD).with(PARAMETERS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let (prefix, keys) = (arguments.text("prefix").to_owned(), count(arguments, "keys"));
        Ok(Self { prefix, keys, log: Log::open(arguments)? })
    }

    fn main_calc(&mut self, tick: Tick, (): &(), outputs: &mut Asks) -> Progress {
        let now = i64::try_from(tick.now.nanos()).unwrap_or(i64::MAX);
        let put = |all: Transaction, key| all.put(format!("{}{key}", self.prefix), now);
        let all = (0..self.keys).fold(Transaction::new("a test writes"), put);
        outputs.database.transact(all, WITHIN);
        while let Some((_, result)) = outputs.database.committed() {
            self.log.add(&told(&result));
        }
        Progress::Continue
    }
}

fn told(result: &Result<TxnId, DatabaseError>) -> String {
    match result {
        Ok(version) => format!("committed {version}"),
        Err(DatabaseError::Refused(why)) => format!("refused {why}"),
        Err(DatabaseError::Unknown(why)) => format!("unknown {why}"),
    }
}

/// Writes down the news about the keys below a prefix: `begin`, `present 3`, `complete`, and for each change `changed
/// 1234 5 9b01c34e5f6a7788:3`. Such a line has the time, the number of keys and the transaction, then the value of each
/// key.
struct Watcher {
    prefix: String,
    log: Log,
}

impl Controller for Watcher {
    type Inputs = ();
    type Outputs = Asks;
    const TYPE: &'static str = "Watcher";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[text("prefix"), text("file")];
        About::service("Watches keys.").every(10 * PERIOD).triggered_by("database").with(PARAMETERS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self { prefix: arguments.text("prefix").to_owned(), log: Log::open(arguments)? })
    }

    fn main_calc(&mut self, tick: Tick, (): &(), outputs: &mut Asks) -> Progress {
        if tick.elapsed == 10 * PERIOD && !self.prefix.is_empty() {
            outputs.database.watch(std::mem::take(&mut self.prefix));
        }
        while let Some((_, event)) = outputs.database.event() {
            let line = match event {
                WatchEvent::Begin => "begin".to_owned(),
                WatchEvent::Present(entries) => format!("present {}", entries.len()),
                WatchEvent::Complete => "complete".to_owned(),
                WatchEvent::Changed(change) => {
                    let values: Vec<String> = change.entries.iter().map(shown).collect();
                    format!("changed {} {} {} {}", tick.now.nanos(), values.len(), change.version, values.join(" "))
                }
                WatchEvent::Refused(why) => format!("refused {why}"),
            };
            self.log.add(&line);
        }
        Progress::Continue
    }
}

fn shown(entry: &Entry) -> String {
    let number = entry.value.as_ref().and_then(|stored| i64::try_from(stored.value()).ok());
    number.map_or("-".to_owned(), |number| number.to_string())
}

/// Adds one to a key a number of times, and is then done. Other programs may count at the same key. Its lines are
/// `committed 3` or `unmet`.
struct Counter {
    key: String,
    left: u64,
    log: Log,
    next: Next,
}

/// The next step of a counter.
enum Next {
    Read,
    Wait,
}

impl Counter {
    fn read(&mut self, value: Option<Entry>, database: &mut Database) {
        let expected = value.as_ref().map_or(Expected::Absent, |entry| Expected::Version(entry.version));
        let before = value.and_then(|entry| entry.value).map_or(Value::Integer(0), |stored| stored.value());
        let number = i64::try_from(before).expect("only counters write there") + 1;
        database.put(self.key.clone(), number, Some(expected), WITHIN);
    }
}

impl Controller for Counter {
    type Inputs = ();
    type Outputs = Asks;
    const TYPE: &'static str = "Counter";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[text("key"), Parameter::new("times", Kind::Number(1.0, 1e6)), text("file")];
        About::task("Counts at a key.").every(PERIOD).triggered_by("database").with(PARAMETERS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let (key, left) = (arguments.text("key").to_owned(), count(arguments, "times"));
        Ok(Self { key, left, log: Log::open(arguments)?, next: Next::Read })
    }

    fn main_calc(&mut self, _: Tick, (): &(), outputs: &mut Asks) -> Progress {
        let database = &mut outputs.database;
        while let Some((_, result)) = database.value() {
            match result {
                Ok(value) => self.read(value, database),
                Err(why) => return Progress::Aborted(why.to_string()),
            }
        }
        while let Some((_, result)) = database.committed() {
            self.next = Next::Read;
            match result {
                Ok(_) => {
                    self.left = self.left.saturating_sub(1);
                    self.log.add("committed");
                }
                Err(DatabaseError::Refused(DatabaseRefusal::Unmet { .. })) => self.log.add("unmet"),
                Err(why) => return Progress::Aborted(why.to_string()),
            }
        }
        if self.left == 0 {
            return Progress::Done(Vec::new());
        }
        if matches!(self.next, Next::Read) {
            self.next = Next::Wait;
            database.get(self.key.clone(), WITHIN);
        }
        Progress::Continue
    }
}

#[derive(Inputs)]
struct Hears {
    /// The claims of all claimers.
    #[port("Claims")]
    claims: Every<KeyNews>,
    /// The answers to the claims of this claimer.
    #[port("Answers")]
    answers: Every<KeyAnswer>,
}

#[derive(Outputs)]
struct Claims {
    #[port("Claim")]
    claim: Out<KeyPut>,
}

/// Claims numbered keys through its ports, one after the other, each if it is free: `committed 3`, `refused 3`. It also
/// writes down the news: `complete`, `changed 3`. It is done when it has received the news of all keys.
struct Claimer {
    count: u64,
    next: u64,
    known: u64,
    log: Log,
}

impl Claimer {
    fn hear(&mut self, entries: &[Entry]) {
        for entry in entries {
            self.known += 1;
            self.log.add(&format!("changed {}", entry.key));
        }
    }
}

impl Controller for Claimer {
    type Inputs = Hears;
    type Outputs = Claims;
    const TYPE: &'static str = "Claimer";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[Parameter::new("count", Kind::Number(1.0, 1000.0)), text("file")];
        About::task("Claims keys.").every(PERIOD).with(PARAMETERS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self { count: count(arguments, "count"), next: 0, known: 0, log: Log::open(arguments)? })
    }

    fn main_calc(&mut self, _: Tick, inputs: &Hears, outputs: &mut Claims) -> Progress {
        for news in inputs.claims.iter() {
            match &news.event {
                WatchEvent::Complete => self.log.add("complete"),
                WatchEvent::Changed(change) => self.hear(&change.entries),
                WatchEvent::Present(entries) => self.hear(entries),
                WatchEvent::Begin => {}
                WatchEvent::Refused(why) => return Progress::Aborted(why.to_string()),
            }
        }
        for KeyAnswer { number, result } in inputs.answers.iter() {
            match result {
                KeyResult::Committed(_) => self.log.add(&format!("committed {number}")),
                KeyResult::Refused(DatabaseRefusal::Unmet { .. }) => self.log.add(&format!("refused {number}")),
                KeyResult::Refused(why) => return Progress::Aborted(why.to_string()),
                KeyResult::Unknown(why) => return Progress::Aborted(why.clone()),
            }
        }
        if self.next < self.count {
            self.next += 1;
            let key = format!("team/claim/{}", self.next);
            outputs.claim.send(KeyPut::new(self.next, key, "mine", WITHIN).expecting(Expected::Absent));
        }
        if self.known < self.count { Progress::Continue } else { Progress::Done(Vec::new()) }
    }
}

/// Has a secret. It shows each value of the secret with all letters moved by 13 places: `made Fjbeqsvfu`, `changed
/// Fjbeqsvfu`.
struct Keeper(Log);

impl Keeper {
    fn show(&mut self, word: &str, arguments: &Arguments) -> Result<(), String> {
        let secret = arguments.secret("password").map_err(|error| error.to_string())?;
        let shown: String = secret.iter().map(|byte| char::from(moved(*byte))).collect();
        self.0.add(&format!("{word} {shown}"));
        Ok(())
    }
}

const fn moved(byte: u8) -> u8 {
    match byte {
        b'A'..=b'Z' => b'A' + (byte - b'A' + 13) % 26,
        b'a'..=b'z' => b'a' + (byte - b'a' + 13) % 26,
        other => other,
    }
}

impl Controller for Keeper {
    type Inputs = ();
    type Outputs = ();
    const TYPE: &'static str = "Keeper";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[Parameter::new("password", Kind::Secret), text("file")];
        About::service("Has a secret.").every(10 * PERIOD).with(PARAMETERS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let mut keeper = Self(Log::open(arguments)?);
        keeper.show("made", arguments)?;
        Ok(keeper)
    }

    fn configure(&mut self, arguments: &Arguments) -> Result<Configured, String> {
        self.show("changed", arguments)?;
        Ok(Configured::Now)
    }

    fn main_calc(&mut self, _: Tick, (): &(), (): &mut ()) -> Progress {
        Progress::Continue
    }
}

fn main() -> ExitCode {
    let mut registry = Registry::default();
    registry.add::<Writer>();
    registry.add::<Watcher>();
    registry.add::<Counter>();
    registry.add::<Claimer>();
    registry.add::<Keeper>();
    process::run(&registry)
}
