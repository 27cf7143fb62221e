//! Reads and writes regular files without waiting, and refuses everything else.
//!
//! A name in a folder may belong to anything. Opening a named pipe waits for a reader or writer, a device may be
//! endless, and a regular file may be larger than the memory.

use crate::logic::human::size;
use rustix::fs::{FileType, Mode, OFlags, fstat, lstat, open, stat};
use rustix::io::Errno;
use std::fs::{File, Metadata, OpenOptions};
use std::io::{self, ErrorKind, Read, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::Path;

/// The permissions of a new file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Privacy {
    /// Only its user may read or write the file.
    Own,
    /// The usual permissions of the process.
    Usual,
}

impl Privacy {
    const fn mode(self) -> u32 {
        match self {
            Self::Own => 0o600,
            Self::Usual => 0o666,
        }
    }
}

/// Returns the bytes of a regular file that has at most `bytes_max` of them.
///
/// # Errors
/// The file cannot be opened or read, is not a regular file (`InvalidInput`), or is longer (`FileTooLarge`).
pub fn bytes(path: &Path, bytes_max: usize) -> io::Result<Vec<u8>> {
    bounded(opened(path)?, bytes_max)
}

/// Opens a regular file to be read.
///
/// # Errors
/// The file cannot be opened, or is not a regular file (`InvalidInput`), which includes a dangling link.
pub fn opened(path: &Path) -> io::Result<File> {
    // Opening a device may already have an effect on it.
    if !is_there(path, "read")? {
        return Err(Errno::NOENT.into());
    }
    // Opened without blocking: since the check, the name may belong to something else.
    regular(path, OFlags::RDONLY, Privacy::Usual, "read")
}

/// Returns the bytes like [`bytes`], but does not follow a link, like [`opened_itself`].
///
/// # Errors
/// The errors of [`opened_itself`], or the file is longer (`FileTooLarge`).
pub fn bytes_itself(path: &Path, bytes_max: usize) -> io::Result<Vec<u8>> {
    bounded(opened_itself(path)?, bytes_max)
}

/// Opens a regular file for reading, without following a link. So a user who owns the folder cannot make this process
/// read other files.
///
/// # Errors
/// The errors of [`opened`], and a link (`InvalidInput`).
pub fn opened_itself(path: &Path) -> io::Result<File> {
    require_regular(FileType::from_raw_mode(lstat(path)?.st_mode), "read")?;
    regular(path, OFlags::RDONLY | OFlags::NOFOLLOW, Privacy::Usual, "read")
}

/// Opens a regular file to be appended to, without following a link; makes it if it does not exist.
///
/// # Errors
/// The errors of [`appended`], and a link (`InvalidInput`).
pub fn appended_itself(path: &Path, privacy: Privacy) -> io::Result<File> {
    check_itself(path)?;
    regular(path, OFlags::WRONLY | OFlags::APPEND | OFlags::CREATE | OFlags::NOFOLLOW, privacy, "written")
}

/// Checks that a name belongs to a regular file, not to a link to one, or to nothing.
///
/// # Errors
/// The name belongs to something else, such as a link (`InvalidInput`, or `IsADirectory`), or cannot be examined.
pub fn check_itself(path: &Path) -> io::Result<()> {
    match lstat(path) {
        Ok(there) => require_regular(FileType::from_raw_mode(there.st_mode), "written"),
        Err(Errno::NOENT) => Ok(()),
        Err(error) => Err(error.into()),
    }
}

/// Opens a regular file for appending. Makes the file if it does not exist.
///
/// # Errors
/// The file cannot be made or opened, or is not a regular file (`InvalidInput`).
pub fn appended(path: &Path, privacy: Privacy) -> io::Result<File> {
    check(path)?;
    regular(path, OFlags::WRONLY | OFlags::APPEND | OFlags::CREATE, privacy, "written")
}

/// Checks that a name belongs to a regular file or to nothing, before a library opens it that does not check this.
///
/// # Errors
/// It belongs to something else (`InvalidInput`, or `IsADirectory`), or cannot be examined.
pub fn check(path: &Path) -> io::Result<()> {
    is_there(path, "written").map(drop)
}

/// Returns whether an open file still has this name. Writes to a file without a name are lost.
pub fn is_in_place(file: &File, path: &Path) -> bool {
    let id = |found: io::Result<Metadata>| found.map(|found| (found.dev(), found.ino())).ok();
    let here = id(std::fs::symlink_metadata(path));
    here.is_some() && here == id(file.metadata())
}

/// Makes an empty file. It replaces anything of its name, except a folder.
///
/// # Errors
/// The present entry cannot be removed, or the file cannot be made.
pub fn created(path: &Path, privacy: Privacy) -> io::Result<File> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    OpenOptions::new().create_new(true).write(true).mode(privacy.mode()).open(path)
}

/// Makes a file of these bytes. It replaces anything of its name, except a folder.
///
/// # Errors
/// The errors of [`created`], or the file cannot be written.
pub fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    created(path, Privacy::Usual)?.write_all(bytes)
}

