//! The journal: the epochs that this node has given out. Each is durable before the first process of its deployment runs.
//!
//! One line each: `EPOCH NAME`, then `hosts EPOCH HOST …`, and `over EPOCH` once every host has confirmed its end: what is not
//! over when a node starts is asked for. A torn last line (power cut) is ignored; the epoch after it is still higher than every
//! one that ran, because a deployment runs only after its line is on the disk. Writing blocks for as long as the disk takes,
//! so the driver does it beside its loop, while programs start.
//!
//! After a failure nobody knows what of the file is on the disk: a sync that has failed once may succeed the next time
//! without having written anything. So the next commit writes a new file and puts it in the place of the old one, as it does
//! when somebody has removed the file or put another in its place: what is written to a file without a name is lost.

use crate::logic::absence::ENDS_MAX;
use crate::logic::protocol::Deployment;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::{File, Metadata, OpenOptions};
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// How many deployments that are not over it carries on.
const OPEN_MAX: usize = 4 * ENDS_MAX;

/// The journal. Its file is opened for writing with the first epoch: a node whose disk is read-only runs without.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    /// None until the first commit, and after one that has failed.
    file: Option<File>,
    epoch: u64,
    /// The deployments that are not over, with their hosts.
    open: BTreeMap<u64, (Deployment, Vec<String>)>,
    /// Epochs that are over, and not written down yet.
    early: BTreeSet<u64>,
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
        let epoch = epochs.max().unwrap_or(0);
        Ok(Self { path: path.to_owned(), file: None, epoch, open: open(&text), early: BTreeSet::new() })
    }

    /// Returns the deployments that are not over, with their hosts: of many the latest.
    pub fn open_ends(&self) -> Vec<(Deployment, Vec<String>)> {
        self.open.values().rev().take(ENDS_MAX).cloned().collect()
    }

    /// Returns the highest epoch in it.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Writes an epoch; it is on the disk when this returns.
    ///
    /// # Errors
    /// The disk refuses: then it may or may not be there after a power cut. The next commit begins with a file of its own.
    pub fn commit(&mut self, deployment: &Deployment, hosts: &[String]) -> io::Result<()> {
        let hosts = if self.early.remove(&deployment.epoch) { &[] } else { hosts };
        self.append(&begun(deployment, hosts))?;
        self.epoch = self.epoch.max(deployment.epoch);
        if !hosts.is_empty() {
            self.open.insert(deployment.epoch, (deployment.clone(), hosts.to_vec()));
        }
        while self.open.len() > OPEN_MAX {
            self.open.pop_first();
        }
        Ok(())
    }

    /// Writes that every host has confirmed the end of a deployment.
    ///
    /// # Errors
    /// The disk refuses: then the hosts are asked once more when the node is started again.
    pub fn settle(&mut self, epoch: u64) -> io::Result<()> {
        if epoch > self.epoch {
            // It is over before its beginning is on the disk.
            self.early.insert(epoch);
            return Ok(());
        }
        self.open.remove(&epoch).map_or(Ok(()), |_open| self.append(&format!("over {epoch}\n")))
    }

    fn append(&mut self, line: &str) -> io::Result<()> {
        let mut file = match self.file.take().filter(|file| self.is_in_place(file)) {
            Some(file) => file,
            None => self.renew()?,
        };
        file.write_all(line.as_bytes())?;
        file.sync_data()?;
        self.file = Some(file);
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
        for (deployment, hosts) in self.open.values() {
            file.write_all(begun(deployment, hosts).as_bytes())?;
        }
        file.sync_data()?;
        std::fs::rename(&unfinished, &self.path)?;
        self.path.parent().map_or(Ok(()), |folder| File::open(folder)?.sync_all())?;
        Ok(file)
    }
}

/// Writes an epoch into a journal that others use, too. Blocks for as long as the disk takes.
///
/// # Errors
/// The disk refuses; the words are for a person.
pub fn commit(journal: &Mutex<Journal>, deployment: &Deployment, hosts: &[String]) -> Result<(), String> {
    let mut journal = journal.lock().unwrap_or_else(PoisonError::into_inner);
    journal.commit(deployment, hosts).map_err(|error| error.to_string())
}

/// Writes the end of a deployment into a journal that others use, too. Blocks for as long as the disk takes.
pub fn settle(journal: &Mutex<Journal>, deployment: &Deployment) {
    if let Err(error) = journal.lock().unwrap_or_else(PoisonError::into_inner).settle(deployment.epoch) {
        tracing::warn!(%deployment, %error, "its end cannot be written down: its hosts are asked again at the next start");
    }
}

