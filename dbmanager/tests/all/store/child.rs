//! A robot in a separate process, with only a replica and its store. It can be killed, watched, and given false answers
//! to its system calls.
//!
//! The process is this test program, started again with an order in a variable. It prints its commits and its failures.
//! A line counts only once it was printed.

use super::{ENGINE, Robot, open, put_text};
use dbmanager::io::store::{DirStore, Engine, Store};
use dbmanager::logic::record::Batch;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The variable with the order: the action, the folder, the count.
const ORDER: &str = "DCA_STORE_CHILD";
/// How often a robot opens its store again before it gives up.
const TRIES_MAX: usize = 200;
/// The number of batches of large records, and the number of records in each.
pub(crate) const LARGE: (u64, u64) = (6, 24);

/// The order of a child.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Order {
    /// Commits small transactions one after another, like a robot. If its store fails, opens it again.
    Commit,
    /// The same, but closes its store after every seventh transaction, and opens it again.
    CommitAndClose,
    /// Writes batches of large records directly to the store.
    Large,
}

/// Returns the command that starts a child. `wrapper`, if not empty, is the command that runs it.
pub(crate) fn command(wrapper: &[&str], (order, dir, count): (Order, &Path, u64)) -> Command {
    let myself = std::env::current_exe().unwrap();
    let myself = myself.to_str().unwrap();
    let words: Vec<&str> =
        wrapper.iter().copied().chain([myself, "--exact", "store::child::obeys", "--nocapture"]).collect();
    let mut command = Command::new(words[0]);
    command.args(&words[1..]).env(ORDER, format!("{order:?} {} {count} {}", ENGINE.get(), dir.display()));
    command
}

/// The entry point of the children that the other tests start; it does nothing by itself.
#[test]
fn obeys() {
    let Ok(order) = std::env::var(ORDER) else { return };
    let mut words = order.splitn(4, ' ');
    let mut word = || words.next().unwrap();
    let (order, engine) = (word(), word().parse::<Engine>().unwrap());
    ENGINE.set(engine);
    let (count, dir) = (word().parse().unwrap(), PathBuf::from(word()));
    match order {
        "Commit" => commit(&dir, (count, u64::MAX)),
        "CommitAndClose" => commit(&dir, (count, 7)),
        "Large" => large(&dir, count),
        other => panic!("nobody knows how to {other}"),
    }
}

fn say(text: &str) {
    // One write per line, so each line is printed completely or not at all.
    let mut out = std::io::stdout().lock();
    out.write_all(format!("{text}\n").as_bytes()).unwrap();
    out.flush().unwrap();
}

/// Commits until the transaction with the number `count` is durable; closes the store after every `close_after`. When
/// the store cannot be opened any more, the file `ballast` beside it is removed, to free space.
fn commit(dir: &Path, (count, close_after): (u64, u64)) {
    let mut robot = reopen(dir);
    say(&format!("open {}", robot.committed()));
    while robot.committed() < count {
        let number = robot.committed() + 1;
        match write(&mut robot, number) {
            Ok(()) => {
                say(&format!("ack {}", robot.committed()));
                if number.is_multiple_of(close_after) {
                    drop(robot);
                    robot = reopen(dir);
                }
            }
            Err(error) => {
                say(&format!("failed {error}"));
                // Readers still see the earlier data.
                let readable = robot.replica.state().scan("team/").count();
                say(&format!("readable {readable}"));
                drop(robot);
                robot = reopen(dir);
                say(&format!("open {}", robot.committed()));
            }
        }
    }
}

fn reopen(dir: &Path) -> Robot<DirStore> {
    for _ in 0..TRIES_MAX {
        match open(dir).map_err(|error| error.to_string()).and_then(Robot::open) {
            Ok(robot) => return robot,
            Err(error) => {
                say(&format!("closed {error}"));
                drop(fs::remove_file(dir.with_file_name("ballast")));
            }
        }
    }
    panic!("the store does not open any more");
}

/// Commits transaction number `number`: usually one small value, sometimes a long one, sometimes many together.
fn write(robot: &mut Robot<impl Store>, number: u64) -> Result<(), String> {
    let text = |number: u64, size| format!("{number} {}", "x".repeat(size));
    let size = usize::try_from(number * 7919 % 300).unwrap();
    let key = |number: u64| format!("team/settings/{}", number % 200);
    match number {
        number if number % 997 == 0 => robot.commit([put_text(&key(number), &text(number, 60_000))]),
        number if number % 101 == 0 => {
            robot.commit((number..number + 20).map(|number| put_text(&key(number), &text(number, size))))
        }
        number => robot.commit([put_text(&key(number), &text(number, size))]),
    }
}

/// Writes one batch after another. The records of a batch have 60 kB each and contain its number. So a batch takes
/// hundreds of pages of the engine.
fn large(dir: &Path, count: u64) {
    let mut store = open(dir).unwrap();
    for number in 1..=count {
        let record = |name: u64| (vec![u8::try_from(name).unwrap()], Some(large_record(number, name)));
        store.commit(&Batch((0..LARGE.1).map(record).collect())).unwrap();
        say(&format!("ack {number}"));
    }
}

/// Returns the record `name` of the batch `number`.
pub(crate) fn large_record(number: u64, name: u64) -> Vec<u8> {
    let size = 50_000 + usize::try_from(name * 1000 + number * 37).unwrap();
    [number.to_le_bytes().to_vec(), vec![u8::try_from(name).unwrap(); size]].concat()
}
