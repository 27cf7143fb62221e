//! A program's output, sent to somebody who asked, as it grows.

use crate::logic::child::{OUTPUT_FILE, OUTPUT_FILE_OLD};
use std::io::SeekFrom;
use std::path::{Path, PathBuf};
use std::time::Duration;
use tokio::fs::File;
use tokio::io::{AsyncReadExt, AsyncSeekExt};
use tokio::sync::mpsc::Sender;

/// How often a followed file is looked at.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// How much is sent at once, and how much of old output is sent first.
const CHUNK: usize = 64 * 1024;

/// Sends the output of the program in `dir`, and with `follow` what comes, until the receiver goes away or `dir` does.
///
/// # Cancellation
/// Safe: nothing is owned but the file.
pub async fn tail(dir: PathBuf, follow: bool, sink: Sender<Vec<u8>>) {
    let path = dir.join(OUTPUT_FILE);
    if send_from(&dir.join(OUTPUT_FILE_OLD), 0, &sink).await.is_none() {
        return;
    }
    let mut at = 0;
    let mut interval = tokio::time::interval(LOOK_EVERY);
    loop {
        match send_from(&path, at, &sink).await {
            Some(end) => at = end,
            None => return,
        }
        if !follow || !dir.exists() {
            return;
        }
        tokio::select! {
            _ = interval.tick() => {}
            () = sink.closed() => return,
        }
    }
}

/// Sends a file from `at` on; returns where it ended, or none when nobody listens. A file that shrank was rotated.
async fn send_from(path: &Path, at: u64, sink: &Sender<Vec<u8>>) -> Option<u64> {
    let Ok(mut file) = File::open(path).await else { return Some(at) };
    let length = file.metadata().await.map_or(0, |meta| meta.len());
    let mut at = if length < at { 0 } else { at };
    if file.seek(SeekFrom::Start(at)).await.is_err() {
        return Some(at);
    }
    loop {
        let mut chunk = vec![0; CHUNK];
        let count = file.read(&mut chunk).await.unwrap_or(0);
        if count == 0 {
            return Some(at);
        }
        chunk.truncate(count);
        at += count as u64;
        sink.send(chunk).await.ok()?;
    }
}
