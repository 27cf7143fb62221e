//! How many values the inputs of programs have lost and refused during a whole run. Signals of the programs count them.

use comms::logic::signals::{LOST_VALUES, REFUSED_VALUES, Signals};
use node::logic::table::counted;
use std::collections::BTreeMap;

/// The most programs whose losses are counted.
const PROGRAMS_MAX: usize = 10_000;

/// A count that restarts at zero with each activation.
#[derive(Clone, Copy, Debug, Default)]
struct Count {
    last: f64,
    total: f64,
}

impl Count {
    fn take(&mut self, value: f64) {
        self.total += if value >= self.last { value - self.last } else { value };
        self.last = value;
    }
}

/// The counts of each program.
#[derive(Clone, Debug, Default)]
pub(super) struct ProgramLosses(BTreeMap<String, [Count; 2]>);

impl ProgramLosses {
    /// Adds a sample of a program.
    pub(super) fn take(&mut self, path: &str, sample: &Signals) {
        for (place, name) in [LOST_VALUES, REFUSED_VALUES].into_iter().enumerate() {
            let signal = sample.values.iter().find(|signal| signal.name == name);
            let Some(value) = signal.map(|signal| signal.value).filter(|value| value.is_finite() && *value >= 0.0)
            else {
                continue;
            };
            if let Some(counts) = self.0.get_mut(path) {
                counts[place].take(value);
            } else if value > 0.0 && self.0.len() < PROGRAMS_MAX {
                self.0.entry(path.to_owned()).or_default()[place].take(value);
            }
        }
    }

    /// Returns each program that has lost or refused values, with the number of values in words.
    pub(super) fn texts(&self) -> impl Iterator<Item = (&str, String)> {
        self.0.iter().map(|(path, counts)| {
            let words = counts.iter().zip(["lost", "refused"]).filter(|(count, _)| count.total > 0.0);
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a count, which is not negative"
            )]
            let words = words.map(|(count, what)| format!("{} {what}", counted(count.total as usize, "value")));
            (path.as_str(), words.collect::<Vec<_>>().join(", "))
        })
    }
}
