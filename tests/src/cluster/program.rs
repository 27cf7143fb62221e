//! A started command: its output so far, its end, and signals to it.

use comms::io::clock::now;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::process::{Pid, PidfdFlags, Signal, kill_process, pidfd_open};
use std::fmt;
use std::io::Read;
use std::os::fd::OwnedFd;
use std::os::unix::process::ExitStatusExt;
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// A stream of a program's output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stream {
    /// Standard output: results.
    Out,
    /// Standard error: everything else.
    Err,
}

/// A started command. Dropping it kills it if it still runs.
#[derive(Debug)]
pub struct Program {
    name: String,
    child: Child,
    pidfd: OwnedFd,
    out: Captured,
    err: Captured,
}

/// How a command ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Ended {
    /// The exit code; none if a signal ended the command.
    pub code: Option<i32>,
    /// The signal that ended it.
    pub signal: Option<i32>,
    /// All text on the standard output.
    pub out: String,
    /// All text on the standard error.
    pub err: String,
}

impl fmt::Display for Ended {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { code, signal, out, err } = self;
        write!(f, "exit code {code:?}, signal {signal:?}\n--- standard output\n{out}--- standard error\n{err}---")
    }
}

/// The bytes that a thread has read from a pipe so far.
#[derive(Debug)]
struct Captured {
    text: Arc<Text>,
    reader: Option<JoinHandle<()>>,
}

#[derive(Debug, Default)]
struct Text {
    so_far: Mutex<(Vec<u8>, bool)>,
    changed: Condvar,
}

impl Text {
    fn lock(&self) -> MutexGuard<'_, (Vec<u8>, bool)> {
        self.so_far.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Captured {
    fn start(mut pipe: impl Read + Send + 'static) -> Self {
        let text = Arc::new(Text::default());
        let filled = Arc::clone(&text);
        let reader = std::thread::spawn(move || {
            let mut chunk = [0; 4096];
            loop {
                let size = pipe.read(&mut chunk).unwrap_or(0);
                let mut so_far = filled.lock();
                so_far.0.extend(&chunk[..size]);
                so_far.1 = size == 0;
                filled.changed.notify_all();
                if size == 0 {
                    return;
                }
            }
        });
        Self { text, reader: Some(reader) }
    }

    fn text(&self) -> String {
        String::from_utf8_lossy(&self.text.lock().0).into_owned()
    }

    /// Waits until the text contains `wanted` this many times, and returns whether it does.
    fn wait_for(&self, wanted: &str, times: usize, within: Duration) -> bool {
        let has = |text: &[u8]| String::from_utf8_lossy(text).matches(wanted).count() >= times;
        let goes_on = |state: &mut (Vec<u8>, bool)| !state.1 && !has(&state.0);
        let waited = self.text.changed.wait_timeout_while(self.text.lock(), within, goes_on);
        has(&waited.unwrap_or_else(PoisonError::into_inner).0.0)
    }

    fn finish(&mut self) -> String {
        if let Some(reader) = self.reader.take() {
            reader.join().expect("reading a pipe does not panic");
        }
        self.text()
    }
}

impl Program {
    /// Starts a command.
    ///
    /// # Panics
    /// Panics if the command cannot be started.
    pub(super) fn start(command: Command) -> Self {
        Self::start_given(command, Stdio::null())
    }

    /// Starts a command with a standard input.
    ///
    /// # Panics
    /// Panics if the command cannot be started.
    pub(super) fn start_given(mut command: Command, input: Stdio) -> Self {
        let name = format!("{command:?}");
        command.stdin(input).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap_or_else(|error| panic!("{name}: {error}"));
        let out = Captured::start(child.stdout.take().expect("the pipe was asked for"));
        let err = Captured::start(child.stderr.take().expect("the pipe was asked for"));
        let pidfd =
            pidfd_open(Pid::from_child(&child), PidfdFlags::empty()).expect("a child that was not reaped is there");
        Self { name, child, pidfd, out, err }
    }

    /// Returns the process id.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Sends a signal to the command.
    ///
    /// # Panics
    /// Panics if the kernel refuses.
    pub fn signal(&self, signal: Signal) {
        kill_process(Pid::from_child(&self.child), signal).expect("a child may be signalled until it is reaped");
    }

    /// Kills the command and waits until it is gone, so that its locks are free for a successor.
    ///
    /// # Panics
    /// Panics if the kernel refuses, or if this takes more than a minute.
    #[track_caller]
    pub fn kill(&self) {
        self.signal(Signal::KILL);
        assert!(self.has_ended(Duration::from_secs(60)), "{} was killed and is still there", self.name);
    }

    /// Returns the output so far.
    pub fn text(&self, stream: Stream) -> String {
        self.stream(stream).text()
    }

    /// Waits until the command has written `wanted`.
    ///
    /// # Panics
    /// Panics if the command does not write it within `within`, or ends without it.
    #[track_caller]
    pub fn wait_for(&self, stream: Stream, wanted: &str, within: Duration) {
        self.wait_for_times(stream, wanted, 1, within);
    }

    /// Waits until the command has written `wanted` this many times.
    ///
    /// # Panics
    /// Panics like [`Program::wait_for`].
    #[track_caller]
    pub fn wait_for_times(&self, stream: Stream, wanted: &str, times: usize, within: Duration) {
        let found = self.stream(stream).wait_for(wanted, times, within);
        let (name, out, err) = (&self.name, self.out.text(), self.err.text());
        assert!(found, "{name} did not write `{wanted}` {times} times within {within:?}\n{out}---\n{err}---");
    }

    /// Returns whether the command still runs.
    pub fn is_running(&self) -> bool {
        !self.has_ended(Duration::ZERO)
    }

    /// Waits for the end of the command.
    ///
    /// # Panics
    /// Panics if the command still runs after `within`.
    #[track_caller]
    pub fn ended(mut self, within: Duration) -> Ended {
        if !self.has_ended(within) {
            panic!("{} still runs after {within:?}\n{}---\n{}---", self.name, self.out.text(), self.err.text());
        }
        let status = self.child.wait().expect("a child can be waited for once");
        Ended { code: status.code(), signal: status.signal(), out: self.out.finish(), err: self.err.finish() }
    }

    fn has_ended(&self, within: Duration) -> bool {
        let deadline = now() + within;
        loop {
            let left = deadline.since(now());
            let timeout = Timespec::try_from(left).expect("a test waits for minutes at the most");
            match poll(&mut [PollFd::new(&self.pidfd, PollFlags::IN)], Some(&timeout)) {
                Ok(0) if left.is_zero() => return false,
                Ok(0) | Err(rustix::io::Errno::INTR) => {}
                Ok(_) => return true,
                Err(error) => panic!("{}: {error}", self.name),
            }
        }
    }

    fn stream(&self, stream: Stream) -> &Captured {
        match stream {
            Stream::Out => &self.out,
            Stream::Err => &self.err,
        }
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        if self.is_running() {
            self.child.kill().unwrap_or_default();
        }
        // The test did not wait for the command, so its exit status does not matter.
        drop(self.child.wait());
    }
}
