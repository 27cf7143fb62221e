//! Programs that hang, and are ended for it.

use super::{LONG, Over, STARTED, Shim, exited, signalled, wait_for};
use comms::io::clock::{Wakeup, now};
use rustix::process::{Pid, Signal, kill_process};
use shim::protocol::{EXIT_FILE, EndReason, Gate, ProgramEnd, ShimOrder, ShimReport, WatchdogBounds};
use std::os::unix::net::UnixDatagram;
use std::time::Duration;

const BOUND: Duration = Duration::from_millis(300);
const HUNG: EndReason = EndReason::Watchdog(BOUND);

fn ended(signal: i32, why: EndReason) -> ShimReport {
    ShimReport::Ended { end: ProgramEnd::Signal(signal), why }
}

/// Starts a shim that is to watch its program; a gate is opened.
fn watched(gate: Gate, silence: Option<Duration>, ready_within: Option<Duration>, script: &str) -> Shim {
    let mut shim = Shim::start_with(|start| {
        (start.gate, start.watchdog) = (gate, WatchdogBounds { silence, ready_within });
        start.command = ["sh", "-c", script].map(str::to_owned).to_vec();
    });
    if gate == Gate::Exec {
        assert_eq!(shim.next(), Some(ShimReport::Ready));
        shim.order(&ShimOrder::Go);
    }
    shim
}

/// A line of Python by which a script speaks to its watcher.
fn say(words: &str) -> String {
    format!(
        "python3 -c 'import os, socket; \
         socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM).sendto(b\"{words}\", os.environ[\"NOTIFY_SOCKET\"])'"
    )
}

#[test]
fn a_program_that_gives_no_sign_of_life_is_ended() {
    let over =
        watched(Gate::Exec, Some(BOUND), None, "exec sleep 60").expect(&[STARTED, ended(6, HUNG), ShimReport::Gone]);
    assert_eq!(over.read(EXIT_FILE), "ended signal 6 watchdog 300\n");
    // The shortest bound that a spec may name.
    let short = Duration::from_millis(20);
    let told = [STARTED, ended(6, EndReason::Watchdog(short)), ShimReport::Gone];
    watched(Gate::Exec, Some(short), None, "exec sleep 60").expect(&told);
    let deaf = "trap '' ABRT; while :; do sleep 0.01; done";
    let began = now();
    watched(Gate::Exec, Some(BOUND), None, deaf).expect(&[STARTED, ended(9, HUNG), ShimReport::Gone]);
    assert!(now() - began >= BOUND + Duration::from_secs(2), "SIGKILL comes after a grace");
}

#[test]
fn a_program_that_is_never_ready_is_ended() {
    let slow = EndReason::StartTimeout(BOUND);
    watched(Gate::Exec, None, Some(BOUND), "exec sleep 60").expect(&[STARTED, ended(6, slow), ShimReport::Gone]);
    // Time enough for an interpreter on a busy machine.
    let script = format!("{}; exit 3", say("READY=1"));
    watched(Gate::Exec, None, Some(LONG), &script).expect(&[STARTED, exited(3), ShimReport::Gone]);
}

/// An SDK program is watched from its first sign on, so a program with an older SDK, which gives none, is left alone.
#[test]
fn a_program_that_speaks_is_watched_from_then_on() {
    let script = format!("{}; echo $$ > up; exec sleep 60", say("WATCHDOG=1"));
    let shim = watched(Gate::None, Some(2 * BOUND), None, &script);
    let program: i32 = wait_for(&shim.dir, "up").trim().parse().unwrap();
    // A suspended process does not get SIGABRT until it is resumed.
    kill_process(Pid::from_raw(program).unwrap(), Signal::STOP).unwrap();
    shim.expect(&[STARTED, ended(6, EndReason::Watchdog(2 * BOUND)), ShimReport::Gone]);

    let environment = "echo $NOTIFY_SOCKET $WATCHDOG_USEC > up; sleep 1; exit 5";
    let shim = watched(Gate::None, Some(BOUND), Some(2 * BOUND), environment);
    let expected = format!("{} 300000\n", shim.dir.join("beat.sock").display());
    let over: Over = shim.expect(&[STARTED, exited(5), ShimReport::Gone]);
    assert_eq!(over.read("up"), expected);
}

#[test]
fn a_program_that_is_being_stopped_is_not_called_hung() {
    let mut shim = watched(Gate::Exec, Some(BOUND), None, "trap '' TERM; echo up > up; while :; do sleep 0.01; done");
    wait_for(&shim.dir, "up");
    shim.order(&ShimOrder::Stop { grace: 4 * BOUND });
    shim.expect(&[STARTED, signalled(9), ShimReport::Gone]);
}

/// The test is not part of the program, so neither its sign of life nor its READY counts.
#[test]
fn the_word_of_another_program_does_not_count() {
    for (watchdog, ready_within, why) in
        [(Some(BOUND), None, HUNG), (None, Some(BOUND), EndReason::StartTimeout(BOUND))]
    {
        let shim = watched(Gate::Exec, watchdog, ready_within, "exec sleep 60");
        let (socket, to) = (UnixDatagram::unbound().unwrap(), shim.dir.join("beat.sock"));
        let speaking = std::thread::spawn(move || {
            let (pause, mut said) = (Wakeup::default(), 0);
            // Until the socket has no receiver any more.
            while socket.send_to(b"WATCHDOG=1\nREADY=1", &to).is_ok() || said == 0 {
                said += u32::from(to.exists());
                pause.wait(Some(now() + Duration::from_millis(20)));
            }
            said
        });
        shim.expect(&[STARTED, ended(6, why), ShimReport::Gone]);
        assert!(speaking.join().unwrap() > 1);
    }
}
