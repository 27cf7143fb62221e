//! A robot is switched on: how long it takes until the database can be used, and how much memory the database then takes.
//! The references are the time to read and hash the same bytes, and the size of these bytes.

use crate::robot::{Robot, key, value};
use crate::table::{Reach, Table};
use crate::{Failure, say};
use comms::io::clock::{self, Wakeup};
use dbmanager::io::store::{DirStore, Engine};
use dbmanager::logic::clock::Wall;
use dbmanager::logic::replica::{AckLevel, CommitRequest, Input};
use dbmanager::logic::txn::Draft;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

/// The number of keys, and the length of their values in bytes.
const KEYS: (u64, usize) = (100_000, 64);
/// How many keys one transaction writes.
const TOGETHER: u64 = 100;

pub(crate) fn measure(folder: &Path, table: &mut Table) -> Result<(), Failure> {
    measure_on(Engine::default(), folder, table)
}

/// Measures one engine.
pub(crate) fn measure_on(engine: Engine, folder: &Path, table: &mut Table) -> Result<(), Failure> {
    let live = fill(engine, folder)?;
    let output = Command::new(std::env::current_exe()?).args(["opens", engine.name()]).arg(folder).output()?;
    let said = String::from_utf8(output.stdout)?;
    let mut numbers = said.split_whitespace().map(str::parse::<u64>);
    let mut number = || numbers.next().ok_or("a child said nothing")?.map_err(Failure::from);
    let (opened, hashed, memory, disk) = (number()?, number()?, number()?, number()?);
    let time = |micros| format!("{} ms", Duration::from_micros(micros).as_millis());
    let mega = |bytes: u64| format!("{:.1} MB", bytes as f64 / 1e6);
    let ratio = |one: u64, other: u64| one as f64 / other as f64;
    table.note("reading and hashing 100,000 keys and their log", &time(hashed));
    table.line(&format!("{engine}: opening them"), &time(opened), (ratio(opened, hashed), "of it"), Reach::None);
    let second = 1_000_000;
    table.line("", "", (ratio(opened, second), "s"), Reach::AtMost(1.0));
    table.note("keys and values", &mega(live));
    table.line(
        "memory of the process that has opened them",
        &mega(memory),
        (ratio(memory, live), "of it"),
        Reach::None,
    );
    let most = 3 * live + 20_000_000;
    table.line("", "", (ratio(memory, most), "of 3 x + 20 MB"), Reach::AtMost(1.0));
    table.line("on the disk", &mega(disk), (ratio(disk, live), "of it"), Reach::AtMost(8.0));
    Ok(())
}

/// Writes all keys; returns the total size of keys and values in bytes.
fn fill(engine: Engine, folder: &Path) -> Result<u64, Failure> {
    let mut robot = Robot::on(engine, folder)?;
    let mut live = 0;
    for first in (0..KEYS.0).step_by(usize::try_from(TOGETHER)?) {
        let mut draft = Draft::new("");
        for number in first..first + TOGETHER {
            let key = key(number)?;
            live += u64::try_from(key.as_str().len() + KEYS.1)?;
            draft = draft.put(key, value(number, KEYS.1));
        }
        let request = CommitRequest { ticket: 0, draft, level: AckLevel::Local, until: clock::now() };
        robot.tell(Input::Commit(vec![request], Wall::default()))?;
        if robot.replica.deadline().is_some_and(|deadline| deadline <= clock::now()) {
            robot.tell(Input::Tick(Wall::default()))?;
        }
    }
    // On a fast disk the writes took less than a tick. Without a tick, nothing has left the log yet.
    Wakeup::default().wait(robot.replica.deadline());
    robot.tell(Input::Tick(Wall::default()))?;
    Ok(live)
}

/// In a separate process: opens the store, and prints the time to open it, the time to hash the bytes, the memory of the
/// process, and the size of the file.
pub(crate) fn opens(engine: &str, folder: &Path) -> Result<(), Failure> {
    let (engine, path) = (engine.parse::<Engine>()?, folder.join(engine));
    let began = clock::now();
    let robot = Robot::open(DirStore::open(&path)?)?;
    let opened = clock::now().since(began);
    let memory = resident()?;
    drop(robot);
    let began = clock::now();
    let mut hasher = blake3::Hasher::new();
    hasher.update(&fs::read(engine.data(&path))?);
    std::hint::black_box(hasher.finalize());
    let hashed = clock::now().since(began);
    let disk = fs::metadata(engine.data(&path))?.blocks() * 512;
    say(&format!("{} {} {memory} {disk}", opened.as_micros(), hashed.as_micros()))
}

/// Returns how much memory this process uses, in bytes. Source: proc(5), `/proc/pid/status`.
fn resident() -> Result<u64, Failure> {
    let status = fs::read_to_string("/proc/self/status")?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:")).ok_or("no VmRSS")?;
    Ok(line.trim().trim_end_matches(" kB").parse::<u64>()? * 1024)
}
