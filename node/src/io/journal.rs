//! The journal contains the epochs that this node has assigned. Each is durable before the first process of its deployment runs.
//!
//! A deployment has the line `EPOCH NAME`, then `hosts EPOCH HOST …`, and `over EPOCH` once every host has confirmed
//! its end. When a node starts, it asks for the deployments that are not over. A tab and a checksum follow on each
//! line. An incomplete last line (power cut) is ignored. But its epoch is not assigned again, because the line may also
//! have been damaged later. A file with any other damage is put aside (`journal.aside-1`). The new file begins with an
//! epoch that no journal has reached: the seconds since 1970, or the greatest readable epoch if this is greater.
//! Writing blocks as long as the disk takes. So the driver writes in parallel to its loop, while programs start.
//!
//! After a failed write, it is not known which part of the file is on the disk: a repeated sync may succeed without
//! having written anything. So the next commit writes a new file and replaces the old one. It does the same if the file
//! has been removed or replaced, because writes to a file without a name are lost.

use crate::io::folder::sync_entry;
use crate::logic::absence::ENDS_MAX;
use crate::logic::protocol::Deployment;
use comms::io::clock::unix_time;
use comms::io::file::{self, Privacy};
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// The longest journal that is read, in bytes.
const SIZE_MAX: usize = 256 << 20;
/// The most deployments that are not over and that are kept in the journal.
const OPEN_MAX: usize = 4 * ENDS_MAX;

/// The journal. Its file is opened for writing with the first epoch. So a node can run on a read-only disk without the file.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    /// Nothing until the first commit, and after a failed one.
    file: Option<File>,
    epoch: u64,
    /// The deployments that are not over, with their hosts.
    open: BTreeMap<u64, (Deployment, Vec<String>)>,
    /// Epochs that are over, but whose beginning is not written yet.
    early: BTreeSet<u64>,
}

impl Journal {
    /// Reads a journal, which need not exist. A damaged journal is put aside and reported.
    ///
    /// # Errors
    /// The file exists and cannot be read.
    pub fn open(path: &Path) -> io::Result<Self> {
        let found = match file::bytes(path, SIZE_MAX) {
            Ok(bytes) => Found::in_bytes(&bytes),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Found::default(),
            Err(error) if matches!(error.kind(), io::ErrorKind::InvalidInput | io::ErrorKind::FileTooLarge) => {
                Found { damage: Some(error.to_string()), ..Found::default() }
            }
            Err(error) => return Err(error),
        };
        let Found { epoch, open, damage } = found;
        let mut journal = Self { path: path.to_owned(), file: None, epoch, open, early: BTreeSet::new() };
        if let Some(damage) = damage {
            journal.epoch = epoch.max(unix_time().as_secs());
            journal.put_aside(&damage);
        }
        Ok(journal)
    }

    /// Puts a damaged file aside. Begins a new file at once, so that a restarted node finds one.
    fn put_aside(&mut self, damage: &str) {
        let mut asides = (1..).map(|number| self.path.with_extension(format!("aside-{number}")));
        let aside = asides.find(|aside| std::fs::symlink_metadata(aside).is_err()).unwrap_or_default();
        match std::fs::rename(&self.path, &aside).and_then(|()| self.renew()) {
            Ok(file) => {
                self.file = Some(file);
                tracing::error!(
                    journal = %self.path.display(), aside = %aside.display(), %damage, epoch = self.epoch,
                    "the journal is damaged and was put aside: the next epochs are above this one; hosts that have not confirmed the end of an \
                     earlier deployment are no longer asked, and `dca status` on them shows what they still run"
                );
            }
            Err(error) => tracing::error!(
                journal = %self.path.display(), %damage, %error,
                "the journal is damaged and cannot be put aside: this node deploys nothing until the journal was put aside"
            ),
        }
    }

    /// Returns the latest deployments that are not over, with their hosts.
    pub fn open_ends(&self) -> Vec<(Deployment, Vec<String>)> {
        self.open.values().rev().take(ENDS_MAX).cloned().collect()
    }

    /// Returns the highest epoch in the journal.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    /// Writes an epoch. It is on the disk when this returns.
    ///
    /// # Errors
    /// The disk refuses. After a power cut, the line may or may not be there. The next commit writes a new file.
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
    /// The disk refuses. Then the hosts are asked once more after the next start of the node.
    pub fn settle(&mut self, epoch: u64) -> io::Result<()> {
        if epoch > self.epoch {
            // The deployment ended before its beginning was written.
            self.early.insert(epoch);
            return Ok(());
        }
        self.open.remove(&epoch).map_or(Ok(()), |_open| self.append(&line(&format!("over {epoch}"))))
    }

