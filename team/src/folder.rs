//! Files that only their owner may read. One that others may read or write is refused, not mended: who knows who has.

use anyhow::{Context as _, ensure};
use std::fs::{self, DirBuilder, File, OpenOptions};
use std::io::{Read as _, Write as _};
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _, OpenOptionsExt as _};
use std::path::Path;
use zeroize::Zeroizing;

/// Makes a folder that only this user can enter, if it is not there.
///
/// # Errors
/// It cannot be made.
pub fn make(folder: &Path) -> anyhow::Result<()> {
    let made = DirBuilder::new().recursive(true).mode(0o700).create(folder);
    made.with_context(|| format!("making the folder `{}`", folder.display()))
}

/// Writes a whole file, or leaves the one from before. It is on the disk when this returns.
///
/// # Errors
/// The disk refuses.
pub fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let part = path.with_extension(format!("part-{}", std::process::id()));
    let write = || {
        // What is left of a process with the same id may have another mode.
        drop(fs::remove_file(&part));
        let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(&part)?;
        file.write_all(bytes)?;
        file.sync_all()?;
        fs::rename(&part, path)?;
        File::open(path.parent().unwrap_or(Path::new("/")))?.sync_all()
    };
    write().with_context(|| format!("writing `{}`", path.display()))
}

/// Reads a file of at most so many bytes; nothing if there is none.
///
/// # Errors
/// It cannot be read, is longer, or somebody else may read or write it.
pub fn read(path: &Path, bytes_max: usize) -> anyhow::Result<Option<Zeroizing<Vec<u8>>>> {
    let reading = || format!("reading `{}`", path.display());
    let file = match File::open(path) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        opened => opened.with_context(reading)?,
    };
    let there = file.metadata().with_context(reading)?;
    let own = rustix::process::getuid().as_raw();
    let is_private = there.mode() & 0o077 == 0 && (there.uid() == own || there.uid() == 0);
    ensure!(
        is_private,
        "others may read or write `{0}`: it is not used; see who did, then `chmod 600 {0}`",
        path.display()
    );
    ensure!(there.is_file() && there.len() <= bytes_max as u64, "`{}` is too long, or no file", path.display());
    let mut bytes = Zeroizing::new(Vec::with_capacity(bytes_max.min(4096)));
    file.take(bytes_max as u64 + 1).read_to_end(&mut bytes).with_context(reading)?;
    ensure!(bytes.len() <= bytes_max, "`{}` is too long", path.display());
    Ok(Some(bytes))
}
