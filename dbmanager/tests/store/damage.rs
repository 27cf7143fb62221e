//! Files that are not as they were left: the store says so, or the replica does; nobody ever reads what was not written.

use crate::{Folder, Robot, batch, config, put_text};
use dbmanager::io::store::memory::MemoryStore;
use dbmanager::io::store::{DirStore, Store, StoreError};
use dbmanager::logic::random::Random;
use dbmanager::logic::record::{OpenError, Records};
use dbmanager::logic::replica::Replica;
use std::fs;

/// Returns the records of a robot that has written a little, and the states it went through.
fn little(store: impl Store) -> (Records, Vec<u128>) {
    let mut robot = Robot::open(store).unwrap();
    let mut states = vec![0, robot.replica.state().digest()];
    for number in 0..60 {
        robot.commit([put_text(&format!("team/{}", number % 7), &format!("value {number}"))]).unwrap();
        states.push(robot.replica.state().digest());
    }
    (robot.store.load().unwrap(), states)
}

#[test]
fn conf_file_empty() {
    let folder = Folder::quick();
    let (records, _) = little(DirStore::open(&folder.store()).unwrap());
    fs::write(folder.store().join("conf"), "").unwrap();
    // The engine may do without; what it must not do is to begin anew as if nothing had been.
    match DirStore::open(&folder.store()) {
        Ok(store) => assert_eq!(store.load().unwrap(), records),
        Err(refused) => assert!(refused.is_damage(), "{refused}"),
    }
    let aside = DirStore::put_aside(&folder.store()).unwrap();
    assert!(aside.join("db").exists() && !folder.store().exists());
    assert!(DirStore::open(&folder.store()).unwrap().load().unwrap().is_empty());
}

#[test]
fn a_store_of_somebody_else_is_left_alone() {
    let folder = Folder::quick();
    let other = sled::open(folder.store()).unwrap();
    other.insert("theirs", "1").unwrap();
    drop(other);
    let refused = DirStore::open(&folder.store()).err().unwrap();
    assert!(matches!(refused, StoreError::Foreign { .. }) && !refused.is_damage(), "{refused}");
}

#[test]
fn a_failed_store_stays_failed() {
    let folder = Folder::quick();
    let mut store = DirStore::open(&folder.store()).unwrap();
    store.commit(&batch(&[(&[0; 1 << 16], Some(vec![1]))])).unwrap_err();
    let refused = store.commit(&batch(&[(b"a", Some(vec![1]))])).unwrap_err();
    assert!(matches!(refused, StoreError::Poisoned { .. }), "{refused}");
}

/// Flips bits anywhere in the files. What opens is a state that once was: the last, or an earlier one, if the engine
/// took the end for torn. That is found when the robot meets the others, who know more of it than itself.
#[test]
fn bit_flip_in_any_file() {
    let folder = Folder::quick();
    let (_, states) = little(DirStore::open(&folder.store()).unwrap());
    let files: Vec<_> = fs::read_dir(folder.store()).unwrap().map(|entry| entry.unwrap().path()).collect();
    let files: Vec<_> =
        files.into_iter().filter(|path| path.is_file()).map(|path| (fs::read(&path).unwrap(), path)).collect();
    let mut random = Random::new(1);
    let (mut refused, mut earlier) = (0, 0);
    for round in 0..120 {
        drop(fs::remove_dir_all(folder.store()));
        fs::create_dir_all(folder.store()).unwrap();
        let chosen = round % files.len();
        for (index, (bytes, path)) in files.iter().enumerate() {
            let mut bytes = bytes.clone();
            if index == chosen {
                // The engine's file is mostly empty at its end: flip where something is.
                let used =
                    bytes.iter().rposition(|byte| *byte != 0 && *byte != bytes[bytes.len() - 1]).unwrap_or(0) + 1;
                let at = usize::try_from(random.below(used as u64)).unwrap();
                bytes[at] ^= 1 << random.below(8);
            }
            fs::write(path, bytes).unwrap();
        }
        match DirStore::open(&folder.store()).map_err(|error| error.is_damage()).map(|store| store.load()) {
            Err(damage) => {
                assert!(damage);
                refused += 1;
            }
            Ok(Err(error)) => {
                assert!(error.is_damage(), "{error}");
                refused += 1;
            }
            Ok(Ok(records)) => match open(&records) {
                Ok(replica) => {
                    let state = replica.state().digest();
                    assert!(states.contains(&state), "a state that never was");
                    earlier += usize::from(Some(&state) != states.last());
                }
                Err(OpenError::Record { .. } | OpenError::Damaged { .. }) => refused += 1,
                Err(other) => panic!("{other}"),
            },
        }
    }
    println!("{refused} of 120 refused, {earlier} opened at an earlier state");
}

fn open(records: &Records) -> Result<Replica, OpenError> {
    Replica::open(config(), records)
}

/// Whatever the engine lets through: each record knows its name and its sum, and all know each other.
#[test]
fn bit_flip_in_log_tail_middle_kv() {
    let (records, _) = little(MemoryStore::default());
    for (name, record) in &records {
        for byte in 0..record.len() {
            let mut damaged = records.clone();
            damaged.get_mut(name).unwrap()[byte] ^= 4;
            assert!(matches!(open(&damaged), Err(OpenError::Record { .. })), "{name:?} {byte}");
        }
        let mut lost = records.clone();
        lost.remove(name);
        let refused = open(&lost).unwrap_err();
        assert!(matches!(refused, OpenError::Damaged { .. }), "{name:?}: {refused}");
    }
}
