//! The state of a wire at its producer, without I/O. It passes no value while the wire is closed, keeps the rate
//! limit, and repeats the last value when the wire opens.

use crate::logic::control::Shape;
use crate::logic::time::Time;

/// The producer's end of a wire.
#[derive(Debug, Default)]
pub struct Flow {
    shape: Shape,
    open: bool,
    /// When the last value passed, if one has passed since the wire was opened.
    passed: Option<Time>,
    /// How many values have passed since the wire was opened.
    sent: u64,
    /// How many values have passed in all. 0 follows `u32::MAX`.
    number: u32,
    /// The number of the last message to a connected consumer.
    told: u32,
    /// The last value, for consumers that connect later.
    last: Option<Vec<u8>>,
    /// Whether a consumer that comes lacks the last value, and nothing else makes this wire repeat it.
    is_owed: bool,
}

impl Flow {
    /// Returns a closed wire.
    pub fn new(shape: Shape) -> Self {
        Self { shape, is_owed: true, ..Self::default() }
    }

    /// Takes a value to be sent; returns whether it passes.
    pub fn offer(&mut self, bytes: &[u8], now: Time) -> bool {
        if self.shape.latch {
            self.last = Some(bytes.to_vec());
        }
        self.pass(now)
    }

    /// Returns whether the last value is kept for later consumers.
    pub fn is_latched(&self) -> bool {
        self.shape.latch
    }

    /// Notes a value to be sent, on a wire that is not latched; returns whether it passes.
    pub fn pass(&mut self, now: Time) -> bool {
        let is_soon = |period| self.passed.is_some_and(|passed| now.since(passed) < period);
        let passes = self.open && !self.shape.period_min.is_some_and(is_soon);
        if passes {
            self.passed = Some(now);
            self.sent += 1;
            self.number = self.number.wrapping_add(1);
        }
        passes
    }

    /// Skips the numbers of values that the sender has lost. The consumer counts them as lost.
    pub fn skip(&mut self, count: u32) {
        if self.open {
            self.number = self.number.wrapping_add(count);
            self.told = self.told.wrapping_add(count);
        }
    }

    /// Returns the sequence number of the last value that has passed.
    pub fn number(&self) -> u32 {
        self.number
    }

    /// Returns whether the wire is open.
    pub fn is_open(&self) -> bool {
        self.open
    }

    /// Opens the wire; returns the value to be sent at once. If the wire is open already, nothing changes.
    pub fn open(&mut self, now: Time) -> Option<Vec<u8>> {
        if self.open {
            return None;
        }
        let last = self.last.clone();
        (self.open, self.passed, self.sent) = (true, last.is_some().then_some(now), u64::from(last.is_some()));
        self.number = self.number.wrapping_add(u32::from(last.is_some()));
        last
    }

    /// Notes whether a consumer was there for a value that has passed. If the only consumer so far was there, and is
    /// gone, its node asks for the last value once it was started again.
    pub fn sent(&mut self, has_consumer: bool) {
        self.is_owed &= !has_consumer;
    }

    /// Notes whether a consumer was there for the last value, which was sent again.
    pub fn repeated(&mut self, has_consumer: bool) {
        self.is_owed = !has_consumer;
    }

    /// Notes that the last message, a value or a boundary, was sent to a connected consumer. All messages have a number,
    /// so the consumer counts the earlier values that it has not received.
    pub fn reached(&mut self) {
        self.told = self.number;
    }

    /// Returns how many values have passed since the last message to a connected consumer. The consumer does not count
    /// them yet. It counts them with the next message, and then this number is 0.
    pub fn undelivered(&self) -> u32 {
        self.number.wrapping_sub(self.told)
    }

    /// Returns whether the last value has to be sent again once a consumer comes.
    pub fn owes(&self) -> bool {
        self.open && self.is_owed && self.last.is_some()
    }

