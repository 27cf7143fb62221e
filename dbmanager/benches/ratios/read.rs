//! A read from a snapshot, compared with a read from a `BTreeMap` with the same keys and values.

use crate::Failure;
use crate::robot::{self, Robot, key, value};
use crate::table::{Reach, Samples, Table};
use comms::io::clock;
use comms::logic::random::Random;
use dbmanager::io::store::memory::MemoryStore;
use dbmanager::logic::clock::Wall;
use dbmanager::logic::key::Key;
use dbmanager::logic::replica::{AckLevel, CommitRequest, Input};
use dbmanager::logic::state::Version;
use dbmanager::logic::txn::{Draft, Value};
use std::collections::BTreeMap;
use std::hint::black_box;
use std::path::Path;
use std::time::Duration;

/// The number of keys, as in the configuration of a large team.
const KEYS: u64 = 10_000;
/// How many reads are measured together.
const READS: u32 = 50_000;
/// How many rounds there are; each measures both in turn.
const ROUNDS: u64 = 15;
/// How many values of 256 bytes are written. Before each write, a snapshot is taken and kept.
const WRITES: u64 = 2000;

pub(crate) fn measure(_folder: &Path, table: &mut Table) -> Result<(), Failure> {
    let mut robot = Robot::open(MemoryStore::default())?;
    fill(&mut robot)?;
    let snapshot = robot.replica.state().clone();
    // The same keys and values at the same places in memory: only the map differs.
    let entry = |(key, versions): (&Key, &[Version])| Some((key.clone(), versions.last()?.value.clone()?));
    let map: BTreeMap<Key, Value> = snapshot.scan("team/").filter_map(entry).collect();
    let (mut of_snapshot, mut of_map) = (Samples::default(), Samples::default());
    for round in 0..ROUNDS {
        let mut random = Random::new(round);
        let keys: Vec<Key> = (0..READS).map(|_| key(random.below(KEYS))).collect::<Result<_, _>>()?;
        let in_map = |key: &Key| map.get(key).map(first);
        let in_snapshot = |key: &Key| snapshot.get(key)?.value.as_ref().map(first);
        of_map.push(vec![timed(&keys, |key| black_box(in_map(key)).is_some())?]);
        of_snapshot.push(vec![timed(&keys, |key| black_box(in_snapshot(key)).is_some())?]);
    }
    let began = clock::now();
    let mut kept = robot.replica.state().clone();
    for number in 0..WRITES {
        robot.tell(Input::Commit(vec![robot::request(number * 7919 % KEYS)?], Wall::default()))?;
        kept = robot.replica.state().clone();
    }
    let write = clock::now().since(began) / u32::try_from(WRITES)?;
    black_box(kept);
    table.note("get from a BTreeMap, 10,000 keys", &format!("{} ns", of_map.quantile(50).as_nanos()));
    let ratio = (of_snapshot.ratio(&of_map), "of it");
    let nanos = format!("{} ns", of_snapshot.quantile(50).as_nanos());
    table.line("get from a snapshot", &nanos, ratio, Reach::AtMost(1.5));
    table.note("commit in memory, and a new snapshot", &format!("{} µs", write.as_micros()));
    Ok(())
}

/// Returns the first byte: a client that reads a value also looks at it.
fn first(value: &Value) -> Option<u8> {
    value.bytes.first().copied()
}

/// Writes all keys.
fn fill(robot: &mut Robot<MemoryStore>) -> Result<(), Failure> {
    for first in (0..KEYS).step_by(100) {
        let mut draft = Draft::new("");
        for number in first..first + 100 {
            draft = draft.put(key(number)?, value(number, 256));
        }
        let request = CommitRequest { ticket: 0, draft, level: AckLevel::Local, until: clock::now() };
        robot.tell(Input::Commit(vec![request], Wall::default()))?;
    }
    Ok(())
}

/// Returns how long one read takes.
fn timed(keys: &[Key], read: impl Fn(&Key) -> bool) -> Result<Duration, Failure> {
    let began = clock::now();
    let found = keys.iter().filter(|key| read(key)).count();
    let took = clock::now().since(began);
    if found != keys.len() {
        return Err("a key was not found".into());
    }
    Ok(took / READS)
}
