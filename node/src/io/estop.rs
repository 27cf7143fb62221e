//! The file `estop` in the folder of a node's state. While it exists, everything is stopped. One line names the user
//! who has stopped everything, and the next line has the reason. A file that cannot be read counts as well: nothing
//! begins before a user releases the stop.
//!
//! The file `estop.spare` reserves space on the disk: on a full disk, a file can get a new name but no content. An
//! emergency stop overwrites the spare file and renames it to `estop`. A release renames it back.

use crate::io::folder::sync_entry;
use crate::logic::protocol::Estop;
use comms::io::file::{self, Privacy};
use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The name of the file.
const FILE: &str = "estop";
/// The extension of the spare file.
const SPARE: &str = "spare";
/// The size of the file in bytes: the lines, and blanks after them.
const SIZE: usize = 4096;

/// The file; nothing for a node that stores nothing.
#[derive(Clone, Debug)]
pub(crate) struct EstopFile(Option<Arc<Inner>>);

#[derive(Debug)]
struct Inner {
    path: PathBuf,
    /// The intended content.
    wanted: Mutex<Option<Estop>>,
    /// Held while the file is written, so that an earlier content never overwrites a later one.
    disk: Mutex<()>,
}

impl EstopFile {
    /// Returns the file in a folder, and the stop that it records.
    pub(crate) fn open(folder: Option<PathBuf>) -> (Self, Option<Estop>) {
        let Some(path) = folder.map(|folder| folder.join(FILE)) else { return (Self(None), None) };
        let found = match file::bytes(&path, SIZE) {
            Err(error) if error.kind() == ErrorKind::NotFound => None,
            Ok(bytes) => Some(read(&String::from_utf8_lossy(&bytes))),
            Err(error) => {
                tracing::error!(file = %path.display(), %error, "the file cannot be read, so everything stays stopped");
                Some(read(""))
            }
        };
        prepare(&path);
        let inner = Inner { path, wanted: Mutex::new(found.clone()), disk: Mutex::new(()) };
        (Self(Some(Arc::new(inner))), found)
    }

    /// Notes the intended content.
    pub(crate) fn want(&self, estop: Option<Estop>) {
        if let Some(inner) = &self.0 {
            *lock(&inner.wanted) = estop;
        }
    }

    /// Writes the intended content. Blocks.
    ///
    /// The disk refuses. The text is for a person.
    /// The disk refuses; for a person.
    pub(crate) fn write(&self) -> Result<(), String> {
        let Some(inner) = &self.0 else { return Ok(()) };
        let turn = lock(&inner.disk);
        let wanted = lock(&inner.wanted).clone();
        let written = match wanted {
            Some(Estop { by, reason }) => mark(&inner.path, &format!("{}\n{}\n", line(&by), line(&reason))),
            None => unmark(&inner.path),
        };
        drop(turn);
        written.map_err(|error| {
            let file = inner.path.display();
            tracing::error!(%file, %error, "cannot store whether everything is stopped: the next start of this node may not know this");
            format!("`{file}`: {error}")
        })
    }
}

/// Makes the file durable. Only its existence matters: on a full disk without a spare file, it may be empty.
fn mark(path: &Path, words: &str) -> io::Result<()> {
    // If the file already has the same words, it is never removed, not even for a moment.
    if file::bytes(path, SIZE).is_ok_and(|there| there.starts_with(words.as_bytes())) {
        return File::open(path)?.sync_all().and_then(|()| sync_entry(path));
    }
    let spare = path.with_extension(SPARE);
    if fill(&spare, words).is_ok() {
        file::check(path)?;
        return fs::rename(spare, path).and_then(|()| sync_entry(path));
    }
    let mut made = file::created(path, Privacy::Usual)?;
    if let Err(error) = made.write_all(words.as_bytes()) {
        tracing::warn!(file = %path.display(), %error, "cannot store the user and the reason of the emergency stop");
    }
    made.sync_all()?;
    sync_entry(path)
}

/// Removes the file. Keeps its disk space for the next emergency stop.
fn unmark(path: &Path) -> io::Result<()> {
    file::check(path)?;
    removed(fs::rename(path, path.with_extension(SPARE)).and_then(|()| sync_entry(path)))?;
    prepare(path);
    Ok(())
}

/// Makes the spare file, unless one of the files already reserves the space. On a full disk, this fails.
fn prepare(path: &Path) {
    let spare = path.with_extension(SPARE);
    let has_room = |file: &Path| file.metadata().is_ok_and(|found| found.is_file() && found.len() >= SIZE as u64);
    if has_room(path) || has_room(&spare) {
        return;
    }
    let made = file::created(&spare, Privacy::Usual).and_then(|mut made| made.write_all(&padded("")));
    if let Err(error) = made {
        tracing::debug!(file = %spare.display(), %error, "cannot reserve space for the reason of an emergency stop");
    }
}

/// Overwrites the spare file with the words, without changing its size.
fn fill(spare: &Path, words: &str) -> io::Result<()> {
    file::check(spare)?;
    let mut opened = OpenOptions::new().write(true).open(spare)?;
    if opened.metadata()?.len() < SIZE as u64 {
        return Err(ErrorKind::NotFound.into());
    }
    opened.write_all(&padded(words))?;
    opened.sync_all()
}

/// Returns the content of the file: the words, followed by blanks.
fn padded(words: &str) -> Vec<u8> {
    let mut bytes = words.as_bytes().to_vec();
    bytes.resize(SIZE.max(bytes.len()), b' ');
    bytes
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn line(text: &str) -> String {
    text.replace(['\n', '\r'], " ")
}

fn read(text: &str) -> Estop {
    let mut lines = text.lines().map(str::to_owned);
    let by = lines.next().filter(|by| !by.is_empty()).unwrap_or_else(|| "somebody".to_owned());
    Estop { by, reason: lines.next().unwrap_or_default() }.bounded()
}

fn removed(result: io::Result<()>) -> io::Result<()> {
    result.or_else(|error| if error.kind() == ErrorKind::NotFound { Ok(()) } else { Err(error) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_stopped_stays_so_until_it_is_released() {
        let folder = std::env::temp_dir().join(format!("dca-estop-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let open = || EstopFile::open(Some(folder.clone()));
        let (file, before) = open();
        assert_eq!(before, None);
        let estop = Estop { by: "ann@c1".into(), reason: "a person\nin the cell".into() };
        file.want(Some(estop));
        file.write().unwrap();
        assert_eq!(open().1, Some(Estop { by: "ann@c1".into(), reason: "a person in the cell".into() }));
        file.want(None);
        file.write().unwrap();
        file.write().unwrap();
        assert_eq!(open().1, None);
        assert!(folder.join("estop.spare").metadata().unwrap().len() == SIZE as u64, "the room is kept");
        let somebody = Estop { by: "somebody".into(), reason: String::new() };
        fs::write(folder.join(FILE), "").unwrap();
        assert_eq!(open().1, Some(somebody.clone()), "an empty file counts");
        fs::remove_file(folder.join(FILE)).unwrap();
        rustix::fs::mkdir(folder.join(FILE), rustix::fs::Mode::RWXU).unwrap();
        assert_eq!(open().1, Some(somebody), "what cannot be read counts");
        assert!(file.write().unwrap_err().contains("estop"), "a folder is in the way");
        fs::remove_dir_all(&folder).unwrap();
    }
}
