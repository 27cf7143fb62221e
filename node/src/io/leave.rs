//! The signals that ask a node to end.

use std::io;
use tokio::signal::unix::{Signal, SignalKind, signal};

/// The number of SIGHUP. Source: signal(7), Linux.
const HANGUP: u32 = 1;

/// SIGTERM and SIGINT. Also SIGHUP, unless the parent of this process made the process ignore it, like nohup(1).
#[derive(Debug)]
pub(crate) struct Leave {
    terminate: Signal,
    interrupt: Signal,
    hang_up: Option<Signal>,
}

impl Leave {
    /// Handles the signals from now on.
    ///
    /// # Errors
    /// The system does not allow it to handle signals.
    pub(crate) fn new() -> io::Result<Self> {
        // If this is not known, the inherited handling of SIGHUP stays.
        let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
        let hang_up = match is_ignored(&status, HANGUP) {
            Some(false) => Some(signal(SignalKind::hangup())?),
            Some(true) | None => None,
        };
        Ok(Self { terminate: signal(SignalKind::terminate())?, interrupt: signal(SignalKind::interrupt())?, hang_up })
    }

    /// Waits for the next of these signals. Returns its name.
    ///
    /// # Cancellation
    /// Safe.
    pub(crate) async fn asked(&mut self) -> &'static str {
        let hang_up = async {
            match &mut self.hang_up {
                Some(signal) => signal.recv().await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            _ = self.terminate.recv() => "SIGTERM",
            _ = self.interrupt.recv() => "SIGINT",
            _ = hang_up => "SIGHUP",
        }
    }
}

/// Returns whether a process ignores a signal, according to its `status`. Source: proc_pid_status(5), `SigIgn`.
fn is_ignored(status: &str, signal: u32) -> Option<bool> {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"))?;
    let mask = u64::from_str_radix(mask.trim(), 16).ok()?;
    Some(mask >> (signal - 1) & 1 == 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_process_ignores_is_read_from_its_status() {
        let status = |mask: &str| format!("Name:\tdca-node\nSigBlk:\t0000000000000000\nSigIgn:\t{mask}\nSigCgt:\t0\n");
        assert_eq!(is_ignored(&status("0000000000000001"), HANGUP), Some(true));
        assert_eq!(is_ignored(&status("0000000000001000"), HANGUP), Some(false));
        assert_eq!(is_ignored("Name:\tdca-node\n", HANGUP), None);
        assert_eq!(is_ignored(&status("none"), HANGUP), None);
    }
}
