//! Files that only their owner may read. Files with wider permissions are rejected rather than fixed, because another
//! user may already have read them.

use anyhow::{Context as _, ensure};
use rustix::fs::OFlags;
use std::fs::{self, DirBuilder, File, OpenOptions, Permissions};
use std::io::{self, Read as _, Write as _};
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _, OpenOptionsExt as _, PermissionsExt as _, fchown};
use std::path::{Path, PathBuf};
use zeroize::Zeroizing;

/// Makes a folder that only this user can enter, if it does not exist.
///
/// # Errors
/// If the folder cannot be made.
pub fn make(folder: &Path) -> anyhow::Result<()> {
    let made = DirBuilder::new().recursive(true).mode(0o700).create(folder);
    made.with_context(|| format!("making the folder `{}`", folder.display()))
}

/// Writes a complete file, or leaves the previous one unchanged. The file is on the disk when this returns.
///
/// # Errors
/// If the disk refuses.
pub fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    write_with(path, bytes, |_| Ok(()))
}

/// Writes a file like [`write()`]. Members of the group `gid` may read it.
///
/// # Errors
/// The errors of [`write()`], or if this process is not root.
pub fn write_for_group(path: &Path, bytes: &[u8], gid: u32) -> anyhow::Result<()> {
    write_with(path, bytes, |file| {
        fchown(file, None, Some(gid))?;
        file.set_permissions(Permissions::from_mode(0o640))
    })
}

/// The file gets its permissions before its name, so no reader finds a file that it cannot read.
fn write_with(path: &Path, bytes: &[u8], share: impl FnOnce(&File) -> io::Result<()>) -> anyhow::Result<()> {
    let part = path.with_extension(format!("part-{}", std::process::id()));
    let write = || {
        // A file that an earlier process with the same id has left may have another mode.
        drop(fs::remove_file(&part));
        let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&part)?;
        file.write_all(bytes)?;
        share(&file)?;
        file.sync_all()?;
        fs::rename(&part, path)?;
        File::open(path.parent().unwrap_or(Path::new("/")))?.sync_all()
    };
    // An incomplete file is removed, so that it does not fill the disk.
    let written = write().inspect_err(|_| drop(fs::remove_file(&part)));
    written.with_context(|| format!("writing `{}`", path.display()))
}

/// Reserved disk space for a later write that must succeed.
#[derive(Debug)]
pub struct Reserve(PathBuf);

impl Reserve {
    /// Reserves `size` bytes in a folder, which is made if it does not exist.
    ///
    /// # Errors
    /// If the disk refuses.
    pub fn take(folder: &Path, size: usize) -> anyhow::Result<Self> {
        make(folder)?;
        let reserve = Self(folder.join(format!(".reserve-{}", std::process::id())));
        write(&reserve.0, &vec![0x5a; size])?;
        Ok(reserve)
    }
}

impl Drop for Reserve {
    fn drop(&mut self) {
        drop(fs::remove_file(&self.0));
    }
}

/// Reads a file of at most `bytes_max` bytes; none if the file is missing.
///
/// # Errors
/// If the file cannot be read, is not a regular file, is too long, or another user may read or write it.
pub fn read(path: &Path, bytes_max: usize) -> anyhow::Result<Option<Zeroizing<Vec<u8>>>> {
    read_with(path, bytes_max, 0o077)
}

/// Reads a file without secrets, like [`read`], but other users may read it as well.
///
/// # Errors
/// If the file cannot be read, is not a regular file, is too long, or another user may write it.
pub fn read_open(path: &Path, bytes_max: usize) -> anyhow::Result<Option<Zeroizing<Vec<u8>>>> {
    read_with(path, bytes_max, 0o022)
}

fn read_with(path: &Path, bytes_max: usize, closed: u32) -> anyhow::Result<Option<Zeroizing<Vec<u8>>>> {
    let reading = || format!("reading `{}`", path.display());
    // Opened without waiting, since the file may be a pipe without a writer.
    let opened = OpenOptions::new().read(true).custom_flags(OFlags::NONBLOCK.bits().cast_signed()).open(path);
    let file = match opened {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        opened => opened.with_context(reading)?,
    };
    let there = file.metadata().with_context(reading)?;
    ensure!(there.is_file(), "`{}` is not a file", path.display());
    ensure!(there.len() <= bytes_max as u64, "`{}` is too long", path.display());
    let own = rustix::process::getuid().as_raw();
    let is_private = there.mode() & closed == 0 && (there.uid() == own || there.uid() == 0);
    ensure!(
        is_private,
        "other users can read or write `{0}`, so it is not used; find out whether another user has read it, and then run `chmod 600 {0}`",
        path.display()
    );
    let mut bytes = Zeroizing::new(Vec::with_capacity(bytes_max.min(4096)));
    file.take(bytes_max as u64 + 1).read_to_end(&mut bytes).with_context(reading)?;
    ensure!(bytes.len() <= bytes_max, "`{}` is too long", path.display());
    Ok(Some(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_private_file_is_read_and_a_reserve_goes() {
        let folder = std::env::temp_dir().join(format!("dca-private-{}", std::process::id()));
        let path = |name: &str| folder.join(name);
        let reserve = Reserve::take(&folder, 5000).unwrap();
        assert_eq!(fs::read_dir(&folder).unwrap().map(|one| one.unwrap().metadata().unwrap().len()).sum::<u64>(), 5000);
        drop(reserve);
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 0);
        write(&path("keys"), b"secret").unwrap();
        assert_eq!(read(&path("keys"), 6).unwrap().unwrap().as_slice(), b"secret");
        assert!(read(&path("keys"), 5).unwrap_err().to_string().ends_with("is too long"));
        assert!(read(&path("none"), 5).unwrap().is_none());
        // A failed write leaves no file.
        fs::create_dir_all(path("full/of")).unwrap();
        assert!(write(&path("full"), b"secret").is_err());
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 2);
        // A file that others may read is not secret, and a file that others may write cannot be trusted.
        let mode = |mode| fs::set_permissions(path("keys"), Permissions::from_mode(mode)).unwrap();
        mode(0o644);
        assert!(read(&path("keys"), 6).is_err() && read_open(&path("keys"), 6).unwrap().is_some());
        mode(0o664);
        assert!(read_open(&path("keys"), 6).is_err());
        // This pipe has no writer: waiting for one would take for ever.
        rustix::fs::mknodat(rustix::fs::CWD, path("pipe"), rustix::fs::FileType::Fifo, 0o600.into(), 0).unwrap();
        assert!(read(&path("pipe"), 5).unwrap_err().to_string().ends_with("is not a file"));
        assert!(read(&folder, 5).unwrap_err().to_string().ends_with("is not a file"));
        fs::remove_dir_all(&folder).unwrap();
    }
}
