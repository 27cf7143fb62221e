//! Writes a file under a temporary name, and renames it when it is complete.

use anyhow::{Context, bail};
use rustix::fs::OFlags;
use rustix::io::Errno;
use std::fs::{self, File, OpenOptions, Permissions};
use std::io::{self, Write};
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

/// Writes a file completely or not at all. A terminal, a device or a pipe with a reader gets the bytes directly.
///
/// # Errors
/// The disk refuses, or the path is a folder or a socket, or the pipe has no reader. An existing file stays unchanged.
pub fn put(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let kind = fs::metadata(path).map(|there| there.file_type());
    if kind.is_ok_and(|kind| kind.is_char_device() || kind.is_fifo()) {
        return pass(path, bytes).with_context(|| format!("writing {}", path.display()));
    }
    let mut file = WholeFile::create(path)?;
    file.write(bytes)?;
    file.finish()
}

/// Writes to something that is not a regular file. Does not wait for a reader.
fn pass(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let flags = OFlags::NONBLOCK.bits().cast_signed();
    let opened = OpenOptions::new().write(true).custom_flags(flags).open(path);
    let mut file = match opened {
        Err(error) if error.raw_os_error() == Some(Errno::NXIO.raw_os_error()) => bail!("no program reads this pipe"),
        opened => opened?,
    };
    // From here on, writes wait for the reader.
    rustix::fs::fcntl_setfl(&file, OFlags::empty())?;
    file.write_all(bytes)?;
    Ok(())
}

/// A file that is being written. If it is dropped before [`WholeFile::finish`], the new file is removed, and an
/// existing file of this name stays unchanged.
#[derive(Debug)]
pub struct WholeFile {
    file: File,
    path: PathBuf,
    /// The temporary name of the file; nothing once the file has its final name.
    part: Option<PathBuf>,
}

impl WholeFile {
    /// Begins a file that will get this name.
    ///
    /// # Errors
    /// The folder cannot be written, or the path is not a regular file.
    pub fn create(path: &Path) -> anyhow::Result<Self> {
        Self::begin(path, OpenOptions::new().create(true).truncate(true))
    }

    /// Begins a file that only its owner can ever read: it has mode 0600 from the start.
    ///
    /// # Errors
    /// The same as for [`WholeFile::create`].
    pub fn create_private(path: &Path) -> anyhow::Result<Self> {
        // A file of this name may be left over from a process with the same id. It may have another mode, so it is not reused.
        let new = Self::begin(path, OpenOptions::new().create_new(true).mode(0o600))?;
        new.file.set_permissions(Permissions::from_mode(0o600)).context("making a file private")?;
        Ok(new)
    }

    fn begin(path: &Path, options: &mut OpenOptions) -> anyhow::Result<Self> {
        if fs::metadata(path).is_ok_and(|there| !there.is_file()) {
            bail!("{} is not a regular file", path.display());
        }
        // If the path is a link, its target is replaced. An existing file keeps its permissions.
        let path = &fs::canonicalize(path).unwrap_or_else(|_not_there_yet| path.to_owned());
        let name = path.file_name().with_context(|| format!("{} names no file", path.display()))?;
        // The process id is in the name, so that two commands never write to the same temporary file.
        let part = path.with_file_name(format!("{}.part-{}", name.to_string_lossy(), std::process::id()));
        let file = options.write(true).open(&part).with_context(|| format!("writing {}", part.display()))?;
        if let Ok(there) = fs::metadata(path) {
            file.set_permissions(there.permissions()).with_context(|| format!("writing {}", part.display()))?;
        }
        Ok(Self { file, path: path.to_owned(), part: Some(part) })
    }

    /// Appends bytes to the file.
    ///
    /// # Errors
    /// The disk refuses.
    pub fn write(&mut self, bytes: &[u8]) -> anyhow::Result<()> {
        self.file.write_all(bytes).with_context(|| format!("writing {}", self.path.display()))
    }

    /// Gives the file its final name. The file is on the disk when this returns.
    ///
    /// # Errors
    /// The disk refuses. Then the new file does not exist; an earlier file is unchanged.
    pub fn finish(mut self) -> anyhow::Result<()> {
        let part = self.part.take().unwrap_or_default();
        let named = self.file.sync_all().and_then(|()| fs::rename(&part, &self.path)).and_then(|()| self.sync_folder());
        if named.is_err() {
            self.part = Some(part);
        }
        named.with_context(|| format!("writing {}", self.path.display()))
    }

    fn sync_folder(&self) -> io::Result<()> {
        let folder = self.path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        File::open(folder)?.sync_all()
    }
}

impl Drop for WholeFile {
    fn drop(&mut self) {
        if let Some(Err(error)) = self.part.take().map(fs::remove_file) {
            tracing::debug!(%error, "a part of a file stays");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_has_its_name_once_it_is_whole() {
        let folder = std::env::temp_dir().join(format!("dca-whole-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let path = folder.join("a.toml");
        let names = || fs::read_dir(&folder).unwrap().count();
        let mut file = WholeFile::create(&path).unwrap();
        file.write(b"half").unwrap();
        assert!(!path.exists() && names() == 1);
        drop(file);
        assert_eq!(names(), 0, "nothing is left of it");
        let mut file = WholeFile::create(&path).unwrap();
        file.write(b"whole").unwrap();
        file.finish().unwrap();
        let mut file = WholeFile::create(&path).unwrap();
        file.write(b"half").unwrap();
        drop(file);
        assert_eq!((fs::read(&path).unwrap(), names()), (b"whole".to_vec(), 1));
        let link = folder.join("link");
        std::os::unix::fs::symlink(&path, &link).unwrap();
        let mut file = WholeFile::create(&link).unwrap();
        file.write(b"through a link").unwrap();
        file.finish().unwrap();
        assert!(link.is_symlink() && fs::read(&path).unwrap() == b"through a link");
        let private = folder.join("private");
        let mut file = WholeFile::create_private(&private).unwrap();
        file.write(b"a key").unwrap();
        file.finish().unwrap();
        assert_eq!(fs::metadata(&private).unwrap().permissions().mode() & 0o777, 0o600);
        let wrong = WholeFile::create(&folder).unwrap_err().to_string();
        assert!(wrong.ends_with("is not a regular file"), "{wrong}");
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_pipe_gets_the_bytes_if_somebody_reads_it() {
        let folder = std::env::temp_dir().join(format!("dca-put-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let pipe = folder.join("pipe");
        rustix::fs::mknodat(rustix::fs::CWD, &pipe, rustix::fs::FileType::Fifo, 0o600.into(), 0).unwrap();
        let refused = format!("{:#}", put(&pipe, b"picture").unwrap_err());
        assert!(refused.ends_with("no program reads this pipe"), "{refused}");
        let reader = {
            let flags = OFlags::NONBLOCK.bits().cast_signed();
            OpenOptions::new().read(true).custom_flags(flags).open(&pipe).unwrap()
        };
        put(&pipe, b"picture").unwrap();
        let mut read = [0; 16];
        let length = rustix::io::read(&reader, &mut read).unwrap();
        assert_eq!(&read[..length], b"picture");
        assert!(format!("{:#}", put(Path::new("/dev/full"), b"x").unwrap_err()).contains("No space left"));
        put(Path::new("/dev/null"), b"x").unwrap();
        fs::remove_dir_all(&folder).unwrap();
    }
}