/// Returns everything that can be read, if it has at most `bytes_max` bytes.
///
/// # Errors
/// It cannot be read, or is longer (`FileTooLarge`).
pub fn bounded(from: impl Read, bytes_max: usize) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    from.take(bytes_max as u64 + 1).read_to_end(&mut bytes)?;
    if bytes.len() > bytes_max {
        let message = format!("it is longer than {}", size(bytes_max as u64));
        return Err(io::Error::new(ErrorKind::FileTooLarge, message));
    }
    Ok(bytes)
}

/// Returns whether a regular file has this name; false if nothing has this name.
fn is_there(path: &Path, use_of_it: &str) -> io::Result<bool> {
    match stat(path) {
        Ok(there) => require_regular(FileType::from_raw_mode(there.st_mode), use_of_it).map(|()| true),
        // A dangling link. Writing would make a file elsewhere, and reading would fail with "not found".
        Err(Errno::NOENT) if lstat(path).is_ok() => {
            Err(io::Error::new(ErrorKind::InvalidInput, "it is a link that leads nowhere"))
        }
        Err(Errno::NOENT) => Ok(false),
        Err(error) => Err(error.into()),
    }
}

fn regular(path: &Path, flags: OFlags, privacy: Privacy, use_of_it: &str) -> io::Result<File> {
    // The system itself refuses to open a pipe without a reader for writing (`ENXIO`).
    let flags = flags | OFlags::NONBLOCK | OFlags::NOCTTY | OFlags::CLOEXEC;
    let file = open(path, flags, Mode::from_raw_mode(privacy.mode()))?;
    require_regular(FileType::from_raw_mode(fstat(&file)?.st_mode), use_of_it)?;
    Ok(File::from(file))
}

fn require_regular(kind: FileType, use_of_it: &str) -> io::Result<()> {
    let what = match kind {
        FileType::RegularFile => return Ok(()),
        FileType::Directory => return Err(Errno::ISDIR.into()),
        FileType::Fifo => "a pipe",
        FileType::Socket => "a socket",
        FileType::CharacterDevice | FileType::BlockDevice => "a device",
        FileType::Symlink => "a link",
        FileType::Unknown => "something else",
    };
    Err(io::Error::new(ErrorKind::InvalidInput, format!("it is {what}; only regular files are {use_of_it}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::fs::{CWD, mknodat};

    #[test]
    fn what_is_no_regular_file_is_refused_at_once() {
        let folder = std::env::temp_dir().join(format!("dca-file-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (pipe, file, link) = (folder.join("pipe"), folder.join("file"), folder.join("link"));
        mknodat(CWD, &pipe, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
        std::os::unix::fs::symlink("/dev/zero", &link).unwrap();
        for (path, what) in [(&pipe, "a pipe"), (&link, "a device")] {
            let said = |use_of_it: &str| format!("it is {what}; only regular files are {use_of_it}");
            assert_eq!(bytes(path, 9).unwrap_err().to_string(), said("read"));
            assert_eq!(appended(path, Privacy::Own).unwrap_err().to_string(), said("written"));
            assert_eq!(check(path).unwrap_err().to_string(), said("written"));
        }
        std::fs::write(&file, b"secret").unwrap();
        let leads = folder.join("leads");
        std::os::unix::fs::symlink(&file, &leads).unwrap();
        assert_eq!(bytes(&leads, 9).unwrap(), b"secret");
        let refused =
            [opened_itself(&leads).map(drop), appended_itself(&leads, Privacy::Own).map(drop), check_itself(&leads)];
        let said = refused.map(|refused| refused.unwrap_err().to_string());
        let why = |use_of_it: &str| format!("it is a link; only regular files are {use_of_it}");
        assert_eq!(said, [why("read"), why("written"), why("written")]);
        assert_eq!(bytes_itself(&file, 9).unwrap(), b"secret");
        appended_itself(&file, Privacy::Own).unwrap().write_all(b"s").unwrap();
        assert_eq!(bytes_itself(&file, 9).unwrap(), b"secrets");
        std::fs::remove_file(&file).unwrap();
        check_itself(&file).unwrap();
        let dangling = folder.join("dangling");
        std::os::unix::fs::symlink(folder.join("nothing"), &dangling).unwrap();
        for error in [opened(&dangling).unwrap_err(), appended(&dangling, Privacy::Own).unwrap_err()] {
            assert_eq!(error.to_string(), "it is a link that leads nowhere");
        }
        assert_eq!(check(&folder).unwrap_err().kind(), ErrorKind::IsADirectory);
        check(&file).unwrap();
        assert_eq!(bytes(&folder, 9).unwrap_err().kind(), ErrorKind::IsADirectory);
        assert_eq!(bytes(&file, 9).unwrap_err().kind(), ErrorKind::NotFound);
        for part in ["abc", "def"] {
            appended(&file, Privacy::Own).unwrap().write_all(part.as_bytes()).unwrap();
        }
        assert_eq!(bytes(&file, 6).unwrap(), b"abcdef");
        assert_eq!(bytes(&file, 5).unwrap_err().kind(), ErrorKind::FileTooLarge);
        // The file in the way is replaced; the target of a link stays.
        for path in [&pipe, &link, &dangling, &file] {
            write(path, b"new").unwrap();
            assert_eq!(bytes(path, 9).unwrap(), b"new");
        }
        assert!(write(&folder, b"new").is_err());
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
