//! The epochs that this node has given out, each durable before the first process of its deployment runs.
//!
//! One line each: `EPOCH NAME`. A torn last line (power cut) is ignored; the epoch after it is still higher than every
//! one that ran, because a deployment runs only after its line is on the disk. Writing blocks for as long as the disk takes,
//! so the driver does it beside its loop, while programs start.

use crate::logic::protocol::Deployment;
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::Path;

/// The open journal.
#[derive(Debug)]
pub struct Journal {
    file: File,
    epoch: u64,
}

impl Journal {
    /// Opens or makes a journal.
    ///
    /// # Errors
    /// The file cannot be read or written.
    pub fn open(path: &Path) -> io::Result<Self> {
        let text = match std::fs::read(path) {
            Ok(bytes) => String::from_utf8_lossy(&bytes).into_owned(),
            Err(error) if error.kind() == io::ErrorKind::NotFound => String::new(),
            Err(error) => return Err(error),
        };
        let epochs = text.lines().filter_map(|line| line.split_once(' ')?.0.parse::<u64>().ok());
        let epoch = epochs.max().unwrap_or(0);
        let mut file = OpenOptions::new().create(true).append(true).open(path)?;
        if !text.is_empty() && !text.ends_with('\n') {
            file.write_all(b"\n")?;
        }
        Ok(Self { file, epoch })
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
        self.file.write_all(format!("{} {}\n", deployment.epoch, deployment.name).as_bytes())?;
        self.file.sync_data()?;
        self.epoch = self.epoch.max(deployment.epoch);
        Ok(())
    }
}
