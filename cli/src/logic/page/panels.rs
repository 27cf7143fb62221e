//! Groups signals into pictures.

use crate::logic::mission::{Mission, Track};
use crate::logic::record::{Entry, Run};
use comms::logic::signals::COUNTS;
use std::collections::BTreeMap;
use std::time::Duration;

/// The most curves in one picture: the number of distinguishable colours.
pub(super) const CURVES_MAX: usize = 8;
/// Words that distinguish related signals.
const PARTS: [&str; 12] = ["x", "y", "z", "rx", "ry", "rz", "left", "right", "roll", "pitch", "yaw", "w"];

/// A picture of signals with the same unit and the same kind of name.
#[derive(Debug)]
pub(super) struct Panel {
    pub(super) title: String,
    pub(super) unit: String,
    /// Whether one of its signals is a headline.
    pub(super) headline: bool,
    pub(super) curves: Vec<Curve>,
}

/// One signal over time.
#[derive(Debug)]
pub(super) struct Curve {
    pub(super) title: String,
    pub(super) points: Vec<(Duration, f64)>,
}

/// Returns the pictures of a run, first those with headline signals, then the others in the order of first appearance.
/// Also returns the signals that never changed, as text, since they need no picture.
pub(super) fn panels(run: &Run, mission: &Mission) -> (Vec<Panel>, Vec<String>) {
    let points = points(run);
    let mut groups: Vec<((&str, String), Vec<usize>)> = Vec::new();
    let mut constants = Vec::new();
    for (index, track) in mission.tracks().iter().enumerate() {
        let is_count = COUNTS.contains(&track.name.as_str());
        if is_count && track.peak <= 0.0 {
            // Every program has these counts, so only the others are worth a word.
            continue;
        }
        if !track.headline && is_constant(&points, track) {
            constants.push(
                format!("{} {} {}", mission.title(track), track.text(track.last), track.unit).trim_end().to_owned(),
            );
            continue;
        }
        let key = (track.unit.as_str(), kind(&track.name));
        match groups.iter_mut().find(|(known, _)| *known == key) {
            Some((_, group)) => group.push(index),
            None => groups.push((key, vec![index])),
        }
    }
    let headline = |group: &[usize]| group.iter().any(|index| mission.tracks()[*index].headline);
    groups.sort_by_key(|(_, group)| !headline(group));
    let mut panels = Vec::new();
    for ((unit, kind), group) in groups {
        let stem = common_stem(group.iter().map(|index| mission.tracks()[*index].name.as_str())).unwrap_or(kind);
        let parts = group.chunks(CURVES_MAX).count();
        for (part, tracks) in group.chunks(CURVES_MAX).enumerate() {
            let mut title = if tracks.len() == 1 { mission.tracks()[tracks[0]].name.clone() } else { stem.clone() };
            if parts > 1 {
                title.push_str(&format!(" ({} of {parts})", part + 1));
            }
            let curves = tracks.iter().map(|index| curve(mission, *index, &points)).collect();
            panels.push(Panel { title, unit: unit.to_owned(), headline: headline(&group), curves });
        }
    }
    (panels, constants)
}

fn is_constant(points: &Points<'_>, track: &Track) -> bool {
    let points = points.get(&(track.path.as_str(), track.name.as_str()));
    points.is_none_or(|points| points.windows(2).all(|pair| pair[0].1.total_cmp(&pair[1].1).is_eq()))
}

/// Every sample, by path and name.
type Points<'a> = BTreeMap<(&'a str, &'a str), Vec<(Duration, f64)>>;

fn points(run: &Run) -> Points<'_> {
    let mut points = Points::new();
    for entry in &run.entries {
        let Entry::Signals { path, at, sample } = entry else { continue };
        for signal in sample.values.iter().filter(|signal| signal.value.is_finite()) {
            points.entry((path, &signal.name)).or_default().push((*at, signal.value));
        }
    }
    points
}

fn curve(mission: &Mission, index: usize, points: &Points<'_>) -> Curve {
    let track = &mission.tracks()[index];
    let mut points = points.get(&(track.path.as_str(), track.name.as_str())).cloned().unwrap_or_default();
    // Samples of one program are in order, also if samples of other programs are between them. This is for records of other tools.
    points.sort_by_key(|(at, _)| *at);
    Curve { title: mission.title(track), points }
}

/// Returns the words of a name without numbers and parts: `joint 3 speed` has the stem `joint speed`.
fn stem(name: &str) -> Vec<&str> {
    let word = |word: &&str| !word.bytes().all(|byte| byte.is_ascii_digit()) && !PARTS.contains(word);
    name.split_whitespace().filter(word).map(|word| word.trim_end_matches(|end: char| end.is_ascii_digit())).collect()
}

/// Returns the last word of the stem, which is the kind: `door angle` and `lever angle` are both an angle.
fn kind(name: &str) -> String {
    stem(name).last().copied().unwrap_or(name).to_owned()
}

fn common_stem<'a>(mut names: impl Iterator<Item = &'a str>) -> Option<String> {
    let first = stem(names.next()?);
    names.all(|name| stem(name) == first).then(|| first.join(" ")).filter(|stem| !stem.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_mean_the_same_kind_meet() {
        for (name, expect) in
            [("door angle", "angle"), ("joint 3 speed", "speed"), ("force x", "force"), ("q1", "q"), ("7", "7")]
        {
            assert_eq!(kind(name), expect);
        }
        assert_eq!(common_stem(["joint 1 speed", "joint 2 speed"].into_iter()).as_deref(), Some("joint speed"));
        assert_eq!(common_stem(["door angle", "lever angle"].into_iter()), None);
    }
}
