//! A disk whose power can be cut: which effects of a program's calls certainly survive, and which may.
//!
//! *Model.* Written bytes are in the page cache, and in the cache of the drive, until a later `fsync` or `fdatasync` of
//! their file has ended. For each sector of 512 bytes that was not synced, the newest content survives with the
//! probability of the cut, otherwise an older one, independently of other sectors. So writes are torn and reordered. Of
//! later changes of a file's length, the first ones survive, up to a random one. `sync_file_range` is not a barrier, as
//! on honest drives that get no flush request. Names change durably when the directory is synced. Of later changes of
//! names, the first ones survive, as from a journal.

use super::trace::Call;
use comms::logic::random::Random;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The bytes that a drive writes atomically.
const SECTOR_SIZE: usize = 512;

/// The calls that count as making writes durable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Barriers {
    /// All calls that should.
    All,
    /// All except `fdatasync`: as if the program had never called it.
    NoDataSync,
}

/// A disk, after some calls.
#[derive(Debug)]
pub(crate) struct Platter {
    barriers: Barriers,
    files: Vec<Content>,
    /// The files, and the directories (without a file), by name, in their durable state.
    names: BTreeMap<PathBuf, Option<usize>>,
    /// The same, in the state that the program sees.
    seen: BTreeMap<PathBuf, Option<usize>>,
    /// Changes of names that are not durable yet.
    changes: Vec<Change>,
    /// How many calls there were.
    calls: usize,
}

#[derive(Clone, Debug)]
enum Change {
    Put(PathBuf, Option<usize>),
    Rename(PathBuf, PathBuf),
    Remove(PathBuf),
}

/// A file: its durable bytes, and its later changes, each with the number of its call.
#[derive(Debug, Default)]
struct Content {
    durable: Vec<u8>,
    later: Vec<(usize, Later)>,
}

#[derive(Clone, Debug)]
enum Later {
    Write(usize, Vec<u8>),
    Truncate(usize),
}

impl Platter {
    pub(crate) fn new(barriers: Barriers) -> Self {
        let (files, names, seen, changes) = (Vec::new(), BTreeMap::new(), BTreeMap::new(), Vec::new());
        Self { barriers, files, names, seen, changes, calls: 0 }
    }

    /// Returns a disk that durably holds the content of this folder.
    pub(crate) fn holding(folder: &Path) -> Self {
        let mut platter = Self::new(Barriers::All);
        let mut folders = vec![folder.to_owned()];
        while let Some(folder) = folders.pop() {
            for path in std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
                let is_file = path.is_file();
                platter.names.insert(path.clone(), is_file.then_some(platter.files.len()));
                if is_file {
                    platter.files.push(Content { durable: std::fs::read(&path).unwrap(), later: Vec::new() });
                } else {
                    folders.push(path);
                }
            }
        }
        platter.seen = platter.names.clone();
        platter
    }

    /// Carries out a call.
    pub(crate) fn take(&mut self, call: &Call) {
        match call {
            Call::Create(path) if self.seen.contains_key(path) => {}
            Call::Create(path) => {
                self.files.push(Content::default());
                self.change(Change::Put(path.clone(), Some(self.files.len() - 1)));
            }
            Call::MakeDir(path) => self.change(Change::Put(path.clone(), None)),
            Call::Rename(from, to) => self.change(Change::Rename(from.clone(), to.clone())),
            Call::Unlink(path) => self.change(Change::Remove(path.clone())),
            Call::Write(path, offset, data) => self.later(path, Later::Write(*offset, data.clone())),
            Call::Truncate(path, length) => self.later(path, Later::Truncate(*length)),
            Call::Sync { data_only: true, .. } if self.barriers == Barriers::NoDataSync => {}
            Call::Sync { path, since, .. } => self.sync(path, *since),
            Call::Notification(_) => {}
        }
        self.calls += 1;
    }

    fn later(&mut self, path: &Path, later: Later) {
        // Files that were made before the log began do not belong to the test.
        let Some(file) = self.seen.get(path).copied().flatten() else { panic!("{} is not known", path.display()) };
        self.files[file].later.push((self.calls, later));
    }

    fn change(&mut self, change: Change) {
        change.apply(&mut self.seen);
        self.changes.push(change);
    }

    fn sync(&mut self, path: &Path, since: usize) {
        match self.seen.get(path) {
            Some(Some(file)) => self.files[*file].sync(since),
            // The folder that contains everything existed before.
            Some(None) | None => {
                let (durable, later) = std::mem::take(&mut self.changes).into_iter().partition(|c| c.is_in(path));
                let durable: Vec<Change> = durable;
                durable.iter().for_each(|change| change.apply(&mut self.names));
                self.changes = later;
            }
        }
    }

    /// Cuts the power: writes the surviving files below `to` instead of `from`.
    pub(crate) fn cut(&self, random: &mut Random, percent: u64, (from, to): (&Path, &Path)) {
        let mut names = self.names.clone();
        let survive = if percent == 0 { 0 } else { below(random, self.changes.len() + 1) };
        self.changes.iter().take(survive).for_each(|change| change.apply(&mut names));
        for (path, file) in &names {
            let path = to.join(path.strip_prefix(from).unwrap());
            match file {
                None => std::fs::create_dir_all(&path).unwrap(),
                Some(file) => {
                    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                    std::fs::write(&path, self.files[*file].after_cut(random, percent)).unwrap();
                }
            }
        }
    }
}

