//! Every signal of a run: its latest value and its peak.

use crate::logic::mission::short;
use comms::logic::signals::Signal;
use std::collections::BTreeMap;
use std::time::Duration;

/// The most signals that are kept. Further signals are left out.
pub const TRACKS_MAX: usize = 10_000;

/// One signal of one program.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// Absolute path of the program.
    pub path: String,
    /// The signal's name.
    pub name: String,
    /// The unit of the signal; empty if it has none.
    pub unit: String,
    /// Whether it belongs on a one-line display.
    pub headline: bool,
    /// Its latest value.
    pub last: f64,
    /// The time since GO of the latest value.
    pub last_at: Duration,
    /// Its largest magnitude.
    pub peak: f64,
    /// The time since GO of the peak.
    pub peak_at: Duration,
}

impl Track {
    /// Formats `value` with as many decimals as suit the range of the signal so far.
    pub fn text(&self, value: f64) -> String {
        let decimals = match self.peak {
            peak if peak >= 1000.0 => 0,
            peak if peak >= 10.0 => 1,
            peak if peak >= 1.0 => 2,
            peak if peak > 0.0 => 3,
            _ => 1,
        };
        let text = format!("{value:.decimals$}");
        // This avoids the text `-0.000`.
        let is_zero = text.bytes().all(|byte| matches!(byte, b'-' | b'0' | b'.'));
        if is_zero { text.trim_start_matches('-').to_owned() } else { text }
    }
}

/// The signals in the order in which they first appeared. A signal is found by path and name.
#[derive(Debug, Clone, Default)]
pub(super) struct Tracks {
    all: Vec<Track>,
    index: BTreeMap<String, BTreeMap<String, usize>>,
}

impl Tracks {
    /// Adds a value. Returns the index of its track, or nothing if there are too many tracks.
    pub(super) fn push(&mut self, path: &str, at: Duration, signal: &Signal) -> Option<usize> {
        let known = self.index.get(path).and_then(|names| names.get(signal.name.as_str())).copied();
        let index = match known {
            Some(index) => index,
            None => self.insert(path, signal)?,
        };
        let track = &mut self.all[index];
        if at >= track.last_at {
            (track.last, track.last_at) = (signal.value, at);
        }
        if signal.value.abs() > track.peak {
            (track.peak, track.peak_at) = (signal.value.abs(), at);
        }
        Some(index)
    }

    pub(super) fn all(&self) -> &[Track] {
        &self.all
    }

    pub(super) fn title(&self, track: &Track) -> String {
        let twins = self.all.iter().filter(|other| other.name == track.name && other.headline == track.headline);
        if twins.count() > 1 { format!("{} of {}", track.name, short(&track.path)) } else { track.name.clone() }
    }

    fn insert(&mut self, path: &str, signal: &Signal) -> Option<usize> {
        if self.all.len() == TRACKS_MAX {
            return None;
        }
        self.index.entry(path.to_owned()).or_default().insert(signal.name.clone(), self.all.len());
        self.all.push(Track {
            path: path.to_owned(),
            name: signal.name.clone(),
            unit: signal.unit.clone(),
            headline: signal.headline,
            last: signal.value,
            last_at: Duration::ZERO,
            peak: 0.0,
            peak_at: Duration::ZERO,
        });
        Some(self.all.len() - 1)
    }
}
