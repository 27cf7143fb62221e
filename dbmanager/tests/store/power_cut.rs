//! The power is cut, again and again, at any moment of a robot's life: nothing that was acknowledged may be gone, and the
//! store has to open.
//!
//! A robot runs once, watched by `strace`. Its calls are carried out on a [`Platter`], which is cut at moments spread over
//! the whole run; what is left is opened as a store. A longer run, by hand:
//! `DCA_POWER_CUTS=1000 DCA_COMMITS=100000 cargo test -p dbmanager --release --test store power_cut -- --nocapture`.

use crate::child::{self, LARGE, Order, large_record};
use crate::platter::{Barriers, Platter};
use crate::trace::{self, Call};
use crate::{Folder, Robot};
use dbmanager::io::store::{DirStore, Store, StoreError};
use dbmanager::logic::random::Random;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// With which probability, in percent, a page that was not synced survives: half of the drives are merciless.
const SURVIVAL: [u64; 4] = [0, 0, 50, 90];

/// What a cut left.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Left {
    /// All that was acknowledged.
    All,
    /// Less.
    Less,
    /// Nothing that opens.
    Nothing,
}

fn has_strace() -> bool {
    let there = Command::new("strace").arg("--version").stdout(Stdio::null()).status().is_ok();
    if !there {
        println!("skipped: needs strace");
    }
    there
}

fn from_environment(name: &str, usual: u64) -> u64 {
    std::env::var(name).map_or(usual, |number| number.parse().unwrap())
}

/// Runs a child under `strace`; returns what it did in its folder.
fn watch(folder: &Folder, order: Order, count: u64) -> Vec<Call> {
    let log = folder.0.join("log");
    let root = folder.0.join("root");
    fs::create_dir(&root).unwrap();
    let calls = format!("trace={}", trace::CALLS);
    let strace = ["strace", "-f", "-qq", "-y", "-xx", "-s", "16777216", "--seccomp-bpf", "-e", &calls];
    let wrapper: Vec<&str> = strace.into_iter().chain(["-o", log.to_str().unwrap()]).collect();
    let ended = child::command(&wrapper, (order, &root.join("db"), count)).stdout(Stdio::null()).status().unwrap();
    assert!(ended.success());
    let calls = trace::read(&log, &root);
    fs::remove_file(log).unwrap();
    calls
}

/// Returns the number in a line that was told: how much is acknowledged.
fn acknowledged(call: &Call) -> Option<u64> {
    let Call::Told(text) = call else { return None };
    text.strip_prefix("ack ")?.trim().parse().ok()
}

/// Cuts the power `cuts` times, at moments after the first acknowledgement; returns what `look` found in the folder then,
/// how often. It is told how much was acknowledged.
fn cut(
    (folder, calls): (&Folder, &[Call]),
    barriers: Barriers,
    cuts: u64,
    look: impl Fn(&Path, u64) -> Left,
) -> BTreeMap<Left, u64> {
    let first = calls.iter().position(|call| acknowledged(call).is_some()).unwrap();
    let mut random = Random::new(cuts);
    let span = u64::try_from(calls.len() - first).unwrap();
    let mut moments: Vec<usize> = (0..cuts).map(|_| first + usize::try_from(random.below(span)).unwrap()).collect();
    moments.sort_unstable();
    let (mut platter, mut done, mut acked) = (Platter::new(barriers), 0, 0);
    let (from, to) = (folder.0.join("root"), folder.0.join("left"));
    let mut found = BTreeMap::new();
    for (number, moment) in moments.into_iter().enumerate() {
        for call in &calls[done..=moment] {
            platter.take(call);
            acked = acknowledged(call).unwrap_or(acked);
        }
        done = moment + 1;
        platter.cut(&mut random, SURVIVAL[number % SURVIVAL.len()], (&from, &to));
        *found.entry(look(&to.join("db"), acked)).or_default() += 1;
        fs::remove_dir_all(&to).unwrap();
    }
    found
}

