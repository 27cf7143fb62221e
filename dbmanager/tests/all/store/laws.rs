//! The laws of every store, for every engine.

use super::{Folder, Robot, batch, on_each_engine, open, put_text};
use dbmanager::io::store::memory::MemoryStore;
use dbmanager::io::store::{DirStore, Engine, Store, StoreError};
use dbmanager::logic::key::{KEY_SIZE_MAX, Key};
use dbmanager::logic::record::{Batch, Records};
use dbmanager::logic::txn::{Draft, VALUE_SIZE_MAX, Value};
use proptest::collection::{btree_map, vec};
use proptest::prelude::*;
use std::fs;

/// Writes batches, and reopens the store after each; its content has to match the batches.
fn check_batches(batches: &[Batch]) {
    let folder = Folder::quick();
    let mut expected = Records::new();
    for batch in batches {
        let mut store = open(&folder.store()).unwrap();
        assert_eq!(store.load().unwrap(), expected);
        store.commit(batch).unwrap();
        batch.apply(&mut expected);
        assert_eq!(store.load().unwrap(), expected);
    }
    assert_eq!(open(&folder.store()).unwrap().load().unwrap(), expected);
}

#[test]
fn what_is_committed_is_there_again() {
    on_each_engine(|| {
        let long = |size: usize| Some((0..size).map(|byte| u8::try_from(byte % 251).unwrap()).collect());
        let batches = [
            batch(&[(b"a", long(3)), (b"ab", long(0)), (b"a\0\0", long(8192))]),
            batch(&[(b"a", long(200_000)), (b"ab", None)]),
            batch(&[(b"a", long(8193)), (b"b", long(100)), (b"nothing", None)]),
            batch(&[(b"a", long(1))]),
            batch(&[]),
        ];
        check_batches(&batches);
    });
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn any_batches(batches in vec(btree_map(vec(0..4_u8, 0..4), proptest::option::of(vec(any::<u8>(), 0..9000)), 0..6), 1..6)) {
        let batches: Vec<Batch> = batches.into_iter().map(Batch).collect();
        on_each_engine(|| check_batches(&batches));
    }
}

/// Opens a robot repeatedly; its state has to stay the same.
#[test]
fn a_robot_is_there_again() {
    on_each_engine(|| {
        let folder = Folder::quick();
        let mut digest = None;
        for boot in 0..3 {
            let mut robot = Robot::open(open(&folder.store()).unwrap()).unwrap();
            assert!(digest.is_none_or(|digest| digest == robot.replica.state().digest()));
            robot
                .commit((0..100).map(|number| put_text(&format!("team/{}", number % 40), &format!("{boot}"))))
                .unwrap();
            assert!(robot.replica.is_member());
            digest = Some(robot.replica.state().digest());
        }
    });
}

#[test]
fn open_twice_same_dir() {
    on_each_engine(|| {
        let folder = Folder::quick();
        let first = open(&folder.store()).unwrap();
        let refused = open(&folder.store()).err().unwrap();
        assert!(matches!(refused, StoreError::Busy { .. }), "{refused}");
        let words = refused.to_string();
        assert!(words.contains("is open already; end the other program"), "{words}");
        drop(first);
        open(&folder.store()).unwrap();
    });
}

#[test]
fn max_key_value_sizes() {
    on_each_engine(|| {
        let folder = Folder::quick();
        let long = |name: usize| Key::new(format!("team/{name:0width$}", width = KEY_SIZE_MAX - 5)).unwrap();
        let value = |byte: u8| Value { bytes: vec![byte; VALUE_SIZE_MAX].into(), ..Value::from(b"") };
        let mut robot = Robot::open(open(&folder.store()).unwrap()).unwrap();
        robot.commit([(0..3).fold(Draft::new("long"), |draft, name| draft.put(long(name), value(b'a')))]).unwrap();
        drop(robot);
        let robot = Robot::open(open(&folder.store()).unwrap()).unwrap();
        let found = robot.replica.state().get(&long(2)).unwrap();
        assert_eq!(found.value, Some(value(b'a')));
        assert_eq!(Robot::open(MemoryStore::default()).unwrap().committed(), 1);
    });
}

#[test]
fn what_is_too_long_is_refused() {
    on_each_engine(|| {
        let folder = Folder::quick();
        for (name, size) in [(vec![0; 1 << 16], 1), (vec![1], 1 << 27)] {
            let mut store = open(&folder.store()).unwrap();
            let refused = store.commit(&batch(&[(b"a", Some(vec![7])), (&name, Some(vec![0; size]))])).unwrap_err();
            assert!(matches!(refused, StoreError::Long { .. }), "{refused}");
            drop(store);
            assert!(open(&folder.store()).unwrap().load().unwrap().is_empty());
        }
    });
}

/// A hundred thousand writes, in groups: space has to be used again.
#[test]
fn key_written_1m_times() {
    on_each_engine(|| {
        let folder = Folder::quick();
        let mut robot = Robot::open(open(&folder.store()).unwrap()).unwrap();
        for round in 0..1000 {
            robot.commit((0..100).map(|number| put_text("team/one", &format!("{round} {number}")))).unwrap();
        }
        drop(robot);
        let size = fs::metadata(folder.records()).unwrap().len();
        println!("one key, 100,000 times: {size} bytes");
        assert!(size <= 16 << 20, "the file has {size} bytes");
        let robot = Robot::open(open(&folder.store()).unwrap()).unwrap();
        let found = robot.replica.state().get(&Key::new("team/one").unwrap()).unwrap();
        assert_eq!(&found.value.as_ref().unwrap().bytes[..], b"999 99");
    });
}

/// The engine is chosen when the folder is made, and does not change.
#[test]
fn an_engine_is_kept_with_the_folder() {
    for (engine, other) in [(Engine::Redb, Engine::Sled), (Engine::Sled, Engine::Redb)] {
        let folder = Folder::quick();
        let mut store = DirStore::open_on(Some(engine), &folder.store()).unwrap();
        store.commit(&batch(&[(b"a", Some(vec![1]))])).unwrap();
        drop(store);
        let store = DirStore::open(&folder.store()).unwrap();
        assert_eq!((store.engine(), store.load().unwrap().len()), (engine, 1));
        drop(store);
        let refused = DirStore::open_on(Some(other), &folder.store()).err().unwrap();
        assert!(matches!(refused, StoreError::Engine { .. }) && !refused.is_damage(), "{refused}");
        let words = refused.to_string();
        assert!(words.contains(&format!("is kept by {engine}, not by {other}; start without `--store`")), "{words}");
        assert!(!other.data(&folder.store()).exists());
    }
}
