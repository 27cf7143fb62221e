//! The interfaces of programs. The server asks for them in the background, and keeps them until the program changes.

use super::inbox::Event;
use language::Source;
use node::io::{programs, run_dir};
use std::fs;
use std::io;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::mpsc::SyncSender;

/// Identifies one build of a program: file number, length and time of the last change.
type Stamp = (u64, u64, i64, i64);

/// A program has answered, or has failed to answer.
#[derive(Debug)]
pub(super) struct InterfaceReply {
    program: PathBuf,
    stamp: Option<Stamp>,
    answer: Result<String, String>,
}

struct Program {
    path: PathBuf,
    /// The build that was last asked; nothing before the first question.
    asked: Option<Option<Stamp>>,
    is_asking: bool,
    source: Option<Source>,
}

/// The programs that offer controllers.
pub(super) struct Interfaces {
    programs: Vec<Program>,
    events: SyncSender<Event>,
    /// The folder for the files of shown interfaces, once one was shown.
    folder: OnceLock<PathBuf>,
}

impl Interfaces {
    /// Asks each of these programs. Their answers arrive as events.
    pub(super) fn new(paths: Vec<PathBuf>, events: SyncSender<Event>) -> Self {
        let program = |path| Program { path, asked: None, is_asking: false, source: None };
        let mut interfaces =
            Self { programs: paths.into_iter().map(program).collect(), events, folder: OnceLock::new() };
        interfaces.refresh();
        interfaces
    }

    /// Asks the programs again that have changed since the last question. Checking for changes takes a few microseconds.
    pub(super) fn refresh(&mut self) {
        for program in &mut self.programs {
            let stamp = stamp(&program.path);
            if program.is_asking || program.asked == Some(stamp) {
                continue;
            }
            program.asked = Some(stamp);
            let (path, events) = (program.path.clone(), self.events.clone());
            let ask = move || {
                let answer = programs::interfaces(&path).map_err(|error| error.to_string());
                // If the editor is gone, the answer has no receiver.
                events.send(Event::Interface(InterfaceReply { program: path, stamp, answer })).unwrap_or_default();
            };
            // The thread is not joined. It ends with the answer, for which there is a time limit.
            program.is_asking = std::thread::Builder::new().name("ask".to_owned()).spawn(ask).is_ok();
        }
    }

    /// Takes the answer of a program.
    ///
    /// # Errors
    /// A sentence for a person: the program does not print its interface. The server keeps its earlier interface.
    pub(super) fn take(&mut self, arrived: InterfaceReply) -> Result<(), String> {
        let Some(program) = self.programs.iter_mut().find(|program| program.path == arrived.program) else {
            return Ok(());
        };
        program.is_asking = false;
        program.asked = Some(arrived.stamp);
        let text = arrived.answer?;
        program.source = Some(Source::new(program.path.display().to_string(), text));
        Ok(())
    }

    /// Returns whether a program has not answered its first question yet. Its interface may make an unknown name known.
    pub(super) fn is_waiting(&self) -> bool {
        self.programs.iter().any(|program| program.is_asking && program.source.is_none())
    }

    /// Writes the interface of a program to a file that an editor can show, and returns its path. The file is in this
    /// user's folder for nodes. The system's folder for temporary files would not be safe, because every user can make
    /// folders there.
    ///
    /// # Errors
    /// The file cannot be written, or the folder belongs to another user.
    pub(super) fn show(&self, source: &Source) -> io::Result<String> {
        let name = Path::new(&source.name).file_name().unwrap_or_default().to_string_lossy().into_owned();
        let folder = own_folder(&run_dir::default_base())?;
        let file = self.folder.get_or_init(|| folder).join(format!("{name}.dca"));
        fs::write(&file, &source.text)?;
        Ok(file.to_string_lossy().into_owned())
    }

    /// Returns the interfaces of the programs.
    pub(super) fn sources(&self) -> Vec<Source> {
        self.programs.iter().filter_map(|program| program.source.clone()).collect()
    }
}

impl Drop for Interfaces {
    fn drop(&mut self) {
        if let Some(folder) = self.folder.get() {
            fs::remove_dir_all(folder).unwrap_or_default();
        }
    }
}

/// Makes this server's own folder in `base`. Both folders belong to this user, and no other user can write there.
fn own_folder(base: &Path) -> io::Result<PathBuf> {
    let folder = base.join(format!("lsp-{}", std::process::id()));
    for path in [base, &folder] {
        run_dir::private_folder(path).map_err(io::Error::other)?;
    }
    Ok(folder)
}

fn stamp(path: &Path) -> Option<Stamp> {
    let data = fs::metadata(path).ok()?;
    Some((data.ino(), data.size(), data.mtime(), data.mtime_nsec()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::{PermissionsExt, symlink};

    #[test]
    fn interfaces_are_shown_from_a_folder_of_this_user() {
        let base = std::env::temp_dir().join(format!("dca-show-{}", std::process::id()));
        let folder = own_folder(&base).unwrap();
        for path in [&base, &folder] {
            assert_eq!(fs::metadata(path).unwrap().permissions().mode() & 0o077, 0, "{path:?}");
        }
        fs::remove_dir(&folder).unwrap();
        symlink(std::env::temp_dir(), &folder).unwrap();
        let why = own_folder(&base).unwrap_err().to_string();
        assert!(why.contains("is a link"), "{why}");
        fs::remove_dir_all(&base).unwrap();
    }
}
