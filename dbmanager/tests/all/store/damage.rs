//! Damaged files: the store or the replica reports the damage; no read returns a value that was never written.

use super::{ENGINE, Folder, Robot, batch, config, on_each_engine, open, put_text};
use comms::logic::random::Random;
use dbmanager::io::store::memory::MemoryStore;
use dbmanager::io::store::{DirStore, Engine, Store, StoreError};
use dbmanager::logic::record::{OpenError, Records};
use dbmanager::logic::replica::Replica;
use redb::ReadableDatabase;
use std::fs;

/// The length of the header of the engine's file, in bytes: its magic number and the two slots for the roots of states.
const HEAD_SIZE: usize = 320;

/// Returns the records of a robot that has made some writes.
fn little(store: impl Store) -> Records {
    let mut robot = Robot::open(store).unwrap();
    live_a_little(&mut robot);
    robot.store.load().unwrap()
}

/// Makes some writes; returns the digests of the states in between.
fn live_a_little(robot: &mut Robot<impl Store>) -> Vec<u128> {
    let mut states = vec![0, robot.replica.state().digest()];
    for number in 0..60 {
        robot.commit([put_text(&format!("team/{}", number % 7), &format!("value {number}"))]).unwrap();
        states.push(robot.replica.state().digest());
    }
    states
}

/// The engine would treat an empty file as a new one. The robot must not silently start again.
#[test]
fn an_emptied_file_is_damage() {
    on_each_engine(|| {
        // A shortened log of sled is a valid earlier state, which cannot be distinguished from a torn one.
        let lengths = if ENGINE.get() == Engine::Redb { [0, 5, 4096] } else { [0, 5, 5] };
        for length in lengths {
            let folder = Folder::quick();
            little(open(&folder.store()).unwrap());
            fs::OpenOptions::new().write(true).open(folder.records()).unwrap().set_len(length).unwrap();
            let refused = open(&folder.store()).err().unwrap();
            assert!(refused.is_damage(), "{refused}");
            let aside = DirStore::put_aside(&folder.store()).unwrap();
            assert!(ENGINE.get().data(&aside).exists() && !folder.store().exists());
            assert!(open(&folder.store()).unwrap().load().unwrap().is_empty());
        }
    });
}

#[test]
fn a_store_of_somebody_else_is_left_alone() {
    const THEIRS: redb::TableDefinition<'static, &str, u64> = redb::TableDefinition::new("theirs");
    let folder = Folder::quick();
    fs::create_dir(folder.store()).unwrap();
    let other = redb::Database::create(folder.records()).unwrap();
    let txn = other.begin_write().unwrap();
    txn.open_table(THEIRS).unwrap().insert("a", 1).unwrap();
    txn.commit().unwrap();
    drop(other);
    let refused = open(&folder.store()).err().unwrap();
    assert!(matches!(refused, StoreError::Foreign { .. }) && !refused.is_damage(), "{refused}");
    let other = redb::ReadOnlyDatabase::open(folder.records()).unwrap();
    let found = other.begin_read().unwrap().open_table(THEIRS).unwrap().get("a").unwrap().map(|found| found.value());
    assert_eq!(found, Some(1));
}

#[test]
fn a_failed_store_stays_failed() {
    on_each_engine(|| {
        let folder = Folder::quick();
        let mut store = open(&folder.store()).unwrap();
        store.commit(&batch(&[(&[0; 1 << 16], Some(vec![1]))])).unwrap_err();
        let refused = store.commit(&batch(&[(b"a", Some(vec![1]))])).unwrap_err();
        assert!(matches!(refused, StoreError::Poisoned { .. }), "{refused}");
    });
}

