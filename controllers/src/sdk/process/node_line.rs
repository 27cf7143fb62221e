//! The program's connection to its node, which outlives every channel. If a node was killed and restarted, the program
//! looks for it and sends it the messages that it has missed.
//!
//! Both sides count the messages that they have sent and taken since the program's start. Invariant: an order that was
//! taken is obeyed and counted before the next one is taken, and a notice is stored before it is sent. So when a
//! channel breaks, each sender repeats the messages in transit, and none is delivered twice.

use comms::io::clock::{Wakeup, now};
use comms::io::control::{self, ControlError, NoticeSender, OrderReceiver, Received};
use comms::logic::codec::WIRE_VERSION;
use comms::logic::control::{Notice, Order};
use std::collections::VecDeque;
use std::os::unix::process::parent_id;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use thiserror::Error;

/// The time limit for the first node to accept the connection.
const CONNECT_WITHIN: Duration = Duration::from_secs(10);
/// How long a starting program looks for its node.
const FIRST_WITHIN: Duration = Duration::from_secs(60);
/// The delay before a lost node is first looked for; each further delay is twice as long.
const DIAL_FIRST: Duration = Duration::from_millis(5);
/// The longest pause between two attempts. A node also has this long to accept the connection.
const DIAL_EVERY: Duration = Duration::from_millis(100);
/// The time limit for an answer of a node. After this time the program dials again: the node may be suspended, or
/// replaced by another node.
const ANSWER_WITHIN: Duration = Duration::from_secs(10);
/// The largest number of stored notices: 144 about messages of an activity, and room for others.
const KEPT_MAX: usize = 256;
/// The least size of the newest notices that are stored, in bytes. The notice in which this size begins is also stored.
const KEPT_SIZE: usize = 4 << 20;

/// Why no more orders arrive.
#[derive(Debug, Error)]
pub(super) enum LineError {
    #[error("the node is gone")]
    Gone,
    #[error("the node cannot be understood: {0}")]
    NotUnderstood(ControlError),
    #[error("the node has {has} notices of this program, which has made {made} and still has the last {kept}")]
    Missed { has: u64, made: u64, kept: usize },
}

