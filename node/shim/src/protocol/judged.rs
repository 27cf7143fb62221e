//! The file that a node has judged before a start, so that the shim runs this file and no other.

use std::ffi::OsString;
use std::fmt;
use std::fs::Metadata;
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;

/// The file that a program was admitted with. A link may lead to another file when the program begins.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Judged {
    /// Its path, without links.
    pub path: PathBuf,
    /// The file at the time of the judgement.
    pub stamp: Stamp,
    /// The reason why it was admitted.
    pub by: JudgedBy,
}

/// The reason why a file was admitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JudgedBy {
    /// Its folder. A script gets its own path. Only users who may change the folder can replace the file at this path.
    Folder,
    /// Its hash. A script gets the path of the open file, even if another file has its name by then.
    Hash,
}

/// A state of a file: any change of the file, or another file in its place, has another one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Stamp {
    device: u64,
    inode: u64,
    length: u64,
    /// The time of the last change of the content or the inode, in seconds and nanoseconds.
    changed: (i64, i64),
}

impl Stamp {
    /// Returns the present state of a file.
    pub fn of(found: &Metadata) -> Self {
        let changed = (found.ctime(), found.ctime_nsec());
        Self { device: found.dev(), inode: found.ino(), length: found.len(), changed }
    }

    fn parse(text: &str) -> Option<Self> {
        let mut fields = text.split('.');
        let mut number = || fields.next()?.parse().ok();
        let (device, inode, length) = (number()?, number()?, number()?);
        let mut signed = || fields.next()?.parse().ok();
        let changed = (signed()?, signed()?);
        fields.next().is_none().then_some(Self { device, inode, length, changed })
    }
}

impl fmt::Display for Stamp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { device, inode, length, changed: (seconds, nanos) } = self;
        write!(f, "{device}.{inode}.{length}.{seconds}.{nanos}")
    }
}

impl Judged {
    /// Returns it as an argument of the shim: `folder:STAMP:PATH`.
    pub(super) fn argument(&self) -> OsString {
        let by = match self.by {
            JudgedBy::Folder => "folder",
            JudgedBy::Hash => "hash",
        };
        let mut argument = OsString::from(format!("{by}:{}:", self.stamp));
        argument.push(&self.path);
        argument
    }

    /// Reads the argument.
    pub(super) fn parse(argument: OsString) -> Option<Self> {
        let bytes = argument.into_vec();
        let mut fields = bytes.splitn(3, |byte| *byte == b':');
        let by = match fields.next()? {
            b"folder" => JudgedBy::Folder,
            b"hash" => JudgedBy::Hash,
            _ => return None,
        };
        let stamp = Stamp::parse(std::str::from_utf8(fields.next()?).ok()?)?;
        let path = PathBuf::from(std::ffi::OsStr::from_bytes(fields.next()?));
        path.is_absolute().then_some(Self { path, stamp, by })
    }
}
