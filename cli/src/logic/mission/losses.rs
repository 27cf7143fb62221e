//! How many values the inputs of programs have lost and refused during a whole run, and how many values of their outputs
//! were not delivered. Signals of the programs count them.

use comms::logic::signals::{LOST_VALUES, REFUSED_VALUES, Signals, UNDELIVERED_VALUES};
use node::logic::table::counted;
use std::collections::BTreeMap;

/// The most programs whose losses are counted.
const PROGRAMS_MAX: usize = 10_000;

/// The signals that count, and their words.
const COUNTED: [(&str, &str); 3] =
    [(LOST_VALUES, "lost"), (REFUSED_VALUES, "refused"), (UNDELIVERED_VALUES, "not delivered")];

/// A count that restarts at zero with each activation.
#[derive(Clone, Copy, Debug, Default)]
struct Count {
    last: f64,
    total: f64,
}

impl Count {
    fn take(&mut self, name: &str, value: f64) {
        if name == UNDELIVERED_VALUES {
            // This count goes on over activations, and is 0 once the consumers count these values themselves.
            self.total = value;
            return;
        }
        self.total += if value >= self.last { value - self.last } else { value };
        self.last = value;
    }
}

/// The counts of each program.
#[derive(Clone, Debug, Default)]
pub(super) struct ProgramLosses(BTreeMap<String, [Count; COUNTED.len()]>);

impl ProgramLosses {
    /// Adds a sample of a program.
    pub(super) fn take(&mut self, path: &str, sample: &Signals) {
        for (place, (name, _)) in COUNTED.into_iter().enumerate() {
            let signal = sample.values.iter().find(|signal| signal.name == name);
            let Some(value) = signal.map(|signal| signal.value).filter(|value| value.is_finite() && *value >= 0.0)
            else {
                continue;
            };
            if let Some(counts) = self.0.get_mut(path) {
                counts[place].take(name, value);
            } else if value > 0.0 && self.0.len() < PROGRAMS_MAX {
                self.0.entry(path.to_owned()).or_default()[place].take(name, value);
            }
        }
    }

    /// Returns each program with such values, with the number of values in words.
    pub(super) fn texts(&self) -> impl Iterator<Item = (&str, String)> {
        let has_any = |(_, counts): &(&String, &[Count; COUNTED.len()])| counts.iter().any(|count| count.total > 0.0);
        self.0.iter().filter(has_any).map(|(path, counts)| {
            let words = counts.iter().zip(COUNTED).filter(|(count, _)| count.total > 0.0);
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a count, which is not negative"
            )]
            let words = words.map(|(count, (_, what))| format!("{} {what}", counted(count.total as usize, "value")));
            (path.as_str(), words.collect::<Vec<_>>().join(", "))
        })
    }
}
