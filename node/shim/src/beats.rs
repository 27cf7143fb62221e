//! Hears the signs of life of the program, and reports when they stay away.

use crate::watchdog::Watchdog;
use crate::{Event, complain};
use comms::io::clock::now;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use shim::processes;
use shim::protocol::{BEAT_FILE, Gate, ShimStart};
use std::fs::Permissions;
use std::io;
use std::os::unix::fs::{PermissionsExt, chown};
use std::os::unix::net::UnixDatagram;
use std::path::PathBuf;
use std::sync::mpsc::SyncSender;

/// The longest datagram that is read whole, in bytes.
const DATAGRAM_MAX: usize = 512;

/// Where the program says that it lives.
pub(crate) struct Beats {
    socket: UnixDatagram,
}

impl Beats {
    /// Opens the socket of the instance; none if nobody watches.
    pub(crate) fn open(start: &ShimStart) -> io::Result<Option<Self>> {
        if start.watchdog.is_none() && start.ready_within.is_none() {
            return Ok(None);
        }
        let path = path(start);
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let socket = UnixDatagram::bind(&path)?;
        std::fs::set_permissions(&path, Permissions::from_mode(0o700))?;
        if let Some(user) = &start.sandbox.user {
            chown(&path, Some(user.uid), Some(user.gid))?;
        }
        Ok(Some(Self { socket }))
    }

    /// Watches the program, which has just been started; ends with the first alarm.
    pub(crate) fn watch(self, start: &ShimStart, program: i32, events: SyncSender<Event>) -> io::Result<()> {
        let from_start = start.gate == Gate::Exec;
        let Some(watchdog) = Watchdog::new(start.watchdog, start.ready_within, from_start, now()) else {
            return Ok(());
        };
        let run = move || {
            if let Err(error) = self.run(watchdog, program, &events) {
                complain(&format!("dca-shim: the program is not watched any more: {error}"));
            }
        };
        std::thread::Builder::new().name("watchdog".into()).spawn(run).map(drop)
    }

    fn run(self, mut watchdog: Watchdog, program: i32, events: &SyncSender<Event>) -> io::Result<()> {
        let mut bytes = [0; DATAGRAM_MAX];
        self.socket.set_nonblocking(true)?;
        loop {
            // Not by the time limit of the socket: the kernel rounds that up to 4 ms and more, too much for a bound of 20 ms.
            let left = watchdog.next_look().since(now());
            let left = Timespec::try_from(left).unwrap_or(Timespec { tv_sec: 1, tv_nsec: 0 });
            match poll(&mut [PollFd::new(&self.socket, PollFlags::IN)], Some(&left)) {
                Ok(_) | Err(Errno::INTR) => {}
                Err(error) => return Err(error.into()),
            }
            match self.socket.recv(&mut bytes) {
                Ok(size) => watchdog.hear(&String::from_utf8_lossy(&bytes[..size]), now()),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                Err(error) => return Err(error),
            }
            let Some(why) = watchdog.look(now()) else { continue };
            if processes::is_traced(program) {
                watchdog.forgive();
                continue;
            }
            // Nobody is there who could not hear it but a supervision that is over.
            events.send(Event::Overdue(why)).unwrap_or_default();
            return Ok(());
        }
    }
}

fn path(start: &ShimStart) -> PathBuf {
    start.sandbox.own.as_ref().unwrap_or(&start.dir).join(BEAT_FILE)
}

/// The variables by which a program learns that it is watched. Source: sd_watchdog_enabled(3).
pub(crate) fn environment(start: &ShimStart) -> Vec<(&'static str, String)> {
    let Some(bound) = start.watchdog.into_iter().chain(start.ready_within).min() else { return Vec::new() };
    let socket = path(start).display().to_string();
    vec![("NOTIFY_SOCKET", socket), ("WATCHDOG_USEC", bound.as_micros().to_string())]
}
