//! The record of a run, read back.

use cli::io::recorder;
use cli::logic::mission::{Mission, Phase};
use cli::logic::record::{Entry, Run};
use comms::io::clock::now;
use comms::logic::time::Time;
use node::logic::protocol::{Change, Ending, Report};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The record of a run.
#[derive(Debug)]
pub struct Trace {
    folder: PathBuf,
    run: Run,
    mission: Mission,
}

/// A value of a signal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// When the value reached the recorder, since GO.
    pub at: Duration,
    /// When the value was published, on the clock of its host.
    pub stamp: Time,
    /// In the signal's unit.
    pub value: f64,
}

impl Trace {
    /// Reads the record in `folder`.
    ///
    /// # Panics
    /// Panics if the record is missing or damaged.
    pub fn read(folder: &Path) -> Self {
        let run = recorder::read(&folder.join(recorder::FILE)).unwrap_or_else(|error| panic!("{error}"));
        assert_eq!(run.damage, None, "{folder:?}");
        let mission = run.mission();
        Self { folder: folder.to_owned(), run, mission }
    }

    /// Reads the part of the record in `folder` that has been written so far.
    ///
    /// # Panics
    /// Panics if the record is missing.
    pub fn so_far(folder: &Path) -> Self {
        let run = recorder::read(&folder.join(recorder::FILE)).unwrap_or_else(|error| panic!("{error}"));
        Self { folder: folder.to_owned(), mission: run.mission(), run }
    }

    /// Returns whether the run has a complete page beside its record. Such a page closes its last tag.
    pub fn has_page(&self) -> bool {
        let page = std::fs::read_to_string(self.folder.join("report.html")).unwrap_or_default();
        page.trim_end().ends_with("</html>")
    }

    /// Returns how `main` ended, and when, since GO.
    ///
    /// # Panics
    /// Panics if `main` did not end.
    pub fn finished(&self) -> (Ending, Duration) {
        let finished = self.reports().find_map(|report| match report {
            Report::Finished { ending, at, .. } => Some((ending.clone(), *at)),
            Report::Accepted { .. }
            | Report::Prepared { .. }
            | Report::Connected { .. }
            | Report::Go { .. }
            | Report::Process { .. }
            | Report::Programs { .. }
            | Report::Changed { .. }
            | Report::Stepped { .. }
            | Report::Unchanged { .. }
            | Report::Replanned { .. }
            | Report::Aligned { .. }
            | Report::BeganLate { .. }
            | Report::Omitted { .. }
            | Report::Refused { .. } => None,
        });
        finished.expect("the record of a run that is over has its end")
    }

    /// Returns the changes of the process with this path, in the order of the record.
    pub fn changes(&self, wanted: &str) -> Vec<&Change> {
        let changes = self.reports().filter_map(|report| match report {
            Report::Process { path, change, .. } => (path == wanted).then_some(change),
            Report::Accepted { .. }
            | Report::Prepared { .. }
            | Report::Connected { .. }
            | Report::Go { .. }
            | Report::Programs { .. }
            | Report::Changed { .. }
            | Report::Stepped { .. }
            | Report::Unchanged { .. }
            | Report::Replanned { .. }
            | Report::Aligned { .. }
            | Report::BeganLate { .. }
            | Report::Omitted { .. }
            | Report::Refused { .. }
            | Report::Finished { .. } => None,
        });
        changes.collect()
    }

    /// Returns the changes of all processes, in the order of the record: the time since GO, the path of the process, and the
    /// change.
    pub fn all_changes(&self) -> Vec<(Duration, &str, &Change)> {
        let mut changes = Vec::new();
        for report in self.reports() {
            if let Report::Process { path, change, at } = report {
                changes.push((*at, path.as_str(), change));
            }
        }
        changes
    }

