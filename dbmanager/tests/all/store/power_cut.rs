//! The power is cut at many moments of a robot's life: no acknowledged transaction may be lost, and the store has to
//! open.
//!
//! A robot runs once under `strace`. Its calls are applied to a [`Platter`], whose power is cut at moments spread over
//! the whole run. The surviving files are opened as a store. To do a longer run: `DCA_POWER_CUTS=1000 DCA_COMMITS=100000
//! cargo test -p dbmanager --release --test all store::power_cut -- --nocapture`.

use super::child::{self, LARGE, Order, large_record};
use super::platter::{Barriers, Platter};
use super::trace::{self, Call};
use super::{ENGINE, Folder, Robot, on_each_engine, open};
use comms::logic::random::Random;
use dbmanager::io::store::{Store, StoreError};
use std::collections::BTreeMap;
use std::fs;
use std::io::BufReader;
use std::path::Path;
use std::process::{Command, Stdio};

/// The probability, in percent, that a sector which was not synced has its newest content. In half of the cuts it is 0.
const SURVIVAL: [u64; 4] = [0, 0, 50, 90];

/// The state of a store after a power cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Left {
    /// All acknowledged transactions.
    All,
    /// Less.
    Less,
    /// A store that does not open.
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

/// Runs a child under `strace`; passes on its calls in its folder during the run, because their log is much larger than
/// the remaining data.
fn watch(folder: &Folder, (order, count): (Order, u64), keep: impl FnMut(Call)) {
    let root = folder.0.join("root");
    fs::create_dir_all(&root).unwrap();
    let calls = format!("trace={}", trace::CALLS);
    let strace = ["strace", "-f", "-qq", "-y", "-xx", "-s", "16777216", "--seccomp-bpf", "-e", &calls];
    let wrapper: Vec<&str> = strace.into_iter().chain(["-o", "|cat 1>&2"]).collect();
    let mut command = child::command(&wrapper, (order, &root.join("db"), count));
    let mut strace = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    trace::read(BufReader::new(strace.stderr.take().unwrap()), &root, keep);
    assert!(strace.wait().unwrap().success());
}

/// Returns the number in a printed line: how many transactions are acknowledged.
fn acknowledged(call: &Call) -> Option<u64> {
    let Call::Notification(text) = call else { return None };
    text.strip_prefix("ack ")?.trim().parse().ok()
}

/// Power cuts at moments spread over the run of a child.
struct Cuts<'a, F> {
    folder: &'a Folder,
    platter: Platter,
    random: Random,
    /// For each cut: after which acknowledgement it happens, and how many calls later. The last element is the next cut.
    moments: Vec<(u64, u64)>,
    /// How many transactions are acknowledged, and how many calls have followed.
    now: (u64, u64),
    /// Examines a folder after a power cut; gets the number of acknowledged transactions.
    look: F,
    found: BTreeMap<Left, u64>,
}

impl<'a, F: Fn(&Path, u64) -> Left> Cuts<'a, F> {
    /// Returns `cuts` power cuts within `acks` acknowledgements. Each is up to `calls` calls after an acknowledgement.
    fn new(folder: &'a Folder, barriers: Barriers, (cuts, acks, calls): (u64, u64, u64), look: F) -> Self {
        let mut random = Random::new(cuts);
        let mut moments: Vec<(u64, u64)> = (0..cuts).map(|_| (1 + random.below(acks), random.below(calls))).collect();
        moments.sort_unstable_by(|one, other| other.cmp(one));
        let (platter, found) = (Platter::new(barriers), BTreeMap::new());
        Self { folder, platter, random, moments, now: (0, 0), look, found }
    }

    fn take(&mut self, call: &Call) {
        if self.moments.is_empty() {
            return;
        }
        self.platter.take(call);
        self.now = acknowledged(call).map_or((self.now.0, self.now.1 + 1), |acked| (acked, 0));
        while self.moments.pop_if(|moment| *moment <= self.now).is_some() {
            self.cut();
        }
    }

    fn cut(&mut self) {
        let (from, to) = (self.folder.0.join("root"), self.folder.0.join("left"));
        let percent = SURVIVAL[self.moments.len() % SURVIVAL.len()];
        self.platter.cut(&mut self.random, percent, (&from, &to));
        *self.found.entry((self.look)(&to.join("db"), self.now.0)).or_default() += 1;
        fs::remove_dir_all(&to).unwrap();
    }

    /// Returns the number of each result. Remaining cuts are made after the end of the run.
    fn end(mut self) -> BTreeMap<Left, u64> {
        while self.moments.pop().is_some() {
            self.cut();
        }
        self.found
    }
}

