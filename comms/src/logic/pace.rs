//! The size of the next request for a stream. It should keep the link full, but urgent messages must not wait long behind the answer.
//!
//! The time of an answer has two parts: a round trip, which is the same for every size, and the time for its bytes. A message in
//! front of the bytes separates the two parts ([`Pace::timed`]). Without such a message, two answers of different size are compared.
//! While only one size is known, the next request is four times as large.
//!
//! A node treats another node as failed after 6 s of silence. Messages of nodes wait behind the bytes of an answer, so these bytes
//! take less than 6 s on any link.

use std::time::Duration;

/// The largest request, in bytes.
pub const SIZE_MAX: usize = 4 << 20;

/// How long to wait for an answer, in addition to its expected time.
const PULL_TIME: Duration = Duration::from_secs(2);
/// How long the bytes of an answer should be in transit. Urgent messages wait behind at most one answer.
const CHUNK_TIME: Duration = Duration::from_millis(250);
/// The same in round trips, for links with long ones. The link is unused for one round trip in this many.
const CHUNK_ROUNDS: u32 = 6;
/// The longest time that the bytes of an answer should be in transit, in addition to half a round trip.
const CHUNK_TIME_MAX: Duration = Duration::from_secs(2);
/// The same if the next answer is requested while the bytes of the previous one are in transit. Then a round trip and a quarter keeps
/// the link full, and up to twice as many bytes are in transit.
const TIMED_TIME_MAX: Duration = Duration::from_millis(2500);
/// The longest time that is expected for an answer that was not full.
const EXPECTED_MAX: Duration = Duration::from_secs(16);
/// The size of the first request to a peer, whose link is unknown. On the slowest radio the answer still arrives in time.
const SIZE_FIRST: usize = 4 << 10;
/// The fewest bytes to ask for.
const SIZE_MIN: usize = 1 << 10;
/// The largest request over a short round trip. An answer is processed in one turn, and other work waits for it.
const SIZE_NEAR: usize = 256 << 10;
/// How many times larger than the last answer a request may be.
const GROWTH_MAX: usize = 64;

/// The estimate of the link to a peer.
#[derive(Debug, Default)]
pub struct Pace {
    /// The size of the fastest full answer, and how long it took.
    base: Option<(usize, Duration)>,
    /// The rate of the link, once it is known.
    rate: Option<Rate>,
    /// The shortest round trip of the answers whose bytes were timed.
    round: Option<Duration>,
    /// The size of the next request in bytes, once the link is known.
    chunk: Option<usize>,
    /// The expected time of an answer of that size.
    expected: Duration,
}

/// How long `bytes` bytes are in transit, in addition to a round trip.
#[derive(Clone, Copy, Debug)]
struct Rate {
    bytes: usize,
    sending: Duration,
}

impl Pace {
    /// Returns the size of the next request, in bytes.
    pub fn chunk(&self) -> usize {
        self.chunk.unwrap_or(SIZE_FIRST)
    }

    /// Returns how long to wait for the answer.
    pub fn wait(&self) -> Duration {
        PULL_TIME + 2 * self.expected
    }

    /// Notes how long an answer took that was not full. Its size is ignored.
    pub fn heard(&mut self, took: Duration) {
        self.expected = self.expected.max(took.min(EXPECTED_MAX));
    }

    /// Notes that the first message of a full answer took `round`, and that its bytes came `sending` later.
    pub fn timed(&mut self, bytes: usize, round: Duration, sending: Duration) {
        let round = self.round.map_or(round, |before| before.min(round));
        let sending = sending.max(Duration::from_millis(1));
        (self.round, self.rate, self.base) = (Some(round), Some(Rate { bytes, sending }), None);
        let time = CHUNK_TIME.max((round * 5 / 4).min(TIMED_TIME_MAX));
        self.expected = round + 2 * time;
        self.ask_for(bytes, Rate { bytes, sending }.fitting(time), time);
    }

    /// Notes how long a full answer of this size took.
    pub fn arrived(&mut self, bytes: usize, took: Duration) {
        let took = took.max(Duration::from_millis(1));
        let (bytes_base, took_base) = self.base.unwrap_or((bytes, took));
        let (more, longer) = (bytes.saturating_sub(bytes_base), took.saturating_sub(took_base));
        if more >= bytes_base && longer > Duration::ZERO {
            self.rate = Some(Rate { bytes: more, sending: longer });
        }
        // An answer faster than the measured rate shows that the link has changed.
        self.rate = self.rate.filter(|rate| rate.time_of(bytes) <= took);
        let (fits, time) = match self.rate {
            Some(rate) => {
                let quickest = if took < took_base { (bytes, took) } else { (bytes_base, took_base) };
                let round = quickest.1.saturating_sub(rate.time_of(quickest.0));
                let time = CHUNK_TIME.max((CHUNK_ROUNDS * round).min(CHUNK_TIME_MAX + round / 2));
                self.expected = round + time;
                (rate.fitting(time), time)
            }
            None => {
                self.expected = 2 * took;
                (4 * bytes, CHUNK_TIME)
            }
        };
        if self.base.is_none() || took < took_base {
            self.base = Some((bytes, took));
        }
        self.ask_for(bytes, fits, time);
    }

