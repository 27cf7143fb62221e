//! The program's signs of life for its watcher: they show that its control loop works, not only its process.
//!
//! The loop records its activity in one atomic number, which costs it two stores per round. A separate thread reads
//! that number four times per bound of the watcher. It only sends a sign if the loop has moved, or waits for an order
//! or its next deadline. So nothing is sent for a loop that hangs in a calculation, nor for a suspended process.
//! Source: sd_notify(3).

use comms::io::clock::{Wakeup, now};
use std::os::unix::net::UnixDatagram;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// The number of checks per bound.
const LOOKS: u32 = 4;
/// The shortest time between two checks.
const LOOK_MIN: Duration = Duration::from_millis(1);

/// The state of the loop: its round, and in the two lowest bits how the loop spends its time.
#[derive(Debug, Default)]
pub(super) struct Heartbeat {
    state: AtomicU64,
}

/// How the loop spends its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Spends {
    /// The loop waits for an order, a sample, an answer or its next deadline.
    Waiting = 0,
    /// The loop calculates.
    Working = 1,
    /// The controller is in its `Init`.
    Initialising = 2,
}

impl Heartbeat {
    /// Records how the loop spends its time from now on. Only the loop calls this.
    pub(super) fn enter(&self, spends: Spends) {
        let round = self.state.load(Ordering::Relaxed) >> 2;
        self.state.store((round + 1) << 2 | spends as u64, Ordering::Release);
    }

    /// Returns the sign of life to send now. None if the loop calculates, and has not moved since
    /// `before`, the state at the last check. Updates `before`.
    fn sign(&self, before: &mut Option<u64>) -> Option<String> {
        let state = self.state.load(Ordering::Acquire);
        let moved = before.replace(state) != Some(state);
        match state & 3 {
            2 => Some(format!("X_INIT={}", state >> 2)),
            0 => Some("WATCHDOG=1".to_owned()),
            _ => moved.then(|| "WATCHDOG=1".to_owned()),
        }
    }
}

/// The watcher of this program.
#[derive(Debug)]
pub(super) struct Watcher {
    socket: PathBuf,
    every: Duration,
}

impl Watcher {
    /// Returns the watcher of this program from its environment, if there is one. Source: sd_watchdog_enabled(3).
    pub(super) fn of_environment() -> Option<Self> {
        let bound = std::env::var("WATCHDOG_USEC").ok()?.parse().ok()?;
        let socket = PathBuf::from(std::env::var_os("NOTIFY_SOCKET")?);
        let every = (Duration::from_micros(bound) / LOOKS).max(LOOK_MIN);
        Some(Self { socket, every })
    }

    /// Sends the loop's signs of life as long as the process lives. The first sign has been sent when this returns. A
    /// program is watched from its first sign on, so it cannot be suspended without being watched once its loop runs.
    ///
    /// # Errors
    /// If the thread or its socket cannot be made.
    pub(super) fn tell(self, heartbeat: Arc<Heartbeat>) -> std::io::Result<()> {
        let socket = UnixDatagram::unbound()?;
        // A suspended watcher must not delay the next sign.
        socket.set_nonblocking(true)?;
        let (Self { socket: path, every }, mut before) = (self, None);
        let mut look = move || {
            if let Some(sign) = heartbeat.sign(&mut before)
                && let Err(error) = socket.send_to(sign.as_bytes(), &path)
            {
                tracing::debug!(%error, "cannot send a sign of life");
            }
        };
        look();
        let run = move || {
            let (pause, mut next) = (Wakeup::default(), now());
            loop {
                next = (next + every).max(now());
                pause.wait(Some(next));
                look();
            }
        };
        // A thread that lives as long as the process cannot be joined.
        std::thread::Builder::new().name("heartbeat".to_owned()).spawn(run).map(drop)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_is_a_sign_before_the_loop_begins() {
        let path = std::env::temp_dir().join(format!("dca-heartbeat-{}", std::process::id()));
        let shim = UnixDatagram::bind(&path).unwrap();
        shim.set_nonblocking(true).unwrap();
        let watcher = Watcher { socket: path.clone(), every: Duration::from_secs(3600) };
        watcher.tell(Arc::default()).unwrap();
        let mut bytes = [0; 32];
        let size = shim.recv(&mut bytes).unwrap();
        assert_eq!(&bytes[..size], b"WATCHDOG=1");
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn a_loop_that_stands_still_gives_no_sign() {
        let (heartbeat, mut before) = (Heartbeat::default(), None);
        let mut sign = || heartbeat.sign(&mut before);
        assert_eq!(sign().as_deref(), Some("WATCHDOG=1"), "it waits for its first order");
        assert_eq!(sign().as_deref(), Some("WATCHDOG=1"), "and still does");
        heartbeat.enter(Spends::Working);
        assert_eq!(sign().as_deref(), Some("WATCHDOG=1"), "it has moved");
        assert_eq!(sign(), None, "it hangs");
        for spends in [Spends::Waiting, Spends::Working] {
            heartbeat.enter(spends);
        }
        assert_eq!(sign().as_deref(), Some("WATCHDOG=1"), "it is in another calculation");
        heartbeat.enter(Spends::Initialising);
        assert_eq!([sign(), sign()], [Some("X_INIT=4".to_owned()), Some("X_INIT=4".to_owned())]);
        heartbeat.enter(Spends::Working);
        heartbeat.enter(Spends::Initialising);
        assert_eq!(sign().as_deref(), Some("X_INIT=6"), "the next one");
    }
}
