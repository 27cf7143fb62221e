//! The machine and zenoh without DCA: one process sends, and several listen.

use crate::raw::{open, publisher, ready};
use crate::streams::{Load, Tally, message};
use anyhow::{Context, bail, ensure};
use comms::io::clock::{Wakeup, now};
use std::io::{BufRead, BufReader, Read, Write};
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use zenoh::Wait;

/// The time in which sent values arrive, and declarations become known.
const SETTLE: Duration = Duration::from_millis(500);

/// The connection between the sender and the listeners.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Transport {
    /// A Unix socket for each listener. Blocking calls write to one after the other.
    Socket,
    /// One publisher of zenoh, like the samples of a wire. Each listener takes them in a thread.
    Zenoh,
}

impl Transport {
    fn word(self) -> &'static str {
        if self == Self::Socket { "socket" } else { "zenoh" }
    }
}

/// Runs one sender and its listeners. Returns the samples of each listener.
pub(crate) fn measure(transport: Transport, dir: &Path, load: Load) -> anyhow::Result<Vec<Tally>> {
    let path = dir.join(format!("stream-{}", transport.word()));
    let start = |side: &str| {
        let mut command = Command::new(std::env::current_exe()?);
        command.args(["stream", side, transport.word()]).arg(&path);
        for number in [load.listeners, load.size, load.count, u32::try_from(load.pause.as_micros())?] {
            command.arg(number.to_string());
        }
        let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).spawn()?;
        let mut out = BufReader::new(child.stdout.take().context("no pipe")?);
        let mut said = String::new();
        out.read_line(&mut said)?;
        ensure!(said == "ready\n", "the {side} said `{said}`");
        anyhow::Ok((child, out))
    };
    let (mut sender, mut sent) = start("send")?;
    let mut listeners = Vec::new();
    for _ in 0..load.listeners {
        listeners.push(start("listen")?);
    }
    Wakeup::default().wait(Some(now() + SETTLE));
    writeln!(sender.stdin.as_mut().context("no pipe")?, "go")?;
    let mut said = String::new();
    sent.read_line(&mut said)?;
    ensure!(said == "sent\n", "the sender said `{said}`");
    Wakeup::default().wait(Some(now() + SETTLE));
    let tallies = listeners.into_iter().map(|(child, out)| result(child, out)).collect();
    drop(sender.stdin.take());
    ensure!(sender.wait()?.success(), "the sender failed");
    if path.exists() {
        std::fs::remove_file(&path)?;
    }
    tallies
}

fn result(mut child: Child, mut out: BufReader<impl Read>) -> anyhow::Result<Tally> {
    drop(child.stdin.take());
    let mut bytes = Vec::new();
    out.read_to_end(&mut bytes)?;
    ensure!(child.wait()?.success(), "a listener failed");
    Tally::of(&bytes)
}

/// Runs one side, in a child process of the benchmark.
pub(crate) fn side(arguments: &[String]) -> anyhow::Result<()> {
    let [side, transport, path, numbers @ ..] = arguments else { bail!("a side, a transport and a path are needed") };
    let numbers = numbers.iter().map(|number| Ok(number.parse()?)).collect::<anyhow::Result<Vec<u32>>>()?;
    let [listeners, size, count, pause] = numbers[..] else { bail!("four numbers are needed") };
    let load = Load { listeners, size, count, pause: Duration::from_micros(pause.into()) };
    let path = PathBuf::from(path);
    match (side.as_str(), transport.as_str()) {
        ("send", "socket") => send_socket(&path, load),
        ("send", "zenoh") => send_zenoh(&path, load),
        ("listen", "socket") => listen_socket(&path),
        ("listen", "zenoh") => listen_zenoh(&path),
        _ => bail!("no such side or transport"),
    }
}

/// Waits for the signal to begin, then hands over each message at its time.
fn send(load: Load, mut put: impl FnMut(Vec<u8>) -> anyhow::Result<()>) -> anyhow::Result<()> {
    std::io::stdin().read_line(&mut String::new())?;
    let (began, pause) = (now(), Wakeup::default());
    for number in 1..=load.count {
        if !load.pause.is_zero() {
            pause.wait(Some(began + load.pause * number));
        }
        put(message(number.into(), now(), load.size))?;
    }
    std::io::stdout().write_all(b"sent\n")?;
    std::io::stdin().read_to_end(&mut Vec::new())?;
    Ok(())
}

fn send_socket(path: &Path, load: Load) -> anyhow::Result<()> {
    let listener = UnixListener::bind(path)?;
    ready()?;
    let accepted = (0..load.listeners).map(|_| Ok(listener.accept()?.0));
    let mut streams = accepted.collect::<std::io::Result<Vec<UnixStream>>>()?;
    send(load, |message| {
        let length = u32::try_from(message.len())?.to_le_bytes();
        let framed = [&length[..], &message].concat();
        Ok(streams.iter_mut().try_for_each(|stream| stream.write_all(&framed))?)
    })
}

fn listen_socket(path: &Path) -> anyhow::Result<()> {
    let mut stream = UnixStream::connect(path)?;
    ready()?;
    let tally: Arc<Mutex<Tally>> = Arc::default();
    let own = Arc::clone(&tally);
    // Ends with the process.
    std::thread::spawn(move || {
        let (mut length, mut bytes) = ([0; 4], Vec::new());
        while stream.read_exact(&mut length).is_ok() {
            bytes.resize(u32::from_le_bytes(length) as usize, 0);
            if stream.read_exact(&mut bytes).is_err() {
                return;
            }
            own.lock().unwrap_or_else(PoisonError::into_inner).take(&bytes, now());
        }
    });
    say(&tally)
}

fn send_zenoh(path: &Path, load: Load) -> anyhow::Result<()> {
    let session = open(Some(path), None)?;
    let failed = |error: zenoh::Error| anyhow::anyhow!("{error}");
    let publisher = publisher(&session, "raw/stream", crate::raw::Transport::ZenohShared)?;
    ready()?;
    send(load, |message| publisher.put(message).wait().map_err(failed))?;
    session.close().wait().map_err(failed)
}

fn listen_zenoh(path: &Path) -> anyhow::Result<()> {
    let session = open(None, Some(path))?;
    let failed = |error: zenoh::Error| anyhow::anyhow!("{error}");
    let samples = session.declare_subscriber("raw/stream").wait().map_err(failed)?;
    ready()?;
    let tally: Arc<Mutex<Tally>> = Arc::default();
    let own = Arc::clone(&tally);
    // Ends with the process.
    std::thread::spawn(move || {
        while let Ok(sample) = samples.recv() {
            own.lock().unwrap_or_else(PoisonError::into_inner).take(&sample.payload().to_bytes(), now());
        }
    });
    say(&tally)?;
    session.close().wait().map_err(failed)
}

/// Prints the received samples, on request.
fn say(tally: &Mutex<Tally>) -> anyhow::Result<()> {
    std::io::stdin().read_to_end(&mut Vec::new())?;
    let bytes = tally.lock().unwrap_or_else(PoisonError::into_inner).bytes();
    Ok(std::io::stdout().write_all(&bytes)?)
}
