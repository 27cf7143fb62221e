//! How many bytes a stream may have in transit to its caller.

use crate::logic::pace::Pace;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

/// How many bytes of answers may be in transit to one session, over all its streams. The buffers of a link to a suspended
/// program hold this many, so other messages through the same nodes are not blocked. Source: the 208 KiB that Linux gives a
/// Unix socket (`net.core.wmem_default`), less a part for other messages.
const ON_THE_WAY_MAX: usize = 128 << 10;
/// The fewest bytes that a stream asks for.
const PIECE_SIZE_MIN: usize = 1 << 10;

/// The window of one stream: the most bytes of the piece that it has requested. All open streams of a session share the
/// bytes in transit to it.
#[derive(Debug)]
pub(super) struct Window {
    /// How many streams of the session are open.
    streams: Arc<AtomicUsize>,
    pace: Pace,
    size: usize,
}

impl Window {
    /// Returns the window of a new stream, which is counted in `streams` until the window is dropped.
    pub(super) fn open(streams: &Arc<AtomicUsize>) -> Self {
        streams.fetch_add(1, Ordering::Relaxed);
        Self { streams: Arc::clone(streams), pace: Pace::default(), size: 0 }
    }

    /// Returns the size of the next piece to request.
    pub(super) fn next(&mut self) -> u32 {
        let share = ON_THE_WAY_MAX / self.streams.load(Ordering::Relaxed).max(1);
        self.size = self.pace.chunk().min(share.max(PIECE_SIZE_MIN));
        u32::try_from(self.size).unwrap_or(u32::MAX)
    }

    /// Notes that a piece with this many bytes, which had been ready at the server, took this long.
    pub(super) fn arrived(&mut self, size: usize, took: Duration) {
        // The time of a smaller piece says little about the link.
        if size == self.size {
            self.pace.arrived(size, took);
        }
    }
}

impl Drop for Window {
    fn drop(&mut self) {
        self.streams.fetch_sub(1, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_streams_of_a_session_share_what_is_in_transit() {
        let streams = Arc::default();
        let mut window = Window::open(&streams);
        // A fast link: the window grows until the stream has all bytes that may be in transit.
        for _ in 0..20 {
            let size = window.next();
            window.arrived(size as usize, Duration::from_micros(u64::from(size) / 100));
        }
        assert_eq!(window.next() as usize, ON_THE_WAY_MAX);
        let others: Vec<Window> = (0..3).map(|_| Window::open(&streams)).collect();
        assert_eq!(window.next() as usize, ON_THE_WAY_MAX / 4);
        drop(others);
        assert_eq!(window.next() as usize, ON_THE_WAY_MAX);
        let _others: Vec<Window> = (0..1000).map(|_| Window::open(&streams)).collect();
        assert_eq!(window.next() as usize, PIECE_SIZE_MIN);
    }

    #[test]
    fn a_piece_that_was_not_full_says_nothing_about_the_link() {
        let mut window = Window::open(&Arc::default());
        let first = window.next();
        window.arrived(first as usize - 1, Duration::from_secs(1));
        assert_eq!(window.next(), first);
    }
}
