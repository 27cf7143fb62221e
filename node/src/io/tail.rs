//! A program's output, sent to somebody who asked, as it grows.
//!
//! The output is rotated while it is read: what was `out.log` becomes `out.log.1`, and a new file takes its place. So a file
//! is followed by what it is, not by its name: it is read to its end after its successor has appeared, and then the
//! successor. What two rotations have taken away meanwhile is told where it is missing.

use crate::logic::child::{OUTPUT_FILE, OUTPUT_FILE_OLD};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::fs::File;
use tokio::io::AsyncReadExt;
use tokio::sync::mpsc::Sender;

/// How often a followed file is looked at.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// How much is sent at once.
const CHUNK: usize = 64 * 1024;
/// What stands where output was rotated away before it was read.
const GAP: &[u8] = b"\n[dca: output is missing here; it was rotated away before it was read]\n";

/// An open file of output, and what names it whatever its path is.
struct Output {
    file: File,
    inode: u64,
}

/// Sends the output of the program in `dir`, and with `follow` what comes, until the receiver goes away or `dir` does.
///
/// # Cancellation
/// Safe: nothing is owned but the file.
pub async fn tail(dir: PathBuf, follow: bool, sink: Sender<Vec<u8>>) {
    let mut current = first(&dir).await;
    let mut interval = tokio::time::interval(LOOK_EVERY);
    loop {
        while let Some(output) = &mut current {
            // In this order: nothing is written to a file any more once another has its name.
            let next = successor(&dir, output.inode).await;
            if send(&mut output.file, &sink).await.is_none() {
                return;
            }
            match next {
                Next::None => break,
                Next::Is(next) => current = Some(next),
                Next::AfterGap(next) => {
                    if sink.send(GAP.to_vec()).await.is_err() {
                        return;
                    }
                    current = Some(next);
                }
            }
        }
        if !follow || !tokio::fs::try_exists(&dir).await.unwrap_or(false) {
            return;
        }
        tokio::select! {
            _ = interval.tick() => {}
            () = sink.closed() => return,
        }
        if current.is_none() {
            current = first(&dir).await;
        }
    }
}

/// What comes after a file.
enum Next {
    None,
    Is(Output),
    /// Files between the two were rotated away.
    AfterGap(Output),
}

/// Returns the oldest output that is left.
async fn first(dir: &Path) -> Option<Output> {
    match open(&dir.join(OUTPUT_FILE_OLD)).await {
        Some(old) => Some(old),
        None => open(&dir.join(OUTPUT_FILE)).await,
    }
}

/// Returns the file that was begun after the one with this inode, which is open and so shares its number with no other.
async fn successor(dir: &Path, inode: u64) -> Next {
    let (old, new) = (dir.join(OUTPUT_FILE_OLD), dir.join(OUTPUT_FILE));
    loop {
        let Some(newest) = open(&new).await else { return Next::None };
        if newest.inode == inode {
            return Next::None;
        }
        let Some(older) = open(&old).await else { return Next::AfterGap(newest) };
        if older.inode == newest.inode {
            // It was rotated between the two looks.
            continue;
        }
        return if older.inode == inode { Next::Is(newest) } else { Next::AfterGap(older) };
    }
}

async fn open(path: &Path) -> Option<Output> {
    let file = File::open(path).await.ok()?;
    let inode = file.metadata().await.ok()?.ino();
    Some(Output { file, inode })
}

/// Sends a file from where it was read to up to its end; none when nobody listens.
async fn send(file: &mut File, sink: &Sender<Vec<u8>>) -> Option<()> {
    loop {
        let mut chunk = vec![0; CHUNK];
        let count = file.read(&mut chunk).await.unwrap_or(0);
        if count == 0 {
            return Some(());
        }
        chunk.truncate(count);
        sink.send(chunk).await.ok()?;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::OpenOptions;
    use std::io::Write;
    use tokio::sync::mpsc;

    struct Log(PathBuf);

    impl Log {
        fn new(name: &str) -> Self {
            let dir = std::env::temp_dir().join(format!("dca-tail-{name}-{}", std::process::id()));
            std::fs::create_dir_all(&dir).unwrap();
            Self(dir)
        }
        fn write(&self, text: &str) {
            let file = OpenOptions::new().create(true).append(true).open(self.0.join(OUTPUT_FILE));
            file.unwrap().write_all(text.as_bytes()).unwrap();
        }
        fn rotate(&self) {
            std::fs::rename(self.0.join(OUTPUT_FILE), self.0.join(OUTPUT_FILE_OLD)).unwrap();
        }
    }

    /// Reads until `wanted` has come.
    async fn read(heard: &mut mpsc::Receiver<Vec<u8>>, wanted: &str) -> String {
        let mut text = String::new();
        while !text.ends_with(wanted) {
            text += &String::from_utf8(heard.recv().await.unwrap()).unwrap();
        }
        text
    }

    /// What is written between the last look and the rotation is not lost, nor what the new file has by the next look.
    #[tokio::test]
    async fn nothing_is_lost_at_a_rotation() {
        let log = Log::new("rotation");
        let (sink, mut heard) = mpsc::channel(64);
        log.write("one\n");
        let tailing = async {
            assert_eq!(read(&mut heard, "one\n").await, "one\n");
            log.write("two\n");
            log.rotate();
            log.write("three is longer than everything before it\n");
            assert_eq!(read(&mut heard, "it\n").await, "two\nthree is longer than everything before it\n");
            for round in 0..20 {
                log.write(&format!("{round} before\n"));
                log.rotate();
                log.write(&format!("{round} behind\n"));
                let expected = format!("{round} before\n{round} behind\n");
                assert_eq!(read(&mut heard, "behind\n").await, expected);
            }
            std::fs::remove_dir_all(&log.0).unwrap();
        };
        tokio::join!(tail(log.0.clone(), true, sink), tailing);
    }

    #[tokio::test]
    async fn what_was_rotated_away_is_told() {
        let log = Log::new("gap");
        let (sink, mut heard) = mpsc::channel(64);
        log.write("one\n");
        let tailing = async {
            assert_eq!(read(&mut heard, "one\n").await, "one\n");
            for text in ["two\n", "three\n", "four\n"] {
                log.rotate();
                log.write(text);
            }
            let expected = format!("{}three\nfour\n", String::from_utf8_lossy(GAP));
            assert_eq!(read(&mut heard, "four\n").await, expected);
            std::fs::remove_dir_all(&log.0).unwrap();
        };
        tokio::join!(tail(log.0.clone(), true, sink), tailing);
    }
}
