//! The real store on a real disk, and the replica on top of it.

use comms::logic::time::Time;
use dbmanager::io::store::memory::MemoryStore;
use dbmanager::io::store::{DirStore, Store, StoreError};
use dbmanager::logic::clock::Wall;
use dbmanager::logic::key::Key;
use dbmanager::logic::mutant::Mutant;
use dbmanager::logic::record::{Batch, OpenError, Records};
use dbmanager::logic::replica::{Answer, Config, Effect, Input, Level, Replica, Request};
use dbmanager::logic::txn::{Draft, Encoding, VALUE_SIZE_MAX, Value};
use std::fs;
use std::path::PathBuf;
use std::sync::atomic::{AtomicU32, Ordering};

/// A directory that is gone after the test.
struct Dir(PathBuf);

impl Dir {
    fn new() -> Self {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let name = format!("dca-store-{}-{}", std::process::id(), NUMBER.fetch_add(1, Ordering::Relaxed));
        Self(std::env::temp_dir().join(name).join("db"))
    }
}

impl Drop for Dir {
    fn drop(&mut self) {
        drop(fs::remove_dir_all(self.0.parent().expect("it was joined to one")));
    }
}

fn batch(changes: &[(&[u8], Option<Vec<u8>>)]) -> Batch {
    Batch(changes.iter().map(|(name, record)| (name.to_vec(), record.clone())).collect())
}

#[test]
fn what_is_committed_is_there_again() {
    let dir = Dir::new();
    let mut expected = Records::new();
    let long = |size: usize| Some((0..size).map(|byte| u8::try_from(byte % 251).unwrap()).collect());
    let steps = [
        batch(&[(b"a", long(3)), (b"ab", long(0)), (b"a\0\0", long(8192))]),
        batch(&[(b"a", long(200_000)), (b"ab", None)]),
        batch(&[(b"a", long(8193)), (b"b", long(100)), (b"nothing", None)]),
        batch(&[(b"a", long(1))]),
    ];
    for step in steps {
        let mut store = DirStore::open(&dir.0).unwrap();
        store.commit(&step).unwrap();
        step.apply(&mut expected);
        assert_eq!(store.load().unwrap(), expected);
        drop(store);
        assert_eq!(DirStore::open(&dir.0).unwrap().load().unwrap(), expected);
    }
}

#[test]
fn long_records_make_no_blobs() {
    let dir = Dir::new();
    let mut store = DirStore::open(&dir.0).unwrap();
    for number in 0..100_u32 {
        store.commit(&batch(&[(&number.to_be_bytes(), Some(vec![7; 64 << 10]))])).unwrap();
    }
    assert_eq!(fs::read_dir(dir.0.join("blobs")).unwrap().count(), 0);
}

#[test]
fn open_twice_same_dir() {
    let dir = Dir::new();
    let first = DirStore::open(&dir.0).unwrap();
    assert!(matches!(DirStore::open(&dir.0), Err(StoreError::Engine { .. })));
    drop(first);
    DirStore::open(&dir.0).unwrap();
}

#[test]
fn conf_file_empty() {
    let dir = Dir::new();
    let written = batch(&[(b"a", Some(vec![1]))]);
    DirStore::open(&dir.0).unwrap().commit(&written).unwrap();
    fs::write(dir.0.join("conf"), "").unwrap();
    // Whatever the engine makes of it: it may refuse, but not begin anew as if nothing had been.
    if let Ok(store) = DirStore::open(&dir.0) {
        assert_eq!(store.load().unwrap().len(), 1);
    }
    let aside = DirStore::put_aside(&dir.0).unwrap();
    assert!(aside.join("db").exists() && !dir.0.exists());
    assert!(DirStore::open(&dir.0).unwrap().load().unwrap().is_empty());
}