/// Flips bits anywhere in the file, and one bit in each byte of its header, where the engine has no checksums. It does
/// so with a store that was closed, and with one that was not. A store that still opens has an earlier state: the last
/// one, or an older one if the engine took the end for torn. An older state is noticed when the robot meets the others,
/// which know more of its transactions.
#[test]
fn bit_flip_in_any_file() {
    let folder = Folder::quick();
    let mut robot = Robot::open(open(&folder.store()).unwrap()).unwrap();
    let states = live_a_little(&mut robot);
    let unclosed = fs::read(folder.records()).unwrap();
    drop(robot);
    let closed = fs::read(folder.records()).unwrap();
    let mut random = Random::new(1);
    for (bytes, how) in [(closed, "closed"), (unclosed, "unclosed")] {
        let (mut refused, mut earlier) = (0, 0);
        // The end of the file is empty, so only the used part is flipped.
        let used = bytes.iter().rposition(|byte| *byte != 0).unwrap() as u64 + 1;
        for round in 0..HEAD_SIZE + 240 {
            let at = if round < HEAD_SIZE { round } else { usize::try_from(random.below(used)).unwrap() };
            let mut bytes = bytes.clone();
            bytes[at] ^= 1 << random.below(8);
            fs::write(folder.records(), bytes).unwrap();
            match open(&folder.store()).and_then(|store| store.read()).map(|stored| Replica::open(config(), stored)) {
                Err(error) => {
                    assert!(error.is_damage(), "byte {at}: {error}");
                    refused += 1;
                }
                Ok(Err(OpenError::Record { .. } | OpenError::Damaged { .. })) => refused += 1,
                Ok(Err(other)) => panic!("byte {at}: {other}"),
                Ok(Ok(replica)) => {
                    let state = replica.state().digest();
                    assert!(states.contains(&state), "byte {at}: a state that never was");
                    earlier += usize::from(Some(&state) != states.last());
                    go_on(&folder);
                }
            }
        }
        println!("{how}: {refused} of {} refused, {earlier} opened at an earlier state", HEAD_SIZE + 240);
    }
}

/// The same on sled, in each of its files. Each round gets a new folder, since the engine may panic and keep a folder
/// in use.
#[test]
fn bit_flip_in_any_file_of_sled() {
    ENGINE.set(Engine::Sled);
    let folder = Folder::quick();
    let states = live_a_little(&mut Robot::open(open(&folder.store()).unwrap()).unwrap());
    let place = Engine::Sled.data(&folder.store()).parent().unwrap().to_owned();
    let paths = fs::read_dir(&place).unwrap().map(|entry| entry.unwrap().path()).filter(|path| path.is_file());
    let files: Vec<_> = paths.map(|path| (fs::read(&path).unwrap(), path)).collect();
    let mut random = Random::new(1);
    let (mut refused, mut earlier) = (0, 0);
    for round in 0..120 {
        fs::remove_dir_all(folder.store()).unwrap();
        fs::create_dir_all(&place).unwrap();
        for (index, (bytes, path)) in files.iter().enumerate() {
            let mut bytes = bytes.clone();
            if index == round % files.len() {
                // The end of the file is empty, so only the used part is flipped.
                let used =
                    bytes.iter().rposition(|byte| *byte != 0 && *byte != bytes[bytes.len() - 1]).unwrap_or(0) + 1;
                bytes[usize::try_from(random.below(used as u64)).unwrap()] ^= 1 << random.below(8);
            }
            fs::write(path, bytes).unwrap();
        }
        match open(&folder.store()).and_then(|store| store.read()).map(|stored| Replica::open(config(), stored)) {
            Err(error) => {
                assert!(error.is_damage(), "{error}");
                refused += 1;
            }
            Ok(Err(OpenError::Record { .. } | OpenError::Damaged { .. })) => refused += 1,
            Ok(Err(other)) => panic!("{other}"),
            Ok(Ok(replica)) => {
                let state = replica.state().digest();
                assert!(states.contains(&state), "a state that never was");
                earlier += usize::from(Some(&state) != states.last());
            }
        }
    }
    println!("{refused} of 120 refused, {earlier} opened at an earlier state");
}

/// A robot on the opened store can write, and finds its writes again: no damage appears later.
fn go_on(folder: &Folder) {
    let mut robot = Robot::open(open(&folder.store()).unwrap()).unwrap();
    robot.commit((0..40).map(|number| put_text(&format!("team/{number}"), &"x".repeat(200)))).unwrap();
    let state = robot.replica.state().digest();
    drop(robot);
    let robot = Robot::open(open(&folder.store()).unwrap()).unwrap();
    assert_eq!(robot.replica.state().digest(), state);
}

fn open_replica(records: &Records) -> Result<Replica, OpenError> {
    Replica::open(config(), records)
}

/// Bit flips that the engine does not notice are found: each record has its name in its checksum, and the records are
/// checked against each other.
#[test]
fn bit_flip_in_log_tail_middle_kv() {
    let records = little(MemoryStore::default());
    for (name, record) in &records {
        for byte in 0..record.len() {
            let mut damaged = records.clone();
            damaged.get_mut(name).unwrap()[byte] ^= 4;
            assert!(matches!(open_replica(&damaged), Err(OpenError::Record { .. })), "{name:?} {byte}");
        }
        let mut lost = records.clone();
        lost.remove(name);
        let refused = open_replica(&lost).unwrap_err();
        assert!(matches!(refused, OpenError::Damaged { .. }), "{name:?}: {refused}");
    }
}
