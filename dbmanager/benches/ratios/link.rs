//! The bytes on the links between robots, and the time to transfer a backlog. The replicas are real, the links are
//! simulated in virtual time, and the limit of the link is the reference.
//!
//! The limit for a backlog is a round trip plus the time of its bytes at the rate of the link. An operation has its
//! key, its value, and 32 bytes for writer, time and seal. Sizes are those of the encoded messages.

mod net;

use crate::Failure;
use crate::robot::{key, value};
use crate::table::{Reach, Table};
use comms::logic::time::Time;
use dbmanager::logic::replica::{AckLevel, CommitRequest, Input};
use dbmanager::logic::txn::Draft;
use net::{Line, Net};
use std::path::Path;
use std::time::Duration;

/// Bytes for the writer, the time and a seal.
const ENVELOPE: u64 = 32;
/// The round trip of a link.
const ROUND_TRIP: Duration = Duration::from_millis(20);
/// How long a team is observed.
const WATCHED: Duration = Duration::from_secs(600);
/// How many robots the team has.
const ROBOTS: usize = 4;
/// How many bytes an operation of a backlog has, including its envelope.
const BACKLOG_SIZE: u64 = 150;
/// Faster than any limit.
const FAST: u64 = 1_000_000_000;
/// The time at which a robot has an urgent write, while the backlog of another robot is in transit.
const URGENT_AFTER: Duration = Duration::from_secs(5);

pub(crate) fn measure(_folder: &Path, table: &mut Table) -> Result<(), Failure> {
    idle(table)?;
    steady(table, ("100 bytes written by one of 4, to each peer", 1))?;
    steady(table, ("100 bytes written by all in turn, to each peer", ROBOTS))?;
    heal(table, ("10,000 operations behind, 1 MB/s", 10_000, 1_000_000), 1.5)?;
    heal(table, ("1,000 operations behind, 50 kbit/s", 1000, 50_000 / 8), 1.5)?;
    urgent(table)
}

fn ratio(one: u64, other: u64) -> f64 {
    one as f64 / other as f64
}

fn put(number: u64, size: u64) -> Result<Input, Failure> {
    let key = key(number)?;
    let size = usize::try_from(size)?.saturating_sub(key.as_str().len());
    let draft = Draft::new("").put(key, value(number, size));
    let request = CommitRequest { ticket: number, draft, level: AckLevel::Local, until: Time::ZERO };
    Ok(Input::Commit(vec![request], net::WALL))
}

/// Nothing happens.
fn idle(table: &mut Table) -> Result<(), Failure> {
    let mut net = Net::team(ROBOTS, Line { rate: FAST, delay: ROUND_TRIP / 2 })?;
    let before = net.bytes();
    net.run_for(WATCHED)?;
    let links = u64::try_from(ROBOTS * (ROBOTS - 1))?;
    let per_second = ratio(net.bytes() - before, WATCHED.as_secs() * links);
    let name = format!("{ROBOTS} robots idle, bytes/s to each peer");
    table.line(&name, &format!("{per_second:.1} B/s"), (per_second / 20.0, "of 20 B/s"), Reach::AtMost(1.0));
    Ok(())
}

/// Robots write now and then: one robot, or all of them in turn, each after it has received the others' writes.
fn steady(table: &mut Table, (name, writers): (&str, usize)) -> Result<(), Failure> {
    let mut net = Net::team(ROBOTS, Line { rate: FAST, delay: ROUND_TRIP / 2 })?;
    let (before, operations) = (net.bytes(), 4000);
    for number in 0..operations {
        net.tell(usize::try_from(number)? % writers, put(number % 500, 100)?)?;
        net.run_for(Duration::from_millis(100))?;
    }
    let least = operations * (ROBOTS as u64 - 1) * (100 + ENVELOPE);
    let bytes = net.bytes() - before;
    let each = ratio(bytes, operations * (ROBOTS as u64 - 1));
    table.line(name, &format!("{each:.0} B"), (ratio(bytes, least), "of 100 + 32 B"), Reach::AtMost(1.5));
    Ok(())
}

/// One robot has written many operations while the other one was away.
fn heal(table: &mut Table, (name, operations, rate): (&str, u64, u64), most: f64) -> Result<(), Failure> {
    let mut net = Net::team(2, Line { rate, delay: ROUND_TRIP / 2 })?;
    net.cut(0, 1);
    for number in 0..operations {
        net.tell(0, put(number, BACKLOG_SIZE - ENVELOPE)?)?;
    }
    let (began, before) = (net.meet(0, 1)?, net.bytes());
    net.run_until(|net| net.cut_of(1) == net.cut_of(0))?;
    let took = net.now().since(began);
    let limit = ROUND_TRIP + Duration::from_secs_f64(ratio(operations * BACKLOG_SIZE, rate));
    let figure = format!("{:.2} s, {} bytes", took.as_secs_f64(), net.bytes() - before);
    table.line(name, &figure, (took.as_secs_f64() / limit.as_secs_f64(), "of the link alone"), Reach::AtMost(most));
    Ok(())
}

/// The same slow link, and a third robot on it that does not know the backlog. A robot that knows the backlog has to
/// receive it before anything later.
fn urgent(table: &mut Table) -> Result<(), Failure> {
    let rate = 50_000 / 8;
    let mut net = Net::team(3, Line { rate, delay: ROUND_TRIP / 2 })?;
    net.share_air(1);
    net.cut(0, 2);
    net.cut(0, 1);
    for number in 0..1000 {
        net.tell(0, put(number, BACKLOG_SIZE - ENVELOPE)?)?;
    }
    net.meet(0, 1)?;
    net.run_for(URGENT_AFTER)?;
    let began = net.now();
    net.tell(2, put(5000, BACKLOG_SIZE - ENVELOPE)?)?;
    let urgent = net.cut_of(2);
    net.run_until(|net| net.cut_of(1).dominates(&urgent))?;
    let took = net.now().since(began);
    if net.cut_of(1) == net.cut_of(0) {
        return Err("the backlog was over before it could be overtaken".into());
    }
    let chunks = took.as_secs_f64() / net.longest_on_air().as_secs_f64();
    let figure = format!("{} ms", took.as_millis());
    table.line("an urgent one overtakes them", &figure, (chunks, "chunks"), Reach::AtMost(2.0));
    let second = took.as_secs_f64();
    table.line("", "", (second, "s"), Reach::AtMost(1.0));
    Ok(())
}
