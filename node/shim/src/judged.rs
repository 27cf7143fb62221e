//! Opens the file that the node has judged, and refuses any other. The shim then executes the open file, and not a name.

use comms::logic::human::cause;
use rustix::fs::{Mode, OFlags, open as open_file};
use rustix::io::{FdFlags, fcntl_setfd};
use shim::protocol::{Judged, JudgedBy, Stamp};
use std::fs::File;
use std::io::{self, Read as _};
use std::os::fd::AsRawFd;
use std::path::PathBuf;

/// The bytes by which the kernel recognises a script. Source: execve(2).
const SCRIPT: &[u8; 2] = b"#!";

/// The file that was judged, to be executed.
#[derive(Debug)]
pub(crate) struct Opened {
    path: PathBuf,
    /// The file stays open until this process executes another program.
    _file: File,
}

impl Opened {
    /// Returns the path to execute. It leads to the file that was judged.
    pub(crate) fn path(&self) -> &PathBuf {
        &self.path
    }
}

/// Opens the file that was judged, with the rights that the program has.
///
/// # Errors
/// Returns a sentence if it is gone, or was changed or exchanged since.
pub(crate) fn open(judged: &Judged) -> Result<Opened, String> {
    let path = judged.path.display();
    let failed = |error: io::Error| format!("cannot open `{path}`, which the policy has admitted: {}", cause(&error));
    let file = open_file(&judged.path, OFlags::PATH | OFlags::NOFOLLOW | OFlags::CLOEXEC, Mode::empty());
    let file = File::from(file.map_err(|error| failed(error.into()))?);
    let found = file.metadata().map_err(failed)?;
    if Stamp::of(&found) != judged.stamp {
        return Err(format!("`{path}` was changed or exchanged after the policy had admitted it; deploy it again"));
    }
    let descriptor = PathBuf::from(format!("/proc/self/fd/{}", file.as_raw_fd()));
    // A script has to be readable. Any other program may be executable without being readable.
    let is_script = File::open(&descriptor).is_ok_and(|mut file| {
        let mut first = [0; SCRIPT.len()];
        file.read_exact(&mut first).is_ok() && first == *SCRIPT
    });
    if !is_script {
        return Ok(Opened { path: descriptor, _file: file });
    }
    if judged.by == JudgedBy::Folder {
        return Ok(Opened { path: judged.path.clone(), _file: file });
    }
    // Its interpreter opens the script by this path.
    fcntl_setfd(&file, FdFlags::empty()).map_err(|error| failed(error.into()))?;
    Ok(Opened { path: descriptor, _file: file })
}
