//! The epochs that this node has given out, each durable before the first process of its deployment runs.
//!
//! One line each: `EPOCH NAME`. A torn last line (power cut) is ignored; the epoch after it is still higher than every
//! one that ran, because a deployment runs only after its line is on the disk. Writing blocks for as long as the disk takes,
//! so the driver does it beside its loop, while programs start.
//!
//! After a failure nobody knows what of the file is on the disk: a sync that has failed once may succeed the next time
//! without having written anything. So the next commit writes a new file and puts it in the place of the old one, as it does
//! when somebody has removed the file or put another in its place: what is written to a file without a name is lost.

use crate::logic::protocol::Deployment;
use std::fs::{File, Metadata, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// The journal. Its file is opened for writing with the first epoch: a node whose disk is read-only runs without.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    /// None until the first commit, and after one that has failed.
    file: Option<File>,
    epoch: u64,
}

impl Journal {
    /// Reads a journal, which need not be there.
    ///
    /// # Errors
    /// The file is there and cannot be read.
    pub fn open(path: &Path) -> io::Result<Self> {
        let text = match std::fs::read(path) {
            Ok(bytes) => String::from_utf8_lossy(&bytes).into_owned(),
            Err(error) if error.kind() == io::ErrorKind::NotFound => String::new(),
            Err(error) => return Err(error),
        };
        let epochs = text.lines().filter_map(|line| line.split_once(' ')?.0.parse::<u64>().ok());
        Ok(Self { path: path.to_owned(), file: None, epoch: epochs.max().unwrap_or(0) })
    }

    /// Returns the highest epoch in it.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Writes an epoch; it is on the disk when this returns.
    ///
    /// # Errors
    /// The disk refuses: then it may or may not be there after a power cut. The next commit begins with a file of its own.
    pub fn commit(&mut self, deployment: &Deployment) -> io::Result<()> {
        let line = format!("{} {}\n", deployment.epoch, deployment.name);
        let mut file = match self.file.take().filter(|file| self.is_in_place(file)) {
            Some(file) => file,
            None => self.renew()?,
        };
        file.write_all(line.as_bytes())?;
        file.sync_data()?;
        self.file = Some(file);
        self.epoch = self.epoch.max(deployment.epoch);
        Ok(())
    }

    /// Returns whether the file is the one that stands under the journal's name.
    fn is_in_place(&self, file: &File) -> bool {
        let id = |found: io::Result<Metadata>| found.map(|found| (found.dev(), found.ino())).ok();
        let here = id(std::fs::symlink_metadata(&self.path));
        here.is_some() && here == id(file.metadata())
    }

    /// Makes a new file with the highest epoch in it, durable and in the place of the old one.
    fn renew(&self) -> io::Result<File> {
        let unfinished = self.path.with_extension("new");
        let mut file = OpenOptions::new().create(true).write(true).truncate(true).open(&unfinished)?;
        if self.epoch > 0 {
            writeln!(file, "{} before", self.epoch)?;
        }
        file.sync_data()?;
        std::fs::rename(&unfinished, &self.path)?;
        self.path.parent().map_or(Ok(()), |folder| File::open(folder)?.sync_all())?;
        Ok(file)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn deployment(epoch: u64) -> Deployment {
        Deployment { name: "ok".to_owned(), epoch }
    }

    #[test]
    fn a_journal_that_was_removed_is_written_again() {
        let folder = std::env::temp_dir().join(format!("dca-journal-removed-{}", std::process::id()));
        let path = folder.join("journal");
        std::fs::create_dir_all(&folder).unwrap();
        let mut journal = Journal::open(&path).unwrap();
        journal.commit(&deployment(1)).unwrap();
        std::fs::remove_file(&path).unwrap();
        journal.commit(&deployment(2)).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "1 before\n2 ok\n");
        std::fs::write(folder.join("other"), "").unwrap();
        std::fs::rename(folder.join("other"), &path).unwrap();
        journal.commit(&deployment(3)).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "2 before\n3 ok\n");
        std::fs::remove_dir_all(&folder).unwrap();
        assert!(journal.commit(&deployment(4)).is_err(), "its folder is gone: nothing can be written down");
    }

    /// What is in the way of the new file stands for a disk that refuses.
    #[test]
    fn what_could_not_be_written_is_not_there_and_later_epochs_are() {
        let folder = std::env::temp_dir().join(format!("dca-journal-{}", std::process::id()));
        let path = folder.join("journal");
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(&path, "3 door\n4 ok\n5").unwrap();
        let mut journal = Journal::open(&path).unwrap();
        assert_eq!(journal.epoch(), 4, "a torn line does not count");
        std::fs::create_dir_all(folder.join("journal.new/x")).unwrap();
        assert!(journal.commit(&deployment(5)).is_err());
        assert_eq!((journal.epoch(), Journal::open(&path).unwrap().epoch()), (4, 4));
        std::fs::remove_dir_all(folder.join("journal.new")).unwrap();
        for epoch in [6, 7] {
            journal.commit(&deployment(epoch)).unwrap();
            assert_eq!(Journal::open(&path).unwrap().epoch(), epoch);
        }
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "4 before\n6 ok\n7 ok\n");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