/// Why an attempt did not find a node.
#[derive(Debug, Error)]
enum NotFound {
    #[error("{0}")]
    Control(#[from] ControlError),
    #[error("it closed the channel")]
    Closed,
    #[error("it does not answer")]
    Silent,
    #[error("it gave another order before its answer")]
    OutOfTurn,
    #[error("{0}")]
    Line(#[from] LineError),
}

/// Sends notices to the present node, and stores them for the next one. Clones share one log.
#[derive(Clone, Debug)]
pub(super) struct NoticeLog {
    log: Arc<Mutex<Log>>,
}

#[derive(Debug)]
struct Log {
    kept: Kept,
    /// The channel to the node; none without a node.
    channel: Option<NoticeSender>,
    /// The number of earlier channels.
    channels: u64,
}

/// The newest notices, as encoded frames.
#[derive(Debug, Default)]
struct Kept {
    /// The number of notices since the program's start.
    made: u64,
    frames: VecDeque<Vec<u8>>,
    /// The size of all frames, in bytes.
    size: usize,
}

/// Receives orders from the present node.
#[derive(Debug)]
pub(super) struct NodeLine {
    socket: PathBuf,
    instance: String,
    /// The process that started this one.
    parent: u32,
    receiver: OrderReceiver,
    /// The number of counted orders that were taken since the program's start.
    orders: u64,
    notices: NoticeLog,
}

/// Dials the node that has started this program as `instance`; `parent` is the process that did this for the node. If
/// the node was killed in the meantime, waits for it.
///
/// # Errors
/// If no node listens on `socket` for a minute, or none listens and the parent is gone.
pub(super) fn connect(socket: &Path, instance: &str, parent: u32) -> Result<(NoticeLog, NodeLine), ControlError> {
    let (until, pause, mut wait) = (now() + FIRST_WITHIN, Wakeup::default(), DIAL_FIRST);
    let (sender, receiver) = loop {
        match control::connect(socket, CONNECT_WITHIN) {
            Err(error @ ControlError::Connect { .. }) if now() < until && parent_id() == parent => {
                tracing::debug!(%error, "the node is looked for");
                pause.wait(Some(now() + wait));
                wait = (2 * wait).min(DIAL_EVERY);
            }
            connected => break connected?,
        }
    };
    let notices = NoticeLog::new(sender);
    let (socket, instance) = (socket.to_owned(), instance.to_owned());
    let line = NodeLine { socket, instance, parent, receiver, orders: 0, notices: notices.clone() };
    Ok((notices, line))
}

impl NoticeLog {
    pub(super) fn new(sender: NoticeSender) -> Self {
        Self { log: Arc::new(Mutex::new(Log { kept: Kept::default(), channel: Some(sender), channels: 0 })) }
    }

    /// Sends a notice, now or once there is a node; never waits.
    ///
    /// # Errors
    /// If the notice is too long. The notice is then not counted.
    pub(super) fn send(&self, notice: &Notice) -> Result<(), ControlError> {
        let frame = control::notice_frame(notice)?;
        let mut log = self.lock();
        log.kept.push(frame.clone());
        if let Some(channel) = &log.channel
            && let Err(error) = channel.send_frame(frame)
        {
            // The end of the channel reaches the reader of orders, which looks for a node that reads.
            tracing::info!(%error, "the node does not take notices");
            channel.close();
            log.channel = None;
        }
        Ok(())
    }

    /// Sends a notice over the present channel only, and does not store it; never waits. Returns the number of the
    /// channel, or none without a node.
    ///
    /// # Errors
    /// If the notice is too long.
    pub(super) fn send_now(&self, notice: &Notice) -> Result<Option<u64>, ControlError> {
        let frame = control::notice_frame(notice)?;
        let mut log = self.lock();
        let Some(channel) = &log.channel else { return Ok(None) };
        if let Err(error) = channel.send_frame(frame) {
            tracing::info!(%error, "the node does not take requests");
            channel.close();
            log.channel = None;
            return Ok(None);
        }
        Ok(Some(log.channels))
    }

    /// Sends the notice, if there is one; without a node it is lost.
    pub(super) fn tell(&self, notice: Option<Notice>) {
        notice.into_iter().for_each(|notice| drop(self.send_now(&notice)));
    }

    /// Returns the number of the present channel, or of the next one if there is none.
    pub(super) fn channel(&self) -> u64 {
        let log = self.lock();
        log.channels + u64::from(log.channel.is_none())
    }

    /// Waits until all notices have been sent to the node, at most for 2 s. Without a node, does not wait.
    pub(super) fn flush(&self) {
        let channel = self.lock().channel.clone();
        if let Some(channel) = channel {
            channel.flush();
        }
    }

    /// Returns the number of notices since the program's start.
    fn made(&self) -> u64 {
        self.lock().kept.made
    }

    fn detach(&self) {
        self.lock().channel = None;
    }

    /// Continues with a node that already has `has` notices.
    fn attach(&self, channel: NoticeSender, has: u64) -> Result<(), NotFound> {
        let mut log = self.lock();
        let Some(missed) = log.kept.after(has) else {
            let (made, kept) = (log.kept.made, log.kept.frames.len());
            return Err(LineError::Missed { has, made, kept }.into());
        };
        for frame in missed {
            channel.send_frame(frame.clone())?;
        }
        log.channel = Some(channel);
        log.channels += 1;
        Ok(())
    }

    fn lock(&self) -> MutexGuard<'_, Log> {
        self.log.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Kept {
    fn push(&mut self, frame: Vec<u8>) {
        self.made += 1;
        self.size += frame.len();
        self.frames.push_back(frame);
        while let Some(oldest) = self.frames.front()
            && (self.frames.len() > KEPT_MAX || self.size - oldest.len() >= KEPT_SIZE)
            && self.frames.len() > 1
        {
            self.size -= oldest.len();
            self.frames.pop_front();
        }
    }

    /// Returns the notices after number `has`, the oldest first; none if some of them are not stored any more, or
    /// number `has` was never sent.
    fn after(&self, has: u64) -> Option<impl Iterator<Item = &Vec<u8>>> {
        let missing = usize::try_from(self.made.checked_sub(has)?).ok()?;
        let first = self.frames.len().checked_sub(missing)?;
        Some(self.frames.range(first..))
    }
}

impl NodeLine {
    /// Waits for the next order, even if the node is away for a long time. [`Order::Resumed`] shows
    /// that found a node again.
    ///
    /// # Errors
    /// If the node and the program's parent are gone, or a message of the node cannot be understood.
    pub(super) fn next(&mut self) -> Result<Order, LineError> {
        loop {
            match self.receiver.recv() {
                // No question belongs to this answer.
                Ok(Some(Order::Resumed { .. })) => continue,
                Ok(Some(order)) => {
                    self.orders += u64::from(order.is_counted());
                    return Ok(order);
                }
                Ok(None) => tracing::info!("the node is gone: looking for a node"),
                Err(ControlError::Broken(error)) => tracing::info!(%error, "the node is lost: looking for a node"),
                Err(error) => return Err(LineError::NotUnderstood(error)),
            }
            let notices = self.find_node()?;
            tracing::info!("found a node again");
            return Ok(Order::Resumed { notices });
        }
    }

    /// Looks for a node, and returns how many notices it has.
    fn find_node(&mut self) -> Result<u64, LineError> {
        self.notices.detach();
        let (pause, mut wait) = (Wakeup::default(), DIAL_FIRST);
        loop {
            pause.wait(Some(now() + wait));
            wait = (2 * wait).min(DIAL_EVERY);
            self.check_parent()?;
            match self.resume() {
                Ok(notices) => return Ok(notices),
                Err(NotFound::Line(error)) => return Err(error),
                Err(error) => tracing::debug!(%error, "no node was found"),
            }
        }
    }

    fn resume(&mut self) -> Result<u64, NotFound> {
        let (sender, mut receiver) = control::connect(&self.socket, DIAL_EVERY)?;
        let (instance, orders, notices) = (self.instance.clone(), self.orders, self.notices.made());
        sender.send(&Notice::Resume { version: WIRE_VERSION, instance, orders, notices })?;
        let until = now() + ANSWER_WITHIN;
        while now() < until {
            match receiver.recv_until(Some(now() + DIAL_EVERY))? {
                Received::Order(Order::Resumed { notices }) => {
                    self.notices.attach(sender, notices)?;
                    self.receiver = receiver;
                    return Ok(notices);
                }
                Received::Order(_) => return Err(NotFound::OutOfTurn),
                Received::Ended => return Err(NotFound::Closed),
                Received::Nothing => self.check_parent()?,
            }
        }
        Err(NotFound::Silent)
    }

    /// Checks whether the parent lives: without node and parent, nothing would ever end this program.
    fn check_parent(&self) -> Result<(), LineError> {
        if parent_id() == self.parent { Ok(()) } else { Err(LineError::Gone) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    /// Pushes frames of these sizes; returns the stored frames.
    fn kept(sizes: impl IntoIterator<Item = usize>) -> Kept {
        let mut kept = Kept::default();
        sizes.into_iter().for_each(|size| kept.push(vec![0; size]));
        assert_eq!(kept.size, kept.frames.iter().map(Vec::len).sum::<usize>());
        kept
    }

    #[test]
    fn the_newest_notices_are_kept() {
        let numbers = |kept: &Kept| kept.frames.iter().map(Vec::len).collect::<Vec<_>>();
        assert_eq!(numbers(&kept([])), Vec::<usize>::new());
        assert_eq!(numbers(&kept(1..=300)), (45..=300).collect::<Vec<_>>());
        // A large frame stays until the frames after it have reached the whole allowance.
        assert_eq!(numbers(&kept([7, KEPT_SIZE, 9])), vec![KEPT_SIZE, 9]);
        assert_eq!(numbers(&kept([3 * KEPT_SIZE, KEPT_SIZE - 1])), vec![3 * KEPT_SIZE, KEPT_SIZE - 1]);
        assert_eq!(numbers(&kept([3 * KEPT_SIZE, KEPT_SIZE - 1, 1])), vec![KEPT_SIZE - 1, 1]);
        assert_eq!(numbers(&kept([7, 3 * KEPT_SIZE])), vec![3 * KEPT_SIZE]);
    }

    #[test]
    fn what_was_missed_is_all_there_or_nothing_is() {
        let kept = kept(1..=300);
        let after = |has| kept.after(has).map(|missed| missed.map(Vec::len).collect::<Vec<_>>());
        let cases: BTreeMap<u64, Option<Vec<usize>>> = BTreeMap::from([
            (0, None),
            (43, None),
            (44, Some((45..=300).collect())),
            (298, Some(vec![299, 300])),
            (300, Some(vec![])),
            (301, None),
            (u64::MAX, None),
        ]);
        for (has, missed) in cases {
            assert_eq!(after(has), missed, "{has}");
        }
    }
}
