//! The steps of a replayed process. `dca replay` takes them from a record; a stand-in program plays them in place of the process.
//!
//! The encoding of a step shows its end, so a file contains the steps one after the other.

use serde::{Deserialize, Serialize};
use std::time::Duration;

/// The controller type that plays steps.
pub const REPLAY: &str = "Replay";
/// The most bytes of steps of one process.
pub const STEPS_MAX: u64 = 1 << 30;

/// One step. Times are measured from the beginning of the activation.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Step {
    /// An activation begins.
    Begin,
    /// A value leaves an output.
    Value {
        /// The time of the value.
        at: Duration,
        /// The index of the output in the list of outputs.
        port: u32,
        /// The encoded value.
        bytes: Vec<u8>,
        /// The time of measurement in the value, if it has one.
        stamp: Option<Stamp>,
    },
    /// The process is done.
    Done {
        /// The time of the end.
        at: Duration,
        /// The value for the next process.
        value: Vec<u8>,
    },
    /// The process has failed.
    Aborted {
        /// The time of the end.
        at: Duration,
        /// Why, for a person.
        reason: String,
    },
}

/// The time of measurement in a value, a number of seconds on the clock of a host. The stand-in replaces it by a time on its own
/// clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stamp {
    /// The index of the number in the encoded value.
    pub place: u32,
    /// The time of the measurement, in nanoseconds since the beginning of the activation.
    pub nanos: i64,
}

/// Appends a step to the bytes of a file.
///
/// # Errors
/// If the step cannot be encoded.
pub fn append(step: &Step, bytes: Vec<u8>) -> Result<Vec<u8>, postcard::Error> {
    postcard::to_extend(step, bytes)
}

/// Reads the first step from the bytes of a file. Returns the step and the bytes after it. None if the bytes do not begin with a step.
pub fn take(bytes: &[u8]) -> Option<(Step, &[u8])> {
    postcard::take_from_bytes(bytes).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_read_as_they_were_written() {
        let at = Duration::from_nanos(1_500_000_001);
        let steps = [
            Step::Begin,
            Step::Value { at, port: 1, bytes: vec![7; 300], stamp: None },
            Step::Value { at, port: 2, bytes: vec![8; 8], stamp: Some(Stamp { place: 0, nanos: -3 }) },
            Step::Done { at, value: vec![] },
            Step::Aborted { at, reason: "it slips".to_owned() },
        ];
        let bytes = steps.iter().fold(Vec::new(), |bytes, step| append(step, bytes).unwrap());
        let mut rest = &bytes[..];
        for step in &steps {
            let (found, behind) = take(rest).unwrap();
            assert_eq!(&found, step);
            rest = behind;
        }
        assert_eq!((rest.len(), take(rest)), (0, None));
        assert_eq!(take(&bytes[..5]).map(|(step, _)| step), Some(Step::Begin));
        assert_eq!(take(&[9, 9]), None);
    }
}
