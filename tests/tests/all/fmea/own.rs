//! Plays a row with the door's own programs. The phase begins when the robot reaches it.

use super::play::{Strike, crash};
use super::row::Row;
use super::seen::Seen;
use dca_tests::cluster::{Cluster, SOON, Stream, Trace, spec};
use rustix::process::Signal;
use std::time::Duration;

const MISSION_MAX: Duration = Duration::from_secs(90);
/// The lines at the beginning of the phases, on standard error.
const PHASES: [&str; 2] = ["▸ (visualserv # distdetect)", "▸ ((opengrip, approach) # hit)"];

/// Plays a row in which a crash in this phase makes the mission fail. The phases are counted from 1.
pub(crate) fn play_own(row: &Row, strike: Strike, phase: usize) {
    let program = row.program.as_deref().expect("a row of a program");
    let cluster = Cluster::new();
    let mission = cluster.here().dca(&["run", &spec("door_opening")]);
    // The second line of a phase comes 2 s after the first. By then everything has begun, and the hand is open.
    mission.wait_for_times(Stream::Err, PHASES[phase - 1], 2, MISSION_MAX);
    if let Strike::Signal(signal) = strike {
        crash(&cluster, program, signal);
    } else {
        cluster.expect_leaf(program).signal(Signal::STOP);
    }
    let ended = mission.ended(SOON);
    assert_eq!((ended.code, row.mission.as_str()), (Some(1), "fails"), "{}: {ended}", row.name);
    cluster.expect_nothing_left(Duration::from_secs(2));
    let trace = Trace::read(&cluster.folder().join("runs/door_opening-1"));
    let seen = Seen::since_the_end_of(&trace, program);
    seen.expect_at_once(row);
    let (took, within) = (seen.safe_after(), row.safe_within.expect("the row says that it is safe"));
    println!("{}: safe after {took:.2?}, the row says {within:?}", row.name);
    assert!(took <= within && row.running.is_empty(), "{}: safe after {took:?}, {within:?}", row.name);
}