impl Change {
    fn apply(&self, names: &mut BTreeMap<PathBuf, Option<usize>>) {
        match self {
            Self::Put(path, file) => drop(names.insert(path.clone(), *file)),
            Self::Remove(path) => drop(names.remove(path)),
            Self::Rename(from, to) => {
                if let Some(file) = names.remove(from) {
                    names.insert(to.clone(), file);
                }
            }
        }
    }

    fn is_in(&self, directory: &Path) -> bool {
        let (Self::Put(path, _) | Self::Remove(path) | Self::Rename(_, path)) = self;
        path.parent() == Some(directory)
    }
}

impl Content {
    fn sync(&mut self, since: usize) {
        let later = std::mem::take(&mut self.later);
        let (durable, later) = later.into_iter().partition(|(call, _)| *call < since);
        let durable: Vec<(usize, Later)> = durable;
        durable.iter().for_each(|(_, change)| change.apply(&mut self.durable));
        self.later = later;
    }

    fn after_cut(&self, random: &mut Random, percent: u64) -> Vec<u8> {
        if percent == 0 {
            return self.durable.clone();
        }
        // Each sector that was written gets its content after some of its writes.
        let mut bytes = self.durable.clone();
        let mut kept: BTreeMap<usize, usize> = BTreeMap::new();
        let mut written: BTreeMap<usize, usize> = BTreeMap::new();
        for sector in self.later.iter().flat_map(|(_, later)| later.sectors()) {
            *written.entry(sector).or_default() += 1;
        }
        for (sector, count) in &written {
            let survives = random.below(100) < percent;
            kept.insert(*sector, if survives { 1 + below(random, *count) } else { 0 });
        }
        let lengths = self.later.iter().filter(|(_, later)| matches!(later, Later::Truncate(_))).count();
        let mut lengths = below(random, lengths + 1);
        for (_, later) in &self.later {
            let spared: BTreeSet<usize> = later.sectors().filter(|sector| kept[sector] > 0).collect();
            spared.iter().for_each(|sector| *kept.get_mut(sector).unwrap() -= 1);
            match later {
                Later::Truncate(_) if lengths == 0 => {}
                Later::Truncate(_) => {
                    lengths -= 1;
                    later.apply(&mut bytes);
                }
                Later::Write(offset, data) => {
                    for sector in spared {
                        let start = (sector * SECTOR_SIZE).max(*offset);
                        let end = ((sector + 1) * SECTOR_SIZE).min(offset + data.len());
                        put(&mut bytes, start, &data[start - offset..end - offset]);
                    }
                }
            }
        }
        bytes
    }
}

impl Later {
    fn sectors(&self) -> impl Iterator<Item = usize> + use<> {
        match self {
            Self::Write(offset, data) if !data.is_empty() => {
                offset / SECTOR_SIZE..(offset + data.len() - 1) / SECTOR_SIZE + 1
            }
            Self::Write(..) | Self::Truncate(_) => 0..0,
        }
    }

    fn apply(&self, bytes: &mut Vec<u8>) {
        match self {
            Self::Write(offset, data) => put(bytes, *offset, data),
            Self::Truncate(length) => bytes.resize(*length, 0),
        }
    }
}

/// Puts data at an offset; bytes before it that were never written are zero.
fn put(bytes: &mut Vec<u8>, offset: usize, data: &[u8]) {
    if bytes.len() < offset + data.len() {
        bytes.resize(offset + data.len(), 0);
    }
    bytes[offset..offset + data.len()].copy_from_slice(data);
}

fn below(random: &mut Random, bound: usize) -> usize {
    usize::try_from(random.below(bound as u64)).unwrap()
}

#[test]
fn what_was_synced_survives() {
    let (root, file, new) = (PathBuf::from("/r"), PathBuf::from("/r/a"), PathBuf::from("/r/b"));
    let write = |offset, byte: u8| Call::Write(file.clone(), offset, vec![byte; 2]);
    let sync = |path: &Path, data_only, since| Call::Sync { path: path.to_owned(), data_only, since };
    let mut calls = vec![Call::Create(file.clone()), write(0, 1), sync(&file, true, 2), write(1, 2)];
    calls.extend([write(2, 3), sync(&root, false, 5), sync(&file, true, 4), Call::Rename(file.clone(), new)]);
    let to = std::env::temp_dir().join(format!("dca-platter-{}", std::process::id()));
    for (barriers, percent, expected) in
        [(Barriers::All, 0, vec![1, 2, 2]), (Barriers::NoDataSync, 0, vec![]), (Barriers::All, 100, vec![1, 2, 3, 3])]
    {
        let mut platter = Platter::new(barriers);
        calls.iter().for_each(|call| platter.take(call));
        // It is random whether the new name survives.
        platter.cut(&mut Random::new(1), percent, (&root, &to));
        let found = std::fs::read(to.join("a")).or_else(|_| std::fs::read(to.join("b"))).unwrap();
        assert_eq!(found, expected, "{barriers:?} {percent}");
        std::fs::remove_dir_all(&to).unwrap();
    }
}
