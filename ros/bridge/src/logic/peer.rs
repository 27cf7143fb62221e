//! A peer of ROS 2 for tests: it takes requests in their order, and carries them out late, with failures, or never.

use comms::logic::random::Random;

/// A random peer. Its user carries out what is due.
pub(crate) struct Peer<R> {
    numbers: Random,
    /// The requests, and the times at which their answers are sent.
    queue: Vec<(u64, R)>,
    /// The percentages of lost requests, lost answers and failures, and the longest delay in milliseconds.
    lost: u64,
    unanswered: u64,
    failing: u64,
    delay: u64,
}

/// The fate of a request.
pub(crate) struct Fate {
    /// Whether the request was lost.
    pub(crate) is_lost: bool,
    /// Whether the answer was lost.
    pub(crate) is_unanswered: bool,
}

impl<R> Peer<R> {
    /// Returns a peer with one of these percentages of failures, and one of these longest delays in milliseconds.
    pub(crate) fn new(seed: u64, failing: [u64; 4], delay: [u64; 4]) -> Self {
        let mut numbers = Random::new(seed);
        let mut one_of = |all: [u64; 4]| all[usize::try_from(numbers.below(4)).unwrap()];
        let (lost, unanswered) = (one_of([0, 0, 20, 100]), one_of([0, 0, 20, 100]));
        let (failing, delay) = (one_of(failing), one_of(delay));
        Self { numbers, queue: Vec::new(), lost, unanswered, failing, delay }
    }

    /// Takes a request.
    pub(crate) fn take(&mut self, now: u64, request: R) {
        let earliest = self.queue.last().map_or(now, |(at, _)| *at);
        let due = earliest.max(now) + 1 + self.numbers.below(self.delay + 1);
        self.queue.push((due, request));
    }

    /// Returns the next request that is due.
    pub(crate) fn due(&mut self, now: u64) -> Option<(R, Fate)> {
        if self.queue.first().is_none_or(|(at, _)| *at > now) {
            return None;
        }
        let (_, request) = self.queue.remove(0);
        let is_lost = self.numbers.below(100) < self.lost;
        let is_unanswered = self.numbers.below(100) < self.unanswered;
        Some((request, Fate { is_lost, is_unanswered }))
    }

    /// Returns whether the next thing that it does fails.
    pub(crate) fn fails(&mut self) -> bool {
        self.numbers.below(100) < self.failing
    }

    /// Returns whether it does everything, and within a delay in milliseconds.
    pub(crate) fn is_well(&self, delay_max: u64) -> bool {
        [self.lost, self.unanswered, self.failing] == [0, 0, 0] && self.delay <= delay_max
    }
}
