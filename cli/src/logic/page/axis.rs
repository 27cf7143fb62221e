//! The axis of time with the phases, which every picture shares, and the axes of values.

use crate::logic::mission::{Mission, seconds};
use crate::logic::page::text::escape;
use std::time::Duration;

/// Width of every picture, in its own units.
pub(super) const WIDTH: f64 = 1160.0;
/// Where the axis begins: left of it is room for names.
pub(super) const LEFT: f64 = 170.0;
/// Where it ends.
pub(super) const RIGHT: f64 = WIDTH - 12.0;
/// Height of the strip with the names of the phases.
const STRIP: f64 = 22.0;
/// About how wide a letter is.
const LETTER: f64 = 6.4;

/// Time since GO across a picture.
#[derive(Debug)]
pub(crate) struct TimeAxis {
    begin: f64,
    end: f64,
    bands: Vec<Band>,
}

#[derive(Debug)]
struct Band {
    number: usize,
    name: String,
    begin: f64,
    end: f64,
}

impl TimeAxis {
    pub(super) fn new(mission: &Mission) -> Self {
        let now = mission.now();
        let bands = mission.phases().iter().enumerate().map(|(index, phase)| Band {
            number: mission.phases_dropped() + index + 1,
            name: phase.name.clone(),
            begin: phase.begin.as_secs_f64(),
            end: phase.end.unwrap_or(now).as_secs_f64(),
        });
        Self { begin: 0.0, end: now.as_secs_f64().max(0.1), bands: bands.collect() }
    }

    /// Returns an axis without phases.
    pub(crate) fn plain(begin: Duration, end: Duration) -> Self {
        let begin = begin.as_secs_f64();
        Self { begin, end: end.as_secs_f64().max(begin + 0.1), bands: Vec::new() }
    }

    /// Returns whether a time is before the axis begins.
    pub(super) fn is_before(&self, time: Duration) -> bool {
        time.as_secs_f64() < self.begin
    }

    /// Returns where a time is.
    pub(super) fn x(&self, time: Duration) -> f64 {
        self.x_of(time.as_secs_f64())
    }

    fn x_of(&self, time: f64) -> f64 {
        LEFT + (RIGHT - LEFT) * ((time - self.begin) / (self.end - self.begin)).clamp(0.0, 1.0)
    }

    /// Returns the phases as bands behind a picture of this height, and the cursor before it.
    pub(super) fn behind(&self, height: f64) -> String {
        let band = |(index, band): (usize, &Band)| {
            let (x, end) = (self.x_of(band.begin), self.x_of(band.end));
            let kind = index % 2;
            format!(
                "<rect class=\"band b{kind}\" x=\"{x:.1}\" y=\"0\" width=\"{:.1}\" height=\"{height}\"/>\n",
                end - x
            )
        };
        self.bands.iter().enumerate().map(band).collect()
    }

    /// Returns the line that the script moves.
    pub(super) fn cursor(&self, height: f64) -> String {
        format!("<line class=\"cursor\" x1=\"0\" x2=\"0\" y1=\"0\" y2=\"{height}\" visibility=\"hidden\"/>\n")
    }

    /// Returns lines and numbers of the axis under a picture of this height.
    pub(super) fn ticks(&self, height: f64) -> String {
        let (step, decimals) = step((self.end - self.begin) / 10.0);
        let mut text = String::new();
        // Adding zero turns -0 into 0.
        let mut tick = (self.begin / step - 1e-9).ceil() * step + 0.0;
        while tick <= self.end {
            let x = self.x_of(tick);
            let unit = if tick + step > self.end { " s" } else { "" };
            text.push_str(&format!(
                "<line class=\"grid\" x1=\"{x:.1}\" x2=\"{x:.1}\" y1=\"0\" y2=\"{height}\"/>\
                 <text class=\"tick\" x=\"{x:.1}\" y=\"{}\" text-anchor=\"middle\">{tick:.decimals$}{unit}</text>\n",
                height + 14.0
            ));
            tick += step;
        }
        text
    }

    /// Returns the strip with numbers and names of the phases.
    pub(super) fn strip(&self) -> String {
        let mut text = svg("strip", STRIP, "phases");
        text.push_str(&format!(
            "<text class=\"lane\" x=\"{}\" y=\"15\" text-anchor=\"end\">phase</text>\n",
            LEFT - 8.0
        ));
        text.push_str(&self.behind(STRIP));
        for band in &self.bands {
            let (x, end) = (self.x_of(band.begin), self.x_of(band.end));
            let (number, name) = (band.number, escape(&band.name));
            let long = format!("{number} {}", band.name);
            let shown = if fits(&long, end - x) {
                format!("{number} {name}")
            } else if fits(&number.to_string(), end - x) {
                number.to_string()
            } else {
                String::new()
            };
            let (begin, end) = (Duration::from_secs_f64(band.begin), Duration::from_secs_f64(band.end));
            text.push_str(&format!(
                "<g class=\"phase\" data-begin=\"{:.3}\" data-end=\"{:.3}\" data-name=\"{number} {name}\">\
                 <title>{number} {name}: {} to {}</title><text x=\"{:.1}\" y=\"15\">{shown}</text></g>\n",
                band.begin,
                band.end,
                seconds(begin),
                seconds(end),
                x + 4.0
            ));
        }
        text.push_str(&self.cursor(STRIP));
        text.push_str("</svg>\n");
        text
    }

