//! The state that has to survive a reboot, for deployments with their home on this node. The folder `running` in the
//! node's state has a file for each deployment. The file `stopped` beside it has the tombstones for homes that could
//! not be reached.
//!
//! The file of a deployment begins with the boot of the machine, so the next node can detect a reboot. The file exists
//! from before the first program runs until the deployment has to end. A damaged file is reported and removed, and its
//! deployment is not resumed.

use crate::io::folder::sync_entry;
use crate::logic::protocol::{Before, Deployment, Earlier, Kept, Tombstone};
use anyhow::Context;
use comms::io::clock::unix_time;
use comms::io::file::{self, Privacy};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs::DirBuilder;
use std::io::{ErrorKind, Write};
use std::os::unix::fs::DirBuilderExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// The folder with the running deployments.
const RUNNING: &str = "running";
/// The file with the tombstones.
const STOPPED: &str = "stopped";
/// The beginning of a file. A checksum in 8 hexadecimal digits follows.
const BEGIN: &[u8] = b"dca kept 1 ";
/// The largest file, in bytes. A plan of 10,000 processes with the request for it is smaller.
const SIZE_MAX: usize = 64 << 20;
/// The most deployments that are read: as many as a node takes part in.
const RUNNING_MAX: usize = 64;
/// How long a tombstone is kept if its home does not return.
const STOPPED_FOR: Duration = Duration::from_secs(30 * 24 * 3600);

/// The content of a deployment's file.
#[derive(Debug, Serialize, Deserialize)]
struct Running {
    boot: String,
    kept: Kept,
}

/// A tombstone, and when it was made, in seconds since 1970.
#[derive(Debug, Serialize, Deserialize)]
struct Stopped {
    since: u64,
    tombstone: Tombstone,
}

/// The files; nothing for a node that stores nothing.
#[derive(Clone, Debug)]
pub(crate) struct KeptFiles(Option<Arc<Inner>>);

#[derive(Debug)]
struct Inner {
    state: PathBuf,
    /// The present boot of the machine.
    boot: String,
    wanted: Mutex<Wanted>,
    /// Held while the files are written, so that an older content never overwrites a newer one.
    disk: Mutex<BTreeMap<Tombstone, u64>>,
}

/// The content that the files should get.
#[derive(Debug, Default)]
struct Wanted {
    /// The files by epoch; nothing for a file that has to be removed.
    running: BTreeMap<u64, Option<Vec<u8>>>,
    /// Whether files without an entry have to be removed.
    is_all: bool,
    tombstones: Option<Vec<Tombstone>>,
}

impl Wanted {
    /// Adds an earlier content that could not be written. For each file, the later content is used.
    fn again(&mut self, earlier: Self) {
        if !self.is_all {
            self.is_all = earlier.is_all;
            for (epoch, bytes) in earlier.running {
                self.running.entry(epoch).or_insert(bytes);
            }
        }
        self.tombstones = self.tombstones.take().or(earlier.tombstones);
    }
}

impl KeptFiles {
    /// Returns the files in the folder of a node's state, and their content. Blocks.
    pub(crate) fn open(state: Option<PathBuf>, boot: &str) -> (Self, Earlier) {
        let Some(state) = state else { return (Self(None), Earlier::default()) };
        let now = unix_time().as_secs();
        let known: BTreeMap<Tombstone, u64> = tombstones(&state.join(STOPPED), now);
        let earlier =
            Earlier { running: running(&state.join(RUNNING), boot), tombstones: known.keys().cloned().collect() };
        let (wanted, disk) = (Mutex::new(Wanted::default()), Mutex::new(known));
        (Self(Some(Arc::new(Inner { state, boot: boot.to_owned(), wanted, disk }))), earlier)
    }

    /// Notes that a deployment has to have a file.
    pub(crate) fn keep(&self, kept: &Kept) {
        let Some(inner) = &self.0 else { return };
        let running = Running { boot: inner.boot.clone(), kept: kept.clone() };
        lock(&inner.wanted).running.insert(kept.deployment.epoch, Some(bytes(&running)));
    }

    /// Notes that the file of a deployment has to be removed.
    pub(crate) fn unkeep(&self, deployment: &Deployment) {
        if let Some(inner) = &self.0 {
            lock(&inner.wanted).running.insert(deployment.epoch, None);
        }
    }

    /// Notes that exactly these deployments have to have a file.
    pub(crate) fn keep_all(&self, all: &[Kept]) {
        if let Some(inner) = &self.0 {
            let mut wanted = lock(&inner.wanted);
            (wanted.is_all, wanted.running) = (true, BTreeMap::new());
        }
        all.iter().for_each(|kept| self.keep(kept));
    }

    /// Notes all tombstones that have to be in the file.
    pub(crate) fn keep_tombstones(&self, all: Vec<Tombstone>) {
        if let Some(inner) = &self.0 {
            lock(&inner.wanted).tombstones = Some(all);
        }
    }

