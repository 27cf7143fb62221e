//! The last messages of a channel, for clients that come later.

use std::collections::VecDeque;
use std::time::Duration;

/// How many of the last events, and how many lines of output, a client gets that comes later.
pub(super) const KEPT_MAX: usize = 200;
/// The most bytes of them.
const KEPT_SIZE_MAX: usize = 1 << 20;

/// A message that is kept for clients that come later.
#[derive(Debug)]
pub(super) struct Kept {
    pub(super) at: Duration,
    pub(super) payload: Vec<u8>,
}

/// A channel whose last messages are kept.
#[derive(Debug)]
pub(super) struct Lasting {
    pub(super) channel: Option<u32>,
    pub(super) kept: VecDeque<Kept>,
    size: usize,
}

impl Lasting {
    pub(super) fn new(channel: Option<u32>) -> Self {
        Self { channel, kept: VecDeque::new(), size: 0 }
    }

    pub(super) fn keep(&mut self, at: Duration, payload: &[u8]) {
        self.size += payload.len();
        self.kept.push_back(Kept { at, payload: payload.to_vec() });
        while self.kept.len() > KEPT_MAX || self.size > KEPT_SIZE_MAX {
            let Some(oldest) = self.kept.pop_front() else { return };
            self.size -= oldest.payload.len();
        }
    }

    /// Forgets all messages.
    pub(super) fn clear(&mut self) {
        (self.kept, self.size) = (VecDeque::new(), 0);
    }
}