/// Opens the surviving files of a robot: the replica checks chains, checksums and digests.
fn look_at_robot<S: Store>(open: fn(&Path) -> Result<S, StoreError>, path: &Path, acked: u64) -> Left {
    match open(path).map_err(|error| error.to_string()).and_then(Robot::open) {
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
    cut_power(40, 6_000);
}

#[test]
#[ignore = "long: 120 cuts in 20,000 commits"]
fn power_cut_in_a_long_life() {
    cut_power(from_environment("DCA_POWER_CUTS", 120), from_environment("DCA_COMMITS", 20_000));
}

fn cut_power(cuts: u64, commits: u64) {
    on_each_engine(|| {
        if !has_strace() {
            return;
        }
        let folder = Folder::quick();
        let data = ENGINE.get().data(&folder.0.join("root/db"));
        let look = |path: &Path, acked| look_at_robot(open, path, acked);
        let mut with = Cuts::new(&folder, Barriers::All, (cuts, commits, 12), look);
        // The method does find the loss if the data is not synced.
        let mut without = Cuts::new(&folder, Barriers::NoDataSync, (12, 500, 12), look);
        let mut written = 0;
        watch(&folder, (Order::Commit, commits), |call| {
            with.take(&call);
            without.take(&call);
            if let Call::Write(path, _, bytes) = call {
                written += if path == data { bytes.len() as u64 } else { 0 };
            }
        });
        let kept = fs::metadata(&data).unwrap().len();
        assert!(written > 3 * kept, "space was not used again: {written} bytes in a file of {kept}");
        let (with, without) = (with.end(), without.end());
        assert_eq!(with, BTreeMap::from([(Left::All, cuts)]));
        assert!(without.get(&Left::All).copied().unwrap_or(0) <= 3, "the method does not find the hole: {without:?}");
    });
}

/// Cuts the power `cuts` times within `acks` acknowledgements of a run, up to `calls` calls after each: all acknowledged
/// data is kept.
fn check_cuts(order: Order, (cuts, acks, calls): (u64, u64, u64), look: impl Fn(&Path, u64) -> Left) {
    if !has_strace() {
        return;
    }
    let folder = Folder::quick();
    let mut life = Cuts::new(&folder, Barriers::All, (cuts, acks, calls), look);
    watch(&folder, (order, acks), |call| life.take(&call));
    assert_eq!(life.end(), BTreeMap::from([(Left::All, cuts)]));
}

/// The store is opened and closed repeatedly, which also writes.
#[test]
fn power_cut_while_it_opens_and_closes() {
    on_each_engine(|| {
        check_cuts(Order::CommitAndClose, (200, 700, 60), |path, acked| look_at_robot(open, path, acked));
    });
}

/// While the store recovers from a power cut, the power is cut again after each call, and the store continues.
#[test]
fn power_cut_after_a_power_cut() {
    on_each_engine(|| {
        if !has_strace() {
            return;
        }
        let (first, mut calls) = (Folder::quick(), Vec::new());
        watch(&first, (Order::Commit, 40), |call| calls.push(call));
        let acks: Vec<usize> = (0..calls.len()).filter(|call| acknowledged(&calls[*call]).is_some()).collect();
        let mut random = Random::new(1);
        for (commit, after) in [(20, 1), (27, 4), (38, 7)] {
            let second = Folder::quick();
            let (root, left) = (second.0.join("root"), second.0.join("left"));
            let mut platter = Platter::new(Barriers::All);
            calls[..acks[commit] + after].iter().for_each(|call| platter.take(call));
            platter.cut(&mut random, 50, (&first.0.join("root"), &root));
            let mut platter = Platter::holding(&root);
            let acked = acknowledged(&calls[acks[commit]]).unwrap();
            let (mut now, mut number) = (acked, 0);
            watch(&second, (Order::Commit, acked + 3), |call| {
                platter.take(&call);
                now = acknowledged(&call).unwrap_or(now);
                platter.cut(&mut random, SURVIVAL[number % SURVIVAL.len()], (&root, &left));
                assert_eq!(look_at_robot(open, &left.join("db"), now), Left::All, "call {number}: {call:?}");
                fs::remove_dir_all(&left).unwrap();
                number += 1;
            });
            println!("cut after each of {number} calls");
        }
    });
}

/// Opens the surviving files of batches of large records: each record is complete or absent.
fn look_at_batches(path: &Path, acked: u64) -> Left {
    let records = match open(path).and_then(|store| store.load()) {
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
    on_each_engine(|| {
        check_cuts(Order::Large, (60, LARGE.0, 80), look_at_batches);
    });
}

/// The power is cut while the store is made: no write was acknowledged, but the store has to open.
#[test]
fn power_cut_at_birth() {
    on_each_engine(|| {
        if !has_strace() {
            return;
        }
        let (folder, mut calls) = (Folder::quick(), Vec::new());
        watch(&folder, (Order::Commit, 2), |call| calls.push(call));
        let first = calls.iter().position(|call| acknowledged(call).is_some()).unwrap();
        let (from, to) = (folder.0.join("root"), folder.0.join("left"));
        let mut random = Random::new(1);
        for (moment, percent) in (0..first).flat_map(|moment| SURVIVAL.map(|percent| (moment, percent))) {
            let mut platter = Platter::new(Barriers::All);
            calls[..=moment].iter().for_each(|call| platter.take(call));
            platter.cut(&mut random, percent, (&from, &to));
            assert_eq!(look_at_robot(open, &to.join("db"), 0), Left::All, "after call {moment}");
            fs::remove_dir_all(&to).unwrap_or_default();
        }
    });
}
