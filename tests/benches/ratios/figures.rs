//! Calculates ratios from samples, and makes the table.

use std::fmt::Write as _;
use std::time::Duration;

/// The median and the tail of one round.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Round {
    pub(crate) p50: Duration,
    pub(crate) p99: Duration,
}

impl Round {
    /// Returns the figures of a round's samples, or nothing without samples.
    pub(crate) fn of(mut samples: Vec<Duration>) -> Option<Self> {
        samples.sort_unstable();
        let at = |percent: usize| samples.get((samples.len() * percent / 100).min(samples.len().saturating_sub(1)));
        Some(Self { p50: *at(50)?, p99: *at(99)? })
    }

    /// Returns half of each figure, for one direction of a round trip.
    pub(crate) fn halved(self) -> Self {
        Self { p50: self.p50 / 2, p99: self.p99 / 2 }
    }

    /// Returns the figures of a round with one sample.
    pub(crate) fn single(sample: Duration) -> Self {
        Self { p50: sample, p99: sample }
    }
}

/// One subject. It is measured in every round.
#[derive(Clone, Debug, Default)]
pub(crate) struct Subject {
    rounds: Vec<Round>,
}

impl Subject {
    pub(crate) fn push(&mut self, round: Round) {
        self.rounds.push(round);
    }

    /// Returns the median of the rounds' medians, and the median of their tails.
    pub(crate) fn figures(&self) -> Round {
        let of = |part: fn(&Round) -> Duration| median(self.rounds.iter().map(part).collect()).unwrap_or_default();
        Round { p50: of(|round| round.p50), p99: of(|round| round.p99) }
    }

    /// Returns the time as a multiple of `base`: the median of the ratios of medians, round by round.
    pub(crate) fn ratio(&self, base: &Self) -> f64 {
        let ratios = self.rounds.iter().zip(&base.rounds);
        let mut ratios: Vec<f64> =
            ratios.map(|(one, other)| one.p50.as_secs_f64() / other.p50.as_secs_f64().max(1e-9)).collect();
        ratios.sort_by(f64::total_cmp);
        ratios.get(ratios.len() / 2).copied().unwrap_or(f64::NAN)
    }
}

fn median(mut of: Vec<Duration>) -> Option<Duration> {
    of.sort_unstable();
    of.get(of.len() / 2).copied()
}

/// The table of the whole benchmark.
#[derive(Debug, Default)]
pub(crate) struct Table {
    lines: Vec<[String; 5]>,
}

impl Table {
    /// Adds a heading. The two last words name the references for the two ratios.
    pub(crate) fn heading(&mut self, text: &str, first: &str, second: &str) {
        let (p50, p99) = ("p50".to_owned(), "p99".to_owned());
        self.lines.push(Default::default());
        self.lines.push([text.to_owned(), p50, p99, first.to_owned(), second.to_owned()]);
    }

    /// Adds a line with a subject. The ratios are already text.
    pub(crate) fn line(&mut self, text: &str, subject: &Subject, ratios: [String; 2]) {
        let (Round { p50, p99 }, [first, second]) = (subject.figures(), ratios);
        let p99 = if subject.rounds.iter().all(|round| round.p50 == round.p99) { String::new() } else { human(p99) };
        self.lines.push([format!("  {text}"), human(p50), p99, first, second]);
    }

    /// Returns the table as text.
    pub(crate) fn text(&self) -> String {
        let width = |column: usize| self.lines.iter().map(|line| line[column].chars().count()).max().unwrap_or(0);
        let widths: Vec<usize> = (0..5).map(width).collect();
        let mut text = String::new();
        for [name, figures @ ..] in &self.lines {
            let mut line = format!("{name:<width$}", width = widths[0]);
            for (figure, width) in figures.iter().zip(&widths[1..]) {
                // Writing to a string cannot fail.
                write!(line, "   {figure:>width$}").unwrap_or_default();
            }
            text.push_str(line.trim_end());
            text.push('\n');
        }
        text
    }
}

/// Returns a ratio as a cell, with the target if it has one.
pub(crate) fn cell(ratio: f64, target: Option<f64>) -> String {
    match target {
        None => format!("{ratio:.2}"),
        Some(target) if ratio <= target => format!("{ratio:.2} (reached: {target})"),
        Some(target) => format!("{ratio:.2} (missed: {target})"),
    }
}

fn human(time: Duration) -> String {
    let micros = time.as_secs_f64() * 1e6;
    if micros < 1e3 { format!("{micros:.1} µs") } else { format!("{:.1} ms", micros / 1e3) }
}
