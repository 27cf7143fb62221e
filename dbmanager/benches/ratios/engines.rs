//! Both engines under a typical load of a robot: small commits one after another, and 100,000 keys. The choice of the default
//! engine, and the table in the manual, are based on this.

use crate::robot::{KEY_AND_VALUE, Robot, request};
use crate::table::{Reach, Samples, Table};
use crate::{Failure, reopen};
use comms::io::clock;
use dbmanager::io::store::{DirStore, Engine};
use dbmanager::logic::clock::Wall;
use dbmanager::logic::replica::Input;
use std::fs::{self, File};
use std::io::Write;
use std::path::Path;

/// How many rounds there are; each measures both engines in turn.
const ROUNDS: u64 = 10;
/// Commits of each in a round.
const COMMITS: u64 = 300;
/// The seconds of a year: the number of commits of a robot that commits once a second.
const YEAR: u64 = 31_557_600;

/// The figures of one engine.
struct Subject {
    engine: Engine,
    robot: Robot<DirStore>,
    samples: Samples,
    /// The bytes passed to the system, and the bytes that the system has passed to the disk.
    written: [u64; 2],
}

pub(crate) fn measure(folder: &Path, table: &mut Table) -> Result<(), Failure> {
    let mut raw = (File::create(folder.join("raw"))?, Samples::default());
    let subject = |engine| {
        let robot = Robot::on(engine, folder)?;
        Ok(Subject { engine, robot, samples: Samples::default(), written: [0; 2] })
    };
    let mut subjects = Engine::ALL.map(subject).into_iter().collect::<Result<Vec<_>, Failure>>()?;
    for round in 0..ROUNDS {
        let mut times = Vec::new();
        for _ in 0..COMMITS {
            let began = clock::now();
            raw.0.write_all(&[7; KEY_AND_VALUE.0 + KEY_AND_VALUE.1 + 29])?;
            raw.0.sync_data()?;
            times.push(clock::now().since(began));
        }
        raw.1.push(times);
        for subject in &mut subjects {
            subject.round(round)?;
        }
    }
    table.note("append of 320 bytes, fdatasync", &raw.1.text());
    for Subject { engine, robot, samples, written } in subjects {
        drop(robot);
        table.line(
            &format!("{engine}: durable commit"),
            &samples.text(),
            (samples.ratio(&raw.1), "of it"),
            Reach::None,
        );
        let [handed, disk] = written.map(|bytes| bytes / (ROUNDS * COMMITS));
        table.note(
            &format!("{engine}: bytes a commit, to the system and to the disk"),
            &format!("{handed} B, {disk} B"),
        );
        let year = |bytes: u64| format!("{:.0} GB", bytes as f64 * YEAR as f64 / 1e9);
        table.note(&format!("{engine}: a commit a second for a year"), &format!("{}, {}", year(handed), year(disk)));
        let place = folder.join(format!("many-{engine}"));
        fs::create_dir(&place)?;
        reopen::measure_on(engine, &place, table)?;
    }
    Ok(())
}

impl Subject {
    fn round(&mut self, round: u64) -> Result<(), Failure> {
        let (before, mut times) = (written()?, Vec::new());
        for number in round * COMMITS..(round + 1) * COMMITS {
            let began = clock::now();
            self.robot.tell(Input::Commit(vec![request(number)?], Wall::default()))?;
            times.push(clock::now().since(began));
        }
        self.samples.push(times);
        let after = written()?;
        for (sum, (after, before)) in self.written.iter_mut().zip(after.into_iter().zip(before)) {
            *sum += after - before;
        }
        Ok(())
    }
}

/// Returns how many bytes this process has written so far: to the system, and through it to disks. Source: proc(5),
/// `/proc/pid/io`.
fn written() -> Result<[u64; 2], Failure> {
    let io = fs::read_to_string("/proc/self/io")?;
    let of = |word: &str| {
        let line = io.lines().find_map(|line| line.strip_prefix(word)).ok_or("no such line in /proc/self/io")?;
        Ok::<u64, Failure>(line.trim().parse()?)
    };
    Ok([of("wchar:")?, of("write_bytes:")?])
}