    /// Closes the wire; returns how many values have passed since it was opened. A second call returns the same
    /// number.
    pub fn close(&mut self) -> u64 {
        self.open = false;
        self.sent
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::switch::{Gaps, Sequence};
    use proptest::prelude::*;
    use std::time::Duration;

    fn at(millis: u64) -> Time {
        Time::from_nanos(millis * 1_000_000)
    }

    #[test]
    fn a_wire_without_a_shape_is_open_or_closed() {
        let mut flow = Flow::new(Shape::default());
        assert!(!flow.offer(b"a", at(0)));
        assert_eq!(flow.open(at(1)), None);
        assert!(flow.offer(b"b", at(1)) && flow.offer(b"c", at(1)));
        assert_eq!((flow.close(), flow.close(), flow.number()), (2, 2, 2));
        assert!(!flow.offer(b"d", at(3)));
    }

    #[test]
    fn a_latched_wire_sends_its_last_value_when_it_is_opened() {
        let mut flow = Flow::new(Shape { latch: true, ..Shape::default() });
        assert_eq!(flow.open(at(0)), None);
        assert!(flow.offer(b"a", at(1)));
        assert_eq!(flow.open(at(1)), None, "it is open already");
        flow.close();
        assert!(!flow.offer(b"b", at(3)));
        assert_eq!((flow.open(at(4)), flow.close()), (Some(b"b".to_vec()), 1));
        assert_eq!(flow.number(), 2, "numbers go on when a wire is opened again");
    }

    #[test]
    fn the_last_value_is_owed_to_a_consumer_that_was_not_there() {
        let mut flow = Flow::new(Shape { latch: true, ..Shape::default() });
        flow.open(at(0));
        assert!(!flow.owes(), "nothing was sent");
        assert!(flow.offer(b"a", at(1)));
        flow.sent(false);
        assert!(flow.owes(), "no consumer has come yet");
        flow.close();
        assert!(!flow.owes() && flow.open(at(2)).is_some());
        flow.repeated(true);
        assert!(!flow.owes() && flow.offer(b"b", at(3)));
        flow.sent(false);
        assert!(!flow.owes(), "the node of the consumer asks for it");
        flow.close();
        flow.open(at(4));
        flow.repeated(false);
        assert!(flow.owes() && flow.offer(b"c", at(5)));
        flow.sent(true);
        assert!(!flow.owes(), "it has a later value");
        let mut other = Flow::new(Shape::default());
        other.open(at(0));
        assert!(other.offer(b"a", at(1)) && !other.owes(), "nothing is kept");
    }

    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    enum Link {
        Up,
        /// Nothing arrives any more, and the producer does not know it yet.
        Silent,
        Down,
    }

    #[derive(Clone, Copy, Debug)]
    enum Step {
        Send,
        /// The sender itself has lost values.
        Skip,
        Open,
        Close,
        Becomes(Link),
    }

    /// A wire with both of its ends, and the fates of its values.
    struct Ends {
        flow: Flow,
        gaps: Gaps,
        link: Link,
        sent: u32,
        arrived: u32,
        lost: u32,
        /// Values that the producer has sent over a silent link, and that the consumer does not know of.
        on_their_way: u32,
    }

    impl Ends {
        fn new(first: u32) -> Self {
            let (mut flow, mut gaps) = (Flow::new(Shape::default()), Gaps::default());
            flow.open(at(0));
            flow.skip(first);
            flow.reached();
            gaps.boundary(Sequence { publisher: (1, 1), number: first });
            Self { flow, gaps, link: Link::Up, sent: 0, arrived: 0, lost: 0, on_their_way: 0 }
        }

        /// Sends a value or a boundary with the last number.
        fn message(&mut self, is_value: bool) {
            let undelivered = self.flow.undelivered();
            if self.link != Link::Down {
                self.flow.reached();
            }
            match self.link {
                Link::Up => {
                    let sequence = Sequence { publisher: (1, 1), number: self.flow.number() };
                    self.lost += if is_value { self.gaps.value(sequence) } else { self.gaps.boundary(sequence) };
                    self.arrived += u32::from(is_value);
                    self.on_their_way = 0;
                }
                Link::Silent => self.on_their_way += undelivered,
                Link::Down => {}
            }
        }

        fn step(&mut self, step: Step) {
            match step {
                Step::Send if self.flow.pass(at(1)) => {
                    self.sent += 1;
                    self.message(true);
                }
                Step::Skip if self.flow.is_open() => {
                    self.flow.skip(1);
                    (self.sent, self.on_their_way) = (self.sent + 1, self.on_their_way + 1);
                }
                Step::Send | Step::Skip => {}
                Step::Open => {
                    self.flow.open(at(1));
                    self.message(false);
                }
                Step::Close => {
                    self.flow.close();
                    self.message(false);
                }
                Step::Becomes(link) => self.link = link,
            }
        }
    }

    fn step() -> impl Strategy<Value = Step> {
        let link = prop_oneof![Just(Link::Up), Just(Link::Silent), Just(Link::Down)];
        prop_oneof![
            6 => Just(Step::Send),
            1 => Just(Step::Skip),
            1 => Just(Step::Open),
            1 => Just(Step::Close),
            2 => link.prop_map(Step::Becomes),
        ]
    }

    proptest! {
        /// For any order of cuts, returns, openings and closings: each value has arrived, or one of the two ends counts
        /// it. While a cut is not noticed, values are still on their way, and they are counted once a message arrives.
        #[test]
        fn a_value_arrives_or_is_counted_once(first: u32, steps in proptest::collection::vec(step(), 0..200)) {
            let mut ends = Ends::new(first);
            for step in steps {
                ends.step(step);
                let counted = ends.lost + ends.flow.undelivered() + ends.on_their_way;
                prop_assert_eq!(ends.sent, ends.arrived + counted);
            }
            ends.step(Step::Becomes(Link::Up));
            ends.step(Step::Close);
            prop_assert_eq!((ends.flow.undelivered(), ends.on_their_way), (0, 0));
            prop_assert_eq!(ends.sent, ends.arrived + ends.lost);
        }
    }

    #[test]
    fn values_keep_their_distance() {
        let mut flow = Flow::new(Shape { period_min: Some(Duration::from_millis(10)), ..Shape::default() });
        flow.open(at(0));
        let passed: Vec<u64> = (0..40).step_by(4).filter(|&millis| flow.offer(b"v", at(millis))).collect();
        assert_eq!(passed, [0, 12, 24, 36]);
        flow.close();
        flow.open(at(41));
        assert!(flow.offer(b"v", at(41)), "what comes first after an opening passes");
    }
}
