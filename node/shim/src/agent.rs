//! The agents of a shim, one after the other: orders in, reports out, counted over all of them.
//!
//! The agent that starts the shim has its standard input and output. Once that is gone, the next one attaches at a
//! socket (`shim::protocol` has the lines). One thread reads all of them, each to its end before the next, so that
//! orders of two agents never mix. Every report is kept, for an agent that does not have it: a shim makes five at the
//! most.

use crate::{Event, complain, print};
use comms::io::clock::{Wakeup, now};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use shim::protocol::{AttachReply, AttachRequest, LINE_MAX, SOCKET_FILE, ShimOrder, ShimReport};
use std::fs::Permissions;
use std::io::{self, BufRead, BufReader, Read, Write};
use std::net::Shutdown;
use std::os::fd::AsFd;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{SendError, SyncSender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// How long an agent that has connected may take to send its request: others wait behind it.
const REQUEST_WITHIN: Duration = Duration::from_secs(1);
/// How long an agent without room for a report may keep this shim waiting.
const WRITE_WITHIN: Duration = Duration::from_secs(1);
/// Until the next try when the kernel has no descriptor for a connection.
const ACCEPT_AGAIN: Duration = Duration::from_millis(100);

/// The agent that gives this shim its orders.
pub(crate) struct Agent {
    reports: Arc<Mutex<Reports>>,
    socket: PathBuf,
}

/// The reports up to now, and the connection that gets the next ones.
struct Reports {
    made: Vec<String>,
    /// How many of them were sent to an agent.
    told: usize,
    /// The agent that attached last; at first the agent that started this shim.
    attached: Option<UnixStream>,
}

/// Whether the agent that started this shim is already gone, regardless of its orders.
pub(crate) fn is_lost() -> bool {
    let stdin = io::stdin();
    let mut input = [PollFd::from_borrowed_fd(stdin.as_fd(), PollFlags::empty())];
    poll(&mut input, Some(&Timespec::default())).is_ok_and(|_| input[0].revents().contains(PollFlags::HUP))
}

impl Agent {
    /// Returns the agent that has started this shim for the instance in `dir`.
    pub(crate) fn new(dir: &Path) -> Self {
        let reports = Reports { made: Vec::new(), told: 0, attached: None };
        Self { reports: Arc::new(Mutex::new(reports)), socket: dir.join(SOCKET_FILE) }
    }

    /// Starts to take orders, and lets others attach once the agent is gone.
    pub(crate) fn listen(&self, events: SyncSender<Event>) -> io::Result<()> {
        match std::fs::remove_file(&self.socket) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let listener = UnixListener::bind(&self.socket)?;
        std::fs::set_permissions(&self.socket, Permissions::from_mode(0o700))?;
        let reports = Arc::clone(&self.reports);
        let reader = Reader { reports, events, taken: 0 };
        std::thread::Builder::new().name("agent".into()).spawn(move || reader.run(&listener)).map(drop)
    }

    /// Reports to the agent. Returns whether there is an agent. A lost agent does not get this
    /// report. The next agent asks for it, or reads the record of the end.
    pub(crate) fn report(&self, report: &ShimReport) -> bool {
        let mut reports = lock(&self.reports);
        let line = format!("{report}\n");
        let is_heard = match &mut reports.attached {
            Some(stream) => {
                let is_written = stream.write_all(line.as_bytes()).is_ok();
                if !is_written {
                    // The agent may have half a line, and nothing may follow that.
                    stream.shutdown(Shutdown::Both).unwrap_or_default();
                }
                is_written
            }
            None => print(&line).is_ok(),
        };
        reports.made.push(line);
        if is_heard {
            reports.told = reports.made.len();
        }
        is_heard
    }

    /// Returns whether every report was sent to an agent.
    pub(crate) fn is_told(&self) -> bool {
        let reports = lock(&self.reports);
        reports.told == reports.made.len()
    }

    /// Makes the last report. The socket goes before it, because the folder may be another shim's right after.
    pub(crate) fn leave(&self) {
        std::fs::remove_file(&self.socket).unwrap_or_default();
        self.report(&ShimReport::Gone);
    }
}

/// The thread that reads the orders of agents.
struct Reader {
    reports: Arc<Mutex<Reports>>,
    events: SyncSender<Event>,
    /// How many orders were taken.
    taken: u64,
}

impl Reader {
    fn run(mut self, listener: &UnixListener) {
        let mut heard = self.hear(&mut io::stdin().lock());
        let pause = Wakeup::default();
        while heard.is_ok() {
            match listener.accept() {
                Ok((stream, _)) => heard = self.serve(&stream),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => {
                    complain(&format!("dca-shim: cannot accept an agent: {error}"));
                    pause.wait(Some(now() + ACCEPT_AGAIN));
                }
            }
        }
    }

    /// Serves one connection to its end. A connection that does not come from an agent is only closed.
    fn serve(&mut self, stream: &UnixStream) -> Result<(), SendError<Event>> {
        let mut lines = BufReader::new(stream);
        let limited = stream.set_read_timeout(Some(REQUEST_WITHIN));
        if limited.and_then(|()| stream.set_write_timeout(Some(WRITE_WITHIN))).is_err() {
            return Ok(());
        }
        let Some(request) = next_line(&mut lines).and_then(|line| AttachRequest::parse(&line)) else {
            complain("dca-shim: closing a connection that does not come from an agent");
            return Ok(());
        };
        let had = usize::try_from(request.reports).unwrap_or(usize::MAX);
        if had > lock(&self.reports).made.len() {
            complain(&format!("dca-shim: an agent that has {had} reports means another shim"));
            return Ok(());
        }
        // Before the reply: an agent that has the reply may rely on the program not being ended by a deadline. The
        // lock is not held here, because the thread that takes events may wait for it.
        self.events.send(Event::Attached)?;
        if self.attach(stream, had).is_ok() {
            return self.hear(&mut lines);
        }
        self.events.send(Event::AgentGone)
    }

    /// Answers the agent, and sends every later report to it.
    fn attach(&self, stream: &UnixStream, had: usize) -> io::Result<()> {
        let copy = stream.try_clone()?;
        stream.set_read_timeout(None)?;
        let mut reports = lock(&self.reports);
        let reply = AttachReply { orders: self.taken };
        let missing: String = reports.made.iter().skip(had).map(String::as_str).collect();
        (&copy).write_all(format!("{reply}\n{missing}").as_bytes())?;
        reports.attached = Some(copy);
        reports.told = reports.made.len();
        Ok(())
    }

    /// Takes orders until the agent is gone.
    fn hear(&mut self, lines: &mut impl BufRead) -> Result<(), SendError<Event>> {
        while let Some(line) = next_line(lines) {
            let Some(order) = ShimOrder::parse(&line) else {
                complain(&format!("dca-shim: `{line}` is not an order"));
                continue;
            };
            self.taken += 1;
            self.events.send(Event::Order(order))?;
        }
        self.events.send(Event::AgentGone)
    }
}

/// Returns the next line; none while it is incomplete. Half an order is not an order: `stop 5` may have begun as
/// `stop 5000`.
fn next_line(lines: &mut impl BufRead) -> Option<String> {
    let mut line = String::new();
    lines.take(LINE_MAX).read_line(&mut line).ok()?;
    line.strip_suffix('\n').map(str::to_owned)
}

fn lock(reports: &Mutex<Reports>) -> MutexGuard<'_, Reports> {
    // Nothing in a critical section of this file can panic.
    reports.lock().unwrap_or_else(PoisonError::into_inner)
}