/// Opens what is left of a robot: the replica checks chains, sums and digests.
fn look_at_robot(path: &Path, acked: u64) -> Left {
    match DirStore::open(path).map_err(|error| error.to_string()).and_then(Robot::open) {
        Ok(robot) if robot.committed() >= acked => Left::All,
        Ok(_) => Left::Less,
        Err(error) => {
            println!("{error}");
            Left::Nothing
        }
    }
}

#[test]
fn power_cut() {
    if !has_strace() {
        return;
    }
    let (cuts, commits) = (from_environment("DCA_POWER_CUTS", 120), from_environment("DCA_COMMITS", 20_000));
    let folder = Folder::quick();
    let calls = watch(&folder, Order::Commit, commits);
    let data = folder.0.join("root/db/db");
    let to_data = |call: &Call| {
        if let Call::Write(path, _, bytes) = call
            && *path == data
        {
            bytes.len()
        } else {
            0
        }
    };
    let written = calls.iter().map(to_data);
    let (written, kept) = (written.sum::<usize>(), usize::try_from(fs::metadata(&data).unwrap().len()).unwrap());
    println!("{commits} commits, {} calls, {written} bytes written to a file of {kept}", calls.len());
    assert!(written > 3 * kept, "space was not used again: {written} bytes in a file of {kept}");
    let found = cut((&folder, &calls), Barriers::All, cuts, look_at_robot);
    println!("with the data sync: {found:?}");
    assert_eq!(found, BTreeMap::from([(Left::All, cuts)]));
    // The method finds what is missing when nobody syncs the data, as the engine alone does.
    let found = cut((&folder, &calls), Barriers::NoDataSync, 12, look_at_robot);
    println!("without: {found:?}");
    assert!(found.get(&Left::All).copied().unwrap_or(0) <= 3, "the method does not find the hole: {found:?}");
}

/// Opens what is left of batches of large records: each is there as a whole or not at all.
fn look_at_batches(path: &Path, acked: u64) -> Left {
    let records = match DirStore::open(path).and_then(|store| store.load()) {
        Ok(records) => records,
        Err(error) => {
            println!("{error}");
            return Left::Nothing;
        }
    };
    let whole = |number: u64| {
        records
            .iter()
            .enumerate()
            .all(|(name, (_, record))| *record == large_record(number, u64::try_from(name).unwrap()))
    };
    let there = records.len() as u64 == LARGE.1 && [acked, acked + 1].into_iter().any(whole);
    if there { Left::All } else { Left::Less }
}

#[test]
fn crash_between_log_and_kv() {
    if !has_strace() {
        return;
    }
    let folder = Folder::quick();
    let calls = watch(&folder, Order::Large, LARGE.0);
    let found = cut((&folder, &calls), Barriers::All, 60, look_at_batches);
    println!("{} calls: {found:?}", calls.len());
    assert_eq!(found, BTreeMap::from([(Left::All, 60)]));
}

/// The power is cut while the store is made: nothing was promised, so it may be damaged, but has to say so.
#[test]
fn power_cut_at_birth() {
    if !has_strace() {
        return;
    }
    let folder = Folder::quick();
    let calls = watch(&folder, Order::Commit, 2);
    let first = calls.iter().position(|call| acknowledged(call).is_some()).unwrap();
    let (from, to) = (folder.0.join("root"), folder.0.join("left"));
    let mut random = Random::new(1);
    for moment in 0..first {
        let mut platter = Platter::new(Barriers::All);
        calls[..=moment].iter().for_each(|call| platter.take(call));
        platter.cut(&mut random, SURVIVAL[moment % SURVIVAL.len()], (&from, &to));
        let path: PathBuf = to.join("db");
        match DirStore::open(&path) {
            Ok(store) => drop(Robot::open(store).unwrap()),
            Err(error @ StoreError::Damaged { .. }) => {
                drop(DirStore::put_aside(&path).unwrap());
                drop(Robot::open(DirStore::open(&path).unwrap()).unwrap());
                println!("after call {moment}: {error}");
            }
            Err(error) => panic!("after call {moment}: {error}"),
        }
        fs::remove_dir_all(&to).unwrap_or_default();
    }
}
