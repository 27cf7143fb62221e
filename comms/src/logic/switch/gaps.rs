//! The consumer's count of the values that were lost on a wire. Each value has a sequence number, and each missing
//! number is a lost value.

/// Identifies a publisher on a wire: its session and, within it, the publisher. A restarted program has another id.
pub type PublisherId = (u128, u32);

/// The sequence number of a value on a wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sequence {
    /// The publisher.
    pub publisher: PublisherId,
    /// How many values the publisher had sent over this wire, including the value that has this number. 0 follows
    /// `u32::MAX`.
    pub number: u32,
}

/// The count of one wire.
#[derive(Clone, Copy, Debug, Default)]
pub struct Gaps {
    last: Option<Sequence>,
}

impl Gaps {
    /// Notes a value. Returns how many values before it are missing since the first message on this wire.
    pub fn value(&mut self, sequence: Sequence) -> u32 {
        self.next(sequence, 1)
    }

    /// Notes a boundary between values; returns the same as [`Gaps::value`].
    pub fn boundary(&mut self, sequence: Sequence) -> u32 {
        self.next(sequence, 0)
    }

    fn next(&mut self, sequence: Sequence, step: u32) -> u32 {
        let last = self.last.filter(|last| last.publisher == sequence.publisher);
        let ahead = last.map_or(step, |last| sequence.number.wrapping_sub(last.number));
        // A number that seems more than half of all numbers ahead is behind: its value was counted as lost, and comes
        // late.
        if ahead > u32::MAX / 2 {
            return 0;
        }
        self.last = Some(sequence);
        ahead.saturating_sub(step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn of(publisher: u32, number: u32) -> Sequence {
        Sequence { publisher: (7, publisher), number }
    }

    proptest! {
        /// For any arrivals: each value sent between the first and the last arrival has arrived or is counted.
        #[test]
        fn what_does_not_arrive_is_counted(first: u32, sent in proptest::collection::vec(any::<[bool; 2]>(), 0..200)) {
            let (mut gaps, mut number, mut lost) = (Gaps::default(), first, 0);
            prop_assert_eq!(gaps.boundary(of(1, first)), 0);
            for [is_value, arrives] in &sent {
                number = number.wrapping_add(u32::from(*is_value));
                if *arrives {
                    let sequence = of(1, number);
                    lost += if *is_value { gaps.value(sequence) } else { gaps.boundary(sequence) };
                }
            }
            lost += gaps.boundary(of(1, number));
            let missing = sent.iter().filter(|one| **one == [true, false]).count();
            prop_assert_eq!(usize::try_from(lost).unwrap(), missing);
        }
    }

    #[test]
    fn who_comes_anew_is_counted_from_its_first_word() {
        let mut gaps = Gaps::default();
        assert_eq!((gaps.value(of(1, 40)), gaps.value(of(1, 43))), (0, 2));
        assert_eq!((gaps.boundary(of(2, 0)), gaps.value(of(2, 1)), gaps.value(of(2, 4))), (0, 0, 2));
        assert_eq!((gaps.value(of(2, 3)), gaps.value(of(2, 5))), (0, 0), "what comes late was counted");
    }
}
