//! The rows of `dca fmea specs/door_opening.dca --json`, on the real system. Each row named here is reproduced with
//! real programs, supervisors and nodes. The tests compare the immediate effects, the programs that still run, the time
//! until none runs, and the result for the mission.
//!
//! A row includes the story before the fault. The driver plays this story, causes the fault, and compares. Most rows
//! are played with stand-ins (`dca-fakes`). These have the interfaces of the door's controllers, but no physics. The
//! spec, the supervisors, the shims and the nodes are the real ones, and a step ends when the test says so. The rows of
//! `own` are played with the door's own programs, and those of `hosts` on three nodes in namespaces.

#![expect(clippy::print_stdout, reason = "a test says how long what it has seen took")]

mod hosts;
mod own;
mod play;
mod row;
mod seen;

use hosts::{Loss, play_on_hosts};
use own::play_own;
use play::{Strike, play};
use row::{Row, rows};
use rustix::process::Signal;

/// A row by its first three columns, without `dooropensyst/`, and the way to cause its fault.
type Case = (&'static str, &'static str, &'static str, Strike);

#[track_caller]
fn check(cases: &[Case]) {
    let rows = rows();
    for (program, fault, phase, strike) in cases {
        play(&Row::find(&rows, program, fault, phase), *strike);
    }
}

/// One row of each kind. The long tests play the others.
#[test]
fn a_crash_a_hang_and_a_limit() {
    check(&[
        ("presshandle", "crash", "alone", SEGV),
        ("closegrip/force", "hang", "closegrip/fingers", Strike::Hang),
        ("approach", "hang", "hit", Strike::Hang),
    ]);
}

#[test]
fn a_loss_of_a_host() {
    play_on_hosts(&Row::find(&rows(), "host c2", "loss of host", "presshandle"), Loss::Death);
}

const KILL: Strike = Strike::Signal(Signal::KILL);
const SEGV: Strike = Strike::Signal(Signal::SEGV);

#[test]
#[ignore = "long: rows of the table, with real programs"]
fn crashes_of_the_first_phase() {
    check(&[
        ("distdetect/laser", "crash", "distdetect/threshold", KILL),
        ("distdetect/threshold", "crash", "alone", SEGV),
        ("visualserv", "crash", "distdetect", KILL),
        ("motionctrl/puma", "crash", "distdetect", Strike::Suspend),
        ("world", "crash", "dooropensyst", KILL),
    ]);
}

#[test]
#[ignore = "long: rows of the table, with real programs"]
fn crashes_of_the_later_phases() {
    check(&[
        ("hit/force", "crash", "approach, opengrip, hit/threshold", KILL),
        ("hit/threshold", "crash", "approach", SEGV),
        ("closegrip/fingers", "crash", "alone", KILL),
        ("closegrip/compliant", "crash", "closegrip/fingers", SEGV),
        ("presshandle", "crash", "alone", KILL),
        ("dooropen/model", "crash", "alone", KILL),
        ("dooropen/add", "crash", "dooropen/model", Strike::Suspend),
        ("motionctrl/redundancy", "crash", "dooropen", KILL),
    ]);
}

/// Two of the three operands of a race are a join. A failure there is noticed only once the other operand is done.
#[test]
#[ignore = "long: rows of the table, with real programs"]
fn what_a_race_forgives_for_a_while() {
    check(&[
        ("approach", "crash", "hit, opengrip", KILL),
        ("approach", "crash", "hit", KILL),
        ("opengrip", "crash", "approach, hit", KILL),
    ]);
}

#[test]
#[ignore = "long: rows of the table, with real programs"]
fn hangs_that_nobody_notices() {
    check(&[
        ("distdetect/laser", "hang", "distdetect/threshold", Strike::Hang),
        ("hit/force", "hang", "approach, hit/threshold", Strike::Hang),
        ("closegrip/force", "hang", "closegrip/fingers", Strike::Hang),
        ("dooropen/add", "hang", "dooropen/model", Strike::Hang),
        ("world", "hang", "dooropensyst", Strike::Hang),
    ]);
}

#[test]
#[ignore = "long: rows of the table, with real programs"]
fn hangs_that_a_limit_ends() {
    check(&[
        ("closegrip/fingers", "hang", "alone", Strike::Hang),
        ("presshandle", "hang", "alone", Strike::Hang),
        ("approach", "hang", "hit", Strike::Hang),
    ]);
}

#[test]
fn a_stop_that_nobody_confirms() {
    check(&[("approach", "stop unanswered", "alone", Strike::Freeze)]);
}

#[test]
#[ignore = "long: rows of the table, with real programs"]
fn another_stop_that_nobody_confirms() {
    check(&[("closegrip/force", "stop unanswered", "alone", Strike::Freeze)]);
}

/// This row is played with the door's own programs and its physics.
#[test]
#[ignore = "long: rows of the table, with real programs"]
fn the_doors_own_programs_while_it_servos() {
    let rows = rows();
    for (program, fault, phase, strike) in [
        ("distdetect/laser", "crash", "distdetect/threshold", KILL),
        ("distdetect/threshold", "crash", "alone", SEGV),
        ("visualserv", "crash", "distdetect", SEGV),
        ("motionctrl/puma", "crash", "distdetect", KILL),
        ("motionctrl/redundancy", "crash", "distdetect", Strike::Suspend),
        ("world", "crash", "dooropensyst", KILL),
    ] {
        play_own(&Row::find(&rows, program, fault, phase), strike, 1);
    }
}

#[test]
#[ignore = "long: rows of the table, with real programs"]
fn the_doors_own_programs_while_it_approaches() {
    let rows = rows();
    for (program, fault, phase) in
        [("hit/force", "crash", "approach, hit/threshold"), ("motionctrl/puma", "crash", "approach, hit")]
    {
        play_own(&Row::find(&rows, program, fault, phase), KILL, 2);
    }
}

/// On three nodes in namespaces.
#[test]
#[ignore = "long: rows of the table, with real programs"]
fn losses_of_hosts() {
    let rows = rows();
    for (host, fault, phase, loss) in [
        ("host c1", "loss of host", "distdetect/threshold", Loss::Death),
        ("host c1", "loss of host", "closegrip", Loss::Death),
        ("host c2", "loss of host", "presshandle", Loss::Death),
        ("host c2", "cut off", "closegrip", Loss::Cut),
        ("host c3", "loss of host", "distdetect/threshold", Loss::Death),
        ("c3 - c2", "loss of link", "dooropen/model", Loss::Between(2, 3)),
    ] {
        play_on_hosts(&Row::find(&rows, host, fault, phase), loss);
    }
}
