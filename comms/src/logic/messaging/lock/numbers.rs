//! The fencing numbers of a lock: each is reserved on the disk before it is granted, so that a restarted server grants no
//! number twice.

/// How many numbers are reserved on the disk at once.
const RESERVED: u64 = 64;

/// The fencing numbers that a lock has not granted.
#[derive(Clone, Debug)]
pub(super) struct FencingNumbers {
    next: u64,
    /// The first number that may not be granted yet.
    reserved: u64,
    /// Whether a reservation is being written to the disk.
    is_persisting: bool,
}

impl FencingNumbers {
    /// Returns the numbers from `first` on. None of them is reserved.
    pub(super) const fn from(first: u64) -> Self {
        Self { next: first, reserved: first, is_persisting: false }
    }

    /// Returns whether a reservation is being written to the disk.
    pub(super) const fn is_persisting(&self) -> bool {
        self.is_persisting
    }

    /// Returns the end of the reservation to write now; none if the next number is reserved, or is being reserved.
    pub(super) fn reserve(&mut self) -> Option<u64> {
        let is_needed = !self.is_reserved() && !self.is_persisting;
        self.is_persisting |= is_needed;
        is_needed.then(|| self.next.saturating_add(RESERVED))
    }

    /// Notes that all numbers before `end` are reserved on the disk.
    pub(super) fn persisted(&mut self, end: u64) {
        self.is_persisting = false;
        self.reserved = self.reserved.max(end);
    }

    /// Returns whether the next number may be granted.
    pub(super) const fn is_reserved(&self) -> bool {
        self.next < self.reserved
    }

    /// Takes the next number.
    pub(super) const fn take(&mut self) -> u64 {
        let number = self.next;
        self.next = self.next.saturating_add(1);
        number
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// The disk is slow, and the server restarts at any time: it continues with the last reservation on the disk.
        #[test]
        fn no_number_is_taken_twice(steps in prop::collection::vec(0_u8..4, 0..400)) {
            let (mut disk, mut writing, mut taken) = (1, None, 0);
            let mut numbers = FencingNumbers::from(disk);
            for step in steps {
                match step {
                    0 => {
                        (numbers, writing) = (FencingNumbers::from(disk), None);
                    }
                    1 => {
                        if let Some(end) = writing.take() {
                            disk = end;
                            numbers.persisted(end);
                        }
                    }
                    _ => {
                        let reserve = numbers.reserve();
                        prop_assert!(writing.is_none() || reserve.is_none(), "two reservations are written at once");
                        writing = writing.or(reserve);
                        prop_assert_eq!(numbers.is_persisting(), writing.is_some());
                        if numbers.is_reserved() {
                            let number = numbers.take();
                            prop_assert!(taken < number && number < disk);
                            taken = number;
                        } else {
                            prop_assert!(writing.is_some(), "the lock would wait for ever");
                        }
                    }
                }
            }
        }
    }
}
