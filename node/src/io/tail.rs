//! Sends the output of programs to a caller as it grows.
//!
//! The output of a program is in a file. If the file is long, it is put aside, so there are at most two files
//! (`dca-shim`). A `Reader` keeps its file open. So no output is lost if the file is put aside during the read.

use crate::io::caller::Caller;
use crate::logic::output_lines::GAP;
use crate::logic::protocol::Answer;
use comms::io::file;
use shim::protocol::{OUTPUT_FILE, OUTPUT_FILE_OLD};
use std::fs::File;
use std::io::{self, Read, Seek};
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;
use std::time::Duration;
use tokio::sync::watch;

/// How often a followed file is read again.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// The most pieces that wait to be sent. If there are more, no more output is read.
const BACKLOG_MAX: usize = 64;
/// How much of a program's output is sent at once.
const CHUNK: usize = 64 * 1024;

/// Shows when a deployment is over. Then its programs write no more output.
#[derive(Debug)]
pub struct DeploymentEnd(Option<watch::Receiver<()>>);

impl DeploymentEnd {
    /// Returns a value that reports the end when `living` is dropped. Without `living`, the deployment is already over.
    pub fn new(living: Option<&watch::Sender<()>>) -> Self {
        Self(living.map(watch::Sender::subscribe))
    }

    fn is_over(&self) -> bool {
        self.0.as_ref().is_none_or(|living| living.has_changed().is_err())
    }

    /// Waits until the deployment is over.
    ///
    /// # Cancellation
    /// Safe.
    async fn wait(&mut self) {
        if let Some(living) = &mut self.0 {
            while living.changed().await.is_ok() {}
        }
    }
}

/// Reads all available output of one program.
#[derive(Debug)]
struct Reader {
    dir: PathBuf,
    file: Option<File>,
    /// Whether the file has been put aside. Then it does not grow any more.
    is_aside: bool,
}

impl Reader {
    fn new(dir: PathBuf) -> Self {
        Self { dir, file: None, is_aside: false }
    }

    /// Returns the next bytes. They are empty while the program writes nothing more.
    fn read(&mut self) -> io::Result<Vec<u8>> {
        let mut chunk = vec![0; CHUNK];
        loop {
            let Some(file) = &mut self.file else {
                let (old, new) = (self.open(OUTPUT_FILE_OLD)?, self.open(OUTPUT_FILE)?);
                (self.is_aside, self.file) = (old.is_some(), old.or(new));
                if self.file.is_none() {
                    return Ok(Vec::new());
                }
                continue;
            };
            let count = file.read(&mut chunk)?;
            if count > 0 {
                chunk.truncate(count);
                return Ok(chunk);
            }
            let this = id(&file.metadata()?);
            if self.is_aside {
                // The next file is the file that was put aside after this file, or else the current file.
                let old = self.open(OUTPUT_FILE_OLD)?;
                let missed = old.filter(|old| old.metadata().is_ok_and(|old| id(&old) != this));
                let is_aside = missed.is_some();
                let Some(next) = (if is_aside { missed } else { self.open(OUTPUT_FILE)? }) else {
                    return Ok(Vec::new());
                };
                (self.is_aside, self.file) = (is_aside, Some(next));
                if is_aside {
                    // Between these two files, other files may have been put aside and removed.
                    return Ok(format!("\n{GAP}\n").into_bytes());
                }
            } else if self.is_current(this) {
                if file_is_shorter(self.file.as_mut())? {
                    // The file has been truncated.
                    continue;
                }
                return Ok(Vec::new());
            } else {
                // The file was put aside. It may have grown before that, so it is read once more.
                self.is_aside = true;
            }
        }
    }

    fn is_current(&self, file: (u64, u64)) -> bool {
        std::fs::metadata(self.dir.join(OUTPUT_FILE)).is_ok_and(|current| id(&current) == file)
    }

    fn open(&self, name: &str) -> io::Result<Option<File>> {
        // The program can write to the folder as well, so the target of a link is not shown.
        match file::opened_itself(&self.dir.join(name)) {
            Ok(file) => Ok(Some(file)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error),
        }
    }
}

/// If a file has become shorter than the part that was read, goes back to its beginning. Returns whether this is so.
fn file_is_shorter(file: Option<&mut File>) -> io::Result<bool> {
    let Some(file) = file else { return Ok(false) };
    let is_shorter = file.metadata()?.len() < file.stream_position()?;
    if is_shorter {
        file.rewind()?;
    }
    Ok(is_shorter)
}

