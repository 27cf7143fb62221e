//! The gate of a wire at its producer. It passes nothing while closed, keeps the rate limit, and repeats the last value when it
//! opens.

use comms::logic::control::Shape;
use comms::logic::time::Time;

/// The producer's end of a wire, without the way itself.
#[derive(Debug, Default)]
pub(super) struct Flow {
    shape: Shape,
    open: bool,
    /// When the last value passed since the wire was opened.
    passed: Option<Time>,
    /// Kept for who is connected later.
    last: Option<Vec<u8>>,
}

impl Flow {
    /// Returns a closed wire.
    pub(super) fn new(shape: Shape) -> Self {
        Self { shape, ..Self::default() }
    }

    /// Takes a value that is to be sent; says whether it passes.
    pub(super) fn offer(&mut self, bytes: &[u8], now: Time) -> bool {
        if self.shape.latch {
            self.last = Some(bytes.to_vec());
        }
        let is_soon = |period| self.passed.is_some_and(|passed| now.since(passed) < period);
        let passes = self.open && !self.shape.period_min.is_some_and(is_soon);
        if passes {
            self.passed = Some(now);
        }
        passes
    }

    /// Opens or closes the wire; returns what is to be sent at once.
    pub(super) fn switch(&mut self, open: bool, now: Time) -> Option<Vec<u8>> {
        let opens = open && !self.open;
        self.open = open;
        let last = self.last.clone().filter(|_| opens);
        self.passed = last.is_some().then_some(now);
        last
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn at(millis: u64) -> Time {
        Time::from_nanos(millis * 1_000_000)
    }

    #[test]
    fn a_wire_without_a_shape_is_open_or_closed() {
        let mut flow = Flow::new(Shape::default());
        assert!(!flow.offer(b"a", at(0)));
        assert_eq!(flow.switch(true, at(1)), None);
        assert!(flow.offer(b"b", at(1)) && flow.offer(b"c", at(1)));
        assert_eq!(flow.switch(false, at(2)), None);
        assert!(!flow.offer(b"d", at(3)));
    }

    #[test]
    fn a_latched_wire_sends_its_last_value_when_it_is_opened() {
        let mut flow = Flow::new(Shape { latch: true, ..Shape::default() });
        assert_eq!(flow.switch(true, at(0)), None);
        assert!(flow.offer(b"a", at(1)));
        assert_eq!(flow.switch(true, at(1)), None, "it is open already");
        flow.switch(false, at(2));
        assert!(!flow.offer(b"b", at(3)));
        assert_eq!(flow.switch(true, at(4)), Some(b"b".to_vec()));
    }

    #[test]
    fn values_keep_their_distance() {
        let mut flow = Flow::new(Shape { period_min: Some(Duration::from_millis(10)), ..Shape::default() });
        flow.switch(true, at(0));
        let passed: Vec<u64> = (0..40).step_by(4).filter(|&millis| flow.offer(b"v", at(millis))).collect();
        assert_eq!(passed, [0, 12, 24, 36]);
        flow.switch(false, at(40));
        flow.switch(true, at(41));
        assert!(flow.offer(b"v", at(41)), "what comes first after an opening passes");
    }
}
