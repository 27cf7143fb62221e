//! The counts of missed deadlines, lost values, undelivered values and refused values in one activation.

use comms::logic::signals::{LOST_VALUES, OVERRUNS, REFUSED_VALUES, Signal, UNDELIVERED_VALUES};

/// The counts of one activation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Tally {
    /// Missed deadlines.
    pub(super) overruns: u64,
    /// Values that were sent to inputs, but have not arrived.
    pub(super) lost: u64,
    /// Values that were sent while their consumers were not connected, also in earlier activations.
    pub(super) undelivered: u64,
    /// Values that inputs have refused, because a number in them was not finite.
    pub(super) refused: u64,
}

impl Tally {
    /// Returns the counts with losses that wait to be counted: a calculation that takes long may be the last one.
    pub(super) const fn with_losses(self, waiting: u64) -> Self {
        Self { lost: self.lost.saturating_add(waiting), ..self }
    }

    /// Returns the counts as signals. The names are the same from the first sample on, so that a record has one schema.
    pub(super) fn signals(self) -> [Signal; 4] {
        let signal = |name: &str, count: u64| {
            #[expect(clippy::cast_precision_loss, reason = "a count for people")]
            let value = count as f64;
            Signal { name: name.to_owned(), unit: String::new(), value, headline: false }
        };
        [
            signal(OVERRUNS, self.overruns),
            signal(LOST_VALUES, self.lost),
            signal(REFUSED_VALUES, self.refused),
            signal(UNDELIVERED_VALUES, self.undelivered),
        ]
    }

    /// Writes the counts to the log at the end of the activation.
    pub(super) fn log(&self) {
        if self.overruns > 0 {
            tracing::info!(overruns = self.overruns, "deadlines were missed");
        }
        if self.lost > 0 {
            tracing::info!(lost = self.lost, "values did not arrive");
        }
        if self.undelivered > 0 {
            tracing::warn!(undelivered = self.undelivered, "values were sent while their consumers were not connected");
        }
        if self.refused > 0 {
            tracing::warn!(refused = self.refused, "values were refused: a number in them was not finite");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::logic::signals::COUNTS;

    #[test]
    fn readers_know_each_count() {
        assert_eq!(Tally::default().signals().map(|signal| signal.name), COUNTS);
    }
}
