//! The record of a mission that is being watched, if it is kept. Each gap in the record is reported once.

use super::record_folder::end_record;
use crate::io::observer::{WireValue, WireValues};
use crate::io::recorder::Recorder;
use crate::logic::mission::Files;
use crate::logic::record::{Entry, Port, WireName};
use crate::logic::value_queue::Queued;
use crate::output::Output;
use node::logic::output_lines::GAP;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

/// The record of a mission.
pub(super) struct Recording {
    recorder: Option<Recorder>,
    is_broken_off: bool,
    /// The values of wires that wait, and the counts of missing values.
    values: Arc<WireValues>,
    /// The processes whose output is not recorded completely.
    lacking: BTreeSet<String>,
}

impl Recording {
    pub(super) fn new(recorder: Option<Recorder>, values: Arc<WireValues>) -> Self {
        Self { recorder, is_broken_off: false, values, lacking: BTreeSet::new() }
    }

    /// Returns whether a record is kept.
    pub(super) const fn is_kept(&self) -> bool {
        self.recorder.is_some()
    }

    /// Adds an entry to the record.
    pub(super) fn push(&mut self, entry: Entry) {
        if let Some(recorder) = &self.recorder {
            recorder.push(entry);
        }
    }

    /// Adds the value of a wire to the record. Values that the queue has dropped are counted.
    pub(super) fn value(&mut self, queued: Queued<WireName, WireValue>, at: Duration, port: Option<&Port>) {
        let Queued { source: wire, value: WireValue { bytes, .. }, lost } = queued;
        let message = port.and_then(|port| port.message.clone());
        let WireName { from, to } = wire.clone();
        let is_kept = self.recorder.as_ref().is_some_and(|one| one.push(Entry::Port { from, to, at, bytes, message }));
        self.values.missing().lose(&wire, lost + u64::from(!is_kept));
    }

    /// Adds the counts of missing values to the record. A count that does not fit now is added later.
    pub(super) fn count_missing(&self, at: Duration) {
        let Some(recorder) = &self.recorder else { return };
        for (wire, lost) in self.values.queue.lost() {
            self.values.missing().lose(&wire, lost);
        }
        let mut missing = self.values.missing();
        for (wire, count) in missing.pending() {
            if recorder.push(Entry::Missing { wire: wire.clone(), at, count }) {
                missing.recorded(&wire, count);
            }
        }
    }

    /// If the record breaks off, prints this once. The mission continues.
    pub(super) fn watch(&mut self, output: &mut Output) {
        if !self.is_broken_off && self.recorder.as_ref().is_some_and(Recorder::has_broken_off) {
            self.is_broken_off = true;
            output.note("warning: the record breaks off here: it cannot be written any more. The mission goes on");
        }
    }

    /// Prints once for each process that some of its output is missing, if `text` says so.
    pub(super) fn watch_output(&mut self, path: &str, text: &str, output: &mut Output) {
        if text.contains(GAP) && self.lacking.insert(path.to_owned()) {
            output.note(&format!(
                "warning: some output of `{path}` is not recorded: it writes faster than its output is read"
            ));
        }
    }

    /// Completes the record of a mission, or drops it if the mission has never begun. Returns its files, and whether all is kept.
    pub(super) fn finish(&mut self, has_begun: bool, output: &mut Output) -> (Files, Result<(), anyhow::Error>) {
        match self.recorder.take() {
            Some(recorder) if !has_begun => {
                recorder.discard();
                (Files::default(), Ok(()))
            }
            Some(recorder) => {
                let (mut files, kept) = end_record(recorder, output);
                files.missing = self.values.missing().sentences();
                (files, kept)
            }
            None => (Files::default(), Ok(())),
        }
    }
}