    fn append(&mut self, line: &str) -> io::Result<()> {
        let mut file = match self.file.take().filter(|file| file::is_in_place(file, &self.path)) {
            Some(file) => file,
            None => self.renew()?,
        };
        file.write_all(line.as_bytes())?;
        file.sync_data()?;
        self.file = Some(file);
        Ok(())
    }

    /// Writes a new durable file with the highest epoch, and replaces the old file by it.
    fn renew(&self) -> io::Result<File> {
        let unfinished = self.path.with_extension("new");
        let mut file = file::created(&unfinished, Privacy::Own)?;
        file.write_all(line(&format!("{} before", self.epoch)).as_bytes())?;
        for (deployment, hosts) in self.open.values() {
            file.write_all(begun(deployment, hosts).as_bytes())?;
        }
        file.sync_data()?;
        std::fs::rename(&unfinished, &self.path)?;
        sync_entry(&self.path)?;
        Ok(file)
    }
}

/// Writes an epoch to a shared journal. Blocks for as long as the disk takes.
///
/// # Errors
/// The disk refuses. The text is for a person.
pub fn commit(journal: &Mutex<Journal>, deployment: &Deployment, hosts: &[String]) -> Result<(), String> {
    let mut journal = journal.lock().unwrap_or_else(PoisonError::into_inner);
    journal.commit(deployment, hosts).map_err(|error| error.to_string())
}

/// Writes the end of a deployment to a shared journal. Blocks for as long as the disk takes.
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
    let begin = line(&format!("{epoch} {name}"));
    if hosts.is_empty() { begin } else { begin + &line(&format!("hosts {epoch} {}", hosts.join(" "))) }
}

/// Returns a line with its checksum.
fn line(body: &str) -> String {
    format!("{body}\t{:08x}\n", crc32fast::hash(body.as_bytes()))
}

/// Returns a line without its checksum; `None` if the line has been changed.
fn body(line: &str) -> Option<&str> {
    let (body, sum) = line.split_once('\t')?;
    if u32::from_str_radix(sum, 16) != Ok(crc32fast::hash(body.as_bytes())) {
        return None;
    }
    let (word, rest) = body.split_once(' ')?;
    let number = match word {
        "hosts" | "over" => rest.split(' ').next()?,
        _ => word,
    };
    number.parse::<u64>().is_ok().then_some(body)
}

/// The readable content of a journal.
#[derive(Debug, Default)]
struct Found {
    /// The highest epoch in the journal.
    epoch: u64,
    open: BTreeMap<u64, (Deployment, Vec<String>)>,
    damage: Option<String>,
}

impl Found {
    fn in_bytes(bytes: &[u8]) -> Self {
        let text = String::from_utf8_lossy(bytes);
        let (whole, torn) = text.rsplit_once('\n').map_or(("", &*text), |(whole, torn)| (whole, torn));
        let lines: Vec<Option<&str>> = whole.lines().map(body).collect();
        let damage = lines.iter().position(Option::is_none).map(|line| format!("its line {} cannot be read", line + 1));
        let is_empty = whole.is_empty().then(|| "it is empty".to_owned());
        let bodies: Vec<&str> = lines.into_iter().flatten().collect();
        let epochs = bodies.iter().filter_map(|line| line.split_once(' ')?.0.parse::<u64>().ok());
        let epoch = epochs.max().unwrap_or(0).saturating_add(u64::from(!torn.is_empty()));
        Self { epoch, open: open(&bodies), damage: damage.or(is_empty) }
    }
}