fn id(file: &std::fs::Metadata) -> (u64, u64) {
    (file.dev(), file.ino())
}

/// Sends the output of the program in `dir`. With `follow`, also sends its later output, until its deployment is over.
///
/// # Cancellation
/// Safe: only the file is owned.
pub async fn tail(dir: PathBuf, follow: bool, over: DeploymentEnd, caller: Caller) {
    let over = if follow { over } else { DeploymentEnd(None) };
    // An empty output is sent first: a call that ends without any answer would look as if it had not arrived.
    if caller.send(Answer::Output(Vec::new())).await {
        send(vec![Reader::new(dir)], over, caller, |_, bytes| Answer::Output(bytes)).await;
    }
}

/// Sends all output of some programs (path, folder), also later output, until their deployment is over.
///
/// # Cancellation
/// Safe: only the files are owned.
pub async fn all(programs: Vec<(String, PathBuf)>, over: DeploymentEnd, caller: Caller) {
    let (paths, dirs): (Vec<String>, Vec<PathBuf>) = programs.into_iter().unzip();
    let readers = dirs.into_iter().map(Reader::new).collect();
    let nothing = Answer::Wrote { path: paths.first().cloned().unwrap_or_default(), bytes: Vec::new() };
    let answer = |index: usize, bytes| Answer::Wrote { path: paths[index].clone(), bytes };
    if caller.send(nothing).await {
        send(readers, over, caller, answer).await;
    }
}