    /// Brings the files to their intended content. Blocks. If the disk refuses, the next call tries again.
    ///
    /// # Errors
    /// The disk has not accepted everything. The text is for a person.
    pub(crate) fn write(&self) -> Result<(), String> {
        let Some(inner) = &self.0 else { return Ok(()) };
        let mut disk = lock(&inner.disk);
        let wanted = std::mem::take(&mut *lock(&inner.wanted));
        let Err(error) = inner.write(&wanted, &mut disk) else { return Ok(()) };
        lock(&inner.wanted).again(wanted);
        let (state, why) = (inner.state.display(), format!("{error:#}"));
        tracing::error!(%state, error = why, "cannot write down the state that survives a reboot");
        Err(why)
    }
}

impl Inner {
    fn write(&self, wanted: &Wanted, disk: &mut BTreeMap<Tombstone, u64>) -> anyhow::Result<()> {
        if let Some(all) = &wanted.tombstones {
            let now = unix_time().as_secs();
            let known: BTreeMap<Tombstone, u64> =
                all.iter().map(|one| (one.clone(), disk.get(one).copied().unwrap_or(now))).collect();
            if known != *disk {
                let all =
                    known.iter().map(|(tombstone, since)| Stopped { since: *since, tombstone: tombstone.clone() });
                put(&self.state.join(STOPPED), &bytes(&all.collect::<Vec<_>>()))?;
                *disk = known;
            }
        }
        let folder = self.state.join(RUNNING);
        let others = if wanted.is_all { names(&folder) } else { Vec::new() };
        for other in
            others.iter().filter(|other| number(other).is_none_or(|epoch| !wanted.running.contains_key(&epoch)))
        {
            remove(other)?;
        }
        for (epoch, bytes) in &wanted.running {
            let path = folder.join(epoch.to_string());
            match bytes {
                Some(bytes) => {
                    DirBuilder::new().recursive(true).mode(0o700).create(&folder).context("making its folder")?;
                    put(&path, bytes)?;
                }
                None => remove(&path)?,
            }
        }
        Ok(())
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Returns the bytes of a file with this content, with a checksum.
fn bytes(content: &impl Serialize) -> Vec<u8> {
    let body = postcard::to_stdvec(content).unwrap_or_default();
    [BEGIN, format!("{:08x}\n", crc32fast::hash(&body)).as_bytes(), &body].concat()
}

fn content<T: DeserializeOwned>(bytes: &[u8]) -> Option<T> {
    let (sum, body) = bytes.strip_prefix(BEGIN)?.split_at_checked(9)?;
    let is_whole = sum == format!("{:08x}\n", crc32fast::hash(body)).as_bytes();
    postcard::from_bytes(body).ok().filter(|_| is_whole)
}

/// Writes a durable file, in the place of an older one.
fn put(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let unfinished = path.with_extension("new");
    let written = || {
        let mut file = file::created(&unfinished, Privacy::Own)?;
        file.write_all(bytes)?;
        file.sync_data()?;
        std::fs::rename(&unfinished, path)?;
        sync_entry(path)
    };
    written().with_context(|| format!("writing `{}`", path.display()))
}

/// Removes a file, and makes this durable.
fn remove(path: &Path) -> anyhow::Result<()> {
    let removed = std::fs::remove_file(path).and_then(|()| sync_entry(path));
    match removed {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        removed => removed.with_context(|| format!("removing `{}`", path.display())),
    }
}

/// Returns the entries of a folder, in order.
fn names(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten();
    let mut names: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    names.sort_unstable();
    names
}

/// Returns the epoch in the name of a file.
fn number(path: &Path) -> Option<u64> {
    path.file_name().and_then(OsStr::to_str)?.parse().ok()
}

/// Returns the deployments that ran. If there are too many, returns those with the latest epochs.
fn running(folder: &Path, boot: &str) -> Vec<Before> {
    let mut found = Vec::new();
    let mut paths: Vec<(u64, PathBuf)> =
        names(folder).into_iter().filter_map(|path| Some((number(&path)?, path))).collect();
    paths.sort_unstable_by_key(|(epoch, _)| std::cmp::Reverse(*epoch));
    for (epoch, path) in paths.into_iter().take(RUNNING_MAX) {
        let read = file::bytes(&path, SIZE_MAX).map(|bytes| content::<Running>(&bytes));
        let why = match read {
            Ok(Some(Running { boot: then, kept })) if kept.deployment.epoch == epoch => {
                let was_rebooted = then != boot || kept.waits;
                found.push(Before { kept, was_rebooted });
                continue;
            }
            Ok(_) => "it is damaged, or of another version".to_owned(),
            Err(error) => error.to_string(),
        };
        tracing::error!(file = %path.display(), why, "the previous deployments cannot be read, so they are not started again");
        drop(std::fs::remove_file(&path));
    }
    found
}

/// Returns the tombstones that are not too old, with the time when each was made.
fn tombstones(path: &Path, now: u64) -> BTreeMap<Tombstone, u64> {
    let read = match file::bytes(path, SIZE_MAX) {
        Err(error) if error.kind() == ErrorKind::NotFound => return BTreeMap::new(),
        read => read.map(|bytes| content::<Vec<Stopped>>(&bytes)),
    };
    let Ok(Some(found)) = read else {
        tracing::error!(file = %path.display(), "the file cannot be read: a home that was away is not told which of its deployments were stopped while it was away");
        return BTreeMap::new();
    };
    // If the clock was set back, each tombstone counts as new.
    let is_new = |one: &Stopped| now.saturating_sub(one.since) < STOPPED_FOR.as_secs();
    found.into_iter().filter(is_new).map(|one| (one.tombstone, one.since)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kept(epoch: u64) -> Kept {
        let deployment = Deployment { name: "door".to_owned(), epoch };
        Kept {
            deployment,
            origin: epoch,
            by: "ann@c1".to_owned(),
            hosts: vec!["c1".to_owned()],
            has_ended: false,
            waits: false,
            resume: None,
        }
    }

    fn tombstone(epoch: u64) -> Tombstone {
        Tombstone { home: "c2".to_owned(), deployment: Deployment { name: "door".to_owned(), epoch } }
    }

    #[test]
    fn what_runs_is_found_again_and_the_boot_tells_a_reboot() {
        let folder = std::env::temp_dir().join(format!("dca-kept-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let open = |boot: &str| KeptFiles::open(Some(folder.clone()), boot);
        let (files, before) = open("first");
        assert!(before.running.is_empty() && before.tombstones.is_empty());
        (1..=3).for_each(|epoch| files.keep(&kept(epoch)));
        files.unkeep(&kept(2).deployment);
        files.keep_tombstones(vec![tombstone(7)]);
        files.write().unwrap();
        files.write().unwrap();
        let found = |boot: &str| {
            let running = open(boot).1.running.into_iter();
            running.map(|before| (before.kept.deployment.epoch, before.was_rebooted)).collect::<Vec<_>>()
        };
        assert_eq!(found("first"), [(3, false), (1, false)]);
        assert_eq!(found("second"), [(3, true), (1, true)]);
        assert_eq!(open("second").1.tombstones, [tombstone(7)]);
        files.keep(&Kept { waits: true, ..kept(3) });
        files.write().unwrap();
        assert_eq!(found("first"), [(3, true), (1, false)], "one that waits is resumed by any next node");
        files.keep_all(&[kept(1)]);
        files.keep_tombstones(Vec::new());
        files.write().unwrap();
        assert_eq!((found("first"), open("first").1.tombstones), (vec![(1, false)], Vec::new()));
        std::fs::remove_dir_all(&folder).unwrap();
    }

    /// If the disk refuses, the next write tries again.
    #[test]
    fn what_the_disk_refuses_is_written_later() {
        let folder = std::env::temp_dir().join(format!("dca-kept-refused-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (files, _) = KeptFiles::open(Some(folder.clone()), "first");
        // A file in the place of the folder makes writes fail.
        std::fs::write(folder.join(RUNNING), "").unwrap();
        files.keep(&kept(1));
        files.keep(&kept(2));
        assert!(files.write().is_err());
        files.unkeep(&kept(2).deployment);
        std::fs::remove_file(folder.join(RUNNING)).unwrap();
        files.write().unwrap();
        let (_, found) = KeptFiles::open(Some(folder.clone()), "first");
        assert_eq!(found.running.iter().map(|one| one.kept.deployment.epoch).collect::<Vec<_>>(), [1]);
        std::fs::remove_dir_all(&folder).unwrap();
    }

    /// Each byte is changed in turn, or the file ends at this byte.
    #[test]
    fn what_is_damaged_is_not_begun_and_does_not_come_back() {
        let folder = std::env::temp_dir().join(format!("dca-kept-damage-{}", std::process::id()));
        let path = folder.join(RUNNING).join("1");
        std::fs::create_dir_all(&folder).unwrap();
        let (files, _) = KeptFiles::open(Some(folder.clone()), "first");
        files.keep(&kept(1));
        files.write().unwrap();
        let whole = std::fs::read(&path).unwrap();
        for at in 0..whole.len() {
            let mut other = whole.clone();
            other[at] ^= 0x15;
            for bytes in [&other[..], &whole[..at]] {
                std::fs::write(&path, bytes).unwrap();
                let (_, found) = KeptFiles::open(Some(folder.clone()), "second");
                assert!(found.running.is_empty() && !path.exists(), "byte {at}");
            }
        }
        std::fs::write(folder.join(RUNNING).join("2"), &whole).unwrap();
        std::fs::write(folder.join(STOPPED), "x").unwrap();
        let (_, found) = KeptFiles::open(Some(folder.clone()), "second");
        assert!(found.running.is_empty() && found.tombstones.is_empty(), "it is of another epoch");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