    /// Returns the hosts that could not confirm that no part of the deployment runs there any more.
    pub fn unconfirmed(&self) -> Vec<&str> {
        let mut all = Vec::new();
        for report in self.reports() {
            if let Report::Finished { unconfirmed, .. } = report {
                all.extend(unconfirmed.iter().map(String::as_str));
            }
        }
        all
    }

    /// Returns the phase with `part` in its name.
    ///
    /// # Panics
    /// Panics if the phase is missing.
    pub fn phase(&self, part: &str) -> &Phase {
        let phases = self.mission.phases();
        phases.iter().find(|phase| phase.name.contains(part)).unwrap_or_else(|| panic!("no phase `{part}`: {phases:?}"))
    }

    /// Returns whether nothing was recorded.
    pub const fn is_empty(&self) -> bool {
        self.run.entries.is_empty()
    }

    /// Returns the samples of a signal of the program with this path.
    pub fn signal(&self, program: &str, name: &str) -> Vec<Sample> {
        let sample = |entry: &Entry| match entry {
            Entry::Signals { path, at, sample } if path == program => {
                let signal = sample.values.iter().find(|signal| signal.name == name)?;
                Some(Sample { at: *at, stamp: sample.stamp, value: signal.value })
            }
            Entry::Signals { .. }
            | Entry::Report(_)
            | Entry::Output { .. }
            | Entry::Port { .. }
            | Entry::Missing { .. } => None,
        };
        let mut samples: Vec<Sample> = self.run.entries.iter().filter_map(sample).collect();
        // A peak between two samples is recorded after the second sample.
        samples.sort_by_key(|sample| sample.at);
        samples
    }

    fn reports(&self) -> impl Iterator<Item = &Report> {
        self.run.entries.iter().filter_map(|entry| match entry {
            Entry::Report(report) => Some(report),
            Entry::Signals { .. } | Entry::Output { .. } | Entry::Port { .. } | Entry::Missing { .. } => None,
        })
    }
}

/// Returns the largest magnitude of the samples that arrived between `from` and `to`.
pub fn peak(samples: &[Sample], from: Duration, to: Duration) -> f64 {
    let within = samples.iter().filter(|sample| (from..=to).contains(&sample.at));
    within.map(|sample| sample.value.abs()).fold(f64::NAN, f64::max)
}

/// A part of the time of a run, on the clock of the hosts. The end is not part of it.
#[derive(Clone, Copy, Debug)]
pub struct Window {
    /// The beginning.
    pub from: Time,
    /// The end.
    pub to: Time,
}

impl Window {
    /// Returns whether a sample was measured in this window.
    pub fn contains(&self, sample: &Sample) -> bool {
        (self.from..self.to).contains(&sample.stamp)
    }
}

/// Runs `act`, and returns when it began and when it ended.
pub fn window(act: impl FnOnce()) -> Window {
    let from = now();
    act();
    Window { from, to: now() }
}

/// Returns the greatest rate of a whole second. Other work on the machine slows some seconds down, but a lasting cause slows
/// all of them down.
pub fn best_second(samples: &[Sample], window: Window) -> f64 {
    let second = Duration::from_secs(1);
    let begins = std::iter::successors(Some(window.from), |begin| Some(*begin + second));
    let seconds = begins.map(|from| Window { from, to: from + second }).take_while(|second| second.to <= window.to);
    let has_rate = |second: &Window| samples.iter().filter(|sample| second.contains(sample)).count() > 1;
    seconds.filter(has_rate).map(|second| rate(samples, second)).fold(0.0, f64::max)
}

/// Returns the growth of a count for each second in a window, on the clock of the hosts.
///
/// # Panics
/// Panics if fewer than two samples arrived in this time.
pub fn rate(samples: &[Sample], window: Window) -> f64 {
    let mut within = samples.iter().filter(|sample| window.contains(sample));
    let (first, last) = (within.next().expect("samples came"), within.next_back().expect("samples came"));
    (last.value - first.value) / (last.stamp - first.stamp).as_secs_f64()
}