/// Returns the deployments of a journal that are not over. If one has no hosts, no host is asked about it.
fn open(lines: &[&str]) -> BTreeMap<u64, (Deployment, Vec<String>)> {
    let (mut names, mut open) = (BTreeMap::new(), BTreeMap::new());
    for (word, rest) in lines.iter().filter_map(|line| line.split_once(' ')) {
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

    /// Returns the lines of a journal without their checksums.
    fn lines(path: &Path) -> Vec<String> {
        let text = std::fs::read_to_string(path).unwrap();
        text.lines().map(|line| body(line).unwrap().to_owned()).collect()
    }

    #[test]
    fn a_damaged_journal_is_put_aside_and_no_epoch_is_given_twice() {
        let folder = std::env::temp_dir().join(format!("dca-journal-damage-{}", std::process::id()));
        let path = folder.join("journal");
        std::fs::create_dir_all(&folder).unwrap();
        let mut journal = Journal::open(&path).unwrap();
        (1..=9).for_each(|epoch| journal.commit(&deployment(epoch), &["c1".to_owned()]).unwrap());
        let whole = std::fs::read(&path).unwrap();
        let aside = |number: u32| folder.join(format!("journal.aside-{number}"));
        let mut asides = 0;
        // Each byte is changed in turn. Then the file is shortened step by step, until it is empty.
        for at in 0..=whole.len() {
            let mut bytes = whole.clone();
            match bytes.get_mut(at) {
                Some(byte) => *byte ^= 0x15,
                None => bytes.clear(),
            }
            std::fs::write(&path, &bytes).unwrap();
            let journal = Journal::open(&path).unwrap();
            assert!(journal.epoch() >= 9, "byte {at}: {}", journal.epoch());
            if aside(asides + 1).exists() {
                asides += 1;
                assert_eq!(std::fs::read(aside(asides)).unwrap(), bytes);
                let again = Journal::open(&path).unwrap();
                assert!(
                    again.epoch() == journal.epoch() && again.epoch() > 1_000_000_000,
                    "it is written down at once"
                );
                assert!(!aside(asides + 1).exists(), "the new one is whole");
            }
        }
        // Only if the last line end is missing, it may be due to a power cut.
        assert_eq!(asides as usize, whole.len());
        rustix::fs::mknodat(rustix::fs::CWD, &path, rustix::fs::FileType::Fifo, 0o600.into(), 0).unwrap_err();
        std::fs::remove_file(&path).unwrap();
        rustix::fs::mknodat(rustix::fs::CWD, &path, rustix::fs::FileType::Fifo, 0o600.into(), 0).unwrap();
        assert!(Journal::open(&path).unwrap().epoch() > 1_000_000_000, "a pipe is not waited for");
        std::fs::remove_dir_all(&folder).unwrap();
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
        assert_eq!(lines(&path), ["1 before", "2 ok"]);
        std::fs::write(folder.join("other"), "2 ok\n").unwrap();
        std::fs::rename(folder.join("other"), &path).unwrap();
        journal.commit(&deployment(3), &[]).unwrap();
        assert_eq!(lines(&path), ["2 before", "3 ok"]);
        std::fs::remove_dir_all(&folder).unwrap();
        assert!(journal.commit(&deployment(4), &[]).is_err(), "its folder is gone: nothing can be written down");
    }

    /// A folder in the place of the new file makes each write fail, like a disk that refuses.
    #[test]
    fn what_could_not_be_written_is_not_there_and_later_epochs_are() {
        let folder = std::env::temp_dir().join(format!("dca-journal-{}", std::process::id()));
        let path = folder.join("journal");
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(&path, line("3 door") + &line("4 ok") + "5").unwrap();
        let mut journal = Journal::open(&path).unwrap();
        assert_eq!(journal.epoch(), 5, "the number of a torn line is not given again");
        std::fs::create_dir_all(folder.join("journal.new/x")).unwrap();
        assert!(journal.commit(&deployment(6), &[]).is_err());
        assert_eq!((journal.epoch(), Journal::open(&path).unwrap().epoch()), (5, 5));
        std::fs::remove_dir_all(folder.join("journal.new")).unwrap();
        for epoch in [7, 8] {
            journal.commit(&deployment(epoch), &[]).unwrap();
            assert_eq!(Journal::open(&path).unwrap().epoch(), epoch);
        }
        assert_eq!(lines(&path), ["5 before", "7 ok", "8 ok"]);
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
        // The first line of a new run makes a new file, which also contains these deployments.
        let mut journal = Journal::open(&path).unwrap();
        journal.settle(1).unwrap();
        journal.settle(9).unwrap();
        let mut journal = Journal::open(&path).unwrap();
        journal.commit(&deployment(4), &[]).unwrap();
        assert_eq!(lines(&path), ["3 before", "3 a b", "hosts 3 c1 c3", "4 ok"]);
        assert_eq!(Journal::open(&path).unwrap().open_ends(), expected[..1]);
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
