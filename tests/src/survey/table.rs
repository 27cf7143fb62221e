//! The results of the survey, row by row, and as text.

use super::{Outcome, Row};
use crate::simulation::Finish;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// The summary of a row.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// The number of missions.
    pub worlds: usize,
    /// The number of successful missions.
    pub success: usize,
    /// The number of successful missions within the force limits.
    pub strict: usize,
    /// The number of false successes: they reported success, but not everything was as required.
    pub false_successes: usize,
    /// The least true angle of a mission that reported success (deg), if one did.
    pub angle_min: Option<f64>,
    /// The largest force while the hand approached the handle (N), over all runs.
    pub hit: f64,
    /// The largest force while the door opened (N), over all runs.
    pub pull: f64,
    /// The largest force at any time (N), over all runs.
    pub worst: f64,
    /// The duration of the longest success (s); zero without a success.
    pub seconds: f64,
    /// The reasons of the missions that were not strict, the most frequent first.
    pub reasons: Vec<(String, usize)>,
}

impl Summary {
    /// Returns the summary of some outcomes.
    pub fn of<'a>(outcomes: impl IntoIterator<Item = &'a Outcome>) -> Self {
        let mut summary = Self {
            worlds: 0,
            success: 0,
            strict: 0,
            false_successes: 0,
            angle_min: None,
            hit: 0.0,
            pull: 0.0,
            worst: 0.0,
            seconds: 0.0,
            reasons: Vec::new(),
        };
        let mut reasons = BTreeMap::new();
        for outcome in outcomes {
            summary.worlds += 1;
            summary.success += usize::from(outcome.is_success());
            summary.strict += usize::from(outcome.is_strict());
            summary.false_successes += usize::from(outcome.is_false());
            if outcome.finish == Finish::Done {
                let least = summary.angle_min.map_or(outcome.angle, |least| least.min(outcome.angle));
                summary.angle_min = Some(least);
            }
            summary.hit = summary.hit.max(outcome.hit);
            summary.pull = summary.pull.max(outcome.pull);
            summary.worst = summary.worst.max(outcome.worst);
            if outcome.is_success() {
                summary.seconds = summary.seconds.max(outcome.seconds);
            }
            if !outcome.is_strict() {
                *reasons.entry(outcome.reason()).or_insert(0) += 1;
            }
        }
        summary.reasons = reasons.into_iter().collect();
        summary.reasons.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
        summary
    }
}

/// Returns the table as text: one line for each row, and one for all rows. Each reason has its count.
pub fn text(rows: &[(Row, Vec<Outcome>)]) -> String {
    let mut text = format!(
        "{:<28} {:>6} {:>8} {:>7} {:>6} {:>8} {:>6} {:>7} {:>8} {:>6}  {}\n",
        "row",
        "worlds",
        "success",
        "strict",
        "FALSE",
        "done deg",
        "hit N",
        "open N",
        "worst N",
        "s",
        "why the others ended"
    );
    let mut group = None;
    for (row, outcomes) in rows {
        if group.replace(row.group) != Some(row.group) {
            line(&mut text, &format!("-- {}", row.group.name()));
        }
        line(&mut text, &numbers(&row.name, &Summary::of(outcomes)));
    }
    let all = Summary { reasons: Vec::new(), ..Summary::of(rows.iter().flat_map(|(_, outcomes)| outcomes)) };
    line(&mut text, &numbers("-- all", &all));
    text
}

/// Returns each mission that was not strict, with everything needed to fly it again.
pub fn failures(rows: &[(Row, Vec<Outcome>)]) -> String {
    let mut text = String::new();
    for (row, outcomes) in rows {
        let failed = row.missions.iter().zip(outcomes).zip(1..).filter(|((_, outcome), _)| !outcome.is_strict());
        for ((mission, outcome), number) in failed {
            let (hit, pull, worst, angle) = (outcome.hit, outcome.pull, outcome.worst, outcome.angle);
            let numbers = format!("{angle:.1} deg, hit {hit:.0} N, open {pull:.0} N, worst {worst:.0} N");
            line(
                &mut text,
                &format!("{}/{number}: {}: {numbers}, {:.1} s", row.label(), outcome.reason(), outcome.seconds),
            );
            line(&mut text, &format!("    {}", mission.arguments));
            if let Some(meddling) = &mission.meddling {
                line(&mut text, &format!("    {:?} {} after {:?}", meddling.disruption, meddling.leaf, meddling.after));
            }
        }
    }
    text
}

/// Returns an angle (deg) as text, or an empty text without an angle.
pub(super) fn degrees(angle: Option<f64>) -> String {
    angle.map_or(String::new(), |angle| format!("{angle:.1}"))
}

fn numbers(name: &str, summary: &Summary) -> String {
    let Summary { worlds, success, strict, false_successes, angle_min, hit, pull, worst, seconds, reasons } = summary;
    let reasons: Vec<String> = reasons.iter().map(|(reason, count)| format!("{count} × {reason}")).collect();
    format!(
        "{name:<28} {worlds:>6} {success:>8} {strict:>7} {false_successes:>6} {:>8} {hit:>6.0} {pull:>7.0} {worst:>8.0} {seconds:>6.1}  {}",
        degrees(*angle_min),
        reasons.join("; ")
    )
}

fn line(text: &mut String, line: &str) {
    writeln!(text, "{}", line.trim_end()).expect("a text takes what is written");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_outcome_counts_once() {
        let good = Outcome {
            finish: Finish::Done,
            beyond: None,
            angle: 72.0,
            hit: 20.0,
            pull: 50.0,
            worst: 55.0,
            wrong: 0.0,
            seconds: 24.0,
        };
        let outcomes = [
            good.clone(),
            Outcome { hit: 31.0, ..good.clone() },
            Outcome { pull: 61.0, ..good.clone() },
            Outcome { angle: 59.9, ..good.clone() },
            Outcome { finish: Finish::Aborted("main/dooropensyst/approach: x".to_owned()), worst: 120.0, ..good },
        ];
        let summary = Summary::of(&outcomes);
        assert_eq!(summary.angle_min, Some(59.9));
        assert_eq!((summary.worlds, summary.success, summary.strict, summary.false_successes), (5, 3, 1, 1));
        assert!((summary.worst - 120.0).abs() < 1e-12);
        let reasons: Vec<&str> = summary.reasons.iter().map(|(reason, _)| reason.as_str()).collect();
        assert_eq!(reasons, ["FALSE", "approach: x", "done, but hit too hard", "done, but pulled too hard"]);
    }
}
