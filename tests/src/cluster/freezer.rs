//! A control group whose processes cannot be ended. Even SIGKILL reaches them only after they are thawed.

use super::{SOON, wait_until};
use std::path::{Path, PathBuf};
use std::process;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

/// Numbers the freezers of this process.
static FREEZERS: AtomicU32 = AtomicU32::new(0);

/// A group of the freezer, version 1. Dropping it thaws its processes.
#[derive(Debug)]
pub struct Freezer(PathBuf);

impl Freezer {
    /// Makes a group. Returns none, and prints a note, if a test cannot have one.
    ///
    /// # Panics
    /// Panics if the new group cannot be removed.
    #[expect(clippy::print_stdout, reason = "who runs the tests has to know what was skipped")]
    pub fn new() -> Option<Self> {
        let made = Self::make();
        made.inspect_err(|why| println!("skipped: needs the freezer of control groups, version 1: {why}")).ok()
    }

    fn make() -> Result<Self, String> {
        let folder = Path::new("/sys/fs/cgroup/freezer").join(format!(
            "dca-test-{}-{}",
            process::id(),
            FREEZERS.fetch_add(1, Relaxed)
        ));
        std::fs::create_dir(&folder).map_err(|error| error.to_string())?;
        if folder.join("freezer.state").is_file() {
            return Ok(Self(folder));
        }
        std::fs::remove_dir(&folder).expect("it is empty");
        Err("this is no such group".to_owned())
    }

    /// Freezes a process.
    ///
    /// # Panics
    /// Panics if the process is gone or does not freeze.
    pub fn freeze(&self, pid: u32) {
        std::fs::write(self.0.join("tasks"), pid.to_string()).expect("the process is there");
        std::fs::write(self.0.join("freezer.state"), "FROZEN").expect("the group is the test's own");
        let is_frozen = || std::fs::read_to_string(self.0.join("freezer.state")).is_ok_and(|state| state == "FROZEN\n");
        wait_until(SOON, is_frozen).expect("it freezes");
    }
}

impl Drop for Freezer {
    fn drop(&mut self) {
        drop(std::fs::write(self.0.join("freezer.state"), "THAWED"));
        wait_until(SOON, || std::fs::remove_dir(&self.0).is_ok());
    }
}
