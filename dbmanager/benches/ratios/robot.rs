//! A robot that is alone in its team, on any store.

use crate::Failure;
use comms::io::clock;
use dbmanager::io::store::{DirStore, Engine, Store};
use dbmanager::logic::clock::Wall;
use dbmanager::logic::key::Key;
use dbmanager::logic::replica::{AckLevel, CommitRequest, Config, Effect, Input, Replica};
use dbmanager::logic::txn::{Draft, Value};
use std::path::Path;

/// The bytes of a key and of its value in all measurements of commits. With 29 bytes of identity and time, these are
/// 320 bytes.
pub(crate) const KEY_AND_VALUE: (usize, usize) = (35, 256);

/// A replica and its store.
pub(crate) struct Robot<S> {
    pub(crate) replica: Replica,
    store: S,
}

/// Returns the configuration of a robot.
pub(crate) fn config(robot: &str, seed: u64) -> Config {
    Config { robot: robot.to_owned(), seed, log_size: 1 << 20 }
}

/// Returns the key with a number. All keys have the same length.
pub(crate) fn key(number: u64) -> Result<Key, Failure> {
    Ok(Key::new(format!("team/parameters/arm/joint/{number:09}"))?)
}

/// Returns a value of `size` bytes that is different for each number.
pub(crate) fn value(number: u64, size: usize) -> Value {
    let bytes = number.to_le_bytes().into_iter().cycle().take(size);
    Value { bytes: bytes.collect(), ..Value::from(b"") }
}

/// Returns a request to write one value.
pub(crate) fn request(number: u64) -> Result<CommitRequest, Failure> {
    let draft = Draft::new("").put(key(number % 5000)?, value(number, KEY_AND_VALUE.1));
    Ok(CommitRequest { ticket: number, draft, level: AckLevel::Local, until: clock::now() })
}

impl Robot<DirStore> {
    /// Opens a robot on an engine, in a separate folder.
    pub(crate) fn on(engine: Engine, folder: &Path) -> Result<Self, Failure> {
        Self::open(DirStore::open_on(Some(engine), &folder.join(engine.name()))?)
    }
}

impl<S: Store> Robot<S> {
    /// Opens the replica in a store, and makes it the first member of its team.
    pub(crate) fn open(store: S) -> Result<Self, Failure> {
        let replica = Replica::open(config("r", 1), store.read()?)?;
        let mut robot = Self { replica, store };
        robot.tell(Input::Found(Wall::default()))?;
        Ok(robot)
    }

    /// Takes an input, and writes the durable effects to the disk; returns the other effects.
    pub(crate) fn tell(&mut self, input: Input) -> Result<Vec<Effect>, Failure> {
        let mut effects = Vec::new();
        self.replica.handle(clock::now(), input, &mut effects);
        let mut after = Vec::new();
        for effect in effects {
            if let Effect::Persist(batch) = effect {
                self.store.commit(&batch)?;
            } else {
                after.push(effect);
            }
        }
        Ok(after)
    }
}
