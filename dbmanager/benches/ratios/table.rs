//! Computes ratios from samples, and prints them as one table.

use std::fmt::Write as _;
use std::time::Duration;

/// Samples of one subject, round by round.
#[derive(Debug, Default)]
pub(crate) struct Samples {
    rounds: Vec<Vec<Duration>>,
}

impl Samples {
    /// Adds a round.
    pub(crate) fn push(&mut self, mut round: Vec<Duration>) {
        round.sort_unstable();
        self.rounds.push(round);
    }

    /// Returns a quantile, in percent: the median over the rounds.
    pub(crate) fn quantile(&self, percent: usize) -> Duration {
        let mut of: Vec<Duration> = self.rounds.iter().map(|round| quantile(round, percent)).collect();
        of.sort_unstable();
        of.get(of.len() / 2).copied().unwrap_or_default()
    }

    /// Returns the ratio to `base`: the median, over the rounds, of the ratio of the medians.
    pub(crate) fn ratio(&self, base: &Self) -> f64 {
        let median = |round: &Vec<Duration>| quantile(round, 50).as_secs_f64().max(1e-9);
        let mut ratios: Vec<f64> =
            self.rounds.iter().zip(&base.rounds).map(|(one, other)| median(one) / median(other)).collect();
        ratios.sort_by(f64::total_cmp);
        ratios.get(ratios.len() / 2).copied().unwrap_or(f64::NAN)
    }

    /// Returns the median and the tail as text.
    pub(crate) fn text(&self) -> String {
        format!("{} (p99 {})", micros(self.quantile(50)), micros(self.quantile(99)))
    }
}

fn quantile(sorted: &[Duration], percent: usize) -> Duration {
    sorted.get((sorted.len() * percent / 100).min(sorted.len().saturating_sub(1))).copied().unwrap_or_default()
}

fn micros(time: Duration) -> String {
    if time < Duration::from_micros(10) {
        format!("{} ns", time.as_nanos())
    } else {
        format!("{} µs", time.as_micros())
    }
}

/// How far a ratio may go.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Reach {
    /// The ratio has to be at most this.
    AtMost(f64),
    /// The ratio has to be at least this.
    AtLeast(f64),
    /// There only to be compared.
    None,
}

/// The table of the whole benchmark: the subject, the figure, its ratio, and the limit of the ratio.
#[derive(Debug, Default)]
pub(crate) struct Table {
    lines: Vec<[String; 4]>,
}

impl Table {
    /// Adds a line; `of` names the reference of the ratio.
    pub(crate) fn line(&mut self, what: &str, figure: &str, (ratio, of): (f64, &str), reach: Reach) {
        let ratio_text = if ratio.is_nan() { String::new() } else { format!("{ratio:.2} {of}").trim_end().to_owned() };
        let reach = match reach {
            Reach::AtMost(most) if ratio <= most => format!("<= {most}"),
            Reach::AtLeast(least) if ratio >= least => format!(">= {least}"),
            Reach::AtMost(most) => format!("<= {most}: missed"),
            Reach::AtLeast(least) => format!(">= {least}: missed"),
            Reach::None => String::new(),
        };
        self.lines.push([what.to_owned(), figure.to_owned(), ratio_text, reach]);
    }

    /// Adds a line without a ratio, for comparison.
    pub(crate) fn note(&mut self, what: &str, figure: &str) {
        self.line(what, figure, (f64::NAN, ""), Reach::None);
    }

    /// Returns the table as text.
    pub(crate) fn text(&self) -> String {
        let width = |column: usize| self.lines.iter().map(|line| line[column].chars().count()).max().unwrap_or(0);
        let widths = [width(0), width(1), width(2)];
        let mut text = String::new();
        for [what, figure, ratio, reach] in &self.lines {
            let [a, b, c] = widths;
            // Writing to a string cannot fail.
            writeln!(text, "{what:a$}  {figure:b$}  {ratio:c$}  {reach}").unwrap_or_default();
        }
        text
    }
}
