//! The number of keys with races, for callers that ask repeatedly.
//!
//! Finding races means reading the whole log, which may have a million transactions. Only a transaction with conditions or grants
//! can be part of a race. So the number is kept as long as the log is unchanged. While the log has no such transaction, only the
//! new transactions are read.

use super::{Race, granted};
use crate::logic::key::Key;
use crate::logic::txn::Txn;
use crate::logic::version_vector::VersionVector;
use crate::logic::view::past::Past;

/// The number of keys with races.
#[derive(Debug, Default)]
pub struct RaceCount(Option<Counted>);

/// The last count.
#[derive(Debug)]
struct Counted {
    /// From where to where the log reached.
    low: VersionVector,
    high: VersionVector,
    count: usize,
    /// Whether a transaction has conditions or grants.
    relies: bool,
}

impl RaceCount {
    /// Returns how many keys have unsettled races, as far back as the log reaches.
    pub fn of(&mut self, past: &Past<'_>) -> usize {
        let (low, high) = (past.log.low(), past.log.vector().clone());
        let is_same = |counted: &Counted| counted.low == low && counted.high == high;
        let counted = match self.0.take() {
            Some(counted) if is_same(&counted) => counted,
            Some(counted) if !counted.relies && high.dominates(&counted.high) && counted.high.dominates(&low) => {
                let relies = any_relies(past, &counted.high);
                Counted { count: if relies { past.races("").len() } else { 0 }, low, high, relies }
            }
            _ => {
                let relies = any_relies(past, &low);
                Counted { count: if relies { past.races("").len() } else { 0 }, low, high, relies }
            }
        };
        self.0.insert(counted).count
    }

    /// Returns the race at a key; none if the key has no race.
    pub fn race_at(&mut self, past: &Past<'_>, key: &Key) -> Option<Race> {
        if self.of(past) == 0 {
            return None;
        }
        past.races(key.as_str()).into_iter().find(|race| race.key == *key)
    }
}

/// Returns whether a transaction after `vector` has conditions or grants.
fn any_relies(past: &Past<'_>, vector: &VersionVector) -> bool {
    past.log.after(vector).any(|(_, encoded)| encoded.open().is_ok_and(|txn| relies(&txn)))
}

fn relies(txn: &Txn) -> bool {
    !txn.requires.is_empty() || granted(txn).next().is_some()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::txn::{Condition, Draft};
    use crate::logic::view::tests::{Robot, heal, key};

    /// The count equals the length of the list, also after earlier counts.
    #[test]
    fn the_number_is_that_of_the_list() {
        let mut team = Robot::team(2);
        let mut counts = [RaceCount::default(), RaceCount::default()];
        let mut check = |team: &[Robot], expected: usize| {
            for (robot, count) in team.iter().zip(&mut counts) {
                let past = robot.past();
                assert_eq!((past.races("").len(), count.of(&past), count.of(&past)), (expected, expected, expected));
                let at = |name: &str, count: &mut RaceCount| count.race_at(&past, &key(name)).is_some();
                assert_eq!((at("team/leader", count), at("team/other", count)), (expected > 0, false));
            }
        };
        check(&team, 0);
        team[0].put("", "team/other", "1");
        check(&team, 0);
        for (robot, name) in team.iter_mut().zip([b"1", b"2"]) {
            robot.commit(Draft::new("").require(key("team/leader"), Condition::Absent).put(key("team/leader"), name));
        }
        check(&team, 0);
        heal(&mut team);
        check(&team, 1);
        team[0].put("settled", "team/leader", "1");
        heal(&mut team);
        check(&team, 0);
        team[0].forget(0);
        assert_eq!(counts[0].of(&team[0].past()), 0);
    }

    /// Without conditions a count reads only new transactions, so the length of the log does not affect its cost.
    #[test]
    fn a_long_log_without_conditions_is_read_once() {
        let mut team = Robot::team(1);
        let mut count = RaceCount::default();
        for number in 0..300 {
            team[0].put("", &format!("team/{number}"), "1");
        }
        assert_eq!(count.of(&team[0].past()), 0);
        let before = count.0.as_ref().map(|counted| counted.high.clone()).unwrap();
        team[0].put("", "team/a", "1");
        assert_eq!(team[0].log.after(&before).count(), 1);
        assert_eq!(count.of(&team[0].past()), 0);
        assert!(count.0.is_some_and(|counted| !counted.relies && counted.high == team[0].vector()));
    }
}
