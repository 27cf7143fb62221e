//! The values inside a group for people who watch them. While no client watches, nothing is copied, and no clock is
//! read.

use crate::sdk::module::{InnerValue, Outlets};

/// The outputs of members that lead to other members.
#[derive(Debug)]
pub(super) struct InnerTaps {
    /// How many values have left each output since the start of the program.
    numbers: Vec<u64>,
    /// Whether each output is watched, as of the end of the last turn.
    heard: Vec<bool>,
    /// The values to be shown at the end of this turn: for each output at most one per calculation.
    values: Vec<InnerValue>,
}

impl InnerTaps {
    pub(super) fn new(count: usize) -> Self {
        Self { numbers: vec![0; count], heard: vec![false; count], values: Vec::new() }
    }

    /// Counts a value. If the output is watched, keeps the value to be shown.
    pub(super) fn pass(&mut self, at: usize, bytes: &[u8]) {
        let (Some(number), Some(is_heard)) = (self.numbers.get_mut(at), self.heard.get(at)) else { return };
        *number += 1;
        if *is_heard {
            self.values.push(InnerValue { at, number: *number, bytes: bytes.to_vec() });
        }
    }

    /// Shows the kept values, and finds out which outputs are watched from now on.
    pub(super) fn show(&mut self, outlets: &mut dyn Outlets) {
        if !self.heard.is_empty() {
            outlets.show_inner(&mut self.values, &mut self.heard);
            self.values.clear();
        }
    }

    /// Forgets the values that were not shown.
    pub(super) fn clear(&mut self) {
        self.values.clear();
    }
}
