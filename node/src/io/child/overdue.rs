//! Finds programs whose end is overdue. The kernel shows that a program has ended, but its shim has not reported how:
//! the shim may be suspended.

use super::leftovers::{press_shim, program_of};
use comms::io::clock;
use comms::logic::time::Time;
use rustix::process::{Pid, PidfdFlags, pidfd_open};
use shim::processes;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::io::Interest;
use tokio::io::unix::AsyncFd;

/// How long a shim may take to report the end of its program. Then the node looks at the shim; each further look comes
/// after twice as long. A shim that is not suspended may take any time.
const TOLD_WITHIN: Duration = Duration::from_secs(2);
/// The longest time between two looks.
const LOOK_EVERY: Duration = Duration::from_secs(60);

/// The end of a program, as the kernel shows it.
#[derive(Debug)]
pub(super) enum Overdue {
    /// Nothing is watched: the program has not begun, or its end was reported.
    No,
    /// The program runs.
    Running(AsyncFd<OwnedFd>),
    /// The program has ended. The node looks at its shim at this time. It has looked this many times.
    Ended { look_at: Time, looks: u32 },
}

impl Overdue {
    /// Watches a program that has been started.
    pub(super) fn of(pid: u32) -> Self {
        let number = i32::try_from(pid).ok().and_then(Pid::from_raw);
        let descriptor = number.and_then(|number| pidfd_open(number, PidfdFlags::empty()).ok());
        #[expect(
            deprecated,
            reason = "its successor is unsafe; an `OwnedFd` keeps its descriptor open, which is all that is asked"
        )]
        let watched = descriptor.and_then(|descriptor| AsyncFd::with_interest(descriptor, Interest::READABLE).ok());
        // If a program cannot be watched, it may have ended, so the node looks at its shim.
        watched.map_or_else(Self::ended, Self::Running)
    }

    /// Watches the program of a shim that an earlier node has started. The shim may have collected the end of the
    /// program and been suspended afterwards.
    pub(super) fn recorded(dir: &Path) -> Self {
        let Some(program) = program_of(dir) else { return Self::No };
        let watched = Self::of(program.pid.cast_unsigned());
        // If the process id belongs to another process by now, the program has ended.
        if processes::is_there(program) { watched } else { Self::ended() }
    }

    fn ended() -> Self {
        Self::Ended { look_at: clock::now() + TOLD_WITHIN, looks: 0 }
    }

    /// Waits until there is something to do.
    ///
    /// # Cancellation
    /// Safe.
    pub(super) async fn wait(&self) {
        match self {
            Self::No => std::future::pending().await,
            // An error counts as an end. The node then looks at the shim, and does nothing if the shim is not suspended.
            Self::Running(descriptor) => drop(descriptor.readable().await),
            Self::Ended { look_at, .. } => clock::sleep_until(*look_at).await,
        }
    }

    /// Takes the next step. A suspended shim is first resumed; if this does not help, it is killed.
    pub(super) async fn act(&mut self, dir: &Path) {
        let Self::Ended { looks, .. } = *self else {
            *self = Self::ended();
            return;
        };
        let dir: PathBuf = dir.to_owned();
        let pressing = tokio::task::spawn_blocking(move || press_shim(&dir, looks > 0));
        if let Err(error) = pressing.await {
            tracing::warn!(%error, "a shim was not looked at");
        }
        let pause = LOOK_EVERY.min(TOLD_WITHIN.saturating_mul(1 << looks.min(8)));
        *self = Self::Ended { look_at: clock::now() + pause, looks: looks + 1 };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shim::process_record::{ProcessRecord, RECORD_FILE};
    use std::process::Command;

    /// The shim is suspended between the end of its program and its report of that end.
    #[test]
    fn a_program_that_was_reaped_before_its_node_looks_has_ended() {
        let dir = std::env::temp_dir().join(format!("dca-overdue-{}", std::process::id()));
        std::fs::create_dir_all(&dir).unwrap();
        let mut child = Command::new("true").spawn().unwrap();
        let program = processes::stat(child.id().cast_signed()).unwrap().process;
        child.wait().unwrap();
        let record = ProcessRecord::default().head() + &ProcessRecord::program_line(program);
        std::fs::write(dir.join(RECORD_FILE), record).unwrap();
        let runtime = tokio::runtime::Runtime::new().unwrap();
        let _entered = runtime.enter();
        let overdue = Overdue::recorded(&dir);
        std::fs::remove_dir_all(&dir).unwrap();
        assert!(matches!(overdue, Overdue::Ended { looks: 0, .. }), "{overdue:?}");
    }
}
