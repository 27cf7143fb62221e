//! Hears the signs of life of the program, and reports when they stay away.

use crate::watchdog::Watchdog;
use crate::{Event, complain};
use comms::io::clock::now;
use rustix::cmsg_space;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::net::sockopt::set_socket_passcred;
use rustix::net::{RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, recvmsg};
use rustix::process::getpid;
use shim::processes;
use shim::protocol::{BEAT_FILE, Gate, ShimStart};
use std::fs::Permissions;
use std::io::{self, IoSliceMut};
use std::mem::MaybeUninit;
use std::os::unix::fs::{PermissionsExt, chown};
use std::os::unix::net::UnixDatagram;
use std::path::PathBuf;
use std::sync::mpsc::SyncSender;

/// The longest datagram that is read whole, in bytes.
const DATAGRAM_MAX: usize = 512;
/// How many parents of a sender are looked at.
const ANCESTORS_MAX: usize = 100;

/// The socket for the program's signs of life.
pub(crate) struct Beats {
    socket: UnixDatagram,
}

impl Beats {
    /// Opens the socket of the instance; none if the program is not watched.
    pub(crate) fn open(start: &ShimStart) -> io::Result<Option<Self>> {
        if start.watchdog.shortest().is_none() {
            return Ok(None);
        }
        let path = path(start);
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let socket = UnixDatagram::bind(&path)?;
        set_socket_passcred(&socket, true)?;
        std::fs::set_permissions(&path, Permissions::from_mode(0o700))?;
        if let Some(user) = &start.sandbox.user {
            chown(&path, Some(user.uid), Some(user.gid))?;
        }
        Ok(Some(Self { socket }))
    }

    /// Watches the program, which has just been started; ends with the first alarm.
    pub(crate) fn watch(self, start: &ShimStart, program: i32, events: SyncSender<Event>) -> io::Result<()> {
        let from_start = start.gate == Gate::Exec;
        let Some(watchdog) = Watchdog::new(start.watchdog, from_start, now()) else {
            return Ok(());
        };
        let run = move || {
            if let Err(error) = self.run(watchdog, program, &events) {
                complain(&format!("dca-shim: the program is not watched any more: {error}"));
            }
        };
        std::thread::Builder::new().name("watchdog".into()).spawn(run).map(drop)
    }

    /// Takes a waiting message: its length, and its sender as the kernel reports it.
    fn take(&self, bytes: &mut [u8]) -> Result<(usize, Option<i32>), Errno> {
        let mut space = [MaybeUninit::uninit(); cmsg_space!(ScmCredentials(1))];
        let mut control = RecvAncillaryBuffer::new(&mut space);
        let received = recvmsg(&self.socket, &mut [IoSliceMut::new(bytes)], &mut control, RecvFlags::empty())?;
        let sender = control.drain().find_map(|message| {
            let RecvAncillaryMessage::ScmCredentials(sender) = message else { return None };
            Some(sender.pid.as_raw_nonzero().get())
        });
        Ok((received.bytes, sender))
    }

    fn run(self, mut watchdog: Watchdog, program: i32, events: &SyncSender<Event>) -> io::Result<()> {
        let mut bytes = [0; DATAGRAM_MAX];
        self.socket.set_nonblocking(true)?;
        loop {
            // Not by the time limit of the socket: the kernel rounds that up to 4 ms and more, too much for a bound of
            // 20 ms.
            let left = watchdog.next_look().since(now());
            let left = Timespec::try_from(left).unwrap_or(Timespec { tv_sec: 1, tv_nsec: 0 });
            match poll(&mut [PollFd::new(&self.socket, PollFlags::IN)], Some(&left)) {
                Ok(_) | Err(Errno::INTR) => {}
                Err(error) => return Err(error.into()),
            }
            match self.take(&mut bytes) {
                Ok((size, sender)) if sender.is_none_or(|sender| is_own(sender, program)) => {
                    watchdog.hear(&String::from_utf8_lossy(&bytes[..size]), now());
                }
                Ok(_of_another_program) => {}
                Err(Errno::INTR | Errno::WOULDBLOCK) => {}
                Err(error) => return Err(error.into()),
            }
            let Some(why) = watchdog.look(now()) else { continue };
            if processes::is_traced(program) {
                watchdog.forgive();
                continue;
            }
            // If the supervision is over, the event has no receiver.
            events.send(Event::Overdue(why)).unwrap_or_default();
            return Ok(());
        }
    }
}

/// Whether a process is the program, or descends from it. For a process that is already gone this is unknown: a script
/// may have sent the message by a command that ends right away.
fn is_own(sender: i32, program: i32) -> bool {
    let this = getpid().as_raw_nonzero().get();
    let mut process = sender;
    for _ in 0..ANCESTORS_MAX {
        if process == program || process == this {
            return true;
        }
        match processes::stat(process) {
            Some(stat) => process = stat.parent,
            None => return process == sender,
        }
    }
    false
}

fn path(start: &ShimStart) -> PathBuf {
    start.sandbox.own.as_ref().unwrap_or(&start.dir).join(BEAT_FILE)
}

/// The variables by which a program learns that it is watched. Source: sd_watchdog_enabled(3).
pub(crate) fn environment(start: &ShimStart) -> Vec<(&'static str, String)> {
    let Some(bound) = start.watchdog.shortest() else { return Vec::new() };
    let socket = path(start).display().to_string();
    vec![("NOTIFY_SOCKET", socket), ("WATCHDOG_USEC", bound.as_micros().to_string())]
}