#[test]
fn a_store_of_somebody_else_is_left_alone() {
    let dir = Dir::new();
    let other = sled::open(&dir.0).unwrap();
    other.insert("theirs", "1").unwrap();
    drop(other);
    assert!(matches!(DirStore::open(&dir.0), Err(StoreError::Foreign { .. })));
}

fn config() -> Config {
    Config { robot: "r".into(), seed: 1, log_size: 1 << 20, mutant: Mutant::None }
}

/// Commits a value; returns the answers, none of which is given unless the store has it.
fn put(replica: &mut Replica, store: &mut impl Store, key: &str, value: Value) -> Vec<Answer> {
    let draft = Draft::new("test").put(Key::new(key).expect("tests use keys"), value);
    let request = Request { ticket: 1, draft, level: Level::Local, until: Time::ZERO };
    run(replica, store, Input::Commit(vec![request], Wall::default()))
}

fn run(replica: &mut Replica, store: &mut impl Store, input: Input) -> Vec<Answer> {
    let (mut effects, mut answers) = (Vec::new(), Vec::new());
    replica.handle(Time::ZERO, input, &mut effects);
    for effect in effects {
        match effect {
            Effect::Persist(batch) if store.commit(&batch).is_err() => break,
            Effect::Answer(_, answer) => answers.push(answer),
            Effect::Persist(_) | Effect::Broadcast(_) | Effect::Send(..) | Effect::Visible(..) => {}
            Effect::Renamed(..) | Effect::Replaced | Effect::Alarm(_) => {}
        }
    }
    answers
}

#[test]
fn a_replica_is_there_again() {
    let dir = Dir::new();
    let value = |byte| Value { encoding: Encoding::Bytes, bytes: vec![byte; VALUE_SIZE_MAX].into() };
    let mut digest = 0;
    for boot in 0..3_u8 {
        let mut store = DirStore::open(&dir.0).unwrap();
        let mut replica = Replica::open(config(), &store.load().unwrap()).unwrap();
        assert_eq!(replica.state().digest(), digest);
        run(&mut replica, &mut store, Input::Found(Wall::default()));
        for key in ["a", "b", "c"] {
            assert!(matches!(put(&mut replica, &mut store, key, value(boot))[..], [Answer::Committed(_)]));
        }
        assert!(replica.is_member());
        digest = replica.state().digest();
    }
}

#[test]
fn disk_full_then_freed() {
    let mut store = MemoryStore::default().failing_after(2);
    let mut replica = Replica::open(config(), &Records::new()).unwrap();
    run(&mut replica, &mut store, Input::Found(Wall::default()));
    assert_eq!(put(&mut replica, &mut store, "a", b"1".into()).len(), 1);
    assert_eq!(put(&mut replica, &mut store, "b", b"2".into()), [], "nothing is promised that the disk does not have");
    let again = Replica::open(config(), &store.load().unwrap()).unwrap();
    assert!(
        again.state().get(&Key::new("a").unwrap()).is_some() && again.state().get(&Key::new("b").unwrap()).is_none()
    );
}

#[test]
fn bit_flip_in_log_tail_middle_kv() {
    let mut store = MemoryStore::default();
    let mut replica = Replica::open(config(), &Records::new()).unwrap();
    run(&mut replica, &mut store, Input::Found(Wall::default()));
    for key in ["a", "b", "c"] {
        put(&mut replica, &mut store, key, b"value".into());
    }
    let records = store.load().unwrap();
    for (name, record) in &records {
        for byte in 0..record.len() {
            let mut damaged = records.clone();
            damaged.get_mut(name).unwrap()[byte] ^= 4;
            assert!(matches!(Replica::open(config(), &damaged), Err(OpenError::Record { .. })), "{name:?} {byte}");
        }
        let mut lost = records.clone();
        lost.remove(name);
        let refused = Replica::open(config(), &lost).unwrap_err();
        assert!(matches!(refused, OpenError::Damaged { .. }), "{name:?}: {refused}");
    }
}
