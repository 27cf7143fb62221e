//! The epochs that this node has given out, each durable before the first process of its deployment runs.
//!
//! One line each: `EPOCH NAME`. A torn last line (power cut) is ignored; the epoch after it is still higher than every
//! one that ran, because a deployment runs only after its line is on the disk. Writing blocks for as long as the disk takes,
//! so the driver does it beside its loop, while programs start.

use crate::logic::protocol::Deployment;
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

/// The open journal.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    /// None while the disk takes no writes.
    file: Option<File>,
    epoch: u64,
}

impl Journal {
    /// Opens or makes a journal. On a disk that can only be read it is read; what is committed is refused.
    ///
    /// # Errors
    /// The file cannot be read, or not be written for another reason.
    pub fn open(path: &Path) -> io::Result<Self> {
        let text = match std::fs::read(path) {
            Ok(bytes) => String::from_utf8_lossy(&bytes).into_owned(),
            Err(error) if error.kind() == io::ErrorKind::NotFound => String::new(),
            Err(error) => return Err(error),
        };
        let epochs = text.lines().filter_map(|line| line.split_once(' ')?.0.parse::<u64>().ok());
        let epoch = epochs.max().unwrap_or(0);
        let file = match append(path) {
            Err(error) if error.kind() == io::ErrorKind::ReadOnlyFilesystem => None,
            opened => Some(opened?),
        };
        Ok(Self { path: path.to_owned(), file, epoch })
    }

    /// Returns the highest epoch in it.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Writes an epoch; it is on the disk when this returns.
    ///
    /// # Errors
    /// The disk refuses.
    pub fn commit(&mut self, deployment: &Deployment) -> io::Result<()> {
        let mut file = match self.file.take() {
            Some(file) => file,
            None => append(&self.path)?,
        };
        let written = file.write_all(format!("{} {}\n", deployment.epoch, deployment.name).as_bytes());
        let synced = written.and_then(|()| file.sync_data());
        self.file = Some(file);
        synced?;
        self.epoch = self.epoch.max(deployment.epoch);
        Ok(())
    }
}

/// Opens the file to write behind what is in it, on a line of its own.
fn append(path: &Path) -> io::Result<File> {
    let mut file = OpenOptions::new().create(true).append(true).read(true).open(path)?;
    let mut text = Vec::new();
    file.read_to_end(&mut text)?;
    if text.last().is_some_and(|last| *last != b'\n') {
        file.write_all(b"\n")?;
    }
    Ok(file)
}
