//! The one place that starts and signals programs: each under a shim, which is told with lines and answers with lines.
//!
//! Nothing here kills on drop: a node that dies leaves its shims to their own rule, a node that lives tells them.

pub mod leftovers;

use crate::logic::child::{OUTPUT_FILE, ShimOrder, ShimReport, ShimStart};
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};
use tokio::process::{ChildStdin, ChildStdout};
use tokio::sync::mpsc::{Receiver, Sender};

/// The longest line of output that is told as a program's last words, in bytes.
const LAST_WORDS_MAX: usize = 400;

/// A started shim, seen from the node: its orders go in here.
#[derive(Debug)]
pub struct ShimOrders {
    orders: ChildStdin,
}

/// The other side of a started shim: what it says, until it ends.
#[derive(Debug)]
pub struct ShimEar {
    child: std::process::Child,
    reports: ChildStdout,
    dir: PathBuf,
}

/// Starts a shim.
///
/// # Errors
/// The shim itself cannot be started.
pub fn start(shim: &Path, start: &ShimStart) -> io::Result<(ShimOrders, ShimEar)> {
    let mut child = Command::new(shim)
        .args(start.arguments())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .env_clear()
        .spawn()?;
    let missing = || io::Error::other("a pipe to the shim is missing");
    let orders = ChildStdin::from_std(child.stdin.take().ok_or_else(missing)?)?;
    let reports = ChildStdout::from_std(child.stdout.take().ok_or_else(missing)?)?;
    Ok((ShimOrders { orders }, ShimEar { child, reports, dir: start.dir.clone() }))
}

/// Checks that a command names something that can be executed, so that a spec is refused before anything runs.
///
/// # Errors
/// It is not there, or must not be executed by this user.
pub fn check_executable(command: &[String]) -> io::Result<()> {
    let name = command.first().map_or("", String::as_str);
    let found = if name.contains('/') {
        vec![PathBuf::from(name)]
    } else {
        let path = std::env::var_os("PATH").unwrap_or_default();
        std::env::split_paths(&path).map(|folder| folder.join(name)).filter(|file| file.is_file()).collect()
    };
    let Some(file) = found.first().filter(|file| file.is_file()) else {
        return Err(io::Error::new(io::ErrorKind::NotFound, format!("there is no program `{name}`")));
    };
    if rustix::fs::access(file, rustix::fs::Access::EXEC_OK).is_err() {
        return Err(io::Error::new(
            io::ErrorKind::PermissionDenied,
            format!("`{name}` is not executable by this user"),
        ));
    }
    Ok(())
}

impl ShimOrders {
    /// Passes orders on until there are no more. A shim that is gone is told nothing; its reports say what became of it.
    ///
    /// # Cancellation
    /// The shim then counts its node as gone.
    pub async fn pass(mut self, mut orders: Receiver<ShimOrder>) {
        while let Some(order) = orders.recv().await {
            if let Err(error) = self.orders.write_all(format!("{order}\n").as_bytes()).await {
                tracing::debug!(%error, "shim does not listen");
            }
        }
    }
}

impl ShimEar {
    /// Passes every report on, with the last line of output beside an exit; the last one is always `Gone`.
    ///
    /// # Cancellation
    /// Not safe: reports are lost. Runs in a task of its own until the shim ends.
    pub async fn listen(self, sink: Sender<(ShimReport, Option<String>)>) {
        let Self { mut child, reports, dir } = self;
        let mut lines = BufReader::new(reports).lines();
        let mut gone = false;
        while let Ok(Some(line)) = lines.next_line().await {
            let Some(report) = ShimReport::parse(&line) else { continue };
            let last_words = match report {
                ShimReport::Exited { .. } | ShimReport::Signalled { .. } => {
                    let path = dir.join(OUTPUT_FILE);
                    tokio::task::spawn_blocking(move || last_line(&path)).await.unwrap_or_default()
                }
                ShimReport::Ready | ShimReport::Started { .. } | ShimReport::ExecFailed { .. } | ShimReport::Gone => {
                    None
                }
            };
            gone |= report == ShimReport::Gone;
            if sink.send((report, last_words)).await.is_err() {
                return;
            }
        }
        let reaped = tokio::task::spawn_blocking(move || {
            let reaped = child.wait();
            if !gone {
                leftovers::end_instance(&dir);
            }
            reaped
        });
        if let Ok(Err(error)) = reaped.await {
            tracing::warn!(%error, "cannot reap a shim");
        }
        if !gone {
            // Nobody is left to hear it only when the node itself is leaving.
            sink.send((ShimReport::Gone, None)).await.unwrap_or_default();
        }
    }
}

/// Returns the last line that is not blank, from the last few kilobytes of a file.
fn last_line(path: &Path) -> Option<String> {
    use std::io::{Read, Seek, SeekFrom};
    let mut file = std::fs::File::open(path).ok()?;
    let length = file.metadata().ok()?.len();
    file.seek(SeekFrom::Start(length.saturating_sub(4096))).ok()?;
    let mut tail = Vec::new();
    file.take(4096).read_to_end(&mut tail).ok()?;
    let text = String::from_utf8_lossy(&tail);
    let line = text.lines().rev().find(|line| !line.trim().is_empty())?.trim();
    Some(line.chars().take(LAST_WORDS_MAX).collect())
}
