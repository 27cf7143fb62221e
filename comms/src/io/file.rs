//! Reads and writes regular files, and nothing else, without waiting.
//!
//! A name in a folder may belong to anything. A named pipe holds whoever opens it until somebody reads or writes, a device may
//! have no end, and a regular file may be larger than the memory.

use rustix::fs::{FileType, Mode, OFlags, fstat, open, stat};
use rustix::io::Errno;
use std::fs::{File, OpenOptions};
use std::io::{self, ErrorKind, Read, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;

/// Who may read a file that is made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Privacy {
    /// Its user alone.
    Own,
    /// Whoever the process lets read its files.
    Usual,
}

/// Returns the bytes of a regular file that has at most `bytes_max` of them.
///
/// # Errors
/// The file cannot be opened or read, is no regular file (`InvalidInput`), or is longer (`FileTooLarge`).
pub fn bytes(path: &Path, bytes_max: usize) -> io::Result<Vec<u8>> {
    bounded(opened(path)?, bytes_max)
}

/// Opens a regular file to be read.
///
/// # Errors
/// The file cannot be opened, or is no regular file (`InvalidInput`).
pub fn opened(path: &Path) -> io::Result<File> {
    // To open a device may already do something to it.
    require_regular(FileType::from_raw_mode(stat(path)?.st_mode), "read")?;
    // Without blocking: the name may belong to something else by now.
    regular(path, OFlags::RDONLY, "read")
}

/// Opens a regular file to be appended to; makes it if it is not there.
///
/// # Errors
/// The file cannot be made or opened, or is no regular file (`InvalidInput`).
pub fn appended(path: &Path) -> io::Result<File> {
    match stat(path) {
        Ok(there) => require_regular(FileType::from_raw_mode(there.st_mode), "written")?,
        Err(Errno::NOENT) => {}
        Err(error) => return Err(error.into()),
    }
    regular(path, OFlags::WRONLY | OFlags::APPEND | OFlags::CREATE, "written")
}

/// Makes an empty file in the place of whatever has its name, but for a folder.
///
/// # Errors
/// What is there cannot be removed, or the file cannot be made.
pub fn created(path: &Path, privacy: Privacy) -> io::Result<File> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    let mode = match privacy {
        Privacy::Own => 0o600,
        Privacy::Usual => 0o666,
    };
    OpenOptions::new().create_new(true).write(true).mode(mode).open(path)
}

/// Makes a file of these bytes, in the place of whatever has its name, but for a folder.
///
/// # Errors
/// As [`created`], or it cannot be written.
pub fn write(path: &Path, bytes: &[u8]) -> io::Result<()> {
    created(path, Privacy::Usual)?.write_all(bytes)
}

/// Returns everything that can be read, if it is at most so much.
///
/// # Errors
/// It cannot be read, or is longer (`FileTooLarge`).
pub fn bounded(from: impl Read, bytes_max: usize) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    from.take(bytes_max as u64 + 1).read_to_end(&mut bytes)?;
    if bytes.len() > bytes_max {
        return Err(io::Error::new(ErrorKind::FileTooLarge, format!("it is longer than {} MiB", bytes_max >> 20)));
    }
    Ok(bytes)
}

fn regular(path: &Path, flags: OFlags, use_of_it: &str) -> io::Result<File> {
    // A pipe without a reader is refused by the system itself (`ENXIO`).
    let file = open(path, flags | OFlags::NONBLOCK | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::from_raw_mode(0o666))?;
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
        FileType::Symlink | FileType::Unknown => "something else",
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
            assert_eq!(appended(path).unwrap_err().to_string(), said("written"));
        }
        assert_eq!(bytes(&folder, 9).unwrap_err().kind(), ErrorKind::IsADirectory);
        assert_eq!(bytes(&file, 9).unwrap_err().kind(), ErrorKind::NotFound);
        for part in ["abc", "def"] {
            appended(&file).unwrap().write_all(part.as_bytes()).unwrap();
        }
        assert_eq!(bytes(&file, 6).unwrap(), b"abcdef");
        assert_eq!(bytes(&file, 5).unwrap_err().kind(), ErrorKind::FileTooLarge);
        // What is in the way goes; what a link leads to stays.
        for path in [&pipe, &link, &file] {
            write(path, b"new").unwrap();
            assert_eq!(bytes(path, 9).unwrap(), b"new");
        }
        assert!(write(&folder, b"new").is_err());
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