/// Sends the output of all readers. It takes one chunk of each reader at a time, so that a program
/// with much output does not delay other readers. If a file cannot be read, the rest of it is left
/// out. The caller is told at the end that the output is incomplete.
async fn send(
    readers: Vec<Reader>,
    mut over: DeploymentEnd,
    caller: Caller,
    answer: impl Fn(usize, Vec<u8>) -> Answer,
) {
    let mut readers: Vec<(usize, Reader)> = readers.into_iter().enumerate().collect();
    let mut failure: Option<String> = None;
    let mut interval = tokio::time::interval(LOOK_EVERY);
    loop {
        if caller.waiting() > BACKLOG_MAX {
            // The caller receives the output more slowly than the programs write it. The files can wait, but the memory
            // of this node must not grow.
            tokio::select! {
                _ = interval.tick() => continue,
                () = caller.closed() => return,
            }
        }
        // This is checked before reading, so that all output from before the end is read afterwards.
        let is_over = over.is_over();
        let reading = tokio::task::spawn_blocking(move || {
            let found = readers.iter_mut().map(|(index, reader)| (*index, reader.read())).collect::<Vec<_>>();
            (readers, found)
        });
        let Ok((back, found)) = reading.await else { return };
        readers = back;
        let mut more = false;
        for (index, read) in found {
            match read {
                Ok(bytes) if bytes.is_empty() => {}
                Ok(bytes) => {
                    more = true;
                    if !caller.send(answer(index, bytes)).await {
                        return;
                    }
                }
                Err(error) => {
                    tracing::warn!(%error, "cannot read the output of a program");
                    failure.get_or_insert(format!("cannot read the output of a program: {error}"));
                    readers.retain(|(reader, _)| *reader != index);
                }
            }
        }
        if is_over && !more || readers.is_empty() {
            return match failure {
                Some(why) => caller.fail(why),
                None => caller.end(),
            };
        }
        tokio::select! {
            () = std::future::ready(()), if is_over => {}
            _ = interval.tick() => {}
            () = over.wait(), if !is_over => {}
            () = caller.closed() => return,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::caller::answers;
    use std::io::Write;
    use std::path::Path;

    fn whole(dir: &Path) -> Vec<u8> {
        let mut reader = Reader::new(dir.to_owned());
        std::iter::from_fn(|| Some(reader.read().unwrap()).filter(|bytes| !bytes.is_empty())).flatten().collect()
    }

    /// The folder of a program, with the files of its shim.
    struct Folder(PathBuf);

    impl Folder {
        fn new(name: &str) -> Self {
            let folder = std::env::temp_dir().join(format!("dca-tail-{name}-{}", std::process::id()));
            std::fs::create_dir_all(&folder).unwrap();
            Self(folder)
        }

        fn write(&self, text: &str) {
            let mut file = File::options().create(true).append(true).open(self.0.join(OUTPUT_FILE)).unwrap();
            file.write_all(text.as_bytes()).unwrap();
        }

        fn rotate(&self) {
            std::fs::rename(self.0.join(OUTPUT_FILE), self.0.join(OUTPUT_FILE_OLD)).unwrap();
        }
    }

    impl Drop for Folder {
        fn drop(&mut self) {
            drop(std::fs::remove_dir_all(&self.0));
        }
    }

    #[test]
    fn a_file_that_somebody_empties_or_removes_is_read_on() {
        let folder = Folder::new("emptied");
        let path = folder.0.join(OUTPUT_FILE);
        let mut reader = Reader::new(folder.0.clone());
        let mut read = || String::from_utf8(reader.read().unwrap()).unwrap();
        folder.write("first");
        assert_eq!(read(), "first");
        std::fs::write(&path, "").unwrap();
        assert_eq!(read(), "");
        folder.write("2nd");
        assert_eq!(read(), "2nd");
        std::fs::remove_file(&path).unwrap();
        assert_eq!(read(), "");
        folder.write("third");
        assert_eq!(read(), "third");
    }

    #[test]
    fn nothing_is_lost_when_the_file_is_put_aside() {
        let folder = Folder::new("aside");
        let mut reader = Reader::new(folder.0.clone());
        let mut read = || String::from_utf8(reader.read().unwrap()).unwrap();
        assert_eq!(read(), "");
        folder.write("a");
        assert_eq!(read(), "a");
        folder.write("b");
        folder.rotate();
        folder.write("c");
        assert_eq!((read(), read(), read()), ("b".into(), "c".into(), String::new()));
        // The file was put aside twice between two reads. The last one is still there, but earlier ones may be missing.
        folder.write("d");
        folder.rotate();
        folder.write("e");
        folder.rotate();
        let gap = format!("\n{GAP}\n");
        assert_eq!((read(), read(), read(), read()), ("d".into(), gap, "e".into(), String::new()));
        folder.write("f");
        assert_eq!((read(), whole(&folder.0)), ("f".into(), b"ef".to_vec()));
    }

    /// There is a folder in the place of the file. It can be opened, but not read.
    #[tokio::test(flavor = "multi_thread")]
    async fn what_cannot_be_read_is_told_and_does_not_hide_the_others() {
        let (one, other) = (Folder::new("unreadable"), Folder::new("readable"));
        std::fs::create_dir(one.0.join(OUTPUT_FILE)).unwrap();
        other.write("other");
        let (caller, mut said) = answers();
        let programs = vec![("main/one".to_owned(), one.0.clone()), ("main/other".to_owned(), other.0.clone())];
        let mut sending = tokio::task::JoinSet::new();
        sending.spawn(all(programs, DeploymentEnd::new(None), caller));
        let mut wrote = Vec::new();
        while let Some(answer) = said.next().await {
            let Answer::Wrote { path, bytes } = answer else { panic!("{answer:?}") };
            wrote.extend(Some((path, bytes)).filter(|(_, bytes)| !bytes.is_empty()));
        }
        assert_eq!(wrote, [("main/other".to_owned(), b"other".to_vec())]);
        let why = said.end().unwrap_err();
        assert!(why.starts_with("cannot read the output of a program: Is a directory"), "{why}");
        sending.join_next().await.unwrap().unwrap();
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn all_that_was_written_before_the_end_is_sent_and_then_it_ends() {
        let (one, other) = (Folder::new("one"), Folder::new("other"));
        one.write("one");
        let living = watch::Sender::new(());
        let (caller, mut said) = answers();
        let programs = vec![("main/one".to_owned(), one.0.clone()), ("main/other".to_owned(), other.0.clone())];
        let mut sending = tokio::task::JoinSet::new();
        sending.spawn(all(programs, DeploymentEnd::new(Some(&living)), caller));
        let wrote = |path: &str, text: &str| Some(Answer::Wrote { path: path.into(), bytes: text.as_bytes().to_vec() });
        assert_eq!(said.next().await, wrote("main/one", ""));
        assert_eq!(said.next().await, wrote("main/one", "one"));
        let long = "x".repeat(CHUNK + 1);
        other.write(&long);
        drop(living);
        assert_eq!(said.next().await, wrote("main/other", &long[1..]));
        assert_eq!(said.next().await, wrote("main/other", "x"));
        assert_eq!(said.next().await, None);
        assert_eq!(said.end(), Ok(()));
        sending.join_next().await.unwrap().unwrap();
    }
}
