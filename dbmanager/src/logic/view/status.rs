//! The lag of other replicas, in transactions, bytes and time.
//!
//! A member that lacks transactions keeps old data from being removed (see [`gc`](crate::logic::gc)): these
//! transactions must still be there when it returns. The oldest of them shows since when this is the case.

use super::past::When;
use crate::logic::log::Log;
use crate::logic::version_vector::{Dot, VersionVector};
use serde::{Deserialize, Serialize};

/// The transactions that a replica lacks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Lag {
    /// How many transactions.
    pub transactions: u64,
    /// The approximate size on the wire, in bytes, of the transactions that are still kept.
    pub bytes: u64,
    /// How many of them were dropped. If there are any, the whole state has to be sent.
    pub dropped: u64,
    /// The time of the oldest transaction that is still kept.
    pub since: Option<When>,
}

impl Lag {
    /// Returns the transactions of a log that a version vector does not include.
    pub fn of(log: &Log, vector: &VersionVector) -> Self {
        let here = log.vector();
        let transactions = here.beyond(vector).iter().map(|(origin, seq)| seq - vector.get(origin)).sum();
        let mut lag = Self { transactions, dropped: transactions, ..Self::default() };
        for (origin, seq) in here.beyond(vector).iter() {
            let kept = (vector.get(origin) + 1..=seq).rev().map_while(|seq| log.encoded(Dot { origin, seq }));
            for encoded in kept {
                lag.dropped -= 1;
                lag.bytes += u64::try_from(encoded.size()).unwrap_or(u64::MAX);
                if let Ok(txn) = encoded.open() {
                    let when = When::of(txn.wall, txn.stamp);
                    lag.since = Some(lag.since.map_or(when, |since| since.min(when)));
                }
            }
        }
        lag
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::view::tests::{MORNING, Robot};

    #[test]
    fn who_is_away_lacks_what_was_written_since() {
        let mut team = Robot::team(2);
        let away = team[1].vector();
        assert_eq!(Lag::of(team[0].past().log, &away), Lag::default());
        for number in 0..5 {
            team[0].put("", "team/a", &number.to_string());
        }
        let lag = Lag::of(team[0].past().log, &away);
        let since = Some(When { millis: MORNING + 2000, trusted: true });
        assert_eq!((lag.transactions, lag.dropped, lag.since), (5, 0, since));
        assert!((5 * 30..5 * 60).contains(&lag.bytes), "{lag:?}");
        team[0].forget(100);
        let lag = Lag::of(team[0].past().log, &away);
        assert!(lag.transactions == 5 && lag.dropped > 0 && lag.bytes <= 100 && lag.since > since, "{lag:?}");
    }
}
