//! One caller commits, and waits for the disk. The references are an append of the same bytes with `fdatasync`, the same
//! replica on sled, and a single etcd on this machine.

use crate::etcd::Etcd;
use crate::robot::{self, KEY_AND_VALUE, Robot, request};
use crate::table::{Reach, Samples, Table};
use crate::{Failure, say};
use comms::io::clock;
use dbmanager::io::store::{Engine, Store};
use dbmanager::logic::clock::Wall;
use dbmanager::logic::replica::Input;
use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::time::Duration;

/// How many rounds there are; each measures all subjects in turn.
const ROUNDS: u64 = 7;
/// Commits of each in a round.
const COMMITS: u64 = 60;
/// The bytes of identity and time that every commit needs.
const IDENTITY_SIZE: usize = 29;

pub(crate) fn measure(folder: &Path, table: &mut Table) -> Result<(), Failure> {
    let mut raw_file = File::create(folder.join("raw"))?;
    let [mut ours, mut sled] = [Robot::on(Engine::Redb, folder)?, Robot::on(Engine::Sled, folder)?];
    let mut etcd = Etcd::start(&folder.join("etcd"))?;
    if etcd.is_none() {
        say("skipped: etcd is not installed (Debian: etcd-server)")?;
    }
    let [mut of_raw, mut of_ours, mut of_sled, mut of_etcd] = [(); 4].map(|()| Samples::default());
    for round in 0..ROUNDS {
        let numbers = || round * COMMITS..(round + 1) * COMMITS;
        of_raw.push(timed(numbers(), |_| append(&mut raw_file))?);
        of_ours.push(timed(numbers(), |number| commit(&mut ours, number))?);
        of_sled.push(timed(numbers(), |number| commit(&mut sled, number))?);
        if let Some(etcd) = &mut etcd {
            let put = |number: u64| etcd.put(robot::key(number % 5000)?.as_str(), &vec![b'x'; KEY_AND_VALUE.1]);
            of_etcd.push(timed(numbers(), put)?);
        }
    }
    table.note("append of 320 bytes, fdatasync", &of_raw.text());
    table.line(
        "durable commit, one caller, redb",
        &of_ours.text(),
        (of_ours.ratio(&of_raw), "of it"),
        Reach::AtMost(1.3),
    );
    table.line("the same replica on sled", &of_sled.text(), (of_sled.ratio(&of_raw), "of it"), Reach::None);
    match etcd {
        Some(etcd) => {
            table.line("put in etcd, one node", &of_etcd.text(), (of_etcd.ratio(&of_raw), "of it"), Reach::None);
            etcd.end()
        }
        None => Ok(()),
    }
}

fn timed(
    numbers: impl Iterator<Item = u64>,
    mut work: impl FnMut(u64) -> Result<(), Failure>,
) -> Result<Vec<Duration>, Failure> {
    numbers
        .map(|number| {
            let began = clock::now();
            work(number)?;
            Ok(clock::now().since(began))
        })
        .collect()
}

fn append(file: &mut File) -> Result<(), Failure> {
    file.write_all(&[7; KEY_AND_VALUE.0 + KEY_AND_VALUE.1 + IDENTITY_SIZE])?;
    Ok(file.sync_data()?)
}

fn commit(robot: &mut Robot<impl Store>, number: u64) -> Result<(), Failure> {
    robot.tell(Input::Commit(vec![request(number)?], Wall::default()))?;
    Ok(())
}
