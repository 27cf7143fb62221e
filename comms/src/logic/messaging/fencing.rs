//! The check in front of a resource: it lets the present holder of the lock through, and no earlier holder.
//!
//! A client that was suspended, or cut off, does not know that its lease is over. So the resource does not trust the
//! client; it compares numbers. Each grant of a lock has a fencing number that is greater than all earlier ones, and
//! every command to the resource carries the number of its grant. Invariant: the floor of a check never sinks, so a
//! number that was refused once is refused for ever. Source: Gray and Cheriton, "Leases", SOSP 1989; Kleppmann,
//! "Designing Data-Intensive Applications", chapter 8.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Compares fencing numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FencingCheck {
    /// The smallest number that is let through.
    floor: u64,
    /// The greatest granted number. None if this check does not get grants.
    granted: Option<u64>,
}

/// Why a command does not reach the resource.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq, Serialize, Deserialize)]
pub enum Refusal {
    /// The command carries no fencing number.
    #[error("it was sent without the lock")]
    NoLock,
    /// The command carries the number of a grant that is over.
    #[error("it was sent under grant {number} of the lock, which is over: only grant {floor} and later grants may act")]
    Over {
        /// The number of the command.
        number: u64,
        /// The smallest number that is let through.
        floor: u64,
    },
    /// The command carries a number that was never granted.
    #[error("grant {number} of the lock was never made")]
    Unknown {
        /// The number of the command.
        number: u64,
    },
}

impl FencingCheck {
    /// Returns a check at a resource that does not get grants. It learns the numbers from the commands that it lets
    /// through.
    pub const fn learning() -> Self {
        Self { floor: 0, granted: None }
    }

    /// Returns a check in the same program as its lock. It is closed until the first grant. No number from `first` on
    /// was granted yet.
    pub const fn closed(first: u64) -> Self {
        Self { floor: first, granted: Some(first.saturating_sub(1)) }
    }

    /// Lets a command through, or refuses it.
    ///
    /// # Errors
    /// Why the number is refused.
    pub fn admit(&mut self, number: Option<u64>) -> Result<(), Refusal> {
        let number = number.ok_or(Refusal::NoLock)?;
        if number < self.floor {
            return Err(Refusal::Over { number, floor: self.floor });
        }
        if self.granted.is_some_and(|granted| number > granted) {
            return Err(Refusal::Unknown { number });
        }
        self.floor = number;
        Ok(())
    }

    /// Notes a grant: every smaller number is refused from now on.
    pub fn open(&mut self, number: u64) {
        self.floor = self.floor.max(number);
        self.granted = self.granted.map(|granted| granted.max(number));
    }

    /// Notes that a grant is over: its number and every smaller one are refused from now on.
    pub fn close(&mut self, number: u64) {
        self.floor = self.floor.max(number.saturating_add(1));
    }

    /// Returns the smallest number that is let through.
    pub const fn floor(&self) -> u64 {
        self.floor
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_check_beside_its_lock_knows_who_holds_it() {
        let mut fencing = FencingCheck::closed(7);
        assert_eq!(fencing.admit(None), Err(Refusal::NoLock));
        assert_eq!(fencing.admit(Some(6)), Err(Refusal::Over { number: 6, floor: 7 }));
        assert_eq!(fencing.admit(Some(7)), Err(Refusal::Unknown { number: 7 }));
        fencing.open(7);
        assert_eq!((fencing.admit(Some(7)), fencing.admit(Some(7))), (Ok(()), Ok(())));
        fencing.close(7);
        assert_eq!(fencing.admit(Some(7)), Err(Refusal::Over { number: 7, floor: 8 }));
        assert_eq!(fencing.admit(Some(8)), Err(Refusal::Unknown { number: 8 }));
    }

    proptest! {
        /// Compared with a list of all numbers that were let through.
        #[test]
        fn no_number_comes_through_after_a_greater_one(numbers in prop::collection::vec(0_u64..20, 0..60)) {
            let (mut fencing, mut through) = (FencingCheck::learning(), Vec::<u64>::new());
            for number in numbers {
                let expected = through.iter().all(|&earlier| earlier <= number);
                prop_assert_eq!(fencing.admit(Some(number)).is_ok(), expected);
                if expected {
                    through.push(number);
                }
            }
        }
    }
}
