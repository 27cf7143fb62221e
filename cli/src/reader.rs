//! The reader of an endless command's output.

use crate::output;
use node::console;
use rustix::event::{PollFd, PollFlags, poll};
use rustix::io::Errno;
use std::future::poll_fn;
use std::io;
use std::task::Poll;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::oneshot;

/// A person who may end the command, by a signal.
#[derive(Debug)]
pub(crate) struct Leave(Vec<Signal>);

impl Leave {
    /// Takes over Ctrl-C and SIGTERM from now on.
    ///
    /// # Errors
    /// The system gives no signals.
    pub(crate) fn new() -> io::Result<Self> {
        Self::by(&[SignalKind::interrupt(), SignalKind::terminate()])
    }

    /// Takes over all signals by which a terminal or a user ends a program. A program that draws gives the terminal back before it
    /// ends. Other commands do not take over SIGHUP, because `nohup` ignores it.
    ///
    /// # Errors
    /// The system gives no signals.
    pub(crate) fn of_terminal() -> io::Result<Self> {
        Self::by(&[SignalKind::interrupt(), SignalKind::terminate(), SignalKind::hangup(), SignalKind::quit()])
    }

    fn by(kinds: &[SignalKind]) -> io::Result<Self> {
        kinds.iter().map(|kind| signal(*kind)).collect::<io::Result<_>>().map(Self)
    }

    /// Waits until the command is asked to end.
    ///
    /// # Cancellation
    /// Safe.
    pub(crate) async fn asked(&mut self) {
        poll_fn(|context| {
            let is_asked = self.0.iter_mut().any(|signal| signal.poll_recv(context).is_ready());
            if is_asked { Poll::Ready(()) } else { Poll::Pending }
        })
        .await;
    }
}

/// A person at a terminal, or a program at the other end of a pipe.
#[derive(Debug)]
pub(crate) struct Reader {
    leave: Leave,
    /// Gets a message once standard output has no reader any more.
    hung_up: oneshot::Receiver<()>,
}

impl Reader {
    /// Watches the reader from now on.
    ///
    /// # Errors
    /// The system gives no signals, or no thread.
    pub(crate) fn new() -> io::Result<Self> {
        let leave = Leave::new()?;
        let (hung_up_tx, hung_up) = oneshot::channel();
        // The thread ends with the process, or with the reader.
        std::thread::Builder::new().name("dca-reader".to_owned()).spawn(|| wait_for_hang_up(hung_up_tx))?;
        Ok(Self { leave, hung_up })
    }

    /// Waits until the reader has ended the command, by Ctrl-C or SIGTERM, reads it no more, or cannot be told anything.
    ///
    /// # Cancellation
    /// Safe.
    pub(crate) async fn left(&mut self) {
        tokio::select! {
            () = self.leave.asked() => {}
            Ok(()) = &mut self.hung_up => {}
            () = console::write_failed() => {}
        }
    }
}

/// Blocks until the other end of standard output is closed. A file has no other end.
fn wait_for_hang_up(hung_up: oneshot::Sender<()>) {
    loop {
        // Errors and the end are reported for any requested events. Source: poll(2).
        match poll(&mut [PollFd::new(&output::results(), PollFlags::empty())], None) {
            Ok(0) | Err(Errno::INTR) => {}
            // The waiting task may have ended.
            Ok(_) => return hung_up.send(()).unwrap_or_default(),
            // It cannot look; the next word that is written fails.
            Err(_) => std::thread::park(),
        }
    }
}