    /// Returns the time at the right end, for the script.
    pub(super) fn end(&self) -> f64 {
        self.end
    }
}

/// Returns whether a text has room in a width of the picture.
pub(super) fn fits(text: &str, width: f64) -> bool {
    let letters = u32::try_from(text.chars().count()).unwrap_or(u32::MAX);
    f64::from(letters) * LETTER + 8.0 < width
}

/// Returns the opening of a picture.
pub(super) fn svg(class: &str, height: f64, label: &str) -> String {
    let label = escape(label);
    format!("<svg class=\"{class}\" viewBox=\"0 0 {WIDTH} {height}\" role=\"img\" aria-label=\"{label}\">\n")
}

/// An axis of values, upwards.
#[derive(Debug)]
pub(super) struct ValueAxis {
    low: f64,
    high: f64,
    step: f64,
    decimals: usize,
    height: f64,
}

impl ValueAxis {
    /// Returns an axis of this height that holds everything from `low` to `high`, and zero unless that is far away. It
    /// ends on quarters of a step: whole steps would leave half a picture empty.
    pub(super) fn new(low: f64, high: f64, height: f64) -> Self {
        let far = (high - low) < 0.2 * low.abs().max(high.abs());
        let (low, high) = if far { (low, high) } else { (low.min(0.0), high.max(0.0)) };
        let span = if high - low > 0.0 { high - low } else { 1.0 };
        let (step, decimals) = step(span / 4.0);
        let quarter = step / 4.0;
        let (low, mut high) = ((low / quarter).floor() * quarter, (high / quarter).ceil() * quarter);
        if high <= low {
            high = low + step;
        }
        Self { low, high, step, decimals, height }
    }

    pub(super) fn y(&self, value: f64) -> f64 {
        self.height * (self.high - value) / (self.high - self.low)
    }

    /// Returns lines and numbers.
    pub(super) fn ticks(&self) -> String {
        let mut text = String::new();
        let mut tick = (self.low / self.step - 1e-9).ceil() * self.step;
        while tick <= self.high + 1e-9 * self.step {
            let y = self.y(tick);
            let zero = if tick.abs() < self.step / 2.0 { " zero" } else { "" };
            // Adding zero turns -0 into 0.
            let number = if zero.is_empty() { tick } else { 0.0 };
            text.push_str(&format!(
                "<line class=\"grid{zero}\" x1=\"{LEFT}\" x2=\"{RIGHT}\" y1=\"{y:.1}\" y2=\"{y:.1}\"/>\
                 <text class=\"tick\" x=\"{}\" y=\"{:.1}\" text-anchor=\"end\">{number:.*}</text>\n",
                LEFT - 8.0,
                y + 4.0,
                self.decimals,
            ));
            tick += self.step;
        }
        text
    }

    /// Returns the numbers that the script needs to read a value off a curve: the value at the top, and a value per
    /// unit of height.
    pub(super) fn reading(&self) -> (f64, f64) {
        (self.high, (self.high - self.low) / self.height)
    }
}

/// Returns the smallest of 1, 2, 5, 10 … that is not below `wanted`, and how many decimals it needs.
fn step(wanted: f64) -> (f64, usize) {
    let mut exponent = 0_i32;
    for candidate in -12..12 {
        exponent = candidate;
        if 10_f64.powi(candidate + 1) >= wanted {
            break;
        }
    }
    let unit = 10_f64.powi(exponent);
    let step = [1.0, 2.0, 5.0].into_iter().map(|factor| factor * unit).find(|step| *step >= wanted);
    match step {
        Some(step) => (step, usize::try_from(-exponent).unwrap_or(0)),
        None => (10.0 * unit, usize::try_from(-exponent - 1).unwrap_or(0)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_round() {
        for (wanted, expect) in
            [(0.09, (0.1, 1)), (0.11, (0.2, 1)), (3.0, (5.0, 0)), (7.0, (10.0, 0)), (2.22, (5.0, 0))]
        {
            let (step, decimals) = step(wanted);
            assert!((step - expect.0).abs() < 1e-12 && decimals == expect.1, "{wanted}: {step} {decimals}");
        }
    }

    #[test]
    fn an_axis_holds_its_values_and_a_zero_that_is_near() {
        for (low, high, expect) in [(0.5, 74.0, (0.0, 75.0)), (-16.0, 28.8, (-20.0, 30.0)), (0.0, 0.0, (0.0, 0.5))] {
            let axis = ValueAxis::new(low, high, 100.0);
            assert!((axis.low - expect.0).abs() < 1e-9 && (axis.high - expect.1).abs() < 1e-9, "{axis:?}");
        }
        let axis = ValueAxis::new(100.0, 101.0, 100.0);
        assert!(axis.low >= 99.0 && axis.high <= 102.0, "{axis:?}");
    }
}
