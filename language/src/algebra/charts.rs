//! Where an activity is, as a number: for an explorer that keeps millions of states.
//!
//! The number is made of the content, so that it does not depend on which thread meets a configuration first.

use super::program::ChartProgram;
use crate::automaton::{Automaton, Configuration};
use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::{Arc, Mutex, PoisonError};

/// Whether a message would be looked at at once.
fn hears(configuration: &Configuration) -> bool {
    !configuration.is_idle() && !configuration.is_waiting()
}

/// The configurations of one activity that were met, by number. Copies share them.
#[derive(Clone, Debug)]
pub(super) struct Charts {
    /// The transitions with timers.
    timed: Vec<usize>,
    known: Arc<Mutex<BTreeMap<u64, Configuration>>>,
}

impl Charts {
    /// How many bytes the number has.
    pub(super) const LENGTH: usize = 8;

    pub(super) fn new(chart: &ChartProgram) -> Self {
        Self { timed: chart.timed.clone(), known: Arc::default() }
    }

    /// How many items there are: the number, whether a message would be looked at at once, and whether each timer is armed.
    pub(super) fn items(&self) -> usize {
        2 + self.timed.len()
    }

    /// The configuration of a number. Number 0 is an activity that does not run.
    pub(super) fn configuration(&self, automaton: &Automaton, number: u64) -> Configuration {
        let known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        known.get(&number).cloned().unwrap_or_else(|| Configuration::new(automaton))
    }

    /// The words of a configuration.
    pub(super) fn words(&self, configuration: Configuration) -> Vec<u64> {
        let armed: Vec<u64> = self.timed.iter().map(|&timed| u64::from(configuration.timer(timed).1)).collect();
        let hears = u64::from(hears(&configuration));
        [self.number(configuration), hears].into_iter().chain(armed).collect()
    }

    fn number(&self, configuration: Configuration) -> u64 {
        if configuration.is_idle() {
            return 0;
        }
        let mut hasher = DefaultHasher::new();
        configuration.hash(&mut hasher);
        let mut number = hasher.finish().max(1);
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        while known.get(&number).is_some_and(|other| *other != configuration) {
            number = number.wrapping_add(1).max(1);
        }
        known.entry(number).or_insert(configuration);
        number
    }

    /// Writes the words of a number.
    pub(super) fn unpack(&self, number: u64, words: &mut [u64]) {
        let known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let configuration = known.get(&number);
        words[0] = number;
        words[1] = u64::from(configuration.is_some_and(hears));
        for (word, &timed) in words[2..].iter_mut().zip(&self.timed) {
            *word = u64::from(configuration.is_some_and(|configuration| configuration.timer(timed).1));
        }
    }
}
