//! The reader of a command's endless output.

use crate::output;
use node::console;
use rustix::event::{PollFd, PollFlags, poll};
use rustix::io::Errno;
use std::future::poll_fn;
use std::io;
use std::task::Poll;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::oneshot;

/// The signals with which a person ends the command.
#[derive(Debug)]
pub(crate) struct Leave(Vec<Signal>);

impl Leave {
    /// Handles Ctrl-C and SIGTERM from now on.
    ///
    /// # Errors
    /// The system does not allow it to handle signals.
    pub(crate) fn new() -> io::Result<Self> {
        Self::by(&[SignalKind::interrupt(), SignalKind::terminate()])
    }

    /// Handles all signals with which a terminal or a user ends a program. A program that draws has to restore the
    /// terminal before it ends. Other commands do not handle SIGHUP, because `nohup` ignores it.
    ///
    /// # Errors
    /// The system does not allow it to handle signals.
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

/// A person at a terminal, or a program that reads from a pipe.
#[derive(Debug)]
pub(crate) struct Reader {
    leave: Leave,
    /// Receives a message when standard output has no reader any more.
    hung_up: oneshot::Receiver<()>,
}

impl Reader {
    /// Watches the reader from now on.
    ///
    /// # Errors
    /// The system does not allow it to handle signals, or to start a thread.
    pub(crate) fn new() -> io::Result<Self> {
        let leave = Leave::new()?;
        let (hung_up_tx, hung_up) = oneshot::channel();
        // The thread ends with the process, or when the reader has gone.
        std::thread::Builder::new().name("dca-reader".to_owned()).spawn(|| wait_for_hang_up(hung_up_tx))?;
        Ok(Self { leave, hung_up })
    }

    /// Waits until the reader has gone: it has ended the command by Ctrl-C or SIGTERM, has closed the pipe, or a write has failed.
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

/// Blocks until the other end of standard output is closed. If standard output is a file, it has no other end.
fn wait_for_hang_up(hung_up: oneshot::Sender<()>) {
    loop {
        // The system reports errors and the end even if no event is requested. Source: poll(2).
        match poll(&mut [PollFd::new(&output::results(), PollFlags::empty())], None) {
            Ok(0) | Err(Errno::INTR) => {}
            // The task that waits for this may have ended.
            Ok(_) => return hung_up.send(()).unwrap_or_default(),
            // The end cannot be watched. The next write then fails.
            Err(_) => std::thread::park(),
        }
    }
}
