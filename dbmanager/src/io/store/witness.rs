//! The witness: a file beside the store, which shows whether the store is still the same store.
//!
//! A store may be restored from a backup, or copied to another robot. It would then continue its numbers from that time, but
//! other replicas already know other transactions by those numbers. So each store has a random number, and counts its
//! *lives*: the openings after which it was written to. The witness lies beside the store, not in it. It records the last
//! number and count, and also the file and the machine. A store that does not match begins a new life, under a new origin,
//! with its first write.
//!
//! The count is increased in the store first, with that first batch, and then in the witness. So after a crash between the
//! two, a store may be one ahead of its witness. A bit-by-bit copy of a card for an equal machine is not recognised here; it
//! is noticed when the two robots meet.

use super::{StoreError, check_file};
use comms::io::entropy;
use comms::io::file::{self, Privacy};
use rustix::fs::{AtFlags, CWD, StatxFlags, statx};
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fmt;
use std::fs::{self, File};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Files that differ between machines and that any user may read.
const MACHINE: [&str; 2] = ["/etc/machine-id", "/proc/device-tree/serial-number"];
/// The longest witness that is read, in bytes.
const SIZE_MAX: usize = 4096;

/// Whether a store may continue under its present origin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trust {
    /// The store was just made, or was never written to.
    New,
    /// The store is the store that was last open here.
    Kept,
    /// The store may be a copy: [`Replica::open_copied`](crate::logic::replica::Replica::open_copied).
    Doubtful(Doubt),
}

/// The reason not to trust a store.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Doubt {
    /// There is no witness.
    Missing,
    /// The content of the witness is not valid.
    Damaged,
    /// Another store was here.
    Another,
    /// The number of lives in which the store was written to does not match the witness.
    Restored,
    /// The store's file is a copy.
    Copied,
    /// The store was on another machine.
    Moved,
}

impl fmt::Display for Doubt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Missing => "its witness is missing",
            Self::Damaged => "its witness is damaged",
            Self::Another => "another store was here before",
            Self::Restored => "it has changed since it was last open here, as if it was restored from a backup",
            Self::Copied => "its file is a copy",
            Self::Moved => "it comes from another machine",
        })
    }
}

/// The identity of a store, and the number of lives in which it was written to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Life {
    pub(super) store: u128,
    pub(super) boots: u64,
}

impl Life {
    /// Returns the life of a new store, with a random identity from the system.
    pub(super) fn new() -> io::Result<Self> {
        Ok(Self { store: u128::from_le_bytes(entropy::bytes()?), boots: 0 })
    }

    pub(super) fn to_bytes(self) -> Vec<u8> {
        [&self.store.to_le_bytes()[..], &self.boots.to_le_bytes()].concat()
    }

    pub(super) fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (store, boots) = bytes.split_first_chunk()?;
        Some(Self { store: u128::from_le_bytes(*store), boots: u64::from_le_bytes(boots.try_into().ok()?) })
    }
}

/// Compares the witness of the store in `dir` with `life`, and with the file `data`.
pub(super) fn ask(dir: &Path, life: Life, data: &Path) -> io::Result<Trust> {
    if life.boots == 0 {
        return Ok(Trust::New);
    }
    let said = match file::bytes(&path(dir), SIZE_MAX) {
        Ok(said) => String::from_utf8_lossy(&said).into_owned(),
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Trust::Doubtful(Doubt::Missing)),
        // A pipe, or a file that no store has written. Nothing confirms the store then.
        Err(error) if matches!(error.kind(), io::ErrorKind::InvalidInput | io::ErrorKind::FileTooLarge) => {
            return Ok(Trust::Doubtful(Doubt::Damaged));
        }
        Err(error) => return Err(error),
    };
    let said: BTreeMap<&str, &str> = said.lines().filter_map(|line| line.split_once(' ')).collect();
    let now = testimony(life, data)?;
    let differs = |word| said.get(word).copied() != now.get(word).map(String::as_str);
    if now.keys().any(|word| !said.contains_key(word)) {
        return Ok(Trust::Doubtful(Doubt::Damaged));
    }
    let boots = said.get("boots").and_then(|boots| boots.parse::<u64>().ok());
    let in_step = boots.is_some_and(|boots| boots == life.boots || boots.checked_add(1) == Some(life.boots));
    let doubts = [
        (differs("store"), Doubt::Another),
        (differs("machine"), Doubt::Moved),
        (differs("file"), Doubt::Copied),
        (!in_step, Doubt::Restored),
    ];
    let doubt = doubts.iter().find(|(holds, _)| *holds).map(|(_, doubt)| *doubt);
    Ok(doubt.map_or(Trust::Kept, Trust::Doubtful))
}

/// Checks that the witness of the store in `dir` can be replaced later: its name may belong to anything except a folder.
pub(super) fn check(dir: &Path) -> Result<(), StoreError> {
    let is_folder = |path: &PathBuf| fs::symlink_metadata(path).is_ok_and(|there| there.is_dir());
    let folder = [path(dir), unfinished(dir)].into_iter().find(is_folder);
    folder.as_deref().map_or(Ok(()), check_file)
}

/// Returns whether there is a witness of a store in `dir`.
pub(super) fn exists(dir: &Path) -> bool {
    path(dir).exists()
}

/// Writes a new witness in place of the old one.
pub(super) fn attest(dir: &Path, life: Life, data: &Path) -> io::Result<()> {
    let text: String = testimony(life, data)?.iter().map(|(word, what)| format!("{word} {what}\n")).collect();
    let (path, new) = (path(dir), unfinished(dir));
    let mut file = file::created(&new, Privacy::Usual)?;
    file.write_all(text.as_bytes())?;
    file.sync_all()?;
    fs::rename(&new, &path)?;
    match path.parent().filter(|parent| !parent.as_os_str().is_empty()) {
        Some(parent) => File::open(parent)?.sync_all(),
        None => File::open(".")?.sync_all(),
    }
}

fn testimony(life: Life, data: &Path) -> io::Result<BTreeMap<&'static str, String>> {
    let file = statx(CWD, data, AtFlags::empty(), StatxFlags::INO | StatxFlags::BTIME)?;
    let born = file.stx_btime;
    let mut machine = blake3::Hasher::new();
    for path in MACHINE {
        // If the machine lacks a property, it also lacked it before.
        machine.update(&fs::read(path).unwrap_or_default()).update(&[0]);
    }
    Ok(BTreeMap::from([
        ("store", format!("{:032x}", life.store)),
        ("boots", life.boots.to_string()),
        ("file", format!("{} {}.{:09}", file.stx_ino, born.tv_sec, born.tv_nsec)),
        ("machine", machine.finalize().to_hex()[..16].to_owned()),
    ]))
}

/// Returns the path of the witness of the store in `dir`.
pub(super) fn path(dir: &Path) -> PathBuf {
    file_next_to(dir, ".witness")
}

/// Returns the path of a witness that is being written.
fn unfinished(dir: &Path) -> PathBuf {
    file_next_to(dir, ".witness.new")
}

/// Returns the path of a file beside `dir` with the same name and an ending.
fn file_next_to(dir: &Path, ending: &str) -> PathBuf {
    let mut name = OsString::from(dir);
    name.push(ending);
    PathBuf::from(name)
}