    /// Sets the size of the next requests to `fits`, the number of bytes that fit into `time`, within the limits. `bytes` is the size
    /// of the last answer.
    fn ask_for(&mut self, bytes: usize, fits: usize, time: Duration) {
        let most = if time > CHUNK_TIME { SIZE_MAX } else { SIZE_NEAR };
        self.chunk = Some(fits.min(GROWTH_MAX * bytes).clamp(SIZE_MIN, most));
    }

    /// Notes that no answer came in time.
    pub fn lost(&mut self) {
        self.chunk = Some((self.chunk() / 4).max(SIZE_MIN));
        self.round = None;
    }
}

impl Rate {
    /// Returns how many bytes are sent in `time`.
    fn fitting(self, time: Duration) -> usize {
        let bytes = time.as_nanos() * in_wide(self.bytes) / self.sending.as_nanos().max(1);
        usize::try_from(bytes).unwrap_or(usize::MAX)
    }

    /// Returns how long it takes to send this number of bytes.
    fn time_of(self, bytes: usize) -> Duration {
        let nanos = self.sending.as_nanos() * in_wide(bytes) / in_wide(self.bytes.max(1));
        Duration::from_nanos(u64::try_from(nanos).unwrap_or(u64::MAX))
    }
}

fn in_wide(size: usize) -> u128 {
    u128::try_from(size).unwrap_or(u128::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the time that `total` bytes take on a link of this rate and round trip, divided by the time of the bytes alone. Checks
    /// that no answer delays messages of nodes for so long that a node counts as failed.
    fn ratio(total: usize, rate: f64, round: f64) -> f64 {
        let (mut pace, mut left, mut time) = (Pace::default(), total, round);
        while left > 0 {
            let chunk = pace.chunk().min(left);
            let took = round + chunk as f64 / rate;
            assert!(took <= pace.wait().as_secs_f64() || round > 2.0, "{chunk} bytes take {took} s");
            assert!(took - round <= 4.0, "{chunk} bytes are on their way for {} s", took - round);
            pace.arrived(chunk, Duration::from_secs_f64(took));
            (left, time) = (left - chunk, time + took);
        }
        time / (total as f64 / rate + round)
    }

    #[test]
    fn the_link_is_full_at_any_delay() {
        // The amount of data that takes ten round trips and a second.
        for (total, rate, round, most) in [
            (1_200_000, 1e6, 0.02, 1.5),
            (3_000_000, 1e6, 0.2, 1.5),
            (5_000_000, 1e6, 0.4, 1.5),
            (9_000_000, 3e6, 0.2, 1.5),
            (68_750, 50e3 / 8.0, 1.0, 1.6),
            (1_100_000, 1e5, 1.0, 1.6),
            (3_100_000, 1e5, 3.0, 2.0),
        ] {
            let ratio = ratio(total, rate, round);
            println!("{rate} B/s, {round} s: {ratio:.2}");
            assert!(ratio < most, "{rate} B/s, {round} s: {ratio}");
        }
    }

    #[test]
    fn a_word_in_front_of_an_answer_tells_the_rate_at_once() {
        for (rate, round, expected) in [(6250, 1000, 7812), (6250, 20, 1562), (100_000, 3000, 250_000)] {
            let mut pace = Pace::default();
            let sending = Duration::from_millis(4096 * 1000 / rate);
            pace.timed(4096, Duration::from_millis(round), sending);
            // An answer that was requested while another one was in transit waits for that one.
            pace.timed(4096, Duration::from_millis(5 * round), sending);
            let chunk = pace.chunk();
            assert!(chunk.abs_diff(expected) <= expected / 20, "{rate} B/s, {round} ms: {chunk}");
        }
    }

    #[test]
    fn a_slow_radio_is_asked_for_what_it_carries_in_a_quarter_of_a_second() {
        let mut pace = Pace::default();
        for number in 0..20 {
            assert!(number < 3 || pace.chunk() <= 1700, "{number}: {}", pace.chunk());
            let took = 0.02 + pace.chunk() as f64 / 6250.0;
            pace.arrived(pace.chunk(), Duration::from_secs_f64(took));
        }
        assert!((1024..=1700).contains(&pace.chunk()), "{}", pace.chunk());
        // The radio is near again, and fast.
        for _ in 0..20 {
            pace.arrived(pace.chunk(), Duration::from_secs_f64(0.02 + pace.chunk() as f64 / 1e6));
        }
        assert!((200_000..=300_000).contains(&pace.chunk()), "{}", pace.chunk());
    }
}
