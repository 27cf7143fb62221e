//! A command on a terminal. The command cannot distinguish the terminal from a person's.

use super::SOON;
use comms::io::clock::now;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fd::OwnedFd;
use rustix::fs::{Mode, OFlags};
use rustix::process::{Pid, Signal, kill_process};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{Winsize, tcsetwinsize};
use std::process::{Command, Stdio};

/// The rows of a terminal.
pub(super) const ROWS: u16 = 24;

/// A terminal.
pub(super) struct Terminal {
    /// The end that a person would see.
    pub(super) screen: OwnedFd,
    /// The end of the command.
    pub(super) line: OwnedFd,
}

/// Opens a terminal.
pub(super) fn open(columns: u16) -> Terminal {
    let screen = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).expect("there are pseudo-terminals");
    grantpt(&screen).and_then(|()| unlockpt(&screen)).expect("the terminal is this test's own");
    let name = ptsname(&screen, Vec::new()).expect("a terminal has a name");
    let line = rustix::fs::open(name.as_c_str(), OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty());
    let line = line.expect("the terminal is there");
    let size = Winsize { ws_row: ROWS, ws_col: columns, ws_xpixel: 0, ws_ypixel: 0 };
    tcsetwinsize(&line, size).expect("a terminal has a size");
    Terminal { screen, line }
}

/// Runs a command to its end, and interrupts it once it has written `wanted`. Returns its exit code and all of its
/// output.
///
/// # Panics
/// Panics if the command does not end within `SOON`, or if no terminal can be opened.
pub(super) fn run(mut command: Command, columns: u16, mut wanted: Option<&str>) -> (Option<i32>, String) {
    let Terminal { screen, line } = open(columns);
    let other = line.try_clone().expect("a descriptor is left");
    command.stdin(Stdio::null()).stdout(line).stderr(other);
    let mut child = command.spawn().expect("it can be started");
    // `command` holds ends of the line. While they are open, the end of the last writer would go unnoticed.
    drop(command);
    let (mut written, deadline) = (Vec::new(), now() + SOON);
    let mut chunk = [0; 4096];
    loop {
        let left = Timespec::try_from(deadline.since(now())).expect("half a minute is a time");
        let mut fds = [PollFd::new(&screen, PollFlags::IN)];
        let ready = poll(&mut fds, Some(&left)).expect("a terminal can be waited for");
        if ready == 0 {
            drop(child.kill());
            panic!("it has not ended within {SOON:?}:\n{}", String::from_utf8_lossy(&written));
        }
        match rustix::io::read(&screen, &mut chunk) {
            // A terminal without writers returns an error instead of the end of the file.
            Ok(0) | Err(_) => break,
            Ok(size) => written.extend(&chunk[..size]),
        }
        if wanted.is_some_and(|wanted| String::from_utf8_lossy(&written).contains(wanted)) {
            kill_process(Pid::from_child(&child), Signal::INT).expect("it has not been waited for");
            wanted = None;
        }
    }
    let status = child.wait().expect("it was started here");
    (status.code(), String::from_utf8_lossy(&written).into_owned())
}