fn begun(deployment: &Deployment, hosts: &[String]) -> String {
    let Deployment { name, epoch } = deployment;
    let name = name.replace(char::is_control, "_");
    let hosts: Vec<&str> =
        hosts.iter().map(String::as_str).filter(|host| !host.contains(char::is_whitespace)).collect();
    if hosts.is_empty() {
        format!("{epoch} {name}\n")
    } else {
        format!("{epoch} {name}\nhosts {epoch} {}\n", hosts.join(" "))
    }
}

/// Returns the deployments of a journal that are not over. Those of before have no hosts, and are not asked for.
fn open(text: &str) -> BTreeMap<u64, (Deployment, Vec<String>)> {
    let (mut names, mut open) = (BTreeMap::new(), BTreeMap::new());
    for (word, rest) in text.lines().filter_map(|line| line.split_once(' ')) {
        let (number, more) = rest.split_once(' ').unwrap_or((rest, ""));
        match (word, word.parse::<u64>(), number.parse::<u64>()) {
            ("hosts", _, Ok(epoch)) => {
                let Some(name) = names.get(&epoch) else { continue };
                let hosts = more.split(' ').filter(|host| !host.is_empty()).map(str::to_owned).collect();
                open.insert(epoch, (Deployment { name: String::clone(name), epoch }, hosts));
            }
            ("over", _, Ok(epoch)) => drop(open.remove(&epoch)),
            (_, Ok(epoch), _) => drop(names.insert(epoch, rest.to_owned())),
            _ => {}
        }
    }
    open
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
        journal.commit(&deployment(1), &[]).unwrap();
        std::fs::remove_file(&path).unwrap();
        journal.commit(&deployment(2), &[]).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "1 before\n2 ok\n");
        std::fs::write(folder.join("other"), "").unwrap();
        std::fs::rename(folder.join("other"), &path).unwrap();
        journal.commit(&deployment(3), &[]).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "2 before\n3 ok\n");
        std::fs::remove_dir_all(&folder).unwrap();
        assert!(journal.commit(&deployment(4), &[]).is_err(), "its folder is gone: nothing can be written down");
    }

    /// A folder in the place of the new file stands for a disk that refuses.
    #[test]
    fn what_could_not_be_written_is_not_there_and_later_epochs_are() {
        let folder = std::env::temp_dir().join(format!("dca-journal-{}", std::process::id()));
        let path = folder.join("journal");
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(&path, "3 door\n4 ok\n5").unwrap();
        let mut journal = Journal::open(&path).unwrap();
        assert_eq!(journal.epoch(), 4, "a torn line does not count");
        std::fs::create_dir_all(folder.join("journal.new/x")).unwrap();
        assert!(journal.commit(&deployment(5), &[]).is_err());
        assert_eq!((journal.epoch(), Journal::open(&path).unwrap().epoch()), (4, 4));
        std::fs::remove_dir_all(folder.join("journal.new")).unwrap();
        for epoch in [6, 7] {
            journal.commit(&deployment(epoch), &[]).unwrap();
            assert_eq!(Journal::open(&path).unwrap().epoch(), epoch);
        }
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "4 before\n6 ok\n7 ok\n");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn what_was_not_over_is_known_after_a_start() {
        let folder = std::env::temp_dir().join(format!("dca-journal-open-{}", std::process::id()));
        let path = folder.join("journal");
        std::fs::create_dir_all(&folder).unwrap();
        let hosts = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
        let mut journal = Journal::open(&path).unwrap();
        let named = Deployment { name: "a b".to_owned(), epoch: 3 };
        for (deployment, names) in
            [(&deployment(1), ["c1", "c2"]), (&deployment(2), ["c1", "c2"]), (&named, ["c1", "c3"])]
        {
            journal.commit(deployment, &hosts(&names)).unwrap();
        }
        journal.settle(2).unwrap();
        let expected = [(named, hosts(&["c1", "c3"])), (deployment(1), hosts(&["c1", "c2"]))];
        assert_eq!(Journal::open(&path).unwrap().open_ends(), expected);
        // The first line of a new run makes a new file, which knows them, too.
        let mut journal = Journal::open(&path).unwrap();
        journal.settle(1).unwrap();
        journal.settle(9).unwrap();
        let mut journal = Journal::open(&path).unwrap();
        journal.commit(&deployment(4), &[]).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "3 before\n3 a b\nhosts 3 c1 c3\n4 ok\n");
        assert_eq!(Journal::open(&path).unwrap().open_ends(), expected[..1]);
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
