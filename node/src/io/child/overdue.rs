//! Whether the end of a program is overdue: the kernel shows when it has ended, but the shim that has to report how may be suspended.

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

/// How long a shim may take to say how its program has ended before it is looked at; then twice as long each time. A shim that runs may
/// take any time.
const TOLD_WITHIN: Duration = Duration::from_secs(2);
/// The longest time between two looks.
const LOOK_EVERY: Duration = Duration::from_secs(60);

/// The end of a program as the kernel sees it.
#[derive(Debug)]
pub(super) enum Overdue {
    /// Nothing is watched: the program has not begun, or its end was reported.
    No,
    /// It runs.
    Running(AsyncFd<OwnedFd>),
    /// It has ended, and its shim is looked at at this time, after this many looks.
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
        // A program that cannot be watched may have ended, so its shim is looked at.
        watched.map_or_else(Self::ended, Self::Running)
    }

    /// Watches the program of a shim that an earlier node has started. Its shim may have reaped it before it was suspended.
    pub(super) fn recorded(dir: &Path) -> Self {
        let Some(program) = program_of(dir) else { return Self::No };
        let watched = Self::of(program.pid.cast_unsigned());
        // A number that belongs to another process by now shows nothing.
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
            // An error counts as an end. The shim is then examined, and a shim that runs is left alone.
            Self::Running(descriptor) => drop(descriptor.readable().await),
            Self::Ended { look_at, .. } => clock::sleep_until(*look_at).await,
        }
    }

    /// Takes the next step: a suspended shim is resumed, and then killed.
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
