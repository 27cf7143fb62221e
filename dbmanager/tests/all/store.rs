//! The store on a real disk, with a replica, and their faults: power cuts, kills, full and failing disks, flipped
//! bits, copies.

#![expect(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "all of it is test code; what was skipped or found is said"
)]

mod child;
mod damage;
mod disk;
mod identity;
mod laws;
mod platter;
mod power_cut;
mod trace;

use comms::logic::time::Time;
use dbmanager::io::store::{DirStore, Engine, Store, StoreError};
use dbmanager::logic::clock::Wall;
use dbmanager::logic::key::Key;
use dbmanager::logic::record::Batch;
use dbmanager::logic::replica::{AckLevel, Answer, CommitRequest, Config, Effect, Input, Replica};
use dbmanager::logic::txn::{Draft, Value};
use dbmanager::logic::version_vector::Dot;
use std::cell::Cell;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

thread_local! {
    /// The engine with which stores are made.
    static ENGINE: Cell<Engine> = const { Cell::new(Engine::Redb) };
}

/// Runs a check on one engine after the other.
fn on_each_engine(check: impl Fn()) {
    for engine in Engine::ALL {
        println!("on {engine}:");
        ENGINE.set(engine);
        check();
    }
}

/// Opens a store, or makes one with the engine of this check.
fn open(path: &Path) -> Result<DirStore, StoreError> {
    DirStore::open_on(Some(ENGINE.get()), path)
}

/// A folder that is removed after the test.
struct Folder(PathBuf);

impl Folder {
    /// Returns a folder on the disk.
    fn new() -> Self {
        Self::below(&std::env::temp_dir())
    }

    /// Returns a folder in memory, if possible: for tests of the order of writes, which do not need a disk.
    fn quick() -> Self {
        let memory = Path::new("/dev/shm");
        if memory.is_dir() { Self::below(memory) } else { Self::new() }
    }

    fn below(parent: &Path) -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let name = format!("dca-store-{}-{}", std::process::id(), NUMBER.fetch_add(1, Ordering::Relaxed));
        let folder = parent.join(name);
        fs::create_dir(&folder).unwrap();
        Self(folder)
    }

    fn store(&self) -> PathBuf {
        self.0.join("db")
    }

    /// Returns the file in which the store has its records.
    fn records(&self) -> PathBuf {
        ENGINE.get().data(&self.store())
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        drop(fs::remove_dir_all(&self.0));
    }
}

fn batch(changes: &[(&[u8], Option<Vec<u8>>)]) -> Batch {
    Batch(changes.iter().map(|(name, record)| (name.to_vec(), record.clone())).collect())
}

fn put_text(key: &str, text: &str) -> Draft {
    let value = Value { bytes: text.as_bytes().into(), ..Value::from(b"") };
    Draft::new("test").put(Key::new(key).unwrap(), value)
}

fn config() -> Config {
    Config { robot: "r".into(), seed: 1, log_size: 64 << 10 }
}

/// A robot that is alone in its team, on any store.
struct Robot<S> {
    replica: Replica,
    store: S,
    now: Time,
}

impl<S: Store> Robot<S> {
    /// Opens the replica in a store, and makes it the first member of its team.
    fn open(store: S) -> Result<Self, String> {
        let stored = store.read().map_err(|error| error.to_string())?;
        let replica = Replica::open(config(), stored).map_err(|error| error.to_string())?;
        let mut robot = Self { replica, store, now: Time::ZERO };
        robot.tell(Input::Found(Wall::default()))?;
        Ok(robot)
    }

    /// Returns the number of its own transactions that are durable.
    fn committed(&self) -> u64 {
        self.replica.log().vector().get(self.replica.origin())
    }

    /// Commits all drafts together; returns when all are durable.
    fn commit(&mut self, drafts: impl IntoIterator<Item = Draft>) -> Result<(), String> {
        let request = |draft| CommitRequest { ticket: 1, draft, level: AckLevel::Local, until: Time::ZERO };
        let requests: Vec<CommitRequest> = drafts.into_iter().map(request).collect();
        let count = requests.len();
        let committed = self.tell(Input::Commit(requests, Wall::default()))?;
        assert_eq!(committed.len(), count);
        Ok(())
    }

    /// Processes an input, and lets time pass; returns the committed transactions.
    fn tell(&mut self, input: Input) -> Result<Vec<Dot>, String> {
        self.now = self.now + Duration::from_millis(10);
        let mut effects = Vec::new();
        self.replica.handle(self.now, input, &mut effects);
        if self.replica.deadline().is_some_and(|deadline| deadline <= self.now) {
            self.replica.handle(self.now, Input::Tick(Wall::default()), &mut effects);
        }
        let mut committed = Vec::new();
        for effect in effects {
            if let Effect::Persist(batch) = effect {
                self.store.commit(&batch).map_err(|error| error.to_string())?;
            } else if let Effect::Answer(_, answer) = effect {
                let Answer::Committed(dot) = answer else { panic!("{answer:?}") };
                committed.push(dot);
            }
        }
        Ok(committed)
    }
}
